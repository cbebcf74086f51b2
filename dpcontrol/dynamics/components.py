"""Components of a plant in addition to arms, cart and drive.

They are casadi expressions. Four components of ordinary rigs are included.

A component adds terms to the Lagrangian and the Rayleigh function of the plant, and can have its own states. If smooth
equations are not enough, it has modes: numbers that are chosen at the beginning of a step and constant within it.

    belt      ẍ = ω² (x_m - x) + 2 ζ ω (ẋ_m - ẋ) + b,  ẍ_m: acceleration of the drive, b: gravity along the track

    play      e⁺ = min(max(e, φ - w/2), φ + w/2),  φ: angle of the joint, e: angle of its encoder, w: the play

    cable     torque T - k θ_1 on the inner arm

    stiction  A joint stays at rest while the holding torque is at most its break-away torque. A sliding joint is braked
              by its kinetic torque.


Sources: Karnopp, Computer simulation of stick-slip friction in mechanical dynamic systems (1985); Visintin,
Differential models of hysteresis (1994), section III.2, for the play operator.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from dpcontrol.dynamics.equations import solve_symmetric
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.shown import Brief


class Sizes(NamedTuple):
    """Numbers of a component's states, parameters and modes, by which its symbols are made.

    Attributes:
        states: number of own states, which follow the plant's.
        parameters: number of own parameters.
        modes: number of own modes, which are chosen at the beginning of a step and are inputs of the plant.
    """

    states: int = 0
    parameters: int = 0
    modes: int = 0


@dataclass(frozen=True, eq=False)
class ComponentFrame(Brief):
    """The symbols from which a component builds its expressions.

    Attributes:
        position, velocity: the arms' angles and the cart (n+1,).
        demand: acceleration of the drive, m/s².
        states, parameters, modes: the component's own.
    """

    position: ca.SX
    velocity: ca.SX
    demand: ca.SX
    states: ca.SX
    parameters: ca.SX
    modes: ca.SX

    @property
    def joints(self) -> ca.SX:
        """The joints' angles (n,)."""
        return ca.diff(ca.vertcat(0, self.position[:-1]))

    @property
    def joint_rates(self) -> ca.SX:
        """The joints' rates (n,)."""
        return ca.diff(ca.vertcat(0, self.velocity[:-1]))


class Terms(NamedTuple):
    """A component's part in the equations of motion; parts that it does not have are zero.

    Attributes:
        lagrangian: kinetic minus potential energy, J.
        dissipation: dissipation function, W.
        rates: time derivatives of the component's states.
        drive: acceleration that a component with a motor gives the cart, m/s².
    """

    lagrangian: ca.SX = ca.SX(0)
    dissipation: ca.SX = ca.SX(0)
    rates: ca.SX = ca.SX(0, 1)
    drive: ca.SX = ca.SX(0)


@dataclass(frozen=True)
class SymbolicPlant:
    """One component, built in or a user's.

    A frozen dataclass of numbers whose class methods give the equations.

    Plants whose components are of the same classes share one compiled step; `numbers` are its parameters. A class
    overrides what it needs; the defaults add nothing.
    """

    motor: ClassVar[bool] = False
    """True if the first two states are position and velocity of a motor, which the drive moves instead of the cart."""

    @classmethod
    def sizes(cls, arms: int) -> Sizes:
        """Return the numbers of states, parameters and modes.

        Args:
            arms: number n of arms.
        """
        return Sizes()

    @classmethod
    def terms(cls, frame: ComponentFrame) -> Terms:
        """Return the component's terms in the equations of motion.

        Args:
            frame: symbols of the plant, and the component's own.
        """
        return Terms()

    @classmethod
    def constrained(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Return the plant's accelerations (N,) with the constraints of the frame's modes, such as a joint at rest.

        Args:
            frame: symbols of the plant, and the component's own.
            mass: mass matrix (N, N) without this component.
            acceleration: accelerations (N,) without this component.
        """
        return acceleration

    @classmethod
    def chosen(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Return the modes with which a step begins, chosen from state and forces.

        Args:
            frame: symbols of the plant, and the component's own.
            mass: mass matrix (N, N) without this component.
            acceleration: accelerations (N,) without this component.
        """
        return frame.modes

    @classmethod
    def guards(cls, frame: ComponentFrame) -> ca.SX:
        """Return numbers that are negative once a step has left its modes, so that the bench splits the step there.

        Args:
            frame: symbols at the end of the step.
        """
        return ca.SX(0, 1)

    @classmethod
    def settled(cls, frame: ComponentFrame) -> tuple[ca.SX, ca.SX]:
        """Return velocities (n+1,) and own states, corrected at the end of a step, such as a stopped joint's rate.

        Args:
            frame: symbols at the end of the step.
        """
        return frame.velocity, frame.states

    def numbers(self) -> tuple[float, ...]:
        """Return the parameters: all fields, one after the other."""
        return tuple(float(value) for entry in fields(self) for value in np.atleast_1d(getattr(self, entry.name)))

    def start(self, state: Array) -> Array:
        """Return the first values of the component's states at the start of a run.

        Args:
            state: state (2n+2,) of arms and cart.
        """
        return np.zeros(0)

    def reads(self, arms: int) -> dict[int, int]:
        """Return the component's states that sensors read instead of joints and cart: {sensor: state}.

        Sensors 0 … n-1 are joints, n the cart.

        Args:
            arms: number n of arms.
        """
        return {}

    @property
    def longest_step(self) -> float:
        """The longest step, s, that keeps the error near round-off."""
        return math.inf


_SHARE_OF_BELT = 0.2
"""Step of a belt as a share of 1/ω."""


@dataclass(frozen=True)
class Belt(SymbolicPlant):
    """An elastic belt between motor and cart.

    The drive holds its motor against the belt's force.

    Attributes:
        frequency: frequency of the cart on it with the motor held, Hz.
        damping: damping ratio.
        motor_scale: True if the cart's scale is on the motor.
    """

    frequency: float
    damping: float
    motor_scale: bool
    motor: ClassVar[bool] = True

    @classmethod
    def sizes(cls, arms: int) -> Sizes:
        """Return the numbers of states (the motor's position and velocity) and parameters (stiffness and damping)."""
        return Sizes(states=2, parameters=2)

    @classmethod
    def terms(cls, frame: ComponentFrame) -> Terms:
        """Return the belt's pull on the cart as an acceleration, and the rates of the motor's position and velocity."""
        x, v, (stiffness, damping) = frame.position[-1], frame.velocity[-1], ca.vertsplit(frame.parameters)
        pull = stiffness * (frame.states[0] - x) + damping * (frame.states[1] - v)
        return Terms(rates=ca.vertcat(frame.states[1], frame.demand), drive=pull)

    def numbers(self) -> tuple[float, ...]:
        """Return the belt's stiffness ω², 1/s², and damping 2 ζ ω, 1/s, over the mass of the cart."""
        omega = 2 * math.pi * self.frequency
        return omega**2, 2 * self.damping * omega

    def start(self, state: Array) -> Array:
        """Return the cart's position and velocity, at which the motor starts with the belt relaxed."""
        return state[-2:].copy()

    def reads(self, arms: int) -> dict[int, int]:
        """Return the motor's position as the reading of the cart's scale, if the scale is on the motor."""
        return {arms: 0} if self.motor_scale else {}

    @property
    def longest_step(self) -> float:
        """The longest step, s, a share of 1/ω with the belt's angular frequency ω."""
        return _SHARE_OF_BELT / (2 * math.pi * self.frequency)


@dataclass(frozen=True)
class EncoderPlay(SymbolicPlant):
    """Play between each joint and its encoder, whose angle is a state of the plant.

    An encoder reverses only once the joint has crossed the play.

    Attributes:
        widths: widths of the play (n,), rad.
        offsets: offsets of the encoders from the middle of their play at the start (n,), rad.
    """

    widths: tuple[float, ...]
    offsets: tuple[float, ...]

    @classmethod
    def sizes(cls, arms: int) -> Sizes:
        """Return the numbers of states (the encoders' angles) and parameters (widths of the play)."""
        return Sizes(states=arms, parameters=arms)

    @classmethod
    def terms(cls, frame: ComponentFrame) -> Terms:
        """Return rates of zero for the encoders' angles, which only move at the end of a step."""
        return Terms(rates=ca.SX.zeros(frame.states.shape[0]))

    @classmethod
    def settled(cls, frame: ComponentFrame) -> tuple[ca.SX, ca.SX]:
        """Return unchanged velocities, and the encoders' angles (n,) moved along by their joints, the play operator."""
        # The play moves with its joint until it is at one of its ends.
        half = frame.parameters / 2
        return frame.velocity, ca.fmin(ca.fmax(frame.states, frame.joints - half), frame.joints + half)

    def numbers(self) -> tuple[float, ...]:
        """Return the widths of the play (n,), rad; the offsets are first states, no parameters."""
        return self.widths

    def start(self, state: Array) -> Array:
        """Return the encoders' first angles (n,), rad: those of the joints plus the offsets."""
        return np.diff(state[: len(self.widths)], prepend=0.0) + self.offsets

    def reads(self, arms: int) -> dict[int, int]:
        """Return the encoders' angles as the readings of all joints."""
        return {k: k for k in range(arms)}


@dataclass(frozen=True)
class Cable(SymbolicPlant):
    """A cable twisted by the inner arm.

    Attributes:
        torque: torque on the hanging arm, N m.
        stiffness: stiffness against turning, N m/rad.
    """

    torque: float
    stiffness: float

    @classmethod
    def sizes(cls, arms: int) -> Sizes:
        """Return the number of parameters (torque and stiffness); a cable has no states."""
        return Sizes(parameters=2)

    @classmethod
    def terms(cls, frame: ComponentFrame) -> Terms:
        """Return the cable's torque T - k θ_1 on the inner arm as a term of the Lagrangian."""
        (torque, stiffness), angle = ca.vertsplit(frame.parameters), frame.position[0]
        return Terms(lagrangian=torque * angle - stiffness * angle**2 / 2)


def _sign(values: ca.SX) -> ca.SX:
    """Return the signs -1, 0 or 1 of values (n,)."""
    return ca.if_else(values > 0, 1, 0) - ca.if_else(values < 0, 1, 0)


_STICTION_STEP = 5e-4
"""Longest step, s, because a joint breaks away only at the beginning of a step."""


@dataclass(frozen=True)
class Stiction(SymbolicPlant):
    """Dry friction in each joint.

    A mode is the sign of the rate at which a joint slides, 0 for a joint at rest.

    Attributes:
        breakaway: torques at rest (n,), N m.
        kinetic: torques while a joint slides (n,), N m.
    """

    breakaway: tuple[float, ...]
    kinetic: tuple[float, ...]

    @classmethod
    def sizes(cls, arms: int) -> Sizes:
        """Return the numbers of parameters (break-away and kinetic torques) and modes (one for each joint)."""
        return Sizes(parameters=2 * arms, modes=arms)

    @classmethod
    def _solved(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the accelerations (N,) with these modes, and the torques (n,), N m, that hold the joints at rest.

        A joint with mode 0 keeps its acceleration of zero. A sliding joint is braked by its kinetic torque, and its
        holding torque is zero. The bench compares holding torques with the break-away torques. `mass` (N, N) and
        `acceleration` (N,) are the plant's without dry friction.
        """
        joint_count, size = frame.modes.shape[0], mass.shape[0]
        # Rates are `sums` times the joints' rates; a cart that is free is the last of both.
        sums = ca.SX.eye(size)
        sums[:joint_count, :joint_count] = ca.DM(np.tril(np.ones((joint_count, joint_count))))
        inertia = sums.T @ mass @ sums
        torques = sums.T @ mass @ acceleration
        moving = ca.vertcat(frame.modes**2, ca.SX.ones(size - joint_count))
        torques[:joint_count] -= frame.parameters[joint_count:] * frame.modes
        # Rows and columns of resting joints become those of the identity, so their accelerations are zero.
        reduced_inertia = ca.diag(moving) @ inertia @ ca.diag(moving) + ca.diag(1 - moving)
        joint_accelerations = solve_symmetric(reduced_inertia, moving * torques)
        return sums @ joint_accelerations, ((inertia @ joint_accelerations - torques) * (1 - moving))[:joint_count]

    @classmethod
    def constrained(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Return the accelerations (N,) with joints of mode 0 at rest and the others braked.

        The plant without dry friction has this mass matrix (N, N) and acceleration (N,).
        """
        return cls._solved(frame, mass, acceleration)[0]

    @classmethod
    def chosen(cls, frame: ComponentFrame, mass: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Return each joint's mode: the sign of its rate, or of its motion after the holding torque was exceeded.

        The plant without dry friction has this mass matrix (N, N) and acceleration (N,).
        """
        n = frame.modes.shape[0]
        modes = _sign(frame.joint_rates)
        # A joint that breaks away changes the torques on the others: one after the other, the worst first.
        for _ in range(n):
            torques = cls._solved(replace(frame, modes=modes), mass, acceleration)[1]
            excess = ca.fabs(torques) - frame.parameters[:n]
            worst = reduce(ca.fmax, ca.vertsplit(excess), ca.SX(0))
            breaks = ca.logic_and(excess >= worst, excess > 0)
            modes = ca.if_else(breaks, -_sign(torques), modes)
        return modes

    @classmethod
    def guards(cls, frame: ComponentFrame) -> ca.SX:
        """Return each joint's rate in the direction of its mode, which is negative once the joint has reversed."""
        return frame.modes * frame.joint_rates

    @classmethod
    def settled(cls, frame: ComponentFrame) -> tuple[ca.SX, ca.SX]:
        """Return the velocities (n+1,) with stopped joints exactly at rest; there are no states."""
        rates: list[ca.SX] = []
        # A joint that sticks, or whose rate left the sign of its mode, turns with the arm before it, to the last bit.
        for k in range(frame.modes.shape[0]):
            inner_rate, outer_rate = rates[-1] if rates else ca.SX(0), frame.velocity[k]
            rates.append(ca.if_else(frame.modes[k] * frame.joint_rates[k] <= 0, inner_rate, outer_rate))
        return ca.vertcat(*rates, frame.velocity[-1]), frame.states

    @property
    def longest_step(self) -> float:
        """The longest step, s, which limits the delay of a joint's breaking away."""
        return _STICTION_STEP
