"""Statement of a reference: equations, an orbit to follow, limits, and settings of the solution.

    minimise ∫ u² + w_z |z - z_guess|² + w_x x² dt      subject to  (z, x, ẋ)˙ = f(z, x, ẋ, u), limits, ends

z is the pendulum's state, with differences scaled by π per angle and 10 rad/s per rate. x is the cart's position and u
its acceleration. Without w_z the optimiser leaves the itinerary.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import Setting, Settings, leaves_of
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.method import method_named

if TYPE_CHECKING:
    from dpcontrol.dynamics.propagator import PolynomialInputPropagator

Guess = Callable[[Array], Array]
"""From times (K,) in s to pendulum states (K, 2n): a conservative shadowing orbit."""

PLANNING = 5
"""Version of the planner, part of the cache keys of references and plans.

Raise it whenever a plan changes: a test of golden plans fails until then.
"""

LEVELS = ("cart", "conservative")
SOLVERS = ("ipopt", "fatrop")
ANGLE_SCALE = np.pi
RATE_SCALE = 10.0
CART_VELOCITY_SCALE = 3.0
NATURAL_TIME, GRAVITY = 1.1002616586, 9.8085802336215
"""Natural time, s, and gravity, m/s², of the laboratory's arms."""


@dataclass(frozen=True)
class Limits(Settings, table="limits"):
    """Symmetric bounds of the cart.

    Attributes:
        position: half the stroke, m.
        velocity: m/s.
        acceleration: m/s².
        jerk: m/s³, zero for none. A bound makes the acceleration continuous.
    """

    position: Annotated[
        float,
        Setting(
            least=1e-6, most=1e6, unit="m", usual=(0.02, 5.0), help="Largest distance of the cart from the centre."
        ),
    ] = 0.4
    velocity: Annotated[
        float, Setting(least=1e-6, most=1e6, unit="m/s", usual=(0.05, 20.0), help="Largest velocity of the cart.")
    ] = 3.0
    acceleration: Annotated[
        float, Setting(least=1e-6, most=1e6, unit="m/s²", usual=(0.05, 300.0), help="Largest acceleration of the cart.")
    ] = 30.0
    jerk: Annotated[
        float,
        Setting(least=1e-6, most=1e6, zero="no limit", unit="m/s³", usual=(5.0, 1e6), help="Largest jerk of the cart."),
    ] = 0.0

    def named(self) -> dict[str, float]:
        """Return the bounds by name; the jerk is listed only if it is limited."""
        bounds = {"position": self.position, "velocity": self.velocity, "acceleration": self.acceleration}
        return {**bounds, "jerk": self.jerk} if self.jerk > 0 else bounds


LIMIT_UNITS = {name: leaf.bounds.unit for name, leaf in leaves_of(Limits).items()}


@dataclass(frozen=True)
class Scale:
    """Factors from a motion's own units to those of the laboratory's arms.

    Attributes:
        length: factor on lengths.
        time: factor on times.
    """

    length: float
    time: float

    @classmethod
    def of(cls, arms: ArmChainParameters) -> "Scale":
        """Return the factors that give arms the laboratory's natural time and gravity.

        Args:
            arms: the arms.
        """
        time = NATURAL_TIME / arms.natural_time
        return cls(GRAVITY / arms.gravity * time**2, time)

    @property
    def acceleration(self) -> float:
        """Factor on accelerations."""
        return self.length / self.time**2

    def state(self, arms: int) -> Array:
        """Return the factors (2n+2,) that convert a state to the units of the laboratory's arms.

        Args:
            arms: number n of arms.
        """
        return np.array([1.0] * arms + [1 / self.time] * arms + [self.length, self.length / self.time])

    def limits(self, limits: Limits, share: float = 1.0) -> Limits:
        """Return the cart's limits, or a share of them, in the units of the laboratory's arms.

        Args:
            limits: limits of the cart.
            share: share of the limits, 1 for all of them.
        """
        bounds = np.array([limits.position, limits.velocity, limits.acceleration, limits.jerk])
        return Limits(*(share * self.length / self.time ** np.arange(4) * bounds).tolist())


@dataclass(frozen=True, eq=False)
class EndConditions(Settings, table="ends"):
    """Conditions at the ends of a reference.

    Attributes:
        start, end: states (N,) with NaN for free entries; None for the guess's, with the cart at rest in the middle.
        closing: whole turns (N,) between start and end of a closed motion.
        energy: energy of the pendulum at the start, J, or None.
        stretch: share by which the duration can change, 0 for none.
    """

    start: Array | None = None
    end: Array | None = None
    closing: Array | None = None
    energy: float | None = None
    stretch: Annotated[float, Setting(least=0, most=0.999, help="Share by which the duration may change.")] = 0.0


def state_scale(dimension: int, limits: Limits) -> Array:
    """Return the scale of each component of a state: π per angle, 10 rad/s per rate, the full stroke and 3 m/s.

    Defects, errors and distances of states are measured in these units.

    Args:
        dimension: number of components.
        limits: limits of the cart.
    """
    n = (dimension - 2) // 2
    return np.array([ANGLE_SCALE] * n + [RATE_SCALE] * n + [2 * limits.position, CART_VELOCITY_SCALE], dtype=float)


@dataclass(frozen=True)
class ReferenceProblem(Brief):
    """Equations, guess, limits and ends of a reference to find.

    Attributes:
        equations: cart-level equations with states (N,) of angles, rates, cart position and velocity, and one input.
        parameters: base parameters (p,) with friction.
        guess: orbit to follow from time 0 to `duration`.
        duration: duration, s.
        limits: limits of the cart.
        ends: conditions at start and end.
        propagators: compiled propagators of the errors between nodes, by degree of the input.
    """

    equations: Equations
    parameters: Array
    guess: Guess
    duration: float
    limits: Limits = field(default_factory=Limits)
    ends: EndConditions = field(default_factory=EndConditions)
    propagators: "dict[int, PolynomialInputPropagator]" = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def end_states(self) -> tuple[Array, Array]:
        """Return the fixed states (N,) at start and end, with NaN for free entries.

        The end of a closed motion is free, because it is tied to the start.
        """
        guessed = self.guess_at(np.array([0.0, self.duration]))
        ends = [self.ends.start, self.ends.end]
        if self.ends.closing is not None:
            return (np.full(self.equations.dimension, np.nan) if ends[0] is None else ends[0],
                    np.full(self.equations.dimension, np.nan))  # fmt: skip
        start, end = (
            np.concatenate([guessed[k], [0.0, 0.0]]) if fixed is None else np.asarray(fixed, dtype=float)
            for k, fixed in enumerate(ends)
        )
        return start, end

    @property
    def pendulum_dimension(self) -> int:
        """Number 2n of entries of the pendulum's state, without those of the cart."""
        return self.equations.dimension - 2

    def guess_at(self, times: Array) -> Array:
        """Return the pendulum's states (K, 2n) of the guess at given times.

        Args:
            times: times (K,), s.
        """
        return np.asarray(self.guess(times), dtype=float)


@dataclass(frozen=True)
class ReferenceSettings(Settings, table="reference"):
    """Settings of the search for a reference.

    Attributes:
        level: "cart" with friction and a cart that compensates it, or "conservative" for the shadowing orbit itself.
        method: collocation method by name.
        solver: "ipopt" or "fatrop".
        interval: initial length of an interval, s.
        tolerance: allowed scaled error between nodes.
        pendulum_weight: w_z of the cost.
        cart_weight: w_x of the cost.
        end_tolerance: allowed scaled distance of the pendulum from the guess's end.
        rounds: rounds of mesh refinement or tightening of limits.
        iterations: solver iterations in each round.
    """

    level: Annotated[str, Setting(choices=LEVELS, help="Equations: with friction and cart, or conservative.")] = "cart"
    method: Annotated[str, Setting(help="Collocation method.")] = "radau-7"
    solver: Annotated[str, Setting(choices=SOLVERS, help="Solver of the nonlinear program.")] = "ipopt"
    # Below the least interval a mesh may have more intervals than memory holds.
    interval: Annotated[float, Setting(least=1e-3, most=10, unit="s", help="Initial length of the mesh intervals.")] = (
        0.05
    )
    tolerance: Annotated[float, Setting(least=1e-20, most=1, help="Allowed scaled error between nodes.")] = 1e-6
    pendulum_weight: Annotated[float, Setting(least=0, help="Weight of the distance from the guess.")] = 0.1
    cart_weight: Annotated[float, Setting(least=0, help="Weight of the cart's distance from the centre.")] = 10.0
    end_tolerance: Annotated[float, Setting(least=0, help="Allowed scaled distance from the guess's end.")] = 0.0
    rounds: Annotated[int, Setting(least=1, help="Rounds of mesh refinement.")] = 8
    iterations: Annotated[int, Setting(least=1, help="Solver iterations in each round.")] = 100

    def _check_together(self) -> None:
        """Reject an unknown collocation method, after the checks of single values.

        Raises:
            InputError: the method's name or its number of points is unknown.
        """
        method_named(self.method)
