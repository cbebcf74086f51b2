"""A score claims no more than a log shows; simulated runs are judged by the true plant, others by the estimate."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dpcontrol.control.estimator_settings import MEANS_OF, nis_means
from dpcontrol.foundation.causes import Cause
from dpcontrol.judge.decoding import FOLLOWS
from dpcontrol.judge.score import HARDEST_METADATA, counted, score, stretches_of
from dpcontrol.logs import Event, RunLog, Stretch
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.run import run_plan


@pytest.fixture(scope="module")
def log(plan: Plan) -> RunLog:
    """The log of a completed run of 1 ms periods."""
    return run_plan(plan).log


@pytest.mark.slow
def test_a_whole_run_and_one_that_lacks_a_few_ticks_are_completed(log: RunLog) -> None:
    assert score(log).completed
    late = log.time + np.where(log.time > 1.0, 0.02, 0.0)
    assert score(replace(log, time=late)).completed


@pytest.mark.parametrize(("shift", "fault"), [(0.4, "jump by +0.401 s"), (-0.4, "jump by -0.399 s")])
def test_stamps_that_jump_or_go_back_are_not_scored_as_completed(shift: float, fault: str, log: RunLog) -> None:
    row = len(log.time) // 2
    moved = log.time + np.where(np.arange(len(log.time)) > row, shift, 0.0)
    found = score(replace(log, time=moved))
    assert (found.completed, found.whole) == (None, False)
    assert f"{fault} at t = {log.time[row]:.2f} s" in found.reason


def test_a_tumble_after_the_run_has_lost_its_reference_is_no_symbol(log: RunLog) -> None:
    """The outer arm falls the same way round before its turn is due, and hangs about upright again by chance."""
    n, truth = len(log.arm_lengths), log.states["truth"].copy()
    early = int(0.35 * len(log.time))
    truth[:, :n] = np.where(np.arange(len(truth))[:, None] < early, truth[:, :n], truth[-1, :n])
    assert np.abs(truth[early, :n] - log.reference[early, :n]).max() > FOLLOWS
    found = score(replace(log, states={**log.states, "truth": truth}))
    assert (found.completed, found.symbols_completed) == (False, 0)
    # Followed all the way the same stops count.
    assert score(log).symbols_completed == 1


def test_a_nis_inside_its_band_but_off_its_mean_is_called_so(log: RunLog) -> None:
    """A third of what is expected leaves nine tenths of single values in their band, and no mean."""
    nis = 0.34 * np.random.default_rng(0).chisquare(3, len(log.time))
    found = score(replace(log, controls={**log.controls, "nis": nis}))
    assert found.nis_inside_95 > 0.85
    assert found.nis_means.inside_95 == 0.0
    assert found.nis_means.mean == pytest.approx(1.02, abs=0.05)


def test_the_score_of_a_default_run_reports_no_fault_of_the_filter(log: RunLog) -> None:
    """The noise that the default filter assumes is close to that of the bench."""
    found = score(log)
    assert 2.5 < found.nis_means.mean < 3.2
    assert found.nis_means.inside_95 > 0.85


@pytest.mark.parametrize("freedom", [1, 2, 3])
def test_means_of_a_consistent_nis_are_in_their_band(freedom: int) -> None:
    values = np.random.default_rng(1).chisquare(freedom, 2000 * MEANS_OF)
    values[::7] = np.nan
    found = nis_means(values, freedom)
    assert found.inside_95 == pytest.approx(0.95, abs=0.02)
    assert nis_means(values[: MEANS_OF - 1], freedom) is None


def with_applied(log: RunLog, row: int, value: float) -> RunLog:
    """Return the log with another acceleration in the loop's own figures."""
    applied = log.controls["applied"].copy()
    applied[row] = value
    return replace(log, controls={**log.controls, "applied": applied})


def without_note(log: RunLog) -> RunLog:
    return replace(log, metadata={k: v for k, v in log.metadata.items() if k != HARDEST_METADATA})


@pytest.mark.slow
def test_a_simulated_run_notes_the_largest_acceleration_that_its_drive_applied(log: RunLog) -> None:
    """Without a cart's mass, command noise or blows it is the largest change of the true velocity."""
    true = np.abs(np.diff(log.states["truth"][:, -1])).max() * log.rate_hz
    assert float(log.metadata[HARDEST_METADATA]) == pytest.approx(true, rel=1e-6)
    assert score(log).document()["judged_by"] == "truth"


def test_wrong_assumptions_on_the_drive_fail_no_simulated_run(log: RunLog) -> None:
    assert score(with_applied(log, 700, 98.3)).completed


def test_a_drive_that_really_went_beyond_its_limit_fails_the_run(log: RunLog) -> None:
    found = score(replace(log, metadata={**log.metadata, HARDEST_METADATA: "41.5"}))
    assert found.completed is False
    assert "41.5" in found.reason


def test_without_the_true_state_the_verdict_uses_the_estimate_and_reports_this(log: RunLog) -> None:
    measured = replace(without_note(log), states={k: v for k, v in log.states.items() if k != "truth"})
    found = score(measured)
    assert (found.completed, found.judged_by) == (None, "estimate")
    assert not found.missed
    assert replace(found, symbols_completed=0).missed
    assert "acceleration" in score(with_applied(measured, 700, 98.3)).reason


def test_ticks_that_are_flown_again_do_not_count() -> None:
    flights = [Stretch(0, 3000, 0.0), Stretch(8000, 9000, 2.0), Stretch(12_000, 15_000, 1.5)]
    parts = counted(flights, rate_hz=1000.0)
    times = np.concatenate([times for _, times in parts])
    assert [rows[0] for rows, _ in parts] == [0, 12_000]
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=1e-9)
    assert times[-1] == pytest.approx(4.499)


def test_flights_are_decoded_from_the_log() -> None:
    symbol = {"symbol": 2, "symbols": 3, "name": "down-up -", "attempt": 4}
    events = [
        Event(0.0, "info", "resume", Cause.JOINED, {**symbol, "at": 0.0, "symbol": 1}),
        Event(3.0, "warn", "return", Cause.TRACKING_LOST),
        Event(9.0, "info", "resume", Cause.JOINED, {**symbol, "at": 2.5}),
        Event(10.0, "warn", "catch", Cause.JOINED, {**symbol, "at": 2.7, "back": 0.8}),
    ]
    log = SimpleNamespace(events=events, time=np.arange(12_000) / 1000, rate_hz=1000.0)
    assert stretches_of(log) == (Stretch(0, 3001, 0.0), Stretch(9000, 10_000, 2.5), Stretch(10_000, 12_000, 2.7))
