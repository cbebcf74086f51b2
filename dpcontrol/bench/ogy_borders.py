"""What is foretold of OGY without a run: how large pulses and how fine encoders keep an orbit.

An error grows by Λ_j, about λ^(1/k), from one of k sections to the next. Along the unstable direction w_j,

    ν_{j+1} = Λ_j ν_j + β_j p_j,    |p_j| ≤ limit:      |ν_j| ≤ c_j = (c_{j+1} + |β_j| limit) / Λ_j

can still be brought back, nothing larger. What the encoders leave unknown, the filter's errors e along the orbit, is
answered as if it were there: ξ_{j+1} = (A - BK) ξ_j - BK e_j is normal along w_j, of a mean that the encoders' zeros
give for all of a run and of variance s_j². The border is foretold without one run where |ν| < c at every section is as
likely as not, over all zeros within a count.

Source: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), 1196, for noise against the largest
pulse; Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2, for c.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from dpcontrol.control.compiled_ekf import EkfProgram
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.control.sampled import SampledModel
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.lab.loop import sampled_model
from dpcontrol.lab.sensors import SensorSettings
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.scenes.model import load_model
from dpcontrol.tubes.lyapunov import lyapunov_orbit

Array = NDArray[np.float64]

RATE = 1000.0
SECONDS = 6.0
LIMIT = 0.5
"""m/s²: small, so that authority ends before the linear range does."""
ESTIMATOR = EkfSettings(augment=())
"""As the shipped itineraries keep orbits; zeros being estimated would ask for a third more of the pulses at k = 16."""
LINEAR = 0.3
"""rad: a sine is its angle to 1.5 % up to here. Where pulses move an arm by more, nothing is foretold."""
_PERIODS = 3
_NODES = 7


@dataclass(frozen=True, eq=False)
class Task:
    """An orbit to be held, the arms that are believed and simulated alike, and the model between ticks."""

    orbit: SustainedOrbit
    arms: ArmChainParameters
    model: SampledModel

    def controller(self, sections: int, limit: float = LIMIT) -> OgyController:
        """Return the law by `sections` pulses a period, of at most `limit` m/s²; it learns nothing."""
        settings = OgySettings(sections=sections, pulse_limit=limit, parameter_error=0.0)
        return ogy_controller(self.orbit, self.model, settings, seconds=SECONDS)


def task(saddle: str = "down-up", energy: float = -0.07) -> Task:
    """Return the lab's orbit about a saddle at an energy in J."""
    model = load_model("lab")
    orbit = sustained_orbit(lyapunov_orbit(model.system, saddle, energy=energy), model.arms)
    return Task(orbit, model.arms, sampled_model(model.arms, RATE))


def encoders(counts: float) -> SensorSettings:
    """Return encoders of so many counts per turn; the cart's is fine."""
    return SensorSettings(counts=max(round(counts), 1), cart_resolution=1e-6)


def unknown(one: Task, counts: float) -> tuple[Array, Array, Array]:
    """Return Σ (K, N, N), the covariance of the filter's true errors e at each tick of a period, Φ (K, N, N) and
    E (K, N, n), their mean for each encoder's zero.

    e_i = Φ_i e_{i-1} + what the reading adds. The filter's gain is its answer to a reading, tick by tick; the errors
    are those of encoders of `counts` alone, of whose zeros the filter knows nothing.
    """
    noise = encoders(counts).covariance(one.arms.count)
    program = EkfProgram(one.model, ESTIMATOR)
    arms, n = one.arms.count, one.model.dimension
    lanes = program.inputs(noise, runs=arms + 2)
    out, where = np.empty((program.step.size_out, arms + 2)), program.slices
    count = round(one.orbit.period / one.model.period)
    step = one.orbit.period / count
    times = np.arange(count + 1) * step
    states, inputs = one.orbit.state(times[:-1]), one.orbit.input(times[:-1] + step / 2)
    matrices, _ = one.model.linearised(states, inputs)
    position = one.model.position_indices
    memory = program.first(states[0])
    # Outer arms carry the zeros of all joints within.
    shown = np.vstack([np.tril(np.ones((arms, arms))), np.zeros((1, arms))])
    sigma, mean = np.diag(np.square(ESTIMATOR.first_sigmas(arms)[:n])), np.zeros((n, arms))
    kept = []
    sizes = np.sqrt(np.diag(noise))
    for k in range(1, _PERIODS * count + 1):
        here = states[k % count]
        memory[:n] = states[(k - 1) % count]
        lanes[where["memory"]] = memory[:, None]
        lanes[where["command"]] = inputs[(k - 1) % count]
        lanes[where["measured"]] = here[position, None]
        # Each reading is nudged by its own noise: the estimate is linear in it.
        for j in range(arms + 1):
            lanes[where["measured"].start + j, j + 1] += sizes[j]
        program.step(lanes, out)
        gain = (out[:n, 1:] - out[:n, :1]) / sizes
        memory = out[program.out["memory"], 0].copy()
        moved = matrices[(k - 1) % count]
        rest = moved - gain @ moved[position]
        sigma, mean = rest @ sigma @ rest.T + gain @ noise @ gain.T, rest @ mean + gain @ shown
        kept.append((sigma, rest, mean))
    # From a phase-0 tick on, a period long.
    sigmas, steps, means = (np.array(part) for part in zip(*kept[-count - 1 : -1], strict=True))
    return sigmas, steps, means


@dataclass(frozen=True, eq=False)
class Room:
    """Along the unstable direction at each of k sections: the range c_j that pulses of 1 m/s² can bring back, the
    standard deviation s_j of what the encoders do to it, and its mean for each encoder's zero at half a count (k, n).
    """

    ranges: Array
    spreads: Array
    shifts: Array

    @property
    def margins(self) -> Array:
        """c_j over the root mean square of all that the encoders do (k,); zeros lie anywhere within a count."""
        return self.ranges / np.sqrt(self.spreads**2 + np.square(self.shifts).sum(axis=1) / 3)

    def survives(self, limit: float, periods: float) -> float:
        """Return the probability that a run of so many periods holds with pulses of up to `limit` m/s².

        A run has its zeros from its beginning to its end; over runs they lie anywhere within a count.
        """
        zeros, shares = np.polynomial.legendre.leggauss(_NODES)
        grid = np.stack(np.meshgrid(*[zeros] * self.shifts.shape[1]), axis=0).reshape(self.shifts.shape[1], -1)
        weights = np.prod(np.meshgrid(*[shares / 2] * self.shifts.shape[1]), axis=0).ravel()
        means, reach, size = self.shifts @ grid, limit * self.ranges[:, None], sqrt(2) * self.spreads[:, None]
        each = np.maximum(erf((reach - means) / size) + erf((reach + means) / size), 0.0) / 2
        return float(weights @ np.prod(each, axis=0) ** periods)


def room(one: Task, controller: OgyController, counts: float) -> Room:
    """Return what pulses can bring back of what encoders of `counts` do."""
    a, b = _maps(one, controller)
    growths, reaches, directions = _unstable(a, b)
    ranges, ahead = np.zeros(len(a)), 0.0
    for j in reversed(list(range(len(a))) * 40):
        ahead = (ahead + abs(reaches[j])) / growths[j]
        ranges[j] = ahead
    covariances, means = spreads(one, controller, counts)
    along = np.sqrt(np.einsum("ki,kij,kj->k", directions, covariances, directions))
    return Room(ranges, along, np.einsum("ki,kij->kj", directions, means) * np.pi / counts)


def largest_linear_pulse(one: Task, controller: OgyController) -> float:
    """Return the pulse in m/s² that moves an arm from one section to the next by as much as is still linear."""
    _, b = _maps(one, controller)
    return LINEAR / float(np.abs(b[:, : one.arms.count]).max())


def _maps(one: Task, controller: OgyController) -> tuple[Array, Array]:
    maps = one.orbit.section_maps(len(controller.times))
    return np.array([m.matrix for m in maps]), np.array([m.response for m in maps])


def spreads(one: Task, controller: OgyController, counts: float) -> tuple[Array, Array]:
    """Return what the encoders do to the state at each section: Ξ (k, N, N), its covariance, and X (k, N, n), its mean
    for each encoder's zero.
    """
    k = len(controller.times)
    maps = one.orbit.section_maps(k)
    a, b = _maps(one, controller)
    sigmas, steps, means = unknown(one, counts)
    ticks = np.rint(controller.times / one.orbit.period * len(sigmas)).astype(int) % len(sigmas)
    n = a.shape[-1]
    lasting = [_over(steps, ticks[j], ticks[(j + 1) % k]) for j in range(k)]
    spread, common, found = np.zeros((n, n)), np.zeros((n, n)), np.zeros((k, n, n))
    mean, shifts = np.zeros((n, means.shape[-1])), np.zeros((k, n, means.shape[-1]))
    for j in list(range(k)) * 60:
        found[j], shifts[j] = spread, mean
        closed = a[j] - np.outer(b[j], controller.gains[j])
        answer = -np.outer(b[j], controller.gains[j] @ maps[j].start.projection)
        error, both = sigmas[ticks[j]], closed @ common
        spread = closed @ spread @ closed.T + answer @ error @ answer.T + both @ answer.T + (both @ answer.T).T
        mean = closed @ mean + answer @ means[ticks[j]]
        # What a filter errs by lasts longer than from one section to the next where these are near together.
        common = (both + answer @ error) @ lasting[j].T
    return found, shifts


def _over(steps: Array, begin: int, end: int) -> Array:
    """Return the product of the steps after tick `begin` up to tick `end`, round the period."""
    out = np.eye(steps.shape[-1])
    for i in range(begin + 1, begin + 1 + ((end - begin - 1) % len(steps) + 1)):
        out = steps[i % len(steps)] @ out
    return out


def _unstable(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return Λ (k,), β (k,) and w (k, N) of unit length with w_{j+1} A_j = Λ_j w_j, β_j = w_{j+1} · B_j."""
    k = len(a)
    product = np.eye(a.shape[-1])
    for one in a:
        product = one @ product
    values, left = np.linalg.eig(product.T)
    w = np.real(left[:, np.argmax(np.abs(values))])
    directions, growths, reaches = np.zeros((k, len(w))), np.zeros(k), np.zeros(k)
    w = w / np.linalg.norm(w)
    for j in reversed(range(k)):
        before = w @ a[j]
        growths[j], reaches[j] = np.linalg.norm(before), w @ b[j]
        w = before / growths[j]
        directions[j] = w
    return growths, reaches, directions
