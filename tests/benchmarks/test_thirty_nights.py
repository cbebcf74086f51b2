"""Nights on varied itineraries: none ends early, none exceeds its limits, and forecasts are close.

Arms, itineraries, energies, rigs and blows are drawn from a seed. Each night is a separate program with an existing
plan, and plans its flights while it runs. Thirty nights of 0.05 h take an hour of two idle cores.
"""

import json
import math
import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import PROGRAM, dpcontrol_program
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


@dataclass
class NightFound:
    """Result of a night. begun, took: s to its first file and in all; forecast: s, as printed."""

    fails: list[str]
    begun: float
    took: float
    forecast: float = math.nan


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


def flown_night(seed: int, folder: Path, *, hours: float) -> NightFound | None:
    """Plan a scene and run its night in a folder; None if the itinerary is refused or has no reference."""
    model, itinerary, options = drawn_night(seed)
    folder.mkdir()
    (folder / "arms.toml").write_text(model)
    (folder / "scene.toml").write_text(itinerary)
    if dpcontrol_program("plan", "scene.toml", "--out", "plan.npz", folder=folder).code:
        return None
    began = time.monotonic()
    words = [PROGRAM, "run", "plan.npz", "--hours", str(hours), *options, "--out", "night.mcap"]
    with subprocess.Popen(
        [*map(str, words)], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    ) as process:
        while process.poll() is None and not [*folder.glob("night/*.mcap*")]:
            time.sleep(0.05)
        begun = time.monotonic() - began
        _, told = process.communicate()
    found = NightFound([], begun, time.monotonic() - began)
    if process.returncode:
        found.fails.append(told.strip().splitlines()[-1])
        return found
    stated = re.search(r"will take about ([\d.,]+) (seconds|minutes)", told)
    assert stated is not None
    found.forecast = float(stated[1]) * (60 if stated[2] == "minutes" else 1)
    document = dpcontrol_program("score", "night", "--json", folder=folder).document
    found.fails += [ending["text"] for ending in document["endings"]]
    if document["hours"] < hours - 1.0 / 3600:
        found.fails.append(f"only {document['hours']:.4f} h")
    if document["stop_hits"]:
        found.fails.append("hit a stop")
    return found


@pytest.mark.benchmark
def test_nights_on_varied_scenes_are_whole(tmp_path: Path) -> None:
    found: list[NightFound] = []
    for seed in range(100):
        one = flown_night(seed, tmp_path / str(seed), hours=HOURS)
        sys.stdout.write(f"{seed}: {'refused' if one is None else f'{one}'}\n")
        found += [] if one is None else [one]
        if len(found) == NIGHTS:
            break
    assert len(found) == NIGHTS
    assert [one.fails for one in found if one.fails] == []
