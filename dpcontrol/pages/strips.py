"""Strips of named spans of time: itinerary, modes and symbols."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dpcontrol.judge.run_view import RunView, Stay
from dpcontrol.logs import FLIGHT, LAP, RESUME, RETURN, Mode
from dpcontrol.pages import style


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
    """Return the strips of itinerary, symbols and modes that exist.

    The itinerary has a planned and a flown strip.

    Args:
        view: run to draw.
        until: planned end of the run, s; the plan's end by default.
    """
    begin, end = view.time_range
    due = view.plan.duration if until is None else until
    stopped = due is not None and end < due - 2 / view.rate_hz
    ended = (Span(end, due, "ended", style.FAINT, "ended"),) if due is not None and stopped else ()
    found = []
    if view.plan.planned:
        between = [Span(a, b, "change of orbit", style.FAINT, "transfer") for a, b in view.plan.transfers]
        name = "near" if view.what == "walk" else "planned"
        found.append(Strip("asked", name, (*_stays(view.plan.planned), *between)))
        if view.what not in ("reference", "walk"):
            found.append(Strip("done", "done", (*_stays(view.done), *ended)))
    if view.plan.symbols:
        moments = [begin, *(at for at, _ in view.plan.symbols), end]
        names = ["before the first", *(f"{k + 1}: {name}" for k, (_, name) in enumerate(view.plan.symbols))]
        tints = [style.FAINT, *(style.RUNS[k % len(style.RUNS)] for k in range(len(view.plan.symbols)))]
        parts = zip(pairwise(moments), names, tints, strict=True)
        found.append(Strip("symbol", "", tuple(Span(a, b, name, tint, "symbol") for (a, b), name, tint in parts)))
    if motions := tuple(_motions(view)):
        found.append(Strip("motion", "motion", motions))
    modes = tuple(Span(a, b, name, style.MODES.get(name, style.FAINT), "mode") for a, b, name in mode_spans(view))
    if modes:
        found.append(Strip("mode", "controller", (*modes, *ended)))
    return tuple(found)


_MOTIONS = {
    RESUME: ("itinerary", style.MODES["holding"]),
    LAP: ("itinerary", style.MODES["holding"]),
    RETURN: ("braking", style.MODES["saturated"]),
    FLIGHT: ("flight", style.MODES["pulsing"]),
}
"""Activity of a run after an event, and its colour."""


def _motions(view: RunView) -> Iterator[Span]:
    """Yield the periods of a run by activity.

    The run is on its itinerary, brakes after a fall, or flies back.
    """
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
    """Return start, end and name of each stretch of constant mode.

    Times are in s. Other numbers are "unknown mode".
    """
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
