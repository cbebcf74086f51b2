"""The unstable and the stable manifold of Up-Up on a section."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.orbits.cut import section_points
from dpcontrol.pages import style
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.layout import Page, key
from dpcontrol.pages.panels import angle_axis, quiet

_SEEDS, _OFF = 6000, 1e-5
_FALL = 60.0
"""Longest duration of a fall, in e-folding times of the slow direction."""


def up_up_states(system: System) -> Array:
    """Return the first crossings of θ₂ = 2πk on Up-Up's unstable manifold.

    The first crossings are states (K, N).
    """
    top = system.equilibria["up-up"]
    values, vectors = np.linalg.eig(system.numeric.jacobian(top))
    rising = np.argsort(np.real(values))[-2:]
    plane = np.real(vectors[:, rising]) / np.linalg.norm(np.real(vectors[:, rising]), axis=0)
    # The slow direction grows less until the fast one has left; a logarithmic scale covers all ratios of both.
    ratio = np.logspace(-6, 6, _SEEDS // 4)
    fast, slow = ratio / np.hypot(1, ratio), 1 / np.hypot(1, ratio)
    seeds = np.concatenate([np.column_stack([a * slow, b * fast]) for a in (1, -1) for b in (1, -1)])
    section = system.sections["down-up", "down-up"]
    met = system.propagator.crossings(
        top + _OFF * seeds @ plane.T, section, longest=_FALL / float(np.sort(np.real(values))[-2])
    )
    return np.array([one.state for one in met if one is not None])


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
    """Draw points where both manifolds cross the section in one direction."""
    q = (points[:, 0] + np.pi) % (2 * np.pi) - np.pi
    # Time reversal changes the sign of momenta and of the crossing.
    for sign, colour in ((1, style.UNSTABLE), (-1, style.STABLE)):
        here = sense * sign == way
        axes.scatter(q[here], sign * points[here, 1], s=2.0, color=colour, linewidths=0)
    quiet(axes, f"θ₂ {'rises' if way > 0 else 'falls'}", x="θ₁ on the section (rad)", y="p / p₀")
    key(axes, [("unstable manifold", style.UNSTABLE), ("stable manifold", style.STABLE)])
    angle_axis(axes, "x")
