"""What a plan says beyond the trajectory: notes (JSON) and arrays that score and review need, kept with the reference.

stay      kind "orbit" or "hold", for an itinerary that goes nowhere; what it takes to make its controller
program   stays ("keep") and flights ("fly") one after the other, for a walk whose stops are kept; rows: the intervals
          of the mesh, of a stay those of its first period; turns: by which its states are away from the orbit's own
stops     where the pendulum wobbles or rests: saddle, angles (lifted), orbit (index into orbits)
symbols   what leads from stop to stop: a connection, or a transfer (name null, no section)
wraps     one for each interior stop; null where they are not counted: beside a transfer
transfers times between which the pendulum is on its way from piece to piece
orbits    periodic orbits and equilibria by index; samples of each are the array orbit_K
made_from what makes it again: texts of scene and model with their hashes, arms' parameters, program, code's hash
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dpcontrol
from dpcontrol.foundation.files import content_hash
from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.symmetric_shooting import equilibria
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.pieces import Goal, Piece
from dpcontrol.tubes.connection import Connection

Array = NDArray[np.float64]

STILL = 0.8
"""Seconds that stand for the period of an equilibrium, about those of the orbits: how long its ends are looked at."""


class _Orbits:
    """Orbits and equilibria in the order in which they are first met."""

    def __init__(self, itinerary: Itinerary) -> None:
        self.system = itinerary.model.system
        self.entries: list[dict[str, Any]] = []
        self.samples: list[Array] = []
        self._index: dict[tuple[str, float], int] = {}

    def of(self, orbit: LyapunovOrbit) -> int:
        """Return the index of a periodic orbit."""
        values = {"period": orbit.period, "multiplier": orbit.unstable_multiplier}
        return self._place(orbit.saddle, orbit.energy, values, lambda: OrbitCurve(orbit).samples)

    def at_rest(self, name: str) -> int:
        """Return the index of an equilibrium."""
        state = self.system.equilibrium(name)
        energy = float(self.system.numeric.hamiltonian(state))
        return self._place(name, energy, {"period": STILL, "multiplier": 1.0}, lambda: np.vstack([state, state]))

    def _place(self, name: str, energy: float, values: dict[str, float], samples: Any) -> int:
        key = (name, energy)
        if key not in self._index:
            self._index[key] = len(self.entries)
            self.entries.append({"saddle": name, "energy": energy, **values})
            self.samples.append(samples())
        return self._index[key]


class _Story:
    """Stops and symbols as they follow one another."""

    def __init__(self) -> None:
        self.stops: list[dict[str, Any]] = []
        self.symbols: list[dict[str, Any]] = []
        self.wraps: list[int | None] = []

    def arrive(self, name: str, angles: Array, orbit: int, symbol: dict[str, Any] | None, wraps: int | None) -> None:
        """Add a stop and the symbol that leads to it; none where it is the stop before, on another orbit."""
        stop = {"saddle": name, "angles": [float(angle) for angle in angles], "orbit": orbit}
        if symbol is None and self.stops:
            self.stops[-1] = {**stop, "arrived_on": self.stops[-1]["orbit"]}
            return
        if symbol is not None:
            if self.symbols:
                self.wraps.append(wraps)
            self.symbols.append(symbol)
        self.stops.append(stop)


def plan_notes(itinerary: Itinerary, pieces: Sequence[Piece], begins: Array) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the notes of solved pieces that begin at `begins` (P + 1,) s, and the arrays that go with them."""
    orbits, story = _Orbits(itinerary), _Story()
    transfers: list[list[float]] = []
    way: dict[str, Any] | None = None
    for piece, begin, end in zip(pieces, begins[:-1], begins[1:], strict=True):
        goal = piece.goal
        if goal is None:
            transfers.append([float(begin), float(end)])
            way = {"text": piece.text, "time": float(begin + end) / 2}
            continue
        walk = goal.shadowing
        index = orbits.at_rest(goal.where[0]) if walk is None else orbits.of(walk.connections[0].source)
        if piece.wraps is None:
            _enter(story, goal, goal.first + piece.lift, index, way)
        if goal.shadowing is not None:
            _follow(story, orbits, piece, float(begin))
    walks = [piece.goal.shadowing for piece in pieces if piece.goal is not None and piece.goal.shadowing is not None]
    energy = walks[0].connections[0].source.energy if walks else None
    notes = {
        **notes_of(
            itinerary, stops=story.stops, symbols=story.symbols, wraps=story.wraps, orbits=orbits.entries, energy=energy
        ),
        "lead_in": walks[0].lead_in if walks else None,
        "lead_out": walks[-1].lead_out if walks else None,
        "shadowing": {
            "residual": max((orbit.residual for orbit in walks), default=None),
            "duration": sum(orbit.duration for orbit in walks),
            "status": "; ".join(orbit.status for orbit in walks) or "no walk to shadow",
            "wraps_realised": [count for orbit in walks for count in orbit.wraps_realised],
        },
        "transfers": transfers,
    }
    return notes, {f"orbit_{k}": samples for k, samples in enumerate(orbits.samples)}


def notes_of(
    itinerary: Itinerary,
    *,
    stops: list[dict[str, Any]],
    symbols: list[dict[str, Any]],
    wraps: list[int | None],
    orbits: list[dict[str, Any]],
    energy: float | None,
) -> dict[str, Any]:
    """Return what every plan's notes hold; energy: of the first orbit, J."""
    system = itinerary.model.system
    n = system.dimension // 2
    return {
        "itinerary": itinerary.name,
        "title": itinerary.title,
        "model": itinerary.model.name,
        "energy": energy,
        "walk": [s["name"] or s["text"] for s in symbols],
        "wraps": wraps,
        "lead_in": None,
        "lead_out": None,
        "shadowing": {"residual": None, "duration": 0.0, "status": "no walk to shadow", "wraps_realised": []},
        "stops": stops,
        "symbols": symbols,
        "transfers": [],
        "orbits": orbits,
        "saddles": {
            name: {"angles": e.state[:n].tolist(), "energy": e.energy} for name, e in equilibria(system).items()
        },
        "made_from": _made_from(itinerary),
    }


def _made_from(itinerary: Itinerary) -> dict[str, Any]:
    return {
        "program": f"dpcontrol {dpcontrol.__version__}",
        "scene": itinerary.text,
        "scene_hash": content_hash(itinerary.text),
        "model": itinerary.model.text,
        "model_hash": content_hash(itinerary.model.text),
        "parameters": {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(itinerary.model.arms).items()
        },
    }


def _enter(story: _Story, goal: Goal, angles: Array, orbit: int, way: dict[str, Any] | None) -> None:
    """Come to the first stop of a piece, by the transfer before it if there was one."""
    name = goal.where[0]
    moved = not story.stops or not np.allclose(story.stops[-1]["angles"], angles)
    if way is None or not moved:
        story.arrive(name, angles, orbit, None, None)
        return
    before = story.stops[-1]
    winding = np.rint((angles - np.asarray(before["angles"])) / (2 * np.pi))
    symbol = {
        **way,
        "name": None,
        "source": before["saddle"],
        "target": name,
        "winding": [int(turns) for turns in winding],
        "sense": 0,
        "section": None,
        "time_out": None,
        "time_in": None,
        "phase_out": None,
        "phase_in": None,
    }
    story.arrive(name, angles, orbit, symbol, None)


def _follow(story: _Story, orbits: _Orbits, piece: Piece, begin: float) -> None:
    """Add the stops and symbols of a walk."""
    assert piece.goal is not None
    orbit = piece.goal.shadowing
    assert orbit is not None
    system = orbit.connections[0].source.system
    n = len(piece.lift)
    lift = np.concatenate([piece.lift, np.zeros(n)])
    rows = zip(piece.goal.symbols, orbit.connections, orbit.symbol_times, strict=True)
    for k, (text, connection, time) in enumerate(rows):
        target = connection.target.saddle
        angles = (system.equilibrium(target) + orbit.offsets[k + 1] * system.turn_lengths)[:n] + piece.lift
        crossing = orbit.sample(np.array([time]))[0] + lift
        symbol = _connection_note(text, connection, crossing, begin + float(time) - piece.goal.begin)
        wraps = orbit.wraps[k - 1] if k > 0 else piece.wraps
        story.arrive(target, angles, orbits.of(connection.target), symbol, wraps)


def _connection_note(text: str, connection: Connection, crossing: Array, time: float) -> dict[str, Any]:
    return {
        "text": text,
        "name": connection.name,
        "source": connection.source.saddle,
        "target": connection.target.saddle,
        "winding": list(connection.winding),
        "sense": connection.sense,
        "time": time,
        "section": {
            "normal": list(connection.section.normal),
            "value": float(np.dot(connection.section.normal, crossing)),
            "angles": crossing[: len(crossing) // 2].tolist(),
        },
        "time_out": connection.time_out,
        "time_in": connection.time_in,
        "phase_out": connection.phase_out,
        "phase_in": connection.phase_in,
    }
