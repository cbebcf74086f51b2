"""From a reference and settings to the controller of a run, whatever its kind.

A reference that stays on one orbit or at one equilibrium says so in its notes (`stay`): kinds that hold orbits or
equilibria need one, and kinds that track take it as any other.
"""

from typing import Any

from dpcontrol.control.adaptive import AdaptiveSettings, adaptive_controller
from dpcontrol.control.estimator_settings import FilterSettings
from dpcontrol.control.hold import HoldSettings, hold_controller
from dpcontrol.control.interface import Controller
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings, ogy_controller
from dpcontrol.control.periodic import orbit_controller
from dpcontrol.control.sampled import SampledModel
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings, tracking_controller
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.programs import keeping_controller, stay_orbit
from dpcontrol.references.reference import Reference

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
    keep: str = "none",
) -> Controller:
    """Return the controller of `settings`, with `parameters` as the model's and `estimator` for what it will know.

    keep: what keeps the stops of a walk (`programs.KEEPERS`) where the settings are TVLQR's.

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
    if isinstance(settings, TvlqrSettings) and keep != "none":
        return keeping_controller(reference, parameters, model, flies=settings, keep=keep)
    if isinstance(settings, TvlqrSettings) and stay.get("kind") == "orbit":
        return orbit_controller(stay_orbit(reference, parameters), model, settings, seconds=seconds)
    return tracking_controller(reference, model, settings)
