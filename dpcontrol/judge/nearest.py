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
    abort nothing follows the reference any more, so these ticks do not count.

    Args:
        view: data of the run.
    """
    n, control = view.arms, view.control or {}
    follows = ~np.isin(control.get("mode", np.zeros(len(view.time))), (Mode.STOPPED, Mode.ABORTED))
    compared: list[tuple[str, Array, float, str, float]] = []
    if view.limits is not None and view.has_cart:
        position, velocity, acceleration = view.limits
        compared += [
            ("cart position", view.state[:, 2 * n], position, "mm", 1000.0),
            ("cart velocity", view.state[:, 2 * n + 1], velocity, "m/s", 1.0),
            *([("acceleration", control["applied"], acceleration, "m/s²", 1.0)] if "applied" in control else []),
        ]
    if view.reference is not None and view.against == "reference":
        away = np.abs(view.state[:, :n] - view.reference[:, :n])
        compared.append(("arm from the reference", away.max(axis=1), FOLLOWS, "rad", 1.0))
    uses = []
    for name, values, limit, unit, scale in compared:
        sizes = np.where(follows, np.abs(values), np.nan)
        if np.isfinite(sizes).any() and limit > 0 and np.isfinite(limit):
            row = int(np.nanargmax(sizes))
            uses.append(LimitUse(name, unit, scale * limit, scale * float(sizes[row]), float(view.time[row])))
    return tuple(sorted(uses, key=lambda use: -use.share))


def closest_approach(view: RunView) -> str:
    """Return the closest approach to a limit in a sentence, or "" without limits.

    Args:
        view: data of the run.
    """
    uses = limit_uses(view)
    if not uses:
        return ""
    first = uses[0]
    word = "Beyond a limit" if first.share > 1 else "Closest to a limit"
    return f"{word}: {first.name}, {first.sentence} ({first.share:.0%})."


def nis_reading(view: RunView) -> str:
    """Return the mean NIS of a run and its meaning in a sentence, or "" without a NIS.

    Args:
        view: data of the run.
    """
    means = None if view.nis is None else nis_means(view.nis, view.sensors)
    return "" if means is None else f"NIS: {means.sentence}."
