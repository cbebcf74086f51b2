"""Benefit of tubes: motions checked by scipy, searches, verdicts and the chart."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import dpcontrol
from scipy.integrate import solve_ivp

from dpcontrol.bench import energies, payoff
from dpcontrol.bench.chart import Point
from dpcontrol.bench.energies import energy_text
from dpcontrol.bench.payoff import (
    GAP,
    SETTINGS,
    STRAIGHT,
    TUBES,
    Charted,
    Compared,
    Recomputed,
    Try,
    as_cheap,
    by_cem,
    cheaper_text,
    even_mesh,
    lasting,
    motion_rate,
    recomputed,
    resampled,
    shot,
    stop_by_stop,
    with_waves,
)
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.plans.itinerary import Itinerary, itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.references.find import smooth_guess
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import EndConditions, Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.trajectory import Trajectory, times_on
from dpcontrol.runs.off_tubes import known_flights, off_tubes_remarks

ARMS = load_model("lab").arms
EQUATIONS = equations_of(ARMS, Level.CART)
HANGING = np.zeros(6)
SWUNG = np.array([0.7, -0.4, 2.0, -3.0, 0.01, 0.1])
ROUNDING = 1e-12
SHOOTING = 1e-7  # Of a step of order 8 over 10 ms.


def problem(duration: float = 0.3) -> ReferenceProblem:
    guess = smooth_guess(HANGING[:4], SWUNG[:4], duration)
    return ReferenceProblem(
        EQUATIONS, ARMS.base(), guess, duration, limits=Limits(), ends=EndConditions(start=HANGING, end=SWUNG)
    )


def free_fall(seconds: float = 0.3) -> Trajectory:
    """A motion under a known input, from scipy at the nodes."""
    method, mesh = method_named(SETTINGS.method), even_mesh(seconds, SETTINGS.interval)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.array(EQUATIONS.function()(x, np.cos(5 * t), ARMS.base())).ravel()

    times = times_on(mesh, method.support)
    instants, where = np.unique(times, return_inverse=True)
    done = solve_ivp(rate, (0, seconds), SWUNG, t_eval=instants, rtol=1e-12, atol=1e-13, method="DOP853")
    states = done.y.T[where.ravel()].reshape(*times.shape, 6)
    return Trajectory(method, mesh, states, np.cos(5 * times_on(mesh, method.points))[..., None])


def test_the_equations_by_hand_are_those_of_the_engine() -> None:
    rng = np.random.default_rng(1)
    states, inputs = rng.normal(size=(6, 20)) * 3, rng.normal(size=20)
    engine = np.array(EQUATIONS.function().map(20)(states, inputs[None], np.tile(ARMS.base()[:, None], 20)))
    assert np.abs(motion_rate(ARMS, states, inputs) - engine).max() < ROUNDING * np.abs(engine).max()


def test_a_motion_is_recognised_with_its_effort() -> None:
    motion = free_fall()
    ends = motion.states[0, 0], motion.states[-1, -1]
    found = recomputed(ARMS, motion, ends)
    assert found.flies(Limits())
    assert found.gap < 1e-9
    assert found.turns == (0, 0)
    exact = 0.15 + np.sin(3.0) / 20
    assert found.effort == pytest.approx(exact, rel=1e-9)
    assert motion.effort == pytest.approx(exact, rel=1e-9)
    assert found.peak == pytest.approx(1.0, abs=1e-6)


def test_invalid_motions_missed_ends_and_exceeded_limits_are_rejected() -> None:
    motion = free_fall()
    ends = motion.states[0, 0], motion.states[-1, -1]
    bent = replace(motion, states=motion.states.copy())
    bent.states[3] += 0.01
    assert recomputed(ARMS, bent, ends).gap > GAP
    assert not recomputed(ARMS, bent, ends).flies(Limits())
    elsewhere = (ends[0], ends[1] + np.array([0, 2 * np.pi, 0, 0, 0, 0]))
    assert not recomputed(ARMS, motion, elsewhere).flies(Limits())
    assert not recomputed(ARMS, motion, ends).flies(Limits(acceleration=0.5))
    assert not recomputed(ARMS, motion, ends).flies(Limits(position=0.01))


def test_shooting_agrees_with_scipy() -> None:
    inputs = np.tile(np.linspace(-1, 1, 20)[:, None], 8)
    states = shot(ARMS, SWUNG, inputs, 0.01)
    x = SWUNG
    for u in inputs[:, 0]:
        x = solve_ivp(
            lambda _, x, u=u: motion_rate(ARMS, x[:, None], np.array([u]))[:, 0],
            (0, 0.01), x, rtol=1e-12, atol=1e-13, method="DOP853",
        ).y[:, -1]  # fmt: skip
    assert np.abs(states[-1] - x[:, None]).max() < SHOOTING


def test_guesses_keep_the_ends_and_their_rates_are_those_of_their_angles() -> None:
    plain = problem()
    for one in (replace(plain, guess=with_waves(plain, np.random.default_rng(2))), stop_by_stop(plain, 3)):
        times = np.linspace(0, plain.duration, 301)
        states = one.guess_at(times)
        assert np.abs(states[[0, -1], :2] - [HANGING[:2], SWUNG[:2]]).max() < ROUNDING
        slopes = np.gradient(states[:, :2], times, axis=0)[1:-1]
        assert np.abs(slopes - states[1:-1, 2:]).max() < 0.2


def test_a_stretched_motion_keeps_its_path() -> None:
    motion = free_fall()
    slow = resampled(motion, 0.6)
    assert np.abs(slow.state(0.4)[:2] - motion.state(0.2)[:2]).max() < 1e-6
    assert np.abs(slow.state(0.4)[2:4] - motion.state(0.2)[2:4] / 2).max() < 1e-5
    assert np.abs(slow.input(0.4) - motion.input(0.2) / 4).max() < 1e-6


def test_cem_comes_nearer_to_the_end_with_every_generation() -> None:
    settings = payoff.CemSettings(samples=32, kept=6, generations=1)
    reachable = replace(problem(), ends=EndConditions(start=SWUNG, end=free_fall().states[-1, -1]))
    missed = [
        by_cem(reachable, ARMS, np.random.default_rng(3), replace(settings, generations=count))[1] for count in (1, 25)
    ]
    assert missed[1] < 0.3 * missed[0]


def test_the_others_search_by_the_same_program_but_for_what_follows_a_guess() -> None:
    assert replace(SETTINGS, pendulum_weight=0.1, cart_weight=10.0) == ReferenceSettings()
    same = lasting(problem(), 0.3)
    assert all(np.array_equal(a, b) for a, b in zip(same.end_states(), problem().end_states(), strict=True))


def charted(method: str, effort: float, duration: float = 1.0) -> Charted:
    return Charted(method, duration, Recomputed(effort, 1.0, 0.0, 0.0, 0.1, 0.1, (0, 1)))


def test_the_verdict_counts_cheap_tries_and_reports_if_none_is_cheaper() -> None:
    inf = float("inf")
    tries = ((TUBES, 1.0, 2.0), (STRAIGHT, 1.0, 2.1), (STRAIGHT, 1.0, 3.0), (STRAIGHT, 1.0, inf))
    one = Compared("a turn", tries, {TUBES: charted(TUBES, 2.0)})
    assert as_cheap(one, STRAIGHT) == 1
    assert Try(STRAIGHT, 1.0).effort == inf
    dearer = cheaper_text("a turn", [charted(TUBES, 1.0), charted(payoff.OFF, 1.5, 2.0)])
    assert dearer == "a turn: no other time from 2 to 2 s is cheaper"
    cheaper = cheaper_text("a turn", [charted(TUBES, 1.0), charted(payoff.OFF, 0.5, 2.0)])
    assert cheaper.startswith("a turn: 0.50 times the effort off the tubes in 2 s")


def loop(energy: float, effort: float, completed: float, *, own: bool = False) -> Point:
    return Point("loop", "", energy, effort, default=own, others={"energy": energy, "completed": completed})


def test_an_energy_is_poor_where_another_takes_less_or_more_runs_come_through() -> None:
    mine = loop(0.2, 1.0, 1.0, own=True)
    assert "good choice" in energy_text(0.2, [mine, loop(0.1, 0.95, 1.0), loop(0.05, 0.1, 0.5)])
    assert energy_text(0.2, [mine, loop(0.1, 0.5, 1.0)]).startswith("0.2 J is a poor choice: 0.1 J takes 0.5 m²/s³")
    fewer = loop(0.2, 1.0, 0.5, own=True)
    assert energy_text(0.2, [fewer, loop(0.1, 2.0, 1.0)]).endswith("100% of runs complete it, not 50%")


@pytest.mark.slow
def test_the_quick_chart_holds_flights_that_scipy_confirms(tmp_path, monkeypatch) -> None:
    """Slow: searches, although in this process and no more than one of each kind."""
    few = replace(payoff.QUICK, waves=1, homotopies=1, inputs=0, cem=1, seeds=2, factors=(1.0,), walks=(1,))
    monkeypatch.setattr(payoff, "QUICK", few)
    monkeypatch.setattr(payoff, "processors", lambda: 1)
    ended = dpcontrol("bench", "payoff", "--quick", "--out", str(tmp_path))
    assert ended.code == 0, ended.stderr
    data = json.loads((tmp_path / "payoff.json").read_text())
    points = [p["others"] for panel in data["panels"] for p in panel["points"] if "gap" in p["others"]]
    assert len(points) > 10
    for p in points:
        assert max(p["gap"], p["miss"]) <= GAP
        assert p["peak"] <= Limits().acceleration * (1 + 1e-6)
        assert p["cart_position"] <= Limits().position * (1 + 1e-6)
    same = next(panel for panel in data["panels"] if panel["title"] == "Same ends, same time: best flight")
    assert {p["setting"] for p in same["points"] if p["default"]} == {"outer -0.07 J", "cross 0.2 J"}
    turns = {"outer -0.07 J": (0, 1), "cross 0.2 J": (0, 0)}
    for p in same["points"]:
        winding = p["others"]["turns_1"], p["others"]["turns_2"]
        assert winding == turns[p["setting"]] or p["setting"] == "cross 0.2 J"


@pytest.mark.slow
def test_energies_of_an_itinerary_are_compared_in_closed_loop(tmp_path, monkeypatch) -> None:
    """Slow: plans and flies an itinerary at two energies."""
    monkeypatch.setattr(energies, "ENERGIES", (0.65, 1.0))
    monkeypatch.setattr(energies, "RUNS", 4)
    picture = tmp_path / "energies.png"
    ended = dpcontrol("plan", "outer-turn", "--explore-energy", str(picture), "--json")
    assert ended.code == 0, ended.stderr
    found = ended.document["energies"]
    assert "choice" in found["chosen"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    loops = [p for p in found["panels"][0]["points"] if p["method"] == "loop"]
    assert len(loops) == 2
    assert all(p["error"] > p["others"]["reference"] for p in loops)


def test_energies_of_more_than_a_walk_are_refused(tmp_path) -> None:
    ended = dpcontrol("plan", "hold-down-up", "--explore-energy", str(tmp_path / "e.png"))
    assert ended.code == 2
    assert "compares energies of one walk" in ended.message


def scene(*parts: str, start: str = "orbit") -> Itinerary:
    tables = "\n".join(f"[[parts]]\n{part}" for part in parts)
    text = f'model = "lab"\nstart = "{start}"\nfinish = "{start}"\n{tables}\n'
    return itinerary_from(text, "test", load_model("lab"))


def test_a_plan_reports_cheaper_flights_off_the_tubes_for_their_ends_only() -> None:
    hold, turn = 'hold = "down-up"\nseconds = 1.0', 'energy = {}\nwalk = ["down-up {}"]\nwraps = []'
    for sense in "+-":
        (said,) = off_tubes_remarks(scene(hold, turn.format(-0.07, sense), hold, start="rest"))
        assert said.startswith(f"'down-up {sense}' at -0.07 J: from hold to hold a flight off the tubes is cheaper")
    assert not [text for text in off_tubes_remarks(scene(turn.format(-0.07, "+"))) if "hold" in text]
    assert off_tubes_remarks(scene(hold, turn.format(-0.05, "+"), hold, start="rest")) == ()


def test_known_flights_off_the_tubes_are_cheaper_than_along_them() -> None:
    assert known_flights()
    assert all(0 < one.effort < one.along for one in known_flights())
