"""Where OGY ends: the largest pulse, and encoder counts, by sections in a period.

An error grows by about λ^(1/k) from one of k sections to the next, so that few sections need large pulses and fine
encoders. Readings round as the orbit has it, which no short formula tells: the borders are measured only.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dpcontrol.bench.control import held
from dpcontrol.bench.edges import Attempt, Border, EdgeChart, EdgeMap, borders, find_border, half_of
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.loop.batch import run_batch
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.loop import LoopSettings, sampled_model
from dpcontrol.loop.result import Ending
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.problem import Limits
from dpcontrol.references.sustained import SustainedOrbit, sustained_orbit
from dpcontrol.scenes.model import load_model

RATE = 1000.0
SECONDS, QUICK_SECONDS = 6.0, 4.0
SEEDS, RATIO = 16, 1.12
QUICK_SEEDS, QUICK_RATIO = 8, 1.6
SECTIONS, QUICK_SECTIONS = (1, 2, 3, 4, 8, 16), (8,)
LIMIT = 0.5
"""m/s²: of the pulses where counts are varied."""
COUNTS = 40_000.0
"""Counts per turn where the pulses are varied."""
FEWEST, MOST = 50.0, 4e8
"""Counts per turn: from the coarsest encoders to none that there is."""
WEAKEST, STRONGEST = 0.01, 5.0
"""m/s²: pulses from next to nothing to the shipped ones."""


@dataclass(frozen=True, eq=False)
class HeldOrbit:
    """An orbit to be held for `seconds`, and the arms that are believed and simulated alike."""

    orbit: SustainedOrbit
    arms: ArmChainParameters
    seconds: float = SECONDS

    def controller(self, sections: int, limit: float = LIMIT) -> OgyController:
        """Return the law by `sections` pulses a period, of at most `limit` m/s²; it learns nothing."""
        settings = OgySettings(sections=sections, pulse_limit=limit, parameter_error=0.0)
        return ogy_controller(self.orbit, sampled_model(self.arms, RATE), settings, seconds=self.seconds)


def stay(saddle: str = "down-up", energy: float = -0.07, *, seconds: float = SECONDS) -> HeldOrbit:
    """Return the lab's orbit about a saddle at an energy in J."""
    lab = load_model("lab")
    return HeldOrbit(sustained_orbit(lyapunov_orbit(lab.system, saddle, energy=energy), lab.arms), lab.arms, seconds)


def chart(quick: bool, progress: Progress) -> EdgeChart:
    """Return the chart; quick: fewer sections and seeds, wider borders, and shorter runs."""
    one = stay(seconds=QUICK_SECONDS if quick else SECONDS)
    sections, seeds, ratio = (QUICK_SECTIONS, QUICK_SEEDS, QUICK_RATIO) if quick else (SECTIONS, SEEDS, RATIO)
    weak, counted = (
        borders(partial(of, one, seeds=seeds, ratio=ratio), sections, part_of(progress, begin, end), what)
        for of, begin, end, what in (
            (limit_border, 0.0, 0.4, "largest pulse, k = {}"), (counts_border, 0.4, 1.0, "counts, k = {}"),
        )
    )  # fmt: skip
    x = "sections in a period, k"
    return EdgeChart(
        name="edges-ogy",
        title=f"Where OGY ends: Down-Up at -0.07 J, multiplier {one.orbit.multipliers[0].real:.0f} a period",
        maps=(
            EdgeMap(f"Authority, {COUNTS:,.0f} counts per turn", x, "largest pulse, m/s²", weak, far="lost"),
            EdgeMap(f"Encoders, pulses of {LIMIT:g} m/s²", x, "counts per turn", counted, far="lost"),
        ),
        reading=(
            "From one section to the next an error grows by about λ^(1/k), so few sections need large pulses or "
            "encoders that nobody builds.",
            f"Circles: at least half of {seeds} runs hold; crosses: fewer. Zeros of the encoders lie anywhere within a "
            "count.",
            "How readings round depends on the orbit, and more counts may be worse in places: no formula predicts "
            "these borders.",
        ),
        chosen="16 sections a period and pulses of up to 5 m/s²: encoders of a few hundred counts would still do.",
    )


def holds(one: HeldOrbit, controller: OgyController, *, counts: float, seeds: int) -> Attempt:
    """Return whether at least half of the runs hold the orbit, else what ended the first that did not."""
    whole = max(round(counts), 1)
    sensors = SensorSettings(counts=whole, cart_resolution=1e-6, zero_error=np.pi / whole)
    # Zeros being estimated would need a third larger pulses at k = 16.
    settings = LoopSettings(
        seed=0, rate=RATE, sensors=sensors, estimator=EkfSettings(augment=()), initial_error=1e-5
    )  # fmt: skip
    runs = run_batch(one.arms, settings=settings, seeds=range(seeds), controller=controller,
                     limits=Limits(position=5.0, acceleration=30.0))  # fmt: skip
    period = one.orbit.period
    judge = held(one.orbit.state(np.linspace(0, period, 1000))[:, : one.arms.count], period=period)
    away = "finished, but away from the orbit in its last period"
    return half_of(
        [Attempt(judge(run), away if run.ending is Ending.FINISHED else run.reason) for run in runs], "runs lost"
    )


def limit_border(one: HeldOrbit, sections: int, *, seeds: int = SEEDS, ratio: float = RATIO) -> Border:
    """Return the smallest limit of the pulses, m/s², with which `sections` of them a period hold the orbit."""
    controller = one.controller(sections)

    def probe(limit: float) -> Attempt:
        return holds(one, replace(controller, pulse_limit=limit), counts=COUNTS, seeds=seeds)

    return _border(probe, sections, near=STRONGEST, far=WEAKEST, ratio=ratio)


def counts_border(one: HeldOrbit, sections: int, *, seeds: int = SEEDS, ratio: float = RATIO) -> Border:
    """Return the fewest counts per turn with which `sections` pulses a period hold the orbit."""
    controller = one.controller(sections)

    def probe(counts: float) -> Attempt:
        return holds(one, controller, counts=counts, seeds=seeds)

    return _border(probe, sections, near=MOST, far=FEWEST, ratio=ratio)


def _border(probe: Callable[[float], Attempt], sections: int, *, near: float, far: float, ratio: float) -> Border:
    return find_border(probe, x=sections, line=f"k = {sections}", near=near, far=far, ratio=ratio)
