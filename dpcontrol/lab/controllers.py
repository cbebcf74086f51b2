"""From a reference and settings to the controller of a run, whatever its kind.

A reference that stays on one orbit or at one equilibrium says so in its notes (`stay`): kinds that hold orbits or
equilibria need one, and kinds that track take it as any other.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from dpcontrol.control.adaptive import AdaptiveSettings, adaptive_controller
from dpcontrol.control.estimator_settings import FilterSettings
from dpcontrol.control.hold import HoldSettings, hold_controller
from dpcontrol.control.interface import Controller
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings, ogy_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.sampled import SampledModel
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings, tracking_controller
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.dynamics.system import pendulum_system
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.reference import Reference
from dpcontrol.references.sustained import SustainedOrbit, sustained_from
from dpcontrol.tubes.lyapunov import lyapunov_orbit

ControllerSettings = (
    TvlqrSettings | FeedforwardSettings | AdaptiveSettings | HoldSettings | OgySettings | ClassicOgySettings
)


def make_controller(
    reference: Reference,
    parameters: ArmChainParameters,
    model: SampledModel,
    *,
    settings: ControllerSettings,
    estimator: FilterSettings,
) -> Controller:
    """Return the controller of `settings`, with `parameters` as the model's and `estimator` for what it will know.

    Raises:
        InputError: the reference did not converge, is not one of these arms, or not of the kind that is needed.
        GoalMissed: no controller can be made for it.
    """
    stay: dict[str, Any] = dict(reference.notes.get("stay", {}))
    seconds = reference.duration
    if isinstance(settings, OgySettings | ClassicOgySettings):
        if stay.get("kind") != "orbit":
            raise InputError(
                f'controller: kind = "{settings.kind}" keeps an orbit; give the itinerary orbit = "down-up"'
            )
        return ogy_controller(stay_orbit(reference, parameters), model, settings, seconds=seconds)
    if isinstance(settings, HoldSettings):
        if stay.get("kind") != "hold":
            raise InputError(
                f'controller: kind = "{settings.kind}" holds an equilibrium; give the itinerary hold = "up-up"'
            )
        return hold_controller(reference.state(0.0), model, settings, seconds=seconds)
    if isinstance(settings, AdaptiveSettings):
        return adaptive_controller(reference, model, settings, estimator=estimator)
    if isinstance(settings, TvlqrSettings) and stay.get("kind") == "orbit":
        return orbit_controller(stay_orbit(reference, parameters), model, settings, seconds=seconds)
    return tracking_controller(reference, model, settings)


def stay_orbit(reference: Reference, parameters: ArmChainParameters) -> SustainedOrbit:
    """Return the sustained orbit on which a reference stays.

    Raises:
        InputError: it is of other arms.
    """
    stay: dict[str, Any] = dict(reference.notes["stay"])
    count = stay["intervals"]
    mesh = reference.mesh[: count + 1] - reference.mesh[0]
    period = replace(reference, mesh=mesh, states=reference.states[:count], inputs=reference.inputs[:count])
    system = pendulum_system(stay["orbit"], parameters)
    lyapunov = lyapunov_orbit(system, stay["orbit"], energy=stay["energy"], family=stay["family"])
    if not lyapunov.converged or not np.isclose(lyapunov.period, stay["lyapunov_period"], rtol=1e-9):
        raise InputError(f"the reference stays on an orbit about {stay['orbit']} of other arms; plan it anew")
    return sustained_from(lyapunov, parameters, period)
