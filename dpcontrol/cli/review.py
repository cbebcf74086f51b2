"""The lines of a run's score, and why a run is not known to be completed."""

from typing import TYPE_CHECKING

from dpcontrol.words.runs import score_lines as score_text

if TYPE_CHECKING:
    from dpcontrol.judge.score import Score

__all__ = ["score_text", "shortfall"]


def shortfall(verdict: "Score", *, failed: str = "") -> str:
    """Return the reason why a run is not known to be completed, or "".

    Args:
        verdict: score of one log.
        failed: reason for an early end, or "".
    """
    return f"{'failed' if verdict.completed else 'not completed'}: {failed}" if failed else verdict.missed
