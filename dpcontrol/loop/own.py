"""Users' Python objects in the loop: law, estimator, plant or rig.

    controller    control(time, state, reference) -> acceleration, m/s²
    estimator     update(reading, acceleration) -> state (N,)
    plant         step(state, acceleration, seconds) -> state (N,)
    rig           read() -> positions (n+1,) or a reading, command(acceleration), stop()

The first three may define `reset()`, which is called before each run. A run ends if a call raises or returns an invalid
value.
"""

import inspect
import math
import pickle
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any
from uuid import uuid4

import numpy as np

from dpcontrol.control.estimator_settings import FilterSettings
from dpcontrol.control.interface import Action, Estimate, Estimator, Mode, Present, SampledModel, Session
from dpcontrol.control.symbolic import Setpoint, SymbolicLaw
from dpcontrol.control.tracking import ReferenceController
from dpcontrol.dynamics.components import SymbolicPlant
from dpcontrol.dynamics.plant import PlantParameters, after_blow
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import content_hash
from dpcontrol.logs import Event
from dpcontrol.loop.bench import Blow
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import ended

NEEDED = {
    "controller": ("control(time, state, reference)",),
    "estimator": ("update(reading, acceleration)",),
    "plant": ("step(state, acceleration, seconds)",),
    "rig": ("read()", "command(acceleration)", "stop()"),
}
"""The methods that an object needs in each role."""
LARGEST = 1e6
"""Upper bound of plausible accelerations and states, SI units."""
_NUMBERS = f"finite numbers up to {LARGEST:g}, SI"
_SHOWN = 60
"""Maximum length of a value in an error message, characters."""


class OwnFailure(ArithmeticError):
    """A user's object raised, or returned an invalid value.

    The message has the object, the method and the value.
    """


class OwnObject:
    """A user's object as controller, estimator, plant or rig.

    Args:
        role: the role of the object.
        thing: the object.
        source: FILE.py:CLASS if the object comes from a file.

    Raises:
        InputError: the object lacks a method or is a class.
    """

    def __init__(self, role: str, thing: Any, source: str = "") -> None:
        """Check that the object is not a class, and that it has the methods of its role."""
        self.role, self.thing, self.source = role, thing, source
        self.symbolic = isinstance(thing, {"controller": SymbolicLaw, "plant": SymbolicPlant}.get(role, ()))
        self.name: str = (thing if isinstance(thing, type | SymbolicLaw) else type(thing)).__name__
        if isinstance(thing, type):
            raise InputError(f"{role} = {self.name}: this is a class; give an object, {self.name}()")
        for usage in () if self.symbolic else NEEDED[role]:
            if not callable(getattr(thing, usage.partition("(")[0], None)):
                raise InputError(f"{role} = {self.name}: it has no method {usage}; see `dpcontrol guide extend`")

    def __str__(self) -> str:
        return self.source or self.name

    def __repr__(self) -> str:
        return f"{self.name} {self._fingerprint}"

    def __deepcopy__(self, memory: Any) -> "OwnObject":
        """Return the object itself, because copies of settings share the user's object."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the call that makes the object in another process: from its file if it has one, else pickled."""
        return own_object, (self.role, self.source or self.thing)

    @cached_property
    def _fingerprint(self) -> str:
        """A hash of code and state, which identifies the object in cached results; unique if these cannot be read."""
        try:
            code = self.thing.function if isinstance(self.thing, SymbolicLaw) else type(self.thing)
            return content_hash(inspect.getsource(code), pickle.dumps(self.thing))
        except Exception:  # noqa: BLE001 - pickling runs the user's code
            return uuid4().hex

    def call(self, member: str, *arguments: Any) -> Any:
        """Call a method of the user's object and return its value, or return an attribute; None if it has neither.

        Args:
            member: name of the method or attribute.
            *arguments: arguments of the method.

        Returns:
            Any value, since the code is the user's; `numbers` checks it.

        Raises:
            OwnFailure: the method or attribute raised.
        """
        try:
            value = getattr(self.thing, member, None)
            return value(*arguments) if callable(value) else value
        except Exception as error:
            raise OwnFailure(f"{self.name}.{member} raised {_error_text(error)}") from error

    def numbers(self, member: str, value: Any, *shape: int) -> Array:
        """Return the numbers that a method returned as an array, after a check of shape and size.

        Args:
            member: name of the method, for the message.
            value: value that the user's method returned, of any type.
            *shape: shape of the array, none for one number.

        Raises:
            OwnFailure: the value has another shape, or entries that are not finite or out of bounds.
        """
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            # NaN fails the check below, which makes the message.
            array = np.full(shape, np.nan)
        if array.shape != shape or not np.abs(array).max() <= LARGEST:
            shown_value = " ".join(repr(value).split())[:_SHOWN]
            raise OwnFailure(
                f"{self.name}.{member} returned {shown_value}: it must return {math.prod(shape)} {_NUMBERS}"
            )
        return array


def wrong_command(law: str, value: float) -> OwnFailure | None:
    """Return the error for an invalid command of a symbolic law, or None if the command is valid.

    Args:
        law: name of the symbolic law.
        value: command that the law returned, m/s².
    """
    return None if abs(value) <= LARGEST else OwnFailure(f"{law} returned {value}: it must return 1 {_NUMBERS}")


def _error_text(error: BaseException) -> str:
    """Return the kind and message of an error on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def names_file(value: str) -> bool:
    """Return True if a value names a Python file.

    Args:
        value: name of a built-in part, an address, or FILE.py:CLASS.
    """
    return ".py:" in value or value.endswith(".py")


def own_object(role: str, value: Any) -> OwnObject:
    """Return a user's object, checked and wrapped: the given object, or the one that FILE.py:CLASS names.

    A class in a file is called without arguments; any other object of that name is used as it is.

    Args:
        role: role of the object, "controller", "estimator", "plant" or "rig".
        value: the object, or FILE.py:CLASS.

    Raises:
        InputError: the file or class does not exist, the constructor raised, or a method is missing.
    """
    if not isinstance(value, str):
        return OwnObject(role, value)
    path, _, name = value.rpartition(":")
    if not (path.endswith(".py") and name and Path(path).is_file()):
        raise InputError(f"{role} = {value}: there is no such file and class; give FILE.py:CLASS")
    file = Path(path)
    module_name = f"dpcontrol_own_{file.stem}"
    module = ModuleType(module_name)
    module.__file__ = path
    # Dataclasses look up their module there. Modules beside the file can be imported, as by a script.
    sys.modules[module_name] = module
    if (folder := str(file.parent.resolve())) not in sys.path:
        sys.path.append(folder)
    try:
        SourceFileLoader(module_name, path).exec_module(module)
        kind = getattr(module, name)
        return OwnObject(role, kind() if isinstance(kind, type) else kind, value)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{role} = {value}: {_error_text(error)}") from error


@dataclass(frozen=True)
class _Chosen:
    """Settings that select a user's object.

    Attributes:
        kind: name of the object, for the log.
        own: the object.
    """

    kind: str
    own: OwnObject


@dataclass(frozen=True)
class OwnLaw(_Chosen):
    """Settings that select a user's law by its object."""


@dataclass(frozen=True)
class OwnExpressions(_Chosen):
    """Settings that select a user's symbolic law by its object."""


@dataclass(frozen=True)
class OwnEstimator(FilterSettings):
    """Settings that select a user's estimator, which estimates only the state."""

    kind: str = "own"
    augment: tuple[str, ...] = ()
    own: OwnObject | None = None


@dataclass(frozen=True)
class OwnPlant(_Chosen):
    """Settings that select a user's plant by its object.

    It replaces arms, cart and drive. A `SymbolicPlant` replaces only one component.
    """


@dataclass(frozen=True, eq=False)
class OwnController(ReferenceController):
    """A user's law on a reference.

    Attributes:
        own: the user's object.
        period: time between ticks, s.
    """

    own: OwnObject
    period: float

    def begin_after(self, lead: int) -> "OwnSession":
        """Return a session of the law for one run, whose commands act `lead` ticks after their reading.

        Args:
            lead: number of first commands, which come from the reference because no reading precedes them.
        """
        return OwnSession(self, lead)


class OwnSession(Session):
    """A user's law during a run.

    Args:
        law: the law.
        lead: number of first commands that come from the reference.

    `failure` is the object's error, which ends the run, or None.
    """

    def __init__(self, law: OwnController, lead: int) -> None:
        """Begin before the first command; `_begun` is True once the object's `reset` was called."""
        self._law, self._lead, self._begun = law, lead, False
        self.failure: OwnFailure | None = None

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action for the period from a tick: feedforward, feedback, and the reference state.

        The user's law returns their sum, an acceleration, from which the feedforward is subtracted. The first `lead`
        commands come from the reference. If the law fails, the command is 0 and `failure` is set, which ends the run.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: estimated further parameters (E,), which the law does not receive.
        """
        law = self._law
        reference = law.reference_states[min(tick, law.ticks)]
        feedforward = float(law.feedforward[min(tick, law.ticks - 1)])
        if tick < self._lead:
            return Action(feedforward, 0.0, reference, Mode.TRACKING)
        command = 0.0
        try:
            if not self._begun:
                self._begun = True
                law.own.call("reset")
            value = law.own.call("control", tick * law.period, state, Setpoint(reference.copy(), feedforward))
            command = float(law.own.numbers("control", value))
        except OwnFailure as failure:
            self.failure = failure
        return Action(feedforward, command - feedforward, reference, Mode.TRACKING)


class OwnEstimates(Estimator):
    """A user's estimator in the loop.

    If the object has `sigmas` (N,), NIS is computed for the model's prediction from the previous estimate. Without
    them, NIS is not available and the supervisor does not check the estimate.

    Args:
        own: the user's object.
        model: model that predicts the state.
        noise: covariance (n+1, n+1) of the measured positions.
    """

    extra_names = ()

    def __init__(self, own: OwnObject, model: SampledModel, *, noise: Array) -> None:
        """Begin before the first reading; `_count` counts the updates and `_sent` is the last command, m/s².

        `failure` is the object's error, which ends the run, or None.
        """
        self.own, self.kind, self._model, self._noise = own, own.name, model, noise
        self.failure: OwnFailure | None = None
        self.judged = True
        """True if the object provided standard deviations at the last update."""
        self._sent, self._count = 0.0, 0

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement.

        Args:
            state: nominal initial state (N,).
        """
        self.failure, self._sent, self._count = None, 0.0, 0
        unknown = np.full(len(state), np.nan)
        return Estimate(state.copy(), np.empty(0), unknown, np.zeros(self._model.arms + 1), 0.0, 0, None)

    def sends(self, command: float) -> None:
        """Store the last command, which the object's next `update` receives.

        Args:
            command: acceleration of the cart, m/s².
        """
        self._sent = command

    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate at the first tick.

        Args:
            estimate: estimate at the start.
            measured: positions (n+1,), rad and m.
            present: True for each new position (n+1,), None if all are new.
        """
        return self._updated(estimate, estimate.state, measured, present)

    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate after a period and a new measurement.

        Args:
            estimate: estimate one tick earlier.
            command: acceleration during the period, m/s².
            measured: positions (n+1,), rad and m.
            present: True for each new position (n+1,), None if all are new.
        """
        return self._updated(estimate, self._model.step(estimate.state, command), measured, present)

    def _updated(self, estimate: Estimate, expected: Array, measured: Array, present: Present) -> Estimate:
        """Return the user's estimate after a reading, with its NIS; a failure leaves the estimate as it was.

        The NIS is computed from the standard deviations of the object's `sigmas`; without them it is 0, and `judged` is
        False. The object's `reset` is called before its first update.

        Args:
            estimate: last estimate.
            expected: state (N,) that the model predicts for this reading, from which the innovation is computed.
            measured: positions (n+1,), rad and m.
            present: True for each new position (n+1,), None if all are new.
        """
        user_object, size = self.own, len(estimate.state)
        measured_now = np.ones(len(measured), dtype=bool) if present is None else present
        reading = Reading(self._count * self._model.period, measured.copy(), measured_now.copy())
        try:
            if not self._count:
                user_object.call("reset")
            state = user_object.numbers("update", user_object.call("update", reading, self._sent), size)
            stated_sigmas = user_object.call("sigmas")
            sigmas = estimate.sigmas if stated_sigmas is None else user_object.numbers("sigmas", stated_sigmas, size)
        except OwnFailure as failure:
            self.failure = failure
            return estimate
        self._count += 1
        nis, rows = 0.0, np.flatnonzero(measured_now)
        self.judged = stated_sigmas is not None
        if self.judged and len(rows):
            places = self._model.position_indices[rows]
            innovation = measured[rows] - expected[places]
            innovation -= np.where(rows < self._model.arms, 2 * np.pi * np.rint(innovation / (2 * np.pi)), 0.0)
            covariance = np.diag(sigmas[places] ** 2) + self._noise[np.ix_(rows, rows)]
            nis = float(innovation @ np.linalg.lstsq(covariance, innovation, rcond=None)[0])
        return Estimate(state, estimate.extra, sigmas, estimate.innovation, nis, len(rows), None)

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) that the model predicts after the pending commands.

        Args:
            estimate: present estimate.
            commands: pending commands, one per period, oldest first, m/s².
        """
        state = estimate.state
        for command in commands:
            state = self._model.step(state, command)
        return state

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N, N) of the state.

        Args:
            estimate: estimate with standard deviations (N,).
        """
        return np.diag(estimate.sigmas**2)

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Return the estimate unchanged, because only the user's object can restart itself.

        Args:
            estimate: estimate that is returned unchanged.
            measured: ignored.
        """
        return estimate


class OwnArms:
    """A user's plant between ticks, with hard stops at ±track m.

    Args:
        own: the user's object.
        parameters: arms that blows strike.
        state: initial state (N,).
        track: half length of the track, m.
    """

    def __init__(self, own: OwnObject, parameters: PlantParameters, state: Array, *, track: float) -> None:
        """Begin at the initial state; the object's `reset` is called before its first step, which `_begun` records.

        `_cart` is the index of the cart's position in the state, and `values` the present state as floats.
        """
        self._own, self._parameters, self._track, self._begun = own, parameters, track, False
        self._cart = 2 * parameters.arms.count
        self.faults: dict[int, Event] = {}
        self.state: Array = state.copy()
        """The present state; `move` overwrites it."""
        self.values: list[Any] = state.tolist()

    @property
    def loop_velocity(self) -> float:
        """The cart's velocity, m/s."""
        return self.values[self._cart + 1]

    def move(self, acceleration: Any, duration: Any, *, time: Any, span: float = 0.0) -> None:
        """Advance the plant with a constant demand, and put a cart beyond its track at rest at the hard stop.

        The first such stop is stored in `faults`, with the time at the end of the step.

        Args:
            acceleration: demanded acceleration of the cart, m/s².
            duration: duration of the step, s.
            time: time at its start, s.
            span: ignored; `SimulatedPlant.move` has it.

        Raises:
            OwnFailure: the object failed.
        """
        if not self._begun:
            self._begun = True
            self._own.call("reset")
        value = self._own.call("step", self.state.copy(), float(acceleration), float(duration))
        state, cart = self._own.numbers("step", value, len(self.state)), self._cart
        if abs(state[cart]) > self._track:
            stop_position, speed = math.copysign(self._track, state[cart]), state[cart + 1]
            figures = {"time": time + duration, "position": stop_position, "velocity": speed}
            self.faults.setdefault(0, ended(Cause.HARD_STOP, figures))
            state[cart], state[cart + 1] = stop_position, 0.0
        self._set_state(state)

    def strike(self, blow: Blow, run: int = 0) -> None:
        """Apply a blow to the state: impulses on the arms, jumps of their rates, and of the cart's velocity.

        Args:
            blow: impulses and jumps.
            run: ignored, since a user's plant serves a single run.
        """
        self._set_state(
            after_blow(self._parameters, self.state, impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock)
        )

    def _set_state(self, state: Array) -> None:
        """Store the state (N,), also as plain floats, which the bench reads faster."""
        self.state[:] = state
        self.values = state.tolist()


class OwnRig:
    """A user's rig in the loop.

    After a `stop` that did not raise, the object receives no further calls of `stop` and `command`.

    Args:
        own: the user's object. Its optional attribute `truth` is the true state (2n+2,).
        arms: number of arms.
        period: control period, s.
    """

    def __init__(self, own: OwnObject, *, arms: int, period: float) -> None:
        """Begin before the first reading; `_count` counts the readings.

        `_stopped` is True once the object's `stop` has succeeded.
        """
        self.own, self.period, self.fault = own, period, None
        self._arms, self._count, self._stopped = arms, 0, False
        self.truth: Array | None = None if getattr(own.thing, "truth", None) is None else np.zeros(2 * arms + 2)
        """The true state (2n+2,) at the last reading, if the object provides it."""

    def read(self) -> Reading:
        """Return the reading of the next tick, from the positions (n+1,) or the `Reading` that the object returns.

        Its time is the loop's own. `truth` is read too, if the object has it.

        Raises:
            OwnFailure: the object raised, or returned invalid numbers.
        """
        user_object, count = self.own, self._arms + 1
        value = user_object.call("read")
        positions, time_s = (
            user_object.numbers("read", getattr(value, "positions", value), count),
            self._count * self.period,
        )
        self._count += 1
        if self.truth is not None:
            self.truth = user_object.numbers("truth", user_object.call("truth"), 2 * self._arms + 2)
        if not isinstance(value, Reading):
            return Reading(time_s, positions)
        present = None if value.present is None else user_object.numbers("read", value.present, count) != 0
        return value._replace(time=time_s, positions=positions, present=present)

    def command(self, acceleration: float) -> None:
        """Send a command to the object.

        Args:
            acceleration: demanded acceleration of the cart, m/s².

        Raises:
            OwnFailure: the object failed.
        """
        if not self._stopped:
            self.own.call("command", acceleration)

    def stop(self) -> None:
        """Call the object's `stop`, unless an earlier call succeeded; report a failure, since the cart may move."""
        if self._stopped:
            return
        try:
            self.own.call("stop")
            self._stopped = True
        except OwnFailure as failure:
            remark(f"{failure}; the cart may still be moving")
