"""dpcontrol model"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, verb

if TYPE_CHECKING:
    from dpcontrol.orbits.equilibria import Equilibrium
    from dpcontrol.scenes.model import Model


@verb(
    "model",
    example="dpcontrol model lab",
    note="MODEL is a name (./models, then those shipped) or a path.",
)
@click.argument("model")
def command(*, model: str) -> Answer:
    """Show a model's parameters with units, and its equilibria (frictionless, pivot at rest)."""
    from dpcontrol.foundation.documents import picked
    from dpcontrol.orbits.equilibria import equilibria
    from dpcontrol.scenes.model import load_model

    loaded = load_model(model)
    points = equilibria(loaded.system)
    document = {
        "model": loaded.name,
        "title": loaded.title,
        "parameters": {
            name: {"value": value, "unit": unit} for name, (value, unit) in loaded.parameters.named().items()
        },
        "sources": loaded.sources,
        "equilibria": {name: picked(e, "state", "energy", "eigenvalues", "kind") for name, e in points.items()},
    }
    return Answer(document, _text(loaded, points))


def _text(loaded: "Model", points: "dict[str, Equilibrium]") -> Iterator[str | TextTable]:
    parameters = [(name, f"{value:.12g}", unit) for name, (value, unit) in loaded.parameters.named().items()]
    yield TextTable(f"{loaded.name}: {loaded.title}", ("parameter", "value", "unit"), parameters)
    rows = [
        (name, f"{e.energy:+.10f}", e.kind, ", ".join(_eigenvalue(v) for v in e.eigenvalues))
        for name, e in points.items()
    ]
    yield TextTable("equilibria", ("name", "energy (J)", "kind", "eigenvalues (1/s)"), rows)
    for table, source in loaded.sources.items():
        yield f"[{table}] {source}"


def _eigenvalue(value: complex) -> str:
    return f"{value.imag:+.6f}i" if abs(value.imag) > abs(value.real) else f"{value.real:+.6f}"
