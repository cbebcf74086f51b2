"""Run an itinerary: its plan, the closed loop, the log."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import dpcontrol
from dpcontrol.foundation.checkout import commit
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.lab.log_sink import LogSink
from dpcontrol.lab.loop import run_loop
from dpcontrol.logs import LogWriter, read_log
from dpcontrol.review.of_log import MODEL_METADATA
from dpcontrol.review.score import REFERENCE_ATTACHMENT, Score, score
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.plan import Plan, plan_key


def default_log(itinerary: Itinerary) -> Path:
    """Return logs/NAME-SEED.mcap in the working folder."""
    return Path("logs") / f"{itinerary.name}-{itinerary.loop.seed}.mcap"


def run_plan(plan: Plan, out: Path, *, progress: Progress = no_progress) -> Score:
    """Run the closed loop of a planned itinerary, write its log to `out`, and score it.

    Raises:
        InputError: the log cannot be written; the plant is to be drawn from an uncertainty that the model's file does
            not give.
        GoalMissed: the plan did not converge, or no controller can be made for it, or no plant drawn.
    """
    itinerary, reference = plan.itinerary, plan.reference
    if not reference.converged:
        raise GoalMissed(f"{itinerary.name} has no reference to follow: {reference.status}")
    uncertainty = itinerary.uncertainty
    with log_writer(plan, out) as writer:
        sink = LogSink(writer)
        result = run_loop(
            reference, itinerary.model.arms, settings=itinerary.loop, uncertainty=uncertainty, sink=sink,
            progress=progress,
        )  # fmt: skip
        writer.result(real_time_factor=repr(result.real_time_factor), ending=result.ending.value)
    return score(read_log(out))


def log_writer(plan: Plan, out: Path) -> LogWriter:
    """Return the writer of the log of a run, with all that is known before it.

    Raises:
        InputError: the log cannot be written.
    """
    itinerary = plan.itinerary
    limits = itinerary.loop.limits(plan.reference)
    return LogWriter(
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
    )


def _metadata(itinerary: Itinerary) -> Mapping[str, str]:
    """Return what tells this run from others; settings as JSON, so that overrides on the command line are kept."""
    return {
        "version": dpcontrol.__version__,
        "commit": commit(),
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "seed": str(itinerary.loop.seed),
        "plan": plan_key(itinerary),
        "scene_hash": content_hash(itinerary.text),
        "model_hash": content_hash(itinerary.model.text),
        "run_settings": json.dumps(asdict(itinerary.loop), sort_keys=True),
        MODEL_METADATA: json.dumps(asdict(itinerary.model.arms), sort_keys=True),
    }
