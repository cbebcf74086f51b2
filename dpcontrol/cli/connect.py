"""dpcontrol connect"""

import difflib
from decimal import Decimal
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import (
    DecimalNumber,
    Hits,
    json_option,
    print_json,
    print_table,
    progress_bar,
    reports_failure,
)
from dpcontrol.foundation.errors import GoalMissed, InputError

if TYPE_CHECKING:
    from dpcontrol.scenes.model import Model
    from dpcontrol.tubes.connection import Connection
    from dpcontrol.tubes.connections import ConnectionSearch


SHOWN = 8
"""Open ends of cuts that are printed for people: tubes that scatter have hundreds."""


@click.command("connect", epilog="Example:  dpcontrol connect lab --from down-up --to up-down --energy 0.2")
@click.argument("model")
@click.option("--from", "source", required=True, help="Saddle whose orbit the connection leaves.")
@click.option("--to", "target", required=True, help="Saddle whose orbit it joins.")
@click.option("--energy", required=True, type=DecimalNumber(), help="Energy in J, zero at the pivot's height.")
@click.option(
    "--hits",
    type=Hits(),
    help="How-manieth crossing of the section: of both tubes, or N,M of the unstable and the stable one. "
    "[default: 1, or what --name says]",
)
@click.option(
    "--section",
    "section_name",
    metavar="NAME",
    help="Seek on this section: outer-down (θ₂ = 2πk), inner-down "
    "(θ₁ = 2πk), aligned (θ₁ = θ₂ + 2πk); three-body: opposite, between. [default: the saddles' own]",
)
@click.option(
    "--longest",
    type=click.FloatRange(min=0, min_open=True),
    metavar="PERIODS",
    help="Time that trajectories are given to the section, in periods of their orbit. Tubes that scatter are "
    "resolved when it is short. [default: the model's, 12 for pendulums]",
)
@click.option("--name", help="Show this connection only; names are those that the verb lists.")
@click.option(
    "--precision",
    type=click.Choice(["double", "extended"]),
    default="double",
    show_default=True,
    help="extended: refine the connection named by --name in 113-bit arithmetic.",
)
@json_option
@reports_failure
def command(
    *,
    model: str,
    source: str,
    target: str,
    energy: Decimal,
    hits: tuple[int, int] | None,
    section_name: str | None,
    longest: float | None,
    name: str | None,
    precision: str,
    as_json: bool,
) -> None:
    """Find every connection between the Lyapunov orbits of two saddles (or one) that meets their section at given hits.

    All connections on the torus of angles are listed: both senses, mirror pairs and reflections. A connection's name
    may stand in an itinerary's walk.

    On another --section other connections come first: homoclinics that pass by the other saddle's side cross "aligned"
    and cross back, and so are found there at --hits 1,2.
    """
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.connection import searched_at
    from dpcontrol.tubes.connections import find_connections, orbits_between
    from dpcontrol.tubes.cut import CutSettings
    from dpcontrol.tubes.intersections import ConnectionSettings
    from dpcontrol.walks.atlas import connection_document

    if precision == "extended" and name is None:
        raise InputError("--precision extended refines one connection: give its --name as `dpcontrol connect` lists it")
    named_hits, named_section = searched_at(name or "") or ((1, 1), None)
    hits = hits or named_hits
    loaded = load_model(model)
    system = loaded.system
    settings = ConnectionSettings(cut=CutSettings(longest=longest))
    with progress_bar("connections") as progress:
        orbits = orbits_between(system, source, target, float(energy))
        for orbit in orbits:
            if not orbit.converged:
                raise GoalMissed(f"the Lyapunov orbit about {orbit.saddle} at {energy} J: {orbit.status}")
        section = system.section_between(source, target, section_name or named_section)
        search = find_connections(*orbits, hits=hits, section=section, settings=settings, progress=progress)
    found = search.connections
    if name is not None:
        found = (_named(search, name),)
    if precision == "extended":
        _extended(loaded, found[0], energy, as_json)
        return
    if as_json:
        print_json(
            {
                "count": len(found),
                "connections": [connection_document(c) for c in found],
                "open_cuts": [
                    {"branch": f"{tube} {end.branch:+d}", "phase_interval": end.phase_interval, "reason": end.reason}
                    for tube, end in search.open_ends
                ],
                "complete": search.complete,
                "status": search.status,
                "energy": float(energy),
                "from": source,
                "to": target,
                "hits": hits,
                "section": section.name,
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
        print_table(f"{source} → {target} at {energy} J on {section.name}", columns, rows)
        click.echo(search.status)
        for tube, end in search.open_ends[:SHOWN]:
            low, high = end.phase_interval
            click.echo(f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.reason}")
        if len(search.open_ends) > SHOWN:
            click.echo(f"… and {len(search.open_ends) - SHOWN} more open ends, which --json lists")
    if name is None and not search.complete:
        raise GoalMissed(f"the search between {source} and {target} is not complete: {search.status}")


def _named(search: "ConnectionSearch", name: str) -> "Connection":
    names = [c.name for c in search.connections]
    if name in names:
        return search.connections[names.index(name)]
    if not names:
        raise InputError(f"there is no connection {name!r}: the search found none ({search.status})")
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.3)
    hint = f"did you mean {close[0]!r}?" if close else f"names look like {names[0]!r}"
    raise InputError(f"there is no connection {name!r} among the {len(names)} found; {hint} (quote it in a shell)")


def _extended(model: "Model", connection: "Connection", energy: Decimal, as_json: bool) -> None:
    """Refine and print one connection in extended precision."""
    from dpcontrol.shooting.extended import refine
    from dpcontrol.walks.atlas import connection_document

    with progress_bar("refining in 113-bit arithmetic"):
        refined = refine(connection.solution, energy=energy, parameters=model.exact_parameters)
    if not refined.converged:
        raise GoalMissed(f"{connection.name} in extended precision: {refined.status}")
    state, residual = refined.digits, f"{float(refined.residual):.3e}"
    ends = dict(zip((connection.source.saddle, connection.target.saddle), refined.ends, strict=True))
    if as_json:
        document = {**connection_document(connection), "state": state, "residual": residual, "precision": "extended"}
        print_json(
            {
                **document,
                "count": 1,
                "connections": [document],
                "state_double": connection.state,
                "residual_double": connection.residual,
                "correction": refined.correction,
                "orbits": [
                    {"saddle": saddle, "state": end.digits, "period": str(end.duration),
                     "residual": f"{float(end.residual):.3e}"}
                    for saddle, end in ends.items()
                ],
                "energy": str(energy),
                "from": connection.source.saddle,
                "to": connection.target.saddle,
                "status": refined.status,
            }
        )  # fmt: skip
        return
    click.echo(f"{connection.name} at {energy} J in 113-bit arithmetic: {refined.status}")
    half = len(state) // 2
    for k, value in enumerate(state):
        click.echo(f"  {'position' if k < half else 'rate'} {k % half + 1}  {value}")
    click.echo(f"  residual {residual} (largest gap between segments, in their units)")
