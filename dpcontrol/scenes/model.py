"""Model files: a pendulum's parameters with their sources, from TOML."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.dynamics.parameters import ArmChainParameters, Friction
from dpcontrol.dynamics.system import System, pendulum_system
from dpcontrol.dynamics.three_body import ThreeBodyParameters, three_body_system
from dpcontrol.dynamics.uncertain_arms import Uncertainty
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, read_toml
from dpcontrol.scenes.lookup import find

SYSTEMS = ("arm-chain", "three-body")


@dataclass(frozen=True)
class Model:
    """A model as its file gives it: title, parameters, the source of each table, and the text itself.

    encoder_zeros (n,) rad: what recorded absolute angles show where the true ones are zero, if the file tells;
    uncertainty: of identified arms.
    """

    name: str
    path: Path
    title: str
    parameters: ArmChainParameters | ThreeBodyParameters
    sources: dict[str, str]
    text: str
    encoder_zeros: tuple[float, ...] = ()
    uncertainty: Uncertainty | None = None

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

    @property
    def known_to(self) -> Uncertainty:
        """How well the arms are known.

        Raises:
            InputError: the file does not say.
        """
        if self.uncertainty is None:
            raise InputError(
                f"{self.path} has no [uncertainty] to draw from; identify the model from recordings, or use a mismatch"
            )
        return self.uncertainty

    def drawn(self, random: np.random.Generator, *, scale: float = 1.0) -> ArmChainParameters:
        """Return arms as likely as the identification says, its standard errors taken `scale` times as large.

        Raises:
            InputError: the file has no [uncertainty].
            GoalMissed: no arms near these have the ratios drawn, as where an uncertainty is as large as its value.
        """
        return self.known_to.drawn(self.arms, random, scale=scale)


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
    smoothed = "smoothing" in friction
    if smoothed:
        laws["smoothing"] = friction.number("smoothing")
    encoders, uncertain = table.table("encoders"), table.table("uncertainty")
    zeros: tuple[float, ...] = ()
    if "encoders" in table:
        sources["encoders"] = encoders.text("source")
        zeros = encoders.numbers("zeros")
    uncertainty = None
    if "uncertainty" in table:
        sources["uncertainty"] = uncertain.text("source")
        uncertainty = Uncertainty(uncertain.texts("names"), uncertain.numbers("covariance"))
    for part in (table, arms, gravity, friction, encoders, uncertain):
        part.finish()
    if smoothed and not any(laws[law.value] for law in Friction):
        raise InputError(
            f"{friction.where('smoothing')}: there is neither coulomb nor quadratic friction to smooth; give one or "
            "leave it out"
        )
    try:
        parameters = ArmChainParameters(**columns, gravity=acceleration, viscous=viscous, **laws)
    except InputError as error:
        key = str(error).split()[0]
        home = {"acceleration": gravity}.get(key, friction if key in ("viscous", "smoothing", *Friction) else arms)
        raise InputError(f"{home.where()} {error}") from error
    if zeros and len(zeros) != parameters.count:
        raise InputError(f"{encoders.where('zeros')} has {len(zeros)} values; give one for each arm")
    if uncertainty is not None:
        try:
            uncertainty.check(parameters)
        except InputError as error:
            raise InputError(f"{uncertain.where()} {error}") from error
    return Model(path.stem, path, title, parameters, sources, text, zeros, uncertainty)


def _three_body(table: Table, title: str, text: str, path: Path) -> Model:
    primaries = table.table("primaries", required=True)
    source, ratio = primaries.text("source"), primaries.number("mass_ratio")
    for part in (table, primaries):
        part.finish()
    parameters = primaries.checked(ThreeBodyParameters, mass_ratio=ratio)
    return Model(path.stem, path, title, parameters, {"primaries": source}, text)
