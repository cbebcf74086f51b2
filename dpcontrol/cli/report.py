"""dpcontrol report"""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import json_option, print_json, print_table, reports_failure
from dpcontrol.foundation.errors import InputError

if TYPE_CHECKING:
    from dpcontrol.review.campaign import CampaignSummary


@click.command("report", epilog="Example:  dpcontrol report logs/outer-turn-0.mcap --picture outer-turn.pdf")
@click.argument("file", metavar="LOG|CAMPAIGN.parquet", type=click.Path(path_type=Path))
@click.option(
    "--picture",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Page to write, .png or .pdf [beside FILE, as NAME-report.png].",
)
@json_option
@reports_failure
def command(*, file: Path, picture: Path | None, as_json: bool) -> None:
    """Write one page of a log or of a campaign, for those who do not open a viewer; matplotlib draws it.

    Of a log: the itinerary as asked and as done, a film, angles, rates, cart, command, errors, energy, phase planes.
    Of a campaign: shares of success by group with Wilson's intervals, failures by symbol and reason.
    """
    picture = picture or file.with_name(f"{file.stem}-report.png")
    if picture.suffix.lower() not in (".png", ".pdf"):
        raise InputError(
            f"--picture {picture}: a page is a .png or a .pdf file; choose a name that ends in one of them"
        )
    if file.suffix.lower() == ".parquet":
        document = _campaign(file, picture, as_json=as_json)
    else:
        document = _log(file, picture, as_json=as_json)
    if as_json:
        print_json({**document, "picture": str(picture)})
    else:
        click.echo(f"page       {picture}")


def _log(file: Path, picture: Path, *, as_json: bool) -> dict[str, Any]:
    from dpcontrol.cli.score import print_score
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
        if not as_json:
            print_score(verdict)
        return verdict.document()
    if not as_json:
        click.echo(f"{file}\n  {view.verdict}")
    return {"log": str(file), "completed": None, "reason": view.verdict}


def _campaign(file: Path, picture: Path, *, as_json: bool) -> dict[str, Any]:
    from dpcontrol.review.campaign import campaign_summary
    from dpcontrol.review.campaign_figure import draw_campaign
    from dpcontrol.review.panel_frame import save_figure

    summary = campaign_summary(file)
    save_figure(draw_campaign(summary), picture)
    if not as_json:
        _show(summary)
    return {
        "campaign": str(file),
        "status": summary.status,
        "runs": summary.runs,
        "unknown": summary.unknown,
        **_share(summary.share),
        "groups": [{**group.names, **_share(group.share)} for group in summary.groups],
        summary.axis: [
            {"group": level.label, "from": level.low, "to": level.high, **_share(level.share)}
            for level in summary.levels
        ],
        "failures": {
            "by_symbol": [
                {"group": label, "symbol": symbol or None, "runs": count}
                for label, symbol, count in summary.failed_symbols
            ],
            "by_reason": [{"reason": reason, "runs": count} for reason, count in summary.reasons],
        },
    }


def _share(share: Any) -> dict[str, Any]:
    values = asdict(share)
    return {
        "completed": values["successes"],
        "of": values["runs"],
        "rate": share.rate,
        "low": values["low"],
        "high": values["high"],
    }


def _show(summary: "CampaignSummary") -> None:
    click.echo(f"{summary.path}\n  {summary.status}")
    rows = [
        [group.label, f"{g.successes} of {g.runs}", f"{g.rate:.1%}", f"{g.low:.1%} to {g.high:.1%}"]
        for group in summary.groups
        for g in (group.share,)
    ]
    print_table("", ["runs", "completed", "share", "95 % interval"], rows)
    if summary.reasons:
        print_table("", ["reason of failure", "runs"], [[text, str(count)] for text, count in summary.reasons[:8]])
