"""What every panel of a drawn picture is made of: a quiet frame, a legend above it, curves, limits, angles in π."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion

Array = NDArray[np.float64]

SMALL = 8.5
NOTE = "#555c64"
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def prepare(axes: Axes, label: str) -> None:
    """Set a panel's title and its quiet frame and grid."""
    axes.set_title(label, loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.tick_params(labelsize=SMALL, colors=NOTE, length=2.5)
    axes.grid(color="#e6e9ec", linewidth=0.7)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.FAINT)
    axes.margins(x=0)


def legend(axes: Axes, entries: list[tuple[str, dict]]) -> None:
    """Put a legend on one line above the panel, right, where it cannot cover a curve."""
    handles = [Line2D([], [], label=label, **look) for label, look in entries]
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.005, 1.0),
        ncols=len(handles),
        fontsize=SMALL,
        frameon=False,
        handlelength=1.5,
        columnspacing=1.1,
        handletextpad=0.5,
        borderpad=0,
        borderaxespad=0.1,
    )


def number(i: int) -> str:
    """Return the number of an arm, counted from zero, as a subscript from one."""
    return str(i + 1).translate(_SUBSCRIPTS)


def in_pi(value: float, *, digits: int = 3) -> str:
    """Return a number of half turns as text."""
    if abs(value) < 1e-9:
        return "0"
    text = f"{value:.{digits}g}"
    return {"1": "π", "-1": "−π"}.get(text, f"{text}π".replace("-", "−"))


def label_in_pi(axis: Axis) -> None:
    """Label an axis of half turns, with as many digits as tell its ends apart."""

    def text(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        largest = max(abs(low), abs(high))
        finest = np.log10(largest / (high - low)) if high > low else 0.0
        return in_pi(value, digits=3 + max(0, int(np.ceil(finest))))

    axis.set_major_formatter(FuncFormatter(text))


def plot(axes: Axes, motion: Motion, values: Array, **look: object) -> None:
    """Draw a series of a motion over time."""
    axes.plot(*series.curve(motion, values), **look)  # type: ignore[arg-type]


def ghost(colour: str = style.REFERENCE) -> dict[str, object]:
    """Return the look of a reference's curve: broad and pale, behind what follows it."""
    return {"color": colour, "alpha": 0.3, "linewidth": 4.5}


def mark_symbols(axes: Axes, motion: Motion, context: ReviewContext) -> None:
    """Mark the symbols' planned crossings with a dotted line."""
    for moment in shown_moments(motion, context).values():
        axes.axvline(moment, color="#7a828b", linewidth=0.9, linestyle=(0, (2, 2)), zorder=1.5)


def shown_moments(motion: Motion, context: ReviewContext) -> dict[int, float]:
    """Return the planned crossings within the motion's time, by symbol counted from zero."""
    moments = {i: moment for i, (moment, _) in enumerate(context.symbols)}
    return {i: moment for i, moment in moments.items() if motion.time[0] <= moment <= motion.time[-1]}


def limit_lines(axes: Axes, limit: float) -> None:
    """Draw a limit on either side, and shade what lies beyond, where the curves come near it."""
    low, high = axes.get_ylim()
    for sign in (-1, 1):
        value = sign * limit
        if low - 0.35 * (high - low) < value < high + 0.35 * (high - low):
            axes.axhline(value, color=style.LIMIT, linewidth=1.1, linestyle=(0, (5, 3)))
            axes.set_ylim(min(low, 1.06 * value), max(high, 1.06 * value))
            low, high = axes.get_ylim()
            axes.axhspan(value, sign * 1e3 * limit, color=style.LIMIT, alpha=0.08, linewidth=0)
            axes.set_ylim(low, high)


def nothing(axes: Axes, motion: Motion, text: str) -> None:
    """Say in a panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=9, color="#7a828b")
    axes.set_xlim(*motion.time_range)
