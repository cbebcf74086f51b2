"""Properties that make the runs of a plan likely to fail.

Each caution compares a figure of plan and rig with a limit, and has a change that was tried and helps. Itineraries
drawn at random (`tests/benchmarks/generated_scenes.py`) complete nearly all runs below the limits. A plan with a figure
beyond its limit is rehearsed in a few simulated runs, and has cautions only if some of these fail.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import compress
from typing import ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.causes import CautionCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Cost, announce
from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import BatchRun
from dpcontrol.plans.authority import growth_along, peak_gains
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.references.reference import Reference
from dpcontrol.words.searches import CAUTION_REMEDIES, Concluded

LIMITS = {
    CautionCause.AUTHORITY: 105.0,
    CautionCause.GAINS: 1.2,
    CautionCause.START: 0.3,
    CautionCause.LAG: 0.42,
    CautionCause.LATE: 0.72,
}
"""Largest figure of each kind that completes reliably."""
REHEARSED, FAILING = 16, 2
"""Simulated runs of a rehearsal, and failures that call for a caution."""
_MISMATCH = 0.05
"""Least mismatch of rehearsed plants."""
_TICKS_A_SECOND = 50_000
"""Ticks of rehearsed runs that a processor computes in a second."""
_FIRST_SEED = 2**30
"""First seed of a rehearsal, far from those of campaigns."""
_TIPS = np.geomspace(0.05, 2.0, 9)
"""Masses to try at the outer tip, relative to the outer arm's."""
_FINER = 4
"""Factor on the counts to try."""


@dataclass(frozen=True)
class Caution(Concluded, Documented):
    """One reason why runs are likely to fail.

    Attributes:
        cause: the kind of figure.
        figure: m/s² per rad for `authority`, powers of e for `lag` and `late`, and shares of the drive's acceleration
            for `gains` and `start`.
        place: the stop, or the largest part of the figure, or "".
        change: what was changed, or "" if nothing that was tried helps.
        value: its value in its own unit.
        changed: the figure with the change.
        failed: number of rehearsed runs that failed, or None without a rehearsal.
    """

    KEYS: ClassVar[str] = "cause figure limit place change value changed failed? status remedy"

    cause: CautionCause
    figure: float
    place: str = ""
    change: str = ""
    value: float = 0.0
    changed: float = 0.0
    failed: int | None = None

    @property
    def limit(self) -> float:
        """The largest figure that completes reliably."""
        return LIMITS[self.cause]

    @property
    def remedy(self) -> str:
        """The change that helps, in words."""
        return CAUTION_REMEDIES[self.change].format_map(vars(self))


def figures_of(itinerary: Itinerary, reference: Reference) -> tuple[Caution, ...]:
    """Return the figures of a plan that are beyond their limits, the farthest first.

    Args:
        itinerary: itinerary with the settings of its runs.
        reference: its converged reference.
    """
    figures = (
        *_authority(itinerary.model.arms, reference),
        *_gains(itinerary, reference),
        *_late(itinerary, reference),
    )
    beyond_limits = [caution for caution in figures if caution.figure > caution.limit]
    return tuple(sorted(beyond_limits, key=lambda caution: -caution.figure / caution.limit))


def cautions_of(itinerary: Itinerary, reference: Reference) -> tuple[Caution, ...]:
    """Return the figures of a plan that are beyond their limits, if rehearsed runs fail.

    Args:
        itinerary: itinerary with the settings of its runs.
        reference: its converged reference.
    """
    if not (figures := figures_of(itinerary, reference)):
        return ()
    try:
        failed = _failed(itinerary, reference)
    except (GoalMissed, InputError):
        # Nothing flies this plan with these settings; a run names the reason.
        return figures
    return tuple(replace(caution, failed=failed) for caution in figures) if failed >= FAILING else ()


def _failed(itinerary: Itinerary, reference: Reference) -> int:
    """Return the number of rehearsed runs, of 16, that do not complete the itinerary.

    The plants of these runs have at least an error of 5 %, and their seeds differ from those of campaigns.
    """
    loop = replace(itinerary.loop, mismatch=max(itinerary.loop.mismatch, _MISMATCH))
    assembly = Assembly(
        reference, itinerary.model.arms, loop, uncertainty=itinerary.uncertainty, stays=stays(reference)
    )
    seeds, ticks = range(_FIRST_SEED, _FIRST_SEED + REHEARSED), REHEARSED * reference.duration * loop.rate
    cost = Cost(f"{REHEARSED} rehearsed runs", ticks / _TICKS_A_SECOND, 72 * ticks, f"plan of {itinerary.name}")
    announce(cost, yes=True)
    runs = assembly.batch(seeds) if assembly.lockstep else [None] * REHEARSED
    flights = (
        BatchRun.of(assembly.simulate(draw=assembly.draw(seed=seed))) if run is None or run.departed else run
        for seed, run in zip(seeds, runs, strict=True)
    )
    limits = loop.limits(reference.limits)
    flown_runs = (Flown.of(run, rate_hz=loop.rate, limits=limits) for run in flights)
    return sum(not verdict_on(flown, reference).completed for flown in flown_runs)


def hidden_angles(itinerary: Itinerary) -> dict[str, float]:
    """Return the angle of an arm that each property of the rig hides from the feedback, rad.

    Dry friction hides the angles at which it holds an arm against gravity.

    Args:
        itinerary: itinerary with the settings of its runs.
    """
    loop, arms = itinerary.loop, itinerary.model.arms
    n, mechanics = arms.count, loop.mechanics
    counts = loop.counts(n)
    plants = [arms, *([loop.plant] if isinstance(loop.plant, ArmChainParameters) else [])]
    friction_angle = max(float(np.max(np.divide(plant.coulomb or 0.0, plant.torques))) for plant in plants)
    return {
        "counts": 2 * np.pi / min(counts) if counts else 0.0,
        "noise": loop.sensors.noise,
        "play": max(compress(mechanics.of_each("play", n), loop.of_each("encoders", n))),
        "friction": friction_angle + float(np.max(np.divide(mechanics.of_each("stiction", n), arms.torques))),
    }


def _authority(arms: ArmChainParameters, reference: Reference) -> Iterator[Caution]:
    """Yield a caution for each unstable stop, with the gain that its feedback needs, m/s² per rad, as the figure.

    The change is the smallest mass at the outer tip, kg, with which the need is below its limit. If no mass suffices,
    it is the one with the smallest need, or none.
    """
    for name, place in {stop.saddle: np.array(stop.angles) for stop in reference.content.stops}.items():
        if (need := arms.need(place)) is None:
            continue
        needs_with_tip = [(arms.with_tip(mass).need(place) or 0.0, mass) for mass in (_TIPS * arms.mass[-1]).tolist()]
        sufficient_tips = (candidate for candidate in needs_with_tip if candidate[0] < LIMITS[CautionCause.AUTHORITY])
        # If no mass suffices, the one with the smallest need, or none.
        need_after, mass = next(sufficient_tips, min(*needs_with_tip, (need, 0.0)))
        yield Caution(CautionCause.AUTHORITY, need, name, "tip_mass" if mass else "", mass, need_after)


def _gains(itinerary: Itinerary, reference: Reference) -> Iterator[Caution]:
    """Yield the cautions on gains that amplify hidden angles and errors at the start.

    The figures are shares of the drive's acceleration: the largest gain times the angles that the rig hides, and the
    first gain times the error of the initial angles.
    """
    loop, arms = itinerary.loop, itinerary.model.arms
    try:
        shares = peak_gains(arms, reference) / itinerary.limits.acceleration
    except GoalMissed:
        # The end cannot be held: its need is infinite, which is a caution already.
        return
    hidden_angle, peak_share = hidden_angles(itinerary), float(shares.max())
    largest = max(hidden_angle, key=lambda name: hidden_angle[name])
    finer_counts = _FINER * min(loop.counts(arms.count), default=0)
    # The change removes the largest hidden angle, or the share of it that finer encoders show.
    value, removed_share = (finer_counts, 1 - 1 / _FINER) if largest == "counts" else (0, 1.0)
    figure = peak_share * sum(hidden_angle.values())
    yield Caution(
        CautionCause.GAINS, figure, largest, largest, value, figure - removed_share * peak_share * hidden_angle[largest]
    )
    figure, limit = float(shares[0]) * loop.initial_error, LIMITS[CautionCause.START]
    yield Caution(CautionCause.START, figure, "", "initial_error", limit / float(shares[0]), limit)


def _late(itinerary: Itinerary, reference: Reference) -> Iterator[Caution]:
    """Yield the cautions on delays: the growth of errors until a command acts, and its part unknown to the controller.

    The figures are powers of e. The change of the first is a known lag, and that of the second halves the largest
    delay.
    """
    loop, rate = itinerary.loop, growth_along(itinerary.model.arms, reference)
    lag, belt = loop.drive.lag, loop.mechanics.belt
    delays = {
        "delay": (loop.drive.delay + 0.5) / loop.rate,
        "lag": lag,
        "belt": 1 / (2 * np.pi * belt) if belt else 0.0,
    }
    yield Caution(CautionCause.LAG, rate * abs(lag - loop.drive_lag), "", "drive_lag", lag)
    largest, growth = max(delays, key=lambda name: delays[name]), rate * sum(delays.values())
    value = delays[largest] / 2
    yield Caution(CautionCause.LATE, growth, largest, largest, value, growth - rate * value)
