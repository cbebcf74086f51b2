"""Maps of failure of control: delay against rate, and a wrong model against delay, at rest and on a moving reference.

Authority: what an error ξ of the unstable direction, ξ' = λξ + bu with |u| ≤ a, has become when the first command acts,
ξ e^{λd}, must be less than a·b/λ, or no command brings it back:

    d < ln(a |b| / (λ |ξ|)) / λ,       ξ = left eigenvector · error,   b = left eigenvector · B

Mismatch: plant, prediction through the commands on their way and gain are one linear map of (x, commands); the border
is where its largest eigenvalue reaches the unit circle. The filter is left out, which costs up to a third.
Neither formula holds along a moving reference, whose borders are measured only.

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., sections 8.6 and 9.3; for bounded
inputs, Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2.

Maps of failure of estimation: how many samples may be lost, and how soon a stuck encoder is reported.

Lost samples: of K ticks each is lost with probability p. A run is ended by a gap of m ticks, longer than the supervisor
allows; gaps of at least m begin K (1 - p) pᵐ times on average, nearly independently: half of the runs see none at

    K (1 - p) pᵐ = ln 2

Stuck encoder: it differs from a still arm only once the reference has moved 0.02 rad from the reading and 15 ms have
passed; the filter's doubt comes on top, so this is a lower bound.

Source: Feller, An Introduction to Probability Theory and Its Applications I, 3rd ed., section XIII.7, for runs.

Where OGY ends: the largest pulse, and encoder counts, by sections in a period.

An error grows by about λ^(1/k) from one of k sections to the next, so that few sections need large pulses and fine
encoders. How readings round depends on the orbit, for which there is no short formula: the borders are measured only.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.chart import Attempt, Border, EdgeChart, EdgeMap, borders, find_border, half_of
from dpcontrol.bench.control import held
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import Controller, SampledModel
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.loop.batch import BatchRun, run_batch
from dpcontrol.loop.bench import DriveSettings, SensorSettings, draw_bench
from dpcontrol.loop.loop import LoopSettings, run_loop, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import still
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.plan import make_plan

Array = NDArray[np.float64]

SADDLE, WALK = "down-up", "outer-turn"
ROOM = 20.0
"""m of track, so that authority alone decides."""
HELD_ERROR, MOVING_ERROR = 0.05, 0.02
"""rad at the start, where the delay is varied."""
WEAK, STRONG = 5.0, 30.0
"""m/s²: the limit where the delay is varied, and where the model is."""
RATES, QUICK_RATES = (25.0, 50.0, 100.0, 200.0, 400.0), (50.0, 200.0)
DELAYS, QUICK_DELAYS = (0.02, 0.05, 0.1, 0.15, 0.2), (0.05, 0.15)
MOVING_RATES, QUICK_MOVING_RATES = (25.0, 50.0, 100.0, 200.0), (100.0,)
MOVING_DELAYS, QUICK_MOVING_DELAYS = (0.04, 0.07, 0.1, 0.14), (0.1,)
MISMATCH_RATE = 100.0
WITHOUT_FILTER = 1 / 3
"""How far the border of mismatch may lie from its prediction."""
_SEED = 0


@dataclass(frozen=True, eq=False)
class Stand:
    """A controller at a rate in Hz on its model; near: a run works whose angles end within this of the reference, rad,
    over its last tenth.
    """

    arms: ArmChainParameters
    model: SampledModel
    controller: Controller
    settings: LoopSettings
    near: float

    def run(self, *, limits: Limits, mismatch: float = 0.0, error: float = 1e-3, delay: float = 0.0) -> Attempt:
        """Return whether a run stays at its reference with a mismatch, an error in rad at the start, a delay in s."""
        # Half a period of wrong timing is another error, which a slow loop pays for dearly.
        drive = DriveSettings(delay=round(delay * self.settings.rate))
        settings = replace(self.settings, mismatch=mismatch, initial_error=error, drive=drive)
        runs = run_batch(self.arms, settings=settings, seeds=[_SEED], controller=self.controller, limits=limits)
        return answer_of(runs[0], near=self.near)

    def drawn_error(self, size: float) -> Array:
        """Return the error (N,) with which runs start that err by up to `size` rad."""
        bench, period = self.settings.bench, self.model.period
        drawn = draw_bench(self.arms, bench, seed=_SEED, ticks=2, period=period, initial_error=size).initial_error
        return np.concatenate([drawn, np.zeros(self.model.dimension - len(drawn))])

    def plant(self, mismatch: float) -> SampledModel:
        """Return the plant of runs with `mismatch` between two ticks."""
        bench, period = self.settings.bench, self.model.period
        plant = draw_bench(self.arms, bench, seed=_SEED, ticks=2, period=period, mismatch=mismatch).plant
        return SampledModel(self.model.equations, plant.arms.base(), period=period)


def answer_of(run: BatchRun, *, near: float) -> Attempt:
    """Return whether a run came to its end, its angles within `near` rad of the reference over its last tenth."""
    if run.ending is not Ending.FINISHED:
        return Attempt(False, run.reason)
    tail, n = max(len(run.times) // 10, 1), run.references.shape[1]
    last = float(np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max())
    return Attempt(last < near, f"finished, but {last:.2g} rad away over its last tenth")


def held_at_rest(rate: float, *, saddle: str = SADDLE, seconds: float = 8.0) -> Stand:
    """Return the lab's arms held at an equilibrium for `seconds`.

    Raises:
        InputError, GoalMissed: the equilibrium cannot be held at this rate.
    """
    lab = load_model("lab")
    model = sampled_model(lab.arms, rate)
    controller = hold_controller(lab.system.equilibrium(saddle), model, HoldSettings(), seconds=seconds)
    settings = LoopSettings(seed=_SEED, rate=rate, controller=HoldSettings())
    return Stand(lab.arms, model, controller, settings, near=0.1)


@cache
def moving(rate: float) -> Stand:
    """Return the planned turn of the outer arm, followed by TVLQR."""
    scene = load_itinerary(WALK)
    model = sampled_model(scene.model.arms, rate)
    controller = tracking_controller(make_plan(scene).reference, model, TvlqrSettings())
    return Stand(scene.model.arms, model, controller, LoopSettings(seed=_SEED, rate=rate), near=0.3)


def control_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of arms held at an equilibrium; quick: fewer rates and delays."""
    rates, delays = (QUICK_RATES, QUICK_DELAYS) if quick else (RATES, DELAYS)
    ratio = 1.15 if quick else 1.06
    late = borders(
        lambda rate: held_delay_border(rate, ratio=ratio), rates, part_of(progress, 0.0, 0.5), "delay at {:g} Hz"
    )
    wrong = borders(
        lambda delay: held_mismatch_border(delay, ratio=ratio),
        delays,
        part_of(progress, 0.5, 1.0),
        "mismatch at {:g} s",
    )
    return EdgeChart(
        name="edges-control",
        title="Where control ends: arms held at Down-Up",
        maps=_maps(
            late, wrong, f"the first command comes when {WEAK:g} m/s² can no longer turn the fall",
            "largest eigenvalue of plant, prediction and gain together is 1",
        ),
        reading=(
            "Left: a known delay is predicted through, so it costs time only, whatever the rate: what an error of up "
            f"to {HELD_ERROR:g} rad grows to before the first command acts must stay within reach.",
            "Right: the prediction runs on the model; the longer the delay, the less it may be wrong.",
            "Circles hold to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="Prediction through all commands on their way, at any rate; delays of the bench are 1 to 20 ms.",
    )  # fmt: skip


def moving_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of a moving reference; quick: one rate, one delay."""
    rates, delays = (QUICK_MOVING_RATES, QUICK_MOVING_DELAYS) if quick else (MOVING_RATES, MOVING_DELAYS)
    late = borders(
        lambda rate: delay_border(moving(rate), error=MOVING_ERROR, ratio=1.08), rates, part_of(progress, 0.0, 0.5),
        "delay at {:g} Hz",
    )  # fmt: skip
    wrong = borders(
        lambda delay: mismatch_border(moving(MISMATCH_RATE), delay, ratio=1.1), delays, part_of(progress, 0.5, 1.0),
        "mismatch at {:g} s",
    )  # fmt: skip
    return EdgeChart(
        name="edges-moving",
        title="Where control ends on a moving reference: one turn of the outer arm, TVLQR",
        maps=_maps(late, wrong),
        reading=(
            f"Left: how late commands of at most {WEAK:g} m/s² may come after an error of up to {MOVING_ERROR:g} rad "
            "at the start, the delay known.",
            "Right: how wrong the plant may be, for the prediction through the delay runs on the model.",
            "Circles end near the reference, crosses end with the sentence in the data.",
        ),
        chosen="Prediction through all commands on their way, from the first on; delays of the bench are 1 to 20 ms.",
    )


def _maps(
    late: tuple[Border, ...], wrong: tuple[Border, ...], of_delay: str = "", of_model: str = ""
) -> tuple[EdgeMap, EdgeMap]:
    return (
        EdgeMap("Known delay, by rate", "rate of the loop, Hz", "delay, s", late, of_delay, far="lost"),
        EdgeMap("Wrong model, by delay", "delay, s", "mismatch of the plant, share", wrong, of_model,
                far="lost", agrees=WITHOUT_FILTER),
    )  # fmt: skip


def delay_border(stand: Stand, *, error: float, ratio: float, predicted: float | None = None) -> Border:
    """Return the border of the delay in s, which the loop knows, after an error in rad at the start."""
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=WEAK)
    rate, middle = stand.settings.rate, predicted or 0.2
    return find_border(
        lambda delay: stand.run(limits=limits, error=error, delay=delay), x=rate, line=f"{rate:g} Hz",
        near=middle / 4, far=3 * middle, predicted=predicted, ratio=ratio, unit=1 / rate,
    )  # fmt: skip


def mismatch_border(stand: Stand, delay: float, *, ratio: float, predicted: float | None = None) -> Border:
    """Return the border of the plant's mismatch at a delay in s, in one direction of all parameters."""
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=STRONG)
    near, far = (predicted / 4, min(2.5 * predicted, 0.6)) if predicted else (0.01, 0.6)
    return find_border(
        lambda mismatch: stand.run(limits=limits, mismatch=mismatch, delay=delay), x=delay,
        line=f"{1e3 * delay:g} ms", near=near, far=far, predicted=predicted, ratio=ratio,
    )  # fmt: skip


def held_delay_border(rate: float, *, ratio: float = 1.1) -> Border:
    """Return the border of the delay in s at `rate` Hz, arms held, beside the predicted one."""
    stand = held_at_rest(rate)
    error = stand.drawn_error(HELD_ERROR)
    predicted = longest_delay(stand.model, stand.controller.first_state, error, acceleration=WEAK)
    return delay_border(stand, error=HELD_ERROR, ratio=ratio, predicted=predicted)


def held_mismatch_border(delay: float, *, rate: float = MISMATCH_RATE, ratio: float = 1.1) -> Border:
    """Return the border of the plant's mismatch at a delay in s, arms held, beside the predicted one."""
    stand = held_at_rest(rate, seconds=20.0)
    # Coarse first: the eigenvalue may come back into the circle.
    beyond = (f for f in np.geomspace(1e-3, 0.6, 60).tolist() if _grows(stand, f, delay=round(delay * rate)))
    return mismatch_border(stand, delay, ratio=ratio, predicted=next(beyond, None))


def longest_delay(model: SampledModel, state: Array, error: Array, *, acceleration: float) -> float:
    """Return the delay in s after which `acceleration` m/s² cannot bring back an `error` (N,) at the start."""
    a, b = (v[0] for v in model.linearised(state[None, :], np.zeros(1)))
    values, left = np.linalg.eig(a.T)
    first = int(np.argmax(np.abs(values)))
    growth, direction = float(values[first].real), np.real(left[:, first])
    rate = float(np.log(growth)) / model.period
    # One held period: b (e^{λT} - 1)/λ.
    reach = float(direction @ b) * rate / (growth - 1)
    return float(np.log(acceleration * abs(reach) / (rate * abs(float(direction @ error)))) / rate)


def _grows(stand: Stand, mismatch: float, *, delay: int) -> bool:
    controller, state = stand.controller, stand.controller.first_state
    assert isinstance(controller, HoldController)
    plant, believed = (
        tuple(v[0] for v in model.linearised(state[None, :], np.zeros(1)))
        for model in (stand.plant(mismatch), stand.model)
    )
    return bool(np.abs(np.linalg.eigvals(loop_matrix(plant, believed, gain=controller.gain, delay=delay))).max() >= 1)


def loop_matrix(plant: tuple[Array, ...], believed: tuple[Array, ...], *, gain: Array, delay: int) -> Array:
    """Return the map of a tick, of the state and the commands on their way, both as deviations; the oldest first.

    plant, believed: A (N, N), B (N,) between ticks, of the plant and of the model that predicts; gain (N,).
    """
    n, size = len(gain), len(gain) + delay
    ahead = np.eye(size)[:n]
    for i in range(delay):
        ahead = believed[0] @ ahead
        ahead[:, n + i] += believed[1]
    whole = np.zeros((size, size))
    whole[:n, :n] = plant[0]
    # The oldest command acts now, the new one comes last.
    whole[n:-1, n + 1 :] = np.eye(max(delay - 1, 0))
    if delay:
        whole[:n, n], whole[-1] = plant[1], -gain @ ahead
    else:
        whole -= np.outer(plant[1], gain)
    return whole


WATCHED_SADDLE = "down-up"
SAMPLE_RATES = (50.0, 100.0, 200.0, 400.0)
QUICK_SAMPLE_RATES = (100.0,)
SECONDS = 10.0
SEEDS = 9
PHASES = (0.1, 0.3, 0.5, 0.7, 0.9)
QUICK_PHASES = (0.3,)
BEFORE = 0.5
"""s of the run before a sensor sticks, at least."""
MOVED, STILL = 0.02, 0.015
"""rad and s: what distinguishes a stuck joint from a still one."""


def estimation_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one rate, one phase, fewer seeds."""
    model = load_model("lab")
    rates, phases, seeds = (QUICK_SAMPLE_RATES, QUICK_PHASES, 5) if quick else (SAMPLE_RATES, PHASES, SEEDS)
    equilibrium = model.system.equilibrium(WATCHED_SADDLE)
    lost = borders(
        lambda rate: lost_border(model.arms, equilibrium, rate=rate, seeds=seeds), rates, part_of(progress, 0.0, 0.6),
        "lost samples at {:g} Hz",
    )  # fmt: skip
    orbit = sustained_orbit(lyapunov_orbit(model.system, WATCHED_SADDLE, energy=-0.07), model.arms)
    stuck = borders(
        lambda phase: stuck_border(model.arms, orbit, phase=phase), phases, part_of(progress, 0.6, 1.0),
        "stuck at phase {:g}",
    )  # fmt: skip
    return EdgeChart(
        name="edges-estimation",
        title="Where estimates end: samples lost, an encoder stuck",
        maps=(
            EdgeMap("Lost samples", "rate of the loop, Hz", "samples that arrive, per s", lost, far="lost",
                    theory="a gap of 0.1 s is as likely as not in 10 s"),
            EdgeMap("A stuck encoder of the outer arm, on the orbit about Down-Up", "phase at which it sticks",
                    "seconds until it is reported", stuck, far="reported", near="goes on", log_x=False),
        ),
        reading=(
            "Left: the filter flies through gaps on its model; the supervisor ends the run after 0.1 s without any.",
            "Right: a stuck encoder is recognised by what the arm should have done meanwhile.",
            "Circles run to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="0.1 s without a sample: an error at Down-Up grows 2.2-fold in it, far within authority.",
    )  # fmt: skip


def arriving(rate: float, *, missing: float, seconds: float) -> float:
    """Return the samples per s that must arrive for half of the runs to see no gap longer than `missing` s."""
    ticks, gap = seconds * rate, math.floor(missing * rate + 1e-9) + 1
    # Gaps become more with p up to p = m / (m + 1); the border lies below.
    low, high = 1e-6, gap / (gap + 1)
    for _ in range(100):
        p = (low + high) / 2
        low, high = (low, p) if ticks * (1 - p) * p**gap > math.log(2) else (p, high)
    return (1 - low) * rate


def lost_border(arms: ArmChainParameters, equilibrium: Array, *, rate: float, seeds: int = SEEDS) -> Border:
    """Return how many samples per s must arrive for half of the runs to hold the equilibrium for ten seconds."""
    settings = LoopSettings(seed=0, rate=rate, controller=HoldSettings(), initial_error=0.01)
    controller = hold_controller(equilibrium, sampled_model(arms, rate), HoldSettings(), seconds=SECONDS)
    reference = still(controller.state, SECONDS, method=method_named("radau-7"), limits=Limits(), interval=1.0)

    def probe(kept: float) -> Attempt:
        one = replace(settings, sensors=SensorSettings(dropout=1 - kept / rate))
        runs = [
            run_loop(reference, arms, settings=replace(one, seed=seed), controller=controller) for seed in range(seeds)
        ]
        return half_of([Attempt(run.ending is Ending.FINISHED, run.reason) for run in runs], "runs lost")

    predicted = arriving(rate, missing=settings.supervisor.missing, seconds=SECONDS)
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=min(1.6 * predicted, rate), far=predicted / 1.8, predicted=predicted,
        ratio=1.12,
    )  # fmt: skip


def earliest_report(orbit: SustainedOrbit, since: float, *, sensor: int) -> float:
    """Return the seconds after which a reading that sticks at `since` s on the clock differs from a still arm's."""
    after = np.arange(0.0, orbit.period, 1e-3)
    angles = orbit.state(since + after)
    joint = angles[:, sensor] - (angles[:, sensor - 1] if sensor else 0.0)
    return max(float(after[int(np.argmax(np.abs(joint - joint[0]) >= MOVED))]), STILL)


def stuck_border(arms: ArmChainParameters, orbit: SustainedOrbit, *, phase: float, sensor: int = 1) -> Border:
    """Return the seconds for which a run that holds an orbit goes on after its encoder has stuck."""
    model = sampled_model(arms, 1000.0)
    wholes = math.ceil(BEFORE / orbit.period)
    at = round((wholes + phase) * orbit.period, 3)
    settings = LoopSettings(seed=0, sensors=SensorSettings(stuck_at=at, stuck_sensor=sensor))

    def probe(after: float) -> Attempt:
        controller = orbit_controller(orbit, model, TvlqrSettings(), seconds=at + after)
        run = run_loop(orbit.reference, arms, settings=settings, controller=controller)
        return Attempt(run.ending is Ending.FINISHED, "" if run.ending is Ending.FINISHED else run.reason)

    least = earliest_report(orbit, at % orbit.period, sensor=sensor)
    return find_border(probe, x=phase, line=f"{phase:g}", near=least / 2, far=8 * least, ratio=1.1, unit=1e-3)


RATE = 1000.0
OGY_SECONDS, QUICK_SECONDS = 6.0, 4.0
OGY_SEEDS, RATIO = 16, 1.12
QUICK_SEEDS, QUICK_RATIO = 8, 1.6
SECTIONS, QUICK_SECTIONS = (1, 2, 3, 4, 8, 16), (8,)
LIMIT = 0.5
"""m/s²: of the pulses where counts are varied."""
COUNTS = 40_000.0
"""Counts per turn where the pulses are varied."""
FEWEST, MOST = 50.0, 4e8
"""Counts per turn: from the coarsest encoders to none that there is."""
WEAKEST, STRONGEST = 0.01, 5.0
"""m/s²: pulses from next to nothing to the shipped ones."""


@dataclass(frozen=True, eq=False)
class HeldOrbit:
    """An orbit to be held for `seconds`, and the arms that are believed and simulated alike."""

    orbit: SustainedOrbit
    arms: ArmChainParameters
    seconds: float = OGY_SECONDS

    def controller(self, sections: int, limit: float = LIMIT) -> OgyController:
        """Return the law by `sections` pulses a period, of at most `limit` m/s²; it learns nothing."""
        settings = OgySettings(sections=sections, pulse_limit=limit, parameter_error=0.0)
        return ogy_controller(self.orbit, sampled_model(self.arms, RATE), settings, seconds=self.seconds)


def stay(saddle: str = "down-up", energy: float = -0.07, *, seconds: float = OGY_SECONDS) -> HeldOrbit:
    """Return the lab's orbit about a saddle at an energy in J."""
    lab = load_model("lab")
    return HeldOrbit(sustained_orbit(lyapunov_orbit(lab.system, saddle, energy=energy), lab.arms), lab.arms, seconds)


def ogy_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer sections and seeds, wider borders, and shorter runs."""
    one = stay(seconds=QUICK_SECONDS if quick else OGY_SECONDS)
    sections, seeds, ratio = (QUICK_SECTIONS, QUICK_SEEDS, QUICK_RATIO) if quick else (SECTIONS, OGY_SEEDS, RATIO)
    weak, counted = (
        borders(partial(of, one, seeds=seeds, ratio=ratio), sections, part_of(progress, begin, end), what)
        for of, begin, end, what in (
            (limit_border, 0.0, 0.4, "largest pulse, k = {}"), (counts_border, 0.4, 1.0, "counts, k = {}"),
        )
    )  # fmt: skip
    x = "sections in a period, k"
    return EdgeChart(
        name="edges-ogy",
        title=f"Where OGY ends: Down-Up at -0.07 J, multiplier {one.orbit.multipliers[0].real:.0f} a period",
        maps=(
            EdgeMap(f"Authority, {COUNTS:,.0f} counts per turn", x, "largest pulse, m/s²", weak, far="lost"),
            EdgeMap(f"Encoders, pulses of {LIMIT:g} m/s²", x, "counts per turn", counted, far="lost"),
        ),
        reading=(
            "From one section to the next an error grows by about λ^(1/k), so few sections need large pulses or "
            "encoders that nobody builds.",
            f"Circles: at least half of {seeds} runs hold; crosses: fewer. Zeros of the encoders lie anywhere within a "
            "count.",
            "How readings round depends on the orbit, and more counts may be worse in places: no formula predicts "
            "these borders.",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would still do.",
    )


def holds(one: HeldOrbit, controller: OgyController, *, counts: float, seeds: int) -> Attempt:
    """Return whether at least half of the runs hold the orbit, else what ended the first that did not."""
    whole = max(round(counts), 1)
    sensors = SensorSettings(counts=whole, cart_resolution=1e-6, zero_error=np.pi / whole)
    # Zeros being estimated would need a third larger pulses at k = 16.
    settings = LoopSettings(
        seed=0, rate=RATE, sensors=sensors, estimator=EkfSettings(augment=()), initial_error=1e-5
    )  # fmt: skip
    runs = run_batch(one.arms, settings=settings, seeds=range(seeds), controller=controller,
                     limits=Limits(position=5.0, acceleration=30.0))  # fmt: skip
    period = one.orbit.period
    judge = held(one.orbit.state(np.linspace(0, period, 1000))[:, : one.arms.count], period=period)
    away = "finished, but away from the orbit in its last period"
    return half_of(
        [Attempt(judge(run), away if run.ending is Ending.FINISHED else run.reason) for run in runs], "runs lost"
    )


def limit_border(one: HeldOrbit, sections: int, *, seeds: int = OGY_SEEDS, ratio: float = RATIO) -> Border:
    """Return the smallest limit of the pulses, m/s², with which `sections` of them a period hold the orbit."""
    controller = one.controller(sections)

    def probe(limit: float) -> Attempt:
        return holds(one, replace(controller, pulse_limit=limit), counts=COUNTS, seeds=seeds)

    return _border(probe, sections, near=STRONGEST, far=WEAKEST, ratio=ratio)


def counts_border(one: HeldOrbit, sections: int, *, seeds: int = OGY_SEEDS, ratio: float = RATIO) -> Border:
    """Return the fewest counts per turn with which `sections` pulses a period hold the orbit."""
    controller = one.controller(sections)

    def probe(counts: float) -> Attempt:
        return holds(one, controller, counts=counts, seeds=seeds)

    return _border(probe, sections, near=MOST, far=FEWEST, ratio=ratio)


def _border(probe: Callable[[float], Attempt], sections: int, *, near: float, far: float, ratio: float) -> Border:
    return find_border(probe, x=sections, line=f"k = {sections}", near=near, far=far, ratio=ratio)
