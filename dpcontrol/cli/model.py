"""dpcontrol model"""

import click

from dpcontrol.cli.output import json_option, print_json, print_table, reports_failure


@click.command(
    "model",
    epilog="Example:  dpcontrol model lab        MODEL is a name (./models, then those shipped) or a path.",
)
@click.argument("model")
@json_option
@reports_failure
def command(*, model: str, as_json: bool) -> None:
    """Show a model's parameters with units, and its equilibria (frictionless, pivot at rest)."""
    from dpcontrol.orbits.equilibria import equilibria
    from dpcontrol.scenes.model import load_model

    loaded = load_model(model)
    points = equilibria(loaded.system)
    if as_json:
        print_json(
            {
                "model": loaded.name,
                "title": loaded.title,
                "parameters": {
                    name: {"value": value, "unit": unit} for name, (value, unit) in loaded.parameters.named().items()
                },
                "sources": loaded.sources,
                "equilibria": {
                    name: {"state": e.state, "energy": e.energy, "eigenvalues": e.eigenvalues, "kind": e.kind}
                    for name, e in points.items()
                },
            }
        )
        return
    rows = [(name, f"{value:.12g}", unit) for name, (value, unit) in loaded.parameters.named().items()]
    print_table(f"{loaded.name}: {loaded.title}", ("parameter", "value", "unit"), rows)
    print_table(
        "equilibria",
        ("name", "energy (J)", "kind", "eigenvalues (1/s)"),
        [
            (name, f"{e.energy:+.10f}", e.kind, ", ".join(_eigenvalue(v) for v in e.eigenvalues))
            for name, e in points.items()
        ],
    )
    for table, source in loaded.sources.items():
        click.echo(f"[{table}] {source}")


def _eigenvalue(value: complex) -> str:
    if abs(value.imag) > abs(value.real):
        return f"{value.imag:+.6f}i"
    return f"{value.real:+.6f}"
