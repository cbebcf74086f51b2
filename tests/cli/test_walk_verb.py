"""`dpcontrol walk`: what it lists, draws and solves, what it writes, and what it refuses."""

import json
from pathlib import Path

import numpy as np
from command_line import dpcontrol
from independent_pendulum import flow

BETWEEN_NODES = 1e-9
"""From node to node by an independent integrator at 1e-12 relative; the segments are an eighth of a period long."""
LOW = ("walk", "lab", "--energy", "-0.07")
TURN = ("-s", "down-up +")
BACK = ("-s", "down-up -")


def test_numpy_reads_the_output_which_satisfies_the_equations(tmp_path: Path) -> None:
    ended = dpcontrol(*LOW, *TURN, *BACK, "--wraps", "1", "--solve", "--out", tmp_path / "orbits", "--json")
    (walk,) = ended.document["walks"]
    assert walk["file"] == str(tmp_path / "orbits" / "walk-1.npz")
    with np.load(walk["file"], allow_pickle=False) as arrays:
        header = json.loads(str(arrays["header"]))
        times, states, symbol_times, turn = (arrays[k] for k in ("times", "states", "symbol_times", "turn"))
    assert (header["model"], header["energy"], header["walk"]) == ("lab", -0.07, walk["walk"])
    assert (header["wraps"], header["wraps_realised"], header["periodic"]) == ([1], [1], False)
    assert symbol_times.tolist() == walk["symbol_times"]
    assert turn.tolist() == [0, 0, 0, 0]
    assert states.shape == (len(times), 4)
    assert (np.diff(times) > 0).all()
    for k in range(0, len(times) - 1, 5):
        flown = flow(states[k], times[k + 1] - times[k])
        assert np.abs(flown[-1] - states[k + 1]).max() < BETWEEN_NODES
    # The section of Down-Up's connections: the outer arm passes straight down.
    for time in symbol_times:
        node = states[np.argmin(np.abs(times - time))]
        assert abs(np.angle(np.exp(1j * node[1]))) < BETWEEN_NODES
