"""The description of a diagram over time.

Both matplotlib and Rerun draw from it.
"""

from dataclasses import dataclass

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.units import prefixed
from dpcontrol.pages.ranges import Range


@dataclass(frozen=True, eq=False)
class Line:
    """A curve over time.

    Attributes:
        key: path in a recording, below its chart's.
        name: label in the viewer.
        label: label in a page's legend, or "".
        time: (K,) s.
        values: (K,) in SI units, nan at gaps.
        colour: colour of the line.
        width: in points.
        reach: (K,) half width of a band, or None.
        around: True for a band about the line, False about zero.
        role: "run", or "reference", broad and pale behind the others, or "detail", shown only in the viewer.
        dashed: True to dash it on a page, over another line.
    """

    key: str
    name: str
    label: str
    time: Array
    values: Array
    colour: str
    width: float = 1.3
    reach: Array | None = None
    role: str = "run"
    dashed: bool = False
    around: bool = False


@dataclass(frozen=True)
class LevelLine:
    """A constant in a chart.

    Its kind is "limit" of the cart, end of the expected "band", or "named" level.
    """

    key: str
    name: str
    value: float
    colour: str
    kind: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over time that share an axis.

    Attributes:
        key: path in a recording, "" for charts only on pages.
        title: the quantity.
        unit: SI unit. "share" is shown in percent, "" is none.
        lines: curves.
        levels: constants.
        cut: (start, end) of each stretch with a limited command, s.
        shown: initial range of values, or None for all.
        bound: limit of the cart that the page's title names, or None.
        used: greatest use of it by a reference, or None for a run.
        note: rest of the page's title.
        prefixed: False if the unit gets no SI prefix.
        half_turns: True if a page ticks the axis in multiples of π.
        log: True for a logarithmic axis.
    """

    key: str
    title: str
    unit: str
    lines: tuple[Line, ...]
    levels: tuple[LevelLine, ...] = ()
    cut: tuple[Range, ...] = ()
    shown: Range | None = None
    bound: float | None = None
    used: float | None = None
    note: str = ""
    prefixed: bool = True
    half_turns: bool = False
    log: bool = False

    @property
    def named(self) -> str:
        """Title in the viewer."""
        return f"{self.title}{f' ({self.unit})' if self.unit else ''}"

    def scaled(self) -> tuple[float, str]:
        """Return the factor and the title for a page.

        The factor converts SI units to the page's unit.
        """
        parts = [np.abs(self.shown)] if self.shown else [np.abs(line.values) for line in self.lines]
        finite = [part[np.isfinite(part)] for part in parts]
        largest = max((float(part.max()) for part in finite if part.size), default=0.0)
        plain = self.half_turns or self.log or not self.prefixed or not self.unit
        scale, unit = (1.0, self.unit) if plain else prefixed(largest, self.unit)
        if self.unit == "share":
            scale, unit = 100.0, "%"
        bound = ""
        if self.bound is not None:
            used = "" if self.used is None else f"{scale * self.used:.3g} of "
            bound = f", {used}±{scale * self.bound:.4g}{' used' if used else ''}"
        return scale, f"{self.title}{f' ({unit})' if unit else ''}{bound}{self.note}"
