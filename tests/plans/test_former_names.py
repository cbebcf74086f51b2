"""Names of version 0.2.0 still work and give a warning with their replacement."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.cli.verbs import FORMER
from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.overrides import resolved


def test_an_orbit_is_sampled_at_times_by_its_states() -> None:
    orbit = dp.orbit("lab", saddle="down-up", energy=-0.07)
    with pytest.warns(DeprecationWarning, match=r"use states\(times\) instead"):
        former = orbit.sample(np.array([0.0, 0.3]))
    assert former == pytest.approx(orbit.states([0.0, 0.3]), abs=0)
    assert orbit.sample(3).shape == (3, 4)


def test_the_uncertainty_of_a_model_has_its_former_name() -> None:
    model = dp.load_model("lab-identified")
    with pytest.warns(DeprecationWarning, match="use identified_uncertainty"):
        assert model.known_to == model.identified_uncertainty


def test_the_margins_of_a_plan_are_those_of_its_closed_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = dp.plan("hold-down-down")
    monkeypatch.setattr(type(dp.closed_loop(plan)), "margins", lambda self: self.plan.itinerary.name)
    with pytest.warns(DeprecationWarning, match=r"use dp.closed_loop\(plan\).margins\(\) instead"):
        assert plan.margins() == "hold-down-down"


def test_the_preflight_of_a_plan_is_that_of_its_closed_loop(recwarn: pytest.WarningsRecorder) -> None:
    with pytest.raises(InputError, match="runs"):
        dp.plan("hold-down-down").preflight(runs=-1)
    assert "use dp.closed_loop(plan).preflight() instead" in str(recwarn.pop(DeprecationWarning).message)


@pytest.mark.parametrize("name", sorted(FORMER))
def test_each_former_option_is_a_path_of_set(name: str) -> None:
    assert resolved(FORMER[name])


@pytest.mark.slow
def test_a_run_with_former_options_has_their_settings(tmp_path: Path) -> None:
    run = ("run", "hold-down-down", "--json", "--force", "--out", tmp_path / "run.mcap")
    former = dpcontrol(*run, "--drive-lag", "0.002", "--rate-noise=0.01")
    assert former.code == 0, former.stderr
    assert "--drive-lag will go: use --set drive_lag=VALUE instead" in former.stderr
    assert "--rate-noise will go: use --set sensors.rate_noise=VALUE instead" in former.stderr
    settings = json.loads(dp.open_log(tmp_path / "run.mcap").log.metadata["run_settings"])
    assert (settings["drive_lag"], settings["sensors"]["rate_noise"]) == (0.002, 0.01)


def test_options_of_a_closed_loop_are_its_settings() -> None:
    with pytest.warns(DeprecationWarning, match="use settings= instead"):
        loop = dp.closed_loop("hold-down-down", options={"drive.lag": 0.002})
    assert loop.plan.itinerary.loop.drive.lag == 0.002
