"""Files that never end, are none, or unpack to more than they say: each refused in one sentence, before it is read."""

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import dpcontrol
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, DataEnd, Footer, Header

from dpcontrol.logs.container import MAGIC


def array(values: object) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array(values))
    return stream.getvalue()


HEADER = array(json.dumps({"format": "dpcontrol-reference", "version": 1}))


def packed(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def refused(path: Path, said: str) -> None:
    for call in (("reference", path), ("review", path, "--picture", path.with_suffix(".png"))):
        ended = dpcontrol(*call)
        assert ended.code == 2
        assert said in ended.message
        assert len(ended.message) < 500


def test_an_archive_that_unpacks_to_gigabytes_is_rejected_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    packed(path, {"header.npy": HEADER, "states.npy": bytes(1000)})
    data = bytearray(path.read_bytes())
    # The unpacked size in the last entry of the zip's directory.
    struct.pack_into("<I", data, data.rindex(b"PK\x01\x02") + 24, 3_000_000_000)
    path.write_bytes(data)
    refused(path, "it would unpack to 3 GB")


def test_a_chunk_of_a_log_that_claims_gigabytes_is_rejected(tmp_path: Path) -> None:
    records = RecordBuilder()
    chunk = Chunk(
        compression="zstd", data=b"", message_end_time=0, message_start_time=0, uncompressed_crc=0,
        uncompressed_size=10**12,
    )  # fmt: skip
    for record in (Header(profile="", library=""), chunk, DataEnd(0), Footer(0, 0, 0)):
        record.write(records)
    (tmp_path / "run.mcap").write_bytes(MAGIC + records.end() + MAGIC)
    ended = dpcontrol("info", tmp_path / "run.mcap")
    assert ended.code == 2
    assert "would unpack to 1e+03 GB" in ended.message


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_a_matlab_file_that_claims_gigabytes_is_rejected(tmp_path: Path, version: str) -> None:
    path = tmp_path / "swing.mat"
    if version == "5":
        data = zlib.compress(struct.pack("<II", 14, 3_000_000_000))
        path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(data)) + data)
    else:
        with h5py.File(path, "w") as file:
            file.create_dataset("angles", shape=(10**10,), dtype="f8", chunks=True)
    ended = dpcontrol("import", path)
    assert ended.code == 2
    assert "would unpack to" in ended.message
