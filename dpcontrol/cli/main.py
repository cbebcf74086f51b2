"""The command line.

Verbs are imported when they are called, which keeps --help fast.
"""

import errno
import importlib
import logging
import os
import shlex
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from io import TextIOWrapper
from typing import Any

import click
from click.shell_completion import CompletionItem

from dpcontrol.cli.commands import Call, Verb, command, print_json, print_message
from dpcontrol.foundation.errors import GoalMissed, InputError, PartMissing, Remark, concise, printable
from dpcontrol.foundation.interrupts import ended_by, forget_interrupts, interrupts
from dpcontrol.foundation.version import PACKAGE, PROGRAM, VERSION

GROUPS = {
    "Start": {
        "demo": Verb(
            "Plan, run, score and draw one itinerary.",
            "demo",
            "dpcontrol demo --itinerary cross",
            names={"itinerary": "--itinerary"},
        ),
        "model": Verb(
            "Show a model: parameters, equilibria, eigenvalues.",
            "describe",
            "dpcontrol model lab",
            "MODEL is a name (in ./models or shipped) or a path.",
        ),
        "guide": Verb(
            "Show a page of the guide, or list its pages.",
            "read_guide",
            "dpcontrol guide start",
            "`dpcontrol guide` lists the pages in reading order.",
        ),
        "config": Verb(
            "Show the defaults of the command line, and where each comes from.", "config", "dpcontrol config"
        ),
        "cache": Verb(
            "List the cached results with their sizes, or delete them.",
            "cache",
            "dpcontrol cache --clear",
            "The folder is $DPCONTROL_CACHE, else ~/.cache/dpcontrol.",
        ),
    },
    "Design": {
        "orbit": Verb(
            "Compute a Lyapunov orbit, or its family, and its Floquet multipliers.",
            "find_orbits",
            "dpcontrol orbit lab --saddle down-up --energy -0.07",
        ),
        "connect": Verb(
            "Find all homoclinic or heteroclinic connections of an energy.",
            "find_connections",
            "dpcontrol connect lab --from down-up --to up-down --energy 0.2",
            names={"source": "--from", "target": "--to"},
        ),
        "bifurcations": Verb(
            "Find the energies at which connections appear, split or change their hits.",
            "find_bifurcations",
            "dpcontrol bifurcations lab --from down-up --to down-up --energies -0.11 -0.09",
            names={"source": "--from", "target": "--to"},
        ),
        "atlas": Verb(
            "Compute all orbits, tubes and connections of an energy.",
            "atlas",
            "dpcontrol atlas lab --energy 0.2",
            "then: dpcontrol review FILE",
        ),
        "walk": Verb(
            "List, count and create walks on the connection graph, and their orbits.",
            "find_walks",
            'dpcontrol walk lab --energy 0.2 -s "down-up +" -s "down-up > up-down" --solve',
            names={"symbols": ("-s", "--symbol"), "source": "--from", "target": "--to"},
        ),
        "prove": Verb(
            "Prove that an orbit or a closed walk exists, or check a certificate.",
            "prove_statement",
            "dpcontrol prove orbit lab --saddle down-up --energy -0.07",
            "For check, MODEL is the file of a certificate.",
            {"symbols": ("-s", "--symbol"), "source": "--from", "target": "--to", "names": "--name"},
        ),
        "plan": Verb(
            "Plan an itinerary: shadowing orbit and reference.",
            "plan",
            "dpcontrol plan outer-turn",
            "ITINERARY is a name (in ./itineraries or shipped) or the path of a .toml, or of a plan from --out.",
        ),
        "reference": Verb(
            "Show a reference: limits, effort, mesh, error, picture.",
            "open_reference",
            "dpcontrol plan cross --out cross.npz; dpcontrol reference cross.npz",
        ),
        "schema": Verb(
            "Print the JSON Schema of itineraries or models, for editors.", "schema", "dpcontrol schema itinerary"
        ),
        "planner": Verb(
            "Plan in the browser, from an energy to a run.",
            "open_planner",
            "dpcontrol planner lab",
            "MODEL is a name (in ./models or shipped) or a path.",
        ),
    },
    "Run": {
        "run": Verb(
            "Run an itinerary in closed loop and write its log.",
            "launch",
            "dpcontrol run outer-turn --seed 3 --mismatch 0.05",
            names={"source": "--from", "program": "--controller-program", "log": "--out"},
        ),
        "export": Verb(
            "Write the controller of an itinerary as C for your own target.",
            "export",
            "dpcontrol export outer-turn --out controller --float",
            names={"folder": "--out", "single": "--float", "unit": "--fmu"},
        ),
        "campaign": Verb(
            "Run an itinerary with many seeds and count the completed runs.",
            "campaign",
            "dpcontrol campaign outer-turn --runs 200 --mismatch 0.05 --lag 0.005",
            names={"first_seed": "--seed-from"},
        ),
        "rig": Verb(
            "Start an example bench for runs over UDP in real time.",
            "start_bench",
            "dpcontrol rig outer-turn --port 47000 --mismatch 0.05",
            names={"faults": "--fault"},
        ),
        "commission": Verb(
            "Measure a rig before its first run: signs, scales, delay, switches.",
            "commission",
            "dpcontrol commission outer-turn --fault encoder-2-reversed",
            "exits with 1",
            names={"faults": "--fault"},
        ),
        "preflight": Verb(
            "Predict whether a first run completes, and find helpful changes.",
            "preflight",
            "dpcontrol preflight turn-from-rest --lag 0.005 --picture preflight.pdf",
            names={"first_seed": "--seed-from"},
        ),
    },
    "Review": {
        "score": Verb(
            "Report whether logged runs completed their itineraries.",
            "score",
            "dpcontrol score logs/outer-turn-0.mcap --why",
        ),
        "review": Verb(
            "Open a log in the viewer, or save a recording or a picture.",
            "review",
            "dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png",
        ),
        "report": Verb(
            "Write one page on a log or a campaign.",
            "report",
            "dpcontrol report logs/outer-turn-0.mcap --picture outer-turn.pdf",
            names={"page": "--picture"},
        ),
        "info": Verb(
            "Show the contents of a log: topics, rates, metadata, attachments.",
            "log_summary",
            "dpcontrol info logs/outer-turn-0.mcap",
        ),
        "recover": Verb(
            "Rebuild a truncated or damaged log, and report the losses.",
            "recover_log",
            "dpcontrol recover logs/outer-turn-0.mcap.partial",
            names={"out": "--out"},
        ),
    },
    "Recordings": {
        "import": Verb(
            "Import a recording of the bench as a log.",
            "import_recording",
            "dpcontrol import swing.csv --mapping my-rig.toml --repair nan,gaps",
            names={"repairs": "--repair"},
        ),
        "identify": Verb(
            "Identify a model from recordings of the bench.",
            "identify",
            "dpcontrol identify logs/lab_free_swing.mcap --model lab --out models/rig.toml",
        ),
        "replay": Verb(
            "Predict a recording by a model, and run an estimator over it.",
            "replay",
            "dpcontrol replay logs/lab_free_swing.mcap --model lab --estimator ukf",
        ),
    },
    "Charts": {
        "figures": Verb(
            "Draw the computational figures of the paper, with captions.",
            "draw_figures",
            "dpcontrol figures tubes heteroclinics --out pictures",
            names={"folder": "--out"},
        ),
        "bench": Verb(
            "Chart speed against accuracy, and the limits of methods.",
            "draw_charts",
            "dpcontrol bench propagation --quick --out charts",
            names={"folder": "--out"},
        ),
    },
}
"""Verbs by heading, in the order of work, each with its module and a summary."""
VERBS = {verb: entry for verbs in GROUPS.values() for verb, entry in verbs.items()}


_INSTALLED = (sys.prefix, sys.base_prefix, f"{PACKAGE}{os.sep}")
"""Folders of libraries and of this program."""


class _Verbs(click.Group):
    """A group whose commands live in modules that are imported on demand."""

    def invoke(self, ctx: click.Context) -> Any:
        with warnings.catch_warnings():
            show_others, shown = warnings.showwarning, set[str]()

            def show(message: Warning | str, category: type[Warning], file: str, *place: Any) -> None:
                if not issubclass(category, Remark):
                    # Warnings from a user's own law or plant are for the user.
                    if ctx.obj.debug or not file.startswith(_INSTALLED):
                        show_others(message, category, file, *place)
                elif str(message) not in shown:
                    shown.add(str(message))
                    print_message(f"dpcontrol: {message}")

            warnings.showwarning = show
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt as error:
                # click starts a new line after the ^C of a terminal.
                if sys.stderr.isatty():
                    raise
                raise click.Abort from error

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if set(args) == {"--version", "--json"}:
            from dpcontrol.foundation.parts import versions

            print_json({name: number or None for name, number in versions().items()})
            ctx.exit()
        if args[:1] == ["help"]:
            # `help VERB` is `VERB --help`, and `help help` is `help`.
            verbs = [text for text in args if text != "help" and not text.startswith("-")]
            if verbs[1:]:
                ctx.fail(f"help shows one verb; remove {shlex.join(verbs[1:])!r}")
            args = [*verbs, "--help"]
        ctx.meta["help"] = bool({"-h", "--help"}.intersection(args))
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        found = super().shell_complete(ctx, incomplete)
        return [*found, CompletionItem("help")] if "help".startswith(incomplete or "-") else found

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        entry = VERBS[cmd_name]
        if isinstance(entry, Verb):
            return command(cmd_name, entry)
        module = importlib.import_module(f"dpcontrol.cli.{entry[0]}")
        return getattr(module, f"{cmd_name}_command")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in VERBS:
            from dpcontrol.foundation.settings import nearest

            if close := nearest(args[0], VERBS):
                ctx.fail(f"there is no verb {args[0]!r}; did you mean {close!r}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, VERBS))
        for heading, verbs in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(verb.ljust(width), _summary(entry)) for verb, entry in verbs.items()])


def _summary(entry: Any) -> str:
    return entry.summary if isinstance(entry, Verb) else entry[1]


@click.group(
    cls=_Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Start with `dpcontrol demo`, then `dpcontrol guide`. Every verb has --help with an example, and --json.",
)
@click.version_option(VERSION, prog_name="dpcontrol", help="Version, and with --json the versions of all parts.")
@click.option(
    "--debug", is_flag=True, expose_value=False, help="Tracebacks and libraries' warnings on stderr; also after a verb."
)
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Design and track trajectories of a double pendulum on a cart.

    Default names are free names: logs/NAME.mcap, then logs/NAME.2.mcap. A file that --out names is replaced only by
    the command that made it, or with --force. Pictures and plans are always replaced.

    Exit codes: 0 done, 1 goal missed (with the reason), 2 bad input, 70 internal error (with a file for the report),
    129 ended by SIGHUP, 130 interrupted, 141 the reader of the output ended first, 143 ended by SIGTERM.
    """
    if ctx.invoked_subcommand in VERBS:
        # Help is shown whatever the configuration contains.
        with suppress(InputError) if ctx.meta["help"] else nullcontext():
            ctx.default_map = _defaults()


def _defaults() -> dict[str, dict[str, Any]]:
    """Return the configured defaults of options by verb; apply the colour.

    Raises:
        InputError: a mistake in the configuration.
    """
    from dpcontrol.foundation.config import configured, log_folder

    own = {one.name: one.value for one in configured() if one.source != "default"}
    if own.get("colour", "auto") != "auto":
        os.environ["FORCE_COLOR" if own["colour"] == "always" else "NO_COLOR"] = "1"
    everywhere = {name: own[name] for name in ("workers",) if name in own}
    folder = {"folder": str(log_folder())} if "logs" in own else {}
    return {verb: everywhere | (folder if verb == "demo" else {}) for verb in VERBS}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit.

    User errors are one line on stderr without a traceback.

    Args:
        arguments: arguments after the program's name; None for those of the process.
    """
    given: Any = sys.argv[1:] if arguments is None else arguments
    # One option of the program instead of one of each verb, accepted on either side of the verb.
    debug, given = "--debug" in given, [text for text in given if text != "--debug"]
    for stream in (sys.stdout, sys.stderr):
        # A terminal without arrows shows question marks instead of an error.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    if debug:
        logging.basicConfig()
        logging.getLogger("dpcontrol").setLevel(logging.DEBUG)
    call = Call(debug=debug)
    try:
        for text in given:
            if printable(text) != text or "\n" in text:
                raise InputError(
                    f"{text}: must be one line of UTF-8 without control characters; rename it or use another name"
                )
        with interrupts():
            cli.main(given, prog_name="dpcontrol", standalone_mode=False, obj=call)
        code = 0
    except click.exceptions.Exit as done:
        code = done.exit_code
    except SystemExit as done:
        # click ends the program with 0 after completing words, and with 1 where the reader of a pipe has ended.
        # Shells report the latter as 128 + SIGPIPE.
        code = 141 if done.code else 0
    except (KeyboardInterrupt, click.Abort) as error:
        code = _interrupted(error)
    except Exception as error:  # noqa: BLE001 - the last one: a traceback on a user's terminal is a defect
        # The error may precede the verb, which reads the option.
        call.as_json |= "--json" in given
        code = _failed(error, given, call)
    sys.exit(code)


def _interrupted(error: BaseException) -> int:
    number = ended_by()
    forget_interrupts()
    how = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
    print_message(f"dpcontrol: {how}; finished results are kept")
    _echo_notes(error)
    return 128 + number


def _failed(error: Exception, arguments: Sequence[str], call: Call) -> int:
    """Print the error as one line, and return the exit code."""
    if isinstance(error, GoalMissed):
        sentence, code = str(error), 1
    elif isinstance(error, InputError | PartMissing):
        sentence, code = str(error), 2
    elif isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        more = f"; see `{context.command_path} --help`" if context is not None else ""
        # click lists choices in lines of their own.
        text = " ".join(line.strip() for line in error.format_message().splitlines())
        sentence, code = f"{concise(text).rstrip('.')}{more}", error.exit_code
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        place = error.filename or f"standard output or in {tempfile.gettempdir()}"
        sentence, code = f"no space left on {place}; free space, redirect the output, or set TMPDIR", 1
    elif isinstance(error, MemoryError):
        sentence, code = "there is not enough memory; use fewer or smaller inputs at once", 1
    elif isinstance(error, OSError) and error.strerror:
        name = "a file" if error.filename is None else error.filename
        sentence, code = f"cannot use {name}: {error.strerror}; choose another file or folder", 2
    else:
        sentence, code = _unforeseen(error, arguments), 70
    if call.as_json and not call.shown:
        # The message on stderr and the exit code remain if stdout is full or closed.
        with suppress(OSError):
            print_json({"status": sentence, "error": code != 1})
    if call.debug:
        print_message("".join(traceback.format_exception(error)).rstrip())
    # Names may hold line breaks; each mistake is one line.
    for mistake in map(str, error.errors) if isinstance(error, InputError) else (sentence,):
        print_message(f"dpcontrol: {mistake.replace(chr(10), chr(92) + 'n')}")
    _echo_notes(error)
    return code


def _unforeseen(error: Exception, arguments: Sequence[str]) -> str:
    """Write the traceback of an internal error to a file.

    The returned message asks for a report.
    """
    trace = "".join(traceback.format_exception(error))
    program = f"{PROGRAM}, Python {sys.version}, {sys.platform}"
    what = f"internal error of dpcontrol, {' '.join(f'{type(error).__name__}: {error}'.split())[:_MOST]}"
    try:
        handle, name = tempfile.mkstemp(prefix="dpcontrol-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{program}\n{shlex.join(arguments)}\n\n{trace}")
    except OSError:
        return f"{what}; please report it with the output of --debug: its file could not be written"
    return f"{what}; please report it with the file {name}, which contains the command and the traceback"


_MOST = 200
"""Number of characters of an internal error in its message."""


def _echo_notes(error: BaseException) -> None:
    """Print the notes of an error and of its causes.

    Notes are, for example, the files that were kept.
    """
    found: BaseException | None = error
    while found is not None:
        for note in getattr(found, "__notes__", ()):
            print_message(f"dpcontrol: {note}")
        found = found.__cause__ or found.__context__
