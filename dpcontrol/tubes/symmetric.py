"""Symmetric homoclinic connections of three arms, at isolated energies.

With two degrees of freedom, the tubes of a Lyapunov orbit are surfaces in a three-dimensional energy surface, and their
intersections persist as the energy changes. With n = 3, the tubes are still surfaces but the energy surface has five
dimensions, so in general they do not intersect at any energy.

Symmetry gives the exceptions. A reverser R maps the unstable tube to the stable tube. If a trajectory of the unstable
tube meets the fixed set of R, lifted by any whole turns, it returns along its own image and is homoclinic. If R
reverses all angles, its fixed set has n equations, because every arm is either hanging or upright. The trajectories of
a whole family have as many unknowns: the departure phase, the time and the energy. Such connections are therefore
isolated in energy, and persist under small changes of the model's parameters.

The search propagates tubes on a grid of energies until the saddle's upright arm hangs down. The deviations of the other
arms' angles define a map from (energy, phase) to the plane. A triangle of the grid whose image contains the origin
contains a zero. Multiple shooting refines each zero, with the energy as an unknown. The list may be incomplete, because
the grid may be too coarse for tubes that scatter.

Source: Devaney, Reversible diffeomorphisms and flows (1976); Champneys, Homoclinic orbits in reversible systems (1998).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.budget import SECONDS, Budget
from dpcontrol.foundation.causes import GridCause, ShootingCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.shown import Shown
from dpcontrol.orbits.cut import arrivals
from dpcontrol.orbits.lyapunov import (
    LyapunovOrbit,
    SymmetricShooting,
    lyapunov_orbit,
    nearby_orbit,
    symmetric_shooting as shooting_problem,
)
from dpcontrol.orbits.manifold import OrbitCurve, local_manifold
from dpcontrol.shooting.newton import ManifoldEnd, ShootingOrbit
from dpcontrol.tubes.connections import Connection, approach, mirrored, named
from dpcontrol.words.searches import Concluded


@dataclass(frozen=True)
class SymmetricSettings:
    """Grid, distances and tolerances of a search for symmetric connections.

    `energies` and `phases` set the size of the grid.

    Attributes:
        farthest: largest distance between connected neighbours of the grid, rad.
        distance: of seeds from their orbit, scaled.
        leaves: start of the refined connection, scaled distance from the orbit.
        segments: nodes per period.
        near: scaled distance of departure and arrival, from which flight times count.
        iterations: largest number of Newton steps.

    A solution is accepted if its largest defect is below `accept` (rad, rad/s). Two connections are the same if their
    energies differ by less than `same`, relative to the energy scale.
    """

    energies: int = 24
    phases: int = 400
    farthest: float = 1.0
    distance: float = 1e-4
    leaves: float = 3e-7
    segments: int = 8
    near: float = 1e-3
    iterations: int = 25
    accept: float = 1e-10
    same: float = 1e-7


@dataclass(frozen=True)
class SymmetricSearch(Shown, Documented, Concluded):
    """Symmetric homoclinic connections of one family between two energies.

    Attributes:
        saddle: saddle of the orbits.
        family: index of the family of orbits.
        hit: crossing at which connections are searched.
        searched: covered energy range, J.
        connections: connections found.
        failed: number of zeros whose refinement did not converge.
        left: number of zeros for which no time was left.
        cause: why the grid of energies ended.
        beyond: first orbit that was not searched, if any.
        seconds: limit of the processor time, s.
    """

    KEYS: ClassVar[str] = (
        "count=#connections connections:energy=source.energy,floquet_multipliers=source.floquet_multipliers,** "
        "from=saddle to=saddle hits complete family searched failed partial cause status"
    )

    saddle: str
    family: int
    hit: int
    searched: tuple[float, float]
    connections: tuple[Connection, ...]
    failed: int
    left: int
    cause: GridCause
    beyond: LyapunovOrbit | None
    seconds: float

    @property
    def partial(self) -> bool:
        """True if the time limit ended the search early."""
        return self.left > 0 or self.cause is GridCause.TIME

    @property
    def missed(self) -> str:
        """Why there is no connection."""
        return "" if self.connections else f"no symmetric connection of {self.saddle}: {self.status}"

    def __repr__(self) -> str:
        return f"<symmetric connections of {self.saddle}: {self.status}>"

    @property
    def hits(self) -> tuple[int, int]:
        """Crossing numbers of both tubes."""
        return self.hit, self.hit

    @property
    def complete(self) -> bool:
        """Always False: the family also has connections that are not symmetric."""
        return False


def find_symmetric_connections(
    system: System,
    saddle: str,
    *,
    energies: tuple[float, float],
    family: int = 0,
    hit: int = 1,
    settings: SymmetricSettings | None = None,
    budget: Budget | None = None,
    progress: Progress = no_progress,
) -> SymmetricSearch:
    """Find the symmetric homoclinic connections of a family.

    Each connection exists at one energy only. If time runs out, the result is marked as partial.

    Args:
        system: system of three arms.
        saddle: name of the saddle.
        energies: (lowest, highest), J.
        family: number of the family, slowest first.
        hit: number of the upright arm's passage through its lowest position, in the middle of the connection.
        settings: settings of the search.
        budget: time limit, one minute by default.
        progress: called with a label and the completed share.

    Raises:
        InputError: an unknown saddle or family, an invalid energy range, or a system without three coordinates.
    """
    settings, budget = settings or SymmetricSettings(), budget or Budget(SECONDS)
    if system.dimension != 6:
        raise InputError(
            f"{system.name} has {system.dimension // 2} coordinates, so its connections form families: give one "
            "energy, or search for bifurcations between two"
        )
    low, high = (float(energy) for energy in energies)
    if not low < high:
        raise InputError(f"energies = {low:g} {high:g}: must be in ascending order, in J")
    search = _FamilySearch(system, saddle, family, hit, settings)
    rows: list[_Row] = []
    cause, orbit = GridCause.REACHED, None
    for k, energy in enumerate(np.linspace(low, high, settings.energies).tolist()):
        progress(f"tubes of {saddle} at {energy:.4g} J", 0.8 * k / settings.energies)
        # The first orbit is found from its saddle, each other one from the previous orbit.
        orbit = (
            nearby_orbit(search.problem, rows[-1].orbit, energy)
            if rows
            else lyapunov_orbit(system, saddle, energy=energy, family=family)
        )
        cause = _fitness(orbit)
        if cause is GridCause.REACHED and budget.share > _GRID:
            cause = GridCause.TIME
        if cause is not GridCause.REACHED:
            break
        rows.append(search.flown(orbit))
    connections: list[Connection] = []
    failed = unsearched = 0
    zeros = list(search.zeros(rows))
    for k, (orbit, branch, phase) in enumerate(zeros):
        if budget.spent:
            unsearched = len(zeros) - k
            break
        progress(f"{len(zeros)} candidates", 0.8 + 0.2 * k / len(zeros))
        connection = search.refined(orbit, branch, phase, (high - low) / settings.energies)
        if connection is None:
            failed += 1
        elif low <= connection.source.energy <= high and not any(
            search.same(connection, earlier) for earlier in connections
        ):
            connections.append(connection)
    connections.sort(key=lambda listed: listed.source.energy)
    progress("connections", 1.0)
    reached = (low, rows[-1].orbit.energy) if rows else (low, low)
    return SymmetricSearch(
        saddle, family, hit, reached, tuple(connections), failed, unsearched, cause, orbit, seconds=budget.seconds
    )


_GRID = 0.7
"""Share of the time limit for the grid of energies; the rest is for the candidates."""


def mirror_image(connection: Connection) -> Connection:
    """Return the mirror image of a connection, which turns the other way and exists at the same energy."""
    return named(mirrored(connection), at_energy=True)


def _fitness(orbit: LyapunovOrbit) -> GridCause:
    """Return REACHED if an orbit's tube can be searched; otherwise the cause that ends the grid of energies."""
    if not orbit.converged:
        return GridCause.ORBIT
    return GridCause.REACHED if orbit.unstable_directions == 1 else GridCause.UNSTABLE_DIRECTIONS


@dataclass(frozen=True)
class _Row:
    """A row of the grid of energies and phases: an orbit, and where the trajectories of its tube arrive.

    `gaps` (B, P, n-1): for B branches and P phases, the angles of all arms but the upright one, relative to the nearest
    vertical positions, when it hangs down, rad. All zero means a symmetric connection; NaN without arrival.
    """

    orbit: LyapunovOrbit
    branches: tuple[int, ...]
    gaps: Array


@dataclass(frozen=True)
class _FamilySearch:
    """The search for symmetric connections of one family: its settings, and the steps from tubes to connections.

    The system has three arms. `family` is the number of the family, slowest first. `hit` is the number of the upright
    arm's passage through its lowest position, in the middle of the connection.
    """

    system: System
    saddle: str
    family: int
    hit: int
    settings: SymmetricSettings

    @cached_property
    def problem(self) -> SymmetricShooting:
        """The shooting problem of the family, from which orbits of other energies follow."""
        return shooting_problem(self.system, self.saddle, self.family)[0]

    @cached_property
    def arm(self) -> int:
        """The saddle's upright arm, which the unstable direction moves most."""
        centre, n = self.system.equilibrium(self.saddle), self.system.dimension // 2
        values, vectors = np.linalg.eig(self.system.numeric.jacobian(centre))
        return int(np.argmax(np.abs(vectors[:n, np.argmax(np.real(values))])))

    @cached_property
    def section(self) -> Section:
        """The section on which the upright arm hangs down."""
        n, period = self.system.dimension // 2, float(self.system.periods[self.arm])
        coefficients = tuple(float(i == self.arm) for i in range(2 * n))
        hanging = float(self.system.equilibrium(self.saddle)[self.arm]) + period / 2
        return Section(
            f"arm {self.arm + 1} hanging", coefficients, coefficients, coefficients[:n], offset=hanging, period=period
        )

    def flown(self, orbit: LyapunovOrbit) -> _Row:
        """Return the row of an orbit: its tube's trajectories at the section, for the grid of energies and phases."""
        settings, manifold = self.settings, local_manifold(orbit, self.settings.distance)
        branches = (1,) if manifold.branches_are_mirrored else (1, -1)
        phases, gaps = np.arange(settings.phases) / settings.phases, []
        indices = [i for i in range(self.system.dimension // 2) if i != self.arm]
        for branch in branches:
            longest = self.system.flight_periods * orbit.period
            states, *_ = arrivals(manifold, self.section, phases, hit=self.hit, branch=branch, longest=longest)
            gaps.append(self._off(states)[:, indices])
        return _Row(orbit, branches, np.array(gaps))

    def _off(self, states: Array) -> Array:
        """Return the angles (…, n) of states (…, N) relative to the nearest vertical positions of the arms, rad.

        All are zero on the fixed set of the reverser.
        """
        deviations = states - self.problem.centre
        deviations = deviations - self.system.nearest_turns(2 * deviations) * self.system.turn_lengths / 2
        return deviations[..., : self.system.dimension // 2]

    def zeros(self, rows: list[_Row]) -> Iterator[tuple[LyapunovOrbit, int, float]]:
        """Yield (nearest orbit, branch, phase) for each triangle of the grid whose image contains the origin.

        Two triangles cover each cell between neighbouring energies and phases. Triangles with distant corners are not
        searched, because the map is not smooth there.
        """
        count = self.settings.phases
        phase_indices = np.arange(count)
        for below, above in pairwise(rows):
            for branch_index, branch in enumerate(below.branches):
                lower_gaps, upper_gaps = below.gaps[branch_index], above.gaps[branch_index]
                next_phase = [np.roll(gaps, -1, axis=0) for gaps in (lower_gaps, upper_gaps)]
                for corners, places, grid_row in (
                    ((lower_gaps, upper_gaps, next_phase[0]), (0, 0, 1), below),
                    ((next_phase[1], upper_gaps, next_phase[0]), (1, 0, 1), above),
                ):
                    first, second, third = corners
                    sides = np.stack([second - first, third - first], axis=-1)
                    with np.errstate(invalid="ignore"):
                        smooth = np.abs(sides).max(axis=(1, 2)) < self.settings.farthest
                        area = np.linalg.det(sides)
                        flat = ~smooth | (area == 0)
                    sides[flat] = np.eye(2)
                    shares = np.linalg.solve(sides, -first[..., None])[..., 0]
                    inside = ~flat & (shares >= 0).all(axis=1) & (shares.sum(axis=1) <= 1)
                    for phase_index in phase_indices[inside]:
                        weights = np.array([1 - shares[phase_index].sum(), *shares[phase_index]])
                        yield grid_row.orbit, branch, float((phase_index + weights @ np.array(places)) / count % 1.0)

    def refined(self, orbit: LyapunovOrbit, branch: int, phase: float, spacing: float) -> Connection | None:
        """Return a zero's connection by multiple shooting with free energy, phase and time, or None after a failure.

        `branch` and `phase`: of the trajectory nearest to the zero. `spacing`: distance of the grid's energies, J.
        """
        settings = self.settings
        manifold = local_manifold(orbit, settings.distance)
        amplitude = manifold.amplitude(phase, branch)
        seed = ManifoldEnd(manifold, False, phase, amplitude, (0.0,) * self.system.dimension)
        lead = float(np.log(settings.distance / settings.leaves)) / manifold.exponent * orbit.period
        arrival = self.system.propagator.crossing(
            seed.states(np.zeros(1))[0],
            self.section,
            longest=self.system.flight_periods * orbit.period,
            hit=self.hit,
        )
        if arrival is None:
            return None
        count = int(np.ceil((lead + arrival.time) / orbit.period * settings.segments))
        times = np.linspace(-lead, arrival.time, count + 1)
        early = times < 0
        states = np.vstack([
            seed.states(times[early]), self.system.propagator.sample(seed.states(np.zeros(1))[0], times[~early])
        ])  # fmt: skip
        start = seed.moved(-lead)
        target = states[-1][: self.system.dimension // 2] - self._off(states[-1])
        shot = self._shot(_Half(start, states[:-1], lead + arrival.time), target, spacing)
        return None if shot is None else self._described(*shot)

    def _shot(self, half: "_Half", target: Array, spacing: float) -> "tuple[_Half, Array, float] | None":
        """Solve for a half that ends at angles `target` (n,), rad, by multiple shooting.

        The unknowns of a Newton step are the orbit's energy, the phase of the start, the duration and the inner nodes.
        `half`: guess. `spacing`: distance of the grid's energies, J, the largest change of the energy in a step.

        Returns:
            The half, its middle state and the largest defect, or None after a failure.
        """
        system, n = self.system, self.system.dimension // 2
        best: tuple[_Half, Array, float] | None = None
        for _ in range(self.settings.iterations):
            nodes, count = half.states, len(half.states)
            try:
                start, slopes = self._start(half)
                nodes = np.vstack([start, nodes[1:]])
                ends, matrices = system.propagator.flows_with_stm(nodes, np.full(count, half.duration / count))
            except (ArithmeticError, np.linalg.LinAlgError):
                break
            gaps = ends - np.vstack([nodes[1:], np.concatenate([target, ends[-1][n:]])])
            largest_gap = float(np.abs(gaps).max())
            if best is None or largest_gap < best[2]:
                best = (replace(half, states=nodes), np.concatenate([target, ends[-1][n:]]), largest_gap)
            elif best[2] < self.settings.accept:
                break
            size = 2 * n * (count - 1)
            # Columns: energy, phase, duration, and the inner nodes. Rows: gaps at the nodes, and angles at the end.
            matrix = np.zeros((size + n, 3 + size))
            for k in range(count):
                rows = slice(2 * n * k, 2 * n * k + (2 * n if k < count - 1 else n))
                height = rows.stop - rows.start
                matrix[rows, 2] = system.numeric.rate(ends[k])[:height] / count
                if k == 0:
                    matrix[rows, :2] = (matrices[0] @ slopes)[:height]
                else:
                    matrix[rows, 3 + 2 * n * (k - 1) : 3 + 2 * n * k] = matrices[k][:height]
                if k < count - 1:
                    matrix[rows, 3 + 2 * n * k : 3 + 2 * n * (k + 1)] -= np.eye(2 * n)
            step = np.linalg.lstsq(matrix, -gaps.ravel()[: size + n], rcond=None)[0]
            # The linearisation is valid for about one cell of the grid.
            step /= max(1.0, abs(step[0]) / spacing, abs(step[1]) * self.settings.phases / 4)
            orbit = nearby_orbit(self.problem, half.start.manifold.orbit, half.start.manifold.orbit.energy + step[0])
            if not orbit.converged:
                break
            manifold = local_manifold(orbit, half.start.manifold.distance)
            sign = np.sign(manifold.vector @ half.start.manifold.vector)
            half = _Half(
                replace(half.start, manifold=manifold, phase=half.start.phase + step[1],
                        amplitude=sign * half.start.amplitude),
                np.vstack([nodes[:1], nodes[1:] + step[3:].reshape(-1, 2 * n)]),
                half.duration + step[2],
            )  # fmt: skip
        return best if best is not None and best[2] < self.settings.accept else None

    def _start(self, half: "_Half") -> tuple[Array, Array]:
        """Return the first state (N,) of a half and its derivatives (N, 2) by energy, per J, and by phase.

        The derivative by energy is a central difference of neighbouring orbits.
        """
        half_start = half.start
        orbit, vector = half_start.manifold.orbit, half_start.manifold.vector
        frame = half_start.manifold.frame(np.array([half_start.phase]))
        by_phase = frame.state_slopes[0] + half_start.amplitude * frame.vector_slopes[0]
        energy_step = 1e-6 * self.system.energy_scale
        neighbours = []
        for energy in (orbit.energy - energy_step, orbit.energy + energy_step):
            manifold = local_manifold(nearby_orbit(self.problem, orbit, energy), half_start.manifold.distance)
            shifted = replace(
                half_start, manifold=manifold, amplitude=np.sign(manifold.vector @ vector) * half_start.amplitude
            )
            neighbours.append(shifted.states(np.zeros(1))[0])
        return half_start.states(np.zeros(1))[0], np.column_stack(
            [(neighbours[1] - neighbours[0]) / (2 * energy_step), by_phase]
        )

    def _described(self, half: "_Half", middle: Array, residual: float) -> Connection:
        """Return the connection composed of a solved half and its image under the reverser.

        `middle` (N,): state on the fixed set, at which the halves meet. `residual`: largest defect between segments.
        """
        system, n = self.system, self.system.dimension // 2
        orbit, centre = half.start.manifold.orbit, self.problem.centre
        # Arms have two reversers. The first maps to stable tubes. The last reverses all angles, and equals the first
        # combined with the half turn that shifts the orbit by half a period.
        reverser, half_turn = system.reversers[-1], half.start.manifold.half_turn
        assert half_turn is not None
        turns = np.zeros(2 * n)
        turns[:n] = np.rint(2 * (middle[:n] - centre[:n]) / system.periods[:n])
        first_half = half.states
        second_half = (first_half[::-1] - centre) @ reverser.T + centre + turns * system.turn_lengths
        count = len(first_half)
        times = np.linspace(-half.duration, half.duration, 2 * count + 1)
        end = replace(
            half.start,
            stable=True,
            phase=half.start.phase + 0.5,
            amplitude=half_turn[1] * half.start.amplitude,
            turns=tuple(float(k) for k in turns),
        )
        flight = ShootingOrbit(
            system=system,
            times=times,
            states=np.vstack([first_half, middle, second_half]),
            ends=(half.start, end),
            turn=None,
            residual=residual,
            iterations=0,
            cause=ShootingCause.CONVERGED,
        )
        time_out, phase_out = approach(flight, OrbitCurve(orbit), -1, self.settings.near)
        time_in, phase_in = approach(flight, OrbitCurve(orbit), +1, self.settings.near)
        winding = tuple(int(k) for k in turns[:n])
        connection = Connection(
            name="",
            source=orbit,
            target=orbit,
            section=self.section,
            state=middle,
            winding=winding,
            sense=int(np.sign(winding[self.arm])),
            symmetric=True,
            residual=residual,
            transversality_angle=float("nan"),
            hits=(self.hit, self.hit),
            time_out=time_out,
            time_in=time_in,
            phase_out=phase_out,
            phase_in=phase_in,
            orbit=flight,
        )
        return named(connection, at_energy=True)

    def same(self, first: Connection, second: Connection) -> bool:
        """Return True if two connections are equal or mirror images, by their energies and turns up to signs."""
        difference = abs(first.source.energy - second.source.energy) / self.system.energy_scale
        return difference < self.settings.same and [abs(k) for k in first.winding] == [abs(k) for k in second.winding]


@dataclass(frozen=True)
class _Half:
    """A connection's first half, from the local manifold to the fixed set.

    Attributes:
        start: point on the unstable manifold.
        states (M, N): nodes at equal times from the start, without the end.
        duration: time from the start to the end, s.
    """

    start: ManifoldEnd
    states: Array
    duration: float
