"""What makes a plan: the reference of an itinerary, with the notes and arrays that go with it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.references.notes import PlanNotes
from dpcontrol.references.reference import Reference, joined
from dpcontrol.scenes.itinerary import HoldPart, Itinerary, WalkPart
from dpcontrol.scenes.kept_walks import plan_kept, plan_stay
from dpcontrol.scenes.pieces import (
    REST,
    REST_AFTER,
    REST_BEFORE,
    Goal,
    notes_of_pieces,
    solve_pieces,
    stay_goal,
    walk_goal,
)
from dpcontrol.tubes.connection import Connection
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver
from dpcontrol.walks.symbols import parse_walk
from dpcontrol.walks.walks import resolve

Array = NDArray[np.float64]


def planned(
    itinerary: Itinerary, orbits: Sequence[ShadowingOrbit] = (), *, progress: Progress = no_progress
) -> tuple[Reference, PlanNotes, dict[str, Array]]:
    """Return the reference of an itinerary, its notes and arrays; orbits: that shadow its walks, where they are known.

    Raises:
        InputError: the walk asks for connections that do not exist at this energy.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    if itinerary.stay is not None:
        return plan_stay(itinerary, itinerary.stay, progress=progress)
    if itinerary.keeps:
        walk = itinerary.walks[0]
        chain, solver = _connections(itinerary, walk, part_of(progress, 0.0, 0.5))
        return plan_kept(itinerary, walk, chain, solver, progress=part_of(progress, 0.5, 1.0))
    goals = _goals(itinerary, list(orbits), part_of(progress, 0.0, 0.4))
    pieces = solve_pieces(itinerary, goals, progress=part_of(progress, 0.4, 1.0))
    reference, begins = joined([piece.reference for piece in pieces])
    return reference, *notes_of_pieces(itinerary, pieces, begins)


def _goals(itinerary: Itinerary, orbits: list[ShadowingOrbit], progress: Progress) -> list[Goal]:
    """Return what the itinerary is to do, one goal for each part, and rests at its ends where it asks for them."""
    goals = [stay_goal(itinerary, REST, REST_BEFORE)] if itinerary.start == "rest" else []
    for k, part in enumerate(itinerary.parts):
        if isinstance(part, WalkPart):
            here = part_of(progress, k / len(itinerary.parts), (k + 1) / len(itinerary.parts))
            orbit = orbits.pop(0) if orbits else shadowing_orbit(itinerary, part=part, progress=here)
            beside = [itinerary.parts[j] if 0 <= j < len(itinerary.parts) else None for j in (k - 1, k + 1)]
            ends = (itinerary.start, itinerary.finish)
            # Towards another walk the orbits meet as they are; towards rest or a hold there is a transfer.
            apart = (e == "rest" if b is None else isinstance(b, HoldPart) for e, b in zip(ends, beside, strict=True))
            goals.append(walk_goal(orbit, part.walk, round_off=(next(apart), next(apart))))
        elif isinstance(part, HoldPart):
            goals.append(stay_goal(itinerary, part.hold, part.seconds))
    if itinerary.finish == "rest":
        goals.append(stay_goal(itinerary, REST, REST_AFTER))
    return goals


def shadowing_orbit(
    itinerary: Itinerary, *, part: WalkPart | None = None, progress: Progress = no_progress
) -> ShadowingOrbit:
    """Find the connections of a part's walk (the first walk's by default) and the orbit that shadows them.

    Raises:
        InputError: the walk asks for connections that do not exist at this energy, or there is no walk.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    if part is None:
        if not itinerary.walks:
            raise InputError(f"{itinerary.name} has no walk, only holds")
        part = itinerary.walks[0]
    chain, solver = _connections(itinerary, part, part_of(progress, 0.0, 0.9))
    progress("shadowing orbit", 0.9)
    result = solver.solve(chain, part.wraps, lead_in=part.lead_in, lead_out=part.lead_out)
    if not result.converged:
        raise GoalMissed(f"the shadowing orbit: {result.status}; {solver.advice(result)}")
    return result


def _connections(itinerary: Itinerary, part: WalkPart, progress: Progress) -> tuple[tuple[Connection, ...], WalkSolver]:
    """Return the connections of a part's walk, and what finds the orbits that shadow them."""
    system = itinerary.model.system
    symbols = parse_walk(part.walk, system.saddles)
    pairs = list(dict.fromkeys((s.source, s.target) for symbol in symbols for s in symbol.simple))
    edges = find_edges(system, part.energy, pairs=pairs, symbols=symbols, progress=progress)
    if edges.absent:
        raise GoalMissed("; ".join(reason for _, reason in edges.absent))
    return resolve(part.walk, edges), WalkSolver(edges.known)
