"""What is written is read back, by our reader and by the public ROS 2 decoder."""

from pathlib import Path

import numpy as np
import pytest
from log_samples import ATTACHMENTS, EXTRAS, METADATA, RATE, open_writer, sample, tick_all, write_sample
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Event, LogWriter, read_log

NANOSECOND = 1e-9


STATES = ("estimate", "reference", "truth")
EVENTS = (
    Event(0.0, "info", "loop", words="started"),
    Event(0.1, "warn", "drive", words="command cut at 5 m/s²"),
    Event(0.249, "error", "supervisor", words="ended"),
)


@pytest.mark.parametrize(
    ("arms", "has_cart", "parts"),
    [
        (2, True, (*STATES, "control", "extras")),
        (1, False, ()),
        (2, True, ("rates", "reference", "truth")),
        (3, False, ("estimate", "control")),
    ],
)
def test_a_log_gives_back_its_input_bit_for_bit(
    tmp_path: Path, arms: int, has_cart: bool, parts: tuple[str, ...]
) -> None:
    run = sample(arms=arms, has_cart=has_cart)
    rows = {"measured": run.measured} | {p: run.measured[::-1] if p == "rates" else getattr(run, p) for p in parts}
    with LogWriter(
        tmp_path / "run.mcap", arm_lengths=run.arm_lengths, rate_hz=RATE, has_cart=has_cart, limits=(0.9, 3.0, 30.0),
        extras=EXTRAS if "extras" in parts else (), metadata=METADATA, attachments=ATTACHMENTS,
    ) as writer:  # fmt: skip
        for event in EVENTS:
            writer.event(event)
        writer.ticks(run.time, **rows)
    log = read_log(tmp_path / "run.mcap")
    assert log.parts == set(parts) - {"extras"}
    read = {"measured": log.measured, "rates": log.rates, **log.states}
    read["control"] = np.column_stack([*log.controls.values()] or [[]])
    for part, values in rows.items():
        if part != "extras":
            np.testing.assert_array_equal(read[part], values)
    np.testing.assert_allclose(log.time, run.time, atol=NANOSECOND)
    if log.extras is not None:
        np.testing.assert_array_equal(np.hstack([log.extras.sigmas, log.extras.values]), run.extras[::20])
        np.testing.assert_allclose(log.extras.time, run.time[::20], atol=NANOSECOND)
    assert (log.extras is not None) == ("extras" in parts)
    assert (log.events, log.attachments) == (EVENTS, ATTACHMENTS)
    assert (log.arm_lengths, log.has_cart, log.limits) == (run.arm_lengths, has_cart, (0.9, 3.0, 30.0))
    assert METADATA.items() <= log.metadata.items()
    for part in {"estimate", "reference", "control"} - set(parts):
        with pytest.raises(InputError, match=f"has no /{part}"):
            getattr(log, part)


def test_a_state_that_is_no_number_is_logged_but_not_as_a_transform(tmp_path: Path) -> None:
    run = sample(60)
    assert run.truth is not None
    run.truth[15:45] = np.nan
    with open_writer(tmp_path / "run.mcap", run) as log:
        tick_all(log, run)
    np.testing.assert_array_equal(read_log(tmp_path / "run.mcap").truth, run.truth)
    stamps = [message.log_time_ns for message in read_ros2_messages(str(tmp_path / "run.mcap"), topics=["/tf"])]
    assert stamps == [0]


def test_attachments_and_metadata_precede_the_first_message(tmp_path: Path) -> None:
    path = write_sample(tmp_path / "run.mcap", sample())
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    first = min(index.chunk_start_offset for index in summary.chunk_indexes)
    before = [index.offset for index in summary.metadata_indexes if index.name != "dpcontrol.result"]
    assert max(*before, *(index.offset for index in summary.attachment_indexes)) < first
    assert summary.statistics is not None
    assert summary.statistics.message_count == 5 * 250 + 2 * 13 + 3 + 2
