"""A motion as a review shows it: of a log with whatever it holds, or of a reference alone.

A simulated run knows truth, estimate, reference and command; a recording from the bench the measured angles only, in
segments. What is missing, or only stands in for something missing, is None here, and what no picture can show is nan.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.logs import Mode, RunLog
from dpcontrol.logs.reader import Event
from dpcontrol.recordings.recording import REPLAYED
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

LARGEST = 1e6
"""In rad, rad/s, m …: no run that is worth a look comes near, and drawing libraries fail far beyond."""
_REFERENCE_RATE = 500.0
ACTUAL = "actual"
"""In `control`: what the simulated cart did, where the truth is known."""
_DRIVEN = ("command", "applied", "feedforward")


@dataclass(frozen=True, eq=False)
class Motion:
    """N ticks of a pendulum of n arms; states are angles, rates and, with a cart, its position and velocity.

    Attributes:
        path: the file it came from.
        time: (N,) in s.
        state: (N, 2n+2) to draw (2n without a cart), and `what` it is: "plant", "estimate", "measured", "reference".
        estimate, reference: (N, 2n+2), or None.
        error: (N, 2n+2) estimate minus truth, or None.
        sigma: (N, 2n+2) standard deviations of the estimate, or None.
        control: (N,) `command`, `applied`, `feedforward`, `saturated`, `mode` by name, and `actual`; or None.
        nis: (N,) nan where there was no measurement; or None. sensors: numbers in a measurement.
        events, metadata, arm_lengths, has_cart, rate_hz: as in the log.
        breaks: rows that follow a gap in time.
        differenced: whether the rates are differences of the measured angles.
        against: what `reference` is: "reference", or "prediction" where a model was replayed on a recording.
    """

    path: Path
    time: Array
    state: Array
    what: str
    estimate: Array | None
    reference: Array | None
    error: Array | None
    sigma: Array | None
    control: dict[str, Array] | None
    nis: Array | None
    sensors: int
    events: tuple[Event, ...]
    metadata: dict[str, str]
    arm_lengths: tuple[float, ...]
    has_cart: bool
    rate_hz: float
    breaks: NDArray[np.int64]
    differenced: bool = False
    against: str = "reference"

    @property
    def arms(self) -> int:
        """Number of arms."""
        return len(self.arm_lengths)

    @property
    def error_name(self) -> str:
        """What the difference between state and reference is called."""
        return "Prediction error" if self.against == "prediction" else "Tracking error"

    @property
    def time_range(self) -> tuple[float, float]:
        """The first and the last time in s, at least one period of the loop apart."""
        first = float(self.time[0])
        return first, max(float(self.time[-1]), first + 1 / self.rate_hz)

    @property
    def pivot(self) -> Array:
        """(N,) the pivot's position in m, zero without a cart."""
        return self.state[:, 2 * self.arms] if self.has_cart else np.zeros(len(self.time))

    def shifted(self, seconds: float) -> "Motion":
        """Return the motion with its clock set back by `seconds`."""
        events = tuple(event._replace(time=event.time - seconds) for event in self.events)
        return replace(self, time=self.time - seconds, events=events)


def motion_of(log: RunLog) -> Motion:
    """Return what a log says, as it can be drawn."""
    n = len(log.arm_lengths)
    truth, estimate, reference = (_cleaned(log.states.get(part)) for part in ("truth", "estimate", "reference"))
    if estimate is not None and reference is not None and np.array_equal(estimate, reference, equal_nan=True):
        reference = None
    breaks = np.flatnonzero(np.diff(log.time) > 1.5 / log.rate_hz) + 1
    state, what = (estimate, "estimate") if truth is None else (truth, "plant")
    if state is None or (what == "estimate" and _stands_in(state, log.measured, n)):
        state, what, estimate = _measured(log, breaks), "measured", None
    control = {name: _clean(values) for name, values in log.controls.items()}
    sigma = None
    if "sigma_1" in control:
        sigma = np.column_stack([control[f"sigma_{i + 1}"] for i in range(state.shape[1])])
        sigma = sigma if np.nan_to_num(sigma).any() else None
    nis = control.get("nis")
    driven = any(np.nan_to_num(control[name]).any() for name in _DRIVEN if name in control)
    if truth is not None and log.has_cart and "applied" in control and len(log.time) > 1:
        control[ACTUAL] = _cart_acceleration(truth[:, 2 * n + 1], log.time)
    busy = "mode" in control and (control["mode"] != Mode.IDLE).any()
    replayed = log.metadata.get("kind") == REPLAYED
    if not busy:
        # Where nothing controlled there was no plan, and no mode worth a strip.
        control = {name: values for name, values in control.items() if name not in ("feedforward", "feedback", "mode")}
    return Motion(
        path=log.path,
        time=log.time,
        state=state,
        what=what,
        estimate=estimate,
        reference=reference,
        error=None if truth is None or estimate is None else estimate - truth,
        sigma=sigma,
        control=control if driven or busy else None,
        nis=nis if nis is not None and np.isfinite(nis).any() else None,
        sensors=n if replayed else log.measured.shape[1],
        events=log.events,
        metadata=log.metadata,
        arm_lengths=log.arm_lengths,
        has_cart=log.has_cart,
        rate_hz=log.rate_hz,
        breaks=breaks,
        differenced=what == "measured" and log.rates is None,
        against="prediction" if replayed else "reference",
    )


def motion_of_reference(reference: Reference, path: Path, *, arm_lengths: tuple[float, ...]) -> Motion:
    """Return a reference as a motion, its input as the command."""
    time = np.arange(reference.mesh[0], reference.mesh[-1], 1 / _REFERENCE_RATE)
    states, inputs = reference.state(time), reference.input(time)[:, 0]
    return Motion(
        path=path,
        time=time,
        state=states,
        what="reference",
        estimate=None,
        reference=None,
        error=None,
        sigma=None,
        control={"feedforward": inputs},
        nis=None,
        sensors=0,
        events=(),
        metadata={"program": str((reference.notes.get("made_from") or {}).get("program", ""))},
        arm_lengths=arm_lengths,
        has_cart=True,
        rate_hz=_REFERENCE_RATE,
        breaks=np.zeros(0, dtype=np.int64),
    )


def _cart_acceleration(velocity: Array, time: Array) -> Array:
    """Return the mean acceleration (N,) m/s² from each tick to the next; nan where a blow moved the cart at once."""
    steps = np.diff(time)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(steps > 0, np.diff(velocity) / steps, np.nan)
    usual = float(np.nanquantile(np.abs(mean), 0.99)) if np.isfinite(mean).any() else 0.0
    with np.errstate(invalid="ignore"):
        mean = np.where(np.abs(mean) <= 5 * usual + 1e-9, mean, np.nan)
    return np.append(mean, mean[-1])


def _clean(values: Array) -> Array:
    """Return values with nan for those beyond all sense; the same array where there are none, for logs are long."""
    with np.errstate(invalid="ignore"):
        sound = np.abs(values) < LARGEST
    return values if sound.all() else np.where(sound, values, np.nan)


def _cleaned(values: Array | None) -> Array | None:
    return None if values is None else _clean(values)


def _stands_in(state: Array, measured: Array, arms: int) -> bool:
    """Tell whether an estimate is nothing but the measured angles, without rates."""
    return np.array_equal(state[:, :arms], measured[:, :arms]) and not state[:, arms : 2 * arms].any()


def _measured(log: RunLog, breaks: NDArray[np.int64]) -> Array:
    """Return the measured positions in state order, with rates by differences within each segment if none are given."""
    n, size = len(log.arm_lengths), log.measured.shape[1]
    positions = _clean(log.measured)
    rates = log.rates
    if rates is None:
        edges = [0, *breaks.tolist(), len(log.time)]
        parts = [
            np.gradient(positions[a:b], log.time[a:b], axis=0) if b - a > 1 else np.zeros((b - a, size))
            for a, b in pairwise(edges)
        ]
        rates = np.concatenate(parts)
    rates = _clean(rates)
    arms = [positions[:, :n], rates[:, :n]]
    return np.column_stack([*arms, positions[:, n], rates[:, n]] if log.has_cart else arms)
