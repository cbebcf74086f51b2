"""Walks of a model at an energy, as `dpcontrol walk` asks for them: drawn, given wraps, solved, kept in files."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.dynamics.propagator import Exact, digits
from dpcontrol.foundation.cost import Cost
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import picked, plain, write_archive
from dpcontrol.shooting.extended import ExtendedOrbit, refine
from dpcontrol.walks.edges import Edges
from dpcontrol.walks.shadowing import MOST_WRAPS, ShadowingOrbit, WalkSolver, check_stops
from dpcontrol.walks.symbols import composed
from dpcontrol.walks.walks import Walk, random_walk

FORMAT = 1
"""Raised whenever the file of a walk's orbit changes its meaning."""


@dataclass(frozen=True)
class WalkRequest:
    """A walk to be made: its connections and either its wraps or how many to add to the least that suffice."""

    chain: Walk
    periodic: bool
    wraps: tuple[int, ...] | None
    extra: tuple[int, ...]
    lead_in: int = 2
    lead_out: int = 2

    def document(self) -> dict[str, Any]:
        """Return what is known before it is solved."""
        return {"walk": [c.name for c in self.chain], "wraps": self.wraps, "periodic": self.periodic}


@dataclass(frozen=True)
class WalkAnswer:
    """What came of a request. least: the fewest wraps that suffice; orbit: None where not even these were found.

    refined: the orbit in extended precision, where that was asked for and `orbit` converged. seconds: what the orbit
    with the wraps asked for took; the search for the least is apart.
    """

    request: WalkRequest
    least: tuple[int, ...] | None
    orbit: ShadowingOrbit | None
    seconds: float
    status: str
    refined: ExtendedOrbit | None = None

    @property
    def converged(self) -> bool:
        """Whether the orbit that was asked for was found, in the precision asked for."""
        found = self.orbit is not None and self.orbit.converged
        return found and (self.refined is None or self.refined.converged)

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol walk --solve --json` says about it."""
        orbit, refined = self.orbit, self.refined
        own = ("wraps", "wraps_realised", "residual", "duration")
        found: dict[str, Any] = dict.fromkeys(own) if orbit is None else picked(orbit, *own)
        document = {
            **self.request.document(),
            "least_wraps": self.least,
            **found,
            "iterations": None if orbit is None else orbit.orbit.iterations,
            **picked(self, "seconds", "converged", "status"),
        }
        if orbit is None:
            return document
        if not orbit.periodic and len(orbit.walk) > 1:
            document["edge"] = composed(orbit.walk, orbit.wraps)
        document |= {"symbol_times": orbit.symbol_times, "certificate": _estimate(orbit)}
        if refined is not None:
            # Digits as strings take the place of doubles; times count from the first symbol's section.
            document |= {
                "precision": "extended",
                "state": refined.digits,
                "state_double": orbit.orbit.states[min(orbit.shot.guess.markers)],
                "period": str(refined.duration) if orbit.periodic else None,
                "symbol_times_digits": digits(refined.times[refined.marked]),
                "residual": f"{float(refined.residual):.3e}",
                "residual_double": orbit.residual,
                "correction": refined.correction,
            }
        return document


def drawn_requests(
    edges: Edges,
    count: int,
    *,
    lengths: tuple[int, int],
    extra: tuple[int, int],
    seed: int,
    periodic: bool,
    leads: tuple[int, int] = (2, 2),
) -> list[WalkRequest]:
    """Draw `count` walks with lengths and extra wraps (both ends included) from a seeded generator.

    Raises:
        InputError: an empty range, or no such walk at this energy.
    """
    for name, (low, high), least in (("lengths", lengths, 1), ("extra wraps", extra, 0)):
        if not least <= low <= high <= MOST_WRAPS:
            raise InputError(
                f"{name} {low} to {high}: must be two whole numbers from {least} to {MOST_WRAPS:,}, the smaller first"
            )
    generator = np.random.default_rng(seed)
    requests = []
    for _ in range(count):
        length = int(generator.integers(lengths[0], lengths[1] + 1))
        chain = random_walk(edges, length, generator, periodic=periodic)
        stops = length if periodic else length - 1
        more = tuple(int(n) for n in generator.integers(extra[0], extra[1] + 1, stops))
        requests.append(WalkRequest(chain, periodic, None, more, *leads))
    return requests


def request(
    chain: Walk, *, wraps: Sequence[int] | None, extra: int, periodic: bool, leads: tuple[int, int] = (2, 2)
) -> WalkRequest:
    """Return the request for one walk: with `wraps`, or `extra` more than the least at each stop.

    Raises:
        InputError: not one wrap count for each stop, or a periodic walk whose end is not its start.
    """
    stops = check_stops(chain, wraps, periodic=periodic)
    return WalkRequest(chain, periodic, None if wraps is None else tuple(wraps), (extra,) * stops, *leads)


_DRAWN, _SOLVED_SYMBOL, _SOLVED_WRAP, _TRIED = 5e-4, 0.05, 0.01, 0.002
"""s: what a symbol takes to draw, a symbol and a wrap to solve, and each pair of symbols where the fewest wraps that
suffice are sought: stop after stop is raised, and all solved again."""
_NODES, _NODE_BYTES = 8, 7_000.0
"""Nodes of an orbit in each period, and bytes that each of them takes to solve for."""


def walks_cost(count: int, *, symbols: int, wraps: int, solve: bool, key: str) -> Cost:
    """Return what walks will take, each of so many symbols and wraps in all; key: what asked for them."""
    seconds, memory = _DRAWN * count * symbols, 200.0 * count * symbols
    work = f"{count:,} walk{'s' if count > 1 else ''} of up to {symbols:,} symbols"
    if not solve:
        return Cost(work, seconds, memory, key)
    nodes = _NODES * (wraps + symbols)
    seconds += count * (_SOLVED_SYMBOL * symbols + _TRIED * symbols**2 + _SOLVED_WRAP * wraps)
    return Cost(f"{work}, {nodes:,} states each,", seconds, memory + _NODE_BYTES * nodes, key)


def solved(requests: Sequence[WalkRequest], solver: WalkSolver) -> Iterator[WalkAnswer]:
    """Solve one request after the other."""
    if requests:
        # What is compiled, and sampled, once for all is not the first walk's time.
        solver.solve(requests[0].chain[:1], ())
    for asked in requests:
        yield _answer(asked, solver)


def _answer(asked: WalkRequest, solver: WalkSolver) -> WalkAnswer:
    least: tuple[int, ...] | None = None
    wraps = asked.wraps
    if wraps is None:
        try:
            least = solver.least(asked.chain, periodic=asked.periodic)
        except GoalMissed as error:
            return WalkAnswer(asked, None, None, 0.0, str(error))
        wraps = tuple(n + more for n, more in zip(least, asked.extra, strict=True))
    began = time.perf_counter()
    orbit = solver.solve(asked.chain, wraps, periodic=asked.periodic, lead_in=asked.lead_in, lead_out=asked.lead_out)
    seconds = time.perf_counter() - began
    status = orbit.status if orbit.converged else f"{orbit.status}; {solver.advice(orbit)}"
    return WalkAnswer(asked, least, orbit, seconds, status)


def refined_answer(answer: WalkAnswer, *, energy: Exact, parameters: Sequence[Exact]) -> WalkAnswer:
    """Return the answer with its orbit refined in 113-bit arithmetic; as it is where there is no orbit.

    energy, parameters (p,): exact values. seconds stay those of the orbit in double precision.

    Raises:
        GoalMissed: the periodic orbit at an end cannot be refined, or there are no 113-bit reals on this machine.
    """
    if answer.orbit is None or not answer.converged:
        return answer
    refined = refine(answer.orbit.shot.solution, energy=energy, parameters=parameters)
    return replace(answer, refined=refined, status=refined.status)


def _estimate(orbit: ShadowingOrbit) -> dict[str, Any] | None:
    """Return the error estimate's numbers; of a periodic orbit also its multipliers, as natural logarithms."""
    estimate = orbit.estimate
    if estimate is None:
        return None
    document = picked(estimate, "condition", "kantorovich", "radius", "energy_error", "departure", "stops")
    if estimate.multipliers is not None:
        numbers = ("log_unstable", "log_stable", "sign", "reciprocity")
        document["multipliers"] = picked(estimate.multipliers, *numbers)
    return document


def save_walk(path: Path, model: str, orbit: ShadowingOrbit, *, refined: ExtendedOrbit | None = None) -> None:
    """Write an orbit to one .npz: `header` (JSON text) and the arrays times, states, symbol_times, turn.

    refined: adds times_digits (L + 1,) s from the first symbol's section and states_digits (L + 1, N), decimal strings.

    times (K + 1,) s and states (K + 1, N) (rad, rad/s) are its nodes: between two of them the conservative equations
    hold. turn (N,): what a periodic orbit adds with each round, zeros for others.
    """
    header = {
        "format": FORMAT,
        "kind": "shadowing orbit",
        "model": model,
        "energy": orbit.connections[0].source.energy,
        "walk": list(orbit.walk),
        "wraps": list(orbit.wraps),
        "wraps_realised": list(orbit.wraps_realised),
        **picked(orbit, "periodic", "lead_in", "lead_out", "duration", "residual", "status"),
        "certificate": plain(_estimate(orbit)),
    }
    turn = orbit.orbit.turn
    arrays: dict[str, Any] = {
        **picked(orbit.orbit, "times", "states"),
        "symbol_times": orbit.symbol_times,
        "turn": np.zeros(orbit.orbit.states.shape[1]) if turn is None else turn,
    }
    if refined is not None:
        arrays["times_digits"] = np.array(digits(refined.times))
        arrays["states_digits"] = np.array([digits(state) for state in refined.states])
    write_archive(path, header, arrays, compressed=True)
