"""A conservative system as the search for orbits sees it: equations, symmetries, saddles, sections.

Nothing here assumes angles: coordinates have periods where they are angles, reversers are matrices, and sections
are rows of numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.equations import Equations, NumericEquations
from dpcontrol.dynamics.propagator import Propagator, Section, SegmentPropagator
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import suggest

Array = NDArray[np.float64]


@dataclass(frozen=True)
class System:
    """A Hamiltonian system with N = 2n states.

    equilibria: name -> state (N,). periods (N,): 2π for angles, infinity otherwise. reversers: matrices (N, N)
    that turn the flow around in time, x(t) -> A x(-t). orientation (N,): a periodic orbit starts where it crosses
    its saddle's fixed set with orientation · (x - saddle) > 0. scale (N,): divides a state error. energy_scale: in
    the energy's unit. sections: (from, to) -> section on which connections are sought unless another is named;
    named_sections: all there are, by short names; section_scale: the size of what happens there in (q, p/p₀).
    flight_periods: how many periods of its orbit a tube's trajectory is given to
    reach a section.
    """

    name: str
    equations: Equations
    parameters: Array
    equilibria: Mapping[str, Array]
    periods: Array
    reversers: tuple[Array, ...]
    orientation: Array
    scale: Array
    energy_scale: float
    sections: Mapping[tuple[str, str], Section]
    named_sections: Mapping[str, Section] = field(default_factory=dict)
    section_scale: float = 1.0
    flight_periods: float = 12.0

    @property
    def dimension(self) -> int:
        """Length N of the state."""
        return self.equations.dimension

    @cached_property
    def turn_lengths(self) -> Array:
        """Lengths (N,) of a whole turn of each coordinate: its period, zero where it is no angle."""
        return np.where(np.isfinite(self.periods), self.periods, 0.0)

    @cached_property
    def numeric(self) -> NumericEquations:
        """The equations as numpy functions."""
        return NumericEquations(self.equations, self.parameters)

    @cached_property
    def propagator(self) -> Propagator:
        """The propagator, compiled when first used."""
        return Propagator(self.equations, self.parameters)

    @cached_property
    def segments(self) -> SegmentPropagator:
        """The propagator of many segments at once, compiled when first used."""
        return SegmentPropagator(self.propagator)

    def equilibrium(self, name: str) -> Array:
        """Return the state (N,) of the named equilibrium.

        Raises:
            InputError: there is no equilibrium of that name.
        """
        if name not in self.equilibria:
            raise InputError(f"{self.name} has no equilibrium {name!r}: {suggest(name, self.equilibria)}")
        return self.equilibria[name]

    def section_between(self, source: str, target: str, name: str | None = None) -> Section:
        """Return the section on which connections between two saddles are sought, or the one of a short name.

        Raises:
            InputError: there is no section of that name, or none between the saddles.
        """
        if name is not None:
            if name not in self.named_sections:
                raise InputError(f"{self.name} has no section {name!r}: {suggest(name, self.named_sections)}")
            return self.named_sections[name]
        if (source, target) not in self.sections:
            raise InputError(f"{self.name} has no section between {source} and {target}")
        return self.sections[source, target]

    def nearest_turns(self, difference: Array) -> Array:
        """Return the whole periods (…, N) nearest to a difference of states: integers, zero off angles."""
        angular = np.isfinite(self.periods)
        turns = np.zeros(np.shape(difference))
        turns[..., angular] = np.rint(np.asarray(difference)[..., angular] / self.periods[angular])
        return turns

    def scaled_distance(self, first: Array, second: Array) -> Array:
        """Return the largest scaled component of the difference of states (…, N), angles modulo a turn."""
        difference = np.asarray(first) - np.asarray(second)
        difference = difference - self.nearest_turns(difference) * self.turn_lengths
        return np.max(np.abs(difference) / self.scale, axis=-1)


def _angle_section(name: str, angles: tuple[float, ...], along: tuple[float, ...]) -> Section:
    """Return the section angles · θ = 2πk of a chain, with the coordinate that varies along `along`."""
    n = len(angles)
    rest = (0.0,) * n
    # Any arm that moves along the section measures the position on it.
    measure = tuple(1.0 if i == along.index(1.0) else 0.0 for i in range(n))
    return Section(name, angles + rest, measure + rest, along, period=2 * np.pi)


def pendulum_system(name: str, parameters: ArmChainParameters) -> System:
    """Return the frictionless pendulum on a fixed pivot as a system: level conservative.

    Saddles are named by the arms' directions, inner arm first. For two arms the sections are those of the paper:
    the turning arm passes straight down ("outer-down", θ₂ = 2πk, about Down-Up; "inner-down", θ₁ = 2πk, about
    Up-Down), and between different saddles both arms align ("aligned", θ₁ - θ₂ = 2πk).
    """
    n = parameters.count
    equations = arm_chain_equations(n, Level.CONSERVATIVE)
    base = parameters.viscous_only().base()
    weights = base[n * (n + 1) // 2 : n * (n + 1) // 2 + n]
    equilibria = {
        "-".join(words): np.array([np.pi * (w == "up") for w in words] + [0.0] * n)
        for words in product(("down", "up"), repeat=n)
    }
    sections: dict[tuple[str, str], Section] = {}
    named: dict[str, Section] = {}
    if n == 2:
        outer = _angle_section("angle_2 = 2 pi k", (0.0, 1.0), (1.0, 0.0))
        inner = _angle_section("angle_1 = 2 pi k", (1.0, 0.0), (0.0, 1.0))
        aligned = _angle_section("angle_1 = angle_2 + 2 pi k", (1.0, -1.0), (1.0, 1.0))
        named = {"outer-down": outer, "inner-down": inner, "aligned": aligned}
        sections = {
            ("down-up", "down-up"): outer,
            ("up-down", "up-down"): inner,
            ("down-up", "up-down"): aligned,
            ("up-down", "down-up"): aligned,
        }
    still, one = np.ones(n), np.ones(n)
    return System(
        name=name,
        equations=equations,
        parameters=base,
        equilibria=equilibria,
        periods=np.concatenate([np.full(n, 2 * np.pi), np.full(n, np.inf)]),
        reversers=(np.diag(np.concatenate([still, -one])), np.diag(np.concatenate([-still, one]))),
        orientation=np.eye(2 * n)[n],
        scale=np.concatenate([np.full(n, np.pi), np.full(n, 10.0)]),
        energy_scale=float(2 * weights.sum()),
        sections=sections,
        named_sections=named,
    )


def momentum_scale(system: System, section: Section) -> float:
    """Return p₀ = √(M_qq G_q), the momentum that makes a section's (q, p/p₀) dimensionless.

    M_qq and G_q are the kinetic and potential stiffness along the section, at the lowest equilibrium; 1 where the
    potential is not of that kind (coordinates that are not angles).
    """
    if not np.isfinite(system.periods).any():
        return 1.0
    n = system.dimension // 2
    lowest = min(system.equilibria.values(), key=lambda x: float(system.numeric.hamiltonian(x)))
    along = np.asarray(section.momentum)
    mass = along @ system.numeric.mass_matrix(lowest) @ along
    # At rest ∂(momentum rate)/∂q = -V'', and momentum rate = M · acceleration.
    stiffness = -system.numeric.mass_matrix(lowest) @ system.numeric.jacobian(lowest)[n:, :n]
    return float(np.sqrt(mass * (along @ stiffness @ along)))
