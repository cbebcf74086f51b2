"""First motions of a transfer, from which collocation starts: flights between its ends, or smooth turns of the arms.

Flights of several durations and first inputs are computed side by side. Those of a given time have the transfer's cost
∫ u² + w x². The shortest ones minimise the time, with a small weight of the effort. All are computed forwards from the
start, and backwards from the end: in reversed time, the friction of the arms gives energy. A search that ends upright
converges more easily than one that leaves an upright start.

A smooth motion turns each arm along a cubic that ignores the rates at both ends. From it, direct collocation found 35
of 36 swing-ups and landings tried; with those rates it found 30, with half the margin. Gentle transfers start from
smooth motions, because those from flights need 1.5 times their effort.

Numbers are those of the laboratory's arms. Other arms are scaled to their natural time and weight (`Scale`), so that
arms of any size get the same motions.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from dpcontrol.control.flight import STEPS, FlightPlanner, Target
from dpcontrol.control.interface import SampledModel, whole_turns
from dpcontrol.control.tracking import TvlqrSettings, terminal_cost
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.references.find import smooth_guess
from dpcontrol.references.method import Method, method_named
from dpcontrol.references.problem import NATURAL_TIME, Limits
from dpcontrol.references.trajectory import Trajectory, even_mesh, times_on

CART_WEIGHT = 100.0
"""Weight w of the cart's squared distance from the middle, beside u², 1/s⁴."""
_PUSHES = ((0.0, 0.0, 0.0), (2.5, 0.5, 0.0), (2.5, 1.0, 0.0), (5.0, 1.6, 0.25), (5.0, 2.0, 0.25))
"""First inputs: amplitude, m/s², swings per natural time, and phase in turns.

Of 43 inputs, these led to the best flights between the equilibria of the laboratory's arms."""
PERIOD = 5e-3
"""Period of the feedback at the ends, s."""
_INTERVAL = 0.1
"""Length of the intervals of a first motion's mesh, s."""
_NEAR = 0.5
"""Distance of a flight's last angles from the end that it leads to, rad."""
_TRIED = 4
"""Number of flights from which collocation starts."""


def coarse(arms: int) -> Method:
    """Return the collocation method of first motions, a finer one for three arms, which swing faster.

    Args:
        arms: number of arms.
    """
    return method_named("radau-3" if arms < 3 else "radau-5")


@lru_cache(maxsize=2)
def shared_model(equations: Equations) -> SampledModel:
    """Return a sampled model that serves all arms of these equations, so that it is compiled once.

    Args:
        equations: equations with a cart.
    """
    return SampledModel(equations, np.ones(equations.parameters.numel()), period=PERIOD)


@dataclass(frozen=True)
class Way:
    """Two states (N,) that flights connect, forwards or backwards in time.

    Attributes:
        arms: the arms.
        limits: limits of the cart, at which the feedback that keeps the end saturates.
        room: limits that the flights keep, a share of those.
        start, end: first and last state.
        backwards: True to compute flights from the end, in reversed time.
    """

    arms: ArmChainParameters
    limits: Limits
    room: Limits
    start: Array
    end: Array
    backwards: bool

    @property
    def parameters(self) -> Array:
        """Base parameters (p,) in this direction of time."""
        base, n = self.arms.base(), self.arms.count
        if self.backwards:
            # In reversed time the arms' friction has the other sign.
            base[n * (n + 1) // 2 + 2 * n : len(base) - bool(self.arms.friction)] *= -1
        return base

    @property
    def mirror(self) -> Array:
        """Signs (N,) of a state in this direction of time."""
        n = self.arms.count
        return np.array([1.0] * n + [-1.0] * n + [1.0, -1.0]) if self.backwards else np.ones(2 * n + 2)

    def target(self) -> Target:
        """Return the goal of flights in this direction of time, with the cost-to-go of a feedback that keeps it.

        The cost-to-go is scaled to 1 at the states in which this feedback begins to saturate.

        Raises:
            GoalMissed: it cannot be stabilised.
        """
        goal = self.mirror * (self.start if self.backwards else self.end)
        model = shared_model(equations_of(self.arms, Level.CART))
        # Matrices of one step, x⁺ = a x + b u, at the goal.
        a, b = (matrices[0] for matrices in model.linearised(goal[None], np.zeros(1), parameters=self.parameters))
        diagonal, effort = TvlqrSettings().weights(self.arms.count, PERIOD)
        cost = terminal_cost(a, b, weights=np.diag(diagonal), effort=effort)
        gain = b @ cost @ a / (effort + b @ cost @ b)
        # Least cost-to-go x'Px of the states with |gain · x| at the limit of the acceleration.
        saturation_cost = self.limits.acceleration**2 / (gain @ np.linalg.solve(cost, gain))
        return Target(goal[None], cost[None] / saturation_cost)

    def flights(self, durations: Array, *, fixed: bool) -> Iterator[Trajectory]:
        """Yield flights that reach the other end, as motions on a coarse mesh.

        A flight is an optimal motion of arms and cart whose inputs are constant in `STEPS` steps. It is sought from
        each of the first inputs `_PUSHES`, sines of the cart's acceleration, for each first duration.

        Args:
            durations: first durations (D,), s.
            fixed: True to keep these durations, with the least effort; otherwise time counts.
        """
        method = coarse(self.arms.count)
        natural_times = np.linspace(0.0, 1.0, STEPS, endpoint=False)[:, None, None] * durations[:, None] / NATURAL_TIME
        amplitudes, rates, phases = np.array(_PUSHES).T
        inputs = (amplitudes * np.sin(2 * np.pi * (rates * natural_times + phases))).reshape(STEPS, -1)
        planner = FlightPlanner(self.arms, self.limits).with_parameters(self.parameters)
        planner = planner.with_room(self.room, centring=CART_WEIGHT if fixed else 0.0)
        first_state = self.mirror * (self.end if self.backwards else self.start)
        flights = planner.timed(first_state, self.target(), np.repeat(durations, len(_PUSHES)), inputs, fixed=fixed)
        flights = flights.picked(flights.reached)
        for nodes, input_steps, duration in zip(flights.nodes, flights.inputs, flights.durations, strict=True):
            mesh = even_mesh(duration, _INTERVAL)
            times, command_times = times_on(mesh, method.support), times_on(mesh, method.points)
            flight_times = (duration - times if self.backwards else times).clip(0.0, duration)
            states = (
                planner.states(nodes, input_steps, duration, flight_times.ravel())[0].reshape(*times.shape, -1)
                * self.mirror
            )
            # The steps of the inputs approximate a smooth input at their middles.
            step_middles = (np.arange(STEPS) + 0.5) * duration / STEPS
            commands = np.interp(command_times, step_middles, input_steps[::-1] if self.backwards else input_steps)[
                ..., None
            ]
            n = self.arms.count
            states[..., :n] -= whole_turns(states[0, 0, :n] - self.start[:n])
            yield Trajectory(method, mesh, states, commands)


def _leads_to(flight: Trajectory, end: Array) -> bool:
    """Return True if a flight's last angles are near those of a state (N,), whole turns included."""
    n = len(end) // 2 - 1
    return bool(np.abs(flight.states[-1, -1, :n] - end[:n]).max() < _NEAR)


def flights_between(
    ways: Sequence[Way], ends: Sequence[Array], durations: Array, *, fixed: bool
) -> list[tuple[Trajectory, Array]]:
    """Return first motions of a transfer from flights: the shortest ones, or in given times those of the least effort.

    Args:
        ways: both directions of time.
        ends: possible states (N,) at the end.
        durations: first durations (D,), s.
        fixed: True to keep these durations.

    Returns:
        At most four flights, each with the end (N,) that it leads to.
    """
    flights: list[Trajectory] = []
    for way in ways:
        # An end that cannot be stabilised is no target.
        with suppress(GoalMissed):
            flights += way.flights(durations, fixed=fixed)
    flights.sort(key=lambda flight: flight.effort if fixed else flight.duration)
    return [(flight, end) for flight in flights for end in ends if _leads_to(flight, end)][:_TRIED]


def smooth_motions(start: Array, ends: Sequence[Array], durations: Array) -> list[tuple[Trajectory, Array]]:
    """Return first motions of a transfer that turn the arms smoothly, for all durations and ends.

    Args:
        start: state (N,) at the start.
        ends: possible states (N,) at the end.
        durations: durations, s.

    Returns:
        Motions, each with the end (N,) that it leads to.
    """
    method, motions = coarse(len(start) // 2 - 1), list[tuple[Trajectory, Array]]()
    for duration, end in product(durations, ends):
        mesh = even_mesh(duration, _INTERVAL)
        times = times_on(mesh, method.support)
        states = np.zeros((*times.shape, len(end)))
        states[..., :-2] = smooth_guess(start[:-2], end[:-2], duration)(times.ravel()).reshape(*times.shape, -1)
        states[..., -2] = start[-2] + (end[-2] - start[-2]) * times / duration
        motions.append((Trajectory(method, mesh, states, np.zeros((len(mesh) - 1, len(method.points), 1))), end))
    return motions
