"""Where results are kept by the content they were made from.

$DPCONTROL_CACHE, else $XDG_CACHE_HOME/dpcontrol, else ~/.cache/dpcontrol.
"""

import os
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """Return the folder for results of one kind; it need not exist."""
    chosen = os.environ.get("DPCONTROL_CACHE")
    if chosen:
        return Path(chosen) / kind
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dpcontrol" / kind
