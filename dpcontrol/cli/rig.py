"""dpcontrol rig"""

import sys
from contextlib import suppress
from typing import Any

import click

from dpcontrol.cli.run_options import run_options
from dpcontrol.cli.verbs import Answer, option, show, verb
from dpcontrol.foundation.progress import progress_bar

SERVER = "Server"


@verb("rig", example="dpcontrol rig outer-turn --port 47000 --mismatch 0.05")
@click.argument("itinerary")
@click.option("--seed", default=0, show_default=True, help="Seed of all that is random on the bench.")
@option("--host", default="127.0.0.1", show_default=True, group=SERVER, help="Address of this computer to listen at.")
@option("--port", type=click.IntRange(0, 65535), default=0, show_default=True, group=SERVER, help="Port; 0: any free.")
@option("--runs", type=click.IntRange(0), default=0, show_default=True, group=SERVER, help="Runs to serve; 0: no end.")
@option("--real-time", is_flag=True, group=SERVER, help="Ask the system for priority over all ordinary work.")
@run_options
def command(*, itinerary: str, seed: int, host: str, port: int, runs: int, real_time: bool, **overrides: Any) -> None:
    """Start an example bench: the itinerary's arms and cart, simulated in real time, reached over UDP.

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

    def say(text: str) -> None:
        click.echo(f"dpcontrol: {text}", err=True)

    with (
        UdpBench(recipe.rig, arms=arms, ticks=recipe.ticks, host=host, port=port, settings=settings, say=say) as bench,
        suppress(KeyboardInterrupt),
    ):
        address = f"udp://{bench.address[0]}:{bench.address[1]}"
        document = {"address": address, "rate": recipe.settings.rate, "arms": arms, "ticks": recipe.ticks}
        show(Answer(document, [f"bench for {scene.name} at {address}"]))
        # Whoever reads this through a pipe waits for it.
        sys.stdout.flush()
        bench.serve(runs=runs)
