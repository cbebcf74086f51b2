"""A small plausible run, made with numpy only: one full turn of the second arm in five seconds."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dpcontrol.judge.run_view import PlanView, RunView, series_of
from dpcontrol.logs import Event, LogWriter, Mode, read_log
from dpcontrol.references.content import PlanOrbit

ARM_LENGTHS = (0.1738, 0.2490)
LIMITS = (0.9, 3.0, 30.0)
RATE = 1000.0


@dataclass(frozen=True)
class SyntheticRun:
    """Arrays of a run: time (N,), states (N, 6), measured (N, 3), control (N, 13)."""

    time: np.ndarray
    truth: np.ndarray
    reference: np.ndarray
    estimate: np.ndarray
    measured: np.ndarray
    control: np.ndarray


def synthetic_run(*, seconds: float = 5.0, rate: float = RATE, seed: int = 1) -> SyntheticRun:
    """Return a run whose second arm turns once, its outer angle from π to 3π, with small errors throughout."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    turn = 1 / (1 + np.exp(-(time - seconds / 2) * 7))
    wobble = np.sin(2 * np.pi * 1.6 * time)
    angles = np.column_stack([0.25 * wobble + 0.9 * np.sin(np.pi * turn) ** 2, np.pi + 2 * np.pi * turn + 0.4 * wobble])
    cart = 0.015 * np.sin(2 * np.pi * 0.4 * time)
    positions = np.column_stack([angles, cart])
    rates = np.gradient(positions, time, axis=0)
    reference = np.column_stack([positions[:, :2], rates[:, :2], positions[:, 2], rates[:, 2]])
    decay = np.exp(-time / 0.4)[:, None]
    drift = 0.02 * np.sin(2 * np.pi * np.outer(time, [0.7, 0.9, 1.1, 1.3, 0.3, 0.5]))
    truth = reference + drift * [1, 1, 5, 5, 0.3, 0.6] + decay * [0.12, -0.1, 0, 0, 0.0, 0.0]
    sigma = np.array([4e-4, 4e-4, 0.02, 0.02, 1e-5, 1e-3]) * (1 + 4 * decay)
    estimate = truth + sigma * rng.standard_normal(truth.shape)
    counts = np.array([2 * np.pi / 40_000, 2 * np.pi / 40_000, 1e-6])
    measured = np.round(truth[:, [0, 1, 4]] / counts) * counts
    feedforward = 0.4 * np.sin(2 * np.pi * 1.6 * time)
    feedback = 6 * decay[:, 0] * np.sin(2 * np.pi * 2 * time) + 0.1 * rng.standard_normal(len(time))
    command = feedforward + feedback
    applied = np.clip(command, -5, 5)
    control = np.column_stack(
        [
            command,
            feedforward,
            feedback,
            applied,
            command != applied,
            rng.chisquare(3, len(time)),
            np.where(time < seconds - 0.5, Mode.TRACKING, Mode.HOLDING),
            sigma,
        ]
    )
    return SyntheticRun(time, truth, reference, estimate, measured, control)


def write_log(path: Path, run: SyntheticRun, *, with_truth: bool = True) -> Path:
    """Write `run` as a log with two events, metadata and an attachment."""
    with LogWriter(
        path,
        arm_lengths=ARM_LENGTHS,
        rate_hz=RATE,
        limits=LIMITS,
        metadata={"seed": "1", "scene": "synthetic"},
        attachments={"scene.toml": b'title = "synthetic"\n'},
    ) as log:
        log.event(Event(run.time[0], "info", "loop", words="started"))
        log.ticks(
            run.time,
            measured=run.measured,
            estimate=run.estimate,
            reference=run.reference,
            truth=run.truth if with_truth else None,
            control=run.control,
        )
        log.event(Event(run.time[-1], "info", "supervisor", words="symbol 1 of 1 completed"))
    return path


def view_of(path: Path, run: SyntheticRun) -> RunView:
    """Write a run as a log and return its view with an orbit, saddle energies, one symbol and an energy."""
    phase = np.linspace(0, 2 * np.pi, 200)
    rate = 2 * np.pi * 1.6
    states = np.column_stack(
        [0.25 * np.sin(phase), np.pi + 0.4 * np.sin(phase), 0.25 * rate * np.cos(phase), 0.4 * rate * np.cos(phase)]
    )
    plan = PlanView(
        orbits=(PlanOrbit("down-up", -0.07, 0.7, 1e3, states),),
        saddle_energies={"down-down": -0.4906, "down-up": -0.1754, "up-down": 0.1754, "up-up": 0.4906},
        symbols=((float(run.time[-1]) / 2, "down-up +"),),
    )
    return replace(
        series_of(read_log(write_log(path, run))),
        title="Turn the outer arm once",
        energy=-0.07 + 0.02 * np.sin(3 * run.time) + 0.05 * np.exp(-run.time / 0.3),
        verdict="completed: 1 of 1 symbols",
        good=True,
        plan=plan,
    )
