"""dpcontrol bench"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import click

from dpcontrol.bench.registry import CHARTS, GROUPS
from dpcontrol.cli.verbs import OUTPUT, Answer, TextTable, option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.bench.run import Drawn


def _listed(names: Iterable[str]) -> str:
    """Return names as a paragraph that is not broken within them."""
    return "\b\n" + fill(", ".join(names), 76, break_on_hyphens=False)


_HELP = f"""Chart speed against accuracy, each numerical choice as a point beside its alternatives, and map failures.

Charts, times being medians on one core, start-up apart, the product's default ringed:

{_listed(name for name in CHARTS if name not in GROUPS["edges"])}

Maps of where a method stops working, found by bisection, beside where theory has it; `edges` stands for all of them:

{_listed(GROUPS["edges"])}

All are drawn where none is named. What is not as it should be, a default off its front or a border that is not where it
is predicted, is in the status; with --strict it makes the exit code 1. --against compares with an earlier drawing: the
order on each front, times within a fifth of each other being a tie, and what each default takes, twice as much being
slower, and errs by.
"""


@verb("bench", help=_HELP, example="dpcontrol bench propagation --quick --out charts")
@click.argument("names", nargs=-1, metavar="[CHART]...")
@click.option("--quick", is_flag=True, help="Less of the same work: all charts in three minutes.")
@click.option(
    "--against",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of an earlier drawing, to compare fronts and defaults with.",
)
@click.option("--strict", is_flag=True, help="Exit with 1 where a chart has a complaint.")
@option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("charts"),
    show_default=True,
    group=OUTPUT,
    help="Folder for each chart's NAME.png and NAME.json.",
)
def command(*, names: tuple[str, ...], quick: bool, against: Path | None, strict: bool, out: Path) -> Answer:
    """Draw the charts, print their fronts and borders."""
    from dpcontrol.bench.chart import PrecisionChart
    from dpcontrol.bench.redrawn import changes, earlier_panels, losses
    from dpcontrol.bench.registry import check_names
    from dpcontrol.bench.run import draw_charts

    # Read before the work: the folder may be the one that is drawn to.
    charts = [name for name in check_names(names) if name not in GROUPS["edges"]]
    earlier = {} if against is None else {name: earlier_panels(against, name) for name in charts}
    with progress_bar("bench") as progress:
        drawn = draw_charts(names, out, quick=quick, progress=progress)
    complaints = [text for d in drawn for text in d.chart.complaints]
    status = f"{len(drawn)} charts drawn; " + ("; ".join(complaints) or "every default stands where it may")
    if against is not None:
        fronts = [(earlier[d.chart.name], d.chart.panels) for d in drawn if isinstance(d.chart, PrecisionChart)]
        changed = [text for before, after in fronts for text in changes(before, after)]
        lost = [text for before, after in fronts for text in losses(before, after)]
        status += "; " + ("; ".join(changed) or f"the order on each front is that in {against}")
        status += "; " + ("; ".join(lost) or "no default became slower or less accurate")
        complaints += changed + lost
    files = [{"file": str(d.picture), "data": str(d.data), "seconds": d.seconds} for d in drawn]
    document = {
        "charts": [{**d.chart.document(), **file} for d, file in zip(drawn, files, strict=True)],
        "status": status,
    }
    missed = status if strict and complaints else ""
    return Answer(document, _text(drawn) if missed else [*_text(drawn), status], missed)


def _text(drawn: "Sequence[Drawn]") -> Iterator[str | TextTable]:
    for d in drawn:
        yield str(d.picture)
        for table in d.chart.tables():
            yield TextTable(table.title, table.columns, table.rows)
            yield from (f"  {note}" for note in table.notes)
        yield from (f"  {line}" for line in d.chart.reading)
        yield fill(f"Chosen: {d.chart.chosen}", 110, initial_indent="  ", subsequent_indent="  ")
        yield f"  {d.data}, {d.seconds:.0f} s"
