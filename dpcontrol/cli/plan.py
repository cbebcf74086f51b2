"""dpcontrol plan"""

import shutil
from pathlib import Path

import click

from dpcontrol.cli.output import checked_suffix, json_option, print_json, progress_bar, reports_failure
from dpcontrol.foundation.errors import GoalMissed


@click.command(
    "plan",
    epilog="Example:  dpcontrol plan outer-turn      ITINERARY is a name (in ./itineraries or shipped) or a path.",
)
@click.argument("itinerary")
@click.option("--fresh", is_flag=True, help="Plan anew even if the plan is cached.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Also write the reference to this .npz.")
@json_option
@reports_failure
def command(*, itinerary: str, fresh: bool, out: Path | None, as_json: bool) -> None:
    """Plan an itinerary: connections, shadowing orbit, and the reference with friction and cart.

    Plans are kept by content: the same itinerary is planned once.
    """
    from dpcontrol.foundation.files import whole_file
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.levels import plan_remarks
    from dpcontrol.scenes.plan import make_plan

    if out is not None:
        checked_suffix(out, ".npz", option="--out")
    scene = load_itinerary(itinerary)
    with progress_bar("plan") as progress:
        plan = make_plan(scene, progress=progress, fresh=fresh)
    reference, notes, file = plan.reference, plan.notes, plan.file
    if out is not None and reference.converged:
        with whole_file(out, suffix=".npz") as temporary:
            shutil.copyfile(file, temporary)
        file = out
    for remark in plan_remarks(scene):
        click.echo(remark, err=True)
    if as_json:
        print_json({**plan.document(), "file": str(file) if plan.converged else None})
    elif reference.converged:
        click.echo(f"{scene.title}")
        for symbol in notes["symbols"]:
            text, name = symbol["text"], symbol["name"]
            click.echo(f"  {text!r} is {name}" if name else f"  {text}, a transfer at {symbol['time']:.2f} s")
        shadowing = notes["shadowing"]
        if shadowing["residual"] is not None:
            click.echo(f"  shadowing orbit  {shadowing['duration']:.3f} s, residual {shadowing['residual']:.1e}")
        click.echo(f"  reference        {reference.status}")
        click.echo(
            f"  cart             {reference.max_cart_position * 1e3:.1f} mm at most, "
            f"{reference.rms_cart_acceleration:.3f} m/s² rms, {reference.max_cart_acceleration:.3f} m/s² at most"
        )
        click.echo(f"  file             {file}{' (cached)' if plan.cached else ''}")
    if not reference.converged:
        raise GoalMissed(f"{scene.name}: {reference.status}")
