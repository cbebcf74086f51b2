"""Controllers on the simulated bench: how well they track, how often they come through, what they spend.

Every controller of a task has the same bench, filter and seeds; what differs is the law. Two campaigns each: one with
the itinerary's own small mismatch for the error, one at 10 % for the share that comes through.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.loop.batch import BatchRun, can_batch, run_batch
from dpcontrol.loop.loop import LoopSettings, run_loop
from dpcontrol.loop.result import Ending
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

SMALL, LARGE = 0.02, 0.10
"""Mismatch: what the shipped itineraries run with, and what success is asked at."""
INITIAL_ERROR = 0.02
"""rad."""
Judge = Callable[[BatchRun], bool]


@dataclass(frozen=True)
class Task:
    """What controllers are compared on: a reference, the arms, and how a run is judged."""

    title: str
    reference: Reference
    arms: ArmChainParameters
    judge: Judge


@dataclass(frozen=True)
class Outcome:
    """rms error of the angles, rad, of runs that came through at the small mismatch (nan: none did); shares that came
    through at the small and at the large one; rms of the feedback, m/s², at the small one.
    """

    error: float
    success_small: float
    success: float
    effort: float


def outcome(task: Task, controller: Controller, settings: LoopSettings, *, seeds: int) -> Outcome:
    """Return what `seeds` runs at each mismatch come to."""
    runs = _runs(task, controller, settings, seeds)
    small, large = runs[:seeds], runs[seeds:]
    good = [run for run in small if task.judge(run)]
    errors = [_error(run, task.arms.count) for run in good]
    return Outcome(
        float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan"),
        len(good) / seeds,
        sum(task.judge(run) for run in large) / seeds,
        float(np.sqrt(np.mean([run.rms_feedback**2 for run in small]))),
    )


def _error(run: BatchRun, n: int) -> float:
    return float(np.sqrt(np.mean((run.truth[:, :n] - run.references[:, :n]) ** 2)))


def _runs(task: Task, controller: Controller, settings: LoopSettings, seeds: int) -> Sequence[BatchRun]:
    """Return `seeds` runs at the small mismatch, then as many at the large one."""
    settings = replace(settings, initial_error=INITIAL_ERROR)
    lanes = [(seed, mismatch) for mismatch in (SMALL, LARGE) for seed in range(seeds)]
    if can_batch(settings, controller):
        return run_batch(
            task.arms, settings=settings, seeds=[seed for seed, _ in lanes], mismatches=[m for _, m in lanes],
            controller=controller, limits=settings.limits(task.reference),
        )  # fmt: skip
    alone = [replace(settings, seed=seed, mismatch=mismatch) for seed, mismatch in lanes]
    return [BatchRun.of(run_loop(task.reference, task.arms, settings=one, controller=controller)) for one in alone]


def held(orbit_angles: Array, *, period: float, near: float = 0.1) -> Judge:
    """Return a judge: did the run last to its end, its angles within `near` rad of the orbit (M, n) in its last period?

    The least distance over phases and turns counts.
    """

    def judge(run: BatchRun) -> bool:
        if run.ending is not Ending.FINISHED:
            return False
        n = orbit_angles.shape[1]
        last = run.truth[run.times > run.times[-1] - period, None, :n][::4] - orbit_angles
        away = np.abs(last - 2 * np.pi * np.rint(last / (2 * np.pi))).max(2).min(1)
        return bool(away.max() <= near)

    return judge


def tick_of(controller: Controller, *, extras: int = 0) -> Callable[[], Action]:
    """Return what a tick of the controller costs, as a function to be timed, walking along what it asks for."""
    session, state, extra = controller.begin(), controller.first_state, np.zeros(extras)
    tick = 0

    def step() -> Action:
        nonlocal tick, state
        tick += 1
        action = session.command(tick, state, extra)
        # A state that stood still would be lost by the clocks of those that have one.
        state = action.reference
        return action

    return step
