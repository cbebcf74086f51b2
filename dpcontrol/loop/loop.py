"""A simulated run: plant, sensors and drive drawn from a seed, a controller and an estimator with the model.

All that is random comes from the seed; the controller and the estimator know the model's parameters and the drive's
nominal limits and delay, and nothing of what was drawn.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimation import make_estimator
from dpcontrol.control.estimator_settings import EkfSettings, EstimatorSettings
from dpcontrol.control.interface import Controller
from dpcontrol.control.model import SampledModel
from dpcontrol.control.tracking import TvlqrSettings
from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.ratios import Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Settings, setting
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    SensorSettings,
    draw_bench,
)
from dpcontrol.loop.control_loop import CommandPath, ControlLoop, Fallback
from dpcontrol.loop.controllers import KEEPERS, ControllerSettings, make_controller, nearest_keeper
from dpcontrol.loop.result import LoopResult, LoopSink, NoSink
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.loop.supervisor import Supervisor, SupervisorSettings
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopSettings(Settings, table="run"):
    """A run: rate Hz; initial_error rad, uniform ± on each angle of the true first state; mismatch of the plant's
    parameters (share); model_uncertainty: factor on the standard errors that the model's file gives, by which the plant
    is drawn besides; seed of all that is random. travel m: the cart's greatest distance from the centre, zero for the
    reference's own limit. keep: what keeps the stops of a walk planned so (`programs.KEEPERS`), while TVLQR flies.
    """

    seed: int = setting(least=0)
    rate: float = setting(1000.0, least=1, most=10_000, unit="Hz")
    initial_error: float = setting(0.0, least=0, most=np.pi, unit="rad")
    mismatch: float = setting(0.0, least=0, most=0.9)
    model_uncertainty: float = setting(0.0, least=0, most=100)
    travel: float = setting(0.0, least=0, most=1000, unit="m")
    keep: str = setting("none", choices=KEEPERS)
    controller: ControllerSettings = field(default_factory=TvlqrSettings)
    estimator: EstimatorSettings = field(default_factory=EkfSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    drive: DriveSettings = field(default_factory=DriveSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    supervisor: SupervisorSettings = field(default_factory=SupervisorSettings)

    def __post_init__(self) -> None:
        """Check the bounds, and that what keeps the stops goes with the controller.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        super().__post_init__()
        if self.keep != "none" and not isinstance(self.controller, TvlqrSettings):
            raise self.refusal("keep", f'what flies between the stops is "tvlqr", not "{self.controller.kind}"')

    @property
    def bench(self) -> BenchSettings:
        """What stands between the model and the world."""
        return BenchSettings(self.sensors, self.drive, self.disturbances)

    def draw(
        self,
        arms: ArmChainParameters,
        *,
        ticks: int,
        uncertainty: Uncertainty | None = None,
        plant: ArmChainParameters | None = None,
        **instead: Any,
    ) -> BenchDraw:
        """Return what is drawn for a run of `ticks` ticks with these arms as the model; see `draw_bench`.

        instead: seed or mismatch in place of the settings' own.
        """
        given = {"seed": self.seed, "mismatch": self.mismatch, **instead}
        return draw_bench(
            arms, self.bench, ticks=ticks, period=1 / self.rate, model_uncertainty=self.model_uncertainty,
            uncertainty=uncertainty, initial_error=self.initial_error, plant=plant, **given,
        )  # fmt: skip

    def limits(self, reference: Reference) -> Limits:
        """Return the cart's limits in this run: the reference's, with this travel where it is given."""
        return replace(reference.limits, position=self.travel) if self.travel else reference.limits


def sampled_model(parameters: ArmChainParameters, rate: float) -> SampledModel:
    """Return the cart-level model of these arms between ticks at `rate` Hz."""
    equations = arm_chain_equations(parameters.count, Level.CART, friction=parameters.friction)
    return SampledModel(equations, parameters.base(), period=1 / rate)


def loop_controller(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Controller:
    """Return the controller of these settings, which any number of runs may share.

    Raises:
        InputError: the reference did not converge, or is not one of these arms.
        GoalMissed: no controller can be made for it.
    """
    model = sampled_model(parameters, settings.rate)
    return make_controller(
        reference, parameters, model, settings=settings.controller, estimator=settings.estimator, keep=settings.keep
    )


def loop_fallback(reference: Reference, parameters: ArmChainParameters, settings: LoopSettings) -> Fallback | None:
    """Return what these settings hold when tracking is lost, which any number of runs may share; None for nothing.

    Raises:
        InputError: the reference is of other arms.
        GoalMissed: an orbit was not found, or cannot be held.
    """
    if settings.supervisor.hold == "none":
        return None
    law = settings.controller
    flies = law if isinstance(law, TvlqrSettings) else TvlqrSettings()
    return nearest_keeper(reference, parameters, sampled_model(parameters, settings.rate), flies=flies)


def loop_supervisor(settings: LoopSettings, limits: Limits, *, can_hold: bool = False) -> Supervisor:
    """Return a supervisor for one run within `limits`."""
    period = 1 / settings.rate
    reaction = (settings.drive.delay + 1) * period
    return Supervisor(settings.supervisor, period, limits.position, limits.acceleration, reaction, can_hold=can_hold)


def control_loop(
    parameters: ArmChainParameters,
    settings: LoopSettings,
    controller: Controller,
    *,
    limits: Limits,
    believed_delay: float | None = None,
    rate_noise: Array | None = None,
    sink: LoopSink | None = None,
    fallback: Fallback | None = None,
    progress: Progress = no_progress,
) -> ControlLoop:
    """Return a loop for any rig, simulated or real; believed_delay in periods, the drive's own by default.

    rate_noise (K, n) rad/s: see `ControlLoop`.
    """
    # The estimator believes in the sensors' resolution and noise.
    noise, model = settings.sensors.covariance(parameters.count), sampled_model(parameters, settings.rate)
    estimator = make_estimator(settings.estimator, model, noise=noise)
    delay = settings.drive.delay if believed_delay is None else believed_delay
    return ControlLoop(
        estimator,
        controller,
        path=CommandPath(limits, delay=delay, period=1 / settings.rate),
        supervisor=loop_supervisor(settings, limits, can_hold=fallback is not None),
        sink=NoSink() if sink is None else sink,
        rate_noise=rate_noise,
        fallback=fallback,
        progress=progress,
    )


def run_loop(
    reference: Reference,
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    controller: Controller | None = None,
    plant: ArmChainParameters | None = None,
    uncertainty: Uncertainty | None = None,
    sink: LoopSink | None = None,
    fallback: Fallback | None = None,
    progress: Progress = no_progress,
) -> LoopResult:
    """Track `reference` on a simulated bench, with `parameters` as the model of controller and estimator.

    controller, fallback: made before, by `loop_controller` and `loop_fallback` with the same settings, to spare making
    them for each of many seeds. plant: the arms to simulate; without it the model's, drawn from its `uncertainty` and
    mismatched by the settings.

    Raises:
        InputError: the reference did not converge, or is not one of these arms; an uncertainty is asked for and not
            known.
        GoalMissed: no controller can be made for it, or no plant drawn.
    """
    if controller is None:
        controller = loop_controller(reference, parameters, settings)
    if fallback is None:
        fallback = loop_fallback(reference, parameters, settings)
    limits, first = settings.limits(reference), controller.first_state
    if len(first) != 2 * parameters.count + 2:
        raise InputError(f"the controller is for states of {len(first)} entries, these arms have {parameters.count}")
    draw = settings.draw(parameters, ticks=controller.ticks + 1, uncertainty=uncertainty, plant=plant)
    loop = control_loop(
        parameters, settings, controller, limits=limits, rate_noise=draw.rate_noise, sink=sink, fallback=fallback,
        progress=progress,
    )  # fmt: skip
    rig = SimulatedRig(draw, settings.bench, limits=limits, start=first, queued=loop.queued)
    return replace(loop.run(rig), plant=draw.plant.arms)
