"""The user's configuration: defaults of the command line, from the environment and from a file.

File: $XDG_CONFIG_HOME/dpcontrol/config.toml, else ~/.config/dpcontrol/config.toml. An option overrides the environment,
the environment overrides the file, and the file overrides the default.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Setting, Settings, leaves_of
from dpcontrol.foundation.toml import Place, read_toml, table_of


@dataclass(frozen=True)
class Config(Settings):
    """Defaults of the command line."""

    logs: Annotated[str, Setting(help="Folder of logs, tables and pages.")] = "logs"
    workers: Annotated[int, Setting(least=1, most=4096, zero="one for each processor", help="Processes.")] = 0
    viewer: Annotated[str, Setting(help="Program that shows recordings; by default that of rerun-sdk.")] = ""
    colour: Annotated[str, Setting(choices=("auto", "always", "never"), help="Colour in the terminal.")] = "auto"


class Configured(NamedTuple):
    """A setting's value with its source (environment, file or default) and its environment variable."""

    name: str
    value: Any
    source: str
    help: str
    variable: str


@dataclass(frozen=True)
class Configuration:
    """The defaults of the command line, and where each comes from.

    Attributes:
        file: place of the configuration file, which need not exist.
    """

    file: Path
    settings: tuple[Configured, ...]

    def __iter__(self) -> Iterator[Configured]:
        return iter(self.settings)

    @property
    def exists(self) -> bool:
        """True if there is a configuration file."""
        return os.path.isfile(self.file)

    def document(self) -> dict[str, Any]:
        """Return file and settings as JSON values."""
        settings = {setting.name: {"value": setting.value, "source": setting.source} for setting in self.settings}
        return {"file": str(self.file), "settings": settings}


def at_home(path: Path | str) -> Path:
    """Return a path with "~" replaced by the home folder.

    Args:
        path: path from a setting; shells do not expand "~" within quotes.

    Raises:
        InputError: there is no such home folder.
    """
    expanded = os.path.expanduser(path)
    if expanded.startswith("~"):
        raise InputError(f"{path}: there is no home folder {expanded.partition('/')[0]!r}")
    return Path(expanded)


def config_file() -> Path:
    """Return the place of the configuration file; it need not exist."""
    folder = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(os.path.expanduser(folder)) / "dpcontrol" / "config.toml"


def configuration() -> Config:
    """Return the defaults of the command line, from the environment and the configuration file.

    Raises:
        InputError: a mistake in the file or in a variable.
    """
    return Config(**{setting.name: setting.value for setting in configured()})


def configured() -> Iterator[Configured]:
    """Yield each setting with its value and its source: an environment variable, the file, or the default.

    Raises:
        InputError: a mistake in the file or in a variable.
    """
    file = config_file()
    values = read_toml(file)[0] if os.path.isfile(file) else {}
    of_file = table_of(Config).read(values, Place(str(file)))
    for name, leaf in leaves_of(Config).items():
        variable = f"DPCONTROL_{name.upper()}"
        if variable in os.environ:
            value, source = leaf.read(os.environ[variable], key=variable, strict=False), variable
        else:
            value, source = getattr(of_file, name), str(file) if name in values else "default"
        yield Configured(name, value, source, leaf.bounds.help, variable)


def log_folder() -> Path:
    """Return the folder of logs, tables and pages.

    Raises:
        InputError: a mistake in the configuration, or a home folder that does not exist.
    """
    return at_home(configuration().logs)
