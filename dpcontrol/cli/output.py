"""What verbs share: JSON on stdout, tables for people, progress on stderr."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from decimal import Decimal, InvalidOperation
from functools import wraps
from pathlib import Path
from typing import Any

import click
import numpy as np

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")


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

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Decimal:
        try:
            return Decimal(value)
        except InvalidOperation:
            self.fail(f"{value!r} is not a number.", param, ctx)


_PRINTED = "dpcontrol.printed"


def plain(value: Any) -> Any:
    """Return `value` in JSON's terms: arrays as lists, complex numbers as [re, im], what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, complex | np.complexfloating):
        return [plain(float(value.real)), plain(float(value.imag))]
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document with numbers at full precision, and note that the verb has given its one."""
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[_PRINTED] = True
    click.echo(json.dumps(plain(document), indent=1, ensure_ascii=False))


def reports_failure(function: Callable[..., None]) -> Callable[..., None]:
    """Make a verb that fails under --json print the failure as its document, unless it has printed one already."""

    @wraps(function)
    def wrapped(*, as_json: bool, **options: Any) -> None:
        try:
            function(as_json=as_json, **options)
        except (InputError, GoalMissed) as error:
            if as_json and not click.get_current_context().meta.get(_PRINTED):
                print_json({"status": str(error), "error": isinstance(error, InputError)})
            raise

    return wrapped


def checked_suffix(path: Path, suffix: str, *, option: str) -> None:
    """Refuse a file name that promises another format than will be written.

    Raises:
        InputError: names the option, the file and the suffix it needs.
    """
    if path.suffix.lower() != suffix:
        raise InputError(f"{option} {path}: this writes a {suffix} file; choose a name that ends in {suffix}")


def multiplier_text(value: complex, digits: int = 11) -> str:
    """Return a Floquet multiplier for people: real where it is; the pair at one is known to some twelve digits."""
    if abs(value.imag) < 1e-12:
        return f"{value.real:.{digits}g}"
    return f"{value.real:.{min(digits, 10)}g}{value.imag:+.{min(digits, 10)}g}i"


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on stdout; as wide as it needs when stdout is no terminal."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", title_style="bold")
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console()
    # A narrow terminal wraps lines; a narrow table would leave out names and digits.
    console = Console(width=max(console.width, 130) if console.is_terminal else 200)
    console.print(table)


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Show a progress bar on stderr while the block runs; yields the function to report to."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<34}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=1.0)

        def report(what: str, done: float) -> None:
            bar.update(task, completed=done, description=what)

        yield report
        bar.update(task, completed=1.0, description=label)
