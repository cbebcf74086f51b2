"""Where results are kept by the content they were made from: settings, parameters, and the code itself.

$DPCONTROL_CACHE, else $XDG_CACHE_HOME/dpcontrol, else ~/.cache/dpcontrol.
"""

import os
from functools import cache
from pathlib import Path

import dpcontrol
from dpcontrol.foundation.files import content_hash

_COMPUTING = ("dynamics", "tubes", "itineraries", "references")


def cache_folder(kind: str) -> Path:
    """Return the folder for results of one kind; it need not exist."""
    chosen = os.environ.get("DPCONTROL_CACHE")
    if chosen:
        return Path(chosen) / kind
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dpcontrol" / kind


@cache
def code_hash() -> str:
    """Return what identifies the code that computes plans and atlases, so that newer code never takes older results."""
    root = Path(dpcontrol.__file__).parent
    files = sorted(file for package in _COMPUTING for file in (root / package).glob("*.py"))
    return content_hash(*(part for file in files for part in (file.name, file.read_bytes())))
