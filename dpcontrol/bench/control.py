"""Chart of controllers: error and failures against the time of a tick, and effort against error.

Three tasks on the same bench: follow one turn of the outer arm, keep the orbit about Down-Up alive, hold both arms up.
Every controller of a task has the same bench and seeds; what differs is the law, and for the adaptive one the filter,
which must estimate the model's errors: a tick's time is that of filter and law together. Two campaigns each: one with
the itineraries' own small mismatch for the error, one at 10 % for the share that comes through.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.chart import (
    Attempt,
    Border,
    EdgeChart,
    EdgeMap,
    Missing,
    Panel,
    Point,
    PrecisionChart,
    find_border,
    measured_maps,
)
from dpcontrol.bench.measure import Judged, timed_in_turns
from dpcontrol.control.estimator_settings import AdaptiveEkfSettings, EkfSettings
from dpcontrol.control.interface import Controller, SampledModel
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings, ogy_controller
from dpcontrol.control.periodic import OrbitController, orbit_controller
from dpcontrol.control.tracking import (
    AdaptiveSettings,
    FeedforwardSettings,
    TvlqrSettings,
    adaptive_controller,
    tracking_controller,
)
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.loop import (
    LoopSettings,
    can_batch,
    loop_controller,
    loop_margins,
    make_ticker,
    run_batch,
    run_loop,
    sampled_model,
)
from dpcontrol.loop.result import BatchRun, Ending, Reading
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference, still
from dpcontrol.references.sustained import sustained_orbit
from dpcontrol.review.score import Flown, verdict_on
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run_options import RunOptions

Array = NDArray[np.float64]

RATE = 1000.0
SMALL, LARGE = 0.02, 0.10
"""Mismatch: what the shipped itineraries run with, and what success is asked at."""
INITIAL_ERROR = 0.02
"""rad."""
AUGMENTED = AdaptiveEkfSettings()
_PLAIN = EkfSettings()
_BARE = EkfSettings(augment=())
"""For pulses, the first of which have no time for what the filter finds."""
_ERROR = "rms error of the angles, rad"
Made = Mapping[tuple[str, str], tuple[Callable[[SampledModel], Controller], EkfSettings]]
"""Controllers by method and setting, each with the filter that it is run with."""
Judge = Callable[[BatchRun], bool]


@dataclass(frozen=True)
class ControlTask:
    """What controllers are compared on: a reference, the arms, and how a run is judged."""

    title: str
    reference: Reference
    arms: ArmChainParameters
    judge: Judge


def chart(quick: bool, progress: Progress) -> PrecisionChart:
    """Return the chart; quick: fewer seeds, sections and weights, and shorter holds."""
    seeds = 4 if quick else 20
    progress("control, one turn", 0.0)
    tracking = _tracking(seeds)
    progress("control, an orbit", 0.3)
    orbit = _orbit((4, 16), seeds, 4.0) if quick else _orbit((1, 2, 3, 4, 8, 16, 32), 10, 10.0)
    progress("control, both arms up", 0.9)
    hold = _hold((0.1, 1.0, 10.0) if quick else (0.1, 1.0, 10.0, 100.0), seeds)
    return PrecisionChart(
        name="control",
        title=f"Control: {SMALL:.0%} of mismatch for the error, {LARGE:.0%} for what fails",
        parts=(*tracking, *orbit, hold),
        reading=(
            "Upper diagrams of a task: rms error of the angles against a tick's time; beside them the share of runs "
            f"at {LARGE:.0%} mismatch that do not come through.",
            "OGY by its sections in a period: an error grows by λ^(1/k) from one to the next, so that few sections "
            "cannot hold the orbit; those stand in the list of what is missing.",
            "Both arms up: effort against error, by the weight of the effort. The data hold effort and success of "
            "every point.",
        ),
        chosen=(
            "The adaptive law for references: half the error, less feedback, and all come through, for two thirds more "
            "time than TVLQR by time. OGY at k = 16."
        ),
    )  # fmt: skip


def measured(task: ControlTask, made: Made, *, seeds: int, default: tuple[str, str] = ("", "")) -> Panel:
    """Return error against the seconds of a tick of those that come through, and the rest with reasons."""
    start_up: dict[str, float] = {}
    judged: dict[tuple[str, str], Judged | str] = {}
    ticks: dict[object, Callable[[], object]] = {}
    for (method, setting), (make, estimator) in made.items():
        settings = LoopSettings(seed=0, rate=RATE, estimator=estimator, initial_error=INITIAL_ERROR)
        model = sampled_model(task.arms, RATE)
        began = time.process_time()
        controller = make(model)
        start_up[", ".join(filter(None, (method, setting)))] = time.process_time() - began
        judged[method, setting] = outcome(task, controller, settings, seeds=seeds)
        ticks[method, setting] = tick_of(task, controller, settings)
    spent = timed_in_turns(ticks)
    points, missing = [], []
    for key, found in judged.items():
        if isinstance(found, str):
            missing.append(Missing(*key, found))
        else:
            one = spent[key]
            points.append(
                Point(*key, one.seconds, found.error, default=key == default, note=found.note, others=found.others,
                      yardstick=one.yardstick)
            )  # fmt: skip
    return Panel("", "", "", tuple(points), start_up, tuple(missing))


def outcome(task: ControlTask, controller: Controller, settings: LoopSettings, *, seeds: int) -> Judged | str:
    """Return the results of `seeds` runs at each mismatch, or that none succeeded at the small one.

    The error is over those that came through; others: shares that came through at both, rms of the feedback in m/s² at
    the small one.
    """
    lanes = [(seed, mismatch) for mismatch in (SMALL, LARGE) for seed in range(seeds)]
    if can_batch(settings, controller):
        runs = run_batch(
            task.arms, settings=settings, seeds=[seed for seed, _ in lanes], mismatches=[m for _, m in lanes],
            controller=controller, limits=settings.limits(task.reference),
        )  # fmt: skip
    else:
        alone = [replace(settings, seed=seed, mismatch=mismatch) for seed, mismatch in lanes]
        runs = [BatchRun.of(run_loop(task.reference, task.arms, settings=one, controller=controller)) for one in alone]
    small, large = runs[:seeds], runs[seeds:]
    good = [run for run in small if task.judge(run)]
    if not good:
        return f"none of {seeds} runs came through at {SMALL:.0%} mismatch"
    n = task.arms.count
    squares = [np.mean((run.truth[:, :n] - run.references[:, :n]) ** 2) for run in good]
    others = {
        "success": sum(task.judge(run) for run in large) / seeds,
        "success_small": len(good) / seeds,
        "effort": float(np.sqrt(np.mean([run.rms_feedback**2 for run in small]))),
    }
    note = f"{others['success']:.0%} come through, feedback {others['effort']:.3f} m/s² rms"
    return Judged(float(np.sqrt(np.mean(squares))), others, note)


def held(orbit_angles: Array, *, period: float, near: float = 0.1) -> Judge:
    """Return a judge: did the run last to its end, its angles within `near` rad of the orbit (M, n) in its last period?

    The least distance over phases and turns counts.
    """

    def judge(run: BatchRun) -> bool:
        if run.ending is not Ending.FINISHED:
            return False
        n = orbit_angles.shape[1]
        last = run.truth[run.times > run.times[-1] - period, None, :n][::4] - orbit_angles
        away = np.abs(last - 2 * np.pi * np.rint(last / (2 * np.pi))).max(2).min(1)
        return bool(away.max() <= near)

    return judge


def _completed(reference: Reference) -> Judge:
    limits = reference.limits

    def judge(run: BatchRun) -> bool:
        flown = Flown(
            time=run.times, states=run.truth, reference_angles=run.references[:, :2], applied=run.applied,
            rate_hz=RATE, limits=(limits.position, limits.velocity, limits.acceleration),
            ended="" if run.ending == "finished" else run.reason,
        )  # fmt: skip
        return not verdict_on(flown, reference).problem

    return judge


def tick_of(task: ControlTask, controller: Controller, settings: LoopSettings) -> Callable[[], None]:
    """Return what a tick of the loop costs but for its bench, as a function to be timed, walking along the path."""
    limits = settings.limits(task.reference)
    ticker = make_ticker(task.arms, settings, controller, limits=limits, delay=settings.drive.delay)
    where = ticker.program.model.position_indices
    seen, ticks = controller.first_state[where], cycle(range(ticker.count))

    def step() -> None:
        nonlocal seen
        k = next(ticks)
        if not k:
            ticker.begin()
            seen = controller.first_state[where]
        ticker(k, Reading(0.0, seen))
        # A state that stood still would be lost by the clocks of those that have one.
        seen = ticker.references[k][where]

    return step


def _pair(task: ControlTask, made: Made, *, seeds: int, default: tuple[str, str], why: str) -> tuple[Panel, Panel]:
    """Return the task's two panels: error, and share that fails at the large mismatch, against a tick's time."""
    found, x = measured(task, made, seeds=seeds, default=default), "s per tick, filter and law"
    failed = tuple(replace(p, error=1 - p.others["success"]) for p in found.points)
    return (
        found.titled(f"{task.title}: error", x, _ERROR, why=why),
        found.titled(f"{task.title}: failures", x, f"share that fails at {LARGE:.0%} mismatch", points=failed, why=why,
                    log_y=False),
    )  # fmt: skip


def _tracking(seeds: int) -> tuple[Panel, Panel]:
    scene = load_itinerary("outer-turn")
    reference, arms = make_plan(scene).reference, scene.model.arms
    task = ControlTask("One turn", reference, arms, _completed(reference))
    made: Made = {
        ("feedforward", ""): (lambda m: tracking_controller(reference, m, FeedforwardSettings()), _PLAIN),
        ("TVLQR", "time"): (lambda m: tracking_controller(reference, m, TvlqrSettings()), _PLAIN),
        ("TVLQR", "phase"): (lambda m: tracking_controller(reference, m, TvlqrSettings(schedule="phase")), _PLAIN),
        ("adaptive", ""): (
            lambda m: adaptive_controller(reference, m, AdaptiveSettings(), estimator=AUGMENTED), AUGMENTED,
        ),
    }  # fmt: skip
    why = "what the filter finds of arms, drive and encoders leaves little for feedback to do"
    return _pair(task, made, seeds=seeds, default=("adaptive", ""), why=why)


def _orbit(sections: tuple[int, ...], seeds: int, seconds: float) -> tuple[Panel, Panel, Panel]:
    model = load_model("lab")
    orbit = sustained_orbit(lyapunov_orbit(model.system, "down-up", energy=-0.07), model.arms)
    angles = orbit.state(np.linspace(0, orbit.period, 1000))[:, : model.arms.count]
    task = ControlTask("An orbit", orbit.reference, model.arms, held(angles, period=orbit.period))

    def pulses(k: int, kind: type) -> Callable[[SampledModel], Controller]:
        return lambda m: ogy_controller(orbit, m, kind(sections=k), seconds=seconds)

    made: Made = {
        ("TVLQR", schedule): (
            lambda m, s=schedule: orbit_controller(orbit, m, TvlqrSettings(schedule=s), seconds=seconds), _PLAIN,
        )
        for schedule in ("time", "phase")
    }  # fmt: skip
    made |= {("OGY", f"k = {k}"): (pulses(k, OgySettings), _BARE) for k in sections}
    made |= {("OGY, classic", f"k = {k}"): (pulses(k, ClassicOgySettings), _BARE) for k in sections[-2:]}
    why = "a periodic gain at every tick is the plain continuation of what follows references"
    error, failures = _pair(task, made, seeds=seeds, default=("TVLQR", "time"), why=why)
    shipped = f"OGY, k = {OgySettings().sections}"
    spending = tuple(
        replace(p, seconds=max(p.others["effort"], 1e-9), default=p.name == shipped)
        for p in error.points
        if p.method.startswith("OGY")
    )
    why = "more sections see an error earlier, and then push less"
    return error, failures, Panel(
        "An orbit by pulses: effort", "rms of the feedback, m/s²", _ERROR, spending, why=why, timed=False
    )  # fmt: skip


def _hold(weights: tuple[float, ...], seeds: int) -> Panel:
    """Return the panel of both arms held up; weights: times the default weight of the effort."""
    start = np.array([np.pi, np.pi, 0.0, 0.0])
    whole = np.concatenate([start, [0.0, 0.0]])
    place = still(whole, 1.0, method=method_named("radau-5"), limits=Limits(), interval=0.1)
    task = ControlTask("Both arms up", place, load_model("lab").arms, held(start[None, :2], period=1.0))
    plain = HoldSettings()
    made: Made = {
        ("LQR", f"effort × {w:g}"): (
            lambda m, w=w: hold_controller(start, m, replace(plain, effort=w * plain.effort), seconds=4.0), _PLAIN,
        )
        for w in weights
    }  # fmt: skip
    found = measured(task, made, seeds=seeds, default=("LQR", "effort × 1"))
    return found.titled(
        "Both arms up: LQR", "rms of the feedback, m/s²", _ERROR, timed=False,
        points=tuple(replace(p, seconds=p.others["effort"]) for p in found.points),
        why="the same weights as TVLQR's, so that a hold goes over into a motion without a jump",
    )  # fmt: skip


FOLLOWED = (
    ("hold-up-up", "lqr"), ("outer-turn", "tvlqr"), ("outer-turn", "adaptive"), ("keep-down-up", "tvlqr"),
    ("cross", "tvlqr"), ("cross", "adaptive"), ("turn-from-rest", "tvlqr"), ("turn-from-rest", "adaptive"),
    ("up-up", "adaptive"),
)  # fmt: skip
"""Itineraries and laws whose margins are compared with campaigns; a quick chart has the first three."""
MARGIN_ERROR = 2e-3
"""rad on each angle at the start: small, so that stability decides and not the size of what it has to bear."""
STAYED = 10.0
"""s, for which a stay lasts."""
ASTRAY = 0.3
"""rad from the reference over a run's last tenth: what is farther off was not held."""
TRIED = 10.0
"""The greatest gain that a simulated drive has: what a loop bears beyond it is not tried."""
CHATTER = 3.0
"""m/s² rms of the feedback, which stays below 1 while the loop is stable: more is a swing that limits alone contain."""
SHORT = 1.0
"""By what share a border may lie beyond its margin: a flight ends before what grows slowly has grown."""


@dataclass(frozen=True, eq=False)
class FollowedReference:
    """A reference with the law that follows it, in runs of `seeds` seeds."""

    reference: Reference
    arms: ArmChainParameters
    settings: LoopSettings
    controller: Controller
    margins: Mapping[str, float]
    seeds: int

    def run(self, *, gain: float = 1.0, delay: float = 0.0, lag: float = 0.0) -> Attempt:
        """Return whether half of the seeds hold on to the reference with a drive that is so unlike the one believed."""
        believed, rate = self.settings.drive.delay, self.settings.rate
        drive = replace(self.settings.drive, response=gain, lag=lag, delay=believed + delay * rate)
        runs = run_batch(
            self.arms, settings=replace(self.settings, drive=drive), seeds=range(self.seeds),
            controller=self.controller, limits=self.settings.limits(self.reference), believed_delay=believed,
        )  # fmt: skip
        failed = [why for run in runs if (why := _astray(run))]
        return Attempt(2 * len(failed) < self.seeds, failed[0] if failed else "")


def _astray(run: BatchRun) -> str:
    """Return why a run did not hold on to its reference, "" where it did."""
    if run.ending is not Ending.FINISHED:
        return run.reason
    if run.rms_feedback > CHATTER:
        return f"finished, but the command swings: feedback of {run.rms_feedback:.2g} m/s² rms"
    tail, n = max(len(run.times) // 10, 1), run.references.shape[1]
    away = float(np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max())
    return "" if away < ASTRAY else f"finished, but {away:.2g} rad away over its last tenth"


@cache
def followed(itinerary: str, law: str, seeds: int) -> FollowedReference:
    """Return an itinerary followed by a law; a stay for `STAYED` s."""
    scene = load_itinerary(itinerary).with_run(RunOptions(controller=law, travel=0.8))
    reference, arms = make_plan(scene).reference, scene.model.arms
    settings = LoopSettings(
        seed=0, controller=scene.loop.controller, estimator=scene.loop.estimator, initial_error=MARGIN_ERROR, travel=0.8
    )
    controller: Any = loop_controller(reference, arms, settings)
    if isinstance(controller, OrbitController | HoldController):
        controller = replace(controller, ticks=round(STAYED * settings.rate))
    least = loop_margins(reference, arms, settings, controller).least()
    margins = {name: value for name, (value, _) in least.items()}
    return FollowedReference(reference, arms, settings, controller, margins, seeds)


def margin_border(name: str, case: tuple[str, str], *, seeds: int, ratio: float) -> Border:
    """Return the border of gain_low, gain_high, delay or lag, beside its margin."""
    loop, key = followed(*case, seeds), name.partition("_")[0]
    predicted = loop.margins[name]
    near, far = {"gain_low": (1.0, predicted / 4), "gain_high": (1.0, min(4 * predicted, TRIED))}.get(
        name, (predicted / 16, 4 * predicted)
    )
    return find_border(
        lambda value: loop.run(**{key: value}), x=0.0, line=", ".join(case), near=near, far=far, ratio=ratio,
        predicted=predicted if name != "gain_high" or predicted < TRIED else None,
    )  # fmt: skip


def margins_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of margins beside campaigns; quick: fewer itineraries and seeds."""
    cases, seeds, ratio = (FOLLOWED[:3], 8, 1.15) if quick else (FOLLOWED, 32, 1.08)

    def border(case: tuple[str, str], name: str) -> Border:
        found = margin_border(name, case, seeds=seeds, ratio=ratio)
        return replace(found, x=float(cases.index(case)))

    theory = "the loop's margin, least along the reference"
    maps = [
        (
            EdgeMap(title, "itinerary and law", label, theory=theory, far="lost", log_x=False, agrees=SHORT),
            partial(border, name=name), cases,
        )
        for name, title, label in (
            ("gain_low", "Too little of a command", "share that the drive gives"),
            ("gain_high", "Too much of a command", "factor that the drive gives"),
            ("delay", "Further delay", "s"), ("lag", "Further lag", "s"),
        )
    ]  # fmt: skip
    return EdgeChart(
        name="edges-margins",
        title="Margins of the loop, and where campaigns end",
        reading=(
            f"Borders: where half of {seeds} runs are lost, or swing within the limits; the drive is not as believed.",
            "Diamonds: the margins, by multipliers over a period where the motion repeats itself, by growth over a "
            "wobble along flights.",
            "A flight may end before what grows has grown, so its border may lie beyond its margin.",
        ),
        chosen=f"Margins as `plan --margins` shows them; a border up to {1 + SHORT:g} times as far counts as agreeing.",
        parts=measured_maps(progress, *maps),
    )
