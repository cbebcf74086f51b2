"""Equilibria and Lyapunov orbits, against independent values and the structure of Hamiltonian flows."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpcontrol.orbits.lyapunov import ContinuationSettings, SymmetricShooting, equilibria, lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.plans.model import load_model
from tests.reference_values import LYAPUNOV_ORBITS, SQUARED_EIGENVALUES

EIGENVALUES = 1e-10
PERIOD = 1e-11
MULTIPLIER = 1e-8
RECIPROCAL = 1e-9
CLOSURE = 5e-14  # times λ (1 + largest state): a few ulp of a rate, amplified over one period


@pytest.fixture(scope="module")
def systems():
    return {name: load_model(name).system for name in ("lab", "printed", "three-body")}


@pytest.fixture(scope="module")
def orbits(systems):
    return {key: lyapunov_orbit(systems[key[0]], key[1], energy=key[2]) for key in LYAPUNOV_ORBITS}


@pytest.mark.parametrize("key", SQUARED_EIGENVALUES, ids=" ".join)
def test_equilibria_have_the_reference_energies_and_eigenvalues(systems, key):
    energy, *squares = SQUARED_EIGENVALUES[key]
    found = equilibria(systems[key[0]])[key[1]]
    assert found.energy == pytest.approx(energy, rel=EIGENVALUES)
    assert np.allclose(sorted((found.eigenvalues**2).real), np.repeat(sorted(squares), 2), rtol=EIGENVALUES)
    unstable = sum(s > 0 for s in squares)
    assert found.kind == ("centre" if unstable == 0 else f"index-{unstable} saddle")


@pytest.mark.parametrize("key", LYAPUNOV_ORBITS, ids=str)
def test_lyapunov_orbits_are_the_reference_ones(orbits, key):
    state, period, multiplier, brake = LYAPUNOV_ORBITS[key]
    found = orbits[key]
    assert found.converged
    assert found.period == pytest.approx(period, rel=PERIOD)
    assert found.unstable_multiplier == pytest.approx(multiplier, rel=MULTIPLIER)
    assert np.abs(found.state - state).max() < 1e-11
    assert found.residual <= CLOSURE * multiplier * (1 + np.abs(found.state).max())
    quarter = found.system.propagator.flow(found.state, period / 4)
    assert np.abs(quarter - (*brake, 0.0, 0.0)).max() < 1e-11


@pytest.mark.parametrize("key", LYAPUNOV_ORBITS, ids=str)
def test_multipliers_come_in_reciprocal_pairs_with_a_pair_at_one(orbits, key):
    multipliers = orbits[key].floquet_multipliers
    assert len(multipliers) == 4
    assert abs(multipliers[0] * multipliers[3] - 1) < RECIPROCAL
    assert np.abs(multipliers[1:3] - 1).max() < 1e-9 * abs(multipliers[0])


@pytest.mark.parametrize("key", LYAPUNOV_ORBITS, ids=str)
def test_monodromy_is_symplectic_in_canonical_coordinates(orbits, key):
    orbit = orbits[key]
    to_canonical = np.vstack([np.eye(4)[:2], orbit.system.numeric.momentum_jacobian(orbit.state)])
    matrix = to_canonical @ orbit.monodromy @ np.linalg.inv(to_canonical)
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    size = np.abs(matrix).max() ** 2
    assert np.abs(matrix.T @ form @ matrix - form).max() < 1e-12 * size


def test_just_above_the_saddle_the_orbit_is_the_linear_centre(systems):
    point = equilibria(systems["lab"])["down-up"]
    orbit = lyapunov_orbit(systems["lab"], "down-up", energy=point.energy + 1e-9)
    frequency = abs(point.eigenvalues.imag).max()
    growth = point.eigenvalues.real.max()
    assert orbit.converged
    assert orbit.period == pytest.approx(2 * np.pi / frequency, rel=1e-7)
    assert np.log(orbit.unstable_multiplier) == pytest.approx(growth * orbit.period, rel=1e-6)


@pytest.mark.parametrize("energy", [-1.505, -1.5, -1.495])
def test_at_high_energies_the_orbit_belongs_to_its_family_for_any_step(systems, energy):
    """Other families cross nearby, so unchecked long steps end on orbits with less than half the period."""
    default, fine = (
        lyapunov_orbit(systems["three-body"], "L1", energy=energy, settings=settings)
        for settings in (ContinuationSettings(), ContinuationSettings(step=0.02))
    )
    assert default.converged
    assert fine.converged
    assert default.period == pytest.approx(fine.period, rel=1e-9)


def test_the_end_of_a_family_is_reported_after_few_arcs(systems, monkeypatch):
    flown = []
    arc = SymmetricShooting.arc

    def counted(problem, unknowns):
        flown.append(unknowns[-1])
        return arc(problem, unknowns)

    monkeypatch.setattr(SymmetricShooting, "arc", counted)
    orbit = lyapunov_orbit(systems["lab"], "up-down", energy=0.6)
    assert not orbit.converged
    # The family runs into the homoclinics of Up-Up, whose energy bounds it.
    assert orbit.outcome.reached == pytest.approx(equilibria(systems["lab"])["up-up"].energy, abs=1e-3)
    assert len(flown) < 300
    # Newton's method may reach arcs of any length. Long arcs once took a minute to integrate.
    assert max(flown) < 20 * orbit.period


@pytest.mark.parametrize("key", [("lab", "down-up", 0.2), ("lab", "up-down", 0.2)], ids=str)
def test_the_flow_maps_the_local_manifold_to_itself(orbits, key):
    orbit = orbits[key]
    manifold = UnstableManifold(orbit)
    for phase in (0.0, 0.17, 0.43, 0.61, 0.9):
        errors = []
        for amplitude in (1e-5, 1e-6):
            frame = manifold.frame(np.array([phase, phase + 0.3]))
            start, end = frame.states + np.array([[1], [np.exp(0.3 * manifold.exponent)]]) * amplitude * frame.vectors
            gap = orbit.system.propagator.flow(start, 0.3 * orbit.period) - end
            errors.append(orbit.system.scaled_distance(gap, np.zeros(4)))
        # The manifold is linear to first order, so the error is quadratic in the amplitude.
        assert errors[1] < 0.03 * errors[0] + 1e-13


FOLDED = """
title = "Folded arms"
system = "arm-chain"
[arms]
source = "a long inner arm and a short, light outer one"
mass = [0.366, 0.136]
centre_of_mass = [0.214, 0.0472]
length = [0.316, 0.101]
inertia = [3.24e-3, 8.14e-5]
[gravity]
source = "standard"
acceleration = 9.81
[friction]
source = "none"
viscous = [0.0, 0.0]
"""
IN_SURFACE = 1e-4
"""Rounding errors of the orbit, times the root of a multiplier of 1e14."""


def test_unstable_vectors_lie_in_the_energy_surface_at_any_phase_of_a_very_unstable_orbit(tmp_path: Path) -> None:
    path = tmp_path / "folded.toml"
    path.write_text(FOLDED)
    system = load_model(str(path)).system
    orbit = lyapunov_orbit(system, "down-up", energy=1.1575)
    assert orbit.unstable_multiplier > 1e13
    frame = UnstableManifold(orbit).frame(np.linspace(-1, 1, 41))
    slopes, vectors = system.numeric.gradient(frame.states) * system.scale, frame.vectors / system.scale
    # A flow that conserves energy moves no deviation out of the surfaces of equal energy, but that along the gradient.
    along = np.abs((slopes * vectors).sum(1)) / np.linalg.norm(slopes, axis=1) / np.linalg.norm(vectors, axis=1)
    assert along.max() < IN_SURFACE


SYSTEM = load_model("triple").system
SAME = 1e-9
"""Relative error of DOP853 at 3e-14, after one period of an orbit with multiplier 4e4: 2e-10."""
CLOSED = 1e-9


@pytest.mark.parametrize("saddle", SYSTEM.saddles)
@pytest.mark.parametrize("family", [0, 1])
def test_floquet_multipliers_of_three_arms_agree_with_dop853(saddle: str, family: int) -> None:
    """The pair at one is defective, with an error of the square root of rounding."""
    orbit = lyapunov_orbit(SYSTEM, saddle, energy=equilibria(SYSTEM)[saddle].energy + 0.05, family=family)
    assert orbit.converged
    n, numeric = SYSTEM.dimension, SYSTEM.numeric

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([numeric.rate(y[:n]), (numeric.jacobian(y[:n]) @ y[n:].reshape(n, n)).ravel()])

    first = np.concatenate([orbit.state, np.eye(n).ravel()])
    done = solve_ivp(rates, (0.0, orbit.period), first, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
    assert np.abs(done[:n] - orbit.state).max() < CLOSED
    found = np.array(orbit.floquet_multipliers)
    expected = np.linalg.eigvals(done[n:].reshape(n, n))
    unstable, stable = found[np.argmax(np.abs(found))], found[np.argmin(np.abs(found))]
    assert np.abs(expected / unstable - 1).min() < SAME
    assert abs(unstable * stable - 1) < SAME
    # A third degree of freedom adds a pair on the unit circle.
    centre = [m for m in found if abs(m.imag) > 1e-3]
    assert len(centre) == 2
    for multiplier in centre:
        assert np.abs(expected - multiplier).min() < SAME
        assert abs(abs(multiplier) - 1) < SAME
