"""Model files: a pendulum's parameters with their sources, from TOML.

A model file of identified arms gives the source and the uncertainty of each number.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from decimal import Decimal
from fractions import Fraction
from functools import cache, cached_property, partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from dpcontrol.dynamics.plant import cart_force
from dpcontrol.dynamics.system import System, ThreeBodyParameters, three_body_system
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.checked import Between, checked, numbers
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError, remark
from dpcontrol.foundation.files import in_the_way, write_whole
from dpcontrol.foundation.settings import Leaf, Setting, leaves_of
from dpcontrol.foundation.shipped import find
from dpcontrol.foundation.toml import Choice, Place, Table, parse_toml, read_toml, with_values
from dpcontrol.orbits.lyapunov import Equilibrium, equilibrium
from dpcontrol.plans.robots import ENDINGS, Robot, load_robot

if TYPE_CHECKING:
    from dpcontrol.bifurcations.links import Quantity
    from dpcontrol.identification.identify import Identification


@dataclass(frozen=True)
class Model:
    """A model as its file gives it: title, parameters, the source of each table, and the text.

    Attributes:
        encoder_zeros: recorded absolute angles (n,) at true zero, rad, if the file gives them.
        uncertainty: uncertainty of identified arms.
        remarks: sentences on unusual numbers.
        differences: sentences on the angles and the cart of a robot, and on what the model leaves out or replaces.
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
    differences: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<model {self.name!r}: {self.title}>"

    @cached_property
    def system(self) -> "ModelSystem":
        """The conservative system of orbits and tubes, which for arms has no friction and a fixed pivot."""
        if isinstance(self.parameters, ThreeBodyParameters):
            system = three_body_system(self.name, self.parameters)
        else:
            system = pendulum_system(self.name, self.parameters)
        return ModelSystem(**{f.name: getattr(system, f.name) for f in fields(system)}, model=self)

    @checked
    def unit(self, name: str, form: str = " {}") -> str:
        """Return a unit of SI as a suffix of numbers, "" for three bodies, whose units are dimensionless.

        Args:
            name: unit, such as "J".
            form: format of the suffix, by default a space and the unit.
        """
        return "" if isinstance(self.parameters, ThreeBodyParameters) else form.format(name)

    @cached_property
    def decimals(self) -> dict[str, tuple[Fraction, ...]]:
        """The parameters exactly as the file's decimals, by field.

        A parameter that was changed after reading is the shortest decimal that reads as its double.
        """
        table, decimals = tomllib.loads(self.text, parse_float=Decimal), {}
        file_values = {**table.get("arms", {}), **table.get("friction", {}), **table.get("primaries", {})}
        file_values["gravity"] = table.get("gravity", {}).get("acceleration")
        for field in fields(self.parameters):
            numbers = [float(v) for v in np.atleast_1d(getattr(self.parameters, field.name))]
            file_value = file_values.get(field.name, [])
            file_decimals = [
                Fraction(v) for v in (file_value if isinstance(file_value, list) else [file_value]) if v is not None
            ]
            unchanged = [float(v) for v in file_decimals] == numbers
            decimals[field.name] = tuple(file_decimals if unchanged else [Fraction(repr(v)) for v in numbers])
        return decimals

    @property
    def exact_parameters(self) -> Sequence[Fraction]:
        """The equations' parameters for exact arithmetic, from the file's decimals."""
        if isinstance(self.parameters, ArmChainParameters):
            return self.parameters.viscous_only().decimal_base(self.decimals)
        return self.decimals["mass_ratio"]

    @property
    def arms(self) -> ArmChainParameters:
        """The arms' parameters, if there are arms.

        Raises:
            InputError: the model is not a pendulum.
        """
        if not isinstance(self.parameters, ArmChainParameters):
            raise InputError(f"{self.path}: {self.title} has no arms and no cart; choose a model of arms, such as lab")
        return self.parameters

    @checked
    def force(
        self,
        state: Sequence[float] | Array,
        acceleration: float,
        *,
        cart_mass: Annotated[float, Between(0)],
        cart_viscous: Annotated[float, Between(0)] = 0.0,
    ) -> float:
        """Return the force on the cart that gives it an acceleration, N.

        It includes the reaction of the moving arms. The force is a linear function of the acceleration.

        Args:
            state: angles (n,), rad, rates (n,), rad/s, and position and velocity of the cart, m and m/s.
            acceleration: acceleration of the cart, m/s².
            cart_mass: mass of the cart without the arms, kg.
            cart_viscous: friction of the cart, N s/m (default: 0).

        Raises:
            InputError: the model has no arms, or the state has another length.

        Examples:
            >>> dp.load_model("lab").force([0.0] * 6, 2.0, cart_mass=1.0)
            2.0...
        """
        return cart_force(
            self.arms,
            np.array(numbers("state", state, 2 * self.arms.count + 2)),
            acceleration,
            mass=cart_mass,
            drag=cart_viscous,
        )

    @property
    def identified_uncertainty(self) -> Uncertainty:
        """Covariance of the arms' ratios, as the model's file gives it.

        Raises:
            InputError: the file does not give it.
        """
        if self.uncertainty is None:
            raise InputError(
                f"{self.path} has no [uncertainty] to draw from; identify the model from recordings, or use a mismatch"
            )
        return self.uncertainty


@dataclass(frozen=True, kw_only=True)
class ModelSystem(System):
    """The conservative system of a model, linked to the model."""

    model: Model


def model_of(system: System) -> Model:
    """Return the model from which a conservative system was made.

    Args:
        system: system that was made from a model.

    Raises:
        InputError: the system was made without a model.
    """
    if not isinstance(system, ModelSystem):
        raise InputError(f"{system.name} has no arms and no cart: start from a model of arms, such as lab")
    return system.model


def parameter_course(
    model: Model,
    parameter: tuple[str, float, float],
    energy: float,
    saddles: Sequence[str] = (),
) -> "Quantity":
    """Return the values of a parameter of a model, over which connections are followed.

    Args:
        model: model with all other parameters.
        parameter: its name as in `named`, lowest and highest value.
        energy: energy at every value, J.
        saddles: saddles above the highest of which this energy is counted (default: none).

    Raises:
        InputError: an unknown parameter, a value out of range, or one without effect.
    """

    name, low, high = parameter

    @cache
    def at(value: float) -> tuple[System, float]:
        """Return the system with a value of the parameter, and the energy at which connections are followed, J."""
        system = replace(model, parameters=model.parameters.with_value(name, value)).system
        return system, energy + max((equilibrium(system, saddle).energy for saddle in saddles), default=0.0)

    # Friction is among the parameters of the equations, but not in the motion.
    rates = [at(value)[0].numeric.rate(0.3 * model.system.scale) for value in (low, high)]
    if low < high and np.array_equal(rates[0], rates[1]):
        raise InputError(
            f"{name} from {low:g} to {high:g}: the motion without friction does not depend on it; choose two values of "
            "a parameter of inertia or gravity"
        )
    unit = model.parameters.named()[name][1]
    unit = "" if unit == "1" else f" {unit}"
    from dpcontrol.bifurcations.links import Quantity

    return Quantity(model.system, name, f"values of {name}", unit, max(abs(low), abs(high)), at)


_INVISIBLE = 1e-6
"""Smallest singular value of an observable pair, well above the rounding of eigenvalues."""


@dataclass(frozen=True)
class ModelDescription(Documented):
    """A model with its frictionless equilibria, the pivot at rest.

    Attributes:
        model: the described model.
        equilibria: by name.
        mjcf: file of MuJoCo that was written, if any.
        file: model file that was written, if any.
    """

    KEYS = (
        "model=model.name title=model.title parameters sources=model.sources remarks=model.remarks "
        "differences=model.differences mjcf file "
        "equilibria=rows:state,energy,eigenvalues,kind,need,spare_encoders"
    )

    model: Model
    equilibria: Mapping[str, Equilibrium]
    mjcf: Path | None = None
    file: Path | None = None

    def need(self, name: str) -> float | None:
        """Return the feedback that an equilibrium needs, m/s² per rad; None if it is stable or has no arms.

        Args:
            name: name of the equilibrium.
        """
        arms = self.model.parameters
        return arms.need(self.equilibria[name].state[: arms.count]) if isinstance(arms, ArmChainParameters) else None

    def spare_encoders(self, name: str) -> list[int]:
        """Return the arms, from 1, without whose encoder a filter can observe the motion about an equilibrium.

        By the test of Popov, Belevitch and Hautus, no eigenvector of the linearised arms may be invisible in the other
        angles. Time is in units of the fastest eigenvalue. The cart's position shows nothing of the arms, because they
        follow its acceleration, which is the input.

        Args:
            name: name of the equilibrium.
        """
        if not isinstance(arms := self.model.parameters, ArmChainParameters):
            return []
        n, equilibrium = arms.count, self.equilibria[name]
        fastest_rate = np.abs(equilibrium.eigenvalues).max()
        units = np.repeat([1.0, fastest_rate], n)
        scaled_jacobian = self.model.system.numeric.jacobian(equilibrium.state) * units / units[:, None] / fastest_rate
        pencils = scaled_jacobian - (equilibrium.eigenvalues / fastest_rate)[:, None, None] * np.eye(2 * n)

        def visible(arm: int) -> bool:
            """Return True if every eigenvector shows in the angles of the other arms."""
            other_angles = np.delete(np.eye(n, 2 * n), arm, axis=0)
            stacked_pencils = [np.vstack([pencil, other_angles]) for pencil in pencils]
            return bool(np.linalg.svd(stacked_pencils, compute_uv=False)[:, -1].min() > _INVISIBLE)

        return [arm + 1 for arm in range(n) if visible(arm)]

    @property
    def rows(self) -> dict[str, tuple[Any, ...]]:
        """State, energy, eigenvalues, kind, need and spare encoders of each equilibrium by name."""
        return {
            name: (
                equilibrium.state,
                equilibrium.energy,
                equilibrium.eigenvalues,
                equilibrium.kind,
                self.need(name),
                self.spare_encoders(name),
            )
            for name, equilibrium in self.equilibria.items()
        }

    @property
    def parameters(self) -> dict[str, Any]:
        """Value and unit of each parameter."""
        named = self.model.parameters.named().items()
        return {name: {"value": value, "unit": unit} for name, (value, unit) in named}


@checked
def load_model(name: str | Path) -> Model:
    """Read and check a model of arms or of three bodies.

    Args:
        name: name of a shipped model or of one in ./models, path of a TOML file, or path of a robot's description in
            URDF or MJCF (`.urdf`, `.xml`).

    Returns:
        The model. Unusual numbers in its file give a remark. A robot gives one with the number of its `differences`.

    Raises:
        InputError: no such model, a mistake in its file, with table, key, value and allowed range, or a robot that is
            no planar chain of hinges on a slider or a fixed base.

    Examples:
        >>> dp.load_model("lab").arms.count
        2
    """
    path = find("models", str(name))
    if path.suffix.lower() in ENDINGS:
        robot = load_robot(path)
        text = _robot_text(robot, path)
        model = _model(parse_toml(text, str(path)), text, path)
        model = replace(model, differences=robot.differences)
        remark(f"{path}: the model differs from it in {len(model.differences)} points: see `dpcontrol model {path}`")
    else:
        document, text = read_toml(path)
        model = _model(document, text, path)
    for sentence in model.remarks:
        remark(f"{path}: {sentence}")
    return model


def model_from(text: str, name: str) -> Model:
    """Return the model that a text in TOML describes, as if it were a file of this name.

    Args:
        text: text of a TOML file.
        name: name of the model.

    Raises:
        InputError: a mistake in it.
    """
    file = Path(f"{name}.toml")
    return _model(parse_toml(text, str(file)), text, file)


_ARMS, _BODIES = leaves_of(ArmChainParameters), leaves_of(ThreeBodyParameters)
"""Parameters, whose declarations the tables of a file share."""


def _sourced(*leaves: Leaf, required: bool = True) -> Table:
    """Return the table of a model's file that holds these settings and the required source of their numbers."""
    source = Leaf("source", Annotated[str, Setting(help="Source of the numbers.")], MISSING)
    return Table({leaf.name: leaf for leaf in (source, *leaves)}, required=required)


def _file(system: str, default: Any, tables: Mapping[str, Table]) -> Table:
    """Return the table that a model's file has as a whole: title, system and the `tables` of this kind of system.

    `default` is the system if the file names none, or `MISSING` if it must name one.
    """
    choice = Setting(choices=(system,), help="System that the parameters belong to.")
    title = Leaf("title", Annotated[str, Setting(help="Title of pages and logs.")], MISSING)
    return Table({"title": title, "system": Leaf("system", Annotated[str, choice], default), **tables})


_INERTIAL = ("mass", "centre_of_mass", "length", "inertia")
_SHOWN_ZEROS = Setting(unit="rad", usual=(0.0, 2 * np.pi), help="Recorded angles at which the true ones are zero.")
FILE = Choice(
    {
        "arm-chain": _file(
            "arm-chain",
            "arm-chain",
            {
                "arms": _sourced(*(_ARMS[name] for name in _INERTIAL)),
                "gravity": _sourced(replace(_ARMS["gravity"], name="acceleration")),
                "friction": _sourced(*(_ARMS[name] for name in ("viscous", "coulomb", "quadratic", "smoothing"))),
                "encoders": _sourced(
                    Leaf("zeros", Annotated[tuple[float, ...], _SHOWN_ZEROS], MISSING), required=False
                ),
                "uncertainty": _sourced(
                    Leaf("names", Annotated[tuple[str, ...], Setting(help="Names of the ratios.")], MISSING),
                    Leaf("covariance", Annotated[tuple[float, ...], Setting(help="Covariance, row by row.")], MISSING),
                    required=False,
                ),
            },
        ),
        "three-body": _file("three-body", MISSING, {"primaries": _sourced(_BODIES["mass_ratio"])}),
    },
    lambda values: values.get("system", "arm-chain"),
    key="system",
)
"""The file of a model."""


def _model(document: Mapping[str, Any], text: str, path: Path) -> Model:
    """Return the model that a file's parsed contents describe, with its text and the path for messages.

    Raises:
        InputError: names every mistake.
    """
    file_place = Place(str(path))
    values = FILE.read(document, file_place)
    sources = {name: table["source"] for name, table in values.items() if isinstance(table, dict)}
    model = partial(Model, path.stem, path, values["title"], sources=sources, text=text)
    if "primaries" in values:
        return model(parameters=ThreeBodyParameters(mass_ratio=values["primaries"]["mass_ratio"]))
    arm_values = {key: values["arms"][key] for key in _INERTIAL}
    friction = {key: value for key, value in values["friction"].items() if key != "source"}
    if "smoothing" in friction and not any(friction.get(law.value) for law in Friction):
        nothing = "there is neither coulomb nor quadratic friction to smooth; give one or leave it out"
        raise replace(file_place, table="friction").refusal(f"smoothing: {nothing}", "smoothing")
    try:
        chain = ArmChainParameters(**arm_values, gravity=values["gravity"]["acceleration"], **friction)
        remarks = oddities(chain)
    except InputError as error:
        key = error.errors[0].key
        table = "gravity" if key == "acceleration" else "friction" if key in friction else "arms"
        raise error.under(f"{file_place} [{table}] ", table=table) from error
    zeros = values.get("encoders", {}).get("zeros", ())
    with replace(file_place, table="encoders"):
        remarks += tuple(_SHOWN_ZEROS.oddities("zeros", zeros))
        if zeros and len(zeros) != chain.count:
            raise InputError(f"zeros has {len(zeros)} values; give one for each arm", key="zeros")
    uncertainty = None
    if "uncertainty" in values:
        uncertainty = Uncertainty(values["uncertainty"]["names"], values["uncertainty"]["covariance"])
        with replace(file_place, table="uncertainty"):
            uncertainty.check(chain)
    return model(parameters=chain, encoder_zeros=zeros, uncertainty=uncertainty, remarks=remarks)


def _robot_text(robot: Robot, path: Path) -> str:
    """Return the TOML text of a robot's arms, so that a robot is read, shown and hashed like any other model file.

    It begins with the differences from the robot's description, as comments.
    """
    source = f"source = {quoted(f'{path.name}, compiled by MuJoCo')}"
    lines_by_name = {name: f"{name} = {_numbers(column)}" for name, column in robot.columns.items()}
    if not any(robot.columns["coulomb"]):
        del lines_by_name["coulomb"]
    lines = [
        *(f"# {_plain(sentence)}" for sentence in robot.differences),
        f"title = {quoted(path.stem)}",
        *("", "[arms]", source, *(lines_by_name.pop(name) for name in _INERTIAL)),
        *("", "[gravity]", source, f"acceleration = {robot.gravity!r}"),
        *("", "[friction]", source, *lines_by_name.values(), ""),
    ]
    return "\n".join(lines)


def model_text(identification: "Identification", *, title: str, logs: Sequence[str], starting_model: str) -> str:
    """Return the text of a model file with identified arms, the source of each number and its uncertainty.

    Args:
        identification: result of the identification.
        title: title of the model.
        logs: names of the recordings.
        starting_model: name of the model that was the first guess.
    """
    arms, count = identification.arms, len(ratio_names(identification.arms))
    unused = np.array([s.rms for s in identification.segments if not s.used])
    # Control characters in a file's name must not end the comment.
    origin = _plain(f"Identified from {', '.join(logs)}")
    starting_model = _plain(starting_model)
    determined = np.isfinite(np.diag(identification.covariance)[:count])
    # A TOML file of numbers has no infinity: undetermined ratios are not varied.
    covariance = np.where(np.outer(determined, determined), identification.covariance[:count, :count], 0.0)
    lines = [
        _first_line(logs, starting_model),
        f"# {len(unused)} segments were left out; their rms is {1e3 * np.median(unused):.2f} mrad in the median, "
        f"{1e3 * unused.max():.2f} at worst.",
        "# What the recordings do not determine:",
        *(f"#   {sentence}" for sentence in identification.undetermined),
        f"title = {quoted(title)}",
        'system = "arm-chain"',
        "",
        "[arms]   # the nearest to the starting model's with the identified ratios",
        f"source = {quoted(f'{origin}: only ratios to {unit_name(arms.count)}; the rest as in {starting_model}')}",
        *(f"{name} = {_numbers(getattr(arms, name))}" for name in _INERTIAL),
        "",
        "[gravity]",
        f"source = {quoted(f'Taken from the model {starting_model}; a clamped cart does not determine it')}",
        f"acceleration = {arms.gravity!r}",
        "",
        "[friction]",
        f"source = {quoted(f'{origin}; laws chosen by the error on segments left out')}",
        f"viscous = {_numbers(arms.viscous)}   # N m s/rad",
    ]
    units = {"coulomb": "N m", "quadratic": "N s²/m², of the air, at each arm's centre of oscillation"}
    lines += [f"{law} = {_numbers(getattr(arms, law))}   # {units[law]}" for law in arms.friction]
    if arms.friction:
        lines.append(f"smoothing = {arms.smoothing!r}   # rad/s")
    if "zeros" in identification.candidates[identification.chosen].terms:
        lines += [
            "",
            "[encoders]   # recorded absolute angles at true zero",
            f"source = {quoted(origin)}",
            f"zeros = {_numbers(identification.zeros.mean(axis=0))}   # rad",
        ]
    lines += [
        "",
        "[uncertainty]   # covariance of the ratios, row by row; undetermined ratios are not varied",
        f"source = {quoted(f'{origin}; equal residuals assumed over blocks')}",
        "names = [" + ", ".join(quoted(name) for name in identification.names[:count]) + "]",
        "covariance = [",
        *("    " + ", ".join(repr(float(v)) for v in row) + "," for row in covariance),
        "]",
        "",
    ]
    return "\n".join(lines)


def learnt_text(model: Model, arms: ArmChainParameters, covariance: Array, logs: Sequence[str]) -> str:
    """Return the text of a model with the numbers of arms that were learnt from runs.

    Args:
        model: model of the runs.
        arms: learnt arms.
        covariance: covariance (f, f) of their ratios.
        logs: names of the logs.
    """
    source = f"Learnt from {', '.join(logs)}: only ratios to {unit_name(arms.count)}; the rest as in {model.name}"
    friction = ("viscous", *arms.friction, *(["smoothing"] if arms.friction else []))
    tables: dict[str, dict[str, Any]] = {
        "": {"title": f"{model.title}, learnt"},
        "arms": {"source": source, **{name: getattr(arms, name) for name in _INERTIAL}},
        "friction": {"source": source, **{name: getattr(arms, name) for name in friction}},
        "uncertainty": {"source": source, "names": ratio_names(arms), "covariance": covariance.ravel().tolist()},
    }
    text = f"{_first_line(logs, model.name)}\n{model.text}"
    return reduce(lambda text, table: with_values(text, table, tables[table]), tables, text)


def _first_line(logs: Sequence[str], starting_model: str) -> str:
    """Return the first line of a model file that was identified from logs, by which such a file is recognised later."""
    return _plain(f"# Identified from {', '.join(logs)}, starting at the model {starting_model}.")


def check_model_replaced(path: Path, *, logs: Sequence[str], starting_model: str, force: bool = False) -> None:
    """Reject a path at which there is a model file that was not identified from these logs, since writing destroys it.

    Args:
        path: file to write.
        logs: names of the recordings.
        starting_model: name of the model that was the first guess.
        force: True to accept any file, default False.

    Raises:
        InputError: there is another file.
    """
    if not force and path.is_file():
        first_line = path.read_text(encoding="utf-8", errors="replace").partition("\n")[0]
        if first_line != _first_line(logs, starting_model):
            raise in_the_way(path, "was not identified from these logs")


def write_model(
    identification: "Identification", path: Path, *, title: str, logs: Sequence[str], starting_model: str
) -> Path:
    """Write identified arms as a model file, and return its path.

    Args:
        identification: result of the identification.
        path: file to write.
        title: title of the model.
        logs: names of the recordings.
        starting_model: name of the model that was the first guess.

    Raises:
        InputError: the file cannot be written.
    """
    write_whole(path, model_text(identification, title=title, logs=logs, starting_model=starting_model))
    return path


def quoted(text: str) -> str:
    """Return any text as a TOML string on one line, with quotes.

    Args:
        text: any text.
    """
    return '"' + _plain(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _plain(text: str) -> str:
    """Return text without control characters, so that it cannot end the line of a TOML comment."""
    return "".join(c if c.isprintable() else " " for c in text)


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    """Return a TOML list of numbers with all their digits."""
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
