"""From a function of `dpcontrol.api` to a verb, and from its result to the terminal.

The arguments and options of a verb are the parameters of its function: names and types from the signature, help from
the docstring. `settings` becomes an option for each common setting and --set. The result prints its `lines()`, or with
--json its `document()`.
"""

import inspect
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click

from dpcontrol.cli.completion import COMPLETERS
from dpcontrol.cli.output import Call, prints_on_stderr, show
from dpcontrol.cli.verbs import Verb
from dpcontrol.foundation.checked import annotations_of
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import PICTURE, Output, checked_folder, checked_other_file, checked_target
from dpcontrol.foundation.interrupts import forget_interrupts
from dpcontrol.foundation.parts import StageModule
from dpcontrol.foundation.progress import reporting
from dpcontrol.foundation.rendering import render

overrides: Any = StageModule("plans.overrides")
layout: Any = StageModule("pages.layout")

OPTIONS, SETTINGS, OUTPUT = "Options", "Run settings", "Output"
"""Headings of the help."""
COMMON = {"mismatch"}
"""Parameters that are also settings with an option."""
ALWAYS_OUTPUT = {"force", "yes", "live", "write"}
"""Flags that concern the output."""


class Option(click.Option):
    """An option that help lists under a group."""

    def __init__(self, *arguments: Any, group: str = OPTIONS, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self.group = group

    def value_is_missing(self, value: Any) -> bool:
        """Return True for None, so that a required option without a value is an error."""
        # click takes the default None for a value.
        return value is None or super().value_is_missing(value)


class Command(click.Command):
    """A verb, whose help lists options by group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of the verb into its help, under the headings of their groups."""
        sections: dict[str, list[tuple[str, str]]] = {OPTIONS: [], SETTINGS: [], OUTPUT: []}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                sections[getattr(param, "group", OPTIONS)].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def command(name: str, verb: Verb) -> click.Command:
    """Return the command of a verb, which calls the verb's function of `dpcontrol.api` and prints the result.

    Args:
        name: name of the verb.
        verb: its function and example.
    """
    from dpcontrol import api

    function = getattr(api, verb.function)
    parameters = inspect.signature(function).parameters
    hints, (text, argument_texts) = annotations_of(inspect.unwrap(function)), described(function)
    accepted = parameters.keys() - {"progress"}
    # These settings are offered by their options among the settings.
    parameters_on_line = accepted - (COMMON if "settings" in accepted else set())
    params = [
        param
        for key, parameter in parameters.items()
        if key in parameters_on_line
        for param in _parameters(name, verb, parameter, hints[key], argument_texts.get(key, ""))
    ]
    if verb.draws:
        params.append(
            Option(
                ["--picture"],
                type=click.Path(path_type=Path),
                group=OUTPUT,
                help="Picture of the result, .png, .pdf or .svg. [default: none]",
            )
        )
    params.append(Option(["--json", "as_json"], is_flag=True, group=OUTPUT, help="One JSON document on stdout."))

    def run(*, as_json: bool, **values: Any) -> None:
        """Call the verb's `function` with the values of the command line, print its result, and draw it if requested.

        `values` are those of all arguments and options by parameter, None for those not given. Options of settings are
        gathered in one mapping, and files to write are checked, before the function is called.
        """
        call = click.get_current_context().ensure_object(Call)
        call.as_json = as_json
        if "settings" in parameters:
            values["settings"] = _settings(values)
        if "over" in parameters:
            values["over"] = _over(values["over"])
        for key in parameters:
            if key in values and (output := _output(hints[key])) is not None:
                values[key] = _checked_output(key, output, values)
        picture = _checked_output("picture", PICTURE, values) if verb.draws else values.get("picture")
        values = {key: value for key, value in values.items() if value is not None and key in accepted}
        with call.aside:
            if as_json:
                call.aside.enter_context(prints_on_stderr())
            with reporting(True, name) as progress:
                result = function(**values, **({"progress": progress} if "progress" in parameters else {}))
            if verb.draws and picture is not None:
                layout.save_figure(render(result), picture)
            picture_file = getattr(result, "picture", picture)
            show(result, {"picture": picture_file} if "picture" in accepted or verb.draws else {})
            if hasattr(result, "serve"):
                _serve(result)

    epilog = f"Example:  {verb.example}" + (f"      {verb.note}" if verb.note else "")
    return Command(name, callback=run, params=params, help=text, epilog=epilog)


def described(function: Callable[..., Any]) -> tuple[str, dict[str, str]]:
    """Return the parts of a function's docstring that the help of its verb shows.

    They are the text before the arguments, and the text of each argument by name.

    Args:
        function: documented function, in Google style.
    """
    description, _, after_text = inspect.cleandoc(function.__doc__ or "").partition("\n\nArgs:\n")
    arguments = re.split(r"\n\n\w+:", after_text)[0]
    entries = re.findall(r"^    (\w+): (.*(?:\n     .*)*)", arguments, re.MULTILINE)
    return description, {name: " ".join(explanation.split()) for name, explanation in entries}


def _parameters(
    verb: str, declared: Verb, parameter: inspect.Parameter, hint: Any, help: str
) -> Iterator[click.Parameter]:
    """Yield the argument or the options of the command line for a parameter of a function.

    Args:
        verb: name of the verb.
        declared: the verb, with the names of options that differ from those of parameters.
        parameter: parameter of the verb's function.
        hint: its type, with annotations.
        help: its text from the docstring of the function.
    """
    name, output = parameter.name, _output(hint)
    completer = COMPLETERS.get((verb, name)) or COMPLETERS.get(("", name))
    if name == "settings":
        yield from _setting_options()
        return
    kinds = _kinds(hint)
    # A list in one text has a parser.
    takes_several = name == "over" or (name not in PARSERS and any(get_origin(kind) is Sequence for kind in kinds))
    kind = _click_type(name, kinds, output)
    required = parameter.default is inspect.Parameter.empty
    if parameter.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD and name not in declared.names:
        yield click.Argument(
            [name], nargs=-1 if takes_several else 1, required=required, type=kind, shell_complete=completer
        )
        return
    # From here on the parameter is an option; flags that are on by default get an option that turns them off.
    names = declared.names.get(name, f"--{name.replace('_', '-')}")
    names = (names,) if isinstance(names, str) else names
    flag = kind is bool
    if flag and parameter.default is True:
        names = (f"--no-{name.replace('_', '-')}",)
    elif flag and parameter.default is None:
        names = (f"{names[0]}/--no-{names[0][2:]}",)
    concerns_output = output is not None or name in ALWAYS_OUTPUT
    if flag and parameter.default is True:
        help = f"do not {help}"
    help = help[:1].upper() + help[1:]
    # Click writes defaults in brackets, docstrings in parentheses.
    help = re.sub(r" \((default: [^)]*)\)\.$", r". [\1]", f"{help.removesuffix('.')}.")
    yield Option(
        [*names, name],
        is_flag=flag,
        # With a value for a flag, click would take -0.07 after an option for another option.
        **({"flag_value": False} if flag and parameter.default is True else {}),
        type=None if flag else kind,
        multiple=takes_several,
        required=required,
        default=None,
        help=help,
        group=OUTPUT if concerns_output else OPTIONS,
        shell_complete=completer,
    )


def _kinds(hint: Any) -> list[Any]:
    """Return the types that a parameter accepts, without None and annotations, by which its text is read.

    `hint` is the annotation of the parameter, such as `Path | str | None`.
    """
    if get_origin(hint) is Annotated:
        return _kinds(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return [kind for alternative in get_args(hint) for kind in _kinds(alternative)]
    return [] if hint in (None, NoneType) else [hint]


def _output(hint: Any) -> Output | None:
    """Return the declaration of the file that a parameter names, or None if it names none to write.

    `hint` is the annotation of the parameter; for a file to write, it is `Annotated` with an `Output`.
    """
    return next(
        (annotation for annotation in getattr(hint, "__metadata__", ()) if isinstance(annotation, Output)), None
    )


def _click_type(name: str, kinds: Sequence[Any], output: Output | None) -> Any:
    """Return the type by which click reads a value from text.

    Args:
        name: name of the parameter, for those with a separate parser. Entries of lists have the name "".
        kinds: types of the parameter, of which the first that click can read counts.
        output: declaration of the file that it names, or None.

    Returns:
        A type of click, a tuple of types for several values, or one of bool, int, float and str.
    """
    if name in PARSERS and int not in kinds:
        return PARSERS[name]
    if output is not None:
        return click.Path(dir_okay=output.folder, path_type=Path)
    for kind in kinds:
        if get_origin(kind) is Sequence:
            return _click_type("", _kinds(get_args(kind)[0]), None)
        if get_origin(kind) is tuple:
            return tuple(_click_type("", _kinds(entry), None) for entry in get_args(kind))
        if get_origin(kind) is Literal:
            return click.Choice([entry for entry in get_args(kind) if isinstance(entry, str)])
        if kind is Path:
            return click.Path(path_type=Path)
        if kind is Decimal:
            return Parser("number", _number, "0.2, a finite number")
    return next((kind for kind in (bool, int, float) if kind in kinds), str)


def _checked_output(name: str, output: Output, values: Mapping[str, Any]) -> Path | bool | None:
    """Return the file or folder to write, checked before the work begins, True for a free name, or None for no file.

    Args:
        name: name of the parameter.
        output: its declaration, with the allowed endings.
        values: values of all parameters, none of whose files may be overwritten.

    Raises:
        InputError: the name has another ending, is that of an input, or cannot be written.
    """
    file: Path | None = values[name]
    if file is None:
        return True if output.free else None
    if not output.folder and not file.name:
        raise InputError(f"{name} = {file}: this is not a file name; give a name")
    if output.endings and file.suffix.lower() not in output.endings:
        allowed = " or ".join(output.endings)
        raise InputError(f"{name} = {file}: this writes a {allowed} file; choose a name that ends in {allowed}")
    for key, value in values.items():
        for item in value if isinstance(value, tuple) else (value,):
            if key != name and isinstance(item, str | Path) and os.path.isfile(item):
                checked_other_file(file, item, what=f"the input {item}", option=name)
    (checked_folder if output.folder else checked_target)(file)
    return file


class Parser(click.ParamType):
    """A value that a function makes of its text, or refuses with ValueError or ArithmeticError.

    Args:
        name: how help writes the value.
        read: function of the text.
        form: an example for the message.
    """

    def __init__(self, name: str, read: Callable[[str], Any], form: str) -> None:
        self.name, self.read, self.form = name, read, form

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of a text; a value that is no text any more, such as a default, is returned as it is."""
        if not isinstance(value, str):
            return value
        try:
            return self.read(value)
        except (ArithmeticError, ValueError):
            self.fail(f"{value!r} is not of the form {self.form}", param, ctx)


def _number(text: str) -> Decimal:
    """Return the decimal number that was typed, without rounding to binary: 0.2 is exactly one fifth."""
    number = Decimal(text)
    if not (number.is_finite() and math.isfinite(number)):
        raise ValueError(text)
    return number


def _hits(text: str) -> tuple[int, int]:
    """Return the numbers of section crossings of both tubes; one number stands for both, as in "1" for (1, 1)."""
    crossings = [int(number) for number in text.split(",")]
    first, *others = crossings
    if len(others) > 1 or not all(1 <= crossing <= 9 for crossing in crossings):
        raise ValueError(text)
    return first, others[0] if others else first


def _setting(text: str) -> tuple[str, str]:
    """Return the path of a setting and the text of its value, from "PATH=VALUE"."""
    name, equals, value = text.partition("=")
    if not (name.strip() and equals and value.strip()):
        raise ValueError(text)
    return name.strip(), value.strip()


PARSERS: Mapping[str, click.ParamType] = {
    "hits": Parser("n[,m]", _hits, "1 or 1,2, numbers from 1 to 9"),
    "wraps": Parser("n,n,…", lambda text: tuple(map(int, text.replace(",", " ").split())), "2,3,2"),
    "repairs": Parser("name,…", lambda text: [one.strip() for one in text.split(",") if one.strip()], "nan,gaps"),
    "over": Parser("path=v1,v2,…", _setting, "PATH=VALUE,VALUE,…, as in mismatch=0.05,0.1"),
}
"""Readers of parameters with a form of their own, by name."""


def _setting_options() -> Iterator[Option]:
    """Yield an option for each common setting of runs, and --set for all settings.

    `overrides.NAMED` has the help of the common settings by path; the option has the name of the path's last part.
    """
    for path, text in overrides.NAMED.items():
        name = path.rpartition(".")[2]
        yield Option(
            [overrides.option_of(path), name],
            group=SETTINGS,
            help=f"{text} [default: the itinerary's]",
            shell_complete=COMPLETERS.get(("", name)),
        )
    yield Option(
        ["--set", "settings"],
        type=Parser("path=value", _setting, "PATH=VALUE, as in drive.lag=0.005"),
        multiple=True,
        group=SETTINGS,
        help="Any setting by its path or unique last part; repeatable. See `dpcontrol guide settings`. [default: none]",
        shell_complete=COMPLETERS["", "over"],
    )


def _settings(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that the user typed, by path, and remove them from the values of the command line.

    The last value of a path counts, so that a remedy can be appended to a command.

    Args:
        values: values of all parameters; the texts of settings are taken out.

    Raises:
        InputError: a setting is given by its option and by its path.
    """
    texts = {path: values.pop(path.rpartition(".")[2]) for path in overrides.NAMED}
    settings = {path: overrides.parsed(path, text) for path, text in texts.items() if text is not None}
    for name, text in values.pop("settings"):
        if texts.get(overrides.resolved(name)) is not None:
            raise InputError(f"--set {name}={text}: {overrides.resolved(name)} is given twice; give it once")
        settings[overrides.resolved(name)] = overrides.parsed(name, text)
    return settings


def _over(given: Sequence[tuple[str, str]]) -> dict[str, list[Any]] | None:
    """Return the values of each setting that a campaign varies, by path, or None if it varies none.

    Args:
        given: path and list of values of each option --over, as texts.

    Raises:
        InputError: a setting is given twice, or a value is none of it.
    """
    varied = {
        name.replace("-", "_"): [overrides.parsed(name, text) for text in overrides.values_in(texts)]
        for name, texts in given
    }
    if len(varied) != len(given):
        raise InputError("--over: a setting is given twice; list its values once, separated by commas")
    return varied or None


def _serve(server: Any) -> None:
    """Serve until the server ends or the user presses Ctrl-C, which is the normal end of such a verb.

    `server` is the result of the verb: a context manager with the method `serve`, such as an example bench.
    """
    # A reader behind a pipe waits for the address.
    sys.stdout.flush()
    with server:
        try:
            server.serve()
        except KeyboardInterrupt:
            forget_interrupts()
