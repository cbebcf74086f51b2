import numpy as np
import pytest
from estimator_runs import MODEL, NOISE, estimated, run

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings


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
