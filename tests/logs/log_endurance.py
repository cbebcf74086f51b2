"""Read and recover damaged logs, and compare the results with the written data."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Recovery, RunLog, read_log, recover

Result = TypeVar("Result")


def rows_of(log: RunLog) -> np.ndarray:
    """Return all numbers of each tick as one row of bits."""
    columns = [log.time[:, None], log.measured, *(log.states[part] for part in sorted(log.states))]
    columns += [values[:, None] for _, values in sorted(log.controls.items())]
    return np.column_stack(columns).view(np.int64)


def is_part_of(found: RunLog, log: RunLog) -> None:
    """Assert that all that was recovered is in the log, at its place."""
    assert found.parts == log.parts
    places = np.searchsorted(log.time, found.time)
    assert (np.diff(places) > 0).all()
    np.testing.assert_array_equal(rows_of(found), rows_of(log)[places])
    if found.extras is not None:
        assert log.extras is not None
        assert found.extras.names == log.extras.names
        places = np.searchsorted(log.extras.time, found.extras.time)
        for part in ("time", "values", "sigmas"):
            np.testing.assert_array_equal(getattr(found.extras, part), getattr(log.extras, part)[places])
    assert [e for e in log.events if e in found.events] == list(found.events)
    assert found.attachments.items() <= log.attachments.items()
    assert found.metadata.items() <= log.metadata.items()


def is_same(found: RunLog, log: RunLog) -> None:
    is_part_of(found, log)
    is_part_of(log, found)
    for field in fields(RunLog):
        if field.name not in ("path", "states", "controls", "time", "measured", "rates", "extras"):
            assert getattr(found, field.name) == getattr(log, field.name)


def is_honest(done: Recovery, found: RunLog, log: RunLog) -> None:
    """Assert that a recovery reports exactly the missing data."""
    assert done.ticks == len(found.time)
    assert (found.recovered or "") == done.lost
    if done.end_known:
        assert done.ticks + done.ticks_lost == len(log.time)
    assert set(done.attachments) | set(done.attachments_lost) == set(log.attachments)
    if not done.lost:
        is_same(found, log)


def endure(whole: RunLog, folder: Path, data: bytes) -> str:
    """Read and recover a damaged copy of a log; return how it ended."""
    bad, out = folder / "bad.mcap", folder / "out.mcap"
    bad.write_bytes(data)
    out.unlink(missing_ok=True)
    as_read = tried(read_log, bad)
    if as_read is not None:
        is_same(as_read, whole)
        return "harmless"
    done = tried(lambda path: recover(path, out), bad)
    if done is None:
        assert not out.exists()
        return "refused"
    found = read_log(out)
    is_part_of(found, whole)
    is_honest(done, found, whole)
    return "partly" if done.lost else "wholly"


def tried(function: Callable[[Path], Result], path: Path) -> Result | None:
    """Return a function's result for a file, or None if it refuses the file by name."""
    try:
        return function(path)
    except InputError as error:
        if str(path) not in str(error) or "\n" in str(error):
            raise AssertionError(f"no sentence on {path}: {error}") from error
        return None
