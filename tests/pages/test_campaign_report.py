"""A campaign's table as numbers and as one page: shares with intervals, failures by symbol and by reason."""

from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet

from dpcontrol.judge.campaign import campaign_summary


def rows() -> list[dict[str, Any]]:
    """Return runs of two controllers; of the first 8 of 10 complete, of the second none."""
    found = []
    for controller in ("tvlqr", "feedforward"):
        for seed in range(10):
            done = controller == "tvlqr" and seed < 8
            found.append(
                {
                    "itinerary": "outer-turn",
                    "controller": controller,
                    "seed": seed,
                    "mismatch": 0.02 * (seed % 2),
                    "completed": done,
                    "symbols_completed": 1 if done else seed % 2,
                    "symbols_total": 1,
                    "cause": "completed" if done else "tracking lost",
                    "reason": "done" if done else f"symbol 1 not done; lost at t = {seed}.5 s",
                    "ending": "completed" if done else "lost",
                    "max_cart_position": 0.05 + 0.01 * seed,
                    "a_column_of_tomorrow": "x",
                }
            )
    return found


def table(path: Path, content: list[dict[str, Any]]) -> Path:
    path.mkdir()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(content), path / "0.parquet")
    return path


def test_failures_are_counted_by_symbol_and_by_cause(tmp_path: Path) -> None:
    summary = campaign_summary(table(tmp_path / "runs.parquet", rows()))
    assert summary.reasons == (("tracking lost", 12),)
    # Symbol 2 of 1: all symbols done, but not held to the end.
    assert {(label, symbol): count for label, symbol, count in summary.failed_symbols} == {
        ("feedforward", 1): 5,
        ("feedforward", 2): 5,
        ("tvlqr", 1): 1,
        ("tvlqr", 2): 1,
    }


def standard_rows(controllers: tuple[str, ...]) -> list[dict[str, Any]]:
    return [
        {"controller": controller, "kind": kind, "level": float(k), "mismatch": 0.01 * k, "completed": k < 15 - 8 * c}
        for c, controller in enumerate(controllers)
        for kind in ("noise", "lag", "pushes")
        for k in range(21)
    ]


def test_a_standard_score_is_reported_by_kind_and_by_level(tmp_path: Path) -> None:
    summary = campaign_summary(table(tmp_path / "runs.parquet", standard_rows(("tvlqr", "adaptive"))))
    shares = {tuple(group.names.values()): group.share for group in summary.groups}
    assert {key: share.successes for key, share in shares.items()} == {
        (controller, kind): count
        for controller, count in (("tvlqr", 15), ("adaptive", 7))
        for kind in ("noise", "lag", "pushes")
    }
    assert summary.axis == "level"
    levels = {(level.label, level.low): (level.share.successes, level.share.runs) for level in summary.levels}
    assert len(levels) == 42
    assert levels["tvlqr", 14.0] == (3, 3)
    assert levels["tvlqr", 15.0] == levels["adaptive", 7.0] == (0, 3)
