"""How near a run came to its limits: the largest errors and uses, and the closest of them."""

from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.decoding import FOLLOWS
from dpcontrol.judge.run_view import RunView


@dataclass(frozen=True)
class NearestLimit:
    """The largest value of a quantity, and its limit.

    Attributes:
        name: of the quantity.
        value: in `unit`.
        limit: in `unit`.
        unit: of both.
        time: of the largest value, s.
    """

    name: str
    value: float
    limit: float
    unit: str
    time: float

    @property
    def share(self) -> float:
        """The largest value as a share of its limit."""
        return self.value / self.limit

    @property
    def sentence(self) -> str:
        """Value, limit and share in words."""
        return f"{self.name} {self.value:.3g} of {self.limit:.4g} {self.unit} ({self.share:.0%})"


def limit_uses(view: RunView) -> tuple[NearestLimit, ...]:
    """Return the use of each limit that a view has, the nearest to its limit first.

    Limits are those of the cart, and the distance from the reference beyond which an itinerary counts as lost.
    """
    found: list[NearestLimit] = []

    def add(name: str, values: Array, limit: float, unit: str, scale: float = 1.0) -> None:
        sizes = np.abs(values)
        if np.isfinite(sizes).any() and limit > 0 and np.isfinite(limit):
            row = int(np.nanargmax(sizes))
            found.append(NearestLimit(name, scale * float(sizes[row]), scale * limit, unit, float(view.time[row])))

    n = view.arms
    if view.limits is not None and view.has_cart:
        position, velocity, acceleration = view.limits
        add("cart position", view.state[:, 2 * n], position, "mm", 1000.0)
        add("cart velocity", view.state[:, 2 * n + 1], velocity, "m/s")
        if view.control is not None and "applied" in view.control:
            add("acceleration", view.control["applied"], acceleration, "m/s²")
    if view.reference is not None and view.against == "reference":
        away = np.abs(view.state[:, :n] - view.reference[:, :n])
        add("distance of an arm from the reference", away.max(axis=1), FOLLOWS, "rad")
    return tuple(sorted(found, key=lambda use: -use.share))


def nearest(view: RunView) -> tuple[str, ...]:
    """Return the largest uses of a view's limits, and the closest approach to failing, each as a line."""
    uses = limit_uses(view)
    if not uses:
        return ()
    closest = uses[0]
    word = "Beyond a limit" if closest.share > 1 else "Closest to a limit"
    return (
        f"Largest values: {'; '.join(use.sentence for use in uses)}.",
        f"{word}: {closest.name} at {closest.time:.2f} s, {closest.share:.0%} of the limit.",
    )
