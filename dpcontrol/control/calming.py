"""Calming: bring the arms to rest from any motion.

The cart stays within the track.

Far from rest, the controlled cart behaves like an apparent mass m on a spring and a damper, pulled by the arms. Their
total energy never increases; the damper dissipates it.

    d/dt (m v + P) = -U'(x) - c v          P(θ, ω): the arms' momentum along the track, against the cart
    E = H(θ, ω) + P v + m v²/2 + U(x),     Ė = -c v² - friction
    u = -(U'(x) + c v + Ṗ₀) / (m - σ),     Ṗ = Ṗ₀ - σ u

P, Ṗ₀ and σ come from the same model, with Ḣ = -P u. The spring keeps the cart near the middle of the track. Near
rest, a linear-quadratic regulator takes over because it converges faster.

After a hard blow the arms pull harder than the drive can follow. The law above, once saturated, would add energy. The
cart then moves against the momentum of the arms directly, which reduces H because Ḣ = -P u:

    u = clip(γ P / σ) - U'(x)/σ - c v/σ

The speed and position of the cart stay within fractions of their limits.

Sources: Ortega, van der Schaft, Mareels & Maschke, Putting energy back in control (2001), on interconnection; Den
Hartog, Mechanical Vibrations, chapter 3, on dynamic vibration absorbers.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import MANY, ONE, ClockedSession, Lanes, SampledModel, whole_turns
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import Limits

SWITCH_MARGIN = 0.05
"""Fraction of the track left free at each end; the supervisor stops runs that come closer."""

SPEED_MARGIN = 0.2
"""Fraction of the maximum cart speed left free, because the arms push a light cart beyond the commanded speed."""
_SLOWING = 0.02
"""Time constant of approaching the speed limit, s; avoids braking at full force there."""
_DRAINING = 0.8
"""Fraction of the maximum acceleration used against the arms' momentum; the rest centres the cart."""


@dataclass(frozen=True)
class CalmingSettings(Settings, table="calming"):
    """Parameters of the virtual cart, spring and damper.

    σ is the largest pull of the arms in kg, w their lowest frequency in rad/s about the hanging equilibrium.

    Args:
        mass: apparent mass, m = (1 + mass) σ.
        spring: stiffness, U' = spring σ w² x (1 + stiffening (x/travel)²).
        stiffening: growth of the stiffness towards the ends of the track.
        damper: damping, c = damper σ w.
        near: energy above rest at which the regulator takes over, as a fraction of the energy of upright arms. The
            regulator stays active up to four times this energy.
        fast: energy above which only the arms' momentum is used, as the same fraction.
        drain: gain γ on the momentum, 1/s.
        braking: fraction of the maximum acceleration assumed for stopping the cart.
    """

    mass: Annotated[float, Setting(above=0, most=100)] = 0.25
    spring: Annotated[float, Setting(above=0, most=100)] = 0.75
    stiffening: Annotated[float, Setting(least=0, most=100)] = 4.0
    damper: Annotated[float, Setting(above=0, most=100)] = 1.7
    near: Annotated[float, Setting(above=0, most=1)] = 0.1
    fast: Annotated[float, Setting(above=0, most=100)] = 1.4
    drain: Annotated[float, Setting(above=0, most=1000)] = 10.0
    braking: Annotated[float, Setting(above=0, most=1)] = 0.4


@dataclass(frozen=True, eq=False)
class CalmingController(Brief):
    """Controller that calms the arms from any state; see `calming_controller`."""

    law: Compiled
    parameters: Array
    regulator: HoldController
    near: float
    fast: float
    brake: float
    limits: Limits
    period: float
    reaction: float
    ticks: int
    kind: str = "calming"

    @property
    def first_state(self) -> Array:
        """Return the hanging equilibrium, with the cart in the middle."""
        return self.regulator.state

    def begin(self) -> "CalmingSession":
        """Return a session for one run."""
        return CalmingSession(self, near=False)

    def begin_many(self, count: int) -> "CalmingSession":
        """Return a session that computes `commands` for `count` runs.

        Args:
            count: number of runs.
        """
        return CalmingSession(self, near=np.zeros(count, dtype=bool), lanes=MANY)


class CalmingSession(ClockedSession):
    """One or many runs of calming.

    A flag marks each run whose regulator is active.
    """

    def __init__(self, law: CalmingController, *, near: Any, lanes: Lanes = ONE) -> None:
        self._law, self._near, self.lanes = law, near, lanes
        arms = len(law.first_state) // 2 - 1
        self._arms = arms
        count = 1 if lanes is ONE else len(near)
        size = 2 * arms + 2
        self._inputs = np.empty((law.law.size_in, count))
        self._inputs[size:] = law.parameters[:, None]
        self._out = np.empty((law.law.size_out, count))

    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return zero feedforward, the feedback and the nearest hanging state.

        Args:
            tick: the tick in which the command acts.
            states: state (N,) of one run, or states (S, N).

        Returns:
            Feedforward and feedback, m/s², and the reference, in the shape of the states.
        """
        law, n = self._law, self._arms
        columns = np.atleast_2d(states)
        self._inputs[: columns.shape[1]] = columns.T
        law.law(self._inputs, self._out)
        far, energy, swift = self._out
        wanted = np.tile(law.first_state, (len(columns), 1))
        wanted[:, :n] = whole_turns(columns[:, :n])
        held = energy < np.where(self._near, 4 * law.near, law.near)
        self._near = held if self.lanes is MANY else bool(held[0])
        feedback = np.where(held, (wanted - columns) @ law.regulator.gain, np.where(energy > law.fast, swift, far))
        speed = columns[:, -1]
        fastest = (1 - SPEED_MARGIN) * law.limits.velocity
        feedback = np.clip(feedback, (-fastest - speed) / _SLOWING, (fastest - speed) / _SLOWING)
        feedback = np.where(self._leaves(columns), -speed / law.period, feedback)
        if self.lanes is ONE:
            return 0.0, float(feedback[0]), wanted[0]
        return np.zeros(len(columns)), feedback, wanted

    def _leaves(self, states: Array) -> NDArray[np.bool_]:
        """True for each cart (S,) that must brake now.

        Otherwise it would leave the track.
        """
        law, position, velocity = self._law, states[:, -2], states[:, -1]
        stops = np.sign(velocity) * (position + velocity * law.reaction) + velocity**2 / (2 * law.brake)
        return stops > (1 - SWITCH_MARGIN) * law.limits.position


def calming_controller(
    model: SampledModel, limits: Limits, settings: CalmingSettings, *, reaction: float, seconds: float
) -> CalmingController:
    """Return the controller that brings this model to hang at rest.

    The cart ends in the middle of the track.

    Args:
        model: model of arms and drive from tick to tick.
        limits: the cart's limits.
        settings: parameters of the virtual cart, spring and damper.
        reaction: time until a command acts, s.
        seconds: duration of the controller, s.

    Raises:
        GoalMissed: The hanging equilibrium cannot be stabilised.
    """
    equations, parameters, n = model.equations, model.parameters, model.arms
    hanging = np.zeros(model.dimension)
    regulator = hold_controller(hanging, model, HoldSettings(damping=0.0), seconds=seconds)
    change, pull, momentum = _momentum(equations)
    numbers = ca.Function("numbers", [equations.state, equations.parameters], [pull, equations.hamiltonian])
    most, lowest = (float(value) for value in numbers(hanging, parameters))
    upright = hanging.copy()
    upright[:n] = np.pi
    span = float(numbers(upright, parameters)[1]) - lowest
    a, _ = model.linearised(hanging[None], np.zeros(1))
    slowest = np.abs(np.angle(np.linalg.eigvals(a[0][: 2 * n, : 2 * n]))).min() / model.period
    x, v = equations.state[2 * n], equations.state[2 * n + 1]
    spring = settings.spring * most * slowest**2 * x * (1 + settings.stiffening * (x / limits.position) ** 2)
    held = spring + settings.damper * most * slowest * v
    far = -(held + change) / ((1 + settings.mass) * most - pull)
    greatest = _DRAINING * limits.acceleration
    swift = ca.fmax(-greatest, ca.fmin(settings.drain * momentum / most, greatest)) - held / most
    law = ca.Function(
        "calming", [equations.state, equations.parameters],
        [ca.cse(ca.vertcat(far, equations.hamiltonian - lowest, swift))], ["state", "parameters"], ["out"],
    )  # fmt: skip
    return CalmingController(
        Compiled(law), parameters, regulator, settings.near * span, settings.fast * span,
        settings.braking * limits.acceleration, limits, model.period, reaction, regulator.ticks,
    )  # fmt: skip


def _momentum(equations: Equations) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return Ṗ₀, σ and P for the equations of a cart-level model."""
    n = equations.dimension // 2 - 1
    angles, rates = equations.state[:n], equations.state[n : 2 * n]
    acceleration = equations.rate[n : 2 * n]
    push = ca.jacobian(acceleration, equations.inputs)
    free = ca.substitute(acceleration, equations.inputs, ca.SX.zeros(1))
    momentum = -ca.dot(ca.gradient(equations.hamiltonian, rates), push)
    by_rate = ca.gradient(momentum, rates)
    change = ca.dot(ca.gradient(momentum, angles), rates) + ca.dot(by_rate, free)
    return change, -ca.dot(by_rate, push), momentum
