"""Maps of failure: the limit of each method, beside the prediction of a formula of a few lines.

*Fixed steps.* About an equilibrium a method multiplies the motion of an eigenvalue s by its stability function in a
step, R(sh) = 1 + sh bᵀ (I - sh A)⁻¹ 1. At the first step with |R| above 1 for an s with Re s < 0, a motion grows that
should decay. Source: Hairer & Wanner, Solving Ordinary Differential Equations II (1996), section IV.2.

*Shadowing.* A node's rounding grows by λ^(1/s) to the next of s nodes in a period, which bounds the gaps; the constant
is random. Source: Stoer & Bulirsch, Introduction to Numerical Analysis, 3rd ed., section 7.3.5.

*References.* The error between nodes of a method with K points falls as the interval's length h to the power K. The
longest interval for a tolerance ε is h₀ (ε / e(h₀))^(1/K), from one solution on a finer mesh.
Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7.

*Control.* An error ξ of the unstable direction obeys ξ' = λξ + bu with |u| ≤ a. At the first command it has grown to
ξ e^{λd}. A command can correct it only below a·b/λ: d < ln(a |b| / (λ |ξ|)) / λ. For a wrong model, plant, prediction
through the commands in flight and gain form one linear map of (x, commands). At the border its largest eigenvalue is on
the unit circle. Omitting the filter costs up to a third. Neither holds along a moving reference.
Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed., sections 8.6 and 9.3; for bounded
inputs, Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2.

*Estimation.* Of K ticks each is lost with probability p. Gaps of at least m ticks, the supervisor's limit, begin
K (1 - p) pᵐ times on average, nearly independently. Half of the runs have none at K (1 - p) pᵐ = ln 2.
Source: Feller, An Introduction to Probability Theory and Its Applications I, 3rd ed., section XIII.7, for runs.

*Margins.* The loop's margins, beside campaigns with a drive that differs from the model.

Seeds of tubes, and OGY by its sections, are only measured. For random outcomes the border is at half the successes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq

from dpcontrol.bench.chart import Attempt, Border, EdgeChart, EdgeMap, find_border, half_of, measured_maps
from dpcontrol.bench.control import held
from dpcontrol.bench.propagation import Stepper
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import Controller, SampledModel
from dpcontrol.control.lqr import HoldController, HoldSettings, hold_controller
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.control.periodic import OrbitController, orbit_controller
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.plant import PlantParameters, longest_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import DriveSettings, SensorSettings
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import BatchRun, Ending
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.plans.itinerary import Itinerary, load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference, still
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.references.trajectory import even_mesh, first_trajectory
from dpcontrol.shooting.newton import NewtonSettings
from dpcontrol.tubes.connections import Connection, find_connections
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingSettings, shadow

Complex = NDArray[np.complex128]
Step = Callable[[Array, float], Array]
"""(state (N,), length in s) -> following state (N,)."""

SADDLE, SADDLE_ENERGY = "down-up", -0.07
"""Saddle to hold, and its energy, J."""
WALK = "outer-turn"

SADDLES = ("down-down", "down-up", "up-down", "up-up")
AMPLITUDE = 1e-6
"""Size of the initial motion: small, so that it stays linear, and large against rounding."""
STEPS = 3
"""Number of steps, limited because rounding in the growing direction must not reach the observed motion."""
RK4 = (np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.0, 0]]), np.array([1, 2, 2, 1]) / 6)
DOP = (np.array(DOP853.A), np.array(DOP853.B))


def propagation_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of fixed steps; quick: two saddles."""
    arms = load_model("lab").arms
    saddles = SADDLES[1::2] if quick else SADDLES
    split = longest_step(PlantParameters(arms))

    def border(saddle: str, **method: Any) -> Border:
        # Equilibria are not numbers, so their lines are placed side by side.
        return replace(step_border(arms, saddle, **method), x=float(saddles.index(saddle)))

    def unused_step(h: float, _: str) -> str:
        return f"never taken: the simulated bench splits steps longer than {split:g} s"

    maps = [
        (
            EdgeMap(title, "equilibrium", "step, s", log_x=False, far="grows, though it should die out",
                    theory="|R(sh)| = 1 for the first of the decaying motions"),
            partial(border, tableau=tableau, step=step, says=says), saddles,
        )
        for title, tableau, step, says in (
            ("Model of controllers and filters: Runge-Kutta 4", RK4, model_step(arms), _run_at),
            ("Plant: 12 stages of DOP853", DOP, plant_step(arms), unused_step),
        )
    ]  # fmt: skip
    return EdgeChart(
        name="edges-propagation",
        title="Where fixed steps end: near the equilibria",
        reading=(
            "The longest step that keeps all decaying motions about an equilibrium decaying: the fastest decides.",
            "Diamonds: from the method's coefficients and the eigenvalues alone.",
            "Loops of 25 Hz are five times from the border of their model, those of 1 kHz two hundred times.",
        ),
        chosen="Runge-Kutta 4 between ticks, stable down to 5 Hz; at most 2 ms at a time in the plant.",
        parts=measured_maps(progress, *maps),
    )


def model_step(arms: ArmChainParameters) -> Step:
    """Return the model step of controllers and filters.

    Its length is free; the cart acceleration is zero.
    """
    return lambda x, h: sampled_model(arms, 1 / h).step(x, 0.0)


def plant_step(arms: ArmChainParameters) -> Step:
    """Return the step of simulated plants, of any length.

    The cart acceleration is zero.
    """
    stepper = Stepper(fixed_step(equations_of(arms, Level.CART)), arms.base())
    return lambda x, h: stepper.fly(x, h, step=h)


def stability(tableau: tuple[Array, Array], z: complex) -> complex:
    """Return R(z) of an explicit method's A (S, S) and b (S,)."""
    a, b = tableau
    return complex(1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * a, np.ones(len(b))))


def predicted_step(tableau: tuple[Array, Array], values: Complex) -> float:
    """Return the first step in s at the border of stability.

    There |R| is 1 for one of the damped eigenvalues `values` in 1/s.
    """

    def growth(step: float) -> float:
        return max(abs(stability(tableau, s * step)) for s in values) - 1

    steps = np.linspace(1e-3, 5.0, 5000) / np.abs(values).max() * 2
    high = next(step for step in steps.tolist() if growth(step) > 0)
    return float(brentq(growth, high - (steps[1] - steps[0]), high))  # type: ignore[arg-type]


def decaying(arms: ArmChainParameters, saddle: str) -> tuple[Array, Complex, Complex, Complex]:
    """Return the equilibrium and its damped eigenvalues and vectors.

    The equilibrium is (N,), eigenvalues (m,) are in 1/s, right and left vectors (m, N).
    """
    e = equations_of(arms, Level.CART)
    state = np.concatenate([load_model("lab").system.equilibrium(saddle), np.zeros(2)])
    linear = ca.Function("linear", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate, e.state)])
    n = 2 * arms.count
    pairs = np.linalg.eig(np.array(linear(state, 0.0, arms.base()))[:n, :n].astype(np.complex128))
    values, right = (np.asarray(found, dtype=np.complex128) for found in pairs)
    damped = np.flatnonzero(values.real < -1e-9)
    # The cart does not move.
    right, left = (
        np.hstack([rows[damped], np.zeros((len(damped), len(state) - n), dtype=np.complex128)])
        for rows in (right.T, np.asarray(np.linalg.inv(right), dtype=np.complex128))
    )
    return state, values[damped], right, left


def step_border(
    arms: ArmChainParameters, saddle: str, *, tableau: tuple[Array, Array], step: Step,
    says: Callable[[float, str], str], ratio: float = 1.05,
) -> Border:  # fmt: skip
    """Return the border of the step's length at an equilibrium."""
    state, values, right, left = decaying(arms, saddle)
    predicted = predicted_step(tableau, values)

    def probe(h: float) -> Attempt:
        for vector, dual in zip(right, left, strict=True):
            y = state + AMPLITUDE * np.real(vector) / np.abs(vector).max()
            before = abs(dual @ (y - state))
            for _ in range(STEPS):
                y = step(y, h)
            if abs(dual @ (y - state)) > before:
                return Attempt(False)
        return Attempt(True)

    found = find_border(
        probe, x=0.0, line=saddle, near=predicted / 1.5, far=1.5 * predicted, predicted=predicted, ratio=ratio
    )
    # Evaluated once, because it takes a run.
    return replace(found, says=says(found.far, saddle)) if found.far else found


def _run_at(h: float, saddle: str) -> str:
    """Return the message of a run with this step as period.

    The arms are held at the equilibrium.
    """
    try:
        loop_case = held_at_rest(1 / h, saddle=saddle, seconds=60.0)
    except (InputError, GoalMissed) as error:
        return str(error)
    return loop_case.run(acceleration=STRONG, error=HELD_ERROR).says


RIGHT = 1e-9
"""Largest scaled distance of a connection from that of the default settings."""
ANEW = 1e-6
"""Relative change of the distance that only redraws all rounding."""


def seeds_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of seeds of tubes; quick: one energy, fewer searches."""
    system = load_model("lab").system
    draws, ratio = (3, 2.0) if quick else (7, 1.25)

    @cache
    def known(energy: float) -> tuple[LyapunovOrbit, Array]:
        orbit = lyapunov_orbit(system, SADDLE, energy=energy)
        return orbit, default_states(orbit)

    energies = (0.05,) if quick else (-0.07, 0.05, 0.2)
    y = "distance of the seeds from the orbit, scaled"
    near, far = (
        EdgeMap(title, "energy, J", y, far="connections are missing", near="all are found", log_x=False)
        for title in ("Too near", "Too far")
    )
    return EdgeChart(
        name="edges-seeds",
        title="Where seeds of tubes end: connections of Down-Up with itself",
        reading=(
            "Left: the nearest seeds, right: the farthest, for a search that finds every connection of that energy; "
            "beyond either it reports \"at least\" a number, and the reason.",
            f"Too near, rounding is decisive: of {draws} searches with different rounding, at least half find all.",
            "Rounding relative to the distance hides intersections; too far, seeds leave the manifold by the square of "
            "their distance.",
        ),
        chosen="Seeds 1e-4 from the orbit: some six hundred times the nearer border in the worst case.",
        parts=measured_maps(
            progress,
            (near, lambda energy: near_border(*known(energy), draws=draws, ratio=ratio), energies),
            (far, lambda energy: far_border(*known(energy), ratio=ratio), energies),
        ),
    )  # fmt: skip


def default_states(orbit: LyapunovOrbit) -> Array:
    """Return all connections of the orbit to itself, as states.

    The states (K, N) on their section come from default searches.
    """
    return np.array([c.state for c in find_connections(orbit, orbit).connections])


def found_all(orbit: LyapunovOrbit, states: Array, distance: float) -> Attempt:
    """Return success if a search finds exactly these connections.

    They are `states` (K, N). Otherwise return its message.
    """
    found = find_connections(orbit, orbit, settings=ConnectionSettings(distance=distance))
    away = [float(np.min(orbit.system.scaled_distance(states, c.state))) for c in found.connections]
    if len(away) == len(states) and max(away) < RIGHT:
        return Attempt(True)
    # A search that counts itself complete has no message.
    return Attempt(False, "" if found.status.startswith(f"{len(away)} connections") else found.status)


def near_border(orbit: LyapunovOrbit, states: Array, *, draws: int, ratio: float) -> Border:
    """Return the seed distance at which half of the searches succeed.

    They must find all connections of `states` (K, N).
    """

    def probe(distance: float) -> Attempt:
        answers = [found_all(orbit, states, distance * (1 + ANEW * draw)) for draw in range(draws)]
        return half_of(answers, "searches miss connections")

    return find_border(probe, x=orbit.energy, line=f"{orbit.energy:g} J", near=5e-6, far=1e-9, ratio=ratio)


def far_border(orbit: LyapunovOrbit, states: Array, *, ratio: float) -> Border:
    """Return the largest seed distance that finds all connections.

    They are those of `states` (K, N).
    """
    probe = partial(found_all, orbit, states)
    return find_border(probe, x=orbit.energy, line=f"{orbit.energy:g} J", near=0.15, far=1.6, ratio=ratio)


ENERGY = 0.2
APART = 1e-9
"""Relative difference of two energies: more than rounding, and negligible for the orbits."""


def walks_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of shadowing; quick: fewer wraps and spacings."""
    walks = tuple(round_trip(ENERGY * (1 + k * APART)) for k in range(3 if quick else 7))
    spacing, wrap = (
        EdgeMap(title, x, "tolerance of gaps, rad and rad/s", far="not converged", log_x=log_x)
        for title, x, log_x in (("Two wraps", "nodes in a period", True), ("One node in a period", "wraps", False))
    )
    return EdgeChart(
        name="edges-walks",
        title=f"Where shadowing ends: Down-Up to Up-Down and back at {ENERGY:g} J",
        reading=(
            "The smallest gap between pieces of orbit within reach of Newton's method, left by rounding.",
            "Left: it falls as nodes come nearer together. Right: many wraps are as good as none; one is worse.",
            "Rounding that grows by λ^(1/s) from node to node sets the scale; its constant is random: no prediction.",
        ),
        chosen="Eight nodes in a period and a tolerance of 1e-11, three orders above the rounding limit.",
        parts=measured_maps(
            progress,
            (spacing, lambda nodes: tolerance_border(walks, segments=nodes, wraps=2, x=nodes),
             (1, 4) if quick else (1, 2, 3, 4, 8)),
            (wrap, lambda wraps: tolerance_border(walks, segments=1, wraps=wraps, x=wraps),
             (1, 4) if quick else (0, 1, 2, 4, 8)),
        ),
    )  # fmt: skip


def round_trip(energy: float = ENERGY) -> tuple[Connection, ...]:
    """Return the lab's first crossing to Up-Down and back.

    It starts at Down-Up.
    """
    system = load_model("lab").system
    edges = find_edges(system, energy, pairs=[("down-up", "up-down"), ("up-down", "down-up")])
    return edges.between("down-up", "up-down")[0], edges.between("up-down", "down-up")[0]


def rounding_floor(walk: Sequence[Connection], *, segments: int) -> float:
    """Return the gap left by rounding between nodes, rad/s.

    A period has `segments` nodes.
    """
    fastest = max(
        float(np.abs(c.orbit.sample(np.linspace(c.orbit.times[0], c.orbit.times[-1], 400)))[:, 2:].max()) for c in walk
    )
    growth = max(c.source.unstable_multiplier for c in walk)
    return 0.5 * math.ulp(fastest) * growth ** (1 / segments)


def tolerance_border(walks: Sequence[Sequence[Connection]], *, segments: int, wraps: int, x: float) -> Border:
    """Return the smallest tolerance with orbits for half the walks.

    A period has `segments` nodes.
    """

    def probe(tolerance: float) -> Attempt:
        settings = ShadowingSettings(segments, newton=NewtonSettings(tolerance=tolerance))
        orbits = [shadow(walk, wraps=[wraps], settings=settings) for walk in walks]
        return half_of([Attempt(orbit.converged, orbit.status) for orbit in orbits], "not converged")

    floor = rounding_floor(walks[0], segments=segments)
    line = f"{wraps} wraps, {segments} nodes"
    return find_border(probe, x=x, line=line, near=100 * floor, far=floor / 20, ratio=1.3)


METHOD, TOLERANCE = ReferenceSettings().method, ReferenceSettings().tolerance
FINE = 0.012
"""Interval of the mesh that predicts the border, s, about one and a half times as long."""


def references_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of references; quick: one friction, one track."""
    frictions, tracks = ((1.0,), (0.01,)) if quick else ((0.0, 1.0, 2.0, 4.0), (0.4, 0.01, 0.002))
    mesh = EdgeMap(
        f"Mesh, {METHOD}", "friction, × the arms' own", f"interval for {TOLERANCE:g} between nodes, s", log_x=False,
        far="not as good", theory="the error falls as the interval to the power of the points",
    )  # fmt: skip
    return EdgeChart(
        name="edges-references",
        title="Where references end: one turn of the outer arm",
        reading=(
            f"Left: the longest equal intervals that keep the error between nodes below {TOLERANCE:g}.",
            "Right: the least acceleration for the motion on a track; the status names the limit.",
            f"Diamonds: from the error on one finer mesh, {1e3 * FINE:g} ms. Planning splits intervals with large "
            "errors and therefore needs fewer.",
        ),
        chosen="Seven points on 50 ms, split according to the error; limits of the bench leave room of a hundred.",
        parts=measured_maps(
            progress,
            (mesh, lambda friction: mesh_border(friction, x=float(frictions.index(friction))), frictions),
            (EdgeMap("Limits", "track, ± m", "acceleration, m/s²", far="no reference"), acceleration_border, tracks),
        ),
    )


@cache
def _walk() -> tuple[Itinerary, Callable[[Array], Array], float]:
    itinerary = load_itinerary(WALK)
    orbit = shadowing_orbit(itinerary)
    return itinerary, orbit.states, orbit.duration


def problem_of(friction: float = 1.0, limits: Limits | None = None) -> ReferenceProblem:
    """Return the turn within `limits` with scaled viscous friction.

    The factor `friction` applies to the arms' friction.
    """
    itinerary, guess, duration = _walk()
    arms = replace(itinerary.model.arms, viscous=tuple(friction * k for k in itinerary.model.arms.viscous))
    return ReferenceProblem(equations_of(arms, Level.CART), arms.base(), guess, duration, limits=limits or Limits())


def on_equal_intervals(problem: ReferenceProblem, interval: float) -> Reference:
    """Return the result of one round on equal intervals.

    They have at most `interval` s, regardless of the guess's error.
    """
    settings = ReferenceSettings(method=METHOD, interval=interval, tolerance=TOLERANCE, rounds=1)
    first = first_trajectory(problem, method_named(METHOD), even_mesh(problem.duration, interval))
    return find_reference(problem, settings, near=first)


def mesh_border(friction: float, *, x: float) -> Border:
    """Return the longest interval, s, that meets the tolerance.

    It applies between the turn's nodes in one round.
    """
    problem = problem_of(friction)
    fine = on_equal_intervals(problem, FINE).max_error_between_nodes
    # The package accepts slightly less than the tolerance.
    predicted = FINE * (0.8 * TOLERANCE / fine) ** (1 / len(method_named(METHOD).points))
    return find_border(
        lambda interval: _converged(on_equal_intervals(problem, interval)), x=x, line=f"× {friction:g}",
        near=predicted / 1.6, far=1.6 * predicted, predicted=predicted, ratio=1.12,
    )  # fmt: skip


def acceleration_border(track: float) -> Border:
    """Return the least acceleration, m/s², for the turn on a track.

    The track has ± `track` m.
    """

    def found(**limits: float) -> Reference:
        return find_reference(problem_of(limits=Limits(position=track, **limits)), ReferenceSettings(tolerance=1e-4))

    free = found()
    taken = free.max_cart_acceleration if free.converged else 10.0
    return find_border(
        lambda acceleration: _converged(found(acceleration=acceleration)), x=track, line=f"± {track:g} m",
        near=1.2 * taken, far=taken / 8, ratio=1.2,
    )  # fmt: skip


def _converged(found: Reference) -> Attempt:
    return Attempt(found.converged, "" if found.converged else found.status)


ROOM = 20.0
"""Length of the track, m, so that authority alone decides."""
HELD_ERROR, MOVING_ERROR = 0.05, 0.02
"""Initial error when the delay is varied, rad."""
WEAK, STRONG = 5.0, 30.0
"""Acceleration limit, m/s², when the delay or the model is varied."""
MISMATCH_RATE = 100.0
"""Hz."""
WITHOUT_FILTER = 1 / 3
"""Tolerance between the border of mismatch and its prediction."""


@dataclass(frozen=True, eq=False)
class LoopCase:
    """A controller at a rate in Hz on its model.

    A run succeeds if its angles end within `near` rad of the reference, over its last tenth.
    """

    reference: Reference
    arms: ArmChainParameters
    model: SampledModel
    controller: Controller
    settings: LoopSettings
    near: float

    def run(self, *, acceleration: float, mismatch: float = 0.0, error: float = 1e-3, delay: float = 0.0) -> Attempt:
        """Return the outcome of a run at the reference.

        Args:
            acceleration: limit, m/s².
            mismatch: of the plant, share.
            error: at the start, rad.
            delay: s.
        """
        # A timing error of half a period is a further error, with a high cost in a slow loop.
        drive = DriveSettings(delay=round(delay * self.settings.rate))
        settings = replace(self.settings, mismatch=mismatch, initial_error=error, drive=drive)
        reference = replace(self.reference, limits=Limits(position=ROOM, velocity=ROOM, acceleration=acceleration))
        (run,) = Assembly(reference, self.arms, settings, law=self.controller).batch([0])
        if run.ending is not Ending.FINISHED:
            return Attempt(False, run.reason)
        last = farthest_at_last(run)
        return Attempt(last < self.near, f"finished, but {last:.2g} rad away over its last tenth")

    def drawn_error(self, size: float) -> Array:
        """Return the initial error (N,) of runs, up to `size` rad."""
        drawn = replace(self.settings, initial_error=size).draw(self.arms, ticks=2).initial_error
        return np.concatenate([drawn, np.zeros(self.model.dimension - len(drawn))])

    def linear(self, mismatch: float = 0.0) -> tuple[Array, Array]:
        """Return A (N, N) and B (N,) over a tick.

        They belong to the controller's first state and a plant with `mismatch`.
        """
        plant = self.settings.draw(self.arms, ticks=2, mismatch=mismatch).plant.arms if mismatch else self.arms
        model = sampled_model(plant, self.settings.rate)
        a, b = model.linearised(self.controller.first_state[None, :], np.zeros(1))
        return a[0], b[0]


def farthest_at_last(run: BatchRun) -> float:
    """Return the largest final distance of the angles, rad.

    It is measured from the reference over a run's last tenth.
    """
    tail, n = max(len(run.times) // 10, 1), run.references.shape[1]
    return float(np.abs(run.truth[-tail:, :n] - run.references[-tail:]).max())


def held_at_rest(rate: float, *, saddle: str = SADDLE, seconds: float = 8.0) -> LoopCase:
    """Return the lab's arms held at an equilibrium for `seconds`.

    Raises:
        InputError, GoalMissed: the equilibrium cannot be held at this rate.
    """
    lab = load_model("lab")
    model = sampled_model(lab.arms, rate)
    controller = hold_controller(lab.system.equilibrium(saddle), model, HoldSettings(), seconds=seconds)
    settings = LoopSettings(seed=0, rate=rate, controller=HoldSettings())
    reference = still(controller.state, seconds, method=method_named("radau-7"), limits=Limits(), interval=1.0)
    return LoopCase(reference, lab.arms, model, controller, settings, near=0.1)


@cache
def moving(rate: float) -> LoopCase:
    """Return the planned turn of the outer arm, followed by TVLQR."""
    scene = load_itinerary(WALK)
    model = sampled_model(scene.model.arms, rate)
    reference = make_plan(scene).reference
    controller = tracking_controller(reference, model, TvlqrSettings())
    return LoopCase(reference, scene.model.arms, model, controller, LoopSettings(seed=0, rate=rate), near=0.3)


LATE = EdgeMap("Known delay, by rate", "rate of the loop, Hz", "delay, s", far="lost")
WRONG = EdgeMap(
    "Wrong model, by delay", "delay, s", "mismatch of the plant, share", far="lost", agrees=WITHOUT_FILTER
)  # fmt: skip


def control_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of arms held at an equilibrium.

    If quick, it has fewer rates and delays.
    """
    ratio = 1.15 if quick else 1.06
    late = replace(LATE, theory=f"the first command comes when {WEAK:g} m/s² can no longer turn the fall")
    wrong = replace(WRONG, theory="largest eigenvalue of plant, prediction and gain together is 1")
    return EdgeChart(
        name="edges-control",
        title="Where control ends: arms held at Down-Up",
        reading=(
            "Left: a known delay is predicted through, so it costs time only, whatever the rate. An error of up "
            f"to {HELD_ERROR:g} rad must stay within reach until the first command acts.",
            "Right: the prediction runs on the model; the longer the delay, the less it may be wrong.",
            "Circles hold to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="Prediction through all commands in flight, at any rate; delays of the bench are 1 to 20 ms.",
        parts=measured_maps(
            progress,
            (late, partial(held_delay_border, ratio=ratio),
             (50.0, 200.0) if quick else (25.0, 50.0, 100.0, 200.0, 400.0)),
            (wrong, partial(held_mismatch_border, ratio=ratio),
             (0.05, 0.15) if quick else (0.02, 0.05, 0.1, 0.15, 0.2)),
        ),
    )  # fmt: skip


def moving_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of a moving reference; quick: one rate, one delay."""
    return EdgeChart(
        name="edges-moving",
        title="Where control ends on a moving reference: one turn of the outer arm, TVLQR",
        reading=(
            f"Left: largest known delay of commands of at most {WEAK:g} m/s² after an error of up to "
            f"{MOVING_ERROR:g} rad at the start.",
            "Right: largest mismatch of the plant, for the prediction through the delay runs on the model.",
            "Circles end near the reference, crosses end with the sentence in the data.",
        ),
        chosen="Prediction through all commands in flight, from the first on; delays of the bench are 1 to 20 ms.",
        parts=measured_maps(
            progress,
            (LATE, lambda rate: delay_border(moving(rate), error=MOVING_ERROR, ratio=1.08),
             (100.0,) if quick else (25.0, 50.0, 100.0, 200.0)),
            (WRONG, lambda delay: mismatch_border(moving(MISMATCH_RATE), delay, ratio=1.1),
             (0.1,) if quick else (0.04, 0.07, 0.1, 0.14)),
        ),
    )  # fmt: skip


def delay_border(loop_case: LoopCase, *, error: float, ratio: float, predicted: float | None = None) -> Border:
    """Return the border of the known delay in s.

    The runs start with an error in rad.
    """
    rate, middle = loop_case.settings.rate, predicted or 0.2
    return find_border(
        lambda delay: loop_case.run(acceleration=WEAK, error=error, delay=delay), x=rate, line=f"{rate:g} Hz",
        near=middle / 4, far=3 * middle, predicted=predicted, ratio=ratio, unit=1 / rate,
    )  # fmt: skip


def mismatch_border(loop_case: LoopCase, delay: float, *, ratio: float, predicted: float | None = None) -> Border:
    """Return the border of the plant's mismatch at a delay.

    The delay is in s. All parameters change in one direction.
    """
    near, far = (predicted / 4, min(2.5 * predicted, 0.6)) if predicted else (0.01, 0.6)
    return find_border(
        lambda mismatch: loop_case.run(acceleration=STRONG, mismatch=mismatch, delay=delay), x=delay,
        line=f"{1e3 * delay:g} ms", near=near, far=far, predicted=predicted, ratio=ratio,
    )  # fmt: skip


def held_delay_border(rate: float, *, ratio: float) -> Border:
    """Return the border of the delay for held arms, with prediction.

    The delay is in s, `rate` in Hz.
    """
    loop_case = held_at_rest(rate)
    predicted = longest_delay(loop_case, loop_case.drawn_error(HELD_ERROR), acceleration=WEAK)
    return delay_border(loop_case, error=HELD_ERROR, ratio=ratio, predicted=predicted)


def longest_delay(loop_case: LoopCase, error: Array, *, acceleration: float) -> float:
    """Return the longest delay in s that can be corrected.

    The limit is `acceleration` m/s², the initial `error` is (N,).
    """
    a, b = loop_case.linear()
    values, left = np.linalg.eig(a.T)
    first = int(np.argmax(np.abs(values)))
    growth, direction = float(values[first].real), np.real(left[:, first])
    rate = float(np.log(growth)) * loop_case.settings.rate
    # One held period: b (e^{λT} - 1)/λ.
    reach = float(direction @ b) * rate / (growth - 1)
    return float(np.log(acceleration * abs(reach) / (rate * abs(float(direction @ error)))) / rate)


def held_mismatch_border(delay: float, *, ratio: float) -> Border:
    """Return the border of mismatch for held arms, with its prediction.

    The delay is in s.
    """
    loop_case = held_at_rest(MISMATCH_RATE, seconds=20.0)
    controller, assumed = loop_case.controller, loop_case.linear()
    assert isinstance(controller, HoldController)

    def grows(mismatch: float) -> bool:
        plant, ticks = loop_case.linear(mismatch), round(delay * MISMATCH_RATE)
        loop = loop_matrix(plant, assumed, gain=controller.gain, delay=ticks)
        return bool(np.abs(np.linalg.eigvals(loop)).max() >= 1)

    # The first border counts: the eigenvalue may return into the circle.
    predicted = next(filter(grows, np.geomspace(1e-3, 0.6, 60).tolist()), None)
    return mismatch_border(loop_case, delay, ratio=ratio, predicted=predicted)


def loop_matrix(
    plant: tuple[Array, Array], assumed: tuple[Array, Array], *, gain: Array, delay: int
) -> Array:  # fmt: skip
    """Return the map of a tick for state and commands.

    Commands are in flight, oldest first; both are deviations.

    Args:
        plant: A (N, N), B (N,) between ticks of the plant.
        assumed: A (N, N), B (N,) of the predicting model.
        gain: (N,).
    """
    n = len(gain)
    ahead = np.eye(n, n + delay)
    for i in range(delay):
        ahead = assumed[0] @ ahead
        ahead[:, n + i] += assumed[1]
    # State, commands in flight, and the new one: the first of the commands acts now, the rest wait.
    rows: Array = np.vstack([np.eye(n + delay), -gain @ ahead])
    return np.vstack([plant[0] @ rows[:n] + plant[1][:, None] * rows[n], rows[n + 1 :]])


RATE = 1000.0
LIMIT = 0.5
"""Size of the pulses, m/s², when counts are varied."""
COUNTS = 40_000.0
"""Counts per turn when the pulses are varied."""


def held_orbit() -> SustainedOrbit:
    """Return the lab's orbit about its saddle."""
    lab = load_model("lab")
    return sustained_orbit(lyapunov_orbit(lab.system, SADDLE, energy=SADDLE_ENERGY), lab.arms)


def pulses(orbit: SustainedOrbit, sections: int, *, seconds: float) -> OgyController:
    """Return the law that holds an orbit by `sections` pulses.

    A pulse has at most LIMIT m/s². The law does not learn.
    """
    settings = OgySettings(sections=sections, pulse_limit=LIMIT, parameter_error=0.0)
    return ogy_controller(orbit, sampled_model(load_model("lab").arms, RATE), settings, seconds=seconds)


def ogy_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of OGY.

    If quick, it has fewer sections and seeds, wider borders, and shorter runs.
    """
    orbit = held_orbit()
    sections, seeds, ratio, seconds = ((8,), 8, 1.6, 4.0) if quick else ((1, 2, 3, 4, 8, 16), 16, 1.12, 6.0)
    how: dict[str, Any] = {"seeds": seeds, "ratio": ratio}
    authority, counts = (
        EdgeMap(title, "sections in a period, k", y, far="lost")
        for title, y in (
            (f"Authority, {COUNTS:,.0f} counts per turn", "largest pulse, m/s²"),
            (f"Encoders, pulses of {LIMIT:g} m/s²", "counts per turn"),
        )
    )
    return EdgeChart(
        name="edges-ogy",
        title=f"Where OGY ends: Down-Up at {SADDLE_ENERGY:g} J, multiplier {orbit.multipliers[0].real:.0f} a period",
        reading=(
            "From one section to the next an error grows by about λ^(1/k), so few sections need large pulses or "
            "impossibly fine encoders.",
            f"Circles: at least half of {seeds} runs hold; crosses: fewer. Zeros of the encoders lie anywhere within a "
            "count.",
            "Rounding of readings depends on the orbit, and more counts can be worse: no formula predicts "
            "these borders.",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would suffice.",
        parts=measured_maps(
            progress,
            (authority, lambda k: limit_border(orbit, pulses(orbit, k, seconds=seconds), **how), sections),
            (counts, lambda k: counts_border(orbit, pulses(orbit, k, seconds=seconds), **how), sections),
        ),
    )


def holds(orbit: SustainedOrbit, controller: OgyController, *, counts: float, seeds: int) -> Attempt:
    """Return success if at least half of the runs hold the orbit.

    Otherwise return the ending of the first failure.
    """
    whole = max(round(counts), 1)
    sensors = SensorSettings(counts=whole, cart_resolution=1e-6, zero_error=np.pi / whole)
    # Estimated zeros would need a third larger pulses at k = 16.
    settings = LoopSettings(
        seed=0, rate=RATE, sensors=sensors, estimator=EkfSettings(augment=()), initial_error=1e-5
    )  # fmt: skip
    arms, period = load_model("lab").arms, orbit.period
    wide = replace(orbit.reference, limits=Limits(position=5.0, acceleration=30.0))
    runs = Assembly(wide, arms, settings, law=controller).batch(range(seeds))
    judge = held(orbit.state(np.linspace(0, period, 1000))[:, : arms.count], period=period)
    away = "finished, but away from the orbit in its last period"
    return half_of(
        [Attempt(judge(run), away if run.ending is Ending.FINISHED else run.reason) for run in runs], "runs lost"
    )


def limit_border(orbit: SustainedOrbit, law: OgyController, *, seeds: int, ratio: float) -> Border:
    """Return the smallest limit of pulses that holds an orbit, m/s²."""

    def probe(limit: float) -> Attempt:
        return holds(orbit, replace(law, pulse_limit=limit), counts=COUNTS, seeds=seeds)

    return find_border(probe, x=len(law.times), line=f"k = {len(law.times)}", near=5.0, far=0.01, ratio=ratio)


def counts_border(orbit: SustainedOrbit, law: OgyController, *, seeds: int, ratio: float) -> Border:
    """Return the fewest counts per turn that hold an orbit.

    Encoders range from coarse to impossibly fine.
    """

    def probe(counts: float) -> Attempt:
        return holds(orbit, law, counts=counts, seeds=seeds)

    return find_border(probe, x=len(law.times), line=f"k = {len(law.times)}", near=4e8, far=50.0, ratio=ratio)


SECONDS = 10.0
"""Duration of the runs that lose samples."""
BEFORE = 0.5
"""Least time of the run before a sensor sticks, s."""
MOVED, STILL = 0.02, 0.015
"""Least angle in rad and time in s that distinguish a stuck joint from a still one."""


def estimation_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of estimates; quick: one rate, one phase, fewer seeds."""
    model = load_model("lab")
    orbit = held_orbit()
    lost = EdgeMap(
        "Lost samples", "rate of the loop, Hz", "samples that arrive, per s", far="lost",
        theory="a gap of 0.1 s is as likely as not in 10 s",
    )  # fmt: skip
    stuck = EdgeMap(
        "A stuck encoder of the outer arm, on the orbit about Down-Up", "phase at which it sticks",
        "seconds until it is reported", far="reported", near="goes on", log_x=False,
    )  # fmt: skip
    equilibrium = model.system.equilibrium(SADDLE)
    return EdgeChart(
        name="edges-estimation",
        title="Where estimates end: samples lost, an encoder stuck",
        reading=(
            "Left: the filter flies through gaps on its model; the supervisor ends the run after 0.1 s without any.",
            "Right: a stuck encoder is recognised by the motion expected of the arm.",
            "Circles run to the end, crosses end with the sentence in the data; diamonds are predicted.",
        ),
        chosen="0.1 s without a sample: an error at Down-Up grows 2.2-fold in it, far within authority.",
        parts=measured_maps(
            progress,
            (lost, lambda rate: lost_border(model.arms, equilibrium, rate=rate, seeds=5 if quick else 9),
             (100.0,) if quick else (50.0, 100.0, 200.0, 400.0)),
            (stuck, lambda phase: stuck_border(model.arms, orbit, phase=phase),
             (0.3,) if quick else (0.1, 0.3, 0.5, 0.7, 0.9)),
        ),
    )  # fmt: skip


def arriving(rate: float, *, missing: float, seconds: float) -> float:
    """Return the least rate of samples without gaps in half the runs.

    The rate is in samples per s; a gap is longer than `missing` s.
    """
    ticks, gap = seconds * rate, math.floor(missing * rate + 1e-9) + 1
    # The number of gaps grows with p up to p = m / (m + 1); the border lies below.

    def excess(p: float) -> float:
        return ticks * (1 - p) * p**gap - math.log(2)

    return (1 - float(brentq(excess, 0.0, gap / (gap + 1)))) * rate  # type: ignore[arg-type]


def lost_border(arms: ArmChainParameters, equilibrium: Array, *, rate: float, seeds: int) -> Border:
    """Return the least rate of samples to hold the equilibrium.

    Half of the runs must hold it for ten seconds; the rate is in samples per s.
    """
    settings = LoopSettings(seed=0, rate=rate, controller=HoldSettings(), initial_error=0.01)
    controller = hold_controller(equilibrium, sampled_model(arms, rate), HoldSettings(), seconds=SECONDS)
    reference = still(controller.state, SECONDS, method=method_named("radau-7"), limits=Limits(), interval=1.0)

    def probe(kept: float) -> Attempt:
        lossy = replace(settings, sensors=SensorSettings(dropout=1 - kept / rate))
        assembly = Assembly(reference, arms, lossy, law=controller)
        runs = [assembly.simulate(seed=k) for k in range(seeds)]
        return half_of([Attempt(run.ending is Ending.FINISHED, run.reason) for run in runs], "runs lost")

    predicted = arriving(rate, missing=settings.supervisor.missing, seconds=SECONDS)
    return find_border(
        probe, x=rate, line=f"{rate:g} Hz", near=min(1.6 * predicted, rate), far=predicted / 1.8, predicted=predicted,
        ratio=1.12,
    )  # fmt: skip


def earliest_report(orbit: SustainedOrbit, since: float, *, sensor: int) -> float:
    """Return the time until a stuck reading is distinguishable, s.

    The reading is stuck at `since` s, and the arm is not still.
    """
    after = np.arange(0.0, orbit.period, 1e-3)
    angles = orbit.state(since + after)
    joint = angles[:, sensor] - (angles[:, sensor - 1] if sensor else 0.0)
    return max(float(after[int(np.argmax(np.abs(joint - joint[0]) >= MOVED))]), STILL)


def stuck_border(arms: ArmChainParameters, orbit: SustainedOrbit, *, phase: float) -> Border:
    """Return the time from a stuck encoder to the run's end.

    The run holds an orbit; the time is in s.
    """
    model = sampled_model(arms, RATE)
    at = round((math.ceil(BEFORE / orbit.period) + phase) * orbit.period, 3)
    settings = LoopSettings(seed=0, sensors=SensorSettings(stuck_at=at, stuck_sensor=1))

    def probe(after: float) -> Attempt:
        controller = orbit_controller(orbit, model, TvlqrSettings(), seconds=at + after)
        run = Assembly(orbit.reference, arms, settings, law=controller).simulate()
        return Attempt(run.ending is Ending.FINISHED, "" if run.ending is Ending.FINISHED else run.reason)

    # A lower bound: the delay of the filter's test is added to it.
    least = earliest_report(orbit, at % orbit.period, sensor=1)
    return find_border(probe, x=phase, line=f"{phase:g}", near=least / 2, far=8 * least, ratio=1.1, unit=1e-3)


FOLLOWED = (
    ("hold-up-up", "lqr"), ("outer-turn", "tvlqr"), ("outer-turn", "adaptive"), ("keep-down-up", "tvlqr"),
    ("cross", "tvlqr"), ("cross", "adaptive"), ("turn-from-rest", "tvlqr"), ("turn-from-rest", "adaptive"),
    ("up-up", "adaptive"),
)  # fmt: skip
"""Itineraries and laws for comparing margins with campaigns; a quick chart has the first three."""
MARGIN_ERROR = 2e-3
"""Initial error of each angle, rad: small, so that stability decides and not the size of the disturbance."""
STAYED = 10.0
"""Duration of a stay, s."""
ASTRAY = 0.3
"""Largest distance from the reference over the last tenth of a successful run, rad."""
TRIED = 10.0
"""Greatest gain of a simulated drive; larger ones are not tried."""
CHATTER = 3.0
"""Limit of the feedback, m/s² rms. It stays below 1 in a stable loop; above, only limits contain a swing."""
SHORT = 1.0
"""Share by which a border may exceed its margin: a flight can end before a slow instability has grown."""


@dataclass(frozen=True, eq=False)
class FollowedReference:
    """A loop that follows a reference, with its margins.

    Each trial runs `seeds` seeds.
    """

    assembly: Assembly
    margins: Mapping[str, float]
    seeds: int

    def run(self, *, gain: float = 1.0, delay: float = 0.0, lag: float = 0.0) -> Attempt:
        """Return success if half of the seeds stay at the reference.

        The drive deviates from the model by gain, delay s and lag s.
        """
        assumed, rate = self.assembly.delay, self.assembly.settings.rate
        drive = replace(self.assembly.settings.drive, response=gain, lag=lag, delay=assumed + delay * rate)
        other = self.assembly.under(replace(self.assembly.settings, drive=drive))
        runs = replace(other, law=self.assembly.controller, believed_delay=assumed).batch(range(self.seeds))
        failed = [why for run in runs if (why := _failure_reason(run))]
        return Attempt(2 * len(failed) < self.seeds, failed[0] if failed else "")


def _failure_reason(run: BatchRun) -> str:
    """Return the reason why a run left its reference, or ""."""
    if run.ending is not Ending.FINISHED:
        return run.reason
    if run.rms_feedback > CHATTER:
        return f"finished, but the command swings: feedback of {run.rms_feedback:.2g} m/s² rms"
    away = farthest_at_last(run)
    return "" if away < ASTRAY else f"finished, but {away:.2g} rad away over its last tenth"


@cache
def followed(itinerary: str, law: str, seeds: int) -> FollowedReference:
    """Return an itinerary followed by a law; a stay for `STAYED` s."""
    scene = load_itinerary(itinerary).with_run({"controller": law, "travel": 0.8})
    reference, arms = make_plan(scene).reference, scene.model.arms
    settings = LoopSettings(
        seed=0, controller=scene.loop.controller, estimator=scene.loop.estimator, initial_error=MARGIN_ERROR, travel=0.8
    )
    assembly = Assembly(reference, arms, settings)
    controller: Any = assembly.controller
    if isinstance(controller, OrbitController | HoldController):
        assembly = replace(assembly, law=replace(controller, ticks=round(STAYED * settings.rate)))
    margins = {name: value for name, (value, _) in assembly.margins().least().items()}
    return FollowedReference(assembly, margins, seeds)


def margin_border(name: str, case: tuple[str, str], *, seeds: int, ratio: float) -> Border:
    """Return the border of gain_low, gain_high, delay or lag, with its margin."""
    loop, key = followed(*case, seeds), name.partition("_")[0]
    predicted = loop.margins[name]
    near, far = {"gain_low": (1.0, predicted / 4), "gain_high": (1.0, min(4 * predicted, TRIED))}.get(
        name, (predicted / 16, 4 * predicted)
    )
    return find_border(
        lambda value: loop.run(**{key: value}), x=0.0, line=", ".join(case), near=near, far=far, ratio=ratio,
        predicted=predicted if name != "gain_high" or predicted < TRIED else None,
    )  # fmt: skip


def margins_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart of margins beside campaigns; quick: fewer itineraries and seeds."""
    cases, seeds, ratio = (FOLLOWED[:3], 8, 1.15) if quick else (FOLLOWED, 32, 1.08)

    def border(case: tuple[str, str], name: str) -> Border:
        found = margin_border(name, case, seeds=seeds, ratio=ratio)
        return replace(found, x=float(cases.index(case)))

    theory = "the loop's margin, least along the reference"
    maps = [
        (
            EdgeMap(title, "itinerary and law", label, theory=theory, far="lost", log_x=False, agrees=SHORT),
            partial(border, name=name), cases,
        )
        for name, title, label in (
            ("gain_low", "Too little of a command", "share that the drive gives"),
            ("gain_high", "Too much of a command", "factor that the drive gives"),
            ("delay", "Further delay", "delay, s"), ("lag", "Further lag", "lag, s"),
        )
    ]  # fmt: skip
    return EdgeChart(
        name="edges-margins",
        title="Margins of the loop, and borders of campaigns",
        reading=(
            f"Borders: at half of {seeds} runs lost, or swinging within the limits; the drive differs from the model.",
            "Diamonds: the margins, from multipliers over a period of a repeating motion, or from growth over a "
            "wobble along flights.",
            "A flight may end before a slow instability has grown, so its border may lie beyond its margin.",
        ),
        chosen=f"Margins as shown by `plan --margins`; a border up to {1 + SHORT:g} times as far counts as agreeing.",
        parts=measured_maps(progress, *maps),
    )
