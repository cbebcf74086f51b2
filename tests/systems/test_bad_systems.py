"""Invalid systems, and systems without a required property, are refused."""

import casadi as ca
import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.dynamics.system import System
from dpcontrol.examples.henon_heiles import henon_heiles
from dpcontrol.foundation.causes import CutCause
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from tests.systems.hill import hill

TIME = ca.SX.sym("t")


def saddle(q, p, c):
    (x, y), (px, py) = q, p
    return (px**2 + py**2 + x**2 - y**2) / 2 + y**4 / 4


def made(energy=saddle, **given):
    return System.from_hamiltonian("odd", energy, **{"coordinates": ("x", "y"), "equilibria": {"top": (0, 0)}} | given)


def with_(change):
    return lambda q, p, c: saddle(q, p, c) + change(q, p, c)


BAD = {
    "no saddle": ({"energy": lambda q, p, c: sum(v**2 for v in (*q, *p))}, "no saddle of index one"),
    "no equilibrium": ({"energy": with_(lambda q, p, c: q[0] ** 3 + 2 * q[0])}, "no equilibrium.*nearer guess"),
    "two guesses of one": ({"equilibria": {"a": (0, 0), "b": (0, 0)}}, "a and b lead to one equilibrium"),
    "time": ({"energy": with_(lambda q, p, c: ca.cos(TIME))}, "depends on 't'"),
    "no expression": ({"energy": lambda q, p, c: None}, "fails on casadi"),
    "a parameter that is nan": ({"parameters": {"k": float("nan")}}, "parameter k = nan"),
    "three coordinates": ({"coordinates": ("x", "y", "z")}, "has two"),
    "a singularity": ({"energy": with_(lambda q, p, c: 1 / ca.sqrt(q[0] ** 2 + q[1] ** 2))}, "not finite"),
    "an operation": ({"energy": with_(lambda q, p, c: ca.fmin(q[0], 0) ** 3)}, "cannot be compiled"),
    "a period that is none": ({"periods": (6.28, None)}, "coordinate 1 does not repeat"),
    "a reverser that is none": (
        {"energy": with_(lambda q, p, c: q[0] ** 3), "reversers": [(-1, 1)]},
        "does not reverse its motion about top",
    ),
    "a section that there is not": ({"between": {("top", "top"): "left"}}, "names 'left'"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_system_is_refused(case):
    given, message = BAD[case]
    with pytest.raises(dp.InputError, match=message):
        made(**given)


def test_a_tube_that_never_returns_has_a_cause():
    """Both branches of the tube escape to infinity on an inverted parabola."""
    ours = made(lambda q, p, c: (p[0] ** 2 + p[1] ** 2 + q[0] ** 2 - q[1] ** 2) / 2)
    orbit = lyapunov_orbit(ours, "top", energy=0.1)
    search = dp.connections(orbit)
    assert search.connections == ()
    assert not search.complete
    assert {cut.cause for cut in search.cuts} == {CutCause.NEVER_ARRIVES}


def test_symmetries_are_found():
    signs = [np.sign(np.diag(r)).tolist() for r in made().reversers]
    assert signs == [[1, 1, -1, -1], [-1, -1, 1, 1]] or signs == [[1, 1, -1, -1], [-1, 1, 1, -1]]
    assert [np.diag(r).tolist() for r in hill().reversers] == [[1, -1, -1, 1]]
    assert len(henon_heiles().reversers) == 1
    declared = made(reversers=[(1, 1), (-1, 1)])
    ours, theirs = (lyapunov_orbit(s, "top", energy=0.2) for s in (made(reversers=[(1, 1)]), declared))
    assert ours.period == pytest.approx(theirs.period, rel=1e-12)
    assert ours.unstable_multiplier == pytest.approx(theirs.unstable_multiplier, rel=1e-9)


@pytest.mark.slow
def test_a_lagrangian_and_its_hamiltonian_give_the_same_motion():
    """In Hill's rotating frame, momenta differ from velocities: p = (vx - y, vy + x)."""

    def by_momenta(q, p, _):
        (x, y), (px, py) = q, p
        return ((px + y) ** 2 + (py - x) ** 2) / 2 - 1.5 * x**2 - 1 / ca.sqrt(x**2 + y**2)

    first = hill()
    second = System.from_hamiltonian(
        "hill", by_momenta, coordinates=("x", "y"), equilibria={"L2": (0.7, 0.0)}, scale=0.2,
        sections={"left": first.named_sections["left"]}, between={("L2", "L2"): "left"}, flight_periods=4.0,
    )  # fmt: skip
    orbits = [lyapunov_orbit(s, "L2", energy=-2.1) for s in (first, second)]
    assert orbits[0].period == pytest.approx(orbits[1].period, rel=1e-11)
    assert orbits[0].unstable_multiplier == pytest.approx(orbits[1].unstable_multiplier, rel=1e-8)
    found = [dp.connections(orbit).connections for orbit in orbits]
    assert len(found[0]) == len(found[1]) == 2
    for one, other in zip(*found, strict=True):
        assert first.numeric.momentum(one.state) == pytest.approx(other.state[2:], abs=1e-9)
