"""The reference of a scene without friction and cart: the shadowing orbit itself, as polynomials on a mesh."""

import time

from dpcontrol.references.errors import error_between_nodes, interval_propagator
from dpcontrol.references.find import first_mesh, split_mesh
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference
from dpcontrol.references.trajectory import first_trajectory

AIMED = 0.8


def shadowed(problem: ReferenceProblem, settings: ReferenceSettings) -> Reference:
    """Return the guess of `problem` as a reference with the cart at rest; its parameters must be frictionless.

    The mesh is refined until the polynomials are within the tolerance of a motion; where they cannot be, because the
    guess is none, the status says so.
    """
    began = time.perf_counter()
    method = method_named(settings.method)
    mesh, propagator = first_mesh(problem, settings, method=method), interval_propagator(problem, method)
    rounds = 0
    while True:
        trajectory = first_trajectory(problem, method, mesh)
        errors = error_between_nodes(problem, trajectory, method=method, propagator=propagator)
        worst, rounds = float(errors.max()), rounds + 1
        if worst <= AIMED * settings.tolerance or rounds == settings.rounds:
            break
        mesh = split_mesh(mesh, errors, tolerance=settings.tolerance, order=len(method.points))
    converged = worst <= settings.tolerance
    status = f"the shadowing orbit itself; error between nodes {worst:.1e} on {len(errors)} intervals"
    if not converged:
        status = (
            f"not converged: the guess is {worst:.1e} from a frictionless motion where {settings.tolerance:.1e} is "
            'asked; check that it is an orbit of the same arms, or use level "cart"'
        )
    return Reference(
        mesh=trajectory.mesh,
        method=method,
        states=trajectory.states,
        inputs=trajectory.inputs,
        limits=problem.limits,
        status=status,
        converged=converged,
        max_error_between_nodes=worst,
        constraint_violation=0.0,
        max_cart_position=0.0,
        max_cart_velocity=0.0,
        max_cart_acceleration=0.0,
        rms_cart_acceleration=0.0,
        iterations=0,
        solve_seconds=time.perf_counter() - began,
    )
