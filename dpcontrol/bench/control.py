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
SMALL, LARGE = 0.02, 0.10
"""Mismatch: of the shipped itineraries, and of the success campaigns."""
INITIAL_ERROR = 0.02
"""rad."""
AUGMENTED = EkfSettings(**ADAPTIVE)
_PLAIN = EkfSettings()
_BARE = EkfSettings(augment=())
"""Settings for pulses; the first pulses come before the filter's estimates."""
_ERROR = "rms error of the angles, rad"
Controllers = Mapping[tuple[str, str], tuple[Callable[[SampledModel], Controller], EkfSettings]]
"""Controllers by method and setting, each with its filter."""
Judge = Callable[[BatchRun], bool]


@dataclass(frozen=True)
class ControlTask:
    """A reference, its arms, and the judge of each controller's run."""

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
    tracking = _tracking(seeds)
    progress("control, an orbit", 0.3)
    orbit = _orbit((4, 16), seeds, 4.0) if quick else _orbit((1, 2, 3, 4, 8, 16, 32), 10, 10.0)
    weights = (0.1, 1.0, 10.0) if quick else (0.1, 1.0, 10.0, 100.0)
    return ChartPage(
        name="control",
        title=f"Control, arms {SMALL:.0%} and {LARGE:.0%} off",
        parts=(*tracking, *orbit, _hold(weights, seeds)),
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
    """Return error against the seconds of a tick, for successful controllers; the others have reasons.

    Args:
        task: reference, arms and judge.
        controllers: controllers by method and setting.
        seeds: runs at each mismatch.
        default: method and setting of the default.
    """
    tried, runs = [], {}
    for (method, setting), (make, estimator) in controllers.items():
        settings = LoopSettings(seed=0, rate=RATE, estimator=estimator, initial_error=INITIAL_ERROR)
        controller = make(sampled_model(task.arms, RATE))
        runs[method, setting] = partial(outcome, task, controller, settings, seeds=seeds)
        tick = tick_of(task, controller, settings)
        tried.append(Alternative(method, setting, tick, default=(method, setting) == default))
    return compare(tried, lambda alternative, _: runs[alternative.method, alternative.setting]())


def outcome(task: ControlTask, controller: Controller, settings: LoopSettings, *, seeds: int) -> Judged | str:
    """Return the results of runs at each mismatch.

    If none succeeded at the small one, return a note. The error is that of completed runs. Others: shares of completed
    runs at both, rms of the feedback in m/s² at the small one.

    Args:
        task: reference, arms and judge.
        controller: law of the runs.
        settings: settings of the loop.
        seeds: runs at each mismatch.
    """
    assembly = Assembly(task.reference, task.arms, settings, law=controller)
    runs = assembly.batch([*range(seeds)] * 2, mismatches=[SMALL] * seeds + [LARGE] * seeds)
    small, large = runs[:seeds], runs[seeds:]
    good = [run for run in small if task.judge(run)]
    if not good:
        return f"none of {seeds} runs completed at {SMALL:.0%} mismatch"
    n = task.arms.count
    squares = [np.mean((run.truth[:, :n] - run.references[:, :n]) ** 2) for run in good]
    measures = {
        "success": sum(task.judge(run) for run in large) / seeds,
        "success_small": len(good) / seeds,
        "effort": float(np.sqrt(np.mean([run.rms_feedback**2 for run in small]))),
    }
    note = f"{measures['success']:.0%} complete, feedback {measures['effort']:.3f} m/s² rms"
    return Judged(float(np.sqrt(np.mean(squares))), measures, note)


def held(orbit_angles: Array, *, period: float, near: float = 0.1) -> Judge:
    """Return a judge of runs that must hold an orbit to their end.

    The last period is judged, by the least distance over phases and turns.

    Args:
        orbit_angles: angles (M, n) along the orbit, rad.
        period: period of the orbit, s.
        near: largest distance of the angles, rad.
    """

    def judge(run: BatchRun) -> bool:
        if run.ending is not Ending.FINISHED:
            return False
        n = orbit_angles.shape[1]
        last = run.truth[run.times > run.times[-1] - period, None, :n][::4] - orbit_angles
        away = np.abs(last - 2 * np.pi * np.rint(last / (2 * np.pi))).max(2).min(1)
        return bool(away.max() <= near)

    return judge


def held_orbit() -> SustainedOrbit:
    """Return the lab's sustained orbit about down-up, at -0.07 J."""
    lab = load_model("lab")
    return sustained_orbit(lyapunov_orbit(lab.system, "down-up", energy=-0.07), lab.arms)


def keeps(orbit: SustainedOrbit) -> Judge:
    """Return a judge of runs that hold a sustained orbit, as `held` does, near its angles.

    Args:
        orbit: orbit to hold.
    """
    return held(orbit.state(np.linspace(0, orbit.period, 1000))[:, : orbit.arms.count], period=orbit.period)


def _completed(reference: Reference, run: BatchRun) -> bool:
    flown = Flown.of(run, rate_hz=RATE, limits=reference.limits)
    return verdict_on(flown, reference).completed


def tick_of(task: ControlTask, controller: Controller, settings: LoopSettings) -> Callable[[], None]:
    """Return a function to time that runs a tick of the loop along the path, without its bench.

    Args:
        task: reference and arms.
        controller: law of the loop.
        settings: settings of the loop.
    """
    ticker = Assembly(task.reference, task.arms, settings, law=controller).ticker()
    where, ticks = ticker.program.model.position_indices, cycle(range(ticker.count))

    def step() -> None:
        k = next(ticks)
        if not k:
            ticker.begin()
        # A constant state would let the clocks of stateful controllers lose it.
        state = ticker.references[k - 1] if k else controller.first_state
        ticker(k, Reading(0.0, state[where]))

    return step


def _pair(task: ControlTask, diagram: Diagram, *, why: str) -> tuple[Diagram, Diagram]:
    """Return the task's two panels against a tick's time: the error, and failures at the large mismatch."""
    error = replace(
        diagram, title=f"{task.title}, error", x_label="time of a tick, filter and law, s", y_label=_ERROR, why=why
    )
    failed = tuple(replace(p, error=1 - p.others["success"]) for p in diagram.points)
    share = f"share that fails at {LARGE:.0%} mismatch"
    return error, replace(error, title=f"{task.title}, failures", y_label=share, points=failed, log_y=False)


def _tracking(seeds: int) -> tuple[Diagram, Diagram]:
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
    orbit = held_orbit()
    task = ControlTask("An orbit", orbit.reference, orbit.arms, keeps(orbit))

    def pulses(k: int, kind: type) -> Callable[[SampledModel], Controller]:
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
    shipped = f"OGY, k = {OgySettings().sections}"
    spending = tuple(
        replace(p, seconds=max(p.others["effort"], 1e-9), default=p.name == shipped)
        for p in error.points
        if p.method.startswith("OGY")
    )
    why = "more sections detect an error earlier, and then need less effort"
    return error, failures, Diagram(
        "An orbit by pulses, effort", "rms of the feedback, m/s²", _ERROR, spending, why=why
    )  # fmt: skip


def _hold(weights: tuple[float, ...], seeds: int) -> Diagram:
    """Return the panel of both arms held up.

    `weights` are multiples of the default effort weight.
    """
    start = np.array([np.pi, np.pi, 0.0, 0.0])
    state = np.append(start, [0.0, 0.0])
    place = still(state, 1.0, method=method_named("radau-5"), limits=Limits(), interval=0.1)
    task = ControlTask("Both arms up", place, load_model("lab").arms, held(start[None, :2], period=1.0))
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
        points=tuple(replace(p, seconds=p.others["effort"]) for p in diagram.points),
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
"""Hz."""
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
    """A swing with known input and states.

    It has commands (K,) m/s², true states (K, N), and relative angles with zeros and the cart (K, n+1).
    """

    commands: Array
    states: Array
    joints: Array

    def measured(self, counts: int) -> Array:
        """Return absolute angles and the cart's position (K, n+1).

        Args:
            counts: encoder counts per turn.
        """
        n = self.joints.shape[1] - 1
        steps = np.array([2 * np.pi / counts] * n + [CART_RESOLUTION])
        read = np.rint(self.joints / steps) * steps
        return np.column_stack([np.cumsum(read[:, :n], axis=1), read[:, n]])


def swing(arms: ArmChainParameters, *, seconds: float, seed: int, mismatch: float, zero_error: float) -> KnownSwing:
    """Return a free-hand swing under a sine of 0.5 m/s².

    Args:
        arms: arms of the model.
        seconds: duration, s.
        seed: seed of the plant and the zeros.
        mismatch: relative error of the plant's parameters.
        zero_error: largest error of the encoder zeros, rad.
    """
    random = np.random.default_rng(seed)
    plant = arms.mismatched(mismatch, random)
    model = SampledModel(equations_of(plant, Level.CART), plant.base(), period=PERIOD)
    n, count = arms.count, round(seconds / PERIOD)
    commands = 0.5 * np.sin(2.5 * PERIOD * np.arange(count))
    x = np.array(_SWING)
    x[:n] += INITIAL_ERROR * random.uniform(-1, 1, n)
    states = np.empty((count, len(x)))
    for k, command in enumerate(commands.tolist()):
        x = model.step(x, command) if k else x
        states[k] = x
    zeros = zero_error * random.uniform(-1, 1, n)
    relative = np.diff(states[:, :n], axis=1, prepend=0.0) + zeros
    return KnownSwing(commands, states, np.column_stack([relative, states[:, 2 * n]]))


def _panel(arms: ArmChainParameters, swings: list[KnownSwing], counts: int, *, quick: bool) -> Diagram:
    model = sampled_model(arms, 1 / PERIOD)
    trials, tried, measured = {}, [], swings[0].measured(counts)
    for name, kind in (("EKF, compiled", "ekf"), ("UKF, filterpy", "ukf")):
        for augment in AUGMENTS[:2] if quick and kind == "ukf" else AUGMENTS:
            # Every method has the settings of the law that requires these extras.
            changes = ADAPTIVE if augment == AUGMENTS[3] else {"augment": augment}
            estimator = make_estimator(ESTIMATORS[kind](**changes), model, noise=noise_of(arms, counts))
            last = estimator.update(estimator.first(np.array(_SWING)), measured[0])
            label = "all extras" if augment == AUGMENTS[3] else "+".join(augment) or "state only"
            work = partial(estimator.step, last, 0.1, measured[1])
            tried.append(Alternative(name, label, work, default=kind == "ekf" and augment in AUGMENTS[2:]))
            trials[name, label] = partial(estimator_trial, estimator, swings, counts=counts)
    joints, rates = measured[:, : arms.count], swings[0].states[0, arms.count : 2 * arms.count]
    for cutoff in CUTOFFS:
        label = f"{cutoff:g} Hz" if cutoff < math.inf else "no low pass"
        tried.append(Alternative("differences", label, partial(differences, rates, joints[0], joints[1], cutoff)))
        trials["differences", label] = partial(derivative_trial, cutoff, swings, counts=counts)
    return replace(
        compare(tried, lambda alternative, _: trials[alternative.method, alternative.setting]()),
        title=f"{counts} counts per turn", x_label="time of a tick, s", y_label="rms error of the arms' state (scaled)",
        why="feedback on the state alone fails on zeros of a few milliradians, and estimating them costs less than "
        "twice the time; parameters are estimated if a controller requires them",
    )  # fmt: skip


def estimator_trial(estimator: Estimator, swings: list[KnownSwing], *, counts: int) -> Judged:
    """Return an estimator's error over the swings, and its shares of NIS and NEES inside their 95 % bands.

    Args:
        estimator: filter, which starts at each swing's first measurement.
        swings: swings with known states.
        counts: encoder counts per turn.
    """
    errors, nis, normalised = [], [], []
    m = swings[0].joints.shape[1]
    n = m - 1
    zeros = [k for k, name in enumerate(estimator.extra_names) if name.startswith("zero_")]
    for flown in swings:
        measured = flown.measured(counts)
        bias = np.cumsum(flown.joints[0, :n] - np.diff(flown.states[0, :n], prepend=0.0))
        estimate = estimator.update(estimator.first(np.array(_SWING)), measured[0])
        for k in range(1, len(flown.commands)):
            # A command acts over the period that ends with the reading.
            estimate = estimator.step(estimate, float(flown.commands[k]), measured[k])
            if k < SETTLED:
                continue
            errors.append(_scaled(estimate.state - flown.states[k], n))
            nis.append(estimate.nis)
            if k % 20 == 0:
                normalised.append(_nees(estimator, estimate, flown.states[k], bias, zeros))
    inside = share_inside(np.array(nis), m)
    of_state = share_inside(np.array(normalised), swings[0].states.shape[1] + len(zeros))
    note = f"NIS {inside:.0%}, NEES {of_state:.0%} inside"
    return Judged(_rms(errors), {"nis_inside_95": inside, "nees_inside_95": of_state}, note)


def _nees(estimator: Estimator, estimate: Estimate, truth: Array, bias: Array, zeros: list[int]) -> float:
    n = len(truth)
    which = [*range(n), *(n + k for k in zeros)]
    error = np.concatenate([truth - estimate.state, bias[: len(zeros)] - estimate.extra[zeros]])
    return float(nees(error, estimator.covariance(estimate)[np.ix_(which, which)]))


def differences(rates: Array, last: Array, measured: Array, cutoff: float) -> Array:
    """Return rates (m,) from two measurements of position.

        v_k = a v_{k-1} + (1 - a) (z_k - z_{k-1}) / T,      a = e^{-2π f T}

    A difference is half a period old and has the noise q/T of one count q; the low pass trades noise against a lag of
    1/(2πf). Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., section 6.1.

    Args:
        rates: last rates (m,).
        last: measurement (m,) of the last period.
        measured: measurement (m,).
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
    for flown in swings:
        measured = flown.measured(counts)
        n = measured.shape[1] - 1
        rates = flown.states[0, n : 2 * n]
        for k in range(1, len(measured)):
            rates = differences(rates, measured[k - 1, :n], measured[k, :n], cutoff)
            if k >= SETTLED:
                state = np.concatenate([measured[k, :n], rates])
                errors.append(_scaled(state - flown.states[k, : 2 * n], n))
    return Judged(_rms(errors), note="no covariance")


def _rms(errors: list[Array]) -> float:
    # Two programs for the same equations differ by rounding, which must not decide the front.
    return float(f"{np.sqrt(np.mean(np.square(errors))):.6g}")


def _scaled(away: Array, n: int) -> Array:
    return np.concatenate([away[:n] / ANGLE_SCALE, away[n : 2 * n] / RATE_SCALE])


def noise_of(arms: ArmChainParameters, counts: int) -> Array:
    """Return the estimators' noise covariance (n+1, n+1).

    Args:
        arms: n arms.
        counts: encoder counts per turn.
    """
    return SensorSettings(counts=counts, cart_resolution=CART_RESOLUTION).covariance(arms.count)
