"""Documents of results, against dictionaries written by hand."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from dpcontrol.foundation.document import Documented, document_of, plain


class Gap(NamedTuple):
    low: float
    high: np.ndarray


@dataclass(frozen=True)
class Wheel:
    name: str
    turns: np.ndarray


@dataclass(frozen=True)
class Cart(Documented):
    KEYS: ClassVar[str] = (
        "file first=wheels.0.name names=wheels.name count=#wheels **best wheels:label=name,turns gaps:low,high doubled"
    )

    file: Path
    wheels: tuple[Wheel, ...]
    best: Wheel
    gaps: tuple[tuple[float, float], ...]

    def doubled(self) -> int:
        return 2 * len(self.wheels)


FRONT = Wheel("front", np.array([1.0, np.inf]))
CART = Cart(Path("a.toml"), (FRONT, Wheel("rear", np.array([2.0]))), FRONT, ((0.0, 1.0),))


def test_keys_name_attributes_parts_lengths_items_and_the_results_of_methods():
    assert CART.document() == {
        "file": "a.toml",
        "first": "front",
        "names": ["front", "rear"],
        "count": 2,
        "name": "front",
        "turns": [1.0, None],
        "wheels": [{"label": "front", "turns": [1.0, None]}, {"label": "rear", "turns": [2.0]}],
        "gaps": [{"low": 0.0, "high": 1.0}],
        "doubled": 4,
    }


def test_dataclasses_mappings_and_named_tuples_are_objects():
    assert plain([FRONT]) == [{"name": "front", "turns": [1.0, None]}]
    assert document_of({"by": {1: (3, 4)}}, "by:entries,bytes") == {"by": {"1": {"entries": 3, "bytes": 4}}}
    gaps = {"gaps": [Gap(0.0, np.array([1.0]))]}
    assert document_of(gaps, "gaps:low,high") == {"gaps": [{"low": 0.0, "high": [1.0]}]}
    again = document_of(CART, "again=best.name **")
    assert (again["again"], again["count"]) == ("front", 2)
