"""Where references end: friction, track and acceleration, for a turn and a crossing; and a picture of it.

    pytest -m benchmark tests/benchmarks/test_reference_edges.py -s

DPCONTROL_EDGES_PICTURE names the PNG to draw. Effort grows as friction. A motion fits a much shorter track than it
takes without limits, by moving the cart more quickly to and fro; of the acceleration six to eight tenths are needed.
"""

import os
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from matplotlib.ticker import FuncFormatter

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, key, save_figure
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import Limits, ReferenceProblem, ReferenceSettings

FRICTION = (0.0, 0.5, 1.0, 2.0, 5.0, 8.0, 12.0, 16.0)
SHARES = {
    "position": (1.5, 1.0, 0.6, 0.3, 0.15, 0.08, 0.04, 0.02),
    "acceleration": (1.5, 1.1, 1.0, 0.8, 0.6, 0.4, 0.25, 0.15),
}
NAMES = ("outer-turn", "cross")


def edges_of(name):
    """Return {axis: [(value, converged, rms in m/s²)]} and what the motion takes of each limit on its own."""
    itinerary = load_itinerary(name)
    orbit, arms = shadowing_orbit(itinerary, itinerary.walks[0]), itinerary.model.arms

    def found_with(friction=1.0, **limits):
        parameters = replace(arms, viscous=tuple(friction * k for k in arms.viscous)).base()
        equations, limits = arm_chain_equations(2, Level.CART), replace(Limits(), **limits)
        problem = ReferenceProblem(equations, parameters, orbit.states, orbit.duration, limits)
        return find_reference(problem, ReferenceSettings())

    free = found_with()
    takes = {"position": free.max_cart_position, "acceleration": free.max_cart_acceleration}
    rows = {"friction": []}
    for factor in FRICTION:
        found = found_with(friction=factor)
        rows["friction"].append((factor, found.converged, found.rms_cart_acceleration))
    for axis, taken in takes.items():
        rows[axis] = []
        for share in SHARES[axis]:
            found = found_with(**{axis: share * taken})
            rows[axis].append((share * taken, found.converged, found.rms_cart_acceleration))
            if not found.converged:
                assert f"cart {axis}" in found.status or "without limits" in found.status, found.status
    return rows, takes


def drawn(edges):
    """Return the picture: effort against friction, track and acceleration."""
    labels = {
        "friction": ("friction, × the arms' own", "Effort grows in proportion to friction", 1.0),
        "position": ("track, ± mm", "Tracks can shrink to a tenth of the free motion's", 1e3),
        "acceleration": ("greatest acceleration, m/s²", "Accelerations can shrink to six to eight tenths", 1.0),
    }
    colours = dict(zip(edges, style.SERIES, strict=False))

    def draw(axes, kind):
        label, title, scale = labels[kind]
        axes.set_title(title, loc="left")
        axes.set(xlabel=label, ylabel="effort, m/s² rms" if kind == "friction" else "")
        for name, (rows, takes) in edges.items():
            values, good, rms = (np.array(column) for column in zip(*rows[kind], strict=True))
            axes.plot(scale * values[good], rms[good], "o-", color=colours[name], markersize=5)
            axes.plot(scale * values[~good], np.zeros(np.sum(~good)), "x", color=colours[name])
            if kind in takes:
                axes.axvline(scale * takes[kind], color=colours[name], linestyle=style.DOTTED, linewidth=1.2)
        if kind == "position":
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        if kind == "friction":
            look = {"color": style.MARK, "linestyle": "none"}
            key(axes, [*colours.items(), ("none found", {"marker": "x", **look})])

    page = Page("References need more effort with friction, and little more on a short track")
    page.row(*(partial(draw, kind=kind) for kind in labels), height=3.3)
    return page.text("Dotted: what the motion takes without limits. Crosses: no reference within the limit.").figure()


@pytest.mark.benchmark
def test_the_edges_of_references():
    edges = {name: edges_of(name) for name in NAMES}
    if "DPCONTROL_EDGES_PICTURE" in os.environ:
        save_figure(drawn(edges), os.environ["DPCONTROL_EDGES_PICTURE"])
    for rows, takes in edges.values():
        # Without friction, the motion needs no effort. With friction, the effort grows.
        frictions = [rms for value, good, rms in rows["friction"] if good and value <= 2.0]
        assert frictions[0] < 1e-3
        assert all(np.diff(frictions) > 0)
        for kind, taken in takes.items():
            wide = [good for value, good, _ in rows[kind] if value >= taken]
            assert all(wide)
            # The last of each axis is not enough, and less room costs more.
            assert not rows[kind][-1][1]
            efforts = [rms for _, good, rms in rows[kind] if good]
            assert all(np.diff(efforts) > -1e-6)
