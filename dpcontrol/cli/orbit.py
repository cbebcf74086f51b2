"""The verb orbit."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import (
    Answer,
    TextTable,
    argument,
    drawn_to,
    file_option,
    multiplier_texts,
    option,
    spaced,
    table,
    verb,
)
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.orbits.family import LyapunovFamily
    from dpcontrol.orbits.lyapunov import LyapunovOrbit
    from dpcontrol.orbits.rotating import RotatingFamily
    from dpcontrol.references.sustained import SustainedOrbit
    from dpcontrol.scenes.model import Model

ARMS = {"inner": 1, "outer": 2}
KIND = "Kind of orbit"
_ROTATING = {
    "energy (J)": "{.energy:.9g}",
    "period (s)": "{.period:.12g}",
    "stability": "{.kind}",
    "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8),
    "state (rad, rad/s)": lambda o: spaced(o.state, ".9f"),
}
Range = tuple[float, float]


@verb("orbit", example="dpcontrol orbit lab --saddle down-up --energy -0.07")
def orbit_command(
    *,
    model: str = argument(),
    saddle: str | None = option(group=KIND, help="Saddle that the orbit surrounds, inner arm first: down-up, up-down."),
    family: int = option(default=0, group=KIND, help="Which of the saddle's families, slowest first."),
    rotating: str | None = option(
        type=click.Choice(["inner", "outer"]), group=KIND, help="Orbits that turn this arm over and over, instead."
    ),
    sustained: bool = option(
        group=KIND, help="The orbit that friction and cart sustain with the least effort, instead."
    ),
    sections: int = option(
        type=click.IntRange(1, 1000),
        default=4,
        group=KIND,
        help="For --sustained: how often in a period the input's clock is reset.",
    ),
    energy: float | None = option(help="Energy in J, zero at the pivot's height."),
    energies: Range | None = option(metavar="LO HI", help="Follow the family between two energies in J."),
    picture: Path | None = file_option(suffix=".png", help="Draw the family, or the sustained orbit, to this PNG."),
) -> Answer:
    """Compute the Lyapunov orbit about a saddle at an energy, or its family, with Floquet multipliers.

    A family is followed from its saddle until it ends, loses hyperbolicity or leaves the energies asked for.

    With --rotating: the symmetric orbits on which one arm turns over and over, with their stability. Their families
    start from the orbits at --energy, or at the middle of --energies.

    With --sustained: the periodic orbit of pendulum and cart that the cart's acceleration keeps alive against friction,
    from the Lyapunov orbit at --energy, held to that energy at phase 0. Its multipliers are those of a period with the
    input replayed, and those of its sections, where the input's clock is reset.
    """
    from dpcontrol.scenes.model import load_model

    if (saddle is None) == (rotating is None):
        raise click.UsageError("give either --saddle for Lyapunov orbits or --rotating inner|outer for rotating ones")
    if sustained:
        if saddle is None or energy is None or energies is not None:
            raise InputError("--sustained makes one orbit about a saddle: give --saddle and --energy with it")
        return _sustained(load_model(model), saddle, energy, family, sections, picture)
    if picture is not None and energies is None:
        raise InputError("--picture draws a family or a sustained orbit: give --energies LO HI or --sustained with it")
    if energy is None and energies is None:
        raise InputError("give --energy for the orbits of one energy or --energies LO HI for their families")
    loaded = load_model(model)
    if rotating is not None:
        return _rotating(loaded, rotating, energy, energies, picture)
    assert saddle is not None
    if energies is None:
        assert energy is not None
        orbit = _lyapunov(loaded, saddle, energy, family)
        return Answer(orbit.document(), _orbit_text(orbit))
    if energy is not None:
        raise InputError("give either --energy for one orbit or --energies LO HI for its family")
    return _family(loaded, saddle, energies, family, picture)


def _lyapunov(model: "Model", saddle: str, energy: float, family: int) -> "LyapunovOrbit":
    from dpcontrol.orbits.lyapunov import lyapunov_orbit

    orbit = lyapunov_orbit(model.system, saddle, energy=energy, family=family)
    if not orbit.converged:
        raise GoalMissed(f"the Lyapunov orbit about {saddle} at {energy:g} J: {orbit.status}")
    return orbit


def _orbit_text(orbit: "LyapunovOrbit") -> Iterator[str]:
    yield f"Lyapunov orbit about {orbit.saddle} at {orbit.energy:g} J: {orbit.status}"
    yield f"  period       {orbit.period:.15g} s"
    yield f"  state        {spaced(orbit.state, '.15g')}   (rad, rad/s)"
    yield f"  multipliers  {multiplier_texts(orbit.floquet_multipliers)}"
    yield f"  closure      {orbit.residual:.1e} (largest component of x(T) - x(0))"


def _family(model: "Model", saddle: str, energies: Range, family: int, picture: Path | None) -> Answer:
    from dpcontrol.orbits.family import lyapunov_family

    with progress_bar(f"family of {saddle}") as progress:
        found = lyapunov_family(model.system, saddle, energies=energies, family=family, progress=progress)
    if picture is not None:
        from dpcontrol.review.orbits import draw_families
        from dpcontrol.review.page import save_figure

        save_figure(draw_families([found], f"Lyapunov orbits about {found.saddle} of {found.system.name}"), picture)
    document = {**found.document(), "energies": energies, "picture": picture}
    missed = "" if found.converged else f"the family about {saddle}: {found.status}"
    return Answer(document, [*_family_text(found, saddle), *drawn_to(picture)], missed)


def _family_text(found: "LyapunovFamily", saddle: str) -> Iterator[str | TextTable]:
    chosen = found.members[:: max(1, len(found.members) // 20)]
    yield table(f"Lyapunov orbits about {saddle}, {len(chosen)} of {len(found.members)}", chosen, {
        "energy (J)": "{.energy:.9g}",
        "period (s)": "{.period:.9g}",
        "multipliers but the pair at one": lambda m: multiplier_texts(
            (v for v in m.floquet_multipliers if abs(abs(v) - 1) > 1e-3), 6
        ),
        "state (rad, rad/s)": lambda m: spaced(m.state, ".6f"),
    })  # fmt: skip
    for side, end in zip(("from", "to"), found.ends, strict=True):
        yield f"{side:5s}{end.energy:.9g} J: {end.reason}"


def _rotating(model: "Model", arm: str, energy: float | None, energies: Range | None, picture: Path | None) -> Answer:
    from dpcontrol.orbits.rotating import rotating_families, rotating_orbits

    if energy is None:
        assert energies is not None
        energy = (energies[0] + energies[1]) / 2
    system, asked = model.system, {"arm": arm, "energy": energy}
    orbits = rotating_orbits(system, ARMS[arm], energy)
    if not orbits:
        raise GoalMissed(
            f"no symmetric orbit that turns the {arm} arm of {system.name} over was found at {energy:g} J; "
            "try a higher energy"
        )
    if energies is None:
        title = f"Orbits of {system.name} at {energy:g} J that turn the {arm} arm forward"
        document = {
            "rotating_orbits": [orbit.document() for orbit in orbits],
            "count": len(orbits),
            **asked,
            "status": f"{len(orbits)} symmetric orbits that turn the {arm} arm forward; each has a reflection",
        }
        note = "each has a reflection that turns backward, (θ, ω) → (−θ, −ω), with the same multipliers"
        return Answer(document, [table(title, orbits, _ROTATING), note])
    with progress_bar("families of rotating orbits") as progress:
        families = rotating_families(orbits, energies, progress=progress)
    if picture is not None:
        from dpcontrol.review.orbits import draw_rotating_families
        from dpcontrol.review.page import save_figure

        save_figure(draw_rotating_families(families), picture)
    document = {
        "families": [family.document() for family in families],
        "count": len(families),
        **asked,
        "energies": energies,
        "picture": picture,
        "status": "; ".join(family.status for family in families),
    }
    lost = [family.status for family in families if not family.converged]
    missed = f"{len(lost)} of {len(families)} families of rotating orbits: {'; '.join(lost)}" if lost else ""
    return Answer(document, [*_rotating_text(families, arm), *drawn_to(picture)], missed)


def _rotating_text(families: "Iterable[RotatingFamily]", arm: str) -> Iterator[str | TextTable]:
    families = list(families)
    for k, family in enumerate(families, start=1):
        chosen = family.members[:: max(1, len(family.members) // 12)]
        title = f"Family {k} of {len(families)}, the {arm} arm turning: {len(chosen)} of {len(family.members)}"
        yield table(title, chosen, _ROTATING)
        for change in family.changes:
            yield f"  at {change.orbit.energy:.10g} J: from {change.before} to {change.after}"
        for fold in family.folds:
            yield f"  at {fold.energy:.10g} J the family turns back in energy"
        for side, end in zip(("from", "to"), family.ends, strict=True):
            yield f"  {side}: {end}"


def _sustained(model: "Model", saddle: str, energy: float, family: int, sections: int, picture: Path | None) -> Answer:
    from dpcontrol.references.sustained import sustained_orbit

    # Asked for first: a system without arms is refused before its orbit is sought, which may take minutes.
    arms = model.arms
    lyapunov = _lyapunov(model, saddle, energy, family)
    with progress_bar(f"sustained orbit about {saddle}") as progress:
        orbit = sustained_orbit(lyapunov, arms, progress=progress)
    if not orbit.converged:
        picture = None
    if picture is not None:
        from dpcontrol.review.of_log import sustained_view
        from dpcontrol.review.page import draw, save_figure

        save_figure(draw(sustained_view(orbit, arms.length)), picture)
    document = {**orbit.document(sections), "picture": picture}
    missed = "" if orbit.converged else f"the sustained orbit about {saddle} at {energy:g} J: {orbit.status}"
    return Answer(document, () if missed else [*_sustained_text(orbit, sections), *drawn_to(picture)], missed)


def _sustained_text(orbit: "SustainedOrbit", sections: int) -> Iterator[str]:
    reference, lyapunov = orbit.reference, orbit.lyapunov
    yield f"Sustained orbit about {lyapunov.saddle} at {lyapunov.energy:g} J: {orbit.status}"
    yield f"  period       {orbit.period:.15g} s, {lyapunov.period:.15g} s without friction"
    yield f"  state        {spaced(orbit.state(0.0), '.9g')}   (rad, rad/s, m, m/s)"
    yield (
        f"  cart         {reference.rms_cart_acceleration:.4g} m/s² rms, {reference.max_cart_acceleration:.4g} "
        f"at most; {1e3 * reference.max_cart_position:.3g} mm at most"
    )
    yield f"  energy       {orbit.energies[0]:.6g} to {orbit.energies[1]:.6g} J along the orbit"
    by_section = orbit.section_multipliers(sections)
    for title, values in (("multipliers", orbit.multipliers), (f"by {sections} sections", by_section)):
        yield f"  {title:<12} {multiplier_texts(values, 9)}"
    yield "               the cart's are 1, 1: driven by its acceleration, nothing holds it in place"
