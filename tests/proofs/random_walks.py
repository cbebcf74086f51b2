"""Random closed walks on random models, for tests of the prover.

As a program, this module proves walks on the command line and appends one line of JSON for each to a file. Walks in the
file are not repeated:

    python tests/proofs/random_walks.py walks.jsonl 0 40
    python tests/proofs/random_walks.py open.jsonl 0 40 open
"""

import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
NARROW = 20
"""From this seed on, arms and energies vary more, and walks change saddles at random."""
MOST_SECONDS = 300.0
"""Processor time for one walk, as required."""


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
    if seed >= NARROW:
        return _broad(random, kind)
    text = _arms(random, kind, 1.33)
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


def _broad(random: np.random.Generator, kind: str) -> WalkCase:
    """Return a walk of one to four symbols between the saddles that the energy allows."""
    text = _arms(random, kind, 2.0)
    levels = _levels(model_from(text, "random").system)
    low, high, top = sorted(levels.values())[1:]
    names = sorted(("down-up", "up-down"), key=levels.__getitem__)
    both = bool(random.integers(2))
    share = random.uniform(0.02, 0.8)
    energy = high + share * (top - high) if both else low + share * (high - low)
    first = here = names[int(random.integers(2)) if both else 0]
    symbols = []
    for left in reversed(range(int(random.integers(1, 5)))):
        # The last symbol returns to the first saddle.
        there = first if left == 0 else names[int(random.integers(2)) if both else 0]
        symbols.append(f"{here} {random.choice(['+', '-'])}" if here == there else f"{here} > {there}")
        here = there
    return WalkCase(f"{kind}, broad", text, _arguments(energy, symbols, random))


def _levels(system: System) -> dict[str, float]:
    return {name: float(system.numeric.hamiltonian(state)) for name, state in system.equilibria.items()}


def _arguments(energy: float, symbols: list[str], random: np.random.Generator) -> tuple[str, ...]:
    wraps = ",".join(str(int(n)) for n in random.integers(1, 5, len(symbols)))
    given = [part for symbol in symbols for part in ("-s", symbol)]
    return ("--energy", f"{energy:.6f}", *given, "--wraps", wraps, "--periodic")


def _arms(random: np.random.Generator, kind: str, most: float) -> str:
    least = 0.75 if most == 1.33 else 1 / most
    factor = lambda: random.uniform(least, most, 2)  # noqa: E731
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


def opened(case: WalkCase) -> WalkCase:
    """Return a closed walk's case as an open walk, which has a stop less."""
    *arguments, _, wraps, _ = case.arguments
    stops = wraps.split(",")[:-1]
    return replace(case, arguments=(*arguments, *(("--wraps", ",".join(stops)) if stops else ())))


def write(case: WalkCase, folder: Path) -> Path:
    """Write a case's model to a file."""
    file = folder / "random-model.toml"
    file.write_text(case.text, encoding="utf-8")
    return file


def proved(seed: int, file: Path, *, closed: bool = True) -> dict[str, Any]:
    """Return the verdict on a walk, its message and the processor time of `dpcontrol prove walk`."""
    case = walk_case(seed) if closed else opened(walk_case(seed))
    before = _spent()
    with tempfile.TemporaryDirectory() as folder:
        line = ["prove", "walk", str(write(case, Path(folder))), *case.arguments, "--yes", "--json"]
        ended = subprocess.run([PROGRAM, *line], capture_output=True, text=True, check=False, preexec_fn=_limit)
    answer = json.loads(ended.stdout) if ended.stdout else {}
    status = answer.get("status") or (ended.stderr.strip().splitlines() or ["killed"])[-1]
    found = {"seed": seed, "model": case.kind, "arguments": case.arguments, "code": ended.returncode, "status": status}
    found |= {"cpu": round(_spent() - before, 1), "nodes": answer.get("nodes"), "steps": answer.get("steps")}
    with file.open("a", encoding="utf-8") as results:
        results.write(json.dumps(found) + "\n")
    return found


PROGRAM = Path(sys.executable).parent / "dpcontrol"


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(MOST_SECONDS), int(MOST_SECONDS) + 5))


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read(file: Path) -> list[dict[str, Any]]:
    """Return the verdicts in a file."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def summary(lines: Iterable[dict[str, Any]]) -> str:
    """Return a table of verdicts and their totals."""
    rows = sorted(lines, key=lambda one: one["seed"])
    good = [one["cpu"] for one in rows if one["code"] == 0]
    shown = [f"{one['seed']:>4} {one['model']:<20} {one['cpu']:>6.1f} s  {one['status']}" for one in rows]
    times = f"median {np.median(good):.0f} s, longest {max(good):.0f} s of processor time" if good else ""
    return "\n".join([*shown, f"{len(good)} of {len(rows)} proved; {times}"])


def main() -> None:
    """Prove the walks that a file lacks, and print a table of all of them."""
    file, first, last = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    done = {one["seed"] for one in read(file)}
    for seed in range(first, last):
        if seed not in done:
            proved(seed, file, closed="open" not in sys.argv[4:])
    sys.stdout.write(summary(read(file)) + "\n")


if __name__ == "__main__":
    main()
