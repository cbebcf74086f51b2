"""Failing runs of many itineraries and causes, and what the remedies printed for them are worth when typed."""

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from command_line import dpcontrol

from dpcontrol.plans.overrides import typed
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.campaign import Case, Job
from dpcontrol.runs.preflight import outcomes

BENCH = {
    "mismatch": 0.1,
    "initial_error": 0.05,
    "lag": 0.005,
    "command_noise": 0.3,
    "zero_error": 0.02,
    "counts": 40_000,
    "travel": 0.8,
}
"""An ordinary rig; each cause makes one thing of it worse."""
CAUSES = {
    "mismatch": ("mismatch", 0.2, 0.35),
    "lag": ("lag", 0.01, 0.06),
    "delay": ("delay", 5.0, 40.0),
    "coarse encoders": ("counts", 64, 1000),
    "encoder noise": ("noise", 1e-3, 1e-2),
    "zeros": ("zero_error", 0.05, 0.4),
    "pushes": ("push_impulse", 3e-3, 3e-2),
    "command noise": ("command_noise", 2.0, 30.0),
    "small track": ("travel", 0.03, 0.3),
    "low rate": ("rate", 50.0, 300.0),
    "tilt": ("tilt", 0.01, 0.2),
    "friction": ("friction", 3.0, 30.0),
    "response": ("response", 0.5, 0.85),
    "wrong law": ("controller", 0.0, 0.0),
}
"""The setting behind each cause, and between which values it is drawn, evenly by their logarithm."""
LAWS = ("feedforward", "tvlqr")
SEEDS = 32


@dataclass(frozen=True)
class Failing:
    """A run that fails."""

    itinerary: str
    cause: str
    options: Mapping[str, Any]
    seed: int


@dataclass(frozen=True)
class Typed:
    """The remedies that were printed for a run, whether each completes it when typed, and the sentence."""

    run: Failing
    helps: dict[str, bool]
    sentence: str


def drawn_options(cause: str, random: np.random.Generator) -> dict[str, Any]:
    """Return the options of a rig with one cause of failures."""
    name, low, high = CAUSES[cause]
    if name == "controller":
        return {**BENCH, "controller": str(random.choice(LAWS)), "mismatch": 0.2}
    value = float(f"{math.exp(random.uniform(math.log(low), math.log(high))):.3g}")
    pushes = {"pushes": 2} if cause == "pushes" else {}
    return {**BENCH, name: round(value) if name in ("counts", "delay", "rate") else value, **pushes}


def failing_runs(plans: Sequence[Plan], *, seed: int, each: int = 2) -> Iterator[Failing]:
    """Yield an endless sequence of random failing runs: `each` for every itinerary and cause in turn."""
    random = np.random.default_rng(seed)
    while True:
        for cause in CAUSES:
            plan = plans[int(random.integers(len(plans)))]
            options = drawn_options(cause, random)
            scene, first = plan.itinerary.with_run(options), int(random.integers(10**6))
            job = Job(
                scene.name, plan.archive, scene.model.arms, Case("failing", (), scene.loop),
                tuple(range(first, first + SEEDS)), "compiled", replayed=0,
            )  # fmt: skip
            failed = [row.seed for row in outcomes(job, SEEDS) if not row.completed]
            for one in failed[:each]:
                yield Failing(scene.name, cause, options, one)


def typed_remedies(run: Failing, plan: Path, folder: Path) -> Typed | None:
    """Run it on the command line, ask why it failed, and type each remedy; None if the run is completed."""
    log = folder / "failing.mcap"
    words = ["run", plan, *shlex.split(typed(run.options)), "--seed", str(run.seed), "--force"]
    if dpcontrol(*words, "--out", log).code != 1:
        return None
    asked = dpcontrol("score", log, "--why", "--json", "--yes")
    assert asked.code == 1, asked.stderr
    why = asked.document["why"]
    helps = {
        remedy: dpcontrol(*words, *shlex.split(remedy), "--out", folder / "typed.mcap").code == 0
        for remedy in why["saves"]
    }
    return Typed(run, helps, why["sentence"])
