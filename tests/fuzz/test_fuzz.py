"""Whatever is typed and whatever files hold, a call ends with 0, 1 or 2 and a sentence, and leaves nothing half done.

The quick tests and the benchmarks try the same inputs each time. An hour of new ones, each in a child that is watched:

    pytest -m benchmark tests/fuzz -s

prints its seeds; DPCONTROL_FUZZ_MINUTES shortens it, and DPCONTROL_FUZZ_SEED tries one round again.
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
"""Inputs of each verb and of each kind of file in the quick tests."""
MORE = 2
"""How many times as many the benchmarks try, but for `demo`, which plans and runs whatever else is asked of it."""
ROUND = 200
"""Inputs of one seed in the long test."""


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    return make_laboratory(tmp_path_factory.mktemp("laboratory"))


@pytest.fixture(autouse=True)
def no_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let trials in this process start no other programs, and put back what is changed for it."""
    monkeypatch.setattr("dpcontrol.review.picture.viewer_program", None)
    monkeypatch.setattr("dpcontrol.rig.bench.UdpBench.serve", None)
    monkeypatch.setenv("VK_DRIVER_FILES", "")
    without_programs()


def tried(trials: st.SearchStrategy[Trial], laboratory: Laboratory, *, count: int) -> None:
    """Try `count` inputs, the same ones each time, in this process."""

    @settings(
        derandomize=True, max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(trials)
    def check(trial: Trial) -> None:
        wrong = complaints(trial, attempt(trial, laboratory))
        assert not wrong, explained(trial, wrong)

    check()


LONG = {"demo", "atlas", "export", "identify", "prove"}
"""Verbs whose work takes seconds: left to the slow tests."""


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in LONG])
def test_every_option_is_taken_or_refused_in_a_sentence(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_spoilt_file_is_read_or_refused_in_a_sentence(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=FILES)


# Of the others as many again with the benchmarks.
@pytest.mark.parametrize(
    "verb", [pytest.param(verb, marks=pytest.mark.slow if verb in LONG else pytest.mark.benchmark) for verb in VERBS]
)
def test_many_options_are_taken_or_refused_in_a_sentence(verb: str, laboratory: Laboratory) -> None:
    tried(option_trials(verb, laboratory), laboratory, count=OPTIONS if verb == "demo" else MORE * OPTIONS)


@pytest.mark.benchmark
@pytest.mark.parametrize("kind", KINDS)
def test_many_spoilt_files_are_read_or_refused_in_a_sentence(kind: str, laboratory: Laboratory) -> None:
    tried(file_trials(kind, laboratory), laboratory, count=MORE * FILES)


@pytest.fixture
def watched(laboratory: Laboratory, tmp_path: Path) -> Iterator[Watched]:
    child = Watched(laboratory, tmp_path / "cache")
    yield child
    child.close()


@pytest.mark.benchmark
def test_an_hour_of_hostile_inputs_meets_no_traceback_no_hang_and_no_leftover(
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
