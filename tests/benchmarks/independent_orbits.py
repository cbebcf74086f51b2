"""A second search for orbits that a cart keeps against friction, to confirm refusals.

It shares no code with the package. For two arms, the orbit about a saddle is that of `independent_tubes`. One period of
the arms with friction is fitted to it by Hermite-Simpson collocation with IPOPT: the cart moves within its limits, from
any place with any velocity, and the mean square of the angles' distance from the orbit is least. The arms may start
beside the orbit.
"""

import tomllib
from pathlib import Path

import casadi as ca
import numpy as np
from independent_planner import acceleration, defects
from independent_tubes import LOST, Pendulum

Array = np.ndarray
INTERVALS = 80
KEPT = 0.1
"""rad: a run must stay as near to its last orbit over one period."""
PUSHED = 1e-7
"""Weight of the cart's mean square acceleration, rad² s⁴/m²; makes the least distance unique."""


def least_distance(model: dict, limits: dict, orbit: Array, period: float) -> float | None:
    """Return the largest distance of angles, rad, from an orbit (2K+1, 4) in the best fit; None if IPOPT fails."""
    count, h = 2 * INTERVALS + 1, period / INTERVALS
    x, u = ca.MX.sym("x", 6, count), ca.MX.sym("u", 1, count)
    slope = acceleration(model).map(count)(x, u)
    cost = ca.sumsqr(x[:2, :] - orbit[:, :2].T) / count + PUSHED * ca.sumsqr(u) / count
    program = {"x": ca.vertcat(ca.vec(x), ca.vec(u)), "f": cost, "g": ca.vec(defects(x, slope, h))}
    options = {"ipopt": {"print_level": 0, "max_iter": 1000, "sb": "yes"}, "print_time": False}
    solver = ca.nlpsol("kept", "ipopt", program, options)
    top = np.tile([np.inf] * 4 + [limits["position"], limits["velocity"]], (count, 1))
    pushes = np.full(count, limits["acceleration"])
    states = np.hstack([orbit, np.zeros((count, 2))])
    bound = np.concatenate([top.ravel(), pushes])
    out = solver(x0=np.concatenate([states.ravel(), 0 * pushes]), lbx=-bound, ubx=bound, lbg=0, ubg=0)
    if not solver.stats()["success"]:
        return None
    fitted = np.array(out["x"]).ravel()[: 6 * count].reshape(count, 6)
    return float(np.abs(fitted[:, :2] - orbit[:, :2]).max())


def unkept_orbits(itinerary: Path) -> list[str]:
    """Return the last orbit of an itinerary if the cart cannot keep the arms with friction within KEPT of it."""
    table = tomllib.loads(itinerary.read_text())
    model = tomllib.loads((itinerary.parent / table["model"]).read_text())
    part = table.get("parts", [table])[-1]
    if table.get("finish") != "orbit" or len(model["arms"]["mass"]) != 2 or "walk" not in part:
        return []
    name = part["walk"][-1].rstrip(" +-").split()[-1]
    pendulum = Pendulum(model)
    home = np.array([np.pi if word == "up" else 0.0 for word in name.split("-")])
    orbit = pendulum.orbit(home, part["energy"])
    if orbit is None or orbit.multiplier > LOST:
        return []
    times = np.linspace(0, orbit.period, 2 * INTERVALS + 1)
    places = pendulum.flow(orbit.start, orbit.period, t_eval=times).y.T
    away = least_distance(model, table["limits"], places, orbit.period)
    if away is not None and away < KEPT:
        return []
    how = "a fit that converges" if away is None else f"a motion nearer than {away:.2f} rad, with friction,"
    return [f"{how} to the orbit about {name} at {part['energy']:g} J"]
