"""Further figures of the paper: both landscapes, the tubes and connections of three bodies, both senses of rotation,
cuts against energy, orbits in space, a shadowing orbit, and the manifold of Up-Up."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.lyapunov import equilibria, lyapunov_orbit
from dpcontrol.pages import style
from dpcontrol.pages.atlas import (
    colours,
    connections_of,
    draw_cuts,
    draw_space,
    kind_of,
    placed,
)
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, Page
from dpcontrol.pages.page import DOTTED, angle_axis, key, new_figure, quiet, wrapped_runs
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.cut import section_points
from dpcontrol.tubes.intersections import search_settings
from dpcontrol.walks.atlas import Atlas
from dpcontrol.walks.shadowing import WalkSolver

LANDSCAPES = {"three-body": (-1.523, -1.5195, -1.51, -1.5005), "lab": (-0.3, -0.07, 0.2, 0.55)}
"""Energies, one between the heights of adjacent critical points."""
_GRID = 361
_REACHED, _FORBIDDEN = "#dbe9f6", "#8d959e"


def landscape_page(gallery: Gallery) -> Page:
    """Draw potential energies and Hill's regions at four energies.

    Both are drawn for three bodies and the pendulum.
    """
    figure = new_figure(13.5, 6.6, "Energy landscapes and Hill's regions: higher energies open more saddles")
    grid = figure.add_gridspec(
        2, 5, left=0.012, right=0.985, top=0.88, bottom=0.07, wspace=0.36, hspace=0.22, width_ratios=[1.45, 1, 1, 1, 1]
    )
    words = []
    for row, (name, energies) in enumerate(LANDSCAPES.items()):
        system, angular = gallery.system(name), name == "lab"
        side = np.linspace(-np.pi, np.pi, _GRID) if angular else np.linspace(-1.45, 1.45, _GRID)
        first, second = np.meshgrid(side, side)
        still = np.stack([first, second, 0 * first, 0 * first], axis=-1)
        # At rest, in the rotating frame for three bodies, the energy is the potential.
        with np.errstate(divide="ignore"):
            potential = system.numeric.hamiltonian(still.reshape(-1, 4)).reshape(first.shape)
        points = {n: (p.state[:2], p.energy, p.kind) for n, p in equilibria(system).items()}
        if not angular:
            top = np.array([0.5 - float(system.parameters[0]), np.sqrt(3) / 2])
            height = float(system.numeric.hamiltonian(np.array([*top, 0.0, 0.0])))
            points |= {n: (top * (1, sign), height, "maximum") for n, sign in (("L4", 1), ("L5", -1))}
        relief = figure.add_subplot(grid[row, 0], projection="3d")
        # The wells of the primaries are bottomless.
        shown = np.maximum(potential, potential.min() if angular else -1.62)
        relief.plot_surface(first, second, shown, cmap="viridis", linewidth=0, rcount=90, ccount=90, alpha=0.95)  # type: ignore[attr-defined]
        relief.view_init(elev=38, azim=-60)  # type: ignore[attr-defined]
        title = "double pendulum: energy at rest (J)" if angular else "three bodies: energy at rest"
        relief.set_title(title, fontsize=10, color=style.INK, y=1.02)
        for which, label in (("x", "θ₁"), ("y", "θ₂")) if angular else (("x", "x"), ("y", "y")):
            if angular:
                angle_axis(relief, which, step=1.0)
            getattr(relief, f"set_{which}label")(label, fontsize=9, labelpad=-4)
        relief.tick_params(labelsize=7.5, pad=-2)
        for k, energy in enumerate(energies):
            axes = figure.add_subplot(grid[row, k + 1])
            _region(axes, (first, second, potential), energy, points, angular=angular)
            quiet(axes, _opened(points, energy, system.worded(f"{energy:g} J")), size=8.5,
                  x="θ₁" if angular else "x", y=("θ₂" if angular else "y") if not k else "")  # fmt: skip
            axes.grid(False)
            axes.set_aspect("equal")
            if angular:
                angle_axis(axes, "x", step=1.0)
                angle_axis(axes, "y", step=1.0)
        listed = ", ".join(system.worded(f"{n} {p[1]:+.4f} J") for n, p in points.items())
        words.append(f"{'Pendulum' if angular else 'Three bodies'}: {listed}.")
    return Page(
        figure,
        "Above the restricted three-body problem in its rotating frame, below the lab pendulum. Left: the energy at "
        "rest, over the plane and over the torus of the two angles (from hanging). Right: Hill's regions, one energy "
        "between adjacent critical points; blue regions are accessible, grey ones are not. Squares: the saddles whose "
        "necks connect regions, L1 and L2, and their counterparts Down-Up and Up-Down. Circle: the stable equilibrium; "
        f"triangles: maxima. Green: reached; red: not. {' '.join(words)}",
        f"Each energy lies between two adjacent equilibria. {IDENTIFIED}",
    )


Points = dict[str, tuple[Array, float, str]]


def _region(axes: Axes, field: tuple[Array, Array, Array], energy: float, points: Points, *, angular: bool) -> None:
    first, second, potential = field
    # At collisions of two bodies the energy has no lower bound.
    potential = np.maximum(potential, -10.0)
    axes.contourf(first, second, potential, levels=[potential.min() - 1, energy], colors=[_REACHED])
    axes.contourf(first, second, potential, levels=[energy, potential.max() + 1], colors=[_FORBIDDEN])
    axes.contour(first, second, potential, levels=[energy], colors=[style.INK], linewidths=1.0, linestyles="solid")
    for name, (place, height, kind) in points.items():
        mark = "o" if kind == "centre" else ("s" if kind.startswith("index-1") else "^")
        for a in {-np.pi, np.pi} if angular and place[0] else {place[0]}:
            for b in {-np.pi, np.pi} if angular and place[1] else {place[1]}:
                axes.plot(a, b, mark, color="#2c8a4b" if height <= energy else style.LIMIT, clip_on=False,
                          markersize=6 if angular else 4.5)  # fmt: skip
                if not angular:
                    side = {"L1": "right", "L2": "left"}.get(name, "center")
                    axes.annotate(name, (a, b), xytext=(0, 6), textcoords="offset points", fontsize=7, ha=side)


def _opened(points: Points, energy: float, text: str) -> str:
    above = [name for name, (_, height, kind) in points.items() if kind != "centre"]
    reached = [name for name in above if points[name][1] <= energy]
    if len(reached) == len(above):
        return f"{text}: everything reached"
    return f"{text}: {'no saddle reached' if not reached else ', '.join(reached) + ' open'}"


BETWEEN_ENERGY = -1.5175
HOMOCLINIC_ENERGIES = {"L1": -1.5185, "L2": -1.518}
Extent = tuple[tuple[float, float], tuple[float, float]]
NEAR: Extent = ((0.89, 1.11), (-0.11, 0.11))
WHOLE: dict[str, Extent] = {"L1": ((-1.15, 1.25), (-1.15, 1.15)), "L2": ((-2.2, 2.2), (-2.1, 2.1))}


def three_body_page(gallery: Gallery) -> Page:
    """Draw L1's and L2's orbits, their tubes and first connections.

    The section is x = 1 - μ. Both directions are drawn.
    """
    atlas = gallery.atlas("three-body", BETWEEN_ENERGY, None)
    pairs = (("L1", "L2"), ("L2", "L1"))
    figure = new_figure(14, 10.4, f"Three bodies: heteroclinic connections of L1 and L2 at energy {BETWEEN_ENERGY:g}")
    counts = _rows(figure, gallery, [(atlas, *pair, NEAR) for pair in pairs])
    kind = kind_of(atlas, "L1", "L2")
    assert kind is not None
    return Page(
        figure,
        "The planar circular restricted three-body problem in the rotating frame, mass ratio "
        f"{float(gallery.system('three-body').parameters[0]):g}, near the smaller primary (dot). Grey: inaccessible at "
        "this energy. Left: Lyapunov orbits about L1 (teal) and L2 (violet). The unstable tube (red) of one and the "
        f"stable tube (green) of the other reach crossing number {kind.hits[0]} of the line x = 1 - μ. Middle: "
        "the cuts there with the connections found. Right: the complete flight of the first. Below: the opposite "
        f"direction, which is the image under time reversal. {counts}.",
        f"Both tubes pass the line once before they can meet: hits {list(kind.hits)} are the first with "
        "connections. The energy's constant is that of the paper's appendix. Cuts are open at trajectories of the "
        "tube that pass close to the smaller primary and are scattered.",
    )


def three_body_homoclinics_page(gallery: Gallery) -> Page:
    """Draw the homoclinic connections of L1 and of L2.

    The page shows tubes, cuts on y = 0, x < 0, and the orbits.
    """
    rows = [(gallery.atlas("three-body", energy, (1, 1)), saddle, saddle, WHOLE[saddle])
            for saddle, energy in HOMOCLINIC_ENERGIES.items()]  # fmt: skip
    figure = new_figure(14, 10.4, "Three bodies: homoclinic connections of L1 and of L2")
    counts = _rows(figure, gallery, rows)
    return Page(
        figure,
        "The planar circular restricted three-body problem in the rotating frame; above the orbit about L1, below that "
        "about L2. Left: the branches of its unstable (red) and stable (green) tubes that go round the larger primary "
        "to the section y = 0, x < 0 (dotted). Grey: inaccessible. Middle: the cuts there, x and its momentum, with "
        "the connections found. Right: one flight of each colour, solid for a symmetric one and dashed for one "
        f"of a mirror pair. {counts}.",
        "The chosen energies are slightly above those of the points, with few connections. Flights are limited to "
        "four periods of their orbit before the section; longer ones exist.",
    )


def _rows(
    figure: Figure,
    gallery: Gallery,
    rows: Sequence[tuple[Atlas, str, str, Extent]],
) -> str:
    """Draw tubes, cuts and flights, a row for each.

    Rows are (atlas, source, target). Return their counts in words.
    """
    mu, words = float(gallery.system("three-body").parameters[0]), []
    for row, (atlas, source, target, extent) in enumerate(rows):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        bottom, letters = 0.545 - 0.485 * row, "abc" if row == 0 else "def"
        title = kind.section.replace("mu", "μ")
        plane = figure.add_axes((0.045, bottom, 0.3, 0.375))
        _plane(plane, gallery, atlas, mu, extent, section=title)
        for saddle, hit, stable in ((source, kind.hits[0], False), (target, kind.hits[1], True)):
            for strand in atlas.cut(saddle, kind.section, hit).strands:
                states = atlas.turned(strand, saddle) if stable else strand
                colour = style.STABLE if stable else style.UNSTABLE
                plane.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.45, alpha=0.75)
        plane.set_title(f"{letters[0]}  tubes of {source} and {target}" if source != target else
                        f"{letters[0]}  tubes of {source}", fontsize=10, loc="left")  # fmt: skip
        plane.text(0.98, 0.98, f"energy {atlas.energy:g}", transform=plane.transAxes, fontsize=8.5, va="top",
                   ha="right", bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none"})  # fmt: skip
        connections = connections_of(atlas, kind)
        look = colours(connections)
        chosen = {look[c.name]: c for c in sorted(connections, key=lambda c: c.name, reverse=True)}.values()
        kept = sorted(chosen, key=lambda c: (not c.symmetric, c.name))[: 1 if source != target else 4]
        numbers = {c.name: str(k + 1) for k, c in enumerate(kept)}
        cuts = figure.add_axes((0.415, bottom, 0.22, 0.375))
        draw_cuts(cuts, atlas, kind, numbers=numbers, legend=False)
        cuts.set_title(f"{letters[1]}  cuts on {title}, hits {list(kind.hits)}", fontsize=10, loc="left")
        flight = figure.add_axes((0.69, bottom, 0.3, 0.375))
        _plane(flight, gallery, atlas, mu, extent, section=title)
        for c in kept:
            line = "-" if c.symmetric or source != target else (0, (5, 2))
            flight.plot(*c.states[:, :2].T, color=look[c.name], linewidth=1.1, linestyle=line, zorder=3)
        flight.set_title(f"{letters[2]}  from {source}'s orbit to {target}'s" if connections else "none found",
                         fontsize=10, loc="left")  # fmt: skip
        symmetric = sum(c.symmetric for c in connections)
        least = f"{'' if source != target else f'at {atlas.energy:g} '}{'' if kind.complete else 'at least '}"
        both = f" ({symmetric} symmetric)" if source == target else ""
        words.append(f"{source} to {target}: {least}{kind.count} connections{both}")
    return "; ".join(words)


def _plane(
    axes: Axes,
    gallery: Gallery,
    atlas: Atlas,
    mu: float,
    extent: Extent,
    *,
    section: str,
) -> None:
    """Draw the inaccessible region, the orbits, the primaries and the section."""
    system, (wide, high) = gallery.system("three-body"), extent
    x, y = np.meshgrid(np.linspace(*wide, 300), np.linspace(*high, 300))
    states = np.stack([x, y, 0 * x, 0 * x], axis=-1).reshape(-1, 4)
    potential = system.numeric.hamiltonian(states).reshape(x.shape)
    axes.contourf(x, y, potential, levels=[atlas.energy, 1e9], colors=["#c4c9cf"])
    quiet(axes, x="x", y="y")
    axes.grid(False)
    for orbit in atlas.orbits:
        closed = placed(atlas, orbit)
        colour = style.saddle_colour(orbit.saddle)
        axes.plot(closed[:, 0], closed[:, 1], color=colour, linewidth=2.4, zorder=5)
        side = -1 if orbit.saddle == "L1" else 1
        axes.annotate(orbit.saddle, (closed[:, 0].mean(), closed[:, 1].max()), xytext=(8 * side, 3), fontsize=9,
                      textcoords="offset points", ha="right" if side < 0 else "left", color=colour)  # fmt: skip
    axes.plot(1 - mu, 0, "o", color=style.INK, markersize=4, zorder=6)
    if wide[0] < -mu:
        axes.plot(-mu, 0, "o", color=style.INK, markersize=8, zorder=6)
    dotted = {"color": style.MARK, "linewidth": 0.9, "linestyle": DOTTED}
    if section.startswith("x"):
        axes.axvline(1 - mu, **dotted)
    else:
        axes.plot([wide[0], 0], [0, 0], **dotted)
    axes.set(xlim=wide, ylim=high, aspect="equal")


_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""
_POSES = 7


def lyapunov_orbits_page(gallery: Gallery) -> Page:
    """Draw Lyapunov orbits about both saddles in both phase planes.

    The motion of one is also drawn.
    """
    system = gallery.system("lab")
    figure = new_figure(13, 7.8, "Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    panels = figure.subplots(2, 3, gridspec_kw={
        "left": 0.06, "right": 0.985, "top": 0.9, "bottom": 0.08, "wspace": 0.24, "hspace": 0.32,
        "width_ratios": [1.2, 1.2, 1],
    })  # fmt: skip
    shades = style.CONNECTIONS
    for row, saddle in enumerate(("down-up", "up-down")):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        for k, above in enumerate(_SIZES):
            orbit = lyapunov_orbit(system, saddle, energy=birth + above)
            states = system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, 400))
            for arm in (0, 1):
                panels[row, arm].plot(states[:, arm], states[:, 2 + arm], color=shades[k], linewidth=1.4)
            if k == 2:
                _motion(panels[row, 2], system, orbit.period, states)
                panels[row, 2].set_title(f"the motion at {birth + above:.3g} J", loc="left", fontsize=9.5)
        for arm in (0, 1):
            number = style.number(arm)
            axes = panels[row, arm]
            axes.plot(system.equilibria[saddle][arm], 0, "+", color=style.LIMIT, markersize=9)
            quiet(axes, "" if arm else f"about {saddle}", x=f"θ{number} (rad)", y=f"ω{number} (rad/s)")
            angle_axis(axes, "x")
        looks = [(f"{birth + above:.3g} J", shades[k]) for k, above in enumerate(_SIZES)]
        key(panels[row, 1], looks, fontsize=7.5, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5,
            handlelength=0.9, columnspacing=0.7, handletextpad=0.3, borderaxespad=0.2)  # fmt: skip
    return Page(
        figure,
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, middle the outer arm's. Right: half a period of "
        "the third orbit, from pale to dark; the dot is the pivot. The hanging arm swings widely while the upright "
        "one balances.",
        f"The paper gives no energies for its curves, so these are chosen. {IDENTIFIED}",
    )


def _motion(axes: Axes, system: System, period: float, states: Array) -> None:
    """Draw the arms to scale at a few times of half a period."""
    arms = system.model.arms.length if hasattr(system, "model") else (1.0, 1.0)  # type: ignore[attr-defined]
    for share in np.linspace(0, 0.5, _POSES):
        # Half a period leads from rest on one side to rest on the other.
        first, second = states[round((share + 0.25) * (len(states) - 1)), :2]
        joint = arms[0] * np.array([np.sin(first), -np.cos(first)])
        tip = joint + arms[1] * np.array([np.sin(second), -np.cos(second)])
        for begin, end, arm in ((np.zeros(2), joint, 0), (joint, tip, 1)):
            axes.plot(*np.column_stack([begin, end]), color=style.arm_colour(arm), linewidth=3,
                      alpha=0.2 + 1.6 * share, solid_capstyle="round")  # fmt: skip
    axes.plot(0, 0, "o", color=style.INK, markersize=6)
    axes.set_aspect("equal")
    axes.margins(0.15)
    axes.axis("off")


SENSES_ENERGY = 0.2
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


def senses_page(gallery: Gallery, *, saddle: str) -> Page:
    """Draw a saddle's tubes at 0.2 J and their cuts.

    The two senses of rotation are separate.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    kind = kind_of(atlas, saddle, saddle)
    assert kind is not None
    arm, section, coordinate = _TURNING[saddle]
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (saddle, kind.section, 1)]
    figure = new_figure(13, 10.6, f"The tubes of {saddle} at {SENSES_ENERGY:g} J: the {arm} arm turns either way")
    counts = []
    for column, sense in enumerate((1, -1)):
        way = "forward" if sense > 0 else "backward"
        space = figure.add_axes((0.02 + 0.5 * column, 0.43, 0.44, 0.5), projection="3d")
        draw_space(space, atlas, cuts, steps=(1.0, 1.0), sense=sense, saddles=(saddle,))
        space.set_title(f"{'ab'[column]}  the {arm} arm turns {way}", fontsize=10, loc="left", y=0.98)
        axes = figure.add_axes((0.07 + 0.5 * column, 0.07, 0.4, 0.32))
        shown = tuple(c for c in connections_of(atlas, kind) if c.sense == sense)
        draw_cuts(axes, atlas, kind, shown=shown, legend=False, sense=sense)
        axes.set_title(f"{'cd'[column]}  cuts on {section}, crossed {way}", fontsize=10, loc="left")
        counts.append(f"{len(shown)} {way}")
    looks = [
        (f"unstable tube of {saddle}", style.UNSTABLE),
        (f"stable tube of {saddle}", style.STABLE),
        ("Lyapunov orbit", style.saddle_colour(saddle)),
        ("cut", style.CUT),
        ("connections", {"color": style.INK, "marker": "o", "linestyle": ""}),
    ]
    key(figure, looks, fontsize=9, loc="upper right", bbox_to_anchor=(0.99, 0.972), ncols=5)
    return Page(
        figure,
        f"Trajectories that leave the Lyapunov orbit about {saddle} at {SENSES_ENERGY:g} J (red) and that approach it "
        f"(green), in (θ₁, θ₂, ω₁), up to the section {section}. Panels a and b: the two senses of the {arm} arm. "
        f"Below, the corresponding cuts: {coordinate} on the section and its momentum over p₀. Homoclinic "
        f"connections: {' and '.join(counts)}.",
        "Both tubes start at the orbit's named position, so the red one ends on one sheet of the section and the green "
        f"one begins on another, whole turns away. Momenta are canonical in place of the paper's rates. {IDENTIFIED}",
    )


CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)


def cuts_page(gallery: Gallery) -> Page:
    """Draw the cuts of Down-Up's tubes at six energies."""
    figure = new_figure(13.5, 8.2, "Cuts of the tubes of Down-Up on θ₂ = 2πk, as energy grows (first hits)")
    panels = figure.subplots(2, 3, gridspec_kw={
        "left": 0.055, "right": 0.99, "top": 0.885, "bottom": 0.075, "wspace": 0.18, "hspace": 0.3,
    })  # fmt: skip
    words = []
    for k, energy in enumerate(CUT_ENERGIES):
        gallery.progress(f"cuts at {energy:g} J", k / len(CUT_ENERGIES))
        atlas = gallery.atlas("lab", energy, (1, 1))
        kind = kind_of(atlas, "down-up", "down-up")
        assert kind is not None
        axes = panels.flat[k]
        draw_cuts(axes, atlas, kind, legend=False)
        symmetric = sum(c.symmetric for c in connections_of(atlas, kind))
        axes.set_title(f"{'abcdef'[k]}  {energy:g} J: {kind.count} connections, {symmetric} symmetric", fontsize=10,
                       loc="left")  # fmt: skip
        words.append(f"{kind.count} at {energy:g} J")
    looks = [
        ("unstable tube", style.UNSTABLE),
        ("stable tube", style.STABLE),
        ("connections", {"color": style.INK, "marker": "o", "linestyle": ""}),
        ("crossed backward", {"color": style.CART, "linestyle": (0, (4, 1.6))}),
    ]
    key(figure, looks, fontsize=9, loc="upper right", bbox_to_anchor=(0.99, 0.965), ncols=4)
    return Page(
        figure,
        "First cuts of the unstable (red) and stable (green) tubes of the Lyapunov orbit about Down-Up on the section "
        "with the outer arm hanging, at six energies: the inner arm's angle and its momentum over p₀. Solid: a "
        "rising angle of the outer arm; dashed: a falling one. Homoclinic connections, both senses: "
        f"{', '.join(words)}.",
        f"Momenta are canonical in place of the paper's rates; both senses are in one panel. {IDENTIFIED}",
    )


def heteroclinic_orbits_page(gallery: Gallery) -> Page:
    """Draw heteroclinic connections at 0.2 J in (θ₁, θ₂, ω₁).

    Both Lyapunov orbits are included.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    figure = new_figure(13, 6.2, f"Heteroclinic orbits in (θ₁, θ₂, ω₁) at {SENSES_ENERGY:g} J")
    words = []
    for column, (source, target) in enumerate((("down-up", "up-down"), ("up-down", "down-up"))):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        # One of each pair of reflections is drawn.
        kept = [c for c in connections_of(atlas, kind) if c.sense > 0]
        look = ["#1f6fb4", "#d9640d", "#c2185b", "#9a6b15"]
        space = figure.add_axes((0.02 + 0.49 * column, 0.0, 0.46, 0.9), projection="3d")
        draw_space(space, atlas, (), saddles=())
        for orbit in atlas.orbits:
            turns = {c.winding for c in kept} if orbit.saddle == target else {(0, 0)}
            for winding in sorted(turns):
                closed = placed(atlas, orbit, winding)[:, :3]
                space.plot(*closed.T, color=style.saddle_colour(orbit.saddle), linewidth=2.5, zorder=10)
        for k, c in enumerate(kept):
            space.plot(*c.states[:, :3].T, color=look[k % len(look)], linewidth=1.2)
        space.set_title(f"{'ab'[column]}  {source} → {target}", fontsize=10, loc="left", y=0.98)
        looks = [(f"orbit about {name}", {"color": style.saddle_colour(name), "linewidth": 2.5}) for name in
                 (source, target)]  # fmt: skip
        looks += [(f"{k + 1}: {c.transversality_angle:.1f}°", look[k % len(look)]) for k, c in enumerate(kept)]
        key(space, looks, fontsize=8.5, loc="lower center", bbox_to_anchor=(0.5, -0.01), ncols=4)
        words.append(f"{len(kept)} from {source} to {target}")
    return Page(
        figure,
        f"The heteroclinic connections at {SENSES_ENERGY:g} J whose difference of angles grows on the section θ₁ = θ₂ "
        f"({' and '.join(words)}; each has a reflection). They lead from one Lyapunov orbit to the other "
        "and are labelled with the angle between the tubes. Those of b are those of a, run backward in time.",
        f"The paper draws one direction. {IDENTIFIED}",
    )


_SHADOWED = "down-up +"


def shadowing_page(gallery: Gallery) -> Page:
    """Draw a homoclinic connection and two orbits that shadow it.

    One follows it twice, the other is periodic.
    """
    system = gallery.system("lab")
    orbit = lyapunov_orbit(system, "down-up", energy=-0.07)
    search = find_connections(orbit, orbit)
    connection = next(c for c in search.connections if c.symmetric and c.sense > 0)
    solver = WalkSolver([connection])
    once = [connection]
    shapes = {
        "a  the homoclinic orbit": solver.solve(once, (), lead_in=1, lead_out=1),
        "b  a double homoclinic orbit beside it": solver.solve(once * 2, solver.least(once * 2), lead_in=1, lead_out=1),
        "c  a periodic orbit beside it": solver.solve(once, solver.least(once, periodic=True), periodic=True),
    }
    figure = new_figure(14, 7.4, "One homoclinic orbit of Down-Up at -0.07 J, and orbits that shadow it")
    panels = figure.subplots(2, 3, gridspec_kw={
        "left": 0.05, "right": 0.99, "top": 0.87, "bottom": 0.075, "wspace": 0.16, "hspace": 0.34,
    })  # fmt: skip
    words = []
    for column, (title, found) in enumerate(shapes.items()):
        assert found.converged, found.status
        times = np.linspace(0.0, found.duration, 1500)
        states = found.sample(times)
        above, below = panels[0, column], panels[1, column]
        turned = states[:, :2] - np.pi * np.array([0.0, 1.0])
        for part in wrapped_runs(np.column_stack([turned[:, 1], states[:, 3]]), (2 * np.pi, None)):
            above.plot(part[:, 0] + np.pi, part[:, 1], color=style.arm_colour(1), linewidth=1.1)
        quiet(above, title, x="θ₂ modulo a turn (rad)", y="" if column else "ω₂ (rad/s)")
        angle_axis(above, "x")
        for arm in (0, 1):
            below.plot(times, states[:, arm], color=style.arm_colour(arm), linewidth=1.2)
        quiet(below, x="time (s)", y="" if column else "angles (rad)")
        angle_axis(below, "y", step=1.0)
        below.margins(x=0)
        words.append(f"{title[0]} {found.duration:.2f} s, residual {found.residual:.0e}")
    key(figure, [("θ₁", style.arm_colour(0)), ("θ₂", style.arm_colour(1))], loc="upper right",
        bbox_to_anchor=(0.99, 0.965), ncols=2)  # fmt: skip
    return Page(
        figure,
        "Above, the outer arm in its phase plane; below, both angles against time. The homoclinic orbit leaves the "
        "Lyapunov orbit, turns the outer arm once and returns. Beside it lie an orbit that does this twice, "
        "with the fewest sufficient wobbles between, and a periodic one that repeats it with as many wobbles in each "
        f"period. Durations: {'; '.join(words)}.",
        f"All three are solved by multiple shooting, with the fewest wobbles that converge. {IDENTIFIED}",
    )


_RETURN_FLIGHT = 2.0
"""Longest flight in periods of its orbit; longer ones scatter."""


def returning_search(system: System) -> ConnectionSearch:
    """Search homoclinics of Down-Up that cross θ₁ = θ₂ twice.

    The energy is 0.2 J.
    """
    orbit = lyapunov_orbit(system, "down-up", energy=SENSES_ENERGY)
    return find_connections(
        orbit, orbit, hits=(1, 2), section=system.named_sections["aligned"],
        settings=search_settings(longest=_RETURN_FLIGHT),
    )  # fmt: skip


def returning_page(gallery: Gallery) -> Page:
    """Draw homoclinics of Down-Up that cross θ₁ = θ₂ and return.

    They pass Up-Down's side.
    """
    system = gallery.system("lab")
    search = returning_search(system)
    back = [c for c in search.connections if not any(c.winding)]
    orbit = search.source
    figure = new_figure(14, 6.4, "Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J")
    space = figure.add_axes((0.01, 0.0, 0.42, 0.92), projection="3d")
    flights = figure.add_axes((0.47, 0.12, 0.22, 0.74))
    axes = figure.add_axes((0.75, 0.12, 0.24, 0.74))
    shades = _by_flight(back)
    closed = system.propagator.sample(orbit.state, np.linspace(0, orbit.period, 200))
    for c in (c for c in back if c.sense > 0):
        times = np.linspace(float(c.orbit.times[0]), float(c.orbit.times[-1]), 900)
        states = c.orbit.sample(times)
        space.plot(*states[:, :3].T, color=shades[c.name], linewidth=1.0)
        flights.plot(states[:, 0], states[:, 1], color=shades[c.name], linewidth=1.1)
    space.plot(*closed[:, :3].T, color=style.saddle_colour("down-up"), linewidth=2.6, zorder=10)
    flights.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour("down-up"), linewidth=3)
    reach = np.array(flights.get_xlim())
    for turn in (0, 1):
        flights.plot(reach, reach + 2 * np.pi * turn, color=style.MARK, linestyle=DOTTED, linewidth=0.9, zorder=1)
    flights.set_xlim(*reach)
    quiet(flights, "b  in the plane of the angles", x="θ₁", y="θ₂")
    for which in "xy":
        angle_axis(flights, which, step=1.0)
    quiet(axes, "c  cuts on θ₁ = θ₂ + 2πk", x="θ₁ on the section (rad)", y="p / p₀")
    for cut, colour, sign in ((search.cuts[0], style.UNSTABLE, 1), (search.cuts[1], style.STABLE, -1)):
        for piece in cut.pieces:
            # Time reversal keeps the angles and reverses momenta.
            points = piece.points * np.array([1.0, sign])
            for part in wrapped_runs(points, (2 * np.pi, None)):
                axes.plot(*part.T, color=colour, linewidth=0.9)
    for c in back:
        q, p = section_points(system, c.section, c.state)
        axes.plot(q - 2 * np.pi * np.rint(q / (2 * np.pi)), p, "o", color=shades[c.name], markersize=6, mec="white")
    angle_axis(axes, "x")
    space.set_title("a  in (θ₁, θ₂, ω₁)", fontsize=10, loc="left", y=0.98)
    for which, label in (("x", "θ₁"), ("y", "θ₂"), ("z", "ω₁ (rad/s)")):
        getattr(space, f"set_{which}label")(label, fontsize=9)
        if which != "z":
            angle_axis(space, which, step=1.0)
    space.view_init(elev=22, azim=-122)  # type: ignore[attr-defined]
    space.tick_params(labelsize=8, colors=style.CART)
    looks = [("orbit about Down-Up", {"color": style.saddle_colour("down-up"), "linewidth": 2.6}),
             ("unstable tube, 1st crossing", style.UNSTABLE), ("stable tube, 2nd crossing", style.STABLE)]  # fmt: skip
    key(figure, looks, fontsize=8.5, loc="upper right", bbox_to_anchor=(0.99, 0.965), ncols=3)
    whole = "" if search.complete else "at least "
    return Page(
        figure,
        f"Connections from the Lyapunov orbit about Down-Up at {SENSES_ENERGY:g} J to the same orbit without a turn "
        "of an arm. They pass θ₁ = θ₂ (dotted) towards Up-Down's side and return the other way. a and b: flights "
        "of one sense. c: the unstable tube at its first crossing of θ₁ = θ₂ and the stable tube at the second before "
        f"it arrives. Found: {whole}{len(back)} of flights up to {_RETURN_FLIGHT:g} periods; dots of one colour are "
        "one connection and its images.",
        "Tubes scatter before later crossings, so longer flights are not listed; `dpcontrol connect lab --section "
        f"aligned --hits 1,2 --longest 2` lists these. {IDENTIFIED}",
    )


def _by_flight(connections: Sequence) -> dict[str, str]:
    """Return a colour for each connection by name; symmetric images have equal durations and share one."""
    lengths: list[float] = []
    for c in sorted(connections, key=lambda c: c.time_in + c.time_out):
        if not lengths or c.time_in + c.time_out - lengths[-1] > 1e-6:
            lengths.append(c.time_in + c.time_out)
    shades = style.CONNECTIONS
    return {c.name: shades[int(np.argmin(np.abs(np.array(lengths) - c.time_in - c.time_out))) % len(shades)]
            for c in connections}  # fmt: skip


_SEEDS, _OFF = 6000, 1e-5
_FALL = 60.0
"""Longest duration of a fall, in e-folding times of the slow direction."""


def up_up_states(system: System) -> Array:
    """Return the first crossings of θ₂ = 2πk on Up-Up's unstable manifold.

    They are states (K, N).
    """
    top = system.equilibria["up-up"]
    values, vectors = np.linalg.eig(system.numeric.jacobian(top))
    rising = np.argsort(np.real(values))[-2:]
    plane = np.real(vectors[:, rising]) / np.linalg.norm(np.real(vectors[:, rising]), axis=0)
    # The slow direction grows less until the fast one has left; a logarithmic scale covers all ratios of both.
    fast, slow = _spread(_SEEDS)
    seeds = top + _OFF * np.column_stack([slow, fast]) @ plane.T
    section = system.sections["down-up", "down-up"]
    met = system.propagator.crossings(seeds, section, longest=_FALL / float(np.sort(np.real(values))[-2]))
    return np.array([one.state for one in met if one is not None])


def _spread(count: int) -> tuple[Array, Array]:
    """Return components along the fast and the slow direction.

    They have both signs of each, with ratios from 1e-6 to 1e6.
    """
    ratio = np.logspace(-6, 6, count // 4)
    fast, slow = ratio / np.hypot(1, ratio), 1 / np.hypot(1, ratio)
    return np.concatenate([fast, fast, -fast, -fast]), np.concatenate([slow, -slow, slow, -slow])


def up_up_page(gallery: Gallery) -> Page:
    """Draw the intersections of Up-Up's manifolds with θ₂ = 2πk.

    Unstable and stable manifold are drawn as points.
    """
    system = gallery.system("lab")
    states, section = up_up_states(system), system.sections["down-up", "down-up"]
    points = section_points(system, section, states)
    sense = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    energy = float(system.numeric.hamiltonian(system.equilibria["up-up"]))
    figure = new_figure(11, 5.6, f"The manifolds of Up-Up at its energy of {energy:.4f} J on the section θ₂ = 2πk")
    panels = figure.subplots(1, 2, sharex=True, sharey=True, gridspec_kw={
        "left": 0.07, "right": 0.985, "top": 0.82, "bottom": 0.11, "wspace": 0.08})  # fmt: skip
    q = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # Time reversal changes the sign of momenta and of the crossing.
    for axes, way in zip(panels, (1, -1), strict=True):
        for sign, colour in ((1, style.UNSTABLE), (-1, style.STABLE)):
            here = sense * sign == way
            axes.scatter(q[here], sign * points[here, 1], s=2.0, color=colour, linewidths=0)
        quiet(axes, f"θ₂ {'rises' if way > 0 else 'falls'}", x="θ₁ on the section (rad)",
              y="p / p₀" if way > 0 else "")  # fmt: skip
        angle_axis(axes, "x")
    key(figure, [("unstable manifold", style.UNSTABLE), ("stable manifold", style.STABLE)], loc="upper right",
        bbox_to_anchor=(0.985, 0.93), ncols=2, fontsize=9)  # fmt: skip
    return Page(
        figure,
        f"Up-Up has two unstable directions, so at its energy of {energy:.4f} J its unstable manifold is a surface "
        f"that starts at a point, and no tube. {len(points):,} trajectories that leave it in all directions of the "
        "unstable plane are drawn as points (red) at their first crossing of the section with the outer arm hanging. "
        "Green: the stable manifold, which is the image under time reversal. At points of both colours a trajectory "
        "falls from Up-Up and climbs back to it.",
        "The paper leaves these manifolds out. Around Up-Up no closed curve of orbits separates the motions, so "
        "there are no cuts to intersect; connections of Up-Up exist, but are not searched or offered as symbols. The "
        "triple pendulum has no such picture either: in its six-dimensional phase space tubes do not meet generically.",
    )
