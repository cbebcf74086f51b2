"""Files of arrays with a JSON header (NumPy's .npz): written whole, and read so that damage is reported in a sentence.

Format: NumPy Enhancement Proposal 1, a zip archive of .npy files; `header` is a string of JSON among them.
"""

import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file


def write_archive(
    path: Path | str, header: Mapping[str, Any], arrays: Mapping[str, Any], *, compressed: bool = False
) -> None:
    """Write a header, plain JSON with its `format` and `version`, and arrays to `path`, whole or not at all.

    Raises:
        InputError: the file cannot be written, or the header is not plain JSON.
    """
    try:
        text = json.dumps(header, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot write {path}: its notes are not plain JSON ({error})") from error
    with whole_file(Path(path), suffix=".npz") as temporary:
        (np.savez_compressed if compressed else np.savez)(temporary, header=np.array(text), **arrays)


def archive_format(path: Path | str) -> str:
    """Return the format that a file's header names, "" where it is no such file or cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return str(json.loads(str(file["header"]))["format"])
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return ""


def is_archive(path: Path | str) -> bool:
    """Tell by its first bytes whether a file is such an archive, whole or damaged."""
    try:
        with Path(path).open("rb") as file:
            return file.read(4) == b"PK\x03\x04"
    except OSError:
        return False


@contextmanager
def archive(
    path: Path | IO[bytes], *, what: str, make: str, again: str, format: str, versions: tuple[int, ...]
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield the header and the arrays of `path`, a path or an open binary file; what the block trips over is damage.

    what: the archive's kind with its article; make: how one is made; again: the same of a damaged one. format,
    versions: those that the caller reads.

    Raises:
        InputError: there is no such file, or it is damaged or of another kind; says which.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(str(arrays.pop("header")))
        if header["format"] != format:
            raise ValueError(f"its format is {header['format']!r}")
        if header["version"] not in versions:
            known = " and ".join(map(str, versions))
            raise ValueError(f"its version is {header['version']!r}, this program reads {known}")
        yield header, arrays
    except FileNotFoundError as error:
        raise InputError(f"there is no {what.partition(' ')[2]} {path}; {make}") from error
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        EOFError,
        IndexError,
        InputError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        # What is no archive at all numpy takes for pickled data, and advises to trust it.
        reason = "it is no .npz file" if "pickle" in reason else reason
        raise InputError(f"{path} is not {what} of dpcontrol, or is damaged: {reason}; {again}") from error
