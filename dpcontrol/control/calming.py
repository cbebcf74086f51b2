"""Calming: bring arms that swing or turn in any way to hang at rest, by the cart, inside its track.

Far from hanging still the cart moves as one of apparent mass m on a spring and a damper would, with the arms pulling at
it: their common energy only falls, whatever they do, and what they lose goes through the damper.

    d/dt (m v + P) = -U'(x) - c v          P(θ, ω): the arms' momentum along the track, against the cart
    E = H(θ, ω) + P v + m v²/2 + U(x),     Ė = -c v² - friction
    u = -(U'(x) + c v + Ṗ₀) / (m - σ),     Ṗ = Ṗ₀ - σ u

P, Ṗ₀ and σ come from the one model: Ḣ = -P u. The spring keeps the cart near the middle. Near
hanging still a linear-quadratic regulator takes over, which is quicker there.

Arms that a blow has made fast pull harder than any drive can follow, and the law above, cut to what it can, would feed
them. There the cart is moved against their momentum itself, for which Ḣ = -P u is enough:

    u = clip(γ P / σ) - U'(x)/σ - c v/σ

The cart's speed is kept to a share of its limit, and its place to a share of the track.

Sources: Ortega, van der Schaft, Mareels & Maschke, Putting energy back in control (2001), on interconnection; Den
Hartog, Mechanical Vibrations, chapter 3, on the damper that a mass on a spring makes.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import MANY, ONE, ClockedSession, Lanes, SampledModel, whole_turns
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.references.problem import Limits

SWITCH_MARGIN = 0.05
"""Share of the track that is left free at its ends: the supervisor ends what comes nearer."""

SPEED_MARGIN = 0.2
"""Share of the cart's greatest speed that is left free: arms that pull at a light cart add to what is commanded."""
_SLOWING = 0.02
"""s: time constant of approaching the speed that is left, so that the drive is not braked at full force there."""
_DRAINING = 0.8
"""Share of the greatest acceleration for the arms' momentum; the rest keeps the cart near the middle."""


@dataclass(frozen=True)
class CalmingSettings(Settings, table="calming"):
    """The cart that is imitated, by the arms' greatest pull σ kg and slowest frequency w rad/s where they hang.

    mass: m = (1 + mass) σ; spring: U' = spring σ w² x (1 + stiffening (x/travel)²); damper: c = damper σ w. near:
    energy above hanging still, as a share of what turns the arms upright, below which the regulator takes over; it
    keeps on to four times that. fast: likewise, above which the arms' momentum alone is heeded; drain: γ, 1/s. braking:
    share of the greatest acceleration that is counted on to stop the cart.
    """

    mass: float = setting(0.25, above=0, most=100)
    spring: float = setting(0.75, above=0, most=100)
    stiffening: float = setting(4.0, least=0, most=100)
    damper: float = setting(1.7, above=0, most=100)
    near: float = setting(0.1, above=0, most=1)
    fast: float = setting(1.4, above=0, most=100)
    drain: float = setting(10.0, above=0, most=1000)
    braking: float = setting(0.4, above=0, most=1)


@dataclass(frozen=True, eq=False)
class CalmingController:
    """Calms arms from any state for so many ticks; see `calming_controller`."""

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
        """Return hanging still, the cart in the middle."""
        return self.regulator.state

    def begin(self) -> "CalmingSession":
        """Return a session for one run."""
        return CalmingSession(self, near=False)

    def begin_many(self, count: int) -> "CalmingSession":
        """Return what answers `commands` for `count` runs."""
        return CalmingSession(self, near=np.zeros(count, dtype=bool), lanes=MANY)


class CalmingSession(ClockedSession):
    """One run of calming, or many: whether the regulator has taken over."""

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
        """Return no feedforward, the feedback in m/s², and hanging still on these turns, for (N,) or (S, N) states."""
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
        """Tell which carts (S,) must brake now to stay on the track."""
        law, position, velocity = self._law, states[:, -2], states[:, -1]
        stops = np.sign(velocity) * (position + velocity * law.reaction) + velocity**2 / (2 * law.brake)
        return stops > (1 - SWITCH_MARGIN) * law.limits.position

    def resynchronise(self, tick: int, state: Array) -> str:
        """Leave all as it is: there is no clock."""
        return ""


def calming_controller(
    model: SampledModel, limits: Limits, settings: CalmingSettings, *, reaction: float, seconds: float
) -> CalmingController:
    """Return what brings the arms of this model to hang at rest with the cart in the middle; reaction s: until a
    command acts, seconds: for how long it goes on.

    Raises:
        GoalMissed: hanging still cannot be held.
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
    """Return Ṗ₀, σ and P of a cart level's equations."""
    n = equations.dimension // 2 - 1
    angles, rates = equations.state[:n], equations.state[n : 2 * n]
    acceleration = equations.rate[n : 2 * n]
    push = ca.jacobian(acceleration, equations.inputs)
    free = ca.substitute(acceleration, equations.inputs, ca.SX.zeros(1))
    momentum = -ca.dot(ca.gradient(equations.hamiltonian, rates), push)
    by_rate = ca.gradient(momentum, rates)
    change = ca.dot(ca.gradient(momentum, angles), rates) + ca.dot(by_rate, free)
    return change, -ca.dot(by_rate, push), momentum
