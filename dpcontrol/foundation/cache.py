"""Where results are kept by the content they were made from: settings, parameters, and the code itself.

Folder: $DPCONTROL_CACHE, else $XDG_CACHE_HOME/dpcontrol, else ~/.cache/dpcontrol; in it one folder for each kind.

Each file ends in a seal, the SHA-256 digest of its name and content. A file whose seal does not match (damaged, edited,
renamed) counts as absent. The seal stands last, where readers of .npz files pass over it. If the cache is not readable
or not writable, results are recomputed every time, and one remark gives the reason.

heyoka keeps the machine code of its integrators in a database. It lies in the same folder under `COMPILER`, and is
listed and deleted with the rest.
"""

import hashlib
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import dpcontrol
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import content_hash, write_whole

VARIABLE = "DPCONTROL_CACHE"
"""Names the folder."""
KINDS = {
    "plans": ".npz", "transfers": ".npz", "atlases": ".npz", "branches": ".json", "preflights": ".json",
    "machine-code": ".bin",
}  # fmt: skip
"""What is kept, each kind in files of one suffix."""
COMPILER = "heyoka"
"""Folder of heyoka's own database."""
_COMPILER_FILES = re.compile(r"^cache\.db(-wal|-shm|-journal)?$")
"""Names that heyoka and SQLite give to its files."""
_OURS = re.compile(rf"-[0-9a-f]{{16}}({'|'.join(map(re.escape, sorted(set(KINDS.values()))))})(\..+)?$")
"""How names of the cache's files end; those half written go on."""
_SEAL = b"\nsha256:"
_SEALED = len(_SEAL) + 64

# Patterns that begin with plain text are found in a third of the time.
_FROM = re.compile(rb"from (dpcontrol[\w.]*) import (\([^)]*\)|[^\n]*)")
_IMPORT = re.compile(rb"import (dpcontrol[\w.]*)")
_WORD = re.compile(rb"\w+")


def cache_root() -> Path:
    """Return the cache's folder; it need not exist."""
    chosen, base = os.environ.get(VARIABLE), os.environ.get("XDG_CACHE_HOME")
    folder = chosen or str(Path(base or "~/.cache") / "dpcontrol")
    # A shell does not expand "~" within quotes. Without a home folder the name stays as it is.
    return Path(os.path.expanduser(folder))


def cache_file(kind: str, name: str, key: str) -> Path:
    """Return where a result of one of the `KINDS` is kept; key: 16 hexadecimal digits that identify its content."""
    # The name is for people: of any length and with any signs, it stays one part of a path.
    shown = re.sub(r"[^\w.+-]", "_", name)[:40]
    return cache_root() / kind / f"{shown}-{key}{KINDS[kind]}"


def kept(file: Path) -> bytes | None:
    """Return the content that was kept under this name; None where there is none, or not the one that was kept."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    return content[:-_SEALED] if content[-_SEALED:] == _seal(file, content[:-_SEALED]) else None


def keep(file: Path, content: bytes) -> None:
    """Keep content under a name of `cache_file`. If the cache is not writable, make one remark and go on."""
    try:
        write_whole(file, content + _seal(file, content))
    except InputError as error:
        unusable(getattr(error.__cause__, "strerror", None) or str(error))


def compiler_folder() -> Path | None:
    """Return the folder of heyoka's database, which need not exist. If it is not writable, remark and return None."""
    folder = cache_root() / COMPILER
    there = folder
    try:
        while not there.exists():
            there = there.parent
        with TemporaryFile(dir=there):
            return folder
    except OSError as error:
        unusable(error.strerror or str(error))
        return None


def unusable(reason: str) -> None:
    """Remark that results cannot be kept, and why."""
    remark(
        f"the cache {cache_root()} cannot be used ({reason}), so slow results are computed every time; "
        f"set {VARIABLE} to a writable folder, or free some space"
    )


def _seal(file: Path, content: bytes) -> bytes:
    return _SEAL + hashlib.sha256(file.name.encode(errors="surrogateescape") + b"\n" + content).hexdigest().encode()


@dataclass(frozen=True)
class CacheContents:
    """What the cache holds, or held before it was emptied: of each kind the number of entries and their bytes."""

    folder: Path
    kinds: dict[str, tuple[int, int]]
    emptied: bool

    @property
    def entries(self) -> int:
        """How many files there are."""
        return sum(count for count, _ in self.kinds.values())

    @property
    def bytes(self) -> int:
        """How large they are together."""
        return sum(size for _, size in self.kinds.values())

    @property
    def sentence(self) -> str:
        """What is in it, and where."""
        count = "1 entry" if self.entries == 1 else f"{self.entries} entries"
        what = f"{count}, {self.bytes / 1e6:.1f} MB"
        return f"emptied {self.folder}: {what}" if self.emptied else f"{self.folder} holds {what}"

    def __repr__(self) -> str:
        return f"<cache: {self.sentence}>"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol cache --json` prints."""
        kinds = {kind: {"entries": count, "bytes": size} for kind, (count, size) in self.kinds.items()}
        return {"folder": self.folder, "variable": VARIABLE, "entries": self.entries, "bytes": self.bytes,
                "kinds": kinds, "emptied": self.emptied, "status": self.sentence}  # fmt: skip


def cache_contents(*, clear: bool = False) -> CacheContents:
    """Return what the cache holds, and delete it if asked: its own files alone, whatever else the folder is for.

    Raises:
        InputError: a file cannot be deleted, or a folder not read.
    """
    root = cache_root()
    kinds: dict[str, tuple[int, int]] = {}
    try:
        for kind, names in {**dict.fromkeys(KINDS, _OURS), COMPILER: _COMPILER_FILES}.items():
            files = _files(root / kind, names)
            sizes = [size for file in files if (size := _size(file, clear=clear)) is not None]
            kinds[kind] = (len(sizes), sum(sizes))
    except OSError as error:
        what = f"cannot {'empty' if clear else 'look into'} the cache: {error.filename}: {error.strerror}"
        raise InputError(f"{what}; check who may read and write there, or set {VARIABLE} to another folder") from error
    return CacheContents(root, kinds, clear)


def _size(file: Path, *, clear: bool) -> int | None:
    """Return a file's size in bytes, and delete it if asked; None where another process has deleted it meanwhile."""
    with suppress(FileNotFoundError):
        size = file.stat().st_size
        if clear:
            file.unlink()
        return size
    return None


def _files(folder: Path, names: re.Pattern[str]) -> Iterator[Path]:
    with suppress(FileNotFoundError, NotADirectoryError):
        yield from (file for file in sorted(folder.iterdir()) if names.search(file.name) and file.is_file())


@cache
def code_hash(module: str, root: Path | None = None) -> str:
    """Return what identifies the code of a module and of all it imports, so that newer code never takes older results.

    root: the package's folder, if not that of the running one.
    """
    sources = module_sources(module, root)
    return content_hash(*(part for name in sorted(sources) for part in (name, sources[name])))


def module_sources(module: str, root: Path | None = None) -> dict[str, bytes]:
    """Return the source of a module of this package and of all that it imports from it, anywhere, by name.

    The statements are read, not run: imports within functions and for types alone count too.
    """
    root = Path(dpcontrol.__file__).parent if root is None else root
    sources: dict[str, bytes] = {}
    seen: set[str] = set()
    left = [module]
    while left:
        name = left.pop()
        if name in seen:
            continue
        seen.add(name)
        file = _file(root, name)
        if file is None:
            continue
        sources[name] = file.read_bytes()
        left += [origin.decode() for origin in _IMPORT.findall(sources[name])]
        for source, names in _FROM.findall(sources[name]):
            origin = source.decode()
            left.append(origin)
            if root.joinpath(*origin.split(".")[1:]).is_dir():
                left += [f"{origin}.{word.decode()}" for word in _WORD.findall(names)]
    return sources


def _file(root: Path, name: str) -> Path | None:
    """Return the file of a module or package; none of other names, nor of the root, which only lists the others."""
    path = root.joinpath(*name.split(".")[1:])
    if path == root:
        return None
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def commit() -> str:
    """Return the commit of the checkout that this package runs from, or "" for an installed one."""
    root = Path(dpcontrol.__file__).parent.parent
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
