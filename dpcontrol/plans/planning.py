"""Planner: the reference of an itinerary, with the content of its plan.

A walk with kept stops has flights along connections between sustained orbits, and whole periods of these orbits.

    orbit · orbit · …  flight  orbit · orbit · …  flight  … orbit

Every flight is solved separately, cart included, from phase 0 of one sustained orbit to phase 0 of the next. So the
length of a stay adds no cost. If a stop has too few wraps for a whole period between two flights, its symbols share one
flight. The content lists the intervals of stays and flights (`segments`) for the controllers that alternate.

Itineraries without transfers hold one equilibrium or keep one periodic orbit for a given time. This orbit is the
sustained one (`references.sustained`), repeated for whole periods.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise, takewhile

import numpy as np

from dpcontrol.control.interface import whole_turns
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.lyapunov import equilibria, equilibrium, lyapunov_orbit, resting_place
from dpcontrol.plans.authority import connection_loss
from dpcontrol.plans.itinerary import HoldPart, Itinerary, OrbitPart, WalkPart
from dpcontrol.plans.pieces import (
    Goal,
    SolvedPiece,
    cart_problem,
    content_of_pieces,
    lifted_guess,
    solve_pieces,
    stay_goal,
    walk_goal,
)
from dpcontrol.plans.transfers import transfer_costs
from dpcontrol.references.content import (
    REST_AFTER,
    REST_BEFORE,
    FlightSegment,
    PlanOrbit,
    PlanStop,
    StaySegment,
)
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import EndConditions
from dpcontrol.references.reference import Reference, joined
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.tubes.connections import Connection
from dpcontrol.tubes.symmetric import SymmetricSettings, find_symmetric_connections
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver, phase_gap
from dpcontrol.walks.symbols import parse_walk
from dpcontrol.walks.walks import resolve, symmetric_walk


def planned(
    itinerary: Itinerary,
    orbits: Sequence[ShadowingOrbit] = (),
    *,
    fresh: bool = False,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Reference:
    """Return the reference of an itinerary with the content of its plan, computed from connections to collocation.

    Args:
        itinerary: itinerary to plan.
        orbits: shadowing orbits of its walks, if known.
        fresh: ignore cached transfers.
        workers: processes that search for transfers.
        progress: receiver of progress reports.

    Raises:
        InputError: the walk needs connections that do not exist at this energy.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    if isinstance(itinerary.stay, OrbitPart):
        return _kept_orbit(itinerary, itinerary.stay, progress)
    if itinerary.keeps:
        walk = itinerary.walks[0]
        chain, solver = _connections(itinerary, walk, part_of(progress, 0.0, 0.5))
        return _kept_walk(itinerary, walk, chain, solver, part_of(progress, 0.5, 1.0))
    share_of_goals = 0.4 if itinerary.walks else 0.0
    goals = _goals(itinerary, list(orbits), part_of(progress, 0.0, share_of_goals))
    pieces = solve_pieces(
        itinerary, goals, fresh=fresh, workers=workers, progress=part_of(progress, share_of_goals, 1.0)
    )
    reference, begins = joined([piece.reference for piece in pieces])
    content = content_of_pieces(itinerary, pieces, begins)
    # The last of the begins is the end.
    solved_transfers = [
        (p.text, float(begin), p.reference) for p, begin in zip(pieces, begins, strict=False) if p.goal is None
    ]
    return replace(reference, plan=replace(content, costs=transfer_costs(solved_transfers)))


def _goals(itinerary: Itinerary, orbits: list[ShadowingOrbit], progress: Progress) -> list[Goal]:
    """Return the goals of an itinerary, one for each part, with its rests and holds at the start and the end.

    A hold of the hanging arms is itself the rest, with its duration. `orbits` holds the shadowing orbits of the walks,
    if they are known; they are used up in order.
    """
    ends, goals = (itinerary.start, itinerary.finish), list[Goal]()
    first, last = itinerary.parts[0], itinerary.parts[-1]
    first_equilibrium, last_equilibrium = (
        _equilibrium(itinerary, end, number) for number, end in zip((0, -1), ends, strict=True)
    )
    # Runs start with the cart in the middle.
    if first_equilibrium and not (isinstance(first, HoldPart) and first.hold == first_equilibrium and not first.cart):
        goals.append(stay_goal(itinerary, first_equilibrium, REST_BEFORE))
    for k, part in enumerate(itinerary.parts):
        if isinstance(part, WalkPart):
            portion = part_of(progress, k / len(itinerary.parts), (k + 1) / len(itinerary.parts))
            orbit = orbits.pop(0) if orbits else shadowing_orbit(itinerary, part, progress=portion)
            neighbours = [itinerary.parts[j] if 0 <= j < len(itinerary.parts) else None for j in (k - 1, k + 1)]
            # Walks meet on their orbits. To rest or a hold, there is a transfer.
            needs_transfer = (
                ending != "orbit" if neighbour is None else isinstance(neighbour, HoldPart)
                for ending, neighbour in zip(ends, neighbours, strict=True)
            )
            goals.append(
                walk_goal(orbit, part.walk, round_off=(next(needs_transfer), next(needs_transfer)), pace=part.transfer)
            )
        elif isinstance(part, HoldPart):
            goals.append(stay_goal(itinerary, part.hold, part.seconds, cart=part.cart, pace=part.transfer))
    if last_equilibrium and not (isinstance(last, HoldPart) and last.hold == last_equilibrium):
        goals.append(stay_goal(itinerary, last_equilibrium, REST_AFTER))
    return goals


def _equilibrium(itinerary: Itinerary, end: str, number: int) -> str:
    """Return the name of the equilibrium at which an itinerary starts or finishes, "" if it does so on an orbit.

    Args:
        itinerary: itinerary of the part.
        end: "rest", "hold" or "orbit", as `start` and `finish` give it.
        number: 0 for the start and the first part, -1 for the finish and the last part.
    """
    part, system = itinerary.parts[number], itinerary.model.system
    if end == "rest":
        return resting_place(system)
    if isinstance(part, HoldPart):
        return part.hold
    if end == "orbit" or not isinstance(part, WalkPart):
        return ""
    symbol = parse_walk(part.walk, system.saddles)[number]
    return symbol.target if number else symbol.source


def shadowing_orbit(itinerary: Itinerary, part: WalkPart, *, progress: Progress = no_progress) -> ShadowingOrbit:
    """Find the orbit that shadows a walk, after a search for the walk's connections.

    Args:
        itinerary: itinerary with the walk.
        part: the walk.
        progress: receiver of progress reports.

    Raises:
        InputError: the walk needs connections that do not exist at this energy.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    if itinerary.model.system.dimension == 6:
        return _symmetric_walk(itinerary.model.system, part, progress)
    chain, solver = _connections(itinerary, part, part_of(progress, 0.0, 0.9))
    progress("shadowing orbit", 0.9)
    result = solver.solve(chain, part.wraps, lead_in=part.lead_in, lead_out=part.lead_out)
    if not result.converged:
        raise solver.missed(result, "the shadowing orbit: ", first=_first_symbol(itinerary, part))
    return result


def _first_symbol(itinerary: Itinerary, part: WalkPart) -> int:
    """Return the index of a walk's first symbol among those of all parts."""
    return sum(len(walk.walk) for walk in takewhile(lambda walk: walk is not part, itinerary.walks))


_BESIDE, _BETWEEN = 0.01, 5
"""Range of energies for connections of three arms, relative to the energy scale, and their number."""


def _symmetric_walk(system: System, part: WalkPart, progress: Progress) -> ShadowingOrbit:
    """Return the walk of three arms along the connection nearest to the part's energy.

    Connections of three arms exist at single energies only, so those of a small range of energies are searched.
    """
    (symbol, *_) = parse_walk(part.walk, system.saddles)
    range_of_energies = _BESIDE * system.energy_scale
    lowest = equilibrium(system, symbol.source).energy
    energies = (
        max(part.energy - range_of_energies, lowest + 1e-3 * range_of_energies),
        part.energy + range_of_energies,
    )
    search = find_symmetric_connections(
        system, symbol.source, energies=energies, hit=(symbol.hits or (1, 1))[0],
        settings=SymmetricSettings(energies=_BETWEEN), progress=progress,
    )  # fmt: skip
    leads = {"lead_in": part.lead_in, "lead_out": part.lead_out}
    return symmetric_walk(part.walk, search, energy=part.energy, **leads)


def _connections(itinerary: Itinerary, part: WalkPart, progress: Progress) -> tuple[tuple[Connection, ...], WalkSolver]:
    """Return the connections of a part's walk, and a solver that finds their shadowing orbits.

    If a connection does not exist, the error's message names energies at which all of them do.
    """
    system = itinerary.model.system
    symbols = parse_walk(part.walk, system.saddles)
    pairs = list(dict.fromkeys((s.source, s.target) for symbol in symbols for s in symbol.simple))
    try:
        edges = find_edges(system, part.energy, pairs=pairs, symbols=symbols, progress=progress)
        if edges.absent:
            raise GoalMissed("; ".join(reason for _, reason in edges.absent))
        by_name = {connection.name: connection for connection in edges.known}
        loss_of = cache(lambda name: connection_loss(itinerary.model.arms, by_name[name]))
        return resolve(part.walk, edges, lambda connection: loss_of(connection.name)), WalkSolver(edges.known)
    except (InputError, GoalMissed) as error:
        # The name of a connection is valid at one energy only.
        has_connection_name = any(simple.name is not None for symbol in symbols for simple in symbol.simple)
        remedy = "" if has_connection_name else f"; {_other_energies(system, part, pairs)}"
        symbol = None if error.symbol is None else _first_symbol(itinerary, part) + error.symbol
        raise type(error)(f"{error}{remedy}", symbol=symbol) from error


_SHARES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)
"""Energies for connections, as shares of the range from a walk's highest saddle to the highest equilibrium."""
_LOST = 1e11
"""Unstable multiplier above which rounding destroys an orbit's tubes within a period."""


def _other_energies(system: System, part: WalkPart, pairs: Sequence[tuple[str, str]]) -> str:
    """Return a sentence on nearby energies at which a walk has all its connections, the remedy in an error message.

    Args:
        system: system of the walk.
        part: the walk, with the energy that failed.
        pairs: pairs of saddles that the walk's symbols connect.
    """
    heights = {name: equilibrium.energy for name, equilibrium in equilibria(system).items()}
    stops = list(dict.fromkeys(name for pair in pairs for name in pair))
    lowest, highest = max(heights[name] for name in stops), max(heights.values())
    energies = sorted((lowest + share * (highest - lowest) for share in _SHARES), key=lambda e: abs(e - part.energy))
    unstable_orbits: list[tuple[float, str]] = []
    for energy in energies:
        orbits = [lyapunov_orbit(system, name, energy=energy) for name in stops]
        most_unstable = max((abs(orbit.unstable_multiplier), orbit.saddle) for orbit in orbits)
        if most_unstable[0] > _LOST:
            unstable_orbits.append(most_unstable)
            continue
        try:
            resolve(part.walk, find_edges(system, energy, pairs=pairs))
        except (InputError, GoalMissed):
            continue
        return f"at {energy:.4g} J there are connections for each symbol"
    finding = f"nor were any found at {len(energies)} energies from {min(energies):.4g} to {max(energies):.4g} J"
    if len(unstable_orbits) < len(energies):
        return f"{finding}; take other symbols"
    growth, saddle = min(unstable_orbits)
    reason = f"there a period near the orbit about {saddle} multiplies errors by {growth:.0e} or more"
    return f"{finding}: {reason}, beyond double precision; take a walk without {saddle}, or one that needs less energy"


_SAMPLES = 401


def _kept_walk(
    itinerary: Itinerary, part: WalkPart, chain: Sequence[Connection], solver: WalkSolver, progress: Progress
) -> Reference:
    """Return the reference of a walk whose stops are stays on sustained orbits, joined by flights.

    A flight follows one connection or more from orbit to orbit. `chain` are the walk's connections, and `solver` finds
    their shadowing orbits. The lift of a flight (n,) are radians that continue the angles of the flight before.

    Raises:
        GoalMissed: a sustained orbit, or a flight's shadowing orbit or reference, was not found.
    """
    orbits = _sustained(itinerary, chain)
    flights = _flights(part, chain, solver)
    pieces: list[SolvedPiece] = []
    for k, flight in enumerate(flights):
        portion = part_of(progress, k / len(flights), (k + 1) / len(flights))
        lift = np.zeros(len(flight.first))
        if pieces:
            lift = pieces[-1].lift + flights[k - 1].last - flight.first
        pieces.append(_flown(itinerary, flight, orbits, lift, portion))
    return _assembled(itinerary, part, flights, pieces, orbits)


def _early(flight: Goal) -> float:
    """Return the periods from a flight's start to the departure of its first connection.

    The stay before the flight is shorter by these periods, see `_periods`.
    """
    connection = flight.walk.connections[0]
    return (float(flight.walk.symbol_times[0]) - flight.begin - connection.time_out) / connection.source.period


def _late(flight: Goal) -> float:
    """Return the periods from the arrival of a flight's last connection to the flight's end.

    The stay after the flight is shorter by these periods, see `_periods`.
    """
    connection, end = flight.walk.connections[-1], flight.begin + flight.seconds
    return (end - float(flight.walk.symbol_times[-1]) - connection.time_in) / connection.target.period


def _sustained(itinerary: Itinerary, chain: Sequence[Connection]) -> dict[str, SustainedOrbit]:
    """Return the sustained orbits of a walk's stops by saddle, which the cart keeps up in spite of friction.

    Raises:
        GoalMissed: an orbit did not converge.
    """
    # The cheapest orbit, not the nearest to the Lyapunov orbit.
    settings = replace(itinerary.reference, pendulum_weight=0.0, cart_weight=1.0)
    orbits: dict[str, SustainedOrbit] = {}
    for lyapunov in (chain[0].source, *(connection.target for connection in chain)):
        if lyapunov.saddle not in orbits:
            sustained = sustained_orbit(
                lyapunov, itinerary.model.arms.planned(), limits=itinerary.limits, settings=settings
            )
            if not sustained.converged:
                place = f"about {lyapunov.saddle} at {lyapunov.energy:g} J"
                raise GoalMissed(f"the sustained orbit {place}, which must be kept: {sustained.status}")
            orbits[lyapunov.saddle] = sustained
    return orbits


def _flights(part: WalkPart, chain: Sequence[Connection], solver: WalkSolver) -> list[Goal]:
    """Return the walk's flights, one for each symbol.

    Flights that would be less than one period of the orbit apart are joined to one.
    """
    single_flights = [_flight(part, chain, solver, k, k + 1) for k in range(len(chain))]
    separations = [k + 1 for k, (before, after) in enumerate(pairwise(single_flights)) if _periods(before, after) >= 1]
    spans = pairwise([0, *separations, len(chain)])
    return [single_flights[i] if j == i + 1 else _flight(part, chain, solver, i, j) for i, j in spans]


def _flight(part: WalkPart, chain: Sequence[Connection], solver: WalkSolver, first: int, last: int) -> Goal:
    """Return the flight along some of a walk's symbols, between the orbits before and after them at phase zero.

    Args:
        part: the walk.
        chain: connections of all its symbols.
        solver: solver of their shadowing orbits.
        first: index of the flight's first symbol.
        last: index of the symbol after its last one.

    Raises:
        GoalMissed: its shadowing orbit did not converge.
    """
    orbit = solver.solve(chain[first:last], part.wraps[first : last - 1], lead_in=0, lead_out=0)
    if not orbit.converged:
        raise solver.missed(orbit, "the shadowing orbit: ", first=first)
    wraps = part.wraps[first - 1] if first else None
    return walk_goal(orbit, part.walk[first:last], round_off=(True, True), wraps=wraps)


def _periods(before: Goal, after: Goal) -> int:
    """Return the number of whole periods to stay on an orbit between two flights, so that the stop has its wraps.

    It is negative if the stop is too short for both flights.
    """
    assert after.wraps is not None
    gap = phase_gap(before.walk.connections[-1], after.walk.connections[0])
    return round(after.wraps + gap - _late(before) - _early(after))


def _flown(
    itinerary: Itinerary, goal: Goal, orbits: dict[str, SustainedOrbit], lift: Array, progress: Progress
) -> SolvedPiece:
    """Return the solved piece of a flight between two sustained orbits.

    Args:
        itinerary: arms, limits and settings.
        goal: the flight.
        orbits: sustained orbits by saddle.
        lift: angles (n,) added to those of the flight, rad.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: the flight was not found.
    """
    ends_of_flight = zip(goal.orbits, (goal.start, goal.end), strict=True)
    start, end = (on_turns(orbits[end_orbit.saddle], state[: len(lift)] + lift) for end_orbit, state in ends_of_flight)
    problem = cart_problem(itinerary, lifted_guess(goal, lift), goal.seconds, EndConditions(start=start, end=end))
    reference = find_reference(problem, itinerary.reference, progress=progress)
    text = ", ".join(goal.symbols)
    if not reference.converged:
        raise GoalMissed(f"no flight {text!r} between the kept orbits: {reference.status}")
    return SolvedPiece(text, goal, lift, reference)


def on_turns(orbit: SustainedOrbit, angles: Array) -> Array:
    """Return a sustained orbit's state (2n+2,) at phase 0, with the whole turns of given angles.

    Args:
        orbit: the sustained orbit.
        angles: angles (n,) whose whole turns the state takes, rad.
    """
    start, n = np.array(orbit.state(0.0)), len(angles)
    start[:n] += whole_turns(angles - start[:n])
    return start


def _assembled(
    itinerary: Itinerary,
    part: WalkPart,
    flights: list[Goal],
    pieces: list[SolvedPiece],
    orbits: dict[str, SustainedOrbit],
) -> Reference:
    """Return the reference of a walk with kept stops, joined from its stays and flights, with the content of its plan.

    A stay repeats the period of its sustained orbit, with the whole turns of the flights beside it. There is one stay
    before each flight and one after the last.

    Args:
        itinerary: itinerary of the walk.
        part: the walk.
        flights: goals of the flights (F,), in order.
        pieces: solved flights (F,).
        orbits: sustained orbits by saddle.
    """
    # Runs are caught on the first orbit for at least one period. On the last one they settle for a period after the
    # flight, and are judged on the next.
    leads = (max(round(part.lead_in - _early(flights[0])), 1), max(round(part.lead_out - _late(flights[-1])), 2))
    counts = [leads[0], *(_periods(a, b) for a, b in pairwise(flights)), leads[1]]
    places = [flights[0].orbits[0], *(flight.orbits[1] for flight in flights)]
    states = [pieces[0].reference.state(0.0), *(p.reference.state(p.reference.duration) for p in pieces)]
    parts: list[Reference] = []
    segments: list[FlightSegment | StaySegment] = []
    begins: list[float] = []
    for k, (count, place, state) in enumerate(zip(counts, places, states, strict=True)):
        orbit = orbits[place.saddle]
        turns = whole_turns(state - orbit.state(0.0))
        stay = replace(orbit.reference, states=orbit.reference.states + turns)
        segments.append(
            StaySegment(
                place.saddle,
                place.energy,
                place.family,
                place.period,
                tuple(turns.tolist()),
                count,
                _rows(parts, stay),
            )
        )
        parts += [stay] * count
        if k < len(pieces):
            segments.append(FlightSegment(pieces[k].text, _rows(parts, pieces[k].reference)))
            begins.append(sum(stay.duration for stay in parts))
            parts.append(pieces[k].reference)
    reference = _counted_once(joined(parts)[0], [piece.reference for piece in pieces], orbits)
    content = content_of_pieces(itinerary, pieces, np.array([*begins, reference.duration]))
    visited = tuple(
        replace(place, period=orbits[place.saddle].period, curve=_sampled(orbits[place.saddle]))
        for place in content.orbits
    )
    content = replace(content, segments=tuple(segments), lead_in=part.lead_in, lead_out=part.lead_out, orbits=visited)
    return replace(reference, plan=content)


def _sampled(orbit: SustainedOrbit) -> Array:
    """Return states (M, 2n) of the pendulum over a period, which a plan stores for the score and review of its runs."""
    return np.asarray(orbit.state(np.linspace(0.0, orbit.period, _SAMPLES))[:, :-2])


def _counted_once(
    joined_reference: Reference, flights: list[Reference], orbits: dict[str, SustainedOrbit]
) -> Reference:
    """Return the joined reference with the search cost of each flight and orbit counted once.

    The joined reference adds up the costs of all its parts, in which an orbit can occur several times. `orbits` are the
    sustained orbits by saddle.
    """
    solved = [*flights, *(orbit.reference for orbit in orbits.values())]
    iterations, seconds = sum(piece.iterations for piece in solved), sum(piece.solve_seconds for piece in solved)
    ending = ReferenceEnding(
        ReferenceCause.FLIGHTS,
        iterations=iterations,
        error=joined_reference.max_error_between_nodes,
        intervals=joined_reference.intervals,
        parts=len(flights),
    )
    return replace(joined_reference, iterations=iterations, solve_seconds=seconds, ending=ending)


def _rows(before: list[Reference], part: Reference) -> tuple[int, int]:
    """Return the first interval of a part and the interval after its last one, counted in the joined reference.

    `before` holds the parts that precede it.
    """
    first = sum(len(earlier.mesh) - 1 for earlier in before)
    return first, first + len(part.mesh) - 1


def _kept_orbit(itinerary: Itinerary, part: OrbitPart, progress: Progress) -> Reference:
    """Return the reference of a stay on a periodic orbit, repeated for whole periods, with the content of its plan.

    Raises:
        GoalMissed: the orbit was not found.
    """
    system, place = itinerary.model.system, f"about {part.orbit} at {part.energy:g} J"
    lyapunov = lyapunov_orbit(system, part.orbit, energy=part.energy, family=part.family)
    if not lyapunov.converged:
        raise GoalMissed(f"the Lyapunov orbit {place}: {lyapunov.status}")
    sustained = sustained_orbit(lyapunov, itinerary.model.arms.planned(), limits=itinerary.limits, progress=progress)
    if not sustained.converged:
        raise GoalMissed(f"the sustained orbit {place}: {sustained.status}")
    one_period = sustained.reference
    periods = max(1, round(part.seconds / sustained.period))
    reference, _ = joined([one_period] * periods)
    reference = replace(
        reference, ending=one_period.ending, iterations=one_period.iterations, solve_seconds=one_period.solve_seconds
    )
    state = system.equilibrium(part.orbit)
    n = len(state) // 2
    stay = StaySegment(
        part.orbit,
        part.energy,
        part.family,
        lyapunov.period,
        (0.0,) * (2 * n + 2),
        periods,
        (0, len(one_period.mesh) - 1),
    )
    orbit = PlanOrbit(part.orbit, part.energy, sustained.period, lyapunov.unstable_multiplier, _sampled(sustained))
    content = replace(
        content_of_pieces(itinerary, [], np.zeros(1)),
        stops=(PlanStop(part.orbit, tuple(state[:n].tolist()), 0),),
        orbits=(orbit,),
        segments=(stay,),
    )
    return replace(reference, plan=content)
