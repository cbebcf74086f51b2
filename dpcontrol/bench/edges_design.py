"""Where fixed steps end: the longest step with which a motion about an equilibrium still dies out, method by method.

About an equilibrium a method multiplies the motion of an eigenvalue s by its stability function in a step,

    R(sh) = 1 + sh bᵀ (I - sh A)⁻¹ 1,      |R(sh)| ≤ 1 for those with Re s < 0

The first step at which |R| passes 1 makes a motion grow that dies out in truth: -λ of a saddle, or an oscillation that
friction damps. Measured with the product's own compiled steps on the nonlinear equations; predicted from A, b alone.

Source: Hairer & Wanner, Solving Ordinary Differential Equations II (1996), section IV.2.

Where seeds of tubes end: too near their orbit, rounding hides where tubes meet; too far, they leave the manifold.

Too near, chance decides, for each search has rounding of its own: the border is where half of them find all. Too far,
the tube's second-order part is left out, an error of δ² at the seed. Neither border has a formula of a few lines.

Where shadowing ends: wraps and tolerance by the spacing of nodes.

A node's rounding, half a unit in the last place of a rate of up to 20 rad/s, grows by λ^(1/s) to the next of s nodes in
a period of the orbit, whatever the number of wraps: multiple shooting forgets what lies before. Gaps cannot become
much smaller than

    floor = ½ ulp(rate) λ^(1/s)

whose constant depends on the luck of roundings, so that it is a bound and no prediction. The same walk is solved at
energies a billionth apart, which draw their roundings anew: at a border half of them converge. One that shoots over a
whole stop, s below one, would be lost after a single wrap.

Source: Stoer & Bulirsch, Introduction to Numerical Analysis, 3rd ed., section 7.3.5.

Where references end: mesh by friction, and acceleration by track, for a turn of the outer arm.

The error between nodes of a method with K points falls as the interval's length h to the power K:

    e(h) = e(h₀) (h/h₀)^K,      so the longest interval for a tolerance ε is  h₀ (ε / e(h₀))^(1/K)

predicted from one solution on a finer mesh. What acceleration a track needs has no formula: that border is measured
only.

Source: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from dpcontrol.bench.chart import Attempt, Border, EdgeChart, EdgeMap, borders, find_border, half_of
from dpcontrol.bench.edges_loop import HELD_ERROR, ROOM, STRONG, held_at_rest
from dpcontrol.bench.propagation import Stepper
from dpcontrol.control.interface import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations
from dpcontrol.dynamics.compiled import fixed_step
from dpcontrol.dynamics.plant import PlantParameters, longest_step
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.orbits.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.references.find import find_reference
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import first_trajectory
from dpcontrol.scenes.itinerary import Itinerary, load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.planning import shadowing_orbit
from dpcontrol.shooting.newton import NewtonSettings
from dpcontrol.tubes.connection import Connection
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingSettings, shadow

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Step = Callable[[Array, float], Array]
"""(state (N,), length in s) -> following state (N,)."""

SADDLES = ("down-down", "down-up", "up-down", "up-up")
AMPLITUDE = 1e-6
"""Of the motion at the start: small, so that it stays linear, and large against rounding."""
STEPS = 3
"""Few: rounding, in the direction that grows, must not reach the motion that is looked at."""
RK4 = (np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.0, 0]]), np.array([1, 2, 2, 1]) / 6)
DOP = (np.array(DOP853.A), np.array(DOP853.B))


def propagation_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: two saddles."""
    arms = load_model("lab").arms
    saddles = ("down-up", "up-up") if quick else SADDLES
    split = longest_step(PlantParameters(arms))
    maps = []
    for title, tableau, step, says in (
        ("Model of controllers and filters: Runge-Kutta 4", RK4, model_step(arms), _run_at),
        ("Plant: 12 stages of DOP853", DOP, plant_step(arms),
         lambda h, saddle: f"never taken: the simulated bench splits what is longer than {split:g} s"),
    ):  # fmt: skip
        border = partial(step_border, arms, tableau=tableau, step=step, says=says)
        found = borders(border, saddles, part_of(progress, len(maps) / 2, (len(maps) + 1) / 2), title + ", {}")
        # Equilibria are no numbers: lines stand side by side.
        found = tuple(replace(one, x=float(k)) for k, one in enumerate(found))
        maps.append(
            EdgeMap(title, "equilibrium", "step, s", found, log_x=False, far="grows, though it should die out",
                    theory="|R(sh)| = 1 for the first of the motions that die out")
        )  # fmt: skip
    return EdgeChart(
        name="edges-propagation",
        title="Where fixed steps end: near the equilibria",
        maps=tuple(maps),
        reading=(
            "The longest step with which all motions that die out about an equilibrium do so: the fastest decides.",
            "Diamonds: from the method's coefficients and the eigenvalues alone.",
            "Loops of 25 Hz are five times from the border of their model, those of 1 kHz two hundred times.",
        ),
        chosen="Runge-Kutta 4 between ticks, stable down to 5 Hz; at most 2 ms at a time in the plant.",
    )  # fmt: skip


def model_step(arms: ArmChainParameters) -> Step:
    """Return the step of controllers' and filters' model, of any length, the cart's acceleration zero."""
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    return lambda x, h: SampledModel(equations, arms.base(), period=h).step(x, 0.0)


def plant_step(arms: ArmChainParameters) -> Step:
    """Return the step of simulated plants, of any length, the cart's acceleration zero."""
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    stepper = Stepper(fixed_step(equations), arms.base())
    return lambda x, h: stepper.fly(x, h, step=h)


def stability(tableau: tuple[Array, Array], z: complex) -> complex:
    """Return R(z) of an explicit method's A (S, S) and b (S,)."""
    a, b = tableau
    return complex(1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * a, np.ones(len(b))))


def predicted_step(tableau: tuple[Array, Array], values: Complex, *, longest: float = 5.0) -> float:
    """Return the step in s at which the first of the eigenvalues `values` in 1/s, all damped, has |R| = 1."""
    steps = np.linspace(1e-3, longest, 5000) / np.abs(values).max() * 2

    def stable(step: float) -> bool:
        return max(abs(stability(tableau, s * step)) for s in values) <= 1

    low, high = next(((low, high) for low, high in pairwise(steps.tolist()) if not stable(high)), (0.0, 0.0))
    if not high:
        raise ValueError("no border up to the longest step")
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def decaying(arms: ArmChainParameters, saddle: str) -> tuple[Array, Complex, Complex, Complex]:
    """Return the equilibrium (N,), the damped eigenvalues (m,) in 1/s, their vectors (m, N) and left vectors (m, N)."""
    e = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    state = np.concatenate([load_model("lab").system.equilibrium(saddle), np.zeros(2)])
    linear = ca.Function("linear", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate, e.state)])
    n = 2 * arms.count
    pairs = np.linalg.eig(np.array(linear(state, 0.0, arms.base()))[:n, :n].astype(np.complex128))
    values, right = (np.asarray(found, dtype=np.complex128) for found in pairs)
    damped = np.flatnonzero(values.real < -1e-9)
    left: Complex = np.asarray(np.linalg.inv(right), dtype=np.complex128)
    cart = np.zeros((len(damped), len(state) - n), dtype=np.complex128)
    return state, values[damped], np.hstack([right.T[damped], cart]), np.hstack([left[damped], cart])


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
    # Asked once, for it takes a run.
    return replace(found, says=says(found.far, saddle)) if found.far else found


def _run_at(h: float, saddle: str) -> str:
    """Return what a run says whose period is as long as the step, arms held at the equilibrium."""
    try:
        stand = held_at_rest(1 / h, saddle=saddle, seconds=60.0)
    except (InputError, GoalMissed) as error:
        return str(error)
    limits = Limits(position=ROOM, velocity=ROOM, acceleration=STRONG)
    return stand.run(limits=limits, error=HELD_ERROR).says


SADDLE = "down-up"
ENERGIES, QUICK_ENERGIES = (-0.07, 0.05, 0.2), (0.05,)
DEFAULT = ConnectionSettings().distance
RIGHT = 1e-9
"""Scaled: how far a connection may lie from the one that the default settings find."""
ANEW = 1e-6
"""Share of the distance whose change draws all rounding anew, and changes nothing else."""
DRAWS, QUICK_DRAWS = 7, 3


def seeds_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one energy, fewer searches."""
    system = load_model("lab").system
    energies, draws, ratio = (QUICK_ENERGIES, QUICK_DRAWS, 2.0) if quick else (ENERGIES, DRAWS, 1.25)
    nearest, farthest = [], []
    for k, energy in enumerate(energies):
        progress(f"edges of seeds, {energy:g} J", k / len(energies))
        orbit = lyapunov_orbit(system, SADDLE, energy=energy)
        states = default_states(orbit)
        nearest.append(near_border(orbit, states, draws=draws, ratio=ratio))
        farthest.append(far_border(orbit, states, ratio=ratio))
    words = {"far": "connections are missing", "near": "all are found", "log_x": False}
    y = "distance of the seeds from the orbit, scaled"
    return EdgeChart(
        name="edges-seeds",
        title="Where seeds of tubes end: connections of Down-Up with itself",
        maps=(
            EdgeMap("Too near", "energy, J", y, tuple(nearest), **words),
            EdgeMap("Too far", "energy, J", y, tuple(farthest), **words),
        ),
        reading=(
            "Left: the nearest seeds, right: the farthest, with which a search finds every connection of that energy; "
            "beyond either it says \"at least\" so many, and why.",
            f"Too near, chance decides: of {draws} searches, each with rounding of its own, at least half find all.",
            "Rounding over the distance hides where tubes meet; too far, seeds leave the manifold by the square of "
            "their distance.",
        ),
        chosen="Seeds 1e-4 from the orbit: at least ninety times from the nearer border where that is worst.",
    )  # fmt: skip


def search(orbit: LyapunovOrbit, distance: float) -> ConnectionSearch:
    """Return the orbit's connections with itself from seeds at `distance`."""
    return find_connections(orbit, orbit, settings=ConnectionSettings(distance=distance))


def default_states(orbit: LyapunovOrbit) -> Array:
    """Return the states (K, N) of all connections on their section, from seeds at the default distance."""
    return np.array([c.state for c in search(orbit, DEFAULT).connections])


def found_all(orbit: LyapunovOrbit, states: Array, distance: float) -> Attempt:
    """Return whether a search finds the connections of `states` (K, N), and no others, else what it says."""
    found = search(orbit, distance)
    away = [float(np.min(orbit.system.scaled_distance(states, c.state))) for c in found.connections]
    right = len(away) == len(states) and max(away) < RIGHT
    if right:
        return Attempt(True)
    # A search that believes itself complete has reported nothing.
    return Attempt(False, "" if found.status.startswith(f"{len(away)} connections") else found.status)


def near_border(orbit: LyapunovOrbit, states: Array, *, draws: int = DRAWS, ratio: float = 1.25) -> Border:
    """Return the distance of seeds at which half of the searches find all connections, those of `states` (K, N)."""

    def probe(distance: float) -> Attempt:
        answers = [found_all(orbit, states, distance * (1 + ANEW * draw)) for draw in range(draws)]
        return half_of(answers, "searches miss connections")

    return find_border(probe, x=orbit.energy, line=f"{orbit.energy:g} J", near=5e-6, far=1e-9, ratio=ratio)


def far_border(orbit: LyapunovOrbit, states: Array, *, ratio: float = 1.25) -> Border:
    """Return the largest distance of seeds with which all connections are found, those of `states` (K, N)."""
    return find_border(
        lambda distance: found_all(orbit, states, distance), x=orbit.energy, line=f"{orbit.energy:g} J", near=0.15,
        far=1.6, ratio=ratio,
    )  # fmt: skip


ENERGY = 0.2
WRAPS = (0, 1, 2, 4, 8)
QUICK_WRAPS = (1, 4)
SPACINGS = (1, 2, 3, 4, 8)
QUICK_SPACINGS = (1, 4)
APART = 1e-9
"""Between two energies, as a share: more than rounding, and nothing to the orbits."""
WALK_DRAWS, QUICK_WALK_DRAWS = 7, 3


def walks_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer wraps and spacings."""
    walks = tuple(round_trip(ENERGY * (1 + k * APART)) for k in range(QUICK_WALK_DRAWS if quick else WALK_DRAWS))
    wraps, spacings = (QUICK_WRAPS, QUICK_SPACINGS) if quick else (WRAPS, SPACINGS)
    by_spacing = borders(
        lambda segments: tolerance_border(walks, segments=segments, wraps=2, x=segments), spacings,
        part_of(progress, 0.0, 0.5), "{} nodes a period",
    )  # fmt: skip
    by_wraps = borders(
        lambda count: tolerance_border(walks, segments=1, wraps=count, x=count), wraps, part_of(progress, 0.5, 1.0),
        "{} wraps",
    )  # fmt: skip
    return EdgeChart(
        name="edges-walks",
        title=f"Where shadowing ends: Down-Up to Up-Down and back at {ENERGY:g} J",
        maps=(
            EdgeMap("Two wraps", "nodes in a period", "tolerance of gaps, rad and rad/s", by_spacing,
                    far="not converged"),
            EdgeMap("One node in a period", "wraps", "tolerance of gaps, rad and rad/s", by_wraps,
                    far="not converged", log_x=False),
        ),
        reading=(
            "The smallest gap between pieces of orbit that Newton's method can reach: what rounding leaves.",
            "Left: it falls as nodes come nearer together. Right: many wraps are as good as none; one is worse.",
            "Rounding that grows by λ^(1/s) from node to node sets the scale; its constant is luck: no prediction.",
        ),
        chosen="Eight nodes in a period and a tolerance of 1e-11, three orders above what rounding leaves.",
    )  # fmt: skip


def round_trip(energy: float = ENERGY) -> tuple[Connection, ...]:
    """Return the lab's first crossing from Down-Up to Up-Down and the first one back."""
    system = load_model("lab").system
    edges = find_edges(system, energy, pairs=[("down-up", "up-down"), ("up-down", "down-up")])
    return edges.between("down-up", "up-down")[0], edges.between("up-down", "down-up")[0]


def rounding_floor(walk: Sequence[Connection], *, segments: int) -> float:
    """Return the gap in rad/s that rounding leaves between nodes, `segments` of them in a period."""
    fastest = max(
        float(np.abs(c.orbit.sample(np.linspace(c.orbit.times[0], c.orbit.times[-1], 400)))[:, 2:].max()) for c in walk
    )
    growth = max(c.source.unstable_multiplier for c in walk)
    return 0.5 * math.ulp(fastest) * growth ** (1 / segments)


def tolerance_border(walks: Sequence[Sequence[Connection]], *, segments: int, wraps: int, x: float) -> Border:
    """Return the smallest tolerance at which half of the walks' orbits are found with `segments` nodes a period."""

    def probe(tolerance: float) -> Attempt:
        settings = ShadowingSettings(segments, newton=NewtonSettings(tolerance=tolerance))
        orbits = [shadow(walk, wraps=[wraps], settings=settings) for walk in walks]
        return half_of([Attempt(orbit.converged, orbit.status) for orbit in orbits], "not converged")

    floor = rounding_floor(walks[0], segments=segments)
    line = f"{wraps} wraps, {segments} nodes"
    return find_border(probe, x=x, line=line, near=100 * floor, far=floor / 20, ratio=1.3)


WALK = "outer-turn"
METHOD, TOLERANCE = ReferenceSettings().method, ReferenceSettings().tolerance
FINE = 0.012
"""s: the mesh from whose error the border is predicted, about one and a half times as long."""
FRICTIONS = (0.0, 1.0, 2.0, 4.0)
QUICK_FRICTIONS = (1.0,)
TRACKS = (0.4, 0.01, 0.002)
QUICK_TRACKS = (0.01,)


def references_chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: one friction, the whole track."""
    frictions, tracks = (QUICK_FRICTIONS, QUICK_TRACKS) if quick else (FRICTIONS, TRACKS)
    meshes = borders(
        lambda friction: mesh_border(friction, x=float(frictions.index(friction))), frictions,
        part_of(progress, 0.0, 0.4), "friction × {:g}",
    )  # fmt: skip
    pushed = borders(acceleration_border, tracks, part_of(progress, 0.4, 1.0), "track ± {:g} m")
    return EdgeChart(
        name="edges-references",
        title="Where references end: one turn of the outer arm",
        maps=(
            EdgeMap(f"Mesh, {METHOD}", "friction, × the arms' own", f"interval for {TOLERANCE:g} between nodes, s",
                    meshes, log_x=False, far="not as good",
                    theory="the error falls as the interval to the power of the points"),
            EdgeMap("Limits", "track, ± m", "acceleration, m/s²", pushed, far="no reference"),
        ),
        reading=(
            f"Left: the longest equal intervals with which the error between nodes stays below {TOLERANCE:g}.",
            "Right: the least acceleration with which the motion exists on a track; the status names the limit.",
            f"Diamonds: from the error on one finer mesh, {1e3 * FINE:g} ms. Planning splits intervals where they err, "
            "and so gets by with fewer.",
        ),
        chosen="Seven points on 50 ms, split where the error asks for it; limits of the bench leave room of a hundred.",
    )  # fmt: skip


@cache
def _walk() -> tuple[Itinerary, Callable[[Array], Array], float]:
    itinerary = load_itinerary(WALK)
    orbit = shadowing_orbit(itinerary)
    return itinerary, orbit.sample, orbit.duration


def problem_of(friction: float = 1.0, limits: Limits | None = None) -> ReferenceProblem:
    """Return the turn with `friction` times the arms' own viscous friction, within `limits`."""
    itinerary, guess, duration = _walk()
    arms = replace(itinerary.model.arms, viscous=tuple(friction * k for k in itinerary.model.arms.viscous))
    equations = arm_chain_equations(arms.count, Level.CART, friction=arms.friction)
    return ReferenceProblem(
        equations=equations, parameters=arms.base(), guess=guess, duration=duration, limits=limits or Limits()
    )


def on_equal_intervals(problem: ReferenceProblem, interval: float, *, tolerance: float = TOLERANCE) -> Reference:
    """Return what one round gives on intervals of at most `interval` s, whatever the guess's own error."""
    method = method_named(METHOD)
    mesh = np.linspace(0.0, problem.duration, int(np.ceil(problem.duration / interval)) + 1)
    settings = ReferenceSettings(method=METHOD, interval=interval, tolerance=tolerance, rounds=1)
    return find_reference(problem, settings, near=first_trajectory(problem, method, mesh))


def mesh_border(friction: float, *, x: float) -> Border:
    """Return the longest interval, s, with which the turn is good to the tolerance between its nodes in one round."""
    problem = problem_of(friction)

    def probe(interval: float) -> Attempt:
        found = on_equal_intervals(problem, interval)
        return Attempt(found.converged, "" if found.converged else found.status)

    fine = on_equal_intervals(problem, FINE).max_error_between_nodes
    # What the product accepts is a little less than the tolerance.
    predicted = FINE * (0.8 * TOLERANCE / fine) ** (1 / len(method_named(METHOD).points))
    return find_border(
        probe, x=x, line=f"× {friction:g}", near=predicted / 1.6, far=1.6 * predicted, predicted=predicted, ratio=1.12
    )


def acceleration_border(track: float) -> Border:
    """Return the least acceleration, m/s², with which the turn exists on a track of ± `track` m."""

    def probe(acceleration: float) -> Attempt:
        found = find_reference(problem_of(limits=Limits(position=track, acceleration=acceleration)), _QUICKLY)
        return Attempt(found.converged, "" if found.converged else found.status)

    free = find_reference(problem_of(limits=Limits(position=track)), _QUICKLY)
    taken = free.max_cart_acceleration if free.converged else 10.0
    return find_border(probe, x=track, line=f"± {track:g} m", near=1.2 * taken, far=taken / 8, ratio=1.2)


_QUICKLY = ReferenceSettings(tolerance=1e-4)
