"""dpcontrol connect"""

import click

from dpcontrol.cli.output import json_option, print_json, print_table, progress_bar, reports_failure
from dpcontrol.foundation.errors import GoalMissed


@click.command("connect", epilog="Example:  dpcontrol connect lab --from down-up --to up-down --energy 0.2")
@click.argument("model")
@click.option("--from", "source", required=True, help="Saddle whose orbit the connection leaves.")
@click.option("--to", "target", required=True, help="Saddle whose orbit it joins.")
@click.option("--energy", required=True, type=float, help="Energy in J, zero at the pivot's height.")
@json_option
@reports_failure
def command(*, model: str, source: str, target: str, energy: float, as_json: bool) -> None:
    """Find every first-hit connection between the Lyapunov orbits of two saddles (or one).

    All connections on the torus of angles are listed: both senses, mirror pairs and reflections. A connection's name
    may stand in an itinerary's walk.
    """
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.connections import find_connections, orbits_between

    system = load_model(model).system
    with progress_bar("connections") as progress:
        orbits = orbits_between(system, source, target, energy)
        for orbit in orbits:
            if not orbit.converged:
                raise GoalMissed(f"the Lyapunov orbit about {orbit.saddle} at {energy:g} J: {orbit.status}")
        search = find_connections(*orbits, progress=progress)
    found = search.connections
    if as_json:
        print_json(
            {
                "count": len(found),
                "connections": [
                    {
                        "name": c.name,
                        "section": c.section.name,
                        "state": c.state,
                        "winding": c.winding,
                        "sense": c.sense,
                        "symmetric": c.symmetric,
                        "residual": c.residual,
                        "transversality_angle_deg": c.transversality_angle,
                        "hits": c.hits,
                        "time_in": c.time_in,
                        "time_out": c.time_out,
                        "phase_in": c.phase_in,
                        "phase_out": c.phase_out,
                    }
                    for c in found
                ],
                "open_cuts": [
                    {"branch": f"{tube} {end.branch:+d}", "phase_interval": end.phase_interval, "reason": end.reason}
                    for tube, end in search.open_ends
                ],
                "complete": search.complete,
                "status": search.status,
                "energy": energy,
                "from": source,
                "to": target,
            }
        )
    else:
        rows = [
            (
                c.name,
                f"{c.sense:+d}",
                "yes" if c.symmetric else "pair",
                f"{c.transversality_angle:.3f}",
                f"{c.residual:.0e}",
                f"{c.time_out:.4f}",
                f"{c.time_in:.4f}",
            )
            for c in found
        ]
        columns = ("name", "sense", "symmetric", "angle (°)", "residual", "time out (s)", "time in (s)")
        print_table(f"{source} → {target} at {energy:g} J on {system.sections[source, target].name}", columns, rows)
        click.echo(search.status)
        for tube, end in search.open_ends:
            low, high = end.phase_interval
            click.echo(f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.reason}")
    if search.failed:
        raise GoalMissed(f"the search between {source} and {target} is not complete: {search.status}")
