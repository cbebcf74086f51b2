"""Results that print themselves in one line, draw themselves and become tables.

The base classes leave the data to the dataclasses that derive from them. Pictures come from the table of renderers.
"""

from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from html import escape
from io import BytesIO
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array, checked_array
from dpcontrol.foundation.checked import Count, checked
from dpcontrol.foundation.document import plain
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.rendering import Axes, DataFrame, Figure, render, thumbnail


class Brief:
    """Base of dataclasses whose repr is one line, made from the JSON values of `document`."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep the inherited repr, which the dataclass decorator would replace by one of all fields."""
        super().__init_subclass__(**options)
        cls.__repr__ = cls.__repr__  # type: ignore[method-assign]
        if "document" in vars(cls):
            cls.document = _in_json(vars(cls)["document"])  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        values = [(attribute.name, getattr(self, attribute.name)) for attribute in fields(self) if attribute.repr]  # type: ignore[arg-type]
        parts = [f"{name}={text}" for name, value in values if (text := _summary(value))]
        return f"{type(self).__name__}({', '.join(parts)})"


def _in_json(document: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method `document` that calls the given one and converts its values to those of JSON."""

    @wraps(document)
    def call(self: Any, *arguments: Any) -> Any:
        """Return the result of the method `document` of an object, with values of Python replaced by those of JSON."""
        return plain(document(self, *arguments))

    return call


def _summary(value: Any) -> str:
    """Return a short text of a value for the one-line repr of a result, or "" if the value has none."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, str):
        return repr(value if len(value) <= _LONGEST else f"{value[:_LONGEST]}…")
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, tuple | list | dict):
        has_short_items = not isinstance(value, dict) and all(isinstance(item, int | float | str) for item in value)
        text = f"({', '.join(map(_summary, value))})" if has_short_items else ""
        return text if 0 < len(text) <= _LONGEST else f"{len(value)} items"
    return ""


_LONGEST = 60
"""Characters of a value."""


class Shown(Brief):
    """Base of results that have a picture."""

    @checked
    def plot(self, axes: Axes | None = None) -> Figure:
        """Draw the result.

        Args:
            axes: matplotlib axes to draw the most important chart in; by default a new figure.

        Returns:
            The new figure, or the figure of `axes`.

        Raises:
            InputError: the result has no picture.
        """
        return render(self, axes)

    def _repr_html_(self) -> str:
        """Return the sentence and a small picture, for notebooks."""
        picture = BytesIO()
        try:
            thumbnail(self).savefig(picture, format="png", dpi=70)
        except (InputError, GoalMissed):
            return f"<p>{escape(repr(self))}</p>"
        data = b64encode(picture.getvalue()).decode()
        return f'<p>{escape(repr(self))}</p><img alt="" src="data:image/png;base64,{data}">'


class Timed(Shown, ABC):
    """Base of results that follow a motion over time."""

    @property
    @abstractmethod
    def time_range(self) -> tuple[float, float]:
        """First and last time, s."""

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""

    @abstractmethod
    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (…), s; None for the default of the result.
        """

    @checked
    def sample(self, count: Count = 200) -> Array:
        """Return states at equally spaced times.

        Args:
            count: number of times, from the first to the last.

        Returns:
            States (count, N).
        """
        return self.states(np.linspace(*self.time_range, count))

    @checked
    def frame(self, count: Count = 200) -> DataFrame:
        """Return a pandas table of the motion.

        Args:
            count: number of rows at equally spaced times.

        Returns:
            Table with the index `time` (s) and a column for each entry of a state.

        Raises:
            PartMissing: pandas is not installed.
        """
        times = np.linspace(*self.time_range, count)
        return data_frame(self.states(times), self.columns, times=times)


def data_frame(rows: Any, columns: Sequence[str] | None = None, *, times: Any = None) -> DataFrame:
    """Return a pandas table.

    Args:
        rows: array (K, N) of K rows, a list of rows, or columns (K,) by name.
        columns: names of the columns, if the rows have none.
        times: index `time` (K,), s; by default the rows are numbered.

    Raises:
        PartMissing: pandas is not installed.
    """
    pandas = part("pandas")
    return pandas.DataFrame(rows, columns=columns, index=None if times is None else pandas.Index(times, name="time"))


def checked_times(times: Any) -> Array:
    """Return times (…) as an array.

    Args:
        times: numbers (…), s.

    Raises:
        InputError: they are not finite numbers.
    """
    finite = checked_array("times", times)
    if not np.isfinite(finite).all():
        raise InputError("times: must be finite numbers, s")
    return finite
