"""Where results are kept by the content they were made from: settings, parameters, and the code itself.

Folder: $DPCONTROL_CACHE, else $XDG_CACHE_HOME/dpcontrol, else ~/.cache/dpcontrol.
"""

import os
import re
import subprocess
from functools import cache
from pathlib import Path

import dpcontrol
from dpcontrol.foundation.files import content_hash

# Patterns that begin with plain text are found in a third of the time.
_FROM = re.compile(rb"from (dpcontrol[\w.]*) import (\([^)]*\)|[^\n]*)")
_IMPORT = re.compile(rb"import (dpcontrol[\w.]*)")
_WORD = re.compile(rb"\w+")


def cache_folder(kind: str) -> Path:
    """Return the folder for results of one kind; it need not exist."""
    chosen = os.environ.get("DPCONTROL_CACHE")
    if chosen:
        return Path(chosen) / kind
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dpcontrol" / kind


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
