"""The story of a run over time, as strips.

They show planned and flown stays, symbols, and the controller's modes.
"""

from matplotlib.axes import Axes

from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.layout import text_width
from dpcontrol.pages.panels import badge
from dpcontrol.pages.ranges import Range
from dpcontrol.pages.strips import Span, Strip, strips

_TALL = 0.84
_WRONG = {"facecolor": "#f7d9d6", "edgecolor": style.LIMIT, "hatch": "xxxx"}
_BETWEEN = {"facecolor": "#eceef0", "edgecolor": style.FAINT, "hatch": "////"}
_ROW = 0.24
_AROUND = 0.62


def story_rows(view: RunView, *, span: Range | None = None) -> list[Strip]:
    """Return the rows of the story, from the top.

    Args:
        view: run to draw.
        span: displayed time range, s; all by default.
    """
    return [strip for strip in strips(view, until=None if span is None else span[1]) if strip.name]


def story_height(view: RunView, *, span: Range | None = None) -> float:
    """Return the height of a story, inches; 0 without rows.

    Args:
        view: run to draw.
        span: displayed time range, s; all by default.
    """
    rows = story_rows(view, span=span)
    return _AROUND + _ROW * len(rows) if rows else 0.0


def _width(text: str, second: float) -> float:
    """Return the time that a text takes, s, at a scale of `second` seconds per inch."""
    return (text_width(text, style.SMALL) + 0.08) * second


def story(axes: Axes, view: RunView, *, span: Range | None = None, width: float = style.WIDTH) -> None:
    """Draw planned stays, decoded stays and modes over time.

    Args:
        axes: panel to draw on.
        view: run to draw.
        span: displayed time range, s; by default that of the motion and its plan.
        width: width of the panel, inches.
    """
    rows = story_rows(view, span=span)
    begin, end = span or view.span
    second = (end - begin) / (width - 1.2)
    marks = {"done": [done for _, _, done in view.symbols if done is not None]}
    if rows:
        marks[rows[0].name] = [planned for _, planned, _ in view.symbols]
    for place, strip in enumerate(reversed(rows)):
        for part in strip.spans:
            _part(axes, part, place, second, marks=marks.get(strip.name, []), mode=strip.name == "controller")
    _numbers(axes, view, [strip.name for strip in rows], (begin, end), second)
    axes.set_xlim(begin, end)
    axes.set_ylim(-0.08, len(rows) + 0.02)
    axes.set_yticks([place + _TALL / 2 for place in range(len(rows))], [strip.name for strip in reversed(rows)])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("time (s)" if view.arm_lengths else "time", loc="left", labelpad=0)
    axes.spines["left"].set_visible(False)
    axes.grid(False)


def _part(axes: Axes, part: Span, place: int, second: float, *, marks: list[float], mode: bool) -> None:
    """Draw a span of a strip, with its text if possible.

    The text needs room between the symbols' marks, s.
    """
    # A mode of one tick, as at an end, is widened to remain visible.
    width = max(part.last - part.first, (0.06 if part.kind == "mode" else 0.04) * second)
    first = part.last - width if part.kind == "mode" else part.first
    look = {"astray": _WRONG, "transfer": _BETWEEN, "ended": _BETWEEN}.get(part.kind, {"facecolor": part.colour})
    axes.broken_barh([(first, width)], (place, _TALL), linewidth=0, **look)  # type: ignore[arg-type]
    text = "" if part.kind == "ended" and mode else part.text
    text = f"the run ended at {part.first:.2f} s" if part.kind == "ended" and not mode else text
    middle, wide = first + width / 2, _width(text, second)
    marked = any(abs(at - middle) < wide / 2 + 0.1 * second for at in marks)
    if not text or marked or width < wide:
        return
    colour = {"stay": style.PAPER, "astray": style.LIMIT, "mode": style.INK}.get(part.kind, style.NOTE)
    box = None if part.kind in ("stay", "mode") else {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    axes.text(
        middle,
        place + _TALL / 2,
        text,
        ha="center",
        va="center_baseline",
        fontsize=style.SMALL,
        color=colour,
        bbox=box,
        clip_on=True,
        zorder=4,
    )


def _numbers(axes: Axes, view: RunView, rows: list[str], span: Range, second: float) -> None:
    """Number the symbols at their planned and actual times.

    They are named above if there is room.
    """
    begin, end = span
    free, last = begin, -1e9
    for i, (name, planned, done) in enumerate(view.symbols):
        for row, moment in ((rows[0], planned), ("done", done)):
            if row in rows and moment is not None and begin <= moment <= end:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == rows[0] and moment - last > 0.2 * second:
                    badge(axes, i + 1, moment, place + _TALL / 2)
                    last = moment
        half = _width(name, second) / 2
        left = min(max(planned - half, begin), end - 2 * half)
        if left > free and begin <= planned <= end:
            look = {"ha": "center", "va": "bottom", "fontsize": style.SMALL, "color": style.INK}
            axes.text(left + half, len(rows) - 0.02, name, **look)  # type: ignore[arg-type]
            free = left + 2 * half
