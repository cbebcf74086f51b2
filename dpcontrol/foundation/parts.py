"""Optional packages, imported on first use, with an install hint if one is missing.

    hy = Later("heyoka")        # imports the package on first use

On systems without a package, or installations without an extra, everything that does not need it works.
"""

import importlib
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from dpcontrol.foundation.errors import PartMissing
from dpcontrol.foundation.version import VERSION

_MATLAB = (
    "MATLAB 7.3 files and MATLAB objects need mat-io; install it by `pip install 'dpcontrol[matlab]'`, or save the "
    "recording in MATLAB as version 7"
)
_SERIAL = "rigs on serial lines need pyserial and cobs; install them by `pip install 'dpcontrol[serial]'`"
_NEEDED = {
    "heyoka": "orbits, tubes and new plans need heyoka, which pip installs only on Linux; install it by `conda install "
    "-c conda-forge heyoka.py`, or use a plan saved elsewhere by `dpcontrol plan NAME --out FILE.npz`",
    "matio": _MATLAB,
    "h5py": _MATLAB,
    "rosbags": "ROS bags and MCAP files need rosbags; install it by `pip install 'dpcontrol[bags]'`, or save CSV",
    "pyarrow": "Parquet tables, as campaigns write them, need pyarrow; install it by `pip install 'dpcontrol[tables]'`",
    "pandas": "tables need pandas; install it by `pip install 'dpcontrol[pandas]'`",
    "flint": "proofs need python-flint; install it by `pip install 'dpcontrol[proof]'`",
    "imageio_ffmpeg": "films as .mp4 need imageio-ffmpeg; install it by `pip install 'dpcontrol[film]'`, or choose "
    ".gif or .webp",
    "serial": _SERIAL,
    "cobs": _SERIAL,
    "mujoco": "models in URDF or MJCF need MuJoCo; install it by `pip install 'dpcontrol[mujoco]'`, or write the model "
    "as TOML",
    "rerun": "the viewer and its recordings need rerun-sdk; install it by `pip install 'dpcontrol[viewer]'`, or draw "
    "with matplotlib by --picture FILE.png",
    "websockets": "the planner needs websockets; install it by `pip install 'dpcontrol[planner]'`",
}
"""Sentences about missing packages: their use and their installation, by name for `import`."""


def part(name: str) -> Any:
    """Import and return an optional package, or explain its installation.

    Args:
        name: name for `import`.

    Raises:
        PartMissing: the package cannot be imported.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PartMissing(_NEEDED[name.partition(".")[0]]) from error


def installed(name: str) -> bool:
    """True if a package is installed; does not import it.

    Args:
        name: name for `import`.
    """
    return find_spec(name) is not None


class Later:
    """A package that is imported on first use.

    Args:
        name: name of the package.
        prepare: called with the package before its first use.

    Raises:
        PartMissing: on first use, if the package cannot be imported.
    """

    def __init__(self, name: str, prepare: Callable[[Any], None] | None = None) -> None:
        self._name, self._prepare = name, prepare

    def __getattr__(self, name: str) -> Any:
        package = part(self._name)
        if self._prepare is not None:
            prepare, self._prepare = self._prepare, None
            prepare(package)
        value = getattr(package, name)
        # Later look-ups bypass this function.
        setattr(self, name, value)
        return value


class StageModule:
    """A module of this package that is imported whenever a name of it is used.

    Args:
        module: its name below the package, such as "plans.plan".
    """

    def __init__(self, module: str) -> None:
        self._module = f"{__name__.partition('.')[0]}.{module}"

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._module), name)


_DISTRIBUTIONS = (
    "numpy", "scipy", "casadi", "heyoka", "networkx", "control", "filterpy", "mcap", "zstandard", "matplotlib",
    "rerun-sdk", "pyarrow", "mat-io", "pandas", "python-flint",
)  # fmt: skip
"""Packages whose versions are reported."""


def versions() -> dict[str, str]:
    """Return the versions of dpcontrol, Python, system and packages, "" for those not installed."""
    # Imported here because the help of verbs needs none of them.
    import platform
    from importlib.metadata import distributions

    installed_versions = {
        distribution.metadata["Name"].lower().replace("_", "-"): distribution.version
        for distribution in distributions()
    }
    program = {"dpcontrol": VERSION, "python": platform.python_version(), "system": platform.platform()}
    return {**program, **{name: installed_versions.get(name, "") for name in _DISTRIBUTIONS}}
