"""Users' own laws, estimators, plants and rigs: they fly, are logged and scored; a failure ends the run by name."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from own_objects import Arms, Filter, Gains, Judged, Rig, Wrong

import dpcontrol as dp

SAME, STEPS = 1e-6, 1e-4
"""rad and rad/s: sums in another order; steps of another method. Later an encoder's count flips, and the runs part."""
BEGINNING = 300
"""Ticks before that."""
FILE = Path(__file__).parent / "own_objects.py"


@pytest.mark.slow
def test_the_gains_of_tvlqr_as_an_own_law_fly_as_tvlqr_does() -> None:
    law = Gains()
    own = dp.closed_loop("outer-turn", controller=law).run(seed=3)
    built_in = dp.closed_loop("outer-turn", controller="tvlqr").run(seed=3)
    assert own.converged
    assert np.abs(own.log.states["truth"] - built_in.log.states["truth"])[:BEGINNING].max() < SAME
    # Delay: the first command is the reference's own. The law is not called before.
    assert (law.resets, law.asked) == (1, len(own.log.time))
    assert own.log.events[0].text.startswith("Gains, ekf")
    assert json.loads(own.log.metadata["run_settings"])["controller"]["kind"] == "Gains"


@pytest.mark.slow
def test_an_own_estimator_flies_and_the_log_lists_disabled_checks() -> None:
    run = dp.closed_loop("outer-turn", controller="tvlqr", estimator=Filter()).run(seed=3)
    assert run.converged
    assert np.isnan(run.log.controls["nis"]).all()
    assert "Filter has no sigmas: NIS and the check of the estimate are off" in [e.text for e in run.log.events]
    judged = dp.closed_loop("outer-turn", controller="tvlqr", estimator=Judged()).run(seed=3)
    assert judged.converged
    assert (judged.log.controls["nis"][1:] >= 0).all()


@pytest.mark.slow
def test_an_own_plant_of_the_same_equations_moves_as_the_benchs_own() -> None:
    options: dict[str, Any] = {"controller": "tvlqr", "mismatch": 0.0, "initial_error": 0.0}
    own = dp.closed_loop("outer-turn", plant=Arms(), **options).run(seed=3)
    built_in = dp.closed_loop("outer-turn", **options).run(seed=3)
    assert own.converged
    assert np.abs(own.log.states["truth"] - built_in.log.states["truth"])[:BEGINNING].max() < STEPS
    assert own.plant is None


def test_an_own_rig_is_run_logged_and_scored_by_its_true_states(tmp_path: Path) -> None:
    rig = Rig()
    run = dp.closed_loop("outer-turn", controller="tvlqr").run(rig=rig, log=tmp_path / "rig.mcap")
    assert run.converged
    assert rig.stopped == 1
    assert run.log.metadata["rig"] == "Rig"


@pytest.mark.parametrize("value", [float("nan"), None, 1e9, 1j])
def test_a_command_that_is_no_sensible_number_ends_the_run_by_name(value: object) -> None:
    class Law:
        def control(self, time, state, reference):
            return value if time >= 0.05 else reference.feedforward

    run = dp.closed_loop("outer-turn", controller=Law()).run()
    assert not run.converged
    assert f"Law.control returned {' '.join(repr(value).split())[:60]}" in run.status
    # The command for 0.05 s is computed a period before, and that tick is the last.
    assert len(run.log.time) == 50
    assert run.log.metadata["ending"] == "object failed"
    assert run.log.events[-1].level == "error"


@pytest.mark.slow
def test_a_campaign_compares_laws_counts_failures_and_continues() -> None:
    found = dp.closed_loop("outer-turn").campaign(runs=2, over={"controller": ["tvlqr", Gains(), Wrong()]})
    assert [one.completed.successes for one in found.results] == [2, 2, 0]
    assert [one.case.label for one in found.results][1:] == ["controller=Gains", "controller=Wrong"]
    reasons = [row["reason"] for row in found.results[2].failed.to_pylist()]
    assert all("Wrong.control returned nan" in reason for reason in reasons)


def test_on_the_command_line_a_law_is_a_file_and_a_class(tmp_path: Path) -> None:
    log = tmp_path / "own.mcap"
    done = dpcontrol("run", "outer-turn", "--controller", f"{FILE}:Wrong", "--out", str(log))
    assert done.code == 1
    assert "Wrong.control returned nan" in done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    again = dpcontrol("run", "--from", str(log))
    assert again.code == 2
    assert "controller = Wrong is a user's object" in again.stderr
    for given in (f"{FILE}:Mute", f"{FILE}:No", "no.py:A"):
        assert dpcontrol("run", "outer-turn", "--controller", given).code == 2


class _Interrupted(Rig):
    def read(self):
        if self.count == 30:
            raise KeyboardInterrupt
        return super().read()


def test_an_interrupted_run_stops_the_rig() -> None:
    rig = _Interrupted()
    with pytest.raises(KeyboardInterrupt):
        dp.closed_loop("outer-turn", controller="tvlqr").run(rig=rig)
    assert rig.stopped == 1
