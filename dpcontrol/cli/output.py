"""What a verb prints: a result as text or as JSON on stdout, and messages on stderr."""

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from typing import Any

import click

from dpcontrol.foundation.errors import GoalMissed, printable
from dpcontrol.words.table import Line, TextTable


@dataclass
class Call:
    """Output options of one call of the program.

    Attributes:
        as_json: True to print the result as a JSON document.
        debug: True to print tracebacks and the warnings of libraries.
        shown: True from when the result is printed.
        aside: contexts that are open while the verb works, such as the one that keeps stdout clean.
    """

    as_json: bool = False
    debug: bool = False
    shown: bool = False
    aside: ExitStack = field(default_factory=ExitStack)


def show(result: Any, also: Mapping[str, Any]) -> None:
    """Print a result as one JSON document at full precision, or as lines and tables.

    Args:
        result: result of a public function, a mapping, or a sequence of results.
        also: further entries of the document, such as the file of a picture.

    Raises:
        GoalMissed: the goal of the verb was missed, with the reason.
    """
    from dpcontrol.words.texts import text_of

    call = click.get_current_context().ensure_object(Call)
    call.shown = True
    # While the verb worked with --json, its own output went to stderr. This ends now, for the document alone.
    call.aside.close()
    if call.as_json:
        print_json({**(result.document() if hasattr(result, "document") else result), **also})
        call.aside.enter_context(prints_on_stderr())
    else:
        for line in result.lines() if hasattr(result, "lines") else text_of(result):
            _print(line)
        if also.get("picture"):
            _print(f"drawn to {also['picture']}")
    if missed := getattr(result, "missed", ""):
        raise GoalMissed(missed)


@contextmanager
def prints_on_stderr() -> Iterator[None]:
    """Move what users' objects and workers print from stdout to stderr, so that stdout holds only the document."""
    with redirect_stdout(sys.stderr), ExitStack() as stack:
        # Either stream may be closed.
        with suppress(OSError):
            copy_of_stdout = os.dup(1)
            stack.callback(os.close, copy_of_stdout)
            # Compiled code and other processes write to the descriptor directly.
            os.dup2(2, 1)
            stack.callback(os.dup2, copy_of_stdout, 1)
            if sys.__stdout__ is not None:
                stack.callback(sys.__stdout__.flush)
        yield


def print_json(document: Mapping[str, Any]) -> None:
    """Print the JSON document of a call, of which each call has one, with control characters escaped.

    Args:
        document: nested mappings, lists, arrays and scalars.
    """
    from dpcontrol.foundation.document import plain

    click.echo(printable(json.dumps(plain(document), indent=1, ensure_ascii=False), json=True))


def print_message(text: str) -> None:
    """Print a message as a line on stderr, since stdout is for the result alone.

    Args:
        text: one line.
    """
    # The exit code remains if stderr is full, or its terminal is closed.
    with suppress(OSError):
        click.echo(printable(text), err=True)


def _print(line: Line) -> None:
    """Print a line of a result: a text, a table, or a page in Markdown."""
    if isinstance(line, str):
        click.echo(printable(line))
        return
    from rich.console import Console

    console = Console()
    if isinstance(line, TextTable):
        # A narrow terminal wraps lines, but a narrow table would omit names and digits.
        Console(width=max(console.width, 130) if console.is_terminal else 200).print(_rich_table(line))
        return
    from rich.markdown import Markdown

    Console(width=min(console.width, 126) if console.is_terminal else 126).print(Markdown(line.text))


def _rich_table(shown: TextTable) -> Any:
    """Return the rich library's table of a table of texts, without a meaning of brackets in its cells.

    Args:
        shown: table of texts.
    """
    from rich.table import Table
    from rich.text import Text

    def texts(cells: Iterable[str]) -> Iterator[Text]:
        """Return cells as texts of rich, in which brackets are no markup and control characters are escaped."""
        return (Text(printable(cell)) for cell in cells)

    table = Table(title=Text(printable(shown.title)) if shown.title else None, title_justify="left", title_style="bold")
    for k, column in enumerate(texts(shown.columns)):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in shown.rows:
        table.add_row(*texts(row))
    return table
