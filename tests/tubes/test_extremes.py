"""Extreme cases: just above a saddle, high energies, grazing crossings, and energies without reference values."""

from decimal import Decimal

import numpy as np
import pytest

from dpcontrol.dynamics.system import momentum_scale
from dpcontrol.foundation.causes import OpenEndCause
from dpcontrol.orbits.cut import tube_cut
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import OrbitCurve, UnstableManifold
from dpcontrol.shooting.extended import refine
from dpcontrol.tubes.connections import find_connections, orbits_between

STATE = 1e-9  # required; about 1e-13 is achieved
PERIOD = 1e-11
RESIDUAL = 1e-11
AREA = 3e-5  # relative; the cut is an ellipse up to terms in the energy above the saddle
TOUCH = 1e-4  # rad: distance from the section next to a grazing phase
NEAR_ORBIT = 2e-6


@pytest.mark.parametrize("saddle", ["down-up", "up-down"])
@pytest.mark.parametrize("above", [1e-6, 1e-9])
def test_just_above_the_saddle_the_tube_encloses_the_orbits_action(lab, saddle, above):
    """dJ/dH = T, so the cut encloses T (H - H₀), even if the orbit is as small as the seeds' distance."""
    system = lab.system
    orbit = lyapunov_orbit(system, saddle, energy=float(system.numeric.hamiltonian(system.equilibrium(saddle))) + above)
    assert orbit.converged
    assert abs(orbit.floquet_multipliers[0] * orbit.floquet_multipliers[3] - 1) < 1e-9
    section = system.sections[saddle, saddle]
    cut = tube_cut(UnstableManifold(orbit, 1e-4), section)
    assert all(piece.closed for piece in cut.pieces)
    for piece in cut.pieces:
        x, y = piece.points[:-1].T
        area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2 * momentum_scale(system, section)
        # A polygon with n points on an ellipse encloses sin(2π/n) / (2π/n) of its area.
        step = 2 * np.pi / len(x)
        assert area == pytest.approx(orbit.period * above * np.sin(step) / step, rel=AREA)


def test_at_a_grazing_phase_the_trajectory_touches_the_section(lab):
    """On one side of the phase, the normal rate vanishes. On the other, the trajectory just misses the section."""
    system = lab.system
    section, orbit = system.sections["down-up", "down-up"], lyapunov_orbit(system, "down-up", energy=0.2)
    manifold = UnstableManifold(orbit, 1e-4)
    cut = tube_cut(manifold, section)
    grazing = [end for end in cut.open_ends if end.cause is OpenEndCause.GRAZES]
    assert grazing
    normal = np.asarray(section.normal)
    for end in grazing:
        low, high = end.phase_interval
        assert (high - low) % 1 < 1e-8
        # At a distance of 1e-7, the rate is a few hundredths and differences exceed rounding.
        sides = []
        for phase in (low - 1e-7, high + 1e-7):
            seed = manifold.seeds(np.array([phase]), end.branch)[0][0]
            crossing = system.propagator.crossing(seed, section, longest=5 * orbit.period)
            assert crossing is not None
            sides.append((abs(float(system.numeric.rate(crossing.state) @ normal)), crossing.time, seed))
        touching, missing = sorted(sides, key=lambda side: side[0])
        assert touching[0] < 0.01 * missing[0]
        assert missing[1] > touching[1]
        near = system.propagator.sample(missing[2], touching[1] + np.linspace(-2e-3, 2e-3, 401))
        off = section.height(near)
        assert np.abs(off - np.rint(off / (2 * np.pi)) * 2 * np.pi).min() < TOUCH


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "target", "energy"),
    [
        ("down-up", "down-up", "-0.12"),
        ("down-up", "down-up", "0.05"),
        ("down-up", "down-up", "0.15"),
        ("down-up", "up-down", "0.24"),
    ],
)
def test_connections_at_other_energies_agree_with_extended_precision(lab, source, target, energy):
    found = find_connections(*orbits_between(lab.system, source, target, float(energy)))
    assert found.connections
    assert max(c.residual for c in found.connections) <= RESIDUAL
    connection = found.connections[0]
    exact = refine(connection.solution, energy=Decimal(energy), parameters=lab.parameters.decimal_base())
    assert exact.converged
    assert float(exact.residual) <= 1e-20
    assert exact.correction < STATE
    for end, orbit in zip(exact.ends, (connection.source, connection.target), strict=True):
        assert float(end.duration) == pytest.approx(orbit.period, abs=PERIOD)
        assert np.abs(end.state.astype(float) - orbit.state).max() < STATE
    for c in found.connections if source == target else ():
        for orbit, sign in ((c.source, -1), (c.target, 1)):
            flown = orbit.system.propagator.sample(c.state, sign * np.linspace(0, 3.0, 1500))
            assert OrbitCurve(orbit).distances(flown)[1].min() < NEAR_ORBIT
