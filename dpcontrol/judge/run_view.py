"""Data to draw of a run and its plan.

The viewer and the pages share them.

A simulated run has truth, estimate, reference and command. A recording from the bench has only the measured angles, in
segments. A plan has stays and symbols over time, and orbits and tubes in phase space.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief
from dpcontrol.logs import Event, Extras, Mode, RunLog
from dpcontrol.loop.result import sensors_of
from dpcontrol.recordings.recording import REPLAYED
from dpcontrol.references.content import PlanOrbit
from dpcontrol.references.reference import Reference


@dataclass(frozen=True)
class TubeCurve(Brief):
    """The part of a tube that a plan uses, from a stop's orbit to a symbol's section.

    Attributes:
        stable: True if it leads to the orbit, False if from it.
        strands: (S, M, 2n) trajectories at the plan's turns, angles then rates; rad, rad/s.
        cut: (C, 2n) intersections with the section, in order of phase, nan at openings.
    """

    stable: bool
    strands: Array
    cut: Array


@dataclass(frozen=True)
class Stay:
    """A period of time near one saddle.

    Attributes:
        first: start, s.
        last: end, s.
        saddle: name of the saddle.
        text: label.
        wanted: True if the plan requires it.
    """

    first: float
    last: float
    saddle: str
    text: str
    wanted: bool = True


@dataclass(frozen=True)
class PlanView:
    """The requirements of a plan.

    Attributes:
        orbits: the itinerary's orbits, on the turns of its stops.
        saddle_energies: energy of each saddle in J, by name.
        symbols: planned time of its section crossing in s, and name, for each symbol of the itinerary.
        tubes: parts of tubes that the plan uses.
        planned: the itinerary as stays.
        transfers: (begin, end) of each planned transfer between pieces, s.
        duration: in s, or None.
    """

    orbits: tuple[PlanOrbit, ...] = ()
    saddle_energies: dict[str, float] = field(default_factory=dict)
    symbols: tuple[tuple[float, str], ...] = ()
    tubes: tuple[TubeCurve, ...] = ()
    planned: tuple[Stay, ...] = ()
    transfers: tuple[tuple[float, float], ...] = ()
    duration: float | None = None

    def timed(self, clock: Callable[[float], float]) -> "PlanView":
        """Return the plan with all times on another clock, such as that of a run.

        Args:
            clock: function of a time of the plan, s, that returns that of the clock.
        """
        return replace(
            self,
            symbols=tuple((clock(at), name) for at, name in self.symbols),
            planned=timed(self.planned, clock),
            transfers=tuple((clock(begin), clock(end)) for begin, end in self.transfers),
            duration=None if self.duration is None else clock(self.duration),
        )


def timed(stays: Iterable[Stay], clock: Callable[[float], float]) -> tuple[Stay, ...]:
    """Return stays with their times on another clock.

    Args:
        stays: the stays.
        clock: function of their times, s, that returns that of the clock.
    """
    return tuple(replace(stay, first=clock(stay.first), last=clock(stay.last)) for stay in stays)


LARGEST = 1e6
"""Limit in rad, rad/s, m …: no sensible run comes near, and drawing libraries fail far beyond."""
ACTUAL = "actual"
"""Key in `control` of the simulated cart's true acceleration."""
_DRIVEN = ("command", "applied", "feedforward")


@dataclass(frozen=True, eq=False)
class RunView(Brief):
    """Data to draw of a run, a recording or a reference.

    There are N ticks of a pendulum of n arms, and their plan.

    States are angles, rates and, with a cart, its position and velocity: 2n + 2 columns, or 2n. Missing data and their
    substitutes are None. Values that cannot be drawn are nan.

    Attributes:
        path: file of origin.
        title: title of the recording and the page.
        time: (N,) in s.
        state: (N, 2n+2) to draw.
        what: kind of `state`: "plant", "estimate", "measured", "reference".
        arm_lengths: (n,) in m.
        has_cart: True if the pivot is on a cart.
        rate_hz: rate of the ticks, Hz.
        estimate: (N, 2n+2), or None.
        reference: (N, 2n+2), or None.
        error: (N, 2n+2) estimate minus truth, or None.
        sigma: (N, 2n+2) standard deviations of the estimate, or None.
        control: (N,) `command`, `applied`, `feedforward`, `saturated`, `mode` by name, and `actual`, or None.
        nis: (N,) nan at ticks without a measurement, or None.
        sensors: number of values in a measurement.
        energy: (N,) in J, of the pendulum at each tick, true if known, otherwise estimated, or None.
        limits: the cart's greatest distance from the centre in m, velocity in m/s, acceleration in m/s², or None.
        breaks: rows that follow a gap in time.
        differenced: True if the rates are differences of the measured angles.
        against: kind of `reference`: "reference", or "prediction" of a model replayed on a recording.
        events: as in the log.
        metadata: as in the log.
        verdict: one line, such as "completed: 1 of 1 symbols".
        good: True for a favourable verdict, None if nothing was judged.
        plan: requirements of the plan, empty without one.
        done: the itinerary decoded from the angles.
        crossings: crossing time of each completed symbol, s, or None for a transfer.
        source: the reference drawn, otherwise None.
        extras: estimated parameters, or None.
        extra_truth: known true values of the parameters by name, a number or (M,) at the extras' times.
    """

    path: Path
    title: str
    time: Array
    state: Array
    what: str
    arm_lengths: tuple[float, ...]
    has_cart: bool
    rate_hz: float
    estimate: Array | None = None
    reference: Array | None = None
    error: Array | None = None
    sigma: Array | None = None
    control: dict[str, Array] | None = None
    nis: Array | None = None
    sensors: int = 0
    energy: Array | None = None
    limits: tuple[float, float, float] | None = None
    breaks: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    differenced: bool = False
    against: str = "reference"
    events: tuple[Event, ...] = ()
    metadata: dict[str, str] = field(default_factory=dict)
    verdict: str = ""
    good: bool | None = None
    plan: PlanView = field(default_factory=PlanView)
    done: tuple[Stay, ...] = ()
    crossings: tuple[float | None, ...] = ()
    source: Reference | None = None
    extras: Extras | None = None
    extra_truth: Mapping[str, Array | float] = field(default_factory=dict)

    @property
    def arms(self) -> int:
        """Number of arms."""
        return len(self.arm_lengths)

    @property
    def error_name(self) -> str:
        """Name of the difference between state and reference, for titles of pictures."""
        return "Prediction error" if self.against == "prediction" else "Tracking error"

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time in s, at least one period apart."""
        first = float(self.time[0])
        return first, max(float(self.time[-1]), first + 1 / self.rate_hz)

    @property
    def span(self) -> tuple[float, float]:
        """Time range in s, extended to the end of the plan."""
        begin, end = self.time_range
        return begin, max(end, self.plan.duration or end)

    @property
    def symbols(self) -> tuple[tuple[str, float, float | None], ...]:
        """Name, planned and actual crossing time of each symbol, s; None for a crossing that is missing."""
        crossing_times = (*self.crossings, *[None] * len(self.plan.symbols))
        return tuple(
            (name, planned_time, crossing_time)
            for (planned_time, name), crossing_time in zip(self.plan.symbols, crossing_times, strict=False)
        )

    @property
    def pivot(self) -> Array:
        """(N,) the pivot's position in m, zero without a cart."""
        return self.state[:, 2 * self.arms] if self.has_cart else np.zeros(len(self.time))

    def delayed(self, seconds: float) -> "RunView":
        """Return the view with all times later by `seconds`, to align it with other runs.

        Args:
            seconds: delay, s.
        """
        return replace(
            self,
            time=self.time + seconds,
            extras=None if self.extras is None else replace(self.extras, time=self.extras.time + seconds),
            events=tuple(replace(event, time=event.time + seconds) for event in self.events),
            plan=self.plan.timed(seconds.__add__),
            done=timed(self.done, seconds.__add__),
            crossings=tuple(
                None if crossing_time is None else crossing_time + seconds for crossing_time in self.crossings
            ),
        )


def series_of(log: RunLog) -> RunView:
    """Return the series of a log for drawing, without plan and verdict.

    The state to draw is the true one if known, then the estimate, then the measured positions with differences as
    rates.

    Args:
        log: log of a run or a recording.
    """
    n = len(log.arm_lengths)
    states = {part: clean(values) for part, values in log.states.items()}
    truth, estimate, reference = (states.get(part) for part in ("truth", "estimate", "reference"))
    if estimate is not None and reference is not None and np.array_equal(estimate, reference, equal_nan=True):
        reference = None
    breaks = np.flatnonzero(np.diff(log.time) > 1.5 / log.rate_hz) + 1
    state, what = (estimate, "estimate") if truth is None else (truth, "plant")
    # An estimate may merely repeat the measured angles, without rates.
    repeats_measured = estimate is not None and np.array_equal(estimate[:, :n], log.measured[:, :n])
    if state is None or (what == "estimate" and repeats_measured and not state[:, n : 2 * n].any()):
        state, what, estimate = _measured(log, breaks), "measured", None
    control = {name: clean(values) for name, values in log.controls.items()}
    names, nis = [f"sigma_{i + 1}" for i in range(state.shape[1])], control.get("nis")
    sigma = np.column_stack([control[name] for name in names]) if "sigma_1" in control else None
    is_driven = any(np.nan_to_num(control[name]).any() for name in _DRIVEN if name in control)
    if truth is not None and log.has_cart and "applied" in control and len(log.time) > 1:
        control[ACTUAL] = _cart_acceleration(truth[:, 2 * n + 1], log.time)
    is_controlled = "mode" in control and (control["mode"] != Mode.IDLE).any()
    replayed = log.metadata.get("kind") == REPLAYED
    if not is_controlled:
        # Without a controller there was neither a plan nor a mode to draw.
        control = {name: values for name, values in control.items() if name not in ("feedforward", "feedback", "mode")}
    return RunView(
        path=log.path,
        title=log.metadata.get("title") or log.path.stem,
        time=log.time,
        state=state,
        what=what,
        arm_lengths=log.arm_lengths,
        has_cart=log.has_cart,
        rate_hz=log.rate_hz,
        estimate=estimate,
        reference=reference,
        error=None if truth is None or estimate is None else estimate - truth,
        sigma=None if sigma is None or not np.nan_to_num(sigma).any() else sigma,
        control=control if is_driven or is_controlled else None,
        nis=nis if nis is not None and np.isfinite(nis).any() else None,
        sensors=n if replayed else sensors_of(log.measured),
        limits=log.limits,
        breaks=breaks,
        differenced=what == "measured" and log.rates is None,
        against="prediction" if replayed else "reference",
        events=log.events,
        metadata=log.metadata,
        extras=log.extras,
    )


def _cart_acceleration(velocity: Array, time: Array) -> Array:
    """Return the cart's mean acceleration (N,) between ticks, m/s², nan at instantaneous velocity jumps.

    An entry belongs to the period that begins with its tick; the last one repeats the one before it.

    Args:
        velocity: velocity (N,) of the cart, m/s.
        time: times (N,), s.
    """
    steps = np.diff(time)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(steps > 0, np.diff(velocity) / steps, np.nan)
        # A knock on the cart is a jump of the velocity, far beyond the drive's accelerations.
        typical_size = float(np.nanquantile(np.abs(mean), 0.99)) if np.isfinite(mean).any() else 0.0
        mean = np.where(np.abs(mean) <= 5 * typical_size + 1e-9, mean, np.nan)
    return np.append(mean, mean[-1])


def clean(values: Array) -> Array:
    """Return values with nan for absurd ones, which drawing libraries cannot show.

    Arrays without such values are returned without a copy, since logs are long.

    Args:
        values: values of any shape.
    """
    with np.errstate(invalid="ignore"):
        sound = np.abs(values) < LARGEST
    return values if sound.all() else np.where(sound, values, np.nan)


def _measured(log: RunLog, breaks: NDArray[np.int64]) -> Array:
    """Return measured positions and rates (N, 2n+2) in the order of a state; without a cart (N, 2n).

    Recordings from a bench have no estimates, so these are drawn. If the log has no rates, they are differences of
    successive positions between two gaps in time, and zero for a single row there.

    Args:
        log: log of a run or a recording.
        breaks: rows that follow a gap in time.
    """
    n, size = len(log.arm_lengths), log.measured.shape[1]
    positions = clean(log.measured)
    rates = log.rates
    if rates is None:
        parts = [
            np.gradient(positions[begin:end], log.time[begin:end], axis=0)
            if end - begin > 1
            else np.zeros((end - begin, size))
            for begin, end in pairwise([0, *breaks.tolist(), len(log.time)])
        ]
        rates = np.concatenate(parts)
    rates = clean(rates)
    arms = [positions[:, :n], rates[:, :n]]
    return np.column_stack([*arms, positions[:, n], rates[:, n]] if log.has_cart else arms)
