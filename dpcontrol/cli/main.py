"""The command line. Verbs are imported when they are called, so that --help is quick."""

import difflib
import errno
import importlib
import os
import shlex
import shutil
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from contextlib import suppress
from io import TextIOWrapper
from typing import Any

import click
from click.shell_completion import CompletionItem

import dpcontrol
from dpcontrol.cli.verbs import DEBUG, Call, print_json, say
from dpcontrol.foundation.errors import GoalMissed, InputError, PartMissing, Remark
from dpcontrol.foundation.interrupts import interrupts, terminated

GROUPS = {
    "Start": {
        "demo": ("start", "Plan, run, score and picture one itinerary."),
        "model": ("start", "Show a model: parameters, equilibria, eigenvalues."),
        "guide": ("start", "Read a page of the guide, or list its pages."),
        "cache": ("start", "Show what is kept of earlier work, where, and its sizes, or empty it."),
    },
    "Design": {
        "orbit": ("connections", "Compute a Lyapunov orbit, or its family, and its Floquet multipliers."),
        "connect": ("connections", "Find all homoclinic or heteroclinic connections of an energy."),
        "bifurcations": ("connections", "Find the energies at which connections appear, split or change their hits."),
        "atlas": ("connections", "Compute all of an energy: orbits, tubes, connections, their graph."),
        "walk": ("walk", "List, count and make walks on the connection graph, and their orbits."),
        "prove": ("prove", "Prove in ball arithmetic that an orbit or a closed walk exists; check a certificate."),
        "plan": ("plan", "Plan an itinerary: shadowing orbit and reference."),
        "reference": ("plan", "Show a reference that a plan made: limits, effort, mesh, error, picture."),
        "planner": ("planner", "Plan by looking: a page in the browser from energy to run."),
    },
    "Run": {
        "run": ("run", "Run an itinerary in closed loop and write its log."),
        "export": ("run", "Write an itinerary's controller as C for a target of one's own."),
        "campaign": ("run", "Run an itinerary with many seeds; report how often it is completed."),
        "rig": ("run", "Start an example bench for runs over UDP in real time."),
        "commission": ("run", "Check what must be right on a rig before its first run, and measure it."),
        "preflight": ("run", "Tell how likely a first run completes, what would end it, and what would help."),
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
                    say(f"dpcontrol: {message}")

            warnings.showwarning = show
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt as error:
                # click begins a new line, after the ^C that a terminal shows.
                if sys.stderr.isatty():
                    raise
                raise click.Abort from error

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if set(args) == {"--version", "--json"}:
            from dpcontrol.foundation.parts import versions

            print_json({name: number or None for name, number in versions().items()})
            ctx.exit()
        if args[:1] == ["help"]:
            # `help VERB` is `VERB --help`.
            args = [*args[1:2], "--help"]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        found = super().shell_complete(ctx, incomplete)
        return [*found, CompletionItem("help")] if "help".startswith(incomplete or "-") else found

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
    epilog="Start with `dpcontrol demo`, then `dpcontrol guide`; every verb has --help with an example, and --json.",
)
@click.version_option(
    dpcontrol.__version__, prog_name="dpcontrol", help="Show the version; with --json those of its parts, too."
)
@click.option("--debug", **DEBUG)
def cli() -> None:
    """Design trajectories of a double pendulum on a cart, and test closed loops that follow them.

    A log, table or model that is there is replaced by the very command that would make it again; any other stays,
    unless --force is given. What is only drawn or computed from files, as pictures and plans, is replaced.

    Exit status: 0 done, 1 goal missed (with the reason), 2 bad input, 70 an error of dpcontrol itself (with the file
    that its report needs), 130 interrupted, 143 ended by SIGTERM, 137 ended by force if a computation does not stop.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit; mistakes of the user are one sentence on stderr, never a traceback."""
    given: Any = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show an arrow shows a question mark; it is no reason to fail.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    call = Call()
    try:
        if any("\0" in text for text in given):
            raise InputError("an argument holds a NUL character, which no name or number has; leave it out")
        with interrupts():
            cli.main(given, prog_name="dpcontrol", standalone_mode=False, obj=call)
        code = 0
    except click.ClickException as error:
        call.as_json |= "--json" in given
        code = _failed(error, given, call)
    except click.exceptions.Exit as done:
        code = done.exit_code
    except (KeyboardInterrupt, click.Abort) as error:
        code = _interrupted(error)
    except Exception as error:  # noqa: BLE001 - the last one: a traceback on a user's terminal is a defect
        code = _failed(error, given, call)
    sys.exit(code)


def _interrupted(error: BaseException) -> int:
    how, code = ("ended by SIGTERM", 143) if terminated() else ("interrupted", 130)
    say(f"dpcontrol: {how}; what was finished is kept")
    _echo_notes(error)
    return code


def _failed(error: Exception, arguments: Sequence[str], call: Call) -> int:
    """Say in a sentence what went wrong; return the exit code."""
    if isinstance(error, GoalMissed):
        sentence, code = str(error), 1
    elif isinstance(error, InputError | PartMissing):
        sentence, code = str(error), 2
    elif isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        more = f"; see `{context.command_path} --help`" if context is not None else ""
        sentence, code = f"{error.format_message().rstrip('.')}{more}", error.exit_code
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        sentence, code = _full(error), 1
    elif isinstance(error, MemoryError):
        sentence, code = "there is not enough memory for this; ask for less at once", 1
    elif isinstance(error, OSError) and error.filename is not None:
        sentence, code = f"cannot use {error.filename}: {error.strerror}; choose another file or folder", 2
    else:
        sentence, code = _unforeseen(error, arguments), 70
    if call.as_json and not call.shown:
        print_json({"status": sentence, "error": code != 1})
    if call.debug:
        say("".join(traceback.format_exception(error)).rstrip())
    # Names may hold line breaks; what is said is one line.
    say(f"dpcontrol: {sentence.replace(chr(10), chr(92) + 'n')}")
    _echo_notes(error)
    return code


def _full(error: OSError) -> str:
    """Return the sentence about a full disk: that of the output, or that of temporary files."""
    folder = tempfile.gettempdir()
    with suppress(OSError):
        if str(error.filename or "").startswith(folder) or shutil.disk_usage(folder).free == 0:
            return f"no space left in the folder of temporary files, {folder}; free some, or set TMPDIR to another"
    return "no space left where the output goes; nothing more was written"


def _unforeseen(error: Exception, arguments: Sequence[str]) -> str:
    """Keep the traceback of an error that no verb foresaw in a file; return the sentence that asks for a report."""
    trace = "".join(traceback.format_exception(error))
    program = f"dpcontrol {dpcontrol.__version__}, Python {sys.version}, {sys.platform}"
    what = f"this is an error of dpcontrol, {' '.join(f'{type(error).__name__}: {error}'.split())[:_MOST]}"
    try:
        handle, name = tempfile.mkstemp(prefix="dpcontrol-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{program}\n{shlex.join(arguments)}\n\n{trace}")
    except OSError:
        return f"{what}; please report it with what --debug prints: no file could be written to keep it"
    return f"{what}; please report it with the file {name}, which holds the command and the traceback"


_MOST = 200
"""Characters of an unforeseen error that its sentence repeats."""


def _echo_notes(error: BaseException) -> None:
    """Say what was noted on the way out of an error or of those behind it: what was kept, and where."""
    found: BaseException | None = error
    while found is not None:
        for note in getattr(found, "__notes__", ()):
            say(f"dpcontrol: {note}")
        found = found.__cause__ or found.__context__
