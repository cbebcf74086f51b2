"""Run an itinerary on a bench in real time, over UDP: the same loop, the same log, and how the deadlines were kept.

The bench may be any that speaks `dpcontrol.rig.packets`; the example is the simulated one, by its own clock.
"""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from dpcontrol.control.interface import Controller
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.logs import read_log
from dpcontrol.loop.control_loop import ControlLoop
from dpcontrol.loop.loop import control_loop, loop_controller, loop_fallback
from dpcontrol.loop.result import LogSink, LoopResult
from dpcontrol.review.score import Score, score
from dpcontrol.rig.bench import BenchProcess, BenchRecipe, BenchServerSettings
from dpcontrol.rig.client import Deadlines, UdpRig, parse_address, real_time_priority, without_collecting
from dpcontrol.scenes.plan import Plan
from dpcontrol.scenes.run import followed, log_writer

OWN_BENCH = "udp"
"""In place of an address: the example bench is started for the run, in a process of its own."""
_SPARE = 1.0
"""Seconds for which the example bench can go on after the controller's end."""


@dataclass(frozen=True)
class RigRun:
    """A run on a bench: score (completion is not known without the true state), the loop's result, deadlines.

    bench: what the example bench said, if it was started for the run.
    """

    score: Score
    result: LoopResult
    deadlines: Deadlines
    bench: tuple[str, ...]


def bench_recipe(plan: Plan, controller: Controller | None = None) -> BenchRecipe:
    """Return the simulated bench that a planned itinerary is run on by its controller, which is made where not given.

    Raises:
        InputError: the plant is to be drawn from an uncertainty that the model's file does not give.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    itinerary, reference = plan.itinerary, followed(plan).reference
    loop = itinerary.loop
    controller = controller or loop_controller(reference, itinerary.model.arms, loop)
    return BenchRecipe(
        itinerary.model.arms, loop, loop.limits(reference), controller.first_state,
        ticks=controller.ticks + round(_SPARE * loop.rate) + 1, uncertainty=itinerary.uncertainty,
    )  # fmt: skip


def run_on_rig(
    plan: Plan, out: Path, address: str, *, real_time: bool = False, progress: Progress = no_progress
) -> RigRun:
    """Run the closed loop of a planned itinerary on the bench at `address`, write its log to `out`, and score it.

    address: udp://HOST:PORT, or `udp` for an example bench of its own. real_time: ask the system for priority.

    Raises:
        InputError: the address is none, no bench answers, it does not fit the itinerary, or the log cannot be written.
        GoalMissed: the plan did not converge, no controller can be made for it, or the bench failed at once.
    """
    itinerary, reference = plan.itinerary, followed(plan).reference
    arms, settings = itinerary.model.arms, itinerary.loop
    where = None if address == OWN_BENCH else parse_address(address)
    limits, controller = settings.limits(reference), loop_controller(reference, arms, settings)
    fallback = loop_fallback(reference, arms, settings)
    process: BenchProcess | None = None
    with log_writer(plan, out) as writer:
        loop = control_loop(
            arms, settings, controller, limits=limits, sink=LogSink(writer), fallback=fallback, progress=progress
        )
        loop.rehearse()
        with ExitStack() as stack:
            if where is None:
                process = stack.enter_context(
                    BenchProcess(bench_recipe(plan, controller), BenchServerSettings(real_time=real_time))
                )
                where = process.address
            rig = stack.enter_context(UdpRig(where, queued=loop.queued))
            _fits(rig, loop, arms=arms.count, rate=settings.rate)
            stack.enter_context(without_collecting())
            if real_time:
                stack.enter_context(real_time_priority())
            result = loop.run(rig)
        if not len(result.ticks.times):
            raise GoalMissed(result.reason)
        deadlines = rig.deadlines
        writer.result(
            real_time_factor=repr(result.real_time_factor), ending=result.ending.value, rig=rig.address,
            **deadlines.record(),
        )  # fmt: skip
    return RigRun(score(read_log(out)), result, deadlines, tuple(process.said if process else ()))


def _fits(rig: UdpRig, loop: ControlLoop, *, arms: int, rate: float) -> None:
    welcome = rig.welcome
    if welcome.arms != arms:
        raise InputError(f"rig {rig.address} has {welcome.arms} arms, the itinerary's model {arms}")
    if abs(welcome.period * rate - 1) > 1e-6:
        raise InputError(
            f"rig {rig.address} ticks at {1 / welcome.period:g} Hz, the loop at {rate:g} Hz; "
            f"run with --rate {1 / welcome.period:g}"
        )
    if welcome.ticks < loop.count:
        raise InputError(f"rig {rig.address} can run for {welcome.ticks} ticks, the itinerary takes {loop.count}")
