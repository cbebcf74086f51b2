"""Generated scenes: models, itineraries and rigs drawn from the ranges that laboratories build.

Each scene is one model file, one itinerary file and, if the plant has friction that the model lacks, a plant file.
Everything is drawn from the scene's seed. Model, itinerary and rig have separate random streams, so a new rig setting
changes no model and no itinerary.

    python tests/benchmarks/generated_scenes.py 0 10 scenes      # write seeds 0 to 9
    dpcontrol run scenes/scene-0003.toml

Ranges, and the reasons for those that are not written below:

    arms          table-top rigs of printed plastic to a steel bar; encoders and bearings shift the centre of mass.
                  Viscous joints alone would let a swing decay over 5 s (bushings) to 200 s (small ball bearings).
                  Coulomb friction is up to 1.5 % of gravity's largest torque; the model lacks one third of these.

    walks         energies 3 to 50 % of the way from the highest visited saddle to upright. Three arms have none here:
                  their connections exist at isolated energies only.

    track         half of it is 1.2 to 2.5 times the arms' length; a plan uses 70 to 90 %. Velocity and acceleration
                  are those of belt drives.

    mechanics     encoder play of a gear or of a coupling; it is unknown if it is below 4 mrad. No model has stiction.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

GRAVITY = 9.81
MISMATCH = 0.05
MODEL, ITINERARY, RIG, MECHANICS = range(4)
"""Random streams of a seed."""


@dataclass(frozen=True)
class Arms:
    """The arms of a model: SI units, inner arm first."""

    mass: tuple[float, ...]
    centre_of_mass: tuple[float, ...]
    length: tuple[float, ...]
    inertia: tuple[float, ...]
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]
    smoothing: float

    @property
    def torques(self) -> tuple[float, ...]:
        """Gravity's largest torque on each arm, N m: with all outer arms carried at the arm's end."""
        count = len(self.mass)
        outer = [sum(self.mass[i + 1 :]) for i in range(count)]
        return tuple(
            GRAVITY * (self.mass[i] * self.centre_of_mass[i] + self.length[i] * outer[i]) for i in range(count)
        )

    def energy(self, place: str) -> float:
        """Return the energy of an equilibrium such as "up-down", J, zero at the pivot's height."""
        senses = [1 if part == "up" else -1 for part in place.split("-")]
        return sum(sense * torque for sense, torque in zip(senses, self.torques, strict=True))

    def text(self, title: str, *, coulomb: bool) -> str:
        """Return the model file; coulomb: whether it has the Coulomb friction."""
        source = 'source = "Drawn at random from the ranges that laboratories build"'
        lines = [
            f'title = "{title}"', 'system = "arm-chain"', "", "[arms]", source, f"mass = {list_text(self.mass)}",
            f"centre_of_mass = {list_text(self.centre_of_mass)}", f"length = {list_text(self.length)}",
            f"inertia = {list_text(self.inertia)}", "", "[gravity]", source, f"acceleration = {GRAVITY}", "",
            "[friction]", source, f"viscous = {list_text(self.viscous)}",
        ]  # fmt: skip
        if coulomb and any(self.coulomb):
            lines += [f"coulomb = {list_text(self.coulomb)}", f"smoothing = {self.smoothing:.4g}"]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Scene:
    """The texts of a scene's files; the plant's is often empty."""

    seed: int
    model: str
    plant: str
    itinerary: str
    kind: str = "scene"

    @property
    def name(self) -> str:
        """The file name without its suffix."""
        return f"{self.kind}-{self.seed:04d}"

    def write(self, folder: Path) -> Path:
        """Write the files and return the path of the itinerary."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{self.name}-model.toml").write_text(self.model)
        if self.plant:
            (folder / f"{self.name}-plant.toml").write_text(self.plant)
        path = folder / f"{self.name}.toml"
        path.write_text(self.itinerary)
        return path


def sampled_scene(seed: int) -> Scene:
    """Return the scene of a seed."""
    rng = np.random.default_rng([seed, MODEL])
    arms = _arms(rng)
    known = bool(rng.random() < 2 / 3)
    frictional = any(arms.coulomb)
    name = f"scene-{seed:04d}"
    rig = _rig(np.random.default_rng([seed, RIG])) + _mechanics(np.random.default_rng([seed, MECHANICS]), arms)
    lines, track = drawn_motion(np.random.default_rng([seed, ITINERARY]), arms)
    rig.append(f"travel = {track:.3f}")
    if frictional and not known:
        rig.append(f'plant = "{name}-plant.toml"')
    text = "\n".join([f'title = "Generated scene {seed}"', f'model = "{name}-model.toml"', *lines, "", "[run]", *rig])
    return Scene(
        seed,
        arms.text(f"Arms of generated scene {seed}", coulomb=known),
        arms.text(f"Plant of generated scene {seed}", coulomb=True) if frictional and not known else "",
        text + "\n",
    )


def list_text(values: Sequence[float]) -> str:
    """Return numbers as a list of TOML."""
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is distributed evenly."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _arms(rng: np.random.Generator) -> Arms:
    count = int(rng.choice([1, 2, 3], p=[0.14, 0.8, 0.06]))
    length = [log_uniform(rng, 0.1, 0.5) for _ in range(count)]
    mass = [one * log_uniform(rng, 0.3, 2.0) for one in length]
    centre = [one * rng.uniform(0.3, 0.7) for one in length]
    inertia = [m * one**2 / 12 * rng.uniform(0.7, 1.3) for m, one in zip(mass, length, strict=True)]
    viscous = []
    for i in range(count):
        # The inertia about joint i with all further arms in line; a swing decays over 2 I / b.
        reach, about = 0.0, 0.0
        for j in range(i, count):
            about += inertia[j] + mass[j] * (reach + centre[j]) ** 2
            reach += length[j]
        viscous.append(2 * about / log_uniform(rng, 5.0, 200.0))
    arms = Arms(tuple(mass), tuple(centre), tuple(length), tuple(inertia), tuple(viscous), (0.0,) * count, 0.0)
    frictional, smoothing = rng.random() >= 0.4, log_uniform(rng, 0.005, 0.5)
    coulomb = tuple(rng.uniform(0, 0.015) * torque for torque in arms.torques)
    if not frictional:
        return arms
    return Arms(arms.mass, arms.centre_of_mass, arms.length, arms.inertia, arms.viscous, coulomb, smoothing)


_UNSTABLE = {
    1: ("up",),
    2: ("down-up", "up-down", "up-up"),
    3: ("down-down-up", "down-up-down", "up-down-down", "down-up-up", "up-down-up", "up-up-down", "up-up-up"),
}
_SADDLES = ("down-up", "up-down")
_KINDS = {
    1: {"held": 0.4, "rest, hold, rest": 0.6},
    2: {
        "held": 0.12, "rest, hold, rest": 0.15, "holds": 0.08, "walk": 0.43, "parts": 0.12, "orbit": 0.05,
        "kept walk": 0.05,
    },
    3: {"held": 0.5, "rest, hold, rest": 0.5},
}  # fmt: skip


def drawn_motion(rng: np.random.Generator, arms: Arms) -> tuple[list[str], float]:
    """Return the lines of the itinerary, limits included, and half of the track, m."""
    count = len(arms.mass)
    track = float(np.clip(sum(arms.length) * rng.uniform(1.2, 2.5), 0.3, 1.0))
    limits = [
        "[limits]", f"position = {track * rng.uniform(0.7, 0.9):.3f}", f"velocity = {rng.uniform(2, 4):.2f}",
        f"acceleration = {rng.uniform(20, 40):.1f}",
    ]  # fmt: skip
    kinds = _KINDS[count]
    kind = str(rng.choice(list(kinds), p=list(kinds.values())))
    places = _UNSTABLE[count]
    symbols = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.25, 0.2, 0.2, 0.15, 0.1, 0.1]))
    ends = [str(end) for end in rng.choice(["rest", "orbit"], size=2)]
    controller: list[str] = []
    if kind == "held":
        lines = ['start = "hold"', *_hold(rng, places, 5, 20)]
    elif kind == "rest, hold, rest":
        lines = ['start = "rest"', 'finish = "rest"', *_hold(rng, places, 1, 3)]
    elif kind == "holds":
        parts = [line for _ in range(int(rng.integers(2, 4))) for line in ("[[parts]]", *_hold(rng, places, 1, 3))]
        lines = ['start = "rest"', 'finish = "rest"', *parts]
    elif kind == "orbit":
        saddle = str(rng.choice(_SADDLES))
        energy = f"energy = {_energy(rng, arms, [saddle]):.6g}"
        lines = [f'orbit = "{saddle}"', energy, f"seconds = {rng.uniform(5, 15):.1f}"]
    elif kind == "parts":
        symbols = max(symbols, 2)
        walks = [_walk(rng, arms, symbols // 2), _walk(rng, arms, symbols - symbols // 2)]
        hold = ["[[parts]]", *_hold(rng, places, 1, 3)]
        parts = [["[[parts]]", *walk] for walk in walks]
        parts.insert(int(rng.integers(0, 3)), hold)
        lines = ['start = "rest"', 'finish = "rest"', *(line for part in parts for line in part)]
    elif kind == "kept walk":
        lines = _walk(rng, arms, symbols)
        controller = ["[controller]", 'kind = "tvlqr"', 'keep = "tvlqr"']
    else:
        lines = [f'start = "{ends[0]}"', f'finish = "{ends[1]}"', *_walk(rng, arms, symbols)]
    return [*lines, "", *limits, *controller], track


def _hold(rng: np.random.Generator, places: Sequence[str], least: float, most: float) -> list[str]:
    return [f'hold = "{rng.choice(places)}"', f"seconds = {rng.uniform(least, most):.1f}"]


def _walk(rng: np.random.Generator, arms: Arms, count: int) -> list[str]:
    here, symbols, visited = str(rng.choice(_SADDLES)), [], []
    for _ in range(count):
        visited.append(here)
        step = rng.choice(["+", "-", ">"])
        if step == ">":
            there = next(saddle for saddle in _SADDLES if saddle != here)
            symbols.append(f"{here} > {there}")
            here = there
        else:
            symbols.append(f"{here} {step}")
    wraps = [int(n) for n in rng.integers(0, 5, size=count - 1)]
    quoted = ", ".join(f'"{symbol}"' for symbol in symbols)
    leads = [f"{name} = {rng.integers(1, 4)}" for name in ("lead_in", "lead_out")]
    return [f"energy = {_energy(rng, arms, [*visited, here]):.6g}", f"walk = [{quoted}]", f"wraps = {wraps}", *leads]


def _energy(rng: np.random.Generator, arms: Arms, visited: Sequence[str]) -> float:
    """Return an energy above all visited saddles, J."""
    lowest = max(arms.energy(saddle) for saddle in visited)
    return lowest + log_uniform(rng, 0.03, 0.5) * (arms.energy("up-up") - lowest)


def _rig(rng: np.random.Generator) -> list[str]:
    """Return the lines of [run]; the track belongs to the itinerary, whose plan needs its length."""
    rate = float(rng.choice([200, 250, 500, 1000, 2000], p=[0.1, 0.1, 0.25, 0.4, 0.15]))
    delay = float(rng.choice([0.0, 1.0, 2.0, 3.0, round(rng.uniform(0, 3), 2)]))
    lag = float(rng.choice([0.0, round(rng.uniform(0.001, 0.02), 4)], p=[0.3, 0.7]))
    known = bool(rng.random() < 0.5)
    counts = round(log_uniform(rng, 1e3, 4e4))
    resolution = log_uniform(rng, 1e-6, 2e-4)
    jitter = float(rng.choice([0.0, rng.uniform(0, min(1 / rate, 2e-3))], p=[2 / 3, 1 / 3]))
    noise = float(rng.choice([0.0, log_uniform(rng, 1e-4, 1e-3)], p=[2 / 3, 1 / 3]))
    return [
        f"rate = {rate:g}", f"delay = {delay:g}", f"lag = {lag:g}", f"drive_lag = {lag if known else 0.0:g}",
        f"counts = {counts}", f"cart_resolution = {resolution:.3g}", f"jitter = {jitter:.3g}",
        f"noise = {noise:.3g}", f"zero_error = {rng.uniform(0, 0.03):.4f}",
        f"command_noise = {rng.uniform(0, 0.5):.3f}", f"initial_error = {rng.uniform(0, 0.05):.4f}",
        f"mismatch = {MISMATCH}",
    ]  # fmt: skip


def _mechanics(rng: np.random.Generator, arms: Arms) -> list[str]:
    """Return the lines of [run] that describe belt, play, cable and stiction."""
    lines: list[str] = []
    with_belt, with_play, with_cable, with_stiction = rng.random(4) < [0.2, 1 / 3, 0.25, 0.25]
    belt, damping, measured = log_uniform(rng, 20, 100), rng.uniform(0.03, 0.1), rng.uniform(0.9, 1.1)
    scale = str(rng.choice(["motor", "cart"], p=[2 / 3, 1 / 3]))
    if with_belt:
        lines += [f"belt = {belt:.1f}", f"belt_damping = {damping:.3f}", f'belt_scale = "{scale}"']
        lines += [f"known_belt = {belt * measured:.1f}"]
    low, high = (5e-3, 2e-2) if rng.random() < 0.5 else (5e-4, 4e-3)
    play, measured = log_uniform(rng, low, high), rng.uniform(0.7, 1.3)
    if with_play:
        lines += [f"play = {play:.3g}", f"known_play = {play * measured if play > 4e-3 else 0:.3g}"]
    torque, turning = rng.uniform(-1, 1) * 0.005, rng.uniform(0, 1) * 0.005
    if with_cable:
        lines += [f"cable_torque = {torque * arms.torques[0]:.3g}"]
        lines += [f"cable_stiffness = {turning * arms.torques[0] / (2 * np.pi):.3g}"]
    share, kinetic = rng.uniform(0, 0.003), rng.uniform(0.6, 0.9)
    if with_stiction:
        lines += [f"stiction = {list_text([share * one for one in arms.torques])}", f"kinetic = {kinetic:.2f}"]
    return lines


if __name__ == "__main__":
    begin, scenes, target = sys.argv[1:]
    for number in range(int(begin), int(begin) + int(scenes)):
        sampled_scene(number).write(Path(target))
