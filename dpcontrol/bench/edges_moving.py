"""Maps of failure of control on a moving reference: delay against rate, and a wrong model against the delay.

Both are foretold by the linear loop along the reference, plant, filter, prediction through the delay and gain, each
tick with its own matrices, commands kept within the limit:

    x_{k+1} = A_k x_k + B_k v_k + m_k,      z_{k+1} = Â_k z_k + B̂_k v_k + L_k (y_{k+1} - H (Â_k z_k + B̂_k v_k))

m_k is by how much the plant's own step from the reference's state misses the next one; the filter's gains L_k are its
answers to nudged readings. The border is where x leaves the range in which the equations are linear.

Source: Rugh, Linear System Theory, 2nd ed., chapter 20, for linear systems that vary with time; Hu & Lin, Control
Systems with Actuator Saturation (2001), chapter 2, for bounded inputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, find_border
from dpcontrol.bench.edges_control import ROOM
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.interface import Estimate
from dpcontrol.control.model import SampledModel
from dpcontrol.control.tracking import TrackingController, TvlqrSettings, tracking_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.batch import BatchRun, run_batch
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan

Array = NDArray[np.float64]

WALK = "outer-turn"
LINEAR = 0.3
"""rad: a sine is its angle to 1.5 % up to here; what goes farther in the linear loop is foretold to be lost."""
INITIAL_ERROR = 0.02
"""rad."""
NEAR = 0.3
"""rad: a run works whose angles end within this of the reference, over its last tenth."""
ACCELERATION = 5.0
RATES = (25.0, 50.0, 100.0, 200.0)
QUICK_RATES = (100.0,)
DELAYS = (0.04, 0.07, 0.1, 0.14)
QUICK_DELAYS = (0.1,)
MISMATCH_RATE = 100.0
_NUDGE = 1e-5
_THEORY = f"the linear loop along the reference strays by {LINEAR:g} rad"


@dataclass(frozen=True, eq=False)
class Path:
    """A reference at a rate: the model between ticks, the controller, and the reference's own motion linearised.

    a (K, N, N), b (K, N): of a tick.
    """

    arms: ArmChainParameters
    model: SampledModel
    controller: TrackingController
    a: Array
    b: Array


@cache
def walked() -> tuple[Reference, ArmChainParameters]:
    """Return the planned turn of the outer arm and the arms that it is planned for."""
    scene = load_itinerary(WALK)
    return make_plan(scene).reference, scene.model.arms


@cache
def path_at(rate: float) -> Path:
    """Return the turn at `rate` Hz."""
    reference, arms = walked()
    model = sampled_model(arms, rate)
    controller = tracking_controller(reference, model, TvlqrSettings())
    assert isinstance(controller, TrackingController)
    a, b = model.linearised(controller.reference_states[:-1], controller.feedforward)
    return Path(arms, model, controller, a, b)


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one rate, one delay."""
    rates, delays = (QUICK_RATES, QUICK_DELAYS) if quick else (RATES, DELAYS)
    late, wrong = [], []
    for k, rate in enumerate(rates):
        progress(f"edges of moving references, delay at {rate:g} Hz", 0.5 * k / len(rates))
        late.append(delay_border(rate=rate))
    for k, delay in enumerate(delays):
        progress(f"edges of moving references, mismatch at {delay:g} s", 0.5 + 0.5 * k / len(delays))
        wrong.append(mismatch_border(delay=delay))
    return EdgeChart(
        name="edges-moving",
        title="Where control ends on a moving reference: one turn of the outer arm, TVLQR",
        maps=(
            EdgeMap("Delay that is known, by rate", "rate of the loop, Hz", "delay, s", tuple(late), far="lost",
                    theory=_THEORY),
            EdgeMap("Wrong model, by delay", "delay, s", "mismatch of the plant, share", tuple(wrong), far="lost",
                    theory=_THEORY),
        ),
        reading=(
            f"Left: how late commands of at most {ACCELERATION:g} m/s² may come after an error of up to "
            f"{INITIAL_ERROR:g} rad at the start, the delay known.",
            "Right: how wrong the plant may be, for the prediction through the delay runs on the model. At 20 ms and "
            "less more is borne than foretold: the range is left and found again.",
            "Circles end near the reference, crosses end with the sentence in the data; diamonds are foretold.",
        ),
        chosen="Prediction through all commands on their way, from the first on; delays of the bench are 1 to 20 ms.",
    )  # fmt: skip


def _answer(run: BatchRun) -> Answer:
    if run.ending is not Ending.FINISHED:
        return Answer(False, run.reason)
    n = run.references.shape[1]
    tail = max(len(run.times) // 10, 1)
    last = float(np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max())
    return Answer(last < NEAR, f"finished, but {last:.2g} rad away over its last tenth")


def delay_border(
    *, rate: float, acceleration: float = ACCELERATION, seed: int = 0, ratio: float = 1.08
) -> Border:  # fmt: skip
    """Return the border of the delay in s, which the loop knows, at `rate` Hz."""
    path = path_at(rate)
    settings = LoopSettings(seed=seed, rate=rate, initial_error=INITIAL_ERROR)
    drawn = draw_bench(
        path.arms, settings.bench, seed=seed, ticks=2, period=1 / rate, initial_error=INITIAL_ERROR
    ).initial_error
    error = np.concatenate([drawn, np.zeros(path.model.dimension - len(drawn))])
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=acceleration)

    def probe(delay: float) -> Answer:
        late = replace(settings, drive=DriveSettings(delay=round(delay * rate)))
        run = run_batch(path.arms, settings=late, seeds=[seed], controller=path.controller, limits=limits)[0]
        return _answer(run)

    ticks = np.unique(np.rint(np.geomspace(0.01 * rate, 0.6 * rate, 60)))
    predicted = _first_failure(
        lambda d: foretold(path, delay=round(d * rate), acceleration=acceleration, truth=path.model, error=error),
        [float(t) / rate for t in ticks if t >= 1],
    )
    middle = predicted or 0.1
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=middle / 4, far=3 * middle, predicted=predicted, ratio=ratio,
        unit=1 / rate,
    )  # fmt: skip


@cache
def filter_gains(rate: float) -> tuple[Array, Array, Array, Array]:
    """Return the filter's first gain (Z, n+1), its gains (K, Z, n+1) along the turn, H (n+1, Z), and the noise it has.

    Each gain is the filter's answer to a nudged reading.
    """
    path = path_at(rate)
    model, states, inputs = path.model, path.controller.reference_states, path.controller.feedforward
    settings = LoopSettings(seed=0, rate=rate)
    noise = settings.sensors.covariance(model.arms)
    ekf = CompiledEkf(model, settings.estimator, noise=noise)
    where = model.position_indices
    nudges = _NUDGE * np.eye(len(where))

    def gain(after: Callable[[Array], Estimate], reading: Array) -> Array:
        def whole(moved: Array) -> Array:
            found = after(moved)
            return np.concatenate([found.state, found.extra])

        return np.array([whole(reading + d) - whole(reading - d) for d in nudges]).T / (2 * _NUDGE)

    begun = ekf.first(states[0])
    first = gain(partial(ekf.update, begun), states[0][where])
    estimate, gains = ekf.update(begun, states[0][where]), []
    for u, state in zip(inputs, states[1:], strict=True):
        gains.append(gain(partial(ekf.step, estimate, float(u)), state[where]))
        estimate = ekf.step(estimate, float(u), state[where])
    return first, np.array(gains), ekf.program.equations.observation, noise


def foretold(path: Path, *, delay: int, acceleration: float, truth: SampledModel, error: Array) -> bool:
    """Return whether the linear loop, its commands within `acceleration` m/s², stays near the reference.

    delay: in ticks; truth: the plant between ticks; error (N,): at the start.
    """
    first, gains, seen, noise = filter_gains(1 / path.model.period)
    n = path.model.dimension
    states, inputs = path.controller.reference_states, path.controller.feedforward
    plant_a, plant_b = truth.linearised(states[:-1], inputs)
    misses = np.array([truth.step(x, float(u)) for x, u in zip(states[:-1], inputs, strict=True)]) - states[1:]
    positions, arms, last = path.model.position_indices, path.arms.count, len(inputs) - 1
    readings = np.random.default_rng(0).multivariate_normal(np.zeros(len(positions)), noise, len(inputs) + 1)
    x, waiting = error.copy(), [0.0] * delay
    z = first @ (x[positions] + readings[0])
    for k in range(len(inputs)):
        ahead = z[:n]
        for i, command in enumerate(waiting):
            at = min(k + i, last)
            ahead = path.a[at] @ ahead + path.b[at] * command
        acts = min(k + delay, last)
        wanted = float(inputs[acts] - path.controller.gains[acts] @ ahead)
        waiting.append(min(max(wanted, -acceleration), acceleration) - float(inputs[acts]))
        command = waiting.pop(0)
        x = plant_a[k] @ x + plant_b[k] * command + misses[k]
        z[:n] = path.a[k] @ z[:n] + path.b[k] * command
        z = z + gains[k] @ (x[positions] + readings[k + 1] - seen @ z)
        if np.abs(x[:arms]).max() > LINEAR:
            return False
    return True


def _first_failure(works: Callable[[float], bool], values: Sequence[float]) -> float | None:
    """Return the middle between the first of the rising values that does not work and the one before; None for none."""
    for before, value in pairwise(values):
        if not works(value):
            return float(np.sqrt(before * value))
    return None


def mismatch_border(*, delay: float, rate: float = MISMATCH_RATE, seed: int = 0, ratio: float = 1.1) -> Border:
    """Return the border of the plant's mismatch, in the direction drawn from `seed`, at `delay` s."""
    path = path_at(rate)
    ticks = round(delay * rate)
    settings = LoopSettings(seed=seed, rate=rate, initial_error=1e-3, drive=DriveSettings(delay=ticks))
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=30.0)

    def works(mismatch: float) -> bool:
        drawn = draw_bench(path.arms, settings.bench, seed=seed, ticks=2, period=1 / rate, mismatch=mismatch)
        truth = SampledModel(path.model.equations, drawn.plant.arms.base(), period=path.model.period)
        none = np.zeros(path.model.dimension)
        return foretold(path, delay=ticks, acceleration=30.0, truth=truth, error=none)

    def probe(mismatch: float) -> Answer:
        wrong = replace(settings, mismatch=mismatch)
        run = run_batch(path.arms, settings=wrong, seeds=[seed], controller=path.controller, limits=limits)[0]
        return _answer(run)

    predicted = _first_failure(works, np.geomspace(2e-3, 0.7, 50).tolist())
    near, far = (predicted / 4, min(3 * predicted, 0.7)) if predicted else (0.01, 0.7)
    return find_border(probe, x=delay, line=f"{1e3 * delay:g} ms", near=near, far=far, predicted=predicted, ratio=ratio)
