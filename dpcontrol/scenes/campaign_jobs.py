"""One job of a campaign: some seeds of one case, run to rows; what a worker anywhere is given and gives back.

A job carries all it needs (reference, parameters, settings), so that a worker needs this package and no files. The same
job gives the same rows wherever and however often it runs.
"""

import io
import math
import threading
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from dpcontrol.control.interface import Controller
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.dynamics.uncertain_arms import Uncertainty
from dpcontrol.foundation.files import content_hash
from dpcontrol.lab.batch import BatchRun, can_batch, run_batch
from dpcontrol.lab.control_loop import Fallback
from dpcontrol.lab.loop import LoopSettings, loop_controller, loop_fallback, run_loop
from dpcontrol.lab.result import Ending
from dpcontrol.references.archive import load_reference
from dpcontrol.references.reference import Reference
from dpcontrol.review.score import Flown, verdict_on

Row = dict[str, Any]

COLUMNS: dict[str, str] = {
    "itinerary": "string",
    "case": "string",
    "controller": "string",
    "estimator": "string",
    "seed": "int64",
    "mismatch": "double",
    "completed": "bool",
    "symbols_completed": "int32",
    "symbols_total": "int32",
    "symbol": "string",
    "ending": "string",
    "reason": "string",
    "simulated_seconds": "double",
    "rms_tracking_error": "double",
    "max_cart_position": "double",
    "rms_cart_acceleration": "double",
    "rms_feedback": "double",
    "nis_inside_95": "double",
    "path": "string",
    "replays": "bool",
}
"""A row's columns and their Arrow types. symbol: the one that was not done, empty if all were; case: what the campaign
varied, as name=value; replays: whether the loop itself, tick by tick, fails too, asked of the first failures of a job
only; null where it was not asked. SI units."""

_ONE_AT_A_TIME = threading.Lock()
"""Compiled code is not to be shared between threads, and a Dask worker may have several."""


@dataclass(frozen=True)
class Case:
    """One combination of what a campaign varies: its label, the values by name, and the loop's settings."""

    label: str
    values: tuple[tuple[str, float | str], ...]
    loop: LoopSettings


@dataclass(frozen=True)
class Job:
    """Seeds of one case. reference: the plan's archive; path: "compiled" (many seeds in lockstep) or "ticks";
    uncertainty: of the arms, for cases that draw their plants from it; replayed: how many failures in lockstep are run
    again tick by tick.
    """

    itinerary: str
    reference: bytes = field(repr=False)
    arms: ArmChainParameters
    case: Case
    seeds: tuple[int, ...]
    path: str
    uncertainty: Uncertainty | None = None
    replayed: int = 4

    @property
    def key(self) -> str:
        """What the rows depend on, as 16 hexadecimal digits."""
        settings = repr(
            (self.itinerary, asdict(self.arms), self.case, self.seeds, self.path, self.uncertainty, self.replayed)
        )
        return content_hash(self.reference, settings)


@lru_cache(maxsize=4)
def _reference(archive: bytes) -> Reference:
    return load_reference(io.BytesIO(archive))


@lru_cache(maxsize=8)
def _controller(archive: bytes, arms: ArmChainParameters, loop: LoopSettings) -> Controller:
    return loop_controller(_reference(archive), arms, loop)


@lru_cache(maxsize=8)
def _fallback(archive: bytes, arms: ArmChainParameters, loop: LoopSettings) -> Fallback | None:
    return loop_fallback(_reference(archive), arms, loop)


def run_job(job: Job) -> list[Row]:
    """Run a job's seeds and return a row for each, in their order.

    Raises:
        InputError: the settings do not fit the plan.
        GoalMissed: no controller can be made for it.
    """
    with _ONE_AT_A_TIME:
        return _rows(job)


def _rows(job: Job) -> list[Row]:
    reference = _reference(job.reference)
    loop = job.case.loop
    # By what a controller depends on: cases that differ in the bench share one.
    decisive = LoopSettings(
        seed=0, rate=loop.rate, keep=loop.keep, controller=loop.controller, estimator=loop.estimator,
        supervisor=loop.supervisor,
    )  # fmt: skip
    controller = _controller(job.reference, job.arms, decisive)
    if job.path == "ticks" or not can_batch(loop, controller):
        fallback = _fallback(job.reference, job.arms, decisive)
        return [
            _row(job, reference, seed, _one(job, reference, controller, seed, fallback), path="ticks")
            for seed in job.seeds
        ]
    limits = loop.limits(reference)
    runs = run_batch(
        job.arms, settings=loop, seeds=job.seeds, controller=controller, limits=limits, uncertainty=job.uncertainty
    )
    rows = [_row(job, reference, seed, run, path="compiled") for seed, run in zip(job.seeds, runs, strict=True)]
    for row in [row for row in rows if not row["completed"]][: job.replayed]:
        # What is listed as a failure should be one when its seed is run alone; round-off decides a few.
        again = _row(job, reference, row["seed"], _one(job, reference, controller, row["seed"]), path="ticks")
        row["replays"] = not again["completed"]
    return rows


def _one(
    job: Job, reference: Reference, controller: Controller, seed: int, fallback: Fallback | None = None
) -> BatchRun:
    settings = replace(job.case.loop, seed=seed)
    return BatchRun.of(
        run_loop(
            reference,
            job.arms,
            settings=settings,
            controller=controller,
            fallback=fallback,
            uncertainty=job.uncertainty,
        )
    )


def _row(job: Job, reference: Reference, seed: int, run: BatchRun, *, path: str) -> Row:
    ended = "" if run.ending is Ending.FINISHED else run.reason
    n = reference.states.shape[-1] // 2 - 1
    loop = job.case.loop
    limits = loop.limits(reference)
    flown = Flown(
        time=run.times,
        states=run.truth,
        reference_angles=run.references,
        applied=run.applied,
        rate_hz=loop.rate,
        limits=(limits.position, limits.velocity, limits.acceleration),
        ended=ended,
    )
    verdict = verdict_on(flown, reference)
    symbols = reference.notes["symbols"]
    undone = symbols[verdict.symbols]["text"] if verdict.symbols < len(symbols) else ""
    away = flown.angles - flown.reference_angles
    return {
        "itinerary": job.itinerary,
        "case": job.case.label,
        "controller": loop.controller.kind,
        "estimator": loop.estimator.kind,
        "seed": seed,
        "mismatch": loop.mismatch,
        "completed": not verdict.problem,
        "symbols_completed": verdict.symbols,
        "symbols_total": len(symbols),
        "symbol": undone,
        "ending": run.ending.value,
        "reason": verdict.problem,
        "simulated_seconds": float(run.times[-1]),
        "rms_tracking_error": math.sqrt(float(np.mean(away**2))),
        "max_cart_position": float(np.abs(run.truth[:, 2 * n]).max()),
        "rms_cart_acceleration": math.sqrt(float(np.mean(run.applied**2))),
        "rms_feedback": run.rms_feedback,
        "nis_inside_95": run.nis_inside_95,
        "path": path,
        "replays": True if path == "ticks" else None,
    }
