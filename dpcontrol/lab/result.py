"""What a run of the loop leaves: every tick as arrays, how it ended, and a few figures."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.parameters import ArmChainParameters

Array = NDArray[np.float64]


class Ending(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    """It came to the reference's end. Whether the itinerary was completed is for the score to say."""
    CART_STOP = "cart at its stop"
    ESTIMATE_LOST = "estimate lost"
    TRACKING_LOST = "tracking lost"
    PLANT_FAILED = "plant failed"


class LoopSink(Protocol):
    """Takes every tick and event as it happens; a log writer is one."""

    def tick(
        self,
        time_s: float,
        *,
        measured: Array,
        estimate: Array,
        reference: Array,
        truth: Array | None,
        control: Array,
    ) -> None:
        """Take one tick: measured (n+1,), states (2n+2,), control (7+2n+2,) as `control_fields` names it."""
        ...

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Take one event: level info, warn or error, its name, and what happened."""
        ...


class NoSink:
    """Takes nothing: the result holds every tick anyway."""

    def tick(
        self,
        time_s: float,
        *,
        measured: Array,
        estimate: Array,
        reference: Array,
        truth: Array | None,
        control: Array,
    ) -> None:
        """Ignore a tick."""

    def event(self, time_s: float, level: str, name: str, text: str) -> None:
        """Ignore an event."""


@dataclass(frozen=True, eq=False)
class LoopResult:
    """A run of K ticks, n arms.

    times (K,) s; measured (K, n+1); estimates, references, truth (K, 2n+2) in state order; control (K, 9+2n) with
    the columns of `dpcontrol.logs.layout.control_fields`. ending, and reason, a sentence. nis_inside_95: share of
    the ticks whose NIS lies in its two-sided 95 % band. rms_tracking_error rad: over all angles, truth against
    reference. max_cart_position m; rms_cart_acceleration m/s², as applied; rms_feedback m/s². real_time_factor:
    simulated over elapsed time. plant: the parameters that were simulated.
    """

    times: Array
    measured: Array
    estimates: Array
    references: Array
    truth: Array
    control: Array
    ending: Ending
    reason: str
    nis_inside_95: float
    rms_tracking_error: float
    max_cart_position: float
    rms_cart_acceleration: float
    rms_feedback: float
    real_time_factor: float
    plant: ArmChainParameters

    @property
    def finished(self) -> bool:
        """Tell whether the run came to the reference's end."""
        return self.ending is Ending.FINISHED

    @property
    def status(self) -> str:
        """Return `reason`."""
        return self.reason

    @property
    def residual(self) -> float:
        """Return `rms_tracking_error`."""
        return self.rms_tracking_error

    @property
    def stats(self) -> dict[str, float]:
        """Return the run's size and pace."""
        return {"ticks": len(self.times), "real_time_factor": self.real_time_factor}
