"""Models, itineraries and mappings that come with the package, and those of the working folder, by name.

Models and itineraries are found by path, in the working folder, then among those shipped: an installed wheel carries
them in `dpcontrol/data`; a checkout has them beside the package.
"""

from contextlib import suppress
from pathlib import Path

import dpcontrol
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_source
from dpcontrol.foundation.settings import nearest

MAPPINGS = Path(dpcontrol.__file__).parent / "recordings" / "mappings"
"""The folder of the mappings that recordings are imported by."""


def mappings() -> list[str]:
    """Return the names of the mappings that can be given without a path."""
    return sorted(file.stem for file in MAPPINGS.glob("*.toml"))


def folders(kind: str) -> tuple[Path, Path]:
    """Return where "models" or "itineraries" are: in the working folder, and shipped, in a wheel or a checkout."""
    package = Path(dpcontrol.__file__).parent
    inside = package / "data" / kind
    return Path(kind), inside if inside.is_dir() else package.parent / kind


def known(kind: str) -> list[str]:
    """Return the names that can be given without a path."""
    names: set[str] = set()
    for folder in folders(kind):
        # A folder that may not be read names nothing.
        with suppress(OSError):
            names |= {file.stem for file in folder.glob("*.toml")}
    return sorted(names)


def find(kind: str, name: str) -> Path:
    """Return the TOML file of a model or an itinerary given by name or path.

    Raises:
        InputError: there is none; lists the known names and the nearest one.
    """
    given, names = Path(name), known(kind)
    is_path = given.suffix == ".toml" or given.name != name
    if is_path:
        checked_source(given)
    for file in [given] if is_path else [folder / f"{name}.toml" for folder in folders(kind)]:
        # A name that no file can have is an error of its own.
        with suppress(OSError, ValueError):
            if file.is_file():
                return file
    if is_path:
        raise InputError(f"there is no file {name}; give a TOML file or one of: {', '.join(names)}")
    close = nearest(name, names)
    hint = f"did you mean {close!r}? " if close else ""
    singular = {"models": "model", "itineraries": "itinerary"}[kind]
    raise InputError(f"there is no {singular} named {name!r}; {hint}known: {', '.join(names)}; a path works too")
