"""Campaigns: one itinerary, many seeds, several cases; how often it is completed, and how sure that is.

A case is a controller with values that override the scene's. All cases run the same seeds, so that they can be compared
in pairs. Jobs of some seeds each go to workers; the table does not depend on how many there are or which of them die.
"""

import itertools
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import dpcontrol
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.processes import processors
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.lab.batch import can_batch
from dpcontrol.lab.statistics import Pairing, Share, paired, wilson
from dpcontrol.scenes.campaign_jobs import Case, Job, Row
from dpcontrol.scenes.campaign_store import Parts, write_rows
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.plan import Plan, make_plan
from dpcontrol.scenes.workers import run_locally, run_on_cluster

PATHS = ("compiled", "ticks")
MOST_RUNS = 1_000_000
MOST_PAIRED = 6
"""Cases up to which each two are compared."""
MOST_TICKS = 5_000_000
"""Of all runs of a job together: what is kept of them takes 72 bytes a tick."""
MOST_TICKS_OF_LOOPS = 120_000
"""Of a job whose runs go one after the other, in a quarter of a minute: so much is lost where a campaign is killed."""


@dataclass(frozen=True)
class CampaignSettings:
    """runs for each case, from seed `first_seed` on; path: "compiled" runs many seeds in lockstep, "ticks" the loop
    itself; workers: processes, 0 for one on each processor; scheduler: address of a Dask cluster, or empty; batch:
    seeds in a job, fewer where runs are long; replayed: how many of a job's failures in lockstep the loop itself runs
    again, to confirm them.
    """

    runs: int
    first_seed: int = 0
    path: str = "compiled"
    workers: int = 0
    scheduler: str = ""
    batch: int = 256
    replayed: int = 4

    def __post_init__(self) -> None:
        """Refuse an impossible campaign.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        bounds = {"runs": (1, MOST_RUNS), "first_seed": (0, 2**31), "workers": (0, 1024), "batch": (1, 4096)}
        bounds["replayed"] = (0, 4096)
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"campaign: {name} = {value!r}: must be {low} to {high}")
        if self.path not in PATHS:
            raise InputError(f"campaign: path = {self.path!r}: must be one of {', '.join(PATHS)}")


@dataclass(frozen=True)
class CaseResult:
    """One case's runs: how many were completed, and the rows of those that were not."""

    case: Case
    completed: Share
    failures: tuple[Row, ...]


@dataclass(frozen=True)
class Campaign:
    """What came out. completed: of all cases; pairs: (first case, second case, comparison) for each two of a few cases.
    file: the rows.
    """

    itinerary: str
    completed: Share
    results: tuple[CaseResult, ...]
    pairs: tuple[tuple[str, str, Pairing], ...]
    seconds: float
    simulated_seconds: float
    file: Path


def cases_of(itinerary: Itinerary, *, fixed: Mapping[str, Any], over: Mapping[str, Sequence[Any]]) -> tuple[Case, ...]:
    """Return the cases: every combination of the values in `over`, on top of the overrides in `fixed`.

    Names are those of `Itinerary.with_run`.

    Raises:
        InputError: an unknown name or an impossible value.
    """
    names = list(over)
    cases = []
    for values in itertools.product(*over.values()):
        chosen = dict(zip(names, values, strict=True))
        scene = itinerary.with_run(**{**fixed, **chosen})
        label = ", ".join(f"{k}={v:g}" if isinstance(v, float) else f"{k}={v}" for k, v in chosen.items())
        cases.append(Case(label or "as the scene", tuple(chosen.items()), scene.loop))
    return tuple(cases)


def run_campaign(
    itinerary: Itinerary,
    cases: Sequence[Case],
    file: Path,
    *,
    settings: CampaignSettings,
    progress: Progress = no_progress,
) -> Campaign:
    """Run every case on every seed and write the rows to `file`, whole or not at all.

    Interrupted, it leaves what is finished beside the file, and goes on from there when it is run again.

    Raises:
        InputError: the file cannot be written; no cluster answers; the settings do not fit the plan.
        GoalMissed: the plan did not converge, or workers died again and again.
    """
    began = time.perf_counter()
    plan = make_plan(itinerary, progress=part_of(progress, 0.0, 0.05))
    if not plan.reference.converged:
        raise GoalMissed(f"{itinerary.name} has no reference to follow: {plan.status}")
    jobs = _jobs(plan, cases, settings)
    extra = _number_columns(cases)
    parts = Parts(file, extra=extra)
    kept = {job.key: rows for job in jobs if (rows := parts.load(job.key)) is not None}
    left = [job for job in jobs if job.key not in kept]
    if left:
        if settings.scheduler:
            finished = run_on_cluster(left, settings.scheduler)
        else:
            finished = run_locally(left, settings.workers or processors())
        for job, rows in finished:
            kept[job.key] = [{**row, **_numbers(job.case)} for row in rows]
            parts.keep(job.key, kept[job.key])
            progress(f"{len(kept)} of {len(jobs)} jobs", 0.05 + 0.95 * len(kept) / len(jobs))
    rows = [row for job in jobs for row in kept[job.key]]
    write_rows(file, rows, extra=extra, metadata=_metadata(itinerary, cases, settings))
    parts.remove()
    return _summary(itinerary.name, cases, rows, seconds=time.perf_counter() - began, file=file)


def _jobs(plan: Plan, cases: Sequence[Case], settings: CampaignSettings) -> list[Job]:
    archive = plan.file.read_bytes()
    seeds = range(settings.first_seed, settings.first_seed + settings.runs)
    # A batch never depends on how many runs were asked for, so that more runs of the same campaign reuse the first.
    name, arms = plan.itinerary.name, plan.itinerary.model.arms
    jobs = []
    for case in cases:
        ticks = max(round(plan.reference.duration * case.loop.rate), 1)
        lockstep = settings.path == "compiled" and can_batch(case.loop)
        size = max(min(settings.batch, (MOST_TICKS if lockstep else MOST_TICKS_OF_LOOPS) // ticks), 1)
        uncertainty = plan.itinerary.model.known_to if case.loop.model_uncertainty else None
        jobs += [
            Job(name, archive, arms, case, tuple(seeds[k : k + size]), settings.path, uncertainty, settings.replayed)
            for k in range(0, settings.runs, size)
        ]
    return jobs


def _numbers(case: Case) -> dict[str, float]:
    return {name: float(value) for name, value in case.values if not isinstance(value, str) and name != "mismatch"}


def _number_columns(cases: Sequence[Case]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for case in cases for name in _numbers(case)))


def _metadata(itinerary: Itinerary, cases: Sequence[Case], settings: CampaignSettings) -> dict[str, Any]:
    return {
        "version": dpcontrol.__version__,
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "settings": asdict(settings),
        "cases": {case.label: json.loads(json.dumps(asdict(case.loop), default=str)) for case in cases},
    }


def _summary(name: str, cases: Sequence[Case], rows: Sequence[Row], *, seconds: float, file: Path) -> Campaign:
    by_case = {case.label: [row for row in rows if row["case"] == case.label] for case in cases}
    results = tuple(
        CaseResult(
            case,
            wilson(sum(row["completed"] for row in by_case[case.label]), len(by_case[case.label])),
            tuple(row for row in by_case[case.label] if not row["completed"]),
        )
        for case in cases
    )
    pairs = tuple(
        (a.label, b.label, paired(*([row["completed"] for row in by_case[c.label]] for c in (a, b))))
        for a, b in itertools.combinations(cases if len(cases) <= MOST_PAIRED else (), 2)
    )
    simulated = sum(row["simulated_seconds"] for row in rows)
    completed = wilson(sum(row["completed"] for row in rows), len(rows))
    return Campaign(name, completed, results, pairs, seconds, simulated, file)
