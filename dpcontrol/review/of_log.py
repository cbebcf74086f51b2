"""What there is to see of a log, from the log alone: its series, and its plan, model and score where it has them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, pendulum_system
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import RunLog
from dpcontrol.recordings.recording import SUMMARY
from dpcontrol.references.reference import Reference
from dpcontrol.review.context import PlacedOrbit, PlanView, Stay
from dpcontrol.review.motion import RunView, series_of
from dpcontrol.review.run_tubes import tubes_of
from dpcontrol.review.score import MODEL_METADATA, REFERENCE_ATTACHMENT, plan_of, recovered_note, score
from dpcontrol.review.stops import Decoded, decode_run, orbit_index

Array = NDArray[np.float64]


def run_view(log: RunLog) -> RunView:
    """Return what there is to see of a log; one without a plan, as from a bench, has little.

    Raises:
        InputError: the plan that the log carries is damaged.
    """
    view, system = series_of(log), _system(log)
    n = len(log.arm_lengths)
    states = log.states.get("truth", log.states.get("estimate"))
    if states is not None and system is not None:
        view = replace(view, energy=system.numeric.hamiltonian(states[:, : 2 * n]))
    if states is None or REFERENCE_ATTACHMENT not in log.attachments or "reference" not in log.states:
        return replace(view, verdict=_without_plan(log))
    plan = plan_of(log)
    notes: dict[str, Any] = dict(plan.notes)
    verdict = score(log)
    decoded = decode_run(log.time, states[:, :n], log.reference[:, :n], notes=notes, rate_hz=log.rate_hz)
    seed = "" if verdict.seed is None else f", seed {verdict.seed}"
    return replace(
        view,
        title=f"{notes['title']} — {notes['itinerary']}{seed}",
        limits=limits_of(plan),
        verdict=verdict.sentence,
        good=verdict.completed,
        plan=plan_view(plan, system=system),
        done=_done(decoded, notes, log.time),
        crossings=decoded.crossings,
    )


def limits_of(plan: Reference) -> tuple[float, float, float]:
    """Return the cart's limits in a plan: position in m, velocity in m/s, acceleration in m/s²."""
    return plan.limits.position, plan.limits.velocity, plan.limits.acceleration


def plan_view(plan: Reference, *, system: System | None) -> PlanView:
    """Return what a plan says of itself, before any run; with its tubes where the pendulum is known.

    Raises:
        InputError: the notes are not those of a plan.
    """
    notes: dict[str, Any] = dict(plan.notes)
    try:
        symbols = tuple((float(s["time"]), str(s["text"])) for s in notes.get("symbols") or [])
        stops = [str(stop["saddle"]) for stop in notes.get("stops") or []]
        edges = [float(plan.mesh[0]), *(at for at, _ in symbols), float(plan.mesh[-1])]
        transfers = tuple((float(a), float(b)) for a, b in notes.get("transfers") or [])
        return PlanView(
            orbits=_placed_orbits(plan, notes),
            saddle_energies={str(name): float(s["energy"]) for name, s in (notes.get("saddles") or {}).items()},
            symbols=symbols,
            tubes=tubes_of(notes, system) if system is not None and symbols else (),
            planned=tuple(
                Stay(a, b, name, name)
                for (first, last), name in zip(pairwise(edges), stops, strict=False)
                for a, b in _outside(transfers, first, last)
            ),
            transfers=transfers,
            duration=plan.duration,
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"the reference's notes are not those of a plan ({error}); plan again") from error


def _outside(transfers: tuple[tuple[float, float], ...], first: float, last: float) -> Iterator[tuple[float, float]]:
    """Yield the parts of a stretch of time that no transfer covers."""
    for begin, end in transfers:
        if begin > first and begin < last:
            yield first, begin
        if end > first and begin < last:
            first = end
    if first < last:
        yield first, last


def _placed_orbits(plan: Reference, notes: dict[str, Any]) -> tuple[PlacedOrbit, ...]:
    """Return the orbits of a plan at each place where it stops."""
    placed: dict[tuple[Any, ...], PlacedOrbit] = {}
    for stop in notes.get("stops") or []:
        for k in {orbit_index(notes, stop), stop.get("arrived_on", orbit_index(notes, stop))}:
            note = notes["orbits"][k]
            home = np.asarray(notes["saddles"][stop["saddle"]]["angles"])
            lift = np.asarray(stop["angles"]) - home
            states = np.asarray(plan.extra[f"orbit_{k}"]) + np.concatenate([lift, np.zeros_like(lift)])
            name = f"{note['saddle']} at {note['energy']:.4g} J"
            placed[(k, *np.rint(lift).tolist())] = PlacedOrbit(name, states, note["saddle"])
    return tuple(placed.values())


def _without_plan(log: RunLog) -> str:
    """Return what to say of a log instead of a verdict."""
    seconds = float(log.time[-1] - log.time[0])
    said = log.metadata.get(SUMMARY) or (
        f"{len(log.time):,} samples at {log.rate_hz:g} Hz, {seconds:.4g} s; it carries no plan, so nothing was asked "
        "and nothing is judged"
    )
    return f"{said}; {recovered_note(log)}" if log.recovered else said


def _system(log: RunLog) -> System | None:
    """Return the conservative pendulum of the model that the log names, or None where it names none."""
    try:
        values: dict[str, Any] = json.loads(log.metadata[MODEL_METADATA])
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return pendulum_system(log.metadata.get("model", "model"), ArmChainParameters(**plain))
    except (KeyError, TypeError, ValueError, AttributeError, InputError):
        return None


def _done(decoded: Decoded, notes: dict[str, Any], time: Array) -> tuple[Stay, ...]:
    """Return the visits as stays: those of the plan by their saddle's name, others with where they were."""
    stays = []
    for k, visit in enumerate(decoded.visits):
        wanted = k < decoded.matched
        saddle = _saddle(visit.angles, notes)
        place = ", ".join(f"{angle / np.pi:.0f}π" for angle in visit.angles)
        text = saddle if wanted else f"{saddle} ({place})"
        stays.append(Stay(float(time[visit.first]), float(time[visit.last]), saddle, text, wanted))
    return tuple(stays)


def _saddle(angles: tuple[float, ...], notes: dict[str, Any]) -> str:
    """Return the name of the saddle at lifted angles."""
    for name, saddle in notes["saddles"].items():
        turns = (np.asarray(angles) - np.asarray(saddle["angles"])) / (2 * np.pi)
        if np.allclose(turns, np.rint(turns), atol=1e-6):
            return str(name)
    return "elsewhere"
