"""dpcontrol orbit"""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import (
    checked_suffix,
    json_option,
    multiplier_text,
    print_json,
    print_table,
    progress_bar,
    reports_failure,
)
from dpcontrol.foundation.errors import GoalMissed, InputError

if TYPE_CHECKING:
    from dpcontrol.dynamics.system import System


@click.command(
    "orbit",
    epilog="Example:  dpcontrol orbit lab --saddle down-up --energy -0.07",
)
@click.argument("model")
@click.option("--saddle", help="Saddle that the orbit surrounds, inner arm first: down-up, up-down.")
@click.option(
    "--rotating", type=click.Choice(["inner", "outer"]), help="Orbits that turn this arm over and over, instead."
)
@click.option("--energy", type=float, help="Energy in J, zero at the pivot's height.")
@click.option("--energies", type=float, nargs=2, metavar="LO HI", help="Follow the family between two energies in J.")
@click.option("--family", default=0, show_default=True, help="Which of the saddle's families, slowest first.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Draw the family, or the sustained orbit, to this PNG.",
)
@click.option(
    "--sustained", is_flag=True, help="The orbit that friction and cart sustain, with the least effort, instead."
)
@click.option(
    "--sections",
    type=click.IntRange(1, 1000),
    default=4,
    show_default=True,
    help="For --sustained: how often in a period the input's clock is reset.",
)
@json_option
@reports_failure
def command(
    *,
    model: str,
    saddle: str | None,
    rotating: str | None,
    energy: float | None,
    energies: tuple[float, float] | None,
    family: int,
    picture: Path | None,
    sustained: bool,
    sections: int,
    as_json: bool,
) -> None:
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
        _sustained(model, saddle, energy, family, sections, picture, as_json)
        return
    if picture is not None and energies is None:
        raise InputError("--picture draws a family or a sustained orbit: give --energies LO HI or --sustained with it")
    if rotating is not None:
        _rotating(model, rotating, energy, energies, picture, as_json)
        return
    assert saddle is not None
    if (energy is None) == (energies is None):
        raise InputError("give either --energy for one orbit or --energies LO HI for its family")
    system = load_model(model).system
    if energies is not None:
        _family(system, saddle, energies, family, picture, as_json)
    else:
        assert energy is not None
        _orbit(system, saddle, energy, family, as_json)


def _sustained(
    model: str, saddle: str, energy: float, family: int, sections: int, picture: Path | None, as_json: bool
) -> None:
    from dpcontrol.cli.orbit_sustained import show_sustained
    from dpcontrol.scenes.model import load_model

    if picture is not None:
        checked_suffix(picture, ".png", option="--picture")
    loaded = load_model(model)
    show_sustained(loaded, saddle, energy, family=family, sections=sections, picture=picture, as_json=as_json)


def _rotating(
    model: str,
    arm: str,
    energy: float | None,
    energies: tuple[float, float] | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    from dpcontrol.cli.rotating import show_families, show_orbits
    from dpcontrol.scenes.model import load_model

    if energies is not None:
        start = (energies[0] + energies[1]) / 2 if energy is None else energy
        show_families(load_model(model).system, arm, start, energies, picture, as_json=as_json)
    elif energy is not None:
        show_orbits(load_model(model).system, arm, energy, as_json=as_json)
    else:
        raise InputError("give --energy for the orbits of an energy or --energies LO HI for their families")


def _orbit(system: "System", saddle: str, energy: float, family: int, as_json: bool) -> None:
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.walks.atlas import orbit_document

    orbit = lyapunov_orbit(system, saddle, energy=energy, family=family)
    if not orbit.converged:
        raise GoalMissed(f"the Lyapunov orbit about {saddle} at {energy:g} J: {orbit.status}")
    if as_json:
        print_json(orbit_document(orbit))
        return
    click.echo(f"Lyapunov orbit about {saddle} at {energy:g} J: {orbit.status}")
    click.echo(f"  period       {orbit.period:.15g} s")
    click.echo(f"  state        {'  '.join(f'{v:.15g}' for v in orbit.state)}   (rad, rad/s)")
    click.echo(f"  multipliers  {'  '.join(multiplier_text(complex(m)) for m in orbit.floquet_multipliers)}")
    click.echo(f"  closure      {orbit.residual:.1e} (largest component of x(T) - x(0))")


def _family(
    system: "System", saddle: str, energies: tuple[float, float], family: int, picture: Path | None, as_json: bool
) -> None:
    from dpcontrol.orbits.family import lyapunov_family
    from dpcontrol.walks.atlas import orbit_document

    with progress_bar(f"family of {saddle}") as progress:
        found = lyapunov_family(system, saddle, energies=energies, family=family, progress=progress)
    if picture is not None:
        from dpcontrol.review.family_figure import write_family_figure

        write_family_figure(found, picture)
    if as_json:
        print_json(
            {
                "family": [orbit_document(m) for m in found.members],
                "ends": [{"energy": e.energy, "kind": e.kind, "reason": e.reason} for e in found.ends],
                "events": [{"kind": e.kind, **orbit_document(e.orbit)} for e in found.events],
                "saddle": saddle,
                "energies": energies,
                "status": found.status,
                "picture": None if picture is None else str(picture),
            }
        )
    else:
        chosen = found.members[:: max(1, len(found.members) // 20)]
        rows = [
            (
                f"{m.energy:.9g}",
                f"{m.period:.9g}",
                "  ".join(multiplier_text(complex(v), 6) for v in m.floquet_multipliers if abs(abs(v) - 1) > 1e-3),
                "  ".join(f"{v:.6f}" for v in m.state),
            )
            for m in chosen
        ]
        columns = ("energy (J)", "period (s)", "multipliers but the pair at one", "state (rad, rad/s)")
        print_table(f"Lyapunov orbits about {saddle}, {len(chosen)} of {len(found.members)}", columns, rows)
        for side, end in zip(("from", "to"), found.ends, strict=True):
            click.echo(f"{side:5s}{end.energy:.9g} J: {end.reason}")
        if picture is not None:
            click.echo(f"drawn to {picture}")
    if not found.converged:
        raise GoalMissed(f"the family about {saddle}: {found.status}")
