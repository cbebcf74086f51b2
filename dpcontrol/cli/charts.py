"""The verbs that draw: figures, bench."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from dpcontrol.bench.chart import CHARTS, GROUPS
from dpcontrol.cli.verbs import FOLDER, OUTPUT, YES, Answer, TextTable, argument, option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.bench.run import DrawnChart


ALL_CHARTS = (*CHARTS, *GROUPS)
FIGURES = (
    "energy-landscape", "three-body-homoclinics", "three-body", "lyapunov-orbits", "families", "tubes",
    "tubes-down-up", "cuts", "colour-wheels", "tubes-up-down", "colour-wheels-up-down", "homoclinics-low",
    "homoclinics-high", "heteroclinics", "heteroclinic-orbits", "branches", "graph", "shadowing",
    "double-homoclinics", "triple-homoclinics", "returning-homoclinics", "up-up",
)  # fmt: skip
"""Names of `pages.figures.FIGURES`, whose import takes a second."""
_FIGURES_HELP = f"""Draw the computational figures of the paper, each a PNG with a caption and the differences.

Names: {", ".join(FIGURES)}. Without a name, all are drawn. Atlases are cached by content.
"""


@verb("figures", help=_FIGURES_HELP, example="dpcontrol figures tubes heteroclinics --out pictures")
def figures_command(
    *,
    names: tuple[str, ...] = argument(metavar="[NAME]...", required=False),
    out: Path = option(
        type=FOLDER, default=Path("figures"), group=OUTPUT, help="Folder for the pictures and captions.json."
    ),
) -> Answer:
    """Draw the figures and print their captions."""
    with progress_bar("figures") as progress:
        progress("loading", 0.0)
        from dpcontrol import api
        from dpcontrol.pages.figures import CAPTIONS

        drawn = api.draw_figures(names, folder=out, progress=progress)
    document = {
        "figures": drawn,
        "captions": out / CAPTIONS,
        "status": f"{len(drawn)} figures drawn",
    }
    lines = [
        "\n".join([str(d.file), _paragraph(d.caption), _paragraph(f"Differs from the paper: {d.differs}")])
        for d in drawn
    ]
    return Answer(document, [*lines, f"captions  {out / CAPTIONS}"])


def _paragraph(text: str) -> str:
    return fill(text, 110, initial_indent="  ", subsequent_indent="  ")


def _listed(names: Iterable[str]) -> str:
    """Return names as a paragraph without line breaks inside a name."""
    return "\b\n" + fill(", ".join(names), 76, break_on_hyphens=False)


_HELP = f"""Chart speed against accuracy of numerical methods, and map their failures.

Charts. Times are medians on one core without start-up, and a ring marks the default of dpcontrol:

{_listed(name for name in CHARTS if name not in GROUPS["edges"])}

Maps of the limits of methods, found by bisection, beside the predictions of theory. `edges` selects all of them:

{_listed(GROUPS["edges"])}

Without a name, all are drawn. The status reports defaults off their front and limits that differ from their
prediction. With --strict, these give exit code 1.
"""


@verb("bench", help=_HELP, example="dpcontrol bench propagation --quick --out charts")
def bench_command(
    *,
    names: tuple[str, ...] = argument(metavar="[CHART]...", required=False),
    quick: bool = option(help="Fewer and shorter measurements."),
    strict: bool = option(help="Exit code 1 if a chart reports a deviation."),
    out: Path = option(
        type=FOLDER, default=Path("charts"), group=OUTPUT, help="Folder for NAME.png and NAME.json of each chart."
    ),
    yes: bool = YES,
) -> Answer:
    """Draw the charts and print their fronts and limits."""
    with progress_bar("bench") as progress:
        progress("loading", 0.0)
        from dpcontrol.bench.run import draw_charts

        drawn = draw_charts(names, out, quick=quick, yes=yes, progress=progress)
    complaints = [text for d in drawn for text in d.chart.complaints]
    status = f"{len(drawn)} charts drawn; " + ("; ".join(complaints) or "every default stands where it may")
    files = [{"file": d.pictures[0], "files": d.pictures, "data": d.data, "seconds": d.seconds} for d in drawn]
    document = {
        "charts": [{**d.chart.document(), **file} for d, file in zip(drawn, files, strict=True)],
        "status": status,
    }
    missed = status if strict and complaints else ""
    return Answer(document, _text(drawn) if missed else [*_text(drawn), status], missed)


def _text(drawn: "Sequence[DrawnChart]") -> Iterator[str | TextTable]:
    for d in drawn:
        yield from map(str, d.pictures)
        for part in d.chart.parts:
            table = part.table()
            yield TextTable(table.title, table.columns, table.rows)
            yield f"  {part.finding()}"
            yield from (f"  {note}" for note in table.notes)
        yield from (f"  {line}" for line in d.chart.reading)
        yield fill(f"Chosen: {d.chart.chosen}", 110, initial_indent="  ", subsequent_indent="  ")
        yield f"  {d.data}, {d.seconds:.0f} s"
