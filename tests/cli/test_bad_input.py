"""Every mistake of the user is one sentence that says what to do, exit code 2, and no file."""

from pathlib import Path

import pytest
from command_line import dpcontrol, dpcontrol_program

REPLACED = {
    "unknown key": ("itinerary", "energy =", "enrgy =", "enrgy"),
    "unknown table key": ("itinerary", "tolerance = 1e-6", "tolerence = 1e-6", "tolerance"),
    "wrong type": ("itinerary", "lead_in  = 2", "lead_in = 'two'", "lead_in"),
    "broken TOML": ("itinerary", "[limits]", "[limits", "scene.toml"),
    "unknown model": ("itinerary", '"lab"', '"lap"', "'lab'"),
    "energy below the saddle's": ("itinerary", "energy = -0.07", "energy = -0.2", "-0.17543"),
    "walk not connected": ("itinerary", '["down-up +"]', '["down-up +", "up-down +"]', "not connected"),
    "unknown saddle": ("itinerary", '["down-up +"]', '["up-sideways +"]', "up-sideways"),
    "no sense": ("itinerary", '["down-up +"]', '["down-up"]', "down-up +"),
    "wraps missing": ("itinerary", '["down-up +"]', '["down-up +", "down-up +"]', "wraps"),
    "impossible limit": ("itinerary", "acceleration = 30.0", "acceleration = -1.0", "acceleration"),
    "unknown controller": ("itinerary", '"tvlqr"', '"tvlqg"', "tvlqr"),
    "negative mass": ("model", "mass           = [0.09", "mass           = [-0.09", "mass"),
    "missing table": ("model", "[gravity]", "[gravitation]", "gravity"),
    "arms of unequal count": ("model", "viscous = [0.000237142782693581, ", "viscous = [", "viscous"),
}
"""(kind of file, text, its replacement, what the message must name)."""


def refused(*arguments: str | Path, naming: str) -> None:
    """Check that a call is refused in one sentence that names `naming`."""
    ended = dpcontrol(*arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    said = [line for line in ended.stderr.splitlines() if line.startswith("dpcontrol: ")]
    assert len(said) == 1
    assert said[0] == ended.message
    assert naming in said[0]
    assert "Traceback" not in ended.stderr


def files(folder: Path) -> set[str]:
    return {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("mistake", REPLACED)
def test_a_mistake_in_a_file_is_named(
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
        ("orbit lab --saddle down-up --energy -0.3", "-0.17543"),
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
    ],
)
def test_a_mistake_on_the_command_line_is_named(
    line: str, naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(*line.split(), naming=naming)
    assert files(tmp_path) == set()


@pytest.mark.parametrize("harm", ["truncated", "corrupt", "not a log"])
def test_a_damaged_log_is_refused_by_score_and_review(
    harm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert dpcontrol("run", "outer-turn", "--out", "whole.mcap").code == 0
    data = Path("whole.mcap").read_bytes()
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


def test_json_tells_a_mistake_too(tmp_path: Path) -> None:
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
