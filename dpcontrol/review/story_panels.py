"""Panels of a page that tell what happened: the itinerary as asked and as done, the controller, the events."""

from textwrap import shorten

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from dpcontrol.review import style
from dpcontrol.review.motion import RunView
from dpcontrol.review.panel_frame import SMALL, badge
from dpcontrol.review.series import Range, Span, Strip, strips

_LETTER = 0.0052
"""Width of a letter as a share of the strip's."""
_TALL = 0.84
_WRONG = {"facecolor": "#f7d9d6", "edgecolor": style.LIMIT, "hatch": "xxxx"}
_BETWEEN = {"facecolor": "#eceef0", "edgecolor": style.FAINT, "hatch": "////"}


def story_rows(view: RunView, *, span: Range | None = None) -> list[Strip]:
    """Return the rows that the story has, from above."""
    return [strip for strip in strips(view, until=None if span is None else span[1]) if strip.name]


def story(axes: Axes, view: RunView, *, span: Range | None = None, legend: bool = True) -> None:
    """Draw over time, one below the other: stays as planned, as decoded from the angles, and the controller's modes.

    span: of time in s to show, if not the motion's and its plan's.
    """
    rows = story_rows(view, span=span)
    begin, end = span or view.span
    letter = _LETTER * (end - begin)
    for place, strip in enumerate(reversed(rows)):
        for part in strip.spans:
            _part(axes, part, place, view, letter=letter, named=strip.name != "controller")
    _numbers(axes, view, [strip.name for strip in rows], letter=letter, begin=begin, end=end)
    axes.set_xlim(begin, end)
    axes.set_ylim(-0.08, len(rows) + 0.02)
    axes.set_yticks([place + _TALL / 2 for place in range(len(rows))], [strip.name for strip in reversed(rows)])
    axes.tick_params(labelsize=SMALL, colors=style.NOTE, length=2.5)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(
        "time (s)" if view.arm_lengths else "time", fontsize=SMALL, color=style.NOTE, loc="left", labelpad=0
    )
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(style.FAINT)
    if legend:
        _legend(axes, rows)


def _part(axes: Axes, part: Span, place: int, view: RunView, *, letter: float, named: bool) -> None:
    """Draw a span of a strip, with its text where there is room."""
    # A mode of one tick, as at an end, is drawn wide enough to be seen.
    width = max(part.last - part.first, letter * (0.8 if part.kind == "mode" else 0.5))
    first = part.last - width if part.kind == "mode" else part.first
    look = {"astray": _WRONG, "transfer": _BETWEEN, "ended": _BETWEEN}.get(part.kind, {"facecolor": part.colour})
    axes.broken_barh([(first, width)], (place, _TALL), linewidth=0, **look)  # type: ignore[arg-type]
    text = {"mode": "", "ended": f"the run ended at {part.first:.2f} s" if named else ""}.get(part.kind, part.text)
    crossed = part.kind == "transfer" and any(part.first <= at <= part.last for at, _ in view.plan.symbols)
    if text and not crossed and width > letter * (len(text) + 1):
        colour = {"stay": "white", "astray": style.LIMIT}.get(part.kind, style.NOTE)
        box = None if part.kind == "stay" else {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(
            first + width / 2, place + _TALL / 2, text, ha="center", va="center_baseline", fontsize=SMALL,
            color=colour, bbox=box, clip_on=True, zorder=4,
        )  # fmt: skip


def _numbers(axes: Axes, view: RunView, rows: list[str], *, letter: float, begin: float, end: float) -> None:
    """Number the symbols where they are planned and where they were done; name those that have room above."""
    free = begin
    for i, (name, planned, done) in enumerate(view.symbols):
        for row, moment in ((rows[0], planned), ("done", done)):
            if row in rows and moment is not None:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == rows[0]:
                    badge(axes, i + 1, moment, place + _TALL / 2)
        half = letter * len(name) / 2
        left = min(max(planned - half, begin), end - 2 * half)
        if left > free:
            axes.text(left + half, len(rows) - 0.02, name, ha="center", va="bottom", fontsize=SMALL, color=style.INK)
            free = left + 2 * half + letter


def _legend(axes: Axes, rows: list[Strip]) -> None:
    every = [part for strip in rows for part in strip.spans]
    shown = {part.text: part.colour for part in every if part.kind == "mode"}
    handles = [Patch(color=colour, label=name) for name, colour in shown.items()]
    if any(part.kind == "astray" for part in every):
        handles.append(Patch(**_WRONG, linewidth=0, label="not asked for"))  # type: ignore[arg-type]
    if handles:
        axes.legend(
            handles=handles, loc="upper right", bbox_to_anchor=(1.0, -0.28 / max(len(rows), 1)), ncols=len(handles),
            fontsize=SMALL, frameon=False, handlelength=1.2, handleheight=0.9, columnspacing=1.2, borderpad=0,
            borderaxespad=0.9,
        )  # fmt: skip


def notes(axes: Axes, view: RunView, *, lines: int) -> None:
    """Write the symbols with their times, then the events, as many as there is room for."""
    axes.axis("off")
    if not view.symbols and not view.events:
        return
    text = [("Itinerary: planned → done (s)", True)] if view.symbols else []
    for i, (name, at, done) in enumerate(view.symbols):
        seen = "" if done is None else f" → {done:.2f}"
        text.append((f"{i + 1}  {shorten(name, 40, placeholder=' …')}   {at:.2f}{seen}", False))
    most = lines // 2 - 1
    if len(text) > most + 1:
        hidden = len(text) - most
        text = [*text[:most], (f"… and {hidden} more", False)]
    text += [("", False), ("Events", True)] if text else [("Events", True)]
    events = [(f"{event.time:7.2f} s  {event.text}", False) for event in view.events]
    room = max(1, lines - len(text))
    if len(events) > room:
        # The end tells how the run went; the start, what it was.
        events = [events[0], (f"… {len(events) - room + 1} more …", False), *events[len(events) - room + 2 :]]
    text += events or [("none", False)]
    for row, (line, heading) in enumerate(text):
        axes.text(
            0.0, 1.0 - row / lines, line if len(line) < 68 else line[:66] + "…", transform=axes.transAxes, va="top",
            fontsize=9.5 if heading else SMALL, color=style.INK if heading else style.NOTE,
        )  # fmt: skip
