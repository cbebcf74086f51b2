"""A reference from a shadowing orbit, or from one state to another: solve, measure between the nodes, refine, again.

Each round solves the program of `dpcontrol.references.transcription` on the present mesh, from the round before.
Then intervals whose error between nodes exceeds the tolerance are split, and a limit that a polynomial passes
between nodes is tightened by as much, until neither is needed. Where the search fails, or ends at another motion than
the guess's, friction is raised step by step: each solution starts the next, from no friction, where the guess is a
solution itself; steps are halved where one fails. How far that comes is an answer too. Where it fails, the status says
why, and what would help: limits, friction, authority, or the guess itself. Without friction and cart the shadowing
orbit itself is the reference.

A transfer (swing up from rest, come down to rest, change of orbit) follows nothing; its cost is the cart's effort and
travel. The guess turns each arm by a smooth curve without its ends' rates, from which direct collocation finds a
swing-up as well as a landing (35 of 36 tried; with the ends' rates in the guess 30, and half as gentle). Several
durations, and several lattice points to end on, are tried on a coarse mesh; the first that leaves the feedback room is
refined, or else the gentlest. Where it is known how errors grow along a motion under feedback, all are tried, and of
those that leave room the one is refined whose errors are smallest.

Sources: Betts, Practical Methods for Optimal Control Using Nonlinear Programming, 3rd ed., section 4.7; Nocedal &
Wright, Numerical Optimization, 2nd ed., section 11.3, for continuation; Kelly, An introduction to trajectory
optimization, SIAM Review 59 (2017), for transfers.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.references.method import Method, interpolation_matrix, method_named
from dpcontrol.references.problem import (
    ANGLE_SCALE,
    LIMIT_UNITS,
    RATE_SCALE,
    EndConditions,
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
    times_on,
    where_largest,
)
from dpcontrol.references.transcription import solve

_HELD = 300.0
"""Factor on the guess's weight if the solver fails or ends at another motion: it then wanders less. A walk of 10 s with
dry friction takes 42 iterations in place of 279."""
_STEP, _LEAST_STEP = 0.25, 1 / 32
"""Shares of the friction by which it is raised at first, and at least."""
_ROUNDING = 1e-12
_ITERATIONS = 40
"""Of the solver in a step: next to a solution it takes ten or so."""
FARTHEST = 0.45
"""How far (scaled) a reference may pass from the guess within a third of a second before it is another motion.

Outer turn at -0.07 J and crossing at 0.2 J: 0.37 at the most that friction did to the itinerary itself (15 times the
arms' own); from 0.55 where the search ended at another motion, and 1.8 from straight lines."""
_UNLIMITED = Limits(1e3, 1e3, 1e5)
_NO_AUTHORITY = 1e-9
_LIMIT_SLACK = 1e-10
"""How far a limit may be passed between nodes: rounding of the polynomials, a tenth of what is promised."""
_ACCEPTED = 0.8
_AIMED = 0.4
"""Shares of the tolerance: accepted, and aimed at in splitting; another dense grid may find a little more."""
_MOST_PIECES = 4
_MOST_GROWTH = 8
"""How many times the first mesh's intervals are worth solving for: beyond, the tolerance is out of reach."""


def friction_parameters(problem: ReferenceProblem) -> NDArray[np.bool_]:
    """Tell which parameters (p,) act on arms whose cart does not push, though the energy does not know them."""
    e = problem.equations
    slopes = ca.Function("slopes", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate, e.parameters)])
    # The cart stands still: terms in its velocity cancel but for rounding.
    anywhere = np.append(np.sqrt(np.arange(2.0, e.dimension)), [0.0, 0.0])
    effect = np.abs(np.array(ca.densify(slopes(anywhere, 0.0, problem.parameters)))).max(0)
    acts = effect > _ROUNDING * effect.max()
    return acts & ~np.array(ca.which_depends(e.hamiltonian, e.parameters, 1, False), dtype=bool)


def raise_friction(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits
) -> tuple[float, Solved | None]:
    """Solve with shares of the friction from none to all, never as far from the guess as another motion.

    Returns:
        The largest share that was made up for, and its solution with the iterations and seconds of all steps;
        not-a-number and None where there is none even without friction.
    """
    friction = friction_parameters(problem)
    reached, step, kept = np.nan, _STEP, None
    iterations, seconds = 0, 0.0
    quick = replace(settings, iterations=min(settings.iterations, _ITERATIONS))
    while not reached >= 1.0 and step >= _LEAST_STEP:
        share = 0.0 if kept is None else min(1.0, reached + step)
        parameters = np.where(friction, share * problem.parameters, problem.parameters)
        solved = solve(
            replace(problem, parameters=parameters), first if kept is None else kept.trajectory, settings=quick,
            limits=limits, warm=kept is not None,
        )  # fmt: skip
        iterations, seconds = iterations + solved.iterations, seconds + solved.seconds
        if solved.succeeded and away_from_guess(problem, solved.trajectory)[0] <= FARTHEST:
            reached, kept = share, solved
        elif kept is None:
            break
        else:
            step /= 2
    return reached, None if kept is None else replace(kept, iterations=iterations, seconds=seconds)


def has_authority(problem: ReferenceProblem, times: Array) -> bool:
    """Tell whether the cart's acceleration moves any arm, along the guess at `times` (K,)."""
    e, n = problem.equations, problem.pendulum_dimension // 2
    effect = ca.Function("effect", [e.state, e.inputs, e.parameters], [ca.jacobian(e.rate[n : 2 * n], e.inputs)])
    states = np.hstack([problem.guess_at(times), np.zeros((len(times), 2))])
    found = np.array(effect.map(len(times))(states.T, 0.0, problem.parameters))
    return bool(np.abs(found).max() > _NO_AUTHORITY)


def limits_passed(problem: ReferenceProblem, trajectory: Trajectory) -> str:
    """Say which of the problem's limits a motion without limits passes, by how much and when; empty if none."""
    largest = largest_values(trajectory, problem.limits)
    passed = [
        f"cart {name} of {largest[name]:.4g} {LIMIT_UNITS[name]} where {bound:.4g} is allowed (at t = "
        f"{where_largest(trajectory, name):.2f} s)"
        for name, bound in problem.limits.named().items()
        if largest[name] > bound
    ]
    if not passed:
        return ""
    return (
        f"without limits it takes a {' and a '.join(passed)}; limits that wide are enough: widen them, or choose a "
        "gentler itinerary"
    )


def wanting(problem: ReferenceProblem, first: Trajectory, settings: ReferenceSettings) -> str:
    """Say what prevented a solution: the cart's authority, limits, or the guess."""
    if not has_authority(problem, first.mesh):
        return "the cart's acceleration moves no arm, so nothing makes up for friction; check the arms' parameters"
    free = solve(problem, first, settings=settings, limits=_UNLIMITED)
    if not free.succeeded:
        return (
            "without limits it finds no solution either: check that the guess is an orbit of the same arms, or "
            "lower the friction"
        )
    return limits_passed(problem, free.trajectory) or (
        "the limits are not the reason, for without them the same motion is found; use shorter intervals"
    )


def friction_text(share: float) -> str:
    """Say how much of the friction could be made up for."""
    if np.isnan(share):
        return (
            "even without friction and limits the guess leads to no motion near it: check that it is an orbit of the "
            "same arms"
        )
    return (
        f"friction is out of reach: {share:.0%} of it can be made up for within the limits; lower the friction, "
        "widen the limits or choose a gentler itinerary"
    )


def guess_misses_its_ends(problem: ReferenceProblem) -> str:
    """Say where the guess is far from the states that the reference is to start and end in; empty if it is not."""
    nz, ends = problem.pendulum_dimension, problem.ends
    scale = state_scale(problem.equations.dimension, problem.limits)[:nz]
    first, last = problem.guess_at(np.array([0.0, problem.duration]))
    gaps = []
    for where, given, guessed in (("starts", ends.start, first), ("ends", ends.end, last)):
        if given is not None:
            gaps.append((where, given[:nz] - guessed))
    if ends.closing is not None:
        gaps.append(("closes", ends.closing[:nz] - (last - first)))
    for where, gap in gaps:
        away = float(np.nanmax(np.abs(gap) / scale, initial=0.0))
        if away > FARTHEST:
            return (
                f"the guess {where} {away:.2f} (scaled) from where the reference is to: an orbit integrated for "
                "several periods leaves itself, so tile one period instead"
            )
    return ""


def another_motion(away: float, when: float) -> str:
    """Say that what was found is not what was asked for."""
    return (
        f"no reference near the guess: the motion found passes {away:.2f} from it at t = {when:.2f} s (scaled by "
        f"{ANGLE_SCALE:.3g} rad and {RATE_SCALE:g} rad/s, more for faster arms; up to {FARTHEST:g} is the same "
        "motion), so it is another motion than the itinerary's; check that the guess is an orbit of the same arms, or "
        "lower the friction"
    )


def split_mesh(mesh: Array, errors: Array, *, tolerance: float, order: int) -> Array:
    """Return `mesh` (N+1,) with the intervals split whose error (N,) exceeds `tolerance`.

    The error of an interval falls as its length to the power `order`; at most four pieces at a time.
    """
    ratio = np.maximum(errors / (_AIMED * tolerance), 1e-300)
    pieces = np.ceil(np.minimum(ratio, 1e30) ** (1 / order)).astype(int)
    pieces = np.where(errors > _ACCEPTED * tolerance, np.clip(pieces, 2, _MOST_PIECES), 1)
    parts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(mesh[:-1], mesh[1:], pieces, strict=True)]
    return np.concatenate([*parts, mesh[-1:]])


def first_mesh(problem: ReferenceProblem, settings: ReferenceSettings, *, method: Method) -> Array:
    """Return equal intervals, split where the guess itself is not a polynomial of the method's degree.

    That interpolation error predicts the error between nodes within a factor of two, and spares a round.
    """
    count = max(int(np.ceil(problem.duration / settings.interval - 1e-9)), 1)
    mesh = np.linspace(0.0, problem.duration, count + 1)
    tau = np.linspace(0.0, 1.0, DENSE)
    times = np.minimum(times_on(mesh, tau), problem.duration)
    dense = problem.guess_at(times.ravel()).reshape(count, DENSE, -1)
    nodes = first_trajectory(problem, method, mesh).states[..., : problem.pendulum_dimension]
    smooth = np.einsum("dk,ikn->idn", interpolation_matrix(method.support, tau), nodes)
    scale = state_scale(problem.equations.dimension, problem.limits)[: problem.pendulum_dimension]
    errors = np.abs((smooth - dense) / scale).max((1, 2))
    return split_mesh(mesh, errors, tolerance=settings.tolerance, order=len(method.points))


def on_mesh(trajectory: Trajectory, mesh: Array, method: Method | None = None) -> Trajectory:
    """Return `trajectory` evaluated on another mesh of the same span, and as polynomials of another method if given."""
    # Places belong to the interval that holds the middle of their own, also at shared ends.
    index = np.searchsorted(trajectory.mesh, (mesh[:-1] + mesh[1:]) / 2, side="right") - 1
    starts, lengths = trajectory.mesh[index][:, None], np.diff(trajectory.mesh)[index][:, None]

    def moved(given: Array, places: Array, values: Array) -> Array:
        tau = (times_on(mesh, places) - starts) / lengths
        rows = interpolation_matrix(given, tau.ravel()).reshape(*tau.shape, -1)
        return np.asarray(np.einsum("ikj,ijn->ikn", rows, values[index]), dtype=np.float64)

    own, method = trajectory.method, method or trajectory.method
    states = moved(own.support, method.support, trajectory.states)
    return Trajectory(method, mesh, states, moved(own.points, method.points, trajectory.inputs))


def tail(reference: Reference, begin: float, *, seconds: float, turns: Array) -> Reference:
    """Return `seconds` of a reference from the time `begin` s on, to its end if that is sooner.

    turns (n,) rad: taken off its angles.
    """
    end = min(begin + seconds, float(reference.mesh[-1]))
    inside = (reference.mesh > begin + _NODE) & (reference.mesh < end - _NODE)
    cut = on_mesh(reference, np.concatenate([[begin], reference.mesh[inside], [end]]))
    cut.states[..., : len(turns)] -= turns
    return replace(reference, mesh=cut.mesh - begin, states=cut.states, inputs=cut.inputs)


_NODE = 1e-3
"""s: no interval is shorter."""


def _tightened(limits: Limits, asked: Limits, largest: dict[str, float]) -> Limits | None:
    """Return limits for the nodes that pull the polynomials inside `asked`, or None if they are inside."""
    changes = {}
    for name, bound in asked.named().items():
        over = largest[name] - bound
        if over > _LIMIT_SLACK:
            # More than the excess, which shifts to other intervals as the limit moves: this ends in a few rounds.
            changes[name] = max(limits.named()[name] - 1.5 * over - 1e-4 * bound, 0.5 * bound)
    return replace(limits, **changes) if changes else None


def _is_another_motion(problem: ReferenceProblem, solved: Solved, settings: ReferenceSettings) -> bool:
    """Tell whether the solver followed the guess to something that is not it; without a weight it follows nothing."""
    followed = settings.pendulum_weight > 0
    return followed and away_from_guess(problem, solved.trajectory)[0] > FARTHEST


def _near_guess(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits
) -> Solved | None:
    """Return a solution that a heavy weight keeps near the guess, or None."""
    if settings.pendulum_weight == 0:
        return None
    solved = solve(problem, first, settings=settings, limits=limits)
    return solved if solved.succeeded and not _is_another_motion(problem, solved, settings) else None


def _once_more(
    problem: ReferenceProblem, first: Trajectory, *, settings: ReferenceSettings, limits: Limits, failed: Solved
) -> tuple[Solved | None, str]:
    """Return a solution found by raising the friction, or none and a sentence that says why."""
    head = f"no reference: the solver stopped with {failed.outcome!r}"
    if failed.succeeded:
        head = another_motion(*away_from_guess(problem, failed.trajectory))
    if settings.pendulum_weight == 0 or not has_authority(problem, first.mesh):
        return None, f"{head}; {wanting(problem, first, settings)}"
    if not failed.succeeded:
        free = solve(problem, first, settings=settings, limits=_UNLIMITED)
        near = free.succeeded and not _is_another_motion(problem, free, settings)
        passed = limits_passed(problem, free.trajectory) if near else ""
        if passed:
            return None, f"{head}; {passed}"
    share, raised = raise_friction(problem, first, settings=settings, limits=limits)
    return (raised, "") if share >= 1.0 else (None, f"{head}; {friction_text(share)}")


def find_reference(
    problem: ReferenceProblem,
    settings: ReferenceSettings,
    *,
    near: Trajectory | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Find the reference nearest to the guess that friction, cart and limits allow.

    It starts on the guess's first state and ends on its last (within `end_tolerance`), cart at rest in the
    middle both times. Ending on the orbit itself costs up to 1.6 times the effort of a free end, but whatever
    holds the orbit afterwards starts without an error, and the last period shows the orbit.

    near: a trajectory of the same method that is nearly a solution, to start from instead of the guess.

    Returns:
        A reference; where `converged` is false it must not be used, and `status` says why and what to try.

    Raises:
        InputError: the guess has the wrong shape, is not finite or ends elsewhere than the reference is to, or a
            setting is impossible.
    """
    method = method_named(settings.method)
    apart = guess_misses_its_ends(problem) if settings.pendulum_weight > 0 else ""
    if apart:
        raise InputError(apart)
    first = near or first_trajectory(problem, method, first_mesh(problem, settings, method=method))
    most = _MOST_GROWTH * len(first.mesh)
    limits, iterations, seconds, round_number = problem.limits, 0, 0.0, 0

    def result(solved: Solved, status: str, *, converged: bool, error: float = np.inf) -> Reference:
        return Reference.of(
            solved.trajectory, problem.limits, status=status, converged=converged, max_error_between_nodes=error,
            constraint_violation=solved.violation, iterations=iterations, solve_seconds=seconds,
        )  # fmt: skip

    while True:
        progress(f"reference, {len(first.mesh) - 1} intervals", round_number / settings.rounds)
        round_number += 1
        solved = solve(problem, first, settings=settings, limits=limits, warm=bool(near) or round_number > 1)
        iterations, seconds = iterations + solved.iterations, seconds + solved.seconds
        if not solved.succeeded or _is_another_motion(problem, solved, settings):
            start = first_trajectory(problem, method, first.mesh)
            held = replace(settings, pendulum_weight=_HELD * settings.pendulum_weight)
            raised = _near_guess(problem, start, settings=held, limits=limits)
            if raised is not None:
                settings = held
            else:
                raised, why = _once_more(problem, start, settings=settings, limits=limits, failed=solved)
                if raised is None:
                    return result(replace(solved, trajectory=first), why, converged=False)
            solved = raised
            iterations, seconds = iterations + raised.iterations, seconds + raised.seconds
        errors = error_between_nodes(problem, solved.trajectory)
        worst = float(errors.max())
        largest = largest_values(solved.trajectory, problem.limits)
        tighter = _tightened(limits, problem.limits, largest)
        if worst <= _ACCEPTED * settings.tolerance and tighter is None:
            progress("reference", 1.0)
            return result(
                solved,
                f"converged in {iterations} iterations; error between nodes {worst:.1e} on {len(errors)} intervals",
                converged=True,
                error=worst,
            )
        finer = split_mesh(solved.trajectory.mesh, errors, tolerance=settings.tolerance, order=len(method.points))
        if round_number == settings.rounds or len(finer) > most:
            break
        first = on_mesh(solved.trajectory, finer)
        limits = tighter or limits
    passed = ", ".join(
        f"cart {name} passes its limit by {largest[name] - bound:.1e} {LIMIT_UNITS[name]}"
        for name, bound in problem.limits.named().items()
        if largest[name] > bound + _LIMIT_SLACK
    )
    return result(
        solved,
        f"not converged in {round_number} rounds: error between nodes {worst:.1e} where "
        f"{settings.tolerance:.1e} is asked{'; ' + passed if passed else ''}; start with a shorter interval, "
        "ask for less, or allow more rounds",
        converged=False,
        error=worst,
    )


def shadowed(problem: ReferenceProblem, settings: ReferenceSettings) -> Reference:
    """Return the guess of `problem` as a reference with the cart at rest; its parameters must be frictionless.

    The mesh is refined until the polynomials are within the tolerance of a motion; where they cannot be, because the
    guess is none, the status says so.
    """
    began = time.perf_counter()
    method = method_named(settings.method)
    mesh, rounds = first_mesh(problem, settings, method=method), 0
    while True:
        trajectory = first_trajectory(problem, method, mesh)
        errors = error_between_nodes(problem, trajectory)
        worst, rounds = float(errors.max()), rounds + 1
        if worst <= _ACCEPTED * settings.tolerance or rounds == settings.rounds:
            break
        mesh = split_mesh(mesh, errors, tolerance=settings.tolerance, order=len(method.points))
    converged = worst <= settings.tolerance
    status = f"the shadowing orbit itself; error between nodes {worst:.1e} on {len(errors)} intervals"
    if not converged:
        status = (
            f"not converged: the guess is {worst:.1e} from a frictionless motion where {settings.tolerance:.1e} is "
            'asked; check that it is an orbit of the same arms, or use level "cart"'
        )
    return Reference.of(
        trajectory, problem.limits, status=status, converged=converged, max_error_between_nodes=worst,
        solve_seconds=time.perf_counter() - began,
    )  # fmt: skip


@dataclass(frozen=True)
class TransferSettings:
    """How transfers are sought. durations: tried in turn, s; cart_weight: of the cart's position in the cost.

    longer: further durations, s, which are tried only if the first ones give no motion.
    gentle: the share of every limit that a transfer may use and leave the feedback room. iterations: of the solver in
    one try; interval: s, of the mesh on which tries are made, by a method of its own where one is named.
    """

    durations: tuple[float, ...] = (2.0, 2.5, 1.5, 3.0)
    longer: tuple[float, ...] = (4.0, 5.0)
    cart_weight: float = 100.0
    gentle: float = 0.7
    iterations: int = 100
    interval: float = 0.05
    method: str = ""

    @classmethod
    def of_arms(cls, count: int) -> "TransferSettings":
        """Return how transfers of so many arms are sought.

        From three arms on the tries are on a mesh of a third of the nodes: six tries from hanging to upright took 5 s
        in place of 69, and all of them ended, where finer meshes let the solver wander.
        """
        return cls() if count < 3 else cls(iterations=150, interval=0.1, method="radau-5")


def smooth_guess(start: Array, end: Array, duration: float) -> Guess:
    """Return the guess whose angles turn from those of start to those of end (2n,), at rest at both."""
    n = len(start) // 2
    change = end[:n] - start[:n]

    def guess(times: Array) -> Array:
        t = np.asarray(times, dtype=float)[:, None] / duration
        return np.hstack([start[:n] + change * (3 * t**2 - 2 * t**3), change * (6 * t - 6 * t**2) / duration])

    return guess


def find_transfer(
    equations: Equations,
    parameters: Array,
    *,
    start: Array,
    ends: Sequence[Array],
    limits: Limits,
    settings: ReferenceSettings,
    transfer: TransferSettings | None = None,
    sensitivity: Callable[[Trajectory], float] | None = None,
    progress: Progress = no_progress,
) -> Reference:
    """Return a reference from `start` (N,) to one of `ends` (N,), with friction, cart and limits.

    sensitivity: how large errors become along a motion under feedback, in any unit.

    Raises:
        GoalMissed: none of the durations and ends gave one; says what stood in the way of the last.
    """
    transfer = transfer or TransferSettings.of_arms(len(start) // 2 - 1)
    wanted = replace(settings, pendulum_weight=0.0, cart_weight=transfer.cart_weight, end_tolerance=0.0)
    tried = replace(wanted, iterations=transfer.iterations)
    method, trying = method_named(settings.method), method_named(transfer.method or settings.method)
    tries, further = (list(product(some, ends)) for some in (transfer.durations, transfer.longer))
    solved: list[tuple[bool, float, ReferenceProblem, Trajectory]] = []

    def sought(duration: float, end: Array) -> tuple[ReferenceProblem, Trajectory]:
        """Return one problem, and the guess on its coarse mesh."""
        guess, both = smooth_guess(start[:-2], end[:-2], duration), EndConditions(start=start, end=end)
        problem = ReferenceProblem(equations, parameters, guess, duration, limits=limits, ends=both)
        return problem, first_trajectory(problem, trying, even_mesh(duration, transfer.interval))

    (problem, first), outcome = sought(*tries[0]), ""
    for k, one in enumerate([*tries, *further]):
        if solved and k >= len(tries):
            break
        progress("transfer", k / (len(tries) + len(further)))
        problem, first = sought(*one)
        attempt = solve(problem, first, settings=tried, limits=limits)
        outcome = attempt.outcome
        if attempt.succeeded:
            largest = largest_values(attempt.trajectory, limits)
            share = max(largest[name] / bound for name, bound in limits.named().items())
            leaves_room = share <= transfer.gentle
            rank = sensitivity(attempt.trajectory) if leaves_room and sensitivity else share
            solved.append((not leaves_room, rank, problem, attempt.trajectory))
            if leaves_room and sensitivity is None:
                break
    for *_, chosen, trajectory in sorted(solved, key=lambda entry: entry[:2]):
        if trying is not method:
            trajectory = on_mesh(trajectory, even_mesh(trajectory.duration, settings.interval), method)
        found = find_reference(chosen, wanted, near=trajectory)
        outcome = found.status
        if found.converged:
            progress("transfer", 1.0)
            return found
    seconds = ", ".join(f"{duration:g}" for duration in (*transfer.durations, *transfer.longer))
    why = wanting(problem, first, tried)
    bounds = ", ".join(f"{name} {bound:g} {LIMIT_UNITS[name]}" for name, bound in limits.named().items())
    raise GoalMissed(f"no transfer in {seconds} s within the cart's limits ({bounds}): {outcome}; {why}")
