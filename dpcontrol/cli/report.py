"""dpcontrol report"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, file_option, verb

if TYPE_CHECKING:
    from dpcontrol.review.campaign import CampaignSummary


@verb("report", example="dpcontrol report logs/outer-turn-0.mcap --picture outer-turn.pdf")
@click.argument("file", metavar="LOG|CAMPAIGN.parquet", type=click.Path(path_type=Path))
@file_option("--picture", suffix=(".png", ".pdf"), help="Page to write [beside FILE, as NAME-report.png].")
def command(*, file: Path, picture: Path | None) -> Answer:
    """Write one page on a log or on a campaign, for those who do not open a viewer; matplotlib draws it.

    Of a log: the itinerary as asked and as done, a film, angles, rates, cart, command, errors, energy, phase planes.
    Of a campaign: shares of success by group with Wilson's intervals, failures by symbol and reason.
    """
    picture = picture or file.with_name(f"{file.stem}-report.png")
    answer = (_campaign if file.suffix.lower() == ".parquet" else _log)(file, picture)
    return Answer({**answer.document, "picture": str(picture)}, [*answer.text, f"page       {picture}"])


def _log(file: Path, picture: Path) -> Answer:
    from dpcontrol.cli.score import score_text
    from dpcontrol.logs import read_log
    from dpcontrol.review.drawing import draw
    from dpcontrol.review.of_log import run_view
    from dpcontrol.review.panel_frame import save_figure
    from dpcontrol.review.score import REFERENCE_ATTACHMENT, score

    log = read_log(file)
    view = run_view(log)
    save_figure(draw(view), picture)
    if REFERENCE_ATTACHMENT in log.attachments and "reference" in log.states:
        verdict = score(log)
        return Answer(verdict.document(), score_text(verdict))
    document = {"log": str(file), "completed": None, "reason": view.verdict}
    return Answer(document, [str(file), f"  {view.verdict}"])


def _campaign(file: Path, picture: Path) -> Answer:
    from dpcontrol.review.campaign import campaign_summary
    from dpcontrol.review.campaign_figure import draw_campaign
    from dpcontrol.review.panel_frame import save_figure

    summary = campaign_summary(file)
    save_figure(draw_campaign(summary), picture)
    return Answer(summary.document(), _text(summary))


def _text(summary: "CampaignSummary") -> Iterator[str | TextTable]:
    yield f"{summary.path}\n  {summary.status}"
    rows = [
        [group.label, f"{g.successes} of {g.runs}", f"{g.rate:.1%}", f"{g.low:.1%} to {g.high:.1%}"]
        for group in summary.groups
        for g in (group.share,)
    ]
    yield TextTable("", ["runs", "completed", "share", "95 % interval"], rows)
    if summary.reasons:
        rows = [[text, str(count)] for text, count in summary.reasons[:8]]
        yield TextTable("", ["reason of failure", "runs"], rows)
