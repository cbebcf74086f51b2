"""Ordinary laboratories: rigs that a workshop builds, drawn at random by seed.

    python tests/benchmarks/ordinary_labs.py 0 10 labs      # write seeds 0 to 9
    dpcontrol run labs/lab-0003.toml

Arms are bars, tubes, printed parts, or bars with a disc near the end. Each inner arm carries a hub with bearing and
encoder at its end. All masses follow from dimensions and densities. Itineraries are drawn like those of
`generated_scenes`. Half of the drive's lag is told to the controller, and half of the models know the dry friction.
"""

import sys
from pathlib import Path

import numpy as np
from generated_scenes import ITINERARY, MODEL, RIG, Arms, Scene, drawn_motion, log_uniform

MISMATCH = 0.05
STEEL, ALUMINIUM, PLASTIC = 7850.0, 2700.0, 1100.0
"""kg/m³."""


def _arm(rng: np.random.Generator, *, carries: bool) -> tuple[float, float, float, float]:
    """Return length, mass, centre of mass and inertia about it, of one arm of a kind drawn at random."""
    length = rng.uniform(0.12, 0.4)
    kind = str(rng.choice(["bar", "tube", "printed", "disc"]))
    width, thickness = rng.uniform(0.015, 0.03), rng.uniform(0.004, 0.01)
    density = STEEL if kind == "bar" and rng.random() < 0.3 else ALUMINIUM
    section = width * thickness
    if kind == "tube":
        radius, wall = rng.uniform(0.005, 0.012), rng.uniform(0.001, 0.002)
        section = np.pi * (radius**2 - (radius - wall) ** 2)
    if kind == "printed":
        density, section = PLASTIC * rng.uniform(0.4, 1.0), width * rng.uniform(0.008, 0.02)
    # The part overhangs its joints by the width on both sides.
    whole = length + 2 * width
    mass = density * section * whole
    points = [(mass, length / 2, mass * whole**2 / 12)]
    if kind == "disc":
        radius = rng.uniform(0.02, 0.04)
        weight = np.pi * radius**2 * rng.uniform(0.004, 0.01) * rng.choice([STEEL, ALUMINIUM])
        points.append((weight, length * rng.uniform(0.7, 1.0), weight * radius**2 / 2))
    if carries:
        hub = rng.uniform(0.02, 0.1)
        points.append((hub, length, hub * 0.015**2 / 2))
    total = sum(m for m, _, _ in points)
    centre = sum(m * x for m, x, _ in points) / total
    return length, total, centre, sum(inertia + m * (x - centre) ** 2 for m, x, inertia in points)


def sampled_lab(seed: int) -> Scene:
    """Return the laboratory of a seed."""
    rng = np.random.default_rng([seed, MODEL, 7])
    count = int(rng.choice([1, 2, 3], p=[0.12, 0.82, 0.06]))
    length, mass, centre, inertia = zip(*(_arm(rng, carries=i + 1 < count) for i in range(count)), strict=True)
    # Viscous torque of small ball bearings: alone, it would let a swing decay over 10 to 200 s.
    about = [
        sum(inertia[j] + mass[j] * (sum(length[i:j]) + centre[j]) ** 2 for j in range(i, count)) for i in range(count)
    ]
    viscous = tuple(2 * moment / log_uniform(rng, 10.0, 200.0) for moment in about)
    smooth = Arms(mass, centre, length, inertia, viscous, (0.0,) * count, log_uniform(rng, 0.01, 0.2))
    share, known = float(rng.uniform(0, 0.01)), bool(rng.random() < 0.5)
    coulomb = tuple(share * torque for torque in smooth.torques)
    arms = Arms(mass, centre, length, inertia, viscous, coulomb, smooth.smoothing)
    lines, track = drawn_motion(np.random.default_rng([seed, ITINERARY, 7]), arms)
    rng = np.random.default_rng([seed, RIG, 7])
    rate = float(rng.choice([250, 500, 1000, 2000]))
    lag = float(rng.choice([0.0, rng.uniform(0.001, 0.01)]))
    delay, jitter = float(rng.uniform(0.5, 2.0)), float(rng.uniform(0, 0.5)) / rate
    counts, resolution = round(log_uniform(rng, 2e3, 4e4)), log_uniform(rng, 1e-6, 1e-4)
    name = f"lab-{seed:04d}"
    rig = [
        f"rate = {rate:g}", f"delay = {delay:.2f}", f"lag = {lag:.4f}", f"drive_lag = {lag / 2:.4f}",
        f"counts = {counts}", f"cart_resolution = {resolution:.3g}", f"jitter = {jitter:.3g}",
        f"zero_error = {rng.uniform(0, 0.02):.4f}", f"initial_error = {rng.uniform(0, 0.03):.4f}",
        f"mismatch = {MISMATCH}", f"travel = {track:.3f}",
    ]  # fmt: skip
    if not known:
        rig.append(f'plant = "{name}-plant.toml"')
    head = [f'title = "Ordinary laboratory {seed}"', f'model = "{name}-model.toml"']
    return Scene(
        seed, arms.text(f"Arms of ordinary laboratory {seed}", coulomb=known),
        "" if known else arms.text(f"Plant of ordinary laboratory {seed}", coulomb=True),
        "\n".join([*head, *lines, "", "[run]", *rig]) + "\n",
        "lab",
    )  # fmt: skip


if __name__ == "__main__":
    begin, scenes, target = sys.argv[1:]
    for number in range(int(begin), int(begin) + int(scenes)):
        sampled_lab(number).write(Path(target))
