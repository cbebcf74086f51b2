"""Kinds of failure, told apart by the exit code; remarks, which stop nothing; text made safe to print."""

import re
import warnings


class InputError(Exception):
    """Bad input: one sentence naming file, key, value and remedy. The command line exits with 2."""


class PartMissing(Exception):
    """A package is not installed: one sentence with what needs it and how to install it. The command line exits with 2.

    No InputError: whoever mends or explains a user's input has nothing to say about it.
    """


class GoalMissed(Exception):
    """A computation ended without its result: one sentence with the reason. The command line exits with 1."""


class Remark(UserWarning):
    """What a user should know about a result that is given all the same: one sentence."""


def remark(text: str) -> None:
    """Make a remark: a warning in Python, a line on stderr of the command line, once in either. Workers make none."""
    from multiprocessing import parent_process

    if parent_process() is None:
        # The place is the same for all that makes one remark, or it would be shown for each.
        warnings.warn(text, Remark, stacklevel=2)


_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Control characters but tab and newline, and those that reorder a line."""


def printable(text: str, *, json: bool = False) -> str:
    """Return text with control characters written out, as in \\x1b; json: the text is JSON, which writes \\u001b."""

    def written_out(found: re.Match[str]) -> str:
        return f"\\u{ord(found[0]):04x}" if json else found[0].encode("unicode_escape").decode()

    return _CONTROLS.sub(written_out, text)
