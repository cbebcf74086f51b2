"""Several runs on one clock: each is delayed so that all cross the section of one symbol at the same moment.

The moment is the run's own crossing, decoded from its true angles, or from the estimated ones where the truth is not
known; for a symbol without a section, or one that was not done, it is the plan's; a log without a plan is taken from
its start. Which it was is said for each run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import RunLog
from dpcontrol.review import style
from dpcontrol.review.context import ReviewContext, Stay
from dpcontrol.review.motion import Motion, motion_of

MOST = len(style.RUNS)


@dataclass(frozen=True)
class ComparedRun:
    """One of several runs.

    Attributes:
        name: of its file, with a number where another has the same.
        colour: its own.
        motion, context: on the common clock.
        delay: s, by which its own clock was moved.
        aligned_by: a phrase.
    """

    name: str
    colour: str
    motion: Motion
    context: ReviewContext
    delay: float
    aligned_by: str


@dataclass(frozen=True)
class Comparison:
    """Runs on one clock, the symbol at which they are aligned (from 1), and when that is, s."""

    runs: tuple[ComparedRun, ...]
    symbol: int
    moment: float

    @property
    def status(self) -> str:
        """How the runs were aligned, in one sentence."""
        said = [f"{run.name} {run.aligned_by}" for run in self.runs]
        return f"aligned at symbol {self.symbol}, at {self.moment:.3f} s: {'; '.join(said)}"

    @property
    def title(self) -> str:
        """A title for a page."""
        titles = list(dict.fromkeys(run.context.title.split(" — ")[0] for run in self.runs))
        return f"{len(self.runs)} runs: {titles[0]}" if len(titles) == 1 else f"{len(self.runs)} runs compared"


def compare(runs: Sequence[tuple[RunLog, ReviewContext]], *, symbol: int = 1) -> Comparison:
    """Return runs on one clock, aligned at a symbol, counted from 1.

    Raises:
        InputError: too many runs, of other pendulums, or none has such a symbol.
    """
    if len(runs) > MOST:
        raise InputError(f"{len(runs)} logs are too many for one picture: compare up to {MOST}")
    if len({len(log.arm_lengths) for log, _ in runs}) > 1:
        raise InputError("the logs are of pendulums with different numbers of arms: compare those that have the same")
    most = max(len(context.symbols) for _, context in runs)
    if not 1 <= symbol <= max(most, 1):
        raise InputError(f"--align {symbol}: these runs have symbols 1 to {most}" if most else "no log has symbols")
    moments = [_moment(log, context, symbol - 1) for log, context in runs]
    latest = max(moment for moment, _ in moments)
    names = [log.path.stem for log, _ in runs]
    compared = []
    for k, ((log, context), (moment, said)) in enumerate(zip(runs, moments, strict=True)):
        delay = latest - moment
        name = names[k] if names.count(names[k]) == 1 else f"{names[k]} ({k + 1})"
        motion = motion_of(log).shifted(-delay)
        compared.append(ComparedRun(name, style.RUNS[k], motion, delayed(context, delay), delay, said))
    return Comparison(tuple(compared), symbol, latest)


def _moment(log: RunLog, context: ReviewContext, k: int) -> tuple[float, str]:
    done = context.crossings[k] if k < len(context.crossings) else None
    if done is not None:
        known = "true" if log.truth is not None else "estimated"
        return done, f"by its own crossing ({known} angles)"
    if k < len(context.symbols):
        reached = k < len(context.crossings)
        return context.symbols[k][0], f"by its plan's time ({'a swing' if reached else 'not done'})"
    return float(log.time[0]), "by its start (no such symbol)"


def delayed(context: ReviewContext, seconds: float) -> ReviewContext:
    """Return a context with its times `seconds` later."""

    def later(stays: tuple[Stay, ...]) -> tuple[Stay, ...]:
        return tuple(replace(stay, first=stay.first + seconds, last=stay.last + seconds) for stay in stays)

    return replace(
        context,
        symbols=tuple((at + seconds, name) for at, name in context.symbols),
        planned=later(context.planned),
        done=later(context.done),
        transfers=tuple((a + seconds, b + seconds) for a, b in context.transfers),
        crossings=tuple(None if at is None else at + seconds for at in context.crossings),
        duration=None if context.duration is None else context.duration + seconds,
    )
