"""dpcontrol score"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, verb

if TYPE_CHECKING:
    from dpcontrol.review.score import Score


@verb("score", example="dpcontrol score logs/outer-turn-0.mcap")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
def command(*, logs: tuple[Path, ...]) -> Answer:
    """Score logged runs: symbols done, wraps, limits, tracking, consistency of the estimator.

    With --json, one log gives one object, several give {"runs": [...]}. Exits with 1 if a run is not completed.
    """
    from dpcontrol.logs import read_log
    from dpcontrol.review.score import score

    verdicts = [score(read_log(path)) for path in logs]
    documents = [verdict.document() for verdict in verdicts]
    failed = [verdict for verdict in verdicts if verdict.completed is False]
    return Answer(
        documents[0] if len(documents) == 1 else {"runs": documents},
        (line for verdict in verdicts for line in score_text(verdict)),
        f"{len(failed)} of {len(verdicts)} not completed; {failed[0].log}: {failed[0].reason}" if failed else "",
    )


def score_text(verdict: "Score") -> Iterator[str]:
    """Yield a score for people."""
    pace = "" if verdict.real_time_factor is None else f", {verdict.real_time_factor:.1f} × real time"
    yield verdict.log
    yield f"  {verdict.sentence}"
    yield (
        f"  tracking {verdict.rms_tracking_error * 1e3:.1f} mrad rms; cart {verdict.max_cart_position * 1e3:.1f} mm at "
        f"most, {verdict.rms_cart_acceleration:.3f} m/s² rms; NIS inside its 95 % band "
        f"{verdict.nis_inside_95:.1%}{pace}"
    )


def shortfall(verdict: "Score") -> str:
    """Return why a run counts as a goal missed, "" where it does not."""
    return f"not completed: {verdict.reason}" if verdict.completed is False else ""
