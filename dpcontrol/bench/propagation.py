"""Chart of propagation: trajectories of a tube, a chaotic swing of 10 s, a tick of the closed loop.

All methods start from the same states and are judged at the same time against 113-bit arithmetic. The energy drift is
the largest change of H over the flight's end states, over the energy scale.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bench.chart import Chart, Missing, Panel, Point
from dpcontrol.bench.flights import Candidate, Work, candidates, work_of
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.bench.ticks import tick_panels
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]

ENERGY = 0.2
SWING = (1.7, 2.2, 0.0, 0.0)
"""Let go at rest: an error of the start grows five-millionfold in 10 s."""
SWING_SECONDS = 10.0
TUBE_PERIODS = 2.0
LANES = 64
ROUNDING = 1e-14
"""Of the energy, over its scale."""


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart of propagation."""
    model = load_model("lab")
    system = model.system
    progress("propagation: truth in 113 bits", 0.0)
    orbit = lyapunov_orbit(system, "down-up", energy=ENERGY)
    phases = np.arange(LANES) / LANES
    seeds, _ = UnstableManifold(orbit).seeds(phases, 1)
    tube = work_of(system, seeds[:: 8 if quick else 2], TUBE_PERIODS * orbit.period)
    swing = work_of(system, np.array([SWING]), SWING_SECONDS)
    panels = []
    for k, (title, work) in enumerate((("trajectory of a tube, {:.2f} s", tube), ("chaotic swing, {:.0f} s", swing))):
        progress(f"propagation: {title.split(',')[0]}", 0.2 + 0.3 * k)
        panels += _panels(
            title.format(work.duration), work, part_of(progress, 0.2 + 0.3 * k, 0.5 + 0.3 * k), batches=k == 0,
            quick=quick,
        )  # fmt: skip
    progress("propagation: tick", 0.8)
    panels = [panels[0], panels[2], panels[3], *tick_panels(model.arms, quick=quick)]
    return Chart(
        name="propagation",
        title="Propagation: time against error",
        panels=tuple(panels),
        reading=(
            "A mark is a method at a setting: left is faster, low is nearer to 113-bit arithmetic; same start.",
            "Grey joins the front: nothing is both faster and nearer than a mark there. A ring: what dpcontrol takes.",
            "Energy gained or lost (third diagram) stays small in symplectic schemes even where the motion is far off.",
        ),
        chosen=(
            "Taylor's method at the tolerance of rounding, eight trajectories at once where there are many: a looser "
            "tolerance saves less than half of the time and costs the digits. Ticks of many plants take DOP853's step "
            "as machine code, the filter's model one step of order 4."
        ),
    )


def _panels(title: str, work: Work, progress: Progress, *, batches: bool, quick: bool) -> list[Panel]:
    """Return the diagrams of error and of energy drift, from the same flights."""
    points, start_up, missing = measured(
        candidates(work, batches=batches, quick=quick), work, quick=quick, progress=progress
    )
    label = "time, s per trajectory"
    drifts = tuple(replace(p, error=p.others["drift"]) for p in points)
    return [
        Panel(title, label, "error, scaled", points, start_up, missing),
        Panel(
            f"{title}: energy",
            label,
            "energy drift, share of the scale",
            drifts,
            start_up,
            missing,
            floor=ROUNDING,
            judged=False,
        ),
    ]


def measured(
    tried: list[Candidate], work: Work, *, quick: bool, progress: Progress = no_progress
) -> tuple[tuple[Point, ...], Mapping[str, float], tuple[Missing, ...]]:
    """Fly each candidate; return its point, its method's longest start-up, and what could not be flown."""

    def flown(fly: Callable[[], Array]) -> Array | str:
        try:
            arrived = fly()
        except (ArithmeticError, RuntimeError, GoalMissed) as failure:
            return str(failure).splitlines()[0][:200]
        return arrived if np.isfinite(arrived).all() else "its step is too long: the state became infinite"

    points, start_up, missing = [], {}, []
    runs = timed_in_turns(
        {k: partial(flown, c.fly) for k, c in enumerate(tried)}, 5 if quick else 9, most=0.1 if quick else 1.0,
        worth=lambda arrived: not isinstance(arrived, str), progress=progress,
    )  # fmt: skip
    for c, run in zip(tried, runs.values(), strict=True):
        if isinstance(run.result, str):
            missing.append(Missing(c.method, c.setting, run.result))
            continue
        start_up[c.method] = max(start_up.get(c.method, 0.0), run.start_up)
        error, drift = work.error(run.result), work.drift(run.result)
        points.append(
            Point(
                c.method,
                c.setting,
                run.seconds / c.take,
                error,
                default=c.default,
                others={"drift": drift},
                yardstick=run.yardstick,
            )
        )
    return tuple(points), start_up, tuple(missing)
