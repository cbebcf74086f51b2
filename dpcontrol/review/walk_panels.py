"""The flat panels of a walk's picture: symbols over time, coordinates, distances, the arms' film."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from dpcontrol.review import style
from dpcontrol.review.film import draw_arms
from dpcontrol.review.panel_frame import angle_axis, badge, legend, mark_times, quiet
from dpcontrol.review.series import arm_points
from dpcontrol.review.walk_story import NEAR, WalkStory, Wobble, symbol_text

Array = NDArray[np.float64]

FILM_SYMBOLS = 48
NAMED = 20
"""Symbols that have room for a name beside their number."""
FRAME_STEP = 1.85
"""Between poses, in lengths of all arms: two stretched towards one another are rarer than in a run's film of eight."""
ROW_STEP = 3.05
"""Between the film's rows, in the same length."""


def timeline(axes: Axes, story: WalkStory) -> None:
    """Draw the symbols over time: stops as coloured spans with their wraps, symbols numbered at their sections."""
    for start, end, saddle in story.near():
        axes.axvspan(start, end, ymin=0.0, ymax=0.52, color=style.saddle_colour(saddle), alpha=0.85, linewidth=0)
    many = len(story.orbit.symbol_times) > NAMED
    apart = float(np.diff(story.orbit.symbol_times, append=np.inf).min()) / story.orbit.duration
    tight = apart < 0.09
    for wobble in story.wobbles():
        text = _count_text(wobble)
        axes.text(
            (wobble.start + wobble.end) / 2, 0.26, text, ha="center", va="center_baseline", fontsize=7 if many else 9,
            weight="bold", color="white" if _is_near(story, wobble) else style.INK, zorder=5,
        )  # fmt: skip
    for k, (time, connection) in enumerate(zip(story.orbit.symbol_times, story.orbit.connections, strict=True)):
        axes.plot([time, time], [0.0, 0.62], color=style.INK, linewidth=1.0)
        badge(axes, k + 1, time, 0.74, size=6 if many else 7.5)
        if not many:
            text = symbol_text(connection).replace(" > ", " >\n")
            text = text.replace(" ", "\n") if tight and "\n" not in text else text
            axes.text(
                time, 1.05, text, ha="center", va="bottom", fontsize=6 if tight else 7.5, color=style.INK,
                linespacing=1.1,
            )  # fmt: skip
    axes.set_xlim(0.0, story.orbit.duration)
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.tick_params(labelbottom=False, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.8)
    handles = [Patch(color=style.saddle_colour(s), alpha=0.85, label=f"wobbles about {s}") for s in story.saddles]
    axes.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.005, 1.05 if many else 1.72), ncols=len(handles),
        fontsize=8.5, frameon=False, handlelength=1.2, columnspacing=1.2, borderpad=0, borderaxespad=0.0,
    )  # fmt: skip
    axes.set_title(
        "Symbols over time; 2× means two wobbles at a stop" + (", ↻ closes the walk" if story.orbit.periodic else ""),
        loc="left", fontsize=10, color=style.INK,
        y=1.0 if many else 1.67, pad=4,
    )  # fmt: skip


def _count_text(wobble: Wobble) -> str:
    return f"{wobble.wraps}×" + (" ↻" if wobble.closing else "")


def _is_near(story: WalkStory, wobble: Wobble) -> bool:
    """Whether the middle of a stop lies on a coloured span."""
    middle = (wobble.start + wobble.end) / 2
    return any(start < middle < end for start, end, _ in story.near())


def coordinates(axes: Axes, story: WalkStory) -> None:
    """Draw the angles over time in units of π, whole turns counted; positions for a system without angles."""
    count = story.states.shape[1] // 2
    names = ("θ₁ inner arm", "θ₂ outer arm") if story.has_angles else ("x", "y")
    for k in range(count):
        axes.plot(story.times, story.states[:, k], color=style.arm_colour(k), linewidth=1.3)
    quiet(axes, "Angles from hanging, whole turns counted" if story.has_angles else "Position")
    if story.has_angles:
        axes.margins(y=0.06)
        angle_axis(axes, "y")
    legend(axes, [(name, {"color": style.arm_colour(k)}) for k, name in enumerate(names[:count])])
    mark_times(axes, list(story.orbit.symbol_times))


def distances(axes: Axes, story: WalkStory) -> None:
    """Draw how near the orbit comes to the periodic orbits: a line for each, logarithmic."""
    for saddle in story.saddles:
        axes.plot(
            story.times, np.maximum(story.distances[saddle], 1e-16), color=style.saddle_colour(saddle), linewidth=1.2
        )
    axes.set_yscale("log")
    axes.axhline(NEAR, color=style.FAINT, linewidth=1.0, linestyle=(0, (5, 3)))
    quiet(axes, "Distance from the periodic orbits (scaled); wobbles are counted below the dashed line")
    axes.yaxis.set_major_locator(LogLocator(base=10, numticks=6))
    axes.set_ylim(top=2.0)
    mark_times(axes, list(story.orbit.symbol_times))


def film_shape(story: WalkStory) -> tuple[int, int, int]:
    """Return (rows, symbols in a row, poses of a symbol) of the film."""
    count = min(len(story.orbit.symbol_times), FILM_SYMBOLS)
    poses = 9 if count == 1 else 7 if count == 2 else 5 if count <= 6 else 3 if count <= 16 else 1
    rows = int(np.ceil(count * poses / 18))
    return rows, int(np.ceil(count / rows)), poses


def film(axes: Axes, story: WalkStory) -> None:
    """Draw the arms at some instants of each symbol, and their tip's path since the instant before."""
    assert story.arm_lengths is not None
    lengths = story.arm_lengths
    reach = sum(lengths)
    step = FRAME_STEP * reach
    _, across, poses = film_shape(story)
    for k in range(min(len(story.orbit.symbol_times), FILM_SYMBOLS)):
        row, place = divmod(k, across)
        connection, time = story.orbit.connections[k], float(story.orbit.symbol_times[k])
        first, last = time - 0.55 * connection.time_out, time + 0.55 * connection.time_in
        instants = np.linspace(first, last, poses) if poses > 1 else np.array([time])
        pace = (last - first) / max(poses - 1, 2)
        top = -row * ROW_STEP * reach
        left = place * (poses + 0.35) * step
        for i, instant in enumerate(instants):
            at = left + i * step
            moments = np.linspace(instant - pace, instant, 40)
            points = arm_points(story.orbit.sample(moments)[:, : len(lengths)], lengths)
            draw_arms(axes, points + np.array([at, top]), size=0.85)
            axes.text(at, top - 1.1 * reach, f"{instant:.2f}", ha="center", va="top", fontsize=7, color=style.NOTE)
        badge(axes, k + 1, left - 0.35 * step, top + 1.24 * reach)
        words = symbol_text(connection)
        axes.text(
            left - 0.35 * step, top + 1.24 * reach, f"     {words}" if poses > 1 else "      " + words.split(" > ")[0],
            va="center_baseline", fontsize=8.5 if poses > 1 else 7, color=style.INK,
        )  # fmt: skip
        if place:
            rule = left - 0.675 * step
            axes.plot([rule, rule], [top - 1.2 * reach, top + 1.4 * reach], color=style.FAINT, linewidth=0.8)
    rows = film_shape(story)[0]
    axes.set_xlim(-0.55 * step, (across * (poses + 0.35) - 0.85) * step)
    axes.set_ylim(-(rows - 1) * ROW_STEP * reach - 1.4 * reach, 1.5 * reach)
    axes.axis("off")
