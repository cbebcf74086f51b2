"""For any arguments and files, a call ends with 0, 1 or 2 and a message, without partial files."""

import pytest
from hostile import KINDS, VERBS, Trial, file_trials, option_trials
from hypothesis import HealthCheck, given, settings, strategies as st
from laboratory import Laboratory, make_laboratory
from trials import attempt, complaints, explained

OPTIONS, FILES = 6, 6
"""Number of inputs per verb and kind of file."""
LONG = {"demo", "atlas", "export", "identify", "plan", "prove", "report"}
"""Verbs that take seconds, reserved for the slow tests."""
COMMON = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    return make_laboratory(tmp_path_factory.mktemp("laboratory"))


@pytest.fixture(autouse=True)
def no_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prevent trials from opening viewers or serving runs."""
    monkeypatch.setattr("dpcontrol.pages.viewer.viewer_program", lambda: "/bin/true")
    monkeypatch.setattr("dpcontrol.rig.bench.UdpBench.serve", lambda self, *, runs=0: None)


def tried(trials: st.SearchStrategy[Trial], laboratory: Laboratory, *, count: int) -> None:
    @settings(derandomize=True, max_examples=count, **COMMON)
    @given(trials)
    def check(trial: Trial) -> None:
        wrong = complaints(trial, attempt(trial, laboratory))
        assert not wrong, explained(trial, wrong)

    check()


@pytest.mark.parametrize("verb", [pytest.param(v, marks=pytest.mark.slow) if v in LONG else v for v in VERBS])
def test_every_option_is_accepted_or_refused_with_a_message(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS // 2 if verb in LONG else OPTIONS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_with_a_message(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=FILES)
