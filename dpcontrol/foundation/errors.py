"""The two kinds of failure a user meets, told apart by the command line's exit code."""


class InputError(Exception):
    """Bad input: one sentence naming file, key, value and remedy. The command line exits with 2."""


class GoalMissed(Exception):
    """A computation ended without its result: one sentence with the reason. The command line exits with 1."""
