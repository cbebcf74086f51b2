"""For any arguments and files, a call ends with 0, 1 or 2 and a message, without partial files.

The quick tests and the benchmarks use fixed inputs. An hour of new ones, each in a supervised child process, is run by

    pytest -m benchmark tests/fuzz -s

It prints its seeds. DPCONTROL_FUZZ_MINUTES shortens it, and DPCONTROL_FUZZ_SEED repeats one round.
"""

import os
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hostile import KINDS, VERBS, Trial, all_trials, file_trials, option_trials
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from laboratory import Laboratory, make_laboratory
from trials import Watched, attempt, complaints, explained, without_programs

OPTIONS, FILES = 6, 6
"""Number of inputs per verb and kind of file in the quick tests."""
MORE = 2
"""Factor for the benchmarks, except for `demo`, which always plans and runs."""
ROUND = 200
"""Number of inputs per seed in the long test."""


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    return make_laboratory(tmp_path_factory.mktemp("laboratory"))


@pytest.fixture(autouse=True)
def no_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prevent trials in this process from starting programs, and restore the changes."""
    monkeypatch.setattr("dpcontrol.pages.picture.viewer_program", None)
    monkeypatch.setattr("dpcontrol.rig.bench.UdpBench.serve", None)
    without_programs()


def tried(trials: st.SearchStrategy[Trial], laboratory: Laboratory, *, count: int) -> None:
    """Run `count` fixed inputs in this process."""

    @settings(
        derandomize=True, max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(trials)
    def check(trial: Trial) -> None:
        wrong = complaints(trial, attempt(trial, laboratory))
        assert not wrong, explained(trial, wrong)

    check()


LONG = {"demo", "atlas", "export", "identify", "plan", "prove", "report"}
"""Verbs that take seconds, reserved for the slow tests."""


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in LONG])
def test_every_option_is_accepted_or_refused_with_a_message(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_with_a_message(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=FILES)


# The other verbs have as many again in the benchmarks.
@pytest.mark.parametrize(
    "verb", [pytest.param(verb, marks=pytest.mark.slow if verb in LONG else pytest.mark.benchmark) for verb in VERBS]
)
def test_many_options_are_accepted_or_refused_with_a_message(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS if verb == "demo" else MORE * OPTIONS)


@pytest.mark.benchmark
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files_are_read_or_refused_with_a_message(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=MORE * FILES)


@pytest.fixture
def watched(laboratory: Laboratory, tmp_path: Path) -> Iterator[Watched]:
    child = Watched(laboratory, tmp_path / "cache")
    yield child
    child.close()


@pytest.mark.benchmark
def test_an_hour_of_hostile_inputs_causes_no_traceback_hang_or_leftover(
    watched: Watched, laboratory: Laboratory, tmp_path: Path
) -> None:
    minutes = float(os.environ.get("DPCONTROL_FUZZ_MINUTES", "60"))
    asked = os.environ.get("DPCONTROL_FUZZ_SEED")
    end = time.monotonic() + 60 * minutes
    count: Counter[str] = Counter()
    wrong: list[str] = []

    def say(text: str) -> None:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    def once(trial: Trial) -> None:
        if time.monotonic() > end and asked is None:
            return
        ended = watched.attempt(trial)
        count["inputs"] += 1
        if ended is None:
            found = ["hang"]
        else:
            found = complaints(trial, ended)
            count[f"exit code {ended.code}"] += 1
            count["interrupted"] += ended.interrupted
        for one in found:
            count[one.partition(":")[0].partition(" left ")[0]] += 1
        if found:
            wrong.append(explained(trial, found))
            say(f"WRONG {wrong[-1]}")

    while time.monotonic() < end:
        number = random.SystemRandom().randrange(2**32) if asked is None else int(asked)
        say(f"seed {number}: {dict(count)}")
        quick = settings(
            max_examples=ROUND, deadline=None, database=None, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        seed(number)(quick(given(all_trials(laboratory))(once)))()
        if asked is not None:
            break
    half = [str(file) for file in (tmp_path / "cache").rglob("*") if file.name.startswith(".")]
    count["leftovers in the cache"] = len(half)
    say(f"in all: {dict(count)}")
    assert not wrong, f"{len(wrong)} of {count['inputs']} inputs:\n" + "\n\n".join(wrong[:20])
    assert not half
