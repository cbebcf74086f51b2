"""The command line.

Verbs are imported when they are called, which keeps --help fast.
"""

import errno
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

from dpcontrol.cli.output import Call, print_json, print_message
from dpcontrol.cli.verbs import GROUPS, VERBS
from dpcontrol.foundation.config import configured, log_folder
from dpcontrol.foundation.errors import GoalMissed, InputError, PartMissing, Remark, concise, printable
from dpcontrol.foundation.interrupts import ended_by, forget_interrupts, interrupts
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.settings import nearest
from dpcontrol.foundation.version import PACKAGE, PROGRAM, VERSION

_INSTALLED = (sys.prefix, sys.base_prefix, f"{PACKAGE}{os.sep}")
"""Folders of libraries and of this program."""


class _Verbs(click.Group):
    """The verbs: a group of commands that are made when they are called, which keeps --help fast."""

    def invoke(self, ctx: click.Context) -> Any:
        """Call a verb, and print its remarks on stderr, each once.

        Warnings of libraries are suppressed without --debug.
        """
        with warnings.catch_warnings():
            show_warning, printed = warnings.showwarning, set[str]()

            def show(message: Warning | str, category: type[Warning], file: str, *place: Any) -> None:
                """Print a remark that is new; pass on other warnings if the user can do something about them.

                It takes the place of `warnings.showwarning`. `file` is the file that caused the warning, and `printed`
                has the remarks so far.
                """
                if not issubclass(category, Remark):
                    # Warnings from a user's own law or plant are for the user.
                    if ctx.obj.debug or not file.startswith(_INSTALLED):
                        show_warning(message, category, file, *place)
                elif str(message) not in printed:
                    printed.add(str(message))
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
        """Parse the arguments before the verb, and answer --version with --json.

        Whether help is requested is stored in the context, since help must not need a valid configuration.
        """
        if set(args) == {"--version", "--json"}:
            print_json({name: number or None for name, number in versions().items()})
            ctx.exit()
        ctx.meta["help"] = bool({"-h", "--help"}.intersection(args))
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs in the order of work."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a verb, or None for an unknown name."""
        if cmd_name not in VERBS:
            return None
        from dpcontrol.cli.commands import command

        return command(cmd_name, VERBS[cmd_name])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb, or suggest the one with the nearest spelling."""
        if args and args[0] not in VERBS and (close := nearest(args[0], VERBS)):
            ctx.fail(f"there is no verb {args[0]!r}; did you mean {close!r}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs with their summaries into the help, under the headings of their groups."""
        width = max(map(len, VERBS))
        for heading, verbs in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), verb.summary) for name, verb in verbs.items()])


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
    """Return the configured defaults of options by verb and option, for click, and set the configured colour.

    Raises:
        InputError: a mistake in the configuration.
    """
    configured_values = {setting.name: setting.value for setting in configured() if setting.source != "default"}
    if configured_values.get("colour", "auto") != "auto":
        os.environ["FORCE_COLOR" if configured_values["colour"] == "always" else "NO_COLOR"] = "1"
    defaults_of_all = {name: configured_values[name] for name in ("workers",) if name in configured_values}
    defaults_of_demo = {"folder": str(log_folder())} if "logs" in configured_values else {}
    return {verb: defaults_of_all | (defaults_of_demo if verb == "demo" else {}) for verb in VERBS}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit.

    User errors are one line on stderr without a traceback. The help of the program, that of `cli`, explains the exit
    codes.

    Args:
        arguments: arguments after the program's name; None for those of the process.
    """
    words: Any = sys.argv[1:] if arguments is None else arguments
    # One option of the program instead of one of each verb, accepted on either side of the verb.
    debug, words = "--debug" in words, [text for text in words if text != "--debug"]
    for stream in (sys.stdout, sys.stderr):
        # A terminal without arrows shows question marks instead of an error.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    if debug:
        logging.basicConfig()
        logging.getLogger("dpcontrol").setLevel(logging.DEBUG)
    call = Call(debug=debug)
    try:
        for text in words:
            if printable(text) != text or "\n" in text:
                raise InputError(
                    f"{text}: must be one line of UTF-8 without control characters; rename it or use another name"
                )
        with interrupts():
            cli.main(words, prog_name="dpcontrol", standalone_mode=False, obj=call)
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
        call.as_json |= "--json" in words
        code = _failed(error, words, call)
    sys.exit(code)


def _interrupted(error: BaseException) -> int:
    """Report an interrupt on stderr, and return the exit code, 128 plus the number of the signal.

    Args:
        error: the interrupt, whose notes name files that were kept.
    """
    number = ended_by()
    forget_interrupts()
    ending = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
    print_message(f"dpcontrol: {ending}; finished results are kept")
    _echo_notes(error)
    return 128 + number


def _failed(error: Exception, arguments: Sequence[str], call: Call) -> int:
    """Print the error of a verb as one line for each mistake, and return the exit code.

    Args:
        error: error that ended the verb.
        arguments: the command line, for the report of an internal error.
        call: output options; with --json the error is also a document.
    """
    if isinstance(error, GoalMissed):
        sentence, code = str(error), 1
    elif isinstance(error, InputError | PartMissing):
        sentence, code = str(error), 2
    elif isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        hint = f"; see `{context.command_path} --help`" if context is not None else ""
        # click lists choices in lines of their own.
        text = " ".join(line.strip() for line in error.format_message().splitlines())
        sentence, code = f"{concise(text).rstrip('.')}{hint}", error.exit_code
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
    """Write the traceback of an internal error to a file, and return the message that asks for a report.

    Args:
        error: error that no rule foresees.
        arguments: the command line, written to the file.
    """
    trace = "".join(traceback.format_exception(error))
    program = f"{PROGRAM}, Python {sys.version}, {sys.platform}"
    summary = f"internal error of dpcontrol, {' '.join(f'{type(error).__name__}: {error}'.split())[:_MOST]}"
    try:
        handle, name = tempfile.mkstemp(prefix="dpcontrol-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{program}\n{shlex.join(arguments)}\n\n{trace}")
    except OSError:
        return f"{summary}; please report it with the output of --debug: its file could not be written"
    return f"{summary}; please report it with the file {name}, which contains the command and the traceback"


_MOST = 200
"""Number of characters of an internal error in its message."""


def _echo_notes(error: BaseException) -> None:
    """Print the notes of an error and of its causes, such as the names of files that were kept.

    Args:
        error: the last error of a chain.
    """
    link: BaseException | None = error
    while link is not None:
        for note in getattr(link, "__notes__", ()):
            print_message(f"dpcontrol: {note}")
        link = link.__cause__ or link.__context__
