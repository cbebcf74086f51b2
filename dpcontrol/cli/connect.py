"""dpcontrol connect"""

import difflib
from collections.abc import Iterator
from decimal import Decimal
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, DecimalNumber, Hits, TextTable, extended_text, option, verb
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.scenes.model import Model
    from dpcontrol.tubes.connection import Connection
    from dpcontrol.tubes.connections import ConnectionSearch

SEARCH, RESULT = "Search", "Result"
SHOWN = 8
"""Open ends of cuts that are printed for people: tubes that scatter have hundreds."""


@verb("connect", example="dpcontrol connect lab --from down-up --to up-down --energy 0.2")
@click.argument("model")
@click.option("--from", "source", required=True, help="Saddle whose orbit the connection leaves.")
@click.option("--to", "target", required=True, help="Saddle whose orbit it joins.")
@click.option("--energy", required=True, type=DecimalNumber(), help="Energy in J, zero at the pivot's height.")
@option(
    "--hits",
    type=Hits(),
    group=SEARCH,
    help="Which crossings of the section count: the k-th of both tubes, or N,M for the unstable and the stable one. "
    "[default: 1, or what --name says]",
)
@option(
    "--section",
    "section_name",
    metavar="NAME",
    group=SEARCH,
    help="Search on this section: outer-down (θ₂ = 2πk), inner-down (θ₁ = 2πk), aligned (θ₁ = θ₂ + 2πk); three-body: "
    "opposite, between. [default: the saddles' own]",
)
@option(
    "--longest",
    type=click.FloatRange(min=0, min_open=True),
    metavar="PERIODS",
    group=SEARCH,
    help="Time that trajectories are given to the section, in periods of their orbit. Tubes that scatter are "
    "resolved when it is short. [default: the model's, 12 for pendulums]",
)
@option("--name", group=RESULT, help="Show this connection only; names are those that the verb lists.")
@option(
    "--precision",
    type=click.Choice(["double", "extended"]),
    default="double",
    show_default=True,
    group=RESULT,
    help="extended: refine the connection named by --name in 113-bit arithmetic.",
)
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
) -> Answer:
    """Find every connection between the Lyapunov orbits of two saddles (or one) that meets their section at given hits.

    All connections on the torus of angles are listed: both senses, mirror pairs and reflections. A connection's name
    may stand in an itinerary's walk. Exits with 1 if the list may be incomplete.

    On another --section other connections come first: homoclinics that pass by the other saddle's side cross "aligned"
    and cross back, and so are found there at --hits 1,2.
    """
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.connection import searched_at
    from dpcontrol.tubes.connections import find_connections, orbits_between
    from dpcontrol.tubes.cut import CutSettings
    from dpcontrol.tubes.intersections import ConnectionSettings

    if precision == "extended" and name is None:
        raise InputError("--precision extended refines one connection: give its --name as `dpcontrol connect` lists it")
    named_hits, named_section = searched_at(name or "") or ((1, 1), None)
    hits = hits or named_hits
    loaded = load_model(model)
    settings = ConnectionSettings(cut=CutSettings(longest=longest))
    with progress_bar("connections") as progress:
        orbits = orbits_between(loaded.system, source, target, float(energy))
        for orbit in orbits:
            if not orbit.converged:
                raise GoalMissed(f"the Lyapunov orbit about {orbit.saddle} at {energy} J: {orbit.status}")
        section = loaded.system.section_between(source, target, section_name or named_section)
        search = find_connections(*orbits, hits=hits, section=section, settings=settings, progress=progress)
    found = search.connections if name is None else (_named(search, name),)
    if precision == "extended":
        return _extended(loaded, found[0], energy)
    document = {
        "count": len(found),
        "connections": [c.document() for c in found],
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
    missed = ""
    if name is None and not search.complete:
        missed = f"the search between {source} and {target} is not complete: {search.status}"
    return Answer(document, _text(f"{source} → {target} at {energy} J on {section.name}", found, search), missed)


def _text(title: str, found: "tuple[Connection, ...]", search: "ConnectionSearch") -> Iterator[str | TextTable]:
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
    yield TextTable(title, ("name", "sense", "symmetric", "angle (°)", "residual", "time out (s)", "time in (s)"), rows)
    yield search.status
    for tube, end in search.open_ends[:SHOWN]:
        low, high = end.phase_interval
        yield f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.reason}"
    if len(search.open_ends) > SHOWN:
        yield f"… and {len(search.open_ends) - SHOWN} more open ends, which --json lists"


def _named(search: "ConnectionSearch", name: str) -> "Connection":
    names = [c.name for c in search.connections]
    if name in names:
        return search.connections[names.index(name)]
    if not names:
        raise InputError(f"there is no connection {name!r}: the search found none ({search.status})")
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.3)
    hint = f"did you mean {close[0]!r}?" if close else f"names look like {names[0]!r}"
    raise InputError(f"there is no connection {name!r} among the {len(names)} found; {hint} (quote it in a shell)")


def _extended(model: "Model", connection: "Connection", energy: Decimal) -> Answer:
    """Refine one connection in extended precision."""
    from dpcontrol.shooting.extended import refine

    with progress_bar("refining in 113-bit arithmetic"):
        refined = refine(connection.solution, energy=energy, parameters=model.exact_parameters)
    if not refined.converged:
        raise GoalMissed(f"{connection.name} in extended precision: {refined.status}")
    residual = f"{float(refined.residual):.3e}"
    ends = dict(zip((connection.source.saddle, connection.target.saddle), refined.ends, strict=True))
    own = {"state": refined.digits, "residual": residual, "precision": "extended"}
    one = {**connection.document(), **own}
    document = {
        **one,
        "count": 1,
        "connections": [one],
        "state_double": connection.state,
        "residual_double": connection.residual,
        "correction": refined.correction,
        "orbits": [
            {
                "saddle": saddle,
                "state": end.digits,
                "period": str(end.duration),
                "residual": f"{float(end.residual):.3e}",
            }
            for saddle, end in ends.items()
        ],
        "energy": str(energy),
        "from": connection.source.saddle,
        "to": connection.target.saddle,
        "status": refined.status,
    }
    lines = [
        f"{connection.name} at {energy} J in 113-bit arithmetic: {refined.status}",
        *extended_text(refined.digits, "  "),
        f"  residual {residual} (largest gap between segments, in their units)",
    ]
    return Answer(document, lines)
