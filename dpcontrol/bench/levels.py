"""Chart of model levels: the cost of each and the error of omitting it, on a scene's motion.

    conservative ⊂ dissipative ⊂ cart ⊂ drive ⊂ force          (see `dpcontrol.dynamics`)

*Motion*: from states along the scene's reference each level flies 0.1 s with the reference's input. The error is the
distance from the fullest level. *Closed loop*: campaigns of the scene with a reference, or on a plant, of
each level. The rig's drive is not identified; the values below are those of a common servo with a linear motor.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from dpcontrol.bench.chart import Missing, Panel, Point, PrecisionChart
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.control.tracking import AdaptiveSettings, TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import compiled_step
from dpcontrol.dynamics.plant import PlantLevel, PlantParameters, plant_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.plans.itinerary import HoldPart, Itinerary, OrbitPart, WalkPart, load_itinerary, overridden
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.plans.run_options import RunOptions
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE
from dpcontrol.references.reference import Reference
from dpcontrol.runs.campaign import Case, Job, run_job
from dpcontrol.runs.evidence import (
    CART_MASS,
    CART_VISCOUS,
    LAG,
    PLANT_LEVELS,
    REFERENCE_LEVELS,
    Evidence,
    LevelRuns,
    motion_key,
)

WINDOW, TICK = 0.1, 1e-3
WINDOWS = 64
LONGEST_STAY = 10.0
"""Length of a stay, s, which repeats its period."""
_LOWER = {"conservative": Level.CONSERVATIVE, "dissipative": Level.DISSIPATIVE}
MOTION_LEVELS = (*_LOWER, *PLANT_LEVELS)
_FLOOR = 1e-11
"""Scaled error of the propagation, and so the least difference between two levels."""
_PLAN_FLOOR = 1e-4
"""Least time to assemble a reference that needs no solver, s."""
_WHY = (
    "the cart level uses all of the rig's identified values; its drive is not identified, so the higher levels are "
    "for users with a known drive"
)


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart of model levels.

    If quick, it has one scene and fewer seeds. The package's evidence covers all scenes.
    """
    names = ("outer-turn",) if quick else ("outer-turn", "cross", "up-up")
    panels: list[Panel] = []
    for k, name in enumerate(names):
        progress(f"levels, {name}", k / len(names))
        panels += _panels(load_itinerary(name), seeds=4 if quick else 20)
    return PrecisionChart(
        name="levels",
        title="Levels of the model: cost of each, and error of omitting the higher ones",
        parts=tuple(panels),
        reading=(
            f"Motion: time for a second of motion against the arms' distance, after {WINDOW:g} s, from the fullest "
            f"level. That is a cart of {CART_MASS:g} kg, pushed by the arms, with a drive lag of {LAG * 1e3:g} ms.",
            "Reference: the solver's time against the effort on a plant equal to the model. Without friction and cart "
            "in the reference, the feedback has to make up for both.",
            "Plant: time against the tracking error's difference from the fullest plant. The data hold effort and "
            "completed runs. A level is enough if neither error nor completion changes by more than a fifth.",
        ),
        chosen=(
            "References at the cart level: a conservative one is made at once and costs the loop more. Plants at the "
            "cart level; a drive's lag changes effort, hardly error. `plan` and `run` report scenes that differ."
        ),
    )  # fmt: skip


def _panels(scene: Itinerary, *, seeds: int) -> list[Panel]:
    evidence, plans = gather(scene, seeds=seeds)
    found = motions(plans["cart"].reference, scene.model.arms)
    fullest = PLANT_LEVELS[-1]
    motion = found.titled(
        f"{scene.name}: motion", "s per second of motion",
        f"arms' distance from the fullest level after {WINDOW:g} s (scaled)", why=_WHY,
        points=tuple(p for p in found.points if p.method != fullest),
        missing=(Missing(fullest, "", "the fullest level, the basis of comparison"),),
    )  # fmt: skip
    made = {level: max(plan.reference.solve_seconds, _PLAN_FLOOR) for level, plan in plans.items()}
    efforts = {level: runs.effort for level, runs in evidence.references.items()}
    reference = Panel(
        f"{scene.name}: reference", "s of the solver", "cart's acceleration, m/s² rms",
        _points(evidence.references, made, efforts, default=scene.reference.level), why=_WHY,
        missing=tuple(
            Missing(level, "", "rest, holds and changes of energy need the cart")
            for level in REFERENCE_LEVELS
            if level not in evidence.references
        ),
    )  # fmt: skip
    flown = {p.method: p.seconds for p in found.points}
    full = evidence.plants[fullest].error
    apart = {level: abs(runs.error - full) / full for level, runs in evidence.plants.items()}
    plant = Panel(
        f"{scene.name}: plant", "s per second of motion", "tracking error, difference from the fullest plant (share)",
        _points(evidence.plants, flown, apart, default="cart"), why=_WHY, log_y=False,
    )  # fmt: skip
    return [motion, reference, plant]


def _points(
    runs: Mapping[str, LevelRuns], seconds: Mapping[str, float], errors: Mapping[str, float], *, default: str
) -> tuple[Point, ...]:
    return tuple(
        Point(
            level, "", seconds[level], errors[level], default=level == default,
            note=f"{found.completed} of {found.runs} completed",
            others={"completed": found.completed, "runs": found.runs, "effort": found.effort,
                    "tracking_error": found.error},
        )
        for level, found in runs.items()
    )  # fmt: skip


def plant_at(level: str, arms: ArmChainParameters) -> PlantParameters:
    """Return the plant of these arms at a level.

    The arms are on the cart, on a cart with a drive, or on one that they push.
    """
    lag = 0.0 if level == PlantLevel.CART else LAG
    mass, drag = (CART_MASS, CART_VISCOUS) if level == PlantLevel.FORCE else (0.0, 0.0)
    return PlantParameters(arms, lag=lag, cart_mass=mass, cart_viscous=drag)


def motions(reference: Reference, arms: ArmChainParameters) -> Panel:
    """Return time per second of motion and error of every level.

    The error is the rms scaled one on a reference's motion.

    The error is that after a window, against the fullest level.
    """
    n = arms.count
    starts = np.linspace(reference.mesh[0], reference.mesh[-1] - WINDOW, WINDOWS)
    times = starts + TICK * (np.arange(round(WINDOW / TICK)) + 0.5)[:, None]
    inputs = reference.input(times)[..., 0]
    first = reference.state(starts).T
    ends = {
        "conservative": _flown(PlantParameters(arms.frictionless()), first, 0 * inputs),
        "dissipative": _flown(PlantParameters(arms), first, 0 * inputs),
        **{level: _flown(plant_at(level, arms), first, inputs) for level in PLANT_LEVELS},
    }
    scale = np.array([ANGLE_SCALE] * n + [RATE_SCALE] * n)[:, None]
    full = ends[PLANT_LEVELS[-1]]

    def judge(one: Alternative[Array], _: Array) -> Judged:
        away = np.abs((ends[one.method][: 2 * n] - full[: 2 * n]) / scale).max(axis=0)
        return Judged(max(float(np.sqrt(np.mean(away**2))), _FLOOR))

    start, command = first[:, 0], float(inputs[0, 0])
    tried = [
        Alternative(level, "", _tick(level, arms, start, command), default=level == "cart", units=TICK)
        for level in MOTION_LEVELS
    ]
    return compare(tried, judge, rounds=61)


def _flown(plant: PlantParameters, first: Array, inputs: Array) -> Array:
    """Return states (N, S) after `inputs` (K, S), each for a tick.

    They start from the cart level's states (N, S).
    """
    step = plant_step(plant.arms.count, plant.level, friction=plant.arms.friction)
    state = first if plant.level is PlantLevel.CART else np.vstack([first, inputs[0]])
    given = np.zeros((step.size_in, state.shape[1]))
    given[step.slices["parameters"]] = plant.numbers()[:, None]
    given[step.slices["duration"]] = TICK
    for row in inputs:
        given[step.slices["state"]], given[step.slices["inputs"]] = state, row
        state = step(given, np.empty((step.size_out, state.shape[1])))
    return state


def _tick(level: str, arms: ArmChainParameters, first: Array, command: float) -> Callable[[], Array]:
    """Return a function to time that computes a tick of a level."""
    if level in _LOWER:
        own = arms.frictionless() if level == "conservative" else arms
        equations, numbers, size = equations_of(own, _LOWER[level]), own.base(), 2 * arms.count
    else:
        plant = plant_at(level, arms)
        equations, numbers, size = plant.equations, plant.numbers(), plant.equations.dimension
    step = compiled_step(equations)
    given, out = np.zeros(step.size_in), np.empty(step.size_out)
    state = np.append(first, command)[:size]
    given[step.slices["parameters"]], given[step.slices["duration"]] = numbers, TICK
    given[step.slices["state"]], given[step.slices["inputs"]] = state, command
    return lambda: step(given, out)


def can_be_conservative(itinerary: Itinerary) -> bool:
    """True if a scene's reference can omit friction and cart.

    It must be one walk between orbits, in one piece.
    """
    alone = len(itinerary.parts) == 1 and isinstance(itinerary.parts[0], WalkPart)
    return alone and not itinerary.keeps and (itinerary.start, itinerary.finish) == ("orbit", "orbit")


def gather(itinerary: Itinerary, *, seeds: int) -> tuple[Evidence, dict[str, Plan]]:
    """Return a scene's evidence and plans.

    It covers the reference's levels on the model, and the plant's levels.
    """
    # Stays are limited to a duration that shows their course.
    parts = (
        replace(part, seconds=min(part.seconds, LONGEST_STAY)) if isinstance(part, HoldPart | OrbitPart) else part
        for part in itinerary.parts
    )
    short = replace(itinerary, parts=tuple(parts))
    levels = REFERENCE_LEVELS if can_be_conservative(itinerary) else REFERENCE_LEVELS[-1:]
    plans = {level: make_plan(replace(short, reference=replace(short.reference, level=level))) for level in levels}
    # One run uses a plant equal to the model, started on the reference; the others use plants of each level. The first
    # uses feedback alone: the parameter estimates of an adaptive law would be noise, attributed to the reference.
    exact = replace(short.loop, mismatch=0.0, initial_error=0.0)
    if isinstance(exact.controller, AdaptiveSettings):
        exact = overridden(exact, RunOptions(controller=TvlqrSettings.kind))
    references = {level: _runs(short, plan.archive, exact, 1) for level, plan in plans.items()}
    plants = {}
    for level in PLANT_LEVELS:
        plant = plant_at(level, short.model.arms)
        drive = replace(
            short.loop.drive, lag=plant.lag, cart_mass=plant.cart_mass, cart_viscous=plant.cart_viscous
        )  # fmt: skip
        plants[level] = _runs(short, plans["cart"].archive, replace(short.loop, drive=drive), seeds)
    return Evidence(itinerary.name, motion_key(itinerary), references, plants), plans


def _runs(itinerary: Itinerary, archive: bytes, loop: LoopSettings, seeds: int) -> LevelRuns:
    """Return the results of `seeds` runs with the reference in `archive`."""
    job = Job(
        itinerary.name, archive, itinerary.model.arms, Case("level", (), loop), tuple(range(seeds)),
        "compiled",
    )  # fmt: skip
    rows = run_job(job)
    effort, error = (
        float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))
        for key in ("rms_cart_acceleration", "rms_tracking_error")
    )
    return LevelRuns(seeds, sum(row["completed"] for row in rows), effort, error)
