"""`dpcontrol info`, `recover`, `run --from`: what a log holds, what is left of it, the run once more, and its plant."""

from pathlib import Path

import pytest
from command_line import dpcontrol
from mcap.reader import make_reader

from dpcontrol.dynamics.chain import base_ratios
from dpcontrol.logs import read_log
from dpcontrol.loop.bench import Unlike, draw_bench
from dpcontrol.plans.itinerary import load_itinerary

RATIO = 1e-5
"""Of ratios from five seconds of a run: what rounding to counts leaves."""
RUN = ("run", "outer-turn", "--seed", "3", "--mismatch", "0.02", "--initial-error", "0.02")


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("logs") / "run.mcap"
    ended = dpcontrol(*RUN, "--out", log)
    assert ended.code == 0, ended.stderr
    return log


def messages(log: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Return topic, sequence, times and bytes of every message, as the public reader gives them."""
    with log.open("rb") as stream:
        found = make_reader(stream).iter_messages(log_time_order=False)
        return [(channel.topic, m.sequence, m.log_time, m.publish_time, m.data) for _, channel, m in found]


@pytest.mark.slow
def test_a_run_repeated_from_its_log_has_the_same_bytes_in_every_message(
    logged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "empty"))
    ended = dpcontrol("run", "--from", logged, "--json")
    assert ended.code == 0, ended.stderr
    again = tmp_path / "logs" / "run-again.mcap"
    assert messages(again) == messages(logged)
    assert ended.document["repeated"]["identical_messages"] == len(messages(logged))
    assert read_log(again).attachments == read_log(logged).attachments
    differing = {k for k, v in read_log(logged).metadata.items() if read_log(again).metadata.get(k) != v}
    assert differing <= {"real_time_factor", "thinking_median", "thinking_99", "commit", "plan"}


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("--controller", "adaptive"), ("--controller", "tvlqr", "--estimator", "ukf")])
def test_a_run_with_every_kind_of_trouble_repeats_too(tmp_path: Path, kinds: tuple[str, ...]) -> None:
    troubles = {"mismatch": 0.05, "initial_error": 0.02, "lag": 0.004, "delay": 1.5, "command_noise": 0.3, "tilt": 0.01,
                "noise": 5e-4, "dropout": 0.02, "jitter": 5e-4, "zero_error": 0.01, "missed_counts": 1, "pushes": 2,
                "push_impulse": 5e-4, "knocks": 1, "knock_velocity": 0.05}  # fmt: skip
    asked = [word for name, value in troubles.items() for word in ("--set", f"{name}={value}")]
    log = tmp_path / "hard.mcap"
    dpcontrol("run", "outer-turn", *kinds, *asked, "--seed", "7", "--out", log)
    ended = dpcontrol("run", "--from", log, "--out", tmp_path / "again.mcap", "--json")
    assert ended.document["repeated"]["difference"] is None
    assert messages(tmp_path / "again.mcap") == messages(log)


@pytest.mark.slow
def test_the_log_of_a_run_identifies_its_plant(logged: Path, tmp_path: Path) -> None:
    done = dpcontrol("identify", logged, "--model", "lab", "--out", tmp_path / "plant.toml", "--json")
    assert done.code == 0, done.stderr
    scene, ticks = load_itinerary("outer-turn"), len(read_log(logged).time)
    drawn = draw_bench(scene.model.arms, scene.loop.bench, seed=3, ticks=ticks, period=1e-3, unlike=Unlike(0.02))
    plant = base_ratios(drawn.plant.arms)
    found = list(done.document["parameters"].values())[: len(plant)]
    for told, true in zip(found, plant, strict=True):
        assert told["value"] == pytest.approx(true, abs=max(4 * told["standard_error"], RATIO * true))
