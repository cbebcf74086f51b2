"""Exceptions, remarks, and text that is safe to print.

Exceptions have exit codes. Remarks stop nothing.
"""

import re
import warnings
from collections.abc import Sequence

_WORD = re.compile(r"[^\s/\\]{256,}")
"""A word that is no part of a file's path, because names of files have at most 255 bytes."""
_LONGEST = 2000
"""Number of characters of a sentence."""


def concise(sentence: str) -> str:
    """Return a sentence with long words and lines shortened.

    A file can have a key of a megabyte.

    Args:
        sentence: one sentence or several, a line each.
    """
    lines = _WORD.sub(lambda word: f"{word[0][:40]}…", sentence).split("\n")
    return "\n".join(one if len(one) <= _LONGEST else f"{one[: _LONGEST // 2]} … {one[-400:]}" for one in lines)


class InputError(Exception):
    """Bad input: one sentence with file, key, value and remedy.

    The exit code is 2.

    Attributes:
        symbol: index of the walk's symbol at which it occurs, or None.
        table: table of the file.
        key: key of the table.
        line: line of the file if it could not be parsed, or None.
    """

    def __init__(
        self, sentence: str, *, symbol: int | None = None, table: str = "", key: str = "", line: int | None = None
    ) -> None:
        super().__init__(concise(sentence))
        self.symbol, self.table, self.key, self.line = symbol, table, key, line


class InputErrors(InputError):
    """Several mistakes in one input, one sentence and one line each."""

    def __init__(self, mistakes: Sequence[str]) -> None:
        super().__init__("\n".join(mistakes))
        self.mistakes = tuple(mistakes)


class Mistakes:
    """Collects the mistakes of one input.

    `with mistakes:` around each check, then `report`.
    """

    def __init__(self) -> None:
        self.sentences: list[str] = []

    def __enter__(self) -> "Mistakes":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if isinstance(error, InputError):
            self.sentences += mistakes_of(error)
        return isinstance(error, InputError)

    def report(self) -> None:
        """Raise the mistakes that were found, if any.

        Raises:
            InputError: one mistake, or several (`InputErrors`).
        """
        if self.sentences:
            raise InputErrors(self.sentences) if len(self.sentences) > 1 else InputError(self.sentences[0])


def mistakes_of(error: InputError) -> tuple[str, ...]:
    """Return the sentences of an error, one for each mistake.

    Args:
        error: one mistake, or several (`InputErrors`).
    """
    return getattr(error, "mistakes", (str(error),))


class PartMissing(Exception):
    """A missing package: one sentence on its use and installation.

    The exit code is 2. It is not an InputError, because the user's input is correct.
    """


class GoalMissed(Exception):
    """A computation without a result: one sentence with the reason.

    The exit code is 1.

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
    """Issue a remark once.

    A remark is a warning in Python and a line on stderr on the command line. Worker processes issue none.

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
    """Return text with control characters escaped, as in \\x1b.

    Bytes that are not UTF-8, which names of files can have, are escaped too.

    Args:
        text: text from any source.
        json: escape as in \\u001b.
    """

    def written_out(found: re.Match[str]) -> str:
        code = ord(found[0])
        if json:
            return f"\\u{code:04x}"
        # Python holds such a byte as a surrogate.
        return chr(code - 0xDC00 if 0xDC80 <= code <= 0xDCFF else code).encode("unicode_escape").decode()

    return _CONTROLS.sub(written_out, text)
