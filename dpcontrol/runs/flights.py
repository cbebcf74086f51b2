"""A flight from any state of a model or a plan to a named target."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from dpcontrol.control.flight import REACHED, Flight, FlightPlanner, Target
from dpcontrol.control.interface import sampled_model, with_dry_friction
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, pendulum_system
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import FlightCause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import check_choice
from dpcontrol.loop.targets import PHASES, hold_target, orbit_target
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibria
from dpcontrol.plans.plan import Plan
from dpcontrol.references.problem import Limits
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.runs.run import assembled

RATE = 1000.0
"""Rate of the law that holds an equilibrium, Hz."""
_LONGER = 2.0
"""Factor on a limit that is tried if no flight is found."""


def plan_flight(
    arms: ArmChainParameters, state: ArrayLike, target: str | LyapunovOrbit | SustainedOrbit | Plan, limits: Limits
) -> Flight:
    """Return a flight from a state to a target; a failed one has the wider limit that would allow it as its remedy.

    Args:
        arms: the arms.
        state: state (N,), or (N-2,) of the arms alone with the cart at rest in the middle.
        target: name of an equilibrium, an orbit, or a plan, to whose first stop the flight leads.
        limits: limits of the cart.

    Raises:
        InputError: the state has another length or is not finite, or there is no such equilibrium.
        GoalMissed: the target cannot be held.
    """
    size, state = 2 * arms.count + 2, np.asarray(state, dtype=float)
    if state.shape == (size - 2,):
        state = np.append(state, (0.0, 0.0))
    if state.shape != (size,) or not np.isfinite(state).all():
        raise InputError(f"state: must be {size} finite numbers: angles, rates, and position and velocity of the cart")
    if max(abs(state[-2]) / limits.position, abs(state[-1]) / limits.velocity) > 1:
        raise InputError(
            f"state: the cart is at {state[-2]:g} m with {state[-1]:g} m/s: must be within ±{limits.position:g} m and "
            f"±{limits.velocity:g} m/s; give wider limits"
        )
    flight = _flight(arms, state, target, limits)
    for name in ("position", "acceleration") if not flight.converged else ():
        wider_limits = replace(limits, **{name: _LONGER * getattr(limits, name)})
        if _flight(arms, state, target, wider_limits).converged:
            return replace(flight, remedy=(name, getattr(wider_limits, name)))
    return flight


@lru_cache(maxsize=4)
def _planner(arms: ArmChainParameters, limits: Limits) -> FlightPlanner:
    """Return the planner of flights for arms and limits, compiled once."""
    return FlightPlanner(with_dry_friction(arms, RATE), limits)


def _flight(
    arms: ArmChainParameters, state: Array, target: str | LyapunovOrbit | SustainedOrbit | Plan, limits: Limits
) -> Flight:
    """Return the best flight from a state (N,) to a target within limits, with the cause of success or failure.

    A flight whose end is near enough to the target (`REACHED`) but that is not valid leaves the limits.
    """
    name, places = _places(arms, target, limits)
    planner = _planner(arms, limits)
    flights = planner.plan(state[None], places)
    cost = float(flights.costs[0])
    miss = FlightCause.OUTSIDE if cost < REACHED else FlightCause.MISSED
    cause = FlightCause.REACHED if flights.reached[0] else miss
    return Flight(name, float(flights.durations[0]), cost, flights.inputs[0], flights.nodes[0], cause, limits, planner)


def _places(
    arms: ArmChainParameters, target: str | LyapunovOrbit | SustainedOrbit | Plan, limits: Limits
) -> tuple[str, Target]:
    """Return the name of a target for texts, and its places: states at which a law can take over, with costs-to-go.

    A target is the name of an equilibrium, an orbit, or a plan, whose first stop has the places. A Lyapunov orbit,
    which has no friction, is first made a sustained one.
    """
    if isinstance(target, Plan):
        recovery = assembled(replace(target, itinerary=target.itinerary.with_run({"start": "anywhere"}))).recovery
        assert recovery is not None
        return f"{recovery.names[0]} of {target.itinerary.name}", recovery.briefing.goals[0].target
    if isinstance(target, LyapunovOrbit):
        target = sustained_orbit(target, arms, limits=limits)
    if isinstance(target, SustainedOrbit):
        model = sampled_model(arms, PHASES / target.period)
        name = f"the orbit about {target.lyapunov.saddle} at {target.energy:g} J"
        return name, orbit_target(target, model, TvlqrSettings(), limits)
    return target, _held(arms, target, limits)


@lru_cache(maxsize=16)
def _held(arms: ArmChainParameters, name: str, limits: Limits) -> Target:
    """Return the equilibrium of this name as a target, with the cost-to-go of the law that holds it."""
    equilibrium_points = equilibria(pendulum_system("pendulum", arms))
    check_choice("equilibrium", equilibrium_points, name)
    return hold_target(
        hold_controller(equilibrium_points[name].state, sampled_model(arms, RATE), HoldSettings(), seconds=1.0), limits
    )
