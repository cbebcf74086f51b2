"""A second planner for motions between equilibria, to confirm refusals: no code is shared with the package.

It solves min ∫u² dt over a free duration by Hermite-Simpson collocation with IPOPT, within the cart's limits. The
equations come from the Lagrangian of arms in the plane. Initial guesses turn the arms smoothly from start to end and
add random sine waves; the cart follows random waves too. A solution is checked by integration.

Source: Kelly, An introduction to trajectory optimization, SIAM Review 59 (2017), sections 4 and 5.
"""

import tomllib
from collections.abc import Callable
from itertools import pairwise, product
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray
INTERVALS = 60
SHORTEST, LONGEST = 0.8, 8.0
"""Bounds of the duration, s."""
LANDS = 0.05
"""Largest distance, rad and rad/s, between a solution and its integration over one interval."""


def _energies(model: dict) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return the symbols of angles, rates, cart and its speed, and the kinetic and potential energy."""
    arms = model["arms"]
    n = len(arms["mass"])
    angles, rates = ca.SX.sym("q", n), ca.SX.sym("w", n)
    cart, speed = ca.SX.sym("x"), ca.SX.sym("v")
    joint, joint_speed = [cart, ca.SX(0)], [speed, ca.SX(0)]
    kinetic, potential = ca.SX(0), ca.SX(0)
    for i in range(n):
        along = [ca.sin(angles[i]), -ca.cos(angles[i])]
        turning = [ca.cos(angles[i]) * rates[i], ca.sin(angles[i]) * rates[i]]
        centre = [j + arms["centre_of_mass"][i] * a for j, a in zip(joint, along, strict=True)]
        centre_speed = [j + arms["centre_of_mass"][i] * t for j, t in zip(joint_speed, turning, strict=True)]
        kinetic += arms["mass"][i] * (centre_speed[0] ** 2 + centre_speed[1] ** 2) / 2
        kinetic += arms["inertia"][i] * rates[i] ** 2 / 2
        potential += arms["mass"][i] * model["gravity"]["acceleration"] * centre[1]
        joint = [j + arms["length"][i] * a for j, a in zip(joint, along, strict=True)]
        joint_speed = [j + arms["length"][i] * t for j, t in zip(joint_speed, turning, strict=True)]
    return angles, rates, cart, speed, kinetic, potential


def mechanical_energy(model: dict) -> Callable[[Array], float]:
    """Return angles and rates (2n,) -> energy of the arms on a cart that stands, J, zero at the pivot's height."""
    angles, rates, cart, speed, kinetic, potential = _energies(model)
    energy = ca.Function("energy", [ca.vertcat(angles, rates, cart, speed)], [kinetic + potential])
    return lambda state: float(energy(np.append(state, [0.0, 0.0])))


def acceleration(model: dict) -> ca.Function:
    """Return (state, input) -> rate of change, for arms on a cart with prescribed acceleration."""
    friction = model["friction"]
    angles, rates, cart, speed, kinetic, potential = _energies(model)
    push, n = ca.SX.sym("u"), angles.shape[0]
    momenta = ca.gradient(kinetic, rates)
    mass = ca.jacobian(momenta, rates)
    relative = [rates[0], *(rates[i] - rates[i - 1] for i in range(1, n))]
    coulomb = friction.get("coulomb", [0.0] * n)
    # Dry friction is smoothed a little more than in any model, so that coarse intervals can follow it.
    width = max(friction.get("smoothing", 0.05), 0.2)
    lost = sum(
        friction["viscous"][i] * r**2 / 2 + coulomb[i] * ca.sqrt(r**2 + width**2) for i, r in enumerate(relative)
    )
    force = ca.gradient(kinetic - potential, angles) - ca.gradient(lost, rates)
    force -= ca.jtimes(momenta, angles, rates) + ca.jacobian(momenta, speed) * push
    state = ca.vertcat(angles, rates, cart, speed)
    return ca.Function("rate", [state, push], [ca.vertcat(rates, ca.solve(mass, force), speed, push)])


def defects(x: ca.MX, slope: ca.MX, h: ca.MX | float) -> ca.MX:
    """Return the gaps of Hermite and of Simpson for intervals of h, given states and slopes at ends and middles."""
    a, m, b = _places(x.shape[1])
    return ca.horzcat(
        x[:, b] - x[:, a] - h / 6 * (slope[:, a] + 4 * slope[:, m] + slope[:, b]),
        x[:, m] - (x[:, a] + x[:, b]) / 2 - h / 8 * (slope[:, a] - slope[:, b]),
    )


def _places(count: int) -> tuple[slice, slice, slice]:
    """Return where the starts, middles and ends of intervals are."""
    return slice(0, count - 2, 2), slice(1, count, 2), slice(2, count, 2)


def _guess(
    generator: np.random.Generator, start: Array, end: Array, *, reach: float, duration: float
) -> tuple[Array, Array]:
    count = 2 * INTERVALS + 1
    n = len(start) // 2 - 1
    s = np.linspace(0, 1, count)[:, None]
    waves = generator.normal(size=(4, n + 1)) * np.append(np.full(n, generator.choice([0.0, 0.5, 1.5])), 0.1)
    shape = np.sin(np.pi * s * np.arange(1, 5))
    places = np.append(start[:n], 0.0), np.append(end[:n], 0.0)
    q = places[0] + (places[1] - places[0]) * (3 * s**2 - 2 * s**3) + shape @ waves
    q[:, n] = np.clip(q[:, n], -reach, reach)
    v = np.gradient(q, duration / (count - 1), axis=0)
    states = np.hstack([q[:, :n], v[:, :n], q[:, n:], v[:, n:]])
    return states, np.gradient(v[:, n], duration / (count - 1))


def find_motion(model: dict, start: Array, end: Array, *, limits: dict, attempts: int, seed: int) -> bool:
    """Return whether an attempt found a motion from `start` to `end` (2n+2,) within the limits."""
    rate, size = acceleration(model), len(start)
    n = size // 2 - 1
    bounds = np.array([np.inf] * 2 * n + [limits["position"], limits["velocity"]])
    count = 2 * INTERVALS + 1
    x, u, duration = ca.MX.sym("x", size, count), ca.MX.sym("u", 1, count), ca.MX.sym("T")
    slope = rate.map(count)(x, u)
    h = duration / INTERVALS
    a, m, b = _places(count)
    cost = h / 6 * ca.sum2(u[:, a] ** 2 + 4 * u[:, m] ** 2 + u[:, b] ** 2)
    program = {"x": ca.vertcat(ca.vec(x), ca.vec(u), duration), "f": cost, "g": ca.vec(defects(x, slope, h))}
    options = {"ipopt": {"print_level": 0, "max_iter": 400, "sb": "yes", "tol": 1e-6}, "print_time": False}
    solver = ca.nlpsol("independent", "ipopt", program, options)
    top = np.tile(bounds, (count, 1))
    low, high = -top, top.copy()
    low[0] = high[0] = start
    low[-1] = high[-1] = end
    pushes = np.full(count, limits["acceleration"])
    generator = np.random.default_rng(seed)
    for _ in range(attempts):
        seconds = generator.uniform(1.5, 5.0)
        states, inputs = _guess(generator, start, end, reach=0.8 * limits["position"], duration=seconds)
        out = solver(
            x0=np.concatenate([states.ravel(), inputs, [seconds]]),
            lbx=np.concatenate([low.ravel(), -pushes, [SHORTEST]]),
            ubx=np.concatenate([high.ravel(), pushes, [LONGEST]]), lbg=0, ubg=0,
        )  # fmt: skip
        if not solver.stats()["success"]:
            continue
        values = np.array(out["x"]).ravel()
        states, inputs = values[: size * count].reshape(count, size), values[size * count : -1]
        if _gap(rate, states, inputs, float(values[-1])) < LANDS:
            return True
    return False


def _gap(rate: ca.Function, states: Array, inputs: Array, duration: float) -> float:
    """Return the largest miss of an interval that is integrated with the parabola of its inputs."""
    h, worst = duration / INTERVALS, 0.0
    for k in range(INTERVALS):
        u = inputs[2 * k : 2 * k + 3]
        parabola = np.polyfit([0, h / 2, h], u, 2)

        def slope(t: float, x: Array, of: Array = parabola) -> Array:
            return np.array(rate(x, np.polyval(of, t))).ravel()

        landed = solve_ivp(slope, (0, h), states[2 * k], rtol=1e-8, atol=1e-10).y[:, -1]
        worst = max(worst, float(np.abs(landed - states[2 * k + 2]).max()))
    return worst


def missing_transfers(itinerary: Path, *, attempts: int, seed: int = 0) -> list[str]:
    """Return the transfers between equilibria that an itinerary needs and no attempt found, such as "rest to up-up".

    Orbits stand for their saddles. Every way round that differs by half a turn is tried.
    """
    table = tomllib.loads(itinerary.read_text())
    model = tomllib.loads((itinerary.parent / table["model"]).read_text())
    n = len(model["arms"]["mass"])
    missing = []
    for before, after in dict.fromkeys(_transfers(table, n)):
        ways = product(*([0.0] if a == b else [np.pi, -np.pi] for a, b in zip(before, after, strict=True)))
        start = np.zeros(2 * n + 2)
        start[:n] = [np.pi if up else 0.0 for up in before]
        ends = (np.concatenate([start[:n] + way, np.zeros(n + 2)]) for way in ways)
        tries = (find_motion(model, start, end, limits=table["limits"], attempts=attempts, seed=seed) for end in ends)
        if not any(tries):
            missing.append(f"{_name(before)} to {_name(after)}")
    return missing


def _name(place: "Place") -> str:
    return "-".join("up" if up else "down" for up in place) if any(place) else "rest"


Place = tuple[bool, ...]
"""True for each arm that points up."""


def _transfers(table: dict, count: int) -> list[tuple[Place, Place]]:
    """Return the places that an itinerary's transfers lead from and to; a walk itself is no transfer."""

    def place(name: str) -> Place:
        return tuple(word == "up" for word in name.split("-"))

    rest = (False,) * count
    stays = [(rest, rest)] if table.get("start") == "rest" else []
    for part in table.get("parts", [table]):
        if "hold" in part:
            stays.append((place(part["hold"]), place(part["hold"])))
        elif "walk" in part:
            first, last = part["walk"][0], part["walk"][-1]
            stays.append((place(first.split()[0]), place(last.rstrip(" +-").split()[-1])))
    stays += [(rest, rest)] if table.get("finish") == "rest" else []
    return [(before[1], after[0]) for before, after in pairwise(stays) if before[1] != after[0]]
