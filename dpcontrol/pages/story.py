"""The story of a run over time, as strips of named spans: planned and flown stays, symbols, and modes."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.judge.run_view import RunView, Stay
from dpcontrol.logs import FLIGHT, LAP, RESUME, RETURN, Mode
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, text_width
from dpcontrol.pages.planes import Range


@dataclass(frozen=True)
class Span:
    """A stretch of a strip, s.

    Its kind is "stay" ("astray" if unplanned), "transfer", "symbol", "motion", "mode" or "ended".
    """

    first: float
    last: float
    text: str
    colour: str
    kind: str


@dataclass(frozen=True)
class Strip:
    """Spans in order of time.

    `key` is the path in a recording, which the viewer sorts alphabetically; `name` is the label on a page, or "".
    """

    key: str
    name: str
    spans: tuple[Span, ...]


def strips(view: RunView, *, until: float | None = None) -> tuple[Strip, ...]:
    """Return the strips of itinerary (planned and flown), symbols and modes that exist.

    Args:
        view: run to draw.
        until: planned end of the run, s; the plan's end by default.
    """
    begin, end = view.time_range
    due = view.plan.duration if until is None else until
    stopped = due is not None and end < due - 2 / view.rate_hz
    ended = (Span(end, due, "ended", style.FAINT, "ended"),) if due is not None and stopped else ()
    strips_of_run = []
    if view.plan.planned:
        between = [Span(a, b, "change of orbit", style.FAINT, "transfer") for a, b in view.plan.transfers]
        name = "near" if view.what == "walk" else "planned"
        strips_of_run.append(Strip("asked", name, (*_stays(view.plan.planned), *between)))
        if view.what not in ("reference", "walk"):
            strips_of_run.append(Strip("done", "done", (*_stays(view.done), *ended)))
    if view.plan.symbols:
        moments = [begin, *(at for at, _ in view.plan.symbols), end]
        names = ["before the first", *(f"{k + 1}: {name}" for k, (_, name) in enumerate(view.plan.symbols))]
        tints = [style.FAINT, *(style.RUNS[k % len(style.RUNS)] for k in range(len(view.plan.symbols)))]
        parts = zip(pairwise(moments), names, tints, strict=True)
        strips_of_run.append(
            Strip("symbol", "", tuple(Span(a, b, name, tint, "symbol") for (a, b), name, tint in parts))
        )
    if motions := tuple(_motions(view)):
        strips_of_run.append(Strip("motion", "motion", motions))
    if modes := tuple(Span(a, b, name, style.MODES.get(name, style.FAINT), "mode") for a, b, name in mode_spans(view)):
        strips_of_run.append(Strip("mode", "controller", (*modes, *ended)))
    return tuple(strips_of_run)


_MOTIONS = {
    RESUME: ("itinerary", style.MODES["holding"]),
    LAP: ("itinerary", style.MODES["holding"]),
    RETURN: ("braking", style.MODES["saturated"]),
    FLIGHT: ("flight", style.MODES["pulsing"]),
}
"""Activity of a run after an event, and its colour."""


def _motions(view: RunView) -> Iterator[Span]:
    """Yield the periods of a run by activity: on its itinerary, braking after a fall, or flying back."""
    changes = [event for event in view.events if event.name in _MOTIONS]
    if not any(event.name == RETURN for event in changes):
        return
    ends = [*(event.time for event in changes[1:]), view.time_range[1]]
    for event, end in zip(changes, ends, strict=True):
        if end > event.time:
            yield Span(event.time, end, *_MOTIONS[event.name], "motion")


def _stays(stays: tuple[Stay, ...]) -> Iterator[Span]:
    for stay in stays:
        colour = style.saddle_colour(stay.saddle) if stay.wanted else style.LIMIT
        yield Span(stay.first, stay.last, stay.text, colour, "stay" if stay.wanted else "astray")


def mode_spans(view: RunView) -> list[tuple[float, float, str]]:
    """Return start and end in s and name of each stretch of constant mode, "unknown mode" for other numbers."""
    if view.control is None or "mode" not in view.control:
        return []
    names = {float(mode): mode.name.lower() for mode in Mode}
    modes = np.nan_to_num(view.control["mode"], nan=-1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(modes) - 1]])
    return [
        (float(view.time[a]), float(view.time[b]), names.get(float(modes[a]), "unknown mode"))
        for a, b in zip(starts, ends, strict=True)
    ]


_TALL = 0.84
_WRONG = {"facecolor": "#f7d9d6", "edgecolor": style.LIMIT, "hatch": "xxxx"}
_BETWEEN = {"facecolor": "#eceef0", "edgecolor": style.FAINT, "hatch": "////"}
_BADGE: dict[str, Any] = {
    "ha": "center",
    "va": "center_baseline",
    "fontsize": style.SMALL,
    "color": "white",
    "zorder": 6,
    "bbox": {"boxstyle": "circle,pad=0.25", "facecolor": style.INK, "edgecolor": "none"},
}
"""Look of a symbol's number, white on a dark disc."""
_ROW = 0.24
_AROUND = 0.62


def add_story(page: Page, view: RunView, *, span: Range | None = None) -> None:
    """Add the strips of planned stays, decoded stays and modes to a page, if there are any.

    Args:
        page: page to extend.
        view: run to draw.
        span: displayed time range, s; by default that of the motion and its plan.
    """
    rows = [strip for strip in strips(view, until=None if span is None else span[1]) if strip.name]
    if rows:
        drawn = partial(_story, view=view, rows=rows, span=span or view.span, width=page.width)
        page.row(drawn, height=_AROUND + _ROW * len(rows))


def _width(text: str, second: float) -> float:
    """Return the time that a text takes, s, at a scale of `second` seconds per inch."""
    return (text_width(text, style.SMALL) + 0.08) * second


def _story(axes: Axes, view: RunView, rows: list[Strip], span: Range, width: float) -> None:
    begin, end = span
    second = (end - begin) / (width - 1.2)
    marks = {"done": [done for _, _, done in view.symbols if done is not None]}
    marks[rows[0].name] = [planned for _, planned, _ in view.symbols]
    for place, strip in enumerate(reversed(rows)):
        for part in strip.spans:
            _part(axes, part, place, second, marks=marks.get(strip.name, []), mode=strip.name == "controller")
    _numbers(axes, view, [strip.name for strip in rows], span, second)
    axes.set(
        xlim=(begin, end),
        ylim=(-0.08, len(rows) + 0.02),
        yticks=[place + _TALL / 2 for place in range(len(rows))],
        yticklabels=[strip.name for strip in reversed(rows)],
    )
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("time (s)" if view.arm_lengths else "time", loc="left", labelpad=0)
    axes.spines["left"].set_visible(False)
    axes.grid(False)


def _part(axes: Axes, part: Span, place: int, second: float, *, marks: list[float], mode: bool) -> None:
    """Draw a span of a strip, with its text if this has room between the symbols' marks, s."""
    # A mode of one tick, as at an end, is widened to remain visible.
    width = max(part.last - part.first, (0.06 if part.kind == "mode" else 0.04) * second)
    first = part.last - width if part.kind == "mode" else part.first
    look = {"astray": _WRONG, "transfer": _BETWEEN, "ended": _BETWEEN}.get(part.kind, {"facecolor": part.colour})
    axes.broken_barh([(first, width)], (place, _TALL), linewidth=0, **look)  # type: ignore[arg-type]
    ended = "" if mode else f"the run ended at {part.first:.2f} s"
    text = ended if part.kind == "ended" else part.text
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
    """Number the symbols at their planned and actual times, and name them above if there is room."""
    begin, end = span
    free, last, named = begin, -1e9, []
    for i, (name, planned, done) in enumerate(view.symbols):
        for row, moment in ((rows[0], planned), ("done", done)):
            if row in rows and moment is not None and begin <= moment <= end:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == rows[0] and moment - last > 0.2 * second:
                    axes.text(moment, place + _TALL / 2, str(i + 1), **_BADGE)
                    last = moment
        half = _width(name, second) / 2
        left = min(max(planned - half, begin), end - 2 * half)
        if left > free and begin <= planned <= end:
            named.append((left + half, name))
            free = left + 2 * half
    look = {"ha": "center", "va": "bottom", "fontsize": style.SMALL, "color": style.INK}
    # A few names would not tell to which of many motions they belong.
    for middle, name in named if 2 * len(named) >= len(view.symbols) else ():
        axes.text(middle, len(rows) - 0.02, name, **look)  # type: ignore[arg-type]
