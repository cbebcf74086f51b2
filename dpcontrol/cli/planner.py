"""The verb planner."""

import sys

import click

from dpcontrol.cli.verbs import Answer, argument, option, say, show, verb
from dpcontrol.foundation.interrupts import forget_interrupts


@verb("planner", example="dpcontrol planner lab", note="MODEL is a name (./models, then those shipped) or a path.")
def planner_command(
    *,
    model: str | None = argument(),
    no_browser: bool = option(help="Only print the address."),
    port: int = option(type=click.IntRange(0, 65535), default=0, help="Port on 127.0.0.1; 0: any free."),
) -> None:
    """Plan by looking: a page in the browser from energy to run, for the lab's arms or those of MODEL.

    Choose an energy, click connections to a walk, plan it, run it, and save itinerary, log and film under ./itineraries
    and ./logs. The page works offline and is for this computer alone: its address carries a token. Serves until Ctrl-C.
    Needs the extra `planner`: pip install 'dpcontrol[planner]'.
    """
    from dpcontrol import api

    with api.open_planner(model or "lab", browser=False, port=port) as planner:
        try:
            show(Answer({"address": planner.address}, [f"planner at {planner.address}", "Ctrl-C ends it"]))
            # Whoever reads this through a pipe waits for it.
            sys.stdout.flush()
            if not no_browser and not planner.open():
                say("dpcontrol: no browser was found; open the address in one")
            planner.wait()
        except KeyboardInterrupt:
            forget_interrupts()
