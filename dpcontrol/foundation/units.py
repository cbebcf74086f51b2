"""Detection of numbers in the wrong unit: unusual values cause a remark, impossible ones an error."""

import math
from collections.abc import Iterator, Sequence

from dpcontrol.foundation.errors import InputError

OTHER_UNITS: dict[str, dict[str, float]] = {
    "m": {"cm": 1e-2, "mm": 1e-3, "µm": 1e-6},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "m/s²": {"cm/s²": 1e-2, "mm/s²": 1e-3},
    "m/s³": {"mm/s³": 1e-3},
    "kg": {"g": 1e-3},
    "kg m²": {"g m²": 1e-3, "kg cm²": 1e-4, "kg mm²": 1e-6, "g cm²": 1e-7, "g mm²": 1e-9},
    "rad": {"degrees": 0.017453292519943295},
    "rad/s": {"degrees/s": 0.017453292519943295},
    "rad/h": {"degrees/h": 0.017453292519943295},
    "s": {"ms": 1e-3, "µs": 1e-6},
    "Hz": {"kHz": 1e3},
    "N m": {"mN m": 1e-3},
    "N m/rad": {"mN m/rad": 1e-3},
    "N m s": {"mN m s": 1e-3},
}
"""Units that are often confused with the first one, and their sizes in it."""
_IMPOSSIBLE = 1000.0
"""Multiple of the largest usual value beyond which a number is rejected."""
_VANISHING = 1e-9
"""Share of the least usual value below which a number is rejected."""


SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Return a factor and a unit with a fitting prefix.

    >>> prefixed(8.8e-05, "s")
    (1000000.0, 'µs')

    Args:
        largest: largest size of the values, in `unit`.
        unit: unit without a prefix, such as "s".
    """
    finite = math.isfinite(largest) and largest > 0
    power = min(max(3 * math.floor(math.log10(largest) / 3), -9), 6) if finite else 0
    return 10.0**-power, f"{_PREFIXES[power]}{unit}"


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit and an SI prefix.

    Squared units have none.

    >>> quantity(8.8e-05, "s")
    '88 µs'

    Args:
        value: number in `unit`.
        unit: unit without a prefix, such as "s".
    """
    takes_no_prefix = not unit or "²" in unit or not unit[0].isalpha()
    factor, prefixed_unit = (1.0, unit) if takes_no_prefix else prefixed(abs(value), unit)
    return f"{value * factor:.3g} {prefixed_unit}".rstrip()


class InUnits:
    """Base of systems and results with a unit system; `si` is True if their units are those of SI."""

    si: bool

    def unit(self, name: str, form: str = " {}") -> str:
        """Return a unit of SI as it follows a number, or "" if the system has its own units.

        Args:
            name: unit, such as "J".
            form: format of the unit, with its blank.
        """
        return form.format(name) if self.si else ""


def unusual(key: str, values: Sequence[float], usual: tuple[float, float], unit: str) -> Iterator[str]:
    """Yield a sentence on each number that is unusual on ordinary benches.

    If another unit would make it usual, the sentence has that unit. Zero is always usual. A number a thousand times
    larger than usual, or a thousand million times smaller, is impossible.

    Args:
        key: key of the values, for the message.
        values: numbers in `unit`.
        usual: least and largest usual size.
        unit: unit of the numbers.

    Raises:
        InputError: a value is impossible.
    """
    least, most = usual
    unit_text = f" {unit}" if unit else ""
    for value in values:
        size = abs(value)
        if not size or least <= size <= most:
            continue
        deviation = f"more than the usual {most:g}" if size > most else f"less than the usual {least:g}"
        text = f"{key} = {value:g}{unit_text} is {deviation}{unit_text}"
        impossible = size > _IMPOSSIBLE * most or size < _VANISHING * least
        alternatives = {other_unit: size * factor for other_unit, factor in OTHER_UNITS.get(unit, {}).items()}
        plausible_units = [
            f"{other_unit} ({converted:.3g}{unit_text})"
            for other_unit, converted in alternatives.items()
            if least <= converted <= most
        ]
        if plausible_units:
            text += f"; is it given in {' or in '.join(plausible_units)}?"
        elif not impossible:
            text += "; check the value"
        if impossible:
            raise InputError(
                text if plausible_units else f"{text}, which is impossible; give it in {unit or 'its unit'}", key=key
            )
        yield text
