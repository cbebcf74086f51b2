"""Families of Lyapunov orbits about both saddles: shapes, periods and multipliers against energy."""

from dpcontrol.orbits.equilibria import equilibria
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.review.family_figure import draw_families
from dpcontrol.review.figures.page import Gallery, Page

_HIGHEST = 0.45


def draw(gallery: Gallery) -> Page:
    """Draw the families about Down-Up and Up-Down of the lab pendulum from birth to 0.45 J."""
    system = gallery.system("lab")
    births = {name: point.energy for name, point in equilibria(system).items() if point.kind.startswith("index-1")}
    families = [lyapunov_family(system, name, energies=(birth + 1e-4, _HIGHEST)) for name, birth in births.items()]
    ends = "; ".join(f"{family.saddle}: {family.status}" for family in families)
    return Page(
        draw_families(families, "Families of Lyapunov orbits of the lab pendulum"),
        "Lyapunov orbits about each saddle from their birth at the saddle (cross) upwards in energy: their shapes in "
        "the phase plane of the arm that hangs, which swings most while the other balances; their periods; and "
        f"their unstable multipliers, by which a deviation grows in one period. {ends}.",
        "Each family is followed along its own curve until 0.45 J instead of being computed at chosen energies, so "
        "that periods and multipliers can be shown against energy. Parameters are the rig's identified ones.",
    )
