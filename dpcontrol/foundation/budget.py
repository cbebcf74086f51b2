"""Time that a search may take: it ends with what it has when the time is over, and says so."""

import time

SECONDS = 60.0
"""s of processor time that a search may take unless it is given others."""


class Budget:
    """Processor time of this process, counted from when the budget is made; seconds: may be infinite."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self._began = float(seconds), time.process_time()

    @property
    def share(self) -> float:
        """How much of it has passed: 1 when it is spent."""
        passed = time.process_time() - self._began
        return passed / self.seconds if self.seconds > 0 else 1.0

    @property
    def spent(self) -> bool:
        """Whether nothing is left."""
        return self.share >= 1

    def part(self, seconds: float) -> "Budget":
        """Return a budget of so many seconds from now on, at most what is left of this one."""
        return Budget(max(0.0, min(seconds, self.seconds * (1 - self.share))))

    def until(self, share: float) -> "Budget":
        """Return a budget that ends when `share` of this one has passed."""
        return self.part(self.seconds * max(1e-9, share - self.share))
