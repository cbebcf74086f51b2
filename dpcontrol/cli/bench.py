"""dpcontrol bench"""

from pathlib import Path
from textwrap import fill

import click

from dpcontrol.cli.output import json_option, print_json, print_table, progress_bar, reports_failure


@click.command("bench", epilog="Example:  dpcontrol bench propagation --quick --out charts")
@click.argument("names", nargs=-1, metavar="[CHART]...")
@click.option("--quick", is_flag=True, help="Less of the same work: all charts in three minutes.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("charts"),
    show_default=True,
    help="Folder for each chart's NAME.png and NAME.json.",
)
@json_option
@reports_failure
def command(*, names: tuple[str, ...], quick: bool, out: Path, as_json: bool) -> None:
    """Chart speed against accuracy: every numerical choice as a point beside its alternatives, measured here and now.

    Charts: propagation, connections, transcription. All are drawn where none is named. Times are medians on one core,
    start-up apart; the product's default is ringed. `edges` stands for the maps of failure: where methods stop working,
    found by bisection, beside where theory has it.
    """
    from dpcontrol.bench.run import draw_charts

    with progress_bar("bench") as progress:
        drawn = draw_charts(names, out, quick=quick, progress=progress)
    complaints = [text for d in drawn for text in d.chart.complaints]
    status = f"{len(drawn)} charts drawn; " + ("; ".join(complaints) or "every default stands where it may")
    if as_json:
        files = [{"file": str(d.picture), "data": str(d.data), "seconds": d.seconds} for d in drawn]
        charts = [{**d.chart.document(), **file} for d, file in zip(drawn, files, strict=True)]
        print_json({"charts": charts, "status": status})
        return
    for d in drawn:
        click.echo(f"{d.picture}")
        for table in d.chart.tables():
            print_table(table.title, table.columns, table.rows)
            for note in table.notes:
                click.echo(f"  {note}")
        for line in d.chart.reading:
            click.echo(f"  {line}")
        click.echo(fill(f"Chosen: {d.chart.chosen}", 110, initial_indent="  ", subsequent_indent="  "))
        click.echo(f"  {d.data}, {d.seconds:.0f} s")
    click.echo(status)
