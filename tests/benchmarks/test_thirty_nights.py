"""Nights on varied itineraries: none ends early, and none hits a stop.

Arms, itineraries, energies, rigs and blows are drawn from a seed. Each night is a separate program with an existing
plan, and plans its flights while it runs. Thirty nights of 0.05 h take an hour of two idle cores.
"""

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol_program
from generated_scenes import Arms

from dpcontrol.plans.model import load_model
from dpcontrol.plans.overrides import typed

WALKS = (
    (-0.07, ("down-up +",), "orbit"),
    (-0.07, ("down-up -",), "rest"),
    (0.2, ("down-up > up-down",), "orbit"),
    (0.22, ("down-up +", "down-up > up-down"), "rest"),
    (0.2, ("up-down +",), "orbit"),
    (0.24, ("down-up > up-down", "up-down > down-up"), "orbit"),
)
"""Energies (J), walks, and where they start and finish."""
NIGHTS, HOURS = 30, 0.05
LAB = load_model("lab").arms
OWN = 0.05
"""Share by which each number of the arms differs from scaled ones of the laboratory."""


def drawn_night(seed: int) -> tuple[str, str, list[str]]:
    """Return a model's and an itinerary's text, and options of the night."""
    random = np.random.default_rng([seed, 9])
    mass, length = (float(np.exp(random.uniform(np.log(low), np.log(high)))) for low, high in ((0.5, 2), (0.7, 1.4)))
    scales = {"mass": mass, "centre_of_mass": length, "length": length, "inertia": mass * length**2}
    own = {
        name: tuple(scale * value * random.uniform(1 - OWN, 1 + OWN) for value in getattr(LAB, name))
        for name, scale in scales.items()
    }
    viscous = tuple(mass * length**1.5 * value for value in LAB.viscous)
    arms = Arms(**own, viscous=viscous, coulomb=(0.0, 0.0), smoothing=0.0)
    energy, walk, ends = WALKS[int(random.integers(len(WALKS)))]
    height = mass * length
    wraps = [int(count) for count in random.integers(0, 3, len(walk) - 1)]
    itinerary = [
        'model = "arms.toml"', f"energy = {(energy + 0.01 * random.uniform()) * height:.6f}",
        f"walk = {json.dumps(list(walk))}", f"wraps = {wraps}", f'start = "{ends}"', f'finish = "{ends}"',
        "[limits]", f"position = {0.4 * length:.4f}", f"velocity = {3 * math.sqrt(length):.4f}", "acceleration = 30.0",
    ]  # fmt: skip
    values = {
        "mismatch": random.uniform(0.01, 0.05), "lag": random.uniform(0.001, 0.006),
        "command_noise": random.uniform(0.1, 0.5), "zero_error": random.uniform(0.002, 0.01),
        "knocks_per_minute": random.uniform(2, 10), "knock_impulse": random.uniform(0.01, 0.03) * mass * length**1.5,
        "travel": 0.8 * length,
    }  # fmt: skip
    options = shlex.split(typed({name: float(f"{value:.4g}") for name, value in values.items()}))
    return arms.text("Drawn arms", coulomb=False), "\n".join(itinerary) + "\n", [*options, "--seed", str(seed)]


def flown_night(seed: int, folder: Path, *, hours: float) -> list[str] | None:
    """Plan a scene, run its night in a folder and return its failures; None if it is refused or has no reference."""
    model, itinerary, options = drawn_night(seed)
    folder.mkdir()
    (folder / "arms.toml").write_text(model)
    (folder / "scene.toml").write_text(itinerary)
    if dpcontrol_program("plan", "scene.toml", "--out", "plan.npz", folder=folder).code:
        return None
    words = ["run", "plan.npz", "--hours", str(hours), *options, "--out", "night.mcap"]
    ended = dpcontrol_program(*words, folder=folder)
    if ended.code:
        return [ended.message]
    document = dpcontrol_program("score", "night", "--json", folder=folder).document
    fails = [ending["text"] for ending in document["endings"]]
    if document["hours"] < hours - 1.0 / 3600:
        fails.append(f"only {document['hours']:.4f} h")
    if document["stop_hits"]:
        fails.append("hit a stop")
    return fails


@pytest.mark.benchmark
def test_nights_on_varied_scenes_are_whole(tmp_path: Path) -> None:
    found: list[list[str]] = []
    for seed in range(100):
        fails = flown_night(seed, tmp_path / str(seed), hours=HOURS)
        found += [] if fails is None else [fails]
        if len(found) == NIGHTS:
            break
    assert len(found) == NIGHTS
    assert [fails for fails in found if fails] == []
