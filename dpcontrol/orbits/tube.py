"""Tubes: invariant manifolds of periodic orbits, followed away from them.

A tube is the stable or unstable manifold of an orbit.

The stable tube is the image of the unstable one under the orbit's reverser, so nothing is integrated backward.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from dpcontrol.dynamics.propagator import INTERVAL_STEPS, Section
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.budget import SECONDS, Budget
from dpcontrol.foundation.checked import Count, Hit, Positive, checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Reporting
from dpcontrol.foundation.shown import Shown
from dpcontrol.orbits.cut import MOST_PERIODS, Cut, CutSettings, Piece, Sampler, section_points, tube_cut
from dpcontrol.orbits.manifold import UnstableManifold, local_manifold
from dpcontrol.orbits.orbit import PeriodicOrbit

_MOMENTS = 160
"""Samples of a strand."""


@dataclass(frozen=True, repr=False)
class Tube(Shown, Documented):
    """The stable or unstable tube of a hyperbolic orbit.

    Attributes:
        branch: +1 or -1, or 0 for both branches.
    """

    KEYS: ClassVar[str] = "orbit stable branch"

    orbit: PeriodicOrbit
    stable: bool = False
    branch: Literal[-1, 0, 1] = 0

    def __repr__(self) -> str:
        side = {1: "branch +1 of the ", -1: "branch -1 of the ", 0: ""}[self.branch]
        return f"<{side}{'' if self.stable else 'un'}stable tube of {self.orbit!r}>"

    @cached_property
    def manifold(self) -> UnstableManifold:
        """The local unstable manifold of the orbit."""
        return local_manifold(self.orbit)

    @property
    def branches(self) -> tuple[int, ...]:
        """Signs of the tube's branches: +1, -1 or both."""
        return (self.branch,) if self.branch else (1, -1)

    def _placed(self, states: Array) -> Array:
        """Return states (…, N) of the unstable tube on this tube: unchanged, or reflected onto the stable one."""
        centre = self.orbit.centre
        return (states - centre) @ self.orbit.reverser.T + centre if self.stable else states

    @checked
    def strands(self, count: Count = 40) -> Array:
        """Return trajectories on the tube, from the orbit to the default section, for pictures of the tube.

        Trajectories that do not meet it are followed while they leave the orbit.

        Args:
            count: number of trajectories of each branch.

        Returns:
            States (B, M, N), in the direction away from the orbit.
        """
        orbit, manifold, system = self.orbit, self.manifold, self.orbit.system
        phases = np.arange(count) / count
        section = system.sections.get((orbit.saddle, orbit.saddle))
        leaving = (1 - np.log(manifold.distance) / manifold.exponent) * orbit.period
        trajectories = []
        for branch in self.branches:
            times = np.full(count, np.inf)
            if section is not None:
                times = Sampler(manifold, section, 1, branch, CutSettings()).fly(phases).times
            for seed, time in zip(manifold.seeds(phases, branch)[0], times, strict=True):
                trajectories.append(_followed(system.propagator, seed, time if np.isfinite(time) else leaving))
        return self._placed(np.array(trajectories))

    @checked
    def cut(
        self,
        section: str | Section | None = None,
        *,
        hit: Hit = 1,
        longest: Positive | None = None,
        seconds: Positive = SECONDS,
        progress: Reporting = None,
    ) -> Cut:
        """Return the curves in which the tube meets a section.

        Args:
            section: section, or its name in the system; by default the one for connections of the orbit to itself.
            hit: number of the crossing.
            longest: time to reach the section, in periods of the orbit (default: the system's).
            seconds: processor time, s. A partial cut is marked as `spent`.
            progress: reports, see `dpcontrol.api`.

        Raises:
            InputError: there is no such section, the reverser does not preserve it, or the time is too long.
        """
        orbit = self.orbit
        if not isinstance(section, Section):
            section = orbit.system.section_between(orbit.saddle, orbit.saddle, section)
        if len(section.normal) != orbit.system.dimension:
            raise InputError(
                f"section {section.name}: has {len(section.normal)} coefficients, and {orbit.system.name} has "
                f"{orbit.system.dimension} states; use a section of this system"
            )
        if self.stable and not section.kept_by(orbit.reverser, orbit.centre):
            raise InputError(f"section {section.name}: not preserved by the reverser about {orbit.saddle}; use another")
        settings = CutSettings(longest=longest)
        if longest is not None and longest > MOST_PERIODS:
            raise InputError(f"longest = {longest:g}: must be at most {MOST_PERIODS:g} periods of the orbit")
        cut = tube_cut(self.manifold, section, hit=hit, settings=settings, budget=Budget(seconds), progress=progress)
        pieces = [piece for piece in cut.pieces if piece.branch in self.branches]
        ends = tuple(end for end in cut.open_ends if end.branch in self.branches)
        pieces = tuple(self.placed(piece, section) for piece in pieces)
        return replace(cut, pieces=pieces, open_ends=ends, stable=self.stable, seconds=seconds)

    def placed(self, piece: Piece, section: Section) -> Piece:
        """Return a piece of an unstable tube's cut as a piece of this tube's cut, reflected for a stable tube.

        Args:
            piece: piece of the unstable tube's cut.
            section: section of the cut.
        """
        if not self.stable:
            return piece
        states = self._placed(piece.states)
        normal = np.asarray(section.normal)
        direction = -piece.direction * int(np.sign(normal @ self.orbit.reverser @ normal))
        points = section_points(self.orbit.system, section, states)
        return replace(piece, points=points, states=states, direction=direction)


def _followed(propagator: Any, seed: Array, seconds: float) -> Array:
    """Return states (M, N) of a trajectory from a seed (N,) for a time, s, for a strand of a tube.

    `propagator`: that of the orbit's system. If the trajectory becomes infinite, the time is halved until it does not.
    """
    while True:
        try:
            return propagator.sample(seed, np.linspace(0.0, seconds, _MOMENTS), most_steps=INTERVAL_STEPS)
        except ArithmeticError:
            seconds /= 2
