"""Identified models as files: written, loaded again, drawn from, and refused where their uncertainty is none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.dynamics.chain import base_ratios
from dpcontrol.foundation.errors import InputError
from dpcontrol.identification.identify import Identification, IdentificationSettings, identify
from dpcontrol.plans.model import load_model, write_model
from dpcontrol.recordings.recording import simulated_recording

LAB = load_model("lab")
DRAWS = 400


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
    """Its model file."""
    return write_model(
        found, tmp_path / "rig.toml", title='The "rig"', logs=["a\\b.mcap", "c\n.mcap"], starting_model="lab"
    )


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


@pytest.mark.slow
def test_drawn_arms_have_the_covariance_and_a_seed_repeats_them(found: Identification, file: Path) -> None:
    model = load_model(str(file))
    random = np.random.default_rng(1)
    drawn = np.array([base_ratios(model.identified_uncertainty.drawn(model.arms, random)) for _ in range(DRAWS)])
    again = [model.identified_uncertainty.drawn(model.arms, np.random.default_rng(3)) for _ in range(2)]
    assert model.uncertainty is not None
    # A standard deviation from 400 draws is itself known to 3.5 %.
    assert drawn.std(axis=0) == pytest.approx(np.sqrt(np.diag(model.uncertainty.matrix)), rel=0.15)
    assert drawn.mean(axis=0) == pytest.approx(base_ratios(model.arms), abs=0, rel=0.05)
    assert again[0] == again[1]


def test_models_without_uncertainty_are_as_they_were_and_cannot_be_drawn_from() -> None:
    assert LAB.uncertainty is None
    assert LAB.encoder_zeros == ()
    with pytest.raises(InputError, match=r"no \[uncertainty\]"):
        _ = LAB.identified_uncertainty


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"M22/M12"', '"M23/M12"', "names ="),
        ("covariance = [\n", "covariance = [\n 1.0,", "covariance has 65 numbers: must have 64"),
        ("covariance = [\n    ", "covariance = [\n    -", "symmetric"),
        ("zeros = [", "zeros = [0.0, ", "zeros has 3 values"),
        ("smoothing = 0.05", "smoothing = 0", "smoothing = 0"),
        ("coulomb = [", "coulomb = [-", "must be 0 to 1e+06"),
        ("coulomb = [", "coulombs = [", "did you mean 'coulomb'"),
    ],
)
def test_mistakes_in_the_new_tables_are_named(file: Path, old: str, new: str, said: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as refused:
        load_model(str(file))
    assert said in str(refused.value)
    assert str(file) in str(refused.value)


def test_smoothing_without_anything_to_smooth_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "model.toml"
    file.write_text(LAB.text.replace("[friction]", "[friction]\nsmoothing = 0.1"))
    with pytest.raises(InputError, match="neither coulomb nor quadratic"):
        load_model(str(file))
