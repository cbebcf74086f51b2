"""A reference on one page: symbols, angles, rates, energy, the cart within its limits, error and mesh by interval."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dpcontrol.foundation.files import whole_file
from dpcontrol.references.summary import ReferenceSummary
from dpcontrol.review import style
from dpcontrol.review.figures.page import angle_axis, new_figure, quiet, saddle_colour

Array = NDArray[np.float64]

_POINTS = 4000
_NAMED = 14
"""Symbols that have room for a text."""
_STILL = "#c9ced4"
_TRANSFER = "#eceef0"


def draw_reference(summary: ReferenceSummary) -> Figure:
    """Return the page as a figure."""
    reference, notes = summary.reference, summary.reference.notes
    figure = new_figure(15.0, 9.6, str(notes.get("title") or notes.get("itinerary") or "A reference"))
    state = "" if reference.converged else "NOT CONVERGED: "
    line = f"{state}{reference.status}; {reference.duration:.4g} s, {reference.rms_cart_acceleration:.3g} m/s² rms"
    figure.text(0.015, 0.945, line, fontsize=9.5, color=style.INK if reference.converged else style.LIMIT)
    times = np.linspace(reference.mesh[0], reference.mesh[-1], _POINTS)
    states, inputs = reference.state(times), reference.input(times)[:, 0]
    n = (states.shape[1] - 2) // 2
    band = figure.add_axes((0.05, 0.86, 0.935, 0.035))
    _band(band, summary, float(times[0]), float(times[-1]))
    grid = figure.add_gridspec(4, 2, left=0.05, right=0.985, top=0.815, bottom=0.055, hspace=0.42, wspace=0.12)
    left = [figure.add_subplot(grid[k, 0]) for k in range(4)]
    right = [figure.add_subplot(grid[k, 1]) for k in range(4)]
    for arm in range(n):
        for axes, shift in ((left[0], 0), (left[1], n)):
            colour = style.arm_colour(arm)
            axes.plot(times, states[:, shift + arm], color=colour, linewidth=1.2, label=f"arm {arm + 1}")
    quiet(left[0], "Angles from hanging, whole turns counted")
    angle_axis(left[0], "y")
    left[0].legend(fontsize=8, frameon=False, ncols=n, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0)
    quiet(left[1], "Rates (rad/s)")
    _energy(left[2], summary, times, states)
    _mesh(left[3], summary)
    bounds = {use.name: use for use in summary.uses}
    for axes, name, values in zip(
        right[:3], ("position", "velocity", "acceleration"), (states[:, -2], states[:, -1], inputs), strict=True
    ):
        axes.plot(times, values, color=style.CART, linewidth=1.2)
        use = bounds[name]
        _limit(axes, f"Cart {name} ({use.unit}): {use.largest:.3g} of ±{use.bound:g} used", use.bound, use.largest)
    _errors(right[3], summary)
    for axes in (*left, *right):
        axes.set_xlim(times[0], times[-1])
        axes.tick_params(labelbottom=axes in (left[3], right[3]))
    for axes in (*left[:3], *right[:3]):
        for symbol in _entries(notes, "symbols"):
            axes.axvline(float(symbol["time"]), color="#7a828b", linewidth=0.8, linestyle=(0, (2, 2)), zorder=1.5)
    for axes in (left[3], right[3]):
        axes.set_xlabel("time (s)", fontsize=9)
    return figure


def _entries(notes: Any, key: str) -> list[Any]:
    return list(notes.get(key) or [])


def _band(axes: Axes, summary: ReferenceSummary, begin: float, end: float) -> None:
    """Draw where the pendulum is: stops as spans between symbols, transfers over them, symbols numbered."""
    notes = summary.reference.notes
    symbols, stops = _entries(notes, "symbols"), _entries(notes, "stops")
    edges = [begin, *(float(symbol["time"]) for symbol in symbols), end]
    wide = 0.0055 * (end - begin)
    transfers = [(float(first), float(last)) for first, last in _entries(notes, "transfers")]
    for first, last, stop in zip(edges[:-1], edges[1:], stops, strict=False):
        name = str(stop["saddle"])
        still = name == "down-down"
        axes.axvspan(first, last, color=_STILL if still else saddle_colour(name), alpha=0.75, linewidth=0)
        # The name stands where no transfer covers the span.
        left = max([first, *(until for since, until in transfers if since <= first < until)])
        right = min([last, *(since for since, until in transfers if since < last <= until)])
        if (right - left) / len(name) > wide:
            colour = style.INK if still else "white"
            axes.text((left + right) / 2, 0.5, name, ha="center", va="center_baseline", fontsize=8.5, color=colour)
    for first, last in transfers:
        axes.axvspan(first, last, facecolor=_TRANSFER, edgecolor=_STILL, hatch="////", linewidth=0)
    for k, symbol in enumerate(symbols):
        time = float(symbol["time"])
        axes.axvline(time, color=style.INK, linewidth=1.2)
        text = str(symbol["text"]) if len(symbols) <= _NAMED else str(k + 1)
        # Neighbours' texts stand at two heights.
        height = 1.12 if k % 2 == 0 or len(symbols) > _NAMED else 1.62
        edge = (time - begin) / (end - begin)
        place = "left" if edge < 0.06 else "right" if edge > 0.94 else "center"
        axes.text(time, height, text, ha=place, va="bottom", fontsize=7.5, color=style.INK)
    axes.set_xlim(begin, end)
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.tick_params(labelbottom=False, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    if not symbols:
        axes.text(begin, 1.12, "no symbols are noted in this file", fontsize=8, color="#555c64", va="bottom")


def _limit(axes: Axes, title: str, bound: float, largest: float) -> None:
    """Shade what lies beyond a limit; the axes reach it only where the curve comes near."""
    quiet(axes, title)
    reach = 1.15 * max(largest, 1e-12)
    if reach >= bound:
        reach = 1.15 * bound
    axes.set_ylim(-reach, reach)
    for side in (-1, 1):
        axes.axhspan(side * bound, side * 10 * bound, color=style.LIMIT, alpha=0.15, linewidth=0)
        axes.axhline(side * bound, color=style.LIMIT, linewidth=0.9)
    axes.set_ylim(-reach, reach)


def _energy(axes: Axes, summary: ReferenceSummary, times: Array, states: Array) -> None:
    quiet(axes, "Energy of the pendulum (J)")
    energies = summary.energies(states)
    if energies is None:
        axes.text(0.5, 0.5, "the file does not say for which arms it was made", transform=axes.transAxes, ha="center",
                  fontsize=9, color="#555c64")  # fmt: skip
        return
    axes.plot(times, energies, color=style.INK, linewidth=1.2)
    low, high = float(energies.min()), float(energies.max())
    margin = 0.12 * max(high - low, 0.05)
    for name, saddle in dict(summary.reference.notes.get("saddles") or {}).items():
        level = float(saddle["energy"])
        if low - 2 * margin <= level <= high + 2 * margin:
            low, high = min(low, level), max(high, level)
            axes.axhline(level, color=saddle_colour(name), linewidth=0.9, linestyle=(0, (4, 2)))
            axes.text(times[-1], level, f"{name} ", fontsize=7.5, color=saddle_colour(name), va="bottom", ha="right")
    axes.set_ylim(low - margin, high + margin)


def _mesh(axes: Axes, summary: ReferenceSummary) -> None:
    mesh = summary.reference.mesh
    lengths = 1e3 * np.diff(mesh)
    axes.stairs(lengths, mesh, color=style.arm_colour(2), linewidth=1.1, baseline=None)
    axes.set_ylim(0.0, 1.15 * float(lengths.max()))
    quiet(axes, f"Mesh: length of {len(lengths)} intervals of {summary.reference.method.name} (ms)")


def _errors(axes: Axes, summary: ReferenceSummary) -> None:
    quiet(axes, "Error between nodes on each interval, measured anew (scaled)")
    if summary.errors is None:
        axes.text(0.5, 0.5, "not measured: the file does not say for which arms it was made", transform=axes.transAxes,
                  ha="center", fontsize=9, color="#555c64")  # fmt: skip
        return
    shown = np.where(np.isfinite(summary.errors), np.maximum(summary.errors, 1e-17), np.nan)
    axes.stairs(shown, summary.reference.mesh, color=style.arm_colour(3), linewidth=1.1, baseline=None)
    axes.set_yscale("log")
    stored = summary.reference.max_error_between_nodes
    if np.isfinite(stored) and stored > 0:
        axes.axhline(stored, color=style.LIMIT, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.text(
            summary.reference.mesh[0], stored, " largest, as stored", fontsize=7.5, color=style.LIMIT, va="bottom"
        )


def write_reference_figure(summary: ReferenceSummary, path: Path) -> None:
    """Write the page as PNG.

    Raises:
        InputError: the file cannot be written.
    """
    figure = draw_reference(summary)
    with whole_file(path, suffix=".png") as temporary:
        figure.savefig(temporary, format="png")
