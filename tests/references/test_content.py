"""A plan's content in the file of its reference: what is written is read, and what contradicts itself is refused."""

import json
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.plan import Plan
from dpcontrol.references.content import FlightSegment, PlanContent, StaySegment, stored
from dpcontrol.references.reference import Reference, load_reference, save_reference


def read_again(plan: Plan, content: PlanContent) -> PlanContent:
    save_reference(file := BytesIO(), replace(plan.reference, plan=content))
    return load_reference(file).content


def values(content: PlanContent) -> dict[str, Any]:
    """The content's fields as plain values, arrays as lists."""
    notes, arrays = stored(content)
    return {**notes, **{name: array.tolist() for name, array in arrays.items()}}


def test_what_is_written_is_read(plan: Plan) -> None:
    segments = (StaySegment("down-up", -0.07, 0, 0.7, (0.0,) * 6, 2, (0, 8)), FlightSegment("down-up +", (8, 20)))
    content = replace(plan.content, segments=segments, polished=(0.1, 0.2), wraps=())
    again = read_again(plan, content)
    assert values(again) == values(content)
    for field in fields(content):
        if field.name != "orbits":
            assert getattr(again, field.name) == getattr(content, field.name), field.name


def test_the_orbits_of_a_walk_close_after_their_period(plan: Plan) -> None:
    system = plan.itinerary.model.system
    for orbit in plan.content.orbits:
        end = system.propagator.sample(np.array(orbit.state), np.array([0.0, orbit.free_period]))[-1]
        assert np.abs(end - orbit.state).max() < 1e-9  # of the search: 1e-12, grown by the multiplier


@pytest.mark.parametrize(
    "change",
    [
        lambda c: replace(c, stops=c.stops[:1]),
        lambda c: replace(c, wraps=(1,)),
        lambda c: replace(c, stops=(replace(c.stops[0], orbit=7), c.stops[1])),
        lambda c: replace(c, stops=(replace(c.stops[0], arrived_on=-1), c.stops[1])),
        lambda c: replace(c, stops=(replace(c.stops[0], saddle="up-up"), c.stops[1])),
        lambda c: replace(c, stops=(replace(c.stops[0], angles=(0.0,)), c.stops[1])),
        lambda c: replace(c, orbits=(replace(c.orbits[0], period=0.0),)),
        lambda c: replace(c, orbits=(replace(c.orbits[0], curve=c.orbits[0].curve[:, :3]),)),
        lambda c: replace(c, symbols=(replace(c.symbols[0], section=replace(c.symbols[0].section, normal=(1.0,))),)),
    ],
)
def test_a_content_that_contradicts_itself_is_refused(plan: Plan, change: Any) -> None:
    with pytest.raises(InputError, match="contradict each other"):
        read_again(plan, change(plan.content))


@pytest.fixture
def stored_turn(reference: Reference, tmp_path: Path) -> tuple[Reference, Path]:
    path = tmp_path / "turn.npz"
    save_reference(path, reference)
    return reference, path


def test_a_reference_is_restored_exactly(stored_turn: tuple[Reference, Path]) -> None:
    reference, path = stored_turn
    back = load_reference(path)
    times = np.linspace(0.0, reference.duration, 333)
    assert (back.state(times) == reference.state(times)).all()
    assert (back.input(times) == reference.input(times)).all()
    assert back.plan is None
    for name in ("status", "converged", "limits", "max_error_between_nodes", "iterations", "duration"):
        assert getattr(back, name) == getattr(reference, name)


def test_the_file_is_readable_with_numpy_alone(stored_turn: tuple[Reference, Path]) -> None:
    reference, path = stored_turn
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        assert header["format"] == "dpcontrol-reference"
        assert file["states"].shape == reference.states.shape
        # The documented layout suffices to evaluate the input by a polynomial fit.
        fit = np.polyfit(file["points"], file["inputs"][7, :, 0], len(file["points"]) - 1)
        time = file["mesh"][7] + 0.3 * (file["mesh"][8] - file["mesh"][7])
    assert np.polyval(fit, 0.3) == pytest.approx(float(reference.input(time)[0]), abs=1e-9)


def test_a_failed_reference_is_stored_without_infinities(stored_turn: tuple[Reference, Path]) -> None:
    reference, path = stored_turn
    save_reference(path, replace(reference, converged=False, max_error_between_nodes=float("inf")))
    back = load_reference(path)
    assert not back.converged
    assert back.max_error_between_nodes == float("inf")
