"""dpcontrol orbit --rotating"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from dpcontrol.cli.output import multiplier_text, print_json, print_table, progress_bar
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.dynamics.system import System
    from dpcontrol.orbits.rotating import RotatingOrbit

ARMS = {"inner": 1, "outer": 2}


def show_orbits(system: "System", arm: str, energy: float, *, as_json: bool) -> None:
    """Find and print the rotating orbits of an arm at an energy (J).

    Raises:
        GoalMissed: the scan finds none.
    """
    from dpcontrol.walks.atlas import rotating_document

    orbits = _orbits(system, arm, energy)
    if as_json:
        print_json({
            "rotating_orbits": [rotating_document(orbit) for orbit in orbits],
            "count": len(orbits),
            "arm": arm,
            "energy": energy,
            "status": f"{len(orbits)} symmetric orbits that turn the {arm} arm forward; each has a reflection",
        })  # fmt: skip
        return
    print_table(f"Orbits of {system.name} at {energy:g} J that turn the {arm} arm forward", _COLUMNS, _rows(orbits))
    click.echo("each has a reflection that turns backward, (θ, ω) → (−θ, −ω), with the same multipliers")


def show_families(
    system: "System", arm: str, energy: float, energies: tuple[float, float], picture: Path | None, *, as_json: bool
) -> None:
    """Follow and print the families of the rotating orbits of an arm at an energy, within bounds (J).

    Raises:
        InputError: the bounds do not enclose the energy, or the picture cannot be written.
        GoalMissed: the scan finds no orbit, or a family could not be followed to an end.
    """
    from dpcontrol.orbits.rotating import rotating_families
    from dpcontrol.walks.atlas import rotating_document

    with progress_bar("families of rotating orbits") as progress:
        families = rotating_families(_orbits(system, arm, energy), energies, progress=progress)
    if picture is not None:
        from dpcontrol.review.rotating_figure import write_rotating_figure

        write_rotating_figure(families, picture)
    if as_json:
        print_json({
            "families": [
                {
                    "members": [rotating_document(member) for member in family.members],
                    "changes": [
                        {"critical_trace": c.critical_trace, "before": c.before, "after": c.after,
                         **rotating_document(c.orbit)}
                        for c in family.changes
                    ],
                    "folds": [rotating_document(fold) for fold in family.folds],
                    "ends": family.ends,
                    "status": family.status,
                }
                for family in families
            ],
            "count": len(families),
            "arm": arm,
            "energy": energy,
            "energies": energies,
            "picture": None if picture is None else str(picture),
            "status": "; ".join(family.status for family in families),
        })  # fmt: skip
    else:
        for k, family in enumerate(families, start=1):
            chosen = family.members[:: max(1, len(family.members) // 12)]
            title = f"Family {k} of {len(families)}, the {arm} arm turning: {len(chosen)} of {len(family.members)}"
            print_table(title, _COLUMNS, _rows(chosen))
            for change in family.changes:
                click.echo(f"  at {change.orbit.energy:.10g} J: from {change.before} to {change.after}")
            for fold in family.folds:
                click.echo(f"  at {fold.energy:.10g} J the family turns back in energy")
            for side, end in zip(("from", "to"), family.ends, strict=True):
                click.echo(f"  {side}: {end}")
        if picture is not None:
            click.echo(f"drawn to {picture}")
    lost = [family.status for family in families if not family.converged]
    if lost:
        raise GoalMissed(f"{len(lost)} of {len(families)} families of rotating orbits: {'; '.join(lost)}")


_COLUMNS = ("energy (J)", "period (s)", "stability", "multipliers", "state (rad, rad/s)")


def _orbits(system: "System", arm: str, energy: float) -> "tuple[RotatingOrbit, ...]":
    from dpcontrol.orbits.rotating import rotating_orbits

    orbits = rotating_orbits(system, ARMS[arm], energy)
    if not orbits:
        raise GoalMissed(
            f"no symmetric orbit that turns the {arm} arm of {system.name} over was found at {energy:g} J; "
            "try a higher energy"
        )
    return orbits


def _rows(orbits: "Sequence[RotatingOrbit]") -> list[tuple[str, ...]]:
    return [
        (
            f"{o.energy:.9g}",
            f"{o.period:.12g}",
            o.kind,
            "  ".join(multiplier_text(complex(m), 8) for m in o.floquet_multipliers),
            "  ".join(f"{float(v):.9f}" for v in np.asarray(o.state)),
        )
        for o in orbits
    ]
