"""`dpcontrol preflight`: its document, its page, and what it refuses before it begins."""

from pathlib import Path

import pytest
from command_line import dpcontrol

HARD = ("--mismatch", "0.2", "--lag", "0.005", "--controller", "tvlqr")


@pytest.mark.benchmark  # finds ten borders, as the guide's own example does with the slow tests
def test_the_document_has_the_probability_endings_limits_and_helpful_changes(tmp_path: Path) -> None:
    page = tmp_path / "page.png"
    ended = dpcontrol("preflight", "outer-turn", *HARD, "--runs", "32", "--workers", "1", "--picture", page, "--json")
    assert ended.code == 0
    shown = ended.document
    assert (shown["runs"], shown["confidence"], shown["picture"]) == (32, 0.99, str(page))
    low, high = shown["wilson"]
    assert 0 <= low <= shown["success_rate"] <= high <= 1
    assert sum(ending["runs"] for ending in shown["endings"]) == 32 - shown["completed"]
    settings = {
        "delay", "lag", "mismatch", "push_impulse", "zero_error", "counts", "travel", "belt", "play", "stiction"
    }  # fmt: skip
    assert {border["setting"] for border in shown["borders"]} == settings
    gains = [change["gain"] for change in shown["changes"]]
    assert gains == sorted(gains, reverse=True)
    assert page.stat().st_size > 10_000
    # A seed that is reported as failing fails.
    seed = shown["endings"][0]["seed"]
    again = dpcontrol("run", "outer-turn", *HARD, "--seed", seed, "--out", tmp_path / "run.mcap", "--json")
    assert again.code == 1


@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        (("outer-turm",), "outer-turn"),
        (("outer-turn", "--mismatch", "2"), "mismatch = 2"),
        (("outer-turn", "--controller", "tvlqg"), "tvlqr"),
        (("outer-turn", "--set", "model_uncertainty=1"), "[uncertainty]"),
        (("outer-turn", "--runs", "3"), "runs = 3"),
        (("outer-turn", "--picture", "page.svg"), "--picture"),
        (("outer-turn", "--picture", "."), "--picture"),
    ],
)
def test_user_errors_are_one_sentence_and_exit_with_two(
    arguments: tuple[str, ...], naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = dpcontrol("preflight", "--workers", "1", *arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    assert naming in ended.message
    assert "Traceback" not in ended.stderr
    assert not list(tmp_path.iterdir())
