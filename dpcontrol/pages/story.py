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
    """A stretch of a strip, from the time `first` to `last`, s, with its text and colour.

    Its kind is "stay" ("astray" if unplanned), "transfer", "symbol", "motion", "mode" or "ended".
    """

    first: float
    last: float
    text: str
    colour: str
    kind: str


@dataclass(frozen=True)
class Strip:
    """One line of a run's story: its spans in order of time.

    `key` is the path in a recording, which the viewer sorts alphabetically; `name` is the label on a page, or "".
    """

    key: str
    name: str
    spans: tuple[Span, ...]


def strips(view: RunView, *, until: float | None = None) -> tuple[Strip, ...]:
    """Return the strips of a run's story that exist: planned and done itinerary, symbols, activities, and modes.

    Their keys are "asked" and "done" for the stays as planned and as decoded, "symbol" for the spans between symbols,
    "motion" for activities after falls, and "mode" for the controller's modes.

    Args:
        view: run to draw.
        until: planned end of the run, s; the plan's end by default.
    """
    begin, end = view.time_range
    planned_end = view.plan.duration if until is None else until
    # Two periods are allowed for, because the last tick of a complete run precedes the planned end.
    stopped = planned_end is not None and end < planned_end - 2 / view.rate_hz
    ended = (Span(end, planned_end, "ended", style.FAINT, "ended"),) if planned_end is not None and stopped else ()
    strips_of_run = []
    if view.plan.planned:
        between = [
            Span(span_start, span_end, "change of orbit", style.FAINT, "transfer")
            for span_start, span_end in view.plan.transfers
        ]
        name = "near" if view.what == "walk" else "planned"
        strips_of_run.append(Strip("asked", name, (*_stays(view.plan.planned), *between)))
        if view.what not in ("reference", "walk"):
            strips_of_run.append(Strip("done", "done", (*_stays(view.done), *ended)))
    if view.plan.symbols:
        moments = [begin, *(moment for moment, _ in view.plan.symbols), end]
        names = ["before the first", *(f"{k + 1}: {name}" for k, (_, name) in enumerate(view.plan.symbols))]
        tints = [style.FAINT, *(style.RUNS[k % len(style.RUNS)] for k in range(len(view.plan.symbols)))]
        spans = zip(pairwise(moments), names, tints, strict=True)
        strips_of_run.append(
            Strip(
                "symbol",
                "",
                tuple(Span(span_start, span_end, name, tint, "symbol") for (span_start, span_end), name, tint in spans),
            )
        )
    if motions := tuple(_motions(view)):
        strips_of_run.append(Strip("motion", "motion", motions))
    if modes := tuple(
        Span(span_start, span_end, name, style.MODES.get(name, style.FAINT), "mode")
        for span_start, span_end, name in mode_spans(view)
    ):
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
    """Yield the periods of a run by activity: on its itinerary, braking after a fall, or flying back.

    A run without a fall has none, because it is on its itinerary throughout.
    """
    motion_events = [event for event in view.events if event.name in _MOTIONS]
    if not any(event.name == RETURN for event in motion_events):
        return
    ends = [*(event.time for event in motion_events[1:]), view.time_range[1]]
    for event, end in zip(motion_events, ends, strict=True):
        if end > event.time:
            yield Span(event.time, end, *_MOTIONS[event.name], "motion")


def _stays(stays: tuple[Stay, ...]) -> Iterator[Span]:
    """Yield stays as spans in the colours of their saddles; stays that the plan does not contain are red.

    A stay is a period of time near the orbit about a saddle, or at rest at it.
    """
    for stay in stays:
        colour = style.saddle_colour(stay.saddle) if stay.wanted else style.LIMIT
        yield Span(stay.first, stay.last, stay.text, colour, "stay" if stay.wanted else "astray")


def mode_spans(view: RunView) -> list[tuple[float, float, str]]:
    """Return the stretches of constant mode of the controller, each with start and end in s and the mode's name.

    A number that is no mode is called "unknown mode".

    Args:
        view: run with or without modes.
    """
    if view.control is None or "mode" not in view.control:
        return []
    names = {float(mode): mode.name.lower() for mode in Mode}
    modes = np.nan_to_num(view.control["mode"], nan=-1.0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(modes) - 1]])
    return [
        (float(view.time[start]), float(view.time[end]), names.get(float(modes[start]), "unknown mode"))
        for start, end in zip(starts, ends, strict=True)
    ]


_TALL = 0.84
"""Height of a strip, where rows are 1 apart."""
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
"""Heights of a row, and of the time axis with the symbols' names, inches."""


def add_story(page: Page, view: RunView, *, span: Range | None = None) -> None:
    """Add the strips of planned stays, decoded stays and modes to a page, if there are any.

    Args:
        page: page to extend.
        view: run to draw.
        span: displayed time range, s; by default that of the motion and its plan.
    """
    rows = [strip for strip in strips(view, until=None if span is None else span[1]) if strip.name]
    if rows:
        draw_story = partial(_story, view=view, rows=rows, span=span or view.span, width=page.width)
        page.row(draw_story, height=_AROUND + _ROW * len(rows))


def _width(text: str, second: float) -> float:
    """Return the duration that a text covers on the time axis, s, with a small margin.

    Args:
        text: text in the smallest type.
        second: scale of the axis, s per inch.
    """
    return (text_width(text, style.SMALL) + 0.08) * second


def _story(axes: Axes, view: RunView, rows: list[Strip], span: Range, width: float) -> None:
    """Draw the strips of a run below one another over time, with the symbols' times, numbers and names.

    Args:
        axes: panel to draw on.
        view: run with the symbols.
        rows: strips, the first at the top.
        span: displayed time range, s.
        width: width of the page, inches.
    """
    begin, end = span
    # The names of the strips take the rest of the width.
    seconds_per_inch = (end - begin) / (width - 1.2)
    # Times of the symbols' marks by the name of their strip: the first has the planned times, "done" the actual ones.
    symbol_times = {"done": [done for _, _, done in view.symbols if done is not None]}
    symbol_times[rows[0].name] = [planned for _, planned, _ in view.symbols]
    for place, strip in enumerate(reversed(rows)):
        for stretch in strip.spans:
            _part(
                axes,
                stretch,
                place,
                seconds_per_inch,
                marks=symbol_times.get(strip.name, []),
                mode=strip.name == "controller",
            )
    _numbers(axes, view, [strip.name for strip in rows], span, seconds_per_inch)
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
    """Draw a span of a strip, with its text if it has room for it and no symbol's mark crosses the text.

    Args:
        axes: panel of the story.
        part: span to draw.
        place: height of the strip's lower edge.
        second: scale of the time axis, s per inch.
        marks: times of the symbols' marks on this strip, s.
        mode: True for a strip of modes, whose end gets no text.
    """
    # A mode of one tick, as at an end, is widened to remain visible.
    width = max(part.last - part.first, (0.06 if part.kind == "mode" else 0.04) * second)
    first = part.last - width if part.kind == "mode" else part.first
    look = {"astray": _WRONG, "transfer": _BETWEEN, "ended": _BETWEEN}.get(part.kind, {"facecolor": part.colour})
    axes.broken_barh([(first, width)], (place, _TALL), linewidth=0, **look)  # type: ignore[arg-type]
    end_text = "" if mode else f"the run ended at {part.first:.2f} s"
    text = end_text if part.kind == "ended" else part.text
    middle, text_duration = first + width / 2, _width(text, second)
    marked = any(abs(mark - middle) < text_duration / 2 + 0.1 * second for mark in marks)
    if not text or marked or width < text_duration:
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
    """Mark the symbols at their planned and actual times, number the planned ones, and name them if there is room.

    `view.symbols` has the name of each symbol, its planned time and its actual one, s, or None if it was not done. A
    number or a name that would overlap the one before is left out.

    Args:
        axes: panel of the story.
        view: run with the symbols.
        rows: names of the strips, from the top; the first has the planned times, "done" the actual ones.
        span: displayed time range, s.
        second: scale of the time axis, s per inch.
    """
    begin, end = span
    free_from, last_badge, names = begin, -1e9, []
    for i, (name, planned, done) in enumerate(view.symbols):
        for row, moment in ((rows[0], planned), ("done", done)):
            if row in rows and moment is not None and begin <= moment <= end:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == rows[0] and moment - last_badge > 0.2 * second:
                    axes.text(moment, place + _TALL / 2, str(i + 1), **_BADGE)
                    last_badge = moment
        half_width = _width(name, second) / 2
        left = min(max(planned - half_width, begin), end - 2 * half_width)
        if left > free_from and begin <= planned <= end:
            names.append((left + half_width, name))
            free_from = left + 2 * half_width
    look = {"ha": "center", "va": "bottom", "fontsize": style.SMALL, "color": style.INK}
    # If only a few of many symbols are named, the reader cannot match the names.
    for middle, name in names if 2 * len(names) >= len(view.symbols) else ():
        axes.text(middle, len(rows) - 0.02, name, **look)  # type: ignore[arg-type]
