"""Users' own laws, estimators, plants and rigs: they fly, are logged and scored; a failure ends the run by name."""

import asyncio
import json
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from command_line import dpcontrol, dpcontrol_program
from own_objects import Arms, Filter, Gains, Judged, Mute, Rig, Wrong

import dpcontrol as dp
from dpcontrol.control.symbolic import Setpoint
from dpcontrol.loop.own import OwnObject
from dpcontrol.loop.result import Reading

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


@pytest.mark.slow
def test_with_its_sigmas_the_estimate_is_judged() -> None:
    run = dp.closed_loop("outer-turn", controller="tvlqr", estimator=Judged()).run(seed=3)
    assert run.converged
    nis = run.log.controls["nis"][1:]
    assert (nis >= 0).all()
    assert nis.any()


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


@pytest.mark.parametrize("value", [float("nan"), None, np.zeros(2), 1e9, -1e9, "1.0", True, [1.0], 1j, 10**400])
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


@pytest.mark.parametrize("where", ["control", "reset"])
def test_errors_of_an_object_are_named_without_a_traceback(where: str) -> None:
    class Law:
        def reset(self):
            assert where != "reset", "not\n ready"

        def control(self, time, state, reference):
            raise SystemExit("not\n ready")

    run = dp.closed_loop("outer-turn", controller=Law()).run()
    kind = "AssertionError" if where == "reset" else "SystemExit"
    assert f"Law.{where} raised {kind}: not ready" in run.status
    assert len(run.log.time) == 1


@pytest.mark.parametrize("sleeps", [True, False])
def test_a_call_that_lasts_too_long_is_interrupted(sleeps: bool) -> None:
    class Law:
        longest = 0.2

        def control(self, at, state, reference):
            while at >= 0.05:
                # As careless as users are.
                with suppress(Exception):
                    time.sleep(60 if sleeps else 0)
            return 0.0

    began = time.monotonic()
    run = dp.closed_loop("outer-turn", controller=Law()).run()
    assert "Law.control took longer than 0.2 s" in run.status
    assert time.monotonic() - began < 60


@pytest.mark.slow
def test_estimators_plants_and_rigs_end_a_run_by_name_as_laws_do() -> None:
    class Half(Filter):
        def update(self, reading, acceleration):
            return super().update(reading, acceleration)[:3] if reading.time > 0.02 else super().update(reading, 0.0)

    class Torn(Arms):
        def step(self, state, acceleration, seconds):
            return state * np.nan

    status = dp.closed_loop("outer-turn", controller="tvlqr", estimator=Half()).run().status
    assert "Half.update returned array(" in status
    status = dp.closed_loop("outer-turn", plant=Torn()).run().status
    assert "Torn.step returned array([nan, nan, nan, nan, nan, nan]): it must return 6 finite numbers" in status
    rig = Rig(fails_at=30, value=[0.0, None, 0.0])
    run = dp.closed_loop("outer-turn").run(rig=rig)
    assert "Rig.read returned [0.0, None, 0.0]: it must return 3 finite numbers" in run.status
    assert (len(run.log.time), rig.stopped) == (29, 1)
    with pytest.raises(dp.GoalMissed, match=r"Rig\.read returned None"):
        dp.closed_loop("outer-turn").run(rig=Rig(fails_at=1))


@pytest.mark.parametrize("role", ["controller", "estimator", "plant"])
def test_a_missing_method_is_an_input_error_before_anything_runs(role: str) -> None:
    with pytest.raises(dp.InputError, match=f"{role} = Mute: it has no method"):
        dp.closed_loop("outer-turn", **{role: Mute()})
    with pytest.raises(dp.InputError, match=r"this is a class; give an object, Gains\(\)"):
        dp.closed_loop("outer-turn", **{role: Gains})
    with pytest.raises(dp.InputError, match="rig = Mute: it has no method"):
        dp.closed_loop("outer-turn").run(rig=Mute())


@pytest.mark.slow
def test_a_campaign_compares_laws_counts_failures_and_continues() -> None:
    found = dp.closed_loop("outer-turn").campaign(runs=2, over={"controller": ["tvlqr", Gains(), Wrong()]})
    assert [one.completed.successes for one in found.results] == [2, 2, 0]
    assert [one.case.label for one in found.results][1:] == ["controller=Gains", "controller=Wrong"]
    reasons = [row["reason"] for row in found.results[2].failed.to_pylist()]
    assert all("Wrong.control returned nan" in reason for reason in reasons)


def test_margins_and_export_need_equations() -> None:
    loop = dp.closed_loop("outer-turn", controller=Gains())
    for ask in (loop.margins, loop.export):
        with pytest.raises(dp.InputError, match="Python"):
            ask()


def test_on_the_command_line_a_law_is_a_file_and_a_class(tmp_path: Path) -> None:
    log = tmp_path / "own.mcap"
    done = dpcontrol("run", "outer-turn", "--controller", f"{FILE}:Wrong", "--out", str(log))
    assert done.code == 1
    assert "Wrong.control returned nan" in done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    again = dpcontrol("run", "--from", str(log))
    assert again.code == 2
    assert "controller = Wrong is a user's object" in again.stderr
    for given, said in ((f"{FILE}:Mute", "no method control"), (f"{FILE}:No", "no class No"), ("no.py:A", "no file")):
        refused = dpcontrol("run", "outer-turn", "--controller", given)
        assert refused.code == 2
        assert said in refused.stderr


@pytest.mark.slow
def test_on_the_command_line_a_rig_is_a_file_and_a_class(tmp_path: Path) -> None:
    log = tmp_path / "rig.mcap"
    done = dpcontrol("run", "outer-turn", "--rig", f"{FILE}:Rig", "--controller", "tvlqr", "--out", str(log))
    assert done.code == 0, done.stderr
    assert dp.open_log(log).log.metadata["rig"] == "Rig"
    for more, said in (("--hours=1", "omit them"), ("--real-time", "omit them")):
        refused = dpcontrol("run", "outer-turn", "--rig", f"{FILE}:Rig", more)
        assert refused.code == 2
        assert said in refused.stderr
    refused = dpcontrol("run", "outer-turn", "--rig", f"{FILE}:Mute")
    assert refused.code == 2
    assert "rig = Mute: it has no method read()" in refused.stderr


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


class _Blind(Rig):
    """A rig that loses its readings, so that the supervisor stops the cart before the end."""

    truth = None

    def __init__(self) -> None:
        super().__init__()
        self.commands: list[bool] = []

    def read(self):
        positions = super().read()
        return Reading(0.0, positions, np.zeros(3, dtype=bool)) if self.count > 50 else positions

    def command(self, acceleration: float) -> None:
        self.commands.append(self.stopped > 0)
        super().command(acceleration)


def test_a_stopped_rig_receives_neither_commands_nor_a_second_stop() -> None:
    rig = _Blind()
    run = dp.closed_loop("outer-turn", controller="tvlqr").run(rig=rig)
    assert "no measurement" in run.failure
    assert rig.stopped == 1
    assert not any(rig.commands)


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        ({"present": ["a", "b", "c"]}, "`present` has 3 times True or False"),
        ({"present": [True, [False], True]}, "`present` has 3 times True or False"),
        ({"switch": "left"}, "returned 'left': it must return a reading whose `switch` is -1, 0 or 1"),
        ({"switch": float("nan")}, "`switch` is -1, 0 or 1"),
        ({"late": None}, "`late` is seconds"),
        ({"age": "old"}, "`age` is None or seconds of at least 0"),
    ],
)
def test_an_invalid_field_of_a_reading_ends_the_run_by_name(reading: dict[str, Any], said: str) -> None:
    class Fields(Rig):
        def read(self):
            return Reading(0.0, super().read())._replace(**(reading if self.count == 30 else {}))

    run = dp.closed_loop("outer-turn", controller="tvlqr").run(rig=Fields())
    assert said in run.failure
    assert len(run.log.time) == 29


def test_a_command_and_an_attribute_that_raise_during_a_run_end_it() -> None:
    class Jams(Rig):
        def command(self, acceleration: float) -> None:
            if self.count == 30:
                raise OSError("bus off")
            super().command(acceleration)

    class Hides(Rig):
        @property
        def truth(self):
            if self.count == 30:
                raise ValueError("no truth")
            return self.state

    run = dp.closed_loop("outer-turn", controller="tvlqr").run(rig=Jams())
    assert (run.failure, len(run.log.time)) == ("Jams.command raised OSError: bus off, at t = 0.029 s", 30)
    run = dp.closed_loop("outer-turn", controller="tvlqr").run(rig=Hides())
    assert (run.failure, len(run.log.time)) == ("Hides.truth raised ValueError: no truth, at t = 0.029 s", 29)


def test_an_exception_of_any_class_ends_the_run_by_name() -> None:
    class Law:
        def control(self, time, state, reference):
            raise asyncio.CancelledError

    assert "Law.control raised CancelledError" in dp.closed_loop("outer-turn", controller=Law()).run().status


@pytest.mark.parametrize("limit", ["abc", -1.0, 0.0, float("inf"), float("nan"), 1e-9, np.ones(2)])
def test_an_invalid_time_limit_is_refused(limit: object) -> None:
    law = Gains()
    law.longest = limit
    with pytest.raises(dp.InputError, match=r"Gains: longest = .*from 0.001 to 86400"):
        dp.closed_loop("outer-turn", controller=law)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers of signals are POSIX's")
@pytest.mark.parametrize("during", [False, True])
def test_timers_of_other_code_go_on(during: bool) -> None:
    class Law:
        def control(self, time, state, reference):
            if during:
                signal.setitimer(signal.ITIMER_REAL, 1000.0, 30.0)
            return reference.feedforward

    before = signal.signal(signal.SIGALRM, lambda number, frame: None)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.0 if during else 1000.0, 0.0 if during else 30.0)
        OwnObject("controller", Law()).number("control", 0.0, np.zeros(6), Setpoint(np.zeros(6), 0.0))
        left, every = signal.getitimer(signal.ITIMER_REAL)
        assert 900 < left <= 1000
        assert every == 30.0
        assert signal.getsignal(signal.SIGALRM).__name__ == "<lambda>"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_complex_numbers_are_refused_instead_of_losing_a_part() -> None:
    class Law:
        def control(self, time, state, reference):
            return np.complex128(1 + 1j)

    assert "Law.control returned" in dp.closed_loop("outer-turn", controller=Law()).run().status


def test_margins_beside_a_python_plant_are_those_of_the_model() -> None:
    own, built_in = (dp.closed_loop("hold-up-up", **more).margins() for more in ({"plant": Arms()}, {}))
    assert own.simulated == built_in.simulated


_PRINTING = """\
import os
import sys
from gains_beside import GAIN
class Prints:
    def control(self, time, state, reference):
        if time < 0.003:
            print("from a law")
            sys.__stdout__.write("around Python's stdout")
            os.write(1, b"from compiled code")
        return reference.feedforward + GAIN
class Rig:
    def read(self):
        raise OSError("gone")
    def command(self, acceleration): ...
    def stop(self): ...
class Later(Rig):
    count = 0
    def read(self):
        self.count += 1
        if self.count > 20:
            raise OSError("gone")
        return [0.0, 0.0, 0.0]
"""


@pytest.fixture
def own_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.syspath_prepend("")
    monkeypatch.chdir(tmp_path)
    Path("gains_beside.py").write_text("GAIN = 0.0\n")
    Path("own.py").write_text(_PRINTING)
    return "own.py"


def test_a_law_that_prints_leaves_the_json_document_whole(own_file: str) -> None:
    done = dpcontrol_program("run", "outer-turn", "--controller", f"{own_file}:Prints", "--json", folder=Path())
    assert json.loads(done.stdout)["symbols_total"] == 1
    for text in ("from a law", "around Python's stdout", "from compiled code"):
        assert text in done.stderr


def test_a_law_that_fails_in_the_last_tick_gives_exit_code_1(tmp_path: Path) -> None:
    done = dpcontrol("run", "outer-turn", "--controller", f"{FILE}:Last", "--out", str(tmp_path / "last.mcap"))
    assert "  completed: 1 of 1 symbols" in done.stdout
    assert done.code == 1
    assert "dpcontrol: failed: Last.control returned None" in done.stderr


def test_a_rig_that_fails_gives_exit_code_1_and_its_traceback_with_debug(own_file: str) -> None:
    done = dpcontrol_program("run", "outer-turn", "--rig", f"{own_file}:Later", "--debug", folder=Path())
    assert done.code == 1
    assert "not completed: Later.read raised OSError: gone, at t = 0.020 s" in done.stderr
    assert 'raise OSError("gone")' in done.stderr


def test_a_file_without_a_class_is_refused(own_file: str) -> None:
    for option in ("--controller", "--rig"):
        refused = dpcontrol("run", "outer-turn", option, own_file)
        assert refused.code == 2
        assert "own.py: the class is missing; give FILE.py:CLASS" in refused.stderr


def test_a_night_with_a_failing_plant_gives_exit_code_1(tmp_path: Path) -> None:
    file = tmp_path / "torn.py"
    file.write_text("class Torn:\n    def step(self, state, acceleration, seconds):\n        return None\n")
    done = dpcontrol(
        "run", "outer-turn", "--set", f"plant={file}:Torn", "--hours=0.001", "--out", str(tmp_path / "n.mcap")
    )
    assert done.code == 1
    assert "ended early: Torn.step returned None" in done.stderr


@pytest.mark.slow
def test_the_standard_score_is_that_of_the_loops_own_law() -> None:
    loop = dp.closed_loop("hold-up-up", controller=dp.SymbolicLaw(_push))
    (found,) = loop.standard_score(settings=dp.CampaignSettings(runs=1, replayed=0))
    assert found.controller == "_push"


def _push(state: ca.SX, reference: Any, memory: ca.SX, parameters: ca.SX) -> tuple[ca.SX, ca.SX]:
    return reference.feedforward, memory
