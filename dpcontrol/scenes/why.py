"""Which single change would have saved a run: its seed run again with one setting changed at a time.

Only what the run had is taken off or made less, and every change keeps the seed's draws: the same blows strike the same
plant. A trouble is halved first; where that does not save the run it is left out altogether, so that what is named is
the cheapest of its kind that was tried. The plan stays as it was flown.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from dpcontrol.control.estimator_settings import Augment, EkfSettings
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.review.score import Score
from dpcontrol.scenes.itinerary import Itinerary, overridden
from dpcontrol.scenes.run_options import RunOptions

Change = tuple[str, LoopSettings]


@dataclass(frozen=True)
class TriedChange:
    """One change: whether the run was completed with it, and its verdict."""

    change: str
    completed: bool
    verdict: str


@dataclass(frozen=True)
class Why:
    """What was tried for one seed; reason: of the run as it was."""

    log: str
    seed: int | None
    reason: str
    trials: tuple[TriedChange, ...]

    @property
    def saves(self) -> tuple[str, ...]:
        """The changes with which the run is completed."""
        return tuple(trial.change for trial in self.trials if trial.completed)

    @property
    def sentence(self) -> str:
        """What would have saved the run, in one line."""
        if not self.trials:
            return "completed as it is: nothing was tried"
        if not self.saves:
            return f"none of {len(self.trials)} single changes saves this seed; it takes more than one"
        return f"this seed is completed {', or '.join(self.saves)} ({len(self.trials)} single changes tried)"

    def __repr__(self) -> str:
        return f"<why: {self.sentence}>"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol score --why --json` prints."""
        return {**asdict(self), "saves": list(self.saves), "sentence": self.sentence}


def why(
    scene: Itinerary, score: Score, run: Callable[[LoopSettings], Score], *, progress: Progress = no_progress
) -> Why:
    """Return which single changes complete a run of this scene that was scored so; run: scores it with other settings.

    Raises:
        InputError, GoalMissed: as `run`; of a change that cannot be made only the change fails.
    """
    trials: list[TriedChange] = []
    groups = [] if score.completed else [*changes(scene)]
    for k, group in enumerate(groups):
        progress("why", k / len(groups))
        for text, loop in group:
            try:
                found = run(loop)
            except GoalMissed as missed:
                trials.append(TriedChange(text, completed=False, verdict=str(missed)))
                continue
            trials.append(TriedChange(text, completed=bool(found.completed), verdict=found.reason))
            if found.completed:
                break
    progress("why", 1.0)
    return Why(score.log, score.seed, score.reason, tuple(trials))


def changes(scene: Itinerary) -> Iterator[Sequence[Change]]:
    """Yield the changes of each kind, the least first, of those that this scene's run leaves room for."""
    loop = scene.loop
    limit = loop.travel or scene.limits.position

    def travel(factor: float) -> Change:
        longer = replace(loop, travel=factor * limit, drive=replace(loop.drive, track=math.inf))
        return f"with a travel of ±{factor * limit:.3g} m", longer

    yield travel(1.5), travel(2.0)

    def less(table: str, key: str, half: str, none: str, nothing: Any = 0.0) -> Iterator[Sequence[Change]]:
        part: Any = loop if table == "run" else getattr(loop, table)
        value = getattr(part, key)
        if value == nothing:
            return
        steps = [(half, (value + nothing) / 2)] if half else []
        steps += [(none, nothing)] if none else []
        changed = [(text, replace(part, **{key: to})) for text, to in steps]
        yield [(text, made if table == "run" else replace(loop, **{table: made})) for text, made in changed]

    yield from less("run", "mismatch", "with half the mismatch", "on a plant that is as the model says")
    yield from less("run", "model_uncertainty", "with half the model's uncertainty", "on a plant as the model says")
    yield from less("run", "initial_error", "with half the error at the start", "without an error at the start")
    yield from less("drive", "lag", "with half the drive's lag", "")
    if loop.drive.lag and loop.drive_lag != loop.drive.lag:
        yield (("with a controller that knows of the lag", replace(loop, drive_lag=loop.drive.lag)),)
    yield from less("drive", "delay", "with half the delay", "without the delay")
    yield from less("run", "friction", "with half the friction's factor", "with the plant's own friction", 1.0)
    yield from less("run", "plant", "", "with the model's own arms as the plant", None)
    yield from less("drive", "response", "with half the error of response", "with a drive that does as told", 1.0)
    yield from less("drive", "command_noise", "with half the noise on the command", "without noise on the command")
    yield from less("drive", "cart_mass", "", "on a cart that the arms do not push")
    yield from less("drive", "jerk", "", "without a limit of jerk", math.inf)
    yield from less("sensors", "zero_error", "with half the error of the zeros", "with the encoders' zeros set")
    yield from less("sensors", "noise", "with half the encoders' noise", "without the encoders' noise")
    yield from less("sensors", "rate_noise", "with half the noise on the rates", "without noise on the rates")
    yield from less("sensors", "missed_counts", "with half the missed counts", "without missed counts")
    yield from less("sensors", "dropout", "with half the dropouts", "without dropouts")
    yield from less("sensors", "jitter", "with half the jitter", "without jitter")
    yield from less("sensors", "stuck_at", "", "with a sensor that does not stick", math.inf)
    yield from less("disturbances", "tilt", "with half the tilt", "on a level track")
    yield from less("disturbances", "push_impulse", "with half the pushes' impulse", "without the pushes")
    yield from less("disturbances", "knock_velocity", "with half the knocks' velocity", "without the knocks")
    if loop.disturbances.explicit:
        yield (("without the blows", replace(loop, disturbances=replace(loop.disturbances, explicit=()))),)
    if loop.sensors.counts:
        finer = 4 * loop.sensors.counts
        yield ((f"with {finer} counts a turn", replace(loop, sensors=replace(loop.sensors, counts=finer))),)
    if loop.rate < _QUICK:
        # The delay stays the same in seconds.
        drive = replace(loop.drive, delay=loop.drive.delay * _QUICK / loop.rate)
        yield ((f"at {_QUICK:g} Hz", replace(loop, rate=_QUICK, drive=drive)),)
    if isinstance(loop.estimator, EkfSettings) and Augment.DRIVE not in loop.estimator.augments:
        known = {*loop.estimator.augments, Augment.ZEROS, Augment.DRIVE}
        asked = replace(loop.estimator, augment=tuple(kind.value for kind in Augment if kind in known))
        yield (('with an estimator of the drive\'s error (augment = "drive")', replace(loop, estimator=asked)),)
    if loop.keep == "none" and scene.stay is None:
        other = "tvlqr" if loop.controller.kind == "adaptive" else "adaptive"
        yield ((f"with {other} as the law", overridden(loop, RunOptions(controller=other))),)


_QUICK = 1000.0
"""Hz."""
