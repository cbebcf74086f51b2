"""Panels of the drawn picture that tell the story: the itinerary as asked and as done, the controller, the events."""

from textwrap import shorten
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext, Stay
from dpcontrol.review.motion import Motion
from dpcontrol.review.panel_frame import NOTE, SMALL

_LETTER = 0.0052
"""Width of a letter as a share of the strip's."""
_TALL = 0.84
_WRONG = "#f7d9d6"
_BETWEEN = "#eceef0"


def story_rows(motion: Motion, context: ReviewContext) -> list[str]:
    """Return the rows that the story has, from above."""
    rows = ["asked"] if context.planned else []
    rows += ["done"] if context.planned and motion.what != "reference" else []
    return rows + (["controller"] if series.mode_spans(motion) else [])


def story(
    axes: Axes,
    motion: Motion,
    context: ReviewContext,
    *,
    span: tuple[float, float] | None = None,
    legend: bool = True,
) -> None:
    """Draw over time, one below the other: stays as planned, as decoded from the angles, and the controller's modes.

    span: of time in s to show, if not the motion's and its plan's.
    """
    rows = story_rows(motion, context)
    begin, end = span or (motion.time_range[0], max(motion.time_range[1], context.duration or motion.time_range[1]))
    letter = _LETTER * (end - begin)
    stopped = float(motion.time[-1])
    for place, row in enumerate(reversed(rows)):
        for stay in {"asked": context.planned, "done": context.done}.get(row, ()):
            _stay(axes, stay, place, letter=letter)
        if row == "asked":
            for first, last in context.transfers:
                busy = any(first <= moment <= last for moment, _ in context.symbols)
                text = "" if busy or last - first < 16 * letter else "change of orbit"
                _between(axes, first, last, place, text=text)
        if row == "controller":
            for first, last, name in series.mode_spans(motion):
                # A mode of one tick, as at an end, is drawn wide enough to be seen.
                width = max(last - first, 0.004 * (end - begin))
                colour = style.MODES.get(name, style.FAINT)
                axes.broken_barh([(min(first, end - width), width)], (place, _TALL), color=colour, linewidth=0)
        if row != "asked" and end - stopped > 0.01 * (end - begin):
            text = f"the run ended at {stopped:.2f} s" if row == "done" and end - stopped > 24 * letter else ""
            _between(axes, stopped, end, place, text=text)
    _numbers(axes, context, rows, letter=letter, begin=begin, end=end)
    axes.set_xlim(begin, end)
    axes.set_ylim(-0.08, len(rows) + 0.02)
    axes.set_yticks([place + _TALL / 2 for place in range(len(rows))], list(reversed(rows)))
    axes.tick_params(labelsize=SMALL, colors=NOTE, length=2.5)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("time (s)", fontsize=SMALL, color=NOTE, loc="left", labelpad=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(style.FAINT)
    if legend:
        _legend(axes, motion, context)


def _stay(axes: Axes, stay: Stay, place: int, *, letter: float) -> None:
    width = max(stay.last - stay.first, letter / 2)
    colour = style.saddle_colour(stay.saddle)
    wrong = {"facecolor": _WRONG, "edgecolor": style.LIMIT, "hatch": "xxxx"}
    look: dict[str, Any] = {"facecolor": colour} if stay.wanted else wrong
    axes.broken_barh([(stay.first, width)], (place, _TALL), linewidth=0, **look)
    if width > letter * (len(stay.text) + 1):
        axes.text(
            stay.first + width / 2,
            place + _TALL / 2,
            stay.text,
            ha="center",
            va="center_baseline",
            fontsize=SMALL,
            color="white" if stay.wanted else style.LIMIT,
            bbox=None if stay.wanted else {"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            clip_on=True,
            zorder=4,
        )


def _between(axes: Axes, first: float, last: float, place: int, *, text: str) -> None:
    axes.broken_barh(
        [(first, last - first)], (place, _TALL), facecolor=_BETWEEN, edgecolor=style.FAINT, hatch="////", linewidth=0
    )
    if text:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        middle = (first + last) / 2
        axes.text(
            middle,
            place + _TALL / 2,
            text,
            ha="center",
            va="center_baseline",
            fontsize=SMALL,
            color=NOTE,
            bbox=box,
            zorder=4,
        )


def _numbers(axes: Axes, context: ReviewContext, rows: list[str], *, letter: float, begin: float, end: float) -> None:
    """Number the symbols where they are planned and where they were done; name those that have room above."""
    actual = (*context.crossings, *[None] * len(context.symbols))
    free = begin
    for i, ((planned, name), done) in enumerate(zip(context.symbols, actual, strict=False)):
        for row, moment in (("asked", planned), ("done", done)):
            if row in rows and moment is not None:
                place = len(rows) - 1 - rows.index(row)
                axes.plot([moment, moment], [place, place + _TALL], color=style.INK, linewidth=1.4, zorder=4.5)
                if row == "asked":
                    _badge(axes, i + 1, moment, place)
        half = letter * len(name) / 2
        left = min(max(planned - half, begin), end - 2 * half)
        if "asked" in rows and left > free:
            axes.text(left + half, len(rows) - 0.02, name, ha="center", va="bottom", fontsize=SMALL, color=style.INK)
            free = left + 2 * half + letter


def _badge(axes: Axes, number: int, moment: float, place: int) -> None:
    axes.text(
        moment,
        place + _TALL / 2,
        str(number),
        ha="center",
        va="center_baseline",
        fontsize=7.5,
        color="white",
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": style.INK, "edgecolor": "none"},
        zorder=5,
    )


def _legend(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    shown = dict.fromkeys(name for _, _, name in series.mode_spans(motion))
    handles = [Patch(color=style.MODES.get(name, style.FAINT), label=name) for name in shown]
    if any(not stay.wanted for stay in context.done):
        handles.append(Patch(facecolor=_WRONG, edgecolor=style.LIMIT, hatch="xxxx", linewidth=0, label="not asked for"))
    if handles:
        axes.legend(
            handles=handles,
            loc="upper right",
            bbox_to_anchor=(1.0, -0.28 / max(len(story_rows(motion, context)), 1)),
            ncols=len(handles),
            fontsize=SMALL,
            frameon=False,
            handlelength=1.2,
            handleheight=0.9,
            columnspacing=1.2,
            borderpad=0,
            borderaxespad=0.9,
        )


def notes(axes: Axes, motion: Motion, context: ReviewContext, *, lines: int) -> None:
    """Write the symbols with their times, then the events, as many as there is room for."""
    axes.axis("off")
    text = [("Itinerary: planned → done (s)", True)] if context.symbols else []
    actual = (*context.crossings, *[None] * len(context.symbols))
    for i, ((at, name), done) in enumerate(zip(context.symbols, actual, strict=False)):
        seen = "" if done is None else f" → {done:.2f}"
        text.append((f"{i + 1}  {shorten(name, 40, placeholder=' …')}   {at:.2f}{seen}", False))
    most = lines // 2 - 1
    if len(text) > most + 1:
        hidden = len(text) - most
        text = [*text[:most], (f"… and {hidden} more", False)]
    text += [("", False), ("Events", True)] if text else [("Events", True)]
    events = [(f"{event.time:7.2f} s  {event.text}", False) for event in motion.events]
    room = max(1, lines - len(text))
    if len(events) > room:
        # The end tells how the run went; the start, what it was.
        events = [events[0], (f"… {len(events) - room + 1} more …", False), *events[len(events) - room + 2 :]]
    text += events or [("none", False)]
    for row, (line, heading) in enumerate(text):
        axes.text(
            0.0,
            1.0 - row / lines,
            line if len(line) < 68 else line[:66] + "…",
            transform=axes.transAxes,
            va="top",
            fontsize=9.5 if heading else SMALL,
            color=style.INK if heading else NOTE,
        )
