"""The kinds of estimator by name, and the estimator of given settings."""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings, EstimatorSettings, FilterpyEkfSettings, UkfSettings
from dpcontrol.control.interface import Estimator, SampledModel

Array = NDArray[np.float64]

ESTIMATORS: dict[str, type[EstimatorSettings]] = {
    settings.kind: settings for settings in (EkfSettings, UkfSettings, FilterpyEkfSettings)
}
"""The settings of each kind of estimator, by its name in an itinerary."""


def make_estimator(settings: EstimatorSettings, model: SampledModel, *, noise: Array) -> Estimator:
    """Return the estimator of `settings` for `model`; noise (n+1, n+1): of the measured positions.

    Raises:
        InputError: the noise has the wrong shape or is no covariance.
    """
    if isinstance(settings, EkfSettings):
        return CompiledEkf(model, settings, noise=noise)
    # filterpy takes a second to import.
    from dpcontrol.control.ukf import FilterpyEkf, Ukf

    if isinstance(settings, UkfSettings):
        return Ukf(model, settings, noise=noise)
    return FilterpyEkf(model, settings, noise=noise)
