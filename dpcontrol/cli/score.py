"""dpcontrol score"""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import json_option, print_json, reports_failure
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.review.score import Score


def print_score(verdict: "Score") -> None:
    """Print a score for people."""
    pace = "" if verdict.real_time_factor is None else f", {verdict.real_time_factor:.1f} × real time"
    click.echo(f"{verdict.log}")
    click.echo(f"  {verdict.sentence}")
    click.echo(
        f"  tracking {verdict.rms_tracking_error * 1e3:.1f} mrad rms; cart {verdict.max_cart_position * 1e3:.1f} mm at "
        f"most, {verdict.rms_cart_acceleration:.3f} m/s² rms; NIS inside its 95 % band "
        f"{verdict.nis_inside_95:.1%}{pace}"
    )


@click.command("score", epilog="Example:  dpcontrol score logs/outer-turn-0.mcap")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@json_option
@reports_failure
def command(*, logs: tuple[Path, ...], as_json: bool) -> None:
    """Score logged runs: symbols done, wraps, limits, tracking, consistency of the estimator.

    With --json, one log gives one object, several give {"runs": [...]}. Exits with 1 if a run is not completed.
    """
    from dpcontrol.logs import read_log
    from dpcontrol.review.score import score

    verdicts = [score(read_log(path)) for path in logs]
    if as_json:
        documents = [v.document() for v in verdicts]
        print_json(documents[0] if len(documents) == 1 else {"runs": documents})
    else:
        for verdict in verdicts:
            print_score(verdict)
    missed = [v for v in verdicts if v.completed is False]
    if missed:
        raise GoalMissed(f"{len(missed)} of {len(verdicts)} not completed; {missed[0].log}: {missed[0].reason}")
