"""Model files: a pendulum's parameters with their sources, from TOML.

Identified arms as a model file: where each number comes from, and how well it is known.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dpcontrol.dynamics.chain import (
    ArmChainParameters,
    Friction,
    Uncertainty,
    oddities,
    pendulum_system,
    ratio_names,
    unit_name,
)
from dpcontrol.dynamics.system import System, ThreeBodyParameters, three_body_system
from dpcontrol.foundation.arguments import path as path_of
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import in_the_way, write_whole
from dpcontrol.foundation.settings import Table, parse_toml, read_toml
from dpcontrol.foundation.shipped import find
from dpcontrol.foundation.units import Usual

if TYPE_CHECKING:
    from dpcontrol.identification.identify import Identification


SYSTEMS = ("arm-chain", "three-body")
_ZEROS = Usual(0.0, 2 * np.pi, "rad")


@dataclass(frozen=True)
class Model:
    """A model as its file gives it: title, parameters, the source of each table, and the text itself.

    encoder_zeros (n,) rad: recorded absolute angles where the true ones are zero, if the file gives them;
    uncertainty: of identified arms; remarks: sentences on what is odd about its numbers.
    """

    name: str
    path: Path
    title: str
    parameters: ArmChainParameters | ThreeBodyParameters
    sources: dict[str, str]
    text: str
    encoder_zeros: tuple[float, ...] = ()
    uncertainty: Uncertainty | None = None
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<model {self.name!r}: {self.title}>"

    @cached_property
    def system(self) -> "ModelSystem":
        """The conservative system in which orbits and tubes live: for arms, without friction, on a fixed pivot."""
        if isinstance(self.parameters, ThreeBodyParameters):
            own = three_body_system(self.name, self.parameters)
        else:
            own = pendulum_system(self.name, self.parameters)
        return ModelSystem(**{f.name: getattr(own, f.name) for f in fields(own)}, model=self)

    def unit(self, name: str, form: str = " {}") -> str:
        """Return a unit of SI as texts have it after a number; "" for three bodies, whose units are their own."""
        return "" if isinstance(self.parameters, ThreeBodyParameters) else form.format(name)

    @cached_property
    def decimals(self) -> dict[str, tuple[Fraction, ...]]:
        """The parameters exactly as the file's decimals, by field.

        A parameter that was changed after reading is the shortest decimal that reads as its double.
        """
        table, out = tomllib.loads(self.text, parse_float=Decimal), {}
        given = {**table.get("arms", {}), **table.get("friction", {}), **table.get("primaries", {})}
        given["gravity"] = table.get("gravity", {}).get("acceleration")
        for one in fields(self.parameters):
            numbers = [float(v) for v in np.atleast_1d(getattr(self.parameters, one.name))]
            typed = given.get(one.name, [])
            exact = [Fraction(v) for v in (typed if isinstance(typed, list) else [typed]) if v is not None]
            same = [float(v) for v in exact] == numbers
            out[one.name] = tuple(exact if same else [Fraction(repr(v)) for v in numbers])
        return out

    @property
    def exact_parameters(self) -> Sequence[Fraction]:
        """The equations' parameters for exact arithmetic, from the file's decimals."""
        if isinstance(self.parameters, ArmChainParameters):
            return self.parameters.viscous_only().decimal_base(self.decimals)
        return self.decimals["mass_ratio"]

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


@dataclass(frozen=True, kw_only=True)
class ModelSystem(System):
    """The conservative system of a model, which whatever is found in it leads back to."""

    model: Model


def model_of(system: System) -> Model:
    """Return the model that a system is the conservative part of.

    Raises:
        InputError: the system was made without one.
    """
    if not isinstance(system, ModelSystem):
        raise InputError(f"{system.name} has no arms and no cart: start from a model of arms, such as lab")
    return system.model


def load_model(name: str) -> Model:
    """Load a model by name or path; what is odd about its numbers is remarked on.

    >>> dp.load_model("lab").arms.count
    2

    Raises:
        InputError: no such model, or a mistake in its file: names file, table, key, value and what is allowed.
    """
    path = find("models", path_of("name", name))
    table, text = read_toml(path)
    model = _model(table, text, path)
    for sentence in model.remarks:
        remark(f"{path}: {sentence}")
    return model


def model_from(text: str, name: str) -> Model:
    """Return the model of a file's text, under a name.

    Raises:
        InputError: a mistake in it.
    """
    file = Path(f"{name}.toml")
    return _model(parse_toml(text, str(file)), text, file)


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
        remarks = oddities(parameters)
    except InputError as error:
        key = str(error).split()[0]
        home = {"acceleration": gravity}.get(key, friction if key in ("viscous", "smoothing", *Friction) else arms)
        raise InputError(f"{home.where()} {error}") from error
    try:
        remarks += tuple(_ZEROS.oddities("zeros", zeros))
    except InputError as error:
        raise InputError(f"{encoders.where()} {error}") from error
    if zeros and len(zeros) != parameters.count:
        raise InputError(f"{encoders.where('zeros')} has {len(zeros)} values; give one for each arm")
    if uncertainty is not None:
        try:
            uncertainty.check(parameters)
        except InputError as error:
            raise InputError(f"{uncertain.where()} {error}") from error
    return Model(path.stem, path, title, parameters, sources, text, zeros, uncertainty, remarks)


def _three_body(table: Table, title: str, text: str, path: Path) -> Model:
    primaries = table.table("primaries", required=True)
    source, ratio = primaries.text("source"), primaries.number("mass_ratio")
    for part in (table, primaries):
        part.finish()
    parameters = primaries.checked(ThreeBodyParameters, mass_ratio=ratio)
    return Model(path.stem, path, title, parameters, {"primaries": source}, text)


def model_text(found: "Identification", *, title: str, logs: Sequence[str], starting_model: str) -> str:
    """Return the TOML text of what was identified from `logs`, started at the model of that name."""
    arms, count = found.arms, len(ratio_names(found.arms))
    left = np.array([s.rms for s in found.segments if not s.used])
    # A comment ends with its line, whatever a file is called.
    of = _plain(f"Identified from {', '.join(logs)}")
    starting_model = _plain(starting_model)
    known = np.isfinite(np.diag(found.covariance)[:count])
    # A file of numbers has no infinity: what the data do not see is not varied.
    covariance = np.where(np.outer(known, known), found.covariance[:count, :count], 0.0)
    lines = [
        _first_line(logs, starting_model),
        f"# {len(left)} segments were left out; their rms is {1e3 * np.median(left):.2f} mrad in the median, "
        f"{1e3 * left.max():.2f} at worst.",
        "# What the recordings do not determine:",
        *(f"#   {sentence}" for sentence in found.undetermined),
        f"title = {quoted(title)}",
        'system = "arm-chain"',
        "",
        "[arms]   # the nearest to the starting model's with the identified ratios",
        f"source = {quoted(f'{of}: only ratios to {unit_name(arms.count)}; the rest as in {starting_model}')}",
        *(f"{name} = {_numbers(getattr(arms, name))}" for name in ("mass", "centre_of_mass", "length", "inertia")),
        "",
        "[gravity]",
        f"source = {quoted(f'Taken from the model {starting_model}; a clamped cart does not determine it')}",
        f"acceleration = {arms.gravity!r}",
        "",
        "[friction]",
        f"source = {quoted(f'{of}; laws chosen by the error on segments left out')}",
        f"viscous = {_numbers(arms.viscous)}   # N m s/rad",
    ]
    units = {"coulomb": "N m", "quadratic": "N s²/m², of the air, at each arm's centre of oscillation"}
    lines += [f"{law} = {_numbers(getattr(arms, law))}   # {units[law]}" for law in arms.friction]
    if arms.friction:
        lines.append(f"smoothing = {arms.smoothing!r}   # rad/s")
    if "zeros" in found.candidates[found.chosen].terms:
        lines += [
            "",
            "[encoders]   # what recorded absolute angles show where the true ones are zero",
            f"source = {quoted(of)}",
            f"zeros = {_numbers(found.zeros.mean(axis=0))}   # rad",
        ]
    lines += [
        "",
        "[uncertainty]   # covariance of the ratios, row by row; what is not determined is not varied",
        f"source = {quoted(f'{of}; residuals taken as alike over blocks')}",
        "names = [" + ", ".join(quoted(name) for name in found.names[:count]) + "]",
        "covariance = [",
        *("    " + ", ".join(repr(float(v)) for v in row) + "," for row in covariance),
        "]",
        "",
    ]
    return "\n".join(lines)


def _first_line(logs: Sequence[str], starting_model: str) -> str:
    return _plain(f"# Identified from {', '.join(logs)}, starting at the model {starting_model}.")


def check_model_replaced(path: Path, *, logs: Sequence[str], starting_model: str, force: bool = False) -> None:
    """Reject a file in the place of a model to identify, unless it was identified from the same logs.

    Raises:
        InputError: there is another file.
    """
    if not force and path.is_file():
        first = path.read_text(encoding="utf-8", errors="replace").partition("\n")[0]
        if first != _first_line(logs, starting_model):
            raise in_the_way(path, "was not identified from these logs")


def write_model(found: "Identification", path: Path, *, title: str, logs: Sequence[str], starting_model: str) -> Path:
    """Write what was identified as a model file and return its path.

    Raises:
        InputError: the file cannot be written.
    """
    write_whole(path, model_text(found, title=title, logs=logs, starting_model=starting_model))
    return path


def quoted(text: str) -> str:
    """Return text as TOML writes it, on one line."""
    return '"' + _plain(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
