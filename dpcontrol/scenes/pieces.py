"""An itinerary's parts as pieces of one reference: walks, holds and rests, with transfers where they do not meet.

Each piece is solved on its own, from a state that is known to a state that is known, and they are joined end to end:
the cost grows with the sum of their lengths, and an infeasible piece is reported by name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.references.find import find_reference, find_transfer, shadowed
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import EndConditions, Guess, ReferenceProblem
from dpcontrol.references.reference import Reference, still
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.walks.shadowing import ShadowingOrbit

Array = NDArray[np.float64]

REST = "down-down"
REST_BEFORE, REST_AFTER = 0.5, 1.0
"""Seconds for which the pendulum hangs still before it starts and after it is back."""
WOBBLES = 2
"""Wobbles in which one orbit becomes another of the same saddle."""


@dataclass(frozen=True)
class Goal:
    """What a piece is to be: a walk's shadowing orbit, or a stay at an equilibrium of `seconds`.

    first, last (n,): angles of the saddles or equilibria at which it starts and ends, on its own lift; start, end
    (2n,): its pendulum states there; symbols: a walk's, as the itinerary writes them.
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


@dataclass(frozen=True)
class SolvedPiece:
    """A solved piece. kind: "walk", "hold" or "transfer"; lift (n,): radians added to its goal's angles.

    wraps: at the stop that it shares with the walk's piece before it; None for a walk in one piece.
    """

    kind: str
    text: str
    goal: Goal | None
    lift: Array
    reference: Reference
    wraps: int | None = None


def walk_goal(orbit: ShadowingOrbit, symbols: tuple[str, ...], *, round_off: tuple[bool, bool]) -> Goal:
    """Return the goal of following a shadowing orbit from its start to its end.

    round_off: whether start and end move out to where their periodic orbits are at phase zero, the arms at the saddle's
    angles: whence they are reached more easily from elsewhere than in mid-swing.
    """
    system, chain = orbit.connections[0].source.system, orbit.connections
    n = system.dimension // 2
    names = (chain[0].source.saddle, chain[-1].target.saddle)
    begin, end = 0.0, orbit.duration
    if round_off[0]:
        begin -= (_phase_at_start(orbit, chain[0].source) % 1.0) * chain[0].source.period
    if round_off[1]:
        end += (-_phase_at_end(orbit, chain[-1].target) % 1.0) * chain[-1].target.period
    ends = orbit.sample(np.array([begin, end]))
    points = [
        (system.equilibrium(name) + offset * system.turn_lengths)[:n]
        for name, offset in zip(names, (orbit.offsets[0], orbit.offsets[-1]), strict=True)
    ]
    return Goal(
        "walk", names, points[0], points[1], ends[0], ends[1], shadowing=orbit, symbols=symbols, begin=begin,
        seconds=end - begin,
    )  # fmt: skip


def stay_goal(itinerary: Itinerary, name: str, seconds: float) -> Goal:
    """Return the goal of staying at an equilibrium."""
    state = itinerary.model.system.equilibrium(name)
    angles = state[: len(state) // 2]
    text = "at rest" if name == REST else f"hold {name}"
    return Goal(text, (name, name), angles, angles, state, state, seconds=seconds)


def solve_pieces(itinerary: Itinerary, goals: Sequence[Goal], *, progress: Progress = no_progress) -> list[SolvedPiece]:
    """Return the pieces that do all goals in order, with the transfers between them.

    A reference that did not converge ends the list: what follows starts where it should have led.

    Raises:
        GoalMissed: no transfer between two goals.
    """
    pieces: list[SolvedPiece] = []
    for k, goal in enumerate(goals):
        here = part_of(progress, k / len(goals), (k + 0.5) / len(goals))
        lift = np.zeros(len(goal.first))
        if k > 0:
            moved = _transfer(itinerary, goals[k - 1], pieces[-1].lift, goal, here)
            pieces.append(moved)
            lift = moved.lift
            if not moved.reference.converged:
                break
        there = part_of(progress, (k + 0.5) / len(goals), (k + 1) / len(goals))
        pieces.append(_own(itinerary, goal, lift, there))
        if not pieces[-1].reference.converged:
            break
    return pieces


def cart_problem(itinerary: Itinerary, guess: Guess, duration: float, ends: EndConditions) -> ReferenceProblem:
    """Return the problem of following a guess for `duration` s with the itinerary's arms, within its limits."""
    return ReferenceProblem(
        equations=equations_of(itinerary.model.arms, Level.CART),
        parameters=itinerary.model.arms.base(),
        guess=guess,
        duration=duration,
        limits=itinerary.limits,
        ends=ends,
    )


def _own(itinerary: Itinerary, goal: Goal, lift: Array, progress: Progress) -> SolvedPiece:
    """Return the piece of a goal itself."""
    turned = np.concatenate([lift, np.zeros(len(lift))])
    settings = itinerary.reference
    if goal.shadowing is None:
        state = np.concatenate([goal.start + turned, [0.0, 0.0]])
        method = method_named(settings.method)
        piece = still(
            state, goal.seconds, method=method, limits=itinerary.limits, interval=max(settings.interval, 0.05)
        )
        return SolvedPiece("hold", goal.text, goal, lift, piece)
    sample = goal.shadowing.sample
    problem = cart_problem(itinerary, lambda times: sample(times + goal.begin) + turned, goal.seconds, EndConditions())
    if settings.level == "conservative":
        free = itinerary.model.arms.frictionless()
        conservative = replace(problem, equations=equations_of(free, Level.CART), parameters=free.base())
        followed = shadowed(conservative, settings)
        return SolvedPiece("walk", goal.text, goal, lift, followed)
    return SolvedPiece("walk", goal.text, goal, lift, find_reference(problem, settings, progress=progress))


def _transfer(itinerary: Itinerary, before: Goal, lift: Array, after: Goal, progress: Progress) -> SolvedPiece:
    """Return the piece from the end of one goal to the start of the next, and the lift of that."""
    start = np.concatenate([before.end + np.concatenate([lift, np.zeros(len(lift))]), [0.0, 0.0]])
    text = f"{_place(before.where[1])} to {_place(after.where[0])}"
    apart = (before.last + lift - after.first) / (2 * np.pi)
    same = before.where[1] == after.where[0]
    if same and before.shadowing is not None and after.shadowing is not None:
        onward = np.rint(apart) * 2 * np.pi
        found = _blend(itinerary, before.shadowing, lift, after.shadowing, onward, progress)
        return SolvedPiece("transfer", f"change of energy at {after.where[0]}", None, onward, found)
    # Half a turn apart, both ways round are tried.
    choices = [sorted({np.floor(a), np.ceil(a)}, key=abs) if 0.1 < a % 1 < 0.9 else [np.rint(a)] for a in apart]
    lifts = [np.array(turns) * 2 * np.pi for turns in product(*choices)]
    ends = [np.concatenate([after.start[: len(m)] + m, after.start[len(m) :], [0.0, 0.0]]) for m in lifts]
    try:
        found = find_transfer(
            equations_of(itinerary.model.arms, Level.CART),
            itinerary.model.arms.base(),
            start=start,
            ends=ends,
            limits=itinerary.limits,
            settings=itinerary.reference,
            progress=progress,
        )
    except GoalMissed as error:
        raise GoalMissed(f"{text}: {error}") from error
    landed = found.state(found.duration)
    chosen = lifts[int(np.argmin([np.abs(landed - end).max() for end in ends]))]
    return SolvedPiece("transfer", text, None, chosen, found)


def _place(name: str) -> str:
    return "rest" if name == REST else name


def _blend(
    itinerary: Itinerary,
    before: ShadowingOrbit,
    lift: Array,
    after: ShadowingOrbit,
    onward: Array,
    progress: Progress,
) -> Reference:
    """Return the reference from the last orbit of one walk to the first of the next, about one saddle."""
    first, last = before.connections[-1].target, after.connections[0].source
    leaving, arriving = _phase_at_end(before, first), _phase_at_start(after, last)
    turns = WOBBLES + (arriving - leaving) % 1.0
    pace = (1 / first.period, 1 / last.period)
    duration = 2 * turns / (pace[0] + pace[1])
    curves = OrbitCurve(first), OrbitCurve(last)
    n = len(lift)
    # Curves are at the saddle's named position; the walk's last lift is that of all its turns.
    home = before.offsets[-1][:n] * 2 * np.pi + lift

    def guess(times: Array) -> Array:
        s = np.asarray(times, dtype=float) / duration
        phases = leaving + duration * (pace[0] * s + (pace[1] - pace[0]) * s**2 / 2)
        share = (s**2 * (3 - 2 * s))[:, None]
        states = (1 - share) * curves[0].states(phases) + share * curves[1].states(phases)
        states[:, :n] += home
        return states

    end = after.sample(np.array([0.0]))[0]
    start = before.sample(np.array([before.duration]))[0]
    shift = [np.concatenate([turned, np.zeros(n)]) for turned in (lift, onward)]
    ends = EndConditions(
        start=np.concatenate([start + shift[0], [0.0, 0.0]]), end=np.concatenate([end + shift[1], [0.0, 0.0]])
    )
    found = find_reference(cart_problem(itinerary, guess, duration, ends), itinerary.reference, progress=progress)
    if found.converged:
        return found
    text = f"from {first.energy:g} J to {last.energy:g} J at {first.saddle}"
    return replace(found, status=f"no change of energy {text}: {found.status}")


def _phase_at_end(orbit: ShadowingOrbit, last: LyapunovOrbit) -> float:
    nodes = orbit.orbit
    return nodes.end.orbit_phase + (orbit.duration - float(nodes.times[-1])) / last.period


def _phase_at_start(orbit: ShadowingOrbit, first: LyapunovOrbit) -> float:
    nodes = orbit.orbit
    return nodes.start.orbit_phase - float(nodes.times[0]) / first.period
