"""What a generated scene asks of its feedback, and a chart of the runs completed over it.

Two numbers explain most failures. Both follow from the reference and the rig, without a run:

    shaking   acceleration that feedback spends on dry friction, stiction, play, a count and noise, over the drive's
              limit. Each of them hides the angle of an arm: friction by its share of gravity's torque, in rad. The
              largest gain of the law along the reference multiplies these angles. Gains are large where the cart
              hardly moves the unstable direction.
    growth    growth of a small error along the reference, by which it multiplies e^growth until a command acts: its
              largest rate times the delay, half a period, the lag, and the belt's time constant.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from generated_scenes import Scene
from scene_flights import Flown

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TvlqrSettings, tracking_controller
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.pages.panels import name_point
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.references.reference import load_reference

SHAKEN, GROWN = 2.0, 0.6
"""Shaking and growth beyond which runs are lost."""
LEAST = 1e-2
"""Smallest value on the axes."""
SAMPLES = 400


def demands(scene: Scene, folder: Path) -> tuple[float, float]:
    """Return the shaking and the growth of a scene."""
    itinerary = load_itinerary(str(folder / f"{scene.name}.toml"))
    reference = load_reference(folder / f"{scene.name}.npz")
    arms, factors, rate = itinerary.model.arms, scene.factors, itinerary.loop.rate
    n = arms.count

    def value(name: str) -> float:
        return float(factors[name])

    law = tracking_controller(reference, sampled_model(arms, rate), TvlqrSettings())
    hidden = sum(value(name) for name in ("Coulomb share", "stiction", "play", "noise")) + 2 * np.pi / value("counts")
    shaking = hidden * float(np.abs(law.gains[:, :n]).sum(axis=1).max()) / reference.limits.acceleration
    times = np.linspace(0.0, reference.duration, SAMPLES)
    fine = 1e-3
    jacobians, _ = sampled_model(arms.frictionless(), 1 / fine).linearised(
        reference.state(times), reference.input(times)[:, 0]
    )
    largest = max(np.abs(np.linalg.eigvals(one[: 2 * n, : 2 * n])).max() for one in jacobians)
    belt = value("belt")
    late = (value("delay") + 0.5) / rate + value("lag") + (1 / (2 * np.pi * belt) if belt else 0.0)
    return shaking, float(np.log(largest)) / fine * late


def draw_limits(flights: Sequence[Flown], folder: Path, file: Path) -> str:
    """Draw the share of runs completed over shaking and growth, and return the counts within and beyond the limits."""
    asked = [demands(flight.scene, folder) for flight in flights]
    within = [f for f, (shaking, growth) in zip(flights, asked, strict=True) if shaking < SHAKEN and growth < GROWN]
    beyond = [f for f in flights if f not in within]

    def counts(some: Sequence[Flown]) -> str:
        done, runs = sum(f.completed for f in some), sum(len(f.runs) for f in some)
        return f"{done} of {runs} runs of {len(some)} itineraries"

    text = f"Within both limits {counts(within)} complete, beyond them {counts(beyond)}. Numbers: seeds below 90 %"
    page = Page("Itineraries fail where feedback shakes the cart or comes late", text, width=8.0)

    def draw(axes) -> None:
        axes.axvspan(SHAKEN, 1e3, color=style.GRID, zorder=0)
        axes.axhspan(GROWN, 10, color=style.GRID, zorder=0)
        for flight, (shaking, growth) in zip(flights, asked, strict=True):
            share = flight.completed / len(flight.runs)
            colour = style.GOOD if share >= 0.97 else style.LIMIT
            face = style.PAPER if 0 < share < 0.97 else colour
            x, y = max(shaking, LEAST), max(growth, LEAST)
            axes.plot(x, y, "o", color=colour, mfc=face, ms=6)
            if share < 0.9:
                name_point(axes, str(flight.scene.seed), (x, y), style.INK, weight="normal")
        axes.set(xscale="log", yscale="log", xlim=(LEAST / 1.5, 200), ylim=(LEAST / 1.5, 3))
        axes.set_xlabel("acceleration that friction, play and counts cost the feedback, over the drive's limit")
        axes.set_ylabel("growth of an error until a command acts (powers of e)")
        marks = {"marker": "o", "linestyle": ""}
        some = ("some complete", {**marks, "color": style.LIMIT, "markerfacecolor": style.PAPER})
        key(axes, [("at least 97 %", {**marks, "color": style.GOOD}), some, ("none", {**marks, "color": style.LIMIT})])

    page.row(draw, height=5.0)
    save_figure(page.figure(), file)
    return text
