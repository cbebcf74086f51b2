"""Users' own objects in the loop: a law, an estimator, a plant or a rig, written in Python.

    controller    control(time, state, reference) -> acceleration, m/s²
    estimator     update(reading, acceleration) -> state (N,)
    plant         step(state, acceleration, seconds) -> state (N,)
    rig           read() -> positions (n+1,) or a reading, command(acceleration), stop()

The first three may have `reset()`, which is called before each run. A run ends where a call raises, returns anything
else, or lasts longer than the object's `longest` seconds, 5 if it has no such attribute. Python code is interrupted
then; native code cannot be, and neither can code in a thread or on Windows: it is found out when it returns.
"""

import importlib.util
import inspect
import math
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from dpcontrol.control.estimator_settings import FilterSettings
from dpcontrol.control.interface import Action, Estimate, Mode, Present, SampledModel
from dpcontrol.control.symbolic import SymbolicLaw, Wanted
from dpcontrol.control.tracking import ReferenceController
from dpcontrol.dynamics.components import SymbolicPlant
from dpcontrol.dynamics.plant import PlantParameters, after_blow
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import content_hash
from dpcontrol.loop.bench import Blow
from dpcontrol.loop.result import Reading

NEEDED = {
    "controller": ("control(time, state, reference)",),
    "estimator": ("update(reading, acceleration)",),
    "plant": ("step(state, acceleration, seconds)",),
    "rig": ("read()", "command(acceleration)", "stop()"),
}
"""The methods that an object needs, by what it takes the place of."""
LONGEST = 5.0
"""s that a call may last."""
LARGEST = 1e6
"""Beyond every acceleration and state of these arms, SI."""
_SHOWN = 60
"""Letters of a value in a sentence."""


class OwnFailure(ArithmeticError):
    """A user's object failed; names the object, the method and the value."""


class _TooLong(BaseException):
    """Raised within a call that lasts too long; no object's own handlers of errors take it."""


def _timed(function: Callable[..., Any], arguments: Sequence[Any], longest: float) -> Any:
    """Call a function, and interrupt it if it lasts too long."""
    began = time.perf_counter()

    def look(number: int, frame: Any) -> None:
        if time.perf_counter() - began >= longest:
            raise _TooLong
        if callable(before):
            before(number, frame)

    interrupts = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    before: Any = None
    if interrupts:
        before = signal.signal(signal.SIGALRM, look)
        signal.setitimer(signal.ITIMER_REAL, longest, longest)
    try:
        value = function(*arguments)
    finally:
        if interrupts:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
    if time.perf_counter() - began > longest:
        raise _TooLong
    return value


class OwnObject:
    """A user's object in the place of a controller, estimator, plant or rig; source: FILE.py:CLASS if it is of a file.

    Raises:
        InputError: it lacks a method, or is a class.
    """

    def __init__(self, role: str, thing: Any, source: str = "") -> None:
        self.role, self.thing, self.source = role, thing, source
        self.symbolic = isinstance(thing, {"controller": SymbolicLaw, "plant": SymbolicPlant}.get(role, ()))
        self.name: str = (thing if isinstance(thing, type | SymbolicLaw) else type(thing)).__name__
        if isinstance(thing, type):
            raise InputError(f"{role} = {self.name}: this is a class; give an object, {self.name}()")
        for usage in () if self.symbolic else NEEDED[role]:
            if not callable(self.attribute(usage.partition("(")[0])):
                raise InputError(f"{role} = {self.name}: it has no method {usage}; see `dpcontrol guide extend`")

    def __str__(self) -> str:
        return self.source or self.name

    def __repr__(self) -> str:
        return f"{self.name} {self._fingerprint}"

    def __deepcopy__(self, memory: Any) -> "OwnObject":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return (load_own, (self.role, self.source)) if self.source else (OwnObject, (self.role, self.thing))

    @cached_property
    def _fingerprint(self) -> str:
        """Identifies code and state; unique if these cannot be read."""
        try:
            code = self.thing.function if isinstance(self.thing, SymbolicLaw) else type(self.thing)
            return content_hash(inspect.getsource(code), pickle.dumps(self.thing))
        except Exception:  # noqa: BLE001 - pickling runs the user's code
            return uuid4().hex

    def attribute(self, name: str) -> Any:
        """Return an attribute; None if there is none.

        Raises:
            InputError: reading it raised.
        """
        try:
            return getattr(self.thing, name, None)
        except Exception as error:
            raise InputError(f"{self.role} = {self.name}: {name} raised {_told(error)}") from error

    def reset(self) -> None:
        """Have the object begin a run."""
        if callable(self.attribute("reset")):
            self.call("reset")

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method and return its value.

        Raises:
            OwnFailure: it raised, or took too long.
        """
        longest = float(self.attribute("longest") or LONGEST)
        try:
            return _timed(getattr(self.thing, method), arguments, longest)
        except _TooLong:
            raise OwnFailure(f"{self.name}.{method} took longer than {longest:g} s") from None
        except (Exception, SystemExit) as error:
            raise OwnFailure(f"{self.name}.{method} raised {_told(error)}") from error

    def number(self, method: str, *arguments: Any) -> float:
        """Return an acceleration that a method returns.

        Raises:
            OwnFailure: it failed, or returned anything but a finite number of sensible size.
        """
        value = self.call(method, *arguments)
        try:
            number = math.nan if isinstance(value, str | bytes | bool) or np.ndim(value) else float(value)
        except Exception:  # noqa: BLE001 - the value is the user's, and so is its __float__
            number = math.nan
        if not abs(number) <= LARGEST:
            raise self.refused(method, value, f"a number from -{LARGEST:g} to {LARGEST:g} m/s²")
        return number

    def numbers(self, method: str, value: Any, size: int) -> Array:
        """Return the array (size,) that a method returned.

        Raises:
            OwnFailure: it is anything else, or has entries that are not finite or beyond all size.
        """
        try:
            array = np.array(value, dtype=float)
        except Exception:  # noqa: BLE001 - the value is the user's, and so is its __array__
            array = np.empty(0)
        if array.shape != (size,) or not np.abs(array).max() <= LARGEST:
            raise self.refused(method, value, f"{size} finite numbers up to {LARGEST:g}, SI")
        return array

    def refused(self, method: str, value: Any, needed: str) -> OwnFailure:
        """Return the error of a value that a method may not return."""
        try:
            text = " ".join(repr(value).split())
        except Exception:  # noqa: BLE001 - the value is the user's, and so is its __repr__
            text = f"a {type(value).__name__}"
        text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
        return OwnFailure(f"{self.name}.{method} returned {text}: it must return {needed}")


def wrong_command(law: str, value: float) -> OwnFailure | None:
    """Return what is wrong with the command of a symbolic law, m/s²; None for nothing."""
    if abs(value) <= LARGEST:
        return None
    return OwnFailure(f"{law} returned {value}: it must return a number from -{LARGEST:g} to {LARGEST:g} m/s²")


def _told(error: BaseException) -> str:
    try:
        text = " ".join(str(error).split())
    except Exception:  # noqa: BLE001 - the error is the user's, and so is its __str__
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def own_object(role: str, value: Any) -> OwnObject:
    """Return a user's object, from FILE.py:CLASS or as it is.

    Raises:
        InputError: it cannot be loaded, or lacks a method.
    """
    return load_own(role, value) if isinstance(value, str) else OwnObject(role, value)


def load_own(role: str, source: str) -> OwnObject:
    """Return an object of the class that FILE.py:CLASS names, made without arguments, or the object of that name.

    Raises:
        InputError: there is no such file or class, it cannot be made, or it lacks a method.
    """
    path, _, name = source.rpartition(":")
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{role} = {source}: there is no file {path}; give FILE.py:CLASS")
    module_name = f"dpcontrol_own_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up there.
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
        kind = getattr(module, name, None)
        thing = kind() if isinstance(kind, type) else kind
    except (Exception, SystemExit) as error:
        raise InputError(f"{role} = {source}: {_told(error)}") from error
    if thing is None:
        raise InputError(f"{role} = {source}: {path} has no class {name}")
    return OwnObject(role, thing, source)


@dataclass(frozen=True)
class OwnLaw:
    """The settings of a user's law."""

    kind: str
    own: OwnObject


@dataclass(frozen=True)
class OwnExpressions:
    """The settings of a user's symbolic law."""

    kind: str
    own: OwnObject


@dataclass(frozen=True)
class OwnEstimator(FilterSettings):
    """The settings of a user's estimator: with it nothing but the state is estimated."""

    kind: str = "own"
    augment: tuple[str, ...] = ()
    own: OwnObject | None = None


@dataclass(frozen=True)
class OwnPlant:
    """The settings of a user's plant: in place of arms, cart and drive, or a component of them (`SymbolicPlant`)."""

    kind: str
    own: OwnObject


@dataclass(frozen=True, eq=False)
class OwnController:
    """A user's law on a reference; period in s."""

    own: OwnObject
    flown: ReferenceController
    period: float

    @property
    def kind(self) -> str:
        """The name of its class."""
        return self.own.name

    @property
    def first_state(self) -> Array:
        """The state (N,) from which it starts."""
        return self.flown.first_state

    @property
    def ticks(self) -> int:
        """For how many periods it has something to do."""
        return self.flown.ticks

    def begin_after(self, lead: int) -> "OwnSession":
        """Return a session for one run, whose first `lead` commands are the reference's own."""
        return OwnSession(self, lead)


class OwnSession:
    """A user's law during a run; failure: what ended it."""

    def __init__(self, law: OwnController, lead: int) -> None:
        self._law, self._lead, self._begun = law, lead, False
        self.failure: OwnFailure | None = None

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick`, for which `state` (N,) is expected."""
        law, flown = self._law, self._law.flown
        wanted = flown.reference_states[min(tick, flown.ticks)]
        forward = float(flown.feedforward[min(tick, flown.ticks - 1)])
        if tick < self._lead:
            return Action(forward, 0.0, wanted, Mode.TRACKING)
        value = 0.0
        try:
            if not self._begun:
                self._begun = True
                law.own.reset()
            value = law.own.number("control", tick * law.period, state, Wanted(wanted.copy(), forward))
        except OwnFailure as failure:
            self.failure = failure
        return Action(forward, value - forward, wanted, Mode.TRACKING)

    def resynchronise(self, tick: int, state: Array) -> str:
        """Leave the clock as it is: the loop's own."""
        return ""


class OwnEstimates:
    """A user's estimator as the loop's; noise (n+1, n+1): of the measured positions.

    If the object has `sigmas` (N,), the NIS is that of the model's prediction from the estimate before. Without them
    there is none, and the supervisor does not judge the estimate. sent m/s²: the acceleration sent last.
    """

    extra_names = ()

    def __init__(self, own: OwnObject, model: SampledModel, *, noise: Array) -> None:
        self.own, self.kind, self._model, self._noise = own, own.name, model, noise
        self.failure: OwnFailure | None = None
        self.sent, self._count = 0.0, 0

    @property
    def judged(self) -> bool:
        """Whether the object gives standard deviations."""
        return self.own.attribute("sigmas") is not None

    def first(self, state: Array) -> Estimate:
        """Return the estimate before any measurement, at `state` (N,)."""
        self.failure, self.sent, self._count = None, 0.0, 0
        none = np.full(len(state), np.nan)
        return Estimate(state.copy(), np.empty(0), none, np.zeros(self._model.arms + 1), 0.0, 0, None)

    def update(self, estimate: Estimate, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate at the first tick."""
        return self._asked(estimate, estimate.state, measured, present)

    def step(self, estimate: Estimate, command: float, measured: Array, present: Present = None) -> Estimate:
        """Return the estimate a period later: the cart accelerated by `command` m/s², then `measured` came."""
        return self._asked(estimate, self._model.step(estimate.state, command), measured, present)

    def _asked(self, estimate: Estimate, expected: Array, measured: Array, present: Present) -> Estimate:
        own, size = self.own, len(estimate.state)
        seen = np.ones(len(measured), dtype=bool) if present is None else present
        reading = Reading(self._count * self._model.period, measured.copy(), seen.copy())
        try:
            if not self._count:
                own.reset()
            state = own.numbers("update", own.call("update", reading, self.sent), size)
            sigmas = own.numbers("sigmas", self.own.attribute("sigmas"), size) if self.judged else estimate.sigmas
        except OwnFailure as failure:
            self.failure = failure
            return estimate
        self._count += 1
        nis, rows = 0.0, np.flatnonzero(seen)
        if self.judged and len(rows):
            places = self._model.position_indices[rows]
            away = measured[rows] - expected[places]
            away -= np.where(rows < self._model.arms, 2 * np.pi * np.rint(away / (2 * np.pi)), 0.0)
            spread = np.diag(sigmas[places] ** 2) + self._noise[np.ix_(rows, rows)]
            nis = float(away @ np.linalg.lstsq(spread, away, rcond=None)[0])
        return Estimate(state, estimate.extra, sigmas, estimate.innovation, nis, len(rows), None)

    def ahead(self, estimate: Estimate, commands: Sequence[float]) -> Array:
        """Return the state (N,) after the commands on their way, by the model."""
        state = estimate.state
        for command in commands:
            state = self._model.step(state, command)
        return state

    def covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (N, N) of the state."""
        return np.diag(estimate.sigmas**2)

    def restarted(self, estimate: Estimate, measured: Array) -> Estimate:
        """Leave the estimate to the object."""
        return estimate


class OwnArms:
    """A user's plant between ticks, with hard stops at ±track m; state (N,). Blows strike arms of `parameters`."""

    def __init__(self, own: OwnObject, parameters: PlantParameters, state: Array, *, track: float) -> None:
        self._own, self._parameters, self._track, self._begun = own, parameters, track, False
        self._cart = 2 * parameters.arms.count
        self.faults: dict[int, str] = {}
        self.state: Array = state.copy()
        """The state now; overwritten as the plant moves."""
        self.values: list[Any] = state.tolist()

    @property
    def loop_velocity(self) -> float:
        """The cart's velocity, m/s."""
        return self.values[self._cart + 1]

    def move(self, acceleration: Any, duration: Any, *, time: Any, span: float = 0.0) -> None:
        """Let `duration` s pass from `time` s with a held demand of `acceleration` m/s².

        Raises:
            OwnFailure: the object failed.
        """
        if not self._begun:
            self._begun = True
            self._own.reset()
        value = self._own.call("step", self.state.copy(), float(acceleration), float(duration))
        state, cart = self._own.numbers("step", value, len(self.state)), self._cart
        if abs(state[cart]) > self._track:
            side, speed = math.copysign(self._track, state[cart]), state[cart + 1]
            self.faults.setdefault(
                0, f"cart hit its hard stop at t = {time + duration:.3f} s: x = {side:.3f} m at {speed:.3g} m/s"
            )
            state[cart], state[cart + 1] = side, 0.0
        self._be(state)

    def strike(self, blow: Blow, run: int = 0) -> None:
        """Apply a blow."""
        self._be(after_blow(self._parameters, self.state, impulses=blow.impulses, jumps=blow.jumps, knock=blow.knock))

    def _be(self, state: Array) -> None:
        self.state[:] = state
        self.values = state.tolist()


class OwnRig:
    """A user's rig as the loop's; period in s. `truth` is the object's, if it has one: the true state (2n+2,).

    A failure of `command` ends the run at the next reading.
    """

    def __init__(self, own: OwnObject, *, arms: int, period: float) -> None:
        self.own, self.period, self.fault = own, period, ""
        self._arms, self._count, self._failure = arms, 0, list[OwnFailure]()
        self.truth: Array | None = None if own.attribute("truth") is None else np.zeros(2 * arms + 2)
        """The true state (2n+2,) at the last reading, if the object knows it."""

    def read(self) -> Reading:
        """Return the next tick's reading.

        Raises:
            OwnFailure: the object failed.
        """
        if self._failure:
            raise self._failure[0]
        own, m = self.own, self._arms + 1
        value = own.call("read")
        given = getattr(value, "positions", value)
        positions, now = own.numbers("read", given, m), self._count * self.period
        self._count += 1
        if self.truth is not None:
            self.truth = own.numbers("truth", own.attribute("truth"), 2 * self._arms + 2)
        if not isinstance(value, Reading):
            return Reading(now, positions)
        if value.present is not None and np.shape(value.present) != (m,):
            raise own.refused("read", value, f"a reading whose `present` has {m} entries")
        return value._replace(time=now, positions=positions)

    def command(self, acceleration: float) -> None:
        """Send the cart's wanted acceleration, m/s²."""
        try:
            self.own.call("command", acceleration)
        except OwnFailure as failure:
            self._failure.append(failure)

    def stop(self) -> None:
        """Have the object stop the cart."""
        try:
            self.own.call("stop")
        except OwnFailure as failure:
            remark(f"{failure}; the cart may still be moving")
