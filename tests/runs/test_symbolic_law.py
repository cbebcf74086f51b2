"""A user's law of expressions: one with built-in gains, in every path, against the built-in law; and its C."""

import runpy
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import dpcontrol as dp
from dpcontrol.control.lqr import HoldController
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.plan import make_plan

SAME, BEGINNING = 1e-9, 300
"""rad, before an encoder's count flips: sums in another order. Ticks before that."""
SHORT_HOLD = """
model = "lab"
start = "hold"
hold = "up-up"
seconds = 4.0
controller = { kind = "lqr" }
run = { mismatch = 0.02, initial_error = 0.02 }
"""
PLAN = make_plan(itinerary_from(SHORT_HOLD, "short-hold", load_model("lab")))
HELD = dp.closed_loop(PLAN, estimator="ekf").assembly.controller


def same_gains() -> dp.SymbolicLaw:
    """Return the regulator that holds both arms upright, without what it feeds back of the estimator's extras."""
    assert isinstance(HELD, HoldController)
    gain = HELD.gain

    def own(state, reference, memory, parameters):
        return reference.feedforward + ca.dot(gain, reference.state - state), memory + 1.0

    return dp.SymbolicLaw(own, memory=1)


@pytest.mark.slow
def test_expressions_fly_as_the_same_law_in_python_does() -> None:
    gain = HELD.gain

    class Own:
        def control(self, time, state, reference):
            return reference.feedforward + gain @ (reference.state - state)

    made, python = (dp.closed_loop(PLAN, controller=law).run(seed=2) for law in (same_gains(), Own()))
    assert made.converged
    assert np.abs(made.log.states["truth"] - python.log.states["truth"])[:BEGINNING].max() < SAME
    assert made.log.events[0].text.startswith("own, ekf")


# Slow: C is made and compiled.
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
def test_the_example_flies_counts_and_leaves_as_c_that_replays_its_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    made = runpy.run_module("dpcontrol.examples.integral_action", run_name="__main__")
    assert "16 of 16 runs completed" in capsys.readouterr().out
    assert (tmp_path / "integral-action.png").stat().st_size > 10_000
    alone, integral = (run.log.states["truth"][-500:, 4].mean() for run in made["runs"].values())
    # At rest the command is zero: K₁ b + K₂ b + K_x x = 0, both arms off by the tilt b.
    gain = made["gains"](1e-9)
    assert alone == pytest.approx(-made["TILT"] * gain[:2].sum() / gain[4], rel=0.1)
    assert abs(integral) < 0.02 * abs(alone)
    done = subprocess.run(
        ["make", "check", "CC=gcc"], cwd=tmp_path / "controller", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "1e-09 allowed" in done.stderr
