"""Lines of the results of models, guide, cache and configuration."""

from collections.abc import Iterator
from typing import Any

from dpcontrol.words.runs import score_lines
from dpcontrol.words.table import Line, Markdown, table


def description(result: Any) -> Iterator[Line]:
    """Yield the parameters and equilibria of a model.

    Args:
        result: a `ModelDescription`.
    """
    model = result.model
    values = {"parameter": "{0[0]}", "value": "{0[1][0]:.12g}", "unit": "{0[1][1]}"}
    yield table(f"{model.name}: {model.title}", model.parameters.named().items(), values)
    columns: dict[str, Any] = {
        "name": "{0[0]}",
        f"energy{model.unit('J', ' ({})')}": "{0[1].energy:+.10f}",
        "kind": "{0[1].kind}",
        f"eigenvalues{model.unit('1/s', ' ({})')}": lambda row: ", ".join(map(_eigenvalue, row[1].eigenvalues)),
    }
    if any(result.need(name) for name in result.equilibria):
        columns["need (m/s² per rad)"] = lambda row: f"{need:.0f}" if (need := result.need(row[0])) else ""
    if any(result.spare_encoders(name) for name in result.equilibria):
        columns["observable without encoder"] = lambda row: " or ".join(map(str, result.spare_encoders(row[0])))
    yield table("equilibria", result.equilibria.items(), columns)
    for part, source in model.sources.items():
        yield f"[{part}] {source}"
    yield from model.differences
    if result.mjcf is not None:
        yield f"arms for MuJoCo written to {result.mjcf}"
    if result.file is not None:
        yield f"model written to {result.file}"


def _eigenvalue(value: complex) -> str:
    return f"{value.imag:+.6f}i" if abs(value.imag) > abs(value.real) else f"{value.real:+.6f}"


def page(text: Any) -> Iterator[Line]:
    """Yield a page of the guide, or the list of its pages.

    Args:
        text: a `GuidePage`.
    """
    if text.topic is not None:
        yield Markdown(text)
        return
    width = max(map(len, text.topics))
    yield "The guide, in reading order:"
    yield from (f"  {name:{width}}  {about}" for name, about in text.topics.items())
    yield ""
    yield "`dpcontrol guide TOPIC` shows a page."


def cache(result: Any) -> Iterator[Line]:
    """Yield the entries and sizes of the cache by kind.

    Args:
        result: a `CacheContents`.
    """
    yield result.sentence
    columns = {"kind": "{0[0]}", "entries": "{0[1][0]}", "MB": lambda row: f"{row[1][1] / 1e6:.1f}"}
    yield table("", result.kinds.items(), columns)


def configuration(result: Any) -> Iterator[Line]:
    """Yield the configured defaults with their sources.

    Args:
        result: a `Configuration`.
    """
    yield f"file  {result.file}{'' if result.exists else ' (not found)'}"
    columns = {
        "setting": "{.name}",
        "value": lambda setting: str(setting.value) or "none",
        "from": "{.source}",
        "variable": "{.variable}",
        "meaning": "{.help}",
    }
    yield table("", result.settings, columns)


def demonstration(result: Any) -> Iterator[Line]:
    """Yield the plan, the score and the files of a demonstration.

    Args:
        result: a `Demonstration`.
    """
    plan, log = result.plan, result.log
    yield f"{plan.itinerary.title}: {' '.join(repr(symbol.text) for symbol in plan.content.symbols)}"
    yield f"  planned: {plan.status}"
    yield from score_lines(result.score)
    yield f"log        {log}"
    if result.recording:
        yield f"recording  {result.recording}     (open it with `rerun {result.recording}`)"
    yield f"picture    {result.picture}"
    yield f"{result.seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`"
