"""From an itinerary to its reference: connections, shadowing orbit, collocation; kept by content.

What the plan says beyond the trajectory (symbols, stops, orbits) is stored with the reference as notes and arrays,
so that a log that carries the reference can be scored and reviewed alone.
"""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.references.reference import Reference, joined, load_reference, save_reference
from dpcontrol.scenes.cache import cache_folder, code_hash
from dpcontrol.scenes.itinerary import HoldPart, Itinerary, WalkPart, itinerary_from
from dpcontrol.scenes.kept_walks import plan_kept
from dpcontrol.scenes.model import model_from
from dpcontrol.scenes.notes import plan_notes
from dpcontrol.scenes.pieces import REST, REST_AFTER, REST_BEFORE, Goal, solve_pieces, stay_goal, walk_goal
from dpcontrol.scenes.stays import plan_stay
from dpcontrol.tubes.connection import Connection
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver
from dpcontrol.walks.symbols import parse_walk
from dpcontrol.walks.walks import resolve

FORMAT = 2
"""Raised whenever the notes change their meaning."""


@dataclass(frozen=True)
class Plan:
    """An itinerary's reference with its notes; file: where it is kept; cached: whether it was found there.

    Of a reference that did not converge there is no file.
    """

    itinerary: Itinerary
    reference: Reference
    file: Path
    cached: bool

    def __repr__(self) -> str:
        return f"<plan {self.itinerary.name!r}: {self.status}>"

    @property
    def notes(self) -> dict[str, Any]:
        """What the plan says beyond the trajectory; see `dpcontrol.scenes.notes`."""
        return dict(self.reference.notes)

    @property
    def status(self) -> str:
        """How the reference's search ended."""
        return self.reference.status

    @property
    def converged(self) -> bool:
        """Whether there is a reference to follow."""
        return self.reference.converged

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol plan --json` prints."""
        reference, notes = self.reference, self.notes
        return {
            "walk": notes["walk"],
            "wraps": notes["wraps"],
            "shadowing": notes["shadowing"],
            "reference": {
                "duration": reference.duration,
                "intervals": len(reference.mesh) - 1,
                "max_error_between_nodes": reference.max_error_between_nodes,
                "constraint_violation": reference.constraint_violation,
                "max_cart_position": reference.max_cart_position,
                "max_cart_velocity": reference.max_cart_velocity,
                "max_cart_acceleration": reference.max_cart_acceleration,
                "rms_cart_acceleration": reference.rms_cart_acceleration,
                "iterations": reference.iterations,
                "solve_seconds": reference.solve_seconds,
                "status": reference.status,
            },
            "file": str(self.file) if self.converged else None,
            "cached": self.cached,
            "status": self.status,
        }


def plan_key(itinerary: Itinerary) -> str:
    """Return the content that a plan depends on, as 16 hexadecimal digits."""
    content = {
        "format": FORMAT,
        "code": code_hash(__name__),
        "parameters": asdict(itinerary.model.arms),
        "name": itinerary.name,
        "title": itinerary.title,
        "model": itinerary.model.name,
        "parts": [asdict(part) for part in itinerary.parts],
        "ends": (itinerary.start, itinerary.finish),
        "limits": asdict(itinerary.limits),
        "reference": asdict(itinerary.reference),
        "keeps": itinerary.keeps,
    }
    return content_hash(json.dumps(content, sort_keys=True))


def make_plan(
    itinerary: Itinerary,
    *,
    orbits: Sequence[ShadowingOrbit] = (),
    progress: Progress = no_progress,
    fresh: bool = False,
) -> Plan:
    """Return the plan of an itinerary, from the cache unless `fresh`.

    orbits: that shadow the itinerary's walks, one for each, where they are known already. A reference that did not
    converge is returned with its status and not kept.

    Raises:
        InputError: the walk asks for connections that do not exist at this energy.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    file = cache_folder("plans") / f"{itinerary.name}-{plan_key(itinerary)}.npz"
    if not fresh and file.is_file():
        # A damaged cache entry, or one under another's name, is replaced as if it were not there.
        with suppress(InputError):
            kept = load_reference(file)
            if kept.notes.get("plan") == plan_key(itinerary):
                return Plan(itinerary, kept, file, cached=True)
    if itinerary.stay is not None:
        reference, notes, arrays = plan_stay(itinerary, itinerary.stay, progress=progress)
    elif itinerary.keeps:
        walk = itinerary.walks[0]
        chain, solver = _connections(itinerary, walk, part_of(progress, 0.0, 0.5))
        flying = part_of(progress, 0.5, 1.0)
        reference, notes, arrays = plan_kept(itinerary, walk, chain, solver, progress=flying)
    else:
        goals = _goals(itinerary, list(orbits), part_of(progress, 0.0, 0.4))
        pieces = solve_pieces(itinerary, goals, progress=part_of(progress, 0.4, 1.0))
        reference, begins = joined([piece.reference for piece in pieces])
        notes, arrays = plan_notes(itinerary, pieces, begins)
    notes |= {"plan": plan_key(itinerary), "made_from": {**notes["made_from"], "code": code_hash(__name__)}}
    reference = replace(reference, notes={**reference.notes, **notes}, extra={**reference.extra, **arrays})
    if reference.converged:
        save_reference(file, reference)
    return Plan(itinerary, reference, file, cached=False)


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


def load_plan(file: Path) -> Plan:
    """Return the plan in a file that was made by planning: its itinerary from the texts that it was made from.

    Raises:
        InputError: the file is missing, damaged, or a reference that no plan made.
    """
    reference = load_reference(file)
    notes = reference.notes
    try:
        model = model_from(notes["made_from"]["model"], notes["model"])
        scene = itinerary_from(notes["made_from"]["scene"], notes["itinerary"], model)
    except (KeyError, TypeError) as error:
        raise InputError(f"{file} is a reference, but its notes are not those of a plan: {error}") from error
    return Plan(scene, reference, file, cached=True)
