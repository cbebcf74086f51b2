"""Homoclinic and heteroclinic connections, found at intersections of tube cuts.

Intersections are refined by multiple shooting from points closer to the periodic orbits, with errors of about 1e-12 in
the states. Each connection has a name, winding, sense, symmetry, transversality angle and flight times.

Time reversal turns connections a → b into connections b → a without another search.

If an orbit crosses the section itself, as rotating orbits do, its tubes have no first crossing. They cross on every
lap, along a curve through the orbit's own crossing that each lap stretches by λ. The search uses laps on which the
curve is large. A connection found on several laps is listed once, by its state at the other tube's first (or last)
crossing. Its phase is that of the rotating orbit, extrapolated to the section crossing and reduced to [0, 1). The
winding is counted from this phase, with γ(φ + 1) = γ(φ) + whole turns.

Sources: Kaheman et al. (2023), section 3; Koon, Lo, Marsden, Ross, Heteroclinic connections between periodic orbits and
resonance transitions in celestial mechanics (2000), section 4.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.budget import Budget
from dpcontrol.foundation.causes import SearchCause
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.shown import Brief, Shown, Timed, checked_times
from dpcontrol.orbits.cut import Cut, OpenEnd, section_points, tube_cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.orbits.manifold import OrbitCurve, local_manifold
from dpcontrol.shooting.newton import Guess, ManifoldEnd, ShootingOrbit, solve_shooting
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection, balanced, intersect_cuts
from dpcontrol.words.searches import Concluded

if TYPE_CHECKING:
    from dpcontrol.shooting.extended import ExtendedOrbit

_ROUNDING = 1e-13
"""Scaled rounding error of the gap between two tubes. Divided by their angle, it is the shift of the intersection."""

_BEFORE = 16
"""Number of earlier steps examined together to find the first approach."""

_MIDDLE = 1e-3
"""Largest deviation of a symmetric orbit's middle from its expected time, in periods."""


@dataclass(frozen=True)
class ConnectionRecord(Brief, Documented):
    """Properties of an orbit between two periodic orbits.

    The winding counts whole turns of each coordinate between the named positions of the source and target saddles. The
    state is lifted from the source saddle's named position.

    Attributes:
        name: `from>to[windings]hHITS@angle,rate`.
        section: surface on which the tubes meet.
        state (N,): point on the section.
        winding: whole turns of each arm.
        sense: direction of the turn, +1 or -1.
        symmetric: True if time reversal maps the connection to itself.
        residual: largest defect between segments.
        transversality_angle: between the cuts in (q, p/p₀), deg.
        hits: crossing numbers of the unstable and stable tubes.
        time_out, time_in: flight times, s.
        phase_out: phase on the source orbit at which it leaves, 0 to 1.
        phase_in: phase on the target orbit at which it arrives, 0 to 1.

    Flight times run from the source orbit to the section and from there to the target orbit. Both ends are at a scaled
    distance of 1e-3, at the phases `phase_out` and `phase_in`.
    """

    KEYS: ClassVar[str] = (
        "name section=section.name state winding sense symmetric residual hits time_out time_in phase_out phase_in "
        "transversality_angle_deg=transversality_angle"
    )

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


@dataclass(frozen=True)
class Connection(ConnectionRecord, Timed):
    """A connection with its orbit, whose time is zero at the section.

    Attributes:
        source: orbit that the connection leaves.
        target: orbit that it joins.
        orbit: trajectory by multiple shooting.
    """

    source: LyapunovOrbit
    target: LyapunovOrbit
    orbit: ShootingOrbit

    def __repr__(self) -> str:
        energy = f"{self.source.energy:g}{self.source.system.unit('J')}"
        return f"<connection {self.name} at {energy}: largest defect {self.residual:.1e}>"

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time, s; zero is the crossing of the section."""
        return float(self.orbit.times[0]), float(self.orbit.times[-1])

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return self.source.system.columns

    @property
    def section_key(self) -> str | None:
        """Short name of the section, None for the default one between the saddles."""
        system = self.source.system
        if system.sections.get((self.source.saddle, self.target.saddle)) == self.section:
            return None
        return next((key for key, section in system.named_sections.items() if section == self.section), "other")

    @property
    def place(self) -> Array:
        """Coordinates (q, p/p₀) of the crossing of the section."""
        return section_points(self.source.system, self.section, self.state)

    def states(self, times: Any = None) -> Array:
        """Return the states at given times.

        Args:
            times: times (…) from the section, s; by default 200 over the whole connection.

        Returns:
            States (…, N), with whole turns counted.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self.orbit.sample(checked_times(times))

    @property
    def solution(self) -> Guess:
        """The orbit as a multiple-shooting problem between the local manifolds."""
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
    """Return a refined orbit as a connection, with its name, symmetry, angle and flight times.

    Args:
        crossing: intersection of the cuts.
        orbit: refined orbit, with time zero on the section.
        curves: source and target orbits.
        settings: settings of the search.
    """
    section, system = crossing.sides[0].section, orbit.system
    source, target = crossing.sides[0].manifold.orbit, crossing.sides[1].manifold.orbit
    state = orbit.states[int(np.argmin(np.abs(orbit.times)))]
    angle = angle_between(*crossing.tangents.T)
    # The seeds of the two tubes are images of each other, so the middle lies halfway between them.
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
    """Return the angle between the tangents of two cuts, deg (0 to 90); a small one shows a nearby bifurcation.

    Args:
        first: tangent (2,), of any length.
        second: tangent (2,), of any length.
    """
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    return float(np.degrees(np.arcsin(min(1.0, abs(first[0] * second[1] - first[1] * second[0]) / lengths))))


def uncertainty(angle: float, least: float) -> float:
    """Return the scaled position error of an intersection of two tubes, which grows as their angle falls.

    Args:
        angle: angle between the tubes, deg.
        least: smallest scaled error.
    """
    return max(least, _ROUNDING / max(float(np.radians(angle)), float(np.finfo(float).eps)))


def _meets_a_mirror(orbit: ShootingOrbit, middle: float, within: float) -> bool:
    """Return True if a reverser maps the orbit to itself, since it meets the reverser's fixed set at its middle.

    `middle`: expected time of the middle, s. `within`: largest scaled distance from the fixed set there.
    """
    system, centre = orbit.system, orbit.start.manifold.orbit.centre
    for reverser in system.reversers:
        moved_part, time, offset = (np.eye(system.dimension) - reverser) / 2, middle, np.full(system.dimension, np.inf)
        for _ in range(4):
            state = orbit.sample(np.array([time]))[0]
            offset = moved_part @ (state - centre)
            offset = (offset - system.nearest_turns(2 * offset) * system.turn_lengths / 2) / system.scale
            rate = moved_part @ system.numeric.rate(state) / system.scale
            # A Newton step for the time at which the orbit is nearest to the fixed set.
            time -= float(offset @ rate / (rate @ rate))
            if abs(time - middle) > _MIDDLE * orbit.start.manifold.orbit.period:
                # Farther away, the periodic orbits themselves meet the fixed set.
                break
        else:
            if np.abs(offset).max() < within:
                return True
    return False


def approach(orbit: ShootingOrbit, curve: OrbitCurve, sign: int, distance: float) -> tuple[float, float]:
    """Return the time, s, and the phase at which a connection from the section first comes near a periodic orbit.

    Args:
        orbit: connecting orbit, with time zero on the section.
        curve: the periodic orbit.
        sign: +1 to search forward in time, -1 backward.
        distance: scaled distance of the approach.

    Returns:
        Time from the section, positive in either direction, and phase of the nearest point, 1 for a period; both NaN if
            the connection does not come so near.
    """
    from scipy.optimize import root_scalar

    duration = abs(orbit.times[-1] if sign > 0 else orbit.times[0])
    grid = np.linspace(0.0, duration, max(2, int(np.ceil(duration / curve.orbit.period * 300))))
    _, distances = curve.distances(orbit.sample(sign * grid))
    inside = np.flatnonzero(distances <= distance)
    if inside.size == 0:
        return float("nan"), float("nan")

    def nearest(seconds: Array) -> tuple[Array, Array]:
        """Return phases (K,) and scaled distances (K,) of the periodic orbit's nearest points, after times (K,), s."""
        return curve.nearest(orbit.sample(sign * seconds))

    if inside[0] == 0:
        return 0.0, float(nearest(grid[:1])[0][0])
    # `nearest` minimises the largest component, so its distance never exceeds that of `distances`. The first approach
    # may therefore lie a few grid steps earlier, never later.
    first, farther = int(inside[0]), np.empty(0, dtype=np.intp)
    while first > 1 and not farther.size:
        earlier = np.arange(max(1, first - _BEFORE), first)
        farther = earlier[nearest(grid[earlier])[1] > distance]
        first = int(farther[-1]) + 1 if farther.size else int(earlier[0])

    def excess(time: float) -> float:
        """Return the logarithm of the distance over that of the approach, which is about linear in the time."""
        # Distances decrease exponentially.
        return float(np.log(nearest(np.array([time]))[1][0] / distance))

    bracket = (grid[first - 1], grid[first])
    seconds = float(root_scalar(excess, bracket=bracket, xtol=1e-12, method="toms748").root)
    return seconds, float(nearest(np.array([seconds]))[0][0])


def mirrored(connection: Connection) -> Connection:
    """Return the mirror image of a connection under the half turn, which has the opposite sense.

    Args:
        connection: connection between orbits with a half turn.
    """
    orbit, source, target = connection.orbit, connection.source, connection.target
    system, half_turn = source.system, orbit.start.manifold.half_turn
    assert half_turn is not None
    symmetry = half_turn[0]
    lengths = np.where(np.isfinite(system.periods), system.periods, 1.0)
    # S acts about the source saddle. About the target saddle it differs by whole turns.
    shift = (source.centre - target.centre) - symmetry @ (source.centre - target.centre)
    end_turns = np.rint(symmetry @ np.asarray(orbit.end.turns) + shift / lengths) + 0.0

    def image(states: Array) -> Array:
        """Return the images of states (…, N) under the symmetry."""
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
    """Return True if time reversal preserves both saddles and the section, so that one search serves both directions.

    Args:
        system: Hamiltonian system with reversers.
        source: name of the saddle that connections leave.
        target: name of the saddle that they approach.
        section: section of the search, None for the saddles' default.
    """
    reverser = system.reversers[0]
    forward = section or system.sections.get((source, target))
    backward = section or system.sections.get((target, source))
    if forward is None or forward != backward:
        return False
    preserved = all(
        np.allclose(reverser @ system.equilibrium(name), system.equilibrium(name)) for name in (source, target)
    )
    return preserved and forward.kept_by(reverser, np.zeros(system.dimension))


def _reversed_phase(orbit: LyapunovOrbit, phase: float) -> float:
    """Return the phase of A γ(φ) for the first reverser A, which maps unstable tubes to stable tubes.

    Orbits start on the fixed set of the last reverser, half a period from that of the first.
    """
    return ((0.5 if len(orbit.system.reversers) > 1 else 0.0) - phase) % 1.0


def reversed_in_time(connection: Connection) -> Connection:
    """Return the time-reversed connection, from target to source.

    Let A be the reverser that maps unstable tubes to stable tubes, x(t) a lifted connection and k its whole turns.
    Then y(t) = A x(-t) - A k is a connection on the lift that starts at the target's named position.

    Args:
        connection: connection of a system with reversers.
    """
    orbit, source, target = connection.orbit, connection.target, connection.source
    system = source.system
    reverser = system.reversers[0]
    turns = -reverser @ np.asarray(orbit.end.turns) + 0.0
    lift = turns * system.turn_lengths
    # The reversed stable end lies on the unstable manifold, with the same phase and amplitude.
    start = replace(orbit.end, stable=False, turns=(0.0,) * system.dimension)
    end = replace(orbit.start, stable=True, turns=tuple(float(k) for k in turns))
    states = orbit.states[::-1] @ reverser.T + lift
    reversed_connection = replace(
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
    return named(replace(reversed_connection, sense=connection_sense(reversed_connection)))


def connection_sense(connection: Connection) -> int:
    """Return the sense (±1) of a connection: of its first arm that turns, or of its crossing of the section."""
    turns = [k for k in connection.winding if k]
    if turns and connection.source.saddle == connection.target.saddle:
        return int(np.sign(turns[0]))
    return connection.section.sense(connection.source.system.numeric.rate(connection.state))


def named(connection: Connection, *, at_energy: bool = False) -> Connection:
    """Return a connection with a name that depends on its properties only.

    The name has source, target, winding, hits, the section unless it is the default, and position and rate to four
    digits. The connections of a family in energy have their energy instead of a place on the section.

    Args:
        connection: connection with any name.
        at_energy: True for a connection of such a family, default False.
    """
    turns, (out_hit, in_hit) = ",".join(str(k) for k in connection.winding), connection.hits
    if at_energy:
        saddle, energy = connection.source.name, connection.source.energy
        return replace(connection, name=f"{saddle}>{saddle}[{turns}]h{out_hit}.{in_hit}@{energy:.6f}J")
    system, section, state = connection.source.system, connection.section, connection.state
    saddles = (connection.source.saddle, connection.target.saddle)
    coordinate = int(np.argmax(np.abs(section.position)))
    period, position = system.periods[coordinate], state[coordinate]
    if np.isfinite(period):
        position = position - np.rint(position / period) * period
    # Adding zero turns -0.0 into 0.0.
    place = ",".join(
        f"{round(float(number), 4) + 0.0:.4f}" for number in (position, state[coordinate + len(state) // 2])
    )
    section_text = "" if connection.section_key is None else f":{connection.section_key}"
    return replace(
        connection,
        name=f"{saddles[0]}>{saddles[1]}[{turns}]h{out_hit}.{in_hit}{section_text}@{place}{section.mark(state)}",
    )


_TANGENT = 1e-5  # scaled; a larger rounding error of an intersection may hide others near a bifurcation


@dataclass(frozen=True)
class ConnectionSearch(Shown, Documented, Concluded):
    """All connections found between two orbits on one section.

    Attributes:
        source: orbit that the connections leave.
        target: orbit that they join.
        connections: connections found.
        cuts: cuts of the unstable and the stable tube.
        failed: number of intersections that did not converge.
        left: number of intersections for which no time was left.
        even: True if closed cuts cross equally often in both directions.
        settings: settings of the search.
        seconds: limit of the processor time, s.
        cause: how the search ended.
        first: first crossing that was tried on the laps of a tube.
    """

    KEYS: ClassVar[str] = (
        "count=#connections connections open_cuts:branch,phase_interval,reason complete partial cause status "
        "energy=source.energy from=source.saddle to=target.saddle hits=cuts.hit section=cuts.0.section.name"
    )

    source: LyapunovOrbit
    target: LyapunovOrbit
    connections: tuple[Connection, ...]
    cuts: tuple[Cut, Cut]
    failed: int
    left: int
    even: bool
    settings: ConnectionSettings
    seconds: float
    cause: SearchCause = SearchCause.TUBES
    first: int = 1

    @property
    def partial(self) -> bool:
        """True if the time limit ended the search early."""
        return self.left > 0 or any(cut.spent for cut in self.cuts)

    @property
    def tangent(self) -> int:
        """Number of connections whose tubes are tangent to rounding."""
        return sum(
            uncertainty(connection.transversality_angle, self.settings.same) > _TANGENT
            for connection in self.connections
        )

    @property
    def complete(self) -> bool:
        """True if no intersection failed or is tangent to rounding, and the cuts are resolved, even and hide nothing.

        On the laps of a tube, a search is never complete.
        """
        missed = self.failed or self.left or self.tangent or any(end.hides or end.later for _, end in self.open_ends)
        resolved = self.even and all(cut.resolved for cut in self.cuts)
        return self.cause is not SearchCause.LAPS and resolved and not missed

    @property
    def missed(self) -> str:
        """Why the list may not be complete."""
        pair = f"between {self.source.saddle} and {self.target.saddle}"
        return "" if self.complete else f"the search {pair} is not complete: {self.status}"

    def __repr__(self) -> str:
        return f"<connections {self.source.saddle} → {self.target.saddle}: {self.status}>"

    @property
    def open_cuts(self) -> list[tuple[str, tuple[float, float], str]]:
        """Branch, phase interval and reason of each open end."""
        return [(f"{tube} {end.branch:+d}", end.phase_interval, end.status) for tube, end in self.open_ends]

    @checked
    def named(self, name: str) -> Connection:
        """Return the connection with the given name.

        Args:
            name: name of a connection, from `named`.

        Raises:
            InputError: no such connection; the message suggests the most similar name.
        """
        for connection in self.connections:
            if connection.name == name:
                return connection
        names = suggest(name, [connection.name for connection in self.connections])
        raise InputError(f"no connection {name!r}, {names} ({self.status}); quote it in a shell")

    @property
    def open_ends(self) -> tuple[tuple[str, OpenEnd], ...]:
        """Open ends of the cuts: (tube, end) with tube "unstable" or "stable"."""
        return tuple((name, end) for name, cut in zip(("unstable", "stable"), self.cuts, strict=True)
                     for end in cut.open_ends)  # fmt: skip


@dataclass(frozen=True)
class ChosenConnection(Documented):
    """A connection by its name, with the search that lists it.

    Attributes:
        search: search that found the connection.
        connections: the chosen connection alone.
    """

    KEYS: ClassVar[str] = "**search count connections"

    search: ConnectionSearch
    connections: tuple[Connection]
    count: ClassVar[int] = 1


@dataclass(frozen=True)
class RefinedConnection(Documented):
    """A connection whose orbit is refined in 113-bit arithmetic at an exact energy, J.

    Attributes:
        connection: connection in double precision.
        refined: its orbit in 113-bit arithmetic.
        energy: exact energy, J, as a decimal.
    """

    KEYS: ClassVar[str] = (
        "**refined_row count connections state_double=connection.state residual_double=connection.residual "
        "correction=refined.correction orbits energy from=connection.source.saddle to=connection.target.saddle "
        "status=refined.status"
    )

    connection: Connection
    refined: "ExtendedOrbit"
    energy: str
    count: ClassVar[int] = 1

    @property
    def refined_row(self) -> dict[str, Any]:
        """The connection's document with the decimal digits of its state."""
        digits = {"state": self.refined.digits, "residual": self.residual, "precision": "extended"}
        return self.connection.document() | digits

    @property
    def connections(self) -> list[dict[str, Any]]:
        """The one row of the list of connections."""
        return [self.refined_row]

    @property
    def residual(self) -> str:
        """The largest gap between segments, in their units."""
        return f"{float(self.refined.residual):.3e}"

    @property
    def orbits(self) -> list[dict[str, Any]]:
        """The refined periodic orbits at both ends, one for a homoclinic connection."""
        saddles = (self.connection.source.saddle, self.connection.target.saddle)
        return [
            {
                "saddle": saddle,
                "state": end.digits,
                "period": str(end.duration),
                "residual": f"{float(end.residual):.3e}",
            }
            for saddle, end in dict(zip(saddles, self.refined.ends, strict=True)).items()
        ]


def orbits_between(system: System, source: str, target: str, energy: float) -> tuple[LyapunovOrbit, LyapunovOrbit]:
    """Return the Lyapunov orbits of both saddles at an energy.

    Args:
        system: Hamiltonian system.
        source: name of the saddle that connections leave.
        target: name of the saddle that they approach.
        energy: energy of the orbits, J.

    Raises:
        InputError: an unknown saddle, or a saddle without an orbit at this energy.
    """
    first = lyapunov_orbit(system, source, energy=energy)
    return first, first if source == target else lyapunov_orbit(system, target, energy=energy)


def find_connections(
    source: LyapunovOrbit,
    target: LyapunovOrbit,
    *,
    hits: tuple[int, int] = (1, 1),
    section: Section | None = None,
    settings: ConnectionSettings | None = None,
    cuts: tuple[Cut, Cut] | None = None,
    budget: Budget | None = None,
    progress: Progress = no_progress,
) -> ConnectionSearch:
    """Find the connections from `source` to `target` on a section.

    A connection with m crossings of the section is found at each pair of hits with sum m + 1. Connections that pass
    beside another saddle and return have at least two crossings.

    Args:
        source: orbit that connections leave.
        target: orbit that they approach, at the same energy.
        hits: crossing numbers of both tubes.
        section: the saddles' default unless given.
        settings: settings of the search.
        cuts: unstable cuts of both orbits, with the same settings.
        budget: time limit, shared with other work.
        progress: called with a label and the completed share.

    Raises:
        InputError: the orbits differ in energy, no section is known between their saddles, the target's reverser does
            not preserve it, or one of the orbits crosses it.
    """
    settings, system = settings or ConnectionSettings(), source.system
    system.check_same(target.system)
    budget = budget or Budget(settings.seconds)
    section = section or system.section_between(source.saddle, target.saddle)
    if source.energy != target.energy:
        energies = " and ".join(f"{orbit.energy:g}{system.unit('J')}" for orbit in (source, target))
        raise InputError(f"orbits at {energies} cannot be connected: the flow conserves energy")
    if not section.kept_by(target.reverser, target.centre):
        raise InputError(
            f"section {section.name}: not preserved by the reverser about {target.saddle}, which maps the unstable "
            "tube to the stable tube; choose a section that this symmetry maps onto itself"
        )
    curves = (OrbitCurve(source), OrbitCurve(target))
    for curve in curves:
        if not curve.orbit.laps and own_crossings(curve, section):
            raise InputError(
                f"the orbit about {curve.orbit.saddle} itself crosses {section.name}: its tubes have no first crossing "
                "there; choose another section, or an energy nearer to the saddle's"
            )
    manifolds = (
        local_manifold(source, settings.distance),
        local_manifold(target, settings.distance),
    )
    if cuts is None:
        same_tube = source is target and hits[0] == hits[1]

        def cut(which: int) -> Cut:
            """Return the unstable cut of the source's orbit (0) or of the target's (1)."""
            # Each tube leaves time for the other one and for the refinement.
            share, part = 0.4 * (which + 1), part_of(progress, 0.3 * which, 0.3 * (which + 1))
            part(f"tube of {(source, target)[which].saddle}", 0.0)
            return tube_cut(
                manifolds[which], section, hit=hits[which], settings=settings.cut, budget=budget.until(share),
                progress=part,
            )  # fmt: skip

        unstable = cut(0)
        backward = unstable if same_tube else cut(1)
    else:
        unstable, backward = cuts
    progress("intersections", 0.6)
    after_cuts = budget.share

    def spent_since() -> float:
        """Return the share of the time after the cuts that has been spent, and report progress."""
        share = (budget.share - after_cuts) / max(1 - after_cuts, 1e-9)
        progress("intersections", 0.6 + 0.1 * min(share, 1.0))
        return share

    intersections = intersect_cuts(system, section, manifolds, (unstable, backward), settings, spent=spent_since)
    crossings, failed, unsearched = intersections.found, intersections.failed, intersections.left
    even = balanced(crossings, (unstable, backward))
    finer_settings = replace(settings, cut=replace(settings.cut, chord=settings.cut.chord / 2))
    # A finer search takes about twice as long.
    if not even and finer_settings.cut.chord >= settings.finest and budget.share < 1 / 4:
        # The cuts have folds thinner than the chord, which a finer polyline resolves.
        return find_connections(
            source, target, hits=hits, section=section, settings=finer_settings, budget=budget, progress=progress
        )
    connections = []
    for k, crossing in enumerate(crossings):
        if budget.spent:
            unsearched += len(crossings) - k
            break
        progress("refining connections", 0.7 + 0.3 * k / len(crossings))
        orbit = _refined(crossing, settings)
        if not orbit.converged:
            failed += 1
            continue
        connection = described_connection(crossing, orbit, curves, settings)
        if not _known(system, connection, connections, settings.same):
            connections.append(connection)
            if manifolds[0].branches_are_mirrored and manifolds[1].branches_are_mirrored:
                connections.append(mirrored(connection))
    if (
        hits[0] == hits[1]
        and source is target
        and can_be_reversed(system, source.saddle, source.saddle, section=section)
    ):
        for image in [reversed_in_time(connection) for connection in connections if not connection.symmetric]:
            if not _known(system, image, connections, settings.same):
                connections.append(image)
    _sort(connections)
    progress("connections", 1.0)
    return ConnectionSearch(
        source, target, tuple(connections), (unstable, backward), failed, unsearched, even, settings, budget.seconds
    )


def _sort(connections: list[Connection]) -> list[Connection]:
    """Sort connections in place by sense and position on their section, for reproducible lists, and return them."""
    # Rounded positions make the order reproducible despite numerical noise.
    connections.sort(
        key=lambda connection: (
            -connection.sense,
            *np.round(section_points(connection.source.system, connection.section, connection.state), 6),
        )
    )
    return connections


def _known(system: System, connection: Connection, connections: list[Connection], tolerance: float) -> bool:
    """Return True if a connection is already in the list, because pieces of scattered cuts overlap.

    `tolerance`: scaled distance of equal states for transversal tubes.
    """

    def same(other: Connection) -> bool:
        """Return True if another connection has the same winding, and the same state within its uncertainty."""
        flattest = min(other.transversality_angle, connection.transversality_angle)
        distance = float(system.scaled_distance(other.state, connection.state))
        return other.winding == connection.winding and distance < uncertainty(flattest, tolerance)

    return any(same(other) for other in connections)


def _refined(crossing: Intersection, settings: ConnectionSettings) -> ShootingOrbit:
    """Return an intersection's orbit by multiple shooting; after failures, by shooting with shorter segments.

    `crossing`: intersection of the cuts. `settings`: distances of the nodes from the orbits, and nodes per period. If
    all attempts fail, the last orbit is returned, which has not converged.
    """
    orbit = _shot(crossing, settings)
    for shorter in (2, 4):
        if orbit.converged:
            break
        orbit = _shot(crossing, replace(settings, segments=shorter * settings.segments))
    return orbit


def _shot(crossing: Intersection, settings: ConnectionSettings) -> ShootingOrbit:
    """Return an intersection's orbit by multiple shooting, with time zero on the section; it may not converge.

    `crossing`: intersection of the cuts. The guess consists of the linear manifolds near both periodic orbits and of
    the tubes' trajectories to the section.
    """
    ends, times, states = [], [], []
    for side, phase, flight in zip(crossing.sides, crossing.phases, crossing.times, strict=True):
        manifold = side.manifold
        system, period = manifold.orbit.system, manifold.orbit.period
        amplitude = manifold.amplitude(float(phase), side.branch)
        turns = crossing.turns if side.stable else np.zeros(system.dimension)
        seed_end = ManifoldEnd(manifold, side.stable, float(phase), amplitude, tuple(float(k) for k in turns))
        # Here time runs from the seed to the section for both tubes.
        sign = -1.0 if side.stable else 1.0
        count = max(2, int(np.ceil(flight / period * settings.segments)))
        # Shooting starts before the seed, since the linear manifold is more accurate near the periodic orbit.
        periods_before_seed = max(
            settings.lead, float(np.log(manifold.distance / settings.farthest)) / manifold.exponent
        )
        periods_before_seed = min(
            periods_before_seed, float(np.log(manifold.distance / settings.nearest)) / manifold.exponent
        )
        lead = np.linspace(
            -periods_before_seed * period, 0.0, max(1, int(np.ceil(periods_before_seed * settings.segments))) + 1
        )[:-1]
        flight_times = np.linspace(0.0, flight, count + 1)
        seeds, _ = manifold.seeds(np.array([phase]), side.branch)
        tube_states = side.turned(system.propagator.sample(seeds[0], flight_times)) + turns * system.turn_lengths
        times.append(sign * (np.concatenate([lead, flight_times]) - flight))
        states.append(np.vstack([seed_end.states(sign * lead), tube_states]))
        ends.append(seed_end.moved(-sign * periods_before_seed * period))
    orbit, section = crossing.sides[0].manifold.orbit, crossing.sides[0].section
    guess_times = np.concatenate([times[0], times[1][::-1][1:]])
    guess = Guess(
        system=orbit.system,
        states=np.vstack([states[0], states[1][::-1][1:]]),
        durations=np.diff(guess_times),
        owners=np.zeros(len(guess_times), dtype=np.intp),
        # The exact section, so that the rounding of the propagated crossing has no effect on the states.
        markers={len(times[0]) - 1: (np.asarray(section.normal), section.level(states[0][-1]))},
        energy=orbit.energy,
        ends=(ends[0], ends[1]),
    )
    return solve_shooting(guess).orbit


def reversed_search(search: ConnectionSearch) -> ConnectionSearch:
    """Return the search from target to source, by time reversal of a search from source to target.

    Args:
        search: search on a section that time reversal preserves.

    Raises:
        ValueError: the reverser does not preserve the section and both saddles (see `can_be_reversed`).
    """
    system = search.source.system
    if not can_be_reversed(system, search.source.saddle, search.target.saddle, section=search.cuts[0].section):
        raise ValueError(f"time reversal does not preserve the section from {search.source.saddle}")
    return replace(
        search,
        source=search.target,
        target=search.source,
        connections=tuple(_sort([reversed_in_time(connection) for connection in search.connections])),
        cuts=(search.cuts[1], search.cuts[0]),
        cause=SearchCause.REVERSED,
    )


_LARGE = 0.4  # scaled distance from the orbit at which a tube is large enough for the search
_PROBED = 96  # number of phases at which seed distances are compared
_EDGE = 1e-6  # rounding tolerance of whole-number phases


def find_lap_connections(
    source: LyapunovOrbit, target: LyapunovOrbit, *, section: Section, crossing: int
) -> ConnectionSearch:
    """Find connections of an orbit that crosses the section itself, at a crossing on one of its laps.

    One of the two orbits must cross the section and the other must not. The first crossing of the other tube is used.

    Args:
        source: orbit that connections leave.
        target: orbit that they approach, at the same energy.
        section: the section.
        crossing: crossing number of the lapping tube, counted from its seeds; see `grown_crossing`.

    Raises:
        InputError: both orbits or neither cross the section, the crossing number is below one, or the energies differ.
    """
    settings = ConnectionSettings()
    lapping = [orbit for orbit in (source, target) if orbit.laps]
    if len(lapping) != 1:
        raise InputError(
            f"{source.saddle} and {target.saddle}: exactly one must be an orbit whose tubes cross on every lap"
        )
    per_lap = own_crossings(OrbitCurve(lapping[0]), section)
    if not per_lap:
        raise InputError(f"{lapping[0].saddle} does not cross {section.name}: search it with find_connections")
    if crossing < 1:
        raise InputError(f"crossing = {crossing}: must be 1 or more")
    longest = lapping[0].system.flight_periods + crossing / per_lap
    settings = replace(settings, cut=replace(settings.cut, longest=longest))
    hits = (crossing, 1) if lapping[0] is source else (1, crossing)
    budget = Budget(settings.seconds)
    cuts = tuple(
        tube_cut(
            local_manifold(orbit, settings.distance),
            section,
            hit=hit,
            settings=settings.cut,
            budget=budget.until(share),
        )
        for orbit, hit, share in zip((source, target), hits, (0.4, 0.8), strict=True)
    )
    search = find_connections(
        source, target, hits=hits, section=section, settings=settings, cuts=(cuts[0], cuts[1]), budget=budget
    )
    connections: list[Connection] = []
    for connection in search.connections:
        canonical = _canonical(connection)
        matches = (
            float(source.system.scaled_distance(canonical.state, earlier.state)) < settings.same
            for earlier in connections
        )
        if not any(matches):
            connections.append(canonical)
    return replace(search, connections=tuple(_sort(connections)), cause=SearchCause.LAPS, first=crossing)


def grown_crossing(orbit: LyapunovOrbit, section: Section) -> int:
    """Return the last crossing before a rotating orbit's tube becomes large, at which a search of its laps begins.

    The limit of its scaled distance is about 0.4.

    Args:
        orbit: orbit of the tube.
        section: section of the orbit's system.
    """
    manifold, phases = local_manifold(orbit, ConnectionSettings().distance), np.arange(_PROBED) / _PROBED
    offsets = (manifold.seeds(phases, 1)[0] - manifold.frame(phases).states) / orbit.system.scale
    # Seeds may be nearer than `distance`, so that no trajectory is sampled twice.
    laps = float(np.log(_LARGE / np.linalg.norm(offsets, axis=1).min())) / manifold.exponent
    return max(1, int(laps * own_crossings(OrbitCurve(orbit), section)))


def own_crossings(curve: OrbitCurve, section: Section) -> int:
    """Return the number of times that an orbit itself crosses a section in a period.

    Args:
        curve: curve of the periodic orbit.
        section: section of the orbit's system.
    """
    states = np.vstack([curve.samples, curve.samples[:1] + curve.orbit.turn])
    return sum(section.admits(states[k]) for k in np.flatnonzero(np.diff(section.sheets(states))))


def _canonical(connection: Connection) -> Connection:
    """Return a connection with the rotating orbit's phase reduced to [0, 1), so that the same connection has one form.

    The two tubes meet on every lap of the rotating orbit, and each lap gives the same connection with another phase and
    winding.
    """
    source, target, orbit = connection.source, connection.target, connection.orbit
    system = source.system
    start, end, states = orbit.start, orbit.end, orbit.states
    state = connection.state
    rounds = int(np.floor(start.orbit_phase - float(orbit.times[0]) / source.period + _EDGE))
    if source.laps and rounds:
        # After whole periods, γ(φ) equals γ(φ - rounds) on another lift, so phases determine the start.
        start_turns = source.whole_turns * rounds
        start = replace(start, phase=start.phase - rounds, amplitude=start.amplitude * _sign(source) ** rounds)
        states, state = states - start_turns * system.turn_lengths, state - start_turns * system.turn_lengths
        end = replace(end, turns=tuple(float(k) for k in np.asarray(end.turns) - start_turns))
    rounds = int(np.floor(end.orbit_phase - float(orbit.times[-1]) / target.period + _EDGE))
    if target.laps and rounds:
        end_turns = target.whole_turns * rounds
        end = replace(
            end,
            phase=end.phase + rounds,
            amplitude=end.amplitude * _sign(target) ** rounds,
            turns=tuple(float(k) for k in np.asarray(end.turns) + end_turns),
        )
    orbit = replace(orbit, ends=(start, end), states=states)
    return named(
        replace(
            connection,
            state=state,
            winding=tuple(int(k) for k in np.rint(end.turns)[: len(connection.winding)]),
            hits=_hits_since(orbit, connection),
            orbit=orbit,
        )
    )


def _sign(orbit: LyapunovOrbit) -> int:
    """Return the sign of the unstable multiplier; a negative one exchanges the branches on each period."""
    return int(np.sign(orbit.unstable_multiplier))


def _hits_since(orbit: ShootingOrbit, connection: Connection) -> tuple[int, int]:
    """Return the crossing numbers of both tubes between the connection's departure and its arrival.

    They count from its flight times, since the seeds of a rotating orbit still cross the section on each lap.
    """
    section, counts = connection.section, []
    for sign, reach, orbit_end in (
        (-1.0, connection.time_out, connection.source),
        (1.0, connection.time_in, connection.target),
    ):
        if not orbit_end.laps:
            counts.append(connection.hits[0 if sign < 0 else 1])
            continue
        # The crossing at time zero lies on a node, so rounding decides its side of the section.
        count = 2 + int(np.ceil(reach / orbit_end.period * 200))
        times = (np.arange(count) + 0.5) * reach / count
        counts.append(1 + int(np.count_nonzero(np.diff(section.sheets(orbit.sample(sign * times))))))
    return counts[0], counts[1]
