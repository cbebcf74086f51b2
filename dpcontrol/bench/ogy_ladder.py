"""A border of something that comes through more and more often, though not steadily: the mean over a ladder of values.

On rungs y_i, of a constant ratio r, a share h_i holds. Had each run one value from which on it holds, the mean of these
values' logarithms would be

    log border = log y_0 - ½ log r + Σ_i (1 - h_i) log r,       error² = log² r Σ_i h_i (1 - h_i) / (runs - 1)

with h = 0 below the ladder and 1 above. It needs no share that rises at every rung, and takes all runs into account,
where a search for the rung at which half hold ends at whichever of several it comes upon.

Source: Spearman-Kärber's estimate; Finney, Statistical Method in Biological Assay, 3rd ed. (1978).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

NEARLY = 0.95
"""What holds so often, or so seldom the other way round, ends a ladder."""
_LEAP = 4


@dataclass(frozen=True)
class Ladder:
    """Rungs of ratio `ratio` from `low` to at most `high`, counted from 0."""

    low: float
    high: float
    ratio: float

    @property
    def count(self) -> int:
        """How many rungs there are."""
        return int(np.log(self.high / self.low) / np.log(self.ratio)) + 1

    def at(self, rung: int) -> float:
        """Return the value at a rung."""
        return float(self.low * self.ratio**rung)

    def border(self, shares: Mapping[int, float]) -> float:
        """Return the border by the shares that hold at neighbouring rungs."""
        lost = sum(1 - share for share in shares.values())
        return self.at(min(shares)) * float(self.ratio ** (lost - 0.5))

    def error(self, shares: Mapping[int, float], runs: int) -> float:
        """Return the factor by which the border of `runs` runs on each rung is uncertain: one standard error."""
        variance = sum(share * (1 - share) for share in shares.values()) / max(runs - 1, 1)
        return float(self.ratio ** np.sqrt(variance))

    def foretold(self, share: Callable[[float], float]) -> dict[int, float]:
        """Return the share at rungs from one at which nearly nothing holds to one at which nearly all does.

        Empty where that is not found within the ladder. Only every few rungs are asked for, up to where it rises; one
        beyond the last is to hold as well, for a share may fall again.
        """
        found, rung, nearly = {0: share(self.at(0))}, 0, 0
        while nearly < 2 and rung < self.count - 1:
            rung = min(rung + _LEAP, self.count - 1)
            found[rung] = share(self.at(rung))
            nearly = nearly + 1 if found[rung] >= NEARLY else 0
        if not nearly:
            return {}
        begin = max((i for i in found if found[i] <= 1 - NEARLY), default=0)
        for i in range(begin, rung):
            if i not in found:
                found[i] = share(self.at(i))
        while found.get(begin + 1, 1.0) <= 1 - NEARLY:
            begin += 1
        while rung - 1 > begin and found[rung - 1] >= NEARLY:
            rung -= 1
        return {i: found[i] for i in range(begin, rung + 1)}
