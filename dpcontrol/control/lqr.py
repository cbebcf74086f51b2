"""Linear-quadratic regulation: weights, and stabilisation of an equilibrium.

    u = -K (x̂ - x*),    K = (r + BᵀPB)⁻¹ BᵀPA,    P of the discrete algebraic Riccati equation of the sampled model

The diagonal of Q and r for a period of T s follow from weights per second.

    Q = T diag(w / s²),   r = T w_u:   weights w of errors measured in s, the scales of angles, rates and cart

If the estimator estimates extra quantities w, such as unexplained accelerations of the arms, the feedback adds -F w. F
is the infinite-horizon limit of the gains of `dpcontrol.control.tracking`.

    x_{k+1} = A x_k + B u_k + E w_k,   w_{k+1} = D w_k,   F = (r + BᵀPB)⁻¹ Bᵀ N,   N = (A - BK)ᵀ N D + P E

This compensates dry friction although the model of a hold has none, since dry friction has no useful derivative at
rest.

Sources: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., section 9.3. Anderson & Moore, Optimal
Control: Linear Quadratic Methods, chapter 6, on selecting weights.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from dpcontrol.control.interface import Action, GainSchedule, Mode, SampledModel, Session, pendulum_scale, whole_turns
from dpcontrol.dynamics.chain import damping_scales
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.references.problem import ANGLE_SCALE, CART_VELOCITY_SCALE, RATE_SCALE


@dataclass(frozen=True)
class QuadraticWeights(Settings, table="controller"):
    """Weights per second of the squared, scaled errors.

    The scales are π for angles, 10 rad/s for rates, 3 m/s for the cart's velocity, 1 m for its position and 1 m/s² for
    the effort.
    """

    angle: Annotated[float, Setting(least=0, help="Weight of the angles.")] = 1000.0
    rate: Annotated[float, Setting(least=0, help="Weight of the rates.")] = 100.0
    position: Annotated[float, Setting(above=0, help="Weight of the cart's position.")] = 100.0
    velocity: Annotated[float, Setting(least=0, help="Weight of the cart's velocity.")] = 10.0
    effort: Annotated[float, Setting(above=0, help="Weight of the cart's acceleration.")] = 1.0

    def weights(self, arms: int, period: float) -> tuple[Array, float]:
        """Return Q's diagonal (N,) and r, the weights of a state's error and of a command in one period.

        Args:
            arms: number of arms.
            period: time between ticks, s.
        """
        pendulum = [self.angle / ANGLE_SCALE**2] * arms + [self.rate / RATE_SCALE**2] * arms
        cart = [self.position, self.velocity / CART_VELOCITY_SCALE**2]
        return np.array(pendulum + cart) * period, self.effort * period


@dataclass(frozen=True)
class ClosingWeights(QuadraticWeights):
    """Weights along a reference.

    In the last `closing_time` s, angles across their path weigh `closing` times more. There, the angles must be on the
    model's orbit, whatever the real arms' own motion would be.
    """

    closing: Annotated[
        float, Setting(least=1, most=1e6, help="Factor on the angles' weight at the end of a reference.")
    ] = 10.0
    closing_time: Annotated[float, Setting(least=0, most=1e4, unit="s", help="Duration of that end.")] = 1.6


@dataclass(frozen=True)
class HoldSettings(QuadraticWeights):
    """Linear-quadratic regulator at an equilibrium."""

    kind: str = "lqr"
    damping: Annotated[
        float | None,
        Setting(
            least=0,
            most=10,
            help="Assumed viscous friction beyond the model's; by default what the arms allow, at most 0.06.",
        ),
    ] = None
    """Viscous friction beyond the model's in each joint, over √(G M), for the mean effect of dry friction; gains
    without it let the arms oscillate with twice the amplitude. None: see `assumed_damping`."""


UNKNOWN_FRICTION = 0.06
"""Assumed viscous friction for dry friction that the model lacks."""
_KEPT_MARGIN = 0.5
"""Share of the loop's modulus margin that the assumed friction must leave."""
_CIRCLE = np.exp(1j * np.geomspace(1e-4, np.pi, 500))[:, None]
"""Points z of the unit circle at which the margin is computed."""


@dataclass(frozen=True, eq=False)
class HoldController(Brief):
    """Gain (N,) about an equilibrium.

    `state` (N,) is the equilibrium with the cart in the middle.

    Attributes:
        ticks: number of periods.
        drive_gain: gain on the cart's acceleration, for a lagging drive.
        extra_gains: gains (E,) on the disturbances that the estimator adds to the state, its extras `names`.
        cost: matrix P (N, N) of the cost-to-go.
    """

    kind: str
    state: Array
    gain: Array
    ticks: int
    drive_gain: float | None = None
    extra_gains: Array | None = None
    names: tuple[str, ...] = ()
    cost: Array | None = None

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,): the equilibrium."""
        return self.state

    def schedule(self, lead: int) -> GainSchedule:
        """Return the gain schedule of the hold, with the same row at every tick.

        Args:
            lead: number of ticks between the computation of a command and its action.
        """
        n, count = (len(self.state) - 2) // 2, self.ticks + 1
        drive = [] if self.drive_gain is None else [0.0, self.drive_gain]
        extras = [] if self.extra_gains is None else self.extra_gains
        row = np.concatenate([[0.0], self.gain, self.state, drive, extras, self.state[:n]])
        shares = None if self.extra_gains is None else (False,) * len(self.names)
        return GainSchedule(
            np.tile(row, (count, 1)), np.tile(self.state, (count, 1)), np.zeros(lead), Mode.HOLDING, shares, self.names
        )

    def join(self, tick: int, state: Array) -> "HoldSession":
        """Return a session that holds the equilibrium with the turns of its angles nearest to the state.

        Args:
            tick: ignored.
            state: present state (N,).
        """
        n = (len(state) - 2) // 2
        lifted = self.state.copy()
        lifted[:n] += whole_turns(state[:n] - lifted[:n])
        return HoldSession(self, lifted)

    def distance(self, state: Array) -> float:
        """Return the scaled distance from the equilibrium, modulo turns, by which a fallback is chosen.

        Args:
            state: state (N,), whose cart is ignored.
        """
        n = (len(state) - 2) // 2
        differences = np.asarray(state[: 2 * n] - self.state[: 2 * n])
        differences[:n] -= whole_turns(differences[:n])
        return float(np.abs(differences / pendulum_scale(n)).max())


class HoldSession(Session):
    """A hold during one run.

    `_wanted` (N,) is the equilibrium with the run's turns, `_gain` (N,) the gains on the deviation from it, and
    `_extra_gains` (E,) those on the estimator's extras, or None. None of them changes during the run.
    """

    def __init__(self, controller: HoldController, wanted: Array) -> None:
        """Begin a hold.

        Args:
            controller: the controller.
            wanted: equilibrium (N,) with the run's turns.
        """
        self._gain, self._extra_gains, self._wanted = controller.gain, controller.extra_gains, wanted

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action for the period from a tick.

        Args:
            tick: ignored.
            state: predicted state (N,) at the tick.
            extra: estimated extras (E,).
        """
        feedback = 0.0
        # The order of the sum is that of the compiled tick (`TickEquations.law`).
        for product in (self._gain * (self._wanted - state)).tolist():
            feedback += product
        if self._extra_gains is not None:
            feedback -= float(self._extra_gains @ extra)
        return Action(0.0, feedback, self._wanted, Mode.HOLDING)


@dataclass(frozen=True, eq=False)
class ExtraEffects(Brief):
    """Disturbances w (E,) that an estimator adds to the state, such as unexplained accelerations of the arms.

    They have `names` (E,). Their effect on the state after a period is E w, with `effects` E (N, E). In a period they
    decay by factors D (E,), which are `kept`: w+ = D w.
    """

    names: tuple[str, ...]
    effects: Array
    kept: Array


def _regulator(
    model: SampledModel, x: Array, settings: HoldSettings, damping: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Return A (N, N) and B (N,) between ticks, and the best loop's gains (N,), cost-to-go and multipliers (N,).

    With a lagging drive, the cart's acceleration is another state.

    `x` (N,): equilibrium. `settings`: weights of state and command; their own damping is not used. `damping`: viscous
    friction beyond the model's, over √(G M).

    Raises:
        GoalMissed: the equilibrium cannot be stabilised.
    """
    # Importing python-control takes more than a second.
    from control import dlqr

    n, parameters = model.arms, model.parameters.copy()
    parameters[n * (n + 1) // 2 + 2 * n :][:n] += damping * np.array(damping_scales(parameters, n))
    state_jacobian, input_jacobian = (
        jacobian[0] for jacobian in model.lagging(*model.linearised(x[None, :], np.zeros(1), parameters=parameters))
    )
    weights, effort = settings.weights(n, model.period)
    try:
        state_weights = np.diag(np.append(weights, [0.0] * (len(input_jacobian) - len(x))))
        gain, cost, multipliers = dlqr(state_jacobian, input_jacobian[:, None], state_weights, np.array([[effort]]))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise GoalMissed(f"the equilibrium cannot be held: {error}") from error
    return state_jacobian, input_jacobian, np.asarray(gain)[0], cost, np.asarray(multipliers)


def assumed_damping(model: SampledModel, x: Array, settings: HoldSettings, *, most: float) -> float:
    """Return the largest assumed damping that leaves the loop half of its modulus margin.

    Dry friction c acts on a rate of amplitude A as viscous friction 4 c/(π A). It is strong where the arms are nearly
    still and vanishes in large motion, so the gains must also hold arms without it. The more arms there are, the less
    damping they bear. The modulus margin min |1 + L| is the distance of the loop from instability,

        1 + L(z) = det(zI - A + BK) / det(zI - A) = Π (z - μ_closed) / (z - μ_open)  on |z| = 1,

    with A, B of the model's own arms, K for damped ones, and the eigenvalues μ of both matrices.

    Source: Åström & Murray, Feedback Systems, 2nd ed., section 10.3.

    Args:
        model: model of arms and drive from tick to tick.
        x: equilibrium (N,).
        settings: weights.
        most: largest value.
    """
    state_jacobian, input_jacobian, *_ = _regulator(model, x, settings, 0.0)

    def margin(damping: float) -> float:
        """Return the modulus margin of the undamped arms' loop with the gains for damped arms, 0 if it is unstable."""
        closed = np.linalg.eigvals(
            state_jacobian - np.outer(input_jacobian, _regulator(model, x, settings, damping)[2])
        )
        distances = np.abs(np.prod((_CIRCLE - closed) / (_CIRCLE - np.linalg.eigvals(state_jacobian)), axis=1))
        return float(distances.min()) if np.abs(closed).max() < 1 else 0.0

    needed = _KEPT_MARGIN * margin(0.0)
    return next(damping for damping in np.linspace(most, 0.0, 21).tolist() if margin(damping) >= needed)


def hold_controller(
    state: ArrayLike,
    model: SampledModel,
    settings: HoldSettings,
    *,
    seconds: float,
    extras: ExtraEffects | None = None,
    dry: float = 0.0,
) -> HoldController:
    """Return the regulator for an equilibrium with the cart in the middle.

    Args:
        state: equilibrium (2n,) of the pendulum, or a state that begins with it; the cart's entries are ignored.
        model: model of arms and drive from tick to tick.
        settings: weights and additional damping.
        seconds: duration of the hold, s.
        extras: disturbances w that the estimator adds to the state, which get gains; None for no such gains.
        dry: viscous friction that has the mean effect of the arms' dry friction, over √(G M). It is added to the
            additional damping of the settings, or else to the largest damping that the arms may allow.

    Raises:
        GoalMissed: the equilibrium cannot be stabilised.
    """
    equilibrium = np.concatenate([np.asarray(state, dtype=float)[: 2 * model.arms], [0.0, 0.0]])
    stated_damping = settings.damping
    damping = (
        assumed_damping(model, equilibrium, settings, most=UNKNOWN_FRICTION + dry)
        if stated_damping is None
        else stated_damping + dry
    )
    state_jacobian, input_jacobian, gains, cost, multipliers = _regulator(model, equilibrium, settings, damping)
    slowest = float(np.abs(multipliers).max())
    if not slowest < 1:
        raise GoalMissed(f"the equilibrium cannot be held: the best loop's largest multiplier is {slowest:.6g}")
    drive = float(gains[-1]) if model.lag else None
    size = len(equilibrium)
    controller = HoldController(
        settings.kind, equilibrium, gains[:size], max(round(seconds / model.period), 1), drive, cost=cost[:size, :size]
    )
    if extras is None:
        return controller
    effects = cost @ np.pad(extras.effects, ((0, len(input_jacobian) - len(equilibrium)), (0, 0)))
    closed, unit = state_jacobian - np.outer(input_jacobian, gains), np.eye(len(input_jacobian))
    extra_costs = [
        np.linalg.solve(unit - decay * closed.T, push) for decay, push in zip(extras.kept, effects.T, strict=True)
    ]
    extra_gains = (
        np.reshape(extra_costs, (-1, len(input_jacobian)))
        @ input_jacobian
        / (settings.effort * model.period + input_jacobian @ cost @ input_jacobian)
    )
    return replace(controller, extra_gains=extra_gains, names=extras.names)
