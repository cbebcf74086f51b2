"""The command line. Verbs are imported when they are called, so that --help is quick."""

import difflib
import errno
import importlib
import signal
import sys
import threading
import warnings
from io import TextIOWrapper
from types import FrameType
from typing import Any

import click

import dpcontrol
from dpcontrol.foundation.errors import GoalMissed, InputError, Remark

GROUPS = {
    "Start": {
        "demo": ("start", "Plan, run, score and picture one itinerary."),
        "model": ("start", "Show a model: parameters, equilibria, eigenvalues."),
        "cache": ("start", "Show what is kept of earlier work, where, and its sizes, or empty it."),
    },
    "Design": {
        "orbit": ("orbit", "Compute a Lyapunov orbit, or its family, and its Floquet multipliers."),
        "connect": ("connections", "Find all homoclinic or heteroclinic connections of an energy."),
        "bifurcations": ("connections", "Find the energies at which connections appear, split or change their hits."),
        "atlas": ("connections", "Compute all of an energy: orbits, tubes, connections, their graph."),
        "walk": ("walk", "List, count and make walks on the connection graph, and their orbits."),
        "plan": ("plan", "Plan an itinerary: shadowing orbit and reference."),
        "reference": ("plan", "Show a reference that a plan made: limits, effort, mesh, error, picture."),
    },
    "Run": {
        "run": ("run", "Run an itinerary in closed loop and write its log."),
        "campaign": ("run", "Run an itinerary with many seeds; report how often it is completed."),
        "rig": ("run", "Start an example bench for runs over UDP in real time."),
    },
    "Review": {
        "score": ("review", "Report whether logged runs did what was asked."),
        "review": ("review", "Open a log in the viewer, or save a recording or a picture."),
        "report": ("review", "Write one page on a log or a campaign."),
        "info": ("review", "Show what is in a log: topics, rates, metadata, attachments."),
        "recover": ("review", "Rebuild a log that is cut or damaged, and report what is lost."),
    },
    "Recordings": {
        "import": ("recordings", "Import a recording of the bench as a log."),
        "identify": ("recordings", "Identify a model from recordings of the bench."),
        "replay": ("recordings", "Predict a recording by a model, and run an estimator over it."),
    },
    "Charts": {
        "figures": ("charts", "Draw the paper's computational figures, with captions."),
        "bench": ("charts", "Chart speed against accuracy, and where methods stop working."),
    },
}
"""Verbs by heading, in the order of work, each with the module that holds it and what it does."""
VERBS = {verb: entry for verbs in GROUPS.values() for verb, entry in verbs.items()}


class _Verbs(click.Group):
    """A group whose commands live in modules that are imported on demand."""

    def invoke(self, ctx: click.Context) -> Any:
        with warnings.catch_warnings():
            show_others, shown = warnings.showwarning, set[str]()

            def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
                if not issubclass(category, Remark):
                    show_others(message, category, *place)
                elif str(message) not in shown:
                    shown.add(str(message))
                    click.echo(f"dpcontrol: {message}", err=True)

            warnings.showwarning = show
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        module = importlib.import_module(f"dpcontrol.cli.{VERBS[cmd_name][0]}")
        return getattr(module, f"{cmd_name}_command")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        close = difflib.get_close_matches(args[0], VERBS, n=1) if args else []
        if close and args[0] not in VERBS:
            ctx.fail(f"there is no verb {args[0]!r}; did you mean {close[0]!r}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, VERBS))
        for heading, verbs in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(verb.ljust(width), text) for verb, (_, text) in verbs.items()])


@click.group(
    cls=_Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Start with `dpcontrol demo`; every verb has --help with an example, and --json for programs.",
)
@click.version_option(dpcontrol.__version__, prog_name="dpcontrol")
def cli() -> None:
    """Design trajectories of a double pendulum on a cart, and test closed loops that follow them.

    Exit status: 0 done, 1 goal missed (with the reason), 2 bad input.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit; mistakes of the user are one sentence on stderr, never a traceback."""
    given: Any = sys.argv[1:] if arguments is None else arguments
    interrupted = _note_interrupts()
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show an arrow shows a question mark; it is no reason to fail.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        cli.main(given, prog_name="dpcontrol", standalone_mode=False)
        code = 0
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except click.exceptions.Exit as done:
        code = done.exit_code
    except (InputError, GoalMissed) as error:
        click.echo(f"dpcontrol: {error}", err=True)
        _echo_notes(error)
        code = 2 if isinstance(error, InputError) else 1
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        click.echo("dpcontrol: no space left where the output goes; nothing more was written", err=True)
        code = 1
    except (KeyboardInterrupt, click.Abort, ImportError, SystemError) as error:
        # Compiled code that is interrupted reports it as an error of its own.
        if isinstance(error, ImportError | SystemError) and not interrupted:
            raise
        click.echo("dpcontrol: interrupted; what was finished is kept", err=True)
        _echo_notes(error)
        code = 130
    sys.exit(code)


def _echo_notes(error: BaseException) -> None:
    """Say what was noted on the way out of an error or of those behind it: what was kept, and where."""
    found: BaseException | None = error
    while found is not None:
        for note in getattr(found, "__notes__", ()):
            click.echo(f"dpcontrol: {note}", err=True)
        found = found.__cause__ or found.__context__


def _note_interrupts() -> list[int]:
    """Return a list that grows with each Ctrl-C, which still raises KeyboardInterrupt."""
    noted: list[int] = []

    def handler(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        raise KeyboardInterrupt

    # Only the main thread may set handlers; called from another, Python's own stays.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, handler)
    return noted
