"""The verb `planner`, which serves the page for planning in a browser."""

import sys

import click

from dpcontrol.cli.verbs import Answer, argument, option, print_message, show, verb
from dpcontrol.foundation.interrupts import forget_interrupts


@verb("planner", example="dpcontrol planner lab", note="MODEL is a name (in ./models or shipped) or a path.")
def planner_command(
    *,
    model: str | None = argument(),
    no_browser: bool = option(help="Print the address only."),
    port: int = option(type=click.IntRange(0, 65535), default=0, help="Port on 127.0.0.1; 0 selects a free one."),
) -> None:
    """Plan in the browser, from an energy to a run.

    MODEL is `lab` by default. Choose an energy, click connections to build a walk, plan it, and run it. Itinerary, log
    and film are saved in ./itineraries and ./logs. The page works offline and only on this computer, because its
    address contains a token. The planner serves until Ctrl-C. It needs an extra: pip install 'dpcontrol[planner]'.
    """
    from dpcontrol import api

    with api.open_planner(model or "lab", browser=False, port=port) as planner:
        try:
            hints = [] if no_browser else ["Ctrl-C ends the planner"]
            show(Answer({"address": planner.address}, [planner.address, *hints]))
            # A reader behind a pipe waits for the address.
            sys.stdout.flush()
            if not no_browser and not planner.open():
                print_message("dpcontrol: no browser was found; open the address in one")
            planner.wait()
        except KeyboardInterrupt:
            forget_interrupts()
