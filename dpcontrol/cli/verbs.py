"""What verbs share: their options by group, their answer as text or as JSON on stdout.

@verb("score", example="dpcontrol score logs/outer-turn-0.mcap")
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path))
def command(*, logs: tuple[Path, ...]) -> Answer:
    return Answer(document, lines, missed="")
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from dpcontrol.foundation.errors import GoalMissed, InputError

if TYPE_CHECKING:
    from decimal import Decimal

ENERGY = "Energy in J, zero at the pivot's height."
OUTPUT = "Output"
"""Group of the options that say where results go."""
_SHOWN = "dpcontrol.shown"


class TextTable(NamedTuple):
    """A table for people: the first column to the left, the others to the right."""

    title: str
    columns: Sequence[str]
    rows: Iterable[Sequence[str]]


@dataclass(frozen=True)
class Answer:
    """What a verb found: its JSON document, the lines and tables for people, and why the goal was missed, or ""."""

    document: Mapping[str, Any]
    text: Iterable[str | TextTable]
    missed: str = ""


class Option(click.Option):
    """An option that help lists under a group; suffixes: of which a file to write must have one, where given."""

    def __init__(self, *arguments: Any, group: str = "", suffixes: tuple[str, ...] = (), **others: Any) -> None:
        super().__init__(*arguments, **others)
        self.group, self.suffixes = group, suffixes

    def check(self, value: Path | None) -> None:
        """Reject a file name that promises another format than will be written.

        Raises:
            InputError: names the option, the file and the suffix it needs.
        """
        if value is not None and self.suffixes and value.suffix.lower() not in self.suffixes:
            allowed = " or ".join(self.suffixes)
            raise InputError(
                f"{self.opts[0]} {value}: this writes a {allowed} file; choose a name that ends in {allowed}"
            )


class Command(click.Command):
    """A verb, whose help lists options by group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                sections.setdefault(getattr(param, "group", "") or "Options", []).append(record)
        output = sections.pop(OUTPUT, [])
        for title, records in [*sections.items(), (OUTPUT, output)]:
            with formatter.section(title):
                formatter.write_dl(records)


def option(*names: str, **settings: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator of an option; `group` is the heading under which help lists it."""
    return click.option(*names, cls=Option, **settings)


def file_option(
    *names: str, suffix: str | tuple[str, ...] = (), help: str
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator of an option that names a file to write, which ends in (one of) `suffix` where given."""
    suffixes = (suffix,) if isinstance(suffix, str) else suffix
    kind = click.Path(dir_okay=False, path_type=Path)
    return option(*names, type=kind, group=OUTPUT, suffixes=suffixes, help=help)


def verb(
    name: str, *, example: str, help: str | None = None, note: str = ""
) -> Callable[[Callable[..., Answer | None]], click.Command]:
    """Return a decorator that makes a verb of a function, with --json; the function's answer is shown.

    example: a command line; note: what else stands beside it in the help.
    """

    def decorate(function: Callable[..., Answer | None]) -> click.Command:
        @wraps(function)
        def run(*, as_json: bool, **options: Any) -> None:
            context = click.get_current_context()
            try:
                for param in context.command.params:
                    if isinstance(param, Option):
                        param.check(options.get(str(param.name)))
                answer = function(**options)
            except (InputError, GoalMissed) as error:
                if as_json and _SHOWN not in context.meta:
                    _print_json({"status": str(error), "error": isinstance(error, InputError)})
                raise
            if answer is not None:
                show(answer)

        json_option = Option(
            ["--json", "as_json"], is_flag=True, group=OUTPUT, help="Print one JSON document on stdout."
        )
        run.__dict__.setdefault("__click_params__", []).insert(0, json_option)
        epilog = f"Example:  {example}" + (f"      {note}" if note else "")
        return click.command(name, cls=Command, help=help, epilog=epilog)(run)

    return decorate


def show(answer: Answer) -> None:
    """Print an answer as the call asks for: one JSON document with numbers at full precision, or lines and tables.

    Raises:
        GoalMissed: the answer says why.
    """
    context = click.get_current_context()
    context.meta[_SHOWN] = True
    if context.params["as_json"]:
        _print_json(answer.document)
    else:
        for item in answer.text:
            click.echo(item) if isinstance(item, str) else _print_table(item)
    if answer.missed:
        raise GoalMissed(answer.missed)


def _print_json(document: Mapping[str, Any]) -> None:
    from dpcontrol.foundation.files import plain

    click.echo(json.dumps(plain(document), indent=1, ensure_ascii=False))


def _print_table(shown: TextTable) -> None:
    """Print a table on stdout; as wide as it needs when stdout is no terminal."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=shown.title or None, title_justify="left", title_style="bold")
    for k, column in enumerate(shown.columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in shown.rows:
        table.add_row(*row)
    console = Console()
    # A narrow terminal wraps lines; a narrow table would leave out names and digits.
    console = Console(width=max(console.width, 130) if console.is_terminal else 200)
    console.print(table)


def drawn_to(picture: Path | None) -> list[str]:
    """Return the line that names a picture, none where there is none."""
    return [] if picture is None else [f"drawn to {picture}"]


def multiplier_text(value: complex, digits: int = 11) -> str:
    """Return a Floquet multiplier for people: real where it is; the pair at one is known to some twelve digits."""
    value = complex(value)
    if abs(value.imag) < 1e-12:
        return f"{value.real:.{digits}g}"
    return f"{value.real:.{min(digits, 10)}g}{value.imag:+.{min(digits, 10)}g}i"


def extended_text(state: Sequence[str], indent: str) -> list[str]:
    """Return the lines of a state (N,) in decimal digits: positions, then rates."""
    half = len(state) // 2
    return [f"{indent}{'position' if k < half else 'rate'} {k % half + 1}  {value}" for k, value in enumerate(state)]


class Hits(click.ParamType):
    """Crossings of the section: N for both tubes, or N,M for the unstable and the stable one."""

    name = "n[,m]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        numbers = str(value).split(",")
        if len(numbers) in (1, 2) and all(n.strip().isdecimal() and 1 <= int(n) <= 9 for n in numbers):
            return int(numbers[0]), int(numbers[-1])
        self.fail(f"{value!r} is neither one number from 1 to 9 nor two, as in 1,2.", param, ctx)


class DecimalNumber(click.ParamType):
    """A number kept as the decimal that was typed, for extended precision: 0.2 is one fifth."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> "Decimal":
        from decimal import Decimal, InvalidOperation

        try:
            return Decimal(value)
        except InvalidOperation:
            self.fail(f"{value!r} is not a number.", param, ctx)


def exact_energy_option(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the energy, kept as the decimal that was typed."""
    return click.option("--energy", required=True, type=DecimalNumber(), help=ENERGY)(function)


def saddle_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the saddles between which connections are sought, as source and target."""
    function = click.option("--to", "target", required=True, help="Saddle whose orbit they join.")(function)
    return click.option("--from", "source", required=True, help="Saddle whose orbit connections leave.")(function)


def hits_option(default: str, *, group: str = "") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator of the option for crossings of the section; default: what holds without it, in words."""
    text = "Which crossings of the section count: the k-th of both tubes, or N,M for the unstable and the stable one."
    return option("--hits", type=Hits(), group=group, help=f"{text} [default: {default}]")


def precision_option(extended: str, *, group: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator of the option for the precision; extended: what extended precision does."""
    kinds = click.Choice(["double", "extended"])
    return option(
        "--precision", type=kinds, default="double", show_default=True, group=group, help=f"extended: {extended}"
    )
