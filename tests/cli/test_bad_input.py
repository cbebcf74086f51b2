"""Every user error gives one sentence for each mistake that names it, exit code 2, and no file: one case per kind."""

import json
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.shipped import find

LINES = {
    # Names, and files that are not there.
    "model lba": "'lab'",
    "run outer-trun": "'outer-turn'",
    "plan no/such.toml": "no/such.toml",
    "score nothing.mcap": "nothing.mcap",
    "orbit lab --saddle down-upp --energy -0.07": "down-up",
    "import swing.csv --repair gap": "gaps",
    "commission outer-turn --fault encoder-2-reversd": "encoder-2-reversed",
    # Values out of range, no numbers, or of too many digits.
    "run outer-turn --mismatch 2": "mismatch",
    "export outer-turn --clock nan --out c": "clock = nan",
    "walk lab --energy -0.07 --random 2 --lengths 1 99999999999999999999": "lengths",
    "campaign outer-turn --over mismatch=low": "low",
    # Motions that do not exist.
    "orbit lab --saddle down-up --energy -0.3": "-0.175429746884",
    # Following the family up to this energy would take minutes.
    "orbit three-body --saddle L1 --energy 0.5 --sustained": "no arms",
    # Options that are missing, lack another, or exclude one another.
    "connect lab": "Missing option '--from'",
    "bifurcations lab --from down-up --energies -0.11 -0.09": "Missing option '--to'",
    "orbit lab --saddle down-up --sustained": "need saddle and energy",
    "run": "itinerary is missing",
    "run outer-turn --rig tcp://x:1": "udp://HOST:PORT",
    "commission outer-turn --rig udp://127.0.0.1:1 --fault zeros-off": "rig = udp://127.0.0.1:1",
    "campaign outer-turn --over mismatch=0.1 --over mismatch=0.2": "twice",
    # Formats that an output cannot have.
    "plan outer-turn --out turn.txt": ".npz",
    "run outer-turn --out turn.txt": ".mcap",
}
"""Command lines, and what the message must name."""
MODEL = {
    "negative mass": ("mass           = [0.09", "mass           = [-0.09", "mass"),
    "not a number": (
        "mass           = [0.0938439747983407",
        "mass           = [true",
        "mass holds True: must be a number",
    ),
    "too many digits": ("acceleration = 9.8085802336215", "acceleration = 1" + 400 * "0", "acceleration = 1000000"),
    "nested too deeply": ('title = "', "x = " + 5000 * "[" + '\ntitle = "', "nested"),
}
"""(text, its replacement, what the message must name)."""

LONGEST = 4000  # characters of all messages: three sentences, of at most 2,000


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(*arguments: str | Path, naming: str) -> None:
    """Check that a call is refused with a message that names `naming`, without another file."""
    before = sorted(Path().rglob("*"))
    ended = dpcontrol(*arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    assert ended.message.startswith("dpcontrol: ")
    assert naming in ended.stderr
    assert "Traceback" not in ended.stderr
    assert len(ended.stderr) < LONGEST
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize("line", LINES)
def test_a_user_error_on_the_command_line_is_named(line: str) -> None:
    refused(*line.split(), naming=LINES[line])


@pytest.mark.parametrize("mistake", MODEL)
def test_a_user_error_in_a_model_is_named(mistake: str) -> None:
    text, replacement, naming = MODEL[mistake]
    shipped = find("models", "lab").read_text()
    assert text in shipped
    Path("mine.toml").write_text(shipped.replace(text, replacement))
    refused("model", "mine.toml", naming=naming)
    refused("orbit", "mine.toml", "--saddle", "down-up", "--energy", "-0.07", naming="mine.toml")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("orbit", "Missing argument 'MODEL'; see `dpcontrol orbit --help`"),
        ("orbit lab --nosuch 3", "No such option '--nosuch'; see `dpcontrol orbit --help`"),
        ("run --seed x outer-turn", "'x' is not a valid integer; see `dpcontrol run --help`"),
        ("orbt", "there is no verb 'orbt'; did you mean 'orbit'?; see `dpcontrol --help`"),
        ("model nosuch", "there is no model named 'nosuch'"),
    ],
)
def test_an_error_is_one_line_and_with_json_a_document(line: str, said: str) -> None:
    ended = dpcontrol(*line.split())
    assert (ended.code, ended.stdout) == (2, "")
    assert ended.stderr.startswith("dpcontrol: ")
    assert ended.stderr.count("\n") == 1
    assert said in ended.stderr
    document = json.loads(dpcontrol(*line.split(), "--json").stdout)
    assert document["error"] is True
    assert said in document["status"]
