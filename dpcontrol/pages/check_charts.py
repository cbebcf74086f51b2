"""Charts that check a run: errors of tracking and estimation, energy, NIS."""

import numpy as np

from dpcontrol.control.estimator_settings import MEANS_OF, mean_band, means_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView, clean
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, LevelLine, Line
from dpcontrol.pages.drive_charts import velocity_chart
from dpcontrol.pages.mesh_charts import mesh_chart, node_error_chart
from dpcontrol.pages.ranges import padded

NIS_LOST = 10.0
"""Multiple of the expected NIS above which an estimate is lost."""


def check_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the run's quality, as far as known.

    They show errors, energy and NIS, or a reference's mesh.
    """
    makers = (velocity_chart, _tracking_error, _estimation_error, _energy, _nis, mesh_chart, node_error_chart)
    return tuple(chart for make in makers if (chart := make(view)) is not None)


def _arm_lines(view: RunView, values: Array, width: float, reach: Array | None = None) -> tuple[Line, ...]:
    """Return a line for each arm's angle.

    The angles are columns of the values (K, …); `reach` has the half widths of their bands.
    """
    return tuple(
        Line(f"arm_{arm + 1}", f"arm {arm + 1}", f"θ{style.number(arm)}", view.time, values[:, arm],
             style.arm_colour(arm), width, reach=None if reach is None else reach[:, arm])
        for arm in range(view.arms)
    )  # fmt: skip


def _tracking_error(view: RunView) -> Chart | None:
    if view.reference is None:
        return None
    lines = _arm_lines(view, view.state - view.reference, 1.1)
    note = f": {view.what} minus {view.against}"
    return Chart("tracking_error", f"{view.error_name} of the angles", "rad", lines, note=note)


def _estimation_error(view: RunView) -> Chart | None:
    """Draw the estimate's error with ±2σ; for an unknown error ±2σ alone."""
    error, reach = view.error, None if view.sigma is None else 2 * view.sigma
    if error is None and reach is None:
        return None
    known = error is not None
    # The large errors at the start are omitted.
    shown = [np.abs(part[:, : view.arms]) for part in (reach, error) if part is not None]
    finite = [part[np.isfinite(part)] for part in shown]
    most = max((1.6 * float(np.quantile(part, 0.97)) for part in finite if part.size), default=0.0) or 1e-6
    return Chart(
        "estimation_error" if known and reach is not None else "",
        "Estimation error of the angles" if known else "Estimate's ±2σ",
        "rad",
        _arm_lines(view, np.full_like(view.state, np.nan) if error is None else error, 1.0, reach),
        shown=(-most, most),
        note=", lines ±2σ" if known else "; the truth is not known",
        hint=", band ±2σ",
    )


def _energy(view: RunView) -> Chart | None:
    energy = None if view.energy is None else clean(np.asarray(view.energy, dtype=float))
    if energy is None or not np.isfinite(energy).any():
        return None
    levels = tuple(
        LevelLine(name.replace("-", "_"), name, value, style.saddle_colour(name), "named")
        for name, value in view.plan.saddle_energies.items()
    )
    line = Line("pendulum", "pendulum", "", view.time, energy, style.PLANT, 1.1)
    # The extremes are omitted: they result from the initial error.
    low, high = (float(value) for value in np.nanquantile(energy, [0.005, 0.995]))
    known = view.plan.saddle_energies.values()
    low = max((level for level in known if level <= low), default=low)
    high = min((level for level in known if level >= high), default=high)
    shown = padded(np.array([low, high]))
    note = ", dashed: the saddles'" if levels else ""
    look = {"levels": levels, "shown": shown, "note": note, "hint": " and saddles", "legend": True}
    return Chart("energy", "Energy of the pendulum", "J", (line,), prefixed=False, **look)


def _nis(view: RunView) -> Chart | None:
    """Draw means of the NIS over windows.

    The 95 % range of a consistent estimator is added.
    """
    if view.nis is None:
        return None
    time, means = smoothed_nis(view)
    ends = mean_band(view.sensors)
    levels = [
        LevelLine(name, f"{name} for 95 %", value, style.GOOD, "band")
        for name, value in zip(("least", "greatest"), ends, strict=True)
    ]
    highest = float(np.nanquantile(means, 0.98)) if len(means) else 0.0
    # A lost estimate would compress the rest of the axis.
    lost = highest > NIS_LOST * view.sensors
    band = f"{ends[0]:.1f} to {ends[1]:.1f}"
    return Chart(
        "nis",
        f"NIS, means of {MEANS_OF} updates",
        "",
        (Line("mean", f"mean of {MEANS_OF} updates", "", time, means, style.ESTIMATE, 1.0),),
        levels=tuple(levels),
        shown=(0.0, NIS_LOST * view.sensors if lost else max(1.15 * highest, 1.6 * view.sensors)),
        log=lost,
        note=f"; band for 95 %: {band}",
        hint=f"; 95 % belong in {band}",
    )


def smoothed_nis(view: RunView) -> tuple[Array, Array]:
    """Return times (K,) and means (K,) of the NIS.

    Means are over stretches of ticks with a measurement.
    """
    nis = np.full(len(view.time), np.nan) if view.nis is None else view.nis
    known = np.isfinite(nis)
    return means_of(view.time[known]), means_of(nis[known])
