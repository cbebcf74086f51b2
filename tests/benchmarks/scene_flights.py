"""Plan and fly generated scenes, and tabulate how many runs were completed by factor.

Scenes are planned by `dpcontrol plan` in a separate process with a limit on its processor time, so that a busy machine
changes no outcome. A scene that was not planned in time counts as refused.
"""

import math
import resource
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from generated_scenes import Scene
from independent_decoder import plan_of
from independent_orbits import unkept_orbits
from independent_planner import missing_transfers
from independent_tubes import missing_connections
from verdict_runs import disagreement, runs

from dpcontrol.judge.score import verdict_on
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.references.reference import load_reference

ATTEMPTS = 8
"""Initial guesses of the independent planner for each transfer of a refused scene."""


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


@dataclass(frozen=True)
class Flown:
    """A scene with its planning and its runs."""

    scene: Scene
    planned: Planned
    runs: tuple[Flight, ...] = ()

    @property
    def completed(self) -> int:
        return sum(run.completed for run in self.runs)


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


def flown_scene(scene: Scene, folder: Path, *, seeds: Sequence[int], planned: Planned) -> Flown:
    """Fly a planned scene and judge each run twice: by its score and by the independent decoder."""
    itinerary = load_itinerary(str(folder / f"{scene.name}.toml"))
    reference = load_reference(folder / f"{scene.name}.npz")
    loop = itinerary.loop
    limits = loop.limits(reference.limits)
    plan = plan_of(reference, loop.rate, (limits.position, limits.velocity, limits.acceleration))
    flights = [
        Flight(verdict.completed, verdict.cause, disagreement(case, reference, plan))
        for case in runs(itinerary, reference, {}, list(seeds))
        for verdict in (verdict_on(case.flown, reference),)
    ]
    return Flown(scene, planned, tuple(flights))


BINS: dict[str, Sequence[float]] = {
    "Coulomb share": (0, 1e-9, 0.003, 0.006, 0.01, 0.02),
    "smoothing": (0, 1e-9, 0.02, 0.1, 1),
    "half track": (0, 0.4, 0.6, 0.8, 2),
    "delay": (0, 0.01, 1.01, 2.01, 4),
    "lag": (0, 1e-9, 0.005, 0.01, 0.1),
    "counts": (0, 2500, 8000, 1e9),
    "cart resolution": (0, 1e-5, 5e-5, 1),
    "jitter": (0, 1e-9, 0.5, 1.1),
    "noise": (0, 1e-9, 3e-4, 1),
    "belt": (0, 1e-9, 30, 50, 1000),
    "play": (0, 1e-9, 4e-3, 1e-2, 1),
    "cable": (0, 1e-9, 2.5e-3, 1),
    "stiction": (0, 1e-9, 1.5e-3, 1),
}
"""Lower edges of the rows of the table, and the last upper one; other factors have a row for each value."""


def _level(factor: str, value: float | str) -> str:
    edges = BINS.get(factor)
    if edges is None or isinstance(value, str):
        return f"{value:g}" if isinstance(value, float) else str(value)
    k = max(i for i, edge in enumerate(edges[:-1]) if value >= edge)
    return "none" if edges[k + 1] <= 1e-9 else f"{edges[k]:g} to {edges[k + 1]:g}"


def table_by_factor(flights: Sequence[Flown]) -> str:
    """Return the lines of the table: by factor and level, scenes planned and runs completed."""
    lines = ["| factor | level | scenes | planned | runs completed |", "|---|---|---|---|---|"]
    for factor in flights[0].scene.factors:
        cells: dict[str, list[Flown]] = defaultdict(list)
        for flight in sorted(flights, key=lambda one: one.scene.factors[factor]):
            cells[_level(factor, flight.scene.factors[factor])].append(flight)
        for level, own in cells.items():
            runs, done = sum(len(one.runs) for one in own), sum(one.completed for one in own)
            ready = sum(one.planned.outcome == "planned" for one in own)
            lines.append(f"| {factor} | {level} | {len(own)} | {ready} | {done} of {runs} |")
    return "\n".join(lines)


def failures(flights: Iterable[Flown], folder: Path, *, searches: bool = True) -> str:
    """Return lines for each scene that was refused or did not complete all its runs, with the reasons.

    searches: add to each refusal what independent searches do not find either, which takes minutes.
    """
    lines = []
    for one in flights:
        head = f"{one.scene.name} ({one.scene.factors['arms']} arms, {one.scene.factors['itinerary']})"
        if one.planned.outcome != "planned":
            lines.append(f"{head}: {one.planned.outcome} after {one.planned.seconds:.0f} s: {one.planned.reason}")
            if not searches:
                continue
            file = folder / f"{one.scene.name}.toml"
            missing = missing_connections(file) + unkept_orbits(file) + missing_transfers(file, attempts=ATTEMPTS)
            lines.append(f"    independent searches do not find: {', '.join(missing) or 'nothing amiss'}")
        elif one.completed < len(one.runs):
            reasons = Counter(run.cause for run in one.runs if not run.completed)
            listed = "; ".join(f"{n} times {reason}" for reason, n in reasons.most_common(3))
            lines.append(f"{head}: {one.completed} of {len(one.runs)} completed: {listed}")
        lines += [f"{head}: false verdict: {run.disagreement}" for run in one.runs if run.disagreement]
    return "\n".join(lines)
