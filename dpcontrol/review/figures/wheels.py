"""Colour wheels: the inside of Down-Up's tube carried through returns to the section."""

from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.review.figures.page import Gallery, Page
from dpcontrol.review.interior_figure import draw_interior
from dpcontrol.tubes.cut import tube_cut
from dpcontrol.tubes.interior import InteriorSettings, tube_interior

ENERGY = -0.07
SADDLE = "down-up"


def draw(gallery: Gallery) -> Page:
    """Draw two returns each way of the inside of Down-Up's unstable tube at -0.07 J."""
    system = gallery.system("lab")
    orbit = lyapunov_orbit(system, SADDLE, energy=ENERGY)
    manifold = UnstableManifold(orbit)
    cut = tube_cut(manifold, system.sections[SADDLE, SADDLE])
    interior = tube_interior(manifold, cut, settings=InteriorSettings(returns=2))
    return Page(
        draw_interior(interior),
        f"A grid over the inside of the unstable tube of Down-Up at {ENERGY:g} J, coloured like a wheel where it first "
        "meets the section, and where its points are at each return forward (above) and backward (below) in time. "
        f"What lands inside a tube's cut will pass, or has passed, the neck at Down-Up again. {interior.status}.",
        "Coordinates are canonical, so that coloured areas keep their size from return to return, and returns are "
        "drawn in both directions of time.",
    )
