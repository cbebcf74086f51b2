"""Shipped models, itineraries and mappings by name, after those of the working folder.

Models and itineraries are searched by path, in the working folder, then among those shipped. An installed wheel
contains them in `dpcontrol/data`; in a checkout they are beside the package.
"""

import os
from pathlib import Path

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source
from dpcontrol.foundation.settings import suggest
from dpcontrol.foundation.version import PACKAGE

PATHS = (".toml", ".urdf", ".xml")
"""Endings of files, which make a name a path."""
MAPPINGS = PACKAGE / "recordings" / "mappings"
"""Folder of the mappings for importing recordings."""


def mappings() -> list[str]:
    """Return the names of mappings that need no path."""
    return sorted(file.stem for file in MAPPINGS.glob("*.toml"))


def folders(kind: str) -> tuple[Path, Path]:
    """Return the folders that are searched for names: one in the working folder, and the shipped one.

    Args:
        kind: "models" or "itineraries".
    """
    inside = PACKAGE / "data" / kind
    return Path(kind), inside if inside.is_dir() else PACKAGE.parent / kind


def shipped_names(kind: str) -> list[str]:
    """Return the names of models or itineraries that need no path, in both folders.

    Args:
        kind: see `folders`.
    """
    return sorted({file.stem for folder in folders(kind) for file in folder.glob("*.toml")})


def find(kind: str, name: str) -> Path:
    """Return the file of a model or an itinerary, which is given by name or by path.

    Args:
        kind: see `folders`.
        name: name, or path of a file.

    Raises:
        InputError: the file does not exist; the message lists the known names and the nearest one.
    """
    path, names = Path(name), shipped_names(kind)
    is_path = path.suffix.lower() in PATHS or path.name != name
    if is_path:
        checked_source(path)
    # A file of this name that does not end in .toml comes last; reading it gives its error.
    for file in [path] if is_path else [*(folder / f"{name}.toml" for folder in folders(kind)), path]:
        # Unlike Path.is_file, this is False for names that no file can have.
        if os.path.isfile(file):
            return file
    if is_path:
        raise InputError(f"there is no file {name}; give the path of a file, or one of: {', '.join(names)}")
    singular = {"models": "model", "itineraries": "itinerary"}[kind]
    raise InputError(f"there is no {singular} named {name!r}; {suggest(name, names)}, or give a path")
