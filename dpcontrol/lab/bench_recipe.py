"""What makes a simulated bench anew for each run that is made on it over UDP."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.dynamics.uncertain_arms import Uncertainty
from dpcontrol.lab.bench import BenchSettings
from dpcontrol.lab.draw import draw_bench
from dpcontrol.lab.simulated import SimulatedRig
from dpcontrol.references.problem import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BenchRecipe:
    """What makes a simulated bench: the model's arms, what the bench adds, what is drawn; start (2n+2,), ticks."""

    parameters: ArmChainParameters
    settings: BenchSettings
    limits: Limits
    start: Array
    ticks: int
    period: float
    seed: int
    mismatch: float = 0.0
    model_uncertainty: float = 0.0
    uncertainty: Uncertainty | None = None
    initial_error: float = 0.0

    def rig(self, queued: Sequence[float]) -> SimulatedRig:
        """Return a bench at its start, with the commands (m/s²) on their way, oldest first."""
        draw = draw_bench(
            self.parameters, self.settings, seed=self.seed, ticks=self.ticks, period=self.period,
            mismatch=self.mismatch, model_uncertainty=self.model_uncertainty, uncertainty=self.uncertainty,
            initial_error=self.initial_error,
        )  # fmt: skip
        return SimulatedRig(draw, self.settings, limits=self.limits, start=self.start, queued=queued)

    def rehearse(self) -> None:
        """Have everything compiled and in memory before the first run."""
        rig = self.rig(())
        for _ in range(min(self.ticks, 100)):
            rig.read()
            rig.command(0.0)
