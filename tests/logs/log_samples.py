"""A small log with random numbers in every field, for tests of writer and reader."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpcontrol.logs import Event, LogWriter, control_fields

RATE = 1000.0
METADATA = {"seed": "7", "commit": "unknown", "scene": "séance"}
ATTACHMENTS = {"scene.toml": b"title = 'x'\n", "reference.npz": bytes(range(256))}


EXTRAS = ("zero_1", "drive", "M11")


@dataclass(frozen=True)
class Sample:
    """Arrays of a log: time (N,), measured (N, n+1), states (N, 2n+2), control (N, fields), extras (N, 6)."""

    arm_lengths: tuple[float, ...]
    has_cart: bool
    time: np.ndarray
    measured: np.ndarray
    estimate: np.ndarray
    reference: np.ndarray
    truth: np.ndarray | None
    control: np.ndarray
    extras: np.ndarray


def sample(ticks: int = 250, *, arms: int = 2, has_cart: bool = True, has_truth: bool = True, seed: int = 3) -> Sample:
    """Return random numbers of the right shapes; some innovations are missing (nan)."""
    rng = np.random.default_rng(seed)
    size = 2 * arms + 2 * has_cart
    control = rng.standard_normal((ticks, len(control_fields(arms, has_cart=has_cart))))
    control[::7, 5] = np.nan
    return Sample(
        arm_lengths=tuple(0.1 * (i + 1) for i in range(arms)),
        has_cart=has_cart,
        time=np.arange(ticks) / RATE,
        measured=rng.standard_normal((ticks, arms + has_cart)),
        estimate=rng.standard_normal((ticks, size)),
        reference=rng.standard_normal((ticks, size)),
        truth=rng.standard_normal((ticks, size)) if has_truth else None,
        control=control,
        extras=rng.standard_normal((ticks, 2 * len(EXTRAS))),
    )


def open_writer(path: Path, run: Sample) -> LogWriter:
    known = {"limits": (0.9, 3.0, 30.0), "extras": EXTRAS, "metadata": METADATA, "attachments": ATTACHMENTS}
    return LogWriter(path, arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=run.has_cart, **known)


def log_ticks(log: LogWriter, run: Sample, first: int, end: int) -> None:
    """Log the ticks from `first` to `end` together."""
    parts = {name: getattr(run, name) for name in ("measured", "estimate", "reference", "truth", "control", "extras")}
    rows = {name: None if part is None else part[first:end] for name, part in parts.items()}
    log.ticks(run.time[first:end], **rows)


def tick_all(log: LogWriter, run: Sample, *, upto: int | None = None) -> None:
    for k in range(len(run.time) if upto is None else upto):
        log_ticks(log, run, k, k + 1)


def write_sample(path: Path, run: Sample) -> Path:
    """Write `run` with an event at its start, one in its middle (0.1 s) and one at its end."""
    with open_writer(path, run) as log:
        log.event(Event(0.0, "info", "loop", words="started"))
        tick_all(log, run, upto=100)
        log.event(Event(0.1, "warn", "drive", words="command cut at 5 m/s²"))
        log_ticks(log, run, 100, len(run.time))
        log.event(Event(run.time[-1], "error", "supervisor", words="ended"))
    return path
