"""Identified models as files: written, loaded again, drawn from, and refused where their uncertainty is none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.identification.identify import Identification, IdentificationSettings, identify
from dpcontrol.plans.model import load_model, write_model
from dpcontrol.recordings.recording import simulated_recording

LAB = load_model("lab")


@pytest.fixture(scope="module")
def found() -> Identification:
    """A quick identification with Coulomb friction and zeros."""
    arms = replace(LAB.arms, viscous=(1e-3, 1e-4), coulomb=(5e-4, 3e-4))
    starts = [np.array(s) for s in ((1.0, 0.2), (-0.5, 0.9), (0.3, -1.1))]
    recording = simulated_recording(arms, starts, seconds=1.5, period=2e-3, zeros=np.array([1e-3, -1e-3]))
    settings = IdentificationSettings(zeros="free", laws=(arms.friction,))
    return identify([recording], LAB.arms, settings=settings)


@pytest.fixture
def file(found: Identification, tmp_path: Path) -> Path:
    return write_model(
        found, tmp_path / "rig.toml", title='The "rig"', logs=["a\\b.mcap", "c\n.mcap"], starting_model="lab"
    )


@pytest.mark.slow
def test_a_written_model_loads_as_it_was_found(found: Identification, file: Path) -> None:
    model = load_model(str(file))
    assert model.arms == found.arms
    assert model.title == 'The "rig"'
    assert model.encoder_zeros == tuple(found.zeros[0])
    assert model.uncertainty is not None
    m = len(model.uncertainty.names)
    assert np.array_equal(model.uncertainty.matrix, found.covariance[:m, :m])
    assert all(sentence in model.text for sentence in found.undetermined)
    assert set(model.sources) == {"arms", "gravity", "friction", "encoders", "uncertainty"}
