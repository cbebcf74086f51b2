"""Results sample, draw, tabulate and print themselves."""

import ast
import json
import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import dpcontrol as dp
from dpcontrol.foundation.shown import Shown, Timed
from dpcontrol.orbits.family import lyapunov_family
from tests.pages.test_night import night

FLOWN = 1e-7
"""Difference between sampled and independently integrated states, grown by the orbit's instability."""


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
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
        "rotating family": dp.rotating_families(lab, "outer", energies=(0.29, 0.31))[0],
        "bifurcations": dp.find_bifurcations(lab, "down-up", "down-up", energies=(-0.08, -0.06), samples=2),
        "proof": dp.prove(orbit),
        "recording": dp.swings(lab, count=2, seconds=1.5),
    }


@pytest.fixture(scope="module")
def slow_results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    loop, swings = dp.closed_loop("outer-turn"), dp.swings("lab", count=3, seconds=1.5)
    folder = tmp_path_factory.mktemp("logs")
    loop.campaign(runs=2, out=folder / "two.parquet")
    logs = [loop.run(seed=seed, log=folder / f"{seed}.mcap").log.path for seed in (1, 2)]
    return {
        "campaign": loop.campaign(runs=2),
        "preflight": loop.preflight(runs=16, workers=1),
        "identification": dp.identify(swings, model="lab"),
        "summary": dp.open_campaign(folder / "two.parquet"),
        "comparison": dp.compare_logs(logs),
        "polished": dp.polish("one-arm", runs=1),
        "sustained orbit": dp.sustained_orbit(dp.orbit("lab", "down-up", energy=-0.07)),
        "symmetric": dp.connections(dp.orbit("triple", "down-down-up", energy=-1.0), energies=(-1.02, -0.99)),
    }


QUICK = (
    "orbit", "family", "tube", "cut", "search", "connection", "walk", "graph", "atlas", "plan", "loop", "run", "log",
    "night", "recording", "rotating orbit", "rotating family", "bifurcations", "proof",
)  # fmt: skip
SLOW = (
    "campaign", "preflight", "identification", "summary", "comparison", "polished", "sustained orbit", "symmetric",
)  # fmt: skip
TIMED = ("orbit", "rotating orbit", "connection", "walk", "plan", "loop", "run", "recording")
SLOW_TIMED = ("sustained orbit",)
CLASSES = {
    "orbit": "LyapunovOrbit", "family": "LyapunovFamily", "tube": "Tube", "cut": "Cut", "search": "ConnectionSearch",
    "connection": "Connection", "walk": "ShadowingOrbit", "graph": "Edges", "atlas": "Atlas", "plan": "Plan",
    "loop": "ClosedLoop", "run": "Run", "log": "RunLog", "night": "Night", "recording": "Recording",
    "rotating orbit": "RotatingOrbit", "rotating family": "RotatingFamily", "bifurcations": "BifurcationSearch",
    "proof": "Proof", "campaign": "Campaign", "preflight": "Preflight", "identification": "Identification",
    "summary": "CampaignSummary", "comparison": "RunComparison", "polished": "Polished",
    "sustained orbit": "SustainedOrbit", "symmetric": "SymmetricSearch",
}  # fmt: skip
"""Class of each result above."""
BASES = {"Shown", "Timed", "Family", "HyperbolicOrbit"}
WITHOUT_PICTURE = {
    "CacheContents", "CertificateCheck", "Commissioning", "Configured", "ControllerSource", "Design", "Drawn",
    "DrawnChart", "Equilibrium", "ExtendedOrbit", "LogSummary", "Planner", "PrecisionChart", "Recovery", "Repeat",
    "Replay", "RigLink", "SymbolChange", "UdpBench", "WalkRequest",
}  # fmt: skip
"""Tables, files, settings and servers. A chart (`PrecisionChart`, `Drawn`) is a picture already."""


def subclasses(kind: type) -> set[type]:
    return {kind}.union(*(subclasses(one) for one in kind.__subclasses__()))


def test_no_type_of_result_is_forgotten_here() -> None:
    """Each class that can draw itself is tried below, and so is each class that a function of `dp` returns."""
    for module in pkgutil.walk_packages(dp.__path__, "dpcontrol."):
        if module.name.rpartition(".")[2] != "__main__" and ".examples" not in module.name:
            import_module(module.name)
    shown = {one.__qualname__ for one in subclasses(Shown)} - BASES
    assert set(CLASSES) == {*QUICK, *SLOW}
    assert set(CLASSES.values()) == shown
    timed = {one.__qualname__ for one in subclasses(Timed)} - BASES
    assert {CLASSES[name] for name in (*TIMED, *SLOW_TIMED)} == timed
    source = ast.parse((Path(dp.__file__).parent / "api.py").read_text(encoding="utf-8"))
    functions = [one for one in source.body if isinstance(one, ast.FunctionDef) and one.name in dp.__all__]
    written = [one.returns.value if isinstance(one.returns, ast.Constant) else ast.unparse(one.returns)
               for one in functions if one.returns is not None]  # fmt: skip
    returned = {node.id for text in written for node in ast.walk(ast.parse(str(text))) if isinstance(node, ast.Name)}
    plain = {"Any", "Figure", "Path", "dict", "int", "str", "tuple"}
    assert returned - plain - shown == WITHOUT_PICTURE


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


@pytest.mark.parametrize("name", QUICK)
def test_a_result_prints_one_line_draws_onto_axes_and_gives_json(name: str, results: dict[str, Any]) -> None:
    assert type(results[name]).__qualname__ == CLASSES[name]
    shows_itself(results[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_a_result_of_many_runs_prints_one_line_and_draws(name: str, slow_results: dict[str, Any]) -> None:
    assert type(slow_results[name]).__qualname__ == CLASSES[name]
    shows_itself(slow_results[name])
    assert slow_results[name].plot().axes


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW_TIMED)
def test_a_slow_motion_has_samples_at_times_and_a_table(name: str, slow_results: dict[str, Any]) -> None:
    is_sampled(slow_results[name])


@pytest.mark.parametrize("name", TIMED)
def test_a_motion_has_samples_at_times_and_a_table(name: str, results: dict[str, Any]) -> None:
    is_sampled(results[name])


def is_sampled(result: Any) -> None:
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


def test_a_stable_tube_approaches_its_orbit_and_an_unstable_one_leaves_it(results: dict[str, Any]) -> None:
    orbit = results["orbit"]
    system = orbit.system
    for stable, way in ((False, -1.0), (True, 1.0)):
        strand = orbit.manifold(stable=stable, branch=1).strands(3)[1]
        # Followed towards the orbit for half of the flight, trajectories end nearer to it than they began.
        flown = solve_ivp(lambda _, x, way=way: way * system.numeric.rate(x), (0, 0.4), strand[-1], rtol=1e-10)
        ring = orbit.sample(800)
        begun, ended = (float(system.scaled_distance(ring, x).min()) for x in (strand[-1], flown.y[:, -1]))
        assert ended < begun


def test_a_cut_lies_on_its_section_at_the_orbits_energy(results: dict[str, Any]) -> None:
    orbit = results["orbit"]
    for stable in (False, True):
        cut = orbit.manifold(stable=stable).cut("outer-down")
        states = np.vstack([piece.states for piece in cut.pieces])
        assert np.abs(np.sin(states[:, 1] / 2)).max() < 1e-9
        assert orbit.system.numeric.hamiltonian(states) == pytest.approx(orbit.energy, abs=1e-9)
        rates = orbit.system.numeric.rate(states)[:, 1]
        directions = np.concatenate([np.full(len(piece.phases), piece.direction) for piece in cut.pieces])
        assert (np.sign(rates) == directions).all()


def test_connections_lie_on_the_cuts_of_both_tubes(results: dict[str, Any]) -> None:
    orbit, chord = results["orbit"], 0.06
    curves = [
        np.vstack([piece.points for piece in orbit.manifold(stable=stable).cut().pieces]) for stable in (False, True)
    ]
    for connection in results["search"].connections:
        for points in curves:
            gaps = points - connection.place
            gaps[:, 0] -= 2 * np.pi * np.rint(gaps[:, 0] / (2 * np.pi))
            assert np.linalg.norm(gaps, axis=1).min() < chord


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda orbit: orbit.manifold(branch=2), "branch = 2: must be -1, 0, 1"),
        (lambda orbit: orbit.manifold().cut("outer-dwn"), "did you mean 'outer-down'"),
        (lambda orbit: orbit.manifold().cut(hit=0), "hit = 0"),
        (lambda orbit: orbit.sample(0), "count = 0"),
        (lambda orbit: orbit.plot(axes=3), "axes = 3"),
    ],
)
def test_methods_of_results_refuse_wrong_arguments(call: Any, words: str, results: dict[str, Any]) -> None:
    with pytest.raises(dp.InputError) as refused:
        call(results["orbit"])
    assert words in str(refused.value)


def test_axes_in_space_are_refused(results: dict[str, Any]) -> None:
    for projection in ("3d", "polar"):
        axes = Figure().add_subplot(projection=projection)
        for name in ("orbit", "proof", "search"):
            with pytest.raises(dp.InputError, match=f"axes = {projection} axes: pictures need plane rectangular axes"):
                results[name].plot(axes)


def test_a_night_is_a_table_of_its_files(results: dict[str, Any]) -> None:
    """Two files with two and one falls before a gap, and a last one without any, 600 s each."""
    table = results["night"].frame()
    assert table.index.tolist() == [0.0, 600.0, 1800.0]
    assert table["end"].tolist() == [600.0, 1200.0, 2400.0]
    assert table["falls"].tolist() == [2, 1, 0]
    assert table["zero_1"].tolist() == [0.0, 0.001, 0.003]


def test_an_html_text_is_escaped(results: dict[str, Any]) -> None:
    assert "&lt;orbit about down-up" in results["orbit"]._repr_html_()


def test_objects_within_results_print_no_arrays(results: dict[str, Any]) -> None:
    """All objects that attributes of a search, a walk and a plan lead to, three levels deep."""
    seen: set[int] = set()

    def visit(value: Any, depth: int) -> None:
        if id(value) in seen or depth > 3:
            return
        seen.add(id(value))
        if type(value).__module__.startswith("dpcontrol.") and hasattr(value, "__dataclass_fields__"):
            text = repr(value)
            assert "array([" not in text, type(value)
            assert "SX(" not in text, type(value)
            for name in value.__dataclass_fields__:
                visit(getattr(value, name), depth + 1)
        elif isinstance(value, tuple | list):
            for one in value[:3]:
                visit(one, depth + 1)

    for name in ("search", "walk", "plan", "run", "atlas", "recording"):
        visit(results[name], 0)
