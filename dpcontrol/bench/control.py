"""Chart 5: controllers, what they do to the error and how often they fail, against the time of a tick and the effort.

Three tasks on the same bench: follow one turn of the outer arm, keep the orbit about Down-Up alive, hold both arms up.
The adaptive law needs a filter that estimates the model's errors, so a tick's time is that of filter and law together.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dpcontrol.bench.chart import Chart, Missing, Panel, Point
from dpcontrol.bench.control_trials import LARGE, SMALL, Outcome, Task, held, outcome, tick_of
from dpcontrol.bench.estimator_trials import noise_of
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.control.adaptive import AdaptiveSettings, adaptive_controller
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import Controller
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.model import SampledModel
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings, ogy_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings, tracking_controller
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.batch import BatchRun
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference, still
from dpcontrol.references.sustained import sustained_orbit
from dpcontrol.review.score import Flown, verdict_on
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.plan import make_plan

RATE = 1000.0
TICKS = "s per tick, filter and law"
SECTIONS = (1, 2, 3, 4, 8, 16, 32)
QUICK_SECTIONS = (4, 16)
WEIGHTS = (0.1, 1.0, 10.0, 100.0)
"""Times the default weight of the effort."""
AUGMENTED = EkfSettings(augment=("friction", "parameters"))
_PLAIN = EkfSettings()
Made = Mapping[tuple[str, str], tuple[Callable[[SampledModel], Controller], EkfSettings]]
"""Controllers by method and setting, each with the filter that it is run with."""


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart; quick: fewer seeds, sections and weights, and shorter holds."""
    seeds = 4 if quick else 20
    progress("control, one turn", 0.0)
    tracking = _tracking(seeds)
    progress("control, an orbit", 0.3)
    orbit = _orbit(QUICK_SECTIONS if quick else SECTIONS, seeds if quick else 10, 4.0 if quick else 10.0)
    progress("control, both arms up", 0.9)
    hold = _hold(WEIGHTS[::2] if quick else WEIGHTS, seeds)
    return Chart(
        name="control",
        title=f"Control: {SMALL:.0%} of mismatch for the error, {LARGE:.0%} for what fails",
        panels=(*tracking, *orbit, hold),
        reading=(
            "Upper diagrams of a task: rms error of the angles against a tick's time; beside them the share of runs "
            f"at {LARGE:.0%} mismatch that do not come through.",
            "OGY by its sections in a period: an error grows by λ^(1/k) from one to the next, so that few sections "
            "cannot hold the orbit; those stand in the list of what is missing.",
            "Both arms up: effort against error, by the weight of the effort. The data hold effort and success of "
            "every point.",
        ),
        chosen=(
            "TVLQR by time for references: the fastest that comes through, with the least effort. The adaptive law "
            "where the model is in doubt: a third more time, one and a half times the feedback, half the error. OGY at "
            "k = 16."
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Row:
    """A controller that comes through: seconds of a tick, filter and law, and of the yardstick beside it."""

    method: str
    setting: str
    seconds: float
    yardstick: float
    outcome: Outcome


def measured(task: Task, made: Made, *, seeds: int) -> tuple[list[Row], list[Missing], dict[str, float]]:
    """Return those that come through, the rest with reasons, and start-ups."""
    start_up, outcomes = {}, {}
    filters: dict[object, Callable[[], object]] = {}
    laws: dict[object, Callable[[], object]] = {}
    for (method, setting), (make, estimator) in made.items():
        settings = LoopSettings(seed=0, rate=RATE, estimator=estimator)
        model = sampled_model(task.arms, RATE)
        began = time.process_time()
        controller = make(model)
        start_up[", ".join(filter(None, (method, setting)))] = time.process_time() - began
        outcomes[method, setting] = outcome(task, controller, settings, seeds=seeds)
        ekf = CompiledEkf(model, estimator, noise=noise_of(task.arms, settings.sensors.counts))
        positions = controller.first_state[model.position_indices]
        # One filter's time for all that have the same, so that its noise puts none before another.
        filters[estimator] = partial(ekf.step, ekf.first(controller.first_state), 0.1, positions)
        laws[method, setting] = tick_of(controller, extras=len(ekf.extra_names))
    spent = timed_in_turns({**filters, **laws})
    rows, missing = [], []
    for (method, setting), found in outcomes.items():
        if np.isfinite(found.error):
            law = spent[method, setting]
            seconds = spent[made[method, setting][1]].seconds + law.seconds
            rows.append(Row(method, setting, seconds, law.yardstick, found))
        else:
            missing.append(Missing(method, setting, f"none of {seeds} runs came through at {SMALL:.0%} mismatch"))
    return rows, missing, start_up


def _pair(task: Task, made: Made, *, seeds: int, default: tuple[str, str], why: str) -> tuple[Panel, Panel]:
    """Return the task's two panels: error, and share that fails at the large mismatch, against a tick's time."""
    rows, missing, start_up = measured(task, made, seeds=seeds)

    def points(of: Callable[[Outcome], float]) -> tuple[Point, ...]:
        return tuple(
            Point(
                row.method, row.setting, row.seconds, of(row.outcome), yardstick=row.yardstick,
                default=(row.method, row.setting) == default,
                note=f"{row.outcome.success:.0%} come through, feedback {row.outcome.effort:.3f} m/s² rms",
                others={
                    "success": row.outcome.success, "success_small": row.outcome.success_small,
                    "effort": row.outcome.effort,
                },
            )
            for row in rows
        )  # fmt: skip

    return (
        Panel(f"{task.title}: error", TICKS, "rms error of the angles, rad", points(lambda o: o.error), start_up,
              tuple(missing), why),
        Panel(f"{task.title}: failures", TICKS, f"share that fails at {LARGE:.0%} mismatch",
              points(lambda o: 1 - o.success), start_up, tuple(missing), why, log_y=False),
    )  # fmt: skip


def _tracking(seeds: int) -> tuple[Panel, Panel]:
    scene = load_itinerary("outer-turn")
    reference, arms = make_plan(scene).reference, scene.model.arms
    task = Task("One turn", reference, arms, _completed(reference))
    made: Made = {
        ("feedforward", ""): (lambda m: tracking_controller(reference, m, FeedforwardSettings()), _PLAIN),
        ("TVLQR", "time"): (lambda m: tracking_controller(reference, m, TvlqrSettings()), _PLAIN),
        ("TVLQR", "phase"): (lambda m: tracking_controller(reference, m, TvlqrSettings(schedule="phase")), _PLAIN),
        ("adaptive", ""): (
            lambda m: adaptive_controller(reference, m, AdaptiveSettings(), estimator=AUGMENTED), AUGMENTED,
        ),
    }  # fmt: skip
    why = "by time the clock needs no state, so a tick is quicker and a run repeats to the bit in lockstep"
    return _pair(task, made, seeds=seeds, default=("TVLQR", "time"), why=why)


def _orbit(sections: tuple[int, ...], seeds: int, seconds: float) -> tuple[Panel, Panel, Panel]:
    model = load_model("lab")
    orbit = sustained_orbit(lyapunov_orbit(model.system, "down-up", energy=-0.07), model.arms)
    angles = orbit.state(np.linspace(0, orbit.period, 1000))[:, : model.arms.count]
    task = Task("An orbit", orbit.reference, model.arms, held(angles, period=orbit.period))

    def pulses(k: int, kind: type) -> Callable[[SampledModel], Controller]:
        return lambda m: ogy_controller(orbit, m, kind(sections=k), seconds=seconds)

    made: Made = {
        ("TVLQR", schedule): (
            lambda m, s=schedule: orbit_controller(orbit, m, TvlqrSettings(schedule=s), seconds=seconds), _PLAIN,
        )
        for schedule in ("time", "phase")
    }  # fmt: skip
    made |= {("OGY", f"k = {k}"): (pulses(k, OgySettings), _PLAIN) for k in sections}
    made |= {("OGY, classic", f"k = {k}"): (pulses(k, ClassicOgySettings), _PLAIN) for k in sections[-2:]}
    error, failures = _pair(
        task, made, seeds=seeds, default=("TVLQR", "time"),
        why="a periodic gain at every tick is the plain continuation of what follows references",
    )  # fmt: skip
    kept = OgySettings()
    spending = Panel(
        "An orbit by pulses: effort",
        "rms of the feedback, m/s²",
        "rms error of the angles, rad",
        tuple(
            replace(p, seconds=max(p.others["effort"], 1e-9), default=p.name == f"OGY, k = {kept.sections}")
            for p in error.points
            if p.method.startswith("OGY")
        ),
        why="more sections see an error earlier, and then push less",
        timed=False,
    )
    return error, failures, spending


def _hold(weights: tuple[float, ...], seeds: int) -> Panel:
    scene = load_model("lab")
    start = np.array([np.pi, np.pi, 0.0, 0.0])
    method, whole = method_named("radau-5"), np.concatenate([start, [0.0, 0.0]])
    place = still(whole, 1.0, method=method, limits=Limits(), interval=0.1)
    task = Task("Both arms up", place, scene.arms, held(start[None, :2], period=1.0))
    plain = HoldSettings()
    made: Made = {
        ("LQR", f"effort × {w:g}"): (
            lambda m, w=w: hold_controller(start, m, replace(plain, effort=w * plain.effort), seconds=4.0), _PLAIN,
        )
        for w in sorted({*weights, 1.0})
    }  # fmt: skip
    rows, missing, start_up = measured(task, made, seeds=seeds)
    points = tuple(
        Point(
            row.method, row.setting, row.outcome.effort, row.outcome.error, default=row.setting == "effort × 1",
            note=f"{row.outcome.success:.0%} come through at {LARGE:.0%} mismatch",
            others={"success": row.outcome.success, "seconds_per_tick": row.seconds},
        )
        for row in rows
    )  # fmt: skip
    return Panel(
        "Both arms up: LQR", "rms of the feedback, m/s²", "rms error of the angles, rad", points, start_up,
        tuple(missing), "the same weights as TVLQR's, so that a hold goes over into a motion without a jump",
        timed=False,
    )  # fmt: skip


def _completed(reference: Reference) -> Callable[[BatchRun], bool]:
    limits = reference.limits

    def judge(run: BatchRun) -> bool:
        flown = Flown(
            time=run.times, states=run.truth, reference_angles=run.references[:, :2], applied=run.applied,
            rate_hz=RATE, limits=(limits.position, limits.velocity, limits.acceleration),
            ended="" if run.ending == "finished" else run.reason,
        )  # fmt: skip
        return not verdict_on(flown, reference).problem

    return judge
