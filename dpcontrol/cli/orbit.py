"""dpcontrol orbit"""

import click

from dpcontrol.cli.output import json_option, print_json, reports_failure
from dpcontrol.foundation.errors import GoalMissed


@click.command("orbit", epilog="Example:  dpcontrol orbit lab --saddle down-up --energy -0.07")
@click.argument("model")
@click.option("--saddle", required=True, help="Saddle that the orbit surrounds, inner arm first: down-up, up-down.")
@click.option("--energy", required=True, type=float, help="Energy in J, zero at the pivot's height.")
@click.option("--family", default=0, show_default=True, help="Which of the saddle's families, slowest first.")
@json_option
@reports_failure
def command(*, model: str, saddle: str, energy: float, family: int, as_json: bool) -> None:
    """Compute the Lyapunov orbit about a saddle at an energy, with its Floquet multipliers."""
    from dpcontrol.scenes.model import load_model
    from dpcontrol.tubes.lyapunov import lyapunov_orbit

    orbit = lyapunov_orbit(load_model(model).system, saddle, energy=energy, family=family)
    if not orbit.converged:
        raise GoalMissed(f"the Lyapunov orbit about {saddle} at {energy:g} J: {orbit.status}")
    if as_json:
        print_json(
            {
                "energy": orbit.energy,
                "period": orbit.period,
                "state": orbit.state,
                "floquet_multipliers": orbit.floquet_multipliers,
                "residual": orbit.residual,
                "status": orbit.status,
                "saddle": saddle,
                "family": family,
            }
        )
        return
    click.echo(f"Lyapunov orbit about {saddle} at {energy:g} J: {orbit.status}")
    click.echo(f"  period       {orbit.period:.15g} s")
    click.echo(f"  state        {'  '.join(f'{v:.15g}' for v in orbit.state)}   (rad, rad/s)")
    click.echo(f"  multipliers  {'  '.join(_multiplier(complex(m)) for m in orbit.floquet_multipliers)}")
    click.echo(f"  closure      {orbit.residual:.1e} (largest component of x(T) - x(0))")


def _multiplier(value: complex) -> str:
    return f"{value.real:.12g}" if abs(value.imag) < 1e-12 else f"{value.real:.10g}{value.imag:+.10g}i"
