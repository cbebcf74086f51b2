"""Families of Lyapunov orbits against energy."""

from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.pages.gallery import Gallery, PaperFigure
from dpcontrol.pages.orbits import draw_families

_HIGHEST = 0.45


def families_page(gallery: Gallery) -> PaperFigure:
    """Draw the families about Down-Up and Up-Down up to 0.45 J."""
    system = gallery.system("lab")
    births = {name: point.energy for name, point in equilibria(system).items() if point.kind.startswith("index-1")}
    families = [lyapunov_family(system, name, energies=(birth + 1e-4, _HIGHEST)) for name, birth in births.items()]
    ends = "; ".join(f"{family.saddle}: {family.status}" for family in families)
    return PaperFigure(
        draw_families(families, "Families of Lyapunov orbits of the lab pendulum"),
        "Lyapunov orbits about each saddle from their birth at the saddle (cross) upwards in energy: their shapes in "
        "the phase plane of the hanging arm, their periods and their unstable multipliers. The hanging arm swings most "
        f"while the other balances. A multiplier is the growth of a deviation in one period. {ends}.",
        "Each family is continued up to 0.45 J instead of being computed at chosen energies, which gives "
        "periods and multipliers against energy. Parameters are the rig's identified ones.",
    )
