"""Rotating orbits and their families, compared with independent values, scipy and symmetries."""

import casadi as ca
import numpy as np
import pytest
from quick_rate import flown_by_scipy

from dpcontrol.foundation.causes import FamilyEndCause
from dpcontrol.orbits.rotating import (
    RotatingSettings,
    rotating_families,
    rotating_family,
    rotating_orbits,
)

STATE = 1e-9  # required; about 1e-13 is achieved
PERIOD = 1e-11
MULTIPLIER = 1e-8
DOP853 = 1e-8  # error of scipy's DOP853 at 1e-12 after a period, times multipliers of a few
LOCATED = 1e-9  # J: difference between two methods for the same change of stability

REFERENCE = {
    (2, -0.06985): (
        (0.0, 0.0, -13.01598498635436, 21.243853523780334),
        0.49753163832685887,
        (-2.7436245634812297, -0.36448135554347005),
        "inverse hyperbolic",
    ),
    (1, 0.2): (
        (0.0, 0.0, 20.70428441172521, -20.03102661145952),
        0.7111087096946145,
        (-0.2998122599 + 0.9539982227j, -0.2998122599 - 0.9539982227j),
        "elliptic",
    ),
}
"""(turning arm, energy): state, period, multipliers, kind; computed independently in 113-bit arithmetic."""


@pytest.fixture(scope="module")
def found(system):
    return {key: rotating_orbits(system, *key) for key in REFERENCE}


@pytest.fixture(scope="module")
def family(found):
    return rotating_family(found[2, -0.06985][-1], (-0.12, 0.42))


@pytest.mark.parametrize("key", REFERENCE, ids=str)
def test_the_scan_finds_the_reference_orbits(found, key):
    state, period, multipliers, kind = REFERENCE[key]
    orbit = min(found[key], key=lambda o: np.abs(o.state - state).max())
    assert np.abs(orbit.state - state).max() < STATE
    assert orbit.period == pytest.approx(period, abs=PERIOD)
    assert np.abs(orbit.floquet_multipliers - multipliers).max() < MULTIPLIER
    assert orbit.kind == kind
    assert orbit.converged


def test_every_orbit_closes_after_one_turn(system, found):
    for (arm, energy), orbits in found.items():
        assert orbits
        for orbit in orbits:
            assert orbit.winding == tuple(int(k == arm - 1) for k in range(2))
            assert float(system.numeric.hamiltonian(orbit.state)) == pytest.approx(energy, abs=1e-13)
            flown = flown_by_scipy(system, orbit.state, orbit.period)
            turned = orbit.state + 2 * np.pi * np.append(orbit.winding, [0, 0])
            assert np.abs(flown - turned).max() < DOP853 * max(1.0, abs(orbit.floquet_multipliers[0]))


def test_both_senses_are_reflections_of_each_other_and_a_finer_scan_finds_the_same_orbits(system, found):
    key = (2, -0.06985)
    back = rotating_orbits(system, *key, sense=-1)
    denser = rotating_orbits(system, *key, settings=RotatingSettings(first_angles=1111, jump=0.1))
    for there, here, again in zip(found[key], back, denser, strict=True):
        assert np.abs(there.state + here.state).max() < STATE
        assert here.winding == (0, -1)
        assert np.abs(there.state - again.state).max() < STATE


def test_the_other_arm_can_be_upright_on_the_symmetry_line(system):
    upright = [o for o in rotating_orbits(system, 1, 0.6) if o.state[1] > 3]
    assert upright
    assert all(o.state[1] == np.pi for o in upright)


@pytest.mark.slow
def test_a_family_stays_on_one_curve_and_reports_its_ends(family):
    assert family.converged
    states = np.array([m.state for m in family.members])
    assert np.abs(np.diff(states, axis=0)).max() < 2.0
    assert max(m.residual for m in family.members) < 1e-10
    assert (family.ends[1].cause, family.ends[1].energy) == (FamilyEndCause.ENERGY_BOUND, 0.42)


@pytest.mark.slow
def test_both_sides_of_a_stability_change_differ(system, family):
    change = next(c for c in family.changes if abs(c.orbit.energy - -0.07812225474946) < LOCATED)
    assert (change.critical_trace, change.before, change.after) == (-2.0, "inverse hyperbolic", "elliptic")
    for step, kind in ((-1e-3, "elliptic"), (1e-3, "inverse hyperbolic")):
        sides = rotating_orbits(system, 2, change.orbit.energy + step)
        assert min(sides, key=lambda o: np.abs(o.state - change.orbit.state).max()).kind == kind
    assert all(c.orbit.kind == "parabolic" or abs(abs(c.orbit.trace) - 2) < 1e-8 for c in family.changes)


@pytest.mark.slow
def test_a_family_folds_when_its_multipliers_meet_at_one(family):
    (fold,) = family.folds
    lowest = family.energies.min()
    assert lowest - 1e-3 < fold.energy <= lowest
    assert fold.trace == pytest.approx(2.0, abs=1e-8)


@pytest.mark.slow
def test_each_family_at_an_energy_is_followed_once(system, found):
    """The fold at -0.1107 J connects the two fastest of six orbits, so there are five families."""
    families = rotating_families(found[2, -0.06985], (-0.115, -0.05))
    assert len(found[2, -0.06985]) == 6
    assert [len(f.folds) for f in families] == [0, 0, 0, 0, 1]
    folded = families[-1]
    # Only the folded family has members with both periods at this energy, 0.498 and 0.781 s.
    there = [m.period for m in folded.members if abs(m.energy + 0.06985) < 0.02]
    assert min(there) < 0.52
    assert max(there) > 0.75


def test_multipliers_agree_with_finite_differences_of_the_poincare_map(system, found):
    orbit = found[1, 0.2][-1]
    energy = ca.Function("H", [system.equations.state, system.equations.parameters], [system.equations.hamiltonian])

    def on_energy(angle, rate_2):
        rate_1 = orbit.state[2]
        for _ in range(30):
            x = np.array([0.0, angle, rate_1, rate_2])
            rate_1 -= (float(energy(x, system.parameters)) - orbit.energy) / system.numeric.gradient(x)[2]
        return np.array([0.0, angle, rate_1, rate_2])

    def returned(angle, rate_2):
        x, t = on_energy(angle, rate_2), orbit.period
        for _ in range(8):
            end = system.propagator.flow(x, t)
            t -= (end[0] - 2 * np.pi) / end[2]
        end = system.propagator.flow(x, t)
        return np.array([end[1], end[3]])

    h = 1e-5
    base = orbit.state[1], orbit.state[3]
    columns = [
        (returned(base[0] + a, base[1] + b) - returned(base[0] - a, base[1] - b)) / (2 * h) for a, b in ((h, 0), (0, h))
    ]
    matrix = np.array(columns).T
    assert np.trace(matrix) == pytest.approx(orbit.trace, abs=1e-5)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-5)
