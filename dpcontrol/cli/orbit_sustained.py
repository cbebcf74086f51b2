"""dpcontrol orbit --sustained"""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import multiplier_text, print_json, progress_bar
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.scenes.model import Model


def show_sustained(
    model: "Model",
    saddle: str,
    energy: float,
    *,
    family: int,
    sections: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Find and show the sustained orbit.

    Raises:
        InputError: no such orbit, or a picture that cannot be written.
        GoalMissed: it was not found; the message says why.
    """
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.references.sustained import sustained_orbit

    arms = model.arms
    lyapunov = lyapunov_orbit(model.system, saddle, energy=energy, family=family)
    if not lyapunov.converged:
        raise GoalMissed(f"the Lyapunov orbit about {saddle} at {energy:g} J: {lyapunov.status}")
    with progress_bar(f"sustained orbit about {saddle}") as progress:
        orbit = sustained_orbit(lyapunov, arms, progress=progress)
    reference = orbit.reference
    by_section = orbit.section_multipliers(sections) if orbit.converged else None
    if picture is not None and orbit.converged:
        from dpcontrol.review.sustained_figure import write_sustained_figure

        write_sustained_figure(orbit, picture)
    if as_json:
        print_json(
            {
                "saddle": saddle,
                "family": family,
                "energy": energy,
                "energies": orbit.energies,
                "period": orbit.period,
                "lyapunov_period": lyapunov.period,
                "state": orbit.state(0.0),
                "multipliers": orbit.multipliers if orbit.converged else None,
                "sections": sections,
                "section_multipliers": by_section,
                "u_rms": reference.rms_cart_acceleration,
                "u_max": reference.max_cart_acceleration,
                "max_cart_position": reference.max_cart_position,
                "max_cart_velocity": reference.max_cart_velocity,
                "departure": orbit.departure,
                "residual": orbit.residual,
                "error_between_nodes": reference.max_error_between_nodes,
                "intervals": len(reference.mesh) - 1,
                "iterations": reference.iterations,
                "solve_seconds": reference.solve_seconds,
                "converged": orbit.converged,
                "status": orbit.status,
                "picture": None if picture is None or not orbit.converged else str(picture),
            }
        )
    elif orbit.converged:
        assert by_section is not None
        click.echo(f"Sustained orbit about {saddle} at {energy:g} J: {orbit.status}")
        click.echo(f"  period       {orbit.period:.15g} s, {lyapunov.period:.15g} s without friction")
        click.echo(f"  state        {'  '.join(f'{v:.9g}' for v in orbit.state(0.0))}   (rad, rad/s, m, m/s)")
        click.echo(
            f"  cart         {reference.rms_cart_acceleration:.4g} m/s² rms, {reference.max_cart_acceleration:.4g} "
            f"at most; {1e3 * reference.max_cart_position:.3g} mm at most"
        )
        click.echo(f"  energy       {orbit.energies[0]:.6g} to {orbit.energies[1]:.6g} J along the orbit")
        for title, values in (("multipliers", orbit.multipliers), (f"by {sections} sections", by_section)):
            click.echo(f"  {title:<12} {'  '.join(multiplier_text(complex(m), 9) for m in values)}")
        click.echo("               the cart's are 1, 1: driven by its acceleration, nothing holds it in place")
        if picture is not None:
            click.echo(f"drawn to {picture}")
    if not orbit.converged:
        raise GoalMissed(f"the sustained orbit about {saddle} at {energy:g} J: {orbit.status}")
