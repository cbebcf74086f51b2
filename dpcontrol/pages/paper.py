"""Further figures of the paper: both landscapes, the tubes and connections of three bodies, both senses of rotation,
cuts against energy, orbits in space, a shadowing orbit, and the manifold of Up-Up."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.cut import section_points
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
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import MOST_IN_KEY, Draw, Page, Panel, key
from dpcontrol.pages.panels import angle_axis, name_point, quiet, quiet_space, wrapped_runs
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.intersections import search_settings
from dpcontrol.walks.atlas import Atlas, AtlasConnection, AtlasKind
from dpcontrol.walks.shadowing import WalkSolver

LANDSCAPES = {"three-body": (-1.523, -1.5195, -1.51, -1.5005), "lab": (-0.3, -0.07, 0.2, 0.55)}
"""Energies, one between the heights of adjacent critical points."""
_GRID = 361
_REACHED, _FORBIDDEN = "#dbe9f6", "#8d959e"


def landscape_page(gallery: Gallery) -> PaperFigure:
    """Draw potential energies and Hill's regions at four energies.

    Both are drawn for three bodies and the pendulum.
    """
    page = Page("Energy landscapes and Hill's regions: higher energies open more saddles")
    words = []
    for name, energies in LANDSCAPES.items():
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
        field = first, second, potential
        regions = [
            partial(_hill, field=field, energy=energy, points=points, angular=angular,
                    title=_opened(points, energy, system.worded(f"{energy:g} J")))
            for energy in energies
        ]  # fmt: skip
        page.row(Panel(partial(_relief, field=field, angular=angular), 1.35, space=True), *regions, height=3.0)
        listed = ", ".join(system.worded(f"{n} {p[1]:+.4f} J") for n, p in points.items())
        words.append(f"{'Pendulum' if angular else 'Three bodies'}: {listed}.")
    return PaperFigure(
        page.figure(),
        "Above the restricted three-body problem in its rotating frame, below the lab pendulum. Left: the energy at "
        "rest, over the plane and over the torus of the two angles (from hanging). Right: Hill's regions, one energy "
        "between adjacent critical points; blue regions are accessible, grey ones are not. Squares: the saddles whose "
        "necks connect regions, L1 and L2, and their counterparts Down-Up and Up-Down. Circle: the stable equilibrium; "
        f"triangles: maxima. Green: reached; red: not. {' '.join(words)}",
        f"Each energy lies between two adjacent equilibria. {IDENTIFIED}",
    )


Points = dict[str, tuple[Array, float, str]]
Field = tuple[Array, Array, Array]


def _relief(axes: Axes, field: Field, *, angular: bool) -> None:
    first, second, potential = field
    # The wells of the primaries are bottomless.
    shown = np.maximum(potential, potential.min() if angular else -1.62)
    axes.plot_surface(first, second, shown, cmap="viridis", linewidth=0, rcount=90, ccount=90, alpha=0.95)  # type: ignore[attr-defined]
    axes.view_init(elev=38, azim=-60)  # type: ignore[attr-defined]
    axes.set_title("double pendulum: energy at rest (J)" if angular else "three bodies: energy at rest", loc="left")
    for which, label in (("x", "θ₁"), ("y", "θ₂")) if angular else (("x", "x"), ("y", "y")):
        if angular:
            angle_axis(axes, which, step=1.0)
        getattr(axes, f"set_{which}label")(label, fontsize=style.SMALL, labelpad=-4)
    axes.tick_params(labelsize=style.SMALL, pad=-2)
    axes.locator_params(axis="z", nbins=4)  # type: ignore[arg-type]


def _hill(axes: Axes, field: Field, energy: float, points: Points, *, angular: bool, title: str) -> None:
    _region(axes, field, energy, points, angular=angular)
    quiet(axes, title, x="θ₁" if angular else "x", y="θ₂" if angular else "y")
    axes.grid(False)
    axes.set_aspect("equal")
    if angular:
        angle_axis(axes, "x", step=1.0)
        angle_axis(axes, "y", step=1.0)


def _region(axes: Axes, field: Field, energy: float, points: Points, *, angular: bool) -> None:
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
                axes.plot(a, b, mark, color=style.GOOD if height <= energy else style.LIMIT, clip_on=False,
                          markersize=6 if angular else 4.5)  # fmt: skip
                if not angular:
                    name_point(axes, name, (float(a), float(b)), style.INK)


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


def three_body_page(gallery: Gallery) -> PaperFigure:
    """Draw L1's and L2's orbits, their tubes and first connections.

    The section is x = 1 - μ. Both directions are drawn.
    """
    atlas = gallery.atlas("three-body", BETWEEN_ENERGY, None)
    pairs = (("L1", "L2"), ("L2", "L1"))
    page = Page(f"Three bodies: heteroclinic connections of L1 and L2 at energy {BETWEEN_ENERGY:g}")
    counts = _rows(page, gallery, [(atlas, *pair, NEAR) for pair in pairs])
    kind = kind_of(atlas, "L1", "L2")
    assert kind is not None
    return PaperFigure(
        page.figure(),
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


def three_body_homoclinics_page(gallery: Gallery) -> PaperFigure:
    """Draw the homoclinic connections of L1 and of L2.

    The page shows tubes, cuts on y = 0, x < 0, and the orbits.
    """
    rows = [(gallery.atlas("three-body", energy, (1, 1)), saddle, saddle, WHOLE[saddle])
            for saddle, energy in HOMOCLINIC_ENERGIES.items()]  # fmt: skip
    page = Page("Three bodies: homoclinic connections of L1 and of L2")
    counts = _rows(page, gallery, rows)
    return PaperFigure(
        page.figure(),
        "The planar circular restricted three-body problem in the rotating frame; above the orbit about L1, below that "
        "about L2. Left: the branches of its unstable (red) and stable (green) tubes that go round the larger primary "
        "to the section y = 0, x < 0 (dotted). Grey: inaccessible. Middle: the cuts there, x and its momentum, with "
        "the connections found. Right: one flight of each colour, solid for a symmetric one and dashed for one "
        f"of a mirror pair. {counts}.",
        "The chosen energies are slightly above those of the points, with few connections. Flights are limited to "
        "four periods of their orbit before the section; longer ones exist.",
    )


def _rows(page: Page, gallery: Gallery, rows: Sequence[tuple[Atlas, str, str, Extent]]) -> str:
    """Add tubes, cuts and flights, a row for each.

    Rows are (atlas, source, target, extent). Return their counts in words.
    """
    words = []
    for row, (atlas, source, target, extent) in enumerate(rows):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        letters, section = "abc" if row == 0 else "def", kind.section.replace("mu", "μ")
        connections = connections_of(atlas, kind)
        look = colours(connections)
        chosen = {look[c.name]: c for c in sorted(connections, key=lambda c: c.name, reverse=True)}.values()
        kept = sorted(chosen, key=lambda c: (not c.symmetric, c.name))[: 1 if source != target else 4]
        plane = partial(_plane, gallery=gallery, atlas=atlas, extent=extent, section=section)
        page.row(
            Panel(partial(_tubes, plane=plane, atlas=atlas, kind=kind, letter=letters[0]), 1.3),
            partial(_cuts, atlas=atlas, kind=kind, kept=kept, title=f"{letters[1]}  cuts on {section}"),
            Panel(partial(_flights, plane=plane, kind=kind, kept=kept, look=look, letter=letters[2]), 1.3),
            height=4.0,
        )
        symmetric = sum(c.symmetric for c in connections)
        least = f"{'' if source != target else f'at {atlas.energy:g} '}{'' if kind.complete else 'at least '}"
        both = f" ({symmetric} symmetric)" if source == target else ""
        words.append(f"{source} to {target}: {least}{kind.count} connections{both}")
    return "; ".join(words)


def _tubes(axes: Axes, plane: Draw, atlas: Atlas, kind: AtlasKind, letter: str) -> None:
    plane(axes)
    source, target = kind.source, kind.target
    for saddle, hit, stable in ((source, kind.hits[0], False), (target, kind.hits[1], True)):
        for strand in atlas.cut(saddle, kind.section, hit).strands:
            states = atlas.turned(strand, saddle) if stable else strand
            colour = style.STABLE if stable else style.UNSTABLE
            axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.45, alpha=0.75)
    both = f"{source} and {target}" if source != target else source
    axes.set_title(f"{letter}  tubes of {both}, energy {atlas.energy:g}", loc="left")


def _cuts(axes: Axes, atlas: Atlas, kind: AtlasKind, kept: Sequence[AtlasConnection], *, title: str) -> None:
    draw_cuts(axes, atlas, kind, numbers={c.name: str(k + 1) for k, c in enumerate(kept)}, legend=False)
    axes.set_title(f"{title}, hits {list(kind.hits)}", loc="left")


def _flights(
    axes: Axes, plane: Draw, kind: AtlasKind, kept: Sequence[AtlasConnection], look: dict[str, str], letter: str
) -> None:
    plane(axes)
    for c in kept:
        line = "-" if c.symmetric or kind.source != kind.target else (0, (5, 2))
        axes.plot(*c.states[:, :2].T, color=look[c.name], linewidth=1.1, linestyle=line, zorder=3)
    title = f"{letter}  from {kind.source}'s orbit to {kind.target}'s" if kept else "none found"
    axes.set_title(title, loc="left")


def _plane(axes: Axes, gallery: Gallery, atlas: Atlas, extent: Extent, *, section: str) -> None:
    """Draw the inaccessible region, the orbits, the primaries and the section."""
    system, (wide, high) = gallery.system("three-body"), extent
    mu = float(system.parameters[0])
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
        name_point(axes, orbit.saddle, (float(closed[:, 0].mean()), float(closed[:, 1].max())), colour)
    axes.plot(1 - mu, 0, "o", color=style.INK, markersize=4, zorder=6)
    if wide[0] < -mu:
        axes.plot(-mu, 0, "o", color=style.INK, markersize=8, zorder=6)
    dotted = {"color": style.MARK, "linewidth": 0.9, "linestyle": style.DOTTED}
    if section.startswith("x"):
        axes.axvline(1 - mu, **dotted)
    else:
        axes.plot([wide[0], 0], [0, 0], **dotted)
    axes.set(xlim=wide, ylim=high, aspect="equal")


_SIZES = (0.002, 0.02, 0.06, 0.12, 0.2)
"""Energies of the drawn Lyapunov orbits above the saddle, J."""
_POSES = 7


def lyapunov_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw Lyapunov orbits about both saddles in both phase planes.

    The motion of one is also drawn.
    """
    system = gallery.system("lab")
    page = Page("Lyapunov orbits of the lab pendulum, in the phase plane of either arm")
    for saddle in ("down-up", "up-down"):
        birth = float(system.numeric.hamiltonian(system.equilibria[saddle]))
        curves: list[tuple[float, Array]] = []
        for above in _SIZES:
            orbit = lyapunov_orbit(system, saddle, energy=birth + above)
            curves.append((birth + above, system.propagator.sample(orbit.state, np.linspace(0.0, orbit.period, 400))))
        planes = [partial(_orbits, curves=curves, saddle=saddle, system=system, arm=arm) for arm in (0, 1)]
        page.row(*planes, Panel(partial(_motion, system=system, energy=curves[2][0], states=curves[2][1]), 0.8),
                 height=3.4)  # fmt: skip
    return PaperFigure(
        page.figure(),
        f"Lyapunov orbits about Down-Up (above) and Up-Down (below), {', '.join(f'{a:g}' for a in _SIZES)} J above "
        "their saddle (cross): left the inner arm's angle and rate, middle the outer arm's. Right: half a period of "
        "the third orbit, from pale to dark; the dot is the pivot. The hanging arm swings widely while the upright "
        "one balances.",
        f"The paper gives no energies for its curves, so these are chosen. {IDENTIFIED}",
    )


def _orbits(axes: Axes, curves: list[tuple[float, Array]], saddle: str, system: System, arm: int) -> None:
    """Draw orbits in the phase plane of an arm, labelled with their energies at the top of each."""
    number = style.number(arm)
    for k, (energy, states) in enumerate(curves):
        colour = style.SERIES[k]
        axes.plot(states[:, arm], states[:, 2 + arm], color=colour, linewidth=1.4)
        if arm == 0:
            key_text = f"{energy:.3g} J"
            axes.annotate(
                key_text, (1.0, 1.0 - 0.09 * k), xycoords="axes fraction", xytext=(4, 0), textcoords="offset points",
                va="top", fontsize=style.SMALL, color=colour, annotation_clip=False,
            )  # fmt: skip
    axes.plot(system.equilibria[saddle][arm], 0, "+", color=style.LIMIT, markersize=9)
    quiet(axes, "" if arm else f"about {saddle}", x=f"θ{number} (rad)", y=f"ω{number} (rad/s)")
    angle_axis(axes, "x")


def _motion(axes: Axes, system: System, energy: float, states: Array) -> None:
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
    axes.set_title(f"the motion at {energy:.3g} J", loc="left")


SENSES_ENERGY = 0.2
_TURNING = {"down-up": ("outer", "θ₂ = 2πk", "θ₁"), "up-down": ("inner", "θ₁ = 2πk", "θ₂")}


def senses_page(gallery: Gallery, *, saddle: str) -> PaperFigure:
    """Draw a saddle's tubes at 0.2 J and their cuts.

    The two senses of rotation are separate.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    kind = kind_of(atlas, saddle, saddle)
    assert kind is not None
    arm, section, coordinate = _TURNING[saddle]
    cuts = [cut for cut in atlas.cuts if (cut.saddle, cut.section.name, cut.hit) == (saddle, kind.section, 1)]
    page = Page(f"The tubes of {saddle} at {SENSES_ENERGY:g} J: the {arm} arm turns either way")
    spaces, panels, counts = [], [], []
    for column, sense in enumerate((1, -1)):
        way = "forward" if sense > 0 else "backward"
        shown = tuple(c for c in connections_of(atlas, kind) if c.sense == sense)
        title = f"{'ab'[column]}  the {arm} arm turns {way}"
        spaces.append(
            Panel(partial(_sense, atlas=atlas, cuts=cuts, sense=sense, saddle=saddle, title=title), space=True)
        )
        title = f"{'cd'[column]}  cuts on {section}, crossed {way}"
        panels.append(partial(_sense_cuts, atlas=atlas, kind=kind, shown=shown, sense=sense, title=title))
        counts.append(f"{len(shown)} {way}")
    page.row(*spaces, height=4.8).row(*panels, height=3.4)
    return PaperFigure(
        page.figure(),
        f"Trajectories that leave the Lyapunov orbit about {saddle} at {SENSES_ENERGY:g} J (red) and that approach it "
        f"(green), in (θ₁, θ₂, ω₁), up to the section {section}. Panels a and b: the two senses of the {arm} arm. "
        f"Below, the corresponding cuts: {coordinate} on the section and its momentum over p₀. Homoclinic "
        f"connections: {' and '.join(counts)}.",
        "Both tubes start at the orbit's named position, so the red one ends on one sheet of the section and the green "
        f"one begins on another, whole turns away. Momenta are canonical in place of the paper's rates. {IDENTIFIED}",
    )


def _sense(axes: Axes, atlas: Atlas, cuts: list, *, sense: int, saddle: str, title: str) -> None:
    draw_space(axes, atlas, cuts, steps=(1.0, 1.0), sense=sense, saddles=(saddle,))
    axes.set_title(title, loc="left")
    looks = [("tube out", style.UNSTABLE), ("tube in", style.STABLE)]
    key(axes, [*looks, ("Lyapunov orbit", style.saddle_colour(saddle)), ("cut", style.CUT)])


def _sense_cuts(axes: Axes, atlas: Atlas, kind: AtlasKind, *, shown: tuple, sense: int, title: str) -> None:
    draw_cuts(axes, atlas, kind, shown=shown, legend=False, sense=sense)
    axes.set_title(title, loc="left")


CUT_ENERGIES = (-0.147, -0.07, -0.034, 0.06, 0.102, 0.157)


def cuts_page(gallery: Gallery) -> PaperFigure:
    """Draw the cuts of Down-Up's tubes at six energies."""
    page = Page("Cuts of the tubes of Down-Up on θ₂ = 2πk, as energy grows (first hits)")
    panels: list[Draw] = []
    words = []
    for k, energy in enumerate(CUT_ENERGIES):
        gallery.progress(f"cuts at {energy:g} J", k / len(CUT_ENERGIES))
        atlas = gallery.atlas("lab", energy, (1, 1))
        kind = kind_of(atlas, "down-up", "down-up")
        assert kind is not None
        symmetric = sum(c.symmetric for c in connections_of(atlas, kind))
        title = f"{'abcdef'[k]}  {energy:g} J: {kind.count} connections, {symmetric} symmetric"
        panels.append(partial(_energy_cuts, atlas=atlas, kind=kind, title=title, legend=k == 0))
        words.append(f"{kind.count} at {energy:g} J")
    page.row(*panels[:3], height=3.5).row(*panels[3:], height=3.3)
    return PaperFigure(
        page.figure(),
        "First cuts of the unstable (red) and stable (green) tubes of the Lyapunov orbit about Down-Up on the section "
        "with the outer arm hanging, at six energies: the inner arm's angle and its momentum over p₀. Solid: a "
        "rising angle of the outer arm; dashed: a falling one. Homoclinic connections, both senses: "
        f"{', '.join(words)}.",
        f"Momenta are canonical in place of the paper's rates; both senses are in one panel. {IDENTIFIED}",
    )


def _energy_cuts(axes: Axes, atlas: Atlas, kind: AtlasKind, *, title: str, legend: bool) -> None:
    draw_cuts(axes, atlas, kind, legend=legend)
    axes.set_title(title, loc="left")


def heteroclinic_orbits_page(gallery: Gallery) -> PaperFigure:
    """Draw heteroclinic connections at 0.2 J in (θ₁, θ₂, ω₁).

    Both Lyapunov orbits are included.
    """
    atlas = gallery.atlas("lab", SENSES_ENERGY, (1, 1))
    page = Page(f"Heteroclinic orbits in (θ₁, θ₂, ω₁) at {SENSES_ENERGY:g} J")
    words, spaces = [], []
    for column, (source, target) in enumerate((("down-up", "up-down"), ("up-down", "down-up"))):
        kind = kind_of(atlas, source, target)
        assert kind is not None
        # One of each pair of reflections is drawn.
        kept = [c for c in connections_of(atlas, kind) if c.sense > 0]
        title = f"{'ab'[column]}  {source} → {target}"
        spaces.append(Panel(partial(_between, atlas=atlas, target=target, kept=kept, title=title), space=True))
        words.append(f"{len(kept)} from {source} to {target}")
    page.row(*spaces, height=5.4)
    return PaperFigure(
        page.figure(),
        f"The heteroclinic connections at {SENSES_ENERGY:g} J whose difference of angles grows on the section θ₁ = θ₂ "
        f"({' and '.join(words)}; each has a reflection). They lead from one Lyapunov orbit to the other "
        "and are labelled with the angle between the tubes. Those of b are those of a, run backward in time.",
        f"The paper draws one direction. {IDENTIFIED}",
    )


def _between(axes: Axes, atlas: Atlas, target: str, kept: Sequence[AtlasConnection], *, title: str) -> None:
    draw_space(axes, atlas, (), saddles=())
    for orbit in atlas.orbits:
        turns = {c.winding for c in kept} if orbit.saddle == target else {(0, 0)}
        for winding in sorted(turns):
            closed = placed(atlas, orbit, winding)[:, :3]
            axes.plot(*closed.T, color=style.saddle_colour(orbit.saddle), linewidth=2.5, zorder=10)
    for k, c in enumerate(kept):
        axes.plot(*c.states[:, :3].T, color=style.SERIES[k % len(style.SERIES)], linewidth=1.2)
    axes.set_title(title, loc="left")
    looks = [(f"{c.transversality_angle:.1f}°", style.SERIES[k]) for k, c in enumerate(kept[:MOST_IN_KEY])]
    key(axes, looks)


def shadowing_page(gallery: Gallery) -> PaperFigure:
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
    page = Page("One homoclinic orbit of Down-Up at -0.07 J, and orbits that shadow it")
    words, above, below = [], [], []
    for title, found in shapes.items():
        assert found.converged, found.status
        times = np.linspace(0.0, found.duration, 1500)
        above.append(partial(_outer_arm, states=found.states(times), title=title))
        below.append(partial(_both_arms, times=times, states=found.states(times)))
        words.append(f"{title[0]} {found.duration:.2f} s, residual {found.residual:.0e}")
    page.row(*above, height=3.2).row(*below, height=3.0)
    return PaperFigure(
        page.figure(),
        "Above, the outer arm in its phase plane; below, both angles against time. The homoclinic orbit leaves the "
        "Lyapunov orbit, turns the outer arm once and returns. Beside it lie an orbit that does this twice, "
        "with the fewest sufficient wobbles between, and a periodic one that repeats it with as many wobbles in each "
        f"period. Durations: {'; '.join(words)}.",
        f"All three are solved by multiple shooting, with the fewest wobbles that converge. {IDENTIFIED}",
    )


def _outer_arm(axes: Axes, states: Array, title: str) -> None:
    """Draw the outer arm in its phase plane, its angle within the turn about upright."""
    for part in wrapped_runs(np.column_stack([states[:, 1] - np.pi, states[:, 3]]), (2 * np.pi, None)):
        axes.plot(part[:, 0] + np.pi, part[:, 1], color=style.arm_colour(1), linewidth=1.1)
    quiet(axes, title, x="θ₂ modulo a turn (rad)", y="ω₂ (rad/s)")
    angle_axis(axes, "x")


def _both_arms(axes: Axes, times: Array, states: Array) -> None:
    for arm in (0, 1):
        axes.plot(times, states[:, arm], color=style.arm_colour(arm), linewidth=1.2)
    quiet(axes, "Angles (rad)", x="time (s)")
    key(axes, [("θ₁", style.arm_colour(0)), ("θ₂", style.arm_colour(1))])
    angle_axis(axes, "y", step=1.0)
    axes.margins(x=0)


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


def returning_page(gallery: Gallery) -> PaperFigure:
    """Draw homoclinics of Down-Up that cross θ₁ = θ₂ and return.

    They pass Up-Down's side.
    """
    system = gallery.system("lab")
    search = returning_search(system)
    back = [c for c in search.connections if not any(c.winding)]
    orbit = search.source
    page = Page("Homoclinic orbits of Down-Up that return through θ₁ = θ₂ the other way, at 0.2 J")
    shades = _by_flight(back)
    closed = system.propagator.sample(orbit.state, np.linspace(0, orbit.period, 200))
    curves = []
    for c in (c for c in back if c.sense > 0):
        times = np.linspace(float(c.orbit.times[0]), float(c.orbit.times[-1]), 900)
        curves.append((shades[c.name], c.orbit.sample(times)))
    page.row(
        Panel(partial(_returning_space, system=system, curves=curves, closed=closed), 1.5, space=True),
        partial(_returning_plane, curves=curves, closed=closed),
        partial(_returning_cuts, search=search, back=back, shades=shades),
        height=4.8,
    )
    whole = "" if search.complete else "at least "
    return PaperFigure(
        page.figure(),
        f"Connections from the Lyapunov orbit about Down-Up at {SENSES_ENERGY:g} J to the same orbit without a turn "
        "of an arm. They pass θ₁ = θ₂ (dotted) towards Up-Down's side and return the other way. a and b: flights "
        "of one sense. c: the unstable tube at its first crossing of θ₁ = θ₂ and the stable tube at the second before "
        f"it arrives. Found: {whole}{len(back)} of flights up to {_RETURN_FLIGHT:g} periods; dots of one colour are "
        "one connection and its images.",
        "Tubes scatter before later crossings, so longer flights are not listed; `dpcontrol connect lab --section "
        f"aligned --hits 1,2 --longest 2` lists these. {IDENTIFIED}",
    )


Curves = list[tuple[str, Array]]
"""Colours and states of flights."""


def _returning_space(axes: Axes, system: System, curves: Curves, closed: Array) -> None:
    for colour, states in curves:
        axes.plot(*states[:, :3].T, color=colour, linewidth=1.0)
    axes.plot(*closed[:, :3].T, color=style.saddle_colour("down-up"), linewidth=2.6, zorder=10)
    quiet_space(axes, system)
    axes.set_title("a  in (θ₁, θ₂, ω₁)", loc="left")


def _returning_plane(axes: Axes, curves: Curves, closed: Array) -> None:
    for colour, states in curves:
        axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=1.1)
    axes.plot(closed[:, 0], closed[:, 1], color=style.saddle_colour("down-up"), linewidth=3)
    reach = np.array(axes.get_xlim())
    for turn in (0, 1):
        axes.plot(reach, reach + 2 * np.pi * turn, color=style.MARK, linestyle=style.DOTTED, linewidth=0.9, zorder=1)
    axes.set_xlim(*reach)
    quiet(axes, "b  in the plane of the angles", x="θ₁", y="θ₂")
    for which in "xy":
        angle_axis(axes, which, step=1.0)


def _returning_cuts(axes: Axes, search: ConnectionSearch, back: Sequence, shades: dict[str, str]) -> None:
    quiet(axes, "c  cuts on θ₁ = θ₂ + 2πk", x="θ₁ on the section (rad)", y="p / p₀")
    for cut, colour, sign in ((search.cuts[0], style.UNSTABLE, 1), (search.cuts[1], style.STABLE, -1)):
        for piece in cut.pieces:
            # Time reversal keeps the angles and reverses momenta.
            for part in wrapped_runs(piece.points * np.array([1.0, sign]), (2 * np.pi, None)):
                axes.plot(*part.T, color=colour, linewidth=0.9)
    for c in back:
        q, p = section_points(search.source.system, c.section, c.state)
        axes.plot(q - 2 * np.pi * np.rint(q / (2 * np.pi)), p, "o", color=shades[c.name], markersize=6, mec="white")
    angle_axis(axes, "x")
    key(axes, [("tube out, 1st crossing", style.UNSTABLE), ("tube in, 2nd crossing", style.STABLE)])


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


def up_up_page(gallery: Gallery) -> PaperFigure:
    """Draw the intersections of Up-Up's manifolds with θ₂ = 2πk.

    Unstable and stable manifold are drawn as points.
    """
    system = gallery.system("lab")
    states, section = up_up_states(system), system.sections["down-up", "down-up"]
    points = section_points(system, section, states)
    sense = np.sign(system.numeric.rate(states) @ np.asarray(section.normal))
    energy = float(system.numeric.hamiltonian(system.equilibria["up-up"]))
    page = Page(f"The manifolds of Up-Up at its energy of {energy:.4f} J on the section θ₂ = 2πk")
    page.row(*(partial(_manifolds, points=points, sense=sense, way=way) for way in (1, -1)), height=5.0)
    return PaperFigure(
        page.figure(),
        f"Up-Up has two unstable directions, so at its energy of {energy:.4f} J its unstable manifold is a surface "
        f"that starts at a point, and no tube. {len(points):,} trajectories that leave it in all directions of the "
        "unstable plane are drawn as points (red) at their first crossing of the section with the outer arm hanging. "
        "Green: the stable manifold, which is the image under time reversal. At points of both colours a trajectory "
        "falls from Up-Up and climbs back to it.",
        "The paper leaves these manifolds out. Around Up-Up no closed curve of orbits separates the motions, so "
        "there are no cuts to intersect; connections of Up-Up exist, but are not searched or offered as symbols. The "
        "triple pendulum has no such picture either: in its six-dimensional phase space tubes do not meet generically.",
    )


def _manifolds(axes: Axes, points: Array, sense: Array, way: int) -> None:
    """Draw the points at which both manifolds cross the section in one direction."""
    q = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # Time reversal changes the sign of momenta and of the crossing.
    for sign, colour in ((1, style.UNSTABLE), (-1, style.STABLE)):
        here = sense * sign == way
        axes.scatter(q[here], sign * points[here, 1], s=2.0, color=colour, linewidths=0)
    quiet(axes, f"θ₂ {'rises' if way > 0 else 'falls'}", x="θ₁ on the section (rad)", y="p / p₀")
    key(axes, [("unstable manifold", style.UNSTABLE), ("stable manifold", style.STABLE)])
    angle_axis(axes, "x")
