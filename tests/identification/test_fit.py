"""Fits of swings: slopes, parameters, outliers and chaos; experiments compared by the information of such fits."""

from dataclasses import replace

import numpy as np
import pytest
from quick_rate import quick_rate
from scipy.integrate import solve_ivp

from dpcontrol.dynamics.chain import Friction, Level, base_from_ratios, base_ratios, equations_of, with_laws
from dpcontrol.identification.fit import (
    Design,
    DesignSettings,
    Swing,
    SwingFit,
    Swings,
    design_experiments,
    digits,
    fit_swings,
)
from dpcontrol.identification.identify import cut_into_swings
from dpcontrol.identification.windows import FitSettings
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.recording import simulated_recording

# Runge-Kutta at 1 ms and DOP853 at 1e-12 over half a second differ by the Coulomb step, rad/s.
STEPPED = 5e-6
# Compared with central differences of DOP853; steps of 1 ms across the Coulomb step cause 1e-4 of a slope.
DIFFERENCES = 5e-4
# Without noise, only the integrator's errors remain.
RECOVERED = 1e-5

ARMS = replace(with_laws(load_model("lab").arms, tuple(Friction)), coulomb=(3e-4, 2e-4), quadratic=(2e-3, 1.7e-3))
RATIOS = base_ratios(ARMS)
N = 4


def flown(state: np.ndarray, times: np.ndarray, ratios: np.ndarray = RATIOS, u: float = 0.0) -> np.ndarray:
    rate = quick_rate(equations_of(ARMS, Level.CART))
    base, start = np.array(base_from_ratios(ratios, ARMS)), np.append(state, [0.0, 0.0])

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return np.array(rate(x, u, base)).ravel()

    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    return solve_ivp(slope, (0.0, times[-1]), start, t_eval=times, **tight).y[:N].T


@pytest.fixture(scope="module")
def model() -> Swings:
    """Compiled once for this file."""
    return Swings(ARMS)


@pytest.mark.parametrize("u", [0.0, 3.0])
def test_states_and_slopes_agree_with_scipy(model: Swings, u: float) -> None:
    start, times = np.array([0.9, -0.4, 1.0, -2.0]), np.linspace(0.0, 0.5, 501)
    cart = {"accelerations": np.full((1, 501), u), "velocities": u * times[None]}
    states, slopes = model.flown(start[None], RATIOS, period=np.array([1e-3]), samples=501, **cart)
    assert np.abs(states[0] - flown(start, times, u=u)).max() < STEPPED
    # An angle, a rate, ratios of inertia and weight, and one of each friction law.
    for column in (1, 2, N, N + 3, N + 5, N + 6, N + 9) if u else (0, 3, N + 1, N + 2, N + 4):
        step = np.zeros(N + len(RATIOS))
        step[column] = 1e-4 * (RATIOS[column - N] if column >= N else 1.0) or 1e-5
        ahead = flown(start + step[:N], times, RATIOS + step[N:], u)
        behind = flown(start - step[:N], times, RATIOS - step[N:], u)
        expected = (ahead - behind) / (2 * step[column])
        assert np.abs(slopes[0, :, :, column] - expected).max() < DIFFERENCES * max(1.0, np.abs(expected).max())


def swings_from(starts: list[list[float]], seconds: float = 2.0, ratios: np.ndarray = RATIOS) -> list[Swing]:
    times = np.arange(round(seconds / 2e-3) + 1) * 2e-3
    return [Swing(flown(np.array(s), times, ratios)[:, :2], 2e-3) for s in starts]


def fitted(model: Swings, swings: list[Swing], first: np.ndarray, **settings: float) -> SwingFit:
    known = {"zeros": np.zeros((1, 2)), "free": np.ones(len(first), dtype=bool), "free_zeros": False}
    return fit_swings(model, swings, parameters=first, settings=FitSettings(**settings), **known)


@pytest.fixture(scope="module")
def exact() -> list[Swing]:
    """Three swings of moderate height."""
    return swings_from([[1.0, 0.3, 0.0, 0.0], [-0.4, 1.1, 0.0, 0.0], [0.8, -0.9, 1.0, 0.0]])


@pytest.mark.slow
def test_ratios_are_recovered_from_a_guess_with_an_error_of_a_tenth(model: Swings, exact: list[Swing]) -> None:
    first = RATIOS * np.where(np.arange(len(RATIOS)) < 4, 1.0, 3.0)
    first[:4] *= [1.1, 0.95, 1.08, 0.93]
    fit = fitted(model, exact, first)
    assert fit.converged, fit.status
    assert fit.parameters[:4] == pytest.approx(RATIOS[:4], rel=RECOVERED)
    assert fit.gap < 1e-6


def test_outliers_have_little_effect_on_the_robust_fit(model: Swings, exact: list[Swing]) -> None:
    random = np.random.default_rng(3)
    spoiled = []
    for swing in exact:
        angles = swing.angles + random.normal(0, 5e-5, swing.angles.shape)
        angles[random.random(len(angles)) < 0.02, 1] += 0.05
        spoiled.append(replace(swing, angles=angles))
    robust, squares = fitted(model, spoiled, RATIOS), fitted(model, spoiled, RATIOS, robust=0.0)
    off = [np.abs(fit.parameters[:4] / RATIOS[:4] - 1).max() for fit in (robust, squares)]
    assert off[0] < 2e-4
    assert off[1] > 3 * off[0]


@pytest.mark.slow
def test_a_chaotic_swing_requires_short_windows(model: Swings) -> None:
    high = swings_from([[3.0, 1.5, 0.0, 0.0], [2.6, -2.0, 0.0, 0.0]], seconds=3.0)
    first = RATIOS * np.where(np.arange(len(RATIOS)) < 4, 1.01, 1.0)
    windows = fitted(model, high, first)
    whole = fitted(model, high, first, window=10.0, iterations=8)
    assert windows.converged
    assert windows.parameters[:4] == pytest.approx(RATIOS[:4], rel=1e-4)
    assert whole.rms.max() > 100 * windows.rms.max()


def test_fitted_friction_is_not_negative(model: Swings) -> None:
    without = base_ratios(replace(ARMS, viscous=(0.0, 0.0), coulomb=(0.0, 0.0), quadratic=(0.0, 1.7e-3)))
    fit = fitted(model, swings_from([[1.0, 0.3, 0.0, 0.0], [-0.4, 1.1, 0.0, 0.0]], ratios=without), RATIOS)
    assert (fit.parameters[4:] >= 0).all()
    assert fit.parameters[4:9] == pytest.approx(np.zeros(5), abs=0.02)


LAB = load_model("lab").arms
QUICK = DesignSettings(seconds=1.5, steps=3, amplitudes=(1.0, 2.0), frequencies=(0.8, 2.0))


@pytest.fixture(scope="module")
def design() -> Design:
    """A small comparison of the lab's pendulum."""
    return design_experiments(LAB, settings=QUICK)


def test_information_agrees_with_a_fit_to_the_same_swing(design: Design) -> None:
    best = next(e for e in design.ranked() if e.kind == "swing")
    recording = simulated_recording(LAB, [np.array(best.angles)], seconds=QUICK.seconds, period=QUICK.period)
    swings, settings = cut_into_swings([recording], 2, 10.0)[0], FitSettings(robust=0.0, window=0.4)
    first = {"parameters": base_ratios(LAB), "zeros": np.zeros((1, 2))}
    fit = fit_swings(Swings(LAB), swings, **first, free=np.ones(6, dtype=bool), free_zeros=True, settings=settings)
    # Zeros are eliminated, slopes are over logarithms, and both angles have the same rounding variance.
    whole, m = fit.information, 6
    reduced = whole[:m, :m] - whole[:m, m:] @ np.linalg.solve(whole[m:, m:], whole[m:, :m])
    sigma = 2 * np.pi / QUICK.counts / np.sqrt(12)
    expected = reduced * np.outer(fit.parameters, fit.parameters) / sigma**2
    # The errors of the fit's ratios are due to rounding, with a few percent for friction.
    assert digits(best.matrix) == pytest.approx(digits(expected), abs=0.05)


def test_higher_swings_and_stronger_drives_give_more_information(design: Design) -> None:
    swings = [e for e in design.experiments if e.kind == "swing" and e.angles[0] == 0.0 and e.angles[1] > 0]
    low, high = (pick(swings, key=lambda e: e.angles[1]) for pick in (min, max))
    assert high.information > low.information
    drives = {(e.amplitude, e.frequency): e.information for e in design.experiments if e.kind == "cart"}
    assert all(drives[2.0, f] > drives[1.0, f] for f in QUICK.frequencies)
    # A pair gives more than either of its experiments.
    first, second = design.best_pair()
    assert digits(first.matrix + second.matrix) > max(first.information, second.information)
    assert all(e.information <= first.information for e in design.ranked())


def test_swings_that_magnify_errors_and_drives_beyond_the_track_are_not_usable(design: Design) -> None:
    assert any(not e.usable and e.amplification > 20 for e in design.experiments)
    short = design_experiments(LAB, settings=replace(QUICK, track=0.02))
    assert not any(e.usable for e in short.experiments if e.kind == "cart" and e.frequency < 1)
