"""Which single change would have saved a run: its seed run again with one setting changed at a time.

Only what the run had is taken off or made less, and every change keeps the seed's draws: the same blows strike the same
plant. A trouble is halved first; where that does not save the run it is left out altogether, so that what is named is
the cheapest of its kind that was tried. The plan stays as it was flown.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from dpcontrol.control.estimator_settings import Augment, EkfSettings
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.review.score import Score
from dpcontrol.scenes.itinerary import Itinerary, overridden, setting_of
from dpcontrol.scenes.run_options import RunOptions


@dataclass(frozen=True)
class SceneChange:
    """A change to be tried: what is said of a run that it saves, and the run's settings with it.

    options: the same by the names of run settings, where these have it. advice: what to do on a bench, as a preflight
    says it; without it no preflight tries the change.
    """

    text: str
    loop: LoopSettings
    options: RunOptions = field(default_factory=RunOptions)
    advice: str = ""


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
        for change in group:
            try:
                found = run(change.loop)
            except GoalMissed as missed:
                trials.append(TriedChange(change.text, completed=False, verdict=str(missed)))
                continue
            trials.append(TriedChange(change.text, completed=bool(found.completed), verdict=found.reason))
            if found.completed:
                break
    progress("why", 1.0)
    return Why(score.log, score.seed, score.reason, tuple(trials))


def changes(scene: Itinerary) -> Iterator[Sequence[SceneChange]]:
    """Yield the changes of each kind, the least first, of those that this scene's run leaves room for."""
    loop = scene.loop
    limit = loop.travel or scene.limits.position

    def by(text: str, advice: str = "", **options: Any) -> SceneChange:
        given = RunOptions(**options)
        return SceneChange(text, overridden(loop, given), given, advice)

    def longer(factor: float, advice: str = "") -> SceneChange:
        change = by(f"with a travel of ±{factor * limit:.3g} m", advice, travel=factor * limit)
        return replace(change, loop=replace(change.loop, drive=replace(change.loop.drive, track=math.inf)))

    yield longer(1.5, f"more travel: ±{1.5 * limit:.3g} m"), longer(2.0)

    def less(key: str, half: str, none: str, advice: str = "", nothing: Any = 0.0) -> Iterator[Sequence[SceneChange]]:
        value = setting_of(loop, key)
        if value == nothing:
            return
        halved = [by(half, advice, **{key: (value + nothing) / 2})] if half else []
        yield [*halved, *([by(none, **{key: nothing})] if none else [])]

    yield from less(
        "mismatch", "with half the mismatch", "on a plant that is as the model says",
        "identify the arms: half the mismatch",
    )  # fmt: skip
    yield from less(
        "model_uncertainty", "with half the model's uncertainty", "on a plant as the model says",
        "identify the arms: half the uncertainty",
    )  # fmt: skip
    yield from less(
        "initial_error", "with half the error at the start", "without an error at the start",
        "hold the arms still at the start: half the error",
    )  # fmt: skip
    yield from less("lag", "with half the drive's lag", "", "a stiffer velocity loop: half the lag")
    if loop.drive.lag and loop.drive_lag != loop.drive.lag:
        known = "with a controller that knows of the lag"
        yield (by(known, "tell the controller of the lag", drive_lag=loop.drive.lag),)
    yield from less("delay", "with half the delay", "without the delay", "half the delay")
    yield from less("friction", "with half the friction's factor", "with the plant's own friction", nothing=1.0)
    if loop.plant is not None:
        yield (SceneChange("with the model's own arms as the plant", replace(loop, plant=None)),)
    yield from less("response", "with half the error of response", "with a drive that does as told", nothing=1.0)
    yield from less(
        "command_noise", "with half the noise on the command", "without noise on the command",
        "a quieter drive: half the noise on its command",
    )  # fmt: skip
    yield from less("cart_mass", "", "on a cart that the arms do not push")
    yield from less("jerk", "", "without a limit of jerk", nothing=math.inf)
    yield from less(
        "zero_error", "with half the error of the zeros", "with the encoders' zeros set",
        "set the encoders' zeros: half their error",
    )  # fmt: skip
    yield from less(
        "noise", "with half the encoders' noise", "without the encoders' noise", "quieter encoders: half their noise"
    )
    yield from less("rate_noise", "with half the noise on the rates", "without noise on the rates")
    yield from less("missed_counts", "with half the missed counts", "without missed counts")
    yield from less("dropout", "with half the dropouts", "without dropouts")
    yield from less("jitter", "with half the jitter", "without jitter")
    yield from less("stuck_at", "", "with a sensor that does not stick", nothing=math.inf)
    yield from less("tilt", "with half the tilt", "on a level track", "level the track: half the tilt")
    yield from less("push_impulse", "with half the pushes' impulse", "without the pushes")
    yield from less("knock_velocity", "with half the knocks' velocity", "without the knocks")
    if loop.disturbances.explicit:
        without = replace(loop, disturbances=replace(loop.disturbances, explicit=()))
        yield (SceneChange("without the blows", without),)
    if loop.sensors.counts:
        finer = 4 * loop.sensors.counts
        yield (by(f"with {finer} counts a turn", "finer encoders: four times the counts", counts=finer),)
    if loop.rate < _QUICK:
        # The delay stays the same in seconds.
        yield (by(f"at {_QUICK:g} Hz", rate=_QUICK, delay=loop.drive.delay * _QUICK / loop.rate),)
    if isinstance(loop.estimator, EkfSettings) and Augment.DRIVE not in loop.estimator.augments:
        known = {*loop.estimator.augments, Augment.ZEROS, Augment.DRIVE}
        asked = replace(loop.estimator, augment=tuple(kind.value for kind in Augment if kind in known))
        text = 'with an estimator of the drive\'s error (augment = "drive")'
        yield (SceneChange(text, replace(loop, estimator=asked)),)
    if loop.keep == "none" and scene.stay is None:
        other = "tvlqr" if loop.controller.kind == "adaptive" else "adaptive"
        yield (by(f"with {other} as the law", f"another law: {other}", controller=other),)


_QUICK = 1000.0
"""Hz."""
