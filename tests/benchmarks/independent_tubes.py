"""A second search for the connections of a walk, to confirm rejections. It shares no code with the package.

For two arms without friction, it computes the periodic orbit about a saddle at an energy and its largest multiplier. It
also tests whether an arm can turn along its tubes, from the orbit back to itself. The equations are those of
`independent_planner`, and scipy's DOP853 integrates everything.

    orbit    from the saddle's angles with rates (r cos a, r sin a) to a stop at a quarter of the period

    tube     trajectories that leave the orbit along its unstable direction, until the arm hangs half-way

    turns    (θ, ω)(t) → (-θ, ω)(-t) makes the stable tube of the unstable one: their cuts (θ, ω of the other arm) meet
             where a cut meets its own mirror image

Source: Koon, Lo, Marsden & Ross (2000), section 4.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from independent_planner import acceleration, mechanical_energy
from scipy.integrate import solve_ivp
from scipy.optimize import root

Array = np.ndarray
PRECISE = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
LOST = 1e11
"""Largest multiplier of an orbit whose tube is resolvable in double precision."""
STEPS, SEGMENTS, PHASES = 24, 12, 160
OFF = 3e-4
"""rad: how far from the orbit the tube's trajectories start."""
PERIODS = 6.0
"""A trajectory that has not turned after so many periods does not turn."""


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit: first state (4,), period s, unstable direction (4,) and multiplier."""

    start: Array
    period: float
    direction: Array
    multiplier: float


class Pendulum:
    """Two arms without friction on a cart that stands."""

    def __init__(self, model: dict) -> None:
        free = {**model, "friction": {"viscous": [0.0, 0.0]}}
        state = ca.SX.sym("state", 4)
        rate = acceleration(free)(ca.vertcat(state, 0, 0), 0)[:4]
        self._rate = ca.Function("free", [state], [rate])
        self._slopes = ca.Function("slopes", [state], [ca.jacobian(rate, state)])
        self.energy = mechanical_energy(model)

    def flow(self, state: Array, seconds: float, **options: object) -> object:
        """Return scipy's solution from a state (4,)."""
        return solve_ivp(lambda _, x: np.array(self._rate(x)).ravel(), (0, seconds), state, **PRECISE, **options)

    def _spinning(self, home: Array, angle: float, energy: float) -> Array:
        state = np.concatenate([home, [np.cos(angle), np.sin(angle)]])
        still = self.energy(np.concatenate([home, [0.0, 0.0]]))
        state[2:] *= np.sqrt(max(energy - still, 0.0) / (self.energy(state) - still))
        return state

    def orbit(self, home: Array, energy: float) -> Orbit | None:
        """Return the orbit about a saddle's angles (2,) at an energy, None if its family is not followed so far."""
        values, vectors = np.linalg.eig(np.array(self._slopes(np.concatenate([home, [0.0, 0.0]])))[2:, :2])
        mode = vectors[:, np.argmin(values.real)].real
        still = self.energy(np.concatenate([home, [0.0, 0.0]]))
        found = np.array([np.arctan2(mode[1], mode[0]), np.pi / 2 / np.sqrt(-values.real.min())])
        for height in (energy - still) * np.linspace(0.02, 1.0, STEPS) ** 2:

            def miss(values: Array, height: float = height) -> Array:
                end = self.flow(self._spinning(home, values[0], still + height), max(values[1], 1e-3)).y[2:, -1]
                return np.asarray(end) / np.sqrt(height)

            solved = root(miss, found, tol=1e-11)
            if np.abs(solved.fun).max() > 1e-6:
                return None
            found = solved.x
        start, period = self._spinning(home, found[0], energy), 4 * float(found[1])
        direction, multiplier = self._unstable(start, period)
        return Orbit(start, period, direction, multiplier)

    def _unstable(self, start: Array, period: float) -> tuple[Array, float]:
        product, state, size = np.eye(4), start, 1e-6
        for _ in range(SEGMENTS):
            step = period / SEGMENTS
            columns = [
                (self.flow(state + size * e, step).y[:, -1] - self.flow(state - size * e, step).y[:, -1]) / (2 * size)
                for e in np.eye(4)
            ]
            product, state = np.column_stack(columns) @ product, self.flow(state, step).y[:, -1]
        values, vectors = np.linalg.eig(product)
        k = int(np.argmax(np.abs(values)))
        return vectors[:, k].real / np.linalg.norm(vectors[:, k].real), float(abs(values[k]))

    def turns(self, orbit: Orbit, arm: int, sense: int) -> bool:
        """True if a trajectory leads from the orbit back to it with one direct turn of an arm."""
        times = np.linspace(0, orbit.period, PHASES, endpoint=False)
        beside = 1e-3 * OFF / orbit.multiplier
        centre = self.flow(orbit.start, orbit.period, t_eval=times).y.T
        moved = self.flow(orbit.start + beside * orbit.direction, orbit.period, t_eval=times).y.T - centre
        place = orbit.start[arm] + sense * np.pi

        def half_way(_: float, state: Array) -> float:
            return float(state[arm] - place)

        half_way.terminal, half_way.direction = True, sense
        for side in (1, -1):
            cut = []
            for state, away in zip(centre, moved, strict=True):
                first = state + side * OFF * away / np.linalg.norm(away)
                hits = self.flow(first, PERIODS * orbit.period, events=half_way).y_events[0]
                other = 1 - arm
                away_from_home = hits[0][other] - orbit.start[other] if len(hits) else np.nan
                cut.append([away_from_home, hits[0][2 + other] if len(hits) else np.nan])
            curve = np.array([*cut, cut[0]])
            if _meet(curve, curve * [-1, 1]):
                return True
        return False


def _meet(first: Array, second: Array) -> bool:
    """True if two polylines (K, 2) cross; not-a-number ends a piece."""
    a, b = first[:-1, None], first[1:, None]
    c, d = second[None, :-1], second[None, 1:]

    def side(p: Array, q: Array, r: Array) -> Array:
        return np.sign((q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0])

    with np.errstate(invalid="ignore"):
        crossed = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return bool(crossed.any())


def missing_connections(itinerary: Path) -> list[str]:
    """Return the required orbits and turns of an itinerary that this search does not find.

    Crossings from one saddle to another are checked by their orbits only.
    """
    table = tomllib.loads(itinerary.read_text())
    model = tomllib.loads((itinerary.parent / table["model"]).read_text())
    if len(model["arms"]["mass"]) != 2:
        return []
    pendulum, missing = Pendulum(model), []
    for part in table.get("parts", [table]):
        energy, turns = part.get("energy", 0.0), []
        names: list[str] = []
        for symbol in part.get("walk", []):
            words = symbol.split()
            names += [words[0], words[2] if words[1] == ">" else words[0]]
            turns += [] if words[1] == ">" else [symbol]
        orbits: dict[str, Orbit] = {}
        for name in dict.fromkeys(names):
            orbit = pendulum.orbit(np.array([np.pi if word == "up" else 0.0 for word in name.split("-")]), energy)
            if orbit is not None and orbit.multiplier < LOST:
                orbits[name] = orbit
                continue
            factor = "" if orbit is None else f", which multiplies errors by {orbit.multiplier:.0e}"
            missing.append(f"the orbit about {name} at {energy:g} J{factor}")
        for symbol in dict.fromkeys(turns):
            saddle, sense = symbol.split()
            arm = saddle.split("-").index("up")
            if saddle in orbits and not pendulum.turns(orbits[saddle], arm, 1 if sense == "+" else -1):
                missing.append(f"{symbol!r} at {energy:g} J")
    return missing
