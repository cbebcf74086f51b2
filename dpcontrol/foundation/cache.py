"""Result cache, keyed by content.

The key covers all that a result depends on: settings, parameters and the version of the code, an explicit number.

The folder is $DPCONTROL_CACHE, else $XDG_CACHE_HOME/dpcontrol, else ~/.cache/dpcontrol. It has one subfolder for each
kind of result.

Each file ends in a seal, the SHA-256 digest of its name and content. A file whose seal does not match (damaged, edited,
renamed) counts as absent. Readers of .npz files ignore the seal, since it comes last. If the cache is not readable or
not writable, results are recomputed every time, and one remark gives the reason.

heyoka stores the machine code of its integrators in a database. The database is in the same folder under `COMPILER`. It
is listed and deleted together with the results.
"""

import hashlib
import os
import pickle
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from dpcontrol.foundation.config import at_home
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import checked_folder, write_whole
from dpcontrol.foundation.version import PACKAGE

VARIABLE = "DPCONTROL_CACHE"
"""Environment variable with the folder."""
KINDS = {
    "plans": ".npz", "transfers": ".npz", "atlases": ".npz", "preflights": ".json",
    "controllers": ".bin", "machine-code": ".bin",
}  # fmt: skip
"""Kinds of results, each with one file suffix."""
COMPILER = "heyoka"
"""Folder of heyoka's database."""
_COMPILER_FILES = re.compile(r"^cache\.db(-wal|-shm|-journal)?$")
"""Names that heyoka and SQLite give to its files."""
_OURS = re.compile(rf"-[0-9a-f]{{16}}({'|'.join(map(re.escape, sorted(set(KINDS.values()))))})(\..+)?$")
"""Suffixes of the cache's files; partly written files have further characters."""
_SEAL = b"\nsha256:"
_SEALED = len(_SEAL) + 64
"""Beginning of a file's seal, and the length of the seal, bytes."""


def cache_root() -> Path:
    """Return the cache's folder, which may not exist yet."""
    requested, base_folder = os.environ.get(VARIABLE), os.environ.get("XDG_CACHE_HOME")
    folder = requested or str(Path(base_folder or "~/.cache") / "dpcontrol")
    # Without a home folder, the name is unchanged, and its users reject it.
    return Path(os.path.expanduser(folder))


def cache_file(kind: str, name: str, key: str) -> Path:
    """Return the path under which a result of one of the `KINDS` is cached.

    Args:
        kind: one of the `KINDS`.
        name: readable part of the file name.
        key: 16 hexadecimal digits that identify the content.
    """
    # The name is for readers. It remains a single path component, whatever its length and characters.
    readable_name = re.sub(r"[^\w.+-]", "_", name)[:40]
    return cache_root() / kind / f"{readable_name}-{key}{KINDS[kind]}"


def kept(file: Path) -> bytes | None:
    """Return the content that is stored under a name, without its seal, or None if it is missing or damaged.

    Args:
        file: entry, from `cache_file`.
    """
    try:
        content = file.read_bytes()
    except OSError:
        return None
    return content[:-_SEALED] if content[-_SEALED:] == _seal(file, content[:-_SEALED]) else None


def keep(file: Path, content: bytes) -> None:
    """Store content under a name of `cache_file`.

    If the cache is not writable, issue a remark.

    Args:
        file: entry, from `cache_file`.
        content: bytes to store; a digest is added.
    """
    try:
        write_whole(at_home(file), content + _seal(file, content))
    except InputError as error:
        unusable(error)


def load_or_make(file: Path, make: Callable[[], Any]) -> Any:
    """Return the object that is stored under a name, or make it now and store it.

    Args:
        file: entry, from `cache_file`.
        make: makes the object, which must be able to be pickled.
    """
    if (content := kept(file)) is not None:
        # An object of another version is made again.
        with suppress(Exception):
            return pickle.loads(content)
    made = make()
    keep(file, pickle.dumps(made))
    return made


def compiler_folder() -> Path | None:
    """Return the folder of heyoka's database, which may not exist yet.

    If the folder is not writable, issue a remark and return None.
    """
    folder = cache_root() / COMPILER
    try:
        checked_folder(at_home(folder))
        return folder
    except InputError as error:
        unusable(error)
        return None


def unusable(error: InputError) -> None:
    """Issue a remark that results cannot be cached.

    Args:
        error: the error of a folder or file that cannot be written.
    """
    reason = getattr(error.__cause__, "strerror", None) or str(error)
    remark(
        f"the cache {cache_root()} cannot be used ({reason}), so slow results may be computed again in each call; set "
        f"{VARIABLE} to a writable folder, or free some space"
    )


def _seal(file: Path, content: bytes) -> bytes:
    """Return the seal of an entry: the digest of its name and content, which reveals renaming, editing and damage."""
    return _SEAL + hashlib.sha256(file.name.encode(errors="surrogateescape") + b"\n" + content).hexdigest().encode()


@dataclass(frozen=True)
class CacheContents(Documented):
    """Number of entries and bytes of each kind in the cache.

    They are counted before the cache is emptied, if it is.

    Attributes:
        folder: folder of the cache.
        kinds: number of entries and bytes, by kind of entry.
        emptied: True if the cache was emptied afterwards.
    """

    KEYS: ClassVar[str] = "folder variable entries bytes kinds:entries,bytes emptied status=sentence"

    folder: Path
    kinds: dict[str, tuple[int, int]]
    emptied: bool

    @property
    def entries(self) -> int:
        """Number of files."""
        return sum(count for count, _ in self.kinds.values())

    @property
    def bytes(self) -> int:
        """Total size, bytes."""
        return sum(size for _, size in self.kinds.values())

    @property
    def sentence(self) -> str:
        """The contents and the folder, in one sentence."""
        count = "1 entry" if self.entries == 1 else f"{self.entries} entries"
        content = f"{count}, {self.bytes / 1e6:.1f} MB"
        return f"emptied {self.folder}: {content}" if self.emptied else f"{self.folder} holds {content}"

    def __repr__(self) -> str:
        return f"<cache: {self.sentence}>"

    @property
    def variable(self) -> str:
        """Name of the environment variable that sets the folder."""
        return VARIABLE


def cache_contents(*, clear: bool = False) -> CacheContents:
    """Return the contents of the cache, as they are before it is emptied on request.

    Args:
        clear: delete the cache's own files; other files in the folder are kept.

    Raises:
        InputError: a file cannot be deleted, or a folder cannot be read.
    """
    root = cache_root()
    kinds: dict[str, tuple[int, int]] = {}
    try:
        at_home(root)
        for kind, pattern in {**dict.fromkeys(KINDS, _OURS), COMPILER: _COMPILER_FILES}.items():
            files = [file for file in (root / kind).glob("*") if pattern.search(file.name) and file.is_file()]
            kinds[kind] = (len(files), sum(file.stat().st_size for file in files))
            for file in files if clear else ():
                file.unlink(missing_ok=True)
    except (OSError, InputError) as error:
        failure = f"cannot {'empty' if clear else 'read'} the cache: {error}"
        raise InputError(f"{failure}; check its permissions, or set {VARIABLE} to another folder") from error
    return CacheContents(root, kinds, clear)


def commit() -> str:
    """Return the commit of a checkout of the sources, for the metadata of logs.

    It ends in "-dirty" if files differ from the commit. It is "" for an installed package, or if git fails.
    """
    root = PACKAGE.parent
    if not (root / ".git").exists():
        return ""
    import subprocess

    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
