from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.ekf import CompiledEkf, FilterEquations, Timing, packed
from dpcontrol.control.estimator_settings import Augment, EkfSettings
from dpcontrol.control.interface import Estimate, SampledModel, sampled_model
from dpcontrol.dynamics.chain import Friction, Level, arm_chain_equations
from dpcontrol.loop.bench import SensorSettings

ROUNDING = 1e-9  # Of two filters over thousands of ticks, relative to standard deviations; NIS loses most.
SAMPLED = 0.03  # Relative, of a mean of 40,000 draws whose standard deviation is about the mean.

NOISE = SensorSettings().covariance(2)
ROOT = np.linalg.cholesky(NOISE)
STATE = np.array([0.4, 2.8, 6.0, -9.0, 0.1, -0.3])
POSITIONS = np.eye(6)[[0, 1, 4]]
MODEL = SampledModel(arm_chain_equations(2, Level.CART), LAB.base(), period=1e-3)
PLAIN = EkfSettings(augment=())


@pytest.fixture(scope="module")
def plain() -> CompiledEkf:
    return CompiledEkf(MODEL, PLAIN, noise=NOISE)


@pytest.fixture(scope="module")
def zeros() -> CompiledEkf:
    return CompiledEkf(MODEL, EkfSettings(augment=("zeros",)), noise=NOISE)


def swing(ticks: int, *, root: np.ndarray = ROOT) -> tuple[list[float], np.ndarray, np.ndarray]:
    """Commands, true states and measured positions of a free swing with a moving cart."""
    random = np.random.default_rng(3)
    truth, commands = STATE + 0.01 * random.standard_normal(6), (2 * np.sin(np.arange(ticks) / 60)).tolist()
    states = np.empty((ticks, 6))
    for k, command in enumerate(commands):
        truth = states[k] = MODEL.step(truth, command)
    return commands, states, states @ POSITIONS.T + random.standard_normal((ticks, 3)) @ root.T


def cart_noise(model: SampledModel, state: np.ndarray, command: float, density: float) -> np.ndarray:
    """Return the covariance per period due to white acceleration of the cart, m/s²/√Hz, arms included.

    By the mean over the stages of Runge-Kutta of the rates' slopes by the command.
    """
    t, half, rate = model.period, model.period / 2, model.equations.function()

    def slope(x: np.ndarray) -> np.ndarray:
        return np.array(rate(x, command, model.parameters))[:, 0]

    first = slope(state)
    second = slope(state + half * first)
    third = slope(state + half * second)
    places = (state, state + half * first, state + half * second, state + t * third)
    pushed = [np.array(rate(x, 1.0, model.parameters) - rate(x, 0.0, model.parameters))[:, 0] for x in places]
    mean = np.average(pushed, axis=0, weights=(1, 2, 2, 1))
    reach = np.zeros((6, 2))
    for p, v in zip((0, 1, 4), (2, 3, 5), strict=True):
        reach[p, 0] = reach[v, 1] = mean[v]
    return density**2 * reach @ np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]) @ reach.T


class TextbookFilter:
    """The extended Kalman filter as the textbook writes it, in plain matrices: what the compiled one is compared with.

    It keeps state (6,), covariance (6, 6), innovation (3,) and nis of the last step; noise (3, 3).
    Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.2 and 10.3.
    """

    def __init__(self, model: SampledModel, settings: EkfSettings, *, noise: np.ndarray, state: np.ndarray) -> None:
        self.model, self.settings, self.noise = model, settings, noise
        self.observation = np.eye(6)[[0, 1, 4]]
        s = settings
        self.state = np.array(state, dtype=float)
        self.covariance = np.diag(np.square([s.first_angle] * 2 + [s.first_rate] * 2 + [s.first_cart] * 2))
        self.innovation, self.nis = np.zeros(3), float("nan")

    @property
    def sigmas(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))

    def predict(self, command: float) -> None:
        """One period on: white accelerations of the settings' density, the cart's and each arm's."""
        t, s = self.model.period, self.settings
        following = self.model.step(self.state, command)
        a = self.model.linearised(self.state[None], np.array([command]))[0][0]
        change = (following - self.state)[2:4] / t
        densities = s.rate_noise**2 + 2 * s.correlation_time * (s.parameter_error * change) ** 2
        q = np.zeros((6, 6))
        for p, v, d in zip((0, 1), (2, 3), densities, strict=True):
            q[p, p], q[p, v], q[v, p], q[v, v] = d * t**3 / 3, d * t**2 / 2, d * t**2 / 2, d * t
        q += cart_noise(self.model, self.state, command, s.cart_noise)
        self.state, self.covariance = following, a @ self.covariance @ a.T + q

    def update(self, measured: np.ndarray) -> None:
        """Take the positions in, by Joseph's form of the covariance; angles in a swing need no wrapping."""
        h, p = self.observation, self.covariance
        s = h @ p @ h.T + self.noise
        gain = np.linalg.solve(s, h @ p).T
        self.innovation = measured - h @ self.state
        self.nis = float(self.innovation @ np.linalg.solve(s, self.innovation))
        self.state = self.state + gain @ self.innovation
        left = np.eye(6) - gain @ h
        self.covariance = left @ p @ left.T + gain @ self.noise @ gain.T


def test_readings_of_unknown_age_are_as_surprising_as_the_filter_expects() -> None:
    # The cart rests by the estimate, within 0.05 m/s: an error of its velocity must not pass for anything else.
    state, sigmas = np.array([0.4, 2.8, 6.0, -9.0, 0.1, 0.0]), np.array([1e-4, 1e-4, 0.3, 0.3, 1e-6, 0.05])
    spread, random, count = 1e-3, np.random.default_rng(8), 40_000
    truth = state + sigmas * random.standard_normal((count, 6))
    ages = spread * (random.random((count, 1)) - 0.5)
    readings = truth[:, [0, 1, 4]] - ages * truth[:, [2, 3, 5]] + random.standard_normal((count, 3)) @ ROOT.T
    measured, timing = ca.SX.sym("measured", 3), Timing(ca.SX(0), ca.SX(spread**2 / 12), ca.SX(state[[2, 3, 5]]))
    filters = FilterEquations(MODEL.equations, MODEL.period, ())
    nis = filters.updated(
        ca.SX(state), ca.SX(np.diag(sigmas**2)), measured, ca.SX.ones(3), ca.SX(packed(NOISE)), timing
    )[3]
    found = np.array(ca.Function("nis", [measured], [nis])(readings.T))
    # The mean NIS of a consistent filter is the number of positions.
    assert found.mean() == pytest.approx(3, rel=SAMPLED)


def test_a_swing_gives_the_numbers_of_the_textbooks_filter(plain: CompiledEkf) -> None:
    estimate, expected = plain.first(STATE), TextbookFilter(MODEL, PLAIN, noise=NOISE, state=STATE)
    assert estimate.sigmas == pytest.approx(expected.sigmas)
    for command, _, measured in zip(*swing(3000), strict=True):
        estimate = plain.step(estimate, command, measured)
        expected.predict(command)
        expected.update(measured)
        sigmas = expected.sigmas
        assert (np.abs(estimate.state - expected.state) <= ROUNDING * sigmas + 1e-15).all()
        assert estimate.sigmas == pytest.approx(sigmas, rel=ROUNDING)
        assert estimate.nis == pytest.approx(expected.nis, rel=1e-6, abs=1e-6)
        assert estimate.innovation == pytest.approx(expected.innovation, abs=1e-14)
    assert plain.covariance(estimate) == pytest.approx(expected.covariance, rel=ROUNDING, abs=1e-20)


@pytest.mark.parametrize("missing", [(0,), (2,), (0, 1), (0, 1, 2)])
def test_a_missing_position_is_as_if_there_were_no_such_sensor(zeros: CompiledEkf, missing: tuple[int, ...]) -> None:
    estimate = zeros.first(STATE)
    for command, _, measured in zip(*swing(30), strict=True):
        estimate = zeros.step(estimate, command, measured)
    present = np.ones(3, dtype=bool)
    present[[*missing]] = False
    holed = POSITIONS @ estimate.state + np.array([2e-4, -1e-4, 3e-6])
    holed[~present] = np.nan
    updated = zeros.update(estimate, holed, present)
    h = zeros.equations.observation[present]
    p, r = zeros.covariance(estimate), NOISE[np.ix_(present, present)]
    z = np.concatenate([estimate.state, estimate.extra])
    s, y = h @ p @ h.T + r, holed[present] - h @ z
    after = z + p @ h.T @ np.linalg.solve(s, y)
    assert np.concatenate([updated.state, updated.extra]) == pytest.approx(after, abs=1e-11)
    posterior = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h)
    assert updated.sigmas == pytest.approx(np.sqrt(np.diag(posterior)), rel=1e-4)
    assert updated.nis == pytest.approx(y @ np.linalg.solve(s, y), rel=1e-9)
    assert updated.used == present.sum()
    assert (updated.innovation[~present] == 0).all()
    # And the next tick, with all of them, knows nothing of the hole.
    assert zeros.update(updated, POSITIONS @ updated.state).used == 3


def test_looking_ahead_is_the_model_with_what_the_extras_do() -> None:
    arms = replace(LAB, coulomb=(1e-3, 2e-3))
    model = sampled_model(arms, 1000.0)
    ekf = CompiledEkf(model, EkfSettings(augment=("drive", "friction", "parameters")), noise=NOISE)
    assert ekf.extra_names == ("drive", "friction_1", "friction_2", "M11", "M22", "S1", "S2")
    first = ekf.first(STATE)
    memory = first.memory.copy()
    memory[6:13] = extra = np.array([0.4, 0.3, -0.2, 0.05, -0.04, 0.03, 0.02])
    estimate = Estimate(memory[:6], memory[6:13], first.sigmas, first.innovation, 0.0, 3, memory)
    # Base parameters: M11, M12, M22, G1, G2, S1, S2, k1, k2, c1, c2 and the smoothing, which stays.
    errors = [extra[3], 0, extra[4], extra[5], extra[6], extra[5], extra[6]]
    factors = np.array([*np.exp(errors), *[1 + extra[1], 1 + extra[2]] * 2, 1])
    changed = SampledModel(model.equations, arms.base() * factors, period=1e-3)
    fades = np.exp(-1e-3 / ekf.settings.drive_time)
    expected = changed.step(changed.step(STATE, 2.0 + 0.4), -1.0 + 0.4 * fades)
    assert ekf.ahead(estimate, [2.0, -1.0]) == pytest.approx(expected, abs=1e-13)
    assert (ekf.ahead(estimate, []) == STATE).all()


def smallest(covariance: np.ndarray) -> float:
    """Smallest eigenvalue of the correlations, -1 if a variance is not positive."""
    variances = np.diag(covariance)
    if not (variances > 0).all():
        return -1.0
    return float(np.linalg.eigvalsh(covariance / np.sqrt(np.outer(variances, variances))).min())


def test_josephs_form_holds_where_the_plain_form_breaks() -> None:
    # A prior seventeen orders above the noise: (I - K H) P alone leaves only rounding, of either sign.
    share = 1e-10
    settings = EkfSettings(augment=(), rate_noise=3e-7, cart_noise=1e-8, parameter_error=1e-7)
    ekf = CompiledEkf(MODEL, settings, noise=NOISE * share)
    estimate, h = ekf.first(STATE), POSITIONS
    p = ekf.covariance(estimate)
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + NOISE * share)
    assert smallest(p - gain @ h @ p) < 0.0
    for command, _, measured in zip(*swing(500, root=ROOT * np.sqrt(share)), strict=True):
        estimate = ekf.step(estimate, command, measured)
        assert smallest(ekf.covariance(estimate)) > 0.01


def test_a_restart_trusts_the_positions_and_little_else(zeros: CompiledEkf) -> None:
    estimate = zeros.first(STATE)
    measured = np.array([1.0, -2.0, 0.2])
    lost = estimate._replace(state=np.array([9.0, np.nan, 400.0, np.nan, 9.0, 9.0]))
    begun = zeros.restarted(lost, measured)
    assert begun.state[[0, 1, 4]] == pytest.approx(measured)
    assert np.isfinite(begun.state).all()
    assert not begun.extra.any()
    assert np.isfinite(zeros.step(begun, 0.0, measured).sigmas).all()
    # A position that is not read is the last estimate's, and one that is not known at all is zero.
    assert zeros.restarted(lost, np.array([np.nan, np.nan, 0.2])).state[[0, 1, 4]].tolist() == [9.0, 0.0, 0.2]


@pytest.mark.parametrize("arms", [1, 2])
def test_friction_errors_scale_every_law_and_not_the_smoothing(arms: int) -> None:
    equations = arm_chain_equations(arms, Level.CART, friction=(Friction.COULOMB,))
    extra = {f"friction_{i + 1}": ca.SX(0.5 - 0.9 * i) for i in range(arms)}
    parameters = ca.SX.sym("p", equations.parameters.shape[0])
    predicted = FilterEquations(equations, 1e-3, (Augment.FRICTION,))._parameters(parameters, extra)
    factors = np.array(ca.Function("factors", [parameters], [predicted])(1.0)).ravel()
    friction = [1.5, 0.6][:arms]
    assert factors[-2 * arms - 1 :] == pytest.approx([*friction, *friction, 1.0])
    assert (factors[: -2 * arms - 1] == 1.0).all()
