"""Chart 6: formats of logs, their chunks and their compression: loss on a kill and size against the time of a message.

Every format holds the same run. A message's time is the run's logging time over its messages, five or six a tick; the
formats that are no messages hold the same numbers, and are divided by the same count.
"""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from dpcontrol.bench.chart import Chart, Missing, Panel, Point
from dpcontrol.bench.log_formats import Arrays, Blocks, ByMessage, Format, Lines, Recording, RowGroups
from dpcontrol.bench.measure import timed_in_turns
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.logs import LogWriter
from dpcontrol.logs.by_message import messages_of
from dpcontrol.loop.loop import run_loop
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run_options import RunOptions

REPEATS = 9
KILLS, QUICK_KILLS = 20, 5
TICKS, QUICK_TICKS = 4000, 1000
CHUNKS = (0.005, 0.01, 0.02, 0.05, 0.2, 1.0)
LEVELS = (-5, 1, 3, 9)
TIME = "s per message"
SURVIVES = 0.25
"""Share of a run: who loses more on average keeps nothing to speak of."""
_WHY = (
    "what is lost is a chunk and never more, and a chunk of 20 ms is as little as the loop itself holds back; longer "
    "ones are quicker by little and lose more"
)


@dataclass(frozen=True)
class Tried:
    """A format's seconds per message, those of the yardstick beside it, bytes per tick, and the mean and the largest
    loss at kills, s.
    """

    kind: Format
    seconds: float
    yardstick: float
    size: float
    loss: float
    largest_loss: float


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart; quick: one second of a run, fewer kills, chunks and levels."""
    formats: list[Format] = [
        ByMessage(1024 * 1024), ByMessage(16 * 1024), ByMessage(16 * 1024, "none"),
        Lines("JSON", flush=False), Lines("JSON", flush=True), Lines("CSV", flush=False), Lines("CSV", flush=True),
        Arrays(compressed=False), Arrays(compressed=True), RowGroups(100), RowGroups(1000),
    ]  # fmt: skip
    ours = [Blocks(chunk) for chunk in (CHUNKS[::2] if quick else CHUNKS)]
    levels = [Blocks(compression=level) for level in (LEVELS[1::2] if quick else LEVELS) if level != 1]
    with tempfile.TemporaryDirectory() as folder:
        run = recording(Path(folder), QUICK_TICKS if quick else TICKS)
        kills = QUICK_KILLS if quick else KILLS
        tried = trials([*ours, *levels, *formats], Path(folder), run, kills=kills, progress=progress)
    blocks = [t for t in tried if isinstance(t.kind, Blocks)]
    seconds = len(run.ticks.times) / run.rate_hz
    alive = [t for t in tried if t.loss < SURVIVES * seconds]
    lost = [
        Missing(
            t.kind.method, t.kind.setting, f"loses {t.loss:.2g} s of {seconds:g} s on a kill, {t.size:.0f} bytes a tick"
        )
        for t in tried
        if t not in alive
    ]
    panels = (
        Panel("A kill", TIME, f"mean loss of a run of {seconds:g} s, s", _points(tried, lambda t: t.loss), why=_WHY),
        Panel("Size, of what outlives a kill", TIME, "bytes per tick", _points(alive, lambda t: t.size),
              missing=tuple(lost), why=_WHY),
        Panel("Chunks and compression of our blocks", "bytes per tick", "mean loss, s",
              _points(blocks, lambda t: t.loss, across=lambda t: t.size), why=_WHY, timed=False),
    )  # fmt: skip
    return Chart(
        name="logging",
        title="Logging: loss on a kill and size against the time of a message",
        panels=panels,
        reading=(
            "Left: seconds of a run that a kill takes, the tick under way included; npz and parquet lose all of it: "
            "they are readable only when complete.",
            "Middle: bytes of a tick, of formats that keep most of a run. MCAP holds messages with types, times and "
            "checksums; the tables hold bare columns of numbers.",
            "Right: our own writer by length of chunk and zstd's level: longer chunks pack better and lose more.",
        ),
        chosen=(
            "Chunks of 20 ms at zstd's level 1, written as arrays: making the messages included, no slower than mcap's "
            "own writer with ready-made ones, and never more lost than a chunk. Higher levels: twice the time for 2 %."
        ),
    )  # fmt: skip


def recording(folder: Path, ticks: int) -> Recording:
    """Return the first ticks of a run of the outer turn, with its messages."""
    scene = load_itinerary("outer-turn").with_run(RunOptions(mismatch=0.02, initial_error=0.02), seed=3)
    arms = scene.model.arms
    flown = run_loop(make_plan(scene).reference, arms, settings=scene.loop).ticks.head(ticks)
    path = folder / "source.mcap"
    with LogWriter(path, arm_lengths=arms.length, rate_hz=scene.loop.rate) as log:
        log.ticks(flown.times, measured=flown.measured, estimate=flown.estimates, reference=flown.references,
                  truth=flown.truth, control=flown.control)  # fmt: skip
    return Recording(flown, messages_of(path), arms.length, scene.loop.rate)


def trials(
    kinds: Sequence[Format], folder: Path, run: Recording, *, kills: int, seed: int = 5, progress: Progress
) -> list[Tried]:
    """Return what formats cost and keep of a run."""
    count = len(run.ticks.times)

    def whole(kind: Format, path: Path) -> None:
        kind.begin(path, run)
        for first in range(0, count, kind.block):
            kind.add(first, min(first + kind.block, count))
        kind.end()

    paths = {k: folder / f"run-{k}" for k in range(len(kinds))}
    spent = timed_in_turns({k: partial(whole, kind, paths[k]) for k, kind in enumerate(kinds)}, REPEATS,
                           progress=part_of(progress, 0.0, 0.6))  # fmt: skip
    found = []
    for k, kind in enumerate(kinds):
        progress(f"kills, {kind.method}", 0.6 + 0.4 * k / len(kinds))
        size = paths[k].stat().st_size / count
        lost = losses(kind, paths[k], run, kills=kills, seed=seed)
        seconds = spent[k].seconds / len(run.messages.messages)
        found.append(Tried(kind, seconds, spent[k].yardstick, size, float(np.mean(lost)), max(lost)))
    return found


def losses(kind: Format, path: Path, run: Recording, *, kills: int, seed: int) -> list[float]:
    """Return the seconds lost at kills at random ticks; a tick that was under way counts."""
    count = len(run.ticks.times)
    moments = np.sort(np.random.default_rng(seed).integers(count // 10, count, kills))
    lost, done = [], 0
    kind.begin(path, run)
    for k, moment in enumerate(moments.tolist()):
        # What is handed over in blocks waits until a block is full.
        until = moment // kind.block * kind.block
        for first in range(done, until, kind.block):
            kind.add(first, first + kind.block)
        done = until
        copy = path.with_name(f"killed-{k}")
        shutil.copyfile(kind.growing(path), copy)
        lost.append((moment + 1 - kind.left(copy)) / run.rate_hz)
    for first in range(done, count, kind.block):
        kind.add(first, min(first + kind.block, count))
    kind.end()
    return lost


def _points(
    tried: list[Tried], of: Callable[[Tried], float], *, across: Callable[[Tried], float] = lambda t: t.seconds
) -> tuple[Point, ...]:
    return tuple(
        Point(
            t.kind.method, t.kind.setting, across(t), of(t), default=t.kind.default, outside=t.kind.outside,
            note=f"{t.largest_loss * 1e3:.0f} ms lost at most, {t.size:.0f} bytes a tick",
            others={"seconds_per_message": t.seconds, "bytes_per_tick": t.size, "mean_loss": t.loss,
                    "largest_loss": t.largest_loss},
            yardstick=t.yardstick,
        )
        for t in tried
    )  # fmt: skip
