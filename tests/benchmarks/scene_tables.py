"""Tables of drawn scenes: runs completed, and how well the cautions of plans tell the scenes that fail.

    export PYTHONPATH=tests
    python tests/benchmarks/scene_tables.py FOLDER scene 200 120 20   # generated scenes 200 to 319, 20 runs each
    python tests/benchmarks/scene_tables.py FOLDER lab 0 100 10       # 100 ordinary laboratories, 10 runs each

Every scene's row is stored in FOLDER/rows.json when its runs are done; stored rows are not run again. Lower ends of
95 % intervals come from drawing scenes, not runs, with replacement, because runs of one scene succeed or fail together.
"""

import json
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from generated_scenes import Scene, sampled_scene
from independent_decoder import plan_of
from independent_orbits import unkept_orbits
from independent_planner import missing_transfers
from independent_tubes import missing_connections
from ordinary_labs import sampled_lab
from verdict_runs import disagreement, runs as flown_runs

from dpcontrol.judge.score import verdict_on
from dpcontrol.plans.cautions import cautions_of
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.references.reference import load_reference

SAMPLERS: dict[str, Callable[[int], Scene]] = {"scene": sampled_scene, "lab": sampled_lab}
LIMIT = 240.0
"""Processor time for planning one scene, s."""
ATTEMPTS = 8
"""Initial guesses of the independent planner for each transfer of a refused scene."""


def _limit_time() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (round(LIMIT), round(LIMIT) + 5))


def planned_scene(scene: Scene, folder: Path) -> tuple[str, str]:
    """Plan a scene within `LIMIT`, and return the outcome ("planned", "refused" or "timeout") and the reason."""
    path, plan = scene.write(folder), folder / f"{scene.name}.npz"
    command = [sys.executable, "-m", "dpcontrol", "plan", str(path), "--out", str(plan), "--workers", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=_limit_time)
    if done.returncode == 0 and plan.is_file():
        return "planned", ""
    if done.returncode == -signal.SIGXCPU:
        return "timeout", f"not planned in {LIMIT:g} s of processor time"
    return "refused", f"exit {done.returncode}: {done.stderr.strip()[-900:]}"


@dataclass(frozen=True)
class SceneRow:
    """A scene with the outcome of its planning, what independent searches do not find, its cautions and its runs."""

    seed: int
    outcome: str
    reason: str
    unfound: tuple[str, ...] = ()
    cautions: dict[str, float] = field(default_factory=dict)
    runs: int = 0
    completed: int = 0
    causes: tuple[str, ...] = ()
    false_verdicts: tuple[str, ...] = ()


def unfound(file: Path) -> tuple[str, ...]:
    """Return what a refused itinerary asks for and independent searches do not find either; takes minutes."""
    return (*missing_connections(file), *unkept_orbits(file), *missing_transfers(file, attempts=ATTEMPTS))


def scene_row(scene: Scene, folder: Path, runs: int) -> SceneRow:
    """Plan a scene, list its cautions, fly it, judge each run by its score and the independent decoder, and sum up."""
    outcome, reason = planned_scene(scene, folder)
    row = SceneRow(scene.seed, outcome, reason)
    if outcome != "planned":
        return replace(row, unfound=unfound(folder / f"{scene.name}.toml"))
    path, first = folder / scene.name, 1000 * scene.seed
    itinerary, reference = load_itinerary(f"{path}.toml"), load_reference(path.with_suffix(".npz"))
    limits = itinerary.loop.limits(reference.limits)
    plan = plan_of(reference, itinerary.loop.rate, (limits.position, limits.velocity, limits.acceleration))
    cases = list(flown_runs(itinerary, reference, {}, list(range(first, first + runs))))
    verdicts = [verdict_on(case.flown, reference) for case in cases]
    told = [disagreement(case, reference, plan) for case in cases]
    return replace(
        row,
        cautions={caution.cause.value: caution.figure for caution in cautions_of(itinerary, reference)},
        runs=runs,
        completed=sum(verdict.completed for verdict in verdicts),
        causes=tuple(sorted({verdict.cause for verdict in verdicts if not verdict.completed})),
        false_verdicts=tuple(text for text in told if text),
    )


def share_line(name: str, successes: Sequence[int], runs: Sequence[int]) -> str:
    """Return a line of the table: scenes, those that complete all, runs, their share and its lower end."""
    good, most = np.array(successes), np.array(runs)
    if not len(good):
        return f"| {name} | 0 | | | | |"
    draws = np.random.default_rng(0).integers(len(good), size=(4000, len(good)))
    low = np.quantile(good[draws].sum(axis=1) / most[draws].sum(axis=1), 0.025)
    whole, share = int(np.count_nonzero(good == most)), good.sum() / most.sum()
    return f"| {name} | {len(good)} | {whole} | {good.sum():,} of {most.sum():,} | {share:.1%} | {low:.1%} |"


def table(rows: Sequence[SceneRow]) -> str:
    """Return the lines of the table and a sentence about the cautions."""
    flown = [row for row in rows if row.outcome == "planned"]
    warned, silent = ([row for row in flown if bool(row.cautions) is wanted] for wanted in (True, False))
    low = [row for row in flown if row.completed < 0.9 * row.runs]
    whole = [row for row in warned if row.completed == row.runs]
    lines = ["| scenes | number | complete all | runs completed | share | lower end |", "|---|---|---|---|---|---|"]
    for name, chosen in (("all", flown), ("without a caution", silent), ("with a caution", warned)):
        lines.append(share_line(name, [row.completed for row in chosen], [row.runs for row in chosen]))
    told = [row.runs if row.cautions else row.completed for row in flown]
    lines.append(share_line("completed or with a caution", told, [row.runs for row in flown]))
    lines.append(
        f"\n{len(flown)} of {len(rows)} scenes have a plan. {len(low)} complete less than 90 %, "
        f"{sum(bool(row.cautions) for row in low)} of them have a caution. Of {len(warned)} with one, {len(whole)} "
        f"complete all. {sum(len(row.false_verdicts) for row in flown)} false verdicts."
    )
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, and print the table."""
    folder, kind, first, count, runs = Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:])
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "rows.json"
    stored = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    rows = {row["seed"]: SceneRow(**row) for row in stored}
    for seed in range(first, first + count):
        if seed not in rows:
            rows[seed] = scene_row(SAMPLERS[kind](seed), folder, runs)
            file.write_text(json.dumps([asdict(row) for row in rows.values()], indent=1) + "\n", encoding="utf-8")
            sys.stdout.write(f"{rows[seed]}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{table([*rows.values()])}\n")


if __name__ == "__main__":
    main()
