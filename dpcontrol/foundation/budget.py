"""Time limits for searches, which return partial results when the time is up."""

import time

SECONDS = 60.0
"""Default processor time of a search, s."""


class Budget:
    """Processor time of this process from now on, s; may be infinite."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self._began = float(seconds), time.process_time()

    @property
    def share(self) -> float:
        """Fraction of the budget that has passed: 1 if it is spent."""
        passed = time.process_time() - self._began
        return passed / self.seconds if self.seconds > 0 else 1.0

    @property
    def spent(self) -> bool:
        """True if no time is left."""
        return self.share >= 1

    def part(self, seconds: float) -> "Budget":
        """Return the budget of one step of a search, which ends with this budget at the latest.

        Args:
            seconds: processor time from now, s.
        """
        return Budget(max(0.0, min(seconds, self.seconds * (1 - self.share))))

    def until(self, share: float) -> "Budget":
        """Return the budget of a step that may last until a fraction of this budget has passed.

        Args:
            share: fraction of this budget, 0 to 1, counted from its begin.
        """
        return self.part(self.seconds * max(1e-9, share - self.share))
