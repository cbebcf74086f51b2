"""Model files: a pendulum's parameters with their sources, from TOML."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from dpcontrol.dynamics.parameters import ArmChainParameters, Friction
from dpcontrol.dynamics.system import System, pendulum_system
from dpcontrol.dynamics.three_body import ThreeBodyParameters, three_body_system
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml
from dpcontrol.scenes.lookup import find

SYSTEMS = ("arm-chain", "three-body")


@dataclass(frozen=True)
class Model:
    """A model as its file gives it: title, parameters, the source of each table, and the text itself."""

    name: str
    path: Path
    title: str
    parameters: ArmChainParameters | ThreeBodyParameters
    sources: dict[str, str]
    text: str

    @cached_property
    def system(self) -> System:
        """The conservative system in which orbits and tubes live: for arms, without friction, on a fixed pivot."""
        if isinstance(self.parameters, ThreeBodyParameters):
            return three_body_system(self.name, self.parameters)
        return pendulum_system(self.name, self.parameters)

    @property
    def exact_parameters(self) -> Sequence[Fraction | Decimal]:
        """The equations' parameters as the decimals that the file gives, for extended precision."""
        if isinstance(self.parameters, ArmChainParameters):
            return self.parameters.viscous_only().decimal_base()
        return [Decimal(repr(float(value))) for value in self.system.parameters]

    @property
    def arms(self) -> ArmChainParameters:
        """The arms' parameters, where there are arms.

        Raises:
            InputError: the model is no pendulum.
        """
        if not isinstance(self.parameters, ArmChainParameters):
            raise InputError(f"{self.path}: {self.title} has no arms and no cart; choose a model of arms, such as lab")
        return self.parameters


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
    if table.text("system", "arm-chain", allowed=SYSTEMS) == "three-body":
        return _three_body(table, title, text, path)
    arms, gravity = table.table("arms", required=True), table.table("gravity", required=True)
    friction = table.table("friction", required=True)
    sources = {t.name: t.text("source") for t in (arms, gravity, friction)}
    columns = {key: arms.numbers(key) for key in ("mass", "centre_of_mass", "length", "inertia")}
    acceleration, viscous = gravity.number("acceleration"), friction.numbers("viscous")
    laws: dict[str, Any] = {law.value: friction.numbers(law.value, ()) for law in Friction}
    if "smoothing" in friction:
        if not any(laws.values()):
            raise InputError(
                f"{friction.where('smoothing')}: there is neither coulomb nor quadratic friction to smooth; give one "
                "or leave it out"
            )
        laws["smoothing"] = friction.number("smoothing")
    for part in (table, arms, gravity, friction):
        part.finish()
    try:
        parameters = ArmChainParameters(**columns, gravity=acceleration, viscous=viscous, **laws)
    except InputError as error:
        key = str(error).split()[0]
        home = {"acceleration": gravity}.get(key, friction if key in ("viscous", "smoothing", *Friction) else arms)
        raise InputError(f"{home.where()} {error}") from error
    return Model(path.stem, path, title, parameters, sources, text)


def _three_body(table: Table, title: str, text: str, path: Path) -> Model:
    primaries = table.table("primaries", required=True)
    source, ratio = primaries.text("source"), primaries.number("mass_ratio")
    for part in (table, primaries):
        part.finish()
    parameters = primaries.checked(ThreeBodyParameters, mass_ratio=ratio)
    return Model(path.stem, path, title, parameters, {"primaries": source}, text)
