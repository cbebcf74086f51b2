"""The closed loop: sensors, estimator, controller, drive and plant, tick by tick.

At tick k the positions are measured and the estimate updated; the command computed then acts from tick k + delay
to the next. It is computed for the estimate predicted to that tick through the commands on their way. All that is
random (plant, first state) comes from the seed; the estimator knows of the drive what it applied.
"""

import math
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.ekf import Ekf, EkfSettings, encoder_noise, nis_band
from dpcontrol.control.interface import Mode
from dpcontrol.control.sampled import SampledModel
from dpcontrol.control.tracking import Controller, ControllerSettings, TvlqrSettings, tracking_controller
from dpcontrol.dynamics.arm_chain import Level, arm_chain_equations
from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import Progress, no_progress
from dpcontrol.lab.bench import Drive, Encoders, Plant, SensorSettings
from dpcontrol.lab.result import Ending, LoopResult, LoopSink, NoSink
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

LOST_TRACKING = 1.5
"""Mean over about a second of the largest angle error, in rad, from which no feedback returns: half a turn is π,
and a completed period asks for 0.1."""
LOST_ESTIMATE = 1e4
"""Mean NIS over about 0.2 s: a hundred standard deviations, where a filter with a model wrong by a fifth shows ten."""
_TRACKING_MEMORY = 1.0
_ESTIMATE_MEMORY = 0.2
_PROGRESS_EVERY = 500


@dataclass(frozen=True)
class LoopSettings:
    """A run: rate Hz; delay in whole periods; initial_error rad, uniform ± on each angle of the true first state;
    mismatch of the plant's parameters (share); seed of both.
    """

    seed: int
    rate: float = 1000.0
    delay: int = 1
    initial_error: float = 0.0
    mismatch: float = 0.0
    controller: ControllerSettings = field(default_factory=TvlqrSettings)
    estimator: EkfSettings = field(default_factory=EkfSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)

    def __post_init__(self) -> None:
        """Refuse an impossible run.

        Raises:
            InputError: names the setting, its value and what is allowed.
        """
        if not np.isfinite(self.rate) or not 1 <= self.rate <= 10_000:
            raise InputError(f"run: rate = {self.rate!r}: must be 1 to 10000 Hz")
        if not 0 <= self.delay <= 1000:
            raise InputError(f"run: delay = {self.delay!r}: must be 0 to 1000 periods")
        if self.seed < 0:
            raise InputError(f"run: seed = {self.seed!r}: must be zero or positive")
        for name, most in (("initial_error", np.pi), ("mismatch", 0.9)):
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise InputError(f"run: {name} = {value!r}: must be 0 to {most:.2g}")


def sampled_model(parameters: ArmChainParameters, rate: float) -> SampledModel:
    """Return the cart-level model of these arms between ticks at `rate` Hz."""
    equations = arm_chain_equations(parameters.count, Level.CART)
    return SampledModel(equations, parameters.base(), period=1 / rate)


@dataclass
class _Watch:
    """Decides when going on is pointless."""

    period: float
    error: float = 0.0
    nis: float = 0.0

    def ending(self, error: float, nis: float, time_s: float) -> tuple[Ending, str] | None:
        if not math.isfinite(nis):
            return Ending.ESTIMATE_LOST, f"estimate lost at t = {time_s:.3f} s: it is no longer finite"
        self.error += (error - self.error) * min(self.period / _TRACKING_MEMORY, 1.0)
        self.nis += (nis - self.nis) * min(self.period / _ESTIMATE_MEMORY, 1.0)
        if self.nis > LOST_ESTIMATE:
            return Ending.ESTIMATE_LOST, (
                f"estimate lost at t = {time_s:.3f} s: mean NIS {self.nis:.3g} where 3 or so is expected; check the "
                "model's parameters, or assume more noise"
            )
        if self.error > LOST_TRACKING:
            return Ending.TRACKING_LOST, (
                f"tracking lost at t = {time_s:.3f} s: an angle has stayed {self.error:.2g} rad from the reference"
            )
        return None


def run_loop(
    reference: Reference,
    parameters: ArmChainParameters,
    *,
    settings: LoopSettings,
    controller: Controller | None = None,
    plant: ArmChainParameters | None = None,
    sink: LoopSink | None = None,
    progress: Progress = no_progress,
) -> LoopResult:
    """Track `reference` on a simulated bench, with `parameters` as the model of controller and estimator.

    controller: one made before, by `tracking_controller` with the same settings, to spare making it for each of
    many seeds. plant: the arms to simulate; without it the model's, mismatched by the settings.

    Raises:
        InputError: the reference did not converge, or is not one of these arms.
        GoalMissed: no controller can be made for it.
    """
    out = NoSink() if sink is None else sink
    model = sampled_model(parameters, settings.rate)
    if controller is None:
        controller = tracking_controller(reference, model, settings.controller)
    wanted = controller.reference_states
    n, arms, period = model.dimension, model.arms, model.period
    if wanted.ndim != 2 or wanted.shape[1] != n:
        raise InputError(f"the controller is for states of shape {wanted.shape[1:]}, these arms have ({n},)")
    # One stream for each use, so that a change of one setting leaves the other's draw as it was.
    plant_random, start_random = (np.random.default_rng(s) for s in np.random.SeedSequence(settings.seed).spawn(2))
    true_arms = plant or parameters.mismatched(settings.mismatch, plant_random)
    bench = Plant(model.equations, true_arms.base())
    encoders, drive = Encoders(arms, settings.sensors), Drive(reference.limits, period)
    noise = encoder_noise(arms, counts=settings.sensors.counts, cart_resolution=settings.sensors.cart_resolution)
    ekf = Ekf(model, settings.estimator, noise=noise)
    truth = wanted[0].copy()
    truth[:arms] += start_random.uniform(-settings.initial_error, settings.initial_error, arms)
    estimate = ekf.first(wanted[0])

    count = len(wanted)
    wanted_angles = wanted[:, :arms].tolist()
    times = np.arange(count) * period
    rows_measured, rows_truth = np.empty((count, arms + 1)), np.empty((count, n))
    rows_estimate, rows_control = np.empty((count, n)), np.empty((count, 7 + n))
    most = reference.limits.acceleration
    pending = deque(min(max(controller.command(k, wanted[k])[0], -most), most) for k in range(settings.delay))
    applied, was_saturated = 0.0, False
    watch = _Watch(period)
    ending, reason = Ending.FINISHED, "came to the reference's end"
    out.event(0.0, "info", "start", f"{controller.kind}, {count - 1} ticks at {settings.rate:g} Hz")
    began = time.perf_counter()
    k = 0
    for k in range(count):
        now = k * period
        measured = encoders.measure(truth)
        try:
            if k:
                estimate = ekf.predict(estimate, applied)
            estimate = ekf.update(estimate, measured)
            nis = estimate.nis
        except ArithmeticError:
            nis = math.nan
        x, position, velocity = estimate.state, float(truth[n - 2]), float(truth[n - 1])
        error = max(abs(a - b) for a, b in zip(truth[:arms].tolist(), wanted_angles[k], strict=True))
        lost = watch.ending(error, nis, now)
        if lost is None:
            feedforward, feedback = controller.command(k + settings.delay, model.ahead(x, pending))
        else:
            feedforward = feedback = 0.0
        command = feedforward + feedback
        pending.append(min(max(command, -most), most))
        applied = drive.applied(pending.popleft(), velocity)
        saturated = abs(command) > most or abs(velocity + applied * period) >= drive.limits.velocity
        mode = Mode.ABORTED if lost else Mode.SATURATED if saturated else Mode.TRACKING
        row = rows_control[k]
        row[:7] = (command, feedforward, feedback, applied, saturated, nis, mode)
        np.sqrt(estimate.covariance.diagonal(), out=row[7:])
        rows_measured[k], rows_truth[k], rows_estimate[k] = measured, truth, x
        out.tick(now, measured=measured, estimate=x, reference=wanted[k], truth=truth, control=row)
        if saturated and not was_saturated:
            out.event(now, "warn", "saturated", f"command {command:.3g} m/s², applied {applied:.3g} m/s²")
        was_saturated = saturated
        if lost is None and drive.at_stop(position):
            lost = (
                Ending.CART_STOP,
                (
                    f"cart at its stop at t = {now:.3f} s: {position:.3f} m; weigh its position more, or "
                    "allow more travel"
                ),
            )
        if lost is None and k < count - 1:
            try:
                truth = bench.after(truth, applied, period)
            except ArithmeticError as failure:
                lost = Ending.PLANT_FAILED, f"plant failed at t = {now:.3f} s: {failure}"
        if lost is not None:
            ending, reason = lost
            break
        if k % _PROGRESS_EVERY == 0:
            progress("run", k / count)
    elapsed = time.perf_counter() - began
    done = k + 1
    out.event(float(times[k]), "info" if ending is Ending.FINISHED else "error", ending.value, reason)
    progress("run", 1.0)
    control = rows_control[:done]
    low, high = nis_band(arms + 1)
    away = rows_truth[:done, :arms] - wanted[:done, :arms]
    return LoopResult(
        times=np.asarray(times[:done], dtype=np.float64),
        measured=rows_measured[:done],
        estimates=rows_estimate[:done],
        references=wanted[:done],
        truth=rows_truth[:done],
        control=control,
        ending=ending,
        reason=reason,
        nis_inside_95=float(((control[:, 5] >= low) & (control[:, 5] <= high)).mean()),
        rms_tracking_error=float(np.sqrt((away**2).mean())),
        max_cart_position=float(np.abs(rows_truth[:done, n - 2]).max()),
        rms_cart_acceleration=float(np.sqrt((control[:, 3] ** 2).mean())),
        rms_feedback=float(np.sqrt((control[:, 2] ** 2).mean())),
        real_time_factor=float(times[k] + period) / max(elapsed, 1e-9),
        plant=true_arms,
    )
