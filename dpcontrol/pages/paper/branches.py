"""Connections against energy with births, splittings and grazes of the section, and rates of passage of the necks."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.bifurcations.bifurcations import BifurcationSearch, SweepSettings, find_bifurcations
from dpcontrol.bifurcations.links import Quantity
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import counted
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.figures import IDENTIFIED, PaperFigure, model_named
from dpcontrol.pages.layout import Page, key
from dpcontrol.pages.panels import angle_axis
from dpcontrol.tubes.transport import transport

MARKS = {"saddle-node": "o", "pitchfork": "^", "section-artefact": "D"}
KINDS = (("down-up", "down-up"), ("up-down", "up-down"), ("down-up", "up-down"))
LOWEST, HIGHEST, HIGHEST_BETWEEN = -0.49, 0.26, 0.236
"""Energies in J between which connections are drawn: sweeps begin at the later of both saddles. Those between different
saddles end earlier: cuts of the lab pendulum's tubes scatter from about 0.237 J on, where counts are lower bounds."""
_BETWEEN, _PAIR = "#c2185b", "#7c858e"
_COORDINATES = {"down-up": ("θ₁", "θ₂ = 2πk"), "up-down": ("θ₂", "θ₁ = 2πk"), "between": ("θ₁", "θ₁ = θ₂ + 2πk")}
_ON_MIRROR = 1e-5  # rad


def branches_page(progress: Progress) -> PaperFigure:
    """Draw connections of the lab pendulum against energy: those of each saddle with itself, and between both.

    They are the connections at the first crossing of their section by both tubes. A search follows them over energy and
    locates their births and splittings; each has a panel for the angle and one for the momentum at the crossing.
    """
    diagrams = [
        find_bifurcations(
            Quantity.of_energy(model_named("lab").system),
            source,
            target,
            values=(LOWEST, HIGHEST if source == target else HIGHEST_BETWEEN),
            settings=SweepSettings(samples=28),
            progress=part_of(progress, k / len(KINDS), (k + 1) / len(KINDS)),
        )
        for k, (source, target) in enumerate(KINDS)
    ]
    page = Page("Connections of the lab pendulum against energy (first hits)").text(
        "Thick: symmetric. Thin grey: one of a mirror pair. Magenta: between different saddles. Marks: circles are "
        "saddle-nodes (two are born), triangles are pitchforks (one sheds a mirror pair), and diamonds are grazes of "
        "the section (no birth).",
        size=style.TEXT,
    )
    panels = [partial(draw, diagram=d) for draw in (_angle_branches, draw_momentum_branches) for d in diagrams]
    words = "; ".join(
        f"{pair_name(d)}: {d.counts[0].count} connections at {d.counts[0].value:.4f} J and "
        f"{_least(d)}{d.counts[-1].count} at {d.counts[-1].value:.4f} J by {len(d.events)} events"
        for d in diagrams
    )
    onset = min((event.energy for event in diagrams[2].events), default=float("nan"))
    return PaperFigure(
        page.grid(panels, across=len(diagrams), height=3.1).figure(),
        "The section crossing of each connection, as energy grows: its angle there (above) and the momentum across "
        "(below). Each curve is a connection followed by continuation, also round folds; marks are events, each "
        "solved separately. The numbers below count all connections on the torus; curves show one "
        "sense, whose mirror images under (θ, ω) → (-θ, -ω) are the other. Shaded, or above the last energy: "
        "trajectories of a tube pass by another orbit and scatter before they arrive, connections accumulate, and "
        f"those found are some of them. {words}. Changes of the numbers without a located cause: "
        f"{sum(len(d.unexplained) for d in diagrams)}.",
        "Folds and splittings are located instead of read off a list of counts. They are distinguished from grazes of "
        "the section, which only change a connection's number of hits. Both orbits exist from 0.1754 J on, which "
        "the paper gives for the onset of heteroclinics; the first of them that meets its section once each appears at "
        f"{onset:.6f} J. With the parameters printed in the paper's text all these energies differ.",
    )


def _angle_branches(axes: Axes, diagram: BifurcationSearch) -> None:
    """Draw connections by the angle of their section crossing, rad, and energy; the title has saddles and section."""
    coordinate, section = _COORDINATES[diagram.source if diagram.source == diagram.target else "between"]
    axes.set(title=f"{pair_name(diagram)}: on {section}", ylabel=f"{coordinate} (rad)")
    _branches(axes, diagram, 0)
    angle_axis(axes, "y")


def draw_momentum_branches(axes: Axes, diagram: BifurcationSearch) -> None:
    """Draw connections by momentum and energy, with their bifurcations and the first and last count.

    Args:
        axes: panel to draw on.
        diagram: branches to draw.
    """
    count = f"{diagram.counts[0].count} to {_least(diagram)}{diagram.counts[-1].count} connections"
    axes.set(xlabel=f"energy (J): {count}", ylabel="p / p₀")
    _branches(axes, diagram, 1)


def _least(diagram: BifurcationSearch) -> str:
    """Return "at least " if connections of the last count may be missing."""
    return "" if diagram.counts[-1].complete else "at least "


def _branches(axes: Axes, diagram: BifurcationSearch, coordinate: int) -> None:
    """Draw each followed connection as a curve over energy, with marks at its births and splittings.

    The height of a curve is the `coordinate` of the connection's first section crossing: 0 for the angle, rad, 1 for
    the momentum over p₀, the section's momentum scale. A connection of a saddle with itself is symmetric if its angle
    stays at a multiple of half a turn, which time reversal maps to itself. Above the energy from which trajectories of
    the tubes scatter, the panel is shaded.
    """
    homoclinic = diagram.source == diagram.target
    for values, points in diagram.runs:
        symmetric = homoclinic and bool(np.all(np.abs(np.sin(points[:, 0])) < _ON_MIRROR))
        colour = style.saddle_colour(diagram.source) if symmetric else _PAIR if homoclinic else _BETWEEN
        look = {"color": colour, "linewidth": 1.8 if symmetric else 1.1, "solid_capstyle": "round"}
        heights = _wrapped(points)[:, coordinate]
        # A branch that leaves the period on one side enters on the other.
        for part in np.split(np.arange(len(heights)), np.flatnonzero(np.abs(np.diff(heights)) > np.pi) + 1):
            axes.plot(values[part], heights[part], **look, zorder=3 if symmetric else 2)
    for mark in diagram.events:
        height = _wrapped(np.array([mark.point]))[0, coordinate]
        axes.plot(mark.value, height, MARKS[mark.kind], color=style.INK, mfc="white", markersize=5.5, zorder=5)
    if diagram.scatters_from is not None:
        axes.axvspan(diagram.scatters_from, diagram.counts[-1].value, color="#f3e9e8", zorder=0)
    axes.set_xlim(diagram.counts[0].value, diagram.counts[-1].value)


def _wrapped(points: Array) -> Array:
    """Return points (K, 2) with the angle inside one turn about zero."""
    angles = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # On the mirror at half a turn, rounding would scatter points to both ends.
    angles = np.where(angles < -np.pi + _ON_MIRROR, angles + 2 * np.pi, angles)
    return np.column_stack([angles, points[:, 1]])


def pair_name(diagram: BifurcationSearch) -> str:
    """Return the saddles of a diagram's connections as text, such as "down-up to itself" or "down-up to up-down"."""
    return f"{diagram.source} to {'itself' if diagram.source == diagram.target else diagram.target}"


def bifurcations(axes: Axes, search: BifurcationSearch) -> None:
    """Draw each connection's momentum on the section over the followed quantity, with bifurcations and counts.

    Args:
        axes: panel to draw on.
        search: search to draw.
    """
    draw_momentum_branches(axes, search)
    title = f"{search.source} → {search.target}: {counted(len(search.events), 'bifurcation')} on {search.section.name}"
    unit = f" ({search.course.unit.strip()})" if search.course.unit else ""
    axes.set(title=title, xlabel=f"{search.course.quantity}{unit}", ylabel="p / p₀")


COUNTED = Path(__file__).with_name("passages.json")
"""Passages of the lab pendulum that `tests/independent_passages.py` counted, with its conditions."""


def transport_page(_: Progress) -> PaperFigure:
    """Draw the rates of passage through both necks of the lab pendulum against energy, computed and counted.

    A neck is the narrow part of the energy surface at a saddle. The counts are stored in the file `COUNTED`.
    """
    system, counts = model_named("lab").system, json.loads(COUNTED.read_text(encoding="utf-8"))
    panels = (partial(_rates, system=system, saddle=saddle, counts=counts) for saddle in system.saddles)
    return PaperFigure(
        Page("Passages of the necks of the lab pendulum, from volume and action alone")
        .row(*panels, height=4.2)
        .figure(),
        "Rate of passages in both directions through the necks of Down-Up and Up-Down. Curves: twice the action of the "
        "Lyapunov orbit over the volume of the energy surface, without simulation. Points: passages counted by a "
        f"separate program over the microcanonical ensemble, {counts[0]['motions']:,} motions of "
        f"{counts[0]['window']:g} s without friction for each, from states drawn evenly from the energy surface; bars "
        "are two standard errors. Dashed: energy of Up-Down, above which both necks are open.",
        f"The paper gives no rates. {IDENTIFIED}",
    )


def _rates(axes: Axes, system: System, saddle: str, counts: list[dict[str, Any]]) -> None:
    """Draw the rate of passages through a saddle's neck, 1/s, against energy, J, computed and counted.

    The computed rates, 2A/Ω by action and volume, extend from just above the saddle to beyond the last counted energy.
    Each of `counts` has an energy, J, and for it the mean time between passages with its standard error, s.
    """
    energies, times, errors = np.array(
        [[c["energy"], c["mean_time"], c["error"]] for c in counts if c["saddle"] == saddle]
    ).T
    heights = {name: equilibrium.energy for name, equilibrium in equilibria(system).items()}
    along = np.linspace(heights[saddle] + 1e-3, energies[-1] + 0.02, 15)
    rates = [1 / transport(lyapunov_orbit(system, saddle, energy=energy)).mean_time for energy in along]
    axes.plot(along, rates, color=style.saddle_colour(saddle), linewidth=1.6)
    axes.errorbar(energies, 1 / times, 2 * errors / times**2, fmt="o", color=style.INK, markersize=4, capsize=3)
    axes.axvline(heights["up-down"], color=style.MARK, linewidth=1.0, linestyle="--")
    axes.set(title=f"neck of {saddle}", xlabel="energy (J)", ylabel="passages per second")
    key(
        axes, [("2A/Ω", style.saddle_colour(saddle)), ("counted", {"color": style.INK, "marker": "o", "linestyle": ""})]
    )
