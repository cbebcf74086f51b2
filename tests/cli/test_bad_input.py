"""Every user error gives one sentence with a remedy, exit code 2, and no file."""

import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol, dpcontrol_program
from mcap.writer import Writer

from dpcontrol.logs import LogWriter, control_fields

REPLACED = {
    "unknown key": ("itinerary", "energy =", "enrgy =", "enrgy"),
    "unknown table key": ("itinerary", "tolerance = 1e-6", "tolerence = 1e-6", "tolerance"),
    "wrong type": ("itinerary", "lead_in  = 2", "lead_in = 'two'", "lead_in"),
    "broken TOML": ("itinerary", "[limits]", "[limits", "scene.toml"),
    "unknown model": ("itinerary", '"lab"', '"lap"', "'lab'"),
    "a number of too many digits": (
        "model",
        "acceleration = 9.8085802336215",
        "acceleration = 1" + 400 * "0",
        "acceleration = inf: must be positive",
    ),
    "nested too deeply": ("model", 'title = "', "x = " + 5000 * "[" + '\ntitle = "', "nested"),
    "nested too deeply by dots": ("model", 'title = "', "x." * 3000 + 'y = 1\ntitle = "', "nested"),
    "nested too deeply by tables": (
        "model",
        'title = "',
        "x = " + 300 * "{a = " + "1" + 300 * "}" + '\ntitle = "',
        "nested",
    ),
    "a mass beyond any bench": (
        "model",
        "mass           = [0.0938439747983407",
        "mass           = [1e300",
        "at most 1e+06",
    ),
    "energy below the saddle's": ("itinerary", "energy = -0.07", "energy = -0.2", "-0.175429747"),
    "walk not connected": ("itinerary", '["down-up +"]', '["down-up +", "up-down +"]', "not connected"),
    "unknown saddle": ("itinerary", '["down-up +"]', '["up-sideways +"]', "up-sideways"),
    "no sense": ("itinerary", '["down-up +"]', '["down-up"]', "down-up +"),
    "wraps missing": ("itinerary", '["down-up +"]', '["down-up +", "down-up +"]', "wraps"),
    "impossible limit": ("itinerary", "acceleration = 30.0", "acceleration = -1.0", "acceleration"),
    "unknown controller": ("itinerary", 'kind = "adaptive"', 'kind = "adaptve"', "adaptive"),
    "negative mass": ("model", "mass           = [0.09", "mass           = [-0.09", "mass"),
    "missing table": ("model", "[gravity]", "[gravitation]", "gravity"),
    "arms of unequal count": ("model", "viscous = [0.000237142782693581, ", "viscous = [", "viscous"),
}
"""(kind of file, text, its replacement, what the message must name)."""

LONGEST = 4000  # characters of all messages: three sentences, of at most 2,000
PROGRESS = re.compile(r"\d+% +\d+:\d\d:\d\d *$")
"""How a line of the progress bar ends where stderr is no terminal."""


def refused(*arguments: str | Path, naming: str) -> None:
    """Check that a call is refused, in one sentence for each mistake, the first of which names `naming`."""
    ended = dpcontrol(*arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    said = [line for line in ended.stderr.splitlines() if line.strip() and not PROGRESS.search(line)]
    assert said
    assert all(line.startswith("dpcontrol: ") for line in said)
    assert naming in "\n".join(said)
    assert "Traceback" not in ended.stderr


def files(folder: Path) -> set[str]:
    """Return all that is in a folder, folders too: an empty one left behind is litter as well."""
    return {str(file.relative_to(folder)) for file in folder.rglob("*")}


def with_value(text: str, key: str, value: str | None) -> str:
    """Return TOML text with one key's value replaced, or the key left out; `table.key` where the key stands twice."""
    table, _, name = key.rpartition(".")
    before, heading, rest = text.partition(f"[{table}]") if table else ("", "", text)
    line = "" if value is None else f"{name} = {value}\n"
    changed, count = re.subn(rf"(?m)^{name}\s*=.*\n", lambda _: line, rest, count=1)
    assert count == 1
    return before + heading + changed


@pytest.mark.parametrize("mistake", REPLACED)
def test_a_user_error_in_a_file_is_named(
    mistake: str, tmp_path: Path, shipped_text: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    kind, text, replacement, naming = REPLACED[mistake]
    original = shipped_text["outer-turn" if kind == "itinerary" else "lab"]
    assert text in original
    Path("scene.toml").write_text(original.replace(text, replacement))
    for arguments in (("run", "scene.toml"), ("plan", "scene.toml")) if kind == "itinerary" else (
        ("model", "scene.toml"),
        ("orbit", "scene.toml", "--saddle", "down-up", "--energy", "-0.07"),
    ):  # fmt: skip
        refused(*arguments, naming=naming)
        refused(*arguments, naming="scene.toml")
    assert files(tmp_path) == {"scene.toml"}


@pytest.mark.parametrize(
    ("line", "naming"),
    [
        ("model lba", "'lab'"),
        ("run outer-trun", "'outer-turn'"),
        ("plan no/such.toml", "no/such.toml"),
        ("orbit lab --saddle down-up --energy -0.3", "-0.175429746884"),
        ("orbit lab --saddle down-up --energy nan", "nan"),
        ("orbit lab --saddle down-upp --energy -0.07", "down-up"),
        ("orbit lab --saddle up-up --energy 0.6", "index-2"),
        ("connect lab --from down-up --to up-down --energy 0.1", "up-down"),
        ("run outer-turn --mismatch 2", "mismatch"),
        ("run outer-turn --initial-error -0.1", "initial_error"),
        ("run outer-turn --seed -1", "seed"),
        ("run outer-turn --controller tvlqg", "tvlqr"),
        ("plan outer-turn --out turn.txt", ".npz"),
        ("score nothing.mcap", "nothing.mcap"),
        ("review nothing.mcap --picture x.png", "nothing.mcap"),
        ("score .", "cannot read ."),
        ("model models/lab", "there is no file models/lab"),
        ("orbit lab --saddle down-up --energy inf", "energy = inf"),
        ("orbit lab --saddle down-down --energy 0", "down-down"),
        ("orbit lab --saddle down-up --energy -0.07 --family 1", "family = 1"),
        ("connect lab --from down-up --to up-up --energy 0.6", "index-2"),
        ("connect lab --from dwn-up --to down-up --energy 0.2", "down-up"),
        ("connect lab --from down-up --to down-up --energy nan", "nan"),
        ("run outer-turn --mismatch nan", "mismatch = nan"),
        ("run outer-turn --initial-error 4", "initial_error = 4.0"),
        ("plan crss", "'cross'"),
        ("demo --itinerary outer-trn", "'outer-turn'"),
        ("demo --seed -1", "seed = -1"),
        ("export outer-turn --clock nan --out c", "--clock = nan"),
        ("connect lab --from down-up --to down-up --energy -0.07 --seconds nan", "--seconds = nan"),
    ],
)
def test_a_user_error_on_the_command_line_is_named(
    line: str, naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(*line.split(), naming=naming)
    assert files(tmp_path) == set()


@pytest.mark.parametrize("key", ["a" * 10**6, "'" + "b " * 500_000 + "'"], ids=["a word", "words"])
def test_a_key_of_a_megabyte_is_not_repeated_whole(key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("long.toml").write_text(f"{key} = 1\n")
    refused("run", "long.toml", naming="long.toml: at the top level, the key")
    assert len(dpcontrol("run", "long.toml").stderr) < LONGEST


@pytest.fixture(scope="module")
def whole_log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A log of a run, made once: every case harms its own copy."""
    path = tmp_path_factory.mktemp("run") / "whole.mcap"
    assert dpcontrol("run", "outer-turn", "--out", path).code == 0
    return path.read_bytes()


@pytest.mark.parametrize("harm", ["truncated", "corrupt", "not a log"])
def test_a_damaged_log_is_rejected_by_score_and_review(
    harm: str, whole_log: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data = whole_log
    Path("whole.mcap").write_bytes(data)
    middle = len(data) // 2
    Path("bad.mcap").write_bytes(
        {
            "truncated": data[:middle],
            "corrupt": data[:middle] + bytes(b ^ 0xFF for b in data[middle : middle + 16]) + data[middle + 16 :],
            "not a log": b"angle,rate\n0.0,0.0\n" * 100,
        }[harm]
    )
    refused("score", "bad.mcap", naming="bad.mcap")
    refused("score", "whole.mcap", "bad.mcap", naming="bad.mcap")
    refused("review", "bad.mcap", "--picture", "bad.png", "--save", "bad.rrd", naming="bad.mcap")
    assert files(tmp_path) == {"whole.mcap", "bad.mcap"}


@pytest.mark.parametrize(
    ("key", "value", "naming"),
    [
        ("mass", None, "[arms] the key 'mass' is missing"),
        ("mass", "[0.1]", "give one for each arm"),
        ("mass", "[]", "at least one arm"),
        ("mass", "0.1", "must be a list of numbers"),
        ("mass", "[true, 0.1]", "mass holds True: must be a list of numbers"),
        ("mass", "['0.1', 0.1]", "must be a list of numbers"),
        ("mass", "[0.0, 0.1]", "mass = 0.0: must be positive"),
        ("mass", "[nan, 0.1]", "mass = nan"),
        ("mass", "[inf, 0.1]", "mass = inf"),
        ("centre_of_mass", "[0, 0]", "positive"),
        ("centre_of_mass", "{a = 1}", "must be a list of numbers"),
        ("length", "[0.1, 0.1, 0.1]", "length has 3 values but mass has 2"),
        ("length", "1979-05-27", "must be a list of numbers"),
        ("inertia", "[-1e-4, 1e-4]", "must be 0 to 1e+09 kg m²"),
        ("gravity.acceleration", "0", "acceleration = 0.0"),
        ("gravity.acceleration", "-9.8", "acceleration = -9.8"),
        ("gravity.acceleration", "'9.8'", "acceleration = '9.8': must be a number"),
        ("gravity.acceleration", "[9.8]", "must be a number"),
        ("viscous", None, "[friction] the key 'viscous' is missing"),
        ("viscous", "[-1e-4, 0]", "must be 0 to 1e+06 N m s/rad"),
        ("viscous", "[0, 0, 0]", "viscous has 3 values but mass has 2"),
        ("title", "3", "title = 3: must be text in quotes"),
        ("title", None, "'title' is missing"),
        ("system", "'arm-chian'", "did you mean 'arm-chain'?"),
        ("friction.source", None, "[friction] the key 'source' is missing"),
    ],
)
def test_a_wrong_value_in_a_model_is_named(
    key: str,
    value: str | None,
    naming: str,
    tmp_path: Path,
    shipped_text: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(with_value(shipped_text["lab"], key, value))
    refused("model", "mine.toml", naming="mine.toml: ")
    refused("model", "mine.toml", naming=naming)
    assert files(tmp_path) == {"mine.toml"}


def test_a_misspelt_key_is_named_if_its_absence_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text('energy = 0.2\nwalk = ["down-up +", "down-up -"]\nwrapps = [1]\n')
    refused("plan", "mine.toml", naming="the key 'wrapps' is unknown: did you mean 'wraps'?")
    assert files(tmp_path) == {"mine.toml"}


@pytest.mark.parametrize(
    ("key", "value", "naming"),
    [
        ("energy", None, "'energy' is missing"),
        ("energy", "'low'", "energy = 'low': must be a number"),
        ("energy", "true", "energy = True: must be a number"),
        ("energy", "nan", "finite"),
        ("walk", "[]", "at least one symbol"),
        ("walk", "'down-up +'", "must be a list of texts in quotes"),
        ("walk", "[3]", "texts in quotes"),
        ("walk", "['']", "is not a symbol"),
        ("walk", "['down-up ++']", "is not a symbol"),
        ("walk", "['down-up > down-up']", "has no direction of rotation"),
        ("walk", "['up-up +']", "'up-up' has no tubes"),
        ("walk", "['up-down +']", "up-down has Lyapunov orbits only above"),
        ("walk", "['down-up +', 'up-down -']", "symbol 2 ('up-down -') starts at up-down"),
        ("wraps", "[2]", "1 symbol has 0 interior stops"),
        ("wraps", "[-1]", "wraps = -1: must be zero or positive"),
        ("wraps", "[1.5]", "wraps holds 1.5: must be a list of whole numbers"),
        ("wraps", "[true]", "wraps holds True: must be a list of whole numbers"),
        ("wraps", "1", "must be a list of whole numbers"),
        ("lead_in", "-1", "lead_in = -1: must be zero or positive"),
        ("lead_out", "2.0", "lead_out = 2.0: must be a whole number"),
        ("start", "'nowhere'", "start = 'nowhere'"),
        ("limits.position", "0", "position = 0.0: must be 1e-06 to 1e+06 m"),
        ("limits.velocity", "inf", "velocity = inf: must be 1e-06 to 1e+06 m/s"),
        ("limits.acceleration", "[30]", "acceleration = [30]: must be a number"),
        ("level", "'card'", "level = 'card'"),
        ("method", "'hermite-simson'", "radau-2 to radau-12"),
        ("method", "'radau-13'", "2 to 12 points"),
        ("interval", "0", "interval = 0.0: must be 0.001 to 10"),
        ("tolerance", "-1e-6", "tolerance = -1e-06: must be 1e-20 to 1"),
        ("controller.kind", "'tvlqrr'", "did you mean 'tvlqr'?"),
        ("estimator.kind", "'efk'", "did you mean 'ekf'?"),
        ("rate", "1e6", "rate = 1000000.0: must be 1 to 10000 Hz"),
        ("delay", "5000", "delay = 5000.0: must be 0 to 1000 periods"),
        ("delay", "true", "delay = True: must be a number"),
        ("mismatch", "1.0", "mismatch = 1.0: must be 0 to 0.9"),
        ("initial_error", "nan", "initial_error = nan"),
        ("counts", "-1", "counts = -1: must be at least 1, or 0 for no rounding"),
        ("counts", "0.5", "counts = 0.5: must be a whole number"),
        ("cart_resolution", "-1", "cart_resolution = -1.0: must be 1e-12 to 1 m, or 0 for no rounding"),
    ],
)
def test_a_wrong_value_in_an_itinerary_is_named(
    key: str,
    value: str | None,
    naming: str,
    tmp_path: Path,
    shipped_text: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    Path("mine.toml").write_text(with_value(shipped_text["outer-turn"], key, value))
    refused("plan", "mine.toml", naming="mine.toml: ")
    refused("plan", "mine.toml", naming=naming)
    assert files(tmp_path) == {"mine.toml"}


@pytest.mark.parametrize("verb", ["model", "plan"])
@pytest.mark.parametrize(
    ("content", "naming"),
    [
        (b"", "is missing"),
        (b"Dear rig,", "not valid TOML"),
        (b"\0" * 100, "not valid TOML"),
        (b"\x89PNG\r\n\xff\xfe", "not a text file"),
        ("title = 'é'\n".encode("latin-1"), "not a text file"),
        (None, "it is a folder; give a regular file"),
    ],
    ids=["empty", "prose", "zeros", "picture", "Latin-1", "folder"],
)
def test_a_file_that_is_not_a_table_is_rejected(
    verb: str, content: bytes | None, naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is None:
        Path("mine.toml").mkdir()
    else:
        Path("mine.toml").write_bytes(content)
    refused(verb, "mine.toml", naming="mine.toml")
    refused(verb, "mine.toml", naming=naming)
    assert files(tmp_path) == {"mine.toml"}


def foreign_log() -> bytes:
    """Return another program's MCAP file, whole and with checksums."""
    stream = BytesIO()
    writer = Writer(stream, enable_data_crcs=True)
    writer.start("", "another program")
    channel = writer.register_channel("/odometry", "json", writer.register_schema("pose", "jsonschema", b"{}"))
    writer.add_message(channel, 0, b"{}", 0)
    writer.finish()
    return stream.getvalue()


def log_carrying(attachments: dict[str, bytes]) -> bytes:
    """Return a whole log of ten ticks at rest, carrying `attachments`."""
    path = Path("made.mcap")
    rest = np.zeros((1, 6))
    with LogWriter(path, arm_lengths=(0.2, 0.2), rate_hz=1000.0, attachments=attachments, metadata={}) as log:
        for k in range(10):
            log.ticks(
                [k / 1000.0],
                measured=np.zeros((1, 3)),
                estimate=rest,
                reference=rest,
                truth=rest,
                control=np.zeros((1, len(control_fields(2, has_cart=True)))),
            )
    data = path.read_bytes()
    path.unlink()
    return data


FOREIGN: dict[str, tuple[Callable[[], bytes], str]] = {
    "empty": (lambda: b"", "is empty"),
    "random bytes": (lambda: np.random.default_rng(5).bytes(4096), "is not an MCAP file"),
    "only the first bytes": (lambda: foreign_log()[:8], "is cut off"),
    "another program's": (foreign_log, "it lacks the metadata record dpcontrol.layout"),
    "damaged reference": (
        lambda: log_carrying({"reference.npz": b"PK\x03\x04" + bytes(100)}),
        "reference.npz is damaged",
    ),
    # An archive could be an atlas: `score` reports that it is not an MCAP file, `review` that it is not an atlas.
    "another archive": (lambda: b"PK\x03\x04" + bytes(100), "is not an"),
}
"""(how a file is made that is no log of a run, what the message must say)."""


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_file_that_is_not_the_log_of_a_run_is_rejected(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made, naming = FOREIGN[kind]
    Path("bad.mcap").write_bytes(made())
    for arguments in (("score", "bad.mcap"), ("review", "bad.mcap", "--save", "bad.rrd", "--picture", "bad.png")):
        refused(*arguments, naming="bad.mcap")
        refused(*arguments, naming=naming)
    assert files(tmp_path) == {"bad.mcap"}


def test_a_log_without_its_reference_can_be_looked_at_but_not_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bare.mcap").write_bytes(log_carrying({}))
    refused("score", "bare.mcap", naming="bare.mcap carries no reference.npz")
    assert dpcontrol("review", "bare.mcap", "--save", "bare.rrd").code == 0
    assert files(tmp_path) == {"bare.mcap", "bare.rrd"}


def test_json_reports_user_errors_too(tmp_path: Path) -> None:
    ended = dpcontrol("model", "lba", "--json")
    assert ended.code == 2
    assert ended.document["error"] is True
    assert "'lab'" in ended.document["status"]


@pytest.mark.parametrize("line", ["orbit lab", "frobnicate", "model lab --colour", "orbit lab --saddle x --energy ten"])
def test_a_wrong_call_ends_with_2_and_points_to_help(line: str, tmp_path: Path) -> None:
    ended = dpcontrol_program(*line.split(), folder=tmp_path)
    assert ended.code == 2
    assert ended.stdout == ""
    assert "--help" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("verb", ["model", "plan"])
def test_a_file_that_is_there_and_no_toml_is_not_denied(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "poles.xml").write_text("<mujoco/>")
    refused(verb, "poles.xml", naming="poles.xml is not valid TOML")
