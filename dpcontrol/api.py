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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, overload

from dpcontrol.foundation.checked import Between, Count, Hit, Index, Positive, Seed, Workers, checked
from dpcontrol.foundation.errors import GoalMissed, InputError, remark
from dpcontrol.foundation.files import Film, Output, Picture, write_whole
from dpcontrol.foundation.parts import installed, part
from dpcontrol.foundation.progress import Cost, Reporting, announce, part_of, reporting
from dpcontrol.foundation.rendering import render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dpcontrol.bench.chart import PrecisionChart
    from dpcontrol.bench.run import DrawnCharts
    from dpcontrol.bifurcations.bifurcations import BifurcationSearch
    from dpcontrol.control.export import ControllerSource
    from dpcontrol.control.symbolic import Setpoint as Setpoint
    from dpcontrol.control.symbolic import SymbolicLaw as SymbolicLaw
    from dpcontrol.dynamics.chain import ArmChainParameters
    from dpcontrol.dynamics.components import Sizes as Sizes
    from dpcontrol.dynamics.components import SymbolicPlant as SymbolicPlant
    from dpcontrol.dynamics.components import Terms as Terms
    from dpcontrol.dynamics.propagator import Section as Section
    from dpcontrol.dynamics.system import System as System
    from dpcontrol.foundation.cache import CacheContents
    from dpcontrol.foundation.config import Configuration
    from dpcontrol.foundation.guide import Page
    from dpcontrol.identification.fit import Design
    from dpcontrol.identification.identify import Identification
    from dpcontrol.identification.replay import Replay
    from dpcontrol.judge.campaign import CampaignSummary
    from dpcontrol.judge.comparison import RunComparison
    from dpcontrol.judge.night import Night
    from dpcontrol.judge.score import Scores
    from dpcontrol.logs import LogSummary, Recovery
    from dpcontrol.loop.protocols import Reading as Reading
    from dpcontrol.loop.protocols import UserRig as Rig
    from dpcontrol.orbits.family import LyapunovFamily
    from dpcontrol.orbits.lyapunov import Equilibrium, LyapunovOrbit
    from dpcontrol.orbits.rotating import RotatingFamily, RotatingOrbit
    from dpcontrol.pages.figures import DrawnFigures
    from dpcontrol.pages.page import Report
    from dpcontrol.pages.picture import Review
    from dpcontrol.planner.server import Planner
    from dpcontrol.plans.model import Model as Model
    from dpcontrol.plans.model import ModelDescription
    from dpcontrol.plans.model import load_model as load_model
    from dpcontrol.plans.plan import Plan
    from dpcontrol.proofs.check import CertificateCheck
    from dpcontrol.proofs.prove import Proof, ProofSettings
    from dpcontrol.recordings.recording import ImportedRecording, Recording
    from dpcontrol.references.problem import Limits as Limits
    from dpcontrol.references.problem import ReferenceSettings as ReferenceSettings
    from dpcontrol.references.reference import ReferenceFile
    from dpcontrol.references.sustained import SustainedOrbit
    from dpcontrol.rig.bench import UdpBench
    from dpcontrol.rig.commissioning import Commissioning
    from dpcontrol.runs.campaign import Campaign
    from dpcontrol.runs.campaign import CampaignSettings as CampaignSettings
    from dpcontrol.runs.closed_loop import ClosedLoop
    from dpcontrol.runs.example_bench import BenchAddress as BenchAddress
    from dpcontrol.runs.night import NightSettings as NightSettings
    from dpcontrol.runs.polish import Polished
    from dpcontrol.runs.run import Demonstration, Repeat, RigLink, Run
    from dpcontrol.shooting.extended import ExtendedOrbit
    from dpcontrol.tubes.connections import Connection, ConnectionSearch
    from dpcontrol.tubes.symmetric import SymmetricSearch
    from dpcontrol.walks.atlas import Atlas
    from dpcontrol.walks.edges import Edges
    from dpcontrol.walks.following import SymbolChange
    from dpcontrol.walks.shadowing import ShadowingOrbit
    from dpcontrol.walks.walks import WalkRequest
else:
    Rig = object  # Its methods are checked where they are called.

Place = Path | str
NotNegative = Annotated[float, Between(0)]
NewLog = Annotated[Path | str | Literal[True] | None, Output((".mcap",), free=True)]
NewModel = Annotated[Path | str | Literal[True] | None, Output((".toml",), free=True)]
"""A file to write; True for a free name of the usual kind."""
_ARMS = {"inner": 1, "outer": 2}
_SWEPT, _SWEPT_BYTES = 2.0, 1e6
"""What each energy of a sweep for bifurcations takes, in s and bytes, for each crossing of the section."""


@checked
def orbit(model: Model | System | str, saddle: str, *, energy: float, family: Index = 0) -> LyapunovOrbit:
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
    from dpcontrol.orbits.lyapunov import lyapunov_orbit

    return lyapunov_orbit(_system(model), saddle, energy=energy, family=family)


@overload
def connections(
    source: LyapunovOrbit,
    target: LyapunovOrbit | None = None,
    *,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> ConnectionSearch: ...
@overload
def connections(
    source: LyapunovOrbit,
    *,
    energies: tuple[float, float],
    hits: tuple[Hit, Hit] = (1, 1),
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> SymmetricSearch: ...
@checked
def connections(
    source: LyapunovOrbit,
    target: LyapunovOrbit | None = None,
    *,
    energies: tuple[float, float] | None = None,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> ConnectionSearch | SymmetricSearch:
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
    from dpcontrol.tubes.intersections import search_settings

    if energies is not None:
        from dpcontrol.foundation.budget import Budget
        from dpcontrol.tubes.symmetric import find_symmetric_connections

        if target is not None and target is not source:
            raise InputError("energies and target are given: a symmetric connection leads back to its source; give one")
        if hits[0] != hits[1]:
            raise InputError(f"hits = {hits}: a symmetric connection meets the section of both tubes at the same one")
        with reporting(progress, "symmetric connections") as report:
            return find_symmetric_connections(
                source.system, source.saddle, energies=energies, family=source.family, hit=hits[0],
                budget=Budget(search_settings(seconds=seconds).seconds), progress=report,
            )  # fmt: skip
    from dpcontrol.tubes.connections import find_connections

    target = source if target is None else target
    source.system.check_same(target.system)
    for one in (source, target):
        _found(one.converged, f"the orbit about {one.saddle}", one.status)
    with reporting(progress, "connections") as report:
        return find_connections(
            source,
            target,
            hits=hits,
            section=source.system.section_between(source.saddle, target.saddle, section),
            settings=search_settings(longest=longest, thorough=thorough, seconds=seconds),
            progress=report,
        )


@checked
def graph(
    model: Model | System | str, *, energy: float, symbols: Sequence[str] = (), progress: Reporting = None
) -> Edges:
    """Find the connection graph of an energy.

    Args:
        model: model, its name, or a system.
        energy: energy, J.
        symbols: symbols of a walk, for other sections, later hits or rotating orbits (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Orbits of all saddles, and the connections between them.

    Raises:
        InputError: no saddle has an orbit at this energy, or a symbol is unknown.

    Examples:
        >>> dp.graph("lab", energy=-0.07).saddles
        ('down-up',)
    """
    from dpcontrol.walks.edges import find_edges
    from dpcontrol.walks.symbols import parse_walk
    from dpcontrol.walks.walks import vertex_names

    system = _system(model)
    requested = parse_walk(symbols, vertex_names(system)) if symbols else ()
    with reporting(progress, "connections") as report:
        return find_edges(system, energy, symbols=requested, progress=report)


@checked
def find_bifurcations(
    model: Model | System | str,
    source: str,
    target: str,
    *,
    energies: tuple[float, float],
    hits: Hit = 1,
    samples: Count = 24,
    yes: bool = False,
    progress: Reporting = None,
) -> BifurcationSearch:
    """Find the energies at which connections appear, vanish or split.

    Args:
        model: model, its name, or a system.
        source: saddle that the connections leave.
        target: saddle that they join.
        energies: lowest and highest energy, J.
        hits: crossings of the section (default: 1).
        samples: energies of the first search (default: 24).
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Events in order of energy, and unexplained changes of the count.

    Raises:
        InputError: an unknown saddle, energies without both orbits, or too much work.

    Examples:
        >>> dp.find_bifurcations("lab", "down-up", "down-up", energies=(-0.08, -0.06), samples=2).events
        ()
    """
    from dpcontrol.bifurcations.bifurcations import SweepSettings
    from dpcontrol.bifurcations.bifurcations import find_bifurcations as find

    cost = Cost(
        f"{samples:,} energies", _SWEPT * samples * hits, _SWEPT_BYTES * samples, f"samples = {samples}, hits = {hits}"
    )
    announce(cost, yes=yes)
    settings = SweepSettings(energies=samples)
    with reporting(progress, "bifurcations") as report:
        return find(
            _system(model), source, target, energies=energies, crossings=hits, settings=settings, progress=report
        )


@checked
def atlas(
    model: Model | System | str,
    *,
    energy: float,
    hits: tuple[Hit, Hit] | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    fresh: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> Atlas:
    """Return all orbits, tubes and connections of an energy.

    Args:
        model: model, its name, or a system.
        energy: energy, J.
        hits: crossings of the section (default: the first with connections, up to the second).
        thorough: resolve parts that are reported as "at least", for up to a minute each.
        seconds: processor time of each search, s (default: 60). A partial atlas is not cached.
        fresh: compute it again even if it is cached.
        yes: accept work of more than an hour or 4 GB (default: refused).
        progress: reports, see `dpcontrol.api`.

    Returns:
        The atlas, from the cache if possible.

    Raises:
        InputError: no saddle has an orbit at this energy, or too much work.

    Examples:
        >>> len(dp.atlas("lab", energy=-0.07).connections)
        8
    """
    from dpcontrol.plans.atlas import AtlasSettings, make_atlas
    from dpcontrol.tubes.intersections import search_settings

    settings = AtlasSettings(hits=hits, search=search_settings(thorough=thorough, seconds=seconds))
    with reporting(progress, "atlas") as report:
        return make_atlas(
            _model(model) if isinstance(model, str) else model,
            energy,
            settings=settings,
            fresh=fresh,
            yes=yes,
            progress=report,
        ).atlas


@checked
def shadow(
    found: Edges | ConnectionSearch | Sequence[ConnectionSearch] | SymmetricSearch,
    walk: Sequence[str] | WalkRequest,
    *,
    wraps: Sequence[Index] | None = None,
    lead_in: Index = 2,
    lead_out: Index = 2,
    periodic: bool = False,
    yes: bool = False,
) -> ShadowingOrbit:
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
    from dpcontrol.tubes.connections import ConnectionSearch
    from dpcontrol.tubes.symmetric import SymmetricSearch
    from dpcontrol.walks.edges import Edges
    from dpcontrol.walks.shadowing import WalkSolver
    from dpcontrol.walks.walks import WalkRequest, resolve, solved, symmetric_walk, walks_cost

    if isinstance(found, SymmetricSearch):
        if isinstance(walk, WalkRequest):
            raise InputError("walk: drawn walks belong to graphs; for three arms give one symbol")
        return symmetric_walk(walk, found, lead_in=lead_in, lead_out=lead_out)
    searches = [found] if isinstance(found, ConnectionSearch) else found
    edges = searches if isinstance(searches, Edges) else _edges(searches)
    solver = WalkSolver(edges.known)
    if isinstance(walk, WalkRequest):
        own = walk.chain[0].source
        _same_level(edges.system, edges.energy, own.system, own.energy)
        (answer,) = solved([walk], solver)
        if answer.orbit is None:
            raise GoalMissed(answer.status)
        return answer.orbit
    key = "wraps" if wraps else "walk"
    announce(walks_cost(1, symbols=len(walk), wraps=sum(wraps or ()), solve=True, key=key), yes=yes)
    chain = resolve(walk, edges)
    counts = solver.least(chain, periodic=periodic) if wraps is None else tuple(wraps)
    return solver.solve(chain, counts, periodic=periodic, lead_in=lead_in, lead_out=lead_out)


@checked
def prove(
    found: LyapunovOrbit | ShadowingOrbit | ConnectionSearch,
    *,
    energy: Decimal | Fraction | float | None = None,
    rivals: Edges | None = None,
    settings: ProofSettings | None = None,
    progress: Reporting = None,
) -> Proof:
    """Prove in ball arithmetic that orbits or connections exist.

    Homoclinic connections of one orbit are proved together with their horseshoe.

    Args:
        found: orbit, closed walk, or search for connections.
        energy: exact energy, J (default: the shortest decimal that reads as the orbit's).
        rivals: graph whose other connections the walk must not follow (default: not checked).
        settings: precision and radii (default: those of `dpcontrol prove`).
        progress: reports, see `dpcontrol.api`.

    Returns:
        "proved" with enclosures and certificate, or the step that does not close.

    Raises:
        InputError: an open walk, or a system without enclosures.
        GoalMissed: the orbit did not converge.
        PartMissing: the extra `proof` is not installed.

    Examples:
        >>> dp.prove(orbit).proved
        True
    """
    part("flint")
    from dpcontrol.orbits.lyapunov import LyapunovOrbit
    from dpcontrol.proofs.prove import exact_energy, prove_connections, prove_orbit, prove_walk
    from dpcontrol.walks.shadowing import ShadowingOrbit

    if not isinstance(found, LyapunovOrbit) and not found.connections:
        raise InputError("found: the search has no connection to prove; search at another energy or with more hits")
    own = found if isinstance(found, LyapunovOrbit) else found.connections[0].source
    if rivals is not None:
        _same_level(own.system, own.energy, rivals.system, rivals.energy)
    height = exact_energy(own.energy if energy is None else energy)
    with reporting(progress, "proof") as report:
        if not isinstance(found, LyapunovOrbit | ShadowingOrbit):
            whole = own is found.connections[0].target
            return prove_connections(found.connections, energy=height, settings=settings, whole=whole, progress=report)
        if isinstance(found, ShadowingOrbit):
            known = () if rivals is None else rivals.known
            return prove_walk(found, energy=height, rivals=known, settings=settings, progress=report)
        return prove_orbit(found, energy=height, settings=settings, progress=report)


@checked
def reference(
    walks: ShadowingOrbit | Sequence[ShadowingOrbit],
    *,
    limits: Limits | None = None,
    settings: ReferenceSettings | None = None,
    start: Literal["orbit", "rest"] = "orbit",
    finish: Literal["orbit", "rest"] = "orbit",
    name: str = "walk",
    yes: bool = False,
    progress: Reporting = None,
) -> Plan:
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
    from dpcontrol.plans.itinerary import WalkPart, itinerary_of
    from dpcontrol.plans.model import model_of
    from dpcontrol.plans.plan import make_plan
    from dpcontrol.walks.shadowing import ShadowingOrbit

    orbits = [walks] if isinstance(walks, ShadowingOrbit) else list(walks)
    if not orbits:
        raise InputError("walks = []: give one at least")
    for one in orbits:
        orbits[0].connections[0].source.system.check_same(one.connections[0].source.system)
        _found(one.converged, "the walk's orbit", one.status)
        if one.periodic:
            raise InputError("a periodic walk has no ends that a reference could start and finish at; shadow it open")
    parts = [
        WalkPart(one.connections[0].source.energy, one.walk, one.wraps, 1, one.lead_in, one.lead_out) for one in orbits
    ]
    scene = itinerary_of(
        model_of(orbits[0].connections[0].source.system),
        parts,
        name=name,
        start=start,
        finish=finish,
        limits=limits,
        reference=settings,
    )
    with reporting(progress, "reference") as report:
        return make_plan(scene, orbits=orbits, progress=report, yes=yes)


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
) -> Plan:
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
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan

    scene = load_itinerary(str(itinerary))
    if explore_energy is not None:
        from dpcontrol.bench.energies import only_walk

        only_walk(scene)
    with reporting(progress, "plan") as report:
        found = make_plan(scene, progress=part_of(report, 0.0, 0.5), fresh=fresh, workers=workers, yes=yes)
        if not found.converged:
            return found
        if polish:
            from dpcontrol.runs.polish import polish as polish_plan

            step = part_of(report, 0.5, 0.8)
            found = replace(found, polished=polish_plan(found, fresh=fresh, workers=workers, yes=yes, progress=step))
        if margins:
            found = replace(found, margins=closed_loop(found).margins())
        if explore_energy is not None and not found.missed:
            step = part_of(report, 0.8, 1.0)
            found = replace(found, energies=explore_energies(found, picture=explore_energy, progress=step))
    return found if out is None or found.missed else found.written_to(Path(out))


@checked
def closed_loop(
    planned: Plan | str,
    *,
    settings: Mapping[str, object] | None = None,
    yes: bool = False,
    progress: Reporting = None,
    **named: object,
) -> ClosedLoop:
    """Return the closed loop of a plan.

    Args:
        planned: plan, or name or path of an itinerary.
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
    with reporting(progress, "plan") as report:
        return _closed(planned, _settings(settings, **named), yes=yes, progress=report)


@checked
def mjcf(
    model: Model | ArmChainParameters | str, *, cart_mass: float = 20.0, lag: float = 0.002, out: Place | None = None
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
    from dpcontrol.dynamics.chain import ArmChainParameters
    from dpcontrol.dynamics.mjcf import mjcf_text

    arms = model if isinstance(model, ArmChainParameters) else _model(model).arms
    text = mjcf_text(arms, name="arms", cart_mass=cart_mass, lag=lag)
    if out is not None:
        write_whole(Path(out), text)
    return text


@checked
def polish(
    planned: Plan | str,
    *,
    fresh: bool = False,
    runs: Count = 48,
    workers: Workers = 0,
    yes: bool = False,
    progress: Reporting = None,
) -> Polished:
    """Re-optimise a motion from rest to rest as one problem.

    The polished plan keeps crossings, windings and wraps at a fraction of the effort. It may stay far from the orbits.

    Args:
        planned: plan from rest to rest, or name or path of an itinerary.
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
    from dpcontrol.runs.polish import polish as polish_plan

    with reporting(progress, "polish") as report:
        found = plan(planned, yes=yes, progress=part_of(report, 0.0, 0.2)) if isinstance(planned, str) else planned
        return polish_plan(found, fresh=fresh, runs=runs, workers=workers, yes=yes, progress=part_of(report, 0.2, 1.0))


@checked
def run(
    planned: Plan | str,
    *,
    mismatch: float | None = None,
    plant: Place | None = None,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    rig: Rig | RigLink | str | None = None,
    log: Place | None = None,
    force: bool = False,
    live: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> Run:
    """Run a closed loop once, simulated or on a rig.

    Args:
        planned: plan, or name or path of an itinerary.
        mismatch: largest relative error of the plant's parameters (default: the itinerary's).
        plant: name or path of a model for a plant with other arms (default: the same arms).
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
    chosen = _settings(settings, mismatch=mismatch, plant=plant)
    with reporting(progress, "run") as report:
        loop = _closed(planned, chosen, yes=yes, progress=part_of(report, 0.0, 0.5))
        return loop.run(seed=seed, rig=rig, log=log, force=force, live=live, progress=part_of(report, 0.5, 1.0))


@checked
def export(
    planned: Plan | str,
    folder: Place | None = None,
    *,
    single: bool = False,
    settings: Mapping[str, object] | None = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> ControllerSource:
    """Return the controller of a plan as C99.

    Args:
        planned: plan, or name or path of an itinerary.
        folder: folder to write, or NAME.fmu for a co-simulation unit (default: none).
        single: use single precision (default: double).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        force: replace files of the same names there.
        yes: accept work of more than an hour or 4 GB (default: refused).
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
    with reporting(progress, "export") as report:
        loop = _closed(planned, _settings(settings), yes=yes, progress=part_of(report, 0.0, 0.5))
        return loop.export(folder, single=single, force=force, progress=part_of(report, 0.5, 1.0))


@checked
def campaign(
    planned: Plan | str,
    *,
    runs: Count = 100,
    mismatch: float | None = None,
    plant: Place | None = None,
    settings: Mapping[str, object] | None = None,
    over: Mapping[str, object] | None = None,
    first_seed: Seed = 0,
    transitions: bool = False,
    workers: Workers = 0,
    out: Place | None = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> Campaign:
    """Run a plan with many seeds, and count completed runs.

    Args:
        planned: plan, or name or path of an itinerary.
        runs: seeds of each case (default: 100).
        mismatch: largest relative error of the plant's parameters (default: the itinerary's).
        plant: name or path of a model for a plant with other arms (default: the same arms).
        settings: run settings by path, such as {"drive.lag": 0.005} (default: none).
        over: values of run settings by name, each combination a case.
        first_seed: first seed (default: 0).
        transitions: run each transfer from hold to hold separately.
        workers: processes, 0 for one per processor.
        out: Parquet table to write (default: none).
        force: replace the table of another campaign there.
        yes: accept work of more than an hour or 4 GB (default: refused).
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
    from dpcontrol.runs.campaign import CampaignSettings

    counts = CampaignSettings(runs=runs, first_seed=first_seed, workers=workers)
    with reporting(progress, "campaign") as report:
        chosen = _settings(settings, mismatch=mismatch, plant=plant)
        loop = _closed(planned, chosen, yes=yes, progress=part_of(report, 0.0, 0.1))
        return loop.campaign(
            over=over, settings=counts, transitions=transitions, out=out, force=force, yes=yes,
            progress=part_of(report, 0.1, 1.0),
        )  # fmt: skip


@checked
def swings(
    model: Model | str, *, count: Count = 9, seconds: Positive = 2.667, seed: Seed = 0, yes: bool = False
) -> Recording:
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
    from dpcontrol.recordings.recording import random_swings, swings_cost

    model = _model(model)
    announce(swings_cost(count, seconds, written=False), yes=yes)
    return random_swings(model.arms, swings=count, seconds=seconds, seed=seed, name=f"{model.name}-swings-{seed}")


@overload
def identify(
    recordings: Recording | Place | Sequence[Recording | Place] = (),
    *,
    model: Model | str = "lab",
    design: Literal[True],
    picture: Picture = None,
    progress: Reporting = None,
) -> Design: ...
@overload
def identify(
    recordings: Recording | Place | Sequence[Recording | Place] = (),
    *,
    model: Model | str = "lab",
    zeros: bool | None = None,
    design: Literal[False] = False,
    out: NewModel = None,
    force: bool = False,
    picture: Picture = None,
    progress: Reporting = None,
) -> Identification: ...
@checked
def identify(
    recordings: Recording | Place | Sequence[Recording | Place] = (),
    *,
    model: Model | str = "lab",
    zeros: bool | None = None,
    design: bool = False,
    out: NewModel = None,
    force: bool = False,
    picture: Picture = None,
    progress: Reporting = None,
) -> Identification | Design:
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
        picture: picture of the result, with profiles of the misfit in a minute (default: none).
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
    from dpcontrol.recordings.recording import Recording

    several = [recordings] if isinstance(recordings, Recording | str | Path) else [*recordings]
    if bool(several) == design:
        wrong = (
            "design compares possible recordings: omit recordings"
            if design
            else "recordings = []: give at least one log"
        )
        raise InputError(wrong)
    model = _model(model)
    if design:
        return design_experiments(model, picture=picture, progress=progress)
    from dpcontrol.identification.identify import IdentificationSettings
    from dpcontrol.identification.identify import identify as found_in
    from dpcontrol.plans.model import check_model_replaced, write_model
    from dpcontrol.recordings.checks import contradiction

    named = [*map(_recording, several)]
    files, given = [Path(name).name for name, _ in named], [one for _, one in named]
    target = Path("models") / f"{Path(files[0]).stem}.toml" if out is True else None if out is None else Path(out)
    if target is not None:
        check_model_replaced(target, logs=files, starting_model=model.name, force=force)
    choice = {None: "chosen", True: "free", False: "none"}[zeros]
    title = f"{model.title}, identified from {', '.join(one.name for one in given)}"
    with reporting(progress, "identify") as report:
        found = found_in(given, model.arms, settings=IdentificationSettings(zeros=choice), progress=report)
        for one in given:
            if against := contradiction(one, model.arms, model=model.name):
                remark(f"{one.name}: {against}")
        if target is not None:
            write_model(found, target, title=title, logs=files, starting_model=model.name)
        if picture is not None:
            from dpcontrol.identification.identify import profiles
            from dpcontrol.pages.identification import draw_identification

            _save(draw_identification(found, profiles(found, progress=report), title=title), picture)
    return replace(found, file=target)


@checked
def open_log(file: Place) -> Run:
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
    from dpcontrol.logs import read_log
    from dpcontrol.runs.run import Run

    return Run(read_log(file))


@checked
def open_plan(file: Place) -> Plan:
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
    from dpcontrol.plans.plan import load_plan

    return load_plan(Path(file))


@checked
def open_reference(file: Place, *, picture: Picture = None, transitions: Picture = None) -> ReferenceFile:
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
    from dpcontrol.references.reference import ReferenceFile, load_reference

    if picture is not None and transitions is not None and Path(picture).resolve() == Path(transitions).resolve():
        raise InputError(f"picture and transitions are both {picture}: give two names")
    reference = load_reference(Path(file))
    if transitions is not None:
        from dpcontrol.pages.transitions import draw_transitions

        # It can be refused, and must be before another picture is written.
        _save(draw_transitions(reference), transitions)
    if picture is not None:
        from dpcontrol.judge.of_log import reference_view

        _save(render(reference_view(reference, Path(file))), picture)
    return ReferenceFile(Path(file), reference, None if transitions is None else Path(transitions))


@checked
def open_atlas(file: Place) -> Atlas:
    """Open the file of an atlas.

    Args:
        file: atlas (.npz), as `dpcontrol atlas --out` writes it.

    Raises:
        InputError: the file is missing, damaged or not an atlas.

    Examples:
        >>> dp.open_atlas(atlas_file).energy
        -0.07
    """
    from dpcontrol.plans.atlas import load_atlas

    return load_atlas(Path(file))


@checked
def open_planner(model: str = "lab", *, browser: bool = True, port: Annotated[int, Between(0, 65535)] = 0) -> Planner:
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
    from dpcontrol.planner.server import Planner

    planner = Planner(model, port=port)
    if browser and not planner.open():
        remark("no browser was found; open the address in one")
    return planner


@checked
def open_recording(
    file: Place, *, mapping: str | None = None, repairs: Sequence[str] = (), progress: Reporting = None
) -> Recording:
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
    from dpcontrol.recordings.checks import checked_repairs
    from dpcontrol.recordings.importing import import_recording
    from dpcontrol.recordings.recording import load_recording

    path = Path(file)
    checked_repairs(tuple(repairs))
    if path.suffix.lower() == ".mcap" and mapping is None:
        return load_recording(path)
    with reporting(progress, "import") as report:
        return import_recording(path, mapping, repairs=list(repairs), progress=report)


@checked
def picture(
    result: Run | Plan | ShadowingOrbit | Atlas,
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
    from dpcontrol.dynamics.chain import ArmChainParameters
    from dpcontrol.judge.of_log import reference_view, run_view
    from dpcontrol.pages.atlas import draw_atlas
    from dpcontrol.pages.layout import save_figure
    from dpcontrol.pages.page import draw
    from dpcontrol.pages.walk_story import WalkStory
    from dpcontrol.pages.walks import draw_walk
    from dpcontrol.plans.model import ModelSystem
    from dpcontrol.plans.plan import Plan
    from dpcontrol.runs.run import Run
    from dpcontrol.walks.shadowing import ShadowingOrbit

    if transitions and not isinstance(result, Plan):
        raise InputError("transitions = True draws the transfers of a plan: give one")
    view: Any = result
    if isinstance(result, Run | Plan):
        plan = isinstance(result, Plan)
        view = reference_view(result.reference, result.file) if plan else run_view(result.log)
        figure = draw(view)
    elif isinstance(result, ShadowingOrbit):
        system = result.connections[0].source.system
        arms = system.model.parameters if isinstance(system, ModelSystem) else None
        lengths = arms.length if isinstance(arms, ArmChainParameters) else None
        figure = draw_walk(result, arm_lengths=lengths, model=system.name)
        view = WalkStory(result, lengths).view(system.name)
    else:
        figure = draw_atlas(result)
    if transitions and isinstance(result, Plan):
        from dpcontrol.pages.transitions import draw_transitions

        figure = draw_transitions(result.reference)
    if film is not None:
        from dpcontrol.pages.film import write_film

        write_film(view, film)
    if file is not None:
        save_figure(figure, file)
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
    from dpcontrol.plans.tables import schema as schema_of

    return schema_of(of)


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
    from dpcontrol.foundation.config import Configuration, config_file, configured

    return Configuration(config_file(), tuple(configured()))


@checked
def cache(*, clear: bool = False) -> CacheContents:
    """List the cached results: plans, atlases, diagrams of connections, machine code.

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
    from dpcontrol.foundation.cache import cache_contents

    return cache_contents(clear=clear)


@checked
def equilibria(model: Model | System | str) -> dict[str, Equilibrium]:
    """Return a model's equilibria by name, with energies and eigenvalues.

    Args:
        model: model or system.

    Returns:
        Equilibria by name; energies in J, eigenvalues in 1/s, each with pivot and cart at rest.

    Examples:
        >>> [name for name, one in dp.equilibria(lab).items() if one.kind == "index-1 saddle"]
        ['down-up', 'up-down']
    """
    from dpcontrol.orbits.lyapunov import equilibria as found_in

    return found_in(_system(model))


@checked
def family(
    model: Model | System | str,
    saddle: str,
    *,
    energies: tuple[float, float],
    family: Index = 0,
    progress: Reporting = None,
) -> LyapunovFamily:
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
    from dpcontrol.orbits.family import lyapunov_family

    with reporting(progress, f"family of {saddle}") as report:
        return lyapunov_family(_system(model), saddle, energies=energies, family=family, progress=report)


@checked
def rotating_orbits(
    model: Model | System | str, arm: Literal["inner", "outer"], *, energy: float
) -> tuple[RotatingOrbit, ...]:
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
    from dpcontrol.orbits.rotating import rotating_orbits as found_in

    return found_in(_system(model), _ARMS[arm], energy)


@checked
def rotating_families(
    model: Model | System | str,
    arm: Literal["inner", "outer"],
    *,
    energies: tuple[float, float],
    progress: Reporting = None,
) -> tuple[RotatingFamily, ...]:
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
    from dpcontrol.orbits.rotating import rotating_families as followed

    orbits = rotating_orbits(model, arm, energy=sum(energies) / 2)
    with reporting(progress, "families of rotating orbits") as report:
        return followed(orbits, energies, progress=report)


@checked
def sustained_orbit(
    orbit: LyapunovOrbit, *, limits: Limits | None = None, progress: Reporting = None
) -> SustainedOrbit:
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
    from dpcontrol.plans.model import model_of
    from dpcontrol.references.sustained import sustained_orbit as sustained

    _found(orbit.converged, f"the orbit about {orbit.saddle}", orbit.status)
    with reporting(progress, f"sustained orbit about {orbit.saddle}") as report:
        return sustained(orbit, model_of(orbit.system).arms, limits=limits, progress=report)


@checked
def refine(found: Connection | ShadowingOrbit, *, energy: Decimal | Fraction | float | None = None) -> ExtendedOrbit:
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
    from dpcontrol.plans.model import ModelSystem, model_of
    from dpcontrol.shooting.extended import refine as refined
    from dpcontrol.tubes.connections import Connection

    source = found.source if isinstance(found, Connection) else found.connections[0].source
    exact = model_of(source.system).exact_parameters if isinstance(source.system, ModelSystem) else None
    height = Decimal(repr(float(source.energy if energy is None else energy)))
    if isinstance(energy, Decimal | Fraction):
        height = energy
    solution = found.solution if isinstance(found, Connection) else found.shot.solution
    return refined(solution, energy=height, parameters=exact)


@checked
def count_walks(graph: Edges, length: Count, *, source: str | None = None, target: str | None = None) -> int:
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
    from dpcontrol.walks.walks import count_walks as counted

    return counted(graph, length, source=source, target=target)


@checked
def list_walks(
    graph: Edges, length: Count, *, source: str | None = None, target: str | None = None, periodic: bool = False
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
    from dpcontrol.walks.walks import LISTED, all_walks, counted, is_closed

    total = count_walks(graph, length, source=source, target=target)
    if total > LISTED:
        raise InputError(
            f"length = {length}: there are {counted(total)} such walks, and {LISTED:,} can be listed; draw some"
        )
    chains = all_walks(graph, length, source=source, target=target)
    return tuple(tuple(c.name for c in chain) for chain in chains if not periodic or is_closed(chain))


@checked
def random_walks(
    graph: Edges,
    count: Count,
    *,
    lengths: tuple[Count, Count] = (1, 8),
    extra_wraps: tuple[Index, Index] = (0, 0),
    periodic: bool = False,
    seed: Seed = 0,
) -> tuple[WalkRequest, ...]:
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
    from dpcontrol.walks.walks import drawn_requests, walks_cost

    wraps = max(extra_wraps) * max(lengths)
    announce(walks_cost(count, symbols=max(lengths), wraps=wraps, solve=False, key=f"count = {count}"), yes=False)
    return tuple(
        drawn_requests(graph, count, lengths=lengths, extra=extra_wraps, seed=seed, periodic=periodic, leads=(2, 2))
    )


@checked
def shortest_walk(graph: Edges, stops: Sequence[str]) -> tuple[str, ...]:
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
    from dpcontrol.walks.walks import through

    return tuple(c.name for c in through(stops, graph))


@checked
def symbol_changes(
    model: Model | System | str, symbols: Sequence[str], *, energies: tuple[float, float], progress: Reporting = None
) -> tuple[SymbolChange, ...]:
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
    from dpcontrol.walks.following import symbol_changes as changes
    from dpcontrol.walks.symbols import parse_walk
    from dpcontrol.walks.walks import vertex_names

    if energies[0] == energies[1]:
        raise InputError(f"energies = {energies}: must be two different energies")
    system = _system(model)
    with reporting(progress, "symbols over energies") as report:
        return changes(system, parse_walk(symbols, vertex_names(system)), energies, progress=report)


@checked
def check_proof(file: Place, *, progress: Reporting = None) -> CertificateCheck:
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
    from dpcontrol.proofs.check import check_file

    part("flint")
    with reporting(progress, "check") as report:
        return check_file(Path(file), report)


@checked
def explore_energies(
    planned: Plan | str, *, picture: Place | None = None, progress: Reporting = None
) -> PrecisionChart:
    """Compare the effort of one walk over energies.

    Args:
        planned: plan, or name or path of an itinerary, with a single walk.
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
    from dpcontrol.bench.energies import energies_chart
    from dpcontrol.plans.itinerary import load_itinerary

    itinerary = load_itinerary(planned) if isinstance(planned, str) else planned.itinerary
    with reporting(progress, "energies") as report:
        chart = energies_chart(itinerary, report)
    if picture is not None:
        from dpcontrol.bench.drawing import save_chart

        save_chart(chart, Path(picture))
        chart = replace(chart, file=Path(picture))
    return chart


@checked
def rig_link(
    address: str = "udp", *, key_file: Place | None = None, insecure: bool = False, real_time: bool = False
) -> RigLink:
    """Return the link to a bench, for runs on it.

    Args:
        address: udp://HOST:PORT, or by default "udp" for an example bench in another process.
        key_file: file with the key that bench and loop share (default: the environment's DPCONTROL_RIG_KEY).
        insecure: accept a bench on another computer without a key (default: not).
        real_time: request priority over all ordinary work (default: not).

    Raises:
        InputError: the address is malformed, or the key is unreadable.

    Examples:
        >>> dp.rig_link("udp://127.0.0.1:47000").address
        'udp://127.0.0.1:47000'
    """
    from dpcontrol.runs.run import rig_link as linked

    found = linked(
        address, key_file=None if key_file is None else Path(key_file), insecure=insecure, real_time=real_time
    )
    assert found is not None
    return found


@checked
def start_bench(
    itinerary: str,
    *,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    hanging: bool = False,
    faults: Sequence[str] = (),
    at: BenchAddress | None = None,
    yes: bool = False,
    progress: Reporting = None,
) -> UdpBench:
    """Start an example bench in real time for loops over UDP.

    Args:
        itinerary: name or path of the itinerary whose arms and cart are simulated.
        seed: seed of the random numbers on the bench (default: 0).
        settings: settings of the bench by path, which override the itinerary's (see `closed_loop`).
        hanging: begin with hanging arms, for `commission` (default: those of the itinerary's start).
        faults: wiring mistakes for practice, such as "encoder-2-reversed" (default: none).
        at: host, port, key and watchdog (default: any free port of this computer).
        yes: accept any duration of planning.
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
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.runs.example_bench import BenchAddress, example_bench

    scene = load_itinerary(itinerary).with_run(_settings(settings), seed=seed)
    with reporting(progress, "rig") as report:
        where = BenchAddress() if at is None else at
        return example_bench(scene, where, hanging=hanging, faults=faults, notify=remark, yes=yes, progress=report)


@checked
def commission(
    itinerary: Plan | str,
    *,
    rig: Rig | RigLink | str | None = None,
    seed: Seed = 0,
    settings: Mapping[str, object] | None = None,
    faults: Sequence[str] = (),
    switches: NotNegative = 0.0,
    write: bool = False,
    progress: Reporting = None,
) -> Commissioning:
    """Check a rig before its first run, and measure its delay.

    Args:
        itinerary: plan, or name or path of an itinerary.
        rig: object with `read()`, `command(acceleration)` and `stop()`, address of a bench in real time, FILE.py:CLASS,
            or link of `rig_link` (default: the example bench in simulated time).
        seed: seed of the random numbers on the example bench (default: 0).
        settings: settings of the example bench by path, which override the itinerary's (see `closed_loop`).
        faults: wiring mistakes of the example bench (default: none).
        switches: distance in m to creep to either side until limit switches answer (default: 0, none).
        write: write measured values into the itinerary's [run] if nothing blocks (default: not).
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
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.runs.closed_loop import bench_of
    from dpcontrol.runs.run import OWN_BENCH, commission_rig, measured_text

    scene = load_itinerary(itinerary) if isinstance(itinerary, str) else itinerary.itinerary
    chosen, bench = _settings(settings), bench_of(rig)
    if getattr(bench, "address", bench) not in (None, OWN_BENCH) and (faults or chosen):
        raise InputError(f"rig = {rig}: faults and settings are those of the example bench; omit them")
    if write:
        # A file that cannot be changed is reported before the cart moves.
        measured_text(scene, {"delay": 1.0, "lag": 0.0, "zeros": [0.0], "counts": 1})
    with reporting(progress, "commission") as report:
        found = commission_rig(
            scene,
            bench,
            practice=scene.with_run(chosen, seed=seed),
            faults=faults,
            switches=switches,
            notify=lambda text: report(text, 0.0),
        )
    if write and found.changes:
        write_whole(*measured_text(scene, found.changes))
    return found


@checked
def repeat(log: Place, out: Place, *, force: bool = False, progress: Reporting = None) -> Repeat:
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
    from dpcontrol.runs.run import repeat_run

    with reporting(progress, "run") as report:
        return repeat_run(Path(log), Path(out), force=force, progress=report)


@checked
def open_night(folder: Place) -> Night:
    """Open the folder of a long run.

    Args:
        folder: folder that `ClosedLoop.night` or `dpcontrol run --hours` wrote.

    Returns:
        Uptime, falls and their causes, repetitions and drifts.

    Raises:
        InputError: the folder has no long run, or a file is damaged.

    Examples:
        >>> dp.open_night(night_folder).falls
        ()
    """
    from dpcontrol.judge.night import read_night

    return read_night(Path(folder))


@checked
def open_campaign(file: Place) -> CampaignSummary:
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
    from dpcontrol.judge.campaign import campaign_summary

    return campaign_summary(Path(file))


@checked
def compare_logs(logs: Sequence[Place], *, align: Count = 1) -> RunComparison:
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
    from dpcontrol.judge.comparison import compare
    from dpcontrol.judge.of_log import run_view
    from dpcontrol.logs import read_log

    return compare([run_view(read_log(Path(log))) for log in logs], symbol=align)


@checked
def score(logs: Place | Sequence[Place], *, why: bool = False, yes: bool = False, progress: Reporting = None) -> Scores:
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
    from dpcontrol.foundation.files import is_bag_folder
    from dpcontrol.judge.night import read_night
    from dpcontrol.judge.score import Scores

    paths = [Path(logs)] if isinstance(logs, str | Path) else [*map(Path, logs)]
    nights = [path for path in paths if path.is_dir() and not is_bag_folder(path)]
    if not nights:
        runs = [open_log(path) for path in paths]
        scores = tuple(run.score() for run in runs)
        return Scores(scores, tuple(run.why(yes=yes, progress=progress) for run in runs) if why else ())
    if why or len(nights) < len(paths):
        other = next((path for path in paths if path not in nights), None)
        what = "why tries single runs" if other is None else f"{other} is a single log"
        raise InputError(f"{nights[0]} is the folder of a long run, and {what}; score the folder alone")
    return Scores(tuple(map(read_night, nights)))


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
) -> Review:
    """Open a log in the Rerun viewer.

    It shows the arms with the reference as a ghost, the planned and the actual itinerary, angles, rates, command,
    errors, energy, and phase planes with the tubes. Recordings from the bench open too. Several logs open side by side,
    delayed so that all cross the section of symbol N at the same time. An atlas (.npz) opens as tubes, orbits and
    flights, with numbered connections on its cuts. A reference (.npz) opens as motion, command and limits.

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
    from dpcontrol.pages.picture import Review, opened, view_in_window
    from dpcontrol.pages.renderers import record

    if stretch is not None and film is None:
        raise InputError("stretch is given without film: give the film too")
    paths = [Path(files)] if isinstance(files, str | Path) else [*map(Path, files)]
    with reporting(progress, "review") as report:
        report("reading", 0.05)
        shown = opened(paths, symbol=align)
        recording = None if save is None else Path(save)
        report("recording", 0.2)
        if recording is not None:
            record(shown, recording)
        elif picture is None and film is None:
            recording = view_in_window(shown, paths[0].stem)
        if film is not None:
            from dpcontrol.pages.film import write_film

            write_film(shown, film, stretch=stretch, yes=yes, progress=report)
        if picture is not None:
            report("picture", 0.5)
            _save(render(shown), picture)
    aligned = getattr(shown, "status", None) if len(paths) > 1 else None
    return Review(tuple(paths), recording, None if film is None else Path(film), aligned)


@checked
def report(file: Place, *, page: Picture = None, margins: bool = False) -> Report:
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
    from dpcontrol.foundation.files import is_bag_folder
    from dpcontrol.judge.campaign import campaign_summary
    from dpcontrol.judge.night import read_night
    from dpcontrol.judge.of_log import run_view
    from dpcontrol.judge.score import Unscored, lacking
    from dpcontrol.pages.page import Report

    source = Path(file)
    # A folder may be named by "." alone.
    target = Path(page or source.parent / f"{source.stem or source.resolve().name}-report.png")
    of_night, of_campaign = source.is_dir() and not is_bag_folder(source), source.suffix.lower() == ".parquet"
    if margins and (of_night or of_campaign):
        remedy = "a log of the folder" if of_night else "a log, or use plan --margins"
        raise InputError(f"{file}: margins apply to one log; give {remedy}")
    if of_night or of_campaign:
        found = read_night(source) if of_night else campaign_summary(source)
        _save(render(found), target)
        return Report(found, target)
    run = open_log(source)
    borne = run.margins() if margins else None
    view = run_view(run.log)
    _save(render(view), target)
    return Report(Unscored(str(source), view.verdict) if lacking(run.log) else run.score(), target, borne)


@checked
def log_summary(file: Place) -> LogSummary:
    """Show a log's topics, types, rates, duration, metadata and attachments.

    Topics also have units and counts.

    All checksums are verified. A truncated or damaged log is rejected, and the message suggests a remedy.

    Args:
        file: log.

    Returns:
        Topics with types, units and rates (Hz), duration (s), metadata and attachments.

    Raises:
        InputError: the file is missing, cut, damaged or not a log.

    Examples:
        >>> dp.log_summary(log).joints
        ('arm_1', 'arm_2', 'cart')
    """
    from dpcontrol.logs import summarise

    return summarise(Path(file))


@checked
def recover_log(
    file: Place,
    out: Annotated[Path | str | None, Output((".mcap",))] = None,
    *,
    force: bool = False,
    progress: Reporting = None,
) -> Recovery:
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
    from dpcontrol.logs import recover

    with reporting(progress, "recover") as report:
        return recover(Path(file), None if out is None else Path(out), force=force, progress=report)


@checked
def import_recording(
    file: Place | None = None,
    *,
    mapping: str | None = None,
    model: Model | str | None = None,
    repairs: Sequence[str] = (),
    simulated: Model | str | None = None,
    swings: int = 9,
    seconds: float = 2.667,
    seed: Seed = 0,
    out: NewLog = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> ImportedRecording:
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
    from dpcontrol.recordings.checks import constant_angles, contradiction
    from dpcontrol.recordings.importing import import_recording as imported
    from dpcontrol.recordings.recording import ImportedRecording, random_swings, swings_cost
    from dpcontrol.recordings.recording import write_recording as written

    if (file is None) == (simulated is None):
        found = "missing" if file is None else "given"
        raise InputError(f"file and simulated are both {found}: give a file, or the model of simulated swings")
    own = None if model is None else _model(model)
    with reporting(progress, "import") as report:
        if simulated is None:
            recording = imported(Path(str(file)), mapping, repairs=list(repairs), progress=report)
        else:
            announce(swings_cost(swings, seconds, written=out is not None), yes=yes)
            swung, name = _model(simulated), f"{_model(simulated).name}-swings-{seed}"
            recording = random_swings(swung.arms, swings=swings, seconds=seconds, seed=seed, name=name)
        report("writing", 0.7)
        log = _new_log(out, f"{recording.name}.mcap", lambda place: written(recording, place, force=force))
    against = "" if own is None else contradiction(recording, own.arms, model=own.name)
    remarks, source = (*constant_angles(recording), *filter(None, [against])), str(file or recording.source)
    for sentence in remarks:
        remark(f"{source}: {sentence}")
    return ImportedRecording(recording, source, log, remarks)


@checked
def write_recording(recording: Recording, file: Place, *, force: bool = False) -> Path:
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
    from dpcontrol.recordings.recording import write_recording as written

    return written(recording, Path(file), force=force)


@checked
def design_experiments(model: Model | str, *, picture: Picture = None, progress: Reporting = None) -> Design:
    """Compare swings by their information on the model's parameters.

    Args:
        model: model of arms.
        picture: picture of the result (default: none).
        progress: reports, see `dpcontrol.api`.

    Returns:
        Experiments by information, and the best pair.

    Raises:
        InputError: the model has no arms, or no experiment is usable.

    Examples:
        >>> len(dp.design_experiments(lab).best_pair())
        2
    """
    from dpcontrol.identification.fit import design_experiments as designed

    model = _model(model)
    with reporting(progress, "design") as report:
        found = designed(model.arms, progress=report)
    if picture is not None:
        from dpcontrol.pages.experiments import draw_design

        _save(draw_design(found, title=model.title), picture)
    return found


@checked
def replay(
    recording: Recording | Place,
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
) -> Replay:
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
    from dpcontrol.identification.replay import ReplaySettings, filter_settings, replay_recording, write_replay
    from dpcontrol.recordings.checks import contradiction

    settings = ReplaySettings(counts=counts, mean_over=mean_over, ahead=ahead, span=span)
    model, filters = _model(model), filter_settings(estimator, model_error=model_error)
    name, recording = _recording(recording)
    with reporting(progress, "replay") as report:
        found = replay_recording(recording, model.arms, filters, settings, zeros=model.encoder_zeros, progress=report)
        log = _new_log(
            out,
            f"{Path(name).stem}-replay.mcap",
            lambda place: write_replay(found, place, model=model.name, model_text=model.text, force=force),
        )
    if against := contradiction(recording, model.arms, model=model.name):
        remark(f"{name}: {against}")
    return replace(found, model=model.name, estimator=estimator, log=log)


@checked
def draw_figures(
    names: Sequence[str] = (),
    *,
    folder: Annotated[Place, Output(folder=True)] = "figures",
    progress: Reporting = None,
) -> DrawnFigures:
    """Draw the computational figures of the paper, each a PNG with a caption and the differences.

    Names: energy-landscape, three-body-homoclinics, three-body, lyapunov-orbits, families, tubes, tubes-down-up, cuts,
    colour-wheels, tubes-up-down, colour-wheels-up-down, homoclinics-low, homoclinics-high, heteroclinics,
    heteroclinic-orbits, branches, graph, shadowing, double-homoclinics, triple-homoclinics, returning-homoclinics,
    up-up. Without a name, all are drawn. Atlases are cached by content.

    Args:
        names: figures, such as "tubes" (default: all).
        folder: folder for the pictures and captions.json (default: figures).
        progress: reports, see `dpcontrol.api`.

    Returns:
        For each figure its file, its caption, and its difference from the paper's.

    Raises:
        InputError: an unknown figure, or the folder is not writable.

    Examples:
        >>> [one.name for one in dp.draw_figures(["energy-landscape"], folder=log.parent)]
        ['energy-landscape']
    """
    with reporting(progress, "figures") as report:
        report("loading", 0.0)
        from dpcontrol.pages.figures import draw_figures as drawn
        from dpcontrol.pages.gallery import cached_gallery

        return drawn(names, cached_gallery(), Path(folder), progress=report)


@checked
def draw_charts(
    names: Sequence[str] = (),
    *,
    folder: Annotated[Place, Output(folder=True)] = "charts",
    quick: bool = False,
    strict: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> DrawnCharts:
    """Chart speed against accuracy of numerical methods, and map their failures.

    Charts: propagation, connections, transcription, estimation, control. Times are medians on one core without
    start-up, and a ring marks the default of dpcontrol.

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
    with reporting(progress, "bench") as report:
        report("loading", 0.0)
        from dpcontrol.bench.run import draw_charts as drawn

        return replace(drawn(names, Path(folder), quick=quick, yes=yes, progress=report), strict=strict)


@checked
def read_guide(topic: str | None = None) -> Page:
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
    from dpcontrol.foundation.guide import page

    return page(topic)


@checked
def describe(model: Model | str, *, mjcf: Annotated[Path | str | None, Output((".xml",))] = None) -> ModelDescription:
    """Show a model's parameters with units, and its equilibria.

    Equilibria are frictionless, with the pivot at rest.

    Args:
        model: model, or its name or path.
        mjcf: MuJoCo model to write, with arms and cart (default: none).

    Returns:
        Parameters, sources and equilibria.

    Raises:
        InputError: no such model, or a mistake in its file.

    Examples:
        >>> dp.describe("lab").equilibria["up-up"].kind
        'index-2 saddle'
    """
    from dpcontrol.dynamics.mjcf import mjcf_text
    from dpcontrol.orbits.lyapunov import equilibria as found_in
    from dpcontrol.plans.model import ModelDescription

    loaded = _model(model)
    if mjcf is not None:
        write_whole(Path(mjcf), mjcf_text(loaded.arms, name=loaded.name, cart_mass=20.0, lag=0.002))
    return ModelDescription(loaded, found_in(loaded.system), None if mjcf is None else Path(mjcf))


@checked
def demo(
    itinerary: Place = "outer-turn",
    *,
    seed: Seed = 0,
    folder: Annotated[Place, Output(folder=True)] = "logs",
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> Demonstration:
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
    from time import perf_counter

    from dpcontrol.foundation.files import free_name
    from dpcontrol.judge.of_log import run_view
    from dpcontrol.pages.rerun_recording import write_recording
    from dpcontrol.runs.run import Demonstration

    began = perf_counter()
    with reporting(progress, "demo") as report:
        planned = plan(itinerary, yes=yes, progress=part_of(report, 0.05, 0.5))
        step, name = part_of(report, 0.5, 0.75), f"{planned.itinerary.name}-{seed}.mcap"
        with free_name(
            Path(folder) / name, lambda log: run(planned, seed=seed, log=log, force=force, progress=step)
        ) as done:
            view, file = run_view(done.log), done.log.path
            recording = file.with_suffix(".rrd") if installed("rerun") else None
            if recording is not None:
                write_recording(view, recording)
            report("picture", 0.85)
            picture = file.with_suffix(".png")
            _save(render(view), picture)
    return Demonstration(planned, file, done.score(), recording, picture, perf_counter() - began)


def _recording(given: Recording | Place) -> tuple[str, Recording]:
    """Return a recording with its name: that of its file, if it is given by one."""
    from dpcontrol.recordings.recording import load_recording

    return (str(given), load_recording(given)) if isinstance(given, str | Path) else (given.name, given)


def _new_log(out: Place | Literal[True] | None, name: str, write: Callable[[Path], Path]) -> Path | None:
    """Write a log to a file, or to the first free name in the folder of logs."""
    from dpcontrol.foundation.config import log_folder
    from dpcontrol.foundation.files import free_name

    if out is True:
        with free_name(log_folder() / name, write) as log:
            return log
    return None if out is None else write(Path(out))


def _save(figure: Figure, file: Place) -> None:
    from dpcontrol.pages.layout import save_figure

    save_figure(figure, file)


def _model(model: Model | str) -> Model:
    from dpcontrol.plans.model import load_model

    return load_model(model) if isinstance(model, str) else model


def _system(model: Model | System | str) -> System:
    from dpcontrol.dynamics.system import System

    return model if isinstance(model, System) else _model(model).system


def _found(converged: bool, what: str, status: str) -> None:
    if not converged:
        raise GoalMissed(f"{what}: {status}")


def _same_level(system: System, energy: float, other: System, other_energy: float) -> None:
    system.check_same(other)
    if energy != other_energy:
        raise InputError(f"the results are of different energies, {energy:g} and {other_energy:g}; use one")


def _edges(searches: Sequence[ConnectionSearch]) -> Edges:
    """Return the part of the graph that some searches found."""
    from dpcontrol.walks.edges import Edges

    if not searches:
        raise InputError("found = []: give a graph, or one search for connections at least")
    first = searches[0].source
    for one in searches:
        first.system.check_same(one.source.system)
    if len({one.energy for search in searches for one in (search.source, search.target)}) > 1:
        raise InputError("the connections are of different energies: a walk keeps one")
    return Edges(
        system=first.system,
        energy=first.energy,
        orbits={one.saddle: one for search in searches for one in (search.source, search.target)},
        absent=(),
        searched=tuple((search.source.saddle, search.target.saddle) for search in searches),
        connections=tuple(one for search in searches for one in search.connections),
        incomplete=(),
    )


def _closed(planned: Plan | str, settings: Mapping[str, Any], *, yes: bool, progress: Reporting) -> ClosedLoop:
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.runs.closed_loop import ClosedLoop

    if isinstance(planned, str):
        # A wrong setting is reported before the plan is computed.
        load_itinerary(planned).with_run(settings)
    return ClosedLoop(plan(planned, yes=yes, progress=progress) if isinstance(planned, str) else planned, settings)


def _settings(settings: Mapping[str, object] | None, **named: object) -> dict[str, Any]:
    """Return settings by path: those of the mapping and of arguments by name."""
    from dpcontrol.plans.overrides import canonical

    if isinstance(named.get("plant"), Path):
        named["plant"] = str(named["plant"])
    return {**canonical(settings or {}), **canonical(named)}
