"""Logs that other tools wrote, or wrote again: one sentence on what is missing, by every verb that reads logs."""

from pathlib import Path

import pytest
from command_line import dpcontrol
from log_samples import sample, write_sample
from mcap.reader import make_reader
from mcap.writer import Writer

from dpcontrol.logs import layout

VERBS = (
    ("score",), ("info",), ("report",), ("review", "--save", "shown.rrd"), ("replay", "--model", "lab"), ("recover",)
)  # fmt: skip
Channels = list[tuple[str, str, str, str, bytes, bytes]]
"""Of each: topic, encoding, schema's name, encoding and text, and a message."""
JOINTS = "sensor_msgs/msg/JointState"


def rewritten(source: Path, out: Path, *, without: str = "", backwards: bool = False, encoding: str = "cdr") -> Path:
    """Write a log again by Python's mcap package, with all of its checksums."""
    with source.open("rb") as stream, out.open("wb") as target:
        reader, writer = make_reader(stream), Writer(target, enable_data_crcs=True)
        writer.start(profile="ros2", library="another program")
        summary = reader.get_summary()
        kept = [channel for channel in summary.channels.values() if channel.topic != without]
        schemas = {k: writer.register_schema(s.name, s.encoding, s.data) for k, s in summary.schemas.items()}
        numbers = {
            c.id: writer.register_channel(c.topic, encoding, schemas[c.schema_id], c.metadata)
            for c in (reversed(kept) if backwards else kept)
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for record in reader.iter_attachments():
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        for _, channel, m in reader.iter_messages(log_time_order=False):
            if channel.id in numbers:
                writer.add_message(numbers[channel.id], m.log_time, m.data, m.publish_time, m.sequence)
        writer.finish()
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
        wanted = "cannot be recovered" if verb == "recover" and "dpcontrol.layout" in said else said
        assert wanted in ended.message, (verb, ended.message)
        assert ended.stderr.count("\n") == 1
        assert ".partial" not in ended.message
        assert "damaged (" not in ended.message
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    "topic", ["/joint_states", "/truth/joint_states", "/control", "/rosout", "/tf", "/robot_description"]
)
def test_a_log_from_which_a_topic_was_taken_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topic: str
) -> None:
    log = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", without=topic)
    refused(log, f"lacks {topic}, which its own description names", tmp_path, monkeypatch)


def test_a_log_whose_channels_were_renumbered_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = rewritten(write_sample(tmp_path / "run.mcap", sample()), tmp_path / "other.mcap", backwards=True)
    said = "numbered the channels anew (/joint_states is channel 10 instead of 1); give the log as `dpcontrol run`"
    refused(log, said, tmp_path, monkeypatch)


def test_a_log_that_was_rewritten_in_another_encoding_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_a_log_of_another_tool_gets_a_sentence_on_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    channels, missing = OTHER[kind]
    log = foreign(tmp_path / "other.mcap", channels)
    refused(log, "lacks the metadata record dpcontrol.layout", tmp_path, monkeypatch)
    said = dpcontrol("info", log).message
    assert "(written by another program) is not a log of `dpcontrol run`" in said
    assert missing in said
    assert "or bring a recording of the bench in by `dpcontrol import`" in said
