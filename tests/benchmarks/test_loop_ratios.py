"""How much of a tick's processor time is its compiled parts? A ratio that holds on any computer.

The compiled parts are the tick (filter, law, path) and the plant's step as C, compiled by the system's compiler. They
are timed on the same core, in turn with the loop.
"""

import ctypes
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.plant import plant_step
from dpcontrol.foundation.arrays import Array
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import LogSink, LoopSink
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.run import assembled, log_writer

pytestmark = pytest.mark.benchmark

ITINERARIES = ("outer-turn", "cross")
SINGLE, LOGGED, LANE = 2.5, 4.0, 0.7
"""Largest processor time of a tick over its compiled parts: alone, with the log, and of one of 64 lanes."""
LANES, TURNS, CALLS = 64, 15, 3000

CALLER = """
void {name}_repeated(const double* in, double* out, long count) {{
    static double w[{work}];
    static long long iw[{whole}];
    const double* arg[{arguments}];
    double* res[{results}];
    {places}
    res[0] = out;
    for (long k = 0; k < count; ++k) {{
        {name}(arg, res, iw, w, 0);
        __asm__ volatile("" ::: "memory");
    }}
}}
"""


def as_c(compiled: Compiled, folder: Path) -> Callable[[Array], float]:
    """Return a function of inputs (M,) that returns the processor time of a call in C, s."""
    function = ca.Function(compiled.function)
    name = function.name()
    code = ca.CodeGenerator(f"{name}.c", {"with_header": False})
    code.add(function)
    text = code.dump() + CALLER.format(
        name=name, work=function.sz_w() + 1, whole=function.sz_iw() + 1, arguments=function.sz_arg(),
        results=function.sz_res(),
        places=" ".join(f"arg[{function.index_in(n)}] = in + {where.start};" for n, where in compiled.slices.items()),
    )  # fmt: skip
    source, library = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(text, encoding="utf-8")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    call, out = ctypes.CDLL(str(library))[f"{name}_repeated"], np.zeros(compiled.size_out)
    expected = compiled.single

    def seconds(inputs: Array) -> float:
        places = [array.ctypes.data_as(ctypes.c_void_p) for array in (inputs, out)]
        begin = time.process_time()
        call(*places, ctypes.c_long(CALLS))
        took = (time.process_time() - begin) / CALLS
        pair = np.repeat(inputs[:, None], 2, axis=1)
        assert np.allclose(expected(pair, np.empty((len(out), 2)))[:, 0], out, rtol=1e-9, atol=1e-9, equal_nan=True)
        return took

    return seconds


@cache
def planned(name: str) -> Plan:
    return make_plan(load_itinerary(name))


def inputs_of(assembly: Assembly) -> tuple[tuple[Compiled, Array], ...]:
    """Return the tick and the plant's step, each with its inputs in the middle of a run."""
    ticker, plant, middle = assembly.ticker(), assembly.draw().plant, assembly.controller.ticks // 2
    program, seen = ticker.program, assembly.simulate().ticks
    for k in range(middle):
        program.take(seen.measured[k][:, None], None, 0.0, None)
        ticker.rows_of(k, 1, program.row[None])
        program.tick()
    tick = np.concatenate([*program.reading, program.row, program.constants[:, None].repeat(2, 1), program.stored])
    step = plant_step(plant.arms.count, plant.level, friction=plant.arms.friction, components=plant.kinds)
    assert seen.truth is not None
    moved = np.concatenate([seen.truth[middle], seen.control[middle, 3:4], [ticker.program.period], plant.numbers()])
    return (program.machine("tick"), tick[:, 0].copy()), (step, moved)


@pytest.mark.parametrize("name", ITINERARIES)
def test_a_tick_takes_little_more_than_its_compiled_parts(name: str, tmp_path: Path) -> None:
    plan = planned(name)
    assembly = assembled(plan)
    parts = [(as_c(compiled, tmp_path), inputs) for compiled, inputs in inputs_of(assembly)]
    ticks, draw = assembly.controller.ticks + 1, assembly.draw()

    def simulated(sink: LoopSink | None = None) -> float:
        """Return the processor time of a tick; loop and bench are made before."""
        loop = assembly.loop(sink=sink)
        start, queued = assembly.controller.first_state, loop.queued
        rig = SimulatedRig(draw, assembly.settings.bench, limits=assembly.limits, start=start, queued=queued)
        begin = time.process_time()
        loop.run(rig)
        return (time.process_time() - begin) / ticks

    def logged() -> float:
        with log_writer(plan, tmp_path / "log.mcap") as writer:
            return simulated(LogSink(writer))

    def lane() -> float:
        begin = time.process_time()
        assembly.batch(range(LANES))
        return (time.process_time() - begin) / ticks / LANES

    kinds: dict[str, Callable[[], float]] = {
        "compiled parts": lambda: sum(seconds(inputs) for seconds, inputs in parts),
        "tick": simulated, "tick and log": logged, "lane": lane,
    }  # fmt: skip
    for work in kinds.values():
        work()
    # In turn, because other work on the computer slows all of them.
    taken = {kind: [] for kind in kinds}
    for _ in range(TURNS):
        for kind, work in kinds.items():
            taken[kind].append(work())
    least = {kind: min(values) for kind, values in taken.items()}
    ratios = {kind: value / least["compiled parts"] for kind, value in least.items()}
    shown = ", ".join(f"{kind} {1e6 * least[kind]:.2f} µs ({ratio:.2f})" for kind, ratio in ratios.items())
    sys.stdout.write(f"\n{name}: {shown}\n")
    assert ratios["tick"] <= SINGLE
    assert ratios["tick and log"] <= LOGGED
    assert ratios["lane"] <= LANE
