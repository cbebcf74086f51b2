"""Plants drawn from how well a model is known: spread as its covariance says, other draws untouched, in both loops."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shadowing_stand_in import StandIn

from dpcontrol.dynamics.chain import Uncertainty, base_ratios, ratio_names
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import (
    BenchDraw,
    BenchSettings,
    DisturbanceSettings,
    DriveSettings,
    SensorSettings,
    Unlike,
    draw_bench,
)
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import load_model
from dpcontrol.references.reference import Reference
from dpcontrol.runs.campaign import Case, Job

LAB = load_model("lab").arms
RATIOS = base_ratios(LAB)
# 0.2 % of each ratio, equal errors of the first two. At ten times that, most drawn ratios belong to no arms.
CORRELATION = np.eye(len(RATIOS))
CORRELATION[0, 1] = CORRELATION[1, 0] = 0.8
SHARE = 2e-3
KNOWN_TO = Uncertainty(ratio_names(LAB), tuple((SHARE**2 * CORRELATION * np.outer(RATIOS, RATIOS)).ravel()))
DRAWS = 200
SPREAD = 0.2  # a standard deviation of 200 draws is itself known to 5 %
FLOWN = 1e-6  # rad, rad/s, m: rounding in another order, over the first tenth of a second

NOISY = BenchSettings(
    SensorSettings(noise=1e-4, zero_error=1e-3, missed_counts=2.0, dropout=0.01, jitter=1e-4, rate_noise=0.01),
    DriveSettings(command_noise=0.1),
    DisturbanceSettings(pushes=2, push_impulse=1e-3, knocks=1, knock_velocity=0.1),
)


def _draw(
    scale: float, seed: int = 3, *, mismatch: float = 0.0, uncertainty: Uncertainty | None = KNOWN_TO
) -> BenchDraw:
    return draw_bench(
        LAB, NOISY, seed=seed, ticks=200, period=1e-3,
        unlike=Unlike(mismatch, scale, uncertainty, initial_error=0.02),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [0.5, pytest.param(2.0, marks=pytest.mark.slow)])
def test_plants_have_the_covariance_times_the_scale(scale: float) -> None:
    away = np.stack([base_ratios(_draw(scale, seed).plant.arms) / RATIOS - 1 for seed in range(DRAWS)])
    assert away.std(axis=0) == pytest.approx(np.full(len(RATIOS), scale * SHARE), rel=SPREAD)
    alike = np.asarray(np.corrcoef(away[:, :4].T))
    assert alike[0, 1] == pytest.approx(0.8, abs=0.08)
    assert np.abs(alike[0, 2:]).max() < 0.25


def test_without_it_nothing_changes_and_with_it_nothing_but_the_plant() -> None:
    plain, drawn = _draw(0.0), _draw(1.0)
    assert plain.plant.arms == LAB
    assert drawn.plant.arms != LAB
    for name in ("initial_error", "zeros"):
        assert np.array_equal(getattr(plain, name), getattr(drawn, name)), name
    assert plain.streams.keys() == drawn.streams.keys()
    for name in plain.streams:
        assert np.array_equal(plain.drawn(name), drawn.drawn(name)), name
    assert [(k, b.knock, *b.impulses) for k, b in plain.blows.items()] == [
        (k, b.knock, *b.impulses) for k, b in drawn.blows.items()
    ]


def test_a_mismatch_comes_on_top_with_the_draw_that_it_has_alone() -> None:
    alone, both, drawn = _draw(0.0, mismatch=0.05), _draw(1.0, mismatch=0.05), _draw(1.0)
    share = np.array(alone.plant.arms.mass) / np.array(LAB.mass)
    assert np.array(both.plant.arms.mass) == pytest.approx(share * np.array(drawn.plant.arms.mass), rel=1e-12)


def test_a_seed_draws_the_same_plant_again_and_another_seed_another() -> None:
    assert _draw(1.0, 5).plant.arms == _draw(1.0, 5).plant.arms
    assert _draw(1.0, 5).plant.arms != _draw(1.0, 6).plant.arms


def test_a_draw_without_an_uncertainty_is_rejected() -> None:
    with pytest.raises(InputError, match=r"model_uncertainty = 1.0: the model has no \[uncertainty\]"):
        _draw(1.0, uncertainty=None)
    with pytest.raises(InputError, match="model_uncertainty = -1"):
        LoopSettings(seed=0, model_uncertainty=-1.0)
    with pytest.raises(InputError, match=r"lab.toml has no \[uncertainty\]"):
        load_itinerary("outer-turn").with_run({"model_uncertainty": 1.0})


def test_an_itinerary_can_draw_from_the_uncertainty_of_its_model(tmp_path: Path) -> None:
    text = load_itinerary("outer-turn").text.replace('model  = "lab"', 'model  = "lab-identified"')
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("[run]\n", "[run]\nmodel_uncertainty = 2.0\n"))
    scene = load_itinerary(str(file))
    assert scene.loop.model_uncertainty == 2.0
    assert scene.uncertainty == load_model("lab-identified").uncertainty
    assert scene.with_run({"model_uncertainty": 0.0}).uncertainty is None


def test_rows_of_a_campaign_are_distinguished_by_the_source_of_their_plants() -> None:
    job = Job("turn", b"", LAB, Case("as the scene", (), LoopSettings(seed=0, model_uncertainty=1.0)), (0,), "ticks")
    assert len({job.key, replace(job, uncertainty=KNOWN_TO).key}) == 2


def test_ratios_that_no_arms_have_are_drawn_again() -> None:
    drawn = [_draw(8.0, seed).plant.arms for seed in range(10)]
    assert all(min(arms.inertia) > 0 and min(arms.mass) > 0 for arms in drawn)


def test_an_uncertainty_that_hardly_any_arms_fit_misses_the_goal_with_a_sentence() -> None:
    # The ratios of inertia one against the other: whichever way it goes, one arm's own inertia falls below zero.
    huge = Uncertainty(KNOWN_TO.names, tuple(1e8 * v for v in KNOWN_TO.covariance))
    with pytest.raises(GoalMissed, match="times 100, none gives possible arms; use a smaller factor"):
        _draw(100.0, 1, uncertainty=huge)


@pytest.mark.slow
def test_runs_in_lockstep_draw_the_plants_that_the_loop_draws(turn: tuple[StandIn, Reference]) -> None:
    reference, seeds = turn[1], [1]
    settings = LoopSettings(seed=0, model_uncertainty=2.0, initial_error=0.02)
    controller = Assembly(reference, LAB, settings).controller

    def together(settings: LoopSettings) -> list[np.ndarray]:
        runs = Assembly(reference, LAB, settings, uncertainty=KNOWN_TO, law=controller).batch(seeds)
        return [run.truth[:100] for run in runs]

    drawn, plain = together(settings), together(replace(settings, model_uncertainty=0.0))
    for seed, one in zip(seeds, drawn, strict=True):
        alone = Assembly(reference, LAB, replace(settings, seed=seed), uncertainty=KNOWN_TO, law=controller).simulate()
        assert alone.ticks.truth is not None
        assert np.abs(one - alone.ticks.truth[:100]).max() < FLOWN
    assert np.abs(plain[0] - drawn[0]).max() > 100 * FLOWN
