"""An orbit that shadows a chain of connections."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.pages import single, style
from dpcontrol.pages.gallery import IDENTIFIED, Gallery, PaperFigure
from dpcontrol.pages.layout import Page
from dpcontrol.pages.panels import quiet_plane, wrapped_runs
from dpcontrol.tubes.connections import find_connections
from dpcontrol.walks.shadowing import ShadowingOrbit, WalkSolver


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
    words, above, below = [], [], []
    for title, found in shapes.items():
        assert found.converged, found.status
        above.append(partial(_outer_arm, orbit=found, title=title))
        below.append(partial(single.walk, found=found))
        words.append(f"{title[0]} {found.duration:.2f} s, residual {found.residual:.0e}")
    page = Page("One homoclinic orbit of Down-Up at -0.07 J, and orbits that shadow it")
    return PaperFigure(
        page.row(*above, height=3.2).row(*below, height=3.0).figure(),
        "Above, the outer arm in its phase plane; below, both angles against time. The homoclinic orbit leaves the "
        "Lyapunov orbit, turns the outer arm once and returns. Beside it lie an orbit that does this twice, "
        "with the fewest sufficient wobbles between, and a periodic one that repeats it with as many wobbles in each "
        f"period. Durations: {'; '.join(words)}.",
        f"All three are solved by multiple shooting, with the fewest wobbles that converge. {IDENTIFIED}",
    )


def _outer_arm(axes: Axes, orbit: ShadowingOrbit, title: str) -> None:
    """Draw the outer arm in its phase plane, with its angle within the turn about upright."""
    for part in wrapped_runs(orbit.sample(1500)[:, [1, 3]] - [np.pi, 0.0], (2 * np.pi, None)):
        axes.plot(part[:, 0] + np.pi, part[:, 1], color=style.arm_colour(1), linewidth=1.1)
    quiet_plane(axes, orbit.system, (1, 3), title)
