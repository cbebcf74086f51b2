"""Families of Lyapunov orbits: members, ends and events."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import mathieu_a

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.causes import FamilyEndCause
from dpcontrol.orbits.family import FollowingSettings, lyapunov_family
from dpcontrol.orbits.lyapunov import equilibrium
from tests.reference_values import LYAPUNOV_ORBITS

STATE = 1e-9  # required; about 1e-12 is achieved
RECIPROCAL = 1e-6  # multipliers of members are up to 1e7
CROSSING = 1e-10  # J: root of a determinant whose error is rounding times the multiplier, here about one
RATE = 0.03  # relative: the exponential law is asymptotic
LIMIT = 1e-4  # J: error of the extrapolated end


@pytest.fixture(scope="module")
def families(system):
    return {s: lyapunov_family(system, s, energies=(-1.0, 1.0)) for s in ("down-up", "up-down")}


@pytest.mark.slow
@pytest.mark.parametrize("saddle", ["down-up", "up-down"])
def test_both_families_end_in_homoclinics_of_up_up(families, system, saddle):
    family = families[saddle]
    assert family.converged
    assert [end.cause for end in family.ends] == [FamilyEndCause.SADDLE, FamilyEndCause.HOMOCLINICS]
    assert family.ends[1].equilibrium == "up-up"
    assert family.ends[1].limit == pytest.approx(equilibrium(system, "up-up").energy, abs=LIMIT)


@pytest.mark.slow
@pytest.mark.parametrize("saddle", ["down-up", "up-down"])
def test_the_period_grows_at_the_slow_rate_of_up_up(system, saddle):
    """With two passages of Up-Up per period, energy - limit ~ exp(-μ T/2), μ from the linearised equations."""
    # The law is asymptotic. Arcs remain accurate for much larger multipliers than monodromy matrices do.
    family = lyapunov_family(system, saddle, energies=(0.48, 1.0), settings=FollowingSettings(largest_multiplier=1e13))
    gap = equilibrium(system, "up-up").energy - family.energies[-6:]
    slope = np.polyfit(family.periods[-6:], np.log(gap), 1)[0]
    growth = equilibrium(system, "up-up").eigenvalues.real
    assert slope == pytest.approx(-growth[growth > 0].min() / 2, rel=RATE)


@pytest.mark.parametrize("saddle", ["down-up", "up-down"])
def test_energy_and_period_grow_together_and_multipliers_stay_reciprocal(families, saddle):
    family = families[saddle]
    assert np.all(np.diff(family.energies) > 0)
    assert np.all(np.diff(family.periods) > 0)
    assert not family.events
    products = family.floquet_multipliers[:, 0] * family.floquet_multipliers[:, -1]
    assert np.abs(products - 1).max() < RECIPROCAL


def test_the_member_at_a_bound_is_the_reference_orbit(system):
    family = lyapunov_family(system, "down-up", energies=(-0.07, 0.2))
    assert [end.cause for end in family.ends] == [FamilyEndCause.ENERGY_BOUND] * 2
    for member, energy in ((family.members[0], -0.07), (family.members[-1], 0.2)):
        state, period, multiplier, _ = LYAPUNOV_ORBITS["lab", "down-up", energy]
        assert member.energy == energy
        assert np.abs(member.state - state).max() < STATE
        assert member.period == pytest.approx(period, abs=STATE)
        assert member.unstable_multiplier == pytest.approx(multiplier, rel=1e-8)


def hill_system(growth, coupling):
    """H = ½(ẋ² + x²) + ½(ẏ² - growth y² + coupling x² y²): along y = 0, y obeys Mathieu's equation."""

    def hamiltonian(q, p, _):
        (x, y), (u, v) = q, p
        return (u**2 + x**2 + v**2 - growth * y**2 + coupling * x**2 * y**2) / 2

    return System.from_hamiltonian("hill", hamiltonian, coordinates=("x", "y"), equilibria={"origin": (0.0, 0.0)})


@pytest.mark.parametrize(("growth", "coupling"), [(1.0, 1.0), (0.5, 2.0)])
def test_hyperbolicity_is_lost_at_a_periodic_solution_of_mathieus_equation(growth, coupling):
    """x = √(2E) cos t makes ÿ + (bE - a + bE cos 2t) y = 0, periodic at the characteristic value a₀(bE/2)."""
    expected = brentq(lambda e: coupling * e - growth - mathieu_a(0, coupling * e / 2), 0.01, 3.0, xtol=1e-14)
    family = lyapunov_family(hill_system(growth, coupling), "origin", energies=(0.0, 5.0))
    assert family.ends[1].cause is FamilyEndCause.HYPERBOLICITY_LOST
    assert family.ends[1].multiplier == 1
    assert family.ends[1].energy == pytest.approx(expected, abs=CROSSING)
    assert np.all(np.abs(family.floquet_multipliers[:-1, 0]) > 1)


def test_a_limit_on_members_is_reported(system):
    family = lyapunov_family(system, "down-up", energies=(-1.0, 1.0), settings=FollowingSettings(most_members=5))
    assert not family.converged
    assert family.ends[1].cause is FamilyEndCause.MANY_MEMBERS
