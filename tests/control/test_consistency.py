import numpy as np
import pytest
from estimator_runs import COUNT, MODEL, NOISE, SWING, Run, run
from scipy.stats import chi2
from shadowing_stand_in import LAB

from dpcontrol.control.consistency import (
    Health,
    Verdict,
    Watch,
    WatchSettings,
    chi_square_band,
    nees,
    share_inside,
)
from dpcontrol.control.ekf import CompiledEkf, EkfProgram
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.simulated_consistency import simulated_consistency
from dpcontrol.foundation.errors import InputError
from dpcontrol.loop.bench import SensorSettings

SHARE = 0.02  # About 95 %; the bar for a nominal plant with the noise that is modelled.
FAULT = 500  # Tick at which sensors fail.


def watched(flown: Run, *, augment: tuple[str, ...] = (), present: np.ndarray | None = None) -> list[Health]:
    """Health at all ticks, until the filter itself gives up."""
    ekf = CompiledEkf(MODEL, EkfSettings(augment=augment), noise=NOISE)
    watch = Watch(ekf, WatchSettings(), noise=NOISE, period=1e-3)
    health, estimate, out = watch.begin(), ekf.first(np.array(SWING)), []
    for k, command in enumerate(flown.commands.tolist()):
        here = None if present is None else present[k]
        measured = flown.measured(k)
        estimate = ekf.step(estimate, command, measured, here) if k else ekf.update(estimate, measured, here)
        health = watch.seen(health, estimate, measured, here)
        out.append(health)
    return out


def alarms(healths: list[Health]) -> set[Verdict]:
    return {health.verdict for health in healths} - {Verdict.CONSISTENT}


def test_bands_are_the_published_ones() -> None:
    # Chi-square with 3 degrees of freedom, 2.5 and 97.5 %: Abramowitz & Stegun, table 26.8.
    assert chi_square_band(3) == pytest.approx((0.215795, 9.34840), rel=1e-5)


def test_too_small_counts_as_outside_as_well_as_too_large() -> None:
    random = np.random.default_rng(4)
    values = random.chisquare(6, 40_000)
    assert share_inside(values, 6) == pytest.approx(0.95, abs=0.005)
    assert share_inside(values / 20, 6) < 0.2
    assert share_inside(values * 20, 6) < 0.2


def test_nees_is_the_squared_error_in_units_of_the_covariance() -> None:
    random = np.random.default_rng(5)
    root = random.standard_normal((4, 4))
    white = random.standard_normal((50, 4))
    assert nees(white @ root.T, np.broadcast_to(root @ root.T, (50, 4, 4))) == pytest.approx((white**2).sum(1))


@pytest.mark.parametrize("augment", [(), ("zeros",), ("friction", "parameters")])
def test_nis_and_nees_of_a_nominal_plant_lie_in_their_bands(augment: tuple[str, ...]) -> None:
    program = EkfProgram(MODEL, EkfSettings(augment=augment))
    commands = 0.5 * np.sin(2.5e-3 * np.arange(1500))
    found = simulated_consistency(program, NOISE, first=np.array(SWING), commands=commands, runs=60, seed=8)
    assert found.nis_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.nees_inside_95 == pytest.approx(0.95, abs=SHARE)
    assert found.mean_nis == pytest.approx(3.0, rel=0.02)
    assert found.mean_nees == pytest.approx(program.equations.dimension, rel=0.05)


def test_wrong_noise_and_missing_process_noise_are_seen() -> None:
    program = EkfProgram(MODEL, EkfSettings(augment=()))
    commands = np.zeros(1000)
    # Half the counts that are assumed: more error than assumed.
    coarse = np.array([4 * COUNT, 4 * COUNT, 1e-6])
    found = simulated_consistency(
        program, NOISE, first=np.array(SWING), commands=commands, runs=20, seed=1, steps=coarse
    )
    assert found.nis_inside_95 < 0.9
    exact = simulated_consistency(
        program, NOISE, first=np.array(SWING), commands=commands, runs=20, seed=1, process_noise=False
    )
    assert exact.nees_inside_95 < 0.93
    assert exact.mean_nees < 5.0


def test_rounding_to_counts_keeps_the_mean_and_puts_too_many_inside() -> None:
    # A rounding error is uniform: of the assumed variance, but without the Gaussian's tails.
    counts = 2000
    steps = np.array([2 * np.pi / counts] * 2 + [1e-6])
    noise = SensorSettings(counts=counts).covariance(2)
    program = EkfProgram(MODEL, EkfSettings(augment=()))
    commands = 0.5 * np.sin(2.5e-3 * np.arange(1000))
    found = simulated_consistency(
        program, noise, first=np.array(SWING), commands=commands, runs=40, seed=2, steps=steps
    )
    assert found.mean_nis == pytest.approx(3.0, rel=0.03)
    assert found.nis_inside_95 > 0.97


@pytest.mark.parametrize("seed", range(5))
def test_a_healthy_run_raises_no_alarm(seed: int) -> None:
    random = np.random.default_rng(seed)
    start = (*random.uniform(-3, 3, 2), *random.uniform(-6, 6, 2), 0.0, 0.0)
    flown = run(2, seed=seed, frequency=random.uniform(0.5, 10), amplitude=random.uniform(0, 3), start=start)
    ekf = CompiledEkf(MODEL, EkfSettings(augment=()), noise=NOISE)
    watch = Watch(ekf, WatchSettings(), noise=NOISE, period=1e-3)
    health, estimate = watch.begin(), ekf.first(np.array(start))
    for k, command in enumerate(flown.commands.tolist()):
        step = ekf.step(estimate, command, flown.measured(k)) if k else ekf.update(estimate, flown.measured(k))
        estimate, health = step, watch.seen(health, step, flown.measured(k))
        assert health.verdict is Verdict.CONSISTENT, health.reason


@pytest.mark.parametrize(("sensor", "name"), [(0, "joint 1"), (1, "joint 2"), (2, "cart's scale")])
@pytest.mark.parametrize("augment", [(), ("zeros",)])
def test_a_stuck_encoder_is_found_and_named(sensor: int, name: str, augment: tuple[str, ...]) -> None:
    flown = run(0.8)
    flown.relative[FAULT:, sensor] = flown.relative[FAULT, sensor]
    healths = watched(flown, augment=augment)
    assert alarms(healths[:FAULT]) == set()
    found = next(k for k, health in enumerate(healths) if health.verdict is Verdict.SENSOR)
    assert found < FAULT + 30
    told = [health.reason for health in healths if health.verdict is Verdict.SENSOR]
    assert all(name in reason for reason in told[:50])
    assert any("stuck" in reason for reason in told)


@pytest.mark.parametrize(("sensor", "name"), [(0, "joint 1"), (1, "joint 2")])
def test_counts_lost_at_once_are_found_and_named(sensor: int, name: str) -> None:
    flown = run(0.6)
    flown.relative[FAULT:, sensor] += 0.05
    healths = watched(flown)
    assert alarms(healths[:FAULT]) == set()
    assert healths[FAULT].verdict is Verdict.SENSOR
    assert f"{name} contradicts" in healths[FAULT].reason


@pytest.mark.parametrize("wrong", [0, 2])
def test_a_wrong_model_is_doubted_and_no_sensor_is_blamed(wrong: int) -> None:
    plant = LAB.base()
    plant[wrong] *= 1.2
    flown = run(2.0, base=plant)
    healths = watched(flown)
    assert alarms(healths) == {Verdict.DOUBTFUL}
    assert "parameters are off" in next(h.reason for h in healths if h.reason)
    # What is wrong can be estimated; then nothing is left to doubt.
    assert watched(flown, augment=("parameters",))[-1].verdict is Verdict.CONSISTENT


def test_an_estimate_that_is_lost_is_told_and_a_restart_heals_it() -> None:
    flown = run(1.0)
    ekf = CompiledEkf(MODEL, EkfSettings(augment=()), noise=NOISE)
    watch = Watch(ekf, WatchSettings(), noise=NOISE, period=1e-3)
    # A filter that is sure of rates that are wrong by 30 rad/s.
    wrong = np.array(SWING) + np.array([0.5, 0.5, 30, -30, 0, 0])
    estimate, health = ekf.first(wrong), watch.begin()
    sure = estimate.memory._replace(kept=ekf.program.first(wrong, np.full(6, 1e-4)))
    estimate = estimate._replace(memory=sure)
    seen = []
    for k in range(100):
        estimate = ekf.step(estimate, float(flown.commands[k]), flown.measured(k))
        health = watch.seen(health, estimate, flown.measured(k))
        seen.append(health.verdict)
    assert Verdict.DIVERGED in seen
    estimate, health = ekf.restarted(estimate, flown.measured(100)), watch.begin()
    for k in range(101, 1000):
        estimate = ekf.step(estimate, float(flown.commands[k]), flown.measured(k))
        health = watch.seen(health, estimate, flown.measured(k))
        assert health.verdict is Verdict.CONSISTENT, health.reason
    assert np.abs(estimate.state - flown.states[-1])[:2].max() < 5 * COUNT


@pytest.mark.parametrize("lost", [(1,), (0, 1, 2)])
def test_a_long_dropout_is_told_and_ends(lost: tuple[int, ...]) -> None:
    flown = run(1.0)
    present = np.ones((1000, 3), dtype=bool)
    present[FAULT : FAULT + 100, [*lost]] = False
    healths = watched(flown, present=present)
    blind = [k for k, health in enumerate(healths) if health.verdict is Verdict.BLIND]
    assert blind == list(range(FAULT + 50, FAULT + 100))
    assert alarms(healths) == {Verdict.BLIND}
    for i, name in enumerate(("joint 1", "joint 2", "cart's scale")):
        assert (name in healths[blind[0]].reason) == (i in lost)


def test_a_dropout_for_a_few_ticks_is_no_alarm() -> None:
    present = np.random.default_rng(3).random((1000, 3)) > 0.3
    assert alarms(watched(run(1.0), present=present)) == set()


def test_the_bound_on_the_mean_is_the_quantile_of_equal_weights() -> None:
    ekf = CompiledEkf(MODEL, EkfSettings(augment=()), noise=NOISE)
    watch = Watch(ekf, WatchSettings(window=0.2), noise=NOISE, period=1e-3)
    freedom = 3 * 399
    assert chi2.sf(watch.bound * freedom, freedom) == pytest.approx(1e-9, rel=1e-3)
    with pytest.raises(InputError, match="gap"):
        WatchSettings(gap=0.0)
