"""Proofs of orbits agree with independent values; nonexistent or elliptic orbits are not proved."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from reference_values import LYAPUNOV_ORBITS

import dpcontrol as dp
from dpcontrol.proofs.balls import bound, flint, symmetric, working
from dpcontrol.proofs.flow import FlowSettings, fly
from dpcontrol.proofs.periodic import closed_chain
from dpcontrol.proofs.prove import Energies, Proof, ProofSettings, proved_chain, surface_of

pytest.importorskip("flint")

DOUBLE = 1e-10
"""Relative accuracy of independent values in double precision, with parameters in double precision."""
PERIOD_OF_DOUBLES = "0.75238002849288055803"
"""Period of lab's orbit at -0.07 J for parameters in double precision, by another program (5e-21)."""


def number(text: str) -> Any:
    return flint.arb(text)


def near(text: str, value: float, relative: float = DOUBLE) -> bool:
    """True if a ball and its radius are within a relative distance of a value."""
    gap = abs(number(text) - flint.arb(value))
    return bool(gap < flint.arb(relative) * abs(flint.arb(value)))


@pytest.mark.slow
@pytest.mark.parametrize("case", [("lab", "down-up", -0.07), ("lab", "up-down", 0.2), ("printed", "down-up", -0.07)])
def test_enclosures_contain_the_independent_period_multiplier_and_state(
    case: tuple[str, str, float], proofs: dict[str, Proof]
) -> None:
    (model, saddle, energy), (state, period, multiplier, _) = case, LYAPUNOV_ORBITS[case]
    shared = case == ("lab", "down-up", -0.07)
    proof = proofs["orbit"] if shared else dp.prove(dp.orbit(dp.load_model(model), saddle, energy=energy))
    assert proof.proved, proof.status
    assert near(proof.figures["period"], period)
    assert near(proof.figures["multipliers"][0], multiplier)
    assert near(proof.figures["multipliers"][1], 1 / multiplier)
    for text, value in zip(proof.figures["state"], state, strict=True):
        assert abs(number(text) - flint.arb(value)) < DOUBLE


@pytest.mark.slow
def test_a_period_differs_from_that_of_the_parameters_doubles_in_the_sixteenth_digit_only(
    proofs: dict[str, Proof],
) -> None:
    proof = proofs["orbit"]
    with working(160):
        gap = abs(number(proof.figures["period"]) - number(PERIOD_OF_DOUBLES))
        assert flint.arb(1e-17) < gap < flint.arb(1e-15)
        assert number(proof.figures["period"]).rad() < flint.arb(5e-21)


@pytest.mark.slow
@pytest.mark.parametrize("case", [("lab", "up-down", 0.49033), ("point-mass", "up-down", 0.69938)])
def test_orbits_with_multipliers_near_1e11_are_proved_with_default_settings(case: tuple[str, str, float]) -> None:
    orbit = dp.orbit(dp.load_model(case[0]), case[1], energy=case[2])
    assert 5e10 < orbit.unstable_multiplier < 2e11
    proof = dp.prove(orbit)
    assert proof.proved, proof.status
    assert near(proof.figures["period"], orbit.period, 1e-9)
    assert near(proof.figures["multipliers"][0], orbit.unstable_multiplier, 1e-2)


@pytest.mark.slow
def test_orbits_of_three_bodies_and_a_users_hamiltonian_are_proved(proofs: dict[str, Proof]) -> None:
    def hamiltonian(q: Any, p: Any, c: Any) -> Any:
        (x, y), (px, py) = q, p
        return (px**2 + py**2 + x**2 + y**2) / 2 + c["lambda"] * (x**2 * y - y**3 / 3) + 0.01 * ca.exp(-(x**2))

    own = dp.System.from_hamiltonian(
        "own", hamiltonian, coordinates=("x", "y"), parameters={"lambda": 1.1}, equilibria={"top": (0.0, 0.9)}
    )
    top = dp.orbit(own, "top", energy=0.17)
    bodies = dp.orbit(dp.load_model("three-body"), "L1", energy=-1.515)
    for orbit, proof in ((bodies, proofs["three bodies"]), (top, dp.prove(top))):
        assert proof.proved, proof.status
        assert near(proof.figures["period"], orbit.period)
        assert near(proof.figures["multipliers"][0], orbit.unstable_multiplier, 1e-8)


def refused(proof: Proof) -> bool:
    """True if a verdict is "not proved" and does not claim falsity."""
    return not proof.proved and proof.status.startswith("not proved: ") and "false" not in proof.status


@pytest.mark.slow
def test_a_wrong_node_a_large_ball_and_an_elliptic_orbit_are_not_proved() -> None:
    lab = dp.load_model("lab")
    orbit = dp.orbit(lab, "down-up", energy=-0.07)
    once = ProofSettings(tries=1)
    assert refused(dp.prove(replace(orbit, state=orbit.state + 1e-4 * np.eye(4)[2]), settings=once))
    assert refused(dp.prove(replace(orbit, period=orbit.period * 1.001), settings=once))
    assert refused(dp.prove(orbit, settings=replace(once, radius=1e-2)))
    assert refused(dp.prove(orbit, energy=-0.069, settings=once))

    def wells(q: Any, p: Any, _: Any) -> Any:
        (x, y), (px, py) = q, p
        return (px**2 + 2 * py**2) / 2 + x**2 / 2 - x**4 / 40 + y**2 - 0.2 * x * y**2

    # Both motions oscillate about the well, so the orbit is elliptic.
    system = dp.System.from_hamiltonian("wells", wells, coordinates=("x", "y"), equilibria={"out": (3.16, 0.0)})
    amplitude = 0.3
    state = np.array([0.0, 0.0, amplitude, 0.0])
    elliptic = replace(orbit, system=system, state=state, period=_period(system, state), saddle="bottom")
    proof = dp.prove(elliptic, energy=float(system.numeric.hamiltonian(state)))
    assert refused(proof)
    assert proof.figures["multipliers"] is None, proof.status


def _period(system: dp.System, state: np.ndarray) -> float:
    """Return the time between upward zero crossings of an orbit with one coordinate."""
    times = np.linspace(5.0, 8.0, 3001)
    x = system.propagator.sample(state, times)[:, 0]
    k = int(np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))[0])
    period = float(times[k])
    for _ in range(5):
        end = system.propagator.flow(state, period)
        period -= float(end[0] / system.numeric.rate(end)[0])
    return period


def test_random_trajectories_stay_in_their_enclosures() -> None:
    """Results of another integrator from random corners of a box lie in the enclosure."""
    random = np.random.default_rng(3)
    system = dp.load_model("lab").system
    radius = 1e-6
    with working(128):
        surface = surface_of(system, Energies.of(0))
        for _ in range(3):
            start = np.concatenate([random.uniform(-3, 3, 2), random.uniform(-20, 20, 2)])
            thin, derivative, box, _ = fly(
                surface.field,
                [flint.arb(v) for v in start],
                flint.arb_mat(4, 1, [symmetric(radius)] * 4),
                Fraction(1, 10),
                FlowSettings(),
            )
            for _ in range(8):
                end = system.propagator.flow(start + radius * random.choice([-1.0, 1.0], 4), 0.1)
                rounding = 1e-12
                assert all(abs(b.mid() - v) <= b.rad() + rounding for b, v in zip(box, end, strict=True))
            _, stm = system.propagator.flow_with_stm(start, 0.1)
            entries = zip(derivative.entries(), stm.ravel(), strict=True)
            assert all(abs(b.mid() - v) <= b.rad() + 1e-9 for b, v in entries)
            # The width of the enclosure is due to the box only.
            assert max(float(b.rad()) for b in thin) < 1e-15


def test_flints_precision_is_restored_and_bounds_round_up() -> None:
    before = flint.ctx.prec
    with working(200):
        assert flint.ctx.prec == 200
    assert flint.ctx.prec == before
    assert (bound(flint.arb(1) / 3), bound(flint.arb(1) / 3, lower=True)) == ("0.334", "0.333")
    assert (bound(1e-8), bound(1e-8, lower=True)) == ("1.01e-8", "1.00e-8")


def test_nodes_are_corrected_to_the_energy() -> None:
    system = dp.load_model("lab").system
    orbit = dp.orbit(system, "down-up", energy=-0.07)
    states = np.array([system.propagator.flow(orbit.state, orbit.period * k / 4) for k in range(4)])
    with working(128):
        surface = surface_of(system, Energies.of("-0.07000000001"))
        chain = closed_chain(system, states, np.full(4, orbit.period / 4), [0] * 4)
        _, found = proved_chain(surface, chain, ProofSettings())
    assert found.proved
    assert found.exists > flint.arb(1e-13)
