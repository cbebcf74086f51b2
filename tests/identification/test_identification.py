"""Identification from quantised swings and the rig's recording, with selection of friction laws."""

from dataclasses import replace

import numpy as np
import pytest
from bench_recordings import rig_file

from dpcontrol.dynamics.chain import ArmChainParameters, Friction, base_ratios
from dpcontrol.identification.identify import Identification, IdentificationSettings, choose, identify
from dpcontrol.identification.windows import correlation_time
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.importing import import_recording
from dpcontrol.recordings.recording import Recording, simulated_recording

# Allowed error of predictions over 2.667 s on held-out segments of the rig, rad.
MEDIAN, WORST = 1.6e-3, 3.6e-3
# For all ratios with 40,000 counts. Independent rounding would give 0.03 % for friction.
RATIO_ERROR = 2e-3
COVERED = 0.9
RUNS = 6
TWO_SIDED_95 = 1.96

LAB = load_model("lab").arms
RUBBING = replace(LAB, viscous=(2e-4, 1e-5), coulomb=(3.4e-4, 1.9e-4), quadratic=(2.2e-3, 1.7e-3))
ALL_LAWS = (tuple(Friction),)
INERTIAL = 4


def recorded(
    arms: ArmChainParameters, seed: int, *, swings: int = 3, seconds: float = 2.0
) -> tuple[Recording, np.ndarray]:
    """A recording of swings from random angles with offset zeros, and the zeros."""
    random = np.random.default_rng(seed)
    zeros = random.uniform(-2e-3, 2e-3, 2)
    starts = list(random.uniform(-1.2, 1.2, (swings, 2)))
    return simulated_recording(arms, starts, seconds=seconds, period=2e-3, zeros=zeros, name=f"run{seed}"), zeros


@pytest.fixture(scope="module")
def runs() -> list[tuple[Identification, np.ndarray]]:
    """True and identified arms: six with errors up to 5 %, from eight swings of 8 s with four held out."""
    out = []
    for seed in range(RUNS):
        arms = RUBBING.mismatched(0.05, np.random.default_rng(100 + seed))
        recording, zeros = recorded(arms, seed, swings=12, seconds=8.0)
        settings = IdentificationSettings(zeros="free", laws=ALL_LAWS, longest=10.0)
        found = identify([recording], LAB, settings=settings)
        out.append((found, np.concatenate([base_ratios(arms), zeros])))
    return out


@pytest.mark.slow
def test_true_ratios_and_zeros_lie_inside_the_95_percent_region_which_is_not_too_wide(runs) -> None:
    apart = [np.abs(found.values - truth) / found.errors for found, truth in runs]
    assert np.mean(np.array(apart) <= TWO_SIDED_95) >= COVERED
    assert 0.15 < np.median(np.square(apart)) < 1.5


@pytest.mark.slow
def test_true_ratios_are_recovered_including_friction(runs) -> None:
    for found, truth in runs:
        ratios = len(base_ratios(found.arms))
        assert np.abs(found.values[:ratios] / truth[:ratios] - 1).max() < RATIO_ERROR
        assert np.abs(found.values[:INERTIAL] / truth[:INERTIAL] - 1).max() < RATIO_ERROR / 100
        assert base_ratios(found.arms) == pytest.approx(found.values[:ratios], rel=1e-9)


@pytest.mark.slow
def test_only_the_acting_friction_laws_are_selected() -> None:
    for arms, expected in (
        (replace(LAB, viscous=(1e-3, 1e-4)), ("viscous",)),
        (replace(LAB, viscous=(1e-4, 1e-5), coulomb=(5e-4, 3e-4)), ("viscous", "coulomb")),
    ):
        recording, _ = recorded(arms, 3, swings=6, seconds=1.5)
        found = identify([recording], LAB, settings=IdentificationSettings(zeros="free"))
        assert found.friction_terms == expected


def test_zeros_are_selected_only_for_offset_encoders() -> None:
    arms = replace(LAB, viscous=(1e-3, 1e-4))
    starts = [np.array(s) for s in ((1.0, 0.2), (-0.5, 0.9), (0.3, -1.1))]
    for zeros, expected in ((np.array([3e-3, -2e-3]), True), (np.zeros(2), False)):
        recording = simulated_recording(arms, starts, seconds=1.5, period=2e-3, zeros=zeros)
        found = identify([recording], LAB, settings=IdentificationSettings(laws=((),)))
        assert found.candidates[found.chosen].zeros is expected
        if expected:
            assert found.zeros[0] == pytest.approx(zeros, abs=1e-4)


def test_each_log_has_separate_zeros_and_consecutive_indices() -> None:
    arms = replace(LAB, viscous=(1e-3, 1e-4))
    both = [recorded(arms, seed, seconds=1.5) for seed in (1, 2)]
    found = identify([r for r, _ in both], LAB, settings=IdentificationSettings(zeros="free", laws=((),)))
    assert found.zeros == pytest.approx(np.array([zeros for _, zeros in both]), abs=1e-4)
    assert [s.index for s in found.segments] == list(range(6))
    assert [s.used for s in found.segments] == [True, True, False] * 2
    assert [s.log for s in found.segments] == ["run1"] * 3 + ["run2"] * 3
    assert found.names[-1] == "zero_2 run2"


@pytest.fixture(scope="module")
def rig() -> Identification:
    """The identification of the rig's recording."""
    return identify([import_recording(rig_file())], LAB)


@pytest.mark.slow
def test_the_rigs_held_out_segments_are_predicted_within_tolerance(rig: Identification) -> None:
    left_out = np.array([s.rms for s in rig.segments if not s.used])
    assert [s.index for s in rig.segments if not s.used] == [2, 5, 8, 11, 14]
    assert np.median(left_out) <= MEDIAN
    assert left_out.max() <= WORST
    # Errors of the published values, computed independently of this code.
    assert rig.started_at * 1e3 == pytest.approx([3.8, 2.9, 2.7, 2.9, 4.0], abs=0.1)


@pytest.mark.slow
def test_the_rigs_friction_needs_coulomb_and_the_airs_drag(rig: Identification) -> None:
    assert rig.friction_terms == ("viscous", "coulomb", "quadratic")
    assert rig.arms.quadratic[1] > 10 * rig.errors[rig.names.index("quadratic_2/M12")] * rig.arms.base()[1]


@pytest.mark.slow
def test_the_choice_prefers_few_terms_within_one_standard_error(rig: Identification) -> None:
    few, many = rig.candidates[0], rig.candidates[-1]
    errors = np.array([1.0, 1.2, 0.8, 1.1, 0.9])
    near = [replace(few, left_out=errors * 1.02), replace(many, left_out=errors)]
    far = [replace(few, left_out=errors * 2), replace(many, left_out=errors)]
    assert choose(near) == 0
    assert choose(far) == 1
    # A single held-out segment gives no standard error, and a law at zero differs in the last digits.
    same = [replace(few, left_out=np.array([1.0])), replace(many, left_out=np.array([1.0 - 1e-13]))]
    assert choose(same) == 0


def test_the_shipped_model_agrees_with_the_rigs_recording(rig: Identification) -> None:
    shipped = load_model("lab-identified")
    ratios = len(base_ratios(rig.arms))
    deviations = np.sqrt(np.diag(shipped.uncertainty.matrix))
    away = np.abs(base_ratios(shipped.arms) - base_ratios(rig.arms))
    assert (away <= 0.05 * deviations + 1e-12).all()
    assert deviations == pytest.approx(np.sqrt(np.diag(rig.covariance))[:ratios], rel=0.05)
    assert shipped.encoder_zeros == pytest.approx(tuple(rig.zeros[0]), abs=1e-6)


def test_correlation_time_agrees_with_a_known_process() -> None:
    random = np.random.default_rng(5)
    memory, count = 0.9, 200_000
    noise = random.standard_normal(count)
    values = np.empty(count)
    values[0] = noise[0]
    for k in range(1, count):
        values[k] = memory * values[k - 1] + noise[k]
    # For a first-order autoregressive process it is (1 + a) / (1 - a). The sum stops at 0.05, a tenth short.
    assert correlation_time([values[:, None]]) == pytest.approx(19.0, rel=0.15)
    assert correlation_time([noise[:, None]]) == pytest.approx(1.0, abs=0.2)
