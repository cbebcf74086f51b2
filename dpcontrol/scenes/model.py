"""Model files: a pendulum's parameters with their sources, from TOML."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from dpcontrol.dynamics.parameters import ArmChainParameters
from dpcontrol.dynamics.system import System, pendulum_system
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml
from dpcontrol.scenes.lookup import find

SYSTEMS = ("arm-chain",)


@dataclass(frozen=True)
class Model:
    """A model as its file gives it: title, parameters, the source of each table, and the text itself."""

    name: str
    path: Path
    title: str
    parameters: ArmChainParameters
    sources: dict[str, str]
    text: str

    @cached_property
    def system(self) -> System:
        """The frictionless pendulum on a fixed pivot, in which orbits and tubes live."""
        return pendulum_system(self.name, self.parameters)


def load_model(name: str) -> Model:
    """Load a model by name or path.

    Raises:
        InputError: no such model, or a mistake in its file: names file, table, key, value and what is allowed.
    """
    path = find("models", name)
    table, text = read_toml(path)
    return _model(table, text, path)


def _model(table: Table, text: str, path: Path) -> Model:
    title = table.text("title")
    table.text("system", "arm-chain", allowed=SYSTEMS)
    arms, gravity = table.table("arms", required=True), table.table("gravity", required=True)
    friction = table.table("friction", required=True)
    sources = {t.name: t.text("source") for t in (arms, gravity, friction)}
    columns = {key: arms.numbers(key) for key in ("mass", "centre_of_mass", "length", "inertia")}
    acceleration, viscous = gravity.number("acceleration"), friction.numbers("viscous")
    for part in (table, arms, gravity, friction):
        part.finish()
    try:
        parameters = ArmChainParameters(**columns, gravity=acceleration, viscous=viscous)
    except InputError as error:
        key = str(error).split()[0]
        home = {"acceleration": gravity, "viscous": friction}.get(key, arms)
        raise InputError(f"{home.where()} {error}") from error
    return Model(path.stem, path, title, parameters, sources, text)
