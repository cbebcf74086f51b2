"""Searches end: sections respect angles, and searches at the time limit are partial and not cached."""

from math import pi

import casadi as ca
import numpy as np
import pytest
from command_line import dpcontrol

import dpcontrol as dp

LAB = ("connect", "lab", "--from", "down-up", "--to", "down-up", "--energy", "-0.07")


def spring(**options):
    def hamiltonian(q, p, _):
        (r, angle), (p_r, p_angle) = q, p
        return p_r**2 / 2 + p_angle**2 / (2 * r**2) + 20 * (r - 1) ** 2 - 9.81 * r * ca.cos(angle)

    about = {"coordinates": ("r", "angle"), "equilibria": {"up": (0.75, 3.1)}, "periods": (None, 2 * pi)}
    return dp.System.from_hamiltonian("spring", hamiltonian, **about, **options)


@pytest.mark.slow
def test_a_pendulum_on_a_spring_is_searched_on_its_hanging_section():
    named = spring(
        sections={"hanging": dp.Section.plane("hanging", (0, 1), period=2 * pi)}, between={("up", "up"): "hanging"}
    )
    energy = float(named.numeric.hamiltonian(named.equilibria["up"])) + 0.2
    found, expected = (dp.connections(dp.orbit(system, "up", energy=energy)) for system in (spring(), named))
    assert found.complete
    assert {c.winding for c in found.connections} == {(0, 1), (0, -1)}
    states = [np.sort(np.array([c.state for c in search.connections])[:, 0]) for search in (found, expected)]
    assert states[0] == pytest.approx(states[1], abs=1e-9)
    assert "turning-up" in spring().named_sections


@pytest.mark.slow
def test_two_saddles_of_an_angle_are_searched_in_both_directions():
    def hamiltonian(q, p, _):
        (x, angle), (p_x, p_angle) = q, p
        return (p_x**2 + p_angle**2 + x**2) / 2 + ca.cos(2 * angle) + 0.1 * x * ca.sin(angle)

    places = {"right": (0.0, 0.0), "left": (0.0, pi)}
    system = dp.System.from_hamiltonian(
        "wheel", hamiltonian, coordinates=("x", "angle"), equilibria=places, periods=(None, 2 * pi)
    )
    energy = float(system.numeric.hamiltonian(system.equilibria["right"])) + 0.05
    search = dp.connections(*(dp.orbit(system, name, energy=energy) for name in ("right", "left")))
    turns = {c.winding[1] for c in search.connections}
    assert turns == {0, -1}, search.status


def test_a_search_at_its_time_limit_misses_its_goal_with_partial_results():
    shown = dpcontrol(*LAB, "--seconds", "0.001", "--json")
    assert shown.code == 1
    assert shown.document["partial"] is True
    assert "0.001 s of processor time" in shown.message
    assert dpcontrol(*LAB, "--seconds", "0").code == 2
    whole = dpcontrol(*LAB, "--json")
    assert (whole.code, whole.document["partial"], whole.document["count"]) == (0, False, 8)
