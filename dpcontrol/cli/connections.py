"""The verbs of connections: connect, bifurcations, atlas."""

from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import (
    ENERGY,
    JOINING,
    LEAVING,
    YES,
    Answer,
    Precision,
    TextTable,
    argument,
    extended_text,
    file_option,
    hits_option,
    multiplier_texts,
    option,
    spaced,
    table,
    verb,
)
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.bifurcations.bifurcations import BifurcationSearch
    from dpcontrol.scenes.model import Model
    from dpcontrol.tubes.connection import Connection
    from dpcontrol.tubes.connections import ConnectionSearch
    from dpcontrol.walks.atlas import Atlas

SEARCH, RESULT = "Search", "Result"
THOROUGH = 'Go on where a search says "at least": 20,000 trajectories a tube and more where they part, up to a minute'
SHOWN = 8
"""Open ends of cuts that are printed for people: tubes that scatter have hundreds."""


@verb("connect", example="dpcontrol connect lab --from down-up --to up-down --energy 0.2")
def connect_command(
    *,
    model: str = argument(),
    source: str = LEAVING,
    target: str = JOINING,
    energy: Decimal = ENERGY,
    hits: tuple[int, int] | None = hits_option("1, or what --name says", group=SEARCH),
    section: str | None = option(
        metavar="NAME",
        group=SEARCH,
        help="Search on this section: outer-down (θ₂ = 2πk), inner-down (θ₁ = 2πk), aligned (θ₁ = θ₂ + 2πk); "
        "three-body: opposite, between. [default: the saddles' own]",
    ),
    longest: float | None = option(
        type=click.FloatRange(min=0, min_open=True),
        metavar="PERIODS",
        group=SEARCH,
        help="Time that trajectories are given to the section, in periods of their orbit. Tubes that scatter are "
        "resolved when it is short. [default: the model's, 12 for pendulums]",
    ),
    thorough: bool = option(group=SEARCH, help=f"{THOROUGH}."),
    name: str | None = option(group=RESULT, help="Show this connection only; names are those that the verb lists."),
    precision: Precision = option(
        default="double", group=RESULT, help="extended: refine the connection named by --name in 113-bit arithmetic."
    ),
) -> Answer:
    """Find every connection between the Lyapunov orbits of two saddles (or one) that meets their section at given hits.

    All connections on the torus of angles are listed: both senses, mirror pairs and reflections. A connection's name
    may stand in an itinerary's walk. Exits with 1 if the list may be incomplete (`complete` in --json); with --name
    only that connection counts, and `complete` says whether there may be others.

    On another --section other connections come first: homoclinics that pass by the other saddle's side cross "aligned"
    and cross back, and so are found there at --hits 1,2.
    """
    from dpcontrol import api
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.connection import searched_at
    from dpcontrol.tubes.connections import orbits_between

    if precision == "extended" and name is None:
        raise InputError("--precision extended refines one connection: give its --name as `dpcontrol connect` lists it")
    named_hits, named_section = searched_at(name or "") or ((1, 1), None)
    loaded = load_model(model)
    orbits = orbits_between(loaded.system, source, target, float(energy))
    search = api.connections(
        *orbits,
        hits=hits or named_hits,
        section=section or named_section,
        longest=longest,
        thorough=thorough,
        progress=True,
    )
    document, found = search.document(), search.connections
    if name is not None:
        found = (search.named(name),)
        document |= {"count": 1, "connections": [found[0].document()]}
    if precision == "extended":
        return _extended(loaded, found[0], energy)
    missed = ""
    if name is None and not search.complete:
        missed = f"the search between {source} and {target} is not complete: {search.status}"
    return Answer(
        document, _connect_text(f"{source} → {target} at {energy} J on {document['section']}", found, search), missed
    )


def _symmetric(one: Any) -> str:
    return "yes" if one.symmetric else "pair"


def _connect_text(title: str, found: "tuple[Connection, ...]", search: "ConnectionSearch") -> Iterator[str | TextTable]:
    yield table(title, found, {
        "name": "{.name}", "sense": "{.sense:+d}", "symmetric": _symmetric, "angle (°)": "{.transversality_angle:.3f}",
        "residual": "{.residual:.0e}", "time out (s)": "{.time_out:.4f}", "time in (s)": "{.time_in:.4f}",
    })  # fmt: skip
    yield search.status
    for tube, end in search.open_ends[:SHOWN]:
        low, high = end.phase_interval
        yield f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.reason}"
    if len(search.open_ends) > SHOWN:
        yield f"… and {len(search.open_ends) - SHOWN} more open ends, which --json lists"


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


@verb("bifurcations", example="dpcontrol bifurcations lab --from down-up --to down-up --energies -0.11 -0.09")
def bifurcations_command(
    *,
    model: str = argument(),
    source: str = LEAVING,
    target: str = JOINING,
    energies: tuple[float, float] = option(metavar="LO HI", help="Range of energies in J."),
    hits: int = option(type=click.IntRange(1), default=1, help="How often the connections cross the section."),
    samples: int = option(type=click.IntRange(2), default=24, help="Energies searched at first."),
    yes: bool = YES,
) -> Answer:
    """Find the energies at which connections appear, vanish or split, and those at which they only seem to.

    saddle-node: two connections meet and vanish. pitchfork: a symmetric connection sheds a mirror pair.
    section-artefact: the connection goes on, but an earlier crossing of the section is born or lost, so that its number
    of hits changes. Every change of the count is explained by such events, or reported.
    Where trajectories scatter before they arrive, connections accumulate without end: counts are lower bounds there.
    """
    from dpcontrol import api
    from dpcontrol.scenes.model import load_model

    found = api.find_bifurcations(
        load_model(model), source, target, energies=energies, hits=hits, samples=samples, yes=yes, progress=True
    )
    missed = f"not every change of the count was located: {found.status}" if found.unexplained else ""
    return Answer({**found.document(), "energies": energies}, _bifurcations_text(found), missed)


def _bifurcations_text(found: "BifurcationSearch") -> Iterator[str | TextTable]:
    title = f"{found.source} → {found.target}, {found.crossings} crossing(s) of {found.section.name}"
    yield table(title, found.events, {
        "energy (J)": "{.energy:.10f}",
        "kind": "{.kind}",
        "count": lambda e: f"{'at least ' if e.at_least else ''}{e.count_below} → {e.count_above}",
        "symmetric": _symmetric,
        "winding": lambda e: ", ".join(map(str, e.winding)),
        "residual": "{.residual:.0e}",
        "state (rad, rad/s)": lambda e: spaced(e.state, ".6f"),
    })  # fmt: skip
    yield found.status


@verb("atlas", example="dpcontrol atlas lab --energy 0.2", note="then: dpcontrol review FILE")
def atlas_command(
    *,
    model: str = argument(),
    energy: float = ENERGY,
    hits: tuple[int, int] | None = hits_option("for each kind the first at which they meet, up to 2"),
    thorough: bool = option(help=f"{THOROUGH} for each kind of connection."),
    fresh: bool = option(help="Compute anew even if the atlas is cached."),
    out: Path | None = file_option(suffix=".npz", help="Also write the atlas to this .npz."),
    yes: bool = YES,
) -> Answer:
    """Compute all of one energy: every Lyapunov orbit, their tubes, every connection between them, rotating orbits.

    The atlas is one file (orbits, cuts, connections with their flights), kept by content: it is computed once. Look at
    it with `dpcontrol review FILE`. Exits with 1 if the list of connections may be incomplete.
    """
    from dpcontrol.scenes.atlas import AtlasSettings, make_atlas, save_atlas
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.intersections import search_settings

    settings = AtlasSettings(hits=hits, search=search_settings(thorough=thorough))
    with progress_bar("atlas") as progress:
        found = make_atlas(load_model(model), energy, settings=settings, fresh=fresh, yes=yes, progress=progress)
    atlas, file = found.atlas, found.file if found.file.is_file() else None
    if out is not None:
        save_atlas(out, atlas)
        file = out
    missed = "" if atlas.complete else f"the atlas of {model} at {energy:g} J is not complete: {atlas.status}"
    document = {**atlas.document(), "file": file, "cached": found.cached}
    place = f"{file or 'none: the cache cannot be written'}{' (cached)' if found.cached else ''}"
    return Answer(document, [*_atlas_text(atlas), f"file  {place}"], missed)


def _atlas_text(atlas: "Atlas") -> Iterator[str | TextTable]:
    yield table(f"{atlas.model} at {atlas.energy:g} J: Lyapunov orbits", atlas.orbits, {
        "about": "{.name}", "period (s)": "{.period:.12g}", "multiplier": "{0.floquet_multipliers[0].real:.10g}",
        "closure": "{.residual:.0e}",
    })  # fmt: skip
    if atlas.rotating_orbits:
        yield table("orbits that turn one arm forward", atlas.rotating_orbits, {
            "arm": lambda o: ("inner", "outer")[o.arm - 1], "period (s)": "{.period:.12g}", "stability": "{.kind}",
            "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8), "closure": "{.residual:.0e}",
        })  # fmt: skip
    yield table("connections", atlas.kinds, {
        "from → to": "{0.source} → {0.target}", "section": "{.section}", "hits": "{0.hits[0]}, {0.hits[1]}",
        "count": "{.count}", "cuts": lambda k: "closed" if k.complete else "open",
    })  # fmt: skip
    for c in atlas.connections:
        symmetric = ", symmetric" if c.symmetric else ""
        yield f"  {c.name}   {c.transversality_angle:.2f}°, residual {c.residual:.0e}{symmetric}"
    yield atlas.status
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in atlas.seconds.items())
    yield f"{seconds} (when it was made)"
