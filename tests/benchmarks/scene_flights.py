"""Plan and fly generated scenes.

Scenes are planned by `dpcontrol plan` in a separate process with a limit on its processor time, so that a busy machine
changes no outcome. A scene that was not planned in time counts as refused.
"""

import math
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from generated_scenes import Scene
from independent_decoder import plan_of
from verdict_runs import disagreement, runs

from dpcontrol.judge.score import verdict_on
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.references.reference import load_reference


@dataclass(frozen=True)
class Planned:
    """The outcome of planning a scene (planned, refused or timeout), the reason, and the processor time in s."""

    outcome: str
    reason: str
    seconds: float


@dataclass(frozen=True)
class Flight:
    """One run with the cause of its failure, and the disagreement between the score and the independent decoder."""

    completed: bool
    cause: str
    disagreement: str


def _limit_time(seconds: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(seconds), math.ceil(seconds) + 5))


def planned_scene(scene: Scene, folder: Path, *, limit: float) -> Planned:
    """Plan a scene within `limit` s of processor time; its files and its plan are in `folder`."""
    path, plan = scene.write(folder), folder / f"{scene.name}.npz"
    command = [sys.executable, "-m", "dpcontrol", "plan", str(path), "--out", str(plan), "--workers", "1"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=lambda: _limit_time(limit))
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if done.returncode == 0 and plan.is_file():
        return Planned("planned", "", seconds)
    if done.returncode == -signal.SIGXCPU:
        return Planned("timeout", f"not planned in {limit:g} s of processor time", seconds)
    return Planned("refused", f"exit {done.returncode}: {done.stderr.strip()[-900:]}", seconds)


def flown_scene(scene: Scene, folder: Path, *, seeds: Sequence[int]) -> list[Flight]:
    """Fly a planned scene and judge each run twice: by its score and by the independent decoder."""
    itinerary = load_itinerary(str(folder / f"{scene.name}.toml"))
    reference = load_reference(folder / f"{scene.name}.npz")
    loop = itinerary.loop
    limits = loop.limits(reference.limits)
    plan = plan_of(reference, loop.rate, (limits.position, limits.velocity, limits.acceleration))
    return [
        Flight(verdict.completed, verdict.cause, disagreement(case, reference, plan))
        for case in runs(itinerary, reference, {}, list(seeds))
        for verdict in (verdict_on(case.flown, reference),)
    ]
