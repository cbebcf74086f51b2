"""Maps of failure of control: delay against rate, and a wrong model against delay, at rest and on a moving reference.

Authority: what an error ξ of the unstable direction, ξ' = λξ + bu with |u| ≤ a, has become when the first command acts,
ξ e^{λd}, must be less than a·b/λ, or no command brings it back:

    d < ln(a |b| / (λ |ξ|)) / λ,       ξ = left eigenvector · error,   b = left eigenvector · B

Mismatch: plant, prediction through the commands on their way and gain are one linear map of (x, commands); the border
is where its largest eigenvalue reaches the unit circle. The filter is left out, which costs up to a third.
Neither formula holds along a moving reference, whose borders are measured only.

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., sections 8.6 and 9.3; for bounded
inputs, Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, borders, find_border
from dpcontrol.control.interface import Controller
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.control.model import SampledModel
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.loop.batch import BatchRun, run_batch
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits
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


def held(rate: float, *, saddle: str = SADDLE, seconds: float = 8.0) -> Stand:
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


def chart(quick: bool, progress: Progress) -> EdgeChart:
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
    stand = held(rate)
    error = stand.drawn_error(HELD_ERROR)
    predicted = longest_delay(stand.model, stand.controller.first_state, error, acceleration=WEAK)
    return delay_border(stand, error=HELD_ERROR, ratio=ratio, predicted=predicted)


def held_mismatch_border(delay: float, *, rate: float = MISMATCH_RATE, ratio: float = 1.1) -> Border:
    """Return the border of the plant's mismatch at a delay in s, arms held, beside the predicted one."""
    stand = held(rate, seconds=20.0)
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
