"""Files that are either whole or absent: written under a temporary name, then renamed."""

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dpcontrol.foundation.errors import InputError


def checked_target(path: Path) -> None:
    """Refuse to write where a rename would take the place of what is no file.

    Raises:
        InputError: `path` is a folder, a device or the like.
    """
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "no file but a device or the like"
        raise InputError(f"cannot write {path}: it is {what}; choose another file name")


def checked_other_file(out: Path, source: Path | str, *, what: str) -> None:
    """Refuse to write over what is being read.

    Raises:
        InputError: `out` is the file `source`, by whatever name; what: what that file is, as in "the log to repeat".
    """
    if out.resolve() == Path(source).resolve() or (out.exists() and out.samefile(source)):
        raise InputError(f"--out {out}: that is {what}; choose another name")


@contextmanager
def whole_file(path: Path, *, suffix: str = "") -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends without an error.

    The temporary name keeps `suffix` at its end, for writers that choose a format by it. Nothing is left
    behind when the block raises.

    Raises:
        InputError: the folder cannot be made or written to, or `path` is a folder or a device.
    """
    path = Path(path)
    checked_target(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=suffix or ".partial", dir=path.parent)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; choose another file or folder") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; choose another file or folder") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write `content` to `path` so that a reader sees either the old file or the whole new one."""
    data = content.encode() if isinstance(content, str) else content
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


def content_hash(*parts: str | bytes) -> str:
    """Return 16 hexadecimal digits that identify `parts` in order."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:16]
