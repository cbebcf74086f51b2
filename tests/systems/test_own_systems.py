"""Three user systems, compared with independent integration of equations from the literature."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import dpcontrol as dp
from dpcontrol.examples.henon_heiles import henon_heiles
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.plans.atlas import AtlasSettings, compute_atlas, load_atlas, save_atlas
from dpcontrol.tubes.connections import find_connections
from tests.systems.hill import hill
from tests.systems.independent import Cut, Problem, crossings, orbit_near

STATE = 1e-9
"""Required accuracy; the linear manifolds of the independent seeds have errors of about 1e-10."""


def henon_heiles_rate(z):
    x, y, px, py = z
    return np.array([px, py, -x - 2 * x * y, -y - x**2 + y**2])


def henon_heiles_energy(z):
    x, y, px, py = z
    return (px**2 + py**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3


NUMBERS = {"m": 8.0, "D": 10.0, "lambda": 1.0, "zeta": 1.0, "V": 1.0, "w": 0.5**0.5}


def isomerisation(q, p, c):
    """De Leon and Berne (J. Chem. Phys. 75, 1981, 3495): two wells, a saddle, and a Morse oscillator across."""
    (x, y), (px, py) = q, p
    morse = c["D"] * (1 - ca.exp(-c["lambda"] * x)) ** 2
    wells = c["V"] / c["w"] ** 4 * y**2 * (y**2 - 2 * c["w"] ** 2) * ca.exp(-c["zeta"] * c["lambda"] * x)
    return (px**2 + py**2) / (2 * c["m"]) + morse + wells + c["V"]


def de_leon_berne():
    return dp.System.from_hamiltonian(
        "de-leon-berne",
        isomerisation,
        coordinates=("x", "y"),
        parameters=NUMBERS,
        equilibria={"barrier": (0.0, 0.0), "well": (0.2, 0.7)},
        scale=0.5,
    )


def de_leon_berne_rate(z):
    x, y, px, py = z
    well = 4 * y**2 * (y**2 - 1) * np.exp(-x)
    return np.array([px / 8, py / 8, well - 20 * (1 - np.exp(-x)) * np.exp(-x), -(16 * y**3 - 8 * y) * np.exp(-x)])


def de_leon_berne_energy(z):
    x, y, px, py = z
    return (px**2 + py**2) / 16 + 10 * (1 - np.exp(-x)) ** 2 + 4 * y**2 * (y**2 - 1) * np.exp(-x) + 1


def hill_rate(z):
    x, y, vx, vy = z
    cubed = (x**2 + y**2) ** 1.5
    return np.array([vx, vy, 2 * vy + 3 * x - x / cubed, -2 * vx - y / cubed])


def hill_energy(z):
    x, y, vx, vy = z
    return (vx**2 + vy**2) / 2 - 1.5 * x**2 - 1 / np.sqrt(x**2 + y**2)


def evenly(z):
    return np.full(z.shape[1], 0.1)


def nearer_the_primary(z):
    # All connections here stay farther away than 0.02.
    return 0.025 * np.clip(2 * np.hypot(z[0], z[1]), 0.04, 1.0) ** 1.5


MAKE = {"henon-heiles": henon_heiles, "de-leon-berne": de_leon_berne, "hill": hill}
BY_OTHERS = {
    "henon-heiles": Problem(henon_heiles_rate, henon_heiles_energy, (1, 1, -1, -1), evenly),
    "de-leon-berne": Problem(de_leon_berne_rate, de_leon_berne_energy, (1, 1, -1, -1), evenly),
    "hill": Problem(hill_rate, hill_energy, (1, -1, -1, 1), nearer_the_primary),
}


@dataclass(frozen=True)
class Case:
    """A search and its section, with height, condition and two coordinates."""

    system: str
    source: str
    target: str
    energy: float
    count: int
    height: object
    counts: object
    chart: object
    hit: int = 1
    longest: float = 40.0


def across(z):
    """The plane halfway between the top and left saddles of Hénon-Heiles contains the right one."""
    return z[0] / 2 + z[1] * 3**0.5 / 2


def along(z):
    return np.array([z[0] * 3**0.5 / 2 - z[1] / 2, z[2] * 3**0.5 / 2 - z[3] / 2])


def everywhere(z):
    return np.full(z.shape[1], True)


def turning(system, energy, count):
    counts = {"top": lambda z: np.abs(z[1] - 1) > 0.5, "barrier": lambda z: np.abs(z[1]) > 0.25}
    saddle = "top" if system == "henon-heiles" else "barrier"
    return Case(system, saddle, saddle, energy, count, lambda z: z[3], counts[saddle], lambda z: z[[0, 2]])


def between_hill(energy, count):
    chart = lambda z: np.array([z[1], z[3]])  # noqa: E731
    return Case("hill", "L2", "L1", energy, count, lambda z: z[0], everywhere, chart, hit=2, longest=12.5)


def between_two(energy, count):
    return Case("henon-heiles", "top", "left", energy, count, across, everywhere, along, hit=2)


CASES = [between_two(0.2, 4)]
MORE = [turning("henon-heiles", 0.2, 4), turning("de-leon-berne", 1.3, 4), between_hill(-2.0, 2)]


@cache
def system(name):
    return MAKE[name]()


@cache
def orbit(name, saddle, energy):
    return lyapunov_orbit(system(name), saddle, energy=energy)


@cache
def by_others(name, saddle, energy):
    ours = orbit(name, saddle, energy)
    moved = ours.state * (1 + 1e-5 * np.arange(1, 5))
    return orbit_near(BY_OTHERS[name], moved, 1.0001 * ours.period, energy)


ORBITS = sorted({(c.system, saddle, c.energy) for c in CASES + MORE for saddle in (c.source, c.target)})


@pytest.mark.parametrize(("name", "saddle", "energy"), ORBITS)
def test_lyapunov_orbits_agree_with_independent_ones(name, saddle, energy):
    ours, other = orbit(name, saddle, energy), by_others(name, saddle, energy)
    assert ours.converged
    assert np.abs(ours.state - other.state).max() < STATE
    assert ours.period == pytest.approx(other.period, abs=STATE)
    assert ours.unstable_multiplier == pytest.approx(other.multiplier, rel=1e-8)
    closed = BY_OTHERS[name].flow(ours.state, ours.period)
    assert np.abs(closed - ours.state).max() < STATE
    assert ours.residual < 1e-11


@pytest.mark.parametrize(
    "case",
    [
        *CASES,
        *(pytest.param(case, marks=pytest.mark.slow) for case in MORE),
    ],
    ids=lambda c: f"{c.system}-{c.source}-{c.target}-{c.energy}",
)
def test_all_first_connections_agree_with_brute_force(case):
    orbits = [orbit(case.system, saddle, case.energy) for saddle in (case.source, case.target)]
    search = find_connections(*orbits, hits=(case.hit, case.hit))
    cuts = {
        (saddle, branch): Cut(by_others(case.system, saddle, case.energy), case.height, case.counts, case.hit, branch,
                              case.longest)
        for saddle in (case.source, case.target) for branch in (1, -1)
    }  # fmt: skip
    found = [
        state
        for out in (1, -1)
        for back in (1, -1)
        for state in crossings(cuts[case.source, out], cuts[case.target, back], case.chart, 300)
    ]
    assert len(search.connections) == len(found) == case.count
    for connection in search.connections:
        assert min(np.abs(connection.state - state).max() for state in found) < STATE
        assert connection.residual < 1e-11
        assert connection.winding == (0, 0)
    assert len({connection.name for connection in search.connections}) == case.count


def test_values_of_the_literature():
    """Escape at 1/6 (Hénon and Heiles, 1964), Hill's problem (Szebehely, 1967) and the Morse oscillator's period."""
    ours = system("henon-heiles")
    assert ours.saddles == ("top", "left", "right")
    for saddle in ours.saddles:
        assert float(ours.numeric.hamiltonian(ours.equilibrium(saddle))) == pytest.approx(1 / 6, rel=1e-14)
    periods = [orbit("henon-heiles", saddle, 0.2).period for saddle in ours.saddles]
    assert periods == pytest.approx([periods[0]] * 3, rel=1e-12)
    ours = system("hill")
    for name, sign in (("L1", -1), ("L2", 1)):
        assert ours.equilibrium(name)[0] == pytest.approx(sign * 3 ** (-1 / 3), rel=1e-14)
        values = np.linalg.eigvals(ours.numeric.jacobian(ours.equilibrium(name)))
        assert max(values.real) == pytest.approx(np.sqrt(1 + 2 * np.sqrt(7)), rel=1e-12)
        assert max(values.imag) == pytest.approx(np.sqrt(2 * np.sqrt(7) - 1), rel=1e-12)
        assert float(ours.numeric.hamiltonian(ours.equilibrium(name))) == pytest.approx(-(3 ** (4 / 3)) / 2, rel=1e-14)
    for energy in (1.1, 1.3):
        expected = 2 * np.pi * np.sqrt(8 / 2 / (10 - (energy - 1)))
        assert orbit("de-leon-berne", "barrier", energy).period == pytest.approx(expected, rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "energy", "kinds"), [("de-leon-berne", 1.1, 1), ("henon-heiles", 0.2, 15), ("hill", -2.0, 6)]
)
def test_an_atlas_and_the_graph_contain_the_results_of_searches(name, energy, kinds):
    ours = system(name)
    found, graph = compute_atlas(ours, energy, settings=AtlasSettings()), dp.graph(ours, energy=energy)
    assert len(found.kinds) == kinds
    assert [o.saddle for o in found.orbits] == list(graph.saddles) == list(ours.saddles)
    assert found.rotating_orbits == ()
    first = [c.name for c in found.connections if c.hits == (1, 1)]
    assert sorted(first) == sorted(c.name for c in graph.connections)
    assert len(set(first)) == len(first)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "energy", "walk"),
    [
        ("de-leon-berne", 1.1, ["barrier +", "barrier -", "barrier +"]),
        ("henon-heiles", 0.2, ["top -", "top>left[0,0]h2.2@-0.3337,0.1484", "left +"]),
        ("hill", -2.0, ["L1 +", "L1>L2[0,0]h2.2@0.4316,0.0000", "L2 -"]),
    ],
)
def test_walks_are_shadowed_by_orbits_of_independent_equations(name, energy, walk):
    graph = dp.graph(system(name), energy=energy, symbols=walk)
    walked = dp.shadow(graph, walk)
    assert walked.converged
    times, states = walked.orbit.times, walked.orbit.states
    for k in range(0, len(times) - 1, 5):
        flown = BY_OTHERS[name].flow(states[k], times[k + 1] - times[k])
        assert np.abs(flown - states[k + 1]).max() < STATE
    closed = dp.shadow(graph, [walk[0]], periodic=True)
    assert closed.converged
    assert closed.orbit.times[-1] > orbit(name, walk[0].split()[0], energy).period


FOREIGN = re.compile(r"\d J\b|\d s\b|\((J|s|rad|rad/s)\)|θ|ω")


def texts(figure: Figure) -> str:
    return "\n".join(one.get_text() for one in figure.findobj(Text))


@pytest.mark.slow
def test_results_of_an_own_system_show_no_unit_of_si(tmp_path: Path) -> None:
    system = henon_heiles()
    orbit = dp.orbit(system, "top", energy=0.2)
    found = dp.connections(orbit)
    save_atlas(tmp_path / "atlas.npz", dp.atlas(system, energy=0.2))
    for result in (
        orbit,
        dp.family(system, "top", energies=(0.17, 0.2)),
        orbit.manifold(),
        found.connections[0],
        dp.shadow(found, [found.connections[0].name]),
        load_atlas(tmp_path / "atlas.npz"),
        dp.find_bifurcations(system, "top", "top", energies=(0.19, 0.2), samples=2),
    ):
        for shown in (repr(result), str(getattr(result, "status", "")), texts(result.plot())):
            assert not FOREIGN.search(shown), shown
