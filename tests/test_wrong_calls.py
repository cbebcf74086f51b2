"""A wrong call of a public function or method is an InputError with one sentence, or the documented status."""

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_origin

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol import api
from dpcontrol.foundation.parts import PartMissing
from tests.test_objects import results_of_functions

pytestmark = pytest.mark.slow  # Each kind of result is made first.

LONGEST = 1000
"""Length of the longest sentence, which lists all itineraries."""


ANY = r"\b(object|Any|ArrayLike|buffer)\b|Array"
TEXTS = rf"{ANY}|\b(str|Path|PathLike)\b"
WRONG: list[tuple[Any, str]] = [
    (None, rf"{ANY}|None|Optional"),
    ("a\nb\x1b[2J", TEXTS),
    (Path("no/such"), TEXTS),
    (10**400, ANY),
    (float("nan"), ANY),
    (-np.float64("inf"), ANY),
    (1j, ANY),
    (b"down-up", ANY),
    ([["x"]], ANY),
    ((float("nan"), 1.0), ANY),
    ({1: 2}, ANY),
    (np.zeros((20, 20)), ANY),
    (iter([]), ANY),
]
"""Values, and a pattern of the annotations that each may fit."""
BY_NAME: dict[str, Any] = {
    **{name: f"${name}" for name in ("graph", "orbit", "recording")},
    **dict.fromkeys(("file", "files", "log", "out"), "$log_file"),
    **dict.fromkeys(("planned", "result"), "$plan"),
    **dict.fromkeys(("difference", "first", "second", "states"), np.zeros(4)),
    **dict.fromkeys(("source", "target", "saddle"), "down-up"),
    **dict.fromkeys(("model", "name"), "lab"),
    **dict.fromkeys(("count", "hit", "index", "length"), 1),
    **dict.fromkeys(("folder", "section"), "no"),
    "times": (0.0, 0.1),
    "arm": "outer",
    "energies": (-0.08, -0.07),
    "energy": -0.07,
    "found": "$search",
    "hours": 0.01,
    "itinerary": "outer-turn",
    "logs": ["no.mcap"],
    "of": "model",
    "other": "$system",
    "recordings": "$recording",
    "stops": ["down-up", "down-up"],
    "symbols": ["down-up +"],
    "walk": ["down-up +"],
    "walks": "$walk",
}
"""Values of required arguments by name; $NAME stands for a result."""
GOOD: dict[str, dict[str, Any]] = {
    "connections": {"source": "$orbit"},
    "flight": {"model": "lab", "state": np.zeros(4), "target": "up-up"},
    "lab.force": {"state": np.zeros(4), "acceleration": 1.0, "cart_mass": 1.0},
    "prove": {"found": "$orbit"},
    "prove_graph": {"model": "lab", "energy": -0.07},
    "prove_statement": {"statement": "orbit", "saddle": "down-up", "energy": -0.07},
    "refine": {"found": "$connection"},
    "rotating_families": {"energies": (0.29, 0.31)},
    "rotating_orbits": {"energy": 0.3},
}
"""Values of functions for which those by name do not suffice."""
UNCHECKED = ("unit", "placed", "from_hamiltonian", "from_lagrangian")
"""Methods that render texts of pages, and those that check their arguments themselves; see tests/systems."""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Results to call and to pass."""
    folder, results = tmp_path_factory.mktemp("wrong"), results_of_functions()
    garbage = folder / "garbage"
    garbage.write_bytes(bytes(range(256)))
    search, lab, hill = results["search"], dp.load_model("lab"), dp.load_model("three-body")
    rods = dp.orbit("point-mass", "down-up", energy=-0.06)
    return results | {
        "lab": lab,
        "system": lab.system,
        "other": dp.orbit(lab, "down-up", energy=-0.06),
        "hill": hill,
        "hill_system": hill.system,
        "hill_orbit": dp.orbit(hill, "L1", energy=-1.519),
        "log_file": results["loop"].run(seed=3, log=folder / "run.mcap").log.path,
        "garbage": garbage,
        "rods": rods,
        "search_rods": replace(search, source=rods, target=rods),
        "request": dp.random_walks(results["graph"], 1)[0],
        "graph_other": replace(results["graph"], energy=-0.06),
    }


Calls = dict[str, tuple[Callable[..., Any], dict[str, Any]]]


def filled(value: Any, things: dict[str, Any]) -> Any:
    """Return a value with the results that $NAME stands for."""
    if isinstance(value, str) and value.startswith("$"):
        return things[value[1:]]
    return [filled(one, things) for one in value] if isinstance(value, list) else value


@pytest.fixture(scope="module")
def calls(things: dict[str, Any]) -> Calls:
    """The public functions and the methods of results, with arguments that suffice."""
    functions = {name: getattr(dp, name) for name in dp.__all__ if inspect.isfunction(getattr(dp, name))}
    for kind, name in {type(thing): name for name, thing in reversed(things.items())}.items():
        for method, _ in inspect.getmembers(kind, inspect.isfunction) if kind.__module__.startswith("dpc") else ():
            if not method.startswith("_") and method not in UNCHECKED:
                functions[f"{name}.{method}"] = getattr(things[name], method)
    found = {}
    for name, function in functions.items():
        required = [key for key, p in inspect.signature(function).parameters.items() if p.default is p.empty]
        good = {key: BY_NAME.get(key) for key in required if key in BY_NAME} | GOOD.get(name, {})
        found[name] = function, {key: filled(value, things) for key, value in good.items()}
    return found


def written(annotation: Any) -> str:
    """Return an annotation as text, with the aliases of the public functions written out."""
    aliases = {name: str(kind) for name, kind in vars(api).items() if get_origin(kind) is not None}
    return re.sub(r"\w+", lambda word: aliases.get(word[0], word[0]), str(annotation))


def wrong_calls(calls: Calls) -> list[tuple[str, str, Any]]:
    """Return (function, parameter, value) for each value that a parameter cannot be."""
    return [
        (name, key, value)
        for name, (function, _) in calls.items()
        for key, parameter in inspect.signature(function).parameters.items()
        for value, fits in WRONG
        if not re.search(fits, written(parameter.annotation))
        # The former sample(times) still works, with a warning.
        and not (name.endswith(".sample") and isinstance(value, (list, tuple, np.ndarray)))
    ]


OPENED = [name for name in dp.__all__ if name.startswith("open_") and name != "open_planner"]
OPENED += ["check_proof", "log_summary", "recover_log", "review", "load_model", "plan", "run"]
"""Functions whose first argument names a file."""
NAMES = ("", "/", "no/such", "$garbage")
MISTAKES: list[tuple[str, dict[str, Any]]] = [
    *((name, {next(iter(inspect.signature(getattr(dp, name)).parameters)): x}) for name in OPENED for x in NAMES),
    *(("orbit", {"saddle": one}) for one in ("down-upp", "down-down", "a\nb")),
    ("orbit", {"model": "$hill"}),
    ("orbit", {"energy": -5.0}),
    ("connections", {"target": "$other"}),
    ("connections", {"target": "$rods"}),
    ("connections", {"section": "no such"}),
    ("graph", {"symbols": ["down-up > no such"]}),
    ("atlas", {"hits": (1, 99)}),
    ("family", {"energies": (-0.07, -0.08)}),
    ("find_bifurcations", {"samples": 1_000_000}),
    ("rotating_orbits", {"model": "triple"}),
    ("shadow", {"walk": []}),
    ("shadow", {"wraps": (1, 2, 3)}),
    ("shadow", {"found": ["$search", "$search_rods"]}),
    ("shadow", {"walk": "$request", "found": "$graph_other"}),
    ("list_walks", {"length": 100_000}),
    ("random_walks", {"lengths": (3, 1)}),
    ("shortest_walk", {"stops": ["down-up"]}),
    ("reference", {"walks": []}),
    ("sustained_orbit", {"orbit": "$hill_orbit"}),
    *(
        ("run", {"settings": one})
        for one in (
            {"mismatchh": 0.1},
            {"mismatch": "x"},
            {"mismatch": -1.0},
            {"drive.lag": 1e300},
            {"controller": object()},
            {"lag": 1, "drive.lag": 1},
        )
    ),
    *(("run", {"rig": one}) for one in (object(), int, "x.py:Y", "udp://x")),
    ("campaign", {"over": {"mismatch": []}}),
    ("campaign", {"over": {"mismatchh": [0.1]}}),
    ("loop.campaign", {"standard": True, "over": {"controller": ["no such"]}}),
    ("loop.night", {"hours": 1e300}),
    ("commission", {"faults": ["encoder-9-reversed"]}),
    ("rig_link", {"address": "no such"}),
    ("mjcf", {"model": "$hill"}),
    ("mjcf", {"out": "\0"}),
    ("swings", {"count": 1_000_000}),
    ("identify", {"model": "triple"}),
    ("replay", {"model": "triple"}),
    ("picture", {"result": "$atlas", "film": "x.gif"}),
    ("draw_figures", {"names": ["no such"]}),
    ("read_guide", {"topic": "../README"}),
    ("compare_logs", {"logs": []}),
    *(("learn", {"logs": one}) for one in ([], "$garbage", "no such")),
    ("open_recording", {"mapping": "no such"}),
    ("tube.cut", {"section": "no such"}),
    ("atlas.turned", {"states": np.zeros(3)}),
    ("night.course", {"name": "zero_9"}),
    ("recording.segment", {"index": 99}),
    ("system.check_same", {"other": "$hill_system"}),
    ("system.scaled_distance", {"first": np.zeros(3)}),
    *(("orbit.states", {"times": one}) for one in ("x", [float("nan")], [[1], [1, 2]])),
]
"""Arguments of the right type that cannot be: unknown names, impossible values, results of another model or energy."""


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


def refused(calls: Calls, name: str, parameter: str, value: Any) -> None:
    """Fail if a value of a wrong type is not refused in one sentence."""
    function, good = calls[name]
    try:
        sound(function, {**good, parameter: value}, status=False)
    except AssertionError as error:
        raise AssertionError(f"{name}({parameter}={value!r:.40}): {error}") from error


def test_every_function_and_method_has_arguments_that_suffice(calls: Calls) -> None:
    """The wrong calls differ from a right one in one argument, so they test what they are meant to test."""
    for name, (function, good) in calls.items():
        try:
            inspect.signature(function).bind(**good)
        except TypeError as error:
            pytest.fail(f"{name}: {error}; add it to BY_NAME or GOOD")


def test_a_wrong_type_is_refused_in_one_sentence(calls: Calls) -> None:
    for call in wrong_calls(calls):
        refused(calls, *call)


@pytest.mark.parametrize("name", sorted({name for name, _ in MISTAKES}))
def test_an_impossible_value_is_refused_in_one_sentence_or_has_a_status(
    name: str, calls: Calls, things: dict[str, Any]
) -> None:
    function, good = calls[name]
    for wrong in (over for of, over in MISTAKES if of == name):
        sound(function, good | {key: filled(value, things) for key, value in wrong.items()}, status=True)
