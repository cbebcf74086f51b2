"""Logs that other tools wrote again are read by their topics; of those that hold no run, one sentence says why."""

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from log_samples import sample, write_sample
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from dpcontrol.foundation.errors import InputError, Remark
from dpcontrol.judge.of_log import run_view
from dpcontrol.judge.score import score
from dpcontrol.logs import RunLog, layout, read_log, summarise
from dpcontrol.pages.picture import opened
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import Run, run_plan

VERBS = (
    ("score",), ("info",), ("report",), ("review", "--save", "shown.rrd"), ("replay", "--model", "lab"), ("recover",)
)  # fmt: skip
Channels = list[tuple[str, str, str, str, bytes, bytes]]
"""Of each: topic, encoding, schema's name, encoding and text, and a message."""
JOINTS = "sensor_msgs/msg/JointState"
TICKED = ("/joint_states", "/estimate/joint_states", "/reference/joint_states", "/truth/joint_states", "/control")
SIX_DIGITS = 1e-5
"""Of an arm's length that only the robot's description tells."""


def rewritten(
    source: Path,
    out: Path,
    *,
    without: str = "",
    only: tuple[float, float] = (0.0, np.inf),
    hole: tuple[float, float] = (np.inf, np.inf),
    last: bool = False,
    backwards: bool = False,
    encoding: str = "cdr",
    thinned: int = 1,
    bare: bool = False,
    shifted: int = 0,
    edit: Callable[[bytes], bytes] = bytes,
    library: str = "another program",
    **how: Any,
) -> Path:
    """Write a log again by Python's mcap package, with all of its checksums unless `how` says otherwise.

    Args:
        only: times to keep, s.
        hole: times to leave out, s.
        last: attachments follow the messages.
        thinned: keep each n-th message of the state topics.
        bare: leave out metadata and attachments, as converters do.
        shifted: seconds between the clocks of run and recorder.
        edit: changes each message of /joint_states.
    """
    seen: Counter[str] = Counter()
    with source.open("rb") as stream, out.open("wb") as target:
        reader, writer = make_reader(stream), Writer(target, **{"enable_data_crcs": True, **how})
        writer.start(profile="ros2", library=library)
        summary = reader.get_summary()
        kept = [channel for channel in summary.channels.values() if channel.topic != without]
        schemas = {k: writer.register_schema(s.name, s.encoding, s.data) for k, s in summary.schemas.items()}
        numbers = {
            c.id: writer.register_channel(c.topic, encoding, schemas[c.schema_id], c.metadata)
            for c in (reversed(kept) if backwards else kept)
        }
        for record in () if bare else reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        attached = [] if bare else [*reader.iter_attachments()]
        for record in () if last else attached:
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        for _, channel, m in reader.iter_messages(log_time_order=False):
            seen[channel.topic] += 1
            if channel.topic in TICKED and (seen[channel.topic] - 1) % thinned:
                continue
            moment = m.log_time / 1e9
            if channel.id in numbers and only[0] <= moment <= only[1] and not hole[0] < moment < hole[1]:
                time, data = m.log_time + shifted * 10**9, edit(m.data) if channel.topic == "/joint_states" else m.data
                writer.add_message(numbers[channel.id], time, data, time, m.sequence)
        for record in attached if last else ():
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        writer.finish()
    return out


@pytest.fixture(scope="module")
def completed_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a completed run, with its plan."""
    out = tmp_path_factory.mktemp("run") / "run.mcap"
    run_plan(make_plan(load_itinerary("outer-turn")), out)
    return out


def foreign(out: Path, channels: Channels) -> Path:
    """Write a log that owes nothing to this program."""
    with out.open("wb") as target:
        writer = Writer(target)
        writer.start(library="another program")
        for topic, encoding, name, language, text, message in channels:
            number = writer.register_channel(topic, encoding, writer.register_schema(name, language, text))
            for k in range(5):
                writer.add_message(number, k * 10**6, message, k * 10**6, k)
        writer.finish()
    return out


def refused(log: Path, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a log to every verb: each must say the same, in one sentence, and write nothing."""
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    for verb, *options in VERBS:
        ended = dpcontrol(verb, log, *options)
        assert ended.code == 2, (verb, ended.stderr)
        assert said in ended.message, (verb, ended.message)
        assert ended.stderr.count("\n") == 1
        assert ".partial" not in ended.message
        assert "damaged (" not in ended.message
    assert sorted(folder.iterdir()) == before


def same_run(log: RunLog, first: RunLog, *, each: int = 1) -> None:
    """Check that a log holds each n-th tick of the first, to the last bit."""
    assert np.array_equal(log.time, first.time[::each])
    assert np.array_equal(log.measured, first.measured[::each])
    for part in log.states:
        assert np.array_equal(log.states[part], first.states[part][::each])
    for name in log.controls:
        assert np.array_equal(log.controls[name], first.controls[name][::each], equal_nan=True)


@pytest.mark.parametrize(
    "how",
    [
        {"backwards": True},
        {"enable_data_crcs": False},
        {"enable_data_crcs": False, "enable_crcs": False, "library": "dpcontrol 0.2.0"},
        {"backwards": True, "use_chunking": False},
        {"backwards": True, "compression": CompressionType.LZ4},
        {"backwards": True, "compression": CompressionType.NONE, "chunk_size": 2000},
        {"shifted": 1_700_000_000},
    ],
)
def test_a_log_that_was_written_again_otherwise_holds_the_same_run(tmp_path: Path, how: dict[str, Any]) -> None:
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    with pytest.warns(Remark, match=r"was rewritten by .* its integrity cannot be checked$"):
        log = read_log(rewritten(tmp_path / "run.mcap", tmp_path / "other.mcap", **how))
    same_run(log, first)
    assert log.parts == first.parts
    assert (log.events, log.attachments, log.limits) == (first.events, first.attachments, first.limits)
    assert (log.arm_lengths, log.metadata) == (first.arm_lengths, first.metadata)
    assert log.extras is not None
    assert first.extras is not None
    assert np.array_equal(log.extras.values, first.extras.values)


def test_a_thinned_log_is_read_at_the_rate_that_is_left(tmp_path: Path) -> None:
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(tmp_path / "run.mcap", tmp_path / "thin.mcap", thinned=5))
    same_run(log, first, each=5)
    assert log.rate_hz == pytest.approx(first.rate_hz / 5)


@pytest.mark.parametrize(
    ("topic", "part"),
    [
        ("/tf", ""),
        ("/rosout", ""),
        ("/robot_description", ""),
        ("/control", "control"),
        ("/truth/joint_states", "truth"),
        ("/estimate/joint_states", "estimate"),
        ("/reference/joint_states", "reference"),
        ("/estimate/extras", ""),
    ],
)
def test_a_log_without_a_topic_is_read_and_the_topic_is_named(tmp_path: Path, topic: str, part: str) -> None:
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    log_file = rewritten(tmp_path / "run.mcap", tmp_path / "other.mcap", without=topic)
    with pytest.warns(Remark) as made:
        log = read_log(log_file)
    same_run(log, first)
    assert log.parts == first.parts - {part}
    assert f"and it lacks {topic}" in str(made[0].message)


@pytest.mark.parametrize(("arms", "has_cart"), [(2, True), (3, False)])
def test_a_converted_log_without_metadata_is_read_by_schema_and_description(
    tmp_path: Path, arms: int, has_cart: bool
) -> None:
    """As rosbag2 converts: topics and messages stay, metadata and attachments do not."""
    first = read_log(write_sample(tmp_path / "run.mcap", sample(arms=arms, has_cart=has_cart)))
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(tmp_path / "run.mcap", tmp_path / "bag.mcap", bare=True, backwards=True))
    same_run(log, first)
    assert log.parts == first.parts
    assert log.arm_lengths == pytest.approx(first.arm_lengths, rel=SIX_DIGITS)
    assert log.rate_hz == pytest.approx(first.rate_hz)
    assert not log.attachments


@pytest.mark.parametrize("topic", ["/control", "/reference/joint_states", "/estimate/joint_states"])
def test_a_run_without_a_topic_is_reviewed_and_the_topic_is_named(
    tmp_path: Path, completed_run: Path, topic: str
) -> None:
    """Attachments at the end of the file look like an archive of NumPy to readers of archives."""
    log_file = rewritten(completed_run, tmp_path / "other.mcap", without=topic, last=True)
    with pytest.warns(Remark, match=f"it lacks {topic}"):
        view = opened([log_file])
    if topic == "/estimate/joint_states":
        assert view.verdict.startswith("completed: 1 of 1")
        return
    assert view.verdict.endswith(f"; the log has no {topic}, so the motion is not judged")
    with (
        pytest.warns(Remark, match="integrity cannot be checked"),
        pytest.raises(
            InputError, match=f"has no {topic}: it is a recording, or another program has left the topic out"
        ),
    ):
        score(read_log(log_file))


def test_a_log_without_messages_names_the_missing_topics(
    tmp_path: Path, completed_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rewritten(completed_run, tmp_path / "other.mcap", only=(1e3, 2e3), last=True)
    refused(log, "lacks /joint_states, /estimate/joint_states", tmp_path, monkeypatch)


def test_a_log_without_metadata_is_never_called_foreign(tmp_path: Path, completed_run: Path) -> None:
    whole = rewritten(completed_run, tmp_path / "whole.mcap", bare=True)
    with pytest.warns(Remark, match="integrity cannot be checked"):
        topics = {topic.topic: topic.count for topic in summarise(whole).topics}
    assert topics == {topic.topic: topic.count for topic in summarise(completed_run).topics}
    assert "another program has left out its attachments" in dpcontrol("score", whole).message
    # The description of the arms is at the start, so that it is cut off.
    said = dpcontrol("score", rewritten(completed_run, tmp_path / "cut.mcap", bare=True, only=(1.0, 3.0))).message
    assert "lacks the metadata record dpcontrol.layout, as after cutting a log in time" in said
    assert "not a log of" not in said


@pytest.mark.parametrize("bare_end", [False, True])
@pytest.mark.parametrize("only", [(0.0, 2.4), (2.4, 10.0), (1.0, 2.0)])
def test_the_completion_of_a_run_is_unknown_from_a_part_of_its_log(
    tmp_path: Path, completed_run: Path, only: tuple[float, float], bare_end: bool
) -> None:
    how = {"without": "/rosout"} if bare_end else {}
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(completed_run, tmp_path / "part.mcap", only=only, **how))
    first, last, end = only[0], min(only[1], 4.876), 4.876
    found = score(log)
    assert found.completed is None
    assert found.reason == (
        f"the log covers only {first:.3f} to {last:.3f} s of the run's {end:.3f} s, so completion cannot be judged"
    )
    assert run_view(log).good is None
    with pytest.raises(InputError, match="so completion cannot be judged; give the log as"):
        Run(log).why()


def test_times_that_are_not_those_of_the_run_are_named(tmp_path: Path, completed_run: Path) -> None:
    """No stamp keeps the time of the run here."""
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(completed_run, tmp_path / "whole.mcap", without="/rosout"))
    assert score(replace(log, time=log.time + 1.7e9)).reason == (
        "the log's times, 1700000000.000 to 1700000004.876 s, are not those of the run, which lasted 4.876 s, so "
        "completion cannot be judged"
    )


@pytest.mark.parametrize("how", [{"only": (0.0, 2.4)}, {"only": (1.0, 10.0)}, {"hole": (2.0, 3.0)}])
def test_the_score_of_a_log_with_a_part_missing_ends_with_1(
    tmp_path: Path, completed_run: Path, how: dict[str, Any]
) -> None:
    log = rewritten(completed_run, tmp_path / "part.mcap", **how)
    ended = dpcontrol("score", log, completed_run)
    assert ended.code == 1
    assert "completion unknown: " in ended.stdout
    assert "1 of 2 not known to be completed; " in ended.message
    assert ended.message.endswith("so completion cannot be judged")


@pytest.mark.parametrize(
    "how", [{}, {"thinned": 3}, {"without": "/rosout"}, {"shifted": 1_700_000_000, "without": "/rosout"}]
)
def test_the_verdict_on_a_whole_run_survives_rewriting(
    tmp_path: Path, completed_run: Path, how: dict[str, Any]
) -> None:
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(completed_run, tmp_path / "whole.mcap", backwards=True, **how))
    assert score(log).completed


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"edit": lambda data: data[:60]}, "its message of /joint_states at 0.000 s does not decode (it ends after 60"),
        ({"edit": lambda data: data[:60], "without": "/tf"}, "its message of /joint_states at 0.000 s does not decode"),
        ({"edit": lambda data: bytes(len(data))}, "the joints of /joint_states are none, for 2 arms"),
        ({"edit": lambda data: data[:-8] + b"\xff" * 8}, "its message of /joint_states at 0.000 s does not decode"),
        ({"only": (0.0, 0.0005)}, "it has 1 tick, times with a message in every state topic, and two are needed"),
    ],
)
@pytest.mark.parametrize("library", ["another program", "dpcontrol 0.2.0"])
def test_messages_that_do_not_decode_are_not_blamed_on_their_channels(
    tmp_path: Path, how: dict[str, Any], said: str, library: str
) -> None:
    """Whole logs with these channels are read."""
    source = write_sample(tmp_path / "run.mcap", sample())
    log = rewritten(source, tmp_path / "other.mcap", backwards=True, library=library, **how)
    for read in (read_log, summarise):
        with pytest.raises(InputError) as refused:
            read(log)
        assert said in str(refused.value)
        assert "renumbered" not in str(refused.value)


@pytest.mark.parametrize("how", [{"library": "dpcontrol 0.2.0"}, {"shifted": 1_700_000_000, "hole": (2.0, 3.0)}])
def test_a_run_is_repeated_from_a_rewritten_log_and_compared_by_its_topics(
    tmp_path: Path, completed_run: Path, how: dict[str, Any]
) -> None:
    log = rewritten(completed_run, tmp_path / "other.mcap", backwards=True, without="/tf", **how)
    with log.open("rb") as stream:
        count = make_reader(stream).get_summary().statistics.message_count
    ended = dpcontrol("run", "--from", log, "--out", tmp_path / "again.mcap", "--json")
    assert ended.code == 0, ended.stderr
    assert ended.document["repeated"] == {"of": str(log), "identical_messages": count, "difference": None}


def test_a_repetition_names_the_first_message_that_another_program_changed(tmp_path: Path, completed_run: Path) -> None:
    def nudged(data: bytes) -> bytes:
        # The second arm's angle, before that of the cart and two empty lists.
        return data[:-17] + bytes([data[-17] ^ 1]) + data[-16:]

    log = rewritten(completed_run, tmp_path / "other.mcap", backwards=True, edit=nudged)
    ended = dpcontrol("run", "--from", log, "--out", tmp_path / "again.mcap")
    assert ended.code == 1
    assert "not the same run: the message of /joint_states at 0.000 s differs" in ended.message


def test_a_run_that_ended_early_has_failed_in_a_rewritten_log_too(tmp_path: Path, completed_run: Path) -> None:
    """The event of its ending is that of the early end, beyond which nothing was cut."""
    with pytest.warns(Remark, match="integrity cannot be checked"):
        log = read_log(rewritten(completed_run, tmp_path / "part.mcap", only=(0.0, 2.4)))
    event = log.events[0]._replace(time=2.4, level="error", name="tracking lost", text="the arm fell")
    found = score(replace(log, events=(*log.events, event), end_s=2.4))
    assert found.completed is False
    assert "the run ended 2.48 s early: the arm fell" in found.reason


def test_two_runs_in_one_file_are_detected_and_rejected(tmp_path: Path) -> None:
    for seed in (1, 2):
        write_sample(tmp_path / f"{seed}.mcap", sample(seed=seed))
    with (tmp_path / "merged.mcap").open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        for seed in (1, 2):
            with (tmp_path / f"{seed}.mcap").open("rb") as stream:
                numbers: dict[int, int] = {}
                for schema, channel, m in make_reader(stream).iter_messages():
                    if channel.id not in numbers:
                        number = writer.register_schema(schema.name, schema.encoding, schema.data)
                        numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number)
                    writer.add_message(numbers[channel.id], m.log_time, m.data, m.publish_time)
        writer.finish()
    with pytest.raises(InputError, match="/joint_states has different messages at one time, as of two runs"):
        read_log(tmp_path / "merged.mcap")


@pytest.mark.parametrize("how", [{}, {"backwards": True}, {"bare": True, "compression": CompressionType.LZ4}])
def test_damage_of_a_rewritten_log_has_a_remedy_that_helps(tmp_path: Path, how: dict[str, Any]) -> None:
    """`recover` rebuilds only what this program wrote, so no sentence recommends it."""
    data = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", **how).read_bytes()
    flipped = bytearray(data)
    flipped[len(data) // 3] ^= 4
    for damaged in (data[: len(data) * 2 // 3], bytes(flipped)):
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        for verb in ("score", "recover"):
            ended = dpcontrol(verb, tmp_path / "damaged.mcap")
            assert ended.code == 2
            assert "write it again with the program that wrote it (another program)" in ended.message
            assert "`dpcontrol recover" not in ended.message


@pytest.mark.parametrize("how", [{"backwards": True}, {"bare": True}])
def test_recovery_of_an_undamaged_rewritten_log_reports_that_it_needs_none(tmp_path: Path, how: dict[str, Any]) -> None:
    log = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", **how)
    ended = dpcontrol("recover", log, "--json")
    assert ended.code == 0
    done = json.loads(ended.stdout)
    assert (done["log"], done["ticks"], done["lost"]) == (str(log), len(read_log(log).time), "")


def test_the_verbs_read_a_log_that_was_written_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", backwards=True)
    ended = dpcontrol("info", log)
    assert ended.code == 0
    assert "integrity not checked" in ended.stdout
    assert ended.stderr.count("cannot be checked") == 1
    first, second = (dpcontrol("info", path, "--json").document for path in (tmp_path / "run.mcap", log))
    assert {**second, "log": first["log"], "size": first["size"], "rewritten": False} == first


def test_a_log_without_measurements_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_sample(tmp_path / "run.mcap", sample())
    log = rewritten(run, tmp_path / "other.mcap", without="/joint_states")
    refused(log, "lacks /joint_states, listed in its description", tmp_path, monkeypatch)


def test_a_log_in_another_encoding_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", encoding="json")
    refused(log, f"topic /joint_states holds {JOINTS} in json, not {JOINTS} in cdr", tmp_path, monkeypatch)


def test_a_log_that_was_rewritten_in_the_same_order_reads_as_before(tmp_path: Path) -> None:
    log = write_sample(tmp_path / "run.mcap", sample())
    again = rewritten(log, tmp_path / "other.mcap")
    first, second = (dpcontrol("info", path, "--json").document for path in (log, again))
    assert first["topics"] == second["topics"]
    assert first["metadata"] == second["metadata"]


NO_JOINTS = "lacks the metadata record dpcontrol.layout and the topic /joint_states (sensor_msgs/msg/JointState in cdr)"
OTHER = {
    "json": (
        [("/joint_states", "json", "JointState", "jsonschema", b'{"type":"object"}', b'{"position":[1,2]}')],
        f"/joint_states holds JointState in json, not {JOINTS} in cdr",
    ),
    "protobuf": (
        [("/pose", "protobuf", "foxglove.PoseInFrame", "protobuf", b"\n\x03abc", b"\x08\x01")],
        f"{NO_JOINTS}; it has /pose",
    ),
    "other fields": (
        [("/joint_states", "cdr", JOINTS, "ros2msg", b"float64 x\n", b"\x00\x01\x00\x00" + bytes(8))],
        f"/joint_states holds messages of that name with other fields, not {JOINTS} in cdr",
    ),
    "other message": (
        [("/joint_states", "cdr", "std_msgs/msg/String", "ros2msg", b"string data\n", bytes(layout.string("x")))],
        f"/joint_states holds std_msgs/msg/String in cdr, not {JOINTS} in cdr",
    ),
    "nothing": ([], f"{NO_JOINTS}; it has no topics"),
}


@pytest.mark.parametrize("kind", OTHER)
def test_missing_parts_of_a_log_of_another_tool_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    channels, missing = OTHER[kind]
    log = foreign(tmp_path / "other.mcap", channels)
    refused(log, "lacks the metadata record dpcontrol.layout", tmp_path, monkeypatch)
    said = dpcontrol("info", log).message
    assert "(written by another program) is not a log of `dpcontrol run`" in said
    assert missing in said
    assert "or import a bench recording with `dpcontrol import`" in said


@pytest.mark.parametrize("compressed", [(), ("--compress", "zstd", "--compress-mode", "storage")], ids=str)
def test_a_log_that_rosbags_converts_is_read_with_a_remark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compressed: tuple[str, ...]
) -> None:
    """The converter itself, which drops metadata and attachments."""
    pytest.importorskip("rosbags")
    monkeypatch.chdir(tmp_path)
    first = read_log(write_sample(tmp_path / "run.mcap", sample()))
    convert = [sys.executable, "-m", "rosbags.convert"]
    command = [*convert, "--src", "run.mcap", "--dst", "converted", "--dst-storage", "mcap", *compressed]
    subprocess.run(command, check=True, capture_output=True)
    log = tmp_path / "converted" / "converted.mcap"
    with pytest.warns(Remark, match="rewritten by rosbags.*integrity cannot be checked"):
        same_run(read_log(log), first)
    ended = dpcontrol("info", log)
    assert ended.code == 0
    assert "integrity not checked" in ended.stdout
    scored = dpcontrol("score", log)
    assert scored.code == 2
    assert "carries no reference.npz" in scored.message
