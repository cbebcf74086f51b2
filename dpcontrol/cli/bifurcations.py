"""dpcontrol bifurcations"""

import click

from dpcontrol.cli.output import json_option, print_json, print_table, progress_bar, reports_failure
from dpcontrol.foundation.errors import GoalMissed


@click.command(
    "bifurcations",
    epilog="Example:  dpcontrol bifurcations lab --from down-up --to down-up --energies -0.11 -0.09",
)
@click.argument("model")
@click.option("--from", "source", required=True, help="Saddle whose orbit the connections leave.")
@click.option("--to", "target", required=True, help="Saddle whose orbit they join.")
@click.option("--energies", required=True, type=float, nargs=2, metavar="LO HI", help="Energies in J between which.")
@click.option(
    "--hits", default=1, show_default=True, type=click.IntRange(1), help="How often the connections cross the section."
)
@click.option("--samples", default=24, show_default=True, type=click.IntRange(2), help="Energies searched at first.")
@json_option
@reports_failure
def command(
    *, model: str, source: str, target: str, energies: tuple[float, float], hits: int, samples: int, as_json: bool
) -> None:
    """Find the energies at which connections appear, vanish or split, and those at which they only seem to.

    saddle-node: two connections meet and vanish. pitchfork: a symmetric connection sheds a mirror pair.
    section-artefact: the connection goes on, but an earlier crossing of the section is born or lost, so that its number
    of hits changes. Every change of the count is explained by such events, or reported.
    Where trajectories scatter before they arrive, connections accumulate without end: counts are lower bounds there.
    """
    from dpcontrol.bifurcations.bifurcations import find_bifurcations
    from dpcontrol.bifurcations.sweep import SweepSettings
    from dpcontrol.scenes.model import load_model

    system = load_model(model).system
    with progress_bar("bifurcations") as progress:
        found = find_bifurcations(
            system,
            source,
            target,
            energies=energies,
            crossings=hits,
            settings=SweepSettings(energies=samples),
            progress=progress,
        )
    if as_json:
        print_json(
            {
                "events": [
                    {
                        "energy": e.energy,
                        "kind": e.kind,
                        "state": e.state,
                        "count_below": e.count_below,
                        "count_above": e.count_above,
                        "at_least": e.at_least,
                        "symmetric": e.symmetric,
                        "winding": e.winding,
                        "residual": e.residual,
                        "point": e.point,
                    }
                    for e in found.events
                ],
                "counts": [
                    {"energy": c.energy, "count": c.count, "complete": c.complete, "caveat": c.caveat}
                    for c in found.counts
                ],
                "unexplained": [{"energies": [low, high], "reason": reason} for low, high, reason in found.unexplained],
                "scatters_from": found.scatters_from,
                "complete": found.complete,
                "status": found.status,
                "section": found.section.name,
                "from": source,
                "to": target,
                "energies": energies,
                "hits": hits,
            }
        )
    else:
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
        print_table(f"{source} → {target}, {hits} crossing(s) of {found.section.name}", columns, rows)
        click.echo(found.status)
    if found.unexplained:
        raise GoalMissed(f"not every change of the count was located: {found.status}")
