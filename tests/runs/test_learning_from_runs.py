"""Arms learnt from runs: their coordinates, the combination of runs, and second runs."""

from dataclasses import replace

import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.control.estimator_settings import ADAPTIVE, Augment, EkfSettings, constants, extra_names
from dpcontrol.dynamics.chain import ArmChainParameters, base_ratios, inertial_count
from dpcontrol.plans.model import load_model
from dpcontrol.runs.learning import caution, combined, coordinates, effort, learnt_arms
from dpcontrol.runs.run import Run

ROUNDING = 1e-12
"""Of differences of logarithms of order 1."""
SECOND_ORDER = 1e-9
"""Scaled difference of nearest arms, which Newton's method ends at."""
SIGMAS = 4.0
"""Standard errors that no ratio of one run may be off by; 6 ratios exceed it once in 2,600 runs."""
GAIN = 0.2
"""Share of the first run's effort that a second run may have; 0.02 to 0.08 as measured."""
AUGMENT = (Augment.FRICTION, Augment.DRY, Augment.PARAMETERS)


def errors_between(model: ArmChainParameters, plant: ArmChainParameters) -> tuple[list[str], np.ndarray]:
    """Return the filter's names and errors for a plant, by their definition in `estimator_settings`."""
    n, names = model.count, list(extra_names(model.count, AUGMENT))
    keys = [f"M{i}{j}" for i in range(1, n + 1) for j in range(i, n + 1)] + [f"G{i}" for i in range(1, n + 1)]
    # Over M12, since only ratios matter.
    own, other = (dict(zip(keys, arms.base() / arms.base()[1], strict=False)) for arms in (model, plant))
    units = model.base()[1], plant.base()[1]
    errors = []
    for name in names:
        kind, _, arm = name.partition("_")
        if kind == "friction":
            errors.append(plant.viscous[int(arm) - 1] / units[1] / (model.viscous[int(arm) - 1] / units[0]) - 1)
        elif kind == "dry":
            errors.append(plant.coulomb[int(arm) - 1] / units[1] / own[f"G{arm}"])
        else:
            errors.append(np.log(other[name.replace("S", "G")] / own[name.replace("S", "G")]))
    return names, np.array(errors)


@pytest.mark.parametrize("name", ["lab", "triple"])
def test_the_errors_of_a_filter_are_differences_of_coordinates(name: str) -> None:
    model = load_model(name).arms
    plant = replace(model.mismatched(0.1, np.random.default_rng(1)), coulomb=(1e-4,) * model.count)
    names, errors = errors_between(model, plant)
    offset, slope = coordinates(model, names)
    inertial = inertial_count(model.count)
    ratios = base_ratios(plant)
    wanted = np.append(np.log(ratios[:inertial]), ratios[inertial:])
    np.testing.assert_allclose(offset + slope @ errors, wanted, rtol=ROUNDING, atol=ROUNDING)


def test_arms_with_learnt_coordinates_are_those_of_the_plant_up_to_their_scale() -> None:
    model = load_model("lab").arms
    plant = replace(model.mismatched(0.1, np.random.default_rng(2)), coulomb=(1e-4, 2e-4))
    names, errors = errors_between(model, plant)
    offset, slope = coordinates(model, names)
    covariance = 1e-12 * np.eye(len(offset))
    arms, ratios, left = learnt_arms(offset + slope @ errors, covariance, model, names)
    np.testing.assert_allclose(base_ratios(arms), base_ratios(plant), rtol=SECOND_ORDER)
    assert ratios.shape == (len(base_ratios(plant)),) * 2
    # The errors of a filter with the learnt model have the same uncertainty in its coordinates.
    again = coordinates(arms, names)[1]
    np.testing.assert_allclose(again @ left @ again.T, covariance, atol=1e-18)


def test_dry_friction_within_three_standard_errors_is_left_out_and_the_rest_follows_its_correlation() -> None:
    model = load_model("lab").arms
    names = list(extra_names(2, AUGMENT))
    offset, _ = coordinates(model, names)
    covariance = 1e-12 * np.eye(len(offset))
    viscous, dry = inertial_count(2), inertial_count(2) + 2
    covariance[dry, dry], covariance[viscous, viscous], covariance[viscous, dry] = 1e-4, 1e-6, -0.8e-5
    covariance[dry, viscous] = covariance[viscous, dry]
    values = offset.copy()
    values[dry] = 0.015  # 1.5 standard errors
    arms, _, _ = learnt_arms(values, covariance, model, names)
    assert not arms.coulomb
    # The mean of one Gaussian variable, given another: m + c/s² (0 - 0.015).
    assert base_ratios(arms)[viscous] == pytest.approx(offset[viscous] + 0.8e-5 / 1e-4 * 0.015, rel=SECOND_ORDER)


def test_runs_combine_as_least_squares_over_all_their_readings() -> None:
    random = np.random.default_rng(3)
    truth, assumed = random.standard_normal(3), np.diag([4.0, 9.0, 1.0])
    rows = [random.standard_normal((40, 3)) for _ in range(2)]
    seen = [one @ truth + 0.1 * random.standard_normal(40) for one in rows]

    def posterior(mean: np.ndarray, covariance: np.ndarray, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares solution of a prior and the readings of some runs, stacked."""
        root = np.linalg.cholesky(np.linalg.inv(covariance)).T
        matrix = np.vstack([root, *(rows[k] / 0.1 for k in chosen)])
        right = np.concatenate([root @ mean, *(seen[k] / 0.1 for k in chosen)])
        return np.linalg.lstsq(matrix, right, rcond=None)[0], np.linalg.inv(matrix.T @ matrix)

    first = (np.zeros(3), assumed)
    single = [posterior(*first, [k]) for k in range(2)]
    both = posterior(*first, [0, 1])
    for before, after in (([first, first], single), ([first, single[0]], [single[0], posterior(*single[0], [1])])):
        values, covariance = combined(before, after, [1.0, 1.0])
        np.testing.assert_allclose(values, both[0], rtol=1e-8)
        np.testing.assert_allclose(covariance, both[1], rtol=1e-6, atol=1e-12)


def test_a_filter_starts_at_a_learnt_covariance() -> None:
    names = extra_names(2, EkfSettings(**ADAPTIVE).augments)
    rows = 6 + np.flatnonzero(np.isin(names, constants(2, EkfSettings(**ADAPTIVE).augments)))
    root = np.random.default_rng(4).standard_normal((len(rows), len(rows)))
    learnt = EkfSettings(**ADAPTIVE, learnt=tuple((root @ root.T).ravel().tolist())).first_covariance(2)
    plain = EkfSettings(**ADAPTIVE).first_covariance(2)
    np.testing.assert_allclose(learnt[np.ix_(rows, rows)], root @ root.T)
    others = np.setdiff1d(np.arange(len(plain)), rows)
    np.testing.assert_array_equal(learnt[np.ix_(others, others)], plain[np.ix_(others, others)])
    with pytest.raises(dp.InputError, match="learnt"):
        EkfSettings(**ADAPTIVE, learnt=(1.0, 2.0)).first_covariance(2)


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run on a plant that differs by up to ±10 % from its model."""
    return dp.run("outer-turn", mismatch=0.1, seed=1, log=tmp_path_factory.mktemp("logs") / "outer-turn-1.mcap")


def feedback(run: Run) -> float:
    return effort(run.log.time, run.log.control["feedback"])


@pytest.mark.slow
def test_after_one_run_the_plant_is_known_and_feedback_only_works_against_noise(first_run: Run) -> None:
    learnt = first_run.learn()
    off = (learnt.values - base_ratios(first_run.plant)) / learnt.errors
    assert np.abs(off).max() < SIGMAS
    loop = replace(learnt.plan.itinerary.loop, plant=first_run.plant, mismatch=0.0)
    second = dp.run(replace(learnt.plan, itinerary=replace(learnt.plan.itinerary, loop=loop)), seed=2)
    assert second.converged
    assert learnt.effort_before == feedback(first_run)
    assert feedback(second) < GAIN * learnt.effort_before
    assert learnt.effort_expected < GAIN * learnt.effort_before


@pytest.mark.slow
def test_friction_of_another_kind_leaves_the_arms_uncertain() -> None:
    """The identified plant has drag of the air, which the filter cannot estimate."""
    run = dp.run("outer-turn", plant="lab-identified", seed=3)
    learnt = run.learn()
    assert caution(run.log) > 1000
    truth = base_ratios(run.plant)[:4]
    assert (np.abs(learnt.values[:4] - truth) / learnt.errors[:4]).max() < SIGMAS
    second = dp.run(learnt.plan, plant="lab-identified", seed=4)
    assert second.converged
    assert feedback(second) < 2 * feedback(run)
