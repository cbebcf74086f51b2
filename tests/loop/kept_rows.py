"""A sink that keeps all rows and events of a run."""

from copy import deepcopy

import numpy as np

from dpcontrol.loop.result import Events, Ticks


class Kept(Events):
    """What a log would have of a run."""

    def __init__(self) -> None:
        super().__init__()
        self.blocks: list[Ticks] = []

    def ticks(self, rows: Ticks) -> None:
        self.blocks.append(deepcopy(rows))

    def whole(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(block, name) for block in self.blocks])

    @property
    def names(self) -> list[str]:
        return [event.name for event in self.kept]
