"""Solve the program of a reference with rockit, in another interpreter that has it; JSON in, JSON out.

The equations of the arms are typed here from the base parameters of the Lagrangian, without code of dpcontrol.
"""

import json
import sys

import casadi as ca
from rockit import DirectCollocation, Ocp

asked = json.load(sys.stdin)
m11, m12, m22, g1, g2, s1, s2, k1, k2 = asked["parameters"]
ocp = Ocp(T=asked["seconds"])
q1, q2, w1, w2, x, v = (ocp.state() for _ in range(6))
u = ocp.control()
across = m12 * ca.cos(q1 - q2)
pull = m12 * ca.sin(q1 - q2)
right1 = -pull * w2**2 - g1 * ca.sin(q1) - s1 * ca.cos(q1) * u - k1 * w1 - k2 * (w1 - w2)
right2 = pull * w1**2 - g2 * ca.sin(q2) - s2 * ca.cos(q2) * u - k2 * (w2 - w1)
det = m11 * m22 - across**2
rates = [w1, w2, (m22 * right1 - across * right2) / det, (m11 * right2 - across * right1) / det, v, u]
states = [q1, q2, w1, w2, x, v]
for state, rate in zip(states, rates, strict=True):
    ocp.set_der(state, rate)
ocp.add_objective(ocp.integral(u**2 + asked["cart_weight"] * x**2))
for k, state in enumerate(states):
    ocp.subject_to(ocp.at_t0(state) == asked["start"][k])
    ocp.subject_to(ocp.at_tf(state) == asked["end"][k])
    if k < 4:
        # Powers of time from the constant up, in rockit's own time symbol.
        ocp.set_initial(state, sum(c * ocp.t**i for i, c in enumerate(asked["guess"][k])))
ocp.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10})
ocp.method(DirectCollocation(N=asked["intervals"], M=1, degree=4, scheme="radau"))
solution = ocp.solve()
times = solution.sample(q1, grid="control")[0]
values = [solution.sample(state, grid="control")[1].tolist() for state in states]
json.dump({"times": times.tolist(), "states": values, "cost": float(solution.value(ocp.objective))}, sys.stdout)
