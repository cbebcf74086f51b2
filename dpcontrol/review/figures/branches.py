"""Connections of the lab pendulum against energy: where each crosses its section, is born, splits, or grazes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dpcontrol.bifurcations.bifurcations import BranchDiagram
from dpcontrol.foundation.progress import part_of
from dpcontrol.review import style
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.panel_frame import angle_axis, new_figure, quiet

Array = NDArray[np.float64]

KINDS = (("down-up", "down-up"), ("up-down", "up-down"), ("down-up", "up-down"))
MARKS = {"saddle-node": "o", "pitchfork": "^", "section-artefact": "D"}
_BETWEEN, _PAIR = "#c2185b", "#7c858e"
_WORDS = {
    "saddle-node": "saddle-node: two are born",
    "pitchfork": "pitchfork: one sheds a mirror pair",
    "section-artefact": "artefact: the section is grazed, none is born",
}
_COORDINATES = {"down-up": ("θ₁", "θ₂ = 2πk"), "up-down": ("θ₂", "θ₁ = 2πk"), "between": ("θ₁", "θ₁ = θ₂ + 2πk")}
_ON_MIRROR = 1e-5  # rad


def draw(gallery: Gallery) -> Page:
    """Draw first-hit homoclinics of both saddles and the heteroclinics of the lab pendulum against energy."""
    diagrams = [
        gallery.branches("lab", source, target, part_of(gallery.progress, k / len(KINDS), (k + 1) / len(KINDS)))
        for k, (source, target) in enumerate(KINDS)
    ]
    figure = new_figure(15, 8.2, "Connections of the lab pendulum against energy (first hits)")
    grid = figure.add_gridspec(2, 3, left=0.05, right=0.99, top=0.86, bottom=0.07, hspace=0.2, wspace=0.2)
    for column, diagram in enumerate(diagrams):
        coordinate, section = _COORDINATES[diagram.source if diagram.source == diagram.target else "between"]
        title = (
            f"{diagram.source} to itself"
            if diagram.source == diagram.target
            else (f"{diagram.source} to {diagram.target}")
        )
        for row, label in enumerate((f"{coordinate} (rad)", "p / p₀")):
            axes = figure.add_subplot(grid[row, column])
            _branches(axes, diagram, row)
            quiet(axes, f"{title}: on {section}" if row == 0 else "")
            axes.set_ylabel(label, fontsize=9, labelpad=1)
            if row == 0:
                angle_axis(axes, "y")
            else:
                axes.set_xlabel("energy (J)", fontsize=9)
                _counts(axes, diagram)
    lines = [
        Line2D([], [], color=style.saddle_colour("down-up"), lw=1.8, label="symmetric (teal, violet)"),
        Line2D([], [], color=_PAIR, lw=1.2, label="one of a mirror pair"),
        Line2D([], [], color=_BETWEEN, lw=1.1, label="between different saddles"),
        *(
            Line2D([], [], color=style.INK, marker=MARKS[kind], lw=0, markersize=6, mfc="white", label=_WORDS[kind])
            for kind in MARKS
        ),
    ]
    figure.legend(
        handles=lines,
        loc="upper left",
        bbox_to_anchor=(0.042, 0.955),
        ncol=6,
        fontsize=8.5,
        columnspacing=1.2,
        frameon=False,
    )
    return Page(figure, _caption(diagrams), _differs(diagrams))


def _branches(axes: Axes, diagram: BranchDiagram, coordinate: int) -> None:
    homoclinic = diagram.source == diagram.target
    for energies, points in diagram.runs:
        symmetric = homoclinic and bool(np.all(np.abs(np.sin(points[:, 0])) < _ON_MIRROR))
        colour = style.saddle_colour(diagram.source) if symmetric else _PAIR if homoclinic else _BETWEEN
        look = {"color": colour, "linewidth": 1.8 if symmetric else 1.1, "solid_capstyle": "round"}
        values = _wrapped(points)[:, coordinate]
        # A branch that leaves the period on one side comes in on the other.
        for part in np.split(np.arange(len(values)), np.flatnonzero(np.abs(np.diff(values)) > np.pi) + 1):
            axes.plot(energies[part], values[part], **look, zorder=3 if symmetric else 2)
    for mark in diagram.marks:
        value = _wrapped(np.array([mark.point]))[0, coordinate]
        axes.plot(mark.energy, value, MARKS[mark.kind], color=style.INK, mfc="white", markersize=5.5, zorder=5)
    if diagram.scatters_from is not None:
        axes.axvspan(diagram.scatters_from, diagram.counts[-1][0], color="#f3e9e8", zorder=0)
    axes.set_xlim(diagram.counts[0][0], diagram.counts[-1][0])


def _wrapped(points: Array) -> Array:
    """Return points (K, 2) with the angle inside one turn about zero."""
    angles = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # On the mirror at half a turn, rounding would throw points to both ends.
    angles = np.where(angles < -np.pi + _ON_MIRROR, angles + 2 * np.pi, angles)
    return np.column_stack([angles, points[:, 1]])


def _counts(axes: Axes, diagram: BranchDiagram) -> None:
    """Write along the lower edge how many connections there are between one event and the next."""
    shown, last, span = -1, -np.inf, diagram.counts[-1][0] - diagram.counts[0][0]
    look = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "fontsize": 8, "color": style.CART}
    for energy, count, complete in diagram.counts:
        room = energy - last > 0.05 * span and diagram.counts[-1][0] - energy > 0.1 * span
        if count != shown and room:
            axes.annotate(f"{'' if complete else '≥'}{count}", (energy, 0.0), xytext=(2, 3), **look)
            shown, last = count, energy
    energy, count, complete = diagram.counts[-1]
    if count != shown:
        axes.annotate(f"{'' if complete else '≥'}{count}", (energy, 0.0), xytext=(-2, 3), ha="right", **look)


def _caption(diagrams: list[BranchDiagram]) -> str:
    words = []
    for d in diagrams:
        name = f"{d.source} to itself" if d.source == d.target else f"{d.source} to {d.target}"
        kinds = ", ".join(
            f"{n} {kind}{'s' if n > 1 else ''}" for kind in MARKS if (n := sum(m.kind == kind for m in d.marks))
        )
        least = "" if d.counts[-1][2] else "at least "
        words.append(f"{name}: {d.counts[0][1]} connections at {d.counts[0][0]:.4f} J and {least}{d.counts[-1][1]} at "
                     f"{d.counts[-1][0]:.4f} J by {kinds}")  # fmt: skip
    unexplained = sum(d.unexplained for d in diagrams)
    causes = (
        "Every change of the numbers has a located cause"
        if not unexplained
        else (f"{unexplained} changes of the numbers have no located cause")
    )
    return (
        "Where each connection crosses its section, as energy grows: its angle there (above) and the momentum across "
        "(below). Each curve is a connection followed by continuation, round its folds too; marks are events, each "
        "solved by its own equations. Numbers along the lower edge count all connections on the torus; curves show one "
        f"sense, whose mirror images under (θ, ω) → (-θ, -ω) are the other. {_scattering(diagrams)}"
        f"{'; '.join(words)}. {causes}."
    )


def _scattering(diagrams: list[BranchDiagram]) -> str:
    what = (
        "trajectories of a tube pass by another orbit and scatter before they arrive, connections accumulate, and "
        "those found are some of them"
    )
    if any(d.scatters_from is not None for d in diagrams):
        return f"Shaded: {what}. "
    highest = diagrams[2].counts[-1][0]
    return f"Those between different saddles are drawn up to {highest:.3f} J; from about 0.237 J on {what}. "


def _differs(diagrams: list[BranchDiagram]) -> str:
    onset = min((m.energy for m in diagrams[2].marks), default=float("nan"))
    return (
        "Folds and splittings are located instead of read off a list of counts, and told from grazes of the section, "
        "which only move a connection to another number of hits. Both orbits exist from 0.1754 J on, which the paper "
        f"gives for the onset of heteroclinics; the first of them that meets its section once each appears at "
        f"{onset:.6f} J, and none below it. Counts are of both senses and of all images on the torus. Parameters are "
        "the rig's identified ones; with those printed in the text all these energies differ."
    )
