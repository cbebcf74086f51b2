"""Parts of an itinerary as pieces of one reference.

Pieces are walks, holds and rests, with transfers between them.

Each piece is solved separately, between two known states, and the pieces are joined. So the cost grows with the sum of
their lengths, and an infeasible piece is reported by name.

The pieces also give the content of the plan for score, pages and controllers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.document import picked
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.shown import Brief
from dpcontrol.foundation.version import PROGRAM
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibria, resting_place
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.layout import Pace
from dpcontrol.plans.transfers import Transfer, find_transfers, turned
from dpcontrol.references.content import (
    Origin,
    PlanContent,
    PlanOrbit,
    PlanSaddle,
    PlanSection,
    PlanStop,
    PlanSymbol,
    Shadowing,
)
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.find import find_reference, shadowed
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import PLANNING, EndConditions, Guess, ReferenceProblem
from dpcontrol.references.reference import Reference, still
from dpcontrol.tubes.connections import Connection
from dpcontrol.walks.shadowing import ShadowingOrbit

WRAPS = 2
"""Wraps of a change between two orbits of one saddle."""


@dataclass(frozen=True)
class Goal(Brief):
    """A walk's shadowing orbit, or a stay of `seconds` at an equilibrium.

    Attributes:
        text: "walk", or the stay in words.
        where: names of the saddles or equilibria at start and end.
        first, last: angles (n,) of the saddles or equilibria at start and end, including turns.
        start, end: pendulum states (2n,) there.
        shadowing: orbit of a walk, None for a stay.
        symbols: symbols of a walk, as the itinerary writes them.
        begin: time of the shadowing orbit at which a walk begins, s, negative if it is extended before its start.
        seconds: duration, s.
        wraps: at the stop shared with the goal before, or None for a walk in one piece.
        cart: place of the cart, m.
        pace: time of the transfer that leads to it, "" for the itinerary's.
    """

    text: str
    where: tuple[str, str]
    first: Array
    last: Array
    start: Array
    end: Array
    shadowing: ShadowingOrbit | None = None
    symbols: tuple[str, ...] = ()
    begin: float = 0.0
    seconds: float = 0.0
    wraps: int | None = None
    cart: float = 0.0
    pace: Pace = ""

    @property
    def walk(self) -> ShadowingOrbit:
        """Shadowing orbit of a goal that is a walk."""
        assert self.shadowing is not None
        return self.shadowing

    @property
    def orbits(self) -> tuple[LyapunovOrbit, LyapunovOrbit]:
        """First and last orbit of a walk."""
        return self.walk.connections[0].source, self.walk.connections[-1].target


@dataclass(frozen=True)
class SolvedPiece(Brief):
    """Solved reference of a goal, or of the transfer to the next goal.

    text: name of the piece. goal: None for a transfer. lift (n,): whole turns of all pieces before it, added to the
    goal's angles, rad; for a transfer, the lift of the goal after it.
    """

    text: str
    goal: Goal | None
    lift: Array
    reference: Reference


def walk_goal(
    orbit: ShadowingOrbit,
    symbols: tuple[str, ...],
    *,
    round_off: tuple[bool, bool],
    wraps: int | None = None,
    pace: Pace = "",
) -> Goal:
    """Return the goal of following a shadowing orbit from start to end.

    Args:
        orbit: shadowing orbit of the walk.
        symbols: symbols of the walk, as the itinerary writes them.
        round_off: for start and end, True to extend it to phase zero of its periodic orbit, with the arms at the
            saddle's angles. Transfers reach these states more easily than those in mid-swing.
        wraps: wraps at the stop shared with the goal before, None for a walk in one piece.
        pace: time of the transfer that leads to it, "" for the itinerary's.
    """
    system, chain = orbit.connections[0].source.system, orbit.connections
    n = system.dimension // 2
    names = (chain[0].source.saddle, chain[-1].target.saddle)
    begin, end = 0.0, orbit.duration
    if round_off[0]:
        begin -= (_phase_at_start(orbit, chain[0].source) % 1.0) * chain[0].source.period
    if round_off[1]:
        end += (-_phase_at_end(orbit, chain[-1].target) % 1.0) * chain[-1].target.period
    ends = orbit.states(np.array([begin, end]))
    points = [
        (system.equilibrium(name) + offset * system.turn_lengths)[:n]
        for name, offset in zip(names, (orbit.offsets[0], orbit.offsets[-1]), strict=True)
    ]
    return Goal(
        "walk", names, points[0], points[1], ends[0], ends[1], shadowing=orbit, symbols=symbols, begin=begin,
        seconds=end - begin, wraps=wraps, pace=pace,
    )  # fmt: skip


def stay_goal(itinerary: Itinerary, name: str, seconds: float, *, cart: float = 0.0, pace: Pace = "") -> Goal:
    """Return the goal of a stay at an equilibrium for a given time.

    Args:
        itinerary: itinerary with the model.
        name: name of the equilibrium.
        seconds: duration of the stay, s.
        cart: place of the cart, m.
        pace: time of the transfer that leads to it, "" for the itinerary's.
    """
    system = itinerary.model.system
    state = system.equilibrium(name)
    angles = state[: len(state) // 2]
    text = "at rest" if name == resting_place(system) else f"hold {name}"
    return Goal(text, (name, name), angles, angles, state, state, seconds=seconds, cart=cart, pace=pace)


def solve_pieces(
    itinerary: Itinerary,
    goals: Sequence[Goal],
    *,
    fresh: bool = False,
    workers: int = 1,
    progress: Progress = no_progress,
) -> list[SolvedPiece]:
    """Return the pieces of all goals in order, with transfers between them.

    The list ends with a reference that did not converge, because the next piece would start from its end. Each goal's
    angles begin at their named values; the lift of its piece adds the whole turns of all pieces before it.

    Args:
        itinerary: arms, limits and settings.
        goals: goals in order.
        fresh: ignore cached transfers.
        workers: processes that search for transfers.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: there is no transfer between two goals.
    """
    transfers_between = [_way(itinerary, *pair) for pair in pairwise(goals)]
    searches = [way.transfer for way in transfers_between if way is not None]
    ready = 0.5 if searches else 0.0
    first = part_of(progress, 0.0, ready)
    transfers = find_transfers(searches, workers=workers, fresh=fresh, progress=first)
    pieces: list[SolvedPiece] = []
    for k, goal in enumerate(goals):
        begin, share = ready + (1 - ready) * k / len(goals), (1 - ready) / len(goals)
        lift = np.zeros(len(goal.first))
        if k > 0:
            way, lift = transfers_between[k - 1], pieces[-1].lift
            if way is not None:
                pieces.append(way.taken(transfers[way.transfer.key], lift))
            elif goal.shadowing is not None:
                pieces.append(_blend(itinerary, goals[k - 1], lift, goal, part_of(progress, begin, begin + share / 2)))
            lift = pieces[-1].lift
            if not pieces[-1].reference.converged:
                break
        portion = part_of(progress, begin + share / 2, begin + share)
        pieces.append(_own(itinerary, goal, lift, portion, judged=k == len(goals) - 1))
        if not pieces[-1].reference.converged:
            break
    return pieces


def cart_problem(itinerary: Itinerary, guess: Guess, duration: float, ends: EndConditions) -> ReferenceProblem:
    """Return the problem of a reference with friction and cart that follows a guess.

    Args:
        itinerary: arms and limits.
        guess: function of times (K,), s, that returns the pendulum's states (K, 2n).
        duration: duration of the motion, s.
        ends: conditions at start and end.
    """
    return ReferenceProblem(
        equations=equations_of(itinerary.model.arms.planned(), Level.CART),
        parameters=itinerary.model.arms.planned().base(),
        guess=guess,
        duration=duration,
        limits=itinerary.limits,
        ends=ends,
    )


def lifted(state: Array, lift: Array, cart: float = 0.0) -> Array:
    """Return the state of arms and cart, with turns added to the arms' angles and the cart at rest.

    Args:
        state: state (2n,) of the pendulum.
        lift: angles (n,) added to its angles, rad.
        cart: place of the cart, m.

    Returns:
        State (2n+2,).
    """
    n = len(lift)
    return np.concatenate([state[:n] + lift, state[n:], [cart, 0.0]])


def lifted_guess(goal: Goal, lift: Array) -> Guess:
    """Return the guess of a walk's reference: its shadowing orbit with turns added, as a function of time.

    Args:
        goal: goal of a walk.
        lift: angles (n,) added to those of the orbit, rad.
    """
    sample, offset = goal.walk.states, np.concatenate([lift, np.zeros(len(lift))])
    return lambda times: sample(times + goal.begin) + offset


_ROOM, _ELSEWHERE = 0.05, 0.6
"""Distances of a reference from its last orbit, rad: half the tolerance of runs, and the one that misses the orbit.

Beyond the first, feedback has no margin left.
"""
_CLOSER = (1e2, 1e4, 1e6)
"""Factors on the pendulum's weight when such a reference is sought again.

With friction, no orbit can be kept exactly, and the cheapest end is not the nearest. The cart then ends at rest in the
middle, but the pendulum anywhere: an end on the frictionless orbit takes it off the orbit before.
"""


def _own(itinerary: Itinerary, goal: Goal, lift: Array, progress: Progress, *, judged: bool) -> SolvedPiece:
    """Return the solved reference of one goal, a walk or a stay, without transfers.

    If the reference of a judged walk does not converge, it is sought again with an open end of the arms. If it leaves
    its last orbit by more than 0.05 rad (but less than 0.6), larger weights of the pendulum are tried, also with an
    open end. The nearest converged reference is returned, or else the one that did not converge.

    Args:
        itinerary: arms, limits and settings.
        goal: walk or stay.
        lift: angles (n,) added to those of the goal, rad.
        progress: receiver of progress reports.
        judged: True if the itinerary ends on this walk's last orbit, from which the run's end is judged. The reference
            must then stay near it.
    """
    settings = itinerary.reference
    if goal.shadowing is None:
        method, interval = method_named(settings.method), max(settings.interval, 0.05)
        state = lifted(goal.start, lift, goal.cart)
        reference = still(state, goal.seconds, method=method, limits=itinerary.limits, interval=interval)
        return SolvedPiece(goal.text, goal, lift, reference)
    problem = cart_problem(itinerary, lifted_guess(goal, lift), goal.seconds, EndConditions())
    if settings.level == "conservative":
        frictionless_arms = itinerary.model.arms.frictionless()
        conservative = replace(
            problem, equations=equations_of(frictionless_arms, Level.CART), parameters=frictionless_arms.base()
        )
        return SolvedPiece(goal.text, goal, lift, shadowed(conservative, settings))
    reference = find_reference(problem, settings, progress=progress)
    if not judged:
        return SolvedPiece(goal.text, goal, lift, reference)
    end_at_rest = np.array([np.nan] * 2 * len(lift) + [0.0, 0.0])
    open_ended = replace(problem, ends=EndConditions(end=end_at_rest))
    if not reference.converged:
        open_reference = find_reference(open_ended, settings, progress=progress)
        reference = open_reference if open_reference.converged else reference
    least_distance = _off_last_orbit(goal, reference, lift) if reference.converged else 0.0
    for factor in _CLOSER:
        if not _ROOM < least_distance < _ELSEWHERE:
            break
        weight = factor * settings.pendulum_weight
        heavier_reference = find_reference(open_ended, replace(settings, pendulum_weight=weight), progress=progress)
        distance = _off_last_orbit(goal, heavier_reference, lift)
        if heavier_reference.converged and distance < least_distance:
            reference, least_distance = heavier_reference, distance
    return SolvedPiece(goal.text, goal, lift, reference)


_PHASES = 1000
"""Phases at which an orbit is sampled, and its last period."""


def _off_last_orbit(goal: Goal, reference: Reference, lift: Array) -> float:
    """Return the largest distance of a walk's reference from its last orbit over the last period, rad.

    `lift` (n,) is added to the goal's angles. Distances are those of the angles from the nearest point of the orbit.
    """
    orbit, n = goal.orbits[1], len(lift)
    shares = np.linspace(0.0, 1.0, _PHASES)
    path = OrbitCurve(orbit).states(shares)[:, :n] - orbit.system.equilibrium(orbit.saddle)[:n] + goal.last + lift
    last_period = reference.state(
        reference.duration - orbit.period * shares.clip(max=reference.duration / orbit.period)
    )[:, :n]
    return float(np.abs(last_period[:, None] - path).max(axis=2).min(axis=1).max())


@dataclass(frozen=True)
class _Way:
    """A transfer between two goals.

    `turns`: for each possible end of the transfer, the whole turns (n,) that are added to the next goal's angles.
    """

    transfer: Transfer
    turns: list[Array]

    def taken(self, reference: Reference, lift: Array) -> SolvedPiece:
        """Return the transfer's solved reference as a piece whose lift is that of the goal after it.

        `lift` (n,) is that of the goal before it. The reference ends at one of several equivalent ends, which differ by
        turns.
        """
        end_state = reference.state(reference.duration)
        nearest = int(np.argmin([np.abs(end_state - end).max() for end in self.transfer.ends]))
        next_lift = self.turns[nearest] * 2 * np.pi + lift
        return SolvedPiece(self.transfer.text, None, next_lift, turned(reference, lift))


def _way(itinerary: Itinerary, before: Goal, after: Goal) -> _Way | None:
    """Return the transfer from one goal to the next, or None if they meet without one.

    Walks about one saddle are blended instead, and a stay continues the stay before it at the same place.
    """
    resting_name = resting_place(itinerary.model.system)
    names = ["rest" if name == resting_name else name for name in (before.where[1], after.where[0])]
    distance_in_turns = (before.last - after.first) / (2 * np.pi)
    walks = [goal.shadowing is not None for goal in (before, after)]
    same_place = names[0] == names[1] and walks[0] == walks[1]
    if same_place and before.cart == after.cart:
        return None
    text = f"side-step at {names[0]}" if same_place else " to ".join(names)
    # Each candidate `way` gives whole turns (n,) to add to the end.
    turns = ways_round(distance_in_turns)
    if not any(walks):
        # Between equilibria a transfer and its mirror image are equivalent.
        turns = [
            way
            for k, way in enumerate(turns)
            if not any(np.allclose(way - distance_in_turns, distance_in_turns - w) for w in turns[:k])
        ]
    ends = [lifted(after.start, way * 2 * np.pi, after.cart) for way in turns]
    start = lifted(before.end, np.zeros(len(distance_in_turns)), before.cart)
    return _Way(Transfer.of(itinerary, text, start, ends, after.pace), turns)


def ways_round(apart: Array) -> list[Array]:
    """Return the whole turns (n,) that a transfer may add to its end so that the arms go one way or the other.

    An arm that is within a tenth of a whole number of turns has one candidate, and any other arm has two. The same
    holds for the joints of two arms: from Up-Down to rest, the outer arm returns to its angle, or goes on with the
    inner arm. The second way can avoid a fall with folded arms, which some carts cannot control.

    Args:
        apart: angles (n,) of the arms at the start of the transfer minus those of its end, in turns.
    """
    by_arm, by_joint = (
        product(*(sorted({np.floor(a), np.ceil(a)}, key=abs) if 0.1 < a % 1 < 0.9 else [np.rint(a)] for a in angles))
        for angles in (apart, np.diff(apart, prepend=0.0))
    )
    # Three arms have eight ways already.
    further = (tuple(np.cumsum(ways)) for ways in by_joint if len(apart) == 2)
    return [np.array(ways) for ways in dict.fromkeys([*by_arm, *further])]


def _blend(itinerary: Itinerary, leaving: Goal, lift: Array, joining: Goal, progress: Progress) -> SolvedPiece:
    """Return the piece between two walks about one saddle, which may have different energies.

    It leads from the last orbit of one walk to the first orbit of the next, within two to three periods, so that it
    ends in phase. The guess mixes both orbits. If the reference does not converge, its ending names the two energies.

    Args:
        itinerary: arms, limits and settings.
        leaving: walk before the change.
        lift: angles (n,) added to those of the walk before, rad.
        joining: walk after the change.
        progress: receiver of progress reports.
    """
    before, after = leaving.walk, joining.walk
    next_lift = np.rint((leaving.last - joining.first) / (2 * np.pi)) * 2 * np.pi + lift
    first, last = leaving.orbits[1], joining.orbits[0]
    departure, arrival = _phase_at_end(before, first), _phase_at_start(after, last)
    turns = WRAPS + (arrival - departure) % 1.0
    frequencies = (1 / first.period, 1 / last.period)
    duration = 2 * turns / (frequencies[0] + frequencies[1])
    curves = OrbitCurve(first), OrbitCurve(last)
    n = len(lift)
    # Curves are at the saddle's named position. The walk's last lift has all its turns.
    angle_offset = before.offsets[-1][:n] * 2 * np.pi + lift

    def guess(times: Array) -> Array:
        """Return the pendulum's states (K, 2n) at times (K,), s.

        The frequency changes at a constant rate from one orbit's to the other's, and the weight of the states smoothly.
        """
        share_of_time = np.asarray(times, dtype=float) / duration
        phases = departure + duration * (
            frequencies[0] * share_of_time + (frequencies[1] - frequencies[0]) * share_of_time**2 / 2
        )
        share = (share_of_time**2 * (3 - 2 * share_of_time))[:, None]
        states = (1 - share) * curves[0].states(phases) + share * curves[1].states(phases)
        states[:, :n] += angle_offset
        return states

    start, end = before.states(np.array([before.duration]))[0], after.states(np.array([0.0]))[0]
    ends = EndConditions(start=lifted(start, lift), end=lifted(end, next_lift))
    reference = find_reference(cart_problem(itinerary, guess, duration, ends), itinerary.reference, progress=progress)
    if not reference.converged:
        energies = (first.energy, last.energy)
        cause = ReferenceCause.ENERGY_CHANGE
        reference = replace(
            reference, ending=ReferenceEnding(cause, energies=energies, saddle=first.saddle, inner=reference.ending)
        )
    return SolvedPiece(f"change of energy at {first.saddle}", None, next_lift, reference)


def _phase_at_end(orbit: ShadowingOrbit, last: LyapunovOrbit) -> float:
    """Return the phase of a walk's last periodic orbit at the walk's end, in periods."""
    nodes = orbit.orbit
    return nodes.end.orbit_phase + (orbit.duration - float(nodes.times[-1])) / last.period


def _phase_at_start(orbit: ShadowingOrbit, first: LyapunovOrbit) -> float:
    """Return the phase of a walk's first periodic orbit at the walk's start, in periods."""
    nodes = orbit.orbit
    return nodes.start.orbit_phase - float(nodes.times[0]) / first.period


STILL = 0.8
"""Observation time at the ends of an equilibrium, about a period of the orbits, s."""


class _Story:
    """Stops and symbols of a plan in order, with their orbits and equilibria in the order of the first visit.

    All attributes grow as pieces are entered and followed. `symbols` are connections and transfers, `wraps` those of
    the stops between them (None beside a transfer), and `transfers` begin and end of each transfer, s. `orbits` holds
    orbits and equilibria by name of the saddle or equilibrium and energy, J.
    """

    def __init__(self, itinerary: Itinerary) -> None:
        """Start without stops; pieces are entered and followed in order."""
        self.system = itinerary.model.system
        self.stops: list[PlanStop] = []
        self.symbols: list[PlanSymbol] = []
        self.wraps: list[int | None] = []
        self.transfers: list[tuple[float, float]] = []
        self.orbits: dict[tuple[str, float], PlanOrbit] = {}
        self.cart = 0.0
        """Place of the cart at the last stop, m."""

    def enter(self, goal: Goal, angles: Array, text: str) -> None:
        """Add the first stop of a piece, and the transfer that leads to it.

        Without a transfer, or if it ends at the previous stop with the cart at the same place, as a change of energy
        does, the previous stop only gets another orbit. If there is none, the stop is the plan's first one.

        Args:
            goal: walk or stay of the piece.
            angles: angles (n,) of its first stop, with whole turns, rad.
            text: name of the transfer before it, "" without one.
        """
        name = goal.where[0]
        orbit_index = self._at_rest(name) if goal.shadowing is None else self._on(goal.orbits[0])
        at_stop = bool(self.stops) and np.allclose(self.stops[-1].angles, angles)
        if not text or (at_stop and self.cart == goal.cart):
            self._arrive(name, angles, orbit_index, None, None)
            return
        previous_stop = self.stops[-1]
        turns = tuple(map(int, np.rint((angles - np.asarray(previous_stop.angles)) / (2 * np.pi))))
        symbol = PlanSymbol(
            text=text, time=sum(self.transfers[-1]) / 2, source=previous_stop.saddle, target=name, winding=turns
        )
        self._arrive(name, angles, orbit_index, symbol, None)

    def follow(self, goal: Goal, lift: Array, begin: float) -> None:
        """Add the stops and symbols of a walk.

        Args:
            goal: the walk.
            lift: angles (n,) added to those of its orbit, rad.
            begin: time at which the piece begins in the plan, s.
        """
        orbit, n = goal.walk, len(lift)
        symbols = zip(goal.symbols, orbit.connections, orbit.symbol_times, strict=True)
        for k, (text, connection, time) in enumerate(symbols):
            target = connection.target.saddle
            stop_state = self.system.equilibrium(target) + orbit.offsets[k + 1] * self.system.turn_lengths
            crossing = orbit.states(np.array([time]))[0] + np.concatenate([lift, np.zeros(n)])
            symbol = _connection_symbol(text, connection, crossing, begin + float(time) - goal.begin)
            wraps = orbit.wraps[k - 1] if k > 0 else goal.wraps
            self._arrive(target, stop_state[:n] + lift, self._on(connection.target), symbol, wraps)

    def _arrive(self, name: str, angles: Array, orbit: int, symbol: PlanSymbol | None, wraps: int | None) -> None:
        """Add a stop with the symbol that leads to it; without a symbol, give the previous stop another orbit.

        Args:
            name: saddle or equilibrium.
            angles: its angles (n,) with whole turns, rad.
            orbit: index of the orbit at the stop.
            symbol: transfer or connection that leads to the stop, None if the stop is the previous one.
            wraps: wraps between the previous symbol and this one, None after a transfer.
        """
        stop = PlanStop(name, tuple(angles.tolist()), orbit)
        if symbol is None and self.stops:
            self.stops[-1] = replace(stop, arrived_on=self.stops[-1].orbit)
            return
        if symbol is not None:
            if self.symbols:
                self.wraps.append(wraps)
            self.symbols.append(symbol)
        self.stops.append(stop)

    def _on(self, orbit: LyapunovOrbit) -> int:
        """Return the index of a Lyapunov orbit among the plan's orbits, to which it is added on the first visit."""
        if (key := (orbit.saddle, orbit.energy)) not in self.orbits:
            self.orbits[key] = PlanOrbit(
                *key,
                orbit.period,
                orbit.unstable_multiplier,
                OrbitCurve(orbit).samples,
                tuple(orbit.state.tolist()),
                orbit.period,
            )
        return list(self.orbits).index(key)

    def _at_rest(self, name: str) -> int:
        """Return the index of an equilibrium among the plan's orbits, to which it is added on the first visit."""
        state = self.system.equilibrium(name)
        if (key := (name, float(self.system.numeric.hamiltonian(state)))) not in self.orbits:
            self.orbits[key] = PlanOrbit(*key, STILL, 1.0, np.vstack([state, state]))
        return list(self.orbits).index(key)


def content_of_pieces(itinerary: Itinerary, pieces: Sequence[SolvedPiece], begins: Array) -> PlanContent:
    """Return the content of a plan (stops, symbols, orbits, transfers) from its solved pieces.

    Args:
        itinerary: itinerary of the pieces.
        pieces: P pieces in order.
        begins: start of each piece and end of the last, (P+1,), s.
    """
    story, transfer_name = _Story(itinerary), ""
    for piece, begin, end in zip(pieces, begins[:-1], begins[1:], strict=True):
        goal = piece.goal
        if goal is None:
            story.transfers.append((float(begin), float(end)))
            transfer_name = piece.text
            continue
        # A goal with wraps shares its first stop with the goal before.
        if goal.wraps is None:
            story.enter(goal, goal.first + piece.lift, transfer_name)
            story.cart = goal.cart
        if goal.shadowing is not None:
            story.follow(goal, piece.lift, float(begin))
    walks = [piece.goal.shadowing for piece in pieces if piece.goal is not None and piece.goal.shadowing is not None]
    model = itinerary.model
    n = model.system.dimension // 2
    return PlanContent(
        itinerary=itinerary.name,
        title=itinerary.title,
        model=model.name,
        wraps=tuple(story.wraps),
        lead_in=walks[0].lead_in if walks else 0,
        lead_out=walks[-1].lead_out if walks else 0,
        shadowing=Shadowing(
            residual=max((orbit.residual for orbit in walks), default=None),
            duration=sum(orbit.duration for orbit in walks),
            status="; ".join(orbit.status for orbit in walks) or "no walk to shadow",
            wraps_realised=tuple(count for orbit in walks for count in orbit.wraps_realised),
        ),
        stops=tuple(story.stops),
        symbols=tuple(story.symbols),
        transfers=tuple(story.transfers),
        orbits=tuple(story.orbits.values()),
        saddles={
            name: PlanSaddle(tuple(e.state[:n].tolist()), e.energy) for name, e in equilibria(model.system).items()
        },
        origin=Origin(
            program=PROGRAM,
            code=f"planning {PLANNING}",
            scene=itinerary.text,
            scene_hash=content_hash(itinerary.text),
            model=model.text,
            model_hash=content_hash(model.text),
            plant=itinerary.plant,
            parameters=model.arms,
        ),
    )


def _connection_symbol(text: str, connection: Connection, crossing: Array, time: float) -> PlanSymbol:
    """Return a connection as a symbol of a plan, crossed at a time (s) of the plan and a state (2n,) with turns."""
    section = connection.section
    return PlanSymbol(
        text=text, source=connection.source.saddle, target=connection.target.saddle, time=time,
        section=PlanSection(
            section.normal, float(np.dot(section.normal, crossing)), tuple(crossing[: len(crossing) // 2].tolist()),
            section.name, connection.hits,
        ),
        **picked(connection, "name", "winding", "sense", "time_out", "time_in", "phase_out", "phase_in"),
    )  # fmt: skip
