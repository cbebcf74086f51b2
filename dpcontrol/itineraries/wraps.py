"""How few wraps suffice: the theorem's M_k, found for the walk at hand.

A walk is tried with no wraps at all; where its orbit cannot be had, the stops beside the symbol at fault are given one
more, until it can; then each stop that was raised is lowered again as far as the orbit allows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.itineraries.shadowing import ShadowingOrbit, shadow
from dpcontrol.itineraries.tiling import ShadowingSettings, Strands
from dpcontrol.tubes.connection import Connection

MOST = 12
"""Wraps at one stop beyond which fewer are not the reason for failure: λ^-12 is below rounding for λ > 20."""


@dataclass
class WalkSolver:
    """Solves walks of one graph, and remembers the least wraps seen between each pair of neighbours.

    rivals: all connections of the graph, which an orbit might follow instead of its own.
    """

    rivals: Sequence[Connection]
    settings: ShadowingSettings = field(default_factory=ShadowingSettings)
    least_seen: dict[tuple[str, str], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make room for the samples that walks share."""
        self._strands = Strands(self.settings.segments)

    def solve(
        self,
        chain: Sequence[Connection],
        wraps: Sequence[int],
        *,
        periodic: bool = False,
        lead_in: int = 2,
        lead_out: int = 2,
    ) -> ShadowingOrbit:
        """Return the orbit of a walk with the wraps asked for; where it fails, the status names the least that work.

        Raises:
            InputError: wraps that do not fit the walk.
        """
        orbit = shadow(
            chain,
            wraps=wraps,
            periodic=periodic,
            lead_in=lead_in,
            lead_out=lead_out,
            settings=self.settings,
            strands=self._strands,
            rivals=self.rivals,
        )
        if orbit.converged:
            self._remember(orbit)
        return orbit

    def least(self, chain: Sequence[Connection], *, periodic: bool = False) -> tuple[int, ...]:
        """Return the fewest wraps at each stop with which the walk's orbit is found.

        Fewest stop by stop: none of them can be lowered alone.

        Raises:
            GoalMissed: no number of wraps up to MOST suffices; names the symbol at fault.
        """
        count = len(chain) if periodic else len(chain) - 1
        wraps, failed = [0] * count, self.solve(chain, [0] * count, periodic=periodic)
        raised: set[int] = set()
        while not failed.converged:
            beside = _stops_beside(failed, count, periodic)
            if not beside or max(wraps[k] for k in beside) >= MOST:
                raise GoalMissed(f"no wraps up to {MOST} suffice: {failed.status}")
            for k in beside:
                wraps[k] += 1
            raised.update(beside)
            failed = self.solve(chain, wraps, periodic=periodic)
        for k in sorted(raised):
            while wraps[k] > 0:
                fewer = [n - (j == k) for j, n in enumerate(wraps)]
                if not self.solve(chain, fewer, periodic=periodic).converged:
                    break
                wraps = fewer
        return tuple(wraps)

    def advice(self, orbit: ShadowingOrbit) -> str:
        """Return a sentence on the least wraps of a walk that failed, if fewer wraps are its fault."""
        try:
            least = self.least(orbit.connections, periodic=orbit.periodic)
        except GoalMissed as error:
            return str(error)
        if any(asked < enough for asked, enough in zip(orbit.wraps, least, strict=True)):
            return f"wraps {list(orbit.wraps)} are too few: the least that work are {list(least)}"
        return f"wraps {list(least)} work where {list(orbit.wraps)} do not"

    def _remember(self, orbit: ShadowingOrbit) -> None:
        chain = orbit.connections
        for k, count in enumerate(orbit.wraps):
            pair = (chain[k].name, chain[(k + 1) % len(chain)].name)
            self.least_seen[pair] = min(count, self.least_seen.get(pair, count))


def _stops_beside(orbit: ShadowingOrbit, count: int, periodic: bool) -> set[int]:
    """Return the stops on both sides of the symbol at fault."""
    fault = orbit.fault or 0
    if periodic:
        return {(fault - 1) % count, fault}
    return {k for k in (fault - 1, fault) if 0 <= k < count}
