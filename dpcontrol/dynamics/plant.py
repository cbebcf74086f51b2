"""Plant: arms on a cart with a drive.

The drive is ideal, lagging, or has a finite force.

    cart:   ẍ = u
    drive:  ẍ = a,  ȧ = (u - a)/τ                    a velocity loop: a = (w - ẋ)/τ on its reference ẇ = u
    force:  d/dt ∂L/∂ẋ + k_c ẋ = F + M b,  F = M a,  ȧ = (u - ẍ)/τ             the arms push the cart about

M: mass of cart and arms together. With a heavy cart, `force` becomes `drive`. With a fast loop, `drive` becomes `cart`.
A tilted track adds gravity b along the track, m/s², with the Lagrangian's further term b (Σ S_i sin θ_i + M x). Angles
are then still measured from the track's normal.

Components add to this at every level (`dpcontrol.dynamics.components`). A component with a motor stands between drive
and cart. The drive then moves the motor, ẍ_m = u or a. The component accelerates the cart, at level force by its force.

Source: Åström & Murray, Feedback Systems (2008), section 2.2 and example 2.1 (balance systems).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from types import SimpleNamespace
from typing import Annotated

import casadi as ca
import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, Friction, Level, arm_chain_equations, chain_energies
from dpcontrol.dynamics.compiled import Compiled, check_operations, compiled_step, fixed_step
from dpcontrol.dynamics.components import ComponentFrame, SymbolicPlant, Terms
from dpcontrol.dynamics.equations import Equations, Mechanics, mechanics, solve_symmetric
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Setting, Settings

_SMOOTH_STEP = 2e-3
"""Longest step with an error of the arms' motion below 1e-12, s."""
_SHARE_OF_LAG = 0.25
_COULOMB_STEP = 2.5e-4


Kinds = tuple[type[SymbolicPlant], ...]


class PlantLevel(StrEnum):
    """Response of the cart to a commanded acceleration, see the head of this module."""

    CART = "cart"
    DRIVE = "drive"
    FORCE = "force"


@dataclass(frozen=True)
class PlantParameters(Settings):
    """The arms with their cart and drive, as a simulated bench has them.

    Attributes:
        lag: time constant of the drive's velocity loop, s, 0 for an ideal drive.
        cart_mass: without the arms, kg, 0 for a cart that the arms cannot move.
        cart_viscous: friction of the cart, N s/m.
        tilt: tilt of the track, rad, positive with the right end down.
        components: in the order of their states.

    Gravity acts along a tilted track by g sin(tilt), and across it by g cos(tilt).
    """

    arms: ArmChainParameters
    lag: Annotated[float, Setting(least=1e-5, most=1, zero="a drive that follows at once", unit="s")] = 0.0
    cart_mass: Annotated[float, Setting(least=0, most=1e6, unit="kg")] = 0.0
    cart_viscous: Annotated[float, Setting(least=0, most=1e6, unit="N s/m")] = 0.0
    tilt: Annotated[float, Setting(least=-np.pi / 4, most=np.pi / 4, unit="rad")] = 0.0
    components: tuple[SymbolicPlant, ...] = ()

    def _check_together(self) -> None:
        """Raise an InputError for a cart with mass but without lag, or with friction but without mass."""
        if self.cart_mass > 0 and self.lag == 0:
            raise InputError(
                f"cart_mass = {self.cart_mass!r} with lag = 0: a cart with mass needs a velocity loop with a time "
                f"constant; give a lag, such as 0.002 s, or no mass"
            )
        if self.cart_viscous > 0 and self.cart_mass == 0:
            raise InputError(
                f"cart_viscous = {self.cart_viscous!r} with cart_mass = 0: friction needs a cart with mass; give one"
            )

    @property
    def level(self) -> PlantLevel:
        """Lowest level that supports these parameters."""
        return PlantLevel.FORCE if self.cart_mass else PlantLevel.DRIVE if self.lag else PlantLevel.CART

    @property
    def equations(self) -> Equations:
        """Equations with the parameters `numbers`."""
        return plant_equations(self.arms.count, self.level, friction=self.arms.friction, components=self.kinds)

    @property
    def kinds(self) -> Kinds:
        """The classes of the components, which select the compiled equations."""
        return tuple(type(component) for component in self.components)

    @property
    def plain_size(self) -> int:
        """Length of the state without the components' states, which follow it."""
        return 2 * self.arms.count + 2 + (self.level is not PlantLevel.CART)

    @property
    def places(self) -> list[tuple[SymbolicPlant, int]]:
        """The components, each with the index of its first state in the plant's state."""
        sizes = [component.sizes(self.arms.count).states for component in self.components]
        return [(component, self.plain_size + sum(sizes[:k])) for k, component in enumerate(self.components)]

    @property
    def motor(self) -> int:
        """Index in the state of the position that the drive moves: the cart, or a component's motor."""
        return next((place for component, place in self.places if component.motor), 2 * self.arms.count)

    @property
    def reads(self) -> dict[int, int]:
        """Indices in the state of the quantities that sensors read instead of joints and cart: {sensor: index}.

        Sensors 0 … n-1 are the joints' encoders, and n is the cart's scale.
        """
        count = self.arms.count
        return {k: place + offset for component, place in self.places for k, offset in component.reads(count).items()}

    def own_states(self, state: Array) -> Array:
        """Return the components' first states, which follow the plain state at the start of a run.

        Args:
            state: state (2n+2,) of arms and cart.
        """
        return np.concatenate([np.zeros(0), *(component.start(state) for component in self.components)])

    def numbers(self) -> Array:
        """Return the parameters (p,) of `equations`.

        Base parameters and the pull b of gravity along the track, m/s². Then, where they occur, the drive's lag τ, s,
        the mass M of cart and arms, kg, and the cart's friction k_c, N s/m. The components' numbers follow.
        """
        upright = replace(self.arms, gravity=self.arms.gravity * float(np.cos(self.tilt)))
        further = [self.arms.gravity * np.sin(self.tilt)]
        if self.level is not PlantLevel.CART:
            further.append(self.lag)
        if self.level is PlantLevel.FORCE:
            further += [self.cart_mass + sum(self.arms.mass), self.cart_viscous]
        further += [number for component in self.components for number in component.numbers()]
        return np.concatenate([upright.base(), further])


@cache
def _symbols() -> SimpleNamespace:
    """Return the symbols u (command), b (pull), τ (lag), M (mass), k_c (drag) and F (force), shared by all levels."""
    return SimpleNamespace(**{name: ca.SX.sym(name) for name in ("command", "pull", "lag", "mass", "drag", "force")})


@cache
def _component_frames(count: int, components: Kinds) -> tuple[ComponentFrame, ...]:
    """Return a frame for each component with the symbols of its states, parameters and modes.

    Modes are numbers that are chosen at the beginning of a step, such as the sign of a joint's sliding. Arms and cart
    are missing in these frames; callers put theirs in. The symbols are the same at each call, so that expressions of
    different functions can be combined. `count` is the number of arms, and `components` are the classes of the
    components.
    """
    no_symbols, frames = ca.SX(0, 1), []
    for place, component in enumerate(components):
        symbols = (
            ca.SX.sym(f"{component.__name__}_{place}_{part}", size) for part, size in enumerate(component.sizes(count))
        )
        frames.append(ComponentFrame(no_symbols, no_symbols, ca.SX.sym("demand"), *symbols))
    return tuple(frames)


def _terms(q: ca.SX, v: ca.SX, components: Kinds) -> list[Terms]:
    """Return each component's terms at the positions q and velocities v (n+1,) of arms and cart.

    `components` are the components' classes.
    """
    frames = _component_frames(q.shape[0] - 1, components)
    return [
        component.terms(replace(frame, position=q, velocity=v))
        for component, frame in zip(components, frames, strict=True)
    ]


@cache
def _parts(count: int, friction: tuple[Friction, ...], *, free_cart: bool, components: Kinds = ()) -> Mechanics:
    """Return the mechanics of arms on a tilted track, their components included.

    With `free_cart`, the cart is the last free coordinate, driven by the force F. Otherwise its acceleration is
    prescribed. `count` is the number of arms, `friction` their laws of friction in addition to the viscous one.
    """
    n, chain, s = count, chain_energies(count, friction=friction), _symbols()

    def lagrangian(q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
        """Return the chain's Lagrangian plus gravity along the track, the components and a free cart's own terms."""
        total = chain.lagrangian(q, v, p) + s.pull * ca.dot(chain.coupling, ca.sin(q[:n]))
        total += sum((term.lagrangian for term in _terms(q, v, components)), ca.SX(0))
        # The chain's Lagrangian includes a cart of 1 kg.
        return total + (s.mass - 1) * v[n] ** 2 / 2 + (s.force + s.mass * s.pull) * q[n] if free_cart else total

    def dissipation(q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
        """Return the chain's dissipation function, plus those of the components and of a free cart's friction."""
        total = chain.dissipation(q, v, p) + (s.drag * v[n] ** 2 / 2 if free_cart else 0)
        return total + sum((term.dissipation for term in _terms(q, v, components)), ca.SX(0))

    free, prescribed = (n + 1, 0) if free_cart else (n, 1)
    return mechanics(lagrangian, dissipation, free=free, prescribed=prescribed, parameters=chain.parameters)


def _parameters(count: int, level: PlantLevel, friction: tuple[Friction, ...], components: Kinds = ()) -> ca.SX:
    """Return the symbols (p,) of a level's parameters, in the order of `PlantParameters.numbers`.

    `count` is the number of arms, `friction` their laws of friction, and `components` the components' classes.
    """
    s = _symbols()
    further = {PlantLevel.CART: [s.pull], PlantLevel.DRIVE: [s.pull, s.lag],
               PlantLevel.FORCE: [s.pull, s.lag, s.mass, s.drag]}  # fmt: skip
    component_parameters = [frame.parameters for frame in _component_frames(count, components)]
    return ca.vertcat(chain_energies(count, friction=friction).parameters, *further[level], *component_parameters)


def _state(q: ca.SX, v: ca.SX, demand: ca.SX, level: PlantLevel) -> ca.SX:
    """Return the plain state of a level: angles, rates, cart position and velocity, then a unless the level is cart.

    q and v (n+1,) are positions and velocities of arms and cart, and `demand` is a.
    """
    n = q.shape[0] - 1
    cart = ca.vertcat(q[:n], v[:n], q[n], v[n])
    return cart if level is PlantLevel.CART else ca.vertcat(cart, demand)


@dataclass(frozen=True, eq=False)
class _EquationsOfMotion:
    """The motion of a plant, symbolically, from which its equations, its step and its modes are made.

    Attributes:
        parts: mechanics of arms and cart.
        demand: symbol of the acceleration a that the drive's velocity loop demands, m/s².
        frames: frames of the components.
        moving: accelerations of arms and cart (n+1,).
        drive: acceleration of the cart or, if a component has a motor, of the motor.
        modes: modes that the components choose at the beginning of a step.
        rates: derivatives of the components' states.
    """

    parts: Mechanics
    demand: ca.SX
    frames: tuple[ComponentFrame, ...]
    moving: ca.SX
    drive: ca.SX
    modes: ca.SX
    rates: ca.SX

    def state(self, velocity: ca.SX, level: PlantLevel, component_states: Sequence[ca.SX]) -> ca.SX:
        """Return the plant's state with the components' states, for these velocities (n+1,) of arms and cart."""
        return ca.vertcat(_state(self.parts.position, velocity, self.demand, level), *component_states)


@cache
def _motion(count: int, level: PlantLevel, friction: tuple[Friction, ...], components: Kinds) -> _EquationsOfMotion:
    """Return the motion of arms, cart, drive and components at a level.

    A component with a motor stands between drive and cart and gives the cart its acceleration. Modes are numbers that
    components choose at the beginning of a step, such as the sign of a joint's sliding. `count` is the number of arms,
    `friction` their laws of friction in addition to the viscous one, and `components` are the components' classes.
    """
    symbols, free_cart, a = _symbols(), level is PlantLevel.FORCE, ca.SX.sym("a")
    parts = _parts(count, friction, free_cart=free_cart, components=components)
    q, v, demand = parts.position, parts.velocity, symbols.command if level is PlantLevel.CART else a
    frames = tuple(
        replace(component, position=q, velocity=v, demand=demand) for component in _component_frames(count, components)
    )
    terms = [component.terms(frame) for component, frame in zip(components, frames, strict=True)]
    motor_drives = [term.drive for component, term in zip(components, terms, strict=True) if component.motor]
    driven_acceleration = motor_drives[0] if motor_drives else demand
    if free_cart:
        # The drive's force F is M a.
        moving = ca.substitute(parts.free_acceleration, symbols.force, symbols.mass * driven_acceleration)
    else:
        # On a motor's belt, gravity pulls the cart along the track; an ideal drive holds it.
        driven_acceleration = driven_acceleration + symbols.pull if motor_drives else driven_acceleration
        moving = ca.substitute(parts.free_acceleration, parts.acceleration, driven_acceleration)
    modes, earlier_modes = ca.SX(0, 1), ca.SX(0, 1)
    for component, frame in zip(components, frames, strict=True):
        chosen_modes = component.chosen(frame, parts.mass_matrix, moving)
        # A component chooses with the modes that earlier ones have just chosen, not with those of the step before.
        modes, earlier_modes = (
            ca.vertcat(modes, ca.substitute(chosen_modes, earlier_modes, modes)),
            ca.vertcat(earlier_modes, frame.modes),
        )
        moving = component.constrained(frame, parts.mass_matrix, moving)
    if not free_cart:
        moving = ca.vertcat(moving, driven_acceleration)
    # The velocity loop belongs to the motor if there is one.
    loop_acceleration = demand if motor_drives else moving[count]
    return _EquationsOfMotion(
        parts, a, frames, moving, loop_acceleration, modes, ca.vertcat(*(term.rates for term in terms))
    )


@cache
def plant_equations(
    count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = (), components: Kinds = ()
) -> Equations:
    """Return the equations of arms on the bench at a level.

    State: angles, rates, cart position and velocity, then (levels drive and force) a, the acceleration that the
    drive's velocity loop demands, then the components' states. Inputs: the commanded acceleration u, then the
    components' modes. Parameters as `PlantParameters.numbers`.

    Args:
        count: number n of arms.
        level: cart, drive or force.
        friction: laws in addition to the viscous one.
        components: classes of the components, in the order of their states.
    """
    n, s, motion = count, _symbols(), _motion(count, level, friction, components)
    v, moving = motion.parts.velocity, motion.moving
    rate = ca.vertcat(v[:n], moving[:n], v[n], moving[n])
    if level is not PlantLevel.CART:
        rate = ca.vertcat(rate, (s.command - motion.drive) / s.lag)
    state = motion.state(v, level, [frame.states for frame in motion.frames])
    arms = arm_chain_equations(count, Level.CART, friction=friction)
    energies = [arms.hamiltonian, arms.momentum, arms.mass_matrix]
    hamiltonian, momentum, mass = ca.substitute(energies, [arms.state], [state[: 2 * n + 2]])
    inputs = ca.vertcat(s.command, *(frame.modes for frame in motion.frames))
    parameters, rate = _parameters(count, level, friction, components), ca.cse(ca.vertcat(rate, motion.rates))
    return Equations(state, inputs, parameters, rate, hamiltonian, momentum, mass)


def check_component(component: SymbolicPlant, arms: int) -> None:
    """Reject a user's component whose expressions do not fit so many arms, before a run uses it.

    Args:
        component: the user's component.
        arms: number of arms.

    Raises:
        InputError: the error in its expressions.
    """
    name = type(component).__name__
    try:
        sizes = component.sizes(arms)
        equations = plant_equations(arms, PlantLevel.CART, components=(type(component),))
        check_operations(equations.function())
        start, numbers = np.array(component.start(np.zeros(2 * arms + 2)), dtype=float), component.numbers()
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"plant = {name}: {type(error).__name__}: {text}") from error
    rates = equations.rate.shape[0] - 2 * arms - 2
    lengths = len(start), len(numbers)
    if lengths != sizes[:2] or rates != sizes.states:
        raise InputError(
            f"plant = {name}: sizes({arms}) gives {sizes.states} states and {sizes.parameters} parameters, but start "
            f"has {lengths[0]}, terms has {rates} rates, and numbers has {lengths[1]}"
        )
    for method, values in (("start", start), ("numbers", numbers)):
        if not np.isfinite(values).all():
            raise InputError(f"plant = {name}: {method}() gives {values}: all must be finite numbers")


@cache
def blow(count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = ()) -> ca.Function:
    """Return a function for the state after an instantaneous blow to arms or cart.

    It maps (state, impulses (n,), jumps (n,), knock, parameters) to the state.

    Units: impulses N m s, of a couple on each arm. jumps rad/s, of the arms' rates. knock m/s, a jump of the cart's
    velocity at constant momenta of the arms. The drive's loop reacts to the change.

    Args:
        count: number n of arms.
        level: cart, drive or force.
        friction: laws in addition to the viscous one.
    """
    n, symbols = count, _symbols()
    parts = _parts(count, friction, free_cart=False)
    q, v = parts.position, parts.velocity
    impulses, jumps, knock, a = ca.SX.sym("p", n), ca.SX.sym("j", n), ca.SX.sym("k"), ca.SX.sym("a")
    if level is PlantLevel.FORCE:
        free_parts = _parts(count, friction, free_cart=True)
        mass = ca.substitute(
            free_parts.mass_matrix, ca.vertcat(free_parts.position, free_parts.velocity), ca.vertcat(q, v)
        )
        changes = solve_symmetric(mass, ca.vertcat(impulses, 0))
    else:
        changes = ca.vertcat(solve_symmetric(parts.mass_matrix, impulses), 0)
    # The cart's velocity jumps with momentum (level force) and with the knock.
    cart = changes[n] + knock
    rates = v[:n] + changes[:n] + jumps + ca.jacobian(parts.free_acceleration, parts.acceleration) * knock
    next_state = ca.vertcat(q[:n], rates, q[n], v[n] + cart)
    if level is not PlantLevel.CART:
        # The loop demands a = (w - ẋ)/τ, so it reacts to a jump of ẋ.
        next_state = ca.vertcat(next_state, a - cart / symbols.lag)
    parameters = _parameters(count, level, friction)
    inputs = [_state(q, v, a, level), impulses, jumps, knock, parameters]
    names = ["state", "impulses", "jumps", "knock", "parameters"]
    return ca.Function("blow", inputs, [ca.cse(ca.densify(next_state))], names, ["after"])


@cache
def plant_step(
    count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = (), components: Kinds = ()
) -> Compiled:
    """Return `fixed_step` of `plant_equations` as machine code.

    The code is built once per process.

    With components, they settle the next state, as stiction stops a joint. Their guards follow it in the output. A
    negative one tells the simulated bench that a mode, such as the sign of a joint's sliding, ended within the step.

    Args:
        count: number n of arms.
        level: cart, drive or force.
        friction: laws in addition to the viscous one.
        components: classes of the components, in the order of their states.
    """
    equations = plant_equations(count, level, friction=friction, components=components)
    if not components:
        return compiled_step(equations)
    motion = _motion(count, level, friction, components)
    velocity, component_states, guards = motion.parts.velocity, [], []
    for component, frame in zip(components, motion.frames, strict=True):
        end_frame = replace(frame, velocity=velocity)
        guards.append(component.guards(end_frame))
        velocity, states = component.settled(end_frame)
        component_states.append(states)
    arguments = [equations.state, equations.inputs, equations.parameters]
    settled = ca.Function("settled", arguments, [ca.vertcat(motion.state(velocity, level, component_states), *guards)])
    step = fixed_step(equations)
    x, u, h, p = symbols = step.sx_in()
    following = settled(step(x, u, h, p), u, p)
    return Compiled(ca.Function("settled_step", symbols, [ca.cse(ca.densify(following))], _INPUTS, ["following"]))


_INPUTS = ["state", "inputs", "duration", "parameters"]


@cache
def plant_modes(
    count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = (), components: Kinds = ()
) -> Compiled | None:
    """Return the compiled function that chooses the components' modes at the beginning of a step.

    A mode is a number that is constant during a step, such as the sign of a joint's sliding. The inputs of the function
    are those of `plant_step`: state, inputs, duration and parameters. The result is None if the components have no
    modes.

    Args:
        count: number n of arms.
        level: cart, drive or force.
        friction: laws in addition to the viscous one.
        components: classes of the components, in the order of their states.
    """
    modes = _motion(count, level, friction, components).modes
    if modes.is_empty():
        return None
    equations = plant_equations(count, level, friction=friction, components=components)
    arguments = [equations.state, equations.inputs, ca.SX.sym("h"), equations.parameters]
    return Compiled(ca.Function("plant_modes", arguments, [ca.cse(ca.densify(modes))], _INPUTS, ["modes"]))


def longest_step(plant: PlantParameters) -> float:
    """Return the longest single step of `plant_step`, s.

    Its error is near round-off (1e-11 at usual states).

    Coulomb friction reverses within a fraction of a millisecond when a joint's rate changes its sign. The error is then
    1e-10 for slow arms, and 1e-7 for arms struck by 2000 rad/s².

    Args:
        plant: parameters with lag, friction and components.
    """
    longest = min(_SMOOTH_STEP, _SHARE_OF_LAG * plant.lag if plant.lag else math.inf)
    longest = min((longest, *(component.longest_step for component in plant.components)))
    return min(longest, _COULOMB_STEP) if Friction.COULOMB in plant.arms.friction else longest


def cart_force(arms: ArmChainParameters, state: Array, acceleration: float, *, mass: float, drag: float) -> float:
    """Return the force that gives the cart an acceleration, N.

        F = (M + Σ m_i) ẍ + Σ S_i (cos θ_i ω̇_i - sin θ_i ω_i²) + k_c ẋ

    Args:
        arms: parameters of the arms.
        state: state (2n+2,) of arms and cart.
        acceleration: acceleration of the cart, m/s².
        mass: mass M of the cart without the arms, kg.
        drag: friction k_c of the cart, N s/m.
    """
    n = arms.count
    rate = _arms_rate(n, arms.friction)(state, acceleration, arms.base())
    angles, rates, accelerations = state[:n], state[n : 2 * n], np.asarray(rate, dtype=float).ravel()[n : 2 * n]
    pushes = arms.torques / arms.gravity * (np.cos(angles) * accelerations - np.sin(angles) * rates**2)
    return float((mass + sum(arms.mass)) * acceleration + pushes.sum() + drag * state[-1])


@cache
def _arms_rate(count: int, friction: tuple[Friction, ...]) -> ca.Function:
    """Return the function (state, cart's acceleration, base parameters) -> rate (2n+2,) of arms on a driven cart."""
    return arm_chain_equations(count, Level.CART, friction=friction).function()


def after_blow(
    plant: PlantParameters, state: Array, *, impulses: Array | None = None, jumps: Array | None = None, knock: float = 0
) -> Array:
    """Return the state (N,) of a plant after a blow that a simulated bench gives to arms or cart.

    Args:
        plant: parameters of the plant.
        state: state (N,) before the blow.
        impulses: impulses (n,) of a couple on each arm, N m s, or None for zero.
        jumps: jumps (n,) of the arms' rates, rad/s, or None for zero.
        knock: jump of the cart's velocity, m/s.
    """
    n, size = plant.arms.count, plant.plain_size
    function = blow(n, plant.level, friction=plant.arms.friction)
    no_change, numbers = np.zeros(n), plant.numbers()
    plain_numbers = numbers[: len(numbers) - sum(len(component.numbers()) for component in plant.components)]
    plain_after = function(state[:size], no_change if impulses is None else impulses,
                           no_change if jumps is None else jumps, knock, plain_numbers)  # fmt: skip
    next_state = np.concatenate([np.asarray(plain_after, dtype=float).ravel(), state[size:]])
    if plant.motor >= size:
        # The motor's loop does not react to blows on the cart.
        next_state[2 * n + 2 : size] = state[2 * n + 2 : size]
    return next_state
