"""dpcontrol plan"""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, file_option, verb

if TYPE_CHECKING:
    from dpcontrol.scenes.plan import Plan


@verb("plan", example="dpcontrol plan outer-turn", note="ITINERARY is a name (in ./itineraries or shipped) or a path.")
@click.argument("itinerary")
@click.option("--fresh", is_flag=True, help="Plan anew even if the plan is cached.")
@file_option("--out", suffix=".npz", help="Also write the reference to this .npz.")
def command(*, itinerary: str, fresh: bool, out: Path | None) -> Answer:
    """Plan an itinerary: connections, shadowing orbit, and the reference with friction and cart.

    Plans are kept by content: the same itinerary is planned once.
    """
    from dpcontrol import api
    from dpcontrol.foundation.files import whole_file
    from dpcontrol.scenes.levels import plan_remarks

    plan = api.plan(itinerary, fresh=fresh, progress=True)
    file = plan.file
    if out is not None and plan.converged:
        with whole_file(out, suffix=".npz") as temporary:
            shutil.copyfile(file, temporary)
        file = out
    for remark in plan_remarks(plan.itinerary):
        click.echo(remark, err=True)
    missed = "" if plan.converged else f"{plan.itinerary.name}: {plan.status}"
    document = {**plan.document(), "file": None if missed else str(file)}
    return Answer(document, () if missed else _text(plan, file), missed)


def _text(plan: "Plan", file: Path) -> Iterator[str]:
    reference, notes = plan.reference, plan.notes
    yield plan.itinerary.title
    for symbol in notes["symbols"]:
        text, name = symbol["text"], symbol["name"]
        yield f"  {text!r} is {name}" if name else f"  {text}, a transfer at {symbol['time']:.2f} s"
    shadowing = notes["shadowing"]
    if shadowing["residual"] is not None:
        yield f"  shadowing orbit  {shadowing['duration']:.3f} s, residual {shadowing['residual']:.1e}"
    yield f"  reference        {reference.status}"
    yield (
        f"  cart             {reference.max_cart_position * 1e3:.1f} mm at most, "
        f"{reference.rms_cart_acceleration:.3f} m/s² rms, {reference.max_cart_acceleration:.3f} m/s² at most"
    )
    yield f"  file             {file}{' (cached)' if plan.cached else ''}"
