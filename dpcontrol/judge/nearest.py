"""The largest values of a run compared with their limits, the closest of them, and the state of the filter."""

import numpy as np

from dpcontrol.control.estimator_settings import nis_means
from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.decoding import FOLLOWS
from dpcontrol.judge.run_view import RunView
from dpcontrol.logs import Mode
from dpcontrol.references.trajectory import LimitUse


def limit_uses(view: RunView) -> tuple[LimitUse, ...]:
    """Return the use of each limit that the view has, the nearest to its limit first.

    Limits are those of the cart, and the distance from the reference beyond which an itinerary counts as lost. After an
    abort nothing follows the reference any more, so these ticks do not count. A limit is left out if its quantity has
    no finite value.

    Args:
        view: data of the run.
    """
    n, control = view.arms, view.control or {}
    is_followed = ~np.isin(control.get("mode", np.zeros(len(view.time))), (Mode.STOPPED, Mode.ABORTED))
    quantities: list[tuple[str, Array, float, str, float]] = []
    if view.limits is not None and view.has_cart:
        position, velocity, acceleration = view.limits
        quantities += [
            ("cart position", view.state[:, 2 * n], position, "mm", 1000.0),
            ("cart velocity", view.state[:, 2 * n + 1], velocity, "m/s", 1.0),
            *([("acceleration", control["applied"], acceleration, "m/s²", 1.0)] if "applied" in control else []),
        ]
    if view.reference is not None and view.against == "reference":
        distances = np.abs(view.state[:, :n] - view.reference[:, :n])
        quantities.append(("arm from the reference", distances.max(axis=1), FOLLOWS, "rad", 1.0))
    uses = []
    for name, values, limit, unit, scale in quantities:
        sizes = np.where(is_followed, np.abs(values), np.nan)
        if np.isfinite(sizes).any() and limit > 0 and np.isfinite(limit):
            worst_row = int(np.nanargmax(sizes))
            uses.append(
                LimitUse(name, unit, scale * limit, scale * float(sizes[worst_row]), float(view.time[worst_row]))
            )
    return tuple(sorted(uses, key=lambda use: -use.share))


def closest_approach(view: RunView) -> str:
    """Return the closest approach to a limit in a sentence, for the page of a run, or "" without limits.

    Args:
        view: data of the run.
    """
    uses = limit_uses(view)
    if not uses:
        return ""
    nearest_use = uses[0]
    word = "Beyond a limit" if nearest_use.share > 1 else "Closest to a limit"
    return f"{word}: {nearest_use.name}, {nearest_use.sentence} ({nearest_use.share:.0%})."


def nis_reading(view: RunView) -> str:
    """Return the mean NIS of a run and its meaning in a sentence, for its page, or "" without a NIS.

    Args:
        view: data of the run.
    """
    means = None if view.nis is None else nis_means(view.nis, view.sensors)
    return "" if means is None else f"NIS: {means.sentence}."
