"""Run an itinerary: its plan, the closed loop, the log; and what a review of the log needs."""

import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import dpcontrol
from dpcontrol.dynamics.arm_chain import Level, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import Progress, content_hash, no_progress
from dpcontrol.lab.loop import run_loop
from dpcontrol.logs import LogWriter, RunLog, read_log
from dpcontrol.review.context import OrbitCurve, ReviewContext
from dpcontrol.review.score import REFERENCE_ATTACHMENT, Score, plan_of, score
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.plan import Plan, plan_key

MODEL_METADATA = "model_parameters"


def default_log(itinerary: Itinerary) -> Path:
    """Return logs/NAME-SEED.mcap in the working folder."""
    return Path("logs") / f"{itinerary.name}-{itinerary.loop.seed}.mcap"


def run_plan(plan: Plan, out: Path, *, progress: Progress = no_progress) -> Score:
    """Run the closed loop of a planned itinerary, write its log to `out`, and score it.

    Raises:
        InputError: the log cannot be written.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    itinerary, reference = plan.itinerary, plan.reference
    if not reference.converged:
        raise GoalMissed(f"{itinerary.name} has no reference to follow: {reference.status}")
    limits = itinerary.limits
    with LogWriter(
        out,
        arm_lengths=itinerary.model.arms.length,
        rate_hz=itinerary.loop.rate,
        limits=(limits.position, limits.velocity, limits.acceleration),
        metadata=_metadata(itinerary),
        attachments={
            "scene.toml": itinerary.text.encode(),
            "model.toml": itinerary.model.text.encode(),
            REFERENCE_ATTACHMENT: plan.file.read_bytes(),
        },
    ) as writer:
        result = run_loop(reference, itinerary.model.arms, settings=itinerary.loop, sink=writer, progress=progress)
        writer.result(real_time_factor=repr(result.real_time_factor), ending=result.ending.value)
    return score(read_log(out))


def _metadata(itinerary: Itinerary) -> Mapping[str, str]:
    """Return what tells this run from others; settings as JSON, so that overrides on the command line are kept."""
    return {
        "version": dpcontrol.__version__,
        "commit": _commit(),
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "seed": str(itinerary.loop.seed),
        "plan": plan_key(itinerary),
        "scene_hash": content_hash(itinerary.text),
        "model_hash": content_hash(itinerary.model.text),
        "run_settings": json.dumps(asdict(itinerary.loop), sort_keys=True),
        MODEL_METADATA: json.dumps(asdict(itinerary.model.arms), sort_keys=True),
    }


def _commit() -> str:
    """Return the commit of the checkout that this package runs from, or "" for an installed one."""
    root = Path(dpcontrol.__file__).parent.parent
    if not (root / ".git").exists():
        return ""
    try:
        found = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty"],
            capture_output=True, text=True, timeout=5, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return found.stdout.strip()


def review_context(log: RunLog) -> ReviewContext:
    """Return what a review shows besides the log's own series, from the plan that the log carries.

    Raises:
        InputError: the log carries no plan.
    """
    plan = plan_of(log)
    notes: dict[str, Any] = dict(plan.notes)
    verdict = score(log)
    n = len(log.arm_lengths)
    states = log.estimate if log.truth is None else log.truth
    energy = None
    if MODEL_METADATA in log.metadata:
        values: dict[str, Any] = json.loads(log.metadata[MODEL_METADATA])
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        parameters = ArmChainParameters(**plain)
        equations = equations_of(parameters, Level.CONSERVATIVE)
        energy = NumericEquations(equations, parameters.base()).hamiltonian(states[:, : 2 * n])
    done = {True: "completed", False: "not completed", None: "completion unknown"}[verdict.completed]
    return ReviewContext(
        title=f"{notes['title']} — {notes['itinerary']}, seed {verdict.seed}",
        arm_lengths=log.arm_lengths,
        limits=(plan.limits.position, plan.limits.velocity, plan.limits.acceleration),
        orbits=tuple(
            OrbitCurve(f"{o['saddle']} at {o['energy']:g} J", np.asarray(plan.extra[f"orbit_{k}"]))
            for k, o in enumerate(notes["orbits"])
        ),
        saddle_energies={name: s["energy"] for name, s in notes["saddles"].items()},
        symbols=tuple((s["time"], s["text"]) for s in notes["symbols"]),
        energy=energy,
        verdict=f"{done}: {verdict.symbols_completed} of {verdict.symbols_total} symbols; {verdict.reason}",
    )
