"""Shared parts of verbs: options, answers as text or as JSON.

Options are parameters of a function. Answers are printed on stdout.

@verb("score", example="dpcontrol score logs/outer-turn-0.mcap")
def score_command(*, logs: tuple[Path, ...] = argument(), seed: int = option(default=0, help="…")) -> Answer:
    return Answer(document, lines, missed="")
"""

import inspect
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import click

from dpcontrol.cli.commands import Call, _prints_on_stderr, print_json
from dpcontrol.cli.commands import print_message as print_message
from dpcontrol.cli.completion import COMPLETERS
from dpcontrol.foundation.errors import GoalMissed, InputError, printable
from dpcontrol.words.table import Markdown as Markdown
from dpcontrol.words.table import TextTable as TextTable
from dpcontrol.words.table import table as table

T = TypeVar("T")

OUTPUT, WORK = "Output", "Work"
"""Groups of options: output files, and distribution of work."""


def claim(file: Path, *, folder: bool = False) -> Path:
    """Prevent other commands from writing a file until the end.

    The lock ends with this command. The file is returned.

    Args:
        file: file to write.
        folder: True for a folder, default False.

    Raises:
        InputError: another command is writing it, or it cannot be written.
    """
    from dpcontrol.foundation.files import checked_folder, checked_target, claimed

    (checked_folder if folder else checked_target)(file)
    context = click.get_current_context()
    files, place = context.meta.setdefault("files", set()), Path(os.path.realpath(file))
    if place not in files:
        files.add(place)
        context.with_resource(claimed(file))
    return file


def claim_free(file: Path, make: Callable[[Path], T]) -> T:
    """Return the result of `make` for the first free name.

    The names are NAME, NAME.2, NAME.3 …; see `free_name`.

    Args:
        file: the first name.
        make: see `free_name`.
    """
    from dpcontrol.foundation.files import free_name

    return click.get_current_context().with_resource(free_name(file, make))


@dataclass(frozen=True)
class Answer:
    """The answer of a verb: its JSON document and its text.

    `missed` is the reason why the goal was missed, or "".
    """

    document: Mapping[str, Any]
    text: Iterable[str | TextTable | Markdown]
    missed: str = ""


_LARGEST = 2**63 - 1
"""Largest integer that estimates of work accept without overflow."""


class Option(click.Option):
    """An option that help lists under a group, with its default.

    Args:
        arguments: see `click.Option`.
        group: heading in the help.
        suffixes: allowed endings of the file to write, if any.
        absent: the default in words, which help texts can also give in brackets.
        others: see `click.Option`.
    """

    def __init__(
        self,
        *arguments: Any,
        group: str = "",
        suffixes: tuple[str, ...] = (),
        absent: str = "none",
        **others: Any,
    ) -> None:
        super().__init__(*arguments, **others)
        self.group, self.suffixes = group, suffixes
        if self.is_flag or self.required or self.show_default or not self.help:
            return
        self.help = re.sub(r" \[(?!default: )([^\]]+)\](?=\.?$)", r" [default: \1]", self.help)
        if "[default: " not in self.help:
            self.help += f" [default: {absent}]"

    def check(self, value: Any) -> None:
        """Reject wrong file names, useless integers, and NaN for a range.

        File names must not have the suffix of another format.

        Args:
            value: value or values of the option.

        Raises:
            InputError: names the option, the file and the suffix it needs, or the number.
            OSError: an impossible file: its name is too long, or its folder is a file. This is checked before the work.
        """
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(self.type, click.FloatRange) and one is not None and math.isnan(one):
                # To click, which compares with the ends, NaN is within any range.
                raise InputError(f"{self.opts[0]} = nan: must be a number in the range that --help shows")
            if isinstance(one, int) and abs(one) > _LARGEST:
                raise InputError(f"{self.opts[0]}: a number with too many digits; must be at most {_LARGEST:,}")
        if isinstance(value, Path) and not value.name and self.type is not FOLDER:
            raise InputError(f"{self.opts[0]} {value}: this is not a file name; give a name")
        if isinstance(value, Path):
            with suppress(FileNotFoundError):
                value.lstat()
        if isinstance(value, Path) and self.suffixes and value.suffix.lower() not in self.suffixes:
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


class _Declared(NamedTuple):
    kind: type[click.Parameter]
    names: tuple[str, ...]
    settings: dict[str, Any]


class Several(NamedTuple):
    """Options that form one parameter of a verb."""

    options: Sequence[Option]
    make: Callable[..., Any]


def argument(**settings: Any) -> Any:
    """Declare a verb's parameter as an argument, by its annotation.

    It is required unless the annotation allows None.

    Args:
        settings: further arguments of `click.Argument`.
    """
    return _Declared(click.Argument, (), settings)


def option(*names: str, help: str, default: Any = None, **settings: Any) -> Any:
    """Declare a verb's parameter as an option.

    The annotation is its type. Without a default the option is required, unless it is a flag or a tuple of any length,
    or allows None.

    Args:
        names: names on the command line; without any, --its-name.
        help: a noun phrase with its unit.
        default: default value.
        settings: `group` of the help, and further arguments of `Option`.
    """
    # click counts an option with a default as given, even if the default is None.
    given = {} if default is None else {"default": default}
    return _Declared(Option, names, {"help": help, **given, **settings})


FILE, FOLDER = click.Path(dir_okay=False, path_type=Path), click.Path(file_okay=False, path_type=Path)


def file_option(*, suffix: str | tuple[str, ...] = (), help: str) -> Any:
    """Declare a parameter as an option for a file to write.

    Args:
        suffix: allowed ends of the name; () for any.
        help: a noun phrase with the file's format.
    """
    return option(type=FILE, group=OUTPUT, suffixes=(suffix,) if isinstance(suffix, str) else suffix, help=help)


def force_option() -> Any:
    """Declare a parameter as the option --force.

    It lifts the one rule of all writers of logs, tables and models.
    """
    text = "Replace an existing file, whatever made it. [without: only a file that the same command made]"
    return option("--force", group=OUTPUT, help=text)


def _parameter(verb: str, name: str, annotation: Any, declared: _Declared) -> click.Parameter:
    """Return the click parameter for a parameter of a verb's function."""
    kind, names, settings = declared.kind, declared.names, dict(declared.settings)
    settings.setdefault("shell_complete", COMPLETERS.get((verb, name)) or COMPLETERS.get(("", name)))
    choices = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    (held,) = (one for one in choices if one is not type(None))
    parts: tuple[Any, ...] = get_args(held) if get_origin(held) is tuple else ()
    several, default = parts[-1:] == (...,), settings.get("default")
    settings.setdefault("type", _click_type(parts[0] if several else held))
    if kind is click.Argument:
        settings.setdefault("required", type(None) not in choices)
        return click.Argument([name], nargs=-1 if several else 1, **settings)
    flag = held is bool
    settings.setdefault("required", default is None and len(choices) == 1 and not several and not flag)
    settings.setdefault("multiple", several)
    settings.setdefault("show_default", default is not None and default != "" and not flag)
    if flag:
        settings |= {"is_flag": True, "type": None, "default": None if len(choices) > 1 else False}
    return Option([*(names or [f"--{name.replace('_', '-')}"]), name], **settings)


def _click_type(held: Any) -> Any:
    if get_origin(held) is Literal:
        return click.Choice(get_args(held))
    if get_origin(held) is tuple:
        return get_args(held)
    return {Path: click.Path(path_type=Path)}.get(held, held)


def verb(
    name: str, *, example: str, help: str | None = None, note: str = ""
) -> Callable[[Callable[..., Answer | None]], click.Command]:
    """Return a decorator that turns a function into a verb.

    The verb has --json and shows the function's answer.

    Args:
        name: name of the verb.
        example: a command line for the help.
        help: text of the help; by default the function's docstring.
        note: further text beside the example.
    """

    def decorate(function: Callable[..., Answer | None]) -> click.Command:
        parameters = inspect.signature(function).parameters.values()
        groups = {one.name: one.default for one in parameters if isinstance(one.default, Several)}
        params: list[click.Parameter] = []
        for one in parameters:
            grouped = one.name in groups
            params += one.default.options if grouped else [_parameter(name, one.name, one.annotation, one.default)]
        params.append(
            Option(["--json", "as_json"], is_flag=True, group=OUTPUT, help="Answer as one JSON document on stdout.")
        )

        def run(*, as_json: bool, **given: Any) -> None:
            call = click.get_current_context().ensure_object(Call)
            call.as_json = as_json
            for param in params:
                if isinstance(param, Option):
                    value = given.get(str(param.name))
                    param.check(value)
                    if param.group == OUTPUT and isinstance(value, Path):
                        _check_output(param, value, params, given)
            for name, group in groups.items():
                given[name] = group.make(**{str(one.name): given.pop(str(one.name)) for one in group.options})
            with call.aside:
                if as_json:
                    call.aside.enter_context(_prints_on_stderr())
                answer = function(**given)
                if answer is not None:
                    show(answer)

        text = help or inspect.cleandoc(function.__doc__ or "")
        epilog = f"Example:  {example}" + (f"      {note}" if note else "")
        return Command(name, callback=run, params=params, help=text, epilog=epilog)

    return decorate


def _check_output(option: Option, out: Path, params: Iterable[click.Parameter], given: Mapping[str, Any]) -> None:
    """Claim a file to write, or check a folder.

    Raises:
        InputError: it cannot be written, or the same call reads it.
    """
    from dpcontrol.foundation.files import checked_folder, checked_other_file

    for param in params:
        value = None if getattr(param, "group", "") == OUTPUT else given.get(str(param.name))
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, str | Path) and os.path.isfile(one):
                checked_other_file(out, one, what=f"the input {one}", option=option.opts[0])
    if option.type is FILE:
        claim(out)
    elif option.type is FOLDER:
        checked_folder(out)


def show(answer: Answer) -> None:
    """Print an answer as one JSON document, or as text.

    The document has numbers at full precision. The text has lines and tables.

    Args:
        answer: answer of the verb.

    Raises:
        GoalMissed: the goal of the verb was missed, with the reason of the answer.
    """
    call = click.get_current_context().ensure_object(Call)
    call.shown = True
    call.aside.close()
    if call.as_json:
        print_json(answer.document)
        call.aside.enter_context(_prints_on_stderr())
    else:
        for item in answer.text:
            _print(item)
    if answer.missed:
        raise GoalMissed(answer.missed)


def _print(item: str | TextTable | Markdown) -> None:
    if isinstance(item, str):
        click.echo(printable(item))
    elif isinstance(item, TextTable):
        _print_table(item)
    else:
        from rich.console import Console
        from rich.markdown import Markdown as Page

        console = Console()
        Console(width=min(console.width, 126) if console.is_terminal else 126).print(Page(item.text))


def _print_table(shown: TextTable) -> None:
    """Print a table on stdout.

    It has full width if stdout is not a terminal. Brackets in it are not markup.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    def text(cell: str) -> Text:
        return Text(printable(cell))

    table = Table(title=text(shown.title) if shown.title else None, title_justify="left", title_style="bold")
    for k, column in enumerate(shown.columns):
        table.add_column(text(column), justify="left" if k == 0 else "right", no_wrap=True)
    for row in shown.rows:
        table.add_row(*map(text, row))
    console = Console()
    # A narrow terminal wraps lines, but a narrow table would omit names and digits.
    console = Console(width=max(console.width, 130) if console.is_terminal else 200)
    console.print(table)


def drawn_to(picture: Path | None) -> list[str]:
    """Return the line that names a picture, if there is one.

    Args:
        picture: file of the picture, or None.
    """
    return [] if picture is None else [f"drawn to {picture}"]


def draw_result(result: Any, picture: Path | None) -> list[str]:
    """Draw a result, and return the line that names its picture.

    Args:
        result: object with a renderer (see `dpcontrol.pages.renderers`).
        picture: file to write; None draws nothing.
    """
    if picture is not None:
        from dpcontrol.foundation.rendering import render
        from dpcontrol.pages.layout import save_figure

        save_figure(render(result), picture)
    return drawn_to(picture)


FILMS = (".gif", ".webp", ".mp4")
"""Formats of films."""
YES = option(group=OUTPUT, help="Permission for work of more than an hour or 4 GB of memory.")
"""Option of verbs with work of any length."""
