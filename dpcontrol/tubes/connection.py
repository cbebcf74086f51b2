"""One connection: an orbit from one Lyapunov orbit to another, described and named.

Source: Kaheman et al. (2023), section 3.
"""

import re
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.shooting.equations import Guess, ShootingOrbit
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection

Array = NDArray[np.float64]

_ROUNDING = 1e-13
"""What rounding leaves of a gap between two tubes, scaled: divided by their angle, it is how far it moves their
intersection along them."""

_BEFORE = 16
"""Steps looked at together before the one by which an orbit has come near."""

_MIDDLE = 1e-3
"""Of a period: how far from its expected time the middle of an orbit may lie that a reverser turns into itself."""


@dataclass(frozen=True)
class ConnectionRecord:
    """What is published of an orbit from one periodic orbit to another (or the same).

    state (N,): its point on the section, on the lift that starts at the source saddle's named position. winding:
    whole turns of each coordinate between the source and target saddles' named positions. hits: which crossing of the
    section this is for the unstable tube forward and the stable tube backward. time_out: s from leaving the source
    orbit (scaled distance 1e-3) to the section; time_in: s from the section to the target orbit; phase_out, phase_in:
    the orbits' phases there. transversality_angle: degrees between the cuts in (q, p/p₀). residual: largest gap
    between the segments of its orbit.
    """

    name: str
    section: Section
    state: Array
    winding: tuple[int, ...]
    sense: int
    symmetric: bool
    residual: float
    transversality_angle: float
    hits: tuple[int, int]
    time_out: float
    time_in: float
    phase_out: float
    phase_in: float

    def document(self) -> dict[str, Any]:
        """Return the record with the keys that `dpcontrol connect --json` prints."""
        values = {field.name: getattr(self, field.name) for field in fields(ConnectionRecord)}
        angle = values.pop("transversality_angle")
        return {**values, "section": self.section.name, "transversality_angle_deg": angle}


@dataclass(frozen=True)
class Connection(ConnectionRecord):
    """A connection: its record, the orbits that it leaves and joins, and its own; time zero is at the section."""

    source: LyapunovOrbit
    target: LyapunovOrbit
    orbit: ShootingOrbit

    @property
    def solution(self) -> Guess:
        """The orbit as what multiple shooting solves: it leaves the source, stays on the section, joins the target."""
        crossing = int(np.argmin(np.abs(self.orbit.times)))
        return Guess(
            system=self.orbit.system,
            states=self.orbit.states,
            durations=np.diff(self.orbit.times),
            owners=np.zeros(len(self.orbit.times), dtype=np.intp),
            markers={crossing: (np.asarray(self.section.normal), self.section.level(self.state))},
            energy=self.source.energy,
            ends=self.orbit.ends,
        )


def described_connection(
    crossing: Intersection,
    orbit: ShootingOrbit,
    curves: tuple[OrbitCurve, OrbitCurve],
    settings: ConnectionSettings,
) -> Connection:
    """Describe a refined orbit, with time zero at the node on the section, that an intersection of cuts led to.

    curves: of the source's and the target's orbit.
    """
    section, system = crossing.sides[0].section, orbit.system
    source, target = crossing.sides[0].manifold.orbit, crossing.sides[1].manifold.orbit
    state = orbit.states[int(np.argmin(np.abs(orbit.times)))]
    angle = angle_between(*crossing.tangents.T)
    # The seeds of one tube are the other's turned around: between them lies the middle.
    middle = (crossing.times[1] - crossing.times[0]) / 2
    symmetric = source.saddle == target.saddle and _meets_a_mirror(orbit, middle, uncertainty(angle, settings.same))
    time_out, phase_out = approach(orbit, curves[0], -1, settings.near)
    time_in, phase_in = approach(orbit, curves[1], +1, settings.near)
    connection = Connection(
        name="",
        source=source,
        target=target,
        section=section,
        state=state,
        winding=tuple(int(k) for k in crossing.turns[: system.dimension // 2]),
        sense=0,
        symmetric=symmetric,
        residual=orbit.residual,
        transversality_angle=angle,
        hits=(crossing.sides[0].hit, crossing.sides[1].hit),
        time_out=time_out,
        time_in=time_in,
        phase_out=phase_out,
        phase_in=phase_in,
        orbit=orbit,
    )
    return named(replace(connection, sense=connection_sense(connection)))


def angle_between(first: Array, second: Array) -> float:
    """Return the angle in degrees, 0 to 90, between two tangents (2,)."""
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    return float(np.degrees(np.arcsin(min(1.0, abs(first[0] * second[1] - first[1] * second[0]) / lengths))))


def uncertainty(angle: float, least: float) -> float:
    """Return how far rounding may move a connection along its tubes (scaled) that meet at `angle` (degrees)."""
    return max(least, _ROUNDING / max(float(np.radians(angle)), float(np.finfo(float).eps)))


def _meets_a_mirror(orbit: ShootingOrbit, middle: float, within: float) -> bool:
    """Whether a homoclinic orbit meets a reverser's fixed set near the time `middle`: the reverser turns it into
    itself, wherever on it the section lies."""
    system, centre = orbit.system, orbit.start.manifold.orbit.centre
    half = np.where(np.isfinite(system.periods), system.periods / 2, np.inf)
    for reverser in system.reversers:
        turned_over, time, off = (np.eye(system.dimension) - reverser) / 2, middle, np.full(system.dimension, np.inf)
        for _ in range(4):
            state = orbit.sample(np.array([time]))[0]
            off = turned_over @ (state - centre)
            off = (off - np.where(np.isfinite(half), np.rint(off / half), 0.0) * system.turn_lengths / 2) / system.scale
            rate = turned_over @ system.numeric.rate(state) / system.scale
            time -= float(off @ rate / (rate @ rate))
            if abs(time - middle) > _MIDDLE * orbit.start.manifold.orbit.period:
                # Farther on the periodic orbits themselves meet the mirror.
                break
        else:
            if np.abs(off).max() < within:
                return True
    return False


def approach(orbit: ShootingOrbit, curve: OrbitCurve, sign: int, near: float) -> tuple[float, float]:
    """Return (seconds, phase) from the section to the first approach within `near` of a periodic orbit.

    sign +1 looks forward in time, -1 backward; seconds are positive either way.
    """
    last = abs(orbit.times[-1] if sign > 0 else orbit.times[0])
    grid = np.linspace(0.0, last, max(2, int(np.ceil(last / curve.orbit.period * 300))))
    _, distances = curve.distances(orbit.sample(sign * grid))
    inside = np.flatnonzero(distances <= near)
    if inside.size == 0:
        return float("nan"), float("nan")

    def nearest(seconds: Array) -> tuple[Array, Array]:
        return curve.nearest(orbit.sample(sign * seconds))

    if inside[0] == 0:
        return 0.0, float(nearest(grid[:1])[0][0])
    # `nearest` minimises the largest component itself, so it never finds more than `distances` does: the first
    # approach may lie a few steps before the grid's, never after it.
    first, farther = int(inside[0]), np.empty(0, dtype=np.intp)
    while first > 1 and not farther.size:
        before = np.arange(max(1, first - _BEFORE), first)
        farther = before[nearest(grid[before])[1] > near]
        first = int(farther[-1]) + 1 if farther.size else int(before[0])

    def excess(time: float) -> float:
        # Distances fall as an exponential.
        return float(np.log(nearest(np.array([time]))[1][0] / near))

    bracket = (grid[first - 1], grid[first])
    seconds = float(root_scalar(excess, bracket=bracket, xtol=1e-12, method="toms748").root)
    return seconds, float(nearest(np.array([seconds]))[0][0])


def mirrored(connection: Connection) -> Connection:
    """Return the image under the symmetry S that exchanges both tubes' branches: the other sense."""
    orbit, source, target = connection.orbit, connection.source, connection.target
    system, half_turn = source.system, orbit.start.manifold.half_turn
    assert half_turn is not None
    symmetry = half_turn[0]
    lengths = np.where(np.isfinite(system.periods), system.periods, 1.0)
    # S acts about the source saddle; about the target saddle it differs by whole turns.
    shift = (source.centre - target.centre) - symmetry @ (source.centre - target.centre)
    end_turns = np.rint(symmetry @ np.asarray(orbit.end.turns) + shift / lengths) + 0.0

    def image(states: Array) -> Array:
        return (states - source.centre) @ symmetry.T + source.centre

    start = replace(orbit.start, phase=orbit.start.phase + 0.5, amplitude=-orbit.start.amplitude)
    end = replace(
        orbit.end,
        phase=orbit.end.phase + 0.5,
        amplitude=-orbit.end.amplitude,
        turns=tuple(float(k) for k in end_turns),
    )
    return named(
        replace(
            connection,
            state=image(connection.state),
            winding=tuple(int(k) for k in end_turns[: len(connection.winding)]),
            sense=-connection.sense,
            phase_out=(connection.phase_out + 0.5) % 1.0,
            phase_in=(connection.phase_in + 0.5) % 1.0,
            orbit=replace(orbit, ends=(start, end), states=image(orbit.states)),
        )
    )


def can_be_reversed(system: System, source: str, target: str, *, section: Section | None = None) -> bool:
    """Tell whether the reverser keeps both saddles and a section, and so every search on it.

    section: the one that was searched on, None for the one between the saddles either way.
    """
    reverser = system.reversers[0]
    forward = section or system.sections.get((source, target))
    backward = section or system.sections.get((target, source))
    if forward is None or forward != backward:
        return False
    kept = all(np.allclose(reverser @ system.equilibrium(name), system.equilibrium(name)) for name in (source, target))
    return kept and forward.kept_by(reverser, np.zeros(system.dimension))


def _reversed_phase(orbit: LyapunovOrbit, phase: float) -> float:
    """Return the phase of A γ(φ): orbits start on the last reverser's fixed set, half a period from the first's."""
    return ((0.5 if len(orbit.system.reversers) > 1 else 0.0) - phase) % 1.0


def reversed_in_time(connection: Connection) -> Connection:
    """Return the connection from target to source that is this one run backward.

    With A the reverser that turns unstable tubes into stable ones, x(t) a connection on its lift and k the whole turns
    at its end, y(t) = A x(-t) - A k is one on the lift that starts at the target's named position.
    """
    orbit, source, target = connection.orbit, connection.target, connection.source
    system = source.system
    reverser = system.reversers[0]
    turns = -reverser @ np.asarray(orbit.end.turns) + 0.0
    lift = turns * system.turn_lengths
    # The turned-around stable end is a point of the unstable manifold, with the same phase and amplitude.
    start = replace(orbit.end, stable=False, turns=(0.0,) * system.dimension)
    end = replace(orbit.start, stable=True, turns=tuple(float(k) for k in turns))
    states = orbit.states[::-1] @ reverser.T + lift
    back = replace(
        connection,
        source=source,
        target=target,
        state=reverser @ connection.state + lift,
        winding=tuple(int(k) for k in turns[: len(connection.winding)]),
        hits=(connection.hits[1], connection.hits[0]),
        time_out=connection.time_in,
        time_in=connection.time_out,
        phase_out=_reversed_phase(source, connection.phase_in),
        phase_in=_reversed_phase(target, connection.phase_out),
        orbit=replace(orbit, ends=(start, end), times=-orbit.times[::-1], states=states),
    )
    return named(replace(back, sense=connection_sense(back)))


def connection_sense(connection: Connection) -> int:
    """Return which way (+1, -1) a homoclinic turns, if it does, or else the section is crossed."""
    turns = [k for k in connection.winding if k]
    if turns and connection.source.saddle == connection.target.saddle:
        return int(np.sign(turns[0]))
    return connection.section.sense(connection.source.system.numeric.rate(connection.state))


def named(connection: Connection) -> Connection:
    """Return a connection under a name made of what it is, not of the order in which it was found.

    Source, target, winding, hits, section where it is not the saddles' own, position and rate there to four digits.
    """
    system, section, state = connection.source.system, connection.section, connection.state
    saddles = (connection.source.saddle, connection.target.saddle)
    coordinate = int(np.argmax(np.abs(section.position)))
    period, position = system.periods[coordinate], state[coordinate]
    if np.isfinite(period):
        position = position - np.rint(position / period) * period
    # Adding zero turns -0.0 into 0.0.
    place = ",".join(f"{round(float(v), 4) + 0.0:.4f}" for v in (position, state[coordinate + len(state) // 2]))
    turns, (out, back) = ",".join(str(k) for k in connection.winding), connection.hits
    own = system.sections.get(saddles) == section
    on = "" if own else f":{next((key for key, one in system.named_sections.items() if one == section), 'other')}"
    return replace(connection, name=f"{saddles[0]}>{saddles[1]}[{turns}]h{out}.{back}{on}@{place}{section.mark(state)}")


def searched_at(name: str) -> tuple[tuple[int, int], str | None] | None:
    """Return the (hits, short name of the section) of a connection's name, None where it is no such name."""
    match = re.search(r"\]h([1-9])\.([1-9])(?::([\w-]+))?@", name)
    return None if match is None else ((int(match[1]), int(match[2])), match[3])
