"""A conservative system for the search of orbits: equations, symmetries, saddles, sections.

Coordinates can be angles, which have periods, or lengths. Reversers are matrices, and sections are rows of numbers.
Users define a system by its energy as a casadi expression:

    def hamiltonian(q, p, c):
        (x, y), (px, py) = q, p
        return (px**2 + py**2) / 2 + (x**2 + y**2) / 2 + c["lambda"] * (x**2 * y - y**3 / 3)

    system = dp.System.from_hamiltonian("henon-heiles", hamiltonian, coordinates=("x", "y"),
                                        parameters={"lambda": 1.0}, equilibria={"top": (0.0, 1.0)})

Source of the reversers' properties: Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Annotated, Any, TypedDict, Unpack

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.dynamics.equations import (
    Energy,
    Equations,
    NumericEquations,
    hamiltonian_equations,
    mechanics,
    state_equations,
)
from dpcontrol.dynamics.propagator import Propagator, Section, taylor_system
from dpcontrol.foundation.arrays import Array, checked_array
from dpcontrol.foundation.checked import checked, number
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import installed
from dpcontrol.foundation.settings import Setting, Settings, check_choice, suggest
from dpcontrol.foundation.shown import Brief
from dpcontrol.foundation.units import SUBSCRIPTS, InUnits

EnergyFunction = Callable[[tuple[ca.SX, ...], tuple[ca.SX, ...], dict[str, ca.SX]], ca.SX]
"""(coordinates, their velocities or momenta, parameters by name) -> energy, casadi scalars throughout."""

_NAME = re.compile(r"\w([\w-]*\w)?")
_NEWTON_STEPS = 50
_SAME = 1e-9
"""Relative tolerance of a symmetry, which admits rounding only."""


class SystemOptions(TypedDict, total=False):
    """Optional properties of a system; each has a default.

    Attributes:
        orientation, section_scale, flight_periods, si: see `System`.
        periods: period of each coordinate, None for other coordinates than angles.
        reversers: signs of the coordinates, such as (1, -1), or matrices (N, N) (default: reversing sign changes).
        scale: typical size of all coordinates, of each, or of each state (default π for angles, else 1).
        energy_scale: default: the energy's rise over that size.
        sections: sections by short names.
        between: (from, to) -> short name for pairs to connect. The default for two saddles is a plane half-way.
            For orbits of one saddle it is their turning points beyond half the scale.
    """

    periods: Sequence[float | None]
    reversers: Sequence[ArrayLike]
    orientation: ArrayLike
    scale: float | Sequence[float]
    energy_scale: float
    sections: Mapping[str, Section]
    between: Mapping[tuple[str, str], str]
    section_scale: float
    flight_periods: float
    si: bool


@dataclass(frozen=True)
class System(Brief, InUnits):
    """A Hamiltonian system with N = 2n states, in which orbits, tubes and connections are searched.

    Attributes:
        equilibria: name -> state (N,).
        periods: 2π for angles, infinity otherwise (N,).
        reversers: matrices (N, N) that reverse the flow in time, x(t) -> A x(-t), about every saddle of index one. The
            product of two advances each Lyapunov orbit by half a period.
        orientation: row (N,). A periodic orbit starts on its saddle's fixed set with orientation · (x - saddle) > 0.
        scale: scale of state errors (N,).
        energy_scale: in the energy's unit.
        sections: (from, to) -> default section of connections.
        named_sections: all sections by short names.
        section_scale: size of structures there in (q, p/p₀).
        flight_periods: time limit of a tube's trajectory to a section, in periods of its orbit.
        coordinates: names (n,).
        si: True for SI units.
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
    coordinates: tuple[str, ...] = ()
    si: bool = False

    @classmethod
    def from_lagrangian(
        cls,
        name: str,
        lagrangian: EnergyFunction,
        *,
        coordinates: Sequence[str],
        equilibria: Mapping[str, Sequence[float]],
        parameters: Mapping[str, float] | None = None,
        **options: Unpack[SystemOptions],
    ) -> "System":
        """Return a system of two coordinates from L(q, v, parameters), in which orbits and connections can be searched.

        Its states are coordinates and velocities.

        Args:
            name: name of the system.
            lagrangian: energy L as a function of q (2,), v (2,) and parameters by name, all casadi scalars.
            coordinates: names (2,).
            equilibria: name -> guess of the coordinates (2,), refined by Newton's method. At least one is a
                saddle.
            parameters: name -> value, or None without parameters.
            **options: see `SystemOptions`.

        Raises:
            InputError: an invalid energy, guess, symmetry or option.
        """
        energy, symbols, numbers = _energy(name, "Lagrangian", lagrangian, coordinates, parameters)
        parts = mechanics(energy, lambda *_: ca.SX(0), free=2, prescribed=0, parameters=symbols)
        equations = state_equations(parts, with_cart=False)
        return described_system(name, equations, numbers, coordinates, equilibria, **options)

    @classmethod
    def from_hamiltonian(
        cls,
        name: str,
        hamiltonian: EnergyFunction,
        *,
        coordinates: Sequence[str],
        equilibria: Mapping[str, Sequence[float]],
        parameters: Mapping[str, float] | None = None,
        **options: Unpack[SystemOptions],
    ) -> "System":
        """Return a system of two coordinates from H(q, p, parameters).

        Its states are coordinates and momenta.

        Args:
            name: name of the system.
            hamiltonian: energy H as a function of q (2,), p (2,) and parameters by name, all casadi scalars.
            coordinates: names (2,).
            equilibria: see `from_lagrangian`. Their momenta are computed.
            parameters: name -> value, or None without parameters.
            **options: see `SystemOptions`.

        Raises:
            InputError: an invalid energy, guess, symmetry or option.
        """
        energy, symbols, numbers = _energy(name, "Hamiltonian", hamiltonian, coordinates, parameters)
        equations = hamiltonian_equations(energy, count=2, parameters=symbols)
        return described_system(name, equations, numbers, coordinates, equilibria, **options)

    def __repr__(self) -> str:
        return f"<system {self.name!r}: {', '.join(self.coordinates)}; saddles {', '.join(self.saddles)}>"

    @property
    def dimension(self) -> int:
        """Length N of the state."""
        return self.equations.dimension

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state, for tables and files.

        Coordinates come first, then their rates (v_x) or momenta (p_x).
        """
        names, state = self.coordinates, np.linspace(0.1, 0.9, self.dimension)
        # States (q, p) are their own momenta; at a generic state, rates differ from momenta.
        letter = "p" if np.allclose(self.numeric.momentum(state), state[len(names) :]) else "v"
        rates = (f"rate_{name[6:]}" if name.startswith("angle_") else f"{letter}_{name}" for name in names)
        return (*names, *rates)

    @property
    def labels(self) -> tuple[str, ...]:
        """Axis labels of the N entries of a state, for pictures; those of arms have symbols and units."""
        symbols = [f"{name[6:].translate(SUBSCRIPTS)} (rad" for name in self.coordinates if name.startswith("angle_")]
        return (*(f"θ{name})" for name in symbols), *(f"ω{name}/s)" for name in symbols)) or self.columns

    @cached_property
    def turn_lengths(self) -> Array:
        """Period (N,) of each state for whole turns, zero for other coordinates than angles."""
        return np.where(np.isfinite(self.periods), self.periods, 0.0)

    @cached_property
    def numeric(self) -> NumericEquations:
        """The equations as numpy functions with the system's parameters."""
        return NumericEquations(self.equations, self.parameters)

    @cached_property
    def propagator(self) -> Propagator:
        """The propagator, compiled when first used."""
        return Propagator(self.equations, self.parameters)

    @cached_property
    def saddles(self) -> tuple[str, ...]:
        """Names of the equilibria of index one.

        They have Lyapunov orbits and tubes.
        """
        return tuple(name for name, state in self.equilibria.items() if saddle_index(self.numeric, state) == 1)

    @property
    def description(self) -> str:
        """Text that identifies the system in cache keys, apart from the values of its parameters."""
        functions = [self.equations.numeric_functions[key].serialize() for key in ("rate", "hamiltonian")]
        settings = (self.equilibria, self.periods, self.reversers, self.orientation, self.scale, self.energy_scale,
                self.sections, self.section_scale, self.flight_periods)  # fmt: skip
        return "\n".join([*functions, repr(settings)])

    @checked
    def equilibrium(self, name: str) -> Array:
        """Return the state (N,) of the named equilibrium.

        Args:
            name: key of `equilibria`.

        Raises:
            InputError: there is no equilibrium of that name.
        """
        if name not in self.equilibria:
            raise InputError(f"{self.name} has no equilibrium {name!r}: {suggest(name, self.equilibria)}")
        return self.equilibria[name]

    @checked
    def section_between(self, source: str, target: str, name: str | None = None) -> Section:
        """Return the section of connections between two saddles.

        Args:
            source: name of the saddle that connections leave.
            target: name of the saddle that they approach.
            name: short name of another section; None for the default one.

        Raises:
            InputError: there is no section of that name, or none between the saddles.
        """
        if name is not None:
            if name not in self.named_sections:
                raise InputError(f"{self.name} has no section {name!r}: {suggest(name, self.named_sections)}")
            return self.named_sections[name]
        check_choice("saddle", self.equilibria, source, target)
        if (source, target) not in self.sections:
            isolated = "; three arms have connections at isolated energies: search a range of them (--energies LO HI)"
            hint = isolated if self.dimension == 6 else ""
            raise InputError(f"{self.name} has no section between {source} and {target}{hint}")
        return self.sections[source, target]

    @checked
    def check_same(self, other: "System") -> None:
        """Raise an error if another system differs, so that results of different systems are not combined.

        Name, coordinates and parameters are compared.

        Args:
            other: the other system.

        Raises:
            InputError: the systems differ.
        """
        identities = [
            (system.name, system.dimension, system.coordinates, system.parameters.tolist()) for system in (self, other)
        ]
        if self is not other and identities[0] != identities[1]:
            numbers = " with other parameters" if self.name == other.name else ""
            raise InputError(f"the results are of different systems, {self.name} and {other.name}{numbers}; use one")

    def nearest_turns(self, difference: Array) -> Array:
        """Return the numbers of whole periods (…, N) nearest to a difference of states.

        They are integers as doubles, zero for other coordinates than angles.

        Args:
            difference: difference of states (…, N).
        """
        return np.rint(checked_array("difference", difference, len(self.periods)) / self.periods)

    def scaled_distance(self, first: Array, second: Array) -> Array:
        """Return the distance (…) of states: the largest component of their difference over the system's scale.

        Angles count modulo a turn.

        Args:
            first: states (…, N).
            second: states (…, N) that are subtracted.
        """
        difference = checked_array("first", first, len(self.scale)) - checked_array("second", second, len(self.scale))
        difference = difference - self.nearest_turns(difference) * self.turn_lengths
        return np.max(np.abs(difference) / self.scale, axis=-1)


def saddle_index(numeric: NumericEquations, state: Array) -> int:
    """Return the number of unstable directions of an equilibrium, which distinguishes saddles from centres.

    This number is the index of the saddle, zero for a centre.

    Args:
        numeric: equations with parameters.
        state: equilibrium (N,).
    """
    eigenvalues = np.asarray(np.linalg.eigvals(numeric.jacobian(state)), dtype=complex)
    # Eigenvalues are real or imaginary here, so a part a million times smaller is rounding.
    return int(np.sum(np.real(eigenvalues) > 1e-6 * np.abs(eigenvalues)))


def momentum_scale(system: System, section: Section) -> float:
    """Return the momentum p₀ that scales a section.

    It makes the section's (q, p/p₀) dimensionless.

    Among angles it is √(M_qq G_q), M_qq and G_q the kinetic and potential stiffness along the section at the lowest
    equilibrium. Otherwise it follows from the states' scale.

    Args:
        system: Hamiltonian system.
        section: section of the system.
    """
    n, numeric, along = system.dimension // 2, system.numeric, np.asarray(section.momentum)
    if np.isfinite(system.periods).any():
        lowest = min(system.equilibria.values(), key=lambda x: float(numeric.hamiltonian(x)))
        mass = along @ numeric.mass_matrix(lowest) @ along
        # At rest ∂(momentum rate)/∂q = -V'', and momentum rate = M · acceleration.
        stiffness = -numeric.mass_matrix(lowest) @ numeric.jacobian(lowest)[n:, :n]
        squared = float(mass * (along @ stiffness @ along))
        if squared > 0:
            return float(np.sqrt(squared))
    units = np.abs(numeric.momentum_jacobian(next(iter(system.equilibria.values())))[:, n:] @ system.scale[n:])
    return float(np.abs(along) @ units / (np.abs(along) @ system.scale[:n]))


def _energy(
    name: str, kind: str, function: EnergyFunction, coordinates: Sequence[str], parameters: Mapping[str, float] | None
) -> tuple[Energy, ca.SX, Array]:
    """Check a user's energy, and return it as a function of casadi vectors, with its parameters' symbols and values.

    The symbols are a vector (p,) in the order of the values (p,). The function raises an InputError if the user's
    expression fails, is not a scalar, or depends on other variables. `kind` is "Lagrangian" or "Hamiltonian", for
    messages.
    """
    subject, numbers = f"the {kind} of {name}", dict(parameters or {})
    if len(coordinates) != 2 or isinstance(coordinates, str) or len(set(coordinates)) != 2:
        raise InputError(
            f"coordinates = {coordinates!r}: a user's system has two, with different names; tubes separate motions "
            f"in two degrees of freedom only"
        )
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise InputError(f"parameter {key} = {value!r} of {name}: must be a finite number")
    symbols = ca.SX.sym("c", len(numbers))

    def energy(q: ca.SX, v: ca.SX, _: ca.SX) -> ca.SX:
        """Return the user's energy at positions q (2,) and velocities or momenta v (2,), with symbols as parameters."""
        named = {key: symbols[k] for k, key in enumerate(numbers)}
        try:
            value = ca.SX(function((q[0], q[1]), (v[0], v[1]), named))
        except Exception as error:
            reason = str(error).partition("\n")[0][:80]
            raise InputError(
                f"{subject} fails on casadi's SX symbols ({type(error).__name__}: {reason}); write it with their "
                "arithmetic and casadi's functions, such as ca.sqrt"
            ) from error
        if value.shape != (1, 1):
            raise InputError(f"{subject} has the shape {value.shape}: an energy is one number")
        declared = {symbol.element_hash() for part in (q, v, symbols) for symbol in ca.symvar(part)}
        undeclared = [str(symbol) for symbol in ca.symvar(value) if symbol.element_hash() not in declared]
        if undeclared:
            raise InputError(
                f"{subject} depends on {undeclared[0]!r}, which is no coordinate, "
                f"{'momentum' if kind[0] == 'H' else 'rate'} or parameter; "
                "energy is conserved only if it does not depend on time or other variables"
            )
        return value

    return energy, symbols, np.array([float(value) for value in numbers.values()])


def described_system(
    name: str,
    equations: Equations,
    parameters: Array,
    coordinates: Sequence[str],
    equilibria: Mapping[str, Sequence[float]],
    **options: Unpack[SystemOptions],
) -> System:
    """Return a system of equations (N = 2n states), with its equilibria refined and its symmetries checked.

    Options that are not given have their defaults.

    Args:
        name: name of the system.
        equations: equations with N states and p parameters.
        parameters: values (p,).
        coordinates: names (n,).
        equilibria: name -> guess (n,) or (N,), refined by Newton's method.
        **options: see `SystemOptions`.

    Raises:
        InputError: an invalid guess, symmetry or option.
    """
    n, numeric = len(coordinates), NumericEquations(equations, parameters)
    if installed("heyoka"):
        try:
            taylor_system(equations, [])
        except NotImplementedError as error:
            raise InputError(f"{name} cannot be compiled: {error}") from error
    states = _equilibria(name, numeric, equilibria, n)
    saddles = {key: state for key, state in states.items() if saddle_index(numeric, state) == 1}
    if not saddles:
        indices = ", ".join(f"{key} has index {saddle_index(numeric, state)}" for key, state in states.items())
        raise InputError(f"{name} has no saddle of index one among its equilibria ({indices}): give a guess near one")
    first_saddle = next(iter(saddles.values()))
    periods = _periods(name, numeric, options.get("periods", (None,) * n), first_saddle)
    scale = _scale(name, options.get("scale"), numeric, periods, first_saddle)
    reversers = _reversers(name, numeric, saddles, scale, options.get("reversers"))
    named_sections = dict(options.get("sections", {}))
    sections: dict[tuple[str, str], Section] = {}
    if "between" not in options and n == 2 and reversers:
        sections = _default_sections(saddles, reversers[0], numeric, scale, periods, coordinates)
        # Sections that an angle replaces can still be named.
        for key in saddles:
            turning_sections = _default_sections(
                {key: saddles[key]}, reversers[0], numeric, scale, _ENDLESS, coordinates
            )
            if (key, key) in turning_sections and turning_sections[key, key] != sections.get((key, key)):
                named_sections.setdefault(f"turning-{key}", turning_sections[key, key])
    for pair, key in options.get("between", {}).items():
        for label, choices in ((key, named_sections), (pair[0], saddles), (pair[1], saddles)):
            if label not in choices:
                raise InputError(f"between {pair} of {name} names {label!r}: {suggest(label, choices)}")
        sections[pair] = named_sections[key]
    # The rise over a tenth of the scale is a hundredth of that over the scale, if it is quadratic.
    energy_rises = numeric.hamiltonian(first_saddle + np.diag(scale) / 10) - numeric.hamiltonian(first_saddle)
    return System(
        name=name,
        equations=equations,
        parameters=parameters,
        equilibria=states,
        periods=periods,
        reversers=reversers,
        # The start is defined by the first coordinate, or rate, that changes along an orbit.
        orientation=np.asarray(options.get("orientation", np.tile(1e-3 ** np.arange(n), 2) / scale), dtype=float),
        scale=scale,
        energy_scale=options.get("energy_scale", 100 * float(np.nanmax(np.abs(energy_rises)))),
        sections=sections,
        named_sections=named_sections,
        section_scale=options.get("section_scale", float(np.min(scale[:n]))),
        flight_periods=options.get("flight_periods", 12.0),
        coordinates=tuple(coordinates),
        si=options.get("si", False),
    )


def _equilibria(
    name: str, numeric: NumericEquations, guesses: Mapping[str, Sequence[float]], n: int
) -> dict[str, Array]:
    """Refine the guesses of equilibria by Newton's method, and return name -> state (N,).

    Guesses are (n,) coordinates, at rest, or states (N,). A guess at which the rate is exactly zero is unchanged. `n`
    is the number of coordinates, and `name` the system's.

    Raises:
        InputError: an invalid name or guess, no convergence, or two guesses of the same equilibrium.
    """
    equilibria: dict[str, Array] = {}
    for key, guess in guesses.items():
        if not isinstance(key, str) or not _NAME.fullmatch(key):
            raise InputError(f"{key!r} is not a name for an equilibrium of {name}: use letters, digits and dashes")
        try:
            numbers = np.asarray(guess, dtype=float)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape not in ((n,), (2 * n,)) or not np.isfinite(numbers).all():
            raise InputError(f"{key} of {name} is guessed at {guess!r}: give {n} finite coordinates, one for each")
        state = np.concatenate([numbers, np.zeros(2 * n - len(numbers))])
        for _ in range(_NEWTON_STEPS):
            rate, slope = numeric.rate(state), numeric.jacobian(state)
            if not (np.isfinite(rate).all() and np.isfinite(slope).all()):
                raise InputError(
                    f"the equations of {name} are not finite at {np.array2string(state, precision=6)}, on the way from "
                    f"the guess of {key}: the energy must be smooth there, with second derivatives by rates or "
                    f"momenta that do not vanish"
                )
            step = np.linalg.lstsq(slope, -rate, rcond=1e-12)[0]
            if np.abs(step).max() <= 4e-16 * max(1.0, float(np.abs(state).max())):
                break
            state = state + step
        residual = float(np.abs(numeric.rate(state)).max())
        if not residual < 1e-10 * max(1.0, float(np.abs(numeric.jacobian(state)).max())):
            raise InputError(
                f"no equilibrium of {name} was found from the guess {list(map(float, numbers))} of {key}: after "
                f"{_NEWTON_STEPS} Newton steps the rate is still {residual:.1e}; give a nearer guess"
            )
        # Entries of rounding size become exact zeros.
        state = np.where(np.abs(state) < 1e-16, 0.0, state)
        for earlier, earlier_state in equilibria.items():
            if np.allclose(state, earlier_state, rtol=0, atol=1e-9):
                raise InputError(
                    f"the guesses of {earlier} and {key} lead to one equilibrium of {name}; give one of them"
                )
        equilibria[key] = state
    return equilibria


def _periods(name: str, numeric: NumericEquations, periods: Sequence[float | None], state: Array) -> Array:
    """Return the periods (N,) of all states from those declared for the coordinates (n,), infinite where there is none.

    The equations must repeat after each period, which is tested near the equilibrium `state`.

    Raises:
        InputError: an invalid period, or rates that differ after it.
    """
    n = len(state) // 2
    if len(periods) != n or any(p is not None and not number("periods", p) > 0 for p in periods):
        raise InputError(f"periods = {list(periods)} of {name}: give {n}, each positive or None")
    lengths = np.array([np.inf if p is None else float(p) for p in periods] + [np.inf] * n)
    for k in np.flatnonzero(np.isfinite(lengths)):
        states = _around(state, np.ones(2 * n))
        rates_before, rates_after = numeric.rate(states), numeric.rate(states + lengths[k] * np.eye(2 * n)[k])
        if not np.allclose(rates_before, rates_after, rtol=_SAME, atol=_SAME, equal_nan=True):
            raise InputError(
                f"periods = {list(periods)} of {name}: coordinate {k + 1} does not repeat after its period"
            )
    return lengths


def _scale(
    name: str, scale: float | Sequence[float] | None, numeric: NumericEquations, periods: Array, saddle: Array
) -> Array:
    """Return the typical size (N,) of each state, by which searches scale distances.

    `scale` is the user's option: one number, n numbers for the coordinates, N numbers, or None for the default. Unless
    given, the sizes of rates or momenta follow from the fastest eigenvalue at the saddle. `periods` (N,) give the
    default for angles, half a turn.
    """
    n = len(periods) // 2
    is_angle = np.isfinite(periods[:n])
    try:
        sizes = np.where(is_angle, periods[:n] / 2, 1.0) if scale is None else np.asarray(scale, dtype=float)
    except (TypeError, ValueError):
        sizes = np.empty(0)
    if sizes.shape not in ((), (n,), (2 * n,)) or not np.isfinite(sizes).all() or not (sizes > 0).all():
        raise InputError(f"scale = {scale!r} of {name}: give one positive number, or one for each of {n} coordinates")
    if sizes.shape == (2 * n,):
        return sizes
    positions = np.broadcast_to(sizes, n)
    fastest_eigenvalue = float(np.abs(np.linalg.eigvals(numeric.jacobian(saddle))).max())
    # One if the states are rates, or momenta of unit masses.
    momenta_per_rate = np.linalg.norm(np.linalg.inv(numeric.jacobian(saddle)[:n, n:]), axis=1)
    return np.concatenate([positions, positions * fastest_eigenvalue * momenta_per_rate])


def _around(state: Array, scale: Array) -> Array:
    """Return twelve fixed states (12, N), scattered about one (N,), at which symmetries are tested.

    They lie off the fixed sets of symmetries. `scale` (N,) is the typical size of each state.
    """
    return state + 0.3 * scale * np.random.default_rng(1).uniform(-1.0, 1.0, (12, len(state)))


def _reverses(numeric: NumericEquations, reverser: Array, saddle: Array, scale: Array) -> bool:
    """True if R reverses the motion about a saddle in time: f(R x) = -R f(x) at scattered states, x from the saddle.

    At least three of the states must have finite rates. `reverser` is R (N, N), and `scale` (N,) the states' typical
    size.
    """
    states = _around(saddle, scale)
    rates = numeric.rate(states) @ reverser.T
    images = numeric.rate((states - saddle) @ reverser.T + saddle)
    finite = np.isfinite(rates).all(axis=1) & np.isfinite(images).all(axis=1)
    return bool(finite.sum() >= 3 and np.allclose(images[finite], -rates[finite], rtol=_SAME, atol=_SAME))


def _reversers(
    name: str,
    numeric: NumericEquations,
    saddles: Mapping[str, Array],
    scale: Array,
    declared: Sequence[ArrayLike] | None,
) -> tuple[Array, ...]:
    """Return at most two reversers (N, N) about every saddle: those declared, or the sign changes that hold.

    A reverser is a matrix R, its own inverse, that reverses the flow in time: with x(t), R x(-t) is a motion. The
    product of both advances each Lyapunov orbit by half a period, as the search of symmetric orbits requires. `saddles`
    are the saddles' states by name, and `declared` the user's option, None for the default.

    Raises:
        InputError: a declared reverser is no involution, or does not reverse the motion.
    """
    n = len(scale) // 2
    if declared is None:
        # Time reversal, if it holds, comes first.
        signs = product((1.0, -1.0), repeat=n)
        candidates = [np.diag([*entries, *(-s for s in entries)]) for entries in signs]
        reversers = [r for r in candidates if all(_reverses(numeric, r, saddle, scale) for saddle in saddles.values())]
    else:
        reversers = []
        for value in declared:
            entries = np.asarray(value, dtype=float)
            reverser = np.diag(np.concatenate([entries, -entries])) if entries.shape == (n,) else entries
            if reverser.shape != (2 * n, 2 * n) or not np.allclose(reverser @ reverser, np.eye(2 * n)):
                raise InputError(
                    f"reverser {entries.tolist()} of {name}: give {n} signs of the coordinates, or a matrix "
                    f"({2 * n}, {2 * n}) that is its own inverse"
                )
            for key, saddle in saddles.items():
                if not _reverses(numeric, reverser, saddle, scale):
                    raise InputError(f"reverser {entries.tolist()} of {name} does not reverse its motion about {key}")
            reversers.append(reverser)
    for second in reversers[1:]:
        if all(_is_half_turn(numeric, saddle, second @ reversers[0]) for saddle in saddles.values()):
            return (reversers[0], second)
    return tuple(reversers[:1])


def _is_half_turn(numeric: NumericEquations, saddle: Array, symmetry: Array) -> bool:
    """True if a symmetry (N, N) is -1 on all oscillations about a saddle.

    Such a symmetry advances the orbits by half a period. The oscillations are the vectors of imaginary eigenvalues.
    """
    values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(numeric.jacobian(saddle)))
    oscillations = vectors[:, np.abs(np.imag(values)) > 1e-6 * np.abs(values)]
    return bool(np.allclose(symmetry @ oscillations, -oscillations, atol=1e-9))


_ENDLESS = np.full(4, np.inf)


def _default_sections(
    saddles: Mapping[str, Array],
    reverser: Array,
    numeric: NumericEquations,
    scale: Array,
    periods: Array,
    names: Sequence[str],
) -> dict[tuple[str, str], Section]:
    """Return (from, to) -> section for the pairs of saddles whose section a reverser keeps; others have no default.

    The reverser is a matrix (N, N) that reverses the motion in time. It keeps a section if it maps it onto itself. The
    system has two coordinates, called `names`.

    Two saddles have the plane half-way, in both directions of an angle. Orbits of one saddle have a plane half a turn
    away if the unstable direction is mostly an angle. Otherwise they have the plane of the reverser's fixed set, which
    symmetric connections cross half-way. Under time reversal, the section is at the turning points along the unstable
    direction. `scale` and `periods` (N,) are the system's.
    """
    sections: dict[tuple[str, str], Section] = {}
    for first, second in product(saddles, repeat=2):
        low_name, high_name = sorted((first, second))
        lower, upper = saddles[low_name], saddles[high_name]
        if first == second:
            values, vectors = (np.asarray(a, dtype=complex) for a in np.linalg.eig(numeric.jacobian(lower)))
            direction, section = _unit_row(vectors[:2, int(np.argmax(np.real(values)))]), None
            coordinate = int(np.argmax(np.abs(direction / scale[:2])))
            if np.isfinite(periods[coordinate]):
                period = float(periods[coordinate])
                half_turn = Section.plane(
                    f"{names[coordinate]} half a turn from {first}",
                    np.eye(2)[coordinate],
                    offset=float(lower[coordinate]) + period / 2,
                    period=period,
                )
                if half_turn.kept_by(reverser, lower):
                    sections[first, first] = half_turn
                    continue
            for k in range(2):
                if section is None and np.allclose(reverser[k], -np.eye(4)[k]):
                    direction, normal = np.eye(2)[1 - k], np.eye(2)[k]
                    section = Section.plane(f"{names[k]} as at {first}", normal, offset=float(lower[k]))
            section = section or Section.turning(f"turning back to {first}", direction)
            reach = 0.5 * float(np.linalg.norm(direction * scale[:2]))
            section = section.where(direction, middle=float(direction @ lower[:2]), reach=reach)
        else:
            difference = (upper - lower)[:2]
            difference = difference - np.rint(difference / periods[:2]) * np.where(
                np.isfinite(periods[:2]), periods[:2], 0.0
            )
            normal_between = _unit_row(difference)
            offset = float(normal_between @ (lower[:2] + difference / 2))
            section = Section.plane(
                f"between {low_name} and {high_name}",
                normal_between,
                offset=offset,
                period=_turn(normal_between, periods),
            )
        if section.kept_by(reverser, saddles[second]):
            sections[first, second] = section
    return sections


def _turn(row: Array, periods: Array) -> float | None:
    """Return the distance between the sheets of the plane half-way between two saddles, or None if it has one sheet.

    The sheets are images of each other by whole turns. `row` (2,) is the plane's unit normal, and `periods` (N,) are
    the system's.
    """
    whole_turns = np.abs(row[row != 0] * periods[:2][row != 0])
    if not np.isfinite(whole_turns).all() or not np.allclose(whole_turns, whole_turns[0]):
        return None
    # Along a single angle, the middles of both directions are half a turn apart.
    return float(whole_turns[0]) / (2 if len(whole_turns) == 1 else 1)


def _unit_row(direction: NDArray[Any]) -> Array:
    """Return the row (n,) of unit length along a real direction (n,), with a definite sign, as a section's normal.

    Its largest entry is positive, and rounding is cut off.
    """
    unit_row = np.real(direction) / np.linalg.norm(np.real(direction))
    unit_row = np.where(np.abs(unit_row) > 1e-12, unit_row, 0.0)
    return unit_row * np.sign(unit_row[np.argmax(np.abs(np.round(unit_row, 9)))]) + 0.0


@dataclass(frozen=True)
class ThreeBodyParameters(Settings):
    """Parameters of the planar circular restricted three-body problem in the rotating frame.

        L = ½(ẋ² + ẏ²) + x ẏ - y ẋ + ½(μ₁ r₁² + μ₂ r₂²) + μ₁/r₁ + μ₂/r₂

    The larger primary (μ₁ = 1 - μ) is at x = -μ, the smaller (μ₂ = μ) at x = 1 - μ. Units are the distance of the
    primaries, their total mass and their angular velocity. The kinetic energy has terms linear in velocity, and there
    are no angles. mass_ratio μ: the smaller primary's share of the total mass, dimensionless.

    Source: Koon, Lo, Marsden, Ross (2000), section 2; the constant in the potential is that of Kaheman et al. (2023),
    appendix A.
    """

    mass_ratio: Annotated[float, Setting(above=0, most=0.5, help="Mass of the lighter body as a share of both.")]

    def named(self) -> dict[str, tuple[float, str]]:
        """Return {name: (value, unit)} for tables and for options that name a parameter."""
        return {"mu": (self.mass_ratio, "1")}

    def with_value(self, name: str, value: float) -> "ThreeBodyParameters":
        """Return the problem with another mass ratio.

        Args:
            name: "mu".
            value: mass ratio.

        Raises:
            InputError: an unknown name, or a value out of range.
        """
        check_choice("parameter", self.named(), name)
        return ThreeBodyParameters(mass_ratio=value)


def _lagrangian(q: tuple[ca.SX, ...], v: tuple[ca.SX, ...], parameters: dict[str, ca.SX]) -> ca.SX:
    """Return L of `ThreeBodyParameters` at positions q = (x, y) and velocities v in the rotating frame."""
    (x, y), (vx, vy), mu = q, v, parameters["mu"]
    first, second = (x + mu) ** 2 + y**2, (x - 1 + mu) ** 2 + y**2
    potential = -((1 - mu) * first + mu * second) / 2 - (1 - mu) / ca.sqrt(first) - mu / ca.sqrt(second)
    return (vx**2 + vy**2) / 2 + x * vy - y * vx - potential


def three_body_system(name: str, parameters: ThreeBodyParameters) -> System:
    """Return the restricted three-body problem as a system, for comparison with the tubes of celestial mechanics.

    The system has the equilibria L1, L2 and L3.

    Homoclinics are cut on y = 0, x < 0; connections between L1 and L2 on x = 1 - μ.

    Args:
        name: name of the system.
        parameters: mass ratio.
    """
    mu = parameters.mass_ratio
    hill_radius = (mu / 3) ** (1 / 3)
    return System.from_lagrangian(
        name,
        _lagrangian,
        coordinates=("x", "y"),
        parameters={"mu": mu},
        equilibria={"L1": (1 - mu - hill_radius, 0), "L2": (1 - mu + hill_radius, 0), "L3": (-1 - 5 * mu / 12, 0)},
        orientation=(0, 0, 0, 1),
        # Orbits about L1 and L2 are about a tenth of the primaries' distance in size.
        scale=(0.1,) * 4,
        energy_scale=0.1,
        sections={
            "opposite": Section.plane("y = 0, x < 0", (0, 1)).where((-1, 0)),
            "between": Section.plane("x = 1 - mu", (1, 0), offset=1 - mu),
        },
        between={
            ("L1", "L1"): "opposite",
            ("L2", "L2"): "opposite",
            ("L1", "L2"): "between",
            ("L2", "L1"): "between",
        },
        # Half a lap of the larger primary takes three periods. Beyond four, passages of the smaller one scatter the
        # tubes.
        flight_periods=4.0,
    )
