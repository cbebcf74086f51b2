"""Plan and fly generated scenes, and tabulate how many runs were completed by factor.

Scenes are planned by `dpcontrol plan` in a separate process with a limit on its processor time, so that a busy machine
changes no outcome. A scene that was not planned in time counts as refused. Plans and refusals are kept in a folder by
the model's text and the itinerary's text up to [run]: a change of the rig's ranges needs no new plans.
"""

import hashlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from generated_scenes import Scene
from independent_decoder import plan_of
from independent_orbits import unkept_orbits
from independent_planner import missing_transfers
from independent_tubes import missing_connections
from verdict_runs import disagreement, runs

from dpcontrol.foundation.statistics import wilson
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
    """One run: why it was not completed, or empty; disagreement: between the score and the independent decoder."""

    problem: str
    disagreement: str


@dataclass(frozen=True)
class Flown:
    """A scene with its planning and its runs; error: why it could not be flown, or empty."""

    scene: Scene
    planned: Planned
    runs: tuple[Flight, ...] = ()
    error: str = ""

    @property
    def completed(self) -> int:
        """The number of completed runs."""
        return sum(not run.problem for run in self.runs)


def plan_key(scene: Scene) -> str:
    """Return a short hash of the texts that determine the plan, with the name in front."""
    text = scene.model + scene.itinerary.split("[run]")[0]
    return f"{scene.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _limit_time(seconds: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(seconds), math.ceil(seconds) + 5))


def planned_scene(scene: Scene, folder: Path, *, limit: float) -> Planned:
    """Plan a scene within `limit` s of processor time, unless its outcome is kept in `folder`."""
    note, plan = folder / f"{plan_key(scene)}.json", folder / f"{plan_key(scene)}.npz"
    if note.is_file():
        return Planned(**json.loads(note.read_text()))
    path = scene.write(folder / "files")
    command = [sys.executable, "-m", "dpcontrol", "plan", str(path), "--out", str(plan), "--workers", "1"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=lambda: _limit_time(limit))
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if done.returncode == 0 and plan.is_file():
        planned = Planned("planned", "", seconds)
    elif done.returncode == -signal.SIGXCPU:
        planned = Planned("timeout", f"not planned in {limit:g} s of processor time", seconds)
    else:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip() and not line.startswith("plan:")]
        said = " ".join(lines) or done.stdout
        planned = Planned("refused", f"exit {done.returncode}: {said[-900:]}", seconds)
    note.write_text(json.dumps(asdict(planned), indent=1) + "\n")
    return planned


def flown_scene(scene: Scene, folder: Path, *, seeds: Sequence[int], planned: Planned) -> Flown:
    """Fly a planned scene and judge each run twice: by its score and by the independent decoder."""
    itinerary = load_itinerary(str(scene.write(folder / "files")))
    reference = load_reference(folder / f"{plan_key(scene)}.npz")
    loop = itinerary.loop
    limits = loop.limits(reference.limits)
    plan = plan_of(reference, loop.rate, (limits.position, limits.velocity, limits.acceleration))
    flights = []
    try:
        for case in runs(itinerary, reference, {}, list(seeds)):
            problem = verdict_on(case.flown, reference).problem
            flights.append(Flight(problem, disagreement(case, reference, plan)))
    except Exception as error:  # noqa: BLE001
        return Flown(scene, planned, error=f"{type(error).__name__}: {error}")
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


def table_by_factor(flights: Iterable[Flown]) -> str:
    """Return the lines of the table: by factor and level, scenes planned and runs completed."""
    flights = list(flights)
    cells: dict[tuple[str, str], list[Flown]] = defaultdict(list)
    for flight in flights:
        for factor, value in {"all": "", **flight.scene.factors}.items():
            cells[factor, _level(factor, value)].append(flight)
    order = {name: k for k, name in enumerate(["all", *flights[0].scene.factors])}
    lines = ["| factor | level | scenes | planned | runs completed | lower end |", "|---|---|---|---|---|---|"]
    for (factor, level), own in sorted(cells.items(), key=lambda item: (order[item[0][0]], _number(item[0][1]))):
        runs = sum(len(one.runs) for one in own)
        done = sum(one.completed for one in own)
        share = wilson(done, runs) if runs else None
        rate = f"{done} of {runs}, {100 * done / runs:.1f} %" if runs else "-"
        ready = sum(one.planned.outcome == "planned" for one in own)
        lines.append(
            f"| {factor} | {level} | {len(own)} | {ready} | {rate} | {f'{100 * share.low:.1f}' if share else '-'} |"
        )
    return "\n".join(lines)


def _number(level: str) -> tuple[float, str]:
    try:
        return float(level.split()[0]), level
    except (ValueError, IndexError):
        return -1.0, level


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
            file = folder / "files" / f"{one.scene.name}.toml"
            missing = [
                *missing_connections(file), *unkept_orbits(file), *missing_transfers(file, attempts=ATTEMPTS)
            ]  # fmt: skip
            lines.append(f"    independent searches do not find: {', '.join(missing) or 'nothing amiss'}")
        elif one.error:
            lines.append(f"{head}: not flown: {one.error}")
        elif one.completed < len(one.runs):
            reasons = Counter(run.problem for run in one.runs if run.problem)
            listed = "; ".join(f"{n} times {reason}" for reason, n in reasons.most_common(3))
            lines.append(f"{head}: {one.completed} of {len(one.runs)} completed: {listed}")
        lines += [f"{head}: false verdict: {run.disagreement}" for run in one.runs if run.disagreement]
    return "\n".join(lines)


def plans_folder(default: Path) -> Path:
    """Return the folder of the plans: DPCONTROL_SCENES, if it is set."""
    folder = Path(os.environ.get("DPCONTROL_SCENES", default))
    folder.mkdir(parents=True, exist_ok=True)
    return folder
