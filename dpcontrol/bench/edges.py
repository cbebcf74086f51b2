"""Maps of failure: each method's limit beside a prediction by a formula of a few lines.

*Moving references.* A known delay is predicted through, and the prediction runs on the model. The borders of the delay
and of the plant's mismatch are only measured.

*Estimation.* Of K ticks each is lost with probability p. Gaps of at least m ticks, the supervisor's limit, begin
K (1 - p) pᵐ times on average, nearly independently. Half of the runs have none at K (1 - p) pᵐ = ln 2.
Source: Feller, An Introduction to Probability Theory and Its Applications I, 3rd ed., section XIII.7, for runs.

*Margins.* The loop's margins, beside campaigns with a drive that differs from the model.

OGY by its sections is only measured. For random outcomes the border is at half the successes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from dpcontrol.bench.chart import Attempt, Border, ChartPage, EdgeMap, find_border, half_of, measured_maps
from dpcontrol.bench.control import RATE, held_orbit, keeps
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import sampled_model
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.control.margins import SHAKEN
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.control.periodic import OrbitController, orbit_controller
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun, Ending
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import still
from dpcontrol.references.sustained import SustainedOrbit

MOVING_ERROR = 0.02
"""Initial error when the delay is varied, rad."""
WEAK, STRONG = 5.0, 30.0
"""Acceleration limit, m/s², when the delay or the model is varied."""
ASTRAY = 0.3
"""Largest distance from the reference over the last tenth of a successful run, rad."""


@dataclass(frozen=True, eq=False)
class LoopCase:
    """A controller in a loop of one rate, whose border is sought by trials.

    A trial succeeds if at least half of its runs end near the reference over their last tenth.

    Attributes:
        assembly: parts of the loop.
        seeds: number of runs in a trial.
        near: largest distance of the angles over the last tenth, rad.
        margins: margins of the loop by name, from which borders are predicted.
    """

    assembly: Assembly
    seeds: int = 1
    near: float = ASTRAY
    margins: Mapping[str, float] = field(default_factory=dict)

    def run(self, *, acceleration: float, mismatch: float = 0.0, error: float = 1e-3, delay: float = 0.0) -> Attempt:
        """Return the outcome of a trial on the simulated bench with a known delay of the drive.

        Args:
            acceleration: limit of the cart, m/s².
            mismatch: relative error of the plant's parameters.
            error: largest initial error of an angle, rad.
            delay: delay of the drive, which the loop knows, s.
        """
        # A timing error of half a period is a further error, with a high cost in a slow loop.
        drive = DriveSettings(delay=round(delay * self.assembly.settings.rate))
        settings = replace(self.assembly.settings, mismatch=mismatch, initial_error=error, drive=drive)
        # A long track, so that authority alone decides.
        limits = Limits(position=20.0, velocity=20.0, acceleration=acceleration)
        reference = replace(self.assembly.reference, limits=limits)
        return self._tried(replace(self.assembly, reference=reference, settings=settings))

    def driven(self, *, gain: float = 1.0, delay: float = 0.0, lag: float = 0.0) -> Attempt:
        """Return the outcome of a trial whose drive deviates from the model, without the loop's knowledge.

        A feedback, rms, above the share `SHAKEN` of the acceleration limit over the gain counts as a failure too.

        Args:
            gain: gain of the drive, its acceleration over the command.
            delay: delay in addition to the one that the loop knows, s.
            lag: time constant of the drive, s.
        """
        assumed_delay, rate = self.assembly.delay, self.assembly.settings.rate
        drive = replace(self.assembly.settings.drive, response=gain, lag=lag, delay=assumed_delay + delay * rate)
        deviating = self.assembly.under(replace(self.assembly.settings, drive=drive))
        return self._tried(
            replace(deviating, believed_delay=assumed_delay), SHAKEN * self.assembly.limits.acceleration / gain
        )

    def _tried(self, assembly: Assembly, most: float = math.inf) -> Attempt:
        """Run all seeds of an assembly, and return success if at least half of the runs end near their reference.

        Feedback above `most` m/s² rms counts as a failure, because such a command swings.
        """
        failures = [failure_of(run, near=self.near, most=most) for run in assembly.batch(range(self.seeds))]
        return half_of([Attempt(not failure, failure) for failure in failures], "runs lost")


def failure_of(run: BatchRun, *, near: float = ASTRAY, most: float = math.inf) -> str:
    """Return the cause by which a run failed to end near its reference, or "" for a success.

    Args:
        run: run along a reference.
        near: distance of an angle from the reference, over the last tenth of the run, from which on it fails, rad.
        most: largest rms feedback of a success, m/s².
    """
    if run.ending is not Ending.FINISHED:
        return run.reason
    if run.rms_feedback > most:
        return f"finished, but the command swings: feedback of {run.rms_feedback:.2g} m/s² rms"
    tail, n = max(len(run.times) // 10, 1), run.references.shape[1]
    distance = float(np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max())
    return "" if distance < near else f"finished, but {distance:.2g} rad away over its last tenth"


@cache
def moving(rate: float) -> LoopCase:
    """Return the loop that follows the planned turn of the outer arm by TVLQR.

    Args:
        rate: rate of the loop, Hz.
    """
    itinerary = load_itinerary("outer-turn")
    reference, arms = make_plan(itinerary).reference, itinerary.model.arms
    controller = tracking_controller(reference, sampled_model(arms, rate), TvlqrSettings())
    return LoopCase(Assembly(reference, arms, LoopSettings(seed=0, rate=rate), law=controller))


def moving_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return the chart of a moving reference.

    Args:
        quick: one rate, one delay.
        progress: called with a label and the completed share.
    """
    delay_map = EdgeMap("Known delay, by rate", "rate of the loop, Hz", "delay, s", far="lost")
    mismatch_map = EdgeMap("Wrong model, by delay", "delay, s", "mismatch of the plant, share", far="lost")
    parts = measured_maps(
        progress,
        (
            delay_map,
            lambda rate: find_border(
                lambda delay: moving(rate).run(acceleration=WEAK, error=MOVING_ERROR, delay=delay),
                x=rate, line=f"{rate:g} Hz", near=0.05, far=0.6, ratio=1.08, unit=1 / rate,
            ),
            (100.0,) if quick else (25.0, 50.0, 100.0, 200.0),
        ),
        (
            mismatch_map,
            # All parameters are changed in one direction.
            lambda delay: find_border(
                lambda mismatch: moving(100.0).run(acceleration=STRONG, mismatch=mismatch, delay=delay),
                x=delay, line=f"{1e3 * delay:g} ms", near=0.01, far=0.6,
            ),
            (0.1,) if quick else (0.04, 0.07, 0.1, 0.14),
        ),
    )  # fmt: skip
    return ChartPage(
        name="edges-moving",
        title=f"A turn of the outer arm by TVLQR is {parts[0].finding()} of delay",
        reading=(
            f"Left: largest known delay of commands of at most {WEAK:g} m/s² after an error of up to "
            f"{MOVING_ERROR:g} rad at the start.",
            "Right: largest mismatch of the plant, for the prediction through the delay runs on the model.",
            "Circles end near the reference, crosses end with the sentence in the data.",
        ),
        chosen="Prediction through all commands in flight, from the first on; delays of the bench are 1 to 20 ms.",
        parts=parts,
    )


LIMIT = 0.5
"""Size of the pulses, m/s², when counts are varied."""
COUNTS = 40_000.0
"""Counts per turn when the pulses are varied."""


def pulses(orbit: SustainedOrbit, sections: int, *, seconds: float) -> OgyController:
    """Return the law, without learning, that holds an orbit by pulses of at most LIMIT m/s².

    Args:
        orbit: sustained orbit.
        sections: pulses per period.
        seconds: duration, s.
    """
    settings = OgySettings(sections=sections, pulse_limit=LIMIT, parameter_error=0.0)
    return ogy_controller(orbit, sampled_model(load_model("lab").arms, RATE), settings, seconds=seconds)


def ogy_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return maps of the pulses and counts that OGY needs.

    Args:
        quick: fewer sections and seeds, wider borders, and shorter runs.
        progress: called with a label and the completed share.
    """
    orbit = held_orbit()
    sections, seeds, ratio, seconds = ((8,), 8, 1.6, 4.0) if quick else ((1, 2, 3, 4, 8, 16), 16, 1.12, 6.0)
    trial_options: dict[str, Any] = {"seeds": seeds, "ratio": ratio}
    pulse_map, count_map = (
        EdgeMap(title, "sections in a period, k", y, far="lost", default=default)
        for title, y, default in (
            (f"Pulses with {COUNTS:,.0f} counts per turn", "largest pulse, m/s²", (16.0, 5.0)),
            (f"Encoders with pulses of {LIMIT:g} m/s²", "counts per turn", None),
        )
    )
    return ChartPage(
        name="edges-ogy",
        title="OGY needs three pulses a period; with sixteen, small ones suffice",
        reading=(
            f"The orbit about Down-Up at {orbit.energy:g} J has the multiplier λ = {orbit.multipliers[0].real:.0f}. "
            "From one of k sections to the next an error grows by about λ^(1/k).",
            f"Circles: at least half of {seeds} runs hold; crosses: fewer. Zeros of the encoders lie anywhere within a "
            "count.",
            "Rounding of readings depends on the orbit, and more counts can be worse: no formula predicts "
            "these borders.",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would suffice.",
        parts=measured_maps(
            progress,
            (
                pulse_map,
                lambda k: pulse_border(orbit, pulses(orbit, k, seconds=seconds), counted=False, **trial_options),
                sections,
            ),
            (
                count_map,
                lambda k: pulse_border(orbit, pulses(orbit, k, seconds=seconds), counted=True, **trial_options),
                sections,
            ),
        ),
    )


def holds(orbit: SustainedOrbit, controller: OgyController, *, counts: float, seeds: int) -> Attempt:
    """Run a law of pulses on benches with encoders of some resolution; at least half of the runs must hold the orbit.

    The zeros of the encoders lie anywhere within a count.

    Args:
        orbit: sustained orbit.
        controller: law of the runs.
        counts: encoder counts per turn.
        seeds: number of runs.
    """
    whole_counts = max(round(counts), 1)
    sensors = SensorSettings(counts=whole_counts, cart_resolution=1e-6, zero_error=np.pi / whole_counts)
    # Estimated zeros would need a third larger pulses at k = 16.
    settings = LoopSettings(
        seed=0, rate=RATE, sensors=sensors, estimator=EkfSettings(augment=()), initial_error=1e-5
    )  # fmt: skip
    wide_reference = replace(orbit.reference, limits=Limits(position=5.0, acceleration=30.0))
    runs = Assembly(wide_reference, orbit.arms, settings, law=controller).batch(range(seeds))
    judge = keeps(orbit)
    departure = "finished, but away from the orbit in its last period"
    return half_of(
        [Attempt(judge(run), departure if run.ending is Ending.FINISHED else run.reason) for run in runs], "runs lost"
    )


def pulse_border(orbit: SustainedOrbit, law: OgyController, *, counted: bool, seeds: int, ratio: float) -> Border:
    """Return the border of the pulses' limit, m/s², or of the counts per turn, that a law needs to hold an orbit.

    Args:
        orbit: sustained orbit.
        law: law of the runs.
        counted: True for counts per turn, False for the limit of pulses.
        seeds: number of runs.
        ratio: precision of the border, as a ratio.
    """
    k, (near, far) = len(law.times), (4e8, 50.0) if counted else (5.0, 0.01)

    def probe(value: float) -> Attempt:
        """Return the outcome of a trial at one limit of pulses, m/s², or, if `counted`, at counts per turn."""
        law_with_limit = law if counted else replace(law, pulse_limit=value)
        return holds(orbit, law_with_limit, counts=value if counted else COUNTS, seeds=seeds)

    return find_border(probe, x=k, line=f"k = {k}", near=near, far=far, ratio=ratio)


SECONDS = 10.0
"""Duration of stays, and of runs that lose samples, s."""
MOVED, STILL = 0.02, 0.015
"""Least angle in rad and time in s that distinguish a stuck joint from a still one."""


def estimation_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return the borders of estimation: lost samples and a stuck encoder.

    Args:
        quick: one rate, one phase, fewer seeds.
        progress: called with a label and the completed share.
    """
    model = load_model("lab")
    orbit = held_orbit()
    dropout_map = EdgeMap(
        "Lost samples", "rate of the loop, Hz", "samples that arrive, per s", far="lost",
        theory="a gap of 0.1 s is as likely as not in 10 s",
    )  # fmt: skip
    stuck_map = EdgeMap(
        "A stuck encoder of the outer arm, on the orbit about Down-Up", "phase at which it sticks",
        "time until it is reported, s", far="reported", near="goes on",
    )  # fmt: skip
    return ChartPage(
        name="edges-estimation",
        title="Limits of estimation",
        reading=(
            "Left: the filter flies through gaps on its model; the supervisor ends the run after 0.1 s without any.",
            "Right: a stuck encoder is recognised by the motion expected of the arm.",
            "Circles run to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="0.1 s without a sample: an error at Down-Up grows 2.2-fold in it, far within authority.",
        parts=measured_maps(
            progress,
            (dropout_map, lambda rate: lost_border(model.arms, model.system.equilibrium("down-up"), rate=rate,
                                            seeds=5 if quick else 9),
             (100.0,) if quick else (50.0, 100.0, 200.0, 400.0)),
            (stuck_map, lambda phase: stuck_border(model.arms, orbit, phase=phase),
             (0.3,) if quick else (0.1, 0.3, 0.5, 0.7, 0.9)),
        ),
    )  # fmt: skip


def arriving(rate: float, *, missing: float, seconds: float) -> float:
    """Return the least rate of samples, per s, at which half the runs have no gap.

    The formula is that of the head of this module; p is the probability that a sample is lost.

    Args:
        rate: rate of the loop, Hz.
        missing: longest time without samples that is no gap, s.
        seconds: duration of a run, s.
    """
    ticks, gap = seconds * rate, math.floor(missing * rate + 1e-9) + 1
    # The number of gaps grows with p up to p = m / (m + 1); the border lies below.
    lost_share: Any = brentq(lambda p: ticks * (1 - p) * p**gap - math.log(2), 0.0, gap / (gap + 1))
    return (1 - float(lost_share)) * rate


def lost_border(arms: ArmChainParameters, equilibrium: Array, *, rate: float, seeds: int) -> Border:
    """Return the border of the rate of samples, per s, from which on half of the runs hold an equilibrium.

    A run lasts `SECONDS` s.

    Args:
        arms: arms of plant and model.
        equilibrium: state (N,) of arms and cart to hold.
        rate: rate of the loop, Hz.
        seeds: number of runs.
    """
    settings = LoopSettings(seed=0, rate=rate, controller=HoldSettings(), initial_error=0.01)
    controller = hold_controller(equilibrium, sampled_model(arms, rate), HoldSettings(), seconds=SECONDS)
    reference = still(controller.state, SECONDS, method=method_named("radau-7"), limits=Limits(), interval=1.0)

    def probe(passed: float) -> Attempt:
        """Return success if at least half of the runs to which `passed` samples per s arrive are finished."""
        lossy_settings = replace(settings, sensors=SensorSettings(dropout=1 - passed / rate))
        assembly = Assembly(reference, arms, lossy_settings, law=controller)
        runs = [assembly.simulate(draw=assembly.draw(seed=k)) for k in range(seeds)]
        return half_of([Attempt(run.ending is Ending.FINISHED, run.reason) for run in runs], "runs lost")

    predicted = arriving(rate, missing=settings.supervisor.missing, seconds=SECONDS)
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=min(1.6 * predicted, rate), far=predicted / 1.8, predicted=predicted,
        ratio=1.12,
    )  # fmt: skip


def earliest_report(orbit: SustainedOrbit, since: float, *, sensor: int) -> float:
    """Return a lower bound on the time after which a stuck reading of a moving arm can be reported, s.

    Until then the arm has moved too little to be distinguished from one at rest.

    Args:
        orbit: sustained orbit.
        since: time at which the reading is stuck, s.
        sensor: index of the encoder.
    """
    elapsed = np.arange(0.0, orbit.period, 1e-3)
    angles = orbit.state(since + elapsed)
    joint = angles[:, sensor] - (angles[:, sensor - 1] if sensor else 0.0)
    return max(float(elapsed[int(np.argmax(np.abs(joint - joint[0]) >= MOVED))]), STILL)


def stuck_border(arms: ArmChainParameters, orbit: SustainedOrbit, *, phase: float) -> Border:
    """Return the time from a stuck encoder to the end of a run that holds an orbit, s.

    Args:
        arms: arms of plant and model.
        orbit: sustained orbit to hold.
        phase: phase at which the encoder is stuck, 1 for a period.
    """
    model = sampled_model(arms, RATE)
    # The run lasts at least half a second before the encoder sticks.
    stuck_at = round((math.ceil(0.5 / orbit.period) + phase) * orbit.period, 3)
    settings = LoopSettings(seed=0, sensors=SensorSettings(stuck_at=stuck_at, stuck_sensor=1))

    def probe(after: float) -> Attempt:
        """Return success if a run that lasts `after` s beyond the failure of the encoder is finished."""
        controller = orbit_controller(orbit, model, TvlqrSettings(), seconds=stuck_at + after)
        run = Assembly(orbit.reference, arms, settings, law=controller).simulate()
        return Attempt(run.ending is Ending.FINISHED, "" if run.ending is Ending.FINISHED else run.reason)

    # A lower bound: the delay of the filter's test is added to it. So half of it works, and eight times fails.
    earliest = earliest_report(orbit, stuck_at % orbit.period, sensor=1)
    return find_border(probe, x=phase, line=f"{phase:g}", near=earliest / 2, far=8 * earliest, ratio=1.1, unit=1e-3)


FOLLOWED = (
    ("hold-up-up", "lqr"), ("outer-turn", "tvlqr"), ("outer-turn", "adaptive"), ("cross", "tvlqr"),
    ("cross", "adaptive"), ("turn-from-rest", "tvlqr"), ("turn-from-rest", "adaptive"),
    ("up-up", "adaptive"),
)  # fmt: skip
"""Itineraries and laws for comparing margins with campaigns; a quick chart has the first three."""
MARGIN_ERROR = 2e-3
"""Initial error of each angle, rad: small, so that stability decides and not the size of the disturbance."""
TRIED = 10.0
"""Greatest gain of a simulated drive; larger ones are not tried."""
SHORT = 0.5
"""Share by which a border may exceed its margin: a motion can end before a slow instability has grown."""


@cache
def followed(itinerary: str, law: str, seeds: int) -> LoopCase:
    """Return the loop of an itinerary and a law, with its margins; a law that holds runs for `SECONDS` s.

    Args:
        itinerary: name of the itinerary.
        law: name of the controller.
        seeds: number of runs in a trial.
    """
    itinerary_of_law = load_itinerary(itinerary).with_run({"controller": law, "travel": 0.8})
    reference, arms, loop = make_plan(itinerary_of_law).reference, itinerary_of_law.model.arms, itinerary_of_law.loop
    settings = LoopSettings(
        seed=0, controller=loop.controller, estimator=loop.estimator, initial_error=MARGIN_ERROR, travel=0.8
    )
    assembly = Assembly(reference, arms, settings)
    controller: Any = assembly.controller
    if isinstance(controller, OrbitController | HoldController):
        assembly = replace(assembly, law=replace(controller, ticks=round(SECONDS * settings.rate)))
    margins = {name: value for name, (value, _) in assembly.margins().least().items()}
    return LoopCase(assembly, seeds, margins=margins)


def margin_border(name: str, case: tuple[str, str], *, seeds: int, ratio: float) -> Border:
    """Return the border of a drive's gain, delay or lag at which half the runs are lost, with the margin as prediction.

    A gain is searched from 1 down or up, delay and lag from well below their margins up. A margin of the gain above
    `TRIED` is no prediction, since such gains are not tried.

    Args:
        name: gain_low, gain_high, delay or lag.
        case: itinerary and law.
        seeds: number of runs in a trial.
        ratio: precision of the border, as a ratio.
    """
    loop, quantity = followed(*case, seeds), name.partition("_")[0]
    predicted = loop.margins[name]
    near, far = {"gain_low": (1.0, predicted / 4), "gain_high": (1.0, min(4 * predicted, TRIED))}.get(
        name, (predicted / 16, 4 * predicted)
    )
    return find_border(
        lambda value: loop.driven(**{quantity: value}), x=float(FOLLOWED.index(case)), line=", ".join(case),
        near=near, far=far, ratio=ratio, predicted=predicted if name != "gain_high" or predicted < TRIED else None,
    )  # fmt: skip


def margins_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return the chart of margins beside campaigns.

    Args:
        quick: fewer itineraries and seeds.
        progress: called with a label and the completed share.
    """
    cases, seeds, ratio = (FOLLOWED[:3], 8, 1.15) if quick else (FOLLOWED, 32, 1.08)
    theory = "the loop's margin, least along the reference"
    maps = [
        (
            EdgeMap(title, "itinerary and law", label, theory=theory, far="lost", agrees=SHORT),
            partial(margin_border, name, seeds=seeds, ratio=ratio), cases,
        )
        for name, title, label in (
            ("gain_low", "Too little of a command", "share that the drive gives"),
            ("gain_high", "Too much of a command", "factor that the drive gives"),
            ("delay", "Further delay", "delay, s"), ("lag", "Further lag", "lag, s"),
        )
    ]  # fmt: skip
    return ChartPage(
        name="edges-margins",
        title="Margins and the limits of campaigns",
        reading=(
            f"Borders: at half of {seeds} runs lost, or swinging within the limits; the drive differs from the model.",
            "Diamonds: the margins, from simulations of the whole reference with eight small first errors.",
            "A motion may end before a slow instability has grown, so its border may lie beyond its margin.",
        ),
        chosen=f"Margins as shown by `plan --margins`; a border up to {1 + SHORT:g} times as far counts as agreeing.",
        parts=measured_maps(progress, *maps),
    )
