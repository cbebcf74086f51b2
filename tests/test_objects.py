"""Results sample, draw, tabulate and print themselves."""

import json
from itertools import islice
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from result_attributes import by_name
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.foundation.shown import Shown
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.runs import preflight
from tests.pages.test_legibility import problems
from tests.pages.test_night import night

FLOWN = 1e-7
"""Difference between sampled and independently integrated states, grown by the orbit's instability."""


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    return results_of_functions()


def results_of_functions() -> dict[str, Any]:
    lab = dp.load_model("lab")
    orbit = dp.orbit(lab, "down-up", energy=-0.07)
    found = dp.connections(orbit)
    walk = dp.shadow(found, ["down-up +"])
    loop = dp.closed_loop("outer-turn", mismatch=0.02)
    run = loop.run(seed=3)
    tube = orbit.manifold(stable=True, branch=1)
    return {
        "orbit": orbit,
        "family": lyapunov_family(lab.system, "down-up", energies=(-0.08, -0.06)),
        "tube": tube,
        "cut": tube.cut(),
        "search": found,
        "connection": found.connections[0],
        "walk": walk,
        "graph": dp.graph(lab, energy=-0.07),
        "atlas": dp.atlas(lab, energy=-0.07),
        "plan": loop.plan,
        "loop": loop,
        "run": run,
        "log": run.log,
        "night": night(),
        "rotating orbit": dp.rotating_orbits(lab, "outer", energy=0.3)[0],
        "recording": dp.swings(lab, count=2, seconds=1.5),
        "flight": dp.flight(lab, [0.5, -1.0, 3.0, 2.0, 0.1, -0.5], "up-up"),
    }


@pytest.fixture(scope="module")
def slow_results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    loop, swings = dp.closed_loop("outer-turn"), dp.swings("lab", count=3, seconds=1.5)
    orbit = dp.orbit("lab", "down-up", energy=-0.07)
    folder = tmp_path_factory.mktemp("logs")
    campaign = loop.campaign(runs=2, out=folder / "two.parquet")
    logs = [loop.run(seed=seed, log=folder / f"{seed}.mcap").log.path for seed in (1, 2)]
    hazards, changes = preflight.hazards, preflight.changes
    with pytest.MonkeyPatch.context() as patch:
        # The border of lag and one kind of change: each of the others takes seconds of runs.
        patch.setattr(preflight, "hazards", lambda plan, scene, **most: hazards(plan, scene, **most)[1:2])
        patch.setattr(preflight, "changes", lambda scene: islice(changes(scene), 1))
        checked = loop.preflight(runs=16, workers=1)
    return {
        "campaign": campaign,
        "preflight": checked,
        "identification": dp.identify(swings, model="lab"),
        "summary": dp.open_campaign(folder / "two.parquet"),
        "comparison": dp.compare_logs(logs),
        "sustained orbit": dp.sustained_orbit(orbit),
        "rotating family": dp.rotating_families("lab", "outer", energies=(0.29, 0.31))[0],
        "bifurcations": dp.find_bifurcations("lab", "down-up", "down-up", energies=(-0.08, -0.06), samples=2),
        "symmetric": dp.connections(dp.orbit("triple", "down-down-up", energy=-1.0), energies=(-1.02, -0.99)),
    }


TIMED = ("orbit", "rotating orbit", "connection", "walk", "plan", "loop", "run", "recording", "flight")
BASES = {"Timed", "Family", "HyperbolicOrbit", "Periodic", "PeriodicOrbit"}


@pytest.mark.slow
def test_each_class_that_can_draw_itself_is_tried_here(results: dict[str, Any], slow_results: dict[str, Any]) -> None:
    shown = {name for name, kind in by_name().items() if issubclass(kind, Shown)} - BASES
    assert {type(one).__qualname__ for one in (*results.values(), *slow_results.values())} == shown


def shows_itself(result: Any) -> None:
    text = repr(result)
    assert "\n" not in text
    assert not any(word in text for word in ("array(", "SX(", "object at 0x"))
    assert len(text) < 400
    json.dumps(result.document(), allow_nan=False)
    figure = Figure()
    axes = figure.add_subplot()
    assert result.plot(axes=axes) is figure
    assert axes.has_data() or axes.patches
    shown = result._repr_html_()
    assert "data:image/png;base64," in shown
    assert len(shown) < 200_000


def test_a_result_prints_one_line_draws_onto_axes_and_gives_json(results: dict[str, Any]) -> None:
    for result in results.values():
        shows_itself(result)


@pytest.mark.slow
def test_a_result_of_many_runs_prints_one_line_and_draws(slow_results: dict[str, Any]) -> None:
    for result in slow_results.values():
        shows_itself(result)


@pytest.mark.slow
def test_the_page_of_each_result_is_legible_in_print(results: dict[str, Any], slow_results: dict[str, Any]) -> None:
    found = {type(one).__name__: problems(one.plot()) for one in (*results.values(), *slow_results.values())}
    assert {name: problem for name, problem in found.items() if problem} == {}


@pytest.mark.parametrize("name", TIMED)
def test_a_motion_has_samples_at_times_and_a_table(name: str, results: dict[str, Any]) -> None:
    result = results[name]
    first, last = result.time_range
    states = result.states(np.linspace(first, last, 5))
    assert result.sample(5) == pytest.approx(states)
    # Any shape of times and any order, as a number or an array.
    assert result.states(last) == pytest.approx(states[4])
    assert result.states([[last, first]]) == pytest.approx(states[None, [4, 0]])
    assert result.states([]).shape == (0, states.shape[1])
    table = result.frame(5)
    assert list(table.columns) == list(result.columns)
    assert table.to_numpy() == pytest.approx(states)
    assert table.index.name == "time"
    for times in ("noon", [np.nan], object()):
        with pytest.raises(dp.InputError, match="times"):
            result.states(times)


@pytest.mark.parametrize("name", ["orbit", "connection", "walk"])
def test_sampled_states_obey_the_equations(name: str, results: dict[str, Any]) -> None:
    """An independent integrator carries each of five sampled states to the next."""
    result, system = results[name], results["orbit"].system
    first, last = result.time_range
    times = np.linspace(first, first + min(last - first, 1.0), 5)
    states = result.states(times)
    for k in range(4):
        flown = solve_ivp(
            lambda _, x: system.numeric.rate(x), (times[k], times[k + 1]), states[k], rtol=1e-11, atol=1e-12
        )
        assert np.abs(flown.y[:, -1] - states[k + 1]).max() < FLOWN
