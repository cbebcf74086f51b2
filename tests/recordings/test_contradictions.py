"""Recordings that a model's arms cannot have made are remarked on; those that they made are not."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.checks import contradiction
from dpcontrol.recordings.recording import Recording, simulated_recording

LAB = load_model("lab").arms
START = [np.array([0.5, 0.8])]
SWAP, NEGATE, STOP = [[0.0, 1.0], [1.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]], [[1.0, 0.0], [0.0, 0.0]]


@pytest.fixture(scope="module")
def swing() -> Recording:
    return simulated_recording(LAB, START, seconds=2.0)


def said(recording: Recording, arms: ArmChainParameters = LAB) -> str:
    return contradiction(recording, arms, model="lab")


def changed(recording: Recording, matrix: list[list[float]]) -> Recording:
    return replace(recording, angles=recording.angles @ np.array(matrix))


@pytest.mark.parametrize("about", [{"counts": 1000}, {"counts": 0, "period": 0.005}])
def test_a_models_own_swings_do_not_contradict_it(about: dict[str, Any]) -> None:
    swing = simulated_recording(LAB, START, seconds=2.0, **about)
    assert said(swing) == said(swing, LAB.mismatched(0.1, np.random.default_rng(1))) == ""
    assert said(simulated_recording(LAB, [np.array([0.02, 0.01])], seconds=1.0, **about)) == ""


def test_exchanged_columns_contradict_the_model_and_are_named(swing: Recording) -> None:
    text = said(changed(swing, SWAP))
    assert "contradicts the recording" in text
    assert "in the order 2, 1" in text


def test_a_wrong_sign_a_constant_angle_or_arms_of_twice_the_length_contradict_the_model(swing: Recording) -> None:
    for matrix in (NEGATE, STOP):
        text = said(changed(swing, matrix))
        assert "contradicts" in text
        assert "exchanged" not in text
    twice = {name: tuple(2 * v for v in getattr(LAB, name)) for name in ("length", "centre_of_mass")}
    assert "contradicts" in said(swing, replace(LAB, **twice, inertia=tuple(4 * v for v in LAB.inertia)))


def test_an_arm_that_swings_about_another_angle_than_hanging_is_named(swing: Recording) -> None:
    text = said(replace(swing, angles=np.column_stack([swing.angles[:, 0], swing.angles[:, 1] + 2.9 - 4 * np.pi])))
    assert re.search(r"; angle 2 swings about 2\.[89]\d* rad instead of 0: is the mapping's zero", text)
