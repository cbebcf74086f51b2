"""Metadata records that can tell whether they are what was written.

MCAP gives a checksum to chunks and attachments, but metadata is covered by that of the whole data section only: in a
file that is cut or damaged nothing would vouch for it. So each record carries the CRC-32 of its own name and values.
"""

import json
import zlib
from collections.abc import Mapping

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
