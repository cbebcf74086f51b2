"""Exceptions, remarks, and text that is safe to print.

Exceptions have exit codes. Remarks stop nothing.
"""

import re
import warnings
from collections.abc import Sequence
from typing import Any

_WORD = re.compile(r"[^\s/\\]{256,}")
"""A word that is no part of a file's path, because names of files have at most 255 bytes."""
_LONGEST = 2000
"""Number of characters of a sentence."""


def concise(sentence: str) -> str:
    """Return a sentence with long words and lines shortened, since a key in a file can have a megabyte.

    Args:
        sentence: one sentence or several, a line each.
    """
    lines = _WORD.sub(lambda word: f"{word[0][:40]}…", sentence).split("\n")
    return "\n".join(line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} … {line[-400:]}" for line in lines)


def shortened(value: Any) -> str:
    """Return the repr of a value for a message, in one line and shortened if it is long.

    Args:
        value: any object.
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:40]}…"


class InputError(Exception):
    """Bad input, exit code 2: one sentence with file, key, value and remedy.

    Attributes:
        sentence: the message without the place at its beginning.
        table: table of the file, "" for the top level.
        key: key of the table, if the mistake is in the value of one.
        line: line of the file, if it could not be parsed.
        symbol: index of the walk's symbol that cannot be resolved.
    """

    def __init__(
        self,
        sentence: str,
        *,
        where: str = "",
        table: str = "",
        key: str = "",
        line: int = 0,
        symbol: int | None = None,
    ) -> None:
        super().__init__(concise(f"{where}{sentence}"))
        self.sentence, self.table, self.key, self.line, self.symbol = sentence, table, key, line, symbol

    @property
    def errors(self) -> "tuple[InputError, ...]":
        """The single mistakes."""
        return (self,)

    def under(self, where: str, *, table: str = "", key: str = "") -> "InputError":
        """Return the same mistake, or mistakes, with another place at the beginning, such as a file and a table.

        Args:
            where: beginning of each message.
            table: table of the file, by default the present one.
            key: key of the table, by default the present one.
        """
        return together(
            [
                InputError(error.sentence, where=where, table=table or error.table, key=key or error.key)
                for error in self.errors
            ]
        )


class InputErrors(InputError):
    """Several mistakes in one input, one sentence and one line each."""

    def __init__(self, errors: "Sequence[InputError]") -> None:
        super().__init__("\n".join(map(str, errors)), table=errors[0].table, key=errors[0].key, line=errors[0].line)
        self._errors = tuple(errors)

    @property
    def errors(self) -> tuple[InputError, ...]:
        """The single mistakes."""
        return self._errors


def together(errors: Sequence[InputError]) -> InputError:
    """Return one error for the mistakes in one input, be they one or several.

    Args:
        errors: mistakes in one input.
    """
    return InputErrors(errors) if len(errors) > 1 else errors[0]


class Mistakes:
    """Collects the mistakes of one input: `with mistakes:` around each check, then `report`."""

    def __init__(self) -> None:
        self.errors: list[InputError] = []

    def __enter__(self) -> "Mistakes":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        """Keep a mistake that was raised in the block, and suppress its error; other errors are passed on."""
        if isinstance(error, InputError):
            self.errors += error.errors
        return isinstance(error, InputError)

    def report(self) -> None:
        """Raise the mistakes that were found, if any.

        Raises:
            InputError: one mistake, or several (`InputErrors`).
        """
        if self.errors:
            raise together(self.errors)


class PartMissing(Exception):
    """A missing package, exit code 2: one sentence on its use and installation.

    It is not an InputError, because the user's input is correct.
    """


class GoalMissed(Exception):
    """A computation without a result, exit code 1: one sentence with the reason.

    Attributes:
        symbol: index of the walk's symbol that failed, or None.
        wraps: wraps with which the walk has an orbit, or None.
    """

    def __init__(self, sentence: str, *, symbol: int | None = None, wraps: tuple[int, ...] | None = None) -> None:
        super().__init__(sentence)
        self.symbol, self.wraps = symbol, wraps


class Remark(UserWarning):
    """A caution about a valid result, in one sentence."""


def remark(text: str) -> None:
    """Issue a remark once, as a warning in Python and as a line on stderr on the command line.

    Worker processes issue none.

    Args:
        text: one sentence.
    """
    from multiprocessing import parent_process

    if parent_process() is None:
        # All occurrences of a remark share one location, or each would be shown.
        warnings.warn(text, Remark, stacklevel=2)


_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters except tab and newline, characters that reorder a line, and surrogates."""


def printable(text: str, *, json: bool = False) -> str:
    """Return text with control characters, and bytes of file names that are not UTF-8, escaped as in \\x1b.

    Args:
        text: text from any source.
        json: escape as in \\u001b.
    """

    def written_out(match: re.Match[str]) -> str:
        """Return the escape sequence of the character that matched, in the form of JSON if `json` is True."""
        code = ord(match[0])
        if json:
            return f"\\u{code:04x}"
        # Python holds such a byte as a surrogate.
        return chr(code - 0xDC00 if 0xDC80 <= code <= 0xDCFF else code).encode("unicode_escape").decode()

    return _CONTROLS.sub(written_out, text)
