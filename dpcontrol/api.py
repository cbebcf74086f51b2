"""The functions of `import dpcontrol as dp`: from a model to runs that are scored, as values in memory.

    lab = dp.load_model("lab")
    orbit = dp.orbit(lab, "down-up", energy=-0.07)
    walk = dp.shadow(dp.connections(orbit), ["down-up +"])
    run = dp.run(dp.reference(walk, limits=dp.Limits(position=0.4)), mismatch=0.02, seed=3)
    print(run.score().sentence)

Bad input is an `InputError`; a result that a step needs and that was not found is a `GoalMissed`. A search
that fails says so in its result, by `converged` and `status`. Long calls take `progress`: a function of a
text and a share from 0 to 1, or True for a bar on stderr. Without it a line is written to stderr every twenty seconds.
"""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, overload

from dpcontrol.control.symbolic import SymbolicLaw as SymbolicLaw
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.components import Sizes as Sizes
from dpcontrol.dynamics.components import SymbolicPlant as SymbolicPlant
from dpcontrol.dynamics.components import Terms as Terms
from dpcontrol.dynamics.mjcf import CART_MASS, LAG, mjcf_text
from dpcontrol.dynamics.propagator import Section as Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.checked import Bounds, Count, Hit, Index, Positive, Seed, Workers, checked
from dpcontrol.foundation.errors import GoalMissed, InputError, remark
from dpcontrol.foundation.progress import Cost, Reporting, announce, part_of, reporting
from dpcontrol.plans.model import Model, ModelSystem, model_of
from dpcontrol.plans.model import load_model as load_model
from dpcontrol.plans.run_options import RunOptions
from dpcontrol.references.problem import Limits, ReferenceSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dpcontrol.bifurcations.bifurcations import BifurcationSearch
    from dpcontrol.control.export import ControllerSource
    from dpcontrol.foundation.cache import CacheContents
    from dpcontrol.identification.identify import Identification
    from dpcontrol.orbits.lyapunov import LyapunovOrbit
    from dpcontrol.planner.server import Planner
    from dpcontrol.plans.plan import Plan
    from dpcontrol.proofs.prove import Proof, ProofSettings
    from dpcontrol.recordings.recording import Recording
    from dpcontrol.runs.campaign import Campaign
    from dpcontrol.runs.closed_loop import ClosedLoop
    from dpcontrol.runs.polish import Polished
    from dpcontrol.runs.run import Run
    from dpcontrol.tubes.connections import ConnectionSearch
    from dpcontrol.tubes.symmetric import SymmetricSearch
    from dpcontrol.walks.atlas import Atlas
    from dpcontrol.walks.edges import Edges
    from dpcontrol.walks.shadowing import ShadowingOrbit

Place = Path | str
_SWEPT, _SWEPT_BYTES = 2.0, 1e6
"""What each energy of a sweep for bifurcations takes, in s and bytes, for each crossing of the section."""


@checked
def orbit(model: Model | System | str, saddle: str, *, energy: float, family: Index = 0) -> "LyapunovOrbit":
    """Return the Lyapunov orbit about a saddle, such as "down-up", at `energy` in J, zero at the pivot's height.

    >>> dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07).period
    0.75238...

    Raises:
        InputError: an unknown saddle or family, or an energy on the wrong side of the saddle's.
    """
    from dpcontrol.orbits.lyapunov import lyapunov_orbit

    return lyapunov_orbit(_system(model), saddle, energy=energy, family=family)


@overload
def connections(
    source: "LyapunovOrbit",
    target: "LyapunovOrbit | None" = None,
    *,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> "ConnectionSearch": ...
@overload
def connections(
    source: "LyapunovOrbit",
    *,
    energies: tuple[float, float],
    hits: tuple[Hit, Hit] = (1, 1),
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> "SymmetricSearch": ...
@checked
def connections(
    source: "LyapunovOrbit",
    target: "LyapunovOrbit | None" = None,
    *,
    energies: tuple[float, float] | None = None,
    hits: tuple[Hit, Hit] = (1, 1),
    section: str | None = None,
    longest: Positive | None = None,
    thorough: bool = False,
    seconds: Positive | None = None,
    progress: Reporting = None,
) -> "ConnectionSearch | SymmetricSearch":
    """Find every connection from one orbit to another of the same energy, or back to itself where there is no other.

    hits: which crossings of the section count, of the unstable and the stable tube. section: by its short name, the
    saddles' own by default. longest: time that trajectories are given to the section, in periods of their orbit.
    thorough: go on where a search says "at least", for up to a minute. seconds: of processor time that the search may
    take, a minute by default; when they are over, what was found is returned and marked `partial`.

    energies: of three arms, whose orbits have connections at isolated energies only, the range in J in which the
    source's family is searched for symmetric ones.

    >>> len(dp.connections(orbit).connections)
    8

    Raises:
        InputError: the orbits differ in energy, or there is no such section between their saddles; three arms without
            `energies`, or two with them.
        GoalMissed: an orbit did not converge.
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
) -> "Edges":
    """Find the connection graph of an energy in J: the orbits of all saddles, and the connections between them.

    symbols: of a walk that asks for connections on other sections or at other hits, or for rotating orbits.

    >>> dp.graph(lab, energy=-0.07).saddles
    ('down-up',)

    Raises:
        InputError: no saddle has an orbit at this energy, or a symbol names what there is not.
    """
    from dpcontrol.walks.edges import find_edges
    from dpcontrol.walks.symbols import parse_walk
    from dpcontrol.walks.walks import vertex_names

    system = _system(model)
    asked = parse_walk(symbols, vertex_names(system)) if symbols else ()
    with reporting(progress, "connections") as report:
        return find_edges(system, energy, symbols=asked, progress=report)


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
) -> "BifurcationSearch":
    """Find the energies in J at which connections between two saddles appear, vanish or split.

    samples: energies that are searched at first. yes: however long that takes.

    >>> dp.find_bifurcations(lab, "down-up", "down-up", energies=(-0.08, -0.06), samples=2).events
    ()

    Raises:
        InputError: saddles or energies between which nothing can be swept.
    """
    from dpcontrol.bifurcations.bifurcations import SweepSettings
    from dpcontrol.bifurcations.bifurcations import find_bifurcations as find

    cost = Cost(f"{samples:,} energies", _SWEPT * samples * hits, _SWEPT_BYTES * samples, f"samples = {samples}")
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
) -> "Atlas":
    """Return the atlas of an energy in J: every orbit, tube and connection; kept by content unless `fresh`.

    hits: of the unstable and the stable tube; by default the first at which they meet, up to the second. thorough: go
    on where a search says "at least", for up to a minute each. seconds: of processor time that each search may take, a
    minute by default; an atlas that is partial for lack of time is not kept. yes: however long all that takes.

    >>> len(dp.atlas(lab, energy=-0.07).connections)
    8

    Raises:
        InputError: no saddle has an orbit at this energy.
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
    found: "Edges | ConnectionSearch | Sequence[ConnectionSearch] | SymmetricSearch",
    walk: Sequence[str],
    *,
    wraps: Sequence[Index] | None = None,
    lead_in: Index = 2,
    lead_out: Index = 2,
    periodic: bool = False,
    yes: bool = False,
) -> "ShadowingOrbit":
    """Return the orbit that follows a walk: symbols such as "down-up +", "down-up > up-down" or a connection's name.

    found: the graph, or searches for connections, that the symbols choose from. wraps: wobbles at each interior stop,
    the fewest that suffice by default; lead_in, lead_out: those on the first and the last orbit. periodic: the walk
    closes, with one more stop. Of three arms a walk is one symbol, the connection itself. yes: however long it takes.

    >>> dp.shadow(found, ["down-up +"]).converged
    True

    Raises:
        InputError: a symbol that no connection fits, or wraps that do not fit the walk.
        GoalMissed: no number of wraps suffices.
    """
    from dpcontrol.tubes.connections import ConnectionSearch
    from dpcontrol.tubes.symmetric import SymmetricSearch
    from dpcontrol.walks.edges import Edges
    from dpcontrol.walks.shadowing import WalkSolver
    from dpcontrol.walks.walks import resolve, symmetric_walk, walks_cost

    if isinstance(found, SymmetricSearch):
        return symmetric_walk(walk, found, lead_in=lead_in, lead_out=lead_out)
    searches = [found] if isinstance(found, ConnectionSearch) else found
    edges = searches if isinstance(searches, Edges) else _edges(searches)
    solver = WalkSolver(edges.known)
    key = "wraps" if wraps else "walk"
    announce(walks_cost(1, symbols=len(walk), wraps=sum(wraps or ()), solve=True, key=key), yes=yes)
    chain = resolve(walk, edges)
    counts = solver.least(chain, periodic=periodic) if wraps is None else tuple(wraps)
    return solver.solve(chain, counts, periodic=periodic, lead_in=lead_in, lead_out=lead_out)


@checked
def prove(
    found: "LyapunovOrbit | ShadowingOrbit | ConnectionSearch",
    *,
    energy: Decimal | Fraction | float | None = None,
    rivals: "Edges | None" = None,
    settings: "ProofSettings | None" = None,
    progress: Reporting = None,
) -> "Proof":
    """Prove in ball arithmetic that a computed orbit, closed walk or connections exist; needs the extra `proof`.

    Homoclinics of one orbit are proved together with the horseshoe that they make. energy in J, exact; by default the
    shortest decimal that reads as the orbit's. rivals: the graph whose other connections the walk must not follow.

    >>> dp.prove(dp.orbit(lab, "down-up", energy=-0.07)).proved
    True

    Raises:
        InputError: an open walk, or a system that cannot be enclosed.
        GoalMissed: the orbit did not converge.
        PartMissing: python-flint is not installed.
    """
    from dpcontrol.foundation.parts import part

    part("flint")
    from dpcontrol.orbits.lyapunov import LyapunovOrbit
    from dpcontrol.proofs.prove import exact_energy, prove_connections, prove_orbit, prove_walk
    from dpcontrol.walks.shadowing import ShadowingOrbit

    own = found if isinstance(found, LyapunovOrbit) else found.connections[0].source
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
    walks: "ShadowingOrbit | Sequence[ShadowingOrbit]",
    *,
    limits: Limits | None = None,
    settings: ReferenceSettings | None = None,
    start: Literal["orbit", "rest"] = "orbit",
    finish: Literal["orbit", "rest"] = "orbit",
    name: str = "walk",
    yes: bool = False,
    progress: Reporting = None,
) -> "Plan":
    """Return the plan of following walks, one after the other, with the model's friction and cart within its limits.

    start, finish: on the periodic orbit, or hanging at rest. What was planned before comes from the cache.
    yes: however long it takes.

    >>> dp.reference(walk, limits=dp.Limits(position=0.4)).converged
    True

    Raises:
        InputError: a walk is of a system without arms, is periodic, or an end cannot be reached.
        GoalMissed: a walk's orbit did not converge, or there is no transfer between two of them.
    """
    from dpcontrol.plans.itinerary import WalkPart, itinerary_of
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
        limits=limits or Limits(),
        reference=settings or ReferenceSettings(),
    )
    with reporting(progress, "reference") as report:
        return make_plan(scene, orbits=orbits, progress=report, yes=yes)


@checked
def plan(
    itinerary: Place,
    *,
    fresh: bool = False,
    workers: Workers = 1,
    scheduler: str = "",
    yes: bool = False,
    progress: Reporting = None,
) -> "Plan":
    """Return the plan of an itinerary's file, by name or path, from the cache unless `fresh`.

    workers: processes that seek its transfers, 0 for as many as are worth it; scheduler: address of a Dask cluster in
    their place. yes: however long it takes.

    >>> dp.plan("outer-turn").itinerary.walk
    ('down-up +',)

    Raises:
        InputError: no such file, a mistake in it, or connections that do not exist at its energy.
        GoalMissed: an orbit did not converge, or there is no transfer.
    """
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.plans.plan import make_plan

    with reporting(progress, "plan") as report:
        return make_plan(
            load_itinerary(str(itinerary)), progress=report, fresh=fresh, workers=workers, scheduler=scheduler, yes=yes
        )


@checked
def closed_loop(
    planned: "Plan | str",
    *,
    options: RunOptions | None = None,
    yes: bool = False,
    progress: Reporting = None,
    **settings: object,
) -> "ClosedLoop":
    """Return the closed loop of a plan, or of an itinerary by name: one object that runs, counts, measures and exports.

    options, settings: run settings that take the place of the scene's, by name; settings come last. controller,
    estimator and plant may be objects of your own (`dpcontrol guide extend`). yes: however long its plan takes.

    >>> dp.closed_loop("outer-turn", mismatch=0.02).run(seed=3).converged
    True

    Raises:
        InputError: an unknown or impossible setting, or the plan would take too long.
        GoalMissed: an orbit did not converge, or there is no transfer.
    """
    with reporting(progress, "plan") as report:
        return _closed(planned, _options(options).over(settings), yes=yes, progress=report)


@checked
def mjcf(
    model: Model | ArmChainParameters | str, *, cart_mass: float = CART_MASS, lag: float = LAG, out: Place | None = None
) -> str:
    """Return the arms of a model on their cart as a model for MuJoCo.

    Args:
        model: a model, or its arms.
        cart_mass: mass of the cart, kg.
        lag: time constant of the servo that drives it, s; its control is the cart's velocity, m/s.
        out: file to write the text to.

    >>> dp.mjcf(dp.load_model("lab")).startswith("<mujoco")
    True

    Raises:
        InputError: the model has no arms, or quadratic friction; a mass or lag that is not positive.
    """
    from dpcontrol.foundation.files import write_whole

    arms = model if isinstance(model, ArmChainParameters) else _model(model).arms
    text = mjcf_text(arms, name="arms", cart_mass=cart_mass, lag=lag)
    if out is not None:
        write_whole(Path(out), text)
    return text


@checked
def polish(
    planned: "Plan | str",
    *,
    fresh: bool = False,
    runs: Count = 48,
    workers: Workers = 0,
    yes: bool = False,
    progress: Reporting = None,
) -> "Polished":
    """Return a plan from rest to rest, or that of an itinerary by name, beside its motion re-optimised as a whole.

    The polished plan keeps crossings, windings and wraps for a fraction of the effort, and need not come near the
    orbits: `sides` has what each takes, and how many of `runs` complete it at a mismatch of 5 and of 20 %. workers:
    processes that fly them, 0 for one on each processor. yes: however long it takes.

    >>> found = dp.polish("one-arm", runs=8)
    >>> [side.name for side in found.sides]
    ['robust', 'polished']
    >>> found.sides[1].effort < found.sides[0].effort
    True

    Raises:
        InputError: the plan is not from rest to rest, or polished already, or it would take too long.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    from dpcontrol.runs.polish import polish as polish_plan

    with reporting(progress, "polish") as report:
        found = plan(planned, yes=yes, progress=part_of(report, 0.0, 0.2)) if isinstance(planned, str) else planned
        return polish_plan(found, fresh=fresh, runs=runs, workers=workers, yes=yes, progress=part_of(report, 0.2, 1.0))


@checked
def run(
    planned: "Plan | str",
    *,
    mismatch: float | None = None,
    plant: Place | None = None,
    seed: Seed = 0,
    options: RunOptions | None = None,
    log: Place | None = None,
    force: bool = False,
    live: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> "Run":
    """Run the closed loop of a plan, or of an itinerary by name, on the simulated bench.

    Args:
        planned: a plan, or an itinerary's name.
        mismatch: largest relative error of the plant's parameters.
        plant: model file or name, for a plant with arms of its own.
        seed: seed of the random numbers.
        options: settings that replace the scene's.
        log: file to write the run's log to.
        force: replace the log of another run there.
        live: show the run in the viewer while it happens.
        yes: plan it however long that takes.
        progress: where progress goes; see the head of this module.

    >>> dp.run("outer-turn", mismatch=0.02, seed=3).converged
    True

    Raises:
        InputError: an impossible setting, the plan would take too long, the log cannot be written, or there is no
            display for a live view.
        GoalMissed: there is no reference to follow, or no controller can be made for it.
    """
    chosen = _options(options, mismatch, plant)
    with reporting(progress, "run") as report:
        loop = _closed(planned, chosen, yes=yes, progress=part_of(report, 0.0, 0.5))
        return loop.run(seed=seed, log=log, force=force, live=live, progress=part_of(report, 0.5, 1.0))


@checked
def export(
    planned: "Plan | str",
    folder: Place | None = None,
    *,
    single: bool = False,
    options: RunOptions | None = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> "ControllerSource":
    """Return the controller of a plan, or of an itinerary by name, as C99, and write it to `folder` if one is given.

    single: in single precision; options: settings of the run that take the place of the scene's. force: replace files
    of the same names in a folder that is there. yes: however long its plan takes.

    >>> sorted(dp.export("outer-turn", single=True).files)[:2]
    ['CMakeLists.txt', 'Makefile']

    Raises:
        InputError: the law or the estimator cannot leave as C, or the folder holds something else.
        GoalMissed: there is no reference to follow, or no controller can be made for it.
    """
    with reporting(progress, "export") as report:
        loop = _closed(planned, _options(options), yes=yes, progress=part_of(report, 0.0, 0.5))
        return loop.export(folder, single=single, force=force, progress=part_of(report, 0.5, 1.0))


@checked
def campaign(
    planned: "Plan | str",
    *,
    runs: Count = 100,
    mismatch: float | None = None,
    plant: Place | None = None,
    options: RunOptions | None = None,
    over: Mapping[str, object] | None = None,
    first_seed: Seed = 0,
    transitions: bool = False,
    workers: Workers = 0,
    out: Place | None = None,
    force: bool = False,
    yes: bool = False,
    progress: Reporting = None,
) -> "Campaign":
    """Run a plan, or an itinerary by name, with many seeds, and count how often it is completed.

    mismatch, plant, options: see `run`; over: values of options that are varied by name, each combination a case of
    `runs` seeds from `first_seed` on. transitions: each transfer from hold to hold alone. workers: processes, 0 for one
    on each processor. out: the Parquet file to write the rows to, if any; force: also where there is that of another
    campaign. yes: however long it takes.

    >>> dp.campaign("outer-turn", runs=4, mismatch=0.02).completed.rate
    1.0

    Raises:
        InputError: an unknown option or impossible value, or the file cannot be written.
        GoalMissed: there is no reference to follow, or workers died again and again.
    """
    from dpcontrol.runs.campaign import CampaignSettings

    settings = CampaignSettings(runs=runs, first_seed=first_seed, workers=workers)
    with reporting(progress, "campaign") as report:
        loop = _closed(planned, _options(options, mismatch, plant), yes=yes, progress=part_of(report, 0.0, 0.1))
        return loop.campaign(
            over=over, settings=settings, transitions=transitions, out=out, force=force, yes=yes,
            progress=part_of(report, 0.1, 1.0),
        )  # fmt: skip


@checked
def swings(
    model: Model | str, *, count: Count = 9, seconds: Positive = 2.667, seed: Seed = 0, yes: bool = False
) -> "Recording":
    """Return free swings of a model as a bench's encoders would record them, to try `identify` on.

    yes: however long it takes.

    >>> dp.swings(lab, count=2).arms
    2

    Raises:
        InputError: the model has no arms, there are to be no swings or of no time, or it would take too long.
    """
    from dpcontrol.recordings.recording import random_swings, swings_cost

    model = _model(model)
    announce(swings_cost(count, seconds, written=False), yes=yes)
    return random_swings(model.arms, swings=count, seconds=seconds, seed=seed, name=f"{model.name}-swings-{seed}")


@checked
def identify(
    recordings: "Recording | Sequence[Recording]",
    *,
    model: Model | str,
    zeros: bool | None = None,
    out: Place | None = None,
    progress: Reporting = None,
) -> "Identification":
    """Identify arms from recordings of free swings: inertia ratios, friction laws, encoder zeros.

    model: to start from; a recording that contradicts it is remarked on. zeros: whether the encoders' zeros are fitted,
    by the segments left out by default. out: the model file to write, for `load_model`, if any.

    >>> dp.identify(dp.swings(lab, count=3, seconds=1.5), model=lab).friction_terms
    ('viscous',)

    Raises:
        InputError: recordings that do not fit the model or hold too little, or the file cannot be written.
    """
    from dpcontrol.identification.identify import IdentificationSettings
    from dpcontrol.identification.identify import identify as found_in
    from dpcontrol.plans.model import write_model
    from dpcontrol.recordings.checks import contradiction
    from dpcontrol.recordings.recording import Recording

    given, model = [recordings] if isinstance(recordings, Recording) else [*recordings], _model(model)
    choice = {None: "chosen", True: "free", False: "none"}[zeros]
    with reporting(progress, "identify") as report:
        found = found_in(given, model.arms, settings=IdentificationSettings(zeros=choice), progress=report)
    for one in given:
        if against := contradiction(one, model.arms, model=model.name):
            remark(f"{one.name}: {against}")
    if out is not None:
        names = [one.name for one in given]
        title = f"{model.title}, identified from {', '.join(names)}"
        write_model(found, Path(out), title=title, logs=names, starting_model=model.name)
    return found


@checked
def open_log(file: Place) -> "Run":
    """Open the log of a run, or of a bench.

    >>> dp.open_log(log).score().completed
    True

    Raises:
        InputError: the file is missing, damaged or no log.
    """
    from dpcontrol.logs import read_log
    from dpcontrol.runs.run import Run

    return Run(read_log(file))


@checked
def open_plan(file: Place) -> "Plan":
    """Open a plan's file, as `dpcontrol plan --out` writes it and every log carries it.

    >>> dp.open_plan(planned.file).status == planned.status
    True

    Raises:
        InputError: the file is missing, damaged or no plan.
    """
    from dpcontrol.plans.plan import load_plan

    return load_plan(Path(file))


@checked
def open_atlas(file: Place) -> "Atlas":
    """Open an atlas that `dpcontrol atlas --out` wrote.

    >>> dp.open_atlas(atlas_file).energy
    -0.07

    Raises:
        InputError: the file is missing, damaged or no atlas.
    """
    from dpcontrol.plans.atlas import load_atlas

    return load_atlas(Path(file))


@checked
def open_planner(model: str = "lab", *, browser: bool = True, port: Annotated[int, Bounds(0, 65535)] = 0) -> "Planner":
    """Start the planner, a page in the browser from energy to run, and return it; it serves until it is closed.

    model: of two arms, by name or path. browser: open it; else only `address` is there to open. port: on 127.0.0.1, 0
    for any that is free.

    >>> with dp.open_planner("lab", browser=False) as planner:
    ...     planner.address
    'http://127.0.0.1:...'

    Raises:
        InputError: the model cannot be used, or the port is taken.
        PartMissing: the extra `planner` is not installed.
    """
    from dpcontrol.planner.server import Planner

    planner = Planner(model, port=port)
    if browser:
        planner.open()
    return planner


@checked
def open_recording(
    file: Place, *, mapping: str | None = None, repairs: Sequence[str] = (), progress: Reporting = None
) -> "Recording":
    """Open a recording of the bench: a log, or MATLAB, CSV, Parquet, MCAP or a ROS bag by a mapping of its columns.

    repairs: what may be mended, of nan, time, gaps, wrap, spikes and sampling.

    >>> dp.open_recording(log).arms
    2

    Raises:
        InputError: the file is missing or damaged, does not fit the mapping, or needs a repair that is not allowed.
    """
    from dpcontrol.recordings.importing import import_recording
    from dpcontrol.recordings.recording import load_recording

    path = Path(file)
    if path.suffix.lower() == ".mcap" and mapping is None:
        return load_recording(path)
    with reporting(progress, "import") as report:
        return import_recording(path, mapping, repairs=list(repairs), progress=report)


@checked
def picture(
    result: "Run | Plan | ShadowingOrbit | Atlas",
    *,
    transitions: bool = False,
    file: Place | None = None,
    film: Place | None = None,
) -> "Figure":
    """Draw a run, a plan, a walk's orbit or an atlas as a figure of matplotlib.

    transitions: of a plan, its transfers between equilibria instead, each in a picture of its own. file: the PNG or PDF
    to write as well, if any. film: the GIF, WebP or MP4, which shows the motion in real time.

    >>> len(dp.picture(walk).axes) > 1
    True

    Raises:
        InputError: a file cannot be written; a film is of an atlas, or of a system without arms; transitions are asked
            of what has none.
    """
    from dpcontrol.judge.of_log import reference_view, run_view
    from dpcontrol.pages.atlas import draw_atlas
    from dpcontrol.pages.layout import save_figure
    from dpcontrol.pages.page import draw
    from dpcontrol.pages.walks import WalkStory, draw_walk
    from dpcontrol.plans.plan import Plan
    from dpcontrol.references.reference import summarised
    from dpcontrol.runs.run import Run
    from dpcontrol.walks.atlas import Atlas
    from dpcontrol.walks.shadowing import ShadowingOrbit

    view = None
    if isinstance(result, Run | Plan):
        plan = isinstance(result, Plan)
        view = reference_view(summarised(result.reference), result.file) if plan else run_view(result.log)
        figure = draw(view)
    elif isinstance(result, ShadowingOrbit):
        system = result.connections[0].source.system
        arms = system.model.parameters if isinstance(system, ModelSystem) else None
        lengths = arms.length if isinstance(arms, ArmChainParameters) else None
        figure = draw_walk(result, arm_lengths=lengths, model=system.name)
        view = WalkStory(result, lengths).view(system.name)
    elif isinstance(result, Atlas):
        figure = draw_atlas(result)
    else:
        raise InputError(f"{type(result).__name__}: a picture is of a run, a plan, a walk's orbit or an atlas")
    if transitions:
        if not isinstance(result, Plan):
            raise InputError("transitions = True draws the transfers of a plan: give one")
        from dpcontrol.pages.transitions import draw_transitions

        figure = draw_transitions(summarised(result.reference))
    if film is not None:
        if view is None:
            raise InputError(f"{film}: an atlas does not move: give a run, a plan or a walk's orbit")
        from dpcontrol.pages.film import write_film

        write_film(view, film)
    if file is not None:
        save_figure(figure, file)
    return figure


@checked
def cache(*, clear: bool = False) -> "CacheContents":
    """List the cached results of earlier work by kind, and delete them if `clear`. They can be computed again.

    >>> entries, size = dp.cache().kinds["plans"]
    >>> entries > 0
    True

    Raises:
        InputError: a file of it cannot be deleted.
    """
    from dpcontrol.foundation.cache import cache_contents

    return cache_contents(clear=clear)


def _model(model: Model | str) -> Model:
    return load_model(model) if isinstance(model, str) else model


def _system(model: Model | System | str) -> System:
    return model if isinstance(model, System) else _model(model).system


def _found(converged: bool, what: str, status: str) -> None:
    if not converged:
        raise GoalMissed(f"{what}: {status}")


def _edges(searches: "Sequence[ConnectionSearch]") -> "Edges":
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
        notes=(),
    )


def _closed(planned: "Plan | str", options: RunOptions, *, yes: bool, progress: Reporting) -> "ClosedLoop":
    from dpcontrol.plans.itinerary import load_itinerary
    from dpcontrol.runs.closed_loop import ClosedLoop

    if isinstance(planned, str):
        # A wrong option is reported before the plan is computed.
        load_itinerary(planned).with_run(options)
    return ClosedLoop(plan(planned, yes=yes, progress=progress) if isinstance(planned, str) else planned, options)


def _options(options: RunOptions | None, mismatch: float | None = None, plant: Place | None = None) -> RunOptions:
    given = {"mismatch": mismatch, "plant": None if plant is None else str(plant)}
    return (options or RunOptions()).over({name: value for name, value in given.items() if value is not None})
