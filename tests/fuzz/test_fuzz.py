"""For any arguments and files, a call ends with 0, 1 or 2 and a message, without partial files.

The quick tests use fixed inputs. An hour of new ones is run by

    pytest -m benchmark tests/fuzz -s

It prints its seeds. DPCONTROL_FUZZ_MINUTES shortens it, and DPCONTROL_FUZZ_SEED repeats one round.
"""

import os
import random
import sys
import time

import pytest
from hostile import KINDS, VERBS, Trial, all_trials, file_trials, option_trials
from hypothesis import HealthCheck, Phase, given, seed, settings, strategies as st
from laboratory import Laboratory, make_laboratory
from trials import attempt, complaints, explained

OPTIONS, FILES = 6, 6
"""Number of inputs per verb and kind of file."""
ROUND = 200
"""Number of inputs per seed in the long test."""
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
    """Run `count` fixed inputs."""

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


@pytest.mark.benchmark
def test_an_hour_of_hostile_inputs_causes_no_traceback_hang_or_leftover(laboratory: Laboratory) -> None:
    asked = os.environ.get("DPCONTROL_FUZZ_SEED")
    end = time.monotonic() + 60 * float(os.environ.get("DPCONTROL_FUZZ_MINUTES", "60"))
    wrong: list[str] = []

    def once(trial: Trial) -> None:
        if time.monotonic() < end and (found := complaints(trial, attempt(trial, laboratory))):
            wrong.append(explained(trial, found))

    while time.monotonic() < end:
        number = random.SystemRandom().randrange(2**32) if asked is None else int(asked)
        sys.stderr.write(f"seed {number}: {len(wrong)} wrong so far\n")
        quick = settings(max_examples=ROUND, phases=[Phase.generate], **COMMON)
        seed(number)(quick(given(all_trials(laboratory))(once)))()
        if asked is not None:
            break
    assert not wrong, "\n\n".join(wrong[:20])
