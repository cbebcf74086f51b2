"""The tubes in a run's phase planes: cuts drawn in short chords, and open where the tube does not arrive."""

from typing import Any

import numpy as np

from dpcontrol.dynamics.chain import pendulum_system
from dpcontrol.judge.of_log import tubes_of
from dpcontrol.plans.model import load_model

CHORD = 0.2  # rad, a rad/s counting a fifth: a hundredth of the picture's width
ON_SECTION = 1e-6  # rad

NOTES: dict[str, Any] = {
    "symbols": [
        {
            "name": "down-up>up-down[0,0]h1.1@-0.4156,19.8978",
            "source": "down-up",
            "target": "up-down",
            "section": {"value": 0.0},
        }
    ],
    "stops": [
        {"orbit": 0, "saddle": "down-up", "angles": [0.0, np.pi]},
        {"orbit": 1, "saddle": "up-down", "angles": [np.pi, 0.0]},
    ],
    "orbits": [{"saddle": "down-up", "energy": 0.2}, {"saddle": "up-down", "energy": 0.2}],
    "saddles": {"down-up": {"angles": [0.0, np.pi]}, "up-down": {"angles": [np.pi, 0.0]}},
}
"""Of a crossing at 0.2 J, whose unstable tube arrives torn: its neighbours of 96 lie up to 6 apart."""


def test_a_cut_is_drawn_in_short_chords_and_not_across_its_open_ends() -> None:
    tubes = tubes_of(NOTES, pendulum_system("lab", load_model("lab").arms))
    assert {tube.stable for tube in tubes} == {False, True}
    for tube in tubes:
        chords = np.linalg.norm(np.diff(tube.cut, axis=0) * [1.0, 1.0, 0.2, 0.2], axis=1)
        drawn = chords[np.isfinite(chords)]
        assert len(drawn) > 90
        assert drawn.max() <= CHORD
        aligned = tube.cut[:, 0] - tube.cut[:, 1]
        assert np.nanmax(np.abs(aligned)) <= ON_SECTION
