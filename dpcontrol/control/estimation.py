"""From settings to estimators."""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings, EstimatorSettings, FilterpyEkfSettings, UkfSettings
from dpcontrol.control.interface import Estimator, SampledModel

ESTIMATORS: dict[str, type[EstimatorSettings]] = {
    settings.kind: settings for settings in (EkfSettings, UkfSettings, FilterpyEkfSettings)
}
"""The settings of each kind of estimator, by its name in an itinerary."""


def make_estimator(settings: EstimatorSettings, model: SampledModel, *, noise: NDArray[np.float64]) -> Estimator:
    """Return the estimator of `settings` for `model`; noise (n+1, n+1): of the measured positions.

    Raises:
        InputError: the noise has the wrong shape or is no covariance.
    """
    if isinstance(settings, EkfSettings):
        return CompiledEkf(model, settings, noise=noise)
    # filterpy takes a second to import.
    from dpcontrol.control.ukf import FilterpyEkf, Ukf

    return (
        Ukf(model, settings, noise=noise)
        if isinstance(settings, UkfSettings)
        else FilterpyEkf(model, settings, noise=noise)
    )
