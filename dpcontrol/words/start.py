"""What the verbs of models, guide, cache and configuration print."""

from collections.abc import Iterator
from typing import Any

from dpcontrol.words.runs import score_lines
from dpcontrol.words.table import Line, Markdown, table


def description(found: Any) -> Iterator[Line]:
    """Yield the parameters and equilibria of a model.

    Args:
        found: a `ModelDescription`.
    """
    model = found.model
    values = {"parameter": "{0[0]}", "value": "{0[1][0]:.12g}", "unit": "{0[1][1]}"}
    yield table(f"{model.name}: {model.title}", model.parameters.named().items(), values)
    columns: dict[str, Any] = {
        "name": "{0[0]}",
        f"energy{model.unit('J', ' ({})')}": "{0[1].energy:+.10f}",
        "kind": "{0[1].kind}",
        f"eigenvalues{model.unit('1/s', ' ({})')}": lambda row: ", ".join(map(_eigenvalue, row[1].eigenvalues)),
    }
    if any(found.need(name) for name in found.equilibria):
        columns["need (m/s² per rad)"] = lambda row: f"{need:.0f}" if (need := found.need(row[0])) else ""
    yield table("equilibria", found.equilibria.items(), columns)
    for part, source in model.sources.items():
        yield f"[{part}] {source}"
    if found.mjcf is not None:
        yield f"arms for MuJoCo written to {found.mjcf}"
    if found.file is not None:
        yield f"model written to {found.file}"


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


def cache(found: Any) -> Iterator[Line]:
    """Yield the entries and sizes of the cache by kind.

    Args:
        found: a `CacheContents`.
    """
    yield found.sentence
    columns = {"kind": "{0[0]}", "entries": "{0[1][0]}", "MB": lambda row: f"{row[1][1] / 1e6:.1f}"}
    yield table("", found.kinds.items(), columns)


def configuration(found: Any) -> Iterator[Line]:
    """Yield the configured defaults with their sources.

    Args:
        found: a `Configuration`.
    """
    yield f"file  {found.file}{'' if found.exists else ' (not found)'}"
    columns = {
        "setting": "{.name}",
        "value": lambda one: str(one.value) or "none",
        "from": "{.source}",
        "variable": "{.variable}",
        "meaning": "{.help}",
    }
    yield table("", found.settings, columns)


def demonstration(found: Any) -> Iterator[Line]:
    """Yield what a demonstration planned, ran and wrote.

    Args:
        found: a `Demonstration`.
    """
    plan, log = found.plan, found.log
    yield f"{plan.itinerary.title}: {' '.join(repr(symbol.text) for symbol in plan.content.symbols)}"
    yield f"  planned: {plan.status}"
    yield from score_lines(found.score)
    yield f"log        {log}"
    if found.recording:
        yield f"recording  {found.recording}     (open it with `rerun {found.recording}`)"
    yield f"picture    {found.picture}"
    yield f"{found.seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`"
