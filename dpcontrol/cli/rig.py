"""dpcontrol rig"""

import sys
from contextlib import suppress
from typing import Any

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure
from dpcontrol.cli.run_options import run_options


@click.command("rig", epilog="Example:  dpcontrol rig outer-turn --port 47000 --mismatch 0.05")
@click.argument("itinerary")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address of this computer to listen at.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, show_default=True, help="0: any that is free.")
@click.option("--runs", type=click.IntRange(0), default=0, show_default=True, help="End after so many; 0: never.")
@click.option("--seed", default=0, show_default=True, help="Of all that is random on the bench.")
@click.option("--real-time", is_flag=True, help="Ask the system for priority over all ordinary work.")
@run_options
@json_option
@reports_failure
def command(
    *, itinerary: str, host: str, port: int, runs: int, seed: int, real_time: bool, as_json: bool, **overrides: Any
) -> None:
    """Start an example bench: the itinerary's arms and cart, simulated in real time, spoken to over UDP.

    Prints its address, for `dpcontrol run ITINERARY --rig ADDRESS`, and serves one run after the other until Ctrl-C.
    The arms start where the itinerary does. The packets are described in dpcontrol/rig/packets.py.
    """
    from dpcontrol.rig.bench import BenchServerSettings, UdpBench
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.rig_run import bench_recipe
    from dpcontrol.scenes.run_options import RunOptions

    scene = load_itinerary(itinerary).with_run(RunOptions(**overrides), seed=seed)
    with progress_bar("rig") as progress:
        plan = make_plan(scene, progress=progress)
    recipe = bench_recipe(plan)
    recipe.rehearse()
    arms, settings = recipe.parameters.count, BenchServerSettings(real_time=real_time)
    with (
        UdpBench(
            recipe.rig, arms=arms, ticks=recipe.ticks, host=host, port=port, settings=settings,
            say=lambda text: click.echo(f"dpcontrol: {text}", err=True),
        ) as bench,
        suppress(KeyboardInterrupt),
    ):  # fmt: skip
        address = f"udp://{bench.address[0]}:{bench.address[1]}"
        if as_json:
            print_json({"address": address, "rate": 1 / recipe.period, "arms": arms, "ticks": recipe.ticks})
        else:
            click.echo(f"bench for {scene.name} at {address}")
        # Whoever reads this through a pipe waits for it.
        sys.stdout.flush()
        bench.serve(runs=runs)
