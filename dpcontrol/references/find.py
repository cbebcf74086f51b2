"""Find a reference from an orbit or between two states, with mesh refinement.

Each round solves the program of `dpcontrol.references.transcription` on the current mesh, starting from the previous
solution. Intervals whose error between nodes exceeds the tolerance are then split. If a polynomial exceeds a limit
between nodes, that limit is tightened by the excess. The rounds end when neither change is needed. If the solver fails
or converges to a different motion, friction is raised in steps. This continuation starts without friction, since the
guess then is a solution, and halves its step after a failure. If it fails too, the status reports the share of friction
reached, the cause (limits, friction, authority or guess) and a remedy. Without friction and cart, the shadowing orbit
is the reference.

A transfer (swing-up, landing, change of orbit, side-step) has no orbit to follow; its cost is the cart's effort and
travel. `dpcontrol.plans.candidates` has its first motions.

Sources: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7. Nocedal &
Wright, Numerical Optimization, 2nd ed., section 11.3, for continuation. Kelly, An introduction to trajectory
optimization, SIAM Review 59 (2017), for transfers.
"""

import time
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ObstacleCause, ReferenceCause
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.references.ending import Obstacle, ReferenceEnding
from dpcontrol.references.method import Method, interpolation_matrix, method_named
from dpcontrol.references.problem import (
    Guess,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    state_scale,
)
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import (
    DENSE,
    Solved,
    Trajectory,
    away_from_guess,
    error_between_nodes,
    even_mesh,
    first_trajectory,
    largest_values,
    limit_uses,
    times_on,
)
from dpcontrol.references.transcription import solve

_HELD = 300.0
"""Factor on the guess's weight if the solver fails or converges to another motion, to keep it near the guess. A walk of
10 s with dry friction then takes 42 iterations instead of 279."""
_STEP, _LEAST_STEP = 0.25, 1 / 32
"""First and smallest step of the friction continuation, as shares of the friction."""
_ROUNDING = 1e-12
_ITERATIONS = 40
"""Iteration limit of one continuation step; close to a solution, about ten suffice."""
FARTHEST = 0.45
"""Largest scaled distance from the guess, within a third of a second, that still counts as the same motion.

Measured for an outer turn at -0.07 J and a crossing at 0.2 J. With 15 times the arms' own friction, the reference
stayed within 0.37 of the itinerary. Other motions were at least 0.55 away, or 1.8 from straight-line guesses."""
_UNLIMITED = Limits(1e3, 1e3, 1e5)
_NO_AUTHORITY = 1e-9
_LIMIT_SLACK = 1e-10
"""Tolerated excess over a limit between nodes: rounding of the polynomials, a tenth of the guaranteed accuracy."""
_ACCEPTED = 0.8
_AIMED = 0.4
"""Shares of the tolerance: accepted, and targeted by splitting; another dense grid may find a slightly larger error."""
_MOST_PIECES = 4
_MOST_GROWTH = 8
"""Largest growth of the mesh, as a multiple of the first; beyond it, the tolerance is out of reach."""


def friction_parameters(problem: ReferenceProblem) -> NDArray[np.bool_]:
    """Return a mask (p,) of the friction parameters, so that friction alone can be raised in steps.

    These are the parameters that act without cart input but are not in the energy.

    Args:
        problem: equations with p parameters.
    """
    equations = problem.equations
    slopes = ca.Function(
        "slopes",
        [equations.state, equations.inputs, equations.parameters],
        [ca.jacobian(equations.rate, equations.parameters)],
    )
    # A generic state of the arms, at which no effect vanishes. The cart is at rest: terms in its velocity cancel to
    # rounding.
    sample_state = np.append(np.sqrt(np.arange(2.0, equations.dimension)), [0.0, 0.0])
    effects = np.abs(np.array(ca.densify(slopes(sample_state, 0.0, problem.parameters)))).max(0)
    has_effect = effects > _ROUNDING * effects.max()
    return has_effect & ~np.array(ca.which_depends(equations.hamiltonian, equations.parameters, 1, False), dtype=bool)


def raise_friction(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits
) -> tuple[float, Solved | None]:
    """Raise friction from zero to its full value by continuation, with solutions that stay near the guess.

    Args:
        problem: equations with full friction, and the guess.
        first: guess on its mesh.
        settings: settings of the solver.
        limits: limits of the cart.

    Returns:
        The largest share of friction compensated, and its solution with the iterations and seconds of all steps;
        NaN and None if there is no solution even without friction.
    """
    friction = friction_parameters(problem)
    reached_share, step, solution = np.nan, _STEP, None
    iterations, seconds = 0, 0.0
    quick = replace(settings, iterations=min(settings.iterations, _ITERATIONS))
    while not reached_share >= 1.0 and step >= _LEAST_STEP:
        share = 0.0 if solution is None else min(1.0, reached_share + step)
        parameters = np.where(friction, share * problem.parameters, problem.parameters)
        solved = solve(
            replace(problem, parameters=parameters), first if solution is None else solution.trajectory, settings=quick,
            limits=limits, search="fresh" if solution is None else "warm",
        )  # fmt: skip
        iterations, seconds = iterations + solved.iterations, seconds + solved.seconds
        if solved.succeeded and away_from_guess(problem, solved.trajectory)[0] <= FARTHEST:
            reached_share, solution = share, solved
        elif solution is None:
            break
        else:
            step /= 2
    return reached_share, None if solution is None else replace(solution, iterations=iterations, seconds=seconds)


def has_authority(problem: ReferenceProblem, times: Array) -> bool:
    """Return True if the cart's acceleration moves any arm somewhere along the guess.

    Args:
        problem: equations and guess.
        times: times (K,), s.
    """
    equations, n = problem.equations, problem.pendulum_dimension // 2
    effect_of_input = ca.Function(
        "effect",
        [equations.state, equations.inputs, equations.parameters],
        [ca.jacobian(equations.rate[n : 2 * n], equations.inputs)],
    )
    states = np.hstack([problem.guess_at(times), np.zeros((len(times), 2))])
    effects = np.array(effect_of_input.map(len(times))(states.T, 0.0, problem.parameters))
    return bool(np.abs(effects).max() > _NO_AUTHORITY)


def limits_passed(problem: ReferenceProblem, trajectory: Trajectory) -> Obstacle | None:
    """Return the cart's limits that a motion exceeds as an obstacle, or None if it exceeds none.

    Args:
        problem: limits of the cart.
        trajectory: motion.
    """
    passed_limits = tuple(use for use in limit_uses(trajectory, problem.limits) if use.share > 1)
    return Obstacle(ObstacleCause.LIMITS, uses=passed_limits) if passed_limits else None


def wanting(problem: ReferenceProblem, first: Trajectory, settings: ReferenceSettings) -> Obstacle:
    """Return the obstacle that explains a failed solution: the cart's authority, its limits, the guess or the mesh.

    Args:
        problem: problem without a solution.
        first: guess on its mesh.
        settings: settings of the solver.
    """
    if not has_authority(problem, first.mesh):
        return Obstacle(ObstacleCause.AUTHORITY)
    unlimited = solve(problem, first, settings=settings, limits=_UNLIMITED)
    if not unlimited.succeeded:
        return Obstacle(ObstacleCause.GUESS)
    return limits_passed(problem, unlimited.trajectory) or Obstacle(ObstacleCause.MESH)


def split_mesh(mesh: Array, errors: Array, *, tolerance: float, order: int) -> Array:
    """Return a mesh in which the intervals whose error exceeds the tolerance are split.

    The error of an interval scales with its length to the power `order`. An interval is split into at most four.

    Args:
        mesh: ends of the intervals (N+1,), s.
        errors: scaled errors (N,).
        tolerance: largest scaled error.
        order: power of an interval's length to which its error is proportional.
    """
    error_ratio = np.maximum(errors / (_AIMED * tolerance), 1e-300)
    pieces = np.ceil(np.minimum(error_ratio, 1e30) ** (1 / order)).astype(int)
    pieces = np.where(errors > _ACCEPTED * tolerance, np.clip(pieces, 2, _MOST_PIECES), 1)
    parts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(mesh[:-1], mesh[1:], pieces, strict=True)]
    return np.concatenate([*parts, mesh[-1:]])


def first_mesh(problem: ReferenceProblem, settings: ReferenceSettings, *, method: Method) -> Array:
    """Return an even mesh, split where the method's polynomials do not resolve the guess.

    This interpolation error predicts the error between nodes within a factor of two, which saves a round.

    Args:
        problem: problem with a guess.
        settings: longest interval and tolerance.
        method: collocation method.
    """
    count = max(int(np.ceil(problem.duration / settings.interval - 1e-9)), 1)
    mesh = np.linspace(0.0, problem.duration, count + 1)
    tau = np.linspace(0.0, 1.0, DENSE)
    times = np.minimum(times_on(mesh, tau), problem.duration)
    guess_states = problem.guess_at(times.ravel()).reshape(count, DENSE, -1)
    node_states = first_trajectory(problem, method, mesh).states[..., : problem.pendulum_dimension]
    polynomial_states = np.einsum("dk,ikn->idn", interpolation_matrix(method.support, tau), node_states)
    scale = state_scale(problem.equations.dimension, problem.limits)[: problem.pendulum_dimension]
    errors = np.abs((polynomial_states - guess_states) / scale).max((1, 2))
    return split_mesh(mesh, errors, tolerance=settings.tolerance, order=len(method.points))


def on_mesh(trajectory: Trajectory, mesh: Array, method: Method | None = None) -> Trajectory:
    """Return a trajectory interpolated on another mesh of equal span, and for another method if one is given.

    Args:
        trajectory: motion.
        mesh: ends of the new intervals (N+1,), s.
        method: another collocation method; None for the same.
    """
    # The midpoint of a new interval selects its old one, so shared ends are unambiguous.
    index = np.searchsorted(trajectory.mesh, (mesh[:-1] + mesh[1:]) / 2, side="right") - 1
    starts, lengths = trajectory.mesh[index][:, None], np.diff(trajectory.mesh)[index][:, None]

    def moved(points: Array, places: Array, values: Array) -> Array:
        """Return values at new places of the new intervals, by the old polynomials through `values` at `points`."""
        tau = (times_on(mesh, places) - starts) / lengths
        rows = interpolation_matrix(points, tau.ravel()).reshape(*tau.shape, -1)
        return np.asarray(np.einsum("ikj,ijn->ikn", rows, values[index]), dtype=np.float64)

    old_method, method = trajectory.method, method or trajectory.method
    states = moved(old_method.support, method.support, trajectory.states)
    return Trajectory(method, mesh, states, moved(old_method.points, method.points, trajectory.inputs))


def tail(reference: Reference, begin: float, *, seconds: float, turns: Array) -> Reference:
    """Return a part of a reference as a reference whose time begins at zero.

    Args:
        reference: reference to cut.
        begin: begin of the part, s.
        seconds: duration, s, at most to the end.
        turns: subtracted from the angles (n,), rad.

    Returns:
        The part. Ends of intervals within 1 ms of its own ends are left out of its mesh.
    """
    end = min(begin + seconds, float(reference.mesh[-1]))
    inside = (reference.mesh > begin + _NODE) & (reference.mesh < end - _NODE)
    part = on_mesh(reference, np.concatenate([[begin], reference.mesh[inside], [end]]))
    part.states[..., : len(turns)] -= turns
    return replace(reference, mesh=part.mesh - begin, states=part.states, inputs=part.inputs)


_NODE = 1e-3
"""Shortest interval, s."""


def _tightened(limits: Limits, required: Limits, largest: dict[str, float]) -> Limits | None:
    """Return limits for the nodes that pull the polynomials inside the cart's limits, or None if they are inside.

    Args:
        limits: limits at the nodes in the last solution.
        required: the cart's limits.
        largest: largest size of each limited quantity along the solution, by name.
    """
    tighter_bounds = {}
    for name, bound in required.named().items():
        excess = largest[name] - bound
        if excess > _LIMIT_SLACK:
            # The excess shifts to other intervals as the limit moves; tightening by more ends in a few rounds.
            tighter_bounds[name] = max(limits.named()[name] - 1.5 * excess - 1e-4 * bound, 0.5 * bound)
    return replace(limits, **tighter_bounds) if tighter_bounds else None


def _is_another_motion(problem: ReferenceProblem, solved: Solved, settings: ReferenceSettings) -> bool:
    """Return True if a solution is too far from the guess to be the same motion.

    It is False if the cost does not weigh the distance from the guess (`settings`), since any motion is then allowed.
    """
    follows_guess = settings.pendulum_weight > 0
    return follows_guess and away_from_guess(problem, solved.trajectory)[0] > FARTHEST


def _near_guess(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits
) -> Solved | None:
    """Return a solution that a heavy weight in `settings` keeps near the guess, or None if there is none.

    `first` is the guess on its mesh, and `limits` bound the cart at the nodes. A problem without a guess has no
    solution.
    """
    if settings.pendulum_weight == 0:
        return None
    solved = solve(problem, first, settings=settings, limits=limits)
    return solved if solved.succeeded and not _is_another_motion(problem, solved, settings) else None


def _once_more(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits, failed: Solved
) -> Solved | Obstacle:
    """Return a solution found by raising the friction in steps, or the obstacle that prevents it.

    Args:
        problem: equations with full friction, and the guess.
        first: guess on its mesh.
        settings: settings of the solver.
        limits: limits of the cart at the nodes.
        failed: result of the search that failed.
    """
    if settings.pendulum_weight == 0 or not has_authority(problem, first.mesh):
        return wanting(problem, first, settings)
    if not failed.succeeded:
        unlimited = solve(problem, first, settings=settings, limits=_UNLIMITED)
        is_near = unlimited.succeeded and not _is_another_motion(problem, unlimited, settings)
        if is_near and (passed_limits := limits_passed(problem, unlimited.trajectory)):
            return passed_limits
    share, solution = raise_friction(problem, first, settings=settings, limits=limits)
    if solution is None:
        return Obstacle(ObstacleCause.NO_MOTION)
    return solution if share >= 1.0 else Obstacle(ObstacleCause.FRICTION, share=share)


def _failure(problem: ReferenceProblem, failed: Solved, obstacle: Obstacle) -> ReferenceEnding:
    """Return the ending of a search that failed or found a different motion, with the obstacle that explains it.

    `failed`: result of the solver.
    """
    if not failed.succeeded:
        return ReferenceEnding(ReferenceCause.SOLVER, answer=failed.outcome, obstacle=obstacle)
    distance, time = away_from_guess(problem, failed.trajectory)
    return ReferenceEnding(
        ReferenceCause.OTHER_MOTION, distance=distance, times=(time,), allowed=FARTHEST, obstacle=obstacle
    )


def _solve_near(problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits) -> Solved:
    """Return the solution near a nearly converged motion `first`; it may have failed.

    The solver starts with a small barrier, and with a large one if that fails because the motion is too far. `limits`
    bound the cart at the nodes.
    """
    solved = solve(problem, first, settings=settings, limits=limits, search="warm")
    return solved if solved.succeeded else solve(problem, first, settings=settings, limits=limits)


def find_reference(
    problem: ReferenceProblem,
    settings: ReferenceSettings,
    *,
    near: Trajectory | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Find the reference nearest to the guess that respects friction, cart and limits.

    It starts at the guess's first state and ends at its last (within `end_tolerance`), with the cart at rest at the
    centre. Ending on the orbit costs up to 1.6 times the effort of a free end. In return, a controller that holds the
    orbit starts without error, and the last period shows the orbit.

    Args:
        problem: equations, guess, limits and ends.
        settings: settings of the solution.
        near: a nearly converged trajectory of the same method to start from instead of the guess.
        progress: called with a label and the completed share.

    Returns:
        A reference. If `converged` is false it must not be used; `status` has the reason and a remedy.

    Raises:
        InputError: an unknown method, or a formulation that the solver does not support.
    """
    method = method_named(settings.method)
    first = near or first_trajectory(problem, method, first_mesh(problem, settings, method=method))
    most_nodes = _MOST_GROWTH * len(first.mesh)
    limits, iterations, seconds, round_number = problem.limits, 0, 0.0, 0

    def result(solved: Solved, ending: ReferenceEnding) -> Reference:
        """Return a solution as the reference of the whole search, which `ending` concludes."""
        return Reference.of(
            solved.trajectory, problem.limits, ending=ending, converged=ending.cause is ReferenceCause.CONVERGED,
            max_error_between_nodes=ending.error, constraint_violation=solved.violation, iterations=iterations,
            solve_seconds=seconds,
        )  # fmt: skip

    while True:
        progress(f"reference, {len(first.mesh) - 1} intervals", round_number / settings.rounds)
        round_number += 1
        search = _solve_near if near or round_number > 1 else solve
        solved = search(problem, first, settings=settings, limits=limits)
        iterations, seconds = iterations + solved.iterations, seconds + solved.seconds
        if not solved.succeeded or _is_another_motion(problem, solved, settings):
            start = first_trajectory(problem, method, first.mesh)
            heavy_settings = replace(settings, pendulum_weight=_HELD * settings.pendulum_weight)
            replacement = _near_guess(problem, start, settings=heavy_settings, limits=limits)
            if replacement is not None:
                settings = heavy_settings
            else:
                replacement = _once_more(problem, start, settings=settings, limits=limits, failed=solved)
                if isinstance(replacement, Obstacle):
                    return result(replace(solved, trajectory=first), _failure(problem, solved, replacement))
            solved = replacement
            iterations, seconds = iterations + replacement.iterations, seconds + replacement.seconds
        errors = error_between_nodes(problem, solved.trajectory)
        worst = float(errors.max())
        tighter = _tightened(limits, problem.limits, largest_values(solved.trajectory, problem.limits))
        if worst <= _ACCEPTED * settings.tolerance and tighter is None:
            progress("reference", 1.0)
            success = ReferenceEnding(
                ReferenceCause.CONVERGED, iterations=iterations, error=worst, intervals=len(errors)
            )
            return result(solved, success)
        finer_mesh = split_mesh(solved.trajectory.mesh, errors, tolerance=settings.tolerance, order=len(method.points))
        if round_number == settings.rounds or len(finer_mesh) > most_nodes:
            break
        first = on_mesh(solved.trajectory, finer_mesh)
        limits = tighter or limits
    uses = limit_uses(solved.trajectory, problem.limits)
    passed = tuple(use for use in uses if use.largest > use.bound + _LIMIT_SLACK)
    return result(
        solved,
        ReferenceEnding(
            ReferenceCause.ROUNDS, rounds=round_number, error=worst, allowed=settings.tolerance, uses=passed
        ),
    )


def shadowed(problem: ReferenceProblem, settings: ReferenceSettings) -> Reference:
    """Return the reference along a frictionless guess, whose cart stays at rest, without optimisation.

    The mesh is refined until the polynomials satisfy the equations within the tolerance. If the guess is not a motion
    of the arms, that is impossible and the status reports it.

    Args:
        problem: problem without friction.
        settings: mesh, tolerance and rounds.
    """
    begin = time.perf_counter()
    method = method_named(settings.method)
    mesh, rounds = first_mesh(problem, settings, method=method), 0
    while True:
        trajectory = first_trajectory(problem, method, mesh)
        errors = error_between_nodes(problem, trajectory)
        largest_error, rounds = float(errors.max()), rounds + 1
        if largest_error <= _ACCEPTED * settings.tolerance or rounds == settings.rounds:
            break
        mesh = split_mesh(mesh, errors, tolerance=settings.tolerance, order=len(method.points))
    converged = largest_error <= settings.tolerance
    cause = ReferenceCause.SHADOWING_ORBIT if converged else ReferenceCause.NO_ORBIT
    ending = ReferenceEnding(cause, error=largest_error, intervals=len(errors), allowed=settings.tolerance)
    return Reference.of(
        trajectory, problem.limits, ending=ending, converged=converged, max_error_between_nodes=largest_error,
        solve_seconds=time.perf_counter() - begin,
    )  # fmt: skip


def smooth_guess(start: Array, end: Array, duration: float) -> Guess:
    """Return a guess that turns the arms smoothly from one state to another, at rest at both ends.

    Args:
        start: first state (2n,) of the arms, rad and rad/s.
        end: last state (2n,) of the arms, rad and rad/s.
        duration: time between both states, s.
    """
    n = len(start) // 2
    change = end[:n] - start[:n]

    def guess(times: Array) -> Array:
        """Return the arms' states (K, 2n) at times (K,), s."""
        t = np.asarray(times, dtype=float)[:, None] / duration
        return np.hstack([start[:n] + change * (3 * t**2 - 2 * t**3), change * (6 * t - 6 * t**2) / duration])

    return guess


def refined_transfer(
    problem: ReferenceProblem, motion: Trajectory, settings: ReferenceSettings, *, cart_weight: float
) -> Reference:
    """Return the reference near a motion that connects two states, of least effort and travel.

    Args:
        problem: the transfer's problem.
        motion: the motion, on any mesh.
        settings: settings of the solution.
        cart_weight: weight of the cart's position in the cost, 1/s⁴.
    """
    transfer_settings = replace(settings, pendulum_weight=0.0, cart_weight=cart_weight, end_tolerance=0.0)
    mesh = even_mesh(motion.duration, settings.interval)
    return find_reference(problem, transfer_settings, near=on_mesh(motion, mesh, method_named(settings.method)))
