"""The extended Kalman filter as machine code: one tick at a time, or one tick of many runs at once.

The equations are those of `dpcontrol.control.ekf_equations`. `EkfProgram` is the function, with its inputs and outputs
in arrays (M,) or (M, S); `CompiledEkf` calls it for one run. Both therefore give the same estimates.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 10.3.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf_equations import FilterEquations, packed, unpacked
from dpcontrol.control.estimator_settings import Augment, FilterSettings
from dpcontrol.control.interface import Estimate
from dpcontrol.control.sampled import SampledModel
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import InputError

Array = NDArray[np.float64]

_AT_ONCE = 32
RESTART_RATE = 10.0
"""rad/s: standard deviation of the rates after a restart, as fast as the arms of a laboratory swing."""
RESTART_VELOCITY = 1.0
"""m/s: standard deviation of the cart's velocity after a restart."""


def checked_noise(noise: Array, arms: int) -> Array:
    """Return R (n+1, n+1), a covariance of the measured positions.

    Raises:
        InputError: it has the wrong shape or is no covariance.
    """
    r, m = np.array(noise, dtype=float), arms + 1
    if r.shape != (m, m):
        raise InputError(f"measurement noise has shape {r.shape}: {arms} arms need ({m}, {m})")
    if not np.isfinite(r).all() or np.abs(r - r.T).max() > 1e-12 * np.abs(r).max() or np.linalg.eigvalsh(r).min() <= 0:
        raise InputError("measurement noise must be a positive definite covariance")
    return r


@lru_cache(maxsize=32)
def _compiled(
    equations: Equations, period: float, augments: tuple[Augment, ...]
) -> tuple[FilterEquations, Compiled, Compiled, Compiled]:
    """Return the filter's equations and its step, update and prediction: made once for all runs of a process."""
    made = FilterEquations(equations, period, augments)
    step, update = Compiled(made.function(predicts=True)), Compiled(made.function(predicts=False))
    return made, step, update, Compiled(made.prediction(with_jacobian=False))


class EkfProgram:
    """The filter of one model, its inputs and outputs laid out for one run or for many.

    `step` and `update` take `inputs` (M,) or (M, S); `slices` tells where memory, command, measured, present, noise,
    parameters and process stand. Their outputs begin with the memory for the next tick; `out` tells where the rest
    stands. Values of positions that are not present must be finite all the same.
    """

    def __init__(self, model: SampledModel, settings: FilterSettings) -> None:
        self.model = model
        self.settings = settings
        self.equations, self.step, self.update, self.ahead = _compiled(model.equations, model.period, settings.augments)
        """ahead: from z, command, parameters and process to the next z (N+E,), without a measurement."""
        size, m = self.equations.dimension, model.arms + 1
        lengths = {"z": size, "covariance": size * (size + 1) // 2, "sigmas": size, "innovation": m, "later": size}
        lengths |= {"nis": 1, "used": 1, "sound": 1}
        ends = np.cumsum([*lengths.values()])
        self.out = {name: slice(int(end - n), int(end)) for (name, n), end in zip(lengths.items(), ends, strict=True)}
        """Where each output stands, by its name."""
        self.out["memory"] = slice(0, self.out["covariance"].stop)
        self.out["state"] = slice(0, model.dimension)
        self.out["extra"] = slice(model.dimension, size)
        self.process = settings.process(model.arms, model.period)

    @property
    def slices(self) -> dict[str, slice]:
        """Where each input stands, by its name."""
        return self.step.slices

    def first(self, state: Array, sigmas: Array | None = None) -> Array:
        """Return the memory before any measurement, of `state` (N,) or states (N, S); (memory,) or (memory, S).

        sigmas (N+E,): its standard deviations; the settings' by default.
        """
        arms, shape = self.model.arms, np.shape(state)[1:]
        one = packed(np.diag(np.square(self.settings.first_sigmas(arms) if sigmas is None else sigmas)))
        extra = np.zeros((self.equations.dimension - self.model.dimension, *shape))
        covariance = one.reshape(-1, *(1 for _ in shape)) * np.ones(shape)
        return np.concatenate([np.asarray(state, dtype=float), extra, covariance])

    def inputs(self, noise: Array, *, runs: int | None = None) -> Array:
        """Return inputs (M,), or (M, runs), with noise R (n+1, n+1), all positions present, and zeros elsewhere.

        Raises:
            InputError: the noise has the wrong shape or is no covariance.
        """
        out = np.zeros(self.step.size_in if runs is None else (self.step.size_in, runs))
        known = {
            "noise": packed(checked_noise(noise, self.model.arms)),
            "parameters": self.model.parameters,
            "process": self.process,
            "present": np.ones(self.model.arms + 1),
        }
        for name, value in known.items():
            out[self.slices[name]] = value if runs is None else value[:, None]
        return out


class _Memory(NamedTuple):
    """What the filter keeps from tick to tick: z and P; and z a period later, if `coming` m/s² act until then."""

    kept: Array
    coming: float
    later: Array


class CompiledEkf:
    """The extended Kalman filter for one sampled model; an `Estimator`. Not to be shared between threads.

    noise (n+1, n+1): of the measured positions.

    Raises:
        InputError: the noise has the wrong shape or is no covariance.
    """

    def __init__(self, model: SampledModel, settings: FilterSettings, *, noise: Array) -> None:
        self.model = model
        self.settings = settings
        self.program = EkfProgram(model, settings)
        self._inputs = self.program.inputs(noise)
        self._size = model.dimension
        where, out = self.program.slices, self.program.out
        # Made once: views of the inputs and slices of the outputs cost as much as the call if made at every tick.
        self._memory, self._measured = self._inputs[where["memory"]], self._inputs[where["measured"]]
        self._present = self._inputs[where["present"]]
        self._command_at = where["command"].start
        self._all = True
        self._shape, self._kept = self._measured.shape, len(self._memory)
        self._z, self._coming_at = out["z"].stop, where["coming"].start
        self._rooms = self._room()
        ahead = self.program.ahead
        for function in (self.program.update, self.program.step, ahead):
            # Compiled now: the first ticks of a run have no time for it.
            _ = function.machine
        self._ahead_inputs = np.zeros(ahead.size_in)
        for name, value in (("parameters", model.parameters), ("process", self.program.process)):
            self._ahead_inputs[ahead.slices[name]] = value

    def _room(self) -> Iterator[tuple[Array, ...]]:
        """Yield outputs and views of their parts: views of many ticks' at once are made in half the time."""
        parts = [self.program.out[name] for name in ("state", "extra", "sigmas", "innovation", "memory", "later")]
        while True:
            block = np.empty((_AT_ONCE, self.program.step.size_out))
            yield from zip(block, block[:, -3:], *(block[:, part] for part in parts), strict=True)

    @property
    def kind(self) -> str:
        """Return the name of its kind."""
        return self.settings.kind

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Return the names of what it is augmented by."""
        return self.program.equations.extra_names

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement: `state` (N,) with the settings' standard deviations.

        Raises:
            InputError: the state has the wrong shape.
        """
        x = np.array(state, dtype=float)
        if x.shape != (self._size,):
            raise InputError(f"state has shape {x.shape}: the filter's model needs ({self._size},)")
        return self._begun(self.program.first(x), self.settings.first_sigmas(self.model.arms))

    def _begun(self, memory: Array, sigmas: Array) -> Estimate:
        still = np.zeros(self.model.arms + 1)
        state, extra = memory[: self._size], memory[self._size : self._z]
        return Estimate(state, extra, sigmas, still, float("nan"), 0, _Memory(memory, float("nan"), state))

    def update(
        self, estimate: Estimate, measured: Array, present: NDArray[np.bool_] | None = None, *, coming: float = 0.0
    ) -> Estimate:
        """Return the estimate after the positions `measured` (n+1,): angles in rad, cart in m.

        present (n+1,): which of them count; all by default. coming: the next period's command, which spares `ahead` its
        first period.

        Raises:
            InputError: the measurement or the estimate has the wrong shape.
            ArithmeticError: the estimate is no longer finite, or its covariance no longer positive.
        """
        return self._called(self.program.update, estimate, measured, present, coming)

    def step(
        self,
        estimate: Estimate,
        command: float,
        measured: Array,
        present: NDArray[np.bool_] | None = None,
        *,
        coming: float = 0.0,
    ) -> Estimate:
        """Return the estimate a period later: the cart accelerated by `command` m/s², then `measured` came.

        present, coming: as in `update`.

        Raises:
            InputError: the measurement or the estimate has the wrong shape.
            ArithmeticError: the estimate is no longer finite, or its covariance no longer positive.
        """
        self._inputs[self._command_at] = command
        return self._called(self.program.step, estimate, measured, present, coming)

    def _called(
        self, program: Compiled, estimate: Estimate, measured: Array, present: NDArray[np.bool_] | None, coming: float
    ) -> Estimate:
        memory = estimate.memory.kept
        self._inputs[self._coming_at] = coming
        if measured.shape != self._shape or len(memory) != self._kept:
            raise InputError(
                f"measurement has shape {measured.shape} and the estimate's memory {memory.shape}: the filter needs "
                f"{self._shape} and {self._memory.shape}"
            )
        self._memory[:] = memory
        if present is not None:
            # What is not a number must not reach the products: zero times it is not zero.
            np.copyto(self._measured, 0.0)
            np.copyto(self._measured, measured, where=present)
            self._present[:] = present
            self._all = False
        else:
            self._measured[:] = measured
            if not self._all:
                self._present[:] = 1.0
                self._all = True
        out, told, state, extra, sigmas, innovation, kept, later = next(self._rooms)
        program.machine(self._inputs, out)
        nis, used, sound = told.tolist()
        if not (0 <= nis < inf and -inf < sound < inf):
            raise ArithmeticError(
                "the filter's covariance is no longer positive, or its state no longer finite; begin again from the "
                "measured positions, or assume more noise"
            )
        return Estimate(state, extra, sigmas, innovation, nis, int(used), _Memory(kept, coming, later))

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the commands on their way, one per period, with the extras' effect.

        This compensates the delay: a new command is computed for the state at which it will act.
        """
        memory: _Memory = estimate.memory
        first = 0
        z = memory.kept[: self._z]
        if commands and commands[0] == memory.coming:
            first, z = 1, memory.later
        inputs, n = self._ahead_inputs, self._z
        for command in commands[first:]:
            inputs[:n] = z
            inputs[n] = command
            z = self.program.ahead(inputs, np.empty(n))
        return z[: self._size]

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N+E, N+E) of state and extra."""
        return unpacked(estimate.memory.kept[self._z :])

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return an estimate that trusts the positions `measured` (n+1,) and little else: for recovery when lost.

        The rates stay where they are finite, but count for little; the extras begin anew.

        Raises:
            InputError: a measured position is missing or not finite.
        """
        return self._begun(*restarted(self.program, estimate.state, measured))


def restarted(program: EkfProgram, state: Array, measured: Array) -> tuple[Array, Array]:
    """Return memory and standard deviations (N+E,) of an estimate that trusts `measured` (n+1,) and little else.

    Raises:
        InputError: a measured position is missing or not finite.
    """
    model, arms = program.model, program.model.arms
    z = np.asarray(measured, dtype=float)
    if z.shape != (arms + 1,) or not np.isfinite(z).all():
        raise InputError(f"measured = {z.tolist()!r}: a restart needs {arms + 1} finite positions")
    x = np.where(np.isfinite(state), state, 0.0)
    x[arms : 2 * arms] = np.clip(x[arms : 2 * arms], -3 * RESTART_RATE, 3 * RESTART_RATE)
    x[-1] = np.clip(x[-1], -3 * RESTART_VELOCITY, 3 * RESTART_VELOCITY)
    x[model.position_indices] = z
    sigmas = program.settings.first_sigmas(arms)
    sigmas[arms : 2 * arms] = RESTART_RATE
    sigmas[2 * arms + 1] = RESTART_VELOCITY
    return program.first(x, sigmas), sigmas
