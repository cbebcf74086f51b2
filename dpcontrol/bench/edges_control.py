"""Maps of failure of control: delay against rate, and a wrong model against the delay, for arms held at Down-Up.

Authority: what an error ξ of the unstable direction, ξ' = λξ + bu with |u| ≤ a, has become when the first command acts,
ξ e^{λd}, must be less than a·b/λ, or no command brings it back:

    d < ln(a |b| / (λ |ξ|)) / λ,       ξ = left eigenvector · error,   b = left eigenvector · B

Mismatch: plant, filter, prediction through the commands on their way and gain are one linear map of (x, x̂, commands);
the border is where its largest eigenvalue reaches the unit circle.

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., sections 8.6 and 9.3; for bounded
inputs, Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from dpcontrol.bench.edges import Answer, Border, EdgeChart, EdgeMap, find_border
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.model import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.batch import BatchRun, run_batch
from dpcontrol.loop.bench import DriveSettings
from dpcontrol.loop.draw import draw_bench
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.references.problem import Limits
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]

SADDLE = "down-up"
NEAR = 0.1
"""rad: a run works that ends within this of the equilibrium, in its last second."""
ROOM = 20.0
"""m of track, so that authority alone decides."""
INITIAL_ERROR = 0.05
RATES = (25.0, 50.0, 100.0, 200.0, 400.0)
QUICK_RATES = (50.0, 200.0)
DELAYS = (0.02, 0.05, 0.1, 0.15, 0.2)
QUICK_DELAYS = (0.05, 0.15)
MISMATCH_RATE = 100.0
_NUDGE = 1e-5
_SETTLED = 400


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer rates and delays."""
    model = load_model("lab")
    equilibrium = model.system.equilibrium(SADDLE)
    rates, delays = (QUICK_RATES, QUICK_DELAYS) if quick else (RATES, DELAYS)
    ratio = 1.15 if quick else 1.06
    borders, wrong = [], []
    for k, rate in enumerate(rates):
        progress(f"edges of control, delay at {rate:g} Hz", 0.5 * k / len(rates))
        borders.append(delay_border(model.arms, equilibrium, rate=rate, ratio=ratio))
    for k, delay in enumerate(delays):
        progress(f"edges of control, mismatch at {delay:g} s", 0.5 + 0.5 * k / len(delays))
        wrong.append(mismatch_border(model.arms, equilibrium, delay=delay, ratio=ratio))
    return EdgeChart(
        name="edges-control",
        title="Where control ends: arms held at Down-Up",
        maps=(
            EdgeMap(
                "Delay that is known, by rate", "rate of the loop, Hz", "delay, s", tuple(borders),
                theory="the first command comes when 5 m/s² can no longer turn the fall", far="lost",
            ),
            EdgeMap(
                "Wrong model, by delay", "delay, s", "mismatch of the plant, share", tuple(wrong),
                theory="largest eigenvalue of plant, filter, prediction and gain together is 1", far="lost",
            ),
        ),
        reading=(
            "Left: a delay that is known is predicted through, so that it costs time only, whatever the rate: what an "
            f"error of up to {INITIAL_ERROR:g} rad grows to before the first command acts must stay within reach.",
            "Right: the prediction runs on the model; the longer the delay, the less it may be wrong.",
            "Circles hold to the end, crosses end with the sentence in the data; diamonds are foretold.",
        ),
        chosen="Prediction through all commands on their way, at any rate; delays of the bench are 1 to 20 ms.",
    )  # fmt: skip


def unstable_direction(model: SampledModel, state: Array) -> tuple[float, Array, float]:
    """Return λ in 1/s, the left eigenvector w (N,) of the one unstable direction at `state` (N,), and w · B in 1/m.

    B: of the rate, per m/s² of the cart, so that (w·x)' = λ w·x + b u.
    """
    a, b = (v[0] for v in model.linearised(state[None, :], np.zeros(1)))
    values, left = np.linalg.eig(a.T)
    first = int(np.argmax(np.abs(values)))
    growth, direction = float(values[first].real), np.real(left[:, first])
    rate = float(np.log(growth)) / model.period
    # One held period: b (e^{λT} - 1)/λ.
    return rate, direction, float(direction @ b) * rate / (growth - 1)


def longest_delay(model: SampledModel, state: Array, error: Array, *, acceleration: float) -> float:
    """Return the delay in s after which `acceleration` m/s² cannot bring back an `error` (N,) at the start."""
    rate, direction, reach = unstable_direction(model, state)
    grown = abs(float(direction @ error))
    return float(np.log(acceleration * abs(reach) / (rate * grown)) / rate)


def _answer(run: BatchRun, state: Array, *, period: float) -> Answer:
    n = (len(state) - 2) // 2
    if run.ending is not Ending.FINISHED:
        return Answer(False, run.reason)
    last = np.abs(run.truth[-max(round(1 / period), 1) :, :n] - state[:n]).max()
    return Answer(bool(last < NEAR), f"finished, but {last:.2g} rad away in the last second")


def delay_border(
    arms: ArmChainParameters, equilibrium: Array, *, rate: float, ratio: float = 1.1, acceleration: float = 5.0,
    seed: int = 0, seconds: float = 8.0,
) -> Border:  # fmt: skip
    """Return the border of the delay in s, which the loop knows, at `rate` Hz."""
    model = sampled_model(arms, rate)
    controller = hold_controller(equilibrium, model, HoldSettings(), seconds=seconds)
    settings = LoopSettings(seed=seed, rate=rate, controller=HoldSettings(), initial_error=INITIAL_ERROR)
    drawn = draw_bench(
        arms, settings.bench, seed=seed, ticks=2, period=1 / rate, initial_error=INITIAL_ERROR
    ).initial_error
    error = np.concatenate([drawn, np.zeros(len(controller.state) - len(drawn))])
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=acceleration)

    def probe(delay: float) -> Answer:
        # Half a period of wrong timing is another error, which a slow loop pays for dearly.
        late = replace(settings, drive=DriveSettings(delay=round(delay * rate)))
        run = run_batch(arms, settings=late, seeds=[seed], controller=controller, limits=limits)[0]
        return _answer(run, controller.state, period=1 / rate)

    predicted = longest_delay(model, controller.state, error, acceleration=acceleration)
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=predicted / 3, far=2 * predicted, predicted=predicted, ratio=ratio,
        unit=1 / rate,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Believed:
    """The filter's linear view of a tick, z = (state, extra) of length Z: A (Z, Z), B (Z,), gain (Z, n+1),
    H (n+1, Z).
    """

    matrix: Array
    response: Array
    gain: Array
    seen: Array


def believed_at(model: SampledModel, settings: LoopSettings, state: Array) -> Believed:
    """Return the view of the loop's filter, settled at an equilibrium: its gain is its answer to a nudged reading."""
    ekf = CompiledEkf(model, settings.estimator, noise=settings.sensors.covariance(model.arms))
    where, n = model.position_indices, model.dimension
    estimate = ekf.update(ekf.first(state), state[where])
    for _ in range(_SETTLED):
        estimate = ekf.step(estimate, 0.0, state[where])

    def answer(reading: Array) -> Array:
        after = ekf.step(estimate, 0.0, reading)
        return np.concatenate([after.state, after.extra])

    nudges = _NUDGE * np.eye(len(where))
    gain = np.array([answer(state[where] + d) - answer(state[where] - d) for d in nudges]).T / (2 * _NUDGE)
    a, b = (v[0] for v in model.linearised(state[None, :], np.zeros(1)))
    extras = ekf.program.process[3 : 3 + len(gain) - n]
    whole = np.asarray(block_diag(a, np.diag(extras)), dtype=np.float64)
    return Believed(whole, np.append(b, 0 * extras), gain, ekf.program.equations.observation)


def loop_matrix(
    plant: tuple[Array, Array], believed: Believed, *, gain: Array, positions: NDArray[np.intp], delay: int
) -> Array:
    """Return the map of a tick, of (x, z, commands on their way), all as deviations.

    plant: A (N, N), B (N,) between ticks; gain (N,) of the controller on the state that z begins with.
    """
    a, b = plant
    n, size = len(b), len(believed.response)
    whole = n + size + delay
    into = np.eye(whole)[n : n + size]
    # Commands: the oldest, which acts now, first.
    ahead = into
    for i in range(delay):
        ahead = believed.matrix @ ahead
        ahead[:, n + size + i] += believed.response
    command = -gain @ ahead[:n]
    acting = np.eye(whole)[n + size] if delay else command
    x_next = np.outer(b, acting)
    x_next[:, :n] += a
    z_next = believed.matrix @ into + np.outer(believed.response, acting)
    z_next = z_next + believed.gain @ (x_next[positions] - believed.seen @ z_next)
    queue = np.zeros((delay, whole))
    if delay:
        queue[:-1, n + size + 1 :] = np.eye(delay - 1)
        queue[-1] = command
    return np.vstack([x_next, z_next, queue])


def mismatch_border(
    arms: ArmChainParameters, equilibrium: Array, *, delay: float, ratio: float = 1.1, rate: float = MISMATCH_RATE,
    seed: int = 0, seconds: float = 20.0,
) -> Border:  # fmt: skip
    """Return the border of the plant's mismatch, in the direction drawn from `seed`, at `delay` s."""
    model = sampled_model(arms, rate)
    controller = hold_controller(equilibrium, model, HoldSettings(), seconds=seconds)
    ticks = round(delay * rate)
    settings = LoopSettings(
        seed=seed, rate=rate, controller=HoldSettings(), initial_error=1e-3, drive=DriveSettings(delay=ticks)
    )
    believed = believed_at(model, settings, controller.state)
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=30.0)

    def largest(mismatch: float) -> float:
        drawn = draw_bench(arms, settings.bench, seed=seed, ticks=2, period=1 / rate, mismatch=mismatch).plant.arms
        truth = SampledModel(model.equations, drawn.base(), period=model.period)
        a, b = (v[0] for v in truth.linearised(controller.state[None, :], np.zeros(1)))
        matrix = loop_matrix(
            (a, b), believed, gain=controller.gain, positions=model.position_indices, delay=ticks
        )  # fmt: skip
        return float(np.abs(np.linalg.eigvals(matrix)).max())

    def probe(mismatch: float) -> Answer:
        wrong = replace(settings, mismatch=mismatch)
        run = run_batch(arms, settings=wrong, seeds=[seed], controller=controller, limits=limits)[0]
        return _answer(run, controller.state, period=1 / rate)

    # Coarse first: the eigenvalue may come back into the circle.
    grid = np.geomspace(1e-3, 0.6, 60)
    beyond = [f for f in grid if largest(f) >= 1]
    predicted = float(beyond[0]) if beyond else None
    far = min(2.5 * predicted, 0.6) if predicted else 0.6
    near = predicted / 4 if predicted else 0.01
    return find_border(probe, x=delay, line=f"{1e3 * delay:g} ms", near=near, far=far, predicted=predicted, ratio=ratio)
