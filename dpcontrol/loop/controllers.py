"""From a reference and settings to the controller and the estimator of a run, whatever their kinds.

A reference that stays on one orbit or at one equilibrium says so in its notes (`stay`): kinds that hold orbits or
equilibria need one, and kinds that track take it as any other.

The notes of a reference whose stops are kept say which of its intervals are a stay's and which a flight's (`program`).
Orbits that are not in a reference are searched for again, which is the same search with the same result each time.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import (
    AdaptiveEkfSettings,
    AdaptiveFilterpyEkfSettings,
    AdaptiveUkfSettings,
    EkfSettings,
    EstimatorSettings,
    FilterpyEkfSettings,
    FilterSettings,
    HoldEkfSettings,
    UkfSettings,
    extra_names,
)
from dpcontrol.control.handover import Fly, Keep, Keeper, NearestKeeper, Program, Segment, program
from dpcontrol.control.interface import Controller, Estimator, SampledModel
from dpcontrol.control.lqr import ExtraEffects, HoldSettings, hold_controller
from dpcontrol.control.ogy import ClassicOgySettings, OgyController, OgySettings, ogy_controller
from dpcontrol.control.periodic import OrbitController, orbit_controller
from dpcontrol.control.tracking import (
    AdaptiveSettings,
    FeedforwardSettings,
    TvlqrSettings,
    adaptive_controller,
    extra_jacobians,
    tracking_controller,
)
from dpcontrol.dynamics.chain import ArmChainParameters, damping_scales, pendulum_system
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.references.reference import Reference, plan_notes

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit


ESTIMATORS: dict[str, type[EstimatorSettings]] = {
    settings.kind: settings for settings in (EkfSettings, UkfSettings, FilterpyEkfSettings)
}
"""The settings of each kind of estimator, by its name in an itinerary."""
ADAPTIVE_ESTIMATORS: dict[str, type[EstimatorSettings]] = {
    settings.kind: settings for settings in (AdaptiveEkfSettings, AdaptiveUkfSettings, AdaptiveFilterpyEkfSettings)
}
"""The same with the defaults for the adaptive law."""


def estimators_of(law: "ControllerSettings") -> dict[str, type[EstimatorSettings]]:
    """Return the settings of each kind of estimator, with the defaults that go with a law."""
    if isinstance(law, AdaptiveSettings):
        return ADAPTIVE_ESTIMATORS
    return {**ESTIMATORS, "ekf": HoldEkfSettings} if isinstance(law, HoldSettings) else ESTIMATORS


def make_estimator(settings: EstimatorSettings, model: SampledModel, *, noise: Array) -> Estimator:
    """Return the estimator of `settings` for `model`; noise (n+1, n+1): of the measured positions.

    Raises:
        InputError: the noise has the wrong shape or is no covariance.
    """
    if isinstance(settings, EkfSettings):
        return CompiledEkf(model, settings, noise=noise)
    # filterpy takes a second to import.
    from dpcontrol.control.ukf import FilterpyEkf, Ukf

    if isinstance(settings, UkfSettings):
        return Ukf(model, settings, noise=noise)
    return FilterpyEkf(model, settings, noise=noise)


KEEPERS = ("none", "ogy", "ogy-classic", "tvlqr")
"""What may keep the stops of a walk; with none the whole reference is followed in one piece."""


def keeping_controller(
    reference: Reference, parameters: ArmChainParameters, model: SampledModel, *, flies: TvlqrSettings, keep: str
) -> Program:
    """Return the program that keeps the stays of `reference` by `keep` and flies the rest as `flies` says.

    Raises:
        InputError: the reference was planned without stays, or is of other arms.
        GoalMissed: a controller cannot be made, or stays and flights do not meet.
    """
    entries: list[dict[str, Any]] = list(reference.notes.get("program", []))
    if not entries:
        raise InputError(
            f'controller: keep = "{keep}": the reference was planned without stays; write keep = "{keep}" under '
            "[controller] of an itinerary that is a walk"
        )
    # What a flight ends on is the next stay's to hold: nothing has to be enforced there.
    open_ended = replace(flies, closing=1.0)
    keepers: dict[str, OgyController | OrbitController] = {}
    segments: list[Segment] = []
    for k, entry in enumerate(entries):
        if "fly" in entry:
            flown = _part(reference, entry)
            segments.append(Fly(entry["fly"], tracking_controller(flown, model, open_ended)))
            continue
        name = _orbit_name(entry["keep"], entry["energy"])
        if name not in keepers:
            keepers[name] = _keeper(kept_orbit(reference, entry, parameters), model, keep=keep, flies=flies)
        segments.append(Keep(f"stay {k // 2 + 1}, {name}", keepers[name], wraps=entry["periods"]))
    kind = f"{flies.kind}, stays by {keep}"
    return program(segments, period=model.period, kind=kind)


def _keeper(
    orbit: "SustainedOrbit", model: SampledModel, *, keep: str, flies: TvlqrSettings
) -> OgyController | OrbitController:
    if keep == "tvlqr":
        return orbit_controller(orbit, model, replace(flies, schedule="phase"), seconds=orbit.period)
    settings = OgySettings() if keep == "ogy" else ClassicOgySettings()
    return ogy_controller(orbit, model, settings, seconds=orbit.period)


def _orbit_name(saddle: str, energy: float) -> str:
    return f"the orbit about {saddle} at {energy:g} J"


def _part(reference: Reference, entry: Mapping[str, Any]) -> Reference:
    """Return the part of a reference that an entry of its program is."""
    first, last = entry["rows"]
    mesh = reference.mesh[first : last + 1] - reference.mesh[first]
    return replace(reference, mesh=mesh, states=reference.states[first:last], inputs=reference.inputs[first:last])


def kept_orbit(reference: Reference, entry: Mapping[str, Any], parameters: ArmChainParameters) -> "SustainedOrbit":
    """Return the sustained orbit of which an entry tells: keep (the saddle), energy, family, lyapunov_period, rows,
    turns.

    Raises:
        InputError: it is of other arms.
    """
    # Runs that keep no orbit do without what finds them.
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.references.sustained import SustainedOrbit

    part = _part(reference, entry)
    period = replace(part, states=part.states - np.asarray(entry["turns"]))
    saddle = entry["keep"]
    system = pendulum_system(saddle, parameters)
    lyapunov = lyapunov_orbit(system, saddle, energy=entry["energy"], family=entry["family"])
    if not lyapunov.converged or not np.isclose(lyapunov.period, entry["lyapunov_period"], rtol=1e-9):
        raise InputError(f"the reference stays on an orbit about {saddle} of other arms; plan it again")
    return SustainedOrbit(lyapunov, parameters, period)


def stay_orbit(reference: Reference, parameters: ArmChainParameters) -> "SustainedOrbit":
    """Return the sustained orbit on which a reference stays (notes, `stay`).

    Raises:
        InputError: it is of other arms.
    """
    return kept_orbit(reference, _stay_entry(reference), parameters)


def _stay_entry(reference: Reference) -> dict[str, Any]:
    stay: dict[str, Any] = dict(reference.notes["stay"])
    turns = [0.0] * reference.states.shape[-1]
    return {**stay, "keep": stay["orbit"], "rows": [0, stay["intervals"]], "turns": turns}


def nearest_keeper(
    reference: Reference, parameters: ArmChainParameters, model: SampledModel, *, flies: TvlqrSettings
) -> NearestKeeper:
    """Return what holds the nearest of a reference's orbits and equilibria, and hanging still, when it is given up.

    Orbits are held by feedback at every tick, at the nearest phase: nothing keeps them from farther away.

    Raises:
        InputError: the reference is of other arms.
        GoalMissed: an orbit was not found, or cannot be held.
    """
    notes = plan_notes(reference)
    entries: list[Any] = [e for e in notes.get("program", []) if "keep" in e]
    if notes.get("stay", {}).get("kind") == "orbit":
        entries = [_stay_entry(reference)]
    found = {_orbit_name(e["keep"], e["energy"]): e for e in entries}
    keepers: dict[str, Keeper] = {}
    names = ["-".join(["down"] * parameters.count)]
    for orbit in notes["orbits"]:
        saddle, energy = orbit["saddle"], orbit["energy"]
        name = _orbit_name(saddle, energy)
        if np.isclose(energy, notes["saddles"][saddle]["energy"], rtol=0, atol=1e-9):
            names.append(saddle)
        elif name not in keepers:
            kept = kept_orbit(reference, found[name], parameters) if name in found else _sought(
                saddle, energy, reference, parameters
            )  # fmt: skip
            keepers[name] = _keeper(kept, model, keep="tvlqr", flies=flies)
    points = equilibria(pendulum_system("pendulum", parameters))
    for name in dict.fromkeys(names):
        keepers[name] = hold_controller(points[name].state, model, HoldSettings(), seconds=reference.duration)
    return NearestKeeper(keepers)


def _sought(saddle: str, energy: float, reference: Reference, parameters: ArmChainParameters) -> "SustainedOrbit":
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.references.sustained import sustained_orbit

    lyapunov = lyapunov_orbit(pendulum_system(saddle, parameters), saddle, energy=energy)
    found = sustained_orbit(lyapunov, parameters, limits=reference.limits)
    if not found.converged:
        raise GoalMissed(
            f'hold = "nearest": {_orbit_name(saddle, energy)} cannot be held: {found.status}; remove hold under '
            "[supervisor]"
        )
    return found


_OSCILLATION = 2.5
"""rad/s: amplitude of a joint's rate at which a hold takes dry friction of its model for viscous friction."""
_MOST_DRY = 0.055
"""Most of it, as a share like a hold's damping: more costs robustness against wrong masses."""

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
        start, names = reference.state(0.0), extra_names(model.arms, estimator.augments)
        process = estimator.process(model.arms, model.period)
        effects, kept = extra_jacobians(model, estimator.augments, start[None], np.zeros(1), process)
        if parameters.coulomb:
            shares = np.array(parameters.coulomb) / np.array(damping_scales(parameters.base(), parameters.count))
            dry = min(4 / (np.pi * _OSCILLATION) * float(shares.max()), _MOST_DRY)
            settings = replace(settings, damping=settings.damping + dry)
        return hold_controller(start, model, settings, seconds=seconds, extras=ExtraEffects(names, effects[0], kept))
    if isinstance(settings, AdaptiveSettings):
        return adaptive_controller(reference, model, settings, estimator=estimator)
    if isinstance(settings, TvlqrSettings) and keep != "none":
        return keeping_controller(reference, parameters, model, flies=settings, keep=keep)
    if isinstance(settings, TvlqrSettings) and stay.get("kind") == "orbit":
        return orbit_controller(stay_orbit(reference, parameters), model, settings, seconds=seconds)
    return tracking_controller(reference, model, settings)
