"""The layout engine of all pages.

A page has rows of panels, strips and tables below a title and a verdict.

    Page("Outer turn", "completed", good=True).row(angles, rates, height=2.0).table(rows).figure()

A panel is a function that draws on given axes. The engine sizes and aligns panels by matplotlib's constrained layout,
wraps titles to the width of their panel, and places keys below them. No page chooses coordinates.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.path import Path as LinePath
from matplotlib.text import Text
from matplotlib.textpath import TextPath
from matplotlib.transforms import Bbox

from dpcontrol.foundation.errors import InputError, printable
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.pages import style
from dpcontrol.pages.panels import BESIDE

Draw = Callable[[Any], None]
_DPI = 150
_LINE = 1.35
"""Distance of two lines, in heights of their text."""
_EDGE = 0.12
"""Free edge of a page and gap between panels, inches."""
_KEY = "key of the engine"


@dataclass(frozen=True)
class Panel:
    """A function that draws on axes.

    `share` is its width in a row or height in a stack, relative to its neighbours; `space` demands three dimensions.
    """

    draw: Draw
    share: float = 1.0
    space: bool = False


@dataclass(frozen=True)
class Stack:
    """Panels below one another, with aligned sides; `share` is the stack's width relative to its neighbours."""

    panels: Sequence[Panel | Draw]
    share: float = 1.0


Item = Panel | Stack | Draw


@dataclass
class Page:
    """A page in preparation.

    Attributes:
        title: title at the top.
        verdict: the result in a sentence, below the title.
        good: True for a favourable verdict, False for an unfavourable one; decides its colour.
        width: in inches.
        rows: rows from the top, each with its height, inches, and the function that draws it into its part.
    """

    title: str
    verdict: str = ""
    good: bool | None = None
    width: float = style.WIDTH
    rows: list[tuple[float, Callable[[SubFigure], None]]] = field(default_factory=list)

    def row(self, *items: Item, height: float) -> "Page":
        """Add a row of panels beside one another below the rows that the page has.

        Args:
            *items: panels, stacks or functions that draw.
            height: height of the row, inches.
        """
        if items:
            self.rows.append((height, lambda part: _row(part, items)))
        return self

    def grid(self, panels: Sequence[Draw], *, across: int, height: float) -> "Page":
        """Add rows of equal panels; the last row may have free places.

        Args:
            panels: functions that draw.
            across: number of panels in a row.
            height: height of a row, inches.
        """
        for first in range(0, len(panels), across):
            row = panels[first : first + across]
            self.row(*row, *[_free] * (across - len(row)), height=height)
        return self

    def table(self, rows: Sequence[Sequence[str]], *, heading: Sequence[str] = ()) -> "Page":
        """Add a table of texts, below an optional heading.

        Args:
            rows: texts by row.
            heading: texts above the columns.
        """
        lines = [heading, *rows] if heading else rows

        def draw(axes: Axes) -> None:
            """Draw `lines`, the rows below their heading, as a table without rules; columns fit their texts."""
            axes.axis("off")
            table = axes.table(lines, loc="upper left", cellLoc="left", edges="open")
            table.auto_set_font_size(False)
            table.set_fontsize(style.TEXT)
            table.auto_set_column_width(range(len(lines[0])))
            table.set_in_layout(False)

        return self.row(draw, height=2 * _EDGE + max(len(lines), 1) * _height(style.TEXT))

    def text(self, text: str, *, colour: str = style.NOTE, size: float = style.SMALL) -> "Page":
        """Add a paragraph, wrapped to the width of the page; an empty text adds nothing.

        Args:
            text: text of the paragraph.
            colour: colour of the text.
            size: size of the text, points.
        """
        lines = [part for line in text.splitlines() for part in wrapped(line, size, self.width - 2 * _EDGE)]
        if lines:
            height = len(lines) * _height(size) + 0.5 * _EDGE

            def write(part: SubFigure) -> None:
                """Write the wrapped `lines` of the paragraph into their part of the figure, `height` inches high."""
                place = 0.5 * _EDGE / self.width, 1 - 0.25 * _EDGE / height
                part.text(*place, "\n".join(lines), fontsize=size, color=colour, va="top", linespacing=_LINE)

            self.rows.append((height, write))
        return self

    def origin(self, path: Path | None, *conditions: str) -> "Page":
        """Add the conditions of what the page shows, and the name and date of the file that it shows.

        Args:
            path: file, which may exist in memory only. None stands for a result that this program has computed today.
            *conditions: conditions, such as model and energy; empty ones are left out.
        """
        if path is None:
            return self.text("; ".join(filter(None, (*conditions, f"{PROGRAM}, {date.today()}"))))
        day = f" of {date.fromtimestamp(path.stat().st_mtime)}" if path.exists() and path.name else ""
        return self.text("; ".join(filter(None, (*conditions, f"{path.name}{day}"))))

    def figure(self) -> Figure:
        """Return the page as a figure, with title and verdict above the rows in the order in which they were added."""
        # Bold letters are wider than those that are measured.
        head = Page("", width=self.width / 1.12).text(self.title, colour=style.INK, size=style.TITLE)
        verdict = Page("", width=self.width).text(
            self.verdict, colour=style.verdict_colour(self.good), size=style.VERDICT
        )
        rows = [*head.rows, *verdict.rows, *self.rows]
        heights = [height for height, _ in rows]
        with rc_context(style.PRINTED):
            figure = new_figure(self.width, sum(heights) + _EDGE)
            # The last part is the page's lower edge.
            subfigures = figure.subfigures(len(rows) + 1, 1, squeeze=False, height_ratios=[*heights, _EDGE])[:, 0]
            for subfigure, (_, draw) in zip(subfigures, rows, strict=False):
                subfigure.set_facecolor("none")
                draw(subfigure)
            if self.title:
                subfigures[0].texts[0].set_weight("bold")
            settle(figure)
        return figure


def _free(axes: Axes) -> None:
    """Leave a place of a grid empty."""
    axes.axis("off")


def _height(size: float) -> float:
    """Return the height of a line of text, inches."""
    return _LINE * size / 72


def _row(part: SubFigure, items: Sequence[Item]) -> None:
    """Draw the items of a row side by side into its part of the figure, with widths in proportion to their shares.

    If there is a stack, each item gets a subfigure. Otherwise all panels share one grid, which aligns them.
    """
    shares = [getattr(item, "share", 1.0) for item in items]
    if any(isinstance(item, Stack) for item in items):
        columns = part.subfigures(1, len(items), squeeze=False, width_ratios=shares)[0]
        for column, item in zip(columns, items, strict=True):
            column.set_facecolor("none")
            _grid(column, item.panels if isinstance(item, Stack) else [item], across=False)
    else:
        _grid(part, [item for item in items if not isinstance(item, Stack)], across=True)


def _grid(part: SubFigure, items: Sequence[Panel | Draw], *, across: bool) -> None:
    """Draw panels into one grid: beside one another if `across`, otherwise below one another, sized by their shares."""
    panels = [item if isinstance(item, Panel) else Panel(item) for item in items]
    shares = [panel.share for panel in panels]
    shape = (1, len(panels)) if across else (len(panels), 1)
    grid = part.add_gridspec(*shape, **{"width_ratios" if across else "height_ratios": shares})
    for k, panel in enumerate(panels):
        place = grid[(0, k) if across else (k, 0)]
        panel.draw(part.add_subplot(place, projection="3d" if panel.space else None))


class ShownFigure(Figure):
    """A figure displayed by notebook cells, and elsewhere by `show`.

    pyplot does not manage it: a figure that pyplot manages appears a second time at the end of a notebook's cell.
    """

    def _repr_png_(self) -> bytes:
        """Return the picture that IPython shows below a cell, as PNG."""
        _literal_texts(self)
        picture = BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()

    def show(self, warn: bool = True) -> None:
        """Display the figure once, in a notebook or a window.

        Outside notebooks the window blocks until it is closed.

        `warn` has no effect; pyplot warns if its backend has no windows.
        """
        notebook = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        if hasattr(notebook, "kernel"):
            sys.modules["IPython"].display.display(self)
            return
        from matplotlib import pyplot

        _literal_texts(self)
        # The window is created for a figure of pyplot and then shows this one.
        canvas = pyplot.figure(figsize=self.get_size_inches()).canvas
        canvas.figure = self
        self.set_canvas(canvas)
        pyplot.show()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure without pyplot, on which matplotlib's constrained layout arranges the panels.

    Args:
        width: width in inches.
        height: height in inches.
    """
    figure = ShownFigure(figsize=(width, height), dpi=_DPI, facecolor=style.PAPER, layout="constrained")
    figure.get_layout_engine().set(w_pad=_EDGE / 2, h_pad=_EDGE / 2, wspace=0.02, hspace=0.02)  # type: ignore[union-attr]
    FigureCanvasAgg(figure)
    return figure


def _literal_texts(figure: Any) -> None:
    """Make a figure of matplotlib draw its texts literally, because names of files may contain any character.

    A dollar sign then begins no formula, and control characters are written out.
    """
    for text in figure.findobj(Text):
        # The tick labels of a logarithmic axis are formulas of matplotlib.
        if "$" in text.get_text() and "\\mathdefault" not in text.get_text():
            text.set_parse_math(False)
        text.set_text(printable(text.get_text()))


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as PNG, PDF or SVG, by the name's suffix.

    Args:
        figure: figure to write.
        path: file, `*.png`, `*.pdf` or `*.svg`.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "pdf", "svg"):
        raise InputError(f"{path}: a picture is a .png, .pdf or .svg file; choose a name that ends so")
    _literal_texts(figure)
    with whole_file(path, suffix=f".{kind}") as temporary:
        try:
            figure.savefig(temporary, format=kind)
        except OverflowError as error:
            raise InputError(
                f"cannot draw {path}: its curves reach too far ({error}); look for time that runs backward or jumps"
            ) from error


@cache
def text_width(text: str, size: float) -> float:
    """Return the width of a line of text as drawn, inches, by which texts are wrapped and placed.

    Args:
        text: text of the line.
        size: size of the text, points.
    """
    if not text.strip():
        return 0.0
    literal = printable(text).replace("$", r"\$")
    # Letters are drawn at whole pixels, which widens texts by up to a twentieth.
    return 1.05 * float(TextPath((0, 0), literal, prop=FontProperties(size=size)).get_extents().x1) / 72


def wrapped(text: str, size: float, width: float) -> list[str]:
    """Return a text as lines that fit into a width, with longer words broken.

    Args:
        text: text to wrap.
        size: size of the text, points.
        width: width of the lines, inches.
    """
    # The factor allows for lines with wider letters than the text's mean.
    share = 0.93 * width / max(text_width(text, size), 1e-9)
    return wrap(text, max(int(share * len(text)), 8)) if share < 0.93 else [text] * bool(text)


def key(axes: Axes, entries: Iterable[tuple[str, str | dict[str, Any]]] | None = None) -> None:
    """Add a key below the title of a panel.

    More than four curves are better named at the right of the panel.

    Args:
        axes: panel of the key.
        entries: labels, each with a colour or a line style; by default the labels of what was drawn.
    """
    handles = axes.get_legend_handles_labels()[0] if entries is None else []
    looks: list[tuple[str, Any]] = [(label, {"color": e} if isinstance(e, str) else e) for label, e in entries or ()]
    handles += [Line2D([], [], label=label, **look) for label, look in looks]
    if handles:
        # Pages place key and title by their widths; a panel alone has the key below its title.
        axes.set_title(axes.get_title(loc="left"), loc="left", pad=6 + style.SMALL * _LINE)
        axes.legend(
            handles=handles,
            ncols=len(handles),
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            borderaxespad=0.25,
            handlelength=1.3,
            handletextpad=0.4,
            columnspacing=1.2,
        ).set_gid(_KEY)


MOST_IN_KEY = 4
"""Greatest number of entries of a key."""


def settle(figure: Figure) -> None:
    """Arrange titles, keys and labels of points after all panels of a figure have been drawn.

    Only then their widths are known. Titles are wrapped to the widths of their panels; a key is placed beside its title
    if both fit, otherwise below it, in one or two rows. Labels of points are moved so that they cover little.
    """
    _literal_texts(figure)
    figure.draw_without_rendering()
    for axes in figure.axes:
        panel_width = axes.get_window_extent().width / figure.dpi
        title, legend, pad = axes.get_title(loc="left"), axes.get_legend(), 4.0
        if legend is not None and legend.get_gid() == _KEY:
            key_width = legend.get_window_extent().width / figure.dpi
            beside, narrow = (
                text_width(title, style.HEAD) + key_width + 0.15 < panel_width,
                key_width < panel_width + 0.3,
            )
            if beside:
                legend.set_loc("lower right")
                legend.set_bbox_to_anchor((1.0, 1.0), transform=axes.transAxes)
            legend.set_ncols(4 if narrow else 2)
            pad += 0.0 if beside else (1 if narrow else 2) * (style.SMALL * _LINE + 2)
        if title:
            lines = wrapped(title, style.HEAD, max(panel_width, 0.8)) if axes.name != "3d" else [title]
            axes.set_title("\n".join(lines), loc="left", fontsize=style.HEAD, color=style.INK, pad=pad)
        _turn_aside(axes, [text for text in axes.texts if text.get_gid() == BESIDE and text.get_text()])


_PLACES = [
    (away * x, away * y) for away in (5, 10, 16, 24, 34, 46, 60) for x in (1, -1, 0) for y in (1, -1, 0) if x or y
]
"""Tried places of a label beside its point, points."""
_LED = 10.0
"""Distance beyond which a line connects a point and its label, points."""
_COVERS, _CROSSES = 1000.0, 30.0
"""Costs of covering a mark or another label, and of being nearer to another mark or crossing a curve, in points."""


def _turn_aside(axes: Axes, labels: list[Any]) -> None:
    """Move labels round their points, and away from them, so that they cover little and their lines cross little.

    The labels are annotations of `name_point`. Each in turn takes the place of least cost; a line connects it to its
    point if it is far away.
    """
    taken = [box for line in axes.lines if labels and line.get_marker() not in ("None", "") for box in _marks(line)]
    curves = [line.get_path().transformed(line.get_transform()) for line in axes.lines if labels]
    for label in labels:
        place = min(_PLACES, key=partial(_cost, label=label, axes=axes, taken=taken, curves=curves))
        taken.append(_beside(label, place))
        if max(map(abs, place)) > _LED:
            line = {"arrowstyle": "-", "color": label.get_color(), "linewidth": 0.5, "shrinkA": 1, "shrinkB": 3}
            axes.annotate("", label.xy, xytext=place, textcoords="offset points", arrowprops=line)
            start = axes.transData.transform(label.xy)
            curves.append(LinePath([start, start + np.multiply(place, axes.figure.dpi / 72)]))


def _cost(place: tuple[int, int], label: Any, axes: Axes, taken: list[Bbox], curves: list[LinePath]) -> float:
    """Return the cost of a place of a label, in points, infinite if the label would reach beyond the panel.

    The cost is the distance from the label's point plus penalties. They count covered marks and labels, crossed curves,
    other marks nearer to the label than its own point, and boxes that the line to the point crosses.

    Args:
        place: offset (x, y) of the label from its point, points.
        label: annotation of the point.
        axes: panel.
        taken: boxes of marks and of labels that are already placed, pixels.
        curves: drawn curves, pixels.
    """
    box, point = _beside(label, place), axes.transData.transform(label.xy)
    end = np.clip(point, box.min, box.max)
    centres = np.reshape([box_taken.get_points().mean(axis=0) for box_taken in taken], (-1, 2))
    nearer_marks = np.hypot(*(centres - np.clip(centres, box.min, box.max)).T) < np.hypot(*(end - point)) - 1
    crossed_curves = sum(curve.intersects_bbox(box, filled=False) for curve in curves)
    struck_boxes = sum(LinePath([point, end]).intersects_bbox(box_taken, filled=False) for box_taken in taken)
    if not all(axes.bbox.contains(*corner) for corner in (box.min, box.max)):
        return np.inf
    return (
        max(map(abs, place))
        + _COVERS * box.count_overlaps(taken)
        + _CROSSES * (crossed_curves + nearer_marks.sum() + 4 * struck_boxes)
    )


def _beside(label: Any, place: tuple[float, float]) -> Bbox:
    """Move a label to a place (x, y) beside its point, points, and return the box that it then covers, pixels.

    `label` is an annotation of matplotlib, as `name_point` makes it. The sign of each offset decides which side of the
    label faces its point.
    """
    x, y = np.sign(place)
    label.set(position=place, ha=("center", "left", "right")[x], va=("center", "bottom", "top")[y])
    return label.get_window_extent()


def _marks(line: Line2D) -> list[Bbox]:
    """Return the box of each mark of a line's points, pixels, which labels should not cover."""
    half = (line.get_markersize() / 2 + 1) * line.get_figure(root=True).dpi / 72  # type: ignore[union-attr]
    return [Bbox([spot - half, spot + half]) for spot in line.get_transform().transform(line.get_xydata())]
