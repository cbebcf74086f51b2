"""The example bench: an itinerary's arms and cart, simulated in real time and driven over UDP."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from socket import AF_INET

from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.rig.bench import BenchServerSettings, UdpBench, checked_faults
from dpcontrol.rig.packets import resolved, shared_key
from dpcontrol.runs.run import bench_recipe, hanging_recipe


@dataclass(frozen=True)
class BenchAddress:
    """Socket of an example bench, with its access rules.

    Attributes:
        host: address of this computer.
        port: port, 0 for any free one.
        key_file: file with the shared key (default: the environment's DPCONTROL_RIG_KEY).
        insecure: accept loops on other computers without a key.
        settings: watchdog and priority of the server.
    """

    host: str = "127.0.0.1"
    port: int = 0
    key_file: Path | None = None
    insecure: bool = False
    settings: BenchServerSettings = field(default_factory=BenchServerSettings)


def example_bench(
    itinerary: Itinerary,
    at: BenchAddress,
    *,
    hanging: bool = False,
    faults: Sequence[str] = (),
    notify: Callable[[str], None] = lambda text: None,
    yes: bool = False,
    progress: Progress = no_progress,
) -> UdpBench:
    """Return the compiled example bench of an itinerary, ready to serve runs.

    Args:
        itinerary: arms, cart and settings of the bench.
        at: socket of the bench.
        hanging: begin with hanging arms, for commissioning, without a plan.
        faults: wiring mistakes for practice (default none).
        notify: called with a sentence on each event.
        yes: accept any duration of planning.
        progress: called with a label and the completed share.

    Raises:
        InputError: the address or port is not available, other computers can reach it without a key, or the arms
            cannot have a fault.
        GoalMissed: the itinerary cannot be planned.
    """
    key = shared_key(at.key_file)
    resolved(at.host, at.port, name=f"rig: --host {at.host}", key=key, insecure=at.insecure, family=AF_INET)
    checked = checked_faults(faults, itinerary.model.arms.count)
    if hanging:
        recipe = hanging_recipe(itinerary, faults=checked)
    else:
        recipe = replace(bench_recipe(make_plan(itinerary, progress=progress, yes=yes)), faults=checked)
    recipe.rehearse()
    return UdpBench(
        recipe.rig,
        arms=recipe.parameters.count,
        ticks=recipe.all_ticks,
        period=recipe.period,
        host=at.host,
        port=at.port,
        key=key,
        insecure=at.insecure,
        settings=at.settings,
        report=notify,
    )
