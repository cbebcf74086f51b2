"""Programs of controllers with handovers.

OGY stabilises a Lyapunov orbit, and TVLQR tracks the connections.

A stay at an orbit ends after the requested number of periods, at the orbit phase nearest to the first state of the
next flight. A flight ends with its reference; the next orbit is entered at the phase nearest to the state. Flights
and orbits each count turns separately, and the turns of a run are summed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dpcontrol.control.interface import Action, Session, whole_turns
from dpcontrol.control.lqr import HoldController
from dpcontrol.control.ogy import OgyController, OgySession
from dpcontrol.control.periodic import OrbitController, OrbitSession
from dpcontrol.control.tracking import PhaseController, TrackingController
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError

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
    """Consecutive segments as one controller.

    Args:
        period: period of the loop, s.
        waits: clock time at which each stay ends, s; NaN for none.
        lasts: minimum ticks of each segment. The last segment continues to the end of the run, which includes time
            for longer stays.
    """

    segments: tuple[Segment, ...]
    waits: tuple[float, ...]
    lasts: tuple[int, ...]
    period: float
    ticks: int
    status: str
    kind: str = "program"

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,)."""
        return self.segments[0].controller.first_state

    def begin(self) -> "ProgramSession":
        """Return a new session for one run."""
        return ProgramSession(self)


class ProgramSession(Session):
    """The active segment and its session.

    It also holds the segment's start, and the turns between flight and reference.
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self._index = 0
        self._began = 0
        self._lift = np.zeros(len(program.first_state))
        self._session: Session = program.segments[0].controller.begin()
        self._past = np.nan

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the commands for the period from a tick.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: estimated extras (E,).
        """
        event = self._hand_over(tick, state) if self._due(tick) else ""
        action = self._session.command(tick, state - self._lift, extra)
        return action._replace(reference=action.reference + self._lift, event=event or action.event)

    def _due(self, tick: int) -> bool:
        """True if the active segment has ended."""
        program, index = self._program, self._index
        if index + 1 == len(program.segments) or tick - self._began < program.lasts[index]:
            return False
        session = self._session
        if not isinstance(session, OgySession | OrbitSession):
            return True
        whole, before = session.orbit_period, self._past
        self._past = (session.time + program.period - program.waits[index]) % whole
        # The section is passed when the elapsed time resets; NaN: the next segment may begin at any phase.
        return np.isnan(self._past) or before - self._past > whole / 2

    def _hand_over(self, tick: int, state: Array) -> str:
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
        """Synchronise the active segment's clock, and describe the change.

        Args:
            tick: present tick.
            state: state (N,) at that tick.
        """
        return self._session.resynchronise(tick, state - self._lift)


def program(segments: Sequence[Segment], *, period: float, kind: str = "program") -> Program:
    """Return the program of these segments.

    Args:
        segments: stays and flights in order.
        period: period of the loop, s.
        kind: name used in logs.

    Raises:
        InputError: two flights in a row do not meet.
        GoalMissed: A flight does not begin or end at its adjacent orbit.
    """
    waits, lasts, total = [], [], 0
    for k, segment in enumerate(segments):
        after = segments[k + 1] if k + 1 < len(segments) else None
        wait, room = np.nan, 0
        if isinstance(segment, Fly):
            last = segment.controller.ticks
            if isinstance(after, Fly):
                _meet(segment, after)
            if isinstance(after, Keep):
                _near(after, segment.controller.reference_states[-1], f"{segment.name} ends")
        else:
            table = segment.controller.table
            whole = table.period
            spare = 0.0 if after is None else 0.5
            last = max(round((segment.wraps - spare) * whole / period), 0)
            room = round((2 * spare + SLOWER * segment.wraps) * whole / period)
            if isinstance(after, Fly):
                wait = float(table.nearest(after.controller.first_state)[0])
        if isinstance(segment, Keep) and isinstance(after, Fly):
            _near(segment, after.controller.first_state, f"{after.name} begins")
        waits.append(wait)
        lasts.append(last)
        total += last + room
    names = ", ".join(segment.name for segment in segments)
    status = f"{len(segments)} segments: {names}"
    return Program(tuple(segments), tuple(waits), tuple(lasts), period, total, status, kind)


def _near(keep: Keep, state: Array, what: str) -> None:
    distance = keep.controller.distance(state)
    if not distance <= NEAR:
        raise GoalMissed(f"{what} {distance:.2g} (scaled) away from {keep.name}: they do not meet")


def _meet(before: Fly, after: Fly) -> None:
    n = (len(after.controller.first_state) - 2) // 2
    apart = before.controller.reference_states[-1] - after.controller.first_state
    apart[:n] -= whole_turns(apart[:n])
    if np.abs(apart[: 2 * n]).max() > NEAR:
        raise InputError(f"{before.name} ends where {after.name} does not begin: insert a stay between them")


class NearestKeeper:
    """Fallback that stabilises the orbit or equilibrium nearest to the state."""

    def __init__(self, keepers: Mapping[str, Keeper]) -> None:
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
