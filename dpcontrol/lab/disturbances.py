"""What nobody commanded: pushes on the arms, knocks on the cart, a track that is not level.

    push:  M(θ) Δω = impulse          knock:  Δẋ given, arms keep their momenta          tilt:  gravity (g sin, -g cos)

Pushes and knocks take no time and act at a tick, right after its reading.
"""

from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.errors import InputError


@dataclass(frozen=True)
class Push:
    """One blow at `time` s, at the tick next to it: on arm `arm` (0: the inner) and on the cart.

    impulse N m s: of a couple on the arm; rate rad/s: jump of the arm's rate in place of or besides it; knock m/s:
    jump of the cart's velocity.
    """

    time: float
    arm: int = 0
    impulse: float = 0.0
    rate: float = 0.0
    knock: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no blow.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if not (np.isfinite(self.time) and self.time >= 0):
            raise InputError(f"push: time = {self.time!r}: must be zero or positive seconds")
        if self.arm < 0:
            raise InputError(f"push: arm = {self.arm!r}: must be 0 (inner arm) or more")
        for name in ("impulse", "rate", "knock"):
            if not abs(getattr(self, name)) <= 1e3:
                raise InputError(f"push: {name} = {getattr(self, name)!r}: must be a number of at most 1000")


@dataclass(frozen=True)
class DisturbanceSettings:
    """Seeded and explicit disturbances.

    pushes: how many blows on arms in a run, at random times on random arms, each of a uniform ± push_impulse N m s;
    knocks: how many on the cart, each a uniform ± knock_velocity m/s. tilt rad of the track, positive with the right
    end down; angles are measured from the track's normal, so hanging arms read `tilt`. explicit: further blows.
    """

    pushes: int = 0
    push_impulse: float = 0.0
    knocks: int = 0
    knock_velocity: float = 0.0
    tilt: float = 0.0
    explicit: tuple[Push, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what is no disturbance; the tilt is checked with the plant's parameters.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        for name in ("pushes", "knocks"):
            if not 0 <= getattr(self, name) <= 10_000:
                raise InputError(f"disturbances: {name} = {getattr(self, name)!r}: must be 0 to 10000")
        for name in ("push_impulse", "knock_velocity"):
            if not 0 <= getattr(self, name) <= 1e3:
                raise InputError(f"disturbances: {name} = {getattr(self, name)!r}: must be 0 to 1000")
