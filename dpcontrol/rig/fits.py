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
    """Return the least-squares solution.

    `design` is (K, p), and the values are (K,) or (K, n).
    """
    return np.asarray(np.linalg.lstsq(design, values, rcond=_INVISIBLE)[0], dtype=float)


class DriveFit(NamedTuple):
    """Fitted drive: delay and lag, s, gain, standard errors.

    misfit: unexplained fraction of the motion.
    """

    delay: float
    lag: float
    gain: float
    errors: tuple[float, float, float]
    misfit: float


def response(commands: Array, period: float, total: float, square: float = 0.0) -> Array:
    """Return the positions (K,) of a cart at rest that responds to commands (K,) m/s² with unit gain.

    The parameters are `total` s, the sum of delay and lag, and `square` s², that of the lag. The two are nearly
    independent even at zero lag, unlike delay and lag.
    """
    lag = math.sqrt(square)
    after = np.maximum(np.arange(len(commands)) * period - (total - lag), 0.0)
    fading = np.exp(-after / lag) if lag else np.where(after > 0, 0.0, 1.0)
    kernel = after**2 / 2 - lag * (after - lag * (1 - fading))
    return signal.fftconvolve(np.diff(commands, prepend=0.0), kernel)[: len(commands)]


_HIGH_PASS = 20.0
"""Corner frequency of the filter, Hz. Below it, positions become accelerations, in which command noise is white."""
_MARGIN = 0.5
"""Time before and after the chirp that the fit includes, s."""


def _high_passed(count: int, period: float) -> Callable[[Array], Array]:
    """Return a filter of `count` samples that leaves no constant, velocity or acceleration."""
    sections = signal.butter(2, min(_HIGH_PASS, 0.05 / period), "highpass", fs=1 / period, output="sos")
    skip = min(round(0.3 / period), count // 8)

    def passed(values: Array) -> Array:
        return np.asarray(signal.sosfilt(sections, values, axis=0), dtype=float)[skip:]

    base, _ = np.linalg.qr(passed(np.vander(np.linspace(-1, 1, count), 3)))

    def high(values: Array) -> Array:
        return passed(values) - base @ (base.T @ passed(values))

    return high


def fit_drive(carts: Array, commands: Sequence[float], period: float, *, first: int, last: int) -> DriveFit:
    """Fit delay, lag and gain of the drive.

    Args:
        carts: readings (K,), m.
        commands: command after each reading, m/s².
        period: control period, s.
        first: tick at which the chirp begins.
        last: tick at which it ends.
    """
    begin, end = max(first - round(_MARGIN / period), 0), min(last + round(_MARGIN / period), len(carts))
    x, u = carts[begin:end], np.array([*commands, 0.0])[begin:end]
    high = _high_passed(len(x), period)
    # In units of the motion itself, so that tolerances are relative.
    size = max(float(np.std(high(x))), 1e-9)
    y = high(x) / size

    def motion(total: float, gain: float, square: float) -> Array:
        """Return the motion for total in ms and square in ms²."""
        return gain * high(response(u, period, 1e-3 * total, 1e-6 * square)) / size

    def rough(total: float, lag: float) -> tuple[float, float, float, float]:
        """Return the cost of a delay and a lag in ms, the best gain, and both again."""
        p = motion(total, 1.0, lag**2)
        gain = float(p @ y) / max(float(p @ p), 1e-30)
        return float(np.sum((y - gain * p) ** 2)), gain, total, lag

    def fitted(values: Array, free: int) -> tuple[Array, Array]:
        """Return the best values of two or three free parameters and their standard errors."""
        bounds = np.array([-1e3 * period, -np.inf, 0.0]), np.array([800, np.inf, 90_000])
        fit = fit_windows(model, values, np.arange(free), bounds=bounds, settings=_DRIVE)
        return fit.values, np.sqrt(np.diag(fit.covariance()))

    delays = [0.5e3 * period + d for d in (0.0, *2.0 ** np.arange(8))]
    _, gain, total, lag = min(rough(d + lag, lag) for d in delays for lag in (0.0, 4.0, 16.0))
    model = DifferencedModel(lambda sets: np.array([y - motion(*values) for values in sets])[:, :, None])
    # Start inside the bounds, because a search would stay on them.
    values, errors = fitted(np.array([total, gain, max(lag, 0.5) ** 2]), 3)
    # Error of the square's root, which is non-negative.
    lag, lag_error = math.sqrt(values[2]), math.sqrt(values[2] + errors[2]) - math.sqrt(values[2])
    if values[2] < 3 * errors[2] or lag < _NO_LAG:
        # The lag is then zero and must not add to the uncertainty of the delay.
        lag, lag_error = 0.0, math.sqrt(values[2] + errors[2])
        values, errors = fitted(np.array([*values[:2], 0.0]), 2)
    total, gain, _ = values
    misfit = float(np.sqrt(np.mean((motion(*values) - y) ** 2) / max(np.mean(y**2), 1e-24)))
    delay_error = math.hypot(errors[0], lag_error if lag else 0.0)
    return DriveFit(1e-3 * (total - lag), 1e-3 * lag, gain, (1e-3 * delay_error, 1e-3 * lag_error, errors[1]), misfit)


_NO_LAG = 0.02
"""Lag below which it counts as zero, ms."""
_DRIVE = FitSettings(robust=1.5, least_scale=1e-9)
"""A late command disturbs the cart for a moment, so the loss is robust."""


class Modes(NamedTuple):
    """Normal modes of hanging arms.

    Frequencies (n,) rad/s, dampings (n,), shapes W_0 (n, n) by column.

    `vectors` (n, n) are the modes of unit mass, by column.
    """

    frequencies: Array
    dampings: Array
    shapes: Array
    vectors: Array


def modes(arms: ArmChainParameters) -> Modes:
    """Return the normal modes of hanging arms on an accelerated cart.

    Θ = shapes · y.

    Args:
        arms: parameters of the n arms.
    """
    n, base = arms.count, arms.base()
    weights, coupling = base[n * (n + 1) // 2 :][:n], base[n * (n + 1) // 2 + n :][:n]
    joints = np.linalg.inv(sums_of(n))
    drag = joints.T @ np.diag(arms.viscous) @ joints
    squares, vectors = linalg.eigh(np.diag(weights), arms.mass_in_line)
    frequencies = np.sqrt(squares)
    dampings = np.diag(vectors.T @ drag @ vectors) / (2 * frequencies)
    return Modes(frequencies, dampings, vectors * (vectors.T @ coupling), vectors)


def sums_of(n: int) -> Array:
    """Return the matrix that converts joint angles to absolute angles."""
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
    ratios, viscous, dry, place, speed = np.split(values.T, 5)
    mass = sums.T @ arms.mass_in_line @ sums
    shapes = sums.T @ arms.mass_in_line @ model.vectors
    inverse = np.linalg.inv(mass + period * np.eye(n) * viscous.T[:, :, None])
    stiffness = shapes @ ((model.frequencies[:, None] * np.exp(ratios.T[:, :, None])) ** 2 * shapes.T)
    step = np.concatenate([inverse @ mass, -period * inverse @ stiffness, -inverse], axis=2)
    jumps = np.diff(carts, prepend=carts[0], n=2) / period
    pushes = jumps[:, None, None] * (np.linalg.inv(sums) @ model.shapes.sum(axis=1))[:, None]
    # Sets lie side by side in each row, because numpy needs most of its time to begin an operation.
    most, least, held = list(period * dry), list(-period * dry), [*np.zeros_like(dry)]
    columns = [inverse[:, :, j].T.copy() for j in range(n)]
    sizes, out = [columns[j][j] for j in range(n)], np.empty((len(carts), *place.shape))
    out[0] = place
    for k, push in enumerate(pushes, start=1):
        speed = (step @ np.concatenate([speed - push, place, held]).T[:, :, None])[:, :, 0].T.copy()
        for j in [*range(n)] * _SWEEPS:
            torque = np.maximum(np.minimum(held[j] + speed[j] / sizes[j], most[j]), least[j])
            speed -= columns[j] * (torque - held[j])
            held[j] = torque
        place = place + period * speed
        out[k] = place
    return (sums @ out).transpose(2, 0, 1)


def _coarse_guess(costs: Callable[[Array], Array], guess: Array, n: int) -> Array:
    """Return the best of coarse grids of friction and frequencies, one parameter after the other, scaled."""
    dry = [[2 * n + k] for k in range(n)]
    # Friction can look like another frequency, so a frequency must improve the fit the more the farther it is away.
    for places in ([*range(2 * n, 3 * n)], *dry, *([k] for k in range(n)), *dry):
        tried, penalty = (_DETUNED, 1 + np.abs(_DETUNED)) if places[0] < n else (_DRY, np.ones(len(_DRY)))
        lanes = np.tile(guess, (len(tried), 1))
        lanes[:, places] = tried[:, None]
        guess = lanes[np.argmin(costs(lanes) * penalty)]
    return guess


def fit_swing(angles: Array, carts: Array, period: float, arms: ArmChainParameters) -> CommissioningSwing:
    """Fit frequencies, friction and first state of the arms to their readings.

    The readings can be any linear combination of the angles.

    Args:
        angles: readings (K, n) of the arms, rad.
        carts: readings (K,) of the cart, m.
        period: time between readings, s.
        arms: model of the arms.
    """
    n, every = arms.count, max(1, round(1 / (_ROWS * period)))
    rows, x, period = angles[::every], carts[::every] - carts[0], period * every
    weight = float(arms.base()[n * (n + 1) // 2 :][:n].max())
    unit = np.repeat([0.1, 1e-3 * weight, 1e-2 * weight, 0.05, 0.3], n)

    def left(values: Array) -> tuple[Array, Array]:
        """Return angles and a constant (P, K, n+1), and the residuals (P, K, n) of their best combinations."""
        motions = simulated_swings(values * unit, x, period, arms)
        designs = np.concatenate([motions, np.ones((len(values), len(rows), 1))], axis=2)
        return designs, np.array([design @ solved(design, rows) - rows for design in designs])

    start = np.concatenate([np.zeros(n), arms.viscous, np.zeros(3 * n)]) / unit
    # A fit from the model's frequencies and a friction that nearly holds the arms finds what a coarse search misses.
    starts = (
        start + np.repeat([0, 0, 1, 0, 0], n),
        _coarse_guess(lambda lanes: (left(lanes)[1] ** 2).sum(axis=(1, 2)), start, n),
    )

    bounds = np.repeat([[-5.0, 0.0, 0.0, -np.inf, -np.inf], [5.0, np.inf, np.inf, np.inf, np.inf]], n, axis=1)
    model, free = DifferencedModel(lambda sets: -left(sets)[1]), np.arange(5 * n)
    fits = [fit_windows(model, guess, free, bounds=(bounds[0], bounds[1]), settings=_SWING) for guess in starts]
    values = min(fits, key=lambda fit: float(np.square(fit.residuals).sum())).values
    designs, rest = left(values + STEP * np.eye(5 * n + 1, 5 * n, k=-1))
    weights = solved(designs[0], rows)
    motions = designs @ weights
    turned = np.moveaxis(motions[1:] - motions[0], 0, -1).reshape(-1, 5 * n) / STEP
    # Each reading has its own combination and zero.
    errors = _errors(np.hstack([turned, np.kron(designs[0], np.eye(n))]), -rest[0])
    ratios, viscous, dry, *_ = np.split(values * unit, 5)
    _, of_viscous, of_dry, *_ = np.split(errors[: 5 * n] * unit, 5)
    return CommissioningSwing(
        rows,
        designs[0, :, :n],
        turned,
        np.exp(ratios),
        (viscous, of_viscous),
        (dry, of_dry),
        (weights[-1], errors[-n:]),
    )


_SWING = FitSettings(robust=0.0, iterations=25, tolerance=1e-4)


def _errors(jacobian: NDArray[Any], residual: Array) -> Array:
    """Return standard errors (p,) for derivatives (K n, p) and residuals (K, n) that are correlated."""
    scores = (jacobian * residual.reshape(-1, 1)).reshape(*residual.shape, -1).sum(axis=1)
    return np.sqrt(np.diag(clustered_covariance(jacobian.T @ jacobian, [scores], [residual])))


class Form(StrEnum):
    """Relation between angles and encoders."""

    SUMMED = "joint encoders, summed"
    RELATIVE = "joint encoders, not summed"
    ABSOLUTE = "absolute encoders"
    TWICE = "absolute encoders, summed"


class Wiring(NamedTuple):
    """Wiring: form, order of the encoders, signs and factors (n,), unexplained fraction of the rms.

    The standard error (n,) of a factor that friction hides is infinite. It is NaN, and the factor 1, for an arm without
    an encoder.
    """

    form: Form
    order: tuple[int, ...]
    factors: Array
    misfit: float
    errors: Array

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Return True for each factor (n,) that is unknown."""
        return 3 * self.errors > FACTOR * np.maximum(np.abs(self.factors), 1)

    @property
    def stuck(self) -> NDArray[np.bool_]:
        """Return True for each encoder (n,) that stands still although its joint moves."""
        return (np.abs(self.factors) < STUCK) & ~self.unknown


FACTOR = 0.25
"""Maximum relative difference to the swing of the model, whose parameters are not exact."""
STUCK = 0.08
"""Fraction of the swing below which an encoder does not move."""
_CLEARLY = 0.6
"""A fault is reported if it leaves less than this fraction of the correct wiring's residual."""


def read_wiring(swing: CommissioningSwing, encoders: NDArray[np.bool_]) -> Wiring:
    """Return the wiring that fits the readings best.

    Args:
        swing: readings, and the motion of the fitted model.
        encoders: True for each arm (n,) with an encoder.
    """
    n, m = len(encoders), int(encoders.sum())
    sums, rest = sums_of(n), (swing.readings - swing.readings.mean(axis=0))[:, encoders]
    joints, one = np.linalg.inv(sums), np.eye(n)
    forms = {
        Form.SUMMED: (sums, joints),
        Form.ABSOLUTE: (one, one),
        Form.RELATIVE: (one, joints),
        Form.TWICE: (sums, one),
    }
    found: list[tuple[Wiring, Array]] = []
    for order in permutations(range(n)):
        for form, (after, before) in forms.items():
            inner = (swing.motion - swing.motion.mean(axis=0)) @ before[list(order)].T
            columns = (after[encoders] * inner[:, None]).reshape(-1, n)
            factors = solved(columns, rest.ravel())
            left = float(np.linalg.norm(rest.ravel() - columns @ factors) / max(np.linalg.norm(rest), 1e-12))
            errors = np.where(inner.std(axis=0) < LEAST_SWING, np.inf, 0.0)
            found.append((Wiring(form, order, factors, left, errors), columns))
    least = min(wiring.misfit for wiring, _ in found)
    nearest, columns = next(pair for pair in found if _CLEARLY * pair[0].misfit <= least + 1e-3)
    slopes = swing.slopes[np.tile(encoders, len(rest))]
    design = np.hstack([columns, slopes, np.kron(np.ones((len(rest), 1)), np.eye(m))])
    errors = _errors(design, rest - (columns @ nearest.factors).reshape(rest.shape))[:n]
    return nearest._replace(
        factors=np.where(encoders, nearest.factors, 1.0),
        errors=np.where(encoders, np.maximum(errors, nearest.errors), np.nan),
    )


_SPAN, _SHORTEST = 0.1, 0.06
"""Time before and after a reversal that shows the play, and its minimum, s."""
_DEGREE = 4
_LIKE = 20
"""Number of consecutive correlated residuals."""


def fit_play(angles: Array, period: float) -> tuple[float, float]:
    """Return the play of an encoder and its standard error, rad.

    The play is that between a joint and its encoder.

    An encoder stops when its joint reverses, and follows again once the joint has crossed the play. Apart from the
    play, the readings on both sides of this gap lie on one smooth curve. Friction bends that curve at the reversal.

    Args:
        angles: angles (K,) of the joint, as its encoder reads them, rad.
        period: time between readings, s.
    """
    noise = float(np.median(np.abs(np.diff(angles)))) / 0.954
    least, mark = max(0.5 * rounding(angles), 5 * noise, 1e-9), angles[0]
    ticks, sides = [], []
    for k, angle in enumerate(angles.tolist()):
        if abs(angle - mark) > least:
            ticks.append(k)
            sides.append(math.copysign(1.0, angle - mark))
            mark = angle
    turns = np.flatnonzero(np.diff(sides)) + 1
    plays, weights = [], []
    for before, turn, after in zip([0, *turns], turns, [*turns[1:], len(sides)], strict=False):
        first, last, begin, end = ticks[before], ticks[turn - 1], ticks[turn], ticks[after - 1]
        if min(last - first, end - begin) * period < _SHORTEST:
            continue
        span = round(_SPAN / period)
        rows = np.concatenate(
            [np.arange(max(first, last - span), last + 1), np.arange(begin, min(end, begin + span) + 1)]
        )
        place, since = np.linspace(-1, 1, rows[-1] - rows[0] + 1)[rows - rows[0]], (rows - last) * period
        side = np.where(rows <= last, -sides[turn], sides[turn])
        design = np.column_stack([side / -2, np.where(since > 0, since**2, 0.0), np.vander(place, _DEGREE + 1)])
        left = angles[rows] - design @ solved(design, angles[rows])
        variance = _LIKE * float(left @ left) / len(rows) * np.linalg.pinv(design.T @ design)[0, 0]
        plays.append(solved(design, angles[rows])[0])
        weights.append(1 / max(variance, 1e-16))
    if len(plays) < _REVERSALS:
        return math.nan, math.nan
    mean = float(np.average(plays, weights=weights))
    scatter = float(np.average((np.array(plays) - mean) ** 2, weights=weights))
    return mean, math.sqrt(scatter / len(plays) + 1 / sum(weights))


_REVERSALS = 4


def rounding(values: Array) -> float:
    """Return the rounding step of values, or 0 without one."""
    # Sums and differences of multiples have errors in their last digits.
    levels = np.unique(np.round(values, 9))
    gaps, span = np.diff(levels), float(np.ptp(levels))
    gaps = gaps[gaps > 5e-9]
    step = float(np.min(gaps, initial=np.inf))
    whole = np.abs(gaps / step - np.round(gaps / step)) < 0.02 + 2e-9 / step
    if len(gaps) < 5 or step < 1e-6 or whole.mean() < 0.95:
        return 0.0
    return span / round(span / step)
