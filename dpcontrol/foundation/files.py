"""Files that are either whole or absent: they are written under a temporary name, then renamed.

Only regular files are read, because pipes and devices never end. Containers are checked for their unpacked size before
they are opened.

Files of arrays with a JSON header (NumPy's .npz) are written atomically. Damage is reported in one sentence when they
are read. Format: NumPy Enhancement Proposal 1, a zip archive of .npy files; `header` among them is a string of JSON.
"""

import hashlib
import itertools
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from secrets import token_hex
from tokenize import TokenError
from typing import IO, Annotated, Any, TypeVar

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later

np = Later("numpy")
"""Imported on first use, because verbs check their output before they import anything heavy."""
T = TypeVar("T")


class InTheWay(InputError):
    """A file exists that another command made or is writing."""


@dataclass(frozen=True)
class Output:
    """The file or folder that a parameter of a public function names, for its annotation.

    Attributes:
        endings: allowed endings of the name, or () for any.
        free: True if a command line without this option writes to the next free name in the folder of logs, as the
            function does for the argument True.
        folder: True for a folder.
    """

    endings: tuple[str, ...] = ()
    free: bool = False
    folder: bool = False


PICTURE = Output((".png", ".pdf", ".svg"))
"""File of a picture."""
Picture = Annotated[Path | str | None, PICTURE]
Film = Annotated[Path | str | None, Output((".gif", ".webp", ".mp4"))]


def checked_target(path: Path) -> Path:
    """Return the place to write: `path`, or the file that it links to, because a rename would replace the link.

    Args:
        path: file to write, which may be missing.

    Raises:
        InTheWay: `path` is not a regular file.
        InputError: its folder cannot be made or written to.
    """
    place = Path(os.path.realpath(path)) if path.is_symlink() else path
    if os.path.exists(place) and not os.path.isfile(place):
        raise InTheWay(f"cannot write {path}: it is a folder or no regular file; choose another file name")
    checked_folder(place.parent, path)
    return place


def checked_folder(folder: Path, path: Path | None = None) -> None:
    """Reject a folder that cannot be made or written to, without leaving anything in it.

    Args:
        folder: folder, which may be missing.
        path: file to write in it, for the message; the folder by default.

    Raises:
        InputError: the folder is a file, or the system forbids it.
    """
    ancestor = next(parent for parent in (folder, *folder.parents, Path()) if os.path.lexists(parent))
    if not (ancestor.is_dir() and os.access(ancestor, os.W_OK)):
        obstacle = f"{ancestor} is not a folder" if not ancestor.is_dir() else f"permission denied in {ancestor}"
        raise InputError(f"cannot write {path or folder}: {obstacle}; choose another file or folder")


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Prevent other commands from writing a file or folder until the end of the block.

    A claim is a locked file beside it, whose name has the start and the hash of its name. The system ends the claim of
    a killed command. The claim has no effect where files cannot be locked. Folders that are made for the claim are
    removed if they stay empty.

    Args:
        path: file or folder to write, which may be missing.

    Raises:
        InTheWay: another command is writing it.
        InputError: its folder cannot be made or written to.
    """
    place = Path(os.path.realpath(path))
    checked_folder(place.parent, path)
    lock_file = place.with_name(f".{place.name[:40]}-{content_hash(place.name)}.partial")
    folders = [folder for folder in place.parents if not os.path.exists(folder)]
    place.parent.mkdir(parents=True, exist_ok=True)
    with lock_file.open("ab") as lock:
        # The claim begins with the lock, not with the file, which a killed command leaves behind.
        if not _exclusive(lock.fileno()):
            raise InTheWay(
                f"cannot write {path}: another dpcontrol command is writing it; wait for it, or choose another name"
            )
        try:
            yield
        finally:
            lock_file.unlink(missing_ok=True)
            # The deepest comes first; one that is not empty ends this.
            with suppress(OSError):
                for folder in folders:
                    folder.rmdir()


def _exclusive(handle: int) -> bool:
    """Lock an open file for this command alone, and return True if that succeeded.

    It fails if another command has locked the file, or has removed it since it was opened: a lock on a removed file
    would not stop a third command. Where files cannot be locked, it counts as locked.

    Args:
        handle: descriptor of the file.
    """
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        # Windows has no such locks, and neither have some network folders.
        return True
    return os.fstat(handle).st_nlink > 0


@contextmanager
def free_name(path: Path, make: Callable[[Path], T]) -> Iterator[T]:
    """Claim the first free name of NAME, NAME.2, NAME.3 …, and yield the result of `make` for it.

    Args:
        path: the first name.
        make: function that makes or checks the file of a name, and raises `InTheWay` if another command made the file.

    Raises:
        InputError: see `claimed` and `make`, except `InTheWay`.
    """
    for number in itertools.count(1):
        candidate = path if number == 1 else path.with_name(f"{path.stem}.{number}{path.suffix}")
        with ExitStack() as stack:
            try:
                stack.enter_context(claimed(candidate))
                result = make(candidate)
            except InTheWay:
                continue
            yield result
            return


@contextmanager
def chosen_name(
    requested: Path | str | bool | None, first: Path, check: Callable[[Path], object] = checked_target
) -> Iterator[Path | None]:
    """Yield the file or folder to write, which no other command writes until the end of the block.

    None is yielded if no file is requested.

    Args:
        requested: its name, True for the first free name, or None for no file.
        first: the first name that is tried (see `free_name`).
        check: checks a name; raises `InTheWay` if another command made the file.

    Raises:
        InputError: the file cannot be written, or is in the way.
    """

    def checked(file: Path) -> Path:
        """Return `file` after `check` has accepted its name; the errors of `check` are passed on."""
        check(file)
        return file

    if requested is True:
        with free_name(first, checked) as file:
            yield file
    elif not requested:
        yield None
    else:
        with claimed(Path(str(requested))):
            yield checked(Path(str(requested)))


def checked_source(path: Path | str) -> Path:
    """Return the path of a file to read, after a check that it is a regular file or missing.

    Args:
        path: file to read; links are followed.

    Raises:
        InputError: `path` is a folder, a device or a pipe.
    """
    path = Path(path)
    # Files that are missing are reported when they are opened.
    if os.path.exists(path) and not os.path.isfile(path):
        if is_bag_folder(path):
            raise InputError(f"cannot read {path}: it is a ROS bag; make a log of it with `dpcontrol import {path}`")
        raise InputError(f"cannot read {path}: it is a folder, a pipe or a device; give a regular file")
    return path


def is_bag_folder(path: Path) -> bool:
    """True if the path is a bag of ROS 2, a folder with metadata.yaml.

    Args:
        path: file or folder.
    """
    return os.path.isfile(path / "metadata.yaml")


MOST_UNPACKED = 1 << 29
"""Largest unpacked size of a file, bytes, tens of times that of the longest plans and recordings."""


def checked_size(size: float, what: str = "it", *, most: int = MOST_UNPACKED) -> None:
    """Reject a file whose headers declare a large unpacked size.

    Args:
        size: declared size, bytes.
        what: subject of the message.
        most: largest allowed size, bytes.

    Raises:
        ValueError: the size is too large, with its value and the limit.
    """
    if size > most:
        raise ValueError(f"{what} would unpack to {size / 1e9:.3g} GB, and {most / 1e9:.2g} GB are allowed")


def checked_other_file(out: Path, source: Path | str, *, what: str, option: str = "--out") -> None:
    """Reject a file to write that is the file being read, by any name, because its content would be lost.

    Args:
        out: file to write.
        source: file that is read.
        what: role of the source, such as "the log to repeat".
        option: option that names the target.

    Raises:
        InputError: `out` is the file `source`, perhaps by another name.
    """
    if os.path.exists(out) and os.path.samefile(out, source):
        raise InputError(f"{option} {out}: that is {what}; choose another name")


def in_the_way(path: Path | str, what: str) -> InTheWay:
    """Return the error of a file with other content, which a command does not replace without --force.

    Args:
        path: the existing file.
        what: its content, such as "holds another run".
    """
    return InTheWay(
        f"{path} is there already and {what}, which would be lost: choose another name, or replace it with --force"
    )


def unwritable(path: Path, error: OSError) -> InputError:
    """Return the error of a file that cannot be written.

    Args:
        path: file to write.
        error: the system's error.
    """
    return InputError(f"cannot write {path}: {error.strerror or error}; choose another file or folder")


@contextmanager
def whole_file(path: Path, *, suffix: str = "") -> Iterator[Path]:
    """Yield a temporary path beside `path`, which gets that name when the block ends without an error.

    The temporary name ends with `suffix`, for writers that choose a format by it. The temporary file is removed if the
    block raises.

    Args:
        path: file to write; missing folders are made.
        suffix: end of the temporary name, ".partial" by default.

    Raises:
        InputError: the folder cannot be made or written to, or `path` is a folder or a device.
    """
    path = checked_target(Path(path))
    # A name of any length leaves room for additions.
    temporary = path.with_name(f".{path.name[:40]}.{token_hex(4)}{suffix or '.partial'}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file so that a reader sees either the old file or the whole new one.

    Args:
        path: file to write.
        content: bytes, or text for UTF-8.
    """
    data = content.encode() if isinstance(content, str) else content
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


def write_folder(path: Path, files: Mapping[str, str], *, force: bool = False) -> None:
    """Write text files to a folder, each whole; files that the folder lacks are added.

    Args:
        path: folder to write.
        files: texts by file name.
        force: replace files of these names in any folder, and keep its other files.

    Raises:
        InputError: the folder is there and holds something else, or cannot be written.
    """
    checked_folder(path)
    encoded = {path / name: text.encode() for name, text in files.items()}
    present = {file: file.read_bytes() for file in encoded if file.is_file()}
    # A folder with other files only was not written by an earlier call and stays as it is.
    occupied = path.is_dir() and any(path.iterdir()) and not present
    if not force and (occupied or any(content != encoded[file] for file, content in present.items())):
        raise in_the_way(path, "holds something else")
    for file, content in encoded.items():
        if content != present.get(file):
            write_whole(file, content)


def content_hash(*parts: str | bytes) -> str:
    """Return 16 hexadecimal digits that identify `parts` in order, for the names of cached results and of locks.

    Args:
        *parts: bytes, or texts encoded as UTF-8.
    """
    digest = hashlib.sha256()
    for part in parts:
        # Names of files can have bytes that are no text.
        data = part.encode(errors="surrogateescape") if isinstance(part, str) else part
        # The length separates the parts: ("ab", "c") and ("a", "bc") differ.
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:16]


UNREADABLE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, MemoryError, RuntimeError,
    AssertionError, SyntaxError, SystemError, TokenError, zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
"""Errors of reading a damaged file, including wrong sizes and deep nesting."""


def write_archive(
    path: Path | str | BytesIO, header: Mapping[str, Any], arrays: Mapping[str, Any], *, compressed: bool = False
) -> None:
    """Write a header and arrays atomically to a file.

    Args:
        path: path, or a file in memory.
        header: plain JSON with its `format` and `version`.
        arrays: arrays of any shape, by name.
        compressed: compress the arrays.

    Raises:
        InputError: the file cannot be written.
    """
    text = json.dumps(header, allow_nan=False)
    with nullcontext(path) if isinstance(path, BytesIO) else whole_file(Path(path), suffix=".npz") as temporary:
        (np.savez_compressed if compressed else np.savez)(temporary, header=np.array(text), **arrays)


def archive_format(path: Path | str) -> str:
    """Return the format in a file's header, or "" if it has none or is not readable.

    Args:
        path: archive (see `is_archive`). A log whose last bytes are an attached archive opens as that archive.

    Raises:
        InputError: it is not a regular file.
    """
    try:
        with np.load(path, allow_pickle=False) as packed:
            return str(json.loads(str(packed["header"]))["format"])
    except UNREADABLE:
        return ""


@contextmanager
def archive(
    path: Path | IO[bytes], *, what: str, make: str, again: str, format: str, versions: tuple[int, ...]
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield the header, as JSON values by key, and the arrays, by name, of an archive, to make an object of them.

    Errors in the block mean damage, because the block reads what the archive should contain.

    Args:
        path: path, or an open binary file.
        what: kind of archive with its article, such as "a plan", for messages.
        make: advice on how to make one, for the message on a missing file.
        again: advice on how to replace a damaged one.
        format: required format.
        versions: supported versions.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    try:
        with zipfile.ZipFile(checked_source(path) if isinstance(path, Path) else path) as packed:
            checked_size(sum(info.file_size for info in packed.infolist()))
        if not isinstance(path, Path):
            path.seek(0)
        with np.load(path, allow_pickle=False) as packed:
            arrays = dict(packed)
        header = json.loads(str(arrays.pop("header")))
        if header["format"] != format:
            raise ValueError(f"its format is {header['format']!r}")
        if header["version"] not in versions:
            supported = " and ".join(map(str, versions))
            raise ValueError(f"its version is {header['version']!r}, this program reads {supported}")
        yield header, arrays
    except FileNotFoundError as error:
        raise InputError(f"there is no {what.partition(' ')[2]} {path}; {make}") from error
    except (*UNREADABLE, InputError) as error:
        message = next(iter(str(error).splitlines()), type(error).__name__)[:200]
        reason = f"it lacks {error}" if isinstance(error, KeyError) else message
        raise InputError(f"{path} is not {what} of dpcontrol, or is damaged: {reason}; {again}") from error
