"""Errors of the first estimates, compared with the best possible ones.

The best possible estimate from 21 readings is the mean of the posterior of zeros and initial angles. Both are uniform
within their bounds, and the readings have only rounding errors. The motion is linearised about the true one, and the
motion of the cart is known, so no estimator can be better. It knows the initial rates to the filter's own `first_rate`
and the arms to ±5 %. The outer arm's encoder sits on the inner arm, so both zeros add up in its angle. About five
minutes of one core.
"""

from dataclasses import replace

import coarse_benches
import numpy as np
import pytest
from numpy.typing import NDArray

from dpcontrol.control.interface import sampled_model
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.reference import Reference
from dpcontrol.runs.campaign import cases_of

pytestmark = pytest.mark.benchmark

Array = NDArray[np.float64]

RUNS, FIRST_SEED = 100, 70_000
TICKS = 20
ARMS = 0.05
"""Share to which the arms are known."""
NEAR = 1.5
"""Times the best possible that the worst of the filter's errors may be; 1.1 to 1.3 as measured."""


@pytest.mark.parametrize("name", ["outer-turn", "cross", "up-up"])
def test_the_first_estimates_come_near_to_the_best_possible(name: str) -> None:
    plan = make_plan(load_itinerary(name))
    arms, reference = plan.itinerary.model.arms, plan.reference
    (case,) = cases_of(plan.itinerary, fixed=coarse_benches.BENCH, over={})
    controller = Assembly(reference, arms, case.loop).controller
    errors, best = list[float](), list[float]()
    for seed in range(FIRST_SEED, FIRST_SEED + RUNS):
        loop = replace(case.loop, seed=seed)
        ticks = Assembly(reference, arms, loop, law=controller).simulate().ticks
        assert ticks.truth is not None
        angles = np.abs(ticks.estimates - ticks.truth)[:, : arms.count].max(axis=1)
        errors.append(float(angles[TICKS:].max()))
        best.append(posterior_error(reference, arms, loop))
    assert max(errors) < NEAR * max(best)


def posterior_error(reference: Reference, arms: ArmChainParameters, loop: LoopSettings) -> float:
    """Return the best possible error of the worse angle, rad."""
    draw = loop.draw(arms, ticks=TICKS + 1)
    true, wrong, zeros = draw.plant.arms, draw.initial_error, draw.zeros
    n = arms.count
    first = reference.state(0.0).ravel() + np.pad(wrong, (0, n + 2))
    commands = reference.input(np.arange(TICKS) / loop.rate).ravel()

    def angles(state: Array, parameters: ArmChainParameters) -> Array:
        model, out = sampled_model(parameters, loop.rate), [state]
        for command in commands:
            out.append(model.step(out[-1], command))
        return np.array(out)[:, :n].ravel()

    def slope(state: Array, parameters: tuple[ArmChainParameters, ArmChainParameters] = (true, true)) -> Array:
        back, on = parameters
        return (angles(first + state, on) - angles(first - state, back)) / (2 * STEP)

    by_state = np.column_stack([slope(STEP * row) for row in np.eye(2 * n + 2)[: 2 * n]])
    by_arms, off, spread = [], [], []
    for name in ("mass", "centre_of_mass", "length", "inertia", "viscous"):
        for k, (known, value) in enumerate(zip(getattr(arms, name), getattr(true, name), strict=True)):
            both = [list(getattr(true, name)) for _ in range(2)]
            both[0][k] -= STEP * known
            both[1][k] += STEP * known
            back, on = (replace(true, **{name: tuple(values)}) for values in both)
            by_arms.append(slope(np.zeros(2 * n + 2), (back, on)))
            off.append(value / known - 1)
            spread.append(5.0 if name == "viscous" else 1.0)
    # With relative encoders, each absolute angle is the sum of its reading and all inner ones.
    summed = np.tril(np.ones((n, n)))
    by_zeros = np.tile(summed, (TICKS + 1, 1))
    count = loop.sensors.steps(n)[0]
    rounding = np.random.default_rng(loop.seed).uniform(-0.5, 0.5, (TICKS + 1, n)) * count @ summed.T
    noise = np.kron(np.eye(TICKS + 1), summed @ summed.T) * count**2 / 12
    start, rates, parts = by_state[:, :n], by_state[:, n:], np.column_stack(by_arms)
    seen = start @ wrong + by_zeros @ zeros + rounding.ravel() + parts @ np.array(off)
    # What is uniform counts with its variance.
    loose = parts * (ARMS / np.sqrt(3) * np.array(spread))
    covariance = noise + loose @ loose.T + loop.estimator.first_rate**2 * rates @ rates.T
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    found = mean_of_zeros(*(white @ one for one in (seen, start, by_zeros)), loop)
    return float(np.abs(summed @ (found - zeros)).max())


STEP = 1e-5
"""Of angles, rates and shares, either way, in differences."""


def mean_of_zeros(seen: Array, start: Array, by_zeros: Array, loop: LoopSettings) -> Array:
    """Return the posterior's mean (2,), rad, given whitened readings and what they change by with angles and zeros."""
    grid = np.linspace(-1, 1, 161) * loop.sensors.zero_error
    zeros = np.array(np.meshgrid(grid, grid, indexing="ij")).reshape(2, -1)
    # For each pair of zeros the first angles follow from the readings.
    solve = np.linalg.pinv(start)
    left = seen[:, None] - by_zeros @ zeros
    angles = solve @ left
    likelihood = -(((left - start @ angles) ** 2).sum(axis=0)) / 2
    likelihood[(np.abs(angles) > loop.initial_error).any(axis=0)] = -np.inf
    weights = np.exp(likelihood - likelihood.max())
    return zeros @ weights / weights.sum()
