"""The two kinds of failure a user meets, told apart by the exit code; and remarks, which stop nothing."""

import warnings


class InputError(Exception):
    """Bad input: one sentence naming file, key, value and remedy. The command line exits with 2."""


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
