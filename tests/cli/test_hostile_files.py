"""Files that never end, are none, or unpack to more than they say: each refused in one sentence, before it is read."""

import io
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from command_line import dpcontrol

from dpcontrol.foundation import files
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs.container import CHUNK_HEAD, ZSTD
from dpcontrol.logs.reader import unpacked
from dpcontrol.recordings import importing

READERS = (
    ("score",), ("info",), ("recover",), ("replay",), ("review",), ("report",), ("identify",), ("run", "--from"),
    ("reference",), ("plan",), ("model",),
)  # fmt: skip


@pytest.fixture(params=["device", "pipe", "folder", "link"])
def no_file(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """Return something that is no file, and what to say about it."""
    path = tmp_path / "thing"
    if request.param == "device":
        return Path("/dev/zero"), "it is a device"
    if request.param == "pipe":
        os.mkfifo(path)
    elif request.param == "folder":
        path.mkdir()
    else:
        path.symlink_to(path)
    return path, "it is a link that leads to itself" if request.param == "link" else f"it is a {request.param}"


def test_every_verb_rejects_a_path_that_is_not_a_file(no_file: tuple[Path, str]) -> None:
    path, said = no_file
    for verb in READERS:
        ended = dpcontrol(*verb, path)
        assert ended.code == 2, verb
        # click refuses a folder as --from itself.
        assert said in ended.message or "is a directory" in ended.message, (verb, ended.message)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_a_pipe_or_a_link_to_itself_is_rejected_as_a_recording(tmp_path: Path, suffix: str) -> None:
    pipe, link = tmp_path / f"pipe{suffix}", tmp_path / f"link{suffix}"
    os.mkfifo(pipe)
    link.symlink_to(link)
    assert "it is a pipe" in dpcontrol("import", pipe).message
    assert "it is a link that leads to itself" in dpcontrol("import", link).message


def array_bytes(values: object) -> bytes:
    """Return the bytes of a .npy file."""
    stream = io.BytesIO()
    np.save(stream, np.array(values))
    return stream.getvalue()


HEADER = array_bytes(json.dumps({"format": "dpcontrol-reference", "version": 1}))


def lying() -> dict[str, bytes]:
    """Return an array whose header declares more values than there are."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**11,)})
    return {"header.npy": HEADER, "states.npy": stream.getvalue() + bytes(800)}


def nested() -> dict[str, bytes]:
    """Return notes that nest a hundred thousand deep."""
    return {"header.npy": array_bytes("[" * 100_000)}


def nested_description() -> dict[str, bytes]:
    """Return an array whose own header nests thousands deep."""
    return {"header.npy": b"\x93NUMPY\x01\x00" + struct.pack("<H", 20_000) + b"(" * 20_000}


@pytest.mark.parametrize("members", [lying(), nested(), nested_description()], ids=["lying", "nested", "described"])
def test_an_archive_with_a_false_or_nested_header_is_rejected(tmp_path: Path, members: dict[str, bytes]) -> None:
    path = tmp_path / "plan.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(name, content)
    for call in (("reference", path), ("review", path, "--picture", tmp_path / "plan.png")):
        ended = dpcontrol(*call)
        assert ended.code == 2
        assert "is damaged" in ended.message
        # As NumPy's own words would have it.
        assert "trust" not in ended.message


def test_an_archive_that_unpacks_to_gigabytes_is_rejected_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("header.npy", HEADER)
        packed.writestr("states.npy", bytes(1000))
    data = bytearray(path.read_bytes())
    # The unpacked size in the last entry of the zip's directory.
    struct.pack_into("<I", data, data.rindex(b"PK\x01\x02") + 24, 3_000_000_000)
    path.write_bytes(data)
    for call in (("reference", path), ("review", path, "--picture", tmp_path / "plan.png")):
        ended = dpcontrol(*call)
        assert ended.code == 2
        assert "it would unpack to 3 GB, and 0.54 GB are allowed" in ended.message


def test_a_chunk_of_a_log_that_claims_gigabytes_is_rejected() -> None:
    chunk = CHUNK_HEAD.pack(0, 0, 10**12, 0, ZSTD, 0)
    with pytest.raises(ValueError, match=r"would unpack to 1e\+03 GB"):
        unpacked(memoryview(chunk), zstandard.ZstdDecompressor())


def test_a_matlab_file_whose_packed_variable_claims_gigabytes_is_rejected(tmp_path: Path) -> None:
    packed = zlib.compress(struct.pack("<II", 14, 3_000_000_000))
    path = tmp_path / "swing.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(InputError, match=r"swing\.mat.*would unpack to 3 GB"):
        importing.read_matlab(path)


def test_a_matlab_file_of_version_73_that_claims_gigabytes_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "swing.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("angles", shape=(10**10,), dtype="f8", chunks=True)
    with pytest.raises(InputError, match=r"swing\.mat.*would unpack to 80 GB"):
        importing.read_matlab(path)


def test_a_parquet_table_is_rejected_by_the_rows_that_it_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "swing.parquet"
    pq.write_table(pa.table({"t": np.zeros(1000)}), path)
    monkeypatch.setattr(importing, "checked_size", lambda size: files.checked_size(size, most=1000))
    with pytest.raises(InputError, match=r"swing\.parquet.*would unpack to"):
        importing.read_table(path, ["t"])
