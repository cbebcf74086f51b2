"""A wrong call of a public function or method is an InputError with one sentence, or the documented status."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import dpcontrol as dp
from dpcontrol.foundation.parts import PartMissing
from tests.pages.test_night import night

CALLS, LONGEST = 2000, 1000
"""Number of calls with a wrong type, and length of the longest sentence, which lists all itineraries."""
NUMBERS = {"Count", "Hit", "Index", "Positive", "Seed", "Workers", "NotNegative", "float", "int", "object"}
"""Kinds of annotations that a positive number of moderate size fits."""


class Hostile:
    """A value that cannot be printed, compared or measured."""

    def __repr__(self) -> str:
        raise RuntimeError("no repr")

    def __len__(self) -> int:
        raise RuntimeError("no length")

    __eq__ = None  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]


WRONG: list[tuple[Any, set[str]]] = [
    (None, {"None"}),
    (True, {"bool", "True"}),
    (False, {"bool"}),
    (np.True_, {"bool"}),
    (0, {"Literal[-1, 0, 1]", "Index", "Seed", "Workers", "NotNegative", "float", "int"}),
    (-1, {"float", "int", "Literal[-1, 0, 1]"}),
    (3, NUMBERS),
    (2**70, {"float", "int", "Positive", "NotNegative"}),
    (10**400, set()),
    (0.5, {"Positive", "NotNegative", "float"}),
    (-0.5, {"float"}),
    (float("nan"), set()),
    (float("inf"), set()),
    (-np.float64("inf"), set()),
    (1j, set()),
    (Fraction(1, 2), {"Positive", "NotNegative", "float", "Fraction"}),
    ("", {"str"}),
    ("no such", {"str"}),
    ("a\nb\x1b[2J", {"str"}),
    ("3", {"str"}),
    (b"down-up", set()),
    (Path("no/such"), {"Path"}),
    ([], {"Sequence[str]", "Sequence[Index]", "Sequence[Place]"}),
    (["no such"], {"Sequence[str]", "Sequence[Place]"}),
    ([None], set()),
    ([["x"]], set()),
    ((1,), {"Sequence[Index]"}),
    ((0, 0), {"Sequence[Index]", "tuple[float, float]", "tuple[Index, Index]"}),
    (
        (1, 2),
        {"Sequence[Index]", "tuple[float, float]", "tuple[Index, Index]", "tuple[Hit, Hit]", "tuple[Count, Count]"},
    ),
    ((1, "2"), set()),
    ((float("nan"), 1.0), set()),
    ((1, 2, 3), {"Sequence[Index]"}),
    ({}, {"Mapping[str, object]"}),
    ({"no such": 1}, {"Mapping[str, object]"}),
    ({1: 2}, set()),
    ({"a", "b"}, set()),
    (np.zeros(3), set()),
    (np.zeros((20, 20)), set()),
    (np.array(1.0), set()),
    (np.array(["x"]), {"Sequence[str]", "Sequence[Place]"}),
    (np.float32(2.5), {"Positive", "NotNegative", "float"}),
    (iter([]), set()),
    (int, {"Callable"}),
    (print, {"Callable"}),
    (object(), set()),
    (type("Runner", (), {}), {"Callable"}),
    (Hostile(), set()),
    (ValueError("x"), set()),
    (re.compile("x"), set()),
]
"""Values, and the kinds of annotations that each fits."""
GOOD: dict[str, dict[str, Any]] = {
    "atlas": {"model": "lab", "energy": -0.07},
    "campaign": {"planned": "$plan"},
    "check_proof": {"file": "$log_file"},
    "closed_loop": {"planned": "$plan"},
    "commission": {"itinerary": "outer-turn"},
    "compare_logs": {"logs": ["no.mcap"]},
    "connections": {"source": "$orbit"},
    "count_walks": {"graph": "$graph", "length": 2},
    "design_experiments": {"model": "lab"},
    "equilibria": {"model": "lab"},
    "explore_energies": {"planned": "$plan"},
    "export": {"planned": "$plan"},
    "family": {"model": "lab", "saddle": "down-up", "energies": (-0.08, -0.07)},
    "find_bifurcations": {"model": "lab", "source": "down-up", "target": "down-up", "energies": (-0.08, -0.06)},
    "graph": {"model": "lab", "energy": -0.07},
    "identify": {"recordings": "$recording", "model": "lab"},
    "list_walks": {"graph": "$graph", "length": 1},
    "load_model": {"name": "lab"},
    "log_summary": {"file": "$log_file"},
    "mjcf": {"model": "lab"},
    "open_atlas": {"file": "$log_file"},
    "open_campaign": {"file": "$log_file"},
    "open_log": {"file": "$log_file"},
    "open_night": {"folder": "$log_file"},
    "open_plan": {"file": "$log_file"},
    "open_recording": {"file": "$log_file"},
    "orbit": {"model": "lab", "saddle": "down-up", "energy": -0.07},
    "picture": {"result": "$plan"},
    "plan": {"itinerary": "outer-turn"},
    "polish": {"planned": "$plan"},
    "prove": {"found": "$orbit"},
    "random_walks": {"graph": "$graph", "count": 2},
    "recover_log": {"file": "$log_file"},
    "reference": {"walks": "$walk"},
    "refine": {"found": "$connection"},
    "repeat": {"log": "$log_file", "out": "$log_file"},
    "replay": {"recording": "$recording", "model": "lab"},
    "review": {"files": "$log_file"},
    "rotating_families": {"model": "lab", "arm": "outer", "energies": (0.29, 0.31)},
    "rotating_orbits": {"model": "lab", "arm": "outer", "energy": 0.3},
    "run": {"planned": "$plan"},
    "schema": {"of": "model"},
    "shadow": {"found": "$found", "walk": ["down-up +"]},
    "shortest_walk": {"graph": "$graph", "stops": ["down-up", "down-up"]},
    "start_bench": {"itinerary": "outer-turn"},
    "sustained_orbit": {"orbit": "$orbit"},
    "swings": {"model": "lab"},
    "symbol_changes": {"model": "lab", "symbols": ["down-up +"], "energies": (-0.07, -0.069)},
    "write_recording": {"recording": "$recording", "file": "$log_file"},
    "atlas.between": {"source": "down-up", "target": "down-up"},
    "atlas.cut": {"saddle": "down-up", "section": "a", "hit": 1},
    "atlas.turned": {"states": np.zeros(4), "saddle": "down-up"},
    "family.column": {"name": "period"},
    "found.named": {"name": "x"},
    "graph.between": {"source": "down-up", "target": "down-up"},
    "graph.leaving": {"saddle": "down-up"},
    "loop.night": {"hours": 0.01, "folder": "no"},
    "night.course": {"name": "zero_1"},
    "recording.segment": {"index": 0},
    "system.check_same": {"other": "$system"},
    "system.equilibrium": {"name": "down-up"},
    "system.nearest_turns": {"difference": np.zeros(4)},
    "system.scaled_distance": {"first": np.zeros(4), "second": np.zeros(4)},
    "system.section_between": {"source": "down-up", "target": "down-up"},
    "system.unit": {"name": "J"},
    "lab.unit": {"name": "J"},
    "hill.unit": {"name": "J"},
    "system.worded": {"text": "J"},
    "extended.at": {"phase": 0.0},
}
"""Arguments that suffice, by function or method; $NAME stands for a result."""
RENDERED = ("unit", "worded")
"""Methods that render texts of pages."""
UNCHECKED = {
    "tube.placed": "renders pieces of a cut",
    "system.from_hamiltonian": "checks the energy and its options itself; see tests/systems",
    "system.from_lagrangian": "checks the energy and its options itself; see tests/systems",
}
"""Methods that are not called here, and why."""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Results to call and to pass."""
    return results(tmp_path_factory.mktemp("wrong"))


def results(folder: Path) -> dict[str, Any]:
    lab = dp.load_model("lab")
    orbit = dp.orbit(lab, "down-up", energy=-0.07)
    found = dp.connections(orbit)
    loop = dp.closed_loop("outer-turn", mismatch=0.02)
    run = loop.run(seed=3, log=folder / "run.mcap")
    walk = dp.shadow(found, ["down-up +"])
    tube = orbit.manifold()
    other, rods = (dp.orbit(name, "down-up", energy=-0.06) for name in ("lab", "point-mass"))
    graph = dp.graph(lab, energy=-0.07)
    garbage = folder / "garbage"
    garbage.write_bytes(bytes(range(256)))
    return {
        "lab": lab,
        "system": lab.system,
        "orbit": orbit,
        "found": found,
        "connection": found.connections[0],
        "walk": walk,
        "tube": tube,
        "loop": loop,
        "plan": loop.plan,
        "run": run,
        "log": run.log,
        "graph": graph,
        "atlas": dp.atlas(lab, energy=-0.07),
        "night": night(),
        "recording": dp.swings(lab, count=2, seconds=1.5),
        "family": dp.family(lab, "down-up", energies=(-0.08, -0.07)),
        "rotating": dp.rotating_orbits(lab, "outer", energy=0.3)[0],
        "cut": tube.cut(),
        "other": other,
        "hill": dp.load_model("three-body"),
        "log_file": folder / "run.mcap",
        "garbage": garbage,
        "found_other": replace(found, source=other, target=other),
        "rods": rods,
        "found_rods": replace(found, source=rods, target=rods),
        "hill_system": dp.load_model("three-body").system,
        "hill_orbit": dp.orbit("three-body", "L1", energy=-1.519),
        "request": dp.random_walks(graph, 1)[0],
        "graph_other": replace(graph, energy=-0.06),
        "section": replace(lab.system.named_sections["aligned"], normal=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    }


def calls(things: dict[str, Any]) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Return the public functions and the methods of results, with arguments that suffice."""
    functions = {name: getattr(dp, name) for name in dp.__all__ if inspect.isfunction(getattr(dp, name))}
    kinds_of = {type(thing): name for name, thing in reversed(things.items())}
    for name in {*kinds_of.values()} - {"section"}:
        thing = things[name]
        methods = (
            inspect.getmembers(type(thing), inspect.isfunction) if type(thing).__module__.startswith("dpc") else []
        )
        for method, function in methods:
            if (
                not method.startswith("_")
                and method not in RENDERED
                and len(inspect.signature(function).parameters) > 1
            ):
                functions[f"{name}.{method}"] = getattr(thing, method)
    found = {}
    for name, function in functions.items():
        good = {
            key: things[value[1:]] if isinstance(value, str) and value.startswith("$") else value
            for key, value in GOOD.get(name, {}).items()
        }
        if name not in UNCHECKED:
            found[name] = function, good
    return found


def kinds(function: Callable[..., Any]) -> dict[str, list[str]]:
    """Return the types of each parameter as the source names them."""
    source = inspect.unwrap(function)
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(source))).body
    return {
        one.arg: list(parts(one.annotation))
        for one in (*tree.args.args, *tree.args.kwonlyargs)
        if one.arg not in ("self", "cls")
    }


ALIASES = {"Place": "Path | str", "Reporting": "Callable | True | None", "Progress": "Callable", "ArrayLike": "Any"}


def parts(node: ast.expr | None) -> Iterator[str]:
    if isinstance(node, ast.BinOp):
        yield from parts(node.left)
        yield from parts(node.right)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield from parts(ast.parse(node.value, mode="eval").body)
    elif node is not None:
        text = ast.unparse(node)
        if text in ALIASES:
            yield from parts(ast.parse(ALIASES[text], mode="eval").body)
        else:
            yield "Index" if text.startswith("Annotated[int") else text


def fits(value: Any, named: set[str], kind: str) -> bool:
    classes = {one.__name__ for one in type(value).__mro__} if type(value).__module__.startswith("dpc") else set()
    return kind in named | classes or (kind.startswith("Sequence[") and isinstance(value, list) and not value)


def wrong_calls(things: dict[str, Any]) -> list[tuple[str, str, Any]]:
    """Return (function, parameter, value) for each value that a parameter cannot be."""
    values = [*WRONG, *((one, {"Path"} if isinstance(one, Path) else set[str]()) for one in things.values())]
    return [
        (name, parameter, value)
        for name, (function, _) in calls(things).items()
        for parameter, allowed in kinds(function).items()
        if "object" not in allowed and "Any" not in allowed
        for value, named in values
        if not any(fits(value, named, kind) for kind in allowed)
        # The former sample(times) still works, with a warning.
        and not (name.endswith(".sample") and isinstance(value, (list, tuple, np.ndarray)))
    ]


MISTAKES: list[tuple[str, dict[str, Any]]] = [
    *(("orbit", {"saddle": one}) for one in ("", "down-upp", "down-down", "a\nb", "x" * 5000, "\0")),
    *(("orbit", {"model": one}) for one in ("", "labb", "..", "/", "no/such.toml", "$garbage", "$hill")),
    *(("orbit", {"energy": one}) for one in (-5.0, -1e300)),
    ("orbit", {"family": 7}),
    ("connections", {"target": "$other"}),
    ("connections", {"target": "$rods"}),
    ("connections", {"section": "no such"}),
    ("connections", {"energies": (-0.08, -0.07), "target": "$other"}),
    ("connections", {"energies": (-0.08, -0.07), "hits": (1, 2)}),
    ("graph", {"energy": -5.0}),
    ("graph", {"symbols": ["no such"]}),
    ("graph", {"symbols": ["down-up > no such"]}),
    ("atlas", {"energy": -5.0}),
    ("atlas", {"hits": (1, 99)}),
    ("family", {"energies": (-5.0, -4.0)}),
    ("family", {"energies": (-0.07, -0.08)}),
    ("find_bifurcations", {"source": "no such"}),
    ("find_bifurcations", {"samples": 1_000_000}),
    ("symbol_changes", {"energies": (-0.07, -0.07)}),
    ("symbol_changes", {"symbols": ["no such"]}),
    ("rotating_orbits", {"model": "triple"}),
    ("rotating_orbits", {"model": "$hill"}),
    ("shadow", {"walk": []}),
    ("shadow", {"walk": ["up-down +"]}),
    ("shadow", {"walk": ["down-up ++"]}),
    ("shadow", {"wraps": (1, 2, 3)}),
    ("shadow", {"found": []}),
    ("shadow", {"found": ["$found", "$found_other"]}),
    ("shadow", {"found": ["$found", "$found_rods"]}),
    ("shadow", {"walk": "$request", "found": "$graph_other"}),
    ("count_walks", {"source": "no such"}),
    ("list_walks", {"length": 50}),
    ("list_walks", {"length": 100_000}),
    ("list_walks", {"target": "up-down"}),
    ("random_walks", {"lengths": (3, 1)}),
    ("random_walks", {"extra_wraps": (3, 1)}),
    ("shortest_walk", {"stops": ["down-up"]}),
    ("shortest_walk", {"stops": ["down-up", "no such"]}),
    ("reference", {"walks": []}),
    ("sustained_orbit", {"orbit": "$hill_orbit"}),
    ("prove", {"rivals": "$graph_other", "found": "$walk"}),
    ("prove", {"found": "$walk"}),
    *(("plan", {"itinerary": one}) for one in ("", "outer-turnn", "/", "no/such.toml", "$garbage", "$log_file", "\0")),
    *(
        (name, {"planned": one})
        for name in ("run", "campaign", "closed_loop", "export", "polish", "explore_energies")
        for one in ("outer-turnn", "", "no/such.toml")
    ),
    *(
        (name, {"settings": one})
        for name in ("run", "campaign", "closed_loop", "export")
        for one in (
            {"mismatchh": 0.1},
            {"mismatch": "x"},
            {"mismatch": -1.0},
            {"drive.lag": 1e300},
            {"controller": "adaptiv"},
            {"controller": object()},
            {"estimator": int},
            {"": 1},
            {"lag": 1, "drive.lag": 1},
        )
    ),
    ("campaign", {"over": {"mismatch": []}}),
    ("campaign", {"over": {"mismatchh": [0.1]}}),
    ("campaign", {"over": {"mismatch": "much"}}),
    ("campaign", {"mismatch": 5.0}),
    ("campaign", {"plant": "no such"}),
    ("run", {"plant": "no such"}),
    ("run", {"mismatch": -0.1}),
    *(
        (name, {"rig": one})
        for name in ("run", "loop.run")
        for one in (object(), 3, int, "no such", "x.py:Y", "udp://x", {"a": 1})
    ),
    ("loop.run", {"program": "x"}),
    ("loop.standard_score", {"controllers": ["no such"]}),
    ("loop.standard_score", {"controllers": [None]}),
    ("loop.standard_score", {"controllers": [5]}),
    ("loop.night", {"hours": 1e300}),
    ("loop.export", {"clock": -1.0}),
    ("start_bench", {"itinerary": "outer-turnn"}),
    ("start_bench", {"settings": {"mismatchh": 0.1}}),
    ("commission", {"itinerary": "outer-turnn"}),
    ("commission", {"faults": ["encoder-9-reversed"]}),
    ("commission", {"rig": "no such"}),
    ("rig_link", {"address": "no such"}),
    ("mjcf", {"model": "$hill"}),
    ("mjcf", {"cart_mass": -1.0}),
    ("mjcf", {"lag": 0.0}),
    *(("mjcf", {"out": one}) for one in ("", "/", "x" * 5000, "\0", "a\nb")),
    ("swings", {"model": "$hill"}),
    ("swings", {"count": 1_000_000}),
    ("identify", {"model": "triple"}),
    ("identify", {"recordings": []}),
    ("identify", {"model": "$hill"}),
    ("replay", {"model": "triple"}),
    ("replay", {"model": "no such"}),
    ("design_experiments", {"model": "$hill"}),
    ("picture", {"result": "$run", "transitions": True}),
    ("picture", {"result": "$atlas", "film": "x.gif"}),
    ("draw_figures", {"names": ["no such"]}),
    ("draw_charts", {"names": ["no such"]}),
    ("read_guide", {"topic": "no such"}),
    ("read_guide", {"topic": "../README"}),
    ("compare_logs", {"logs": []}),
    ("review", {"files": []}),
    ("repeat", {"log": "$garbage"}),
    ("open_recording", {"repairs": ["no such"]}),
    ("open_recording", {"mapping": "no such"}),
    *(
        (name, {parameter: one})
        for name, parameter in (
            ("open_log", "file"),
            ("open_plan", "file"),
            ("open_atlas", "file"),
            ("open_campaign", "file"),
            ("open_night", "folder"),
            ("open_recording", "file"),
            ("check_proof", "file"),
            ("log_summary", "file"),
            ("recover_log", "file"),
            ("review", "files"),
            ("load_model", "name"),
        )
        for one in ("", "/", "no/such", "x" * 5000, "\0", "a\nb", "$garbage")
    ),
    *((name, {"file": "$log_file"}) for name in ("open_plan", "open_atlas", "open_campaign", "check_proof")),
    ("open_planner", {"model": "no such"}),
    ("open_planner", {"model": "triple"}),
    ("write_recording", {"file": "/"}),
    ("tube.cut", {"section": "no such"}),
    ("tube.cut", {"section": "$section"}),
    ("found.named", {"name": "down-upp"}),
    ("atlas.cut", {"section": "no such"}),
    ("atlas.between", {"source": "down-upp"}),
    ("atlas.turned", {"states": np.zeros(3)}),
    ("graph.between", {"target": "down-upp"}),
    ("graph.leaving", {"saddle": "down-upp"}),
    ("family.column", {"name": "periodd"}),
    ("night.course", {"name": "zero_9"}),
    ("recording.segment", {"index": 99}),
    ("system.check_same", {"other": "$hill_system"}),
    ("system.section_between", {"source": "down-upp"}),
    ("system.equilibrium", {"name": "down-upp"}),
    *(
        (f"{name}.states", {"times": one})
        for name in ("orbit", "connection", "walk", "plan", "loop", "run", "recording", "rotating")
        for one in (
            "x",
            [None],
            [float("nan")],
            1j,
            object(),
            np.array(["a"]),
            Hostile(),
            {"a": 1},
            b"1",
            [[1], [1, 2]],
        )
    ),
    *(
        (name, {parameter: one})
        for name, parameter in (
            ("system.nearest_turns", "difference"),
            ("system.scaled_distance", "first"),
            ("system.scaled_distance", "second"),
        )
        for one in ("x", None, 1j, np.zeros(3), 1.0, [[1], [1, 2]], Hostile())
    ),
]
"""Arguments of the right type that cannot be: unknown names, impossible values, results of another model or energy."""


def filled(value: Any, things: dict[str, Any]) -> Any:
    """Return a value with the results that $NAME stands for."""
    if isinstance(value, str) and value.startswith("$"):
        return things[value[1:]]
    return [filled(one, things) for one in value] if isinstance(value, list) else value


def mistakes(things: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [(name, {key: filled(value, things) for key, value in over.items()}) for name, over in MISTAKES]


def sound(function: Callable[..., Any], arguments: dict[str, Any], *, status: bool) -> None:
    """Fail if a wrong call raises no InputError with one sentence and, where allowed, has no status either."""
    try:
        found = function(**arguments)
    except dp.InputError as error:
        text = str(error)
        assert text, "an empty message"
        assert "\n" not in text, text
        assert len(text) < LONGEST, text
        assert all(hasattr(dp, name) for name in re.findall(r"\bdp\.(\w+) returns", text)), text
    except (dp.GoalMissed, PartMissing) as error:
        text = str(error)
        assert status, text
        assert "\n" not in text
    else:
        assert status, f"returned {found!r}"
        assert getattr(found, "converged", None) is False, f"returned {found!r}"


def test_every_function_and_method_has_arguments_that_suffice(things: dict[str, Any]) -> None:
    """The wrong calls differ from a right one in one argument, so they test what they are meant to test."""
    for name, (function, good) in calls(things).items():
        try:
            inspect.signature(function).bind(**good)
        except TypeError as error:
            pytest.fail(f"{name}: {error}; add it to GOOD")


def test_a_wrong_type_is_refused_in_one_sentence(things: dict[str, Any]) -> None:
    wrong = wrong_calls(things)

    @seed(36)
    @settings(
        max_examples=CALLS,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(number=st.integers(0, len(wrong) - 1))
    def each_is_refused(number: int) -> None:
        refused(things, *wrong[number])

    each_is_refused()


@pytest.mark.slow
def test_every_wrong_type_is_refused_in_one_sentence(things: dict[str, Any]) -> None:
    for wrong in wrong_calls(things):
        refused(things, *wrong)


def refused(things: dict[str, Any], name: str, parameter: str, value: Any) -> None:
    """Fail if a value of a wrong type is not refused in one sentence."""
    function, good = calls(things)[name]
    try:
        sound(function, {**good, parameter: value}, status=False)
    except AssertionError as error:
        raise AssertionError(f"{name}({parameter}={value!r:.40}): {error}") from error


@pytest.mark.parametrize("name", sorted({name for name, _ in MISTAKES}))
def test_an_impossible_value_is_refused_in_one_sentence_or_has_a_status(name: str, things: dict[str, Any]) -> None:
    function, good = calls(things)[name]
    wrong = [over for of, over in mistakes(things) if of == name]
    assert wrong
    for over in wrong:
        sound(function, {**good, **over}, status=True)
