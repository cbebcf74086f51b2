"""Stops decoded from angles: detours that the reference makes too are no mistakes of a run."""

import numpy as np
import pytest

from dpcontrol.review.stops import Visit, decode_stops, settled_ticks, without_detours

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
