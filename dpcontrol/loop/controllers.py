"""Build controller and estimator of a run from reference and settings.

The notes of a reference that stays on one orbit or at one equilibrium have the entry `stay`. Laws that hold orbits or
equilibria need this entry. Laws that track accept any reference.

If stops are kept, the notes list the intervals of stays and flights (`program`). Orbits that are not in a reference are
computed again. This search is deterministic.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import (
    ADAPTIVE,
    HOLD,
    Augment,
    EkfSettings,
    EstimatorSettings,
    FilterSettings,
    UkfSettings,
    extra_names,
)
from dpcontrol.control.handover import Fly, Keep, Keeper, NearestKeeper, Program, program
from dpcontrol.control.interface import Controller, Estimator, SampledModel
from dpcontrol.control.lqr import ExtraEffects, HoldSettings, hold_controller
from dpcontrol.control.ogy import ClassicOgySettings, OgyController, OgySettings, ogy_controller
from dpcontrol.control.periodic import OrbitController, orbit_controller
from dpcontrol.control.symbolic import symbolic_controller
from dpcontrol.control.tracking import (
    AdaptiveSettings,
    FeedforwardSettings,
    ReferenceController,
    TvlqrSettings,
    adaptive_controller,
    extra_jacobians,
    tracking_controller,
)
from dpcontrol.dynamics.chain import ArmChainParameters, damping_scales, pendulum_system
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import fields_of
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.loop.own import OwnController, OwnEstimates, OwnEstimator, OwnExpressions, OwnLaw
from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.references.content import FlightSegment, StaySegment
from dpcontrol.references.reference import Reference

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SustainedOrbit


class Filter(NamedTuple):
    """A kind of estimator: its settings, and the function that makes it from settings, model and noise (n+1, n+1).

    A symbolic estimator is compiled into the tick and can be exported to C.
    """

    settings: type
    make: Callable[[Any, SampledModel, Array], Estimator]
    symbolic: bool = False


def _ukf(settings: Any, model: SampledModel, noise: Array) -> Estimator:
    """Return the unscented filter for a model and covariance `noise` (n+1, n+1) of the measured positions."""

    # filterpy takes a second to import.
    from dpcontrol.control.ukf import Ukf

    return Ukf(model, settings, noise=noise)


FILTERS = (
    Filter(EkfSettings, lambda s, model, noise: CompiledEkf(model, s, noise=noise), symbolic=True),
    Filter(UkfSettings, _ukf),
    Filter(OwnEstimator, lambda s, model, noise: OwnEstimates(s.own, model, noise=noise)),
)
"""Every kind of estimator."""
ESTIMATORS: dict[str, type[EstimatorSettings]] = {one.settings.kind: one.settings for one in FILTERS[:-1]}
"""The settings of each built-in kind, by its name in an itinerary."""


def filter_of(settings: EstimatorSettings | OwnEstimator) -> Filter:
    """Return the kind of estimator, one of `FILTERS`, to which these settings belong.

    Args:
        settings: settings of an estimator, built in or a user's.
    """
    return next(kind for kind in FILTERS if isinstance(settings, kind.settings))


def filter_defaults(kind: str, law: "ControllerSettings", keep: str = "none") -> Mapping[str, Any]:
    """Return the estimator's settings that suit a law and differ from the defaults of its kind.

    An itinerary that does not give these settings gets them, for example the estimates of parameters that an adaptive
    law uses.

    Args:
        kind: kind of the estimator, one of `ESTIMATORS`.
        law: settings of the law that follows the reference.
        keep: law that keeps the stops, one of `KEEPERS`.
    """
    if isinstance(law, AdaptiveSettings) or keep == "tvlqr":
        return ADAPTIVE
    return HOLD if isinstance(law, HoldSettings) and kind == "ekf" else {}


def make_estimator(settings: EstimatorSettings | OwnEstimator, model: SampledModel, *, noise: Array) -> Estimator:
    """Return the estimator of `settings` for `model`.

    Args:
        settings: settings of the estimator, which select its kind.
        model: model of the n arms that predicts the state.
        noise: covariance (n+1, n+1) of the measured positions, rad² and m².
    """
    return filter_of(settings).make(settings, model, noise)


KEEPERS = ("none", "ogy", "ogy-classic", "tvlqr")
"""Laws that can keep the stops of a walk; with none, one law follows the whole reference."""


def keeps_by_phase(keep: str, estimator: FilterSettings | EstimatorSettings | OwnEstimator) -> bool:
    """Return True if laws with internal timing keep the stops, and not gains by time with the estimated arms.

    Gains by time can be tabulated, compiled and resumed after a fall.

    Args:
        keep: law that keeps the stops, one of `KEEPERS`.
        estimator: settings of the estimator.
    """
    estimates = isinstance(estimator, FilterSettings) and Augment.PARAMETERS in estimator.augments
    return keep != "none" and not (keep == "tvlqr" and estimates)


def keeping_controller(
    reference: Reference, parameters: ArmChainParameters, model: SampledModel, *, flies: TvlqrSettings, keep: str
) -> Program:
    """Return the program of laws for a reference with stays: one keeps each stay, another follows each flight.

    Stays on the same orbit share one law. The reference's segments give the rows of each stay or flight.

    Args:
        reference: reference that was planned with stays.
        parameters: parameters of the model's arms.
        model: model of arms and drive from tick to tick.
        flies: settings of the law between the stays.
        keep: law that keeps the stays, one of `KEEPERS`.

    Raises:
        InputError: the reference was planned without stays, or is of other arms.
        GoalMissed: a controller cannot be made, or stays and flights do not meet.
    """
    if not any(isinstance(segment, FlightSegment) for segment in reference.content.segments):
        raise InputError(
            f'controller: keep = "{keep}": the reference was planned without stays; write keep = "{keep}" under '
            "[controller] of an itinerary that is a walk"
        )
    # The next stay holds the end of a flight, so no terminal weight is needed (`closing` is the factor on it).
    flight_settings = replace(flies, closing=1.0)
    keepers: dict[str, OgyController | OrbitController] = {}
    stays, flights = list[Keep](), list[Fly]()
    for entry in reference.content.segments:
        if isinstance(entry, FlightSegment):
            flights.append(Fly(entry.fly, tracking_controller(_part(reference, entry.rows), model, flight_settings)))
            continue
        orbit_name = _orbit_name(entry.keep, entry.energy)
        if orbit_name not in keepers:
            keepers[orbit_name] = _keeper(kept_orbit(reference, entry, parameters), model, keep=keep, flies=flies)
        stays.append(Keep(f"stay {len(stays) + 1}, {orbit_name}", keepers[orbit_name], wraps=entry.periods))
    return program(stays, flights, period=model.period, kind=f"{flies.kind}, stays by {keep}")


def _keeper(
    orbit: "SustainedOrbit", model: SampledModel, *, keep: str, flies: TvlqrSettings
) -> OgyController | OrbitController:
    """Return the controller that keeps a sustained orbit at a stop, or as a fallback.

    Args:
        orbit: orbit to keep.
        model: model of arms and drive from tick to tick.
        keep: law that keeps it, one of `KEEPERS` except "none".
        flies: settings of the law between the stops, whose weights "tvlqr" uses here too.
    """
    if keep == "tvlqr":
        return orbit_controller(orbit, model, replace(flies, schedule="phase"), seconds=orbit.period)
    settings = OgySettings() if keep == "ogy" else ClassicOgySettings()
    return ogy_controller(orbit, model, settings, seconds=orbit.period)


def _orbit_name(saddle: str, energy: float) -> str:
    """Return the name of an orbit for logs and errors, which also identifies it in this module."""
    return f"the orbit about {saddle} at {energy:g} J"


def _part(reference: Reference, rows: tuple[int, int]) -> Reference:
    """Return a part of a reference as a reference that begins at time 0, for a law that follows this part alone.

    `rows` are the first interval of its mesh, and that after the last one.
    """
    first, last = rows
    mesh = reference.mesh[first : last + 1] - reference.mesh[first]
    return replace(reference, mesh=mesh, states=reference.states[first:last], inputs=reference.inputs[first:last])


def kept_orbit(reference: Reference, stay: StaySegment, parameters: ArmChainParameters) -> "SustainedOrbit":
    """Return the sustained orbit of a stay, the periodic motion with friction and cart that a law keeps there.

    The Lyapunov orbit is computed again, since a reference contains only the sustained motion.

    Args:
        reference: reference that contains the orbit.
        stay: segment of the reference with the stay.
        parameters: parameters of the model's arms.

    Raises:
        InputError: the reference is of other arms.
    """
    # Runs that keep no orbit do not import the search for sustained ones.
    from dpcontrol.references.sustained import SustainedOrbit

    stay_motion = _part(reference, stay.rows)
    one_period = replace(stay_motion, states=stay_motion.states - np.asarray(stay.turns))
    system = pendulum_system(stay.keep, parameters)
    lyapunov = lyapunov_orbit(system, stay.keep, energy=stay.energy, family=stay.family)
    if not lyapunov.converged or not np.isclose(lyapunov.period, stay.lyapunov_period, rtol=1e-9):
        raise InputError(f"the reference stays on an orbit about {stay.keep} of other arms; plan it again")
    return SustainedOrbit(lyapunov, parameters, one_period)


def nearest_keeper(
    reference: Reference, parameters: ArmChainParameters, model: SampledModel, *, flies: TvlqrSettings
) -> NearestKeeper:
    """Return the laws of which one takes over after tracking is lost: that of the nearest orbit or equilibrium.

    They hold the reference's orbits and equilibria, and the hanging arms. Orbits are held by feedback at every tick, at
    the nearest phase, because it holds them from the largest distance.

    Args:
        reference: planned reference, with the orbits of its plan.
        parameters: parameters of the model's arms.
        model: model of arms and drive from tick to tick.
        flies: settings of the feedback that holds orbits.

    Raises:
        InputError: the reference is of other arms.
        GoalMissed: an orbit was not found, or cannot be held.
    """
    content = reference.content
    stays = {_orbit_name(stay.keep, stay.energy): stay for stay in content.stays}
    keepers: dict[str, Keeper] = {}
    equilibrium_names = ["-".join(["down"] * parameters.count)]
    for orbit in content.orbits:
        name = _orbit_name(orbit.saddle, orbit.energy)
        if np.isclose(orbit.energy, content.saddles[orbit.saddle].energy, rtol=0, atol=1e-9):
            equilibrium_names.append(orbit.saddle)
        elif name not in keepers:
            sustained = (
                kept_orbit(reference, stays[name], parameters)
                if name in stays
                else _sought_orbit(orbit.saddle, orbit.energy, reference, parameters)
            )
            keepers[name] = _keeper(sustained, model, keep="tvlqr", flies=flies)
    all_equilibria = equilibria(pendulum_system("pendulum", parameters))
    for name in dict.fromkeys(equilibrium_names):
        keepers[name] = hold_controller(all_equilibria[name].state, model, HoldSettings(), seconds=reference.duration)
    return NearestKeeper(keepers)


def _sought_orbit(saddle: str, energy: float, reference: Reference, parameters: ArmChainParameters) -> "SustainedOrbit":
    """Return the sustained orbit about a saddle at an energy, as a fallback for an orbit that the plan lacks.

    Args:
        saddle: name of the saddle.
        energy: energy of the orbit, J.
        reference: reference of the run, whose limits the orbit must keep.
        parameters: parameters of the model's arms.

    Raises:
        GoalMissed: the cart cannot sustain the orbit.
    """
    from dpcontrol.references.sustained import sustained_orbit

    lyapunov = lyapunov_orbit(pendulum_system(saddle, parameters), saddle, energy=energy)
    sustained = sustained_orbit(lyapunov, parameters, limits=reference.limits)
    if not sustained.converged:
        raise GoalMissed(
            f'hold = "nearest": {_orbit_name(saddle, energy)} cannot be held: {sustained.status}; remove hold under '
            "[supervisor]"
        )
    return sustained


_OSCILLATION = 2.5
"""Amplitude of a joint's rate at which a hold replaces dry by viscous friction in its model, rad/s."""
_MOST_DRY = 0.055
"""Largest damping ratio from it: more reduces robustness against wrong masses."""

ControllerSettings = (
    TvlqrSettings
    | FeedforwardSettings
    | AdaptiveSettings
    | HoldSettings
    | OgySettings
    | ClassicOgySettings
    | OwnLaw
    | OwnExpressions
)


@dataclass(frozen=True, eq=False)
class LawInputs:
    """Arguments from which the controllers of all kinds are made.

    Attributes:
        reference: reference to follow.
        parameters: parameters of the model's arms.
        model: model of arms and drive from tick to tick.
        settings: settings of the law.
        estimator: settings of the filter that supplies the law's state.
        keep: law that keeps the stops of a walk, see `make_controller`.
    """

    reference: Reference
    parameters: ArmChainParameters
    model: SampledModel
    settings: Any
    estimator: FilterSettings
    keep: str

    @property
    def stay(self) -> StaySegment | None:
        """The orbit on which the whole reference stays, or None for a reference that moves."""
        plan = self.reference.plan
        return plan.stays[0] if plan is not None and len(plan.segments) == 1 else None


def _own(made: LawInputs) -> Controller:
    """Return a user's Python law, which receives the reference's states and feedforward at each tick.

    `made` holds reference, model and settings. A law of feedforward alone supplies the states and inputs by tick.
    """
    user_object = made.settings.own
    reference_fields = fields_of(
        ReferenceController, tracking_controller(made.reference, made.model, FeedforwardSettings())
    )
    return OwnController(**{**reference_fields, "kind": user_object.name}, own=user_object, period=made.model.period)


def _ogy(made: LawInputs) -> Controller:
    """Return the law that keeps the itinerary's orbit by pulses once per section of its period (OGY control).

    `made` holds reference, model and settings. A reference that does not stay on one orbit is refused.
    """
    if made.stay is None:
        raise InputError(
            f'controller: kind = "{made.settings.kind}" keeps an orbit; give the itinerary orbit = "down-up"'
        )
    orbit = kept_orbit(made.reference, made.stay, made.parameters)
    return ogy_controller(orbit, made.model, made.settings, seconds=made.reference.duration)


def _hold(made: LawInputs) -> Controller:
    """Return the law that holds the itinerary's equilibrium, with gains on the estimated disturbances.

    Dry friction enters as the viscous friction that dissipates as much in an oscillation of amplitude `_OSCILLATION`.
    Its damping ratio is 4/(π · amplitude) times the dry torque over the scale of damping, at most `_MOST_DRY`. `made`
    holds reference, model and settings. A reference that moves, or stays on an orbit, is refused.
    """
    settings, model, estimator, parameters = made.settings, made.model, made.estimator, made.parameters
    plan = made.reference.plan
    if plan is None or plan.symbols or plan.segments:
        raise InputError(
            f'controller: kind = "{settings.kind}" holds an equilibrium; give the itinerary hold = "up-up"'
        )
    start, names = made.reference.state(0.0), extra_names(model.arms, estimator.augments)
    process = estimator.process(model.arms, model.period)
    effects, decays = extra_jacobians(model, estimator.augments, start[None], np.zeros(1), process)
    shares = np.divide(parameters.coulomb or 0.0, damping_scales(parameters.base(), parameters.count))
    dry = min(4 / (np.pi * _OSCILLATION) * float(shares.max()), _MOST_DRY)
    extras = ExtraEffects(names, effects[0], decays)
    return hold_controller(start, model, settings, seconds=made.reference.duration, extras=extras, dry=dry)


def _tvlqr(made: LawInputs) -> Controller:
    """Return the law by time-varying LQR for the itinerary's stays, its only orbit, or its walk.

    `made` holds reference, model and settings, and `keep`, the law that keeps the stops of a walk ("none" for no other
    law). With `keep = "tvlqr"` and estimated parameters, the stops are kept by gains by time that depend on them.
    """
    reference, parameters, model, settings = made.reference, made.parameters, made.model, made.settings
    if keeps_by_phase(made.keep, made.estimator):
        return keeping_controller(reference, parameters, model, flies=settings, keep=made.keep)
    if made.keep != "none":
        # At ±5 %, 14 of 20 runs of a walk complete with feedback by phase, and 20 with this law.
        defaults = vars(TvlqrSettings())
        changed_settings = {
            name: value for name, value in vars(settings).items() if value != defaults[name] and name != "schedule"
        }
        return adaptive_controller(reference, model, AdaptiveSettings(**changed_settings), estimator=made.estimator)
    if made.stay is not None:
        orbit = kept_orbit(reference, made.stay, parameters)
        return orbit_controller(orbit, model, settings, seconds=reference.duration)
    return tracking_controller(reference, model, settings)


class Law(NamedTuple):
    """A kind of controller: its settings and its factory.

    A law that is symbolic in the loop's time, but not in a phase, is compiled into the tick and can be exported to C.
    """

    settings: type
    make: Callable[[LawInputs], Controller]
    symbolic: bool = True


LAWS = (
    Law(TvlqrSettings, _tvlqr),
    Law(AdaptiveSettings, lambda m: adaptive_controller(m.reference, m.model, m.settings, estimator=m.estimator)),
    Law(OgySettings, _ogy, symbolic=False),
    Law(ClassicOgySettings, _ogy, symbolic=False),
    Law(HoldSettings, _hold),
    Law(FeedforwardSettings, lambda m: tracking_controller(m.reference, m.model, m.settings)),
    Law(OwnLaw, _own, symbolic=False),
    Law(OwnExpressions, lambda m: symbolic_controller(m.settings.own.thing, m.reference, m.model)),
)
"""Every kind of controller."""
CONTROLLERS: dict[str, type[ControllerSettings]] = {one.settings.kind: one.settings for one in LAWS[:-2]}
"""The settings of each built-in kind, by its name in an itinerary."""


def law_of(settings: ControllerSettings) -> Law:
    """Return the kind of controller, one of `LAWS`, to which these settings belong.

    Args:
        settings: settings of a controller.
    """
    return next(kind for kind in LAWS if isinstance(settings, kind.settings))


def make_controller(
    reference: Reference,
    parameters: ArmChainParameters,
    model: SampledModel,
    *,
    settings: ControllerSettings,
    estimator: FilterSettings,
    keep: str = "none",
) -> Controller:
    """Return the controller that the settings select, for a reference and a model.

    Args:
        reference: reference to follow.
        parameters: the model's arms.
        model: model between ticks.
        settings: settings of the law.
        estimator: estimator that supplies its state.
        keep: law that keeps the stops of a walk (`KEEPERS`), with TVLQR in between.

    Raises:
        InputError: the reference did not converge, is not one of these arms, or not of the required kind.
        GoalMissed: no controller can be made for it.
    """
    return law_of(settings).make(LawInputs(reference, parameters, model, settings, estimator, keep))
