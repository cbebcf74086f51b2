"""Searches end: sections respect angles, and searches at the time limit are partial and not cached."""

import time
from math import pi

import casadi as ca
import numpy as np
import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.foundation import progress as progress_module
from dpcontrol.foundation.budget import Budget
from dpcontrol.plans.atlas import AtlasSettings, make_atlas
from dpcontrol.tubes.intersections import search_settings

SOON = 10.0  # s of processor time, ten times the usual one
LAB = ("connect", "lab", "--from", "down-up", "--to", "down-up", "--energy", "-0.07")


def spring(**options):
    """A mass on a spring that swings around its pivot, with an upright saddle and one angle."""

    def hamiltonian(q, p, _):
        (r, angle), (p_r, p_angle) = q, p
        return p_r**2 / 2 + p_angle**2 / (2 * r**2) + 20 * (r - 1) ** 2 - 9.81 * r * ca.cos(angle)

    return dp.System.from_hamiltonian(
        "spring",
        hamiltonian,
        coordinates=("r", "angle"),
        equilibria={"up": (0.75, 3.1)},
        periods=(None, 2 * pi),
        **options,
    )


@pytest.mark.slow
def test_a_pendulum_on_a_spring_is_searched_on_its_hanging_section():
    """The default section gives the result of the hanging section."""
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

    system = dp.System.from_hamiltonian(
        "wheel",
        hamiltonian,
        coordinates=("x", "angle"),
        equilibria={"right": (0.0, 0.0), "left": (0.0, pi)},
        periods=(None, 2 * pi),
    )
    energy = float(system.numeric.hamiltonian(system.equilibria["right"])) + 0.05
    search = dp.connections(*(dp.orbit(system, name, energy=energy) for name in ("right", "left")))
    turns = {c.winding[1] for c in search.connections}
    assert turns == {0, -1}, search.status


def test_a_search_at_its_time_limit_misses_its_goal_with_partial_results():
    shown = dpcontrol(*LAB, "--seconds", "0.001", "--json")
    assert shown.code == 1
    assert shown.document["partial"] is True
    assert "partial" in shown.message
    assert "0.001 s of processor time" in shown.message
    whole = dpcontrol(*LAB, "--json")
    assert (whole.code, whole.document["partial"], whole.document["count"]) == (0, False, 8)


def test_the_default_time_limit_is_one_minute():
    assert search_settings().seconds == 60.0
    assert search_settings(seconds=2.0).seconds == 2.0


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf", "1e9"])
def test_times_out_of_range_are_refused(seconds):
    shown = dpcontrol(*LAB, "--seconds", seconds)
    assert shown.code == 2
    assert "seconds" in shown.message


@pytest.mark.slow
def test_a_partial_atlas_is_not_cached(tmp_path, monkeypatch):
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path))
    model = dp.load_model("lab")
    hurried = AtlasSettings(search=search_settings(seconds=1e-3))
    for _ in range(2):
        found = make_atlas(model, -0.07, settings=hurried)
        assert not found.cached
        assert not found.file.exists()
        assert any(kind.partial for kind in found.atlas.kinds)
        assert "(partial)" in found.atlas.status
    again = [make_atlas(model, -0.07) for _ in range(2)]
    assert [one.cached for one in again] == [False, True]
    assert not any(kind.partial for one in again for kind in one.atlas.kinds)


def test_branches_that_become_infinite_do_not_delay_a_search():
    """Beyond the saddle, x becomes infinite in a finite time; on the other side, some trajectories return twice."""

    def hamiltonian(q, p, _):
        (x, y), (p_x, p_y) = q, p
        return (p_x**2 + p_y**2) / 2 + x**2 / 2 - x**3 / 3 + y**2 / 2 * (1 + 0.3 * x**2) + 0.1 * x * y**2

    system = dp.System.from_hamiltonian("cubic", hamiltonian, coordinates=("x", "y"), equilibria={"bar": (1.01, 0)})
    orbit = dp.orbit(system, "bar", energy=float(system.numeric.hamiltonian(system.equilibria["bar"])) + 0.1)
    began = time.process_time()
    search = dp.connections(orbit)
    assert (len(search.connections), search.complete, search.partial) == (4, True, False)
    tubes = [orbit.manifold(branch=branch) for branch in (1, -1)]
    assert [len(tube.cut().pieces) for tube in tubes] == [0, 1]
    assert all(np.isfinite(tube.strands(8)).all() for tube in tubes)
    assert time.process_time() - began < SOON


def test_a_cut_at_its_time_limit_is_partial():
    told = []
    tube = dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07).manifold()
    cut = tube.cut(seconds=0.001, progress=lambda what, done: told.append(what))
    assert cut.document()["partial"] is True
    assert not cut.resolved
    assert "limit of 0.001 s of processor time: allow more seconds" in cut.status
    assert "limit of 0 s" not in cut.status
    assert "tube of down-up" in told
    assert tube.cut().document()["partial"] is False


def test_tubes_report_progress():
    told = []
    orbit = dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07)
    dp.connections(orbit, progress=lambda what, done: told.append((what, done)))
    shares = [done for _, done in told]
    assert all(0 <= share <= 1 for share in shares)
    assert len({round(done, 6) for what, done in told if what.startswith("tube of")}) > 3
    assert any(what.startswith("refining") for what, _ in told)


def test_without_a_terminal_progress_is_reported_in_lines(monkeypatch, capsys):
    monkeypatch.setattr(progress_module, "_LINE", 0.0)
    orbit = dp.orbit(dp.load_model("lab"), "down-up", energy=-0.07)
    dp.connections(orbit)
    told = capsys.readouterr().err.splitlines()
    assert len(told) > 5
    assert all(line.startswith("connections: ") and "% after" in line for line in told)


def test_a_part_of_a_budget_does_not_exceed_it():
    assert Budget(1.0).part(5.0).seconds <= 1.0
    assert Budget(10.0).until(0.4).seconds == pytest.approx(4.0, rel=1e-3)
    assert Budget(float("inf")).until(0.5).seconds == float("inf")
    assert Budget(1e-9).spent


@pytest.mark.slow
def test_searches_with_three_bodies_do_not_mention_joules():
    begin = ("three-body", "--energy", "-1.5175")
    texts = [
        dpcontrol("atlas", *begin).stdout,
        dpcontrol("walk", *begin, "--hits", "2").stdout,
        dpcontrol("orbit", "three-body", "--saddle", "L1", "--energies", "-1.5195", "-1.5175").stdout,
        dpcontrol("orbit", "three-body", "--saddle", "L1", "--energy", "-1.7").message,
        dpcontrol("atlas", "three-body", "--energy", "-1.7").message,
    ]
    assert all(texts)
    assert [text for text in texts if " J" in text or "(s)" in text or "rad" in text] == []
