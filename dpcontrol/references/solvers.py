"""Solvers of the nonlinear programs, by name, with the options that serve references.

Sources: Wächter & Biegler, Mathematical Programming 106 (2006), for IPOPT; Vanroye, Sathya, De Schutter & Decré,
FATROP: a fast constrained optimal control problem solver (2023).
"""

from typing import Any

from dpcontrol.references.problem import ReferenceSettings

Structure = tuple[list[int], list[int], list[int], list[bool]]


def solver_options(settings: ReferenceSettings, structure: Structure | None, *, warm: bool = False) -> dict[str, Any]:
    """Return casadi's options; structure: (states, inputs, constraints by stage, which are equal) for fatrop.

    warm: the search starts from a solution on another mesh, so a barrier far from it would only lead away.
    """
    shared: dict[str, Any] = {"print_time": False, "error_on_fail": False}
    if structure is not None:
        states, inputs, constraints, equal = structure
        return {
            **shared,
            "structure_detection": "manual",
            "N": len(states) - 1,
            "nx": states,
            "nu": inputs,
            "ng": constraints,
            "equality": equal,
            "fatrop.print_level": 0,
            "fatrop.max_iter": settings.iterations,
            "fatrop.tolerance": 1e-8,
        }
    return {
        **shared,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": settings.iterations,
        "ipopt.tol": 1e-8,
        "ipopt.constr_viol_tol": 1e-10,
        # IPOPT would otherwise widen every bound by 1e-8 before it starts.
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.mu_init": 1e-6 if warm else 0.1,
    }
