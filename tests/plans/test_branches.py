"""Diagrams of connections against energy are cached by content, read back unchanged, and computed again if damaged."""

import numpy as np
import pytest

from dpcontrol.plans import atlas as branches
from dpcontrol.plans.atlas import make_branches
from dpcontrol.plans.model import load_model

FOLD = (-0.1425, -0.1400)  # J: about the first saddle-node of Down-Up's homoclinics


def diagram():
    return make_branches(load_model("lab"), "down-up", "down-up", energies=FOLD, samples=2)


@pytest.mark.slow
def test_a_diagram_holds_its_event_is_kept_and_is_computed_again_if_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path))
    made = diagram()
    (mark,) = made.marks
    assert (mark.kind, mark.count_below, mark.count_above) == ("saddle-node", 0, 4)
    energies, points = min(made.runs, key=lambda run: run[0].min())
    assert 0 < energies.min() - mark.energy < 1e-5
    assert np.abs(points[int(np.argmin(energies))] - mark.point).max() < 0.01
    assert [count for _, count, _ in made.counts] == [0, 4]
    with monkeypatch.context() as patch:
        patch.setattr(branches, "find_bifurcations", lambda *_, **__: pytest.fail("swept again"))
        read = diagram()
    assert read.marks == made.marks
    assert read.counts == made.counts
    assert all(
        np.array_equal(a, b)
        for one, other in zip(read.runs, made.runs, strict=True)
        for a, b in zip(one, other, strict=True)
    )
    (file,) = tmp_path.glob("branches/*.json")
    file.write_text('{"runs": 3}')
    assert diagram().marks == made.marks
    assert file.stat().st_size > 200
