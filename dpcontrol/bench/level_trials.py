"""What each level of the model costs, and what goes wrong where it is left out, on a scene's own motion.

    conservative ⊂ dissipative ⊂ cart ⊂ drive ⊂ force          (see `dpcontrol.dynamics`)

*Motion*: from states along the scene's reference each level flies 0.1 s with the reference's input; the error is the
distance from what the fullest level does. *Closed loop*: campaigns of the scene with a reference, or on a plant, of
each level. The rig's drive is not identified; the values below are those of a common servo with a linear motor.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import compiled_step
from dpcontrol.dynamics.plant import PlantLevel, PlantParameters, plant_step
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE
from dpcontrol.references.reference import Reference
from dpcontrol.scenes.campaign import Case, Job, run_job
from dpcontrol.scenes.itinerary import HoldPart, Itinerary, OrbitPart, WalkPart
from dpcontrol.scenes.levels import PLANT_LEVELS, REFERENCE_LEVELS, Evidence, LevelRuns, motion_key
from dpcontrol.scenes.plan import Plan, make_plan

Array = NDArray[np.float64]

LAG, CART_MASS, CART_VISCOUS = 5e-3, 3.0, 5.0
"""s, kg, N s/m."""
WINDOW, TICK = 0.1, 1e-3
WINDOWS = 64
LONGEST_STAY = 10.0
"""s: a stay is the same from period to period."""
_LOWER = {"conservative": Level.CONSERVATIVE, "dissipative": Level.DISSIPATIVE}
MOTION_LEVELS = (*_LOWER, *PLANT_LEVELS)
_FLOOR = 1e-11
"""Scaled: what the propagation itself errs by, so what two equal levels may differ by."""


@dataclass(frozen=True)
class LevelMotion:
    """Of a level: s per second of motion, extra s at first; rms scaled error of a window against the fullest level."""

    level: str
    seconds: float
    start_up: float
    yardstick: float
    error: float


def plant_at(level: str, arms: ArmChainParameters) -> PlantParameters:
    """Return these arms on the cart, on a cart with a drive, or on one that they push."""
    if level == PlantLevel.CART:
        return PlantParameters(arms)
    if level == PlantLevel.DRIVE:
        return PlantParameters(arms, lag=LAG)
    return PlantParameters(arms, lag=LAG, cart_mass=CART_MASS, cart_viscous=CART_VISCOUS)


def motions(reference: Reference, arms: ArmChainParameters) -> tuple[LevelMotion, ...]:
    """Return cost and error of every level on a reference's own motion."""
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
    start, command = first[:, 0], float(inputs[0, 0])
    spent = timed_in_turns({level: _tick(level, arms, start, command) for level in MOTION_LEVELS}, 61)
    found = []
    for level in MOTION_LEVELS:
        away = np.abs((ends[level][: 2 * n] - full[: 2 * n]) / scale).max(axis=0)
        error = max(float(np.sqrt(np.mean(away**2))), _FLOOR)
        run = spent[level]
        found.append(LevelMotion(level, run.seconds / TICK, run.start_up, run.yardstick, error))
    return tuple(found)


def _flown(plant: PlantParameters, first: Array, inputs: Array) -> Array:
    """Return states (N, S) after `inputs` (K, S), held for a tick each, from the cart level's states (N, S)."""
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
    """Return what a tick of a level costs, as a function to be timed."""
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


def shortened(itinerary: Itinerary) -> Itinerary:
    """Return a scene whose stays last as long as tells all of them."""
    parts = tuple(
        replace(part, seconds=min(part.seconds, LONGEST_STAY)) if isinstance(part, HoldPart | OrbitPart) else part
        for part in itinerary.parts
    )
    return replace(itinerary, parts=parts)


def can_be_conservative(itinerary: Itinerary) -> bool:
    """Tell whether a scene can do without friction and cart in its reference: one walk from orbit to orbit, in one."""
    alone = len(itinerary.parts) == 1 and isinstance(itinerary.parts[0], WalkPart)
    return alone and not itinerary.keeps and (itinerary.start, itinerary.finish) == ("orbit", "orbit")


def plan_at(itinerary: Itinerary, level: str) -> Plan:
    """Return the scene's plan with a reference of `level`."""
    return make_plan(replace(itinerary, reference=replace(itinerary.reference, level=level)))


def plant_runs(itinerary: Itinerary, archive: Path, *, plant: str, seeds: int) -> LevelRuns:
    """Return what `seeds` runs of the scene come to with the reference in `archive` on a plant of `plant` level."""
    other = plant_at(plant, itinerary.model.arms)
    drive = replace(itinerary.loop.drive, lag=other.lag, cart_mass=other.cart_mass, cart_viscous=other.cart_viscous)
    return _runs(itinerary, archive, replace(itinerary.loop, drive=drive), seeds)


def exact_run(itinerary: Itinerary, archive: Path) -> LevelRuns:
    """Return what one run with the reference in `archive` comes to on a plant that is the model, started on it."""
    return _runs(itinerary, archive, replace(itinerary.loop, mismatch=0.0, initial_error=0.0), 1)


def _runs(itinerary: Itinerary, archive: Path, loop: LoopSettings, seeds: int) -> LevelRuns:
    case = Case("level", (), loop)
    rows = run_job(
        Job(itinerary.name, archive.read_bytes(), itinerary.model.arms, case, tuple(range(seeds)), "compiled")
    )
    squares = {key: np.mean([row[key] ** 2 for row in rows]) for key in ("rms_cart_acceleration", "rms_tracking_error")}
    return LevelRuns(
        seeds,
        sum(row["completed"] for row in rows),
        float(np.sqrt(squares["rms_cart_acceleration"])),
        float(np.sqrt(squares["rms_tracking_error"])),
    )


def gather(itinerary: Itinerary, *, seeds: int) -> tuple[Evidence, dict[str, Plan]]:
    """Return a scene's evidence: its reference's levels on the model itself, its plant's levels; and its plans."""
    short = shortened(itinerary)
    levels = REFERENCE_LEVELS if can_be_conservative(itinerary) else REFERENCE_LEVELS[-1:]
    plans = {level: plan_at(short, level) for level in levels}
    plants = {level: plant_runs(short, plans["cart"].file, plant=level, seeds=seeds) for level in PLANT_LEVELS}
    references = {level: exact_run(short, plan.file) for level, plan in plans.items()}
    return Evidence(itinerary.name, motion_key(itinerary), references, plants), plans


HEADING = f"""What each shipped scene needs of the model: `pytest -m benchmark tests/benchmarks/test_level_evidence.py`.
reference: one run on a plant that is the model. plant: runs with the scene's own mismatch; drive: lag {LAG:g} s;
force: a cart of {CART_MASS:g} kg besides. effort: m/s² rms of the cart; error: rad rms of the angles."""
