import numpy as np
import pytest
from estimator_runs import MODEL, NOISE, estimated, run
from shadowing_stand_in import LAB

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings

ZERO = 1e-3  # rad, after four seconds of swinging: a hundredth of what harms a run.
SHARE = 0.01  # Of base parameters, after four seconds.


@pytest.mark.slow
@pytest.mark.parametrize("zeros", [(0.03, -0.03), (0.03, 0.03)])
def test_encoder_zeros_are_found_while_swinging(zeros: tuple[float, float]) -> None:
    ekf = CompiledEkf(MODEL, EkfSettings(augment=("zeros",)), noise=NOISE)
    flown = run(4, zeros=zeros)
    last = estimated(ekf, flown)[-1]
    assert ekf.extra_names == ("zero_1", "zero_2")
    assert last.extra == pytest.approx(zeros, abs=ZERO)
    assert last.state[:2] == pytest.approx(flown.states[-1][:2], abs=ZERO)
    blind = estimated(CompiledEkf(MODEL, EkfSettings(augment=()), noise=NOISE), flown)[-1]
    assert np.abs(blind.state[:2] - flown.states[-1][:2]).max() > 10 * ZERO


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_parameters_wrong_by_a_tenth_are_found_while_swinging(seed: int) -> None:
    plant = LAB.mismatched(0.1, np.random.default_rng(seed)).base()
    augment = ("zeros", "friction", "parameters")
    ekf = CompiledEkf(MODEL, EkfSettings(augment=augment, parameter_error=1e-3, rate_noise=1e-2), noise=NOISE)
    last = estimated(ekf, run(4, base=plant, zeros=(0.02, -0.01), seed=seed))[-1]
    found = dict(zip(ekf.extra_names, last.extra, strict=True))
    # Only ratios matter: over M12, the second of M11, M12, M22, G1, G2, S1, S2, k1, k2.
    true = (plant / plant[1]) / (LAB.base() / LAB.base()[1]) - 1
    for name, place in (("M11", 0), ("M22", 2), ("S1", 5), ("S2", 6)):
        assert found[name] == pytest.approx(np.log1p(true[place]), abs=SHARE)
    assert found["zero_1"] == pytest.approx(0.02, abs=ZERO)
    sigmas = last.sigmas[6:]
    for i, name in enumerate(ekf.extra_names):
        if name.startswith("friction"):
            assert abs(found[name] - true[6 + int(name[-1])]) < 4 * sigmas[i]


@pytest.mark.slow
def test_unobservable_errors_keep_their_uncertainty_at_rest() -> None:
    hanging = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    still = run(2, amplitude=0.0, start=hanging)
    still.relative[:] = 0.0
    ekf = CompiledEkf(MODEL, EkfSettings(augment=("disturbance", "parameters")), noise=NOISE)
    last = estimated(ekf, still, start=hanging)[-1]
    known = dict(zip(ekf.extra_names, last.sigmas[6:], strict=True))
    prior = ekf.settings.model_error
    # Inertia needs accelerations, and an angle's zero within a disturbance is not told from it.
    assert known["M11"] > 0.9 * prior
    assert known["S1"] > 0.9 * prior
    moving = estimated(ekf, run(2))[-1]
    assert dict(zip(ekf.extra_names, moving.sigmas[6:], strict=True))["M11"] < 0.2 * prior


@pytest.mark.slow
def test_a_lumped_disturbance_is_followed() -> None:
    flown = run(3, torque=2.0)
    plain = estimated(CompiledEkf(MODEL, EkfSettings(augment=(), parameter_error=1e-3), noise=NOISE), flown)
    # It is drawn towards zero the more, the sooner it is expected to fade.
    settings = EkfSettings(augment=("disturbance",), disturbance_time=1.0, parameter_error=1e-3)
    ekf = CompiledEkf(MODEL, settings, noise=NOISE)
    told = estimated(ekf, flown)
    mean = np.mean([e.extra for e in told[1000:]], axis=0)
    assert mean == pytest.approx([0.0, 2.0], abs=0.3)
    late = slice(1000, None)
    errors = [np.array([e.state[3] for e in es[late]]) - flown.states[late, 3] for es in (plain, told)]
    assert np.abs(errors[1].mean()) < 0.5 * np.abs(errors[0].mean())
