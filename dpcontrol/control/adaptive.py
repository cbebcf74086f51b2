"""Tracking that counts on what the estimator finds wrong with the model: one gain more for each extra quantity.

    e_{k+1} = A_k e_k + B_k v_k + E_k w_k,   w_{k+1} = D w_k,   minimise Σ_k e_kᵀ Q_k e_k + r v_k² + e_Kᵀ P_K e_K
    v_k = -K_k e_k - F_k w_k,     F_k = (r + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ (P_{k+1} E_k + N_{k+1} D),
    N_k = (A_k - B_k K_k)ᵀ (P_{k+1} E_k + N_{k+1} D),     N_K = 0

e: the state's distance from the reference, v: the input's, as in `dpcontrol.control.tracking`; w: the estimator's extra
quantities, above all the relative errors of the model's parameters. N carries back from the reference's end what they
will do along all that remains, so the feedback leans against a wrong mass before it is felt; without w it is TVLQR.
To first order in w. The symmetric share 2 (p - p₀)/(p + p₀) stands for a parameter's relative error: it agrees with it
to first order, and to second with the logarithm, in which the equations know no overall scale.

Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 2.4 and 10.3; Åström & Wittenmark,
Adaptive Control, section 1.4 (certainty equivalence).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import FilterEquations
from dpcontrol.control.estimator_settings import Augment, FilterSettings, extra_names
from dpcontrol.control.interface import Action, Mode, SampledModel
from dpcontrol.control.lqr import ClosingWeights
from dpcontrol.control.tracking import (
    FeedforwardSettings,
    TimedController,
    TimedSession,
    terminal_cost,
    tracking_controller,
)
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import setting
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdaptiveSettings(ClosingWeights):
    """Weights as of "tvlqr", heavier by default: what is known of the model needs no feedback, so there is room.

    trust: the greatest share by which a parameter is taken to be wrong; masses and lengths that are off by a fifth make
    base parameters off by 0.39 at most.
    """

    kind: str = "adaptive"
    angle: float = 30_000.0
    rate: float = 3000.0
    position: float = 300.0
    closing: float = 30.0
    trust: float = setting(0.4, least=0, most=1.9)


@dataclass(frozen=True, eq=False)
class AdaptiveController(TimedController):
    """Gains by time on the state and, (K, E), on the extras.

    shares (E,): which extras are relative errors of parameters; names: of all; trust: of shares, see the settings.
    """

    extra_gains: Array
    names: tuple[str, ...]
    shares: NDArray[np.bool_]
    trust: float

    def believed(self, extras: Array) -> Array:
        """Return what the gains act on for extras (E,) or (E, S): shares made symmetric and bounded by the trust."""
        out = np.array(extras, dtype=float)
        found = np.maximum(out[self.shares], -1.0)
        out[self.shares] = np.clip(found / (1 + found / 2), -self.trust, self.trust)
        return out

    def commands(self, tick: int, states: Array, extras: Array) -> tuple[float, Array, Array]:
        """Return feedforward m/s², feedbacks (S,) m/s² and the reference (N,) for states (N, S), extras (E, S).

        The products are added up in the order of state and extras, as for one run: both agree to the last bit.
        """
        k = min(tick, self.ticks - 1)
        wanted = self.reference_states[min(tick, self.ticks)]
        by_state = self.gains[k][:, None] * (self.reference_states[k][:, None] - states)
        by_extra = -self.extra_gains[k][:, None] * self.believed(extras)
        return float(self.feedforward[k]), np.add.reduce(np.concatenate([by_state, by_extra]), axis=0), wanted

    def join(self, tick: int, state: Array) -> "AdaptiveSession":
        """Return a session whose start is at `tick`."""
        return AdaptiveSession(self, tick)


class AdaptiveSession(TimedSession):
    """An adaptive controller during one run."""

    def __init__(self, controller: AdaptiveController, start: int = 0) -> None:
        super().__init__(start)
        self._controller = controller
        self._feedforward = controller.feedforward.tolist()
        self._last = len(self._feedforward) - 1
        self._shares = controller.shares.tolist()
        self._doubted = False

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick`; an event when the model is first found wrong beyond trust."""
        law, tick = self._controller, max(tick - self._start, 0)
        k = tick if tick < self._last else self._last
        wanted = law.reference_states[tick if tick <= self._last else self._last + 1]
        feedback, trust, beyond = 0.0, law.trust, -1
        for product in (law.gains[k] * (law.reference_states[k] - state)).tolist():
            feedback += product
        # Python's own numbers: for so few, arrays take three times as long.
        found = extra.tolist()
        for i, gain in enumerate(law.extra_gains[k].tolist()):
            value = found[i]
            if self._shares[i]:
                value = max(value, -1.0)
                value = value / (1 + value / 2)
                if abs(value) > trust:
                    value, beyond = math.copysign(trust, value), i
            feedback -= gain * value
        event = "" if beyond < 0 or self._doubted else self._doubt(beyond, found[beyond])
        return Action(self._feedforward[k], feedback, wanted, Mode.TRACKING, event)

    def _doubt(self, which: int, share: float) -> str:
        """Return a sentence on a parameter that is found wrong by more than the trust."""
        self._doubted = True
        law = self._controller
        return (
            f"model doubted: {law.names[which]} is found to be off by {share:+.0%}, more than first order carries "
            f"(trust {law.trust:g}); identify the arms, or expect the reference to be lost"
        )


def preview_gains(
    jacobians: tuple[Array, Array, Array, Array], *, weights: Array, effort: float, terminal: Array
) -> tuple[Array, Array]:
    """Return gains on the state (K, N) and on the extras (K, E).

    jacobians: A (K, N, N), B (K, N), E (K, N, E) and D (E,), the share of each extra left after a period; weights
    (K, N): Q's diagonals; terminal (N, N): P at the end.
    """
    a, b, e, kept = jacobians
    gains, extra_gains = np.empty(b.shape), np.empty((len(b), len(kept)))
    cost, carried = terminal, np.zeros(e.shape[1:])
    for k in range(len(b) - 1, -1, -1):
        push = cost @ e[k] + carried * kept
        weighted = b[k] @ cost
        curvature = effort + weighted @ b[k]
        gain = (weighted @ a[k]) / curvature
        gains[k], extra_gains[k] = gain, (b[k] @ push) / curvature
        closed = a[k] - np.outer(b[k], gain)
        carried = closed.T @ push
        # The symmetric form keeps P positive (Joseph): thousands of steps would lose it otherwise.
        cost = np.diag(weights[k]) + effort * np.outer(gain, gain) + closed.T @ cost @ closed
        cost = (cost + cost.T) / 2
    return gains, extra_gains


def extra_jacobians(
    model: SampledModel, augment: tuple[Augment, ...], states: Array, commands: Array, process: Array
) -> tuple[Array, Array]:
    """Return E (K, N, E) and D (E,) at states (K, N) and commands (K,), from the estimator's own prediction."""
    equations = FilterEquations(model.equations, model.period, augment)
    size, n, count = equations.dimension, model.dimension, len(states)
    program = Compiled(equations.prediction(with_jacobian=True))
    inputs = np.zeros((program.size_in, count))
    inputs[:n] = states.T
    for name, value in (("command", commands), ("parameters", model.parameters), ("process", process)):
        inputs[program.slices[name]] = value if name == "command" else value[:, None]
    out = program(inputs, np.empty((program.size_out, count)))
    jacobian = out[size : size + size * size].reshape(size, size, count)
    # casadi writes column by column: the first index is the column.
    return jacobian[n:, :n].transpose(2, 1, 0).copy(), jacobian[range(n, size), range(n, size), 0].copy()


def adaptive_controller(
    reference: Reference, model: SampledModel, settings: AdaptiveSettings, *, estimator: FilterSettings
) -> AdaptiveController:
    """Return the controller for `reference` at the model's period, for what `estimator` estimates besides the state.

    Raises:
        InputError: the reference did not converge or has another number of states than the model, or the estimator
            does not estimate the parameters.
        GoalMissed: the reference's end cannot be stabilised.
    """
    if Augment.PARAMETERS not in estimator.augments:
        raise InputError(
            f"controller: kind = {settings.kind!r} needs to know what is wrong with the model, and the estimator has "
            f'augment = {list(estimator.augment)!r}: add "parameters", and "friction" as well'
        )
    plain = tracking_controller(reference, model, FeedforwardSettings())
    states, commands = plain.reference_states, plain.feedforward
    a, b = model.linearised(states[:-1], commands)
    process = estimator.process(model.arms, model.period)
    e, kept = extra_jacobians(model, estimator.augments, states[:-1], commands, process)
    diagonal, effort = settings.weights(model.arms, model.period)
    weights = settings.along(model.arms, model.period, count=len(b))
    terminal = terminal_cost(a[-1], b[-1], weights=diagonal, effort=effort)
    gains, extra_gains = preview_gains((a, b, e, kept), weights=weights, effort=effort, terminal=terminal)
    if not (np.isfinite(gains).all() and np.isfinite(extra_gains).all()):
        raise GoalMissed("the controller's gains became infinite; weigh effort more or shorten the period")
    names = extra_names(model.arms, estimator.augments)
    shares = np.array([name.startswith(("M", "S")) for name in names])
    return AdaptiveController(
        settings.kind, states, commands, gains,
        f"gains for {len(commands)} ticks, on the state and on {', '.join(names)}",
        extra_gains, names, shares, settings.trust,
    )  # fmt: skip
