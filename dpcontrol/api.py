"""The functions of `import dpcontrol as dp`, with values in memory.

They lead from a model to runs that are scored.

    lab = dp.load_model("lab")
    orbit = dp.orbit(lab, "down-up", energy=-0.07)
    walk = dp.shadow(dp.connections(orbit), ["down-up +"])
    run = dp.run(dp.reference(walk, limits=dp.Limits(position=0.4)), mismatch=0.02, seed=3)
    print(run.score().sentence)

Bad input is an `InputError`; a result that a step needs and that was not found is a `GoalMissed`. The
result of a failed search has `converged` False and the cause in `status`. Long calls take `progress`: a function of a
text and a share from 0 to 1, or True for a bar on stderr. By default, a line is written to stderr every twenty seconds.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, overload

from dpcontrol.foundation.budget import Budget
from dpcontrol.foundation.cache import CacheContents, cache_contents
from dpcontrol.foundation.checked import Between, Count, Hit, Index, Positive, Seed, Workers, checked
from dpcontrol.foundation.config import Configuration, config_file, configured, log_folder
from dpcontrol.foundation.errors import GoalMissed, InputError, remark
from dpcontrol.foundation.files import (
    Film,
    Output,
    Picture,
    chosen_name,
    free_name,
    in_the_way,
    is_bag_folder,
    write_whole,
)
from dpcontrol.foundation.guide import GuidePage, page as guide_page
from dpcontrol.foundation.parts import StageModule, installed, part
from dpcontrol.foundation.progress import Cost, Progress, Reporting, announce, part_of
from dpcontrol.foundation.rendering import render

STAGES = {
    "chains": "dynamics.chain",
    "atlases": "plans.atlas",
    "bench_server": "rig.bench",
    "bifurcations": "bifurcations.bifurcations",
    "links": "bifurcations.links",
    "campaign_tables": "judge.campaign",
    "campaigns": "runs.campaign",
    "loops": "runs.closed_loop",
    "comparison": "judge.comparison",
    "drawing": "bench.drawing",
    "energy_charts": "bench.energies",
    "example_benches": "runs.example_bench",
    "extended": "shooting.extended",
    "families": "orbits.family",
    "films": "pages.film",
    "fits": "identification.fit",
    "flights": "runs.flights",
    "following": "walks.following",
    "identification": "identification.identify",
    "identification_pages": "pages.identification",
    "importing": "recordings.importing",
    "intersections": "tubes.intersections",
    "itineraries": "plans.itinerary",
    "learning": "runs.learning",
    "log_reader": "logs.reader",
    "log_recovery": "logs.recovery",
    "log_views": "judge.of_log",
    "lyapunov": "orbits.lyapunov",
    "mjcf_files": "dynamics.mjcf",
    "models": "plans.model",
    "night_logs": "judge.night",
    "night_runs": "runs.night",
    "overrides": "plans.overrides",
    "own_objects": "loop.own",
    "page_layout": "pages.layout",
    "paper_figures": "pages.figures",
    "servers": "planner.server",
    "plans": "plans.plan",
    "polishing": "runs.polish",
    "proof_checks": "proofs.check",
    "proofs": "proofs.prove",
    "recording_checks": "recordings.checks",
    "recording_files": "recordings.recording",
    "reference_problems": "references.problem",
    "references": "references.reference",
    "renderers": "pages.renderers",
    "replays": "identification.replay",
    "report_pages": "pages.page",
    "rerun_recordings": "pages.rerun_recording",
    "rotations": "orbits.rotating",
    "schemas": "plans.schema",
    "scoring": "judge.score",
    "shadowing": "walks.shadowing",
    "single_runs": "runs.run",
    "sustained_orbits": "references.sustained",
    "symmetric": "tubes.symmetric",
    "systems": "dynamics.system",
    "transports": "tubes.transport",
    "tubes": "tubes.connections",
    "viewer": "pages.viewer",
    "graphs": "walks.edges",
    "walk_lists": "walks.walks",
    "walk_symbols": "walks.symbols",
}
"""Modules that are imported when a function uses them, by their names here: help and completion must not wait."""

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dpcontrol.bench import chart, drawing, energies as energy_charts
    from dpcontrol.bifurcations import bifurcations, links
    from dpcontrol.control import export as exports
    from dpcontrol.control.flight import Flight as Flight
    from dpcontrol.control.symbolic import Setpoint as Setpoint, SymbolicLaw as SymbolicLaw
    from dpcontrol.dynamics import chain as chains, mjcf as mjcf_files, system as systems
    from dpcontrol.dynamics.components import Sizes as Sizes, SymbolicPlant as SymbolicPlant, Terms as Terms
    from dpcontrol.dynamics.propagator import Section as Section
    from dpcontrol.dynamics.system import System as System
    from dpcontrol.identification import fit as fits, identify as identification, replay as replays
    from dpcontrol.judge import (
        campaign as campaign_tables,
        comparison,
        night as night_logs,
        of_log as log_views,
        preflight as preflights,
        score as scoring,
    )
    from dpcontrol.logs import reader as log_reader, recovery as log_recovery
    from dpcontrol.loop import own as own_objects
    from dpcontrol.loop.protocols import Reading as Reading, UserEstimator, UserLaw, UserPlant, UserRig
    from dpcontrol.orbits import family as families, lyapunov, rotating as rotations
    from dpcontrol.pages import (
        figures as paper_figures,
        film as films,
        identification as identification_pages,
        layout as page_layout,
        page as report_pages,
        renderers,
        rerun_recording as rerun_recordings,
        viewer,
    )
    from dpcontrol.planner import server as servers
    from dpcontrol.plans import (
        atlas as atlases,
        itinerary as itineraries,
        model as models,
        overrides,
        plan as plans,
        schema as schemas,
    )
    from dpcontrol.plans.model import Model as Model, load_model as load_model
    from dpcontrol.proofs import check as proof_checks, prove as proofs
    from dpcontrol.recordings import checks as recording_checks, importing, recording as recording_files
    from dpcontrol.references import (
        problem as reference_problems,
        reference as references,
        sustained as sustained_orbits,
    )
    from dpcontrol.references.problem import Limits as Limits, ReferenceSettings as ReferenceSettings
    from dpcontrol.rig import bench as bench_server, commissioning
    from dpcontrol.runs import (
        campaign as campaigns,
        closed_loop as loops,
        example_bench as example_benches,
        flights,
        learning,
        night as night_runs,
        polish as polishing,
        run as single_runs,
    )
    from dpcontrol.runs.campaign import CampaignSettings as CampaignSettings
    from dpcontrol.runs.night import NightSettings as NightSettings
    from dpcontrol.shooting import extended
    from dpcontrol.tubes import connections as tubes, intersections, symmetric, transport as transports
    from dpcontrol.walks import (
        atlas as walk_atlases,
        edges as graphs,
        following,
        shadowing,
        symbols as walk_symbols,
        walks as walk_lists,
    )

    Law: TypeAlias = UserLaw
    Estimator: TypeAlias = UserEstimator
    Plant: TypeAlias = UserPlant
    Rig: TypeAlias = UserRig
else:
    Rig = object  # Its methods are checked where they are called.
    globals().update({name: StageModule(module) for name, module in STAGES.items()})

Place = Path | str
NotNegative = Annotated[float, Between(0)]
LogFile = Annotated[Path | str | bool | None, Output((".mcap", ""), free=True)]
NewLog = Annotated[Path | str | Literal[True] | None, Output((".mcap",), free=True)]
NewModel = Annotated[Path | str | Literal[True] | None, Output((".toml",), free=True)]
"""A file to write; True for a free name of the usual kind."""
_ARMS = {"inner": 1, "outer": 2}
_SWEPT, _SWEPT_BYTES = 2.0, 1e6
"""What each energy of a sweep for bifurcations takes, in s and bytes, for each crossing of the section."""


@checked
def orbit(model: Model | System | str, saddle: str, *, energy: float, family: Index = 0) -> lyapunov.LyapunovOrbit:
    """Return the Lyapunov orbit about a saddle.

    Args:
        model: model, its name, or a system.
        saddle: saddle that the orbit surrounds, inner arm first, such as "down-up".
        energy: energy, J, zero at the pivot's height.
        family: which of the saddle's families, slowest first (default: 0).

    Returns:
        The orbit with state (N,), period (s) and Floquet multipliers; use it only if it `converged`.

    Raises:
        InputError: an unknown saddle or family, or an energy below the saddle's.

    Examples:
        >>> dp.orbit("lab", "down-up", energy=-0.07).period
        0.75238...
    """
    return lyapunov.lyapunov_orbit(_system(model), saddle, energy=energy, family=family)


@checked
def find_orbits(
    model: Model | System | str,
    *,
    saddle: str | None = None,
    family: Index = 0,
    rotating: Literal["inner", "outer"] | None = None,
    sustained: bool = False,
    sections: Annotated[int, Between(1, 1000)] = 4,
    transport: bool = False,
    energy: float | None = None,
    energies: tuple[float, float] | None = None,
    picture: Picture = None,
    progress: Reporting = None,
) -> (
    lyapunov.LyapunovOrbit
    | transports.Transport
    | families.LyapunovFamily
    | sustained_orbits.SustainedOrbit
    | rotations.RotatingOrbits
    | rotations.RotatingFamilies
):
    """Compute a Lyapunov orbit or its family, with Floquet multipliers.

    A family is followed from its saddle until it ends, loses hyperbolicity or leaves the given energies.

    `rotating` selects the symmetric orbits on which one arm rotates, with their stability. Their families start from
    the orbits at `energy`, or at the middle of `energies`.

    `sustained` selects the periodic orbit of pendulum and cart that the acceleration of the cart sustains against
    friction. It starts from the Lyapunov orbit at `energy` and has that energy at phase 0. There are two sets of
    multipliers: over a period with the input replayed, and from section to section with the input clock reset.

    Args:
        model: model, its name, or a system.
        saddle: saddle inside the orbit, inner arm first, such as down-up (default: none).
        family: family of orbits about the saddle, slowest first (default: 0).
        rotating: arm of the rotating orbits to find instead (default: none).
        sustained: orbit that the cart sustains against friction with the least effort instead.
        sections: resets of the input clock per period of the sustained orbit (default: 4).
        transport: rates at which motions pass the saddle's neck at `energy`, as `transport` returns them, instead.
        energy: energy, J, zero at the pivot's height, or in the three bodies' own units (default: none).
        energies: lowest and highest energy of a family, J (default: none).
        picture: picture to write, .png, .pdf or .svg (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The orbit, family or rates, with `lines()` and `document()`.

    Raises:
        InputError: neither a saddle nor a rotating arm, no energy, or what `orbit` and `family` raise.
        GoalMissed: the Lyapunov orbit did not converge, or there is no rotating orbit at the energy.

    Examples:
        >>> dp.find_orbits("lab", saddle="down-up", energy=-0.07).period
        0.75238...
    """
    if (saddle is None) == (rotating is None):
        raise InputError("give either saddle for Lyapunov orbits, or rotating = inner or outer for rotating orbits")
    if sustained and transport:
        raise InputError("give either sustained or transport")
    if (sustained or transport) and (saddle is None or energy is None):
        raise InputError("a sustained orbit and rates of transport need saddle and energy: give both")
    if energy is None and energies is None:
        raise InputError("give energy for the orbits of one energy, or energies for their families")
    if picture is not None and rotating is not None and energies is None:
        raise InputError("picture shows families of rotating orbits: give energies")
    system = _system(model)
    if rotating is not None:
        result = view = _rotating(system, rotating, energy, energies, progress)
    elif not sustained:
        result = view = _lyapunov(system, str(saddle), family, energy, energies, progress)
        result = transports.transport(result) if transport else result
    else:
        # A system without arms is rejected before the search for its orbit, which can take minutes.
        arms = models.model_of(system).arms
        conservative = _lyapunov(system, str(saddle), family, energy, energies, progress)
        result = replace(sustained_orbit(conservative, progress=progress), resets=sections)
        view = None
        if picture is not None:
            _found(result.converged, f"the sustained orbit about {saddle}", result.status)
            view = log_views.sustained_view(result, arms.length)
    _draw(view, picture)
    return result


@overload
def connections(
    source: lyapunov.LyapunovOrbit,
    target: lyapunov.LyapunovOrbit | None = None,
    *,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> tubes.ConnectionSearch: ...
@overload
def connections(
    source: lyapunov.LyapunovOrbit,
    *,
    energies: tuple[float, float],
    hits: tuple[Hit, Hit] = (1, 1),
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> symmetric.SymmetricSearch: ...
@checked
def connections(
    source: lyapunov.LyapunovOrbit,
    target: lyapunov.LyapunovOrbit | None = None,
    *,
    energies: tuple[float, float] | None = None,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> tubes.ConnectionSearch | symmetric.SymmetricSearch:
    """Find every connection from one orbit to another.

    Args:
        source: orbit that the connections leave.
        target: orbit of the same energy that they join (default: `source`).
        energies: for three arms, lowest and highest energy, J, of symmetric connections.
        hits: crossings of the section that count, of the unstable and the stable tube (default: (1, 1)).
        section: short name of the section (default: that of the saddles).
        longest: time to reach the section, in periods of the orbit (default: the model's).
        thorough: resolve parts that are reported as "at least", for up to a minute.
        seconds: processor time of the search, s (default: 60). A partial result is marked.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The connections, and whether the list is complete.

    Raises:
        InputError: the orbits differ in energy, an unknown section, three arms without `energies`, or two with them.
        GoalMissed: an orbit did not converge.

    Examples:
        >>> len(dp.connections(orbit).connections)
        8
    """
    if energies is not None:
        if target is not None and target is not source:
            raise InputError("energies and target are given: a symmetric connection leads back to its source; give one")
        if hits[0] != hits[1]:
            raise InputError(f"hits = {hits}: a symmetric connection meets the section of both tubes at the same one")
        return symmetric.find_symmetric_connections(
            source.system, source.saddle, energies=energies, family=source.family, hit=hits[0],
            budget=Budget(intersections.search_settings(seconds=seconds).seconds), progress=progress,
        )  # fmt: skip
    target = source if target is None else target
    source.system.check_same(target.system)
    for end in (source, target):
        _found(end.converged, f"the orbit about {end.saddle}", end.status)
    return tubes.find_connections(
        source,
        target,
        hits=hits,
        section=source.system.section_between(source.saddle, target.saddle, section),
        settings=intersections.search_settings(longest=longest, thorough=thorough, seconds=seconds),
        progress=progress,
    )


@checked
def find_connections(
    model: Model | System | str,
    source: str,
    target: str,
    *,
    energy: Decimal | float | None = None,
    energies: tuple[float, float] | None = None,
    family: Index = 0,
    hits: tuple[Hit, Hit] | None = None,
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    name: str | None = None,
    precision: Literal["double", "extended"] = "double",
    progress: Reporting = None,
) -> tubes.ConnectionSearch | symmetric.SymmetricSearch | tubes.ChosenConnection | tubes.RefinedConnection:
    """Find every connection between Lyapunov orbits at given section hits.

    The list contains all connections on the torus of angles: both senses, mirror pairs and reflections. The walk of an
    itinerary can use their names. The exit code is 1 if the list may be incomplete (`complete` in --json). With a name,
    only that connection counts, and `complete` is false if there may be others.

    Another section gives other connections first. Homoclinics that pass the other saddle cross "aligned" twice, so the
    hits 1,2 find them there.

    Orbits of three arms have connections at isolated energies only. Use `energies` to find the symmetric ones, which
    lead from an orbit back to itself through a moment at which every arm hangs or stands.

    Args:
        model: model, its name, or a system.
        source: first saddle of the connections.
        target: last saddle of the connections.
        energy: energy, J, zero at the pivot's height, or in the three bodies' own units (default: none).
        energies: for three arms: lowest and highest energy of symmetric connections, J (default: none).
        family: with energies: family of orbits, slowest first (default: 0).
        hits: section crossings of the connections, of the unstable and the stable tube (default: 1, or those of name).
        section: section of the search: outer-down (θ₂ = 2πk), inner-down (θ₁ = 2πk), aligned (θ₁ = θ₂ + 2πk);
            three-body: opposite, between (default: the saddles' own).
        longest: longest flight to the section, in periods of the orbit. A short limit also resolves scattering tubes
            (default: the model's, 12 for pendulums).
        thorough: longer search if the result is "at least": 20,000 or more trajectories per tube, up to a minute.
        seconds: processor time of the search, s; after it, the partial result is shown (default: 60).
        name: only this connection, by a name from the list (default: none).
        precision: precision of the connection with this name; extended refines it in 113-bit arithmetic (default:
            double).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The search, or the connection with the name.

    Raises:
        InputError: an unknown saddle, section or name, no orbit at the energy, or arguments that exclude each other.
        GoalMissed: an orbit did not converge, or the connection cannot be refined.

    Examples:
        >>> len(dp.find_connections("lab", "down-up", "down-up", energy=-0.07).connections)
        8
    """
    extended = precision == "extended"
    if energies is not None:
        options = {"energy": energy, "section": section, "longest": longest, "thorough": thorough, "name": name}
        if unused := [key for key, value in (options | {"precision": extended}).items() if value not in (None, False)]:
            raise InputError(f"{unused[0]} belongs to a search at one energy: omit it, or energies")
        if source != target:
            raise InputError(f"energies: symmetric connections lead back to their orbit: the target must be {source}")
        orbit = _lyapunov(_system(model), source, family, energies[0], None, progress)
        return connections(orbit, energies=energies, hits=hits or (1, 1), seconds=seconds, progress=progress)
    if energy is None:
        raise InputError("give energy or, for three arms, energies")
    if family:
        raise InputError("family belongs to a search with energies: omit it with energy")
    if extended and name is None:
        raise InputError("precision = extended refines one connection: give its name from the list of connections")
    symbol = None if name is None else walk_symbols.parse_symbol(name, [source, target])
    search = connections(
        *tubes.orbits_between(_system(model), source, target, float(energy)),
        hits=hits or (symbol and symbol.hits) or (1, 1),
        section=section or (symbol and symbol.section),
        longest=longest,
        thorough=thorough,
        seconds=seconds,
        progress=progress,
    )
    if name is None:
        return search
    connection = search.named(name)
    if not extended:
        return tubes.ChosenConnection(search, (connection,))
    progress("refining in 113-bit arithmetic", 0.9)
    refined = refine(connection, energy=energy)
    _found(refined.converged, f"{connection.name} in extended precision", refined.status)
    return tubes.RefinedConnection(connection, refined, str(energy))


@checked
def graph(
    model: Model | System | str,
    *,
    energy: float,
    symbols: Sequence[str] = (),
    yes: bool = False,
    progress: Reporting = None,
) -> graphs.Edges:
    """Find the connection graph of an energy.

    Args:
        model: model, its name, or a system.
        energy: energy, J.
        symbols: symbols of a walk, for other sections, later hits or rotating orbits (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Orbits of all saddles, and the connections between them.

    Raises:
        InputError: no saddle has an orbit at this energy, or a symbol is unknown.

    Examples:
        >>> dp.graph("lab", energy=-0.07).saddles
        ('down-up',)
    """
    system = _system(model)
    requested = walk_symbols.parse_walk(symbols, walk_lists.vertex_names(system)) if symbols else ()
    return graphs.find_edges(system, energy, symbols=requested, yes=yes, progress=progress)


@checked
def find_bifurcations(
    model: Model | System | str,
    source: str,
    target: str,
    *,
    energies: tuple[float, float] | None = None,
    parameter: tuple[str, float, float] | None = None,
    energy: float | None = None,
    height: Positive | None = None,
    hits: Hit = 1,
    samples: Annotated[int, Between(2, 1_000_000)] = 24,
    yes: bool = False,
    progress: Reporting = None,
) -> bifurcations.BifurcationSearch:
    """Find where connections appear, vanish or split, over the energy or a parameter of the model.

    There are three kinds of events. At a saddle-node, two connections meet and vanish. At a pitchfork, a mirror pair
    splits off a symmetric connection. At a section-artefact, the connection continues, but gains or loses an earlier
    crossing of the section. Changes of the count without such an event are reported. If trajectories scatter before
    they arrive, connections accumulate without end, and counts are lower bounds.

    Args:
        model: model, its name, or a system.
        source: first saddle of the connections.
        target: last saddle of the connections.
        energies: lowest and highest energy, J (default: none).
        parameter: name in `dpcontrol model`, lowest and highest value of a parameter, such as m2 0.05 0.3 (default:
            none).
        energy: energy at every value of the parameter, J (default: none).
        height: energy above the higher saddle instead, at every value of the parameter, J (default: none).
        hits: section crossings of the connections (default: 1).
        samples: energies or values of the first search, two or more (default: 24).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Events in order of the energy or of the parameter, and unexplained changes of the count.

    Raises:
        InputError: neither energies nor a parameter with its energy or height, an unknown saddle or parameter, values
            without both orbits, or too much work.

    Examples:
        >>> dp.find_bifurcations("lab", "down-up", "down-up", energies=(-0.08, -0.06), samples=2).events
        ()
    """
    levels = [level for level in (energy, height) if level is not None]
    if energies is not None and parameter is None and not levels:
        course, values = links.Quantity.of_energy(_system(model)), energies
    elif energies is None and parameter is not None and len(levels) == 1:
        saddles_below = () if height is None else (source, target)
        course = models.parameter_course(models.model_of(_system(model)), parameter, levels[0], saddles_below)
        values = parameter[1:]
    else:
        raise InputError("give either energies, or a parameter and its energy or height")
    cost = Cost(
        f"{samples:,} searches", _SWEPT * samples * hits, _SWEPT_BYTES * samples, f"samples = {samples}, hits = {hits}"
    )
    announce(cost, yes=yes)
    settings = bifurcations.SweepSettings(samples=samples)
    return bifurcations.find_bifurcations(
        course, source, target, values=values, crossings=hits, settings=settings, progress=progress
    )


@checked
def transport(orbit: lyapunov.LyapunovOrbit) -> transports.Transport:
    """Return the rates at which motions pass the neck of a saddle, without simulation.

    The mean time between passages is the volume of the energy surface over twice the orbit's action. It holds for
    motions that visit the energy surface evenly. The volume is that of all places that motions reach from the neck
    at this energy, through other open necks too.

    Args:
        orbit: Lyapunov orbit about the saddle, in two coordinates: of two arms, three bodies or your own system.

    Returns:
        Action (J s), volume (J s²), mean time (s) between passages, and the share that returns at once. It is not
        `converged` if the energy surface is unbounded.

    Raises:
        InputError: the system does not have two coordinates.
        GoalMissed: the orbit did not converge.

    Examples:
        >>> dp.transport(dp.orbit("lab", "down-up", energy=-0.07)).mean_time
        2.580...
    """
    return transports.transport(orbit)


@checked
def atlas(
    model: Model | System | str,
    *,
    energy: float,
    hits: tuple[Hit, Hit] | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    fresh: bool = False,
    out: Annotated[Path | str | None, Output((".npz",))] = None,
    yes: bool = False,
    progress: Reporting = None,
) -> walk_atlases.Atlas:
    """Compute all orbits, tubes and connections of an energy.

    The orbits are Lyapunov orbits about the saddles and rotating orbits. The atlas is one file with orbits, cuts, and
    connections with their flights. It is cached by content, unless a search of it ended early. Draw it with `dpcontrol
    review FILE`. The exit code is 1 if the list of connections may be incomplete.

    Args:
        model: model, its name, or a system.
        energy: energy, J, zero at the pivot's height; three bodies: own units.
        hits: section crossings of the connections, of the unstable and the stable tube (default: for each kind, the
            first with intersections, up to 2).
        thorough: longer search if the result is "at least": 20,000 or more trajectories per tube, up to a minute for
            each kind of connection.
        seconds: processor time per search, s; after it, the partial result is shown (default: 60).
        fresh: new atlas, even if one is cached.
        out: atlas to write, .npz (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The atlas, from the cache if possible, with its file.

    Raises:
        InputError: no saddle has an orbit at this energy, too much work, or a file that cannot be written.

    Examples:
        >>> len(dp.atlas("lab", energy=-0.07).connections)
        8
    """
    settings = atlases.AtlasSettings(
        hits=hits, search=intersections.search_settings(thorough=thorough, seconds=seconds)
    )
    loaded_model = _model(model) if isinstance(model, str) else model
    computed_atlas = atlases.make_atlas(
        loaded_model, float(energy), settings=settings, fresh=fresh, yes=yes, progress=progress
    )
    if out is None:
        return computed_atlas
    atlases.save_atlas(Path(out), computed_atlas)
    return replace(computed_atlas, file=Path(out))


@checked
def shadow(
    found: graphs.Edges | tubes.ConnectionSearch | Sequence[tubes.ConnectionSearch] | symmetric.SymmetricSearch,
    walk: Sequence[str] | walk_lists.WalkRequest,
    *,
    wraps: Sequence[Index] | None = None,
    lead_in: Index = 2,
    lead_out: Index = 2,
    periodic: bool = False,
    yes: bool = False,
) -> shadowing.ShadowingOrbit:
    """Return the orbit that follows a walk.

    Args:
        found: graph, or searches for connections, from which symbols select.
        walk: symbols such as "down-up +" and "down-up > up-down", names of connections, or a walk of `random_walks`.
        wraps: oscillations at each interior stop (default: the fewest that suffice).
        lead_in: oscillations on the first orbit (default: 2).
        lead_out: oscillations on the last orbit (default: 2).
        periodic: the walk closes, with one more stop (default: open).
        yes: accept work of more than an hour or 4 GB (default: refused).

    Returns:
        The orbit with symbol times (s) and an estimate of its error; use it only if it `converged`.

    Raises:
        InputError: a symbol matches no connection, or a wrong number of wraps.
        GoalMissed: no number of wraps suffices.

    Examples:
        >>> dp.shadow(found, ["down-up +"]).converged
        True
    """
    if isinstance(found, symmetric.SymmetricSearch):
        if isinstance(walk, walk_lists.WalkRequest):
            raise InputError("walk: drawn walks belong to graphs; for three arms give one symbol")
        return walk_lists.symmetric_walk(walk, found, lead_in=lead_in, lead_out=lead_out)
    searches = [found] if isinstance(found, tubes.ConnectionSearch) else found
    edges = searches if isinstance(searches, graphs.Edges) else _edges(searches)
    solver = shadowing.WalkSolver(edges.known)
    if isinstance(walk, walk_lists.WalkRequest):
        first_orbit = walk.chain[0].source
        _same_level(edges.system, edges.energy, first_orbit.system, first_orbit.energy)
        (answer,) = walk_lists.solved([walk], solver)
        if answer.orbit is None:
            raise GoalMissed(answer.status)
        return answer.orbit
    key = "wraps" if wraps else "walk"
    announce(walk_lists.walks_cost(1, symbols=len(walk), wraps=sum(wraps or ()), solve=True, key=key), yes=yes)
    chain = walk_lists.resolve(walk, edges)
    counts = solver.least(chain, periodic=periodic) if wraps is None else tuple(wraps)
    return solver.solve(chain, counts, periodic=periodic, lead_in=lead_in, lead_out=lead_out)


@checked
def prove(
    found: lyapunov.LyapunovOrbit | shadowing.ShadowingOrbit | tubes.ConnectionSearch,
    *,
    energy: proofs.Energies | Decimal | Fraction | float | None = None,
    rivals: graphs.Edges | None = None,
    horseshoe: bool = True,
    settings: proofs.ProofSettings | None = None,
    progress: Reporting = None,
) -> proofs.Proof:
    """Prove in ball arithmetic that orbits or connections exist.

    Args:
        found: orbit, walk, or search for connections.
        energy: exact energy, J, or `Energies` of an interval (default: the shortest decimal that reads as the orbit's).
        rivals: graph whose other connections the walk must not follow (default: not checked).
        horseshoe: prove also the horseshoe of homoclinic connections of one orbit (default: True).
        settings: precision and radii (default: those of `dpcontrol prove`).
        progress: reports, see `dpcontrol.api`.

    Returns:
        "proved" with enclosures and certificate, or the step that does not close.

    Raises:
        InputError: no connection, or a system without enclosures.
        GoalMissed: the orbit did not converge.
        PartMissing: the extra `proof` is not installed.

    Examples:
        >>> dp.prove(orbit).proved
        True
    """
    part("flint")
    if not isinstance(found, lyapunov.LyapunovOrbit) and not found.connections:
        raise InputError("found: the search has no connection to prove; search at another energy or with more hits")
    first_orbit = found if isinstance(found, lyapunov.LyapunovOrbit) else found.connections[0].source
    if rivals is not None:
        _same_level(first_orbit.system, first_orbit.energy, rivals.system, rivals.energy)
    height = proofs.Energies.of(first_orbit.energy if energy is None else energy)
    if not isinstance(found, lyapunov.LyapunovOrbit | shadowing.ShadowingOrbit):
        kind = "horseshoe" if horseshoe and first_orbit is found.connections[0].target else "connection"
        return proofs.prove_network(kind, found.connections, energy=height, settings=settings, progress=progress)
    if isinstance(found, shadowing.ShadowingOrbit):
        rival_connections = () if rivals is None else rivals.known
        return proofs.prove_walk(found, energy=height, rivals=rival_connections, settings=settings, progress=progress)
    return proofs.prove_orbit(found, energy=height, settings=settings, progress=progress)


@checked
def prove_graph(
    model: Model | System | graphs.Edges | str,
    *,
    energy: proofs.Energies | Decimal | Fraction | float | None = None,
    settings: proofs.ProofSettings | None = None,
    out: Annotated[Path | str | None, Output((".json",))] = None,
    yes: bool = False,
    progress: Reporting = None,
) -> proofs.Proof:
    """Prove that every walk on the connection graph of an energy is followed by an orbit.

    The connections between the orbits of all saddles are one network of covering relations. The proof has the fewest
    wraps at which all walks exist, and a lower bound of the topological entropy of the flow.

    Args:
        model: model, its name, a system, or its graph.
        energy: energy, J, as an exact decimal, or `Energies` of an interval (default: that of the graph).
        settings: precision and radii (default: those of `dpcontrol prove`).
        out: certificate to write, .json, for `prove check` (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        "proved" with links, wraps, entropy and certificate, or the link that does not close.

    Raises:
        InputError: the energy is missing, no saddle has an orbit, or a system without enclosures.
        PartMissing: the extra `proof` is not installed.

    Examples:
        >>> dp.prove_graph("lab", energy=-0.07).figures["wraps"]
        4
    """
    part("flint")
    if not isinstance(model, graphs.Edges):
        if energy is None:
            raise InputError("energy is missing: give the energy, J")
        model = graph(
            model, energy=float(proofs.Energies.of(energy).middle), yes=yes, progress=part_of(progress, 0.0, 0.1)
        )
    exact = proofs.Energies.of(model.energy if energy is None else energy)
    _same_level(model.system, model.energy, model.system, float(exact.middle))
    periods = (4 + (c.time_out + c.time_in) / c.source.period for c in model.connections)
    announce(_proof_cost(sum(periods)), yes=yes)
    proof = proofs.prove_network(
        "graph", model.connections, energy=exact, settings=settings, progress=part_of(progress, 0.1, 1.0)
    )
    return _certified(proof, out)


@checked
def prove_statement(
    statement: Literal["orbit", "walk", "connection", "horseshoe", "graph", "check"],
    model: Model | System | str,
    *,
    energy: Decimal | Fraction | float | None = None,
    within: Annotated[float, Between(0, 0.1)] = 0.0,
    saddle: str | None = None,
    family: Index = 0,
    symbols: Sequence[str] = (),
    wraps: Sequence[Index] | None = None,
    periodic: bool = False,
    source: str | None = None,
    target: str | None = None,
    names: Sequence[str] = (),
    hits: tuple[Hit, Hit] = (1, 1),
    bits: Annotated[int, Between(64, 1024)] = 128,
    radius: Annotated[float, Between(1e-20, 1e-3)] = 1e-8,
    box: Annotated[float, Between(1e-12, 1e-4)] = 1e-7,
    out: Annotated[Path | str | None, Output((".json",))] = None,
    yes: bool = False,
    progress: Reporting = None,
) -> proofs.Proof | proof_checks.CertificateCheck:
    """Prove in ball arithmetic that orbits exist, or check a certificate.

    Statements concern an orbit, a walk, connections, the horseshoe of one orbit, or the graph of all connections.
    Parameters and energy are exact decimals.
    The answer is "proved", or "not proved" with the enclosure that does not close. The latter is not a disproof.
    Separate code checks certificates.

    Args:
        statement: what to prove, or "check".
        model: model, its name, or a system; for "check", the file of a certificate.
        energy: energy, J, as an exact decimal (default: none).
        within: largest distance of other energies from it, J, which are covered piece by piece, 0 to 0.1 (default: 0).
        saddle: for orbit: saddle inside the orbit (default: none).
        family: for orbit: family of orbits about the saddle, slowest first (default: 0).
        symbols: for walk: symbol, in order, as for `dpcontrol walk` (default: none).
        wraps: for walk: wraps at the stops, such as 2,3 (default: the fewest that work).
        periodic: for walk: closed walk.
        source: for connection, horseshoe: first saddle (default: saddle).
        target: for connection: last saddle (default: the first one).
        names: for connection: name from the list of `dpcontrol connect` (default: all).
        hits: section crossings of the connections, of the unstable and the stable tube (default: 1).
        bits: working precision, 64 to 1024 bits (default: 128).
        radius: radius of the balls in which orbits are unique, scaled, 1e-20 to 1e-3 (default: 1e-8).
        box: for connections and open walks: half-width of the boxes, scaled, 1e-12 to 1e-4 (default: 1e-7).
        out: certificate to write, .json, for `prove check` (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The proof, or the verdict on the certificate.

    Raises:
        InputError: a part of the statement is missing, a system without enclosures, or too much work.
        GoalMissed: an orbit to prove was not found.
        PartMissing: the extra `proof` is not installed.

    Examples:
        >>> dp.prove_statement("orbit", "lab", saddle="down-up", energy=-0.07).proved
        True
    """
    part("flint")
    if statement == "check":
        if out is not None:
            raise InputError(f"out = {out}: a check writes no certificate; omit it")
        return check_proof(str(model), progress=progress)
    system, first_saddle, settings = _system(model), source or saddle, proofs.ProofSettings(bits, radius, box)
    if energy is None:
        raise InputError("energy is missing: give the energy, J")
    if statement == "walk" and not symbols:
        raise InputError("a walk is missing: give its symbols")
    if first_saddle is None and statement not in ("walk", "graph"):
        raise InputError("give the saddle inside the orbit, or the source of the connections, such as down-up")
    if statement == "horseshoe" and target not in (None, first_saddle):
        raise InputError("a horseshoe needs homoclinics of one orbit: omit the target")

    def proved(energies: proofs.Energies) -> proofs.Proof:
        """Return the proof of `statement` over an interval, which `over_range` halves if the proof fails."""
        height, energy_and_settings = float(energies.middle), {"energy": energies, "settings": settings}
        if statement == "graph":
            return prove_graph(system, **energy_and_settings, yes=yes, progress=progress)
        if statement == "walk":
            edges = graph(system, energy=height, symbols=symbols, yes=yes, progress=part_of(progress, 0.0, 0.2))
            walk = shadow(edges, symbols, wraps=wraps, periodic=periodic, yes=yes)
            announce(_proof_cost(walk.duration / walk.connections[0].source.period), yes=yes)
            return prove(walk, **energy_and_settings, rivals=edges, progress=part_of(progress, 0.2, 1.0))
        source_orbit = orbit(system, str(first_saddle), energy=height, family=family)
        if statement == "orbit":
            return prove(source_orbit, **energy_and_settings, progress=progress)
        target_orbit = source_orbit if target in (None, first_saddle) else orbit(system, str(target), energy=height)
        search = connections(source_orbit, target_orbit, hits=hits, progress=part_of(progress, 0.0, 0.1))
        chosen_connections = tuple(search.named(name) for name in dict.fromkeys(names)) or search.connections
        announce(
            _proof_cost(sum(4 + (c.time_out + c.time_in) / source_orbit.period for c in chosen_connections)), yes=yes
        )
        chosen_search, is_horseshoe = replace(search, connections=chosen_connections), statement == "horseshoe"
        return prove(chosen_search, **energy_and_settings, horseshoe=is_horseshoe, progress=part_of(progress, 0.1, 1.0))

    return _certified(proofs.over_range(proofs.Energies.of(energy, within), proved), out)


@checked
def reference(
    walks: shadowing.ShadowingOrbit | Sequence[shadowing.ShadowingOrbit],
    *,
    limits: Limits | None = None,
    settings: ReferenceSettings | None = None,
    start: Literal["orbit", "rest"] = "orbit",
    finish: Literal["orbit", "rest"] = "orbit",
    name: str = "walk",
    yes: bool = False,
    progress: Reporting = None,
) -> plans.Plan:
    """Plan one or more walks with friction and a cart.

    Args:
        walks: orbit of `shadow`, or several in order.
        limits: limits of the cart, m, m/s and m/s² (default: those of itineraries).
        settings: method, mesh and tolerance of the collocation (default: those of itineraries).
        start: begin on the "orbit", by default, or at "rest".
        finish: end on the "orbit", by default, or at "rest".
        name: name of the plan (default: "walk").
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The plan, from the cache if possible; use it only if it `converged`.

    Raises:
        InputError: a system without arms, a periodic walk, or an end that cannot be reached.
        GoalMissed: a walk's orbit did not converge, or no transfer exists between two walks.

    Examples:
        >>> dp.reference(walk, limits=dp.Limits(position=0.4)).converged
        True
    """
    orbits = [walks] if isinstance(walks, shadowing.ShadowingOrbit) else list(walks)
    if not orbits:
        raise InputError("walks = []: give one at least")
    for walk in orbits:
        orbits[0].connections[0].source.system.check_same(walk.connections[0].source.system)
        _found(walk.converged, "the walk's orbit", walk.status)
        if walk.periodic:
            raise InputError("a periodic walk has no ends that a reference could start and finish at; shadow it open")
    parts = [
        itineraries.WalkPart(walk.connections[0].source.energy, walk.walk, walk.wraps, 1, walk.lead_in, walk.lead_out)
        for walk in orbits
    ]
    loaded = itineraries.itinerary_of(
        models.model_of(orbits[0].connections[0].source.system),
        parts,
        name=name,
        start=start,
        finish=finish,
        limits=limits,
        reference=settings,
    )
    return plans.make_plan(loaded, orbits=orbits, progress=progress, yes=yes)


@checked
def plan(
    itinerary: Place,
    *,
    fresh: bool = False,
    out: Annotated[Path | str | None, Output((".npz",))] = None,
    margins: bool = False,
    polish: bool = False,
    explore_energy: Picture = None,
    workers: Workers = 0,
    yes: bool = False,
    progress: Reporting = None,
) -> plans.Plan:
    """Plan an itinerary: connections, shadowing orbit and reference.

    Plans are cached by content, so the same itinerary is planned once. Each transfer is cached too, so interrupted
    planning resumes with the next one.

    Args:
        itinerary: name or path of an itinerary's file.
        fresh: new plan, even if one is cached.
        out: reference to write, .npz, the polished one if there is one (default: none).
        margins: limits of gain, delay and lag along the plan, in some seconds.
        polish: joint optimisation of a motion from rest to rest, compared with the robust plan, in a minute or two.
        explore_energy: chart of the effort with feedback at ±5 % over energies, in a minute (default: none).
        workers: processes that search for transfers (default: one per processor if there are at least four).
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The plan, from the cache if possible; use it only if it `converged`.

    Raises:
        InputError: no such file, a mistake in it, or no such connections at its energy.
        GoalMissed: an orbit did not converge, or no transfer exists.

    Examples:
        >>> dp.plan("outer-turn").itinerary.walk
        ('down-up +',)
    """
    loaded = itineraries.load_itinerary(str(itinerary))
    if explore_energy is not None:
        energy_charts.only_walk(loaded)
    planned = plans.make_plan(loaded, progress=part_of(progress, 0.0, 0.5), fresh=fresh, workers=workers, yes=yes)
    if not planned.converged:
        return planned
    if polish:
        step = part_of(progress, 0.5, 0.8)
        planned = replace(
            planned, polished=polishing.polish(planned, fresh=fresh, workers=workers, yes=yes, progress=step)
        )
    if margins:
        planned = replace(planned, margins=closed_loop(planned).margins())
    if explore_energy is not None and not planned.missed:
        step = part_of(progress, 0.8, 1.0)
        planned = replace(planned, energies=explore_energies(planned, picture=explore_energy, progress=step))
    return planned if out is None or planned.missed else planned.written_to(Path(out))


@checked
def closed_loop(
    itinerary: plans.Plan | str,
    *,
    settings: Mapping[str, object] | None = None,
    yes: bool = False,
    progress: Reporting = None,
    **named: object,
) -> loops.ClosedLoop:
    """Return the closed loop of a plan.

    Args:
        itinerary: plan, or name or path of an itinerary.
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.
        named: further settings by the last part of their paths, such as `mismatch=0.02`; laws, estimators and plants
            may be objects.

    Returns:
        The loop, which runs, counts, measures and exports.

    Raises:
        InputError: an unknown or impossible setting, or too much work.
        GoalMissed: the itinerary cannot be planned.

    Examples:
        >>> dp.closed_loop("outer-turn", mismatch=0.02).run(seed=3).converged
        True
    """
    return _closed(itinerary, _settings(settings, **named), yes=yes, progress=progress)


@checked
def mjcf(
    model: Model | chains.ArmChainParameters | str,
    *,
    cart_mass: float = 20.0,
    lag: float = 0.002,
    out: Place | None = None,
) -> str:
    """Return the arms on their cart as a model for MuJoCo.

    Args:
        model: model, its name, or arms.
        cart_mass: mass of the cart, kg (default: 20).
        lag: time constant of the servo, s; its control is the cart's velocity, m/s (default: 0.002).
        out: file to write (default: none).

    Returns:
        The model in MuJoCo's XML.

    Raises:
        InputError: the model has no arms or has quadratic friction, or a mass or lag is not positive.

    Examples:
        >>> dp.mjcf("lab").startswith("<mujoco")
        True
    """
    arms = model if isinstance(model, chains.ArmChainParameters) else _model(model).arms
    text = mjcf_files.mjcf_text(arms, name="arms", cart_mass=cart_mass, lag=lag)
    if out is not None:
        write_whole(Path(out), text)
    return text


@checked
def polish(
    itinerary: plans.Plan | str,
    *,
    fresh: bool = False,
    runs: Count = 48,
    workers: Workers = 0,
    yes: bool = False,
    progress: Reporting = None,
) -> polishing.Polished:
    """Re-optimise a motion from rest to rest as one problem.

    The polished plan keeps crossings, windings and wraps at a fraction of the effort. It may stay far from the orbits.

    Args:
        itinerary: plan from rest to rest, or name or path of an itinerary.
        fresh: compute it again even if it is cached.
        runs: runs of each plan at a mismatch of 5 and of 20 % (default: 48).
        workers: processes of these runs, 0 for one per processor.
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Both plans, with effort, peak, travel and completed runs as `sides`.

    Raises:
        InputError: the plan is not from rest to rest or is polished already, or too much work.
        GoalMissed: the plan did not converge, or no controller exists for it.

    Examples:
        >>> found = dp.polish("one-arm", runs=8)
        >>> found.sides[1].effort < found.sides[0].effort
        True
    """
    planned = (
        plan(itinerary, yes=yes, progress=part_of(progress, 0.0, 0.2)) if isinstance(itinerary, str) else itinerary
    )
    return polishing.polish(
        planned, fresh=fresh, runs=runs, workers=workers, yes=yes, progress=part_of(progress, 0.2, 1.0)
    )


@checked
def run(
    itinerary: plans.Plan | str,
    *,
    mismatch: float | None = None,
    plant: Place | None = None,
    start: Sequence[float] | str | None = None,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    rig: Rig | single_runs.RigLink | str | None = None,
    log: Place | None = None,
    force: bool = False,
    live: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> single_runs.Run:
    """Run a plan once in closed loop, and log it if requested; see `launch` for long and repeated runs.

    Args:
        itinerary: plan, or name or path of an itinerary.
        mismatch: largest relative error of the plant's parameters (default: the itinerary's).
        plant: name or path of a model for a plant with other arms (default: the same arms).
        start: state (N,) from which a flight leads to the first stop, or "anywhere" for a random one within
            the bounds of the settings `initial_…` (default: as planned).
        seed: seed of the random numbers (default: 0).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        rig: object with `read()`, `command(acceleration)` and `stop()`, address of a bench in real time, or link of
            `rig_link` (default: the simulated bench).
        log: log to write (default: the run stays in memory).
        force: replace the log of another run there.
        live: show the run in the viewer.
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The run, which scores, draws and explains itself.

    Raises:
        InputError: an impossible setting, too much work, a log that cannot be written, or no display for a live view.
        GoalMissed: the plan did not converge, or no controller exists for it.

    Examples:
        >>> dp.run("outer-turn", mismatch=0.02, seed=3).converged
        True
    """
    run_settings = _settings(settings, mismatch=mismatch, plant=plant, start=start)
    loop = _closed(itinerary, run_settings, yes=yes, progress=part_of(progress, 0.0, 0.5))
    return loop.run(seed=seed, rig=rig, log=log, force=force, live=live, progress=part_of(progress, 0.5, 1.0))


@checked
def flight(
    model: Model | chains.ArmChainParameters | plans.Plan | str,
    state: Sequence[float],
    target: str | lyapunov.LyapunovOrbit | sustained_orbits.SustainedOrbit | plans.Plan,
    *,
    limits: Limits | None = None,
) -> Flight:
    """Return a short motion of the cart that carries the arms from any state to a target.

    At its end, the law that holds the target takes over. The flight uses two thirds of the greatest acceleration, 80 %
    of the greatest speed, and leaves up to 7 cm of the track free at each end, so that feedback can follow it.

    Args:
        model: model, its name, arms, or a plan, whose model and limits are used.
        state: state (N,): angles, rad, rates, rad/s, and position and velocity of the cart, m and m/s; without the last
            two, the cart is at rest in the middle.
        target: name of an equilibrium such as "up-up", an orbit (any phase), or a plan (its first stop).
        limits: limits of the cart (default: the plan's, or those of `Limits`).

    Returns:
        The flight, which samples and draws itself, and tells its cause if it misses the target.

    Raises:
        InputError: a state of another length, or an unknown equilibrium.
        GoalMissed: the target cannot be held.

    Examples:
        >>> dp.flight("lab", [0, 0, 0, 0, 0, 0], "up-up").converged
        True
    """
    if isinstance(model, plans.Plan):
        arms, limits = model.itinerary.model.arms, limits or model.reference.limits
    else:
        arms = model if isinstance(model, chains.ArmChainParameters) else _model(model).arms
    return flights.plan_flight(arms, state, target, limits or reference_problems.Limits())


@checked
def launch(
    itinerary: plans.Plan | str | None = None,
    *,
    source: Place | None = None,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    rig: Rig | single_runs.RigLink | str | None = None,
    program: Place | None = None,
    real_time: bool = False,
    key_file: Place | None = None,
    insecure: bool = False,
    hours: Positive | None = None,
    file_minutes: Positive = 10.0,
    keep_every: Count = 1,
    learn: bool = False,
    resume: bool = False,
    live: bool = False,
    log: LogFile = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> single_runs.Run | night_logs.Night | single_runs.Repeat:
    """Run an itinerary in closed loop, on the simulated bench or on a rig.

    The itinerary is planned first if its plan is not cached. The run is missed (exit code 1) if it is not completed. A
    rig has no true state, so there it is missed if the run ended early, or if by the estimate a symbol was not done.
    For hours, the itinerary is repeated, seamlessly if its end meets its start, and otherwise after a flight to it.
    After a fall, the arms fly back and the symbol is repeated, except with another `on_fall`.

    Args:
        itinerary: plan, or name or path of an itinerary.
        source: log to repeat, from its attachments alone; missed if a message differs (default: none).
        seed: seed of all random numbers (default: 0).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        rig: bench for a run in real time: udp://HOST:PORT (see `dpcontrol rig`), serial://PORT of a microcontroller, or
            udp to start the example bench; FILE.py:CLASS or an object with `read()`, `command(acceleration)` and
            `stop()` is a rig in Python, which runs as fast as it answers. A real bench needs an itinerary with
            start = "rest" (default: the simulated bench).
        program: program that controls the run on rig udp, such as main_udp of `export` (default: none).
        real_time: priority over all ordinary processes, on a rig.
        key_file: file with the shared key of bench and loop (default: the environment's DPCONTROL_RIG_KEY).
        insecure: no key for a bench on another computer.
        hours: duration of a long run through falls, h, with the folder logs/NAME-SEED (default: a single run).
        file_minutes: duration of each log of the folder, min (default: 10).
        keep_every: interval of the older logs to keep, each N-th (default: 1).
        learn: in a long run, a new plan after the first repetition, for the arms learnt from it (see `learn`).
        resume: continuation of the interrupted long run in this folder.
        live: view of the run while it happens.
        log: log to write, logs/NAME-SEED.mcap on the command line; a folder without .mcap for a long run (default: the
            run stays in memory).
        force: replacement of an existing log, whatever made it.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The run, which scores, draws and explains itself; a long run; or the comparison of a repeated run.

    Raises:
        InputError: an impossible setting, arguments that exclude each other, too much work, a log that cannot be
            written, or no display for a live view.
        GoalMissed: the plan did not converge, or no controller exists for it.

    Examples:
        >>> dp.launch(source=log, log=log.with_name("same.mcap")).comparison.difference is None
        True
    """
    if source is not None:
        if any((itinerary, seed, settings, rig, program, hours, resume, live)):
            raise InputError(f"source = {source}: a run is repeated without changes; give only log and force with it")
        with chosen_name(log or True, single_runs.repeated_log(Path(source))) as file:
            return repeat(source, str(file), force=force, progress=progress)
    if itinerary is None:
        raise InputError("itinerary is missing: give one, or with source a log to repeat")
    if hours is None and (resume or learn or keep_every != 1 or file_minutes != 10.0):
        raise InputError("learn, resume, keep_every and file_minutes apply to long runs: give hours")
    if program is not None and (hours is not None or live):
        raise InputError("program: controls single runs without a live view; omit hours and live")
    if live:
        viewer.check_viewer(viewer.LIVE_REMEDY)
    bench = loops.bench_of(_linked(rig, key_file=key_file, insecure=insecure, real_time=real_time))
    run_settings, options = _settings(settings), {"force": force, "live": live}
    loaded = _loaded(itinerary).with_run(run_settings, seed=seed)
    night = None if hours is None else night_runs.NightSettings(hours, file_minutes, keep_every)
    loaded = loaded if night is None else night_runs.night_itinerary(loaded, overrides=run_settings)
    check = night_runs.name_check(
        loaded, bench, night, resume=resume, free=log is True and not learn, force=force, yes=yes
    )
    # Names are checked before the plan, which can take minutes.
    with chosen_name(log, single_runs.default_log(loaded), check) as file:
        loop, step = (
            _closed(itinerary, run_settings, yes=yes, progress=part_of(progress, 0.0, 0.5)),
            part_of(progress, 0.5, 1.0),
        )
        if night is None:
            return loop.run(seed=seed, rig=bench, program=program, log=file, progress=step, **options)
        folder = file or single_runs.default_log(loaded)
        return loop.night(
            night, folder, seed=seed, rig=bench, resume=resume, learn=learn, yes=yes, progress=step, **options
        )


@checked
def learn(
    logs: Place | Sequence[Place],
    *,
    out: NewModel = None,
    force: bool = False,
    progress: Reporting = None,
) -> learning.Learnt:
    """Learn the arms from runs, and plan their itinerary again for the learnt arms.

    The filter of the adaptive law estimates the model's errors with their covariance. At the end of a run they give the
    arms' ratios, those of several runs weighted by information. The new plan is of the last run's itinerary, and its
    filter starts at the learnt covariance. Run it as `dpcontrol run models/NAME-learnt.npz`.

    Args:
        logs: logs of runs with the adaptive law on one rig, in order.
        out: model to write, with its plan beside it as .npz, models/NAME-learnt.toml on the command line (default: no
            files).
        force: replace an existing model and plan.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Ratios with standard errors, model, plan, and effort of the feedback before and as expected.

    Raises:
        InputError: a log without estimates of the model's errors, logs of different arms, or a file that cannot be
            written.
        GoalMissed: there are no such arms near the model's, or no plan for them.

    Examples:
        >>> dp.learn("logs/outer-turn.mcap").effort_expected < 0.1  # doctest: +SKIP
        True
    """
    files = [Path(log) for log in ([logs] if isinstance(logs, str | Path) else logs)]
    if not files:
        raise InputError("logs = []: give at least one log")
    runs, names = [open_log(file) for file in files], [file.name for file in files]
    last_metadata = runs[-1].log.metadata
    with chosen_name(
        out,
        Path("models") / f"{last_metadata.get('itinerary', 'run')}-learnt.toml",
        lambda file: models.check_model_replaced(
            file, logs=names, starting_model=last_metadata.get("model", ""), force=force
        ),
    ) as file:
        learnt_model = runs[-1].learn(runs[:-1], progress=progress)
        return learnt_model if file is None else learnt_model.written_to(file)


@checked
def export(
    itinerary: plans.Plan | str,
    folder: Annotated[Place | None, Output(folder=True)] = None,
    *,
    single: bool = False,
    clock: Annotated[float, Between(1, 100_000)] | None = None,
    unit: bool = False,
    settings: Mapping[str, object] | None = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> exports.ControllerSource:
    """Write the controller of an itinerary as C99.

    The C code has estimator, law and supervisor in one call. The itinerary is planned first if its plan is not cached.
    The folder has a Makefile, a replay program and a page on the wiring. Only laws with gains by time can be exported:
    tvlqr, adaptive, lqr, feedforward. Settings of the bench, such as the mismatch, only change the simulated run that
    `make check` replays.

    Args:
        itinerary: plan, or name or path of an itinerary.
        folder: folder to write, or NAME.fmu for a co-simulation unit (default: none).
        single: single precision.
        clock: clock of a Cortex-M4 that must keep the rate, MHz (default: not checked).
        unit: True for a co-simulation unit (FMI 2.0) for Simulink, Modelica tools and FMPy, NAME.fmu.
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        force: replacement of existing files with these names.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The files, with code size, memory and operations per tick.

    Raises:
        InputError: the law or the estimator has no C export, or the folder has other files.
        GoalMissed: the plan did not converge, or no controller exists for it.

    Examples:
        >>> sorted(dp.export("outer-turn", single=True).files)[:2]
        ['CMakeLists.txt', 'Makefile']
    """
    if unit and (folder is None or Path(folder).suffix != ".fmu"):
        raise InputError(f"folder = {folder}: a co-simulation unit needs a name that ends in .fmu")
    run_settings = _settings(settings)
    single_runs.check_exportable(_loaded(itinerary).with_run(run_settings))
    loop = _closed(itinerary, run_settings, yes=yes, progress=part_of(progress, 0.0, 0.5))
    return loop.export(folder, single=single, clock=clock, force=force, progress=part_of(progress, 0.5, 1.0))


@checked
def campaign(
    itinerary: plans.Plan | str,
    *,
    runs: Count | None = None,
    mismatch: float | None = None,
    plant: Place | None = None,
    settings: Mapping[str, object] | None = None,
    over: Mapping[str, object] | None = None,
    first_seed: Seed = 0,
    standard: bool = False,
    transitions: bool = False,
    path: Literal["compiled", "ticks"] = "compiled",
    workers: Workers = 0,
    out: Annotated[Place | bool | None, Output((".parquet",), free=True, folder=True)] = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> campaigns.Campaign:
    """Run an itinerary with many seeds and count the completed runs.

    Every case runs the same seeds. An interrupted campaign with a table resumes with the same call. A run with the seed
    of a failure and the same settings repeats it. The standard score applies to every controller that `over` lists, or
    to that of the itinerary.

    Args:
        itinerary: plan, or name or path of an itinerary.
        runs: number of seeds of each case (default: 100, or 8 for the standard score).
        mismatch: largest relative error of the plant's parameters (default: the itinerary's).
        plant: name or path of a model for a plant with other arms (default: the same arms).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        over: values of a setting by path, each combination of several settings a case (default: one case).
        first_seed: first seed (default: 0).
        standard: robustness score: nine kinds of disturbances at 21 levels each.
        transitions: separate runs of each transfer from hold to hold.
        path: method of simulation: many seeds in lockstep, or the loop itself (default: compiled).
        workers: number of processes (default: one per processor).
        out: table to write, a folder NAME.parquet; logs/NAME.parquet on the command line (default: none).
        force: replacement of an existing table, whatever made it.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Shares of completed runs with 95 % intervals, and failures with seeds and reasons.

    Raises:
        InputError: an unknown setting, an impossible value, or a file that cannot be written.
        GoalMissed: the plan did not converge, or workers ended repeatedly.

    Examples:
        >>> dp.campaign("outer-turn", runs=4, mismatch=0.02).completed.rate
        1.0
    """
    # Check for the writer of the table before the plan, which can take minutes.
    part("pyarrow")
    loaded, fixed_settings = _loaded(itinerary), _settings(settings, mismatch=mismatch, plant=plant)
    # A score needs no list of confirmed failures.
    replayed_failures = 0 if standard else campaigns.CampaignSettings.replayed
    counts = campaigns.CampaignSettings(
        runs or (8 if standard else 100), first_seed, path, workers, replayed=replayed_failures
    )
    cases = campaigns.asked_cases(
        loaded, fixed=fixed_settings, over=over or {}, standard=standard, transitions=transitions
    )
    record = campaigns.campaign_record(loaded, cases, counts, transitions=transitions)

    def check(file: Path) -> None:
        """Reject a file with the table of another campaign, which would be lost, unless `force` is True."""
        if not force:
            campaigns.check_table(file, record)

    default_table = log_folder() / f"{loaded.name}{'-transitions' if transitions else ''}.parquet"
    with chosen_name(out, default_table, check) as file:
        loop = _closed(itinerary, fixed_settings, yes=yes, progress=part_of(progress, 0.0, 0.1))
        return loop.campaign(
            over=over, settings=counts, standard=standard, transitions=transitions, out=file, force=force, yes=yes,
            progress=part_of(progress, 0.1, 1.0),
        )  # fmt: skip


@checked
def preflight(
    itinerary: plans.Plan | str,
    *,
    runs: Index = 0,
    first_seed: Seed = 1_000_000,
    workers: Workers = 0,
    settings: Mapping[str, object] | None = None,
    picture: Annotated[Place | bool | None, Output((".pdf", ".png", ".svg"), free=True)] = None,
    yes: bool = False,
    progress: Reporting = None,
) -> preflights.Preflight:
    """Predict whether the first run on a rig completes.

    The arms are drawn from the identified uncertainty of the model, or from a mismatch if the model file has none. The
    bench is that of [run], which `commission` fills with measurements. The limit of a disturbance is the value at which
    the itinerary completes half as often. A repeated call resumes after an interruption.

    Args:
        itinerary: plan, or name or path of an itinerary.
        runs: number of seeds for the rate, 16 or more, or 0 for as many as two minutes allow (default: 0).
        first_seed: first seed (default: 1,000,000).
        workers: number of processes (default: one per processor).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        picture: page to write, logs/NAME-preflight.pdf on the command line (default: none).
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Success rate, causes of failure, borders, and useful changes.

    Raises:
        InputError: an impossible setting, or it would take too long.
        GoalMissed: the plan did not converge, or no controller exists for it.

    Examples:
        >>> dp.preflight("hold-up-up", runs=16, yes=True).share.runs  # doctest: +SKIP
        16
    """
    loaded, run_settings = _loaded(itinerary), _settings(settings)
    default_page = log_folder() / f"{loaded.name}-preflight.pdf"
    with chosen_name(picture, default_page) as file:
        loop = _closed(itinerary, run_settings, yes=yes, progress=part_of(progress, 0.0, 0.05))
        prediction = loop.preflight(
            runs=runs, first_seed=first_seed, workers=workers, yes=yes, progress=part_of(progress, 0.05, 1.0)
        )
        return _drawn(prediction, file)


@checked
def swings(
    model: Model | str, *, count: Count = 9, seconds: Positive = 2.667, seed: Seed = 0, yes: bool = False
) -> recording_files.Recording:
    """Return simulated free swings as encoders would record them.

    Args:
        model: model of arms, or its name.
        count: number of swings (default: 9).
        seconds: duration of each swing, s.
        seed: seed of the starts and encoder zeros (default: 0).
        yes: accept work of more than an hour or 4 GB (default: refused).

    Returns:
        The recording, for `identify` and `replay`.

    Raises:
        InputError: the model has no arms, or too much work.

    Examples:
        >>> dp.swings("lab", count=2).arms
        2
    """
    return _swings(_model(model), count, seconds, seed=seed, yes=yes)


def _swings(model: Model, count: int, seconds: float, *, seed: int, yes: bool) -> recording_files.Recording:
    """Return simulated swings from random angles (see `swings`), after announcing their cost."""
    announce(recording_files.swings_cost(count, seconds), yes=yes)
    name = f"{model.name}-swings-{seed}"
    return recording_files.random_swings(model.arms, swings=count, seconds=seconds, seed=seed, name=name)


@overload
def identify(
    recordings: recording_files.Recording | Place | Sequence[recording_files.Recording | Place] = (),
    *,
    model: Model | str = "lab",
    design: Literal[True],
    progress: Reporting = None,
) -> fits.Design: ...
@overload
def identify(
    recordings: recording_files.Recording | Place | Sequence[recording_files.Recording | Place] = (),
    *,
    model: Model | str = "lab",
    zeros: bool | None = None,
    design: Literal[False] = False,
    out: NewModel = None,
    force: bool = False,
    picture: Picture = None,
    progress: Reporting = None,
) -> identification.Identification: ...
@checked
def identify(
    recordings: recording_files.Recording | Place | Sequence[recording_files.Recording | Place] = (),
    *,
    model: Model | str = "lab",
    zeros: bool | None = None,
    design: bool = False,
    out: NewModel = None,
    force: bool = False,
    picture: Picture = None,
    progress: Reporting = None,
) -> identification.Identification | fits.Design:
    """Identify a model from recordings that `dpcontrol import` wrote.

    The model gets inertia ratios, friction laws and encoder zeros. Every third segment is held out, and the friction
    laws are chosen by the error on these segments. --design needs no recording.

    Args:
        recordings: recording, its log, or several.
        model: initial model, a name or a TOML file (default: lab).
        zeros: fit of the encoder zeros (default: if it predicts the held-out segments better).
        design: most informative swings for recording, instead of an identification.
        out: model to write (default: models/NAME.toml).
        force: replace an existing model, whatever made it.
        picture: picture of the identification (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Inertia ratios, friction laws and encoder zeros with standard errors; experiments by information with `design`.

    Raises:
        InputError: recordings contradict the model or are too short, none or, with `design`, some are given, or the
            file cannot be written.

    Examples:
        >>> dp.identify(dp.swings("lab", count=3, seconds=1.5), model="lab").friction_terms
        ('viscous',)
    """
    sources = [recordings] if isinstance(recordings, recording_files.Recording | str | Path) else [*recordings]
    if bool(sources) == design:
        mistake = (
            "design compares possible recordings: omit recordings"
            if design
            else "recordings = []: give at least one log"
        )
        raise InputError(mistake)
    model = _model(model)
    if design and picture is not None:
        raise InputError("picture shows an identification, and design makes none: omit picture")
    if design:
        return design_experiments(model, progress=progress)
    named_recordings = [*map(_recording, sources)]
    files, measured = (
        [Path(name).name for name, _ in named_recordings],
        [swing_recording for _, swing_recording in named_recordings],
    )
    target = Path("models") / f"{Path(files[0]).stem}.toml" if out is True else None if out is None else Path(out)
    if target is not None:
        models.check_model_replaced(target, logs=files, starting_model=model.name, force=force)
    zeros_choice = {None: "chosen", True: "free", False: "none"}[zeros]
    title = f"{model.title}, identified from {', '.join(swing_recording.name for swing_recording in measured)}"
    identified = identification.identify(
        measured, model.arms, settings=identification.IdentificationSettings(zeros=zeros_choice), progress=progress
    )
    for swing_recording in measured:
        if contradiction := recording_checks.contradiction(swing_recording, model.arms, model=model.name):
            remark(f"{swing_recording.name}: {contradiction}")
    if target is not None:
        models.write_model(identified, target, title=title, logs=files, starting_model=model.name)
    if picture is not None:
        _save(identification_pages.draw_identification(identified, title=title), picture)
    return replace(identified, file=target)


@checked
def open_log(file: Place) -> single_runs.Run:
    """Open the log of a run or of a bench.

    Args:
        file: log (.mcap).

    Returns:
        The run, which scores, draws and explains itself.

    Raises:
        InputError: the file is missing, damaged or not a log.

    Examples:
        >>> dp.open_log(log).score().completed
        True
    """
    return single_runs.Run(log_reader.read_log(file))


@checked
def open_plan(file: Place) -> plans.Plan:
    """Open the file of a plan.

    Args:
        file: plan (.npz), as `dpcontrol plan --out` writes it and every log contains it.

    Returns:
        The plan, which can run without planning.

    Raises:
        InputError: the file is missing, damaged or not a plan.

    Examples:
        >>> dp.open_plan(planned.file).status == planned.status
        True
    """
    return plans.load_plan(Path(file))


@checked
def open_reference(file: Place, *, picture: Picture = None, transitions: Picture = None) -> references.ReferenceFile:
    """Show a reference: motion, limits, effort, mesh, error and origin.

    FILE is a .npz from `dpcontrol plan --out`. numpy can read it; dpcontrol.references.reference documents its layout.
    The error between nodes is measured again.

    Args:
        file: reference (.npz).
        picture: picture of the reference to draw (default: none).
        transitions: picture of the transfers between equilibria, from rows to columns (default: none).

    Returns:
        The reference with its figures and the files drawn.

    Raises:
        InputError: the file is missing, damaged or not a reference, or has no transfers to draw.

    Examples:
        >>> dp.open_reference(planned.file).reference.converged
        True
    """
    if picture is not None and transitions is not None and Path(picture).resolve() == Path(transitions).resolve():
        raise InputError(f"picture and transitions are both {picture}: give two names")
    reference = references.load_reference(Path(file))
    if transitions is not None:
        # It can be refused, and must be before another picture is written.
        _save(films.draw_transitions(reference), transitions)
    if picture is not None:
        _save(render(log_views.reference_view(reference, Path(file))), picture)
    return references.ReferenceFile(Path(file), reference, None if transitions is None else Path(transitions))


@checked
def open_atlas(file: Place) -> walk_atlases.Atlas:
    """Open the file of an atlas.

    Args:
        file: atlas (.npz), as `dpcontrol atlas --out` writes it.

    Raises:
        InputError: the file is missing, damaged or not an atlas.

    Examples:
        >>> dp.open_atlas(atlas_file).energy
        -0.07
    """
    return replace(atlases.load_atlas(Path(file)), file=Path(file))


@checked
def open_planner(
    model: str = "lab", *, browser: bool = True, port: Annotated[int, Between(0, 65535)] = 0
) -> servers.Planner:
    """Plan in the browser, from an energy to a run.

    Choose an energy, click connections to build a walk, plan it, and run it. Itinerary, log and film are saved in
    ./itineraries and ./logs. The page works offline and only on this computer, because its address contains a token.
    It needs an extra: pip install 'dpcontrol[planner]'.

    Args:
        model: name or path of a model of two arms (default: lab).
        browser: open the page in the browser.
        port: port on 127.0.0.1; 0 selects a free one (default: 0).

    Returns:
        The planner, a context manager, which serves until it is closed.

    Raises:
        InputError: the model has no two arms, or the port is taken.
        PartMissing: the extra `planner` is not installed.

    Examples:
        >>> with dp.open_planner("lab", browser=False) as planner:
        ...     planner.address
        'http://127.0.0.1:...'
    """
    planner = servers.Planner(model, port=port)
    if browser and not planner.open():
        remark("no browser was found; open the address in one")
    return planner


@checked
def open_recording(
    file: Place, *, mapping: str | None = None, repairs: Sequence[str] = (), progress: Reporting = None
) -> recording_files.Recording:
    """Open a recording of a bench.

    Args:
        file: log, MATLAB, CSV, Parquet or MCAP file, or ROS bag.
        mapping: name or TOML file that describes the columns (default: chosen by the kind of file).
        repairs: allowed repairs among nan, time, gaps, wrap, spikes and sampling (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Angles (rad) by time (s), in segments.

    Raises:
        InputError: the file is missing or damaged, does not match the mapping, or needs a repair.

    Examples:
        >>> dp.open_recording(log).arms
        2
    """
    path = Path(file)
    if path.suffix.lower() == ".mcap" and mapping is None and not repairs:
        return recording_files.load_recording(path)
    return importing.import_recording(path, mapping, repairs=list(repairs), progress=progress)


@checked
def picture(
    result: single_runs.Run | plans.Plan | shadowing.ShadowingOrbit | walk_atlases.Atlas,
    *,
    transitions: bool = False,
    file: Place | None = None,
    film: Place | None = None,
) -> Figure:
    """Draw a result as a figure, with a film if requested.

    Args:
        result: run, plan, walk's orbit or atlas.
        transitions: draw each transfer of a plan separately.
        file: PNG or PDF to write (default: none).
        film: GIF, WebP or MP4 to write, in real time (default: none).

    Returns:
        A figure of matplotlib.

    Raises:
        InputError: a file cannot be written, or the result has no film or no transitions.

    Examples:
        >>> len(dp.picture(walk).axes) > 1
        True
    """
    if transitions and not isinstance(result, plans.Plan):
        raise InputError("transitions = True draws the transfers of a plan: give one")
    if transitions and isinstance(result, plans.Plan):
        figure = films.draw_transitions(result.reference)
    else:
        figure = render(result)
    if film is not None:
        films.write_film(report_pages.view_of(result), film)
    if file is not None:
        _save(figure, file)
    return figure


@checked
def schema(of: Literal["itinerary", "model"]) -> dict[str, Any]:
    """Return the JSON Schema of itinerary files or model files.

    Editors use it to complete and check files. Save it beside the files, and name it in their first line, such as
    #:schema itinerary.schema.json.

    Args:
        of: "itinerary" or "model".

    Returns:
        The schema, for editors and checks.

    Raises:
        InputError: another kind of file.

    Examples:
        >>> dp.schema("model")["title"]
        'Model of dpcontrol'
    """
    return schemas.schema(of)


@checked
def config() -> Configuration:
    """Show the defaults of the command line, and where each comes from.

    An option overrides the environment variable, which overrides the file, which overrides the default. The file is
    $XDG_CONFIG_HOME/dpcontrol/config.toml, such as: logs = "~/runs".

    Returns:
        Settings with value and source: an environment variable, the file, or the built-in default.

    Raises:
        InputError: the file has a mistake.

    Examples:
        >>> [one.source for one in dp.config() if one.name == "logs"]
        ['default']
    """
    return Configuration(config_file(), tuple(configured()))


@checked
def cache(*, clear: bool = False) -> CacheContents:
    """List the cached results: plans, atlases, machine code.

    Entries are cached by their input, including the program code, and checked when they are read. A damaged entry or
    one of another version is computed again. You can empty the cache at any time. Other files in its folder are kept.

    Args:
        clear: delete them; they can be computed again.

    Returns:
        Entries and bytes by kind.

    Raises:
        InputError: a file cannot be deleted.

    Examples:
        >>> entries, size = dp.cache().kinds["plans"]
        >>> entries > 0
        True
    """
    return cache_contents(clear=clear)


@checked
def equilibria(model: Model | System | str) -> dict[str, lyapunov.Equilibrium]:
    """Return a model's equilibria by name, with energies and eigenvalues.

    Args:
        model: model or system.

    Returns:
        Equilibria by name; energies in J, eigenvalues in 1/s, each with pivot and cart at rest.

    Examples:
        >>> [name for name, one in dp.equilibria(lab).items() if one.kind == "index-1 saddle"]
        ['down-up', 'up-down']
    """
    return lyapunov.equilibria(_system(model))


@checked
def family(
    model: Model | System | str,
    saddle: str,
    *,
    energies: tuple[float, float],
    family: Index = 0,
    progress: Reporting = None,
) -> families.LyapunovFamily:
    """Follow a family of Lyapunov orbits between two energies.

    Args:
        model: model or system.
        saddle: saddle that the orbits surround, such as "down-up".
        energies: lowest and highest energy, J.
        family: which of the saddle's families, slowest first (default: 0).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The members in order of energy, and the reason for each end.

    Raises:
        InputError: an unknown saddle or family, or no member within the energies.

    Examples:
        >>> found = dp.family(lab, "down-up", energies=(-0.08, -0.07))
        >>> found.converged, len(found.members) > 1
        (True, True)
    """
    return families.lyapunov_family(_system(model), saddle, energies=energies, family=family, progress=progress)


@checked
def rotating_orbits(
    model: Model | System | str, arm: Literal["inner", "outer"], *, energy: float
) -> tuple[rotations.RotatingOrbit, ...]:
    """Find the symmetric orbits that turn one arm over.

    Args:
        model: model or system of two arms.
        arm: arm that turns, counter-clockwise.
        energy: energy, J.

    Returns:
        Orbits, slowest first. Each has a reflection that turns backward.

    Raises:
        InputError: the system has no two arms.

    Examples:
        >>> len(dp.rotating_orbits(lab, "outer", energy=0.3))
        5
    """
    return rotations.rotating_orbits(_system(model), _ARMS[arm], energy)


@checked
def rotating_families(
    model: Model | System | str,
    arm: Literal["inner", "outer"],
    *,
    energies: tuple[float, float],
    progress: Reporting = None,
) -> tuple[rotations.RotatingFamily, ...]:
    """Follow the families of orbits that turn one arm over.

    Args:
        model: model or system of two arms.
        arm: arm that turns, counter-clockwise.
        energies: lowest and highest energy, J; families start from the orbits at their mean.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Families with folds and changes of stability; empty if there is no orbit at the mean energy.

    Raises:
        InputError: the system has no two arms.

    Examples:
        >>> families = dp.rotating_families(lab, "outer", energies=(0.29, 0.31))
        >>> all(one.converged for one in families)
        True
    """
    orbits = rotating_orbits(model, arm, energy=sum(energies) / 2)
    return rotations.rotating_families(orbits, energies, progress=progress)


@checked
def sustained_orbit(
    orbit: lyapunov.LyapunovOrbit, *, limits: Limits | None = None, progress: Reporting = None
) -> sustained_orbits.SustainedOrbit:
    """Return the periodic orbit that the cart sustains against friction.

    Args:
        orbit: Lyapunov orbit of a model of arms; the result has its energy at phase 0.
        limits: limits of the cart (default: those of itineraries).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The orbit with the least effort; use it only if it `converged`.

    Raises:
        InputError: the orbit's system has no arms.
        GoalMissed: the Lyapunov orbit did not converge.

    Examples:
        >>> dp.sustained_orbit(orbit).converged
        True
    """
    _found(orbit.converged, f"the orbit about {orbit.saddle}", orbit.status)
    return sustained_orbits.sustained_orbit(orbit, models.model_of(orbit.system).arms, limits=limits, progress=progress)


@checked
def refine(
    found: tubes.Connection | shadowing.ShadowingOrbit, *, energy: Decimal | Fraction | float | None = None
) -> extended.ExtendedOrbit:
    """Refine a connection or a walk's orbit in 113-bit arithmetic.

    Args:
        found: connection, or orbit of a walk.
        energy: exact energy, J (default: the shortest decimal that reads as the orbit's).

    Returns:
        The orbit with decimal digits beyond double precision; use it only if it `converged`.

    Raises:
        GoalMissed: a periodic orbit cannot be refined, or the machine has no 113-bit floating-point type.

    Examples:
        >>> float(dp.refine(found.connections[0]).residual) < 1e-25
        True
    """
    source = found.source if isinstance(found, tubes.Connection) else found.connections[0].source
    solution = found.solution if isinstance(found, tubes.Connection) else found.shot.solution
    height = _exact(source.energy if energy is None else energy)
    return extended.refine(solution, energy=height, parameters=_exact_parameters(source.system))


@checked
def find_walks(
    model: Model | System | str,
    *,
    energy: Decimal | float,
    hits: tuple[Hit, Hit] = (1, 1),
    symbols: Sequence[str] = (),
    through: Sequence[str] = (),
    length: Annotated[int, Between(1, 10_000)] | None = None,
    source: str | None = None,
    target: str | None = None,
    random: Count | None = None,
    lengths: tuple[Count, Count] = (1, 8),
    seed: Seed = 0,
    periodic: bool = False,
    compare: float | None = None,
    wraps: Sequence[Index] | None = None,
    extra_wraps: tuple[Index, Index] = (0, 0),
    lead_in: Index = 2,
    lead_out: Index = 2,
    solve: bool = False,
    precision: Literal["double", "extended"] = "double",
    out: Annotated[Path | str | None, Output(folder=True)] = None,
    picture: Picture = None,
    film: Film = None,
    yes: bool = False,
    progress: Reporting = None,
) -> graphs.Edges | walk_lists.WalkList | walk_lists.SolvedWalks | following.SymbolChanges:
    """List, count and create walks on the connection graph.

    `solve` computes the orbit that follows each walk, with an estimate of its error. The orbit is homoclinic,
    heteroclinic, or with `periodic` periodic. Give one walk by its symbols (-s) or its stops (`through`). `length`
    lists all walks of a length, and `random` draws some. Without these options, the graph itself is shown.

    A symbol selects the connection at the largest angle. At other energies this can be another connection; `compare`
    reports the energies of such changes.

    A symbol is "down-up +", "down-up > up-down", any connection's name that `dpcontrol connect` lists, or a
    composite edge ("(down-up +)·1·(down-up -)": symbols, and the wraps between them). It can also lead to or from a
    rotating orbit: "down-up > outer-rotating" (also inner-rotating, outer-rotating-back, outer-rotating-2: faster ones
    first). There, a wrap is a turn.

    Args:
        model: model, its name, or a system.
        energy: energy, J, zero at the pivot's height; three bodies: own units.
        hits: last section crossings of the connections, of the unstable and the stable tube (default: 1).
        symbols: symbol of one walk, in order, as in an itinerary, or to and from rotating orbits (default: none).
        through: stop of the shortest walk through all given stops (default: none).
        length: number of symbols of the listed walks, up to 10,000 (default: none).
        source: with a length: first saddle of the walks (default: any).
        target: with a length: last saddle of the walks (default: any).
        random: number of random walks (default: none).
        lengths: least and greatest number of symbols of a random walk (default: 1 and 8).
        seed: seed of the random walks (default: 0).
        periodic: closed walks: periodic orbits, with one more stop.
        compare: other energy, J; energies at which symbols select other connections are reported (default: none).
        wraps: wraps at the stops of one walk, such as 2,3 (default: the fewest that work).
        extra_wraps: range of additional wraps at each stop, random for random walks (default: 0 and 0).
        lead_in: wraps before the first symbol (default: 2).
        lead_out: wraps after the last symbol (default: 2).
        solve: orbit of each walk.
        precision: precision of the orbits; extended refines up to 4 in 113-bit arithmetic, in seconds per symbol
            (default: double).
        out: folder for the orbits, .npz (default: none).
        picture: picture of the orbit of one walk, .png, .pdf or .svg (default: none).
        film: film of the orbit of one walk, in real time, .gif, .webp or .mp4 (default: none).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The graph, the walks, their orbits, or the changes of the symbols.

    Raises:
        InputError: no such walk at this energy, arguments that exclude each other, or too much work.
        GoalMissed: an orbit cannot be refined.

    Examples:
        >>> dp.find_walks("lab", energy=-0.07, symbols=["down-up +"], solve=True).converged
        True
    """
    lead_wraps = (lead_in, lead_out)
    selection = walk_lists.WalkSelection(
        symbols, through, length, source, target, random, lengths, seed, periodic, wraps, extra_wraps, lead_wraps
    )
    selection.check(solve=solve, yes=yes)
    exact_energy = _exact(energy) if precision == "extended" else None
    options_of_orbits = {"out": out, "picture": picture, "film": film, "precision": exact_energy}
    if not solve and (names := [name for name, value in options_of_orbits.items() if value is not None]):
        raise InputError(f"{names[0]} concerns the orbits of walks: add --solve (solve=True in Python)")
    if solve and not selection.selected_by:
        raise InputError("solve needs walks: give symbols, through, length or random")
    if compare is not None and (solve or not (symbols or through)):
        raise InputError("compare follows the symbols of one walk: give symbols or through, and omit solve")
    system = _system(model)
    parsed_symbols = selection.parsed(system)
    if compare is not None:
        return _changes(system, parsed_symbols, (float(energy), compare), progress)
    hits_to_search = {
        (source_hit, target_hit) for source_hit in range(1, hits[0] + 1) for target_hit in range(1, hits[1] + 1)
    }
    search = part_of(progress, 0.0, 0.3 if solve else 1.0)
    edges = graphs.find_edges(
        system, float(energy), hits=hits_to_search, symbols=parsed_symbols, yes=yes, progress=search
    )
    if not selection.selected_by:
        return edges
    walks = walk_lists.WalkList(edges, selection.requests(edges, solve=solve, yes=yes))
    return _solved(walks, out, (picture, film), exact_energy, part_of(progress, 0.3, 1.0)) if solve else walks


@checked
def count_walks(graph: graphs.Edges, length: Count, *, source: str | None = None, target: str | None = None) -> int:
    """Return the number of walks with some number of symbols.

    Args:
        graph: connection graph.
        length: symbols of a walk, at least 1.
        source: saddle at which walks begin (default: any).
        target: saddle at which walks end (default: any).

    Returns:
        The exact count, a whole number of any size.

    Raises:
        InputError: a length below 1, or a saddle without an orbit.

    Examples:
        >>> dp.count_walks(dp.graph(lab, energy=-0.07), 3)
        512
    """
    return walk_lists.count_walks(graph, length, source=source, target=target)


@checked
def list_walks(
    graph: graphs.Edges,
    length: Count,
    *,
    source: str | None = None,
    target: str | None = None,
    periodic: bool = False,
) -> tuple[tuple[str, ...], ...]:
    """List all walks with some number of symbols.

    Args:
        graph: connection graph.
        length: symbols of a walk, at least 1.
        source: saddle at which walks begin (default: any).
        target: saddle at which walks end (default: any).
        periodic: only walks that close (default: all).

    Returns:
        Walks as names of connections, each of which `shadow` accepts.

    Raises:
        InputError: a length below 1, a saddle without an orbit, or more than 100,000 walks.

    Examples:
        >>> len(dp.list_walks(dp.graph(lab, energy=-0.07), 2))
        64
    """
    chains = walk_lists.listed(graph, length, source=source, target=target, periodic=periodic)
    return tuple(tuple(connection.name for connection in chain) for chain in chains)


@checked
def random_walks(
    graph: graphs.Edges,
    count: Count,
    *,
    lengths: tuple[Count, Count] = (1, 8),
    extra_wraps: tuple[Index, Index] = (0, 0),
    periodic: bool = False,
    seed: Seed = 0,
) -> tuple[walk_lists.WalkRequest, ...]:
    """Draw walks, each of one length with equal probability.

    Args:
        graph: connection graph.
        count: number of walks.
        lengths: fewest and most symbols of a walk (default: 1 and 8).
        extra_wraps: range of wraps beyond the fewest that suffice at each stop (default: none).
        periodic: only walks that close (default: any).
        seed: seed of the random numbers (default: 0).

    Returns:
        Walks that `shadow` accepts.

    Raises:
        InputError: a range that is not ascending, or no such walk.

    Examples:
        >>> graph = dp.graph(lab, energy=-0.07)
        >>> [len(walk.chain) for walk in dp.random_walks(graph, 3, lengths=(2, 2))]
        [2, 2, 2]
    """
    wraps = max(extra_wraps) * max(lengths)
    announce(
        walk_lists.walks_cost(count, symbols=max(lengths), wraps=wraps, solve=False, key=f"count = {count}"), yes=False
    )
    return tuple(
        walk_lists.drawn_requests(
            graph, count, lengths=lengths, extra=extra_wraps, seed=seed, periodic=periodic, leads=(2, 2)
        )
    )


@checked
def shortest_walk(graph: graphs.Edges, stops: Sequence[str]) -> tuple[str, ...]:
    """Return the shortest walk that visits saddles in order.

    Args:
        graph: connection graph.
        stops: saddles, at least two; a repeated one gives a homoclinic connection.

    Returns:
        The walk as names of connections, which `shadow` accepts.

    Raises:
        InputError: fewer than two stops, an unknown saddle, or no walk between them.

    Examples:
        >>> len(dp.shortest_walk(dp.graph(lab, energy=-0.07), ["down-up", "down-up"]))
        1
    """
    return tuple(connection.name for connection in walk_lists.through(stops, graph))


@checked
def symbol_changes(
    model: Model | System | str, symbols: Sequence[str], *, energies: tuple[float, float], progress: Reporting = None
) -> tuple[following.SymbolChange, ...]:
    """Find the energies at which symbols select other connections.

    Args:
        model: model or system.
        symbols: symbols of a walk, such as "down-up +".
        energies: first and last energy, J.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Changes in order of energy, each with the names before and after.

    Raises:
        InputError: a symbol cannot be followed in energy, or both energies are equal.

    Examples:
        >>> dp.symbol_changes(lab, ["down-up +"], energies=(-0.07, -0.069))
        ()
    """
    system = _system(model)
    return following.symbol_changes(
        system, walk_symbols.parse_walk(symbols, walk_lists.vertex_names(system)), energies, progress=progress
    )


@checked
def check_proof(file: Place, *, progress: Reporting = None) -> proof_checks.CertificateCheck:
    """Check the certificate of a proof by independent code.

    Args:
        file: certificate, as `dpcontrol prove --out` writes it.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The verdict: the proved statement, or the step that fails.

    Raises:
        InputError: the file is missing or unreadable.
        PartMissing: the extra `proof` is not installed.

    Examples:
        >>> dp.check_proof(certificate_file).proved
        True
    """
    part("flint")
    return proof_checks.check_file(Path(file), progress)


@checked
def explore_energies(
    itinerary: plans.Plan | str, *, picture: Place | None = None, progress: Reporting = None
) -> chart.ChartPage:
    """Compare the effort of one walk over energies.

    Args:
        itinerary: plan, or name or path of an itinerary, with a single walk.
        picture: PNG to draw (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The chart; `chosen` compares the itinerary's energy with the best one.

    Raises:
        InputError: the itinerary has several parts, or the picture cannot be written.
        GoalMissed: the itinerary's energy cannot be planned, or no run completes.

    Examples:
        >>> dp.explore_energies("outer-turn").name  # doctest: +SKIP
        'outer-turn-energies'
    """
    chart = energy_charts.energies_chart(_loaded(itinerary), progress)
    if picture is not None:
        _save(drawing.figure(chart, chart.parts), picture)
        chart = replace(chart, file=Path(picture))
    return chart


@checked
def rig_link(
    address: str = "udp", *, key_file: Place | None = None, insecure: bool = False, real_time: bool = False
) -> single_runs.RigLink:
    """Return the link to a bench, for runs on it.

    Args:
        address: udp://HOST:PORT, serial://PORT?baud=RATE (1,000,000 by default), or by default "udp" for an example
            bench in another process.
        key_file: file with the key that bench and loop share (default: the environment's DPCONTROL_RIG_KEY).
        insecure: accept a bench on another computer without a key (default: not).
        real_time: request priority over all ordinary work (default: not).

    Raises:
        InputError: the address is malformed, or the key is unreadable.

    Examples:
        >>> dp.rig_link("udp://127.0.0.1:47000").address
        'udp://127.0.0.1:47000'
    """
    key = None if key_file is None else Path(key_file)
    return single_runs.rig_link(address, key_file=key, insecure=insecure, real_time=real_time)


@checked
def start_bench(
    itinerary: str,
    *,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    hanging: bool = False,
    faults: Sequence[str] = (),
    host: str = "127.0.0.1",
    port: Annotated[int, Between(0, 65535)] = 0,
    runs: Index = 0,
    watchdog: Positive = 0.1,
    real_time: bool = False,
    key_file: Place | None = None,
    insecure: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> bench_server.UdpBench:
    """Start an example bench for runs over UDP in real time.

    The bench simulates the arms and cart of the itinerary. It serves one run after another at its address, for
    `dpcontrol run ITINERARY --rig ADDRESS`. The arms start at the beginning of the itinerary. `dpcontrol guide packets`
    describes the packets. If other computers can reach the host, loops need the key of the bench.

    Args:
        itinerary: name or path of the itinerary whose arms and cart are simulated.
        seed: seed of all random numbers on the bench (default: 0).
        settings: settings of the bench by path, which override the itinerary's (see `closed_loop`).
        hanging: hanging arms at the start, without a plan, as for `commission`.
        faults: wiring mistake for practice: drive-reversed, cart-reversed, encoder-1-reversed, encoder-2-reversed,
            encoders-swapped, angles-not-summed, encoder-1-factor-4, zeros-off, switch-dead, switches-swapped
            (default: none).
        host: address of this computer for connections (default: 127.0.0.1).
        port: port, 0 for a free one (default: 0).
        runs: number of runs to serve, 0 for no limit (default: 0).
        watchdog: silence of the loop until the cart is stopped, s (default: 0.1).
        real_time: priority over all ordinary processes.
        key_file: file with the shared key of bench and loop (default: the environment's DPCONTROL_RIG_KEY).
        insecure: no key, so that anyone with access to the host can drive the cart.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The bench, a context manager; `url` is its address, and `serve(runs=1)` serves a run.

    Raises:
        InputError: an unknown fault, the port is taken, or other computers can reach it without a key.

    Examples:
        >>> with dp.start_bench("outer-turn", hanging=True) as bench:
        ...     bench.url
        'udp://127.0.0.1:...'
    """
    loaded = _loaded(itinerary).with_run(_settings(settings), seed=seed)
    server = bench_server.BenchServerSettings(watchdog=watchdog, real_time=real_time, runs=runs)
    address = example_benches.BenchAddress(host, port, None if key_file is None else Path(key_file), insecure, server)
    return example_benches.example_bench(
        loaded, address, hanging=hanging, faults=faults, notify=remark, yes=yes, progress=progress
    )


@checked
def commission(
    itinerary: plans.Plan | str,
    *,
    rig: Rig | single_runs.RigLink | str | None = None,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    faults: Sequence[str] = (),
    switches: NotNegative = 0.0,
    real_time: bool = False,
    key_file: Place | None = None,
    insecure: bool = False,
    write: bool = False,
    progress: Reporting = None,
) -> commissioning.Commissioning:
    """Measure a rig before its first run: signs, delay, lag, zeros.

    The arms must hang, and the cart must stand at the centre. The cart moves a few millimetres, then follows a chirp
    within 10 mm. The motion of cart and arms gives signs, order, counts and zeros of the encoders, and direction and
    gain of the drive. Ctrl-C brakes the cart. It is missed (exit code 1) if a finding is wrong. Settings and faults
    apply to the example bench. For more, see `dpcontrol guide commission`.

    Args:
        itinerary: plan, or name or path of an itinerary.
        rig: rig at udp://HOST:PORT or serial://PORT, FILE.py:CLASS or an object with `read()`,
            `command(acceleration)` and `stop()`, or udp for the example bench in a separate process (default: the
            example bench in simulated time).
        seed: seed of all random numbers on the example bench (default: 0).
        settings: settings of the example bench by path, which override the itinerary's (see `closed_loop`).
        faults: wiring mistake of the example bench for practice, see `start_bench` (default: none).
        switches: distance of the search for limit switches to either side, m, short of the hard stops (default: 0, no
            search).
        real_time: priority over all ordinary processes.
        key_file: file with the shared key of bench and loop (default: the environment's DPCONTROL_RIG_KEY).
        insecure: no key for a bench on another computer.
        write: update of [run] in the itinerary with the measured delay, lag, zeros and counts.
        progress: called with each step.

    Returns:
        Findings with remedies, and measured values as `changes`.

    Raises:
        InputError: the rig lacks a method, no bench answers, it needs a key or has other arms, or the file cannot be
            written.

    Examples:
        >>> dp.commission("outer-turn", faults=["encoder-2-reversed"]).wrong[0].step
        'encoders'
    """
    loaded, run_settings = _loaded(itinerary), _settings(settings)
    bench = loops.bench_of(_linked(rig, key_file=key_file, insecure=insecure, real_time=real_time))
    if getattr(bench, "address", bench) not in (None, single_runs.OWN_BENCH) and (faults or run_settings):
        raise InputError(f"rig = {rig}: faults and settings are those of the example bench; omit them")
    if write:
        # A file that cannot be changed is reported before the cart moves.
        single_runs.measured_text(loaded, {"delay": 1.0, "lag": 0.0, "zeros": [0.0], "counts": 1})
    on_example = loaded.with_run(run_settings, seed=seed)
    findings = single_runs.commission_rig(
        loaded, bench, practice=on_example, faults=faults, switches=switches, notify=lambda text: progress(text, 0.0)
    )
    findings = replace(findings, itinerary=loaded.name, bench="" if bench is None else bench.name)
    return single_runs.written(findings, loaded) if write else findings


@checked
def repeat(log: Place, out: Place, *, force: bool = False, progress: Reporting = None) -> single_runs.Repeat:
    """Repeat a run from its log, and compare all messages.

    Args:
        log: log of a simulated run.
        out: log to write.
        force: replace the log of another run there.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Score of the repetition, and the comparison of its messages.

    Raises:
        InputError: the log is damaged, is of a rig, or is the same file as `out`.
        GoalMissed: no controller exists for its reference.

    Examples:
        >>> dp.repeat(log, log.with_name("again.mcap")).comparison.difference is None
        True
    """
    return single_runs.repeat_run(Path(log), Path(out), force=force, progress=progress)


@checked
def open_night(folder: Place) -> night_logs.Night:
    """Open the folder of a long run.

    Args:
        folder: folder that `ClosedLoop.night` or `dpcontrol run --hours` wrote.

    Returns:
        Uptime, falls and their causes, repetitions and drifts.

    Raises:
        InputError: the folder has no long run, or a file is damaged.

    Examples:
        >>> len(dp.open_night(night_folder).falls)
        0
    """
    return night_logs.read_night(Path(folder))


@checked
def open_campaign(file: Place) -> campaign_tables.CampaignSummary:
    """Open the table of a campaign.

    Args:
        file: Parquet table that `campaign` wrote.

    Returns:
        Shares of completed runs by group with 95 % intervals, and reasons of failure.

    Raises:
        InputError: the file is missing, or is not a campaign's table.

    Examples:
        >>> dp.open_campaign(campaign_file).runs
        4
    """
    return campaign_tables.campaign_summary(Path(file))


@checked
def compare_logs(logs: Sequence[Place], *, align: Count = 1) -> comparison.RunComparison:
    """Align several logged runs at one symbol.

    Args:
        logs: logs of pendulums with the same number of arms.
        align: number of the symbol at whose crossing the runs are aligned (default: 1).

    Returns:
        The runs on one clock, with a picture of them all.

    Raises:
        InputError: a log is missing or damaged, the arms differ, or no run has this symbol.

    Examples:
        >>> len(dp.compare_logs([log, log]).runs)
        2
    """
    return comparison.compare([log_views.run_view(log_reader.read_log(Path(log))) for log in logs], symbol=align)


@checked
def score(
    logs: Place | Sequence[Place], *, why: bool = False, yes: bool = False, progress: Reporting = None
) -> scoring.Scores:
    """Score logged runs: symbols, wraps, limits, tracking, consistency of the estimator.

    For the folder of a long run, the score has uptime, falls with causes, times to return, repetitions, and drift of
    the estimates. With --why, it prints the options of `dpcontrol run` (more travel, half the lag, another law …) that
    complete a failed run more often than harmless changes. It works for simulated runs only. With --json, one log gives
    one object, several give {"runs": [...]}. The exit code is 1 if a run is not completed, or if its log covers only a
    part of it. On a rig, it is 1 if by the estimate a symbol was not done.

    Args:
        logs: log, several logs, or folders of long runs.
        why: options that complete each failed run, found by simulation.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The scores in order; `missed` says which run is not known to be completed.

    Raises:
        InputError: a log is missing, damaged or has no plan, or folders are mixed with logs or with `why`.

    Examples:
        >>> dp.score(log).results[0].completed
        True
    """
    paths = [Path(logs)] if isinstance(logs, str | Path) else [*map(Path, logs)]
    nights = [path for path in paths if path.is_dir() and not is_bag_folder(path)]
    if not nights:
        runs = [open_log(path) for path in paths]
        scores = tuple(run.score() for run in runs)
        return scoring.Scores(scores, tuple(run.why(yes=yes, progress=progress) for run in runs) if why else ())
    if why or len(nights) < len(paths):
        other_log = next((path for path in paths if path not in nights), None)
        conflict = "why tries single runs" if other_log is None else f"{other_log} is a single log"
        raise InputError(f"{nights[0]} is the folder of a long run, and {conflict}; score the folder alone")
    return scoring.Scores(tuple(map(night_logs.read_night, nights)))


@checked
def review(
    files: Place | Sequence[Place],
    *,
    align: Count = 1,
    save: Annotated[Path | str | None, Output((".rrd",))] = None,
    picture: Picture = None,
    film: Film = None,
    stretch: tuple[float, float] | None = None,
    yes: bool = False,
    progress: Reporting = None,
) -> viewer.Review:
    """Open a log in the Rerun viewer.

    It shows the arms with the reference as a ghost, the planned and the actual itinerary, angles, rates, command,
    errors, energy, and phase planes with the tubes. Recordings from the bench open too. Several logs open side by side,
    delayed so that all cross the section of symbol N at the same time. An atlas (.npz) opens as tubes, orbits and
    flights in space. A reference (.npz) opens as motion, command and limits.

    With --save, --picture or --film, no viewer opens. A film shows the arms on their cart, the reference, the path of
    the tip and the itinerary.

    Args:
        files: a log, an atlas, a reference, or several logs.
        align: symbol at which several logs are aligned, counted from 1 (default: 1).
        save: Rerun recording to write, .rrd (default: none).
        picture: picture to draw (default: none).
        film: film of the arms in real time; .mp4 needs pip install 'dpcontrol[film]' (default: none).
        stretch: begin and end of the filmed part of the log, s (default: all).
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The files: the recording, which may be that of the viewer, picture and film.

    Raises:
        InputError: a file is missing or damaged, there is no display, or a stretch without a film.
        PartMissing: the extra `viewer` is not installed.

    Examples:
        >>> dp.review(log, save=log.with_suffix(".rrd")).recording.name
        'turn.rrd'
    """
    if stretch is not None and film is None:
        raise InputError("stretch is given without film: give the film too")
    paths = [Path(files)] if isinstance(files, str | Path) else [*map(Path, files)]
    progress("reading", 0.05)
    content = viewer.opened(paths, symbol=align)
    recording = None if save is None else Path(save)
    progress("recording", 0.2)
    if recording is not None:
        renderers.record(content, recording)
    elif picture is None and film is None:
        recording = viewer.view_in_window(content, paths[0].stem)
    if film is not None:
        films.write_film(content, film, stretch=stretch, yes=yes, progress=progress)
    if picture is not None:
        progress("picture", 0.5)
        _save(render(content), picture)
    aligned = getattr(content, "status", None) if len(paths) > 1 else None
    return viewer.Review(tuple(paths), recording, None if film is None else Path(film), aligned)


@checked
def report(file: Place, *, page: Picture = None, margins: bool = False) -> report_pages.Report:
    """Write one page on a log, a long run or a campaign.

    matplotlib draws it.

    The page of a log has the planned and the actual itinerary, a film strip, angles, rates, cart, command, errors,
    energy and phase planes. It also compares the further estimates with the truth, if that is in the log. The page of a
    long run has strips of half an hour with the times on the itinerary and the causes of interruptions. It also has
    times to return, and drift. The page of a campaign has success rates by group with Wilson's intervals, and failures
    by symbol and reason.

    Args:
        file: log, folder of a long run, or table of a campaign (.parquet).
        page: page to write (default: NAME-report.png beside the file).
        margins: limits of gain, delay and lag along the reference of a log, in some seconds.

    Returns:
        The score or the summary, and the page.

    Raises:
        InputError: the file is missing or damaged, the page cannot be written, or margins of more than one log.

    Examples:
        >>> dp.report(log, page=log.with_name("page.png")).page.name
        'page.png'
    """
    source = Path(file)
    # A folder may be named by "." alone.
    target = Path(page or source.parent / f"{source.stem or source.resolve().name}-report.png")
    of_campaign = source.suffix.lower() == ".parquet"
    of_night = not of_campaign and source.is_dir() and not is_bag_folder(source)
    if margins and (of_night or of_campaign):
        remedy = "a log of the folder" if of_night else "a log, or use plan --margins"
        raise InputError(f"{file}: margins apply to one log; give {remedy}")
    if of_night or of_campaign:
        judged = night_logs.read_night(source) if of_night else campaign_tables.campaign_summary(source)
        _save(render(judged), target)
        return report_pages.Report(judged, target)
    run = open_log(source)
    margins_of_run = run.margins() if margins else None
    view = log_views.run_view(run.log)
    _save(render(view), target)
    return report_pages.Report(
        scoring.Unscored(str(source), view.verdict) if scoring.lacking(run.log) else run.score(), target, margins_of_run
    )


@checked
def log_summary(file: Place) -> log_reader.RunLog:
    """Show a log's topics, types, rates, duration, metadata and attachments.

    Topics also have units and counts.

    All checksums are verified. A truncated or damaged log is rejected, and the message suggests a remedy.

    Args:
        file: log.

    Returns:
        The log, with its topics, metadata and attachments.

    Raises:
        InputError: the file is missing, cut, damaged or not a log.

    Examples:
        >>> dp.log_summary(log).joint_names
        ('arm_1', 'arm_2', 'cart')
    """
    return log_reader.read_log(Path(file))


@checked
def recover_log(
    file: Place,
    out: Annotated[Path | str | None, Output((".mcap",))] = None,
    *,
    force: bool = False,
    progress: Reporting = None,
) -> log_recovery.Recovery:
    """Rebuild a truncated or damaged log, and report the losses.

    The log can also be that of a killed run.

    Intact records are copied bit for bit, sorted and verified. The old file is kept.

    Args:
        file: damaged log, which is kept.
        out: log to write (default: NAME.mcap for NAME.mcap.partial if it does not exist, else NAME-recovered.mcap).
        force: replace an existing log, whatever made it.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Recovered ticks, and a sentence on the losses.

    Raises:
        InputError: the file holds nothing that can be recovered, or the new log cannot be written.

    Examples:
        >>> dp.recover_log(log).lost
        ''
    """
    return log_recovery.recover(Path(file), None if out is None else Path(out), force=force, progress=progress)


@checked
def import_recording(
    file: Place | None = None,
    *,
    mapping: str | None = None,
    model: Model | str | None = None,
    repairs: Sequence[str] = (),
    simulated: Model | str | None = None,
    swings: Count = 9,
    seconds: Positive = 2.667,
    seed: Seed = 0,
    out: NewLog = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> recording_files.ImportedRecording:
    """Import a recording of the bench as a log.

    It reads MATLAB, CSV, Parquet, MCAP and ROS bags. Gaps, repeated times, missing numbers, wrapped angles and
    contradicting columns are rejected with their row. --repair selects the faults to correct, and the log records the
    corrections. Segments count from 0, rows from 1. Unusual but possible data cause a remark: a constant angle, and
    with --model a recording that its arms cannot have made. --simulated gives data with known truth for `identify` and
    `replay`.

    Args:
        file: recording of the bench.
        mapping: mapping of the columns, a name or a TOML file (default: by contents for .mat, joint-states for bags and
            .mcap, otherwise table).
        model: model of the arms, for remarks on contradictions (default: none).
        repairs: faults to correct, with commas: nan,time,gaps,wrap,spikes,sampling (default: none).
        simulated: model whose free swings replace the file, as encoders measure them (default: none).
        swings: number of simulated swings (default: 9).
        seconds: duration of each simulated swing, s (default: 2.667).
        seed: seed of the simulated initial states and encoder zeros (default: 0).
        out: log to write (default: logs/NAME.mcap).
        force: replace an existing log, whatever made it.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        The recording with its log, and remarks on it.

    Raises:
        InputError: file and simulated model are both given or both missing, or the file is missing or damaged, does
            not match the mapping, or needs a repair.

    Examples:
        >>> dp.import_recording(simulated="lab", swings=2, out=log.with_name("two.mcap")).recording.arms
        2
    """
    if (file is None) == (simulated is None):
        state = "missing" if file is None else "given"
        raise InputError(f"file and simulated are both {state}: give a file, or the model of simulated swings")
    expected_model = None if model is None else _model(model)
    if simulated is None:
        recording = importing.import_recording(Path(str(file)), mapping, repairs=list(repairs), progress=progress)
    else:
        recording = _swings(_model(simulated), swings, seconds, seed=seed, yes=yes)
    progress("writing", 0.7)
    log = _new_log(
        out, f"{recording.name}.mcap", lambda place: recording_files.write_recording(recording, place, force=force)
    )
    contradiction = (
        ""
        if expected_model is None
        else recording_checks.contradiction(recording, expected_model.arms, model=expected_model.name)
    )
    remarks, source = (
        (*recording_checks.constant_angles(recording), *filter(None, [contradiction])),
        str(file or recording.source),
    )
    for sentence in remarks:
        remark(f"{source}: {sentence}")
    return recording_files.ImportedRecording(recording, source, log, remarks)


@checked
def write_recording(recording: recording_files.Recording, file: Place, *, force: bool = False) -> Path:
    """Write a recording as a log.

    Args:
        recording: recording of a bench, or simulated swings.
        file: log to write (.mcap).
        force: replace any log there (default: only one with the same origin).

    Returns:
        The log.

    Raises:
        InputError: another log is there, or the file cannot be written.

    Examples:
        >>> dp.write_recording(dp.swings(lab, count=1), log.with_name("swings.mcap")).name
        'swings.mcap'
    """
    return recording_files.write_recording(recording, Path(file), force=force)


@checked
def design_experiments(model: Model | str, *, progress: Reporting = None) -> fits.Design:
    """Compare swings by their information on the model's parameters.

    Args:
        model: model of arms.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Experiments by information, and the best pair.

    Raises:
        InputError: the model has no arms, or no experiment is usable.

    Examples:
        >>> len(dp.design_experiments(lab).best_pair())
        2
    """
    return fits.design_experiments(_model(model).arms, progress=progress)


@checked
def replay(
    recording: recording_files.Recording | Place,
    *,
    model: Model | str = "lab",
    ahead: int = 100,
    span: float | None = None,
    estimator: Literal["ekf", "ukf"] = "ekf",
    counts: int = 40_000,
    mean_over: float | None = None,
    model_error: NotNegative = 0.003,
    out: NewLog = None,
    force: bool = False,
    progress: Reporting = None,
) -> replays.Replay:
    """Predict a recording by a model, and run an estimator.

    The log contains the prediction, the estimates and the measurements. Each segment is predicted in one piece from its
    best initial state. The prediction is the reference of the log, so `dpcontrol review` shows both. If the cart moved,
    as in a log of `dpcontrol run`, its command or its recorded motion is the input of the model. The encoder zeros of
    the model file are subtracted.

    Args:
        recording: recording of a bench, or its log.
        model: model for the prediction, a name or a path (default: lab).
        ahead: number of samples of the n-step prediction error (default: 100).
        span: longest prediction in one piece, s (default: 5, or 0.5 if the cart moved).
        estimator: kind of estimator (default: ekf).
        counts: encoder counts per turn, for the assumed noise of the estimator (default: 40000).
        mean_over: duration of the estimator's means, s (default: 0.015, or 0 if the cart moved).
        model_error: assumed relative error of the accelerations (default: 0.003).
        out: log to write (default: logs/NAME-replay.mcap).
        force: replace an existing log, whatever made it.
        progress: reports, see `dpcontrol.api`.

    Returns:
        Prediction, estimate and their errors.

    Raises:
        InputError: the recording does not fit the model, an impossible setting, or the log cannot be written.

    Examples:
        >>> len(dp.replay(dp.swings(lab, count=2), model=lab).fits)
        2
    """
    settings = replays.ReplaySettings(counts=counts, mean_over=mean_over, ahead=ahead, span=span)
    model, filters = _model(model), replays.filter_settings(estimator, model_error=model_error)
    name, recording = _recording(recording)
    replayed = replays.replay_recording(
        recording, model.arms, filters, settings, zeros=model.encoder_zeros, progress=progress
    )
    log = _new_log(
        out,
        f"{Path(name).stem}-replay.mcap",
        lambda place: replays.write_replay(replayed, place, model=model.name, model_text=model.text, force=force),
    )
    if contradiction := recording_checks.contradiction(recording, model.arms, model=model.name):
        remark(f"{name}: {contradiction}")
    return replace(replayed, model=model.name, estimator=estimator, log=log)


@checked
def draw_figures(
    names: Sequence[str] = (),
    *,
    folder: Annotated[Place, Output(folder=True)] = "figures",
    progress: Reporting = None,
) -> paper_figures.DrawnFigures:
    """Draw the computational figures of the paper, each a PNG with a caption and the differences.

    Names: energy-landscape, three-body-homoclinics, three-body, lyapunov-orbits, tubes-down-up, cuts, tubes-up-down,
    heteroclinics, branches, graph, shadowing, double-homoclinics, triple-homoclinics, returning-homoclinics, up-up.
    Without a name, all are drawn. Atlases are cached by content.

    Args:
        names: figures, such as "cuts" (default: all).
        folder: folder for the pictures (default: figures).
        progress: reports, see `dpcontrol.api`.

    Returns:
        For each figure its file, its caption, and its difference from the paper's.

    Raises:
        InputError: an unknown figure, or the folder is not writable.

    Examples:
        >>> [one.name for one in dp.draw_figures(["energy-landscape"], folder=log.parent)]
        ['energy-landscape']
    """
    progress("loading", 0.0)
    return paper_figures.draw_figures(names, Path(folder), progress=progress)


@checked
def draw_charts(
    names: Sequence[str] = (),
    *,
    folder: Annotated[Place, Output(folder=True)] = "charts",
    quick: bool = False,
    strict: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> drawing.DrawnCharts:
    """Chart speed against accuracy of numerical methods, and map their failures.

    Charts: stages, propagation, connections, transcription, estimation, control. `stages` has the time and error of
    each stage's first result, with an empty and with a filled cache. In the others times are medians on one core
    without start-up, and a ring marks the default of dpcontrol.

    Maps of the limits of methods, found by bisection, beside the predictions of theory: edges-moving, edges-ogy,
    edges-estimation, edges-margins. `edges` selects all of them.

    Without a name, all are drawn. The status reports defaults off their front and limits that differ from their
    prediction. With --strict, these give exit code 1.

    Args:
        names: charts, such as "propagation" (default: all).
        folder: folder for NAME.png and NAME.json of each chart (default: charts).
        quick: fewer and shorter measurements.
        strict: exit code 1 if a chart reports a deviation, which the result names as `missed`.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: reports, see `dpcontrol.api`.

    Returns:
        For each chart its points, complaints and files.

    Raises:
        InputError: an unknown chart, too much work, or the folder is not writable.

    Examples:
        >>> dp.draw_charts(["edges-margins"], quick=True)  # doctest: +SKIP
    """
    progress("loading", 0.0)
    return replace(drawing.draw_charts(names, Path(folder), quick=quick, yes=yes, progress=progress), strict=strict)


@checked
def read_guide(topic: str | None = None) -> GuidePage:
    """Show a page of the guide, or list its pages.

    Args:
        topic: page, such as "tubes" (default: the list of pages).

    Returns:
        The page, a text in Markdown.

    Raises:
        InputError: the guide has no such page.

    Examples:
        >>> dp.read_guide("tubes").splitlines()[0]
        '# ...'
    """
    return guide_page(topic)


@checked
def describe(
    model: Model | str,
    *,
    mjcf: Annotated[Path | str | None, Output((".xml",))] = None,
    out: Annotated[Path | str | None, Output((".toml",))] = None,
    force: bool = False,
) -> models.ModelDescription:
    """Show a model's parameters with units, and its equilibria.

    Equilibria are frictionless, with the pivot at rest.

    Args:
        model: model, its name, or the path of its file: TOML, or a robot in URDF or MJCF.
        mjcf: MuJoCo model to write, with arms and cart (default: none).
        out: model file to write (default: none).
        force: replace an existing file at `out`, whatever it holds.

    Returns:
        Parameters, sources and equilibria.

    Raises:
        InputError: no such model, a mistake in its file, or another file at `out`.

    Examples:
        >>> dp.describe("lab").equilibria["up-up"].kind
        'index-2 saddle'
    """
    loaded = _model(model)
    if mjcf is not None:
        write_whole(Path(mjcf), mjcf_files.mjcf_text(loaded.arms, name=loaded.name, cart_mass=20.0, lag=0.002))
    if out is not None:
        if not force and Path(out).is_file() and Path(out).read_bytes() != loaded.text.encode():
            raise in_the_way(out, "holds another model")
        write_whole(Path(out), loaded.text)
    mjcf_file, file = (None if output is None else Path(output) for output in (mjcf, out))
    return models.ModelDescription(loaded, lyapunov.equilibria(loaded.system), mjcf_file, file)


@checked
def demo(
    itinerary: Place = "outer-turn",
    *,
    seed: Seed = 0,
    folder: Annotated[Place, Output(folder=True)] = "logs",
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> single_runs.Demonstration:
    """Plan, run, score and picture one itinerary.

    The default is a full turn of the outer arm at no cost in energy. All steps are computed: Lyapunov orbit, tube,
    connections, and the reference with friction and cart. The closed loop has encoders, an estimator, and a plant that
    differs from the model.

    Args:
        itinerary: name or path of an itinerary (default: outer-turn).
        seed: seed of the plant parameters and the initial error (default: 0).
        folder: folder for log, recording and picture (default: logs).
        force: replace an existing log, whatever made it.
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The score, and the files.

    Raises:
        InputError: no such itinerary, or a file that cannot be written.
        GoalMissed: the itinerary cannot be planned.

    Examples:
        >>> dp.demo(folder=log.parent).score.completed
        True
    """
    start = perf_counter()
    planned = plan(itinerary, yes=yes, progress=part_of(progress, 0.05, 0.5))
    progress_of_run, name = part_of(progress, 0.5, 0.75), f"{planned.itinerary.name}-{seed}.mcap"
    with free_name(
        Path(folder) / name, lambda log: run(planned, seed=seed, log=log, force=force, progress=progress_of_run)
    ) as logged_run:
        view, file = log_views.run_view(logged_run.log), logged_run.log.path
        recording = file.with_suffix(".rrd") if installed("rerun") else None
        if recording is not None:
            rerun_recordings.write_recording(view, recording)
        progress("picture", 0.85)
        picture = file.with_suffix(".png")
        _save(render(view), picture)
    return single_runs.Demonstration(planned, file, logged_run.score(), recording, picture, perf_counter() - start)


def _recording(given: recording_files.Recording | Place) -> tuple[str, recording_files.Recording]:
    """Return a recording with its name: that of its file, if it is given by one."""
    return (str(given), recording_files.load_recording(given)) if isinstance(given, str | Path) else (given.name, given)


def _new_log(out: Place | Literal[True] | None, name: str, write: Callable[[Path], Path]) -> Path | None:
    """Write a log to a file, or to the first free name in the folder of logs, and return the file.

    Args:
        out: file, True for a free name, or None to write no log.
        name: first name that is tried in the folder of logs.
        write: function that writes the log to a path and returns it.
    """
    if out is True:
        with free_name(log_folder() / name, write) as log:
            return log
    return None if out is None else write(Path(out))


def _draw(result: Any, file: Place | None) -> None:
    """Draw the picture of a result that has one to a file; without a file, nothing is drawn."""
    if file is not None:
        _save(render(result), file)


def _save(figure: Figure, file: Place) -> None:
    """Write a figure to a file, in the format of its suffix."""
    page_layout.save_figure(figure, file)


def _model(model: Model | str) -> Model:
    """Return a model, loaded if its name or file is given."""
    return models.load_model(model) if isinstance(model, str) else model


def _system(model: Model | System | str) -> System:
    """Return the dynamical system of a model, or the system itself."""
    return model if isinstance(model, systems.System) else _model(model).system


def _found(converged: bool, what: str, status: str) -> None:
    """Raise GoalMissed for a result that a later step needs and that did not converge.

    Args:
        converged: True if the result can be used.
        what: the result, as the beginning of the message.
        status: reason for which it did not converge.
    """
    if not converged:
        raise GoalMissed(f"{what}: {status}")


def _lyapunov(
    system: System,
    saddle: str,
    number: int,
    energy: float | None,
    energies: tuple[float, float] | None,
    progress: Reporting,
) -> Any:
    """Return the Lyapunov orbit about a saddle at one energy, or its family between two energies.

    Args:
        system: system of the saddle.
        saddle: name of the saddle.
        number: number of the family of orbits about the saddle, slowest first, from 0.
        energy: energy of the orbit, or None for a family.
        energies: first and last energy of the family, or None for one orbit.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: the orbit does not converge.
        InputError: both energy and energies are given.
    """
    if energies is not None and energy is not None:
        raise InputError("energy and energies are given: give energy for one orbit, or energies for its family")
    if energies is not None:
        return family(system, saddle, energies=energies, family=number, progress=progress)
    assert energy is not None
    lyapunov_orbit = orbit(system, saddle, energy=energy, family=number)
    _found(
        lyapunov_orbit.converged,
        f"the Lyapunov orbit about {saddle} at {energy:g}{system.unit('J')}",
        lyapunov_orbit.status,
    )
    return lyapunov_orbit


def _rotating(
    system: System,
    arm: Literal["inner", "outer"],
    energy: float | None,
    energies: tuple[float, float] | None,
    progress: Reporting,
) -> rotations.RotatingOrbits | rotations.RotatingFamilies:
    """Return the rotating orbits of one arm at an energy, or their families between two energies.

    Args:
        system: system of two arms.
        arm: arm that turns over.
        energy: energy of the orbits; None for families.
        energies: first and last energy of the families, which start from orbits in the middle between these.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: there is no such orbit.
    """
    height = sum(energies or ()) / 2 if energy is None else energy
    orbits = rotating_orbits(system, arm, energy=height)
    if not orbits:
        raise GoalMissed(f"no symmetric orbit that turns the {arm} arm of {system.name} over was found at {height:g} J")
    if energies is None:
        return rotations.RotatingOrbits(orbits, arm, height)
    return rotations.RotatingFamilies(
        rotations.rotating_families(orbits, energies, progress=progress), arm, height, energies
    )


def _changes(
    system: System, symbols: Sequence[walk_symbols.Symbol], energies: tuple[float, float], progress: Progress
) -> following.SymbolChanges:
    """Return the energies of a range at which the symbols of a walk come to select other connections.

    `energies` are the ends of the range, in the system's unit.
    """
    return following.SymbolChanges(
        following.symbol_changes(system, symbols, energies, progress=progress), energies, system.unit("J")
    )


_REFINED = 4
"""Largest number of walks whose orbits are refined in extended precision."""


def _solved(
    walks: walk_lists.WalkList,
    folder: Place | None,
    shown: tuple[Place | None, Place | None],
    energy: Decimal | Fraction | None,
    progress: Reporting,
) -> walk_lists.SolvedWalks:
    """Return the orbits of walks, in files of a folder, refined at an exact energy, and shown in picture and film.

    Args:
        walks: walks on a graph.
        folder: folder of the orbits' files, or None.
        shown: files of a picture and a film, or None; only for a single walk. They are drawn if its orbit converges.
        energy: exact energy for a refinement in 113 bits, or None for double precision.
        progress: receiver of progress reports.

    Raises:
        InputError: a picture or film of several walks is requested, or too many walks are to be refined.
    """
    count = len(walks.walks)
    if any(shown) and count != 1:
        raise InputError(f"picture and film show one walk, but there are {count}: give the symbols of one")
    if energy is not None and count > _REFINED:
        raise InputError(f"precision = extended: {count} walks; at most {_REFINED} are possible")
    parameters, orbit_folder = _exact_parameters(walks.edges.system), None if folder is None else Path(folder)
    solved_walks = walk_lists.solve_walks(
        walks, energy=energy, parameters=parameters, folder=orbit_folder, progress=progress
    )
    if any(shown) and solved_walks.converged and (orbit := solved_walks.answers[0].orbit) is not None:
        picture(orbit, file=shown[0], film=shown[1])
        return replace(solved_walks, picture=shown[0], film=shown[1])
    return solved_walks


def _exact(energy: Decimal | Fraction | float) -> Decimal | Fraction:
    """Return an energy as an exact number; a float counts as the decimal number that Python prints for it."""
    return energy if isinstance(energy, Decimal | Fraction) else Decimal(repr(float(energy)))


def _exact_parameters(system: System) -> Sequence[Any] | None:
    """Return a model's parameters as exact numbers for extended precision, or None for a system without a model."""
    return system.model.exact_parameters if isinstance(system, models.ModelSystem) else None


def _proof_cost(periods: float) -> Cost:
    """Return the predicted cost of a proof, whose measured time is 0.8 to 1.5 s for each period.

    Args:
        periods: length of all orbits to enclose, in periods of the periodic orbit.
    """
    return Cost(f"{periods:.3g} periods of orbits", 1.5 * periods, 2e8, "prove")


def _certified(proof: proofs.Proof, out: Place | None) -> proofs.Proof:
    """Write the certificate of a proof to `out`, and return the proof with the file.

    The proof is returned unchanged if no file is requested or nothing is proved. It is also unchanged, and a remark is
    printed, if the proof has no certificate.
    """
    if out is None or not proof.proved:
        return proof
    if proof.certificate is None:
        remark(f"{out} is not written: the proof has no certificate, because the system has no model file")
        return proof
    write_whole(Path(out), json.dumps(proof.certificate, indent=1) + "\n")
    return replace(proof, file=Path(out))


def _same_level(system: System, energy: float, other: System, other_energy: float) -> None:
    """Reject two results that belong to different systems or energies, and so to different energy surfaces.

    Raises:
        InputError: the systems or the energies differ.
    """
    system.check_same(other)
    if energy != other_energy:
        raise InputError(f"the results are of different energies, {energy:g} and {other_energy:g}; use one")


def _edges(searches: Sequence[tubes.ConnectionSearch]) -> graphs.Edges:
    """Return the part of the connection graph that some searches found, all at one energy.

    Raises:
        InputError: there is no search, or the searches are of different systems or energies.
    """
    if not searches:
        raise InputError("found = []: give a graph, or one search for connections at least")
    first_orbit = searches[0].source
    for item in searches:
        first_orbit.system.check_same(item.source.system)
    if len({item.energy for search in searches for item in (search.source, search.target)}) > 1:
        raise InputError("the connections are of different energies: a walk keeps one")
    return graphs.Edges(
        system=first_orbit.system,
        energy=first_orbit.energy,
        orbits={item.saddle: item for search in searches for item in (search.source, search.target)},
        absent=(),
        searched=tuple((search.source.saddle, search.target.saddle) for search in searches),
        connections=tuple(item for search in searches for item in search.connections),
        incomplete=(),
    )


def _loaded(itinerary: plans.Plan | str) -> itineraries.Itinerary:
    """Return an itinerary, loaded if its name or file is given, or that of a plan."""
    return itineraries.load_itinerary(itinerary) if isinstance(itinerary, str) else itinerary.itinerary


def _closed(
    itinerary: plans.Plan | str, settings: Mapping[str, Any], *, yes: bool, progress: Progress
) -> loops.ClosedLoop:
    """Return the closed loop of an itinerary, which is planned unless a plan is given.

    Args:
        itinerary: plan, or name or file of an itinerary.
        settings: settings of the runs, by path.
        yes: permission for work of more than an hour or 4 GB of memory.
        progress: receiver of progress reports.
    """
    # A wrong setting is reported before the plan is computed.
    loaded = _loaded(itinerary).with_run(settings)
    planned = plans.make_plan(loaded, yes=yes, progress=progress) if isinstance(itinerary, str) else itinerary
    return loops.ClosedLoop(planned, settings)


def _linked(
    rig: Rig | single_runs.RigLink | str | None, *, key_file: Place | None, insecure: bool, real_time: bool
) -> Rig | single_runs.RigLink | str | None:
    """Return a rig, or the link to a bench at an address, if options of links are given.

    Args:
        rig: object of the user, link, address or name of a rig, or None for the simulated bench.
        key_file: file with the shared key of bench and loop, or None.
        insecure: True to allow a bench on another computer without a key.
        real_time: True to request real-time priority.

    Raises:
        InputError: options of links are given for another kind of rig.

    Returns:
        `rig` itself if no option is given, else a link that opens the bench with these options.
    """
    if not (key_file or insecure or real_time):
        return rig
    if not isinstance(rig, str) or own_objects.names_file(rig):
        raise InputError("real_time, key_file and insecure apply to benches at udp://: give such a rig, or udp")
    return rig_link(rig, key_file=key_file, insecure=insecure, real_time=real_time)


def _drawn(result: Any, file: Place | None) -> Any:
    """Draw the picture of a result to `file`, and return the result with the name of the picture.

    Without a file, nothing is drawn and the result is unchanged.
    """
    _draw(result, file)
    return result if file is None else replace(result, picture=Path(file))


def _settings(settings: Mapping[str, object] | None, **named: object) -> dict[str, Any]:
    """Return the settings of runs by path: those of the mapping, and those that have an argument of their own.

    Args:
        settings: values by path or unique last part, or None.
        **named: values by the names of arguments, which override the mapping; None for those not given.
    """
    if isinstance(named.get("plant"), Path):
        named["plant"] = str(named["plant"])
    start: Any = named.get("start")
    if hasattr(start, "tolist"):
        named["start"] = start.tolist()
    return {**overrides.canonical(settings or {}), **overrides.canonical(named)}
