"""From an itinerary to its reference: connections, shadowing orbit, collocation; kept by content.

What the plan says beyond the trajectory (symbols, stops, orbits) is stored with the reference as notes and arrays,
so that a log that carries the reference can be scored and reviewed alone.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import Progress, content_hash, no_progress
from dpcontrol.itineraries.edges import find_edges, saddles_with_tubes
from dpcontrol.itineraries.shadowing import ShadowingOrbit
from dpcontrol.itineraries.walk import parse_walk
from dpcontrol.itineraries.walks import resolve
from dpcontrol.itineraries.wraps import WalkSolver
from dpcontrol.references.archive import load_reference, save_reference
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import ReferenceProblem
from dpcontrol.references.reference import Reference
from dpcontrol.scenes.cache import cache_folder, code_hash
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.tubes.equilibria import equilibria
from dpcontrol.tubes.lyapunov import LyapunovOrbit
from dpcontrol.tubes.orbit_curve import OrbitCurve

Array = NDArray[np.float64]

FORMAT = 1
"""Raised whenever the notes change their meaning."""


@dataclass(frozen=True)
class Plan:
    """An itinerary's reference with its notes; file: where it is kept; cached: whether it was found there."""

    itinerary: Itinerary
    reference: Reference
    file: Path
    cached: bool

    @property
    def notes(self) -> dict[str, Any]:
        """What the plan says beyond the trajectory; see `_notes`."""
        return dict(self.reference.notes)

    @property
    def status(self) -> str:
        """How the reference's search ended."""
        return self.reference.status


def plan_key(itinerary: Itinerary) -> str:
    """Return the content that a plan depends on, as 16 hexadecimal digits."""
    content = {
        "format": FORMAT,
        "code": code_hash(),
        "parameters": asdict(itinerary.model.arms),
        "name": itinerary.name,
        "title": itinerary.title,
        "model": itinerary.model.name,
        "energy": itinerary.energy,
        "walk": itinerary.walk,
        "wraps": itinerary.wraps,
        "repeat": itinerary.repeat,
        "leads": (itinerary.lead_in, itinerary.lead_out),
        "limits": asdict(itinerary.limits),
        "reference": asdict(itinerary.reference),
    }
    return content_hash(json.dumps(content, sort_keys=True))


def make_plan(itinerary: Itinerary, *, progress: Progress = no_progress, fresh: bool = False) -> Plan:
    """Return the plan of an itinerary, from the cache unless `fresh`.

    A reference that did not converge is returned with its status and not kept.

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
    shadowing = shadowing_orbit(itinerary, progress=_part(progress, 0.0, 0.4))
    equations = arm_chain_equations(itinerary.model.arms.count, Level.CART)
    problem = ReferenceProblem(
        equations=equations,
        parameters=itinerary.model.arms.base(),
        guess=shadowing.sample,
        duration=shadowing.duration,
        limits=itinerary.limits,
    )
    reference = find_reference(problem, itinerary.reference, progress=_part(progress, 0.4, 1.0))
    notes, arrays = _notes(itinerary, shadowing)
    reference = replace(reference, notes={**reference.notes, **notes}, extra={**reference.extra, **arrays})
    if reference.converged:
        save_reference(file, reference)
    return Plan(itinerary, reference, file, cached=False)


def shadowing_orbit(itinerary: Itinerary, *, progress: Progress = no_progress) -> ShadowingOrbit:
    """Find the connections of the walk and the orbit that shadows them.

    Raises:
        InputError: the walk asks for connections that do not exist at this energy.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    system = itinerary.model.system
    symbols = parse_walk(itinerary.walk, saddles_with_tubes(system))
    pairs = list(dict.fromkeys((s.source, s.target) for s in symbols))
    hits = {(1, 1), *(s.hits for s in symbols if s.hits is not None)}
    edges = find_edges(system, itinerary.energy, pairs=pairs, hits=hits, progress=_part(progress, 0.0, 0.9))
    if edges.absent:
        raise GoalMissed("; ".join(reason for _, reason in edges.absent))
    chain = resolve(itinerary.walk, edges)
    progress("shadowing orbit", 0.9)
    solver = WalkSolver(edges.connections)
    result = solver.solve(chain, itinerary.wraps, lead_in=itinerary.lead_in, lead_out=itinerary.lead_out)
    if not result.converged:
        raise GoalMissed(f"the shadowing orbit: {result.status}; {solver.advice(result)}")
    return result


def _part(progress: Progress, low: float, high: float) -> Progress:
    """Return a progress that reports into a part of another."""
    report: Callable[[str, float], None] = lambda what, done: progress(what, low + (high - low) * done)  # noqa: E731
    return report


def _notes(itinerary: Itinerary, shadowing: ShadowingOrbit) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what score and review need: JSON notes, and each orbit's samples as arrays `orbit_K`."""
    system = itinerary.model.system
    n = system.dimension // 2
    orbits: list[LyapunovOrbit] = []
    for connection in shadowing.connections:
        orbits += [o for o in (connection.source, connection.target) if o.saddle not in [p.saddle for p in orbits]]
    turn = system.turn_lengths
    names = [shadowing.connections[0].source.saddle, *(c.target.saddle for c in shadowing.connections)]
    stops = [
        {"saddle": name, "angles": (system.equilibrium(name) + offset * turn)[:n].tolist()}
        for name, offset in zip(names, shadowing.offsets, strict=True)
    ]
    symbols = [
        {
            "text": text,
            "name": c.name,
            "source": c.source.saddle,
            "target": c.target.saddle,
            "winding": list(c.winding),
            "sense": c.sense,
            "time": float(time),
            "section": {
                "normal": list(c.section.normal),
                "value": float(np.dot(c.section.normal, shadowing.sample(np.array([time]))[0])),
            },
            "time_out": c.time_out,
            "time_in": c.time_in,
            "phase_out": c.phase_out,
            "phase_in": c.phase_in,
        }
        for text, c, time in zip(itinerary.walk, shadowing.connections, shadowing.symbol_times, strict=True)
    ]
    notes = {
        "plan": plan_key(itinerary),
        "itinerary": itinerary.name,
        "title": itinerary.title,
        "model": itinerary.model.name,
        "energy": itinerary.energy,
        "walk": list(shadowing.walk),
        "wraps": list(shadowing.wraps),
        "lead_in": shadowing.lead_in,
        "lead_out": shadowing.lead_out,
        "shadowing": {
            "residual": shadowing.residual,
            "duration": shadowing.duration,
            "status": shadowing.status,
            "wraps_realised": list(shadowing.wraps_realised),
        },
        "stops": stops,
        "symbols": symbols,
        "orbits": [
            {"saddle": o.saddle, "energy": o.energy, "period": o.period, "multiplier": o.unstable_multiplier}
            for o in orbits
        ],
        "saddles": {
            name: {"angles": e.state[:n].tolist(), "energy": e.energy} for name, e in equilibria(system).items()
        },
    }
    return notes, {f"orbit_{k}": OrbitCurve(orbit).samples for k, orbit in enumerate(orbits)}
