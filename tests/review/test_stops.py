"""Stops decoded from angles: detours that the reference makes too are no mistakes of a run."""

import numpy as np
import pytest

from dpcontrol.review.score import Visit, decode_stops, section_crossings, settled_ticks, without_detours

A, B, C, D = (0.0, np.pi), (2 * np.pi, np.pi), (0.0, 3 * np.pi), (np.pi, 0.0)


def visits(*points):
    return [Visit(point, 10 * k, 10 * k + 9) for k, point in enumerate(points)]


@pytest.mark.parametrize(
    ("planned", "made", "left"),
    [
        ((A, C), (A, C), (A, C)),
        ((A, B, C), (A, B, C), (A, C)),
        ((A, B, C), (A, C), (A, C)),
        ((A, B, D, C), (A, D, C), (A, C)),
        ((A, B, C), (A, D), (A, D)),
        ((A, B, C), (A, B, D), (A, D)),
        ((A, C), (A, B, C), (A, B, C)),
        ((A, B), (A, B, C), (A, B, C)),
        ((A, B, C), (A, B, C, D), (A, C, D)),
        ((A, C), (), ()),
    ],
)
def test_only_detours_of_the_reference_are_forgiven(planned, made, left):
    found = without_detours(visits(*made), visits(*planned), [A, C])
    assert [visit.angles for visit in found] == list(left)


def test_while_on_a_transfer_the_pendulum_is_nowhere():
    time = np.arange(100) * 0.1
    angles = np.repeat([A, B, C], [40, 30, 30], axis=0)
    settled = settled_ticks(time, {"transfers": [[4.0, 6.9]]})
    saddles = np.array([A, D])
    assert [v.angles for v in decode_stops(angles, saddles, dwell=5)] == [A, B, C]
    assert [v.angles for v in decode_stops(angles, saddles, dwell=5, settled=settled)] == [A, C]


def test_where_a_stay_lasts_its_own_time_the_angles_at_the_section_tell_which_crossing_is_meant() -> None:
    """Thrice over θ₂ = 0; the one meant is at θ₁ = 1.5, two seconds later than planned."""
    time = np.arange(0.0, 12.0, 1e-3)
    angles = np.array([time - 7.0, np.interp(time, [0, 6, 8, 9, 12], [-1.0, -0.5, 0.5, -0.5, 1.0])]).T
    visits = [Visit((0.0, 0.0), 0, 2000), Visit((0.0, 0.0), 11_000, 11_999)]
    section = {"normal": [0.0, 1.0, 0.0, 0.0], "value": 0.0, "angles": [1.5, 0.0]}
    notes = {"symbols": [{"section": section, "time": 6.5}]}
    (by_time,) = section_crossings(time, angles, notes, visits)
    (by_place,) = section_crossings(time, angles, {**notes, "program": []}, visits)
    assert by_time == pytest.approx(7.0, abs=1e-6)
    assert by_place == pytest.approx(8.5, abs=1e-6)
