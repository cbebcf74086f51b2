"""Chart of a new program's first result at each stage, with an empty and with a filled cache, and of later results.

Each stage is what a user's program calls. Its processor time includes that of Python and of imports. The first program
of a stage finds an empty cache and compiles its code. The second stores optimised code, because the code is used again.
A later one finds everything, and computes the stage twice. The error is the one that the stage's result reports.
"""

import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from dpcontrol.bench.chart import ChartPage, Diagram, Point
from dpcontrol.foundation.cache import VARIABLE
from dpcontrol.foundation.progress import Progress

STAGES = {
    "planned and simulated run": ('dp.run("cross", yes=True)', "result.score().rms_tracking_error"),
    "reference of a walk": ('dp.plan("cross", fresh=True)', "result.reference.max_error_between_nodes"),
    "connections of two orbits": (
        'dp.find_connections("lab", "down-up", "up-down", energy=0.2)',
        "max(c.residual for c in result.connections)",
    ),
    "periodic orbit": ('dp.orbit(dp.load_model("lab"), "down-up", energy=0.2)', "result.residual"),
}
"""Each stage's call and the expression of its error, scaled; of a run rad. The longest one is first."""
PROGRAM = """
import json, os, time
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, range(os.cpu_count()))
import dpcontrol as dp
result = {call}
times = [time.process_time()]
for _ in range({later}):
    {call}
    times.append(time.process_time())
print(json.dumps([times[0], times[-1] - times[-2] if times[1:] else None, {error}]))
"""
"""A program on any core. It prints the seconds of its first and its last result, and the error."""


def stages_chart(quick: bool, progress: Progress) -> ChartPage:
    """Return time and error of each stage: of the first result, with an empty and a filled cache, and of later ones.

    Args:
        quick: one program with a filled cache instead of three.
        progress: called with a label and the completed share.
    """
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        points = []
        for k, stage_points in enumerate(pool.map(partial(_measured, programs=1 if quick else 3), STAGES)):
            points += stage_points
            progress("stages", (k + 1) / len(STAGES))
    return ChartPage(
        name="stages",
        title="From a question to its answer",
        parts=(Diagram("each stage on one core", "processor time, s", "error", tuple(points), joined=True),),
        reading=(
            "Right: a program's first result with an empty cache, as after installation. Middle: with a filled cache.",
            "Left: the same again in one program. Left is faster, low is more accurate; a line joins a stage's marks.",
            "Error: of scaled components, where orbit, connection or reference miss; of the run, rad rms.",
        ),
        chosen="A new stage is compiled without optimisation, because its code is used once. From the second program "
        "on, the cache holds optimised code.",
    )


def _measured(stage: str, programs: int) -> list[Point]:
    """Return the points of a stage: its first result with an empty and a filled cache, and its later results.

    Each program runs in a separate process, and all use one temporary cache. The first finds it empty. The second,
    which is not measured, fills it with optimised code. `programs` is the number of those after it; of their times, the
    least count.
    """
    call, error = STAGES[stage]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, VARIABLE: f"{folder}/cache"}
        codes = [PROGRAM.format(call=call, error=error, later=later) for later in (0, 0, *[1] * programs)]
        outputs = [subprocess.check_output([sys.executable, "-c", code], cwd=folder, env=environment) for code in codes]
    (empty_seconds, *_), _, *later_programs = (json.loads(text.splitlines()[-1]) for text in outputs)
    filled_seconds, later, errors = zip(*later_programs, strict=True)
    times = {"empty cache": empty_seconds, "filled cache": min(filled_seconds), "later results": min(later)}
    return [Point(stage, setting, seconds, errors[-1]) for setting, seconds in times.items()]
