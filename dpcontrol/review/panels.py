"""The panels of the drawn picture: each function draws one quantity of a run into one pair of axes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from dpcontrol.logs import RunLog
from dpcontrol.review import series, style
from dpcontrol.review.context import ReviewContext

_SMALL = 8.5
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def prepare(axes: Axes, label: str) -> None:
    """Set a panel's title and its quiet frame and grid."""
    axes.set_title(label, loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.tick_params(labelsize=_SMALL, colors="#555c64", length=2.5)
    axes.grid(color="#e6e9ec", linewidth=0.7)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.FAINT)
    axes.margins(x=0)


def _legend(axes: Axes, entries: list[tuple[str, dict]]) -> None:
    """Put a legend on one line above the panel, right, where it cannot cover a curve."""
    handles = [Line2D([], [], label=label, **look) for label, look in entries]
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.005, 0.985),
        ncols=len(handles),
        fontsize=_SMALL,
        frameon=False,
        handlelength=1.5,
        columnspacing=1.1,
        handletextpad=0.5,
        borderpad=0,
        borderaxespad=0.25,
    )


def _number(i: int) -> str:
    return str(i + 1).translate(_SUBSCRIPTS)


def _in_pi(value: float, _: object) -> str:
    return (
        "0"
        if abs(value) < 1e-9
        else f"{value:.3g}π".replace("1π", "π")
        if abs(abs(value) - 1) < 1e-9
        else f"{value:.3g}π"
    )


def _plot(axes: Axes, time: NDArray[np.float64], values: NDArray[np.float64], **look: object) -> None:
    axes.plot(*series.thinned(time, values), **look)  # type: ignore[arg-type]


def mark_symbols(axes: Axes, context: ReviewContext, log: RunLog) -> None:
    """Mark the symbols' planned crossings with a dotted line."""
    for moment in _shown_moments(context, log).values():
        axes.axvline(moment, color="#7a828b", linewidth=0.9, linestyle=(0, (2, 2)), zorder=1.5)


def _shown_moments(context: ReviewContext, log: RunLog) -> dict[int, float]:
    moments = {i: moment for i, (moment, _) in enumerate(context.symbols)}
    return {i: moment for i, moment in moments.items() if log.time[0] <= moment <= log.time[-1]}


def angles(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the arms' angles in turns of π with the reference behind."""
    state, shown = series.shown_state(log)
    arms = len(context.arm_lengths)
    prepare(axes, "Angles from hanging")
    entries: list[tuple[str, dict]] = []
    for arm in range(arms):
        colour = style.arm_colour(arm)
        _plot(axes, log.time, log.reference[:, arm] / np.pi, color=colour, alpha=0.3, linewidth=4.5)
        _plot(axes, log.time, state[:, arm] / np.pi, color=colour, linewidth=1.3)
        entries.append((f"θ{_number(arm)} {shown}", {"color": colour, "linewidth": 1.5}))
    entries.append(("reference", {"color": style.REFERENCE, "linewidth": 4.5, "alpha": 0.6}))
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.yaxis.set_major_formatter(FuncFormatter(_in_pi))
    _legend(axes, entries)


def rates(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the arms' rates with the reference behind."""
    state, _ = series.shown_state(log)
    arms = len(context.arm_lengths)
    prepare(axes, "Rates (rad/s)")
    for arm in range(arms):
        colour = style.arm_colour(arm)
        _plot(axes, log.time, log.reference[:, arms + arm], color=colour, alpha=0.3, linewidth=4.5)
        _plot(axes, log.time, state[:, arms + arm], color=colour, linewidth=1.3)
    _legend(axes, [(f"ω{_number(arm)}", {"color": style.arm_colour(arm), "linewidth": 1.5}) for arm in range(arms)])


def cart(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the cart's position in mm; its limits as lines where they are near, in the title always."""
    state, shown = series.shown_state(log)
    limit = 1000 * context.limits[0]
    prepare(axes, f"Cart position (mm), track ±{limit:.0f}")
    position = 2 * len(context.arm_lengths)
    _plot(axes, log.time, 1000 * log.reference[:, position], color=style.CART, alpha=0.3, linewidth=4.5)
    _plot(axes, log.time, 1000 * state[:, position], color=style.CART, linewidth=1.3)
    _limits(axes, limit)
    ghost = {"color": style.REFERENCE, "linewidth": 4.5, "alpha": 0.6}
    _legend(axes, [(shown, {"color": style.CART}), ("reference", ghost)])


def _limits(axes: Axes, limit: float) -> None:
    low, high = axes.get_ylim()
    for value in (-limit, limit):
        if low - 0.35 * (high - low) < value < high + 0.35 * (high - low):
            axes.axhline(value, color=style.LIMIT, linewidth=1.1, linestyle=(0, (5, 3)))


def command(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the commanded acceleration, its feedforward part, and the modes as a strip below."""
    limit = context.limits[2]
    prepare(axes, f"Acceleration |u| ≤ {limit:g} m/s²")
    _plot(axes, log.time, log.control["applied"], color=style.INK, linewidth=1.0)
    _plot(axes, log.time, log.control["feedforward"], color=style.ARMS[1], linewidth=1.4)
    saturated = log.control["saturated"] > 0
    if saturated.any():
        level = np.where(saturated, log.control["applied"], np.nan)
        axes.plot(log.time, level, color=style.LIMIT, linewidth=2.5)
    _limits(axes, limit)
    entries: list[tuple[str, dict]] = [("applied", {"color": style.INK}), ("feedforward", {"color": style.ARMS[1]})]
    if saturated.any():
        entries.append(("saturated", {"color": style.LIMIT, "linewidth": 2.5}))
    _legend(axes, entries)


def modes(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the controller's modes as a coloured strip, and on it the numbers of the symbols."""
    spans = series.mode_spans(log)
    for start, end, name in spans:
        axes.axvspan(start, end, color=style.MODES.get(name, style.FAINT), linewidth=0)
    names = list(dict.fromkeys(name for _, _, name in spans))
    axes.set_yticks([])
    axes.set_xlim(*series.time_range(log))
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(labelbottom=False, length=0)
    handles = [Patch(color=style.MODES.get(name, style.FAINT), label=name) for name in names]
    for i, moment in _shown_moments(context, log).items():
        axes.text(
            moment,
            0.5,
            str(i + 1),
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="center_baseline",
            fontsize=7.5,
            color="white",
            bbox={"boxstyle": "circle,pad=0.25", "facecolor": style.INK, "edgecolor": "none"},
            zorder=5,
        )
    axes.set_title("Controller", loc="left", fontsize=9.5, color=style.INK, pad=4)
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.005, 0.94),
        ncols=len(handles),
        fontsize=_SMALL,
        frameon=False,
        handlelength=1.0,
        handleheight=0.9,
        columnspacing=1.1,
        handletextpad=0.5,
        borderpad=0,
        borderaxespad=0.25,
    )


def tracking_error(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw how far the arms are from the reference, in rad."""
    state, shown = series.shown_state(log)
    prepare(axes, f"Tracking error: {shown} minus reference (rad)")
    axes.axhline(0, color=style.FAINT, linewidth=1)
    for arm in range(len(context.arm_lengths)):
        _plot(axes, log.time, state[:, arm] - log.reference[:, arm], color=style.arm_colour(arm), linewidth=1.1)
    names = [f"θ{_number(arm)}" for arm in range(len(context.arm_lengths))]
    _legend(axes, [(name, {"color": style.arm_colour(arm)}) for arm, name in enumerate(names)])


def estimation_error(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the estimate's error in the angles with two standard deviations either side; the band only if no truth."""
    error = series.estimation_error(log)
    sigma = series.sigmas(log)
    prepare(axes, "Estimation error ±2σ (mrad)" if error is not None else "Estimate's 2σ (mrad): the truth is unknown")
    arms = len(context.arm_lengths)
    for arm in range(arms):
        colour = style.arm_colour(arm)
        time, band = series.thinned(log.time, 2000 * sigma[:, arm])
        axes.fill_between(time, -band, band, color=colour, alpha=0.14, linewidth=0)
        axes.plot(time, band, time, -band, color=colour, linewidth=0.9, zorder=3)
        if error is not None:
            _plot(axes, log.time, 1000 * error[:, arm], color=colour, linewidth=0.6, alpha=0.7)
    # A large error in the first instants must not flatten the rest of the run.
    shown = (
        2000 * sigma[:, :arms] if error is None else np.maximum(2000 * sigma[:, :arms], 1000 * np.abs(error[:, :arms]))
    )
    most = 1.6 * float(np.nanquantile(shown, 0.97)) if np.isfinite(shown).any() else 0.0
    if np.isfinite(most) and most > 0:
        axes.set_ylim(-most, most)


def energy(axes: Axes, log: RunLog, context: ReviewContext) -> None:
    """Draw the pendulum's energy and the saddles' levels next to it."""
    prepare(axes, "Energy of the pendulum (J)")
    levels = sorted(context.saddle_energies.items(), key=lambda item: item[1])
    if context.energy is None:
        axes.text(0.5, 0.5, "not computed", transform=axes.transAxes, ha="center", fontsize=9, color="#7a828b")
        axes.set_xlim(*series.time_range(log))
        return
    values = context.energy
    _plot(axes, log.time, values, color=style.INK, linewidth=1.1)
    low, high = series.energy_range(values, context.saddle_energies)
    axes.set_ylim(low, high)
    for name, level in levels:
        if low <= level <= high:
            axes.axhline(level, color=style.ARMS[3], linewidth=1.0, linestyle=(0, (5, 3)))
            axes.annotate(
                name,
                (0.995, level),
                xycoords=("axes fraction", "data"),
                xytext=(0, 2),
                textcoords="offset points",
                ha="right",
                fontsize=7.5,
                color=style.ARMS[3],
            )


def innovations(axes: Axes, log: RunLog) -> None:
    """Draw means of the NIS over windows, and where 95 % of them lie if the estimator is consistent."""
    time, means, spread = series.smoothed_nis(log)
    expected = log.measured.shape[1]
    prepare(axes, f"NIS, means over 50 ticks; consistent: {expected} ± {spread:.1f}")
    axes.axhspan(max(expected - spread, 0), expected + spread, color="#9fd3a8", alpha=0.35, linewidth=0)
    axes.plot(time, means, color=style.CART, linewidth=1.0)
    axes.set_xlim(*series.time_range(log))
    if len(means):
        axes.set_ylim(0, max(1.15 * float(np.nanquantile(means, 0.98)), 1.6 * expected))


def phase_plane(axes: Axes, log: RunLog, context: ReviewContext, *, arm: int) -> None:
    """Draw an arm's angle and rate, unwrapped, over the orbits' copies at the lattice points that it visits."""
    state, _ = series.shown_state(log)
    arms = len(context.arm_lengths)
    prepare(axes, f"Arm {arm + 1}: ω{_number(arm)} (rad/s) over θ{_number(arm)}")
    for orbit in context.orbits:
        for copy in series.lattice_copies(orbit, state[:, arm], arm=arm):
            axes.plot(copy[:, 0] / np.pi, copy[:, 1], color=style.ARMS[2], linewidth=3.2, alpha=0.55, zorder=3)
    step = max(1, len(log.time) // 20_000)
    axes.plot(
        state[::step, arm] / np.pi, state[::step, arms + arm], color=style.arm_colour(arm), linewidth=0.9, zorder=2
    )
    axes.plot(state[0, arm] / np.pi, state[0, arms + arm], "o", color=style.INK, markersize=5, zorder=4)
    axes.plot(state[-1, arm] / np.pi, state[-1, arms + arm], "s", color=style.INK, markersize=5, zorder=4)
    entries = [("start", {"color": style.INK, "marker": "o", "linestyle": "", "markersize": 4.5})]
    entries.append(("end", {"color": style.INK, "marker": "s", "linestyle": "", "markersize": 4.5}))
    if context.orbits:
        entries.insert(0, ("orbit", {"color": style.ARMS[2], "linewidth": 3.2, "alpha": 0.55}))
    axes.margins(x=0.04)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(FuncFormatter(_in_pi))
    _legend(axes, entries)


def notes(axes: Axes, log: RunLog, context: ReviewContext, *, lines: int) -> None:
    """Write the symbols with their times, then the events, as many as there is room for."""
    axes.axis("off")
    text = [("Itinerary", True)] if context.symbols else []
    text += [
        (f"{i + 1}  {name}, crossing planned at {at:.2f} s", False) for i, (at, name) in enumerate(context.symbols)
    ]
    most = lines // 2 - 1
    if len(text) > most + 1:
        hidden = len(text) - most
        text = [*text[:most], (f"… and {hidden} more", False)]
    text += [("", False), ("Events", True)] if text else [("Events", True)]
    events = [(f"{event.time:7.2f} s  {event.text}", False) for event in log.events]
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
            fontsize=9.5 if heading else _SMALL,
            color=style.INK if heading else "#555c64",
        )
