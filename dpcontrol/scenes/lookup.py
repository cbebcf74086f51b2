"""Where models and itineraries are found: by path, in the working folder, then among those shipped.

An installed wheel carries them in `dpcontrol/data`; a checkout has them beside the package.
"""

import difflib
from contextlib import suppress
from pathlib import Path

import dpcontrol
from dpcontrol.foundation.errors import InputError


def shipped(kind: str) -> Path:
    """Return the folder of shipped "models" or "itineraries"."""
    package = Path(dpcontrol.__file__).parent
    inside = package / "data" / kind
    return inside if inside.is_dir() else package.parent / kind


def known(kind: str) -> list[str]:
    """Return the names that can be given without a path."""
    names: set[str] = set()
    for folder in (Path(kind), shipped(kind)):
        # A folder that may not be read names nothing.
        with suppress(OSError):
            names |= {file.stem for file in folder.glob("*.toml")}
    return sorted(names)


def _is_file(path: Path) -> bool:
    """Tell whether there is such a file that may be looked at; a name that no file can have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find(kind: str, name: str) -> Path:
    """Return the TOML file of a model or an itinerary given by name or path.

    Raises:
        InputError: there is none; lists the known names and the nearest one.
    """
    given = Path(name)
    looks_like_path = given.suffix == ".toml" or given.name != name
    if looks_like_path:
        if _is_file(given):
            return given
        raise InputError(f"there is no file {name}; give a TOML file or one of: {', '.join(known(kind))}")
    for folder in (Path(kind), shipped(kind)):
        file = folder / f"{name}.toml"
        if _is_file(file):
            return file
    names = known(kind)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    singular = {"models": "model", "itineraries": "itinerary"}[kind]
    raise InputError(f"there is no {singular} named {name!r}; {hint}known: {', '.join(names)}; a path works too")
