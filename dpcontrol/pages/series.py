"""Charts of a run by name, and of further estimates."""

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView, clean
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.check_charts import check_charts
from dpcontrol.pages.motion_charts import motion_charts
from dpcontrol.pages.ranges import padded

EXTRA_CHARTS = (
    ("zero_", "zeros", "Encoder zeros", "rad"),
    ("disturbance_", "disturbances", "Disturbances", "rad/s²"),
    ("drive", "drive", "Drive's error", "m/s²"),
    ("friction_", "friction", "Friction's errors", "share"),
    ("dry_", "dry", "Dry friction not in the model, of gravity", "share"),
    ("", "parameters", "Model's errors", "share"),
)
"""Extras that share a chart: beginning of their names, the chart's key, title and unit."""


def extra_charts(view: RunView) -> tuple[Chart, ...]:
    """Return the charts of the estimated parameters, ±2σ.

    The truth is added if it is known.
    """
    extras, found = view.extras, []
    left = {} if extras is None else dict.fromkeys(extras.names)
    for begins, key, title, unit in EXTRA_CHARTS:
        names = [name for name in left if name.startswith(begins)]
        for name in names:
            del left[name]
        if extras is None or not names:
            continue
        lines: list[Line] = []
        truths: list[Line] = []
        reaches: list[Array] = []
        for k, name in enumerate(names):
            column, colour = extras.names.index(name), style.RUNS[k % len(style.RUNS)]
            values, reach = clean(extras.values[:, column]), 2 * clean(extras.sigmas[:, column])
            label = name.replace("_", " ") if len(names) > 1 or name != key else ""
            lines.append(Line(name, f"{name} ±2σ", label, extras.time, values, colour, reach=reach, around=True))
            # The prior at the start is omitted.
            late = slice(len(values) // 4, None)
            reaches += [values, values[late] + reach[late], values[late] - reach[late]]
            if name in view.extra_truth:
                truth = np.broadcast_to(view.extra_truth[name], extras.time.shape)
                label, look = "" if truths else "true", {"width": 1.1, "dashed": True}
                truths.append(Line(f"{name}_truth", f"{name} true", label, extras.time, truth, colour, **look))
                reaches.append(truth)
        every = np.concatenate(reaches)
        known = every[np.isfinite(every)]
        shown = padded(np.quantile(known, [0.01, 0.99])) if known.size else None
        look = {"shown": shown, "note": ", ±2σ", "hint": ", band ±2σ", "legend": True}
        found.append(Chart(key, title, unit, (*lines, *truths), **look))
    return tuple(found)


def charts(view: RunView) -> dict[str, Chart]:
    """Return all charts by key."""
    return {chart.key: chart for chart in (*motion_charts(view), *check_charts(view))}
