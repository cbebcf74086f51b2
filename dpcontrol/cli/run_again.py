"""`dpcontrol run --from LOG`: a run repeated from its log."""

from pathlib import Path

import click
from click.core import ParameterSource

from dpcontrol.cli.output import print_json, progress_bar
from dpcontrol.cli.score import print_score
from dpcontrol.foundation.errors import GoalMissed, InputError

_ALLOWED = ("source", "out", "as_json")


def repeat(source: Path, out: Path | None, *, as_json: bool) -> None:
    """Repeat a run, print its score and whether every message is the same.

    Raises:
        InputError: the log cannot be repeated, or other options ask for another run.
        GoalMissed: a message differs, or the run was not completed.
    """
    from dpcontrol.scenes.run import repeat_run, repeated_log

    context = click.get_current_context()
    asked = {p.name: p for p in context.command.params if p.name not in _ALLOWED}
    given = [p for name, p in asked.items() if context.get_parameter_source(str(name)) is ParameterSource.COMMANDLINE]
    if given:
        names = ", ".join(p.human_readable_name if isinstance(p, click.Argument) else p.opts[0] for p in given)
        raise InputError(f"--from repeats a run as it was: leave out {names}")
    with progress_bar("run") as progress:
        done = repeat_run(source, out or repeated_log(source), progress=progress)
    same = done.comparison
    if as_json:
        repeated = {"of": str(source), "identical_messages": same.messages, "difference": same.difference}
        print_json({**done.score.document(), "repeated": repeated})
    else:
        print_score(done.score)
        click.echo(f"  repeats {source}: {same.messages:,} messages are identical")
    if same.difference is not None:
        raise GoalMissed(f"not the same run: {same.difference}{f'; {done.versions}' if done.versions else ''}")
    if done.score.completed is False:
        raise GoalMissed(f"not completed: {done.score.reason}")
