"""Continuation of connections in energy, and changes of the selected connection.

The symbol "down-up +" selects the connection whose tubes meet at the largest angle. Angles vary with energy, so the
symbol may select another motion beyond some energy. Connections are followed by continuation, and each energy at which
the selection changes is located by bisection.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from dpcontrol.bifurcations.bifurcations import Sweep, SweepSettings
from dpcontrol.bifurcations.links import PathPoint, Quantity, carry, first_crossing
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.tubes.connections import Connection, find_connections, mirrored, orbits_between
from dpcontrol.walks.symbols import Symbol, choose

_SAME = 1e-4
"""Largest scaled distance between two solutions for the same section crossing."""
_GRID = 6
"""Number of steps in a range of energies."""
_HALVED = 7
"""Number of bisections to locate a change within a step."""


@dataclass(frozen=True)
class SymbolChange(Documented):
    """An energy beyond which a symbol selects another connection.

    Attributes:
        symbol: symbol, such as "down-up +".
        energy: J.
        within: error bound of the energy, J.
        before, after: connection names.
        ends: True if the first connection is not found beyond, False if another one has a larger angle.
        unit: unit of the energy, "" in a system with its own units.
    """

    KEYS: ClassVar[str] = "symbol energy within before after ends"

    symbol: str
    energy: float
    within: float
    before: str
    after: str
    ends: bool
    unit: str = " J"

    @property
    def sentence(self) -> str:
        """A sentence describing the change."""
        reason = "the previous one is not found beyond it" if self.ends else "another one has a larger angle beyond it"
        return (
            f'"{self.symbol}" selects another connection beyond {self.energy:.6g}{self.unit} (±{self.within:.1g}), '
            f"because {reason}: {self.before} before, {self.after} after"
        )


@dataclass(frozen=True)
class SymbolChanges(Documented):
    """The energies between two, J, at which symbols select other connections.

    Attributes:
        changes: changes in order of energy.
        energies: energies between which they were searched, J.
        unit: unit of the energies, "" in a system with its own units.
    """

    KEYS: ClassVar[str] = "symbol_changes=changes energies status"

    changes: tuple[SymbolChange, ...]
    energies: tuple[float, float]
    unit: str

    @property
    def status(self) -> str:
        """Number of the changes in words."""
        begin, end = self.energies
        return f"{len(self.changes)} changes of the selected connections between {begin:g} and {end:g}{self.unit}"


class SymbolBranches:
    """Connections that match a symbol at any energy, with cached searches.

    `_found` holds the connections between the symbol's saddles by energy, J, of all searches so far.
    """

    def __init__(self, system: System, symbol: Symbol) -> None:
        """Prepare a symbol, such as "down-up > up-down +", to be followed in energy.

        Raises:
            InputError: the symbol is a composite edge or leads to a rotating orbit.
        """
        if symbol.parts or (symbol.source, symbol.target) not in system.sections:
            raise InputError(f"{symbol.text!r}: only a connection between saddles can be followed in energy")
        self.system, self.symbol = system, symbol
        self._found: dict[float, tuple[Connection, ...]] = {}

    @cached_property
    def _sweep(self) -> Sweep:
        """The sweep over energy that solves and continues the first-hit connections of the symbol's saddles."""
        return Sweep(Quantity.of_energy(self.system), self.symbol.source, self.symbol.target, 1, SweepSettings())

    def connections(self, energy: float) -> tuple[Connection, ...]:
        """Return the connections between the symbol's saddles at an energy, none if an orbit does not exist there.

        Args:
            energy: energy, J.
        """
        if energy not in self._found:
            try:
                orbits = orbits_between(self.system, self.symbol.source, self.symbol.target, energy)
                exist = all(orbit.converged for orbit in orbits)
                self._found[energy] = find_connections(*orbits).connections if exist else ()
            except InputError:
                self._found[energy] = ()
        return self._found[energy]

    def chosen(self, energy: float) -> Connection | None:
        """Return the connection that the symbol selects at an energy, or None if there is none.

        Args:
            energy: energy, J.
        """
        try:
            return choose(self.symbol, self.connections(energy))
        except InputError:
            return None

    def followed(self, connection: Connection, energy: float) -> Connection | None:
        """Return the connection among those at another energy to which continuation of a connection leads.

        The image of a connection is that under the half turn, a symmetry of the system that advances each Lyapunov
        orbit by half a period. The result is None if continuation fails, if the search at the first energy finds
        neither the connection nor its image, or if no connection found at the other energy agrees with the
        continuation.

        Args:
            connection: connection at its energy.
            energy: the other energy, J.
        """
        start = connection.source.energy
        # Sweeps find only one of two mirror images, so the other one is sought if the connection is not among them.
        half_turn = connection.orbit.start.manifold.half_turn
        for original_or_image in (connection,) if half_turn is None else (connection, mirrored(connection)):
            point = self._point(original_or_image, start)
            if point is None:
                continue
            # `carry` is None if the connection may turn back or cannot be followed to this energy.
            continued = point if energy == start else carry(self._sweep.problem, point, energy)
            if continued is None:
                return None
            state = first_crossing(self._sweep.problem, continued.link, energy)
            if state is None:
                return None
            for other in self.connections(energy):
                candidate = other if original_or_image is connection else mirrored(other)
                if other.sense == connection.sense and self.system.scaled_distance(state, candidate.state) < _SAME:
                    return other
            return None
        return None

    def _point(self, connection: Connection, energy: float) -> PathPoint | None:
        """Return the solution of the sweep at `energy` (J) that is the given connection, or None if none is.

        The solution describes the connection by phases and duration of its flight between the two tubes' seeds (its
        link), without a section, and can be continued. It is the connection if their first section crossings agree to
        a scaled distance of 1e-4.
        """
        for point in self._sweep.search(energy).points:
            state = first_crossing(self._sweep.problem, point.link, energy)
            if state is not None and float(self.system.scaled_distance(state, connection.state)) < _SAME:
                return point
        return None

    def changes(self, low: float, high: float, *, progress: Progress = no_progress) -> tuple[SymbolChange, ...]:
        """Return the changes of the connection that the symbol selects, between two energies.

        The range has six steps, and bisection locates at most one change in each of them. Steps with an end at which
        the symbol selects no connection are skipped with a remark.

        Args:
            low: first energy, J.
            high: last energy, J.
            progress: called with a label and the completed share.
        """
        grid, changes, unit = np.linspace(low, high, _GRID + 1).tolist(), [], self.system.unit("J")
        if absent := [f"{energy:.6g}{unit}" for energy in grid if self.chosen(energy) is None]:
            remark(
                f'"{self.symbol.text}" selects no connection at {", ".join(absent)}: changes beside these energies are '
                "not reported"
            )
        for k, (begin, end) in enumerate(pairwise(grid)):
            progress(f"{self.symbol.text} from {begin:.4g}{unit}", k / _GRID)
            selected, selected_at_end = self.chosen(begin), self.chosen(end)
            if selected is None or selected_at_end is None or self._keeps(selected, end):
                continue
            energy, beyond = bisected(begin, end, lambda value, connection=selected: self._keeps(connection, value))
            next_selected = self.chosen(beyond)
            changes.append(
                SymbolChange(
                    self.symbol.text,
                    (energy + beyond) / 2,
                    abs(beyond - energy) / 2,
                    selected.name,
                    selected_at_end.name if next_selected is None else next_selected.name,
                    self.followed(selected, beyond) is None,
                    unit,
                )
            )
        progress(self.symbol.text, 1.0)
        return tuple(changes)

    def _keeps(self, connection: Connection, energy: float) -> bool:
        """Return True if, at another energy (J), the symbol still selects the continuation of `connection`."""
        followed, chosen = self.followed(connection, energy), self.chosen(energy)
        return followed is not None and chosen is not None and followed.name == chosen.name


def bisected(low: float, high: float, holds: Callable[[float], bool]) -> tuple[float, float]:
    """Return the bracket of a change, found by bisection, whose width is 2^-7 of the first one.

    Args:
        low: energy on one side of the change, J.
        high: energy on the other side, J.
        holds: function of an energy; True at `low`, False at `high`.

    Returns:
        The last energy at which `holds` is True, and the first one at which it is False.
    """
    for _ in range(_HALVED):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def symbol_changes(
    system: System, symbols: Sequence[Symbol], energies: tuple[float, float], *, progress: Progress = no_progress
) -> tuple[SymbolChange, ...]:
    """Return the energies at which the symbols of a walk select another connection, and thus another motion.

    Args:
        system: dynamical system.
        symbols: symbols of a walk; each is followed once, and names of connections are skipped.
        energies: first and last energy, J.
        progress: called with a label and the completed share.

    Raises:
        InputError: a symbol cannot be followed, or both energies are equal.
    """
    if energies[0] == energies[1]:
        raise InputError(f"energies = {energies}: must be two different energies")
    simple_symbols = list({s.text: s for symbol in symbols for s in symbol.simple if s.name is None}.values())
    changes: list[SymbolChange] = []
    for k, symbol in enumerate(simple_symbols):
        portion = part_of(progress, k / len(simple_symbols), (k + 1) / len(simple_symbols))
        changes += SymbolBranches(system, symbol).changes(*energies, progress=portion)
    return tuple(changes)
