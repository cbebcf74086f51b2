"""Settings: frozen dataclasses whose fields carry their bounds and units, checked in one place.

    @dataclass(frozen=True)
    class DriveSettings(Settings, table="drive"):
        delay: float = setting(1.0, least=0, most=1000, unit="periods")

A value out of bounds is an InputError that names the table, the key, the value and what is allowed.
"""

import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from numbers import Real
from typing import Any, ClassVar

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import suggest


@dataclass(frozen=True)
class Bounds:
    """What a setting may be, in `unit`.

    Numbers are from `least`, or more than `above`, to `most`; texts are one of `choices`. zero, infinite: what 0 or
    infinity stand for where they are allowed besides. key: the setting's name in files, where it is not the field's.
    """

    least: float = -math.inf
    above: float = -math.inf
    most: float = math.inf
    choices: Sequence[str] = ()
    zero: str = ""
    infinite: str = ""
    unit: str = ""
    key: str = ""

    @property
    def range(self) -> str:
        """What is allowed, as in "0 to 1000 periods" or "positive"; empty for any number."""
        unit = f" {self.unit}" if self.unit else ""
        low = max(self.least, self.above)
        if math.isfinite(self.most):
            start = f"{_digits(low)} to " if self.above < low else "positive, at most " if low == 0 else ""
            text = f"{start or f'more than {_digits(low)}, at most '}{_digits(self.most)}{unit}"
        elif low == 0:
            text = ("positive" if self.above == 0 else "zero or positive") + (f", in{unit}" if unit else "")
        elif math.isfinite(low):
            text = f"{'more than' if self.above == low else 'at least'} {_digits(low)}{unit}"
        else:
            text = f"a finite number{f' of{unit}' if unit else ''}"
        extremes = (("0", self.zero), ("inf", self.infinite))
        return text + "".join(f", or {value} for {meaning}" for value, meaning in extremes if meaning)

    def complaint(self, value: Any) -> str:
        """Return what is wrong with a value, empty where nothing is."""
        if self.choices:
            return "" if value in self.choices else suggest(str(value), self.choices)
        if not isinstance(value, Real):
            return "must be a number"
        number = float(value)
        allowed = (
            (bool(self.zero) and number == 0)
            or (bool(self.infinite) and number == math.inf)
            or (math.isfinite(number) and self.above < number and self.least <= number <= self.most)
        )
        return "" if allowed else f"must be {self.range}"


def setting(default: Any = MISSING, /, **bounds: Any) -> Any:
    """Return a dataclass field with a default (required where there is none) and the `Bounds` of its values.

    Of a tuple every value is checked; None passes where it is the default.
    """
    return field(default=default, metadata={"bounds": Bounds(**bounds)})


class Settings:
    """Base of settings: checks the fields' bounds on construction; `table` names the settings in messages."""

    TABLE: ClassVar[str] = ""

    def __init_subclass__(cls, table: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if table is not None:
            cls.TABLE = table

    def __post_init__(self) -> None:
        """Check every bounded field.

        Raises:
            InputError: names table, key, value and what is allowed.
        """
        for name, bounds in bounds_of(type(self)).items():
            value = getattr(self, name)
            for one in value if isinstance(value, tuple | list) else (value,):
                if one is not None and (complaint := bounds.complaint(one)):
                    raise self.refusal(bounds.key or name, complaint, value=one)

    def refusal(self, key: str, complaint: str, *, value: Any = MISSING) -> InputError:
        """Return the error of a setting's value, by default the present one."""
        value = getattr(self, key) if value is MISSING else value
        return InputError(f"{f'{self.TABLE}: ' if self.TABLE else ''}{key} = {value!r}: {complaint}")


@cache
def bounds_of(kind: type) -> dict[str, Bounds]:
    """Return {field: bounds}; a field that a subclass gives another default keeps its bounds."""
    found: dict[str, Bounds] = {}
    for one in fields(kind):
        for ancestor in kind.__mro__:
            own = vars(ancestor).get("__dataclass_fields__", {}).get(one.name)
            if own is not None and "bounds" in own.metadata:
                found[one.name] = own.metadata["bounds"]
                break
    return found


def _digits(value: float) -> str:
    return f"{value}" if isinstance(value, int) else f"{value:g}"
