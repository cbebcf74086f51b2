"""Programs of controllers with handovers.

OGY stabilises a Lyapunov orbit, and TVLQR tracks the connections.

A stay at an orbit ends after the requested number of periods, at the orbit phase nearest to the first state of the
next flight. A flight ends with its reference; the next orbit is entered at the phase nearest to the state. Flights
and orbits each count turns separately, and the turns of a run are summed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from dpcontrol.control.interface import Action, Session, whole_turns
from dpcontrol.control.lqr import HoldController
from dpcontrol.control.ogy import OgyController, OgySession
from dpcontrol.control.periodic import OrbitController, OrbitSession
from dpcontrol.control.tracking import PhaseController, TrackingController
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed

NEAR = 0.2
"""Largest scaled distance between the end of a flight and the orbit that follows."""
SLOWER = 0.05
"""Relative extension of a stay beyond its plan: the plant's period differs from the model's."""


Keeper = OgyController | OrbitController | HoldController
"""Controllers that take over states near their orbit or equilibrium."""


@dataclass(frozen=True, eq=False)
class Keep:
    """A stay at an orbit for `wraps` periods.

    The duration is exact to half a period.
    """

    name: str
    controller: OgyController | OrbitController
    wraps: float = 0.0


@dataclass(frozen=True, eq=False)
class Fly:
    """A flight along a reference from start to end."""

    name: str
    controller: TrackingController | PhaseController


Segment = Keep | Fly


@dataclass(frozen=True, eq=False)
class Program:
    """Stays with flights between them as one controller.

    Args:
        period: period of the loop, s.
        waits: phase of the orbit, s, at which each stay but the last ends.
        lasts: minimum ticks of each segment. The last segment continues to the end of the run, which includes time
            for longer stays.
        ticks: number of periods of the whole program, that time included.
        kind: name of the law used in logs.
    """

    segments: tuple[Keep, *tuple[Segment, ...]]
    waits: tuple[float, ...]
    lasts: tuple[int, ...]
    period: float
    ticks: int
    kind: str

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,), with which a run begins."""
        return self.segments[0].controller.first_state

    def begin(self) -> "ProgramSession":
        """Return a new session, the state of this law during one run."""
        return ProgramSession(self)


class ProgramSession(Session):
    """The active segment and its session.

    A handover changes all of the following. `_index` is the number of the active segment, from 0, `_session` its
    session, and `_began` its first tick. `_lift` (N,) are the whole turns between the run and a flight's reference,
    rad, zero during a stay. `_past` is the time since the last passage of a stay's phase of leaving, s, at the last
    tick at which `_due` tested it; NaN before the first test.
    """

    def __init__(self, program: Program) -> None:
        """Begin with the first segment.

        Args:
            program: the stays and flights.
        """
        self._program = program
        self._index = 0
        self._began = 0
        self._lift = np.zeros(len(program.first_state))
        self._session: Session = program.segments[0].controller.begin()
        self._past = np.nan

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action of the active segment for the period from a tick, after a handover if it has ended.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: estimated extras (E,).
        """
        event = self._hand_over(tick, state) if self._due(tick) else ""
        action = self._session.command(tick, state - self._lift, extra)
        return action._replace(reference=action.reference + self._lift, event=event or action.event)

    def _due(self, tick: int) -> bool:
        """Return True if the active segment has ended: a flight after its ticks, a stay also at its phase of leaving.

        `tick`: the tick in which the command acts.
        """
        program, index = self._program, self._index
        if index + 1 == len(program.segments) or tick - self._began < program.lasts[index]:
            return False
        session = self._session
        if not isinstance(session, OgySession | OrbitSession):
            return True
        # Stays and flights alternate, and each stay but the last has a phase at which it ends.
        orbit_period, previous = session.orbit_period, self._past
        self._past = (session.time + program.period - program.waits[index // 2]) % orbit_period
        # The section is passed when the elapsed time resets; NaN: the next segment may begin at any phase.
        return np.isnan(self._past) or previous - self._past > orbit_period / 2

    def _hand_over(self, tick: int, state: Array) -> str:
        """Begin the next segment at this tick and state (N,), and return a sentence for the log.

        A flight gets the whole turns between the state and its reference; an orbit's session counts its own.
        """
        self._index += 1
        self._began, self._past = tick, np.nan
        segment = self._program.segments[self._index]
        self._lift = np.zeros(len(state))
        if isinstance(segment, Fly):
            n = (len(state) - 2) // 2
            self._lift[:n] = whole_turns(state[:n] - segment.controller.first_state[:n])
        self._session = segment.controller.join(tick, state - self._lift)
        return f"hand over to {segment.controller.kind}: {segment.name}"

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the active segment's clock to the phase nearest to a state, and return a sentence for the log.

        Args:
            tick: present tick.
            state: state (N,) at that tick.
        """
        return self._session.resynchronise(tick, state - self._lift)


def program(stays: Sequence[Keep], flights: Sequence[Fly], *, period: float, kind: str) -> Program:
    """Return the program that stays at each orbit for its wraps, and flies from each stay to the next.

    Args:
        stays: stays (F+1) in order.
        flights: flights (F) between them.
        period: period of the loop, s.
        kind: name used in logs.

    Raises:
        GoalMissed: a flight does not begin or end at its adjacent orbit.
    """
    segments, waits, lasts, total = list[Segment](), list[float](), list[int](), 0
    for stay, flight in zip_longest(stays, flights):
        table, spare = stay.controller.table, 0.0 if flight is None else 0.5
        segments.append(stay)
        # A stay ends at a phase, so up to half a period before or after its wraps.
        lasts.append(max(round((stay.wraps - spare) * table.period / period), 0))
        total += lasts[-1] + round((2 * spare + SLOWER * stay.wraps) * table.period / period)
        if flight is not None:
            _check_near(stay, flight.controller.first_state, f"{flight.name} begins")
            _check_near(stays[len(waits) + 1], flight.controller.reference_states[-1], f"{flight.name} ends")
            waits.append(float(table.nearest(flight.controller.first_state)[0]))
            segments.append(flight)
            lasts.append(flight.controller.ticks)
            total += flight.controller.ticks
    return Program((stays[0], *segments[1:]), tuple(waits), tuple(lasts), period, total, kind)


def _check_near(stay: Keep, state: Array, what: str) -> None:
    """Raise GoalMissed if a flight's end, a state (N,), is far from the orbit of a stay; `what` begins the message."""
    distance = stay.controller.distance(state)
    if not distance <= NEAR:
        raise GoalMissed(f"{what} {distance:.2g} (scaled) away from {stay.name}: they do not meet")


class NearestKeeper:
    """Fallback that stabilises the orbit or equilibrium nearest to the state."""

    def __init__(self, keepers: Mapping[str, Keeper]) -> None:
        """Set the laws that can hold a state, by the names of their orbits and equilibria."""
        self._keepers = dict(keepers)

    def session(self, tick: int, state: Array) -> tuple[Session, str]:
        """Return a session that holds the nearest fallback.

        Args:
            tick: first tick.
            state: state (N,) at that tick.

        Returns:
            The session, and a description of the fallback.
        """
        distances = {name: keeper.distance(state) for name, keeper in self._keepers.items()}
        name = min(distances, key=distances.__getitem__)
        text = f"holds {name}, {distances[name]:.2g} (scaled) away, by {self._keepers[name].kind}"
        return self._keepers[name].join(tick, state), text
