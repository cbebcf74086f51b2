"""The notes of a plan, from its pieces: what score, review and controllers need, by the types of `references.notes`."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

import dpcontrol
from dpcontrol.foundation.files import content_hash
from dpcontrol.orbits.curve import OrbitCurve
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.symmetric_shooting import equilibria
from dpcontrol.references.notes import OrbitNote, PlanNotes, StopNote, SymbolNote
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.pieces import Goal, SolvedPiece
from dpcontrol.tubes.connection import Connection

Array = NDArray[np.float64]

STILL = 0.8
"""Seconds that stand for the period of an equilibrium, about those of the orbits: how long its ends are looked at."""


class _Story:
    """Stops and symbols as they follow one another, and orbits and equilibria in the order in which they are met."""

    def __init__(self, itinerary: Itinerary) -> None:
        self.system = itinerary.model.system
        self.stops: list[StopNote] = []
        self.symbols: list[SymbolNote] = []
        self.wraps: list[int | None] = []
        self.transfers: list[list[float]] = []
        self.orbits: list[OrbitNote] = []
        self.samples: list[Array] = []

    def transfer(self, begin: float, end: float) -> None:
        """Add a time between pieces."""
        self.transfers.append([begin, end])

    def enter(self, goal: Goal, angles: Array, text: str) -> None:
        """Come to the first stop of a piece, by the transfer before it, named by its text, if there was one."""
        name = goal.where[0]
        here = self._at_rest(name) if goal.shadowing is None else self._on(goal.shadowing.connections[0].source)
        if not text or (self.stops and np.allclose(self.stops[-1]["angles"], angles)):
            self._arrive(name, angles, here, None, None)
            return
        before = self.stops[-1]
        winding = np.rint((angles - np.asarray(before["angles"])) / (2 * np.pi))
        symbol = {
            "text": text, "time": sum(self.transfers[-1]) / 2, "name": None, "source": before["saddle"],
            "target": name, "winding": [int(turns) for turns in winding], "sense": 0, "section": None,
            "time_out": None, "time_in": None, "phase_out": None, "phase_in": None,
        }  # fmt: skip
        self._arrive(name, angles, here, symbol, None)  # type: ignore[arg-type]

    def follow(self, piece: SolvedPiece, begin: float) -> None:
        """Add the stops and symbols of a walk that begins at this time, s."""
        assert piece.goal is not None
        orbit = piece.goal.shadowing
        assert orbit is not None
        n = len(piece.lift)
        lift = np.concatenate([piece.lift, np.zeros(n)])
        rows = zip(piece.goal.symbols, orbit.connections, orbit.symbol_times, strict=True)
        for k, (text, connection, time) in enumerate(rows):
            target = connection.target.saddle
            home = self.system.equilibrium(target) + orbit.offsets[k + 1] * self.system.turn_lengths
            crossing = orbit.sample(np.array([time]))[0] + lift
            symbol = _connection_note(text, connection, crossing, begin + float(time) - piece.goal.begin)
            wraps = orbit.wraps[k - 1] if k > 0 else piece.wraps
            self._arrive(target, home[:n] + piece.lift, self._on(connection.target), symbol, wraps)

    def _arrive(self, name: str, angles: Array, orbit: int, symbol: SymbolNote | None, wraps: int | None) -> None:
        """Add a stop and the symbol that leads to it; none where it is the stop before, on another orbit."""
        stop: StopNote = {"saddle": name, "angles": [float(angle) for angle in angles], "orbit": orbit}
        if symbol is None and self.stops:
            self.stops[-1] = {**stop, "arrived_on": self.stops[-1]["orbit"]}
            return
        if symbol is not None:
            if self.symbols:
                self.wraps.append(wraps)
            self.symbols.append(symbol)
        self.stops.append(stop)

    def _on(self, orbit: LyapunovOrbit) -> int:
        values = orbit.energy, orbit.period, orbit.unstable_multiplier
        return self._index(orbit.saddle, *values, lambda: OrbitCurve(orbit).samples)

    def _at_rest(self, name: str) -> int:
        state = self.system.equilibrium(name)
        energy = float(self.system.numeric.hamiltonian(state))
        return self._index(name, energy, STILL, 1.0, lambda: np.vstack([state, state]))

    def _index(self, saddle: str, energy: float, period: float, multiplier: float, samples: Callable[[], Array]) -> int:
        known = [(one["saddle"], one["energy"]) for one in self.orbits]
        if (saddle, energy) not in known:
            self.orbits.append({"saddle": saddle, "energy": energy, "period": period, "multiplier": multiplier})
            self.samples.append(samples())
            return len(known)
        return known.index((saddle, energy))


def notes_of_pieces(
    itinerary: Itinerary, pieces: Sequence[SolvedPiece], begins: Array
) -> tuple[PlanNotes, dict[str, Array]]:
    """Return the notes of solved pieces that begin at `begins` (P + 1,) s, and the arrays that go with them."""
    story, way = _Story(itinerary), ""
    for piece, begin, end in zip(pieces, begins[:-1], begins[1:], strict=True):
        goal = piece.goal
        if goal is None:
            story.transfer(float(begin), float(end))
            way = piece.text
            continue
        if piece.wraps is None:
            story.enter(goal, goal.first + piece.lift, way)
        if goal.shadowing is not None:
            story.follow(piece, float(begin))
    walks = [piece.goal.shadowing for piece in pieces if piece.goal is not None and piece.goal.shadowing is not None]
    notes = notes_of(
        itinerary, stops=story.stops, symbols=story.symbols, wraps=story.wraps, orbits=story.orbits,
        energy=walks[0].connections[0].source.energy if walks else None,
    )  # fmt: skip
    notes["transfers"] = story.transfers
    if walks:
        notes["lead_in"], notes["lead_out"] = walks[0].lead_in, walks[-1].lead_out
        notes["shadowing"] = {
            "residual": max(orbit.residual for orbit in walks),
            "duration": sum(orbit.duration for orbit in walks),
            "status": "; ".join(orbit.status for orbit in walks),
            "wraps_realised": [count for orbit in walks for count in orbit.wraps_realised],
        }
    return notes, {f"orbit_{k}": samples for k, samples in enumerate(story.samples)}


def notes_of(
    itinerary: Itinerary,
    *,
    stops: list[StopNote],
    symbols: list[SymbolNote],
    wraps: list[int | None],
    orbits: list[OrbitNote],
    energy: float | None,
) -> PlanNotes:
    """Return what every plan's notes hold; energy: of the first orbit, J."""
    model = itinerary.model
    n = model.system.dimension // 2
    return {
        "itinerary": itinerary.name,
        "title": itinerary.title,
        "model": model.name,
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
            name: {"angles": e.state[:n].tolist(), "energy": e.energy} for name, e in equilibria(model.system).items()
        },
        "made_from": {
            "program": f"dpcontrol {dpcontrol.__version__}",
            "scene": itinerary.text,
            "scene_hash": content_hash(itinerary.text),
            "model": model.text,
            "model_hash": content_hash(model.text),
            "parameters": json.loads(json.dumps(asdict(model.arms))),
        },
    }


def _connection_note(text: str, connection: Connection, crossing: Array, time: float) -> SymbolNote:
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
