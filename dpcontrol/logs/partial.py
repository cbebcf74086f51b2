"""Where a log is while it grows: `NAME.mcap.partial`, beside the log that it will become.

A run that was killed leaves its partial file. It is never overwritten nor removed: a later run of the same log grows
under another name beside it, and `dpcontrol recover` makes a log of what the killed one left.

Metadata records carry a checksum of their own.

MCAP gives a checksum to chunks and attachments, but metadata is covered by that of the whole data section only: in a
file that is cut or damaged nothing would vouch for it. So each record carries the CRC-32 of its own name and values.
"""

import json
import os
import zlib
from collections.abc import Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path

SUFFIX = ".partial"


def open_partial(path: Path) -> tuple[Path, FileIO]:
    """Create the file in which the log `path` grows, unbuffered; its name and the open file.

    Raises:
        OSError: it cannot be created.
    """
    names = [path.with_name(path.name + SUFFIX)]
    names += [path.with_name(f"{path.name}.{os.getpid()}-{k}{SUFFIX}") for k in range(1, 100)]
    for name in names[:-1]:
        with suppress(FileExistsError):
            return name, FileIO(name, "xb")
    return names[-1], FileIO(names[-1], "wb")


def partials_of(path: Path) -> tuple[Path, ...]:
    """Return the partial files that runs of the log `path` have left or are writing, oldest first."""
    with suppress(OSError):
        names = [file for file in path.parent.iterdir() if file.suffix == SUFFIX and file.name.startswith(path.name)]
        return tuple(sorted(names, key=lambda file: file.stat().st_mtime))
    return ()


def moved_away(path: Path, stream: FileIO) -> bool:
    """Tell whether `path` is no longer the file that is open as `stream`."""
    try:
        found, own = os.stat(path), os.fstat(stream.fileno())
    except OSError:
        return True
    return (found.st_ino, found.st_dev) != (own.st_ino, own.st_dev)


def sync_folder(folder: Path) -> None:
    """Have the system put a rename in `folder` on the disk, where it can be asked to."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


_KEY = "crc32"


def sealed(name: str, values: Mapping[str, str]) -> dict[str, str]:
    """Return `values` with the checksum of the record `name`.

    Raises:
        ValueError: a value is called as the checksum is.
    """
    if _KEY in values:
        raise ValueError(f"metadata may not hold the key {_KEY!r}: the log keeps its checksum there")
    return {**values, _KEY: _checksum(name, values)}


def unsealed(name: str, record: Mapping[str, str]) -> dict[str, str] | None:
    """Return the values of a record without its checksum, or None where it has none or another."""
    values = {key: value for key, value in record.items() if key != _KEY}
    return values if record.get(_KEY) == _checksum(name, values) else None


def _checksum(name: str, values: Mapping[str, str]) -> str:
    content = json.dumps([name, dict(sorted(values.items()))])
    return f"{zlib.crc32(content.encode()):08x}"
