"""dpcontrol bifurcations"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.bifurcations.bifurcations import BifurcationSearch


@verb("bifurcations", example="dpcontrol bifurcations lab --from down-up --to down-up --energies -0.11 -0.09")
@click.argument("model")
@click.option("--from", "source", required=True, help="Saddle whose orbit the connections leave.")
@click.option("--to", "target", required=True, help="Saddle whose orbit they join.")
@click.option("--energies", required=True, type=float, nargs=2, metavar="LO HI", help="Range of energies in J.")
@click.option(
    "--hits", default=1, show_default=True, type=click.IntRange(1), help="How often the connections cross the section."
)
@click.option("--samples", default=24, show_default=True, type=click.IntRange(2), help="Energies searched at first.")
def command(*, model: str, source: str, target: str, energies: tuple[float, float], hits: int, samples: int) -> Answer:
    """Find the energies at which connections appear, vanish or split, and those at which they only seem to.

    saddle-node: two connections meet and vanish. pitchfork: a symmetric connection sheds a mirror pair.
    section-artefact: the connection goes on, but an earlier crossing of the section is born or lost, so that its number
    of hits changes. Every change of the count is explained by such events, or reported.
    Where trajectories scatter before they arrive, connections accumulate without end: counts are lower bounds there.
    """
    from dpcontrol.bifurcations.bifurcations import find_bifurcations
    from dpcontrol.bifurcations.sweep import SweepSettings
    from dpcontrol.scenes.model import load_model

    system, settings = load_model(model).system, SweepSettings(energies=samples)
    with progress_bar("bifurcations") as progress:
        found = find_bifurcations(
            system, source, target, energies=energies, crossings=hits, settings=settings, progress=progress
        )
    missed = f"not every change of the count was located: {found.status}" if found.unexplained else ""
    return Answer({**found.document(), "energies": energies}, _text(found), missed)


def _text(found: "BifurcationSearch") -> Iterator[str | TextTable]:
    rows = [
        (
            f"{e.energy:.10f}",
            e.kind,
            f"{'at least ' if e.at_least else ''}{e.count_below} → {e.count_above}",
            "yes" if e.symmetric else "pair",
            ", ".join(str(k) for k in e.winding),
            f"{e.residual:.0e}",
            "  ".join(f"{v:.6f}" for v in e.state),
        )
        for e in found.events
    ]
    columns = ("energy (J)", "kind", "count", "symmetric", "winding", "residual", "state (rad, rad/s)")
    title = f"{found.source} → {found.target}, {found.crossings} crossing(s) of {found.section.name}"
    yield TextTable(title, columns, rows)
    yield found.status
