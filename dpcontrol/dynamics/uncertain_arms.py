"""How well identified arms are known, and arms drawn as likely as that says.

    r' = r + s Σ^½ z,      z standard normal,      arms' = the nearest to the model's with the ratios r'

r: the f ratios of `dpcontrol.dynamics.base_ratios`; Σ their covariance; s a factor on their standard errors.

Source: Hastie, Tibshirani, Friedman, The elements of statistical learning (2009), section 8.2 (parametric bootstrap).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.base_ratios import base_ratios, nearest_arms, ratio_names
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import GoalMissed, InputError

_TRIES = 20


@dataclass(frozen=True)
class Uncertainty:
    """How well arms are known: covariance (f, f) of the f ratios of `dpcontrol.dynamics.base_ratios`, row by row."""

    names: tuple[str, ...]
    covariance: tuple[float, ...]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The covariance (f, f)."""
        return np.reshape(self.covariance, (len(self.names), len(self.names)))

    def check(self, arms: ArmChainParameters) -> None:
        """Refuse what is not the covariance of these arms' ratios.

        Raises:
            InputError: names the key and what is allowed.
        """
        wanted = ratio_names(arms)
        if self.names != wanted:
            raise InputError(f"names = {list(self.names)}: must be {list(wanted)} for these arms")
        if len(self.covariance) != len(wanted) ** 2:
            raise InputError(
                f"covariance has {len(self.covariance)} numbers: must have {len(wanted) ** 2}, one row for each name"
            )
        scale = np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        scaled = self.matrix / np.outer(scale, scale)
        if not np.allclose(scaled, scaled.T, atol=1e-9) or np.linalg.eigvalsh(scaled)[0] < -1e-6:
            raise InputError(
                "covariance is none: it must be symmetric, and no direction may have a variance below zero"
            )

    def drawn(self, arms: ArmChainParameters, random: np.random.Generator, *, scale: float = 1.0) -> ArmChainParameters:
        """Return arms as likely as the covariance says of these; friction drawn below zero becomes zero.

        Ratios that no arms have, as of an inertia below zero, are drawn again. scale: factor on the standard errors.

        Raises:
            GoalMissed: no ratios drawn are those of arms, as where an uncertainty is as large as its value.
        """
        ratios = base_ratios(arms)
        sizes, axes = np.linalg.eigh(self.matrix)
        for _ in range(_TRIES):
            away = axes @ (np.sqrt(np.maximum(sizes, 0.0)) * random.standard_normal(len(sizes)))
            try:
                return nearest_arms(ratios + scale * away, arms)
            except GoalMissed:
                continue
        raise GoalMissed(
            f"of {_TRIES} draws from the model's uncertainty, its standard errors times {scale:g}, none are arms that "
            "can be; take a smaller factor"
        )
