"""Random closed walks on random models, for tests of the prover."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpcontrol.dynamics.system import System
from dpcontrol.plans.model import model_from

LAB = {
    "mass": (0.0938439747983407, 0.137595970499412),
    "centre_of_mass": (0.108565214610396, 0.116779018445656),
    "length": (0.172719203817519, 0.2286),
    "inertia": (0.00043752942975691, 0.00126882939257741),
}
KINDS = ("lab", "rods", "point masses", "long arms", "three-body")


@dataclass(frozen=True)
class WalkCase:
    """A model's text and the arguments of `dpcontrol prove walk` after the model."""

    kind: str
    text: str
    arguments: tuple[str, ...]


def walk_case(seed: int) -> WalkCase:
    """Return a random closed walk on a random model.

    Masses, lengths and inertias vary about those of the lab's arms, uniform rods or point masses. Energies lie above a
    random saddle. One to four symbols have one to four wraps each.
    """
    random = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    if kind == "three-body":
        return _three_body(random)
    text = _arms(random, kind)
    system = model_from(text, "random").system
    levels = _levels(system)
    low, high, top = sorted(levels.values())[1:]
    first, second = sorted(("down-up", "up-down"), key=levels.__getitem__)
    which = ("first", "second", "both")[seed // len(KINDS) % 3]
    if which == "first":
        energy = low + random.uniform(0.05, 0.5) * (high - low)
    else:
        energy = high + random.uniform(0.05, 0.4) * (top - high)
    count = int(random.integers(1, 5))
    if which == "both":
        count = max(2, count - count % 2)
        symbols = [f"{first} > {second}", f"{second} > {first}"] * (count // 2)
    else:
        home = first if which == "first" else second
        symbols = [f"{home} {random.choice(['+', '-'])}" for _ in range(count)]
    return WalkCase(f"{kind}, {which}", text, _arguments(energy, symbols, random))


def _levels(system: System) -> dict[str, float]:
    return {name: float(system.numeric.hamiltonian(state)) for name, state in system.equilibria.items()}


def _arguments(energy: float, symbols: list[str], random: np.random.Generator) -> tuple[str, ...]:
    wraps = ",".join(str(int(n)) for n in random.integers(1, 5, len(symbols)))
    given = [part for symbol in symbols for part in ("-s", symbol)]
    return ("--energy", f"{energy:.6f}", *given, "--wraps", wraps, "--periodic")


def _arms(random: np.random.Generator, kind: str) -> str:
    factor = lambda: random.uniform(0.75, 1.33, 2)  # noqa: E731
    if kind == "lab":
        mass, centre, length, inertia = (np.array(LAB[key]) * factor() for key in LAB)
        centre = np.minimum(centre, length)
    else:
        size = random.uniform(1.0, 4.0) if kind == "long arms" else 1.0
        mass, length = 0.12 * factor() * size, 0.2 * factor() * size
        centre = length if kind == "point masses" else length / 2
        inertia = np.zeros(2) if kind == "point masses" else mass * length**2 / 12
    columns = {"mass": mass, "centre_of_mass": centre, "length": length, "inertia": inertia}
    rows = [f"{key} = [{', '.join(f'{v:.17e}' for v in column)}]" for key, column in columns.items()]
    return "\n".join(
        [
            'title = "Random arms"', 'system = "arm-chain"', "[arms]", 'source = "random"', *rows,
            "[gravity]", 'source = "standard"', "acceleration = 9.80665",
            "[friction]", 'source = "none"', "viscous = [0.0, 0.0]", "",
        ]
    )  # fmt: skip


def _three_body(random: np.random.Generator) -> WalkCase:
    ratio = 9.537e-4 * random.uniform(0.8, 1.3)
    text = "\n".join(
        [
            'title = "Random primaries"', 'system = "three-body"', "[primaries]", 'source = "random"',
            f"mass_ratio = {ratio:.6e}", "",
        ]
    )  # fmt: skip
    system = model_from(text, "random").system
    level = _levels(system)["L2"]
    symbols = ["L1 > L2", "L2 > L1"] * int(random.integers(1, 3))
    return WalkCase("three-body", text, _arguments(level + random.uniform(2e-3, 5e-3), symbols, random))


def write(case: WalkCase, folder: Path) -> Path:
    """Write a case's model to a file."""
    file = folder / "random-model.toml"
    file.write_text(case.text, encoding="utf-8")
    return file
