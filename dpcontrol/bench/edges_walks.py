"""Where shadowing ends: wraps and tolerance by the spacing of nodes.

A node's rounding, half a unit in the last place of a rate of up to 20 rad/s, grows by λ^(1/s) to the next of s nodes in
a period of the orbit, whatever the number of wraps: multiple shooting forgets what lies before. Gaps cannot become
much smaller than

    floor = ½ ulp(rate) λ^(1/s)

whose constant depends on the luck of roundings, so that it is a bound and no prediction. The same walk is solved at
energies a billionth apart, which draw their roundings anew: at a border half of them converge. One that shoots over a
whole stop, s below one, would be lost after a single wrap.

Source: Stoer & Bulirsch, Introduction to Numerical Analysis, 3rd ed., section 7.3.5.
"""

import math
from collections.abc import Sequence

import numpy as np

from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, borders, find_border, half_of
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.scenes.model import load_model
from dpcontrol.shooting.newton import NewtonSettings
from dpcontrol.tubes.connection import Connection
from dpcontrol.walks.edges import find_edges
from dpcontrol.walks.shadowing import ShadowingSettings, shadow

ENERGY = 0.2
WRAPS = (0, 1, 2, 4, 8)
QUICK_WRAPS = (1, 4)
SPACINGS = (1, 2, 3, 4, 8)
QUICK_SPACINGS = (1, 4)
APART = 1e-9
"""Between two energies, as a share: more than rounding, and nothing to the orbits."""
DRAWS, QUICK_DRAWS = 7, 3


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer wraps and spacings."""
    walks = tuple(round_trip(ENERGY * (1 + k * APART)) for k in range(QUICK_DRAWS if quick else DRAWS))
    wraps, spacings = (QUICK_WRAPS, QUICK_SPACINGS) if quick else (WRAPS, SPACINGS)
    by_spacing = borders(
        lambda segments: tolerance_border(walks, segments=segments, wraps=2, x=segments), spacings,
        part_of(progress, 0.0, 0.5), "{} nodes a period",
    )  # fmt: skip
    by_wraps = borders(
        lambda count: tolerance_border(walks, segments=1, wraps=count, x=count), wraps, part_of(progress, 0.5, 1.0),
        "{} wraps",
    )  # fmt: skip
    return EdgeChart(
        name="edges-walks",
        title=f"Where shadowing ends: Down-Up to Up-Down and back at {ENERGY:g} J",
        maps=(
            EdgeMap("Two wraps", "nodes in a period", "tolerance of gaps, rad and rad/s", by_spacing,
                    far="not converged"),
            EdgeMap("One node in a period", "wraps", "tolerance of gaps, rad and rad/s", by_wraps,
                    far="not converged", log_x=False),
        ),
        reading=(
            "The smallest gap between pieces of orbit that Newton's method can reach: what rounding leaves.",
            "Left: it falls as nodes come nearer together. Right: many wraps are as good as none; one is worse.",
            "Rounding that grows by λ^(1/s) from node to node sets the scale; its constant is luck: no prediction.",
        ),
        chosen="Eight nodes in a period and a tolerance of 1e-11, three orders above what rounding leaves.",
    )  # fmt: skip


def round_trip(energy: float = ENERGY) -> tuple[Connection, ...]:
    """Return the lab's first crossing from Down-Up to Up-Down and the first one back."""
    system = load_model("lab").system
    edges = find_edges(system, energy, pairs=[("down-up", "up-down"), ("up-down", "down-up")])
    return edges.between("down-up", "up-down")[0], edges.between("up-down", "down-up")[0]


def rounding_floor(walk: Sequence[Connection], *, segments: int) -> float:
    """Return the gap in rad/s that rounding leaves between nodes, `segments` of them in a period."""
    fastest = max(
        float(np.abs(c.orbit.sample(np.linspace(c.orbit.times[0], c.orbit.times[-1], 400)))[:, 2:].max()) for c in walk
    )
    growth = max(c.source.unstable_multiplier for c in walk)
    return 0.5 * math.ulp(fastest) * growth ** (1 / segments)


def tolerance_border(walks: Sequence[Sequence[Connection]], *, segments: int, wraps: int, x: float) -> Border:
    """Return the smallest tolerance at which half of the walks' orbits are found with `segments` nodes a period."""

    def probe(tolerance: float) -> Attempt:
        settings = ShadowingSettings(segments, newton=NewtonSettings(tolerance=tolerance))
        orbits = [shadow(walk, wraps=[wraps], settings=settings) for walk in walks]
        return half_of([Attempt(orbit.converged, orbit.status) for orbit in orbits], "not converged")

    floor = rounding_floor(walks[0], segments=segments)
    line = f"{wraps} wraps, {segments} nodes"
    return find_border(probe, x=x, line=line, near=100 * floor, far=floor / 20, ratio=1.3)
