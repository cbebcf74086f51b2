"""Tables of drawn scenes: runs completed, and how well the cautions of plans tell the scenes that fail.

    python tests/benchmarks/scene_tables.py FOLDER scene 200 120 20   # generated scenes 200 to 319, 20 runs each
    python tests/benchmarks/scene_tables.py FOLDER lab 0 100 10       # 100 ordinary laboratories, 10 runs each

Every scene's row is stored in FOLDER/rows.json when its runs are done; stored rows are not run again. Lower ends of
95 % intervals come from drawing scenes, not runs, with replacement, because runs of one scene succeed or fail together.
"""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from generated_scenes import Scene, sampled_scene
from ordinary_labs import sampled_lab
from scene_flights import flown_scene, planned_scene

from dpcontrol.plans.cautions import cautions_of
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.references.reference import load_reference

SAMPLERS: dict[str, Callable[[int], Scene]] = {"scene": sampled_scene, "lab": sampled_lab}
LIMIT = 240.0
"""Processor time for planning one scene, s."""
Row = dict[str, object]


def scene_row(scene: Scene, folder: Path, runs: int) -> Row:
    """Plan a scene, list its cautions, fly it, and return its row.

    Args:
        scene: scene to write, plan and fly.
        folder: folder of its files.
        runs: number of runs, whose seeds begin at 1000 times the scene's.
    """
    planned = planned_scene(scene, folder, limit=LIMIT)
    row: Row = {"seed": scene.seed, "outcome": planned.outcome, "reason": planned.reason, **scene.factors}
    if planned.outcome != "planned":
        return row
    path = folder / scene.name
    cautions = cautions_of(load_itinerary(f"{path}.toml"), load_reference(path.with_suffix(".npz")))
    first = 1000 * scene.seed
    flown = flown_scene(scene, folder, seeds=range(first, first + runs), planned=planned)
    causes = sorted({run.cause for run in flown.runs if not run.completed})
    false = [run.disagreement for run in flown.runs if run.disagreement]
    cautioned = {one.cause.value: one.figure for one in cautions}
    return {**row, "cautions": cautioned, "runs": runs, "completed": flown.completed, "causes": causes, "false": false}


def share_line(name: str, rows: Sequence[Row]) -> str:
    """Return a line of the table: scenes, those that complete all, runs, their share and its lower end.

    Args:
        name: name of the line.
        rows: rows of the scenes, each with its successes in `good` and its `runs`.
    """
    if not rows:
        return f"| {name} | 0 | | | | |"
    good, runs = (np.array([int(str(row[key])) for row in rows]) for key in ("good", "runs"))
    draws = np.random.default_rng(0).integers(len(rows), size=(4000, len(rows)))
    low = np.quantile(good[draws].sum(axis=1) / runs[draws].sum(axis=1), 0.025)
    whole = int(np.count_nonzero(good == runs))
    share = good.sum() / runs.sum()
    return f"| {name} | {len(rows)} | {whole} | {good.sum():,} of {runs.sum():,} | {share:.1%} | {low:.1%} |"


def table(rows: Sequence[Row]) -> str:
    """Return the lines of the table and a sentence about the cautions.

    Args:
        rows: rows of `scene_row`.
    """
    flown = [{**row, "good": row["completed"]} for row in rows if row["outcome"] == "planned"]
    warned, silent = ([row for row in flown if bool(row["cautions"]) is wanted] for wanted in (True, False))
    told = [{**row, "good": row["runs"] if row["cautions"] else row["completed"]} for row in flown]
    low = [row for row in flown if int(str(row["completed"])) < 0.9 * int(str(row["runs"]))]
    whole = [row for row in warned if row["completed"] == row["runs"]]
    lines = ["| scenes | number | complete all | runs completed | share | lower end |", "|---|---|---|---|---|---|"]
    lines += [share_line("all", flown), share_line("without a caution", silent), share_line("with a caution", warned)]
    lines.append(share_line("completed or with a caution", told))
    lines.append(
        f"\n{len(flown)} of {len(rows)} scenes have a plan. {len(low)} complete less than 90 %, "
        f"{sum(bool(row['cautions']) for row in low)} of them have a caution. Of {len(warned)} with one, {len(whole)} "
        f"complete all. {sum(len(list(row['false'])) for row in flown)} false verdicts."  # type: ignore[call-overload]
    )
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, and print the table."""
    folder, kind, first, count, runs = Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:])
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "rows.json"
    rows: dict[str, Row] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for seed in range(first, first + count):
        if str(seed) not in rows:
            rows[str(seed)] = scene_row(SAMPLERS[kind](seed), folder, runs)
            file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
            sys.stdout.write(f"{rows[str(seed)]}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{table([*rows.values()])}\n")


if __name__ == "__main__":
    main()
