"""A motion as a Rerun recording, built from its story (`run_charts`).

The motion is a run, a recording or a reference. The layout of the recording is built here too.

The viewer can also open a log itself, in its default layout. Times are durations from the start. In the scene x points
right and z up.
In the phase planes the viewer's y points down and its scales are equal: a rate of 10 rad/s is drawn as long as an angle
of 2 rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.parts import Later
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, Line
from dpcontrol.pages.planes import Plane, arm_points, plane
from dpcontrol.pages.ranges import extreme_rows, gap_times, padded, ticked
from dpcontrol.pages.run_charts import check_charts, extra_charts, motion_charts
from dpcontrol.pages.strips import Span, Strip, strips

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
else:
    rr, rrb = Later("rerun"), Later("rerun.blueprint")


TIMELINE = "message_log_time"
"""Timeline of the log's messages, a duration from the start; derived series use the same."""
TRACE_RATE = 50.0
"""Rate of recorded poses and positions, Hz, sufficient for viewing."""
_BINS = 30_000
"""Number of bins of a long curve; the least and the greatest value of each are recorded."""
_ON_THE_WAY = "on the way"


_NO_GAPS: Array = np.zeros(0)


def follow(recording: rr.RecordingStream, path: str, look: Any, time: Array, columns: Any) -> None:
    """Record values at times under a path, in constant style.

    Args:
        recording: recording to extend.
        path: path in the recording.
        look: constant style.
        time: (K,) s.
        columns: values as columns of Rerun.
    """
    recording.log(path, look, static=True)
    recording.send_columns(path, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns)


def trace_rows(view: RunView) -> NDArray[np.int64]:
    """Return the ticks of the recorded poses."""
    return np.arange(0, len(view.time), max(1, round(view.rate_hz / TRACE_RATE)))


def record_chart(recording: rr.RecordingStream, home: str, chart: Chart, view: RunView) -> None:
    """Record a chart's lines and levels under `home` and its key.

    Args:
        recording: recording to extend.
        home: parent path.
        chart: chart to record, skipped without a key.
        view: run with time range and gaps.
    """
    if not chart.key:
        return
    home = f"{home}/{chart.key}"
    for line in chart.lines:
        _line(recording, f"{home}/{line.key}", line, gaps=gap_times(view))
    for level in chart.levels:
        ends = np.array([view.time[0], view.time[-1]])
        _line(
            recording, f"{home}/{level.key}", Line("", level.name, "", ends, np.full(2, level.value), level.colour, 1.0)
        )


def _line(recording: rr.RecordingStream, path: str, line: Line, *, gaps: Array = _NO_GAPS) -> None:
    """Record a line under a path, with its band, if any.

    Long lines are reduced to their extremes.

    Ink becomes pale on the viewer's dark plots, and a reference grey. Lines are interrupted at `gaps`, times in s.
    """
    tint = style.rgb(style.ON_DARK.get(style.REFERENCE if line.role == "reference" else line.colour, line.colour))
    rows = extreme_rows(line.values, bins=_BINS)
    look: rr.SeriesLines | rr.Measurements
    if line.reach is None:
        look = rr.SeriesLines(colors=[tint], names=[line.name], widths=[line.width])
        columns = rr.Scalars.columns(scalars=line.values[rows])
    else:
        look = rr.Measurements.from_fields(names=[line.name], colors=[tint], widths=[line.width])
        # The viewer's band is one standard deviation of the given values.
        columns = rr.Measurements.columns(values=line.values[rows], variances=line.reach[rows] ** 2)
    time = line.time[rows]
    if len(time):
        # At an empty row the viewer ends one line and begins another.
        gaps = gaps[(time[0] < gaps) & (gaps < time[-1])]
        places = np.searchsorted(time, gaps)
        columns = columns.partition(np.insert(np.ones(len(time), dtype=np.int64), places, 0))
        time = np.insert(time, places, gaps)
    follow(recording, path, look, time, columns)


def record_strips(recording: rr.RecordingStream, home: str, strips: Sequence[Strip], view: RunView) -> None:
    """Record strips of named states, each from its start time, s.

    Args:
        recording: recording to extend.
        home: parent path.
        strips: strips to record.
        view: run with the time range.
    """
    for strip in strips:
        changes, colours = _changes(strip.spans, view)
        if not changes:
            continue
        path = f"{home}/{strip.key}"
        # All modes are listed, because another part of the run may follow.
        colours |= style.MODES if strip.key == "mode" else {}
        values = list(colours) if strip.key == "mode" else list(dict.fromkeys(name for _, name in changes))
        tints = [(*style.rgb(colours[value]), 255) for value in values]
        columns = rr.StateChange.columns(state=[name for _, name in changes])
        look = rr.StateConfiguration(values=values, colors=tints)
        follow(recording, path, look, np.array([at for at, _ in changes]), columns)


def _changes(spans: Sequence[Span], view: RunView) -> tuple[list[tuple[float, str]], dict[str, str]]:
    """Return spans as changes of a state, and colours by name.

    Gaps between stays are "on the way".
    """
    begin, end = view.time_range
    changes: list[tuple[float, str]] = []
    colours = {_ON_THE_WAY: style.FAINT}
    for span in spans:
        if span.kind == "transfer":
            continue
        text = f"not planned: {span.text}" if span.kind == "astray" else span.text
        colours[text] = span.colour
        at = max(span.first, begin)
        if changes and changes[-1][0] >= at:
            changes.pop()
        changes.append((at, text))
        if span.kind in ("stay", "astray"):
            changes.append((span.last, _ON_THE_WAY))
    # The last stay extends to the end of the run or the plan.
    if changes and changes[-1][1] == _ON_THE_WAY and changes[-1][0] > end - 2 / view.rate_hz:
        changes.pop()
    return changes, colours


Box = tuple[float, float, float, float]
"""Bounds as drawn: least and greatest x, least and greatest y."""

_RATE = 0.2
_SCALE = np.array([1.0, -_RATE])
_GRID, _DARK_GRID = (226, 229, 233), (52, 56, 62)
_EACH = 2
"""Every second strand of a tube suffices, and is faster to draw without a graphics card."""
_TUBES = (
    (False, style.UNSTABLE, style.PALE_UNSTABLE, "tubes_from"),
    (True, style.STABLE, style.PALE_STABLE, "tubes_to"),
)
"""Stability, colours of the cut and of the strands (the viewer's thin lines are opaque), and name."""
_FAR = 60.0
"""Limits in rad and rad/s beyond which the view is not widened."""


def record_planes(recording: rr.RecordingStream, home: str, view: RunView, *, boxes: list[Box] | None = None) -> None:
    """Record the phase plane of each arm under `home/arm_K`.

    Grid lines cross its box.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
        boxes: box of each arm; fitted to the run by default.
    """
    for arm in range(view.arms):
        at, shown = f"{home}/arm_{arm + 1}", plane(view, arm)
        reading_lines(recording, at, boxes[arm] if boxes else bounds(shown), scale=_RATE)
        for stable, colour, pale, name in _TUBES:
            strands = shown.strands[stable][::_EACH]
            _strips(recording, f"{at}/{name}", strands, [pale] * len(strands), width=0.5)
            _strips(recording, f"{at}/{name}/cut", shown.cuts[stable], [colour] * len(shown.cuts[stable]), width=1.2)
        _strips(recording, f"{at}/orbits", [p for _, p in shown.orbits], [c for c, _ in shown.orbits], width=1.8)
        _strips(recording, f"{at}/run", shown.run, [style.INK] * len(shown.run), width=0.7)
    record_places(recording, home, view)


def record_places(recording: rr.RecordingStream, home: str, view: RunView) -> None:
    """Record the position of each arm in its phase plane.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
    """
    rows = trace_rows(view)
    for arm in range(view.arms):
        look = rr.Points2D.from_fields(colors=[style.rgb(style.LIMIT)], radii=rr.Radius.ui_points(5))
        columns = rr.Points2D.columns(positions=view.state[rows][:, [arm, view.arms + arm]] * _SCALE)
        follow(recording, f"{home}/arm_{arm + 1}/now", look, view.time[rows], columns)


def bounds(*planes: Plane) -> Box:
    """Return the drawn bounds of phase planes, without far outliers."""
    parts = [points for plane in planes for _, points in plane.orbits]
    parts += [points for plane in planes for some in (plane.run, *plane.strands.values()) for points in some]
    every = np.concatenate([part * _SCALE for part in parts]) if parts else np.zeros((1, 2))
    near = np.isfinite(every).all(axis=1) & (np.abs(every[:, 1]) < _FAR)
    every = every[near] if near.any() else np.zeros((1, 2))
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.08 * float(max(high - low)) + 1e-3
    low, high = low - margin, high + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _strips(recording: rr.RecordingStream, at: str, strips: list[Array], colours: list[str], *, width: float) -> None:
    if strips:
        tints = [(*style.rgb(colour), 255) for colour in colours]
        drawn = rr.LineStrips2D([s * _SCALE for s in strips], colors=tints, radii=rr.Radius.ui_points(width))
        recording.log(at, drawn, static=True)


def reading_lines(
    recording: rr.RecordingStream, at: str, box: Box, *, scale: float, turning: bool = True, dark: bool = False
) -> None:
    """Draw grid lines with labels.

    They are at round values across, and at multiples of π or round values along. Bounds of more than fifty turns, or
    of a height without measure, get none.

    Args:
        recording: recording to extend.
        at: parent path.
        box: bounds as drawn.
        scale: drawn length of one unit across.
        turning: True if x is an angle.
        dark: True for a dark background.
    """
    left, right, top, bottom = box
    unit = np.pi if turning else 1.0
    if right - left > 100 * np.pi or not bottom - top < 1e100 * scale:
        return
    strips, places, labels = [], [], []
    for k in _round_values(left / unit, right / unit, integer=turning):
        strips.append([(k * unit, top), (k * unit, bottom)])
        places.append((k * unit, bottom - 0.04 * (bottom - top)))
        labels.append(style.in_pi(k) if turning else f"{k + 0.0:.6g}")
    for k in _round_values(-bottom / scale, -top / scale):
        strips.append([(left, -scale * k), (right, -scale * k)])
        places.append((left + 0.06 * (right - left), -scale * k))
        labels.append(f"{k + 0.0:.6g}")
    if strips:
        look = {"colors": [_DARK_GRID if dark else _GRID], "radii": rr.Radius.ui_points(0.5), "draw_order": -10.0}
        recording.log(f"{at}/grid", rr.LineStrips2D(strips, **look), static=True)  # type: ignore[arg-type]
        ink = (154, 163, 173) if dark else (70, 76, 84)
        names = rr.Points2D(places, labels=labels, colors=[ink], radii=rr.Radius.ui_points(1.0), show_labels=True)
        recording.log(f"{at}/grid/names", names, static=True)


def _round_values(low: float, high: float, *, integer: bool = False) -> Array:
    values = np.asarray(MaxNLocator(6, steps=[1, 2, 5, 10], integer=integer).tick_values(low, high))
    return values[(low <= values) & (values <= high)]


_TRACE_SECONDS = 0.4
_DEPTH = -0.05


def draw_pendulum(recording: rr.RecordingStream, home: str, view: RunView) -> None:
    """Draw the moving arms, the reference, the cart and the track.

    The reference is grey, behind the arms. The track ends at the limits.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
    """
    rows = trace_rows(view)
    reach = sum(view.arm_lengths)
    if view.has_cart:
        _track(recording, home, view, reach=reach)
    shown = [("arms", view.state, 0.0, 0.028)]
    shown += [("reference", view.reference, 0.03, 0.05)] if view.reference is not None else []
    for name, states, depth, radius in shown:
        points = _points(states[rows], view) + np.array([0.0, depth, 0.0])
        for arm in range(view.arms):
            colour = style.arm_colour(arm) if name == "arms" else style.REFERENCE
            look = rr.LineStrips3D.from_fields(colors=[style.rgb(colour)], radii=radius * reach / 2)
            columns = rr.LineStrips3D.columns(strips=list(points[:, arm : arm + 2]))
            follow(recording, f"{home}/{name}/arm_{arm + 1}", look, view.time[rows], columns)
    length = round(_TRACE_SECONDS * TRACE_RATE)
    tips = _points(view.state[rows], view)[:, -1] + np.array([0.0, _DEPTH, 0.0])
    strips = [tips[max(0, k - length) : k + 1] for k in range(len(rows))]
    look = rr.LineStrips3D.from_fields(
        colors=[style.rgb(style.arm_colour(view.arms - 1))], radii=rr.Radius.ui_points(1.5)
    )
    follow(recording, f"{home}/tip", look, view.time[rows], rr.LineStrips3D.columns(strips=strips))
    if view.has_cart:
        centres = np.column_stack([view.pivot[rows], np.full(len(rows), 0.02), np.zeros(len(rows))])
        size = [[0.13 * reach, 0.02, 0.05 * reach]]
        box = rr.Boxes3D.from_fields(half_sizes=size, colors=[style.rgb(style.CART)], fill_mode="solid")
        follow(recording, f"{home}/cart", box, view.time[rows], rr.Boxes3D.columns(centers=centres))


def _track(recording: rr.RecordingStream, home: str, view: RunView, *, reach: float) -> None:
    finite = np.abs(view.pivot[np.isfinite(view.pivot)])
    end = view.limits[0] if view.limits else max(float(finite.max()) if finite.size else 0.0, reach)
    rail = [[(-end, 0.05, 0.0), (end, 0.05, 0.0)]]
    stops = [[(x, 0.05, -0.06 * reach), (x, 0.05, 0.06 * reach)] for x in (-end, end)]
    tints = [style.rgb(style.FAINT), style.rgb(style.LIMIT), style.rgb(style.LIMIT)]
    recording.log(f"{home}/track", rr.LineStrips3D(rail + stops, colors=tints, radii=0.012 * reach), static=True)


def _points(states: Array, view: RunView) -> Array:
    """Return pivot, elbows and tip of states (K, …).

    The points (K, n+1, 3) are in m.
    """
    points = arm_points(states[:, : view.arms], view.arm_lengths)
    pivot = states[:, 2 * view.arms] if view.has_cart else np.zeros(len(states))
    return np.stack([points[..., 0] + pivot[:, None], np.zeros(points.shape[:2]), points[..., 1]], axis=-1)


PAPER = [250, 251, 252]
SUMMARY = "summary"


def blueprint(view: RunView, *, growing: bool = False) -> rrb.Blueprint:
    """Return the blueprint of a recording.

    Args:
        view: the recorded run.
        growing: True if more data will follow: axes adapt, and the viewer follows the latest time.
    """
    grey = f": {view.against} grey" if view.reference is not None else ""
    middle, checks = plots(motion_charts(view), growing=growing), plots(check_charts(view), growing=growing)
    if len(checks) == 1 and len(middle) > 2:
        middle, checks = [*middle, *checks], []
    shares = [2.0] * len(middle)
    shown = {strip.key: strip.name or "symbols" for strip in strips(view)}
    if shown:
        words = ["itinerary as planned and done" if view.done else "itinerary as planned"] if "asked" in shown else []
        words += [name for name in shown.values() if name not in ("asked", "done")]
        contents = [f"+ /{key}" for key in shown]
        middle.insert(0, rrb.StateTimelineView(name=", ".join(words).capitalize(), contents=contents))
        shares.insert(0, 2.2)
    planes = [
        plane_view(arm, "/phase_planes", bounds(plane(view, arm)), name=f"Arm {arm + 1}: rate over angle")
        for arm in range(min(view.arms, 2))
    ]
    texts: list[rrb.View] = [summary_view()]
    if view.events:
        columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
        texts.append(rrb.TextLogView(name="Events", origin="/rosout", columns=columns))
    scene = scene_view(view, name=f"Scene{grey}")
    left = rrb.Vertical(scene, rrb.Horizontal(*planes), rrb.Horizontal(*texts), row_shares=[4, 4, 2.4])
    beside: list[rrb.Container] = [rrb.Vertical(*checks, name="Checks")] if checks else []
    if extras := plots(extra_charts(view)):
        beside = [rrb.Tabs(*beside, rrb.Vertical(*extras, name="Estimated parameters"), active_tab=0)]
    return page([left, rrb.Vertical(*middle, row_shares=shares), *beside], [5, 4.3, 3.7], growing=growing)


def page(
    columns: Sequence[rrb.Container], shares: Sequence[float], *, timeline: str = TIMELINE, growing: bool = False
) -> rrb.Blueprint:
    """Return a blueprint of columns of views, without side panels.

    Args:
        columns: columns of views.
        shares: relative widths of the columns.
        timeline: name of the timeline.
        growing: True to follow the latest time.
    """
    playing: dict[str, Any] = {"play_state": "following"} if growing else {}
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=shares[: len(columns)]),
        rrb.TimePanel(state="collapsed", timeline=timeline, **playing),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(view: RunView, *, home: str = "/scene", name: str = "Scene") -> rrb.View:
    """Return the view of the pendulum in space, seen from the front.

    Args:
        view: recorded run.
        home: path of the scene.
        name: title of the view.
    """
    reach = sum(view.arm_lengths)
    distance = max(2.4 * reach, 1.9 * view.limits[0] if view.limits else 0.0)
    eye = rrb.EyeControls3D(position=(0.0, -distance, 0.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=[f"+ {home}/**"],
        eye_controls=eye,
        line_grid=False,
        background=PAPER,
    )


def summary_view() -> rrb.View:
    """Return the view of a recording's summary."""
    return rrb.TextDocumentView(name="Summary", origin=f"/{SUMMARY}")


def plane_view(arm: int, home: str, box: Box, *, name: str, free: float = 0.1) -> rrb.View:
    """Return the view of an arm's phase plane.

    Args:
        arm: index of the arm, from 0.
        home: parent path.
        box: bounds as drawn.
        name: title of the view.
        free: margin for labels, as a share of the box.
    """
    left, right, top, bottom = box
    wide, high = free * (right - left), free * (bottom - top)
    return rrb.Spatial2DView(
        name=name,
        origin=f"{home}/arm_{arm + 1}",
        visual_bounds=rrb.VisualBounds2D(x_range=(left - wide, right + wide), y_range=(top - high, bottom + high)),
        background=PAPER,
    )


def plots(charts: Sequence[Chart], *, growing: bool = False) -> list[rrb.View]:
    """Return the views of charts.

    Args:
        charts: charts to show; those without a key are omitted.
        growing: as in `blueprint`.
    """
    return [
        rrb.TimeSeriesView(
            name=chart.named,
            origin=f"/plots/{chart.key}",
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
            axis_y=rrb.ScalarAxis(range=None if growing else _shown(chart)),
        )
        for chart in charts
        if chart.key
    ]


def _shown(chart: Chart) -> tuple[float, float] | None:
    """Return the initial range of a chart in the viewer.

    The result is None for an empty chart.
    """
    if chart.shown:
        return ticked(*chart.shown)
    values = np.concatenate([line.values for line in chart.lines])
    return ticked(*padded(values)) if np.isfinite(values).any() else None


_APPLICATION = "dpcontrol"
SCENE = "scene"


def write_recording(view: RunView, path: Path) -> None:
    """Write the recording of a view to `path` (`*.rrd`).

    Args:
        view: run or reference.
        path: file, `*.rrd`.

    Raises:
        InputError: the recording cannot be written.
    """
    with recording_to(path, view.title, blueprint(view), _summary(view)) as recording:
        record_strips(recording, "", strips(view), view)
        for chart in (*motion_charts(view), *check_charts(view), *extra_charts(view)):
            record_chart(recording, "plots", chart, view)
        record_planes(recording, "phase_planes", view)
        draw_pendulum(recording, SCENE, view)
        record_events(recording, view)


@contextmanager
def recording_to(path: Path, name: str, view: rrb.Blueprint, summary: str) -> Iterator[rr.RecordingStream]:
    """Yield a recording with blueprint and summary.

    It becomes the file `path` if the block ends without an error.

    Args:
        path: file, `*.rrd`.
        name: name of the recording.
        view: blueprint.
        summary: text in Markdown.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(Path(path), suffix=".rrd") as temporary:
        recording = rr.RecordingStream(_APPLICATION, send_properties=True)
        # The recording stays in memory until it is complete, because the viewer's writer can hang on a full disk.
        kept = recording.memory_recording()
        recording.send_blueprint(view, make_active=False)
        recording.send_recording_name(name)
        recording.log(SUMMARY, rr.TextDocument(summary, media_type="text/markdown"), static=True)
        yield recording
        recording.flush()
        temporary.write_bytes(kept.drain_as_bytes())


def record_events(recording: rr.RecordingStream, view: RunView) -> None:
    """Record a run's events.

    Args:
        recording: recording to extend.
        view: run with the events.
    """
    if view.events:
        columns = rr.TextLog.columns(
            text=[f"[{event.name}] {event.text}" for event in view.events],
            level=[event.level.upper() for event in view.events],
        )
        index = rr.TimeColumn(TIMELINE, duration=[event.time for event in view.events])
        recording.send_columns("rosout", indexes=[index], columns=columns)


def _summary(view: RunView) -> str:
    rows = [f"**{view.verdict}**" if view.verdict else "", ""]
    for i, (name, at, done) in enumerate(view.symbols):
        seen = "" if done is None else f", done at {done:.3f} s"
        rows.append(f"{i + 1}. {name}: planned at {at:.3f} s{seen}")
    if view.plan.orbits:
        flown = "the reference" if view.what == "reference" else "the run"
        rows += [
            "",
            f"Phase planes, rad/s over rad: orbits thick, tubes from them red and to them green, {flown} black.",
        ]
    rows += ["", f"{view.title} ({view.path.name})", "", "| | |", "|---|---|"]
    # Long values, such as settings in JSON, would push everything out of sight.
    rows += [f"| {key} | {value} |" for key, value in view.metadata.items() if value and len(value) < 60]
    return "\n".join(rows)
