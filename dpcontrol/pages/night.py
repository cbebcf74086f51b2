"""Evaluate a long run from the folder of its logs: times on and off the itinerary, and the reasons.

    uptime = time on the itinerary / known time

At a fall the supervisor gives up the itinerary. The time until the itinerary is joined again is one
absence, regardless of further falls in it. The files' digests are read one by one; a missing digest, as after a killed
run, is computed from the log.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs.container import partials_of
from dpcontrol.logs.layout import CATCH, LAP, REST, RESUME, RETURN, START
from dpcontrol.logs.reader import read_log
from dpcontrol.logs.rolling import Digest, digest_of_log
from dpcontrol.pages import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ITINERARY, CALMING, STARTING = "on the itinerary", "arms calmed", "rising"
BETWEEN, UNKNOWN = "between repetitions", "no log"
"""Kinds of spans, as displayed."""
STOPPED = "ended"
_SHORT = 0.05
"""Share of the longest file's time below which a mean does not count: estimates drift while the cart is at rest."""
_GAP = 0.5
"""Least gap between two files, s."""


@dataclass(frozen=True)
class NightSpan:
    """A part of a night of one kind; times in s.

    The `cause` is that of the preceding fall, or "".
    """

    first: float
    end: float
    kind: str
    cause: str = ""


@dataclass(frozen=True)
class Fall:
    """A fall at a time s, with its cause and logged text.

    `back` is the time until the itinerary was joined again, s, from the first of consecutive falls, or None.
    """

    time: float
    cause: str
    text: str
    back: float | None = None


@dataclass(frozen=True)
class Drift:
    """Course of one estimated parameter.

    It has the mean over the first file and the last, and the change per hour.

    The change is that of a straight line through the files' means; not-a-number for a single file.
    """

    name: str
    first: float
    last: float
    per_hour: float


def cause_of(text: str) -> str:
    """Return the reason for giving up the itinerary, in a few words."""
    # A braking cart has not hit its stop.
    for mark, words in (("is stuck", "sensor stuck"), ("no measurement", "no measurement"),
                        ("limit switch", "limit switch"), ("cart at its stop", "cart near its stop")):  # fmt: skip
        if mark in text:
            return words
    for words in ("tracking lost", "estimate lost", "plant failed"):
        if text.startswith(words):
            return words
    return "other"


@dataclass(frozen=True, eq=False)
class Night:
    """A long run, represented by its digests in order."""

    folder: Path
    digests: tuple[Digest, ...]
    partials: tuple[Path, ...] = ()
    spans: tuple[NightSpan, ...] = field(init=False)
    falls: tuple[Fall, ...] = field(init=False)
    endings: tuple[tuple[float, str], ...] = field(init=False)
    """Times and texts of endings, except by the planned time."""

    def __post_init__(self) -> None:
        """Find spans and falls in the digests."""
        spans, falls, endings = _followed(self.digests)
        for name, value in (("spans", spans), ("falls", falls), ("endings", endings)):
            object.__setattr__(self, name, tuple(value))

    def _time(self, *kinds: str) -> float:
        return sum(span.end - span.first for span in self.spans if span.kind in kinds)

    @property
    def known(self) -> float:
        """Time with known activity, s."""
        return sum(digest.end - digest.first for digest in self.digests)

    @property
    def uptime(self) -> float:
        """Share of the known time on the itinerary."""
        return self._time(ITINERARY) / self.known

    @property
    def falls_per_hour(self) -> float:
        """Falls in an hour of the known time."""
        return 3600 * len(self.falls) / self.known

    @property
    def causes(self) -> dict[str, int]:
        """Number of falls by cause, the most frequent first."""
        return dict(Counter(fall.cause for fall in self.falls).most_common())

    @property
    def returns(self) -> Array:
        """Time from each fall until the itinerary was joined again, s."""
        return np.array([fall.back for fall in self.falls if fall.back is not None])

    @property
    def repetitions(self) -> int:
        """Number of completed repetitions of the itinerary."""
        return sum(digest.repetitions for digest in self.digests)

    @property
    def catches(self) -> int:
        """Number of catches before a fall."""
        return sum(digest.others.get(CATCH, 0) for digest in self.digests)

    @property
    def tracking(self) -> float:
        """Rms distance of the angles from the reference on the itinerary, rad."""
        followed = sum(digest.followed for digest in self.digests)
        return math.sqrt(sum(digest.squares for digest in self.digests) / followed / 2) if followed else math.nan

    @property
    def cart(self) -> float:
        """Greatest distance of the cart from the centre, m."""
        return max(digest.cart for digest in self.digests)

    @property
    def stop_hits(self) -> int:
        """Number of times the cart hit an end stop of its track."""
        return sum("hit its hard stop" in text for _, text in self.endings)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(dict.fromkeys(name for digest in self.digests for name in digest.extras))

    def course(self, name: str) -> tuple[Array, Array]:
        """Return hours (K,) and means (K,) of a parameter, by file.

        A short last file is omitted.
        """
        own = [digest for digest in self.digests if name in digest.extras]
        least = _SHORT * max(digest.end - digest.first for digest in own)
        hours, values = np.array(
            [((d.first + d.end) / 7200, d.extras[name][0]) for d in own if d.end - d.first >= least]
        ).T
        return hours, values

    @property
    def drifts(self) -> tuple[Drift, ...]:
        """Courses of the estimated parameters."""
        out = []
        for name in self.estimated:
            hours, values = self.course(name)
            slope = float(np.polyfit(hours, values, 1)[0]) if len(values) > 1 else math.nan
            out.append(Drift(name, float(values[0]), float(values[-1]), slope))
        return tuple(out)

    @property
    def memory_growth(self) -> float:
        """Final memory of the process relative to the session's first file.

        It is not-a-number if unknown.
        """
        last = self.digests[-1]
        of_session = [d.memory for d in self.digests if d.session == last.session and math.isfinite(d.memory)]
        return of_session[-1] / of_session[0] if of_session else math.nan

    @property
    def deadlines(self) -> dict[str, float] | None:
        """Deadline statistics of a rig, or None in simulation.

        Counts cover all sessions; the worst delay is in s.
        """
        kept = [digest.deadlines for digest in self.digests if digest.deadlines]
        counts = {name: sum(int(one[name]) for one in kept) for name in ("ticks", "missed", "lost", "held")}
        return {**counts, "worst": max(one["worst"] for one in kept)} if kept else None

    @property
    def sentence(self) -> str:
        """Summary of the night in one line."""
        hours = self.known / 3600
        returns = self.returns
        back = ""
        if len(returns):
            median, slowest = np.quantile(returns, [0.5, 0.99])
            back = f", back on it after {median:.1f} s in the median, 99 % within {slowest:.1f} s"
        caught = f"caught {self.catches} time{'s' * (self.catches > 1)}, " if self.catches else ""
        return (
            f"{hours:.3g} hours: {self.uptime:.1%} of the time on the itinerary, {self.repetitions} repetitions; "
            f"{caught}{len(self.falls)} fall{'s' * (len(self.falls) != 1)} ({self.falls_per_hour:.3g} an hour){back}"
        )

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol score FOLDER --json`."""
        returns = self.returns
        quantiles = np.quantile(returns, [0.5, 0.99]).tolist() if len(returns) else [None, None]
        lost = [{"first": s.first, "end": s.end} for s in self.spans if s.kind == UNKNOWN]
        return {
            "log": self.folder, "hours": self.known / 3600, "files": len(self.digests),
            "files_kept": len([*self.folder.glob("*.mcap")]),
            "sessions": len({d.session for d in self.digests}),
            "uptime": self.uptime, "repetitions": self.repetitions, "falls": len(self.falls),
            "catches": self.catches, "falls_per_hour": self.falls_per_hour, "causes": self.causes,
            "return_median": quantiles[0], "return_99": quantiles[1],
            "not_back": sum(fall.back is None for fall in _firsts(self.falls, self.spans)),
            "stop_hits": self.stop_hits, "max_cart_position": self.cart, "rms_tracking_error": self.tracking,
            "seconds": {kind: self._time(kind) for kind in (ITINERARY, CALMING, STARTING, BETWEEN)},
            "not_logged": lost, "endings": [{"time": time, "text": text} for time, text in self.endings],
            "drift": [asdict(drift) for drift in self.drifts],
            "memory_growth": self.memory_growth, "deadlines": self.deadlines, "partials": list(self.partials),
        }  # fmt: skip

    def lines(self) -> Iterator[str]:
        """Yield the lines of the report."""
        yield str(self.folder)
        yield f"  {self.sentence}"
        if self.falls:
            yield f"  falls    {', '.join(f'{cause} {count}' for cause, count in self.causes.items())}"
        limit = self.digests[0].limit
        of = f" of {1e3 * limit:.0f}" if limit else ""
        hits = self.stop_hits
        yield (
            f"  cart     {1e3 * self.cart:.1f}{of} mm at most, {hits or 'no'} end stop{'s' if hits > 1 else ''} hit; "
            f"tracking {1e3 * self.tracking:.1f} mrad rms on the itinerary"
        )
        if self.drifts:
            shown = (f"{d.name} {d.first:+.4f} to {d.last:+.4f}" for d in self.drifts)
            yield f"  drift    {', '.join(shown)}"
        if math.isfinite(self.memory_growth):
            yield f"  memory   {self.memory_growth:.0%} of its size after the first file"
        if (kept := self.deadlines) is not None:
            yield (
                f"  rig      {kept['missed']:,} of {kept['ticks']:,} deadlines missed, ticks began up to "
                f"{1e3 * kept['worst']:.3g} ms late; {kept['lost']:,} readings lost, the bench repeated a command "
                f"{kept['held']:,} times"
            )
        for span in self.spans:
            if span.kind == UNKNOWN:
                yield f"  no log from {span.first / 60:.2f} to {span.end / 60:.2f} minutes"
        for time, text in self.endings:
            yield f"  ended at {time / 60:.2f} minutes: {text}"
        for file in self.partials:
            yield f"  beside it: {file}, of a night that was interrupted or is under way"


def _firsts(falls: Sequence[Fall], spans: Sequence[NightSpan]) -> list[Fall]:
    """Return the falls that took a run off its itinerary."""
    ends = [span.end for span in spans if span.kind == ITINERARY]
    return [fall for fall in falls if any(abs(fall.time - end) < 1e-6 for end in ends)]


def _followed(digests: Sequence[Digest]) -> tuple[list[NightSpan], list[Fall], list[tuple[float, str]]]:
    spans: list[NightSpan] = []
    falls: list[Fall] = []
    endings: list[tuple[float, str]] = []
    kind, cause, since, left = STOPPED, "", digests[0].first, None
    end = digests[0].first

    def turn(time: float, following: str, why: str) -> None:
        nonlocal kind, cause, since
        if time > since:
            if spans and (spans[-1].kind, spans[-1].cause, spans[-1].end) == (kind, cause, since):
                spans[-1] = replace(spans[-1], end=time)
            else:
                spans.append(NightSpan(since, time, kind, cause))
        kind, cause, since = following, why, time

    for digest in digests:
        if digest.first > end + _GAP:
            turn(end, UNKNOWN, "")
            turn(digest.first, ITINERARY if digest.on else STOPPED, "")
            left = None
        for time, level, name, text in digest.events:
            if name in (RESUME, LAP):
                if left is not None:
                    falls[left] = replace(falls[left], back=time - falls[left].time)
                    left = None
                turn(time, ITINERARY, "")
            elif name == RETURN and level == "info":
                turn(time, BETWEEN, "")
            elif name == RETURN:
                left = len(falls) if left is None else left
                falls.append(Fall(time, cause_of(text), text))
                turn(time, CALMING, falls[left].cause)
            elif name == START and kind not in (STOPPED, ITINERARY):
                turn(time, BETWEEN if kind == BETWEEN else STARTING, cause)
            elif name not in (REST, START):
                if name != "finished":
                    endings.append((time, text))
                turn(time, STOPPED, "")
        end = digest.end
    turn(end, STOPPED, "")
    return spans, falls, endings


def read_night(folder: Path) -> Night:
    """Return the long run in a folder.

    Raises:
        InputError: the folder holds none, or one of its files is damaged or from another run.
    """
    folder = Path(folder)
    digests = [*_digests(folder)]
    if not digests:
        raise InputError(
            f"cannot read {folder}: it is a folder without logs of a long run; give a log, or a folder that "
            "`dpcontrol run --hours` made"
        )
    partials = partials_of(folder / folder.resolve().name)
    # Partial files with a recovered log are not reported.
    left = [file for file in partials if not (folder / f"{file.name.partition('.mcap')[0]}.mcap").exists()]
    return Night(folder, tuple(digests), tuple(left))


def _digests(folder: Path) -> Iterator[Digest]:
    name = folder.resolve().name
    numbers = sorted({file.stem for file in folder.glob(f"{name}-[0-9]*") if file.suffix in (".mcap", ".json")})
    for stem in numbers:
        log, beside = folder / f"{stem}.mcap", folder / f"{stem}.json"
        size = log.stat().st_size if log.is_file() else None
        digest = None
        with suppress(OSError, ValueError, TypeError, KeyError):
            digest = Digest.of(beside.read_text(encoding="utf-8"))
        if digest is not None and size in (None, digest.size):
            yield digest
        elif size is not None:
            yield digest_of_log(read_log(log), size=size)
        else:
            raise InputError(f"{beside} is damaged, and its log was thinned; remove it to score the other files")


_COLOURS = {
    ITINERARY: "#9fd3a8", CALMING: "#e8877f", STARTING: "#f2c46d", BETWEEN: "#8fbce6", UNKNOWN: "#22262b",
    STOPPED: "#ffffff",
}  # fmt: skip
_ROW = 1800.0
"""Duration of a row of the strip, s, short enough to show absences of seconds; longer in long nights."""
_ROWS = 32
_REMAINDER = 5.0
"""Time at the end of a night, s, that gets no separate row, for example while the cart is braked."""


def draw_night(night: Night) -> "Figure":
    """Return one page on a night.

    It shows strips of half an hour, times to return, causes, and drift of the parameters.
    """
    from dpcontrol.pages.page import new_figure

    last = max(span.end for span in night.spans)
    row = last if last <= 600.0 + _REMAINDER else 600.0 if last <= 3600.0 else _ROW * math.ceil(last / _ROW / _ROWS)
    rows = max(1, math.ceil((last - _REMAINDER) / row))
    strip, others = max(1.0, 0.42 * rows), 1.7
    height = 4.6 + 0.42 * rows
    figure = new_figure(12.0, height)
    grid = figure.add_gridspec(
        3, 2, height_ratios=[strip, others, others], left=0.09, right=0.94, top=1 - 0.75 / height,
        bottom=0.75 / height, hspace=2.7 / (strip + 2 * others), wspace=0.25,
    )  # fmt: skip
    title = fill(f"{night.folder.name}: {night.sentence}", 150)
    figure.text(0.03, 1 - 0.22 / height, title, fontsize=9.5, va="center")
    _draw_strip(figure.add_subplot(grid[0, :]), night, row, rows)
    _draw_returns(figure.add_subplot(grid[1, 0]), night)
    _draw_causes(figure.add_subplot(grid[1, 1]), night)
    names = night.estimated
    zeros = [name for name in names if name.startswith("zero_")]
    _draw_drift(figure.add_subplot(grid[2, 0]), night, "Encoder zeros, change since the first file", "mrad", zeros, 1e3)
    others = [name for name in names if name not in zeros]
    _draw_drift(
        figure.add_subplot(grid[2, 1]), night, "Other parameters, change since first file", "share", others, 1.0
    )
    return figure


_FALLS = {
    "tracking lost": "#b3261e", "estimate lost": "#8a4fa3", "cart near its stop": "#d9640d", "limit switch": "#d9640d",
    "sensor stuck": "#1f6fb4", "no measurement": "#0f8b8d",
}  # fmt: skip


def _draw_strip(axes: "Axes", night: Night, row: float, rows: int) -> None:
    from matplotlib.patches import Patch

    from dpcontrol.pages.page import quiet

    quiet(axes)
    scale = 60.0
    for span in night.spans:
        first = span.first
        while first < span.end - 1e-9:
            k = int(first / row + 1e-9)
            end = min(span.end, (k + 1) * row)
            # The edge keeps short absences visible.
            colour, edge = _COLOURS[span.kind], 0.0 if span.kind in (ITINERARY, STOPPED) else 0.8
            axes.barh(k, (end - first) / scale, left=(first - k * row) / scale, height=0.78, color=colour,
                      edgecolor=colour, linewidth=edge)  # fmt: skip
            first = end
    for fall in night.falls:
        k = min(int(fall.time / row), rows - 1)
        axes.plot((fall.time - k * row) / scale, k - 0.42, marker="v", markersize=4.5, clip_on=False,
                  color=_FALLS.get(fall.cause, style.INK), linewidth=0)  # fmt: skip
    for k in range(rows):
        within = [(max(s.first, k * row), min(s.end, (k + 1) * row), s.kind) for s in night.spans]
        total = sum(max(b - a, 0.0) for a, b, kind in within if kind != UNKNOWN)
        on = sum(max(b - a, 0.0) for a, b, kind in within if kind == ITINERARY)
        if total:
            axes.text(1.008, k, f"{on / total:.0%}", transform=axes.get_yaxis_transform(), va="center", fontsize=8.5)
    minutes = [round(k * row / 60) for k in range(rows)]
    labels = [f"{m // 60}:{m % 60:02d} h" if row >= _ROW else f"{m} min" for m in minutes]
    axes.set_yticks(range(rows), labels)
    axes.set(xlim=(0, row / scale), ylim=(rows - 0.5, -0.65))
    axes.set_xlabel("minutes", fontsize=8.5)
    axes.set_title("up", loc="right", fontsize=8.5, color=style.NOTE)
    shown = [kind for kind in _COLOURS if any(s.kind == kind for s in night.spans) and kind != STOPPED]
    handles: list[Any] = [Patch(color=_COLOURS[kind], label=kind) for kind in shown]
    handles += [
        axes.plot([], [], marker="v", linewidth=0, markersize=5, color=_FALLS.get(cause, style.INK),
                  label=f"fall: {cause}")[0]
        for cause in night.causes
    ]  # fmt: skip
    axes.legend(handles=handles, ncols=len(handles), loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=8.5,
                frameon=False, handlelength=1.2, columnspacing=1.4)  # fmt: skip


def _draw_returns(axes: "Axes", night: Night) -> None:
    from dpcontrol.pages.page import quiet

    quiet(axes, "Time from the fall back onto the itinerary", x="s", y="share of falls within")
    returns = np.sort(night.returns)
    if not len(returns):
        axes.text(0.5, 0.5, "no falls", transform=axes.transAxes, ha="center", color=style.NOTE)
        return
    shares = np.arange(1, len(returns) + 1) / len(returns)
    axes.step(np.r_[0, returns], np.r_[0, shares], where="post", color=style.ARMS[0])
    for share, name, height in ((0.5, "median", 0.16), (0.99, "99 %", 0.04)):
        value = float(np.quantile(returns, share))
        axes.axvline(value, color=style.MARK, linewidth=0.8, linestyle=":")
        axes.text(value, height, f" {name} {value:.1f} s", fontsize=8, color=style.NOTE)
    axes.set(xlim=(0, 1.3 * returns[-1]), ylim=(0, 1.03))


def _draw_causes(axes: "Axes", night: Night) -> None:
    from matplotlib.ticker import MaxNLocator

    from dpcontrol.pages.page import quiet

    quiet(axes, "Falls by cause")
    causes = night.causes
    axes.barh(range(len(causes)), list(causes.values()), color=[_FALLS.get(c, style.INK) for c in causes], height=0.6,
              alpha=0.8)  # fmt: skip
    axes.set_yticks(range(len(causes)), list(causes))
    axes.set_ylim(max(len(causes) - 0.4, 0.6), -0.6)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_drift(axes: "Axes", night: Night, title: str, unit: str, names: Sequence[str], scale: float) -> None:
    from dpcontrol.pages.page import quiet

    quiet(axes, title, x="hours", y=unit)
    for k, name in enumerate(names):
        hours, values = night.course(name)
        colour = style.RUNS[k % len(style.RUNS)]
        line = "-" if k < len(style.RUNS) else "--"
        axes.plot(hours, scale * (values - values[0]), line, color=colour, marker="o", markersize=2.5, linewidth=1.1,
                  label=name)  # fmt: skip
    if names:
        axes.legend(ncols=len(names), fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.24),
                    handlelength=1.4, columnspacing=1.0)  # fmt: skip
