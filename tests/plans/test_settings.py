"""Settings are declared once: files, logs, options, paths, tables and schema agree with the declaration."""

import json
import tomllib
from dataclasses import replace
from typing import Any

import pytest
from command_line import dpcontrol
from jsonschema import Draft202012Validator
from settings_page import PAGE, settings_page

import dpcontrol as dp
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.shipped import folders
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.plans.itinerary import itinerary_from, load_itinerary, setting_of
from dpcontrol.plans.model import load_model
from dpcontrol.plans.overrides import NAMED, parsed, paths, typed

TURN = """
model = "lab"
energy = -0.07
walk = ["down-up +"]
"""
LAB = folders("models")[1].joinpath("lab.toml").read_text()


@pytest.mark.slow
def test_the_guides_page_on_settings_is_the_one_that_the_declarations_give() -> None:
    assert PAGE.read_text() == settings_page()
    assert all(f"`{path}`" in settings_page() for path in paths())


@pytest.mark.parametrize(("of", "folder"), [("itinerary", "itineraries"), ("model", "models")])
def test_the_schema_is_valid_accepts_every_shipped_file_and_rejects_mistakes(of: Any, folder: str) -> None:
    schema = dp.schema(of)
    Draft202012Validator.check_schema(schema)
    assert "Attributes:" not in json.dumps(schema)
    assert json.loads(json.dumps(schema, allow_nan=False)) == dpcontrol("schema", of, "--json").document
    valid = Draft202012Validator(schema).is_valid
    for file in folders(folder)[1].glob("*.toml"):
        document = tomllib.loads(file.read_text())
        assert valid(document), file.name
        assert not valid({**document, "tittle": "x"}), file.name
    if of == "itinerary":
        turn = tomllib.loads(TURN)
        assert valid({**turn, "run": {"lag": 0.01, "play": [0.1, 0.2], "belt": 0}})
        for run in ({"lag": 2}, {"lag": "x"}, {"belt": 0.5}, {"counts": 1.5}):
            assert not valid({**turn, "run": run}), run
        assert valid({**turn, "controller": {"kind": "lqr", "damping": 0.1}})
        assert not valid({**turn, "controller": {"kind": "tvlqr", "damping": 0.1}})
        assert not valid({key: value for key, value in turn.items() if key != "energy"})
        assert not valid({**turn, "hold": "up-up"})
    else:
        arms = tomllib.loads(LAB)
        assert not valid({**arms, "gravity": {**arms["gravity"], "acceleration": -9.81}})
        assert not valid({**arms, "arms": {**arms["arms"], "mass": [0.1, -0.1]}})


def value_of(path: str) -> Any:
    """Return a value of a setting that differs from its default."""
    leaf = paths()[path]
    others = [choice for choice in leaf.bounds.choices if choice != leaf.default]
    if path == "start":
        return (0.1, 0.2, 3.0, 4.0, 0.0, 0.0)
    if path == "sensors.jitter":
        # At most a period.
        return 0.0005
    if isinstance(leaf.default, bool):
        return (True, False)
    if isinstance(leaf.default, tuple):
        return ("zeros",) if leaf.default else (0.5, 0.25)
    if others:
        return others[0]
    low = max(leaf.bounds.least, leaf.bounds.above, -1.0)
    high = min(leaf.bounds.most, low + 50)
    return int(low + 1) if "int" in str(leaf.hint) else low + 0.25 * (high - low)


APART = ("plant", "seconds", "controller", "model_uncertainty")
NOT_ALONE = "drive.failure"  # needs the time of the fault


@pytest.mark.parametrize(
    "path", [path for path in paths() if path != NOT_ALONE and path.partition(".")[0] not in APART]
)
def test_a_setting_by_path_is_that_of_a_file_and_is_typed_and_parsed_back(path: str) -> None:
    value = value_of(path)
    scene = itinerary_from(f'{TURN}[controller]\nkind = "tvlqr"\n', "turn", load_model("lab"))
    if path.startswith("estimator."):
        scene = scene.with_run({"estimator": "ukf"})
    loop = scene.with_run({path: value}).loop
    assert setting_of(loop, path) == value != setting_of(scene.loop, path)
    word = typed({path: value}).split()
    text = word[1] if path in NAMED else word[1].partition("=")[2]
    assert parsed(path, text) == value
    part, _, key = path.rpartition(".")
    table = part if part in ("estimator", "supervisor") else "run"
    kind = 'kind = "ukf"\n' if table == "estimator" else ""
    if path == "estimator":
        key, kind = "kind", ""
        table = "estimator"
    shown = list(value) if isinstance(value, tuple) else value
    text = f'{TURN}[controller]\nkind = "tvlqr"\n[{table}]\n{kind}{key} = {json.dumps(shown)}\n'
    assert itinerary_from(text, "turn", load_model("lab")).loop == loop


def test_settings_are_replaced_by_path() -> None:
    loop = LoopSettings(seed=0)
    changed = loop.with_({"rate": 500.0, "drive.lag": 0.002, "drive.delay": 2.0})
    assert changed == replace(loop, rate=500.0, drive=replace(loop.drive, lag=0.002, delay=2.0))
    with pytest.raises(InputError, match=r"drive\.lagg: drive has no such setting; it has delay, lag, "):
        loop.with_({"drive.lagg": 0.002})
    with pytest.raises(InputError, match=r"dirve: .* has no such setting"):
        loop.with_({"dirve.lag": 0.002})
    with pytest.raises(InputError, match=r"lag = -1\.0: must be 0 to 1 s\n.*counts = 0\.5: must be a whole number"):
        load_itinerary("outer-turn").with_run({"lag": -1, "counts": 0.5})


MISTAKES: list[tuple[str, str, str]] = [
    (
        "parts without an s",
        '[[part]]\nhold = "up-up"\n',
        "at the top level, the key 'part' is unknown: did you mean 'parts'?",
    ),
    ("unknown key", f"{TURN}[run]\nlagg = 0.1\n", "[run] the key 'lagg' is unknown: did you mean 'lag'?"),
    (
        "misspelt required key",
        'walk = ["down-up +"]\nenergie = -0.07',
        "the key 'energie' is unknown: did you mean 'energy'?",
    ),
    ("text for number", f"{TURN}[run]\nlag = 'x'\n", "[run] lag = 'x': must be a number"),
    ("fraction for whole number", f"{TURN}[run]\ncounts = 1.5\n", "[run] counts = 1.5: must be a whole number"),
    ("below the range", f"{TURN}[run]\nlag = -1\n", "[run] lag = -1.0: must be 0 to 1 s"),
    ("wrong choice", f"{TURN}[reference]\nsolver = 'ipot'\n", "[reference] solver = 'ipot': did you mean 'ipopt'?"),
    ("another kind's key", f"{TURN}[controller]\nkind = 'lqr'\ntrust = 1\n", "[controller] the key 'trust' is unknown"),
    ("table within [run]", f"{TURN}[run.sensors]\ncounts = 3\n", "[run] the key 'sensors' is unknown"),
    ("text in a list", f"{TURN}[run]\nplay = [0.1, 'x']\n", "[run] play holds 'x': must be"),
    ("value for a table", f"run = 3\n{TURN}", "run = 3: must be a table, [run]"),
    ("repeated walk that ends elsewhere", 'repeat = 2\nenergy = 0.2\nwalk = ["down-up > up-down"]\n', "repeat = 2"),
    ("empty list of parts", "parts = []\n", "parts = []: must be tables, each under [[parts]]"),
    ("text for blows", f"{TURN}[run]\nblows = 'x'\n", "run.blows = 'x': must be tables, each under [[run.blows]]"),
    ("number for a choice", f"{TURN}[supervisor]\nhold = 3\n", "[supervisor] hold = 3: allowed: none, nearest"),
    ("hold beside a walk", f'{TURN}hold = "up-up"\n', "hold"),
    ("rest without a cart", f'{TURN}start = "rest"\n[reference]\nlevel = "conservative"\n', "conservative"),
    ("impossible walk", 'energy = -0.07\nwalk = ["down-up ?"]\n', "walk: "),
    ("energy below the saddle", 'energy = -9\nwalk = ["down-up +"]\n', "energy = -9.0 J: down-up has Lyapunov orbits"),
    ("error of a blow", f"{TURN}[[run.blows]]\ntime = -1\n", "[[run.blows]] 1, time = -1.0: must be at least 0 s"),
]


@pytest.mark.parametrize(("what", "text", "told"), MISTAKES, ids=[one[0] for one in MISTAKES])
def test_each_kind_of_mistake_is_named(what: str, text: str, told: str) -> None:
    with pytest.raises(InputError) as refused:
        itinerary_from(text, "scene", load_model("lab"))
    (sentence,) = map(str, refused.value.errors)
    assert told in sentence
