"""Uncertainty of campaign counts: Wilson's interval and McNemar's exact test for pairs.

Sources: Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927); McNemar, Note on
the sampling error of the difference between correlated proportions, Psychometrika 12 (1947).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dpcontrol.foundation.parts import Later

stats = Later("scipy.stats")
"""Imported on first use, which takes half a second."""


@dataclass(frozen=True)
class Share:
    """`successes` of `runs`, and the 95 % interval of the underlying share, from `low` to `high`."""

    successes: int
    runs: int
    low: float
    high: float

    @property
    def likely(self) -> bool | None:
        """True if the share is at least 0.9, False if less than 0.5, both with confidence; None in between."""
        return True if self.low >= 0.9 else False if self.high < 0.5 else None

    @property
    def rate(self) -> float:
        """The observed share."""
        return self.successes / self.runs if self.runs else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """The interval's ends."""
        return self.low, self.high

    def sentence(self, confidence: float = 0.95) -> str:
        """Return the share with its interval, as a sentence.

        Args:
            confidence: probability of the interval.
        """
        band = f"{self.low:.1%} to {self.high:.1%} with {confidence:.0%} confidence"
        return f"{self.successes} of {self.runs} runs completed: {self.rate:.1%} ({band})"


def wilson(successes: int, runs: int, *, confidence: float = 0.95) -> Share:
    """Return the share with Wilson's interval, which is 0 to 1 without runs.

    Args:
        successes: number of successful runs.
        runs: number of runs.
        confidence: probability of the interval, 0 to 1.
    """
    if not runs:
        return Share(0, 0, 0.0, 1.0)
    interval = stats.binomtest(successes, runs).proportion_ci(confidence, method="wilson")
    return Share(successes, runs, float(interval.low), float(interval.high))


def share_of(done: ArrayLike) -> Share:
    """Return the share of runs that succeeded.

    Args:
        done: True for each run (K,) that did.
    """
    flags = np.asarray(done, dtype=bool)
    return wilson(int(flags.sum()), flags.size)


@dataclass(frozen=True)
class Pairing:
    """Outcomes of two controllers on the same seeds.

    Attributes:
        pairs: number of seeds.
        only_first: number of seeds on which only the first one succeeded.
        only_second: number of seeds on which only the second one succeeded.
        p_value: probability of such a difference between equal controllers, by McNemar's exact test.
    """

    pairs: int
    only_first: int
    only_second: int
    p_value: float


def paired(first: ArrayLike, second: ArrayLike) -> Pairing:
    """Compare two controllers by the seeds on which only one of them succeeds, with McNemar's exact test.

    Args:
        first: outcomes (K,) of one controller, True for success.
        second: outcomes (K,) of the other controller, in the same order of seeds.
    """
    of_first, of_second = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second = int((of_first & ~of_second).sum()), int((of_second & ~of_first).sum())
    differing = only_first + only_second
    if not differing:
        return Pairing(of_first.size, 0, 0, 1.0)
    return Pairing(of_first.size, only_first, only_second, float(stats.binomtest(only_first, differing).pvalue))
