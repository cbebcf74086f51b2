"""Charts of controllers and estimators: error against the time of a tick.

*Controllers*: error and failures against the time of a tick, and effort against error. Three tasks on the same bench:
follow one turn of the outer arm, sustain the orbit about Down-Up, hold both arms up. Every controller of a task has
the same bench and seeds. Only the law differs, and for the adaptive one the filter, which must estimate the model's
errors: a tick's time is that of filter and law together. There are two campaigns each: one with the itineraries' small
mismatch for the error, one at 10 % for the share of completed runs.

*Estimators*: error and consistency over the resolution of the encoders. A plant with drawn parameters and encoder zeros
swings under a known input; every estimator has the nominal parameters and the same readings. Error: root
mean square over ticks of the arms' scaled errors (π rad, 10 rad/s).

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle

import numpy as np

from dpcontrol.bench.chart import ChartPage, Diagram
from dpcontrol.bench.measure import Alternative, Judged, compare
from dpcontrol.control.estimator_settings import (
    ADAPTIVE,
    EkfSettings,
    nees,
    share_inside,
)
from dpcontrol.control.interface import Controller, Estimate, Estimator, SampledModel, sampled_model
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings, ogy_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.tracking import (
    AdaptiveSettings,
    FeedforwardSettings,
    TvlqrSettings,
    adaptive_controller,
    tracking_controller,
)
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.controllers import ESTIMATORS, make_estimator
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import BatchRun, Ending
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ANGLE_SCALE, RATE_SCALE, Limits
from dpcontrol.references.reference import Reference, still
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit

RATE = 1000.0
"""Rate of the loop in the comparisons of controllers, Hz."""
SMALL, LARGE = 0.02, 0.10
"""Mismatch: of the shipped itineraries, and of the success campaigns."""
INITIAL_ERROR = 0.02
"""Largest initial error of an angle, rad."""
AUGMENTED = EkfSettings(**ADAPTIVE)
_PLAIN = EkfSettings()
_BARE = EkfSettings(augment=())
"""Settings for pulses; the first pulses come before the filter's estimates."""
_ERROR = "rms error of the angles, rad"
Controllers = Mapping[tuple[str, str], tuple[Callable[[SampledModel], Controller], EkfSettings]]
"""Controllers by method and setting, each with its filter."""
Judge = Callable[[BatchRun], bool]
"""Function of a run that returns True if it has fulfilled its task."""


@dataclass(frozen=True)
class ControlTask:
    """A task that all compared controllers have in common.

    Attributes:
        title: name of the task.
        reference: reference to follow.
        arms: arms of the model.
        judge: decides if a run has fulfilled the task.
    """

    title: str
    reference: Reference
    arms: ArmChainParameters
    judge: Judge


def control_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return controllers' errors and failure rates against the time of a tick.

    Args:
        quick: fewer seeds, sections and weights, and shorter holds.
        progress: called with a label and the completed share.
    """
    seeds = 4 if quick else 20
    progress("control, one turn", 0.0)
    tracking_panels = _tracking(seeds)
    progress("control, an orbit", 0.3)
    orbit_panels = _orbit((4, 16), seeds, 4.0) if quick else _orbit((1, 2, 3, 4, 8, 16, 32), 10, 10.0)
    weights = (0.1, 1.0, 10.0) if quick else (0.1, 1.0, 10.0, 100.0)
    return ChartPage(
        name="control",
        title=f"Control, arms {SMALL:.0%} and {LARGE:.0%} off",
        parts=(*tracking_panels, *orbit_panels, _hold(weights, seeds)),
        reading=(
            "Upper diagrams of a task: rms error of the angles against a tick's time; beside them the share of runs "
            f"at {LARGE:.0%} mismatch that fail.",
            "OGY by its sections in a period: an error grows by λ^(1/k) from one to the next, so few sections "
            "cannot hold the orbit; those are listed as missing.",
            "Both arms up: effort against error, by the weight of the effort. The data hold effort and success of "
            "every point.",
        ),
        chosen="The adaptive law for references, TVLQR by time for an orbit, and OGY at k = 16.",
    )  # fmt: skip


def measured(
    task: ControlTask, controllers: Controllers, *, seeds: int, default: tuple[str, str] = ("", "")
) -> Diagram:
    """Return the diagram of the rms error of angles, rad, against the time of a tick, s, of several controllers.

    Controllers of which no run succeeds have no point but a reason.

    Args:
        task: reference, arms and judge.
        controllers: controllers by method and setting.
        seeds: runs at each mismatch.
        default: method and setting of the default.
    """
    alternatives, trials = [], {}
    for (method, setting), (make, estimator) in controllers.items():
        settings = LoopSettings(seed=0, rate=RATE, estimator=estimator, initial_error=INITIAL_ERROR)
        controller = make(sampled_model(task.arms, RATE))
        trials[method, setting] = partial(outcome, task, controller, settings, seeds=seeds)
        tick_work = tick_of(task, controller, settings)
        alternatives.append(Alternative(method, setting, tick_work, default=(method, setting) == default))
    return compare(alternatives, lambda alternative, _: trials[alternative.method, alternative.setting]())


def outcome(task: ControlTask, controller: Controller, settings: LoopSettings, *, seeds: int) -> Judged | str:
    """Run a controller at each mismatch and judge its runs; return a text if none succeeds at the small one.

    The error is that of completed runs. Other measures are the shares of completed runs at both mismatches, and the rms
    of the feedback at the small one, m/s².

    Args:
        task: reference, arms and judge.
        controller: law of the runs.
        settings: settings of the loop.
        seeds: runs at each mismatch.
    """
    assembly = Assembly(task.reference, task.arms, settings, law=controller)
    runs = assembly.batch([*range(seeds)] * 2, mismatches=[SMALL] * seeds + [LARGE] * seeds)
    small, large = runs[:seeds], runs[seeds:]
    completed = [run for run in small if task.judge(run)]
    if not completed:
        return f"none of {seeds} runs completed at {SMALL:.0%} mismatch"
    n = task.arms.count
    squares = [np.mean((run.truth[:, :n] - run.references[:, :n]) ** 2) for run in completed]
    measures = {
        "success": sum(task.judge(run) for run in large) / seeds,
        "success_small": len(completed) / seeds,
        "effort": float(np.sqrt(np.mean([run.rms_feedback**2 for run in small]))),
    }
    note = f"{measures['success']:.0%} complete, feedback {measures['effort']:.3f} m/s² rms"
    return Judged(float(np.sqrt(np.mean(squares))), measures, note)


def held(orbit_angles: Array, *, period: float, near: float = 0.1) -> Judge:
    """Return a judge of runs that must hold an orbit: a function of a run, which is True if the run succeeds.

    Angles of the last period must be within `near` of some phase of the orbit, modulo whole turns.

    Args:
        orbit_angles: angles (M, n) along the orbit, rad.
        period: period of the orbit, s.
        near: largest distance of an angle from the orbit that counts as held, rad.
    """

    def judge(run: BatchRun) -> bool:
        """Return True for a run that ended regularly and held the orbit in its last period.

        Every fourth tick is compared with all phases of the orbit.
        """
        if run.ending is not Ending.FINISHED:
            return False
        n = orbit_angles.shape[1]
        differences = run.truth[run.times > run.times[-1] - period, None, :n][::4] - orbit_angles
        distances = np.abs(differences - 2 * np.pi * np.rint(differences / (2 * np.pi))).max(2).min(1)
        return bool(distances.max() <= near)

    return judge


def held_orbit() -> SustainedOrbit:
    """Return the lab's sustained orbit about Down-Up at -0.07 J, which several charts hold."""
    lab = load_model("lab")
    return sustained_orbit(lyapunov_orbit(lab.system, "down-up", energy=-0.07), lab.arms)


def keeps(orbit: SustainedOrbit) -> Judge:
    """Return a judge of runs that must hold a sustained orbit, by the distance of their angles in the last period.

    Args:
        orbit: orbit to hold.
    """
    return held(orbit.state(np.linspace(0, orbit.period, 1000))[:, : orbit.arms.count], period=orbit.period)


def _completed(reference: Reference, run: BatchRun) -> bool:
    """Return True if a run has completed the plan of its reference."""
    motion = Flown.of(run, rate_hz=RATE, limits=reference.limits)
    return verdict_on(motion, reference).completed


def tick_of(task: ControlTask, controller: Controller, settings: LoopSettings) -> Callable[[], None]:
    """Return a function to time, which computes the next tick of the loop along the reference without a bench.

    Args:
        task: reference and arms.
        controller: law of the loop.
        settings: settings of the loop.
    """
    ticker = Assembly(task.reference, task.arms, settings, law=controller).ticker()
    position_indices, ticks = ticker.program.model.position_indices, cycle(range(ticker.count))

    def step() -> None:
        """Compute the next tick, for a reading on the reference, and begin again after the last one."""
        k = next(ticks)
        if not k:
            ticker.begin()
        # A constant state would let the clocks of stateful controllers lose it.
        state = ticker.references[k - 1] if k else controller.first_state
        ticker(k, Reading(0.0, state[position_indices]))

    return step


def _pair(task: ControlTask, diagram: Diagram, *, why: str) -> tuple[Diagram, Diagram]:
    """Return a task's two diagrams against a tick's time: the error, and the failures at the large mismatch.

    Args:
        task: the task.
        diagram: its controllers as points.
        why: reason for keeping a default off the front.
    """
    error = replace(
        diagram, title=f"{task.title}, error", x_label="time of a tick, filter and law, s", y_label=_ERROR, why=why
    )
    failures = tuple(replace(point, error=1 - point.others["success"]) for point in diagram.points)
    label = f"share that fails at {LARGE:.0%} mismatch"
    return error, replace(error, title=f"{task.title}, failures", y_label=label, points=failures, log_y=False)


def _tracking(seeds: int) -> tuple[Diagram, Diagram]:
    """Return the diagrams of laws that follow one turn of the outer arm, from `seeds` runs at each mismatch."""
    itinerary = load_itinerary("outer-turn")
    reference, arms = make_plan(itinerary).reference, itinerary.model.arms
    task = ControlTask("One turn", reference, arms, partial(_completed, reference))
    controllers: Controllers = {
        ("feedforward", ""): (lambda m: tracking_controller(reference, m, FeedforwardSettings()), _PLAIN),
        ("TVLQR", "time"): (lambda m: tracking_controller(reference, m, TvlqrSettings()), _PLAIN),
        ("TVLQR", "phase"): (lambda m: tracking_controller(reference, m, TvlqrSettings(schedule="phase")), _PLAIN),
        ("adaptive", ""): (
            lambda m: adaptive_controller(reference, m, AdaptiveSettings(), estimator=AUGMENTED), AUGMENTED,
        ),
    }  # fmt: skip
    why = "the filter's estimates of arms, drive and encoders leave little for feedback to do"
    return _pair(task, measured(task, controllers, seeds=seeds, default=("adaptive", "")), why=why)


def _orbit(sections: tuple[int, ...], seeds: int, seconds: float) -> tuple[Diagram, Diagram, Diagram]:
    """Return the diagrams of laws that hold an orbit: error, failures, and effort of pulses.

    Args:
        sections: numbers of pulses per period.
        seeds: runs at each mismatch.
        seconds: duration of a run, s.
    """
    orbit = held_orbit()
    task = ControlTask("An orbit", orbit.reference, orbit.arms, keeps(orbit))

    def pulses(k: int, kind: type) -> Callable[[SampledModel], Controller]:
        """Return the factory of an OGY law with k pulses per period; `kind` is the class of its settings."""
        return lambda m: ogy_controller(orbit, m, kind(sections=k), seconds=seconds)

    controllers: Controllers = {
        ("TVLQR", schedule): (
            lambda m, s=schedule: orbit_controller(orbit, m, TvlqrSettings(schedule=s), seconds=seconds), _PLAIN,
        )
        for schedule in ("time", "phase")
    }  # fmt: skip
    controllers |= {("OGY", f"k = {k}"): (pulses(k, OgySettings), _BARE) for k in sections}
    controllers |= {("OGY, classic", f"k = {k}"): (pulses(k, ClassicOgySettings), _BARE) for k in sections[-2:]}
    why = "a periodic gain at every tick continues the laws for references"
    error, failures = _pair(task, measured(task, controllers, seeds=seeds, default=("TVLQR", "time")), why=why)
    default_name = f"OGY, k = {OgySettings().sections}"
    effort_points = tuple(
        replace(point, seconds=max(point.others["effort"], 1e-9), default=point.name == default_name)
        for point in error.points
        if point.method.startswith("OGY")
    )
    why = "more sections detect an error earlier, and then need less effort"
    return error, failures, Diagram(
        "An orbit by pulses, effort", "rms of the feedback, m/s²", _ERROR, effort_points, why=why
    )  # fmt: skip


def _hold(weights: tuple[float, ...], seeds: int) -> Diagram:
    """Return the diagram of laws that hold both arms up: error against effort.

    Args:
        weights: weights of the effort, as multiples of the default.
        seeds: runs at each mismatch.
    """
    start = np.array([np.pi, np.pi, 0.0, 0.0])
    state = np.append(start, [0.0, 0.0])
    rest = still(state, 1.0, method=method_named("radau-5"), limits=Limits(), interval=0.1)
    task = ControlTask("Both arms up", rest, load_model("lab").arms, held(start[None, :2], period=1.0))
    plain = HoldSettings()
    controllers: Controllers = {
        ("LQR", f"effort × {w:g}"): (
            lambda m, w=w: hold_controller(start, m, replace(plain, effort=w * plain.effort), seconds=4.0), _PLAIN,
        )
        for w in weights
    }  # fmt: skip
    diagram = measured(task, controllers, seeds=seeds, default=("LQR", "effort × 1"))
    return replace(
        diagram, title="Both arms up, LQR", x_label="rms of the feedback, m/s²", y_label=_ERROR,
        points=tuple(replace(point, seconds=point.others["effort"]) for point in diagram.points),
        why="the same weights as TVLQR's, so that a hold passes into a motion without a jump",
    )  # fmt: skip


PERIOD = 1e-3
"""Period of the loop, s."""
SETTLED = 300
"""Ticks omitted at the start, which would judge the first guess and not the filter."""
CART_RESOLUTION = 1e-6
ZERO_ERROR = 3e-3
"""Reading accuracy of an arm's resting position, rad."""
CUTOFFS = (10.0, 30.0, 100.0, math.inf)
"""Cutoff frequencies of differentiated readings, Hz."""
AUGMENTS = ((), ("zeros",), EkfSettings().augment, AUGMENTED.augment)
_SWING = (0.4, 2.8, 2.0, -3.0, 0.0, 0.0)


def estimation_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return diagrams of the estimators' error against time.

    Args:
        quick: two resolutions, one second of one swing, and the UKF with and without zeros only.
        progress: called with a label and the completed share.
    """
    arms = load_model("lab").arms
    resolutions = (4000, 40_000) if quick else (512, 4000, 40_000, 400_000)
    seconds, seeds = (1.0, 1) if quick else (3.0, 3)
    swings = [swing(arms, seconds=seconds, seed=k, mismatch=SMALL, zero_error=ZERO_ERROR) for k in range(seeds)]
    panels = []
    for k, counts in enumerate(resolutions):
        progress(f"estimation, {counts} counts", k / len(resolutions))
        panels.append(_panel(arms, swings, counts, quick=quick))
    return ChartPage(
        name="estimation",
        title=f"Estimation, plant {SMALL:.0%} and zeros {ZERO_ERROR * 1e3:g} mrad off",
        parts=tuple(panels),
        reading=(
            "Each point: an estimator on the same swings. Across: a tick's time. Up: the rms scaled error of angles "
            "and rates. Each encoder has a panel.",
            f"Labels list the extras that are estimated too; all extras: {', '.join(AUGMENTS[-1])}. Differences need "
            "no model, and have no covariance to show their failures.",
            "The data hold the shares of NIS and NEES inside their 95 % bands: below 0.9 it is overconfident, "
            "near 1.0 too cautious. Filters with the same extras have the same settings.",
        ),
        chosen=(
            "The compiled EKF: the UKF takes longer and is no better here. Differences are less accurate at each "
            "resolution, and cannot estimate zeros."
        ),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class KnownSwing:
    """A simulated swing with known input and states, on which estimators are compared.

    Attributes:
        commands: accelerations (K,) of the cart, m/s².
        states: true states (K, N).
        joints: relative angles with the encoders' zeros, rad, and the cart's position, m (K, n+1).
    """

    commands: Array
    states: Array
    joints: Array

    def measured(self, counts: int) -> Array:
        """Return the readings (K, n+1) of encoders at a resolution: absolute angles and the cart's position.

        Args:
            counts: encoder counts per turn.
        """
        n = self.joints.shape[1] - 1
        steps = np.array([2 * np.pi / counts] * n + [CART_RESOLUTION])
        rounded = np.rint(self.joints / steps) * steps
        return np.column_stack([np.cumsum(rounded[:, :n], axis=1), rounded[:, n]])


def swing(arms: ArmChainParameters, *, seconds: float, seed: int, mismatch: float, zero_error: float) -> KnownSwing:
    """Return a swing of a drawn plant from `_SWING`, while the cart is driven by a sine of 0.5 m/s².

    Args:
        arms: arms of the model.
        seconds: duration of the swing, s.
        seed: seed of the plant, its first angles and the zeros.
        mismatch: relative error of the plant's parameters.
        zero_error: largest error of the encoder zeros, rad.
    """
    generator = np.random.default_rng(seed)
    plant = arms.mismatched(mismatch, generator)
    model = SampledModel(equations_of(plant, Level.CART), plant.base(), period=PERIOD)
    n, count = arms.count, round(seconds / PERIOD)
    commands = 0.5 * np.sin(2.5 * PERIOD * np.arange(count))
    state = np.array(_SWING)
    state[:n] += INITIAL_ERROR * generator.uniform(-1, 1, n)
    states = np.empty((count, len(state)))
    for k, command in enumerate(commands.tolist()):
        state = model.step(state, command) if k else state
        states[k] = state
    zeros = zero_error * generator.uniform(-1, 1, n)
    relative = np.diff(states[:, :n], axis=1, prepend=0.0) + zeros
    return KnownSwing(commands, states, np.column_stack([relative, states[:, 2 * n]]))


def _panel(arms: ArmChainParameters, swings: list[KnownSwing], counts: int, *, quick: bool) -> Diagram:
    """Return the diagram of all estimators at one resolution of the encoders: error against the time of a tick.

    Args:
        arms: arms of the model.
        swings: swings with known states.
        counts: encoder counts per turn.
        quick: fewer settings of the UKF.
    """
    model = sampled_model(arms, 1 / PERIOD)
    trials, alternatives, readings = {}, [], swings[0].measured(counts)
    for name, kind in (("EKF, compiled", "ekf"), ("UKF, filterpy", "ukf")):
        for augment in AUGMENTS[:2] if quick and kind == "ukf" else AUGMENTS:
            # Every method has the settings of the law that requires these extras.
            changes = ADAPTIVE if augment == AUGMENTS[3] else {"augment": augment}
            estimator = make_estimator(ESTIMATORS[kind](**changes), model, noise=noise_of(arms, counts))
            first_estimate = estimator.update(estimator.first(np.array(_SWING)), readings[0])
            label = "all extras" if augment == AUGMENTS[3] else "+".join(augment) or "state only"
            work = partial(estimator.step, first_estimate, 0.1, readings[1])
            alternatives.append(Alternative(name, label, work, default=kind == "ekf" and augment in AUGMENTS[2:]))
            trials[name, label] = partial(estimator_trial, estimator, swings, counts=counts)
    joints, rates = readings[:, : arms.count], swings[0].states[0, arms.count : 2 * arms.count]
    for cutoff in CUTOFFS:
        label = f"{cutoff:g} Hz" if cutoff < math.inf else "no low pass"
        alternatives.append(
            Alternative("differences", label, partial(differences, rates, joints[0], joints[1], cutoff))
        )
        trials["differences", label] = partial(derivative_trial, cutoff, swings, counts=counts)
    return replace(
        compare(alternatives, lambda alternative, _: trials[alternative.method, alternative.setting]()),
        title=f"{counts} counts per turn", x_label="time of a tick, s", y_label="rms error of the arms' state (scaled)",
        why="feedback on the state alone fails on zeros of a few milliradians, and estimating them costs less than "
        "twice the time; parameters are estimated if a controller requires them",
    )  # fmt: skip


def estimator_trial(estimator: Estimator, swings: list[KnownSwing], *, counts: int) -> Judged:
    """Return an estimator's error over the swings, and its shares of NIS and NEES inside their 95 % bands.

    The error is the rms of the arms' scaled angles and rates, without the first `SETTLED` ticks. NEES is the squared
    error of states and encoder zeros, normalised by the covariance; every 20th tick counts for it.

    Args:
        estimator: filter, which starts at each swing's first measurement.
        swings: swings with known states.
        counts: encoder counts per turn.
    """
    errors, nis, nees_values = [], [], []
    sensors = swings[0].joints.shape[1]
    n = sensors - 1
    zeros = [k for k, name in enumerate(estimator.extra_names) if name.startswith("zero_")]
    for known_swing in swings:
        readings = known_swing.measured(counts)
        # True zero errors of the absolute angles, which add up those of the encoders between successive arms.
        bias = np.cumsum(known_swing.joints[0, :n] - np.diff(known_swing.states[0, :n], prepend=0.0))
        estimate = estimator.update(estimator.first(np.array(_SWING)), readings[0])
        for k in range(1, len(known_swing.commands)):
            # A command acts over the period that ends with the reading.
            estimate = estimator.step(estimate, float(known_swing.commands[k]), readings[k])
            if k < SETTLED:
                continue
            errors.append(_scaled(estimate.state - known_swing.states[k], n))
            nis.append(estimate.nis)
            if k % 20 == 0:
                nees_values.append(_nees(estimator, estimate, known_swing.states[k], bias, zeros))
    nis_share = share_inside(np.array(nis), sensors)
    nees_share = share_inside(np.array(nees_values), swings[0].states.shape[1] + len(zeros))
    note = f"NIS {nis_share:.0%}, NEES {nees_share:.0%} inside"
    return Judged(_rms(errors), {"nis_inside_95": nis_share, "nees_inside_95": nees_share}, note)


def _nees(estimator: Estimator, estimate: Estimate, truth: Array, bias: Array, zeros: list[int]) -> float:
    """Return the squared error of an estimate of states and encoder zeros, normalised by the estimator's covariance.

    Args:
        estimator: filter, which gives the covariance.
        estimate: its estimate of states and extras.
        truth: true state (N,).
        bias: true zero errors (n,) of absolute angles, rad.
        zeros: indices of the zeros among the estimator's extras.
    """
    n = len(truth)
    rows = [*range(n), *(n + k for k in zeros)]
    error = np.concatenate([truth - estimate.state, bias[: len(zeros)] - estimate.extra[zeros]])
    return float(nees(error, estimator.covariance(estimate)[np.ix_(rows, rows)]))


def differences(rates: Array, last: Array, measured: Array, cutoff: float) -> Array:
    """Return rates (m,) from two measurements of position, as an estimator without a model computes them.

        v_k = a v_{k-1} + (1 - a) (z_k - z_{k-1}) / T,      a = e^{-2π f T}

    T is the period `PERIOD`, s. A difference is half a period old and has the noise q/T of one count q; the low pass
    trades noise against a lag of 1/(2πf). Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd
    ed., section 6.1.

    Args:
        rates: rates v (m,) that this function returned one period earlier.
        last: positions z (m,) measured one period earlier.
        measured: positions z (m,) measured now.
        cutoff: f of the first-order low pass, Hz, infinite for none.
    """
    weight = math.exp(-2 * math.pi * cutoff * PERIOD)
    return weight * rates + (1 - weight) * (measured - last) / PERIOD


def derivative_trial(cutoff: float, swings: list[KnownSwing], *, counts: int) -> Judged:
    """Return the error of measured positions and rates by `differences`, which give no covariance.

    Args:
        cutoff: cutoff of `differences`, Hz.
        swings: swings with known states.
        counts: encoder counts per turn.
    """
    errors = []
    for known_swing in swings:
        readings = known_swing.measured(counts)
        n = readings.shape[1] - 1
        rates = known_swing.states[0, n : 2 * n]
        for k in range(1, len(readings)):
            rates = differences(rates, readings[k - 1, :n], readings[k, :n], cutoff)
            if k >= SETTLED:
                state = np.concatenate([readings[k, :n], rates])
                errors.append(_scaled(state - known_swing.states[k, : 2 * n], n))
    return Judged(_rms(errors), note="no covariance")


def _rms(errors: list[Array]) -> float:
    """Return the root mean square of scaled errors, in six digits."""
    # Two programs for the same equations differ by rounding, which must not decide the front.
    return float(f"{np.sqrt(np.mean(np.square(errors))):.6g}")


def _scaled(away: Array, n: int) -> Array:
    """Return the errors (2n,) of the arms' angles and rates, in units of `ANGLE_SCALE` rad and `RATE_SCALE` rad/s.

    `away` are the errors of a state, of which those of a cart are left out.
    """
    return np.concatenate([away[:n] / ANGLE_SCALE, away[n : 2 * n] / RATE_SCALE])


def noise_of(arms: ArmChainParameters, counts: int) -> Array:
    """Return the covariance (n+1, n+1) of the positions that encoders of a resolution measure, as filters assume it.

    Args:
        arms: n arms.
        counts: encoder counts per turn.
    """
    return SensorSettings(counts=counts, cart_resolution=CART_RESOLUTION).covariance(arms.count)
