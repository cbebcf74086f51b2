"""Fits to what a rig measures while its arms hang: the drive, the swing of the arms, their wiring and their play.

With commands u_j at ticks j, T apart, a drive of delay d, lag τ and gain γ moves the cart by

    x(t) = x_0 + v_0 t + γ Σ_j (u_j - u_{j-1}) p(t - j T - d),     p(s) = s²/2 - τ s + τ² (1 - e^{-s/τ})  for s > 0

Both sides are high-pass filtered, which removes the accumulated noise of the command. Then d, τ and γ are fitted to the
cart's readings by `dpcontrol.identification.windows`, like all parameters here.

Small swings of hanging arms follow the measured position x of the cart, so the drive has no effect. With joint angles φ
and the rate of each joint ρ

    M φ̈ + K φ + k ρ + c sgn ρ = -s ẍ,     readings = zeros + B L φ,     |torque| ≤ c where ρ = 0

The frequencies of M and K, viscous friction k, dry friction c and the first state are fitted with a free matrix B. The
readings cannot judge the encoder of a joint that friction holds. Encoders that are wired, scaled or summed wrongly give
a special B. Let L be the sums of joint angles, D a diagonal of signs and factors, and P an exchange of encoders. Then B
is L D P L⁻¹ (joint encoders, summed, as it should be), D P L⁻¹ (never summed), D P (absolute encoders) or L D P
(absolute angles summed again). The nearest form is reported.

Sources: Ljung, System identification (1999), sections 7.4 (output error) and 14.4 (prefilters). Golub & Pereyra,
Separable nonlinear least squares (2003). Moreau, Numerical aspects of the sweeping process (1999), for dry friction.
"""

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.parts import Later
from dpcontrol.identification.windows import STEP, DifferencedModel, FitSettings, clustered_covariance, fit_windows

linalg, signal = Later("scipy.linalg"), Later("scipy.signal")
_INVISIBLE = 1e-6
"""Share of the greatest motion that is due to rounding: a joint that friction holds does not move."""


def solved(design: Array, values: Array) -> Array:
    """Return the least-squares solution x (p,) or (p, n) of design · x = values.

    `design` is (K, p), and the values are (K,) or (K, n). A direction with hardly any motion gets the value zero.
    """
    return np.asarray(np.linalg.lstsq(design, values, rcond=_INVISIBLE)[0], dtype=float)


class DriveFit(NamedTuple):
    """Fitted drive, for comparison with the drive's settings in [run].

    Attributes:
        delay: time from a command to the beginning of its effect, s.
        lag: time constant of the velocity loop, s.
        gain: cart's acceleration over the command.
        errors: standard errors of the three.
        misfit: unexplained fraction of the motion.
    """

    delay: float
    lag: float
    gain: float
    errors: tuple[float, float, float]
    misfit: float


def response(commands: Array, period: float, total: float, square: float = 0.0) -> Array:
    """Return the positions (K,) of a cart at rest that responds to commands (K,) m/s² with unit gain.

    The parameters are `total`, the sum of delay and lag, s, and `square`, the square of the lag, s². The two are nearly
    independent even at zero lag, unlike delay and lag. `period` is the time between commands, s.
    """
    lag = math.sqrt(square)
    elapsed = np.maximum(np.arange(len(commands)) * period - (total - lag), 0.0)
    fading = np.exp(-elapsed / lag) if lag else np.where(elapsed > 0, 0.0, 1.0)
    # p(s) at the head of this module, for each tick after a jump of the command.
    kernel = elapsed**2 / 2 - lag * (elapsed - lag * (1 - fading))
    return signal.fftconvolve(np.diff(commands, prepend=0.0), kernel)[: len(commands)]


_HIGH_PASS = 20.0
"""Corner frequency of the filter, Hz. Below it, positions become accelerations, in which command noise is white."""
_MARGIN = 0.5
"""Time before and after the chirp that the fit includes, s."""


def _high_passed(count: int, period: float) -> Callable[[Array], Array]:
    """Return a filter of `count` samples that removes a constant, a constant velocity and a constant acceleration.

    The filter drops the samples at the beginning, in which it settles, and works on arrays (count,) or (count, m).
    `period` is the time between samples, s.
    """
    sections = signal.butter(2, min(_HIGH_PASS, 0.05 / period), "highpass", fs=1 / period, output="sos")
    skip = min(round(0.3 / period), count // 8)

    def filtered(values: Array) -> Array:
        """Apply the Butterworth filter, and drop the samples in which it settles."""
        return np.asarray(signal.sosfilt(sections, values, axis=0), dtype=float)[skip:]

    slow_motions, _ = np.linalg.qr(filtered(np.vander(np.linspace(-1, 1, count), 3)))

    def high_passed(values: Array) -> Array:
        """Return the filtered values without the filtered parabola that fits them best."""
        return filtered(values) - slow_motions @ (slow_motions.T @ filtered(values))

    return high_passed


def fit_drive(carts: Array, commands: Sequence[float], period: float, *, first: int, last: int) -> DriveFit:
    """Fit delay, lag and gain of the drive to the cart's motion during the chirp.

    A lag that is not significant is set to zero, and delay and gain are then fitted without it.

    Args:
        carts: readings (K,) of the cart's position, m.
        commands: command after each reading, m/s².
        period: control period, s.
        first: tick at which the chirp begins.
        last: tick at which the chirp ends.
    """
    start, end = max(first - round(_MARGIN / period), 0), min(last + round(_MARGIN / period), len(carts))
    positions, demands = carts[start:end], np.array([*commands, 0.0])[start:end]
    filtered = _high_passed(len(positions), period)
    # In units of the motion itself, so that tolerances are relative.
    motion_size = max(float(np.std(filtered(positions))), 1e-9)
    measured = filtered(positions) / motion_size

    def motion(total: float, gain: float, square: float) -> Array:
        """Return the filtered motion of the cart, relative to the measured size, for a drive.

        `total` is the sum of delay and lag, ms, `gain` that of the drive, and `square` the square of the lag, ms².
        """
        return gain * filtered(response(demands, period, 1e-3 * total, 1e-6 * square)) / motion_size

    def coarse_fit(total: float, lag: float) -> tuple[float, float, float, float]:
        """Return the cost of `total` (delay and lag together) and lag, both in ms, the best gain, and both again.

        The least of such tuples fits best.
        """
        unit_motion = motion(total, 1.0, lag**2)
        gain = float(unit_motion @ measured) / max(float(unit_motion @ unit_motion), 1e-30)
        return float(np.sum((measured - gain * unit_motion) ** 2)), gain, total, lag

    def refined(values: Array, free: int) -> tuple[Array, Array]:
        """Return the best values (3,) of total, gain and square, and the standard errors of the free ones.

        The first `free` of them are fitted from `values`, the others stay.
        """
        bounds = np.array([-1e3 * period, -np.inf, 0.0]), np.array([800, np.inf, 90_000])
        fit = fit_windows(model, values, np.arange(free), bounds=bounds, settings=_DRIVE)
        return fit.values, np.sqrt(np.diag(fit.covariance()))

    delays = [0.5e3 * period + d for d in (0.0, *2.0 ** np.arange(8))]
    _, gain, total, lag = min(coarse_fit(d + lag, lag) for d in delays for lag in (0.0, 4.0, 16.0))
    model = DifferencedModel(lambda sets: np.array([measured - motion(*values) for values in sets])[:, :, None])
    # Start inside the bounds, because a search would stay on them.
    values, errors = refined(np.array([total, gain, max(lag, 0.5) ** 2]), 3)
    # The error of a root of the square: the square itself may be zero, where the root has no derivative.
    lag, lag_error = math.sqrt(values[2]), math.sqrt(values[2] + errors[2]) - math.sqrt(values[2])
    if values[2] < 3 * errors[2] or lag < _NO_LAG:
        # The lag is then zero and must not add to the uncertainty of the delay.
        lag, lag_error = 0.0, math.sqrt(values[2] + errors[2])
        values, errors = refined(np.array([*values[:2], 0.0]), 2)
    total, gain, _ = values
    misfit = float(np.sqrt(np.mean((motion(*values) - measured) ** 2) / max(np.mean(measured**2), 1e-24)))
    delay_error = math.hypot(errors[0], lag_error if lag else 0.0)
    return DriveFit(1e-3 * (total - lag), 1e-3 * lag, gain, (1e-3 * delay_error, 1e-3 * lag_error, errors[1]), misfit)


_NO_LAG = 0.02
"""Lag below which it counts as zero, ms."""
_DRIVE = FitSettings(robust=1.5, least_scale=1e-9)
"""A late command disturbs the cart for a moment, so the loss is robust."""


class Modes(NamedTuple):
    """Normal modes of hanging arms.

    Attributes:
        frequencies: (n,), rad/s.
        dampings: damping ratios (n,) from viscous friction.
        shapes: shapes W_0 (n, n) by column, scaled by the cart's effect on each mode.
        vectors: modes (n, n) of unit mass, by column.
    """

    frequencies: Array
    dampings: Array
    shapes: Array
    vectors: Array


def modes(arms: ArmChainParameters) -> Modes:
    """Return the normal modes of hanging arms on an accelerated cart, as a reference for measured swings.

    The angles are Θ = shapes · y, each entry of y an oscillator that minus the cart's acceleration drives.

    Args:
        arms: parameters of the n arms.
    """
    n, base = arms.count, arms.base()
    weights, coupling = base[n * (n + 1) // 2 :][:n], base[n * (n + 1) // 2 + n :][:n]
    to_joints = np.linalg.inv(sums_of(n))
    drag = to_joints.T @ np.diag(arms.viscous) @ to_joints
    frequency_squares, vectors = linalg.eigh(np.diag(weights), arms.mass_in_line)
    frequencies = np.sqrt(frequency_squares)
    dampings = np.diag(vectors.T @ drag @ vectors) / (2 * frequencies)
    return Modes(frequencies, dampings, vectors * (vectors.T @ coupling), vectors)


def sums_of(n: int) -> Array:
    """Return the matrix (n, n) that converts joint angles to absolute angles."""
    return np.tril(np.ones((n, n)))


class CommissioningSwing(NamedTuple):
    """Swing of n arms in K readings, and the motion of the model that is nearest to it.

    Attributes:
        readings: readings (K, n), rad.
        motion: absolute angles (K, n) of the fitted model, rad.
        slopes: derivatives (K n, p) of the readings with respect to the fitted parameters.
        ratios: frequencies (n,) of the modes relative to the model.
        viscous: viscous friction (n,) of the joints, N m s/rad, and its standard errors.
        dry: dry friction (n,) of the joints, N m, and its standard errors.
        zeros: readings (n,) of hanging arms, rad, and their standard errors.
    """

    readings: Array
    motion: Array
    slopes: Array
    ratios: Array
    viscous: tuple[Array, Array]
    dry: tuple[Array, Array]
    zeros: tuple[Array, Array]


LEAST_SWING = 1e-3
"""Swing of a joint that is necessary to judge its encoder, rad rms."""
_DETUNED = np.linspace(-3, 3, 25)
"""Logarithms of the ratios of frequencies to try, in units of 0.1."""
_DRY = np.array([0.0, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0])
"""Dry friction to try, in percent of gravity's torque on the arms."""
_ROWS = 100.0
"""Sampling rate that is sufficient for slow swings, Hz."""
_SWEEPS = 3
"""Corrections of the dry torques in each step, which begin with those of the last step."""


def simulated_swings(values: Array, carts: Array, period: float, arms: ArmChainParameters) -> Array:
    """Return the angles (P, K, n) of hanging arms on a moving cart, with viscous and dry friction, rad.

    Rates of joints are found at the middle of each step, at which the dry torque of a joint either holds it or has its
    full size (Moreau's time stepping). All sets of values are simulated together.

    Args:
        values: P rows of 5n values: logarithms of the ratios of frequencies, viscous friction, N m s/rad, dry friction,
            N m, and first angles and rates of the joints.
        carts: positions (K,) of the cart, m.
        period: time between positions, s.
        arms: model of the arms, whose friction is ignored.
    """
    n, model = arms.count, modes(arms)
    sums = sums_of(n)
    # Equations of the joint angles φ = sums⁻¹ θ: M φ̈ + K φ + k ρ + c sgn ρ = -s ẍ, see the head of this module.
    ratios, viscous, dry, angles, rates = np.split(values.T, 5)
    mass = sums.T @ arms.mass_in_line @ sums
    shapes = sums.T @ arms.mass_in_line @ model.vectors
    inverse = np.linalg.inv(mass + period * np.eye(n) * viscous.T[:, :, None])
    stiffness = shapes @ ((model.frequencies[:, None] * np.exp(ratios.T[:, :, None])) ** 2 * shapes.T)
    step = np.concatenate([inverse @ mass, -period * inverse @ stiffness, -inverse], axis=2)
    jumps = np.diff(carts, prepend=carts[0], n=2) / period
    pushes = jumps[:, None, None] * (np.linalg.inv(sums) @ model.shapes.sum(axis=1))[:, None]
    # Sets of values lie side by side in each row, because numpy needs most of its time to begin an operation.
    largest, smallest, impulses = list(period * dry), list(-period * dry), [*np.zeros_like(dry)]
    # An impulse of dry friction, N m s, changes the rates by its joint's column of `inverse`.
    effects = [inverse[:, :, j].T.copy() for j in range(n)]
    own_effects, trajectory = [effects[j][j] for j in range(n)], np.empty((len(carts), *angles.shape))
    trajectory[0] = angles
    for k, push in enumerate(pushes, start=1):
        rates = (step @ np.concatenate([rates - push, angles, impulses]).T[:, :, None])[:, :, 0].T.copy()
        # The impulse that holds joint j, or its largest; joints affect each other, so all are corrected repeatedly.
        for j in [*range(n)] * _SWEEPS:
            impulse = np.maximum(np.minimum(impulses[j] + rates[j] / own_effects[j], largest[j]), smallest[j])
            rates -= effects[j] * (impulse - impulses[j])
            impulses[j] = impulse
        angles = angles + period * rates
        trajectory[k] = angles
    return (sums @ trajectory).transpose(2, 0, 1)


def _coarse_guess(costs: Callable[[Array], Array], guess: Array, n: int) -> Array:
    """Return the best values of coarse grids of dry friction and frequencies, one parameter after the other.

    They are the start of the fit, which would otherwise end in a local minimum. `costs` returns the costs (P,) of
    values (P, 5n), which are those of `simulated_swings` in the units of the fit. `guess` (5n,) is the start.
    """
    dry_places = [[2 * n + k] for k in range(n)]
    # Friction can look like another frequency, so a frequency must improve the fit the more the farther it is away.
    for entries in ([*range(2 * n, 3 * n)], *dry_places, *([k] for k in range(n)), *dry_places):
        candidates, penalty = (_DETUNED, 1 + np.abs(_DETUNED)) if entries[0] < n else (_DRY, np.ones(len(_DRY)))
        guesses = np.tile(guess, (len(candidates), 1))
        guesses[:, entries] = candidates[:, None]
        guess = guesses[np.argmin(costs(guesses) * penalty)]
    return guess


def fit_swing(angles: Array, carts: Array, period: float, arms: ArmChainParameters) -> CommissioningSwing:
    """Fit frequencies, friction and first state of the arms to their readings, whatever the wiring of the encoders.

    The readings can be any linear combination of the angles and a constant, which is found by least squares. Readings
    are used at `_ROWS` Hz.

    Args:
        angles: readings (K, n) of the arms, rad.
        carts: readings (K,) of the cart, m.
        period: time between readings, s.
        arms: model of the arms.
    """
    n, stride = arms.count, max(1, round(1 / (_ROWS * period)))
    rows, cart_positions, period = angles[::stride], carts[::stride] - carts[0], period * stride
    weight = float(arms.base()[n * (n + 1) // 2 :][:n].max())
    # Units of frequencies (logarithm of the ratio), viscous and dry friction, first angles, rad, and rates, rad/s.
    units = np.repeat([0.1, 1e-3 * weight, 1e-2 * weight, 0.05, 0.3], n)

    def combinations(values: Array) -> tuple[Array, Array]:
        """Return angles and a constant (P, K, n+1), and the residuals (P, K, n) of their best combinations.

        `values` are P rows of 5n values of `simulated_swings`, each in its unit (`units`). Readings `rows` (K, n), rad,
        are combinations of angles and constant.
        """
        motions = simulated_swings(values * units, cart_positions, period, arms)
        designs = np.concatenate([motions, np.ones((len(values), len(rows), 1))], axis=2)
        return designs, np.array([design @ solved(design, rows) - rows for design in designs])

    start = np.concatenate([np.zeros(n), arms.viscous, np.zeros(3 * n)]) / units
    # A fit from the model's frequencies and a friction that nearly holds the arms finds what a coarse search misses.
    guesses = (
        start + np.repeat([0, 0, 1, 0, 0], n),
        _coarse_guess(lambda lanes: (combinations(lanes)[1] ** 2).sum(axis=(1, 2)), start, n),
    )

    bounds = np.repeat([[-5.0, 0.0, 0.0, -np.inf, -np.inf], [5.0, np.inf, np.inf, np.inf, np.inf]], n, axis=1)
    model, free = DifferencedModel(lambda sets: -combinations(sets)[1]), np.arange(5 * n)
    fits = [fit_windows(model, guess, free, bounds=(bounds[0], bounds[1]), settings=_SWING) for guess in guesses]
    values = min(fits, key=lambda fit: float(np.square(fit.residuals).sum())).values
    designs, residuals = combinations(values + STEP * np.eye(5 * n + 1, 5 * n, k=-1))
    weights = solved(designs[0], rows)
    motions = designs @ weights
    slopes = np.moveaxis(motions[1:] - motions[0], 0, -1).reshape(-1, 5 * n) / STEP
    # Each reading has its own combination and zero.
    errors = _errors(np.hstack([slopes, np.kron(designs[0], np.eye(n))]), -residuals[0])
    ratios, viscous, dry, *_ = np.split(values * units, 5)
    _, of_viscous, of_dry, *_ = np.split(errors[: 5 * n] * units, 5)
    return CommissioningSwing(
        rows,
        designs[0, :, :n],
        slopes,
        np.exp(ratios),
        (viscous, of_viscous),
        (dry, of_dry),
        (weights[-1], errors[-n:]),
    )


_SWING = FitSettings(robust=0.0, iterations=25, tolerance=1e-4)


def _errors(jacobian: NDArray[Any], residual: Array) -> Array:
    """Return standard errors (p,) of fitted parameters from residuals (K, n) that are correlated in time.

    `jacobian` (K n, p) are the derivatives of the fit; a row belongs to one entry of the residuals, row by row.
    """
    scores = (jacobian * residual.reshape(-1, 1)).reshape(*residual.shape, -1).sum(axis=1)
    return np.sqrt(np.diag(clustered_covariance(jacobian.T @ jacobian, [scores], [residual])))


class Form(StrEnum):
    """Relation between the arms' angles and their encoders' readings, as a rig may be wired or programmed."""

    SUMMED = "joint encoders, summed"
    RELATIVE = "joint encoders, not summed"
    ABSOLUTE = "absolute encoders"
    TWICE = "absolute encoders, summed"


class Wiring(NamedTuple):
    """How encoders are wired, as far as the swing of the arms shows it.

    Attributes:
        form: relation between angles and encoders.
        order: arm (n,) whose angle each encoder measures.
        factors: sign and factor (n,) of each encoder, 1 if it is right or missing.
        misfit: unexplained fraction of the rms.
        errors: standard error (n,) of each factor, infinite if friction hides it, NaN without an encoder.
    """

    form: Form
    order: tuple[int, ...]
    factors: Array
    misfit: float
    errors: Array

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """True for each encoder (n,) whose factor is too uncertain to be judged."""
        return 3 * self.errors > FACTOR * np.maximum(np.abs(self.factors), 1)

    @property
    def stuck(self) -> NDArray[np.bool_]:
        """True for each encoder (n,) that stands still although its joint moves."""
        return (np.abs(self.factors) < STUCK) & ~self.unknown


FACTOR = 0.25
"""Maximum relative difference to the swing of the model, whose parameters are not exact."""
STUCK = 0.08
"""Fraction of the swing below which an encoder does not move."""
_CLEARLY = 0.6
"""A fault is reported if it leaves less than this fraction of the correct wiring's residual."""


def read_wiring(swing: CommissioningSwing, encoders: NDArray[np.bool_]) -> Wiring:
    """Return the wiring that fits the readings best, for the findings about the encoders.

    All forms and orders of the encoders are tried, each with its best factors. The correct wiring, which is the first,
    is preferred unless another one fits clearly better (`_CLEARLY`).

    Args:
        swing: readings, and the motion of the fitted model.
        encoders: True for each arm (n,) with an encoder.
    """
    n, m = len(encoders), int(encoders.sum())
    sums, centred = sums_of(n), (swing.readings - swing.readings.mean(axis=0))[:, encoders]
    joints, identity = np.linalg.inv(sums), np.eye(n)
    forms = {
        Form.SUMMED: (sums, joints),
        Form.ABSOLUTE: (identity, identity),
        Form.RELATIVE: (identity, joints),
        Form.TWICE: (sums, identity),
    }
    candidates: list[tuple[Wiring, Array]] = []
    for order in permutations(range(n)):
        for form, (outer, inner_map) in forms.items():
            encoder_angles = (swing.motion - swing.motion.mean(axis=0)) @ inner_map[list(order)].T
            columns = (outer[encoders] * encoder_angles[:, None]).reshape(-1, n)
            factors = solved(columns, centred.ravel())
            misfit = float(np.linalg.norm(centred.ravel() - columns @ factors) / max(np.linalg.norm(centred), 1e-12))
            errors = np.where(encoder_angles.std(axis=0) < LEAST_SWING, np.inf, 0.0)
            candidates.append((Wiring(form, order, factors, misfit, errors), columns))
    least_misfit = min(wiring.misfit for wiring, _ in candidates)
    nearest, columns = next(pair for pair in candidates if _CLEARLY * pair[0].misfit <= least_misfit + 1e-3)
    slopes = swing.slopes[np.tile(encoders, len(centred))]
    design = np.hstack([columns, slopes, np.kron(np.ones((len(centred), 1)), np.eye(m))])
    errors = _errors(design, centred - (columns @ nearest.factors).reshape(centred.shape))[:n]
    return nearest._replace(
        # An arm without an encoder has no wrong factor.
        factors=np.where(encoders, nearest.factors, 1.0),
        errors=np.where(encoders, np.maximum(errors, nearest.errors), np.nan),
    )


_SPAN, _SHORTEST = 0.1, 0.06
"""Time before and after a reversal that shows the play, and its minimum, s."""
_DEGREE = 4
_LIKE = 20
"""Number of consecutive correlated residuals."""


def fit_play(angles: Array, period: float) -> tuple[float, float]:
    """Return the play between a joint and its encoder and its standard error, rad.

    An encoder stops when its joint reverses, and follows again once the joint has crossed the play. Apart from the
    play, the readings on both sides of this gap lie on one smooth curve. Friction bends that curve at the reversal.
    With fewer than `_REVERSALS` reversals, both results are NaN.

    Args:
        angles: angles (K,) of the joint, as its encoder reads them, rad.
        period: time between readings, s.
    """
    # The median of absolute differences of white noise is 0.954 times its standard deviation.
    noise = float(np.median(np.abs(np.diff(angles)))) / 0.954
    least_change, last_angle = max(0.5 * rounding(angles), 5 * noise, 1e-9), angles[0]
    ticks, directions = [], []
    for k, angle in enumerate(angles.tolist()):
        if abs(angle - last_angle) > least_change:
            ticks.append(k)
            directions.append(math.copysign(1.0, angle - last_angle))
            last_angle = angle
    reversals = np.flatnonzero(np.diff(directions)) + 1
    plays, weights = [], []
    for previous_turn, turn, next_turn in zip(
        [0, *reversals], reversals, [*reversals[1:], len(directions)], strict=False
    ):
        first, last, begin, end = ticks[previous_turn], ticks[turn - 1], ticks[turn], ticks[next_turn - 1]
        if min(last - first, end - begin) * period < _SHORTEST:
            continue
        span = round(_SPAN / period)
        samples = np.concatenate(
            [np.arange(max(first, last - span), last + 1), np.arange(begin, min(end, begin + span) + 1)]
        )
        scaled_times, time_after_reversal = (
            np.linspace(-1, 1, samples[-1] - samples[0] + 1)[samples - samples[0]],
            (samples - last) * period,
        )
        sides = np.where(samples <= last, -directions[turn], directions[turn])
        # The play between the sides, the bend by friction, and a polynomial of degree `_DEGREE`.
        design = np.column_stack(
            [
                sides / -2,
                np.where(time_after_reversal > 0, time_after_reversal**2, 0.0),
                np.vander(scaled_times, _DEGREE + 1),
            ]
        )
        residuals = angles[samples] - design @ solved(design, angles[samples])
        variance = _LIKE * float(residuals @ residuals) / len(samples) * np.linalg.pinv(design.T @ design)[0, 0]
        plays.append(solved(design, angles[samples])[0])
        weights.append(1 / max(variance, 1e-16))
    if len(plays) < _REVERSALS:
        return math.nan, math.nan
    mean = float(np.average(plays, weights=weights))
    scatter = float(np.average((np.array(plays) - mean) ** 2, weights=weights))
    return mean, math.sqrt(scatter / len(plays) + 1 / sum(weights))


_REVERSALS = 4


def rounding(values: Array) -> float:
    """Return the rounding step of values (K,), by which an encoder's counts are recognised, or 0 without one.

    The step is the smallest gap between distinct values. Nearly all gaps must be multiples of it.
    """
    # Sums and differences of multiples have errors in their last digits.
    distinct = np.unique(np.round(values, 9))
    gaps, span = np.diff(distinct), float(np.ptp(distinct))
    gaps = gaps[gaps > 5e-9]
    step = float(np.min(gaps, initial=np.inf))
    is_multiple = np.abs(gaps / step - np.round(gaps / step)) < 0.02 + 2e-9 / step
    if len(gaps) < 5 or step < 1e-6 or is_multiple.mean() < 0.95:
        return 0.0
    return span / round(span / step)
