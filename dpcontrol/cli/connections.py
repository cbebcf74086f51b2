"""The verbs of orbits and connections: orbit, connect, bifurcations, atlas."""

import os
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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
    draw_result,
    drawn_to,
    extended_text,
    file_option,
    hits_option,
    multiplier_texts,
    option,
    spaced,
    table,
    verb,
)
from dpcontrol.foundation.document import counted
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.bifurcations.bifurcations import BifurcationSearch
    from dpcontrol.orbits.family import LyapunovFamily
    from dpcontrol.orbits.lyapunov import LyapunovOrbit
    from dpcontrol.orbits.rotating import RotatingFamily
    from dpcontrol.plans.model import Model
    from dpcontrol.references.sustained import SustainedOrbit
    from dpcontrol.tubes.connections import Connection, ConnectionSearch
    from dpcontrol.tubes.symmetric import SymmetricSearch
    from dpcontrol.walks.atlas import Atlas


KIND = "Kind of orbit"
_ROTATING = {
    "energy (J)": "{.energy:.9g}",
    "period (s)": "{.period:.12g}",
    "stability": "{.kind}",
    "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8),
    "state (rad, rad/s)": lambda o: spaced(o.state, ".9f"),
}
Range = tuple[float, float]


@verb("orbit", example="dpcontrol orbit lab --saddle down-up --energy -0.07")
def orbit_command(
    *,
    model: str = argument(),
    saddle: str | None = option(group=KIND, help="Saddle inside the orbit, inner arm first: down-up, up-down."),
    family: int = option(default=0, group=KIND, help="Family of orbits about the saddle, slowest first."),
    rotating: Literal["inner", "outer"] | None = option(group=KIND, help="Rotating orbits of this arm instead."),
    sustained: bool = option(
        group=KIND, help="Orbit that the cart sustains against friction with the least effort instead."
    ),
    sections: int = option(
        type=click.IntRange(1, 1000),
        default=4,
        group=KIND,
        help="For --sustained: resets of the input clock per period.",
    ),
    energy: float | None = option(help="Energy, J, zero at the height of the pivot; three bodies: own units."),
    energies: Range | None = option(metavar="LO HI", help="Energies between which the family is followed, J."),
    picture: Path | None = file_option(suffix=".png", help="Picture of the family or the sustained orbit (.png)."),
) -> Answer:
    """Compute a Lyapunov orbit or its family, with Floquet multipliers.

    A family is followed from its saddle until it ends, loses hyperbolicity or leaves the given energies.

    --rotating selects the symmetric orbits on which one arm rotates, with their stability. Their families start from
    the orbits at --energy, or at the middle of --energies.

    --sustained selects the periodic orbit of pendulum and cart that the acceleration of the cart sustains against
    friction. It starts from the Lyapunov orbit at --energy and has that energy at phase 0. There are two sets of
    multipliers: over a period with the input replayed, and from section to section with the input clock reset.
    """
    from dpcontrol.plans.model import load_model

    if (saddle is None) == (rotating is None):
        raise click.UsageError("give either --saddle for Lyapunov orbits or --rotating inner|outer for rotating ones")
    if sustained:
        if saddle is None or energy is None or energies is not None:
            raise InputError("--sustained needs --saddle and --energy: add both")
        return _sustained(load_model(model), saddle, energy, family, sections, picture)
    if picture is not None and energies is None:
        raise InputError("--picture draws a family or a sustained orbit: add --energies LO HI or --sustained")
    if energy is None and energies is None:
        raise InputError("give --energy for the orbits of one energy or --energies LO HI for their families")
    loaded = load_model(model)
    if rotating is not None:
        return _rotating(loaded, rotating, energy, energies, picture)
    assert saddle is not None
    if energies is None:
        assert energy is not None
        orbit = _lyapunov(loaded, saddle, energy, family)
        return Answer(orbit.document(), _orbit_text(loaded, orbit))
    if energy is not None:
        raise InputError("give either --energy for one orbit or --energies LO HI for its family")
    return _family(loaded, saddle, energies, family, picture)


def _lyapunov(model: "Model", saddle: str, energy: float, family: int) -> "LyapunovOrbit":
    from dpcontrol import api

    orbit = api.orbit(model, saddle, energy=energy, family=family)
    if not orbit.converged:
        raise GoalMissed(f"the Lyapunov orbit about {saddle} at {energy:g}{model.unit('J')}: {orbit.status}")
    return orbit


_BRACKETS = " ({})"


def _orbit_text(model: "Model", orbit: "LyapunovOrbit") -> Iterator[str]:
    yield f"Lyapunov orbit about {orbit.saddle} at {orbit.energy:g}{model.unit('J')}: {orbit.status}"
    yield f"  period       {orbit.period:.15g}{model.unit('s')}"
    yield f"  state        {spaced(orbit.state, '.15g')}{model.unit('rad, rad/s', '   ({})')}"
    yield f"  multipliers  {multiplier_texts(orbit.floquet_multipliers)}"
    yield f"  closure      {orbit.residual:.1e} (largest component of x(T) - x(0))"


def _family(model: "Model", saddle: str, energies: Range, family: int, picture: Path | None) -> Answer:
    from dpcontrol import api

    found = api.family(model, saddle, energies=energies, family=family, progress=True)
    document = {**found.document(), "energies": energies, "picture": picture}
    missed = "" if found.converged else f"the family about {saddle}: {found.status}"
    return Answer(document, [*_family_text(model, found, saddle), *draw_result(found, picture)], missed)


def _family_text(model: "Model", found: "LyapunovFamily", saddle: str) -> Iterator[str | TextTable]:
    chosen = found.members[:: max(1, len(found.members) // 20)]
    yield table(f"Lyapunov orbits about {saddle}, {len(chosen)} of {len(found.members)}", chosen, {
        f"energy{model.unit('J', _BRACKETS)}": "{.energy:.9g}",
        f"period{model.unit('s', _BRACKETS)}": "{.period:.9g}",
        "multipliers but the pair at one": lambda m: multiplier_texts(
            (v for v in m.floquet_multipliers if abs(abs(v) - 1) > 1e-3), 6
        ),
        f"state{model.unit('rad, rad/s', _BRACKETS)}": lambda m: spaced(m.state, ".6f"),
    })  # fmt: skip
    for side, end in zip(("from", "to"), found.ends, strict=True):
        yield f"{side:5s}{end.energy:.9g}{model.unit('J')}: {end.status}"


def _rotating(
    model: "Model", arm: Literal["inner", "outer"], energy: float | None, energies: Range | None, picture: Path | None
) -> Answer:
    from dpcontrol import api

    if energies is not None:
        energy = sum(energies) / 2
    assert energy is not None
    missed = f"no symmetric orbit that turns the {arm} arm of {model.name} over was found at {energy:g} J"
    requested = {"arm": arm, "energy": energy}
    if energies is None:
        orbits = api.rotating_orbits(model, arm, energy=energy)
        if not orbits:
            raise GoalMissed(missed)
        title = f"Orbits of {model.name} at {energy:g} J that turn the {arm} arm forward"
        document = {
            "rotating_orbits": [orbit.document() for orbit in orbits],
            "count": len(orbits),
            **requested,
            "status": f"{len(orbits)} symmetric orbits that turn the {arm} arm forward; each has a reflection",
        }
        note = "each has a reflection that turns backward, (θ, ω) → (−θ, −ω), with the same multipliers"
        return Answer(document, [table(title, orbits, _ROTATING), note])
    families = api.rotating_families(model, arm, energies=energies, progress=True)
    if not families:
        raise GoalMissed(missed)
    if picture is not None:
        from dpcontrol.pages.layout import save_figure
        from dpcontrol.pages.rotating_orbits import draw_rotating_families

        save_figure(draw_rotating_families(families), picture)
    document = {
        "families": [family.document() for family in families],
        "count": len(families),
        **requested,
        "energies": energies,
        "picture": picture,
        "status": "; ".join(family.status for family in families),
    }
    lost = [family.status for family in families if not family.converged]
    missed = f"{len(lost)} of {len(families)} families of rotating orbits: {'; '.join(lost)}" if lost else ""
    return Answer(document, [*_rotating_text(families, arm), *drawn_to(picture)], missed)


def _rotating_text(families: "Sequence[RotatingFamily]", arm: str) -> Iterator[str | TextTable]:
    for k, family in enumerate(families, start=1):
        chosen = family.members[:: max(1, len(family.members) // 12)]
        title = f"Family {k} of {len(families)}, the {arm} arm turning: {len(chosen)} of {len(family.members)}"
        yield table(title, chosen, _ROTATING)
        for change in family.changes:
            yield f"  at {change.orbit.energy:.10g} J: from {change.before} to {change.after}"
        for fold in family.folds:
            yield f"  at {fold.energy:.10g} J the family turns back in energy"
        for side, end in zip(("from", "to"), family.ends, strict=True):
            yield f"  {side}: {end.status}"


def _sustained(model: "Model", saddle: str, energy: float, family: int, sections: int, picture: Path | None) -> Answer:
    from dpcontrol import api

    # A system without arms is rejected before the search for its orbit, which can take minutes.
    arms = model.arms
    orbit = api.sustained_orbit(_lyapunov(model, saddle, energy, family), progress=True)
    if not orbit.converged:
        missed = f"the sustained orbit about {saddle} at {energy:g} J: {orbit.status}"
        return Answer({**orbit.document(sections), "picture": None}, (), missed)
    from dpcontrol.judge.of_log import sustained_view

    lines = [*_sustained_text(orbit, sections), *draw_result(sustained_view(orbit, arms.length), picture)]
    return Answer({**orbit.document(sections), "picture": picture}, lines)


def _sustained_text(orbit: "SustainedOrbit", sections: int) -> Iterator[str]:
    reference, lyapunov = orbit.reference, orbit.lyapunov
    yield f"Sustained orbit about {lyapunov.saddle} at {lyapunov.energy:g} J: {orbit.status}"
    yield f"  period       {orbit.period:.15g} s, {lyapunov.period:.15g} s without friction"
    yield f"  state        {spaced(orbit.state(0.0), '.9g')}   (rad, rad/s, m, m/s)"
    yield (
        f"  cart         {reference.rms_cart_acceleration:.4g} m/s² rms, {reference.max_cart_acceleration:.4g} "
        f"at most; {1e3 * reference.max_cart_position:.3g} mm at most"
    )
    yield f"  energy       {orbit.energies[0]:.6g} to {orbit.energies[1]:.6g} J along the orbit"
    by_section = orbit.section_multipliers(sections)
    for title, values in (("multipliers", orbit.multipliers), (f"by {sections} sections", by_section)):
        yield f"  {title:<12} {multiplier_texts(values, 9)}"
    yield "               the cart's are 1, 1: driven by its acceleration, nothing holds it in place"


SEARCH, RESULT = "Search", "Result"
THOROUGH = 'Longer search if the result is "at least": 20,000 or more trajectories per tube, up to a minute'
SECONDS_HELP = "Processor time per search, s. After it, the partial result is shown (exit code 1). [default: 60]"


def seconds_option(**more: Any) -> float | None:
    """Return the option --seconds of a search.

    Args:
        more: further arguments of `option`.
    """
    return option(type=click.FloatRange(min=0, min_open=True), help=SECONDS_HELP, **more)


SHOWN = 8
"""Number of open ends of cuts to print: tubes that scatter have hundreds."""


@verb("connect", example="dpcontrol connect lab --from down-up --to up-down --energy 0.2")
def connect_command(
    *,
    model: str = argument(),
    source: str = LEAVING,
    target: str = JOINING,
    energy: Decimal | None = option(help="Energy, J, zero at the height of the pivot; three bodies: own units."),
    energies: Range | None = option(
        metavar="LO HI", help="For three arms: range of energies for symmetric connections, J."
    ),
    family: int = option(default=0, group=SEARCH, help="For --energies: family of orbits, slowest first."),
    hits: tuple[int, int] | None = hits_option("1, or that of --name", group=SEARCH),
    section: str | None = option(
        metavar="NAME",
        group=SEARCH,
        help="Section of the search: outer-down (θ₂ = 2πk), inner-down (θ₁ = 2πk), aligned (θ₁ = θ₂ + 2πk); "
        "three-body: opposite, between. [default: the saddles' own]",
    ),
    longest: float | None = option(
        type=click.FloatRange(min=0, min_open=True),
        metavar="PERIODS",
        group=SEARCH,
        help="Longest flight to the section, in periods of the orbit. A short limit also resolves scattering tubes. "
        "[default: the model's, 12 for pendulums]",
    ),
    thorough: bool = option(group=SEARCH, help=f"{THOROUGH}."),
    seconds: float | None = seconds_option(group=SEARCH),
    name: str | None = option(group=RESULT, help="Only this connection, by a name from the list."),
    precision: Precision = option(
        default="double",
        group=RESULT,
        help="Precision of the connection --name; extended refines it in 113-bit arithmetic.",
    ),
) -> Answer:
    """Find every connection between Lyapunov orbits at given section hits.

    The list contains all connections on the torus of angles: both senses, mirror pairs and reflections. The walk of an
    itinerary can use their names. The exit code is 1 if the list may be incomplete (`complete` in --json). With --name,
    only that connection counts, and `complete` is false if there may be others.

    Another --section gives other connections first. Homoclinics that pass the other saddle cross "aligned" twice, so
    --hits 1,2 finds them there.

    Orbits of three arms have connections at isolated energies only. Use --energies to find the symmetric ones, which
    lead from an orbit back to itself through a moment at which every arm hangs or stands.
    """
    from dpcontrol import api
    from dpcontrol.plans.model import load_model
    from dpcontrol.tubes.connections import orbits_between
    from dpcontrol.walks.symbols import parse_symbol

    if (energy is None) == (energies is None):
        raise click.UsageError("give either --energy or, for three arms, --energies LO HI")
    if energies is not None:
        given = {"--section": section, "--longest": longest, "--thorough": thorough or None, "--name": name}
        for option_name in (key for key, value in given.items() if value is not None):
            raise InputError(f"{option_name} applies to a search at one --energy: omit it with --energies")
        if source != target:
            raise InputError(f"--energies: symmetric connections lead back to their orbit: add --to {source}")
        orbit = _lyapunov(load_model(model), source, energies[0], family)
        return _symmetric_connections(
            api.connections(orbit, energies=energies, hits=hits or (1, 1), seconds=seconds, progress=True)
        )
    assert energy is not None
    if family:
        raise InputError("--family applies to a search with --energies: omit it with --energy")
    if precision == "extended" and name is None:
        raise InputError(
            "--precision extended refines one connection: add its --name from the list of `dpcontrol connect`"
        )
    symbol = None if name is None else parse_symbol(name, [source, target])
    loaded = load_model(model)
    orbits = orbits_between(loaded.system, source, target, float(energy))
    search = api.connections(
        *orbits,
        hits=hits or (symbol and symbol.hits) or (1, 1),
        section=section or (symbol and symbol.section),
        longest=longest,
        thorough=thorough,
        seconds=seconds,
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
    title = f"{source} → {target} at {energy}{loaded.unit('J')} on {document['section']}"
    return Answer(document, _connect_text(loaded, title, found, search), missed)


def _symmetric(one: Any) -> str:
    return "yes" if one.symmetric else "pair"


def _connect_text(
    model: "Model", title: str, found: "tuple[Connection, ...]", search: "ConnectionSearch"
) -> Iterator[str | TextTable]:
    out, into = (f"time {way}{model.unit('s', _BRACKETS)}" for way in ("out", "in"))
    yield table(title, found, {
        "name": "{.name}", "sense": "{.sense:+d}", "symmetric": _symmetric, "angle (°)": "{.transversality_angle:.3f}",
        "residual": "{.residual:.0e}", out: "{.time_out:.4f}", into: "{.time_in:.4f}",
    })  # fmt: skip
    yield search.status
    for tube, end in search.open_ends[:SHOWN]:
        low, high = end.phase_interval
        yield f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.status}"
    if len(search.open_ends) > SHOWN:
        yield f"… and {len(search.open_ends) - SHOWN} more open ends, which --json lists"


def _symmetric_connections(search: "SymmetricSearch") -> Answer:
    title = f"{search.saddle}, family {search.family}: symmetric homoclinics"
    shown = table(title, search.connections, {
        "name": "{.name}", "energy (J)": "{.source.energy:.12g}", "turns": lambda c: ", ".join(map(str, c.winding)),
        "multiplier": "{.source.unstable_multiplier:.6g}", "residual": "{.residual:.0e}",
        "time out = in (s)": "{.time_out:.4f}", "middle (rad, rad/s)": lambda c: spaced(c.state, ".6f"),
    })  # fmt: skip
    missed = "" if search.connections else f"no symmetric connection of {search.saddle}: {search.status}"
    return Answer(search.document(), [shown, search.status], missed)


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
        f"{connection.name} at {energy}{model.unit('J')} in 113-bit arithmetic: {refined.status}",
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
    energies: tuple[float, float] = option(metavar="LO HI", help="Range of energies, J."),
    hits: int = option(type=click.IntRange(1), default=1, help="Section crossings of the connections."),
    samples: int = option(type=click.IntRange(2), default=24, help="Energies of the first search."),
    yes: bool = YES,
) -> Answer:
    """Find the energies at which connections appear, vanish or split.

    There are three kinds of events. At a saddle-node, two connections meet and vanish. At a pitchfork, a mirror pair
    splits off a symmetric connection. At a section-artefact, the connection continues, but gains or loses an earlier
    crossing of the section. Changes of the count without such an event are reported. If trajectories scatter before
    they arrive, connections accumulate without end, and counts are lower bounds.
    """
    from dpcontrol import api
    from dpcontrol.plans.model import load_model

    loaded = load_model(model)
    found = api.find_bifurcations(
        loaded, source, target, energies=energies, hits=hits, samples=samples, yes=yes, progress=True
    )
    missed = f"not every change of the count was located: {found.status}" if found.unexplained else ""
    return Answer({**found.document(), "energies": energies}, _bifurcations_text(loaded, found), missed)


def _bifurcations_text(model: "Model", found: "BifurcationSearch") -> Iterator[str | TextTable]:
    title = f"{found.source} → {found.target}, {counted(found.crossings, 'crossing')} of {found.section.name}"
    yield table(title, found.events, {
        f"energy{model.unit('J', _BRACKETS)}": "{.energy:.10f}",
        "kind": "{.kind}",
        "count": lambda e: f"{'at least ' if e.at_least else ''}{e.count_below} → {e.count_above}",
        "symmetric": _symmetric,
        "winding": lambda e: ", ".join(map(str, e.winding)),
        "residual": "{.residual:.0e}",
        f"state{model.unit('rad, rad/s', _BRACKETS)}": lambda e: spaced(e.state, ".6f"),
    })  # fmt: skip
    yield found.status


@verb("atlas", example="dpcontrol atlas lab --energy 0.2", note="then: dpcontrol review FILE")
def atlas_command(
    *,
    model: str = argument(),
    energy: float = ENERGY,
    hits: tuple[int, int] | None = hits_option("for each kind, the first with intersections, up to 2"),
    thorough: bool = option(help=f"{THOROUGH} for each kind of connection."),
    seconds: float | None = seconds_option(),
    fresh: bool = option(help="New atlas, even if one is cached."),
    out: Path | None = file_option(suffix=".npz", help="Atlas to write (.npz)."),
    yes: bool = YES,
) -> Answer:
    """Compute all orbits, tubes and connections of an energy.

    The orbits are Lyapunov orbits about the saddles and rotating orbits. The atlas is one file with orbits, cuts, and
    connections with their flights. It is cached by content. Draw it with `dpcontrol review FILE`. The exit code is 1 if
    the list of connections may be incomplete.
    """
    from dpcontrol.plans.atlas import AtlasSettings, make_atlas, save_atlas
    from dpcontrol.plans.model import load_model
    from dpcontrol.tubes.intersections import search_settings

    settings = AtlasSettings(hits=hits, search=search_settings(thorough=thorough, seconds=seconds))
    with progress_bar("atlas") as progress:
        loaded = load_model(model)
        found = make_atlas(loaded, energy, settings=settings, fresh=fresh, yes=yes, progress=progress)
    atlas, file = found.atlas, found.file if os.path.isfile(found.file) else None
    if out is not None:
        save_atlas(out, atlas)
        file = out
    place_of = f"{model} at {energy:g}{loaded.unit('J')}"
    missed = "" if atlas.complete else f"the atlas of {place_of} is not complete: {atlas.status}"
    document = {**atlas.document(), "file": file, "cached": found.cached}
    partial = any(kind.partial for kind in atlas.kinds)
    nowhere = "none: a partial atlas is not cached; --out keeps it" if partial else "none: the cache cannot be written"
    place = f"{file or nowhere}{' (cached)' if found.cached else ''}"
    return Answer(document, [*_atlas_text(atlas, loaded), f"file  {place}"], missed)


def _atlas_text(atlas: "Atlas", model: "Model") -> Iterator[str | TextTable]:
    title = f"{atlas.model} at {atlas.energy:g}{model.unit('J')}: Lyapunov orbits"
    yield table(title, atlas.orbits, {
        "about": "{.name}", f"period{model.unit('s', _BRACKETS)}": "{.period:.12g}",
        "multiplier": "{0.floquet_multipliers[0].real:.10g}",
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
