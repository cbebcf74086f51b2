"""One step of fixed length, as machine code: for plants whose input changes at known times.

    k_i = f(x + h Σ_{j<i} a_ij k_j, u; p),      x⁺ = x + h Σ_i b_i k_i        (12 stages, order 8)

The coefficients are those of DOP853, which scipy carries. The step's length is an input, so that one function serves
whole periods, parts of them and many plants at once. At 1 ms the double pendulum's error is round-off.

Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I (1993), section II.5.
"""

import casadi as ca
from scipy.integrate import DOP853

from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations


def fixed_step(equations: Equations) -> ca.Function:
    """Return (state (N,), inputs (m,), duration, parameters (p,)) -> following (N,), the inputs held."""
    f = equations.function()
    x, u, p, h = equations.state, equations.inputs, equations.parameters, ca.SX.sym("h")
    stages: list[ca.SX] = []
    for row in DOP853.A:
        shift = sum((float(a) * k for a, k in zip(row, stages, strict=False) if a), ca.SX.zeros(x.shape[0]))
        stages.append(f(x + h * shift, u, p))
    sloped = sum((float(b) * k for b, k in zip(DOP853.B, stages, strict=True) if b), ca.SX.zeros(x.shape[0]))
    names = ["state", "inputs", "duration", "parameters"]
    return ca.Function("fixed_step", [x, u, h, p], [ca.cse(ca.densify(x + h * sloped))], names, ["following"])


def compiled_step(equations: Equations) -> Compiled:
    """Return `fixed_step` as machine code, for (M,) or (M, S) inputs."""
    return Compiled(fixed_step(equations))
