"""Fit of ratios, zeros and initial states to swings.

Parameter ratios and encoder zeros are fitted by the multiple shooting of `dpcontrol.identification.windows`. With
windows of half a second, the fit tolerates a poor first guess and chaotic swings.

Many swings are integrated at once, with their sensitivities to start and parameters:

    x_{k+1} = F(x_k, p; u),    S_{k+1} = ∂F/∂x S_k + [0  ∂F/∂p],    S = [∂x/∂x_0  ∂x/∂p]

F is one classical Runge-Kutta step (order 4), and p are the ratios of `dpcontrol.dynamics.chain`. The cart is clamped
or follows a given acceleration. F is compiled once per process, for as many swings as fit in the processor's vectors.

Source: Hairer, Nørsett, Wanner, Solving ordinary differential equations I (1993), section I.14.

*Design* finds the most informative recordings for a model, among free swings from rest and swings driven by the cart.

    I = 1/σ² (J_pᵀJ_p - J_pᵀJ_x (J_xᵀJ_x)⁻¹ J_xᵀJ_p),     digits = ½ log₁₀(det I) / f          (D-optimality)

J_p are the derivatives of all sampled angles with respect to the logarithms of the f ratios in use. J_x are those with
respect to start and encoder zeros, which differ between recordings. σ is the rounding of one encoder. 10^-digits is the
geometric mean of the relative standard errors due to independent rounding alone. Real errors are larger, but the
ranking is similar. Swings that greatly amplify an error of their start appear the most informative but are unreliable,
so they are marked as not usable.

Sources: Atkinson, Donev, Tobias, Optimum experimental designs, with SAS (2007), chapter 10. Swevers et al., Optimal
robot excitation and identification (1997).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise, product
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import (
    ArmChainParameters,
    Level,
    base_from_ratios,
    base_ratios,
    equations_of,
    inertial_count,
    ratio_names,
)
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import runge_kutta_4
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief
from dpcontrol.identification.windows import FitSettings, Linearised, LinearisedStretch, WindowedFit, fit_windows
from dpcontrol.recordings.recording import smoothed_derivative

LONGEST_STEP = 2e-3
"""Integration step, s. Steps of 1 ms err by 1e-7 rad at the rig's rates, mostly at sign changes of Coulomb friction."""
_CLOSED = 1e-12
"""Gap between windows that is due to rounding, rad or rad/s."""


class Swings:
    """Integrator for swings of arms and their sensitivities, which a fit of start and parameters needs.

    The arms have the count, gravity and friction laws of `arms`. Each call sets the values of the parameters. An
    instance must not be shared between threads.
    """

    def __init__(self, arms: ArmChainParameters) -> None:
        self.arms = arms
        self.states = 2 * arms.count
        self.parameters = len(ratio_names(arms))

    def flown(
        self,
        starts: Array,
        parameters: Array,
        *,
        period: Array,
        samples: int,
        accelerations: Array | float = 0.0,
        velocities: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """Return states (W, K, N) and sensitivities (W, K, N, N+m) of W swings, integrated together from their starts.

        The sensitivities are derivatives of each state by the swing's start (N,) and by the ratios (m,).

        Args:
            starts: initial states (W, N).
            parameters: ratios (m,).
            period: sampling periods (W,), s.
            samples: number of samples K.
            accelerations: cart accelerations (W, K), m/s², constant between samples.
            velocities: cart velocities (W, K) at the samples, m/s.
        """
        count, n, m = len(starts), self.states, self.parameters
        rows = n + n * (n + m)
        # All swings have the same number of substeps, that of the longest period.
        substeps = int(np.ceil(period.max() / LONGEST_STEP - 1e-9))
        inputs, following = np.empty((rows + m + 3, count)), np.empty((rows, count))
        # Rows: state, sensitivities column by column, ratios, step, then acceleration and velocity of the cart.
        inputs[:n] = starts.T
        inputs[n:rows] = np.eye(n, n + m).T.reshape(-1, 1)
        inputs[rows : rows + m] = parameters[:, None]
        inputs[rows + m] = period / substeps
        u, v = (np.broadcast_to(values, (count, samples)) for values in (accelerations, velocities))
        history = np.empty((samples, rows, count))
        step = _compiled(_nominal(self.arms))
        history[0] = inputs[:rows]
        for k in range(1, samples):
            inputs[rows + m + 1], inputs[rows + m + 2] = u[:, k - 1], v[:, k - 1]
            for _ in range(substeps):
                step(inputs, following)
                inputs[:rows] = following
                # Under a constant acceleration the cart's velocity grows from substep to substep.
                inputs[rows + m + 2] += inputs[rows + m] * inputs[rows + m + 1]
            history[k] = following
        states = history[:, :n].transpose(2, 0, 1)
        return states, history[:, n:].reshape(samples, n + m, n, count).transpose(3, 0, 2, 1)


def _nominal(arms: ArmChainParameters) -> ArmChainParameters:
    """Return arms with the count, gravity, friction laws and smoothing of `arms`, and all other parameters 1.

    Arms that differ only in the latter have the same compiled step, whose parameters are inputs.
    """
    names = ("mass", "centre_of_mass", "length", "inertia", "viscous", *arms.friction)
    return replace(arms, **dict.fromkeys(names, (1.0,) * arms.count))


@cache
def _compiled(arms: ArmChainParameters) -> Compiled:
    """Return the compiled Runge-Kutta step of state and sensitivities, of all swings at once.

    It maps (x, vec S, p, (h, u, v)) to (x, vec S), see the head of this module; h is the step, u and v are acceleration
    and velocity of the cart. Compiling takes longer than most fits.
    """
    n, m = 2 * arms.count, len(ratio_names(arms))
    rate = equations_of(arms, Level.CART).function()
    start, ratios, drive = ca.SX.sym("x", n), ca.SX.sym("p", m), ca.SX.sym("drive", 3)
    h, u, velocity = drive[0], drive[1], drive[2]
    base = ca.vertcat(*base_from_ratios(ratios, arms))

    def slope(state: ca.SX, after: Any) -> ca.SX:
        """Return the rate of the arms' state, angles and angle rates, at a time within the Runge-Kutta step.

        `after` is the time since the beginning of the step, s, a number or a symbolic fraction of h. By then the cart's
        `velocity` at the beginning has changed by its acceleration u times that time. `base` are the base parameters
        that belong to the ratios.
        """
        return rate(ca.vertcat(state, 0, velocity + after * u), u, base)[:n]

    following = runge_kutta_4(slope, start, h)
    sensitivity = ca.SX.sym("S", n, n + m)
    next_sensitivity = ca.jacobian(following, start) @ sensitivity + ca.horzcat(
        ca.SX.zeros(n, n), ca.jacobian(following, ratios)
    )
    next_values = ca.cse(ca.densify(ca.vertcat(following, ca.vec(next_sensitivity))))
    return Compiled(ca.Function("swing", [ca.vertcat(start, ca.vec(sensitivity)), ratios, drive], [next_values]))


@dataclass(frozen=True, eq=False)
class Swing(Brief):
    """K measured samples of one uninterrupted swing, to which states and ratios are fitted."""

    angles: Array
    """Absolute angles (K, n) from hanging, rad; NaN where a reading is missing."""
    period: float
    """Sampling period, s."""
    group: int = 0
    """Index of the swings that share their encoders' zeros."""
    accelerations: Array | float = 0.0
    """Of the cart (K,), m/s²; 0 if it is clamped."""
    velocities: Array | float = 0.0
    """Of the cart (K,), m/s."""

    @property
    def drive(self) -> Array:
        """Accelerations, m/s², and velocities, m/s, of the cart at each sample (2, K)."""
        return np.stack([np.broadcast_to(values, len(self.angles)) for values in (self.accelerations, self.velocities)])

    def edges(self, length: float) -> NDArray[np.intp]:
        """Return the samples at which shooting windows of about `length` s begin and end (windows + 1,).

        Args:
            length: duration of a window, s.
        """
        count = len(self.angles)
        pieces = max(round((count - 1) / max(round(length / self.period), 2)), 1)
        return np.linspace(0, count - 1, pieces + 1).round().astype(int)

    def guess(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Return states (R, 2n) from the measured angles, as first guesses of the windows' starts.

        Missing angles are interpolated, and rates come from a local polynomial.

        Args:
            rows: samples (R,).
        """
        angles = filled(self.angles)
        return np.hstack([angles[rows], smoothed_derivative(angles, self.period)[rows]])


def filled(angles: Array) -> Array:
    """Return angles (K, n) with missing ones interpolated, or zero if there is none.

    Args:
        angles: angles (K, n), rad; NaN where a reading is missing.
    """
    complete = np.zeros_like(angles)
    for column, values in zip(complete.T, angles.T, strict=True):
        finite = np.flatnonzero(np.isfinite(values))
        if len(finite):
            column[:] = np.interp(np.arange(len(values)), finite, values[finite])
    return complete


class Windows:
    """All swings, cut into windows of about `length` s that are integrated together: the model of `fit_windows`.

    Attributes:
        windows: windows of each swing, by number.
        first: row of its swing at which each window begins.
        last: row of its swing at which each window ends.
        samples: samples K of the longest window.
        periods: sampling period of each window (W,), s.
        drive: the cart's accelerations, m/s², and velocities, m/s (2, W, K), zero after the end of a window.
    """

    def __init__(self, swings: list[Swing], model: Swings, length: float) -> None:
        self.swings, self.model = swings, model
        edges = [swing.edges(length) for swing in swings]
        counts = [len(rows) - 1 for rows in edges]
        self.windows: Sequence[range] = [range(begin, end) for begin, end in pairwise(np.cumsum([0, *counts]).tolist())]
        self.first, self.last = (
            np.concatenate(rows)
            for rows in zip(*((swing_edges[:-1], swing_edges[1:]) for swing_edges in edges), strict=True)
        )
        self.samples = int((self.last - self.first).max()) + 1
        self.periods = np.repeat([swing.period for swing in swings], counts)
        self.drive = np.zeros((2, len(self.first), self.samples))
        for swing, windows in zip(swings, self.windows, strict=True):
            for w in windows:
                rows = slice(self.first[w], self.last[w] + 1)
                self.drive[:, w, : rows.stop - rows.start] = swing.drive[:, rows]

    def guess(self) -> Array:
        """Return the windows' starts (W, 2n) from the measured angles, as a first guess."""
        pairs = zip(self.swings, self.windows, strict=True)
        return np.concatenate([swing.guess(self.first[w.start : w.stop]) for swing, w in pairs])

    def linearised(self, starts: Array, values: Array, unknowns: NDArray[np.intp]) -> Linearised:
        """Integrate all windows and chain their derivatives along each swing, as Gauss-Newton steps require.

        Args:
            starts: initial states (W, 2n) of the windows.
            values: values (V,): the ratios (m,), then the zeros of each group of swings (groups · n), rad.
            unknowns: indices (f,) of the free ones.
        """
        model = self.model
        # Here n is the number of states of the arms, twice the number of arms.
        n, m, arms = model.states, model.parameters, model.arms.count
        u, v = self.drive
        states, slopes = model.flown(
            starts, values[:m], period=self.periods, samples=self.samples, accelerations=u, velocities=v
        )
        zeros, is_ratio = values[m:].reshape(-1, arms), unknowns < m
        linearised = Linearised([], finite=bool(np.isfinite(states).all() and np.isfinite(slopes).all()))
        for swing, windows in zip(self.swings, self.windows, strict=True):
            shape = swing.angles.shape
            stretch = LinearisedStretch(np.empty(shape), np.empty(shape), np.zeros((*shape, n + len(unknowns))), [], [])
            # A window's start is N_j (x_0, p) + d_j, see `dpcontrol.identification.windows`.
            start_slope, offset = np.eye(n, n + len(unknowns)), np.zeros(n)
            for w in windows:
                stretch.nodes.append(start_slope)
                stretch.offsets.append(offset)
                rows, k = slice(self.first[w], self.last[w] + 1), self.last[w] - self.first[w]
                jacobian = slopes[w, : k + 1, :arms]
                stretch.residual[rows] = swing.angles[rows] - states[w, : k + 1, :arms] - zeros[swing.group]
                stretch.reduced[rows] = stretch.residual[rows] - jacobian[..., :n] @ offset
                stretch.slope[rows] = jacobian[..., :n] @ start_slope
                stretch.slope[rows, :, n:][..., is_ratio] += jacobian[..., n + unknowns[is_ratio]]
                end = slopes[w, k]
                start_slope, offset = end[:, :n] @ start_slope, end[:, :n] @ offset
                start_slope[:, n:][:, is_ratio] += end[:, n + unknowns[is_ratio]]
                # The next window should start at the end of this one.
                if w != windows[-1]:
                    jump = states[w, k] - starts[w + 1]
                    offset = offset + jump
                    linearised.gaps += float(np.maximum(np.abs(jump) - _CLOSED, 0.0).sum())
                    linearised.gap = max(linearised.gap, float(np.abs(jump).max()))
            # A zero adds to each reading of its arm in all swings of its group.
            for column, index in enumerate(unknowns):
                if index >= m and (index - m) // arms == swing.group:
                    stretch.slope[:, (index - m) % arms, n + column] = 1.0
            # A missing reading has no residual and depends on nothing.
            missing = ~np.isfinite(swing.angles)
            for array in stretch[:3]:
                array[missing] = 0.0
            linearised.stretches.append(stretch)
        return linearised


@dataclass(frozen=True, eq=False)
class SwingFit(WindowedFit):
    """Fit of swings, whose parameters are the ratios (m,), then the zeros (groups, n), rad."""

    parameters: Array
    zeros: Array


def fit_swings(
    model: Swings,
    swings: list[Swing],
    *,
    parameters: Array,
    zeros: Array,
    free: NDArray[np.bool_],
    free_zeros: bool,
    settings: FitSettings,
    near: Array | None = None,
) -> SwingFit:
    """Fit the swings' starts, the free parameters, and the zeros if requested; friction remains non-negative.

    Args:
        model: integrator of the arms.
        swings: measured swings.
        parameters: ratios (m,) of the arms: first guess or fixed values.
        zeros: encoder zeros (groups, n) of each group of swings, rad: first guess or fixed values.
        free: True for parameters (m,) to fit; the others keep their values.
        free_zeros: True to fit the zeros.
        settings: windows, robust loss and convergence.
        near: first guess (W, 2n) of the windows' starts, default the measured angles without the zeros.
    """
    cut_swings = Windows(swings, model, settings.window)
    m, arms = model.parameters, model.arms.count
    values = np.concatenate([parameters, zeros.ravel()])
    lower_bounds = np.full(len(values), -np.inf)
    lower_bounds[inertial_count(arms) : m] = 0.0
    starts = cut_swings.guess() if near is None else near
    if near is None:
        for windows, swing in zip(cut_swings.windows, swings, strict=True):
            starts[windows, :arms] -= zeros[swing.group]
    fit = fit_windows(
        cut_swings,
        values,
        np.flatnonzero([*free, *[free_zeros] * zeros.size]),
        bounds=(lower_bounds, np.full(len(values), np.inf)),
        settings=settings,
        starts=starts,
    )
    return SwingFit(**vars(fit), parameters=fit.values[:m], zeros=fit.values[m:].reshape(zeros.shape))


def fit_starts(
    model: Swings,
    swings: list[Swing],
    *,
    parameters: Array,
    zeros: Array,
    settings: FitSettings,
    near: Array | None = None,
) -> SwingFit:
    """Fit only the swings' starts, by least squares, to judge given parameters by the residuals.

    Args:
        model: integrator of the arms.
        swings: measured swings.
        parameters: ratios (m,) of the arms, which are judged.
        zeros: encoder zeros (groups, n) of each group of swings, rad.
        settings: windows and convergence; its robust loss is not used.
        near: first guess (W, 2n) of the windows' starts, default the measured angles.
    """
    return fit_swings(
        model,
        swings,
        parameters=parameters,
        zeros=zeros,
        free=np.zeros(model.parameters, dtype=bool),
        free_zeros=False,
        settings=replace(settings, robust=0.0),
        near=near,
    )


_LANES = 64
"""Number of experiments that are integrated together."""
_CHAOTIC = 20.0
"""Growth of an error of the start from which an experiment is unreliable."""


@dataclass(frozen=True)
class DesignSettings(Settings, table="design"):
    """Experiments to compare."""

    seconds: Annotated[float, Setting(above=0, unit="s")] = 2.667
    """Duration of each recording, s."""
    period: Annotated[float, Setting(above=0, unit="s")] = 4e-3
    """Sampling period, s."""
    counts: Annotated[int, Setting(least=1)] = 40_000
    """Encoder counts per turn."""
    steps: Annotated[int, Setting(least=2)] = 9
    """Grid points of each angle over half a turn."""
    amplitudes: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """Of the cart's sine, m/s²."""
    frequencies: tuple[float, ...] = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 1.8, 2.1, 2.5, 3.0)
    """Of the cart's sine, Hz."""
    track: Annotated[float, Setting(above=0, unit="m")] = 0.4
    """Half length of the track, m."""


@dataclass(frozen=True, eq=False)
class Experiment(Brief):
    """One recording to make: a "swing" from rest at angles (n,) rad, or a "cart" with a sinusoidal acceleration.

    Attributes:
        kind: "swing" or "cart".
        amplitude: of the cart's acceleration, m/s².
        frequency: of the cart's acceleration, Hz.
        information: digits of information.
        amplification: growth of an error of the start.
        matrix: information matrix (f, f).
    """

    kind: str
    angles: tuple[float, ...]
    amplitude: float
    frequency: float
    information: float
    amplification: float
    usable: bool
    matrix: Array

    @property
    def text(self) -> str:
        """Instruction for the experiment, such as "release at 90°, 0°"."""
        if self.kind == "swing":
            return "release at " + ", ".join(f"{np.degrees(a):.0f}°" for a in self.angles)
        return f"sinusoidal cart acceleration of {self.amplitude:g} m/s² at {self.frequency:g} Hz"


@dataclass(frozen=True, eq=False)
class Design(Documented):
    """Comparison of experiments for the ratios `names` (f,) of a model.

    Attributes:
        names: names of the parameters.
        experiments: compared recordings.
        settings: settings of the comparison.
        status: the best recording in words.
    """

    KEYS: ClassVar[str] = (
        "unknowns=names experiments:kind,angles,amplitude,frequency,information,amplification,usable best=best.text "
        "pair=best_pair.text"
    )

    names: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    settings: DesignSettings
    status: str

    def ranked(self) -> list[Experiment]:
        """Return the usable experiments, the most informative first."""
        return sorted((e for e in self.experiments if e.usable), key=lambda e: -e.information)

    def best_pair(self) -> tuple[Experiment, Experiment]:
        """Return the most informative experiment and the best addition to it, which may be the same."""
        ranked = self.ranked()
        first = ranked[0]
        return first, max(ranked, key=lambda e: digits(first.matrix + e.matrix))

    @property
    def best(self) -> list[Experiment]:
        """The five most informative usable experiments, for a list."""
        return self.ranked()[:5]


def digits(matrix: Array) -> float:
    """Return the digits of an information matrix, ½ log₁₀ det / f, by which experiments are compared.

    Args:
        matrix: information matrix (f, f).

    Returns:
        The digits, -inf for a singular matrix.
    """
    sign, logarithm = np.linalg.slogdet(matrix)
    return float(logarithm / np.log(10) / 2 / len(matrix)) if sign > 0 else -np.inf


def design_experiments(
    arms: ArmChainParameters, *, settings: DesignSettings | None = None, progress: Progress = no_progress
) -> Design:
    """Compare experiments by their information: free swings over a grid of angles, and sines of the cart.

    An experiment is usable if it amplifies an error of its start less than `_CHAOTIC`-fold, keeps the cart on its
    track, and its information on the ratios that are not zero is not singular.

    An experiment is planned as kind, release angles (n,), rad, and amplitude, m/s², and frequency, Hz, of the cart's
    acceleration. This is held from sample to sample at its value in the middle. Since the cart starts from rest, it
    moves to one side only, by twice the amplitude of its sine.

    Args:
        arms: model of the arms.
        settings: experiments to compare.
        progress: receiver of progress reports.

    Raises:
        InputError: no experiment is usable.
    """
    settings = settings or DesignSettings()
    n = arms.count
    values = base_ratios(arms)
    fitted_ratios = np.flatnonzero(values)
    half_turns = np.linspace(-np.pi, np.pi, 2 * settings.steps + 1)[1:-1]
    # A mirrored swing gives the same information, so the first angle is positive. Upright arms at rest do not move.
    grid = [
        angle_set
        for angle_set in product(half_turns[half_turns > -1e-9], *[half_turns] * (n - 1))
        if np.abs(angle_set).max() > 1e-9
    ]
    sines = list(product(settings.amplitudes, settings.frequencies))
    times = np.arange(round(settings.seconds / settings.period) + 1) * settings.period
    plans = [("swing", angle_set, 0.0, 0.0) for angle_set in grid] + [("cart", (0.0,) * n, *sine) for sine in sines]
    starts = np.zeros((len(plans), 2 * n))
    accelerations, velocities = np.zeros((2, len(plans), len(times)))
    for number, (kind, angles, amplitude, frequency) in enumerate(plans):
        starts[number, :n] = angles
        if kind == "swing":
            continue
        angular_frequency = 2 * np.pi * frequency
        accelerations[number] = amplitude * np.cos(angular_frequency * (times + settings.period / 2))
        velocities[number] = amplitude / angular_frequency * np.sin(angular_frequency * times)
    model = Swings(arms)
    informations: list[tuple[Array, float]] = []
    for first in range(0, len(starts), _LANES):
        progress("swings", first / len(starts))
        rows = slice(first, first + _LANES)
        _, slopes = model.flown(
            starts[rows],
            values,
            period=np.full(len(starts[rows]), settings.period),
            samples=len(times),
            accelerations=accelerations[rows],
            velocities=velocities[rows],
        )
        informations += [_information(slope[:, :n], values, fitted_ratios, settings.counts) for slope in slopes]
    progress("swings", 1.0)
    experiments: list[Experiment] = []
    for (kind, angles, amplitude, frequency), (matrix, growth) in zip(plans, informations, strict=True):
        cart_amplitude = amplitude / (2 * np.pi * frequency) ** 2 if kind == "cart" else 0.0
        information = digits(matrix)
        usable = growth < _CHAOTIC and 2 * cart_amplitude <= settings.track and bool(np.isfinite(information))
        release_angles = tuple(float(angle) for angle in angles)
        experiments.append(Experiment(kind, release_angles, amplitude, frequency, information, growth, usable, matrix))
    usable = sum(e.usable for e in experiments)
    if not usable:
        raise InputError("no experiment is usable, since none determines the arms' ratios; check the model's friction")
    left_out = [ratio_names(arms)[k] for k in range(len(values)) if k not in fitted_ratios]
    omission = f"; zero ratios are not fitted: {', '.join(left_out)}" if left_out else ""
    return Design(
        names=tuple(ratio_names(arms)[k] for k in fitted_ratios),
        experiments=tuple(experiments),
        settings=settings,
        status=f"{usable} of {len(experiments)} experiments are usable: an error of the start grows less than "
        f"{_CHAOTIC:g}-fold, and the cart stays on its track{omission}",
    )


def _information(slopes: Array, values: Array, used: NDArray[np.intp], counts: int) -> tuple[Array, float]:
    """Return the information (f, f) on the logarithms of the ratios in use, and the growth of errors of the start.

    The information is I at the head of this module. The growth is the greatest size of the angles' derivatives by the
    release angles. If the derivatives overflow, the information is zero and the growth infinite.

    Args:
        slopes: derivatives (K, n, 2n+m) of the angles by start and ratios.
        values: ratios (m,).
        used: indices (f,) of the ratios in use, which are not zero.
        counts: encoder counts per turn, whose rounding is the noise.
    """
    samples, arms, _ = slopes.shape
    sigma = 2 * np.pi / counts / np.sqrt(12)
    by_start = slopes[:, :, : 2 * arms]
    growth = float(np.linalg.norm(by_start[:, :, :arms], axis=(1, 2)).max() / np.sqrt(arms))
    if not np.isfinite(slopes).all():
        return np.zeros((len(used), len(used))), np.inf
    zeros = np.broadcast_to(np.eye(arms), (samples, arms, arms))
    by_own_unknowns = np.concatenate([by_start, zeros], axis=2).reshape(samples * arms, -1)
    by_log_ratios = slopes[:, :, 2 * arms :][:, :, used].reshape(samples * arms, -1) * values[used]
    # Projection onto the complement of the recording's own unknowns.
    projected = by_log_ratios - by_own_unknowns @ np.linalg.lstsq(by_own_unknowns, by_log_ratios, rcond=1e-10)[0]
    return projected.T @ projected / sigma**2, growth
