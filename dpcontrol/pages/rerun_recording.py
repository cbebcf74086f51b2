"""A motion as a Rerun recording with its layout: scene, strips, charts (`run_charts`), phase planes and events.

The motion is a run, a recording or a reference. The viewer can also open a log itself, in its default layout. Times are
durations from the start. In the scene x points right and z up. In phase planes a rate of 10 rad/s is drawn as long as
an angle of 2 rad. A plane of the viewer has equal scales, and its y axis points down.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.parts import Later
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.planes import Plane, arm_points, extreme_rows, gap_times, plane
from dpcontrol.pages.run_charts import Chart, Line, check_charts, extra_charts, motion_charts
from dpcontrol.pages.story import Strip, strips

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
else:
    rr, rrb = Later("rerun"), Later("rerun.blueprint")

PAPER, DARK = (250, 251, 252), (18, 20, 24)
"""Backgrounds of views."""
_FAR = np.array([300.0, 300.0])
"""Values beyond which a sheet is not widened."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A part of a phase plane, with an angle in rad as x.

    Attributes:
        low: least x and y.
        high: greatest x and y.
    """

    low: Array
    high: Array

    @classmethod
    def around(cls, *planes: Plane) -> Sheet:
        """Return the smallest sheet, with margins, that holds phase planes of one arm, apart from far outliers.

        Args:
            *planes: phase planes of the arm, one for each run that is shown.
        """
        curves = [points for plane in planes for _, points in plane.orbits]
        curves += [
            points for plane in planes for stretches in (plane.run, *plane.strands.values()) for points in stretches
        ]
        all_points = np.concatenate([np.zeros((0, 2)), *curves])
        near = all_points[(np.abs(all_points) < _FAR).all(axis=1)]
        low, high = (near.min(axis=0), near.max(axis=0)) if len(near) else (np.zeros(2), np.zeros(2))
        width, height = np.maximum(high - low, 1e-12)
        margin = 0.1 * max(width, _RATE * height) * np.array([1.0, 1 / _RATE]) + 1e-3
        return cls(low - margin, high + margin)

    def drawn(self, points: ArrayLike) -> Array:
        """Return points (…, 2) of angle and rate as the viewer draws them: rates shortened, and upwards."""
        return np.asarray(points) * [1.0, -_RATE]

    def grid(self, recording: rr.RecordingStream, home: str) -> None:
        """Record grid lines with labels at round rates and at angles that are multiples of π.

        Args:
            recording: recording to extend.
            home: parent path.
        """
        (left, bottom), (right, top) = self.low, self.high
        angles, rates = np.pi * _round_values(left / np.pi, right / np.pi, integer=True), _round_values(bottom, top)
        lines = [[(x, bottom), (x, top)] for x in angles] + [[(left, y), (right, y)] for y in rates]
        label_angle, label_rate = self.low + [0.06, 0.04] * (self.high - self.low)
        places = [(x, label_rate) for x in angles] + [(label_angle, y) for y in rates]
        # Adding zero turns a negative zero into zero.
        labels = [style.in_pi(x / np.pi) for x in angles] + [f"{y + 0.0:.6g}" for y in rates]
        if lines:
            ends = [self.drawn(line) for line in lines]
            record_curves(recording, f"{home}/grid", ends, ["#e2e5e9"], 0.5, draw_order=-10.0)
            look = {"colors": [style.rgb("#464c54")], "radii": rr.Radius.ui_points(0.5), "show_labels": True}
            names = rr.Points2D(self.drawn(places), labels=labels, **look)
            recording.log(f"{home}/grid/names", names, static=True)

    def view(self, origin: str, *, name: str) -> rrb.View:
        """Return the viewer's view of the sheet, which shows exactly its part of the plane.

        Args:
            origin: path of its contents.
            name: title of the view.
        """
        (left, top), (right, bottom) = self.drawn([(self.low[0], self.high[1]), (self.high[0], self.low[1])])
        bounds = rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom))
        return rrb.Spatial2DView(name=name, origin=origin, visual_bounds=bounds, background=PAPER)


def _round_values(low: float, high: float, *, integer: bool = False) -> Array:
    """Return about six round values between two bounds for grid lines, multiples of whole numbers if `integer`."""
    values = np.asarray(MaxNLocator(6, steps=[1, 2, 5, 10], integer=integer).tick_values(low, high))
    return values[(low <= values) & (values <= high)]


TIMELINE = "message_log_time"
"""Timeline of the log's messages, a duration from the start; derived series use the same."""
TRACE_RATE = 50.0
"""Rate of recorded poses and positions, Hz, sufficient for viewing."""
SCENE, SUMMARY, PLANES, PLOTS = "scene", "summary", "phase_planes", "plots"
"""Paths in a recording."""
_BINS = 30_000
"""Number of bins of a long curve; the least and the greatest value of each are recorded."""
_ON_THE_WAY = "on the way"
"""State of a strip between two stays."""
_RATE = 0.2
"""Drawn length of 1 rad/s in a phase plane; an angle of 1 rad is 1 long."""
_EACH = 2
"""Every second strand of a tube suffices, and is faster to draw without a graphics card."""
_TUBES = (
    (False, style.UNSTABLE, style.PALE_UNSTABLE, "tubes_from"),
    (True, style.STABLE, style.PALE_STABLE, "tubes_to"),
)
"""Stability, colours of the cut and of the strands (the viewer's thin lines are opaque), and name."""
_TRACE_SECONDS = 0.4
"""Duration of the visible path of the tip, s."""
_NO_GAPS: Array = np.zeros(0)


def follow(recording: rr.RecordingStream, path: str, look: Any, time: Array, columns: Any) -> None:
    """Record values at times under a path, in constant style, as every curve and every moving object of a recording.

    Args:
        recording: recording to extend.
        path: path in the recording.
        look: constant style, an object of Rerun's kind for these values, such as `rr.SeriesLines`.
        time: (K,) s.
        columns: the K values, as made by the method `columns` of the kind, such as `rr.Scalars.columns`.
    """
    recording.log(path, look, static=True)
    recording.send_columns(path, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns)


def record_curves(
    recording: rr.RecordingStream,
    home: str,
    curves: Sequence[Array],
    colours: Sequence[str],
    width: float,
    **look: Any,
) -> None:
    """Record constant curves, such as orbits and tubes, under one path in one style.

    Args:
        recording: recording to extend.
        home: path in the recording.
        curves: curves (K, 2) in the plane or (K, 3) in space.
        colours: one colour, or the colour of each curve.
        width: width of the curves, points.
        **look: further fields of Rerun's line strips.
    """
    if len(curves):
        strips = rr.LineStrips2D if curves[0].shape[1] == 2 else rr.LineStrips3D
        look = {"colors": [style.rgb(colour) for colour in colours], "radii": rr.Radius.ui_points(width), **look}
        recording.log(home, strips(curves, **look), static=True)


def trace_rows(view: RunView) -> NDArray[np.int64]:
    """Return the ticks of the recorded poses, which are fewer than the run's: 50 in each second suffice for viewing."""
    return np.arange(0, len(view.time), max(1, round(view.rate_hz / TRACE_RATE)))


def record_chart(recording: rr.RecordingStream, chart: Chart, view: RunView) -> None:
    """Record the lines of a chart and its levels, which are lines of two points.

    Args:
        recording: recording to extend.
        chart: chart to record, skipped without a key.
        view: run with time range and gaps.
    """
    if not chart.key:
        return
    level_lines = [
        Line(level.key, level.name, "", view.time[[0, -1]], np.full(2, level.value), level.colour, 1.0)
        for level in chart.levels
    ]
    for line in chart.lines:
        _line(recording, f"{PLOTS}/{chart.key}/{line.key}", line, gaps=gap_times(view))
    for line in level_lines:
        _line(recording, f"{PLOTS}/{chart.key}/{line.key}", line)


def _line(recording: rr.RecordingStream, path: str, line: Line, *, gaps: Array = _NO_GAPS) -> None:
    """Record a line of a chart under a path, with its band, if any; long lines are reduced to their extremes.

    Ink becomes pale on the viewer's dark plots, and a reference grey. Lines are interrupted at `gaps`, times in s.
    """
    tint = style.rgb(style.ON_DARK.get(style.REFERENCE if line.role == "reference" else line.colour, line.colour))
    rows = extreme_rows(line.values, bins=_BINS)
    values, time = line.values[rows], line.time[rows]
    look: rr.SeriesLines | rr.Measurements
    if line.reach is None:
        look = rr.SeriesLines(colors=[tint], names=[line.name], widths=[line.width])
        columns = rr.Scalars.columns(scalars=values)
    else:
        look = rr.Measurements.from_fields(names=[line.name], colors=[tint], widths=[line.width])
        # The viewer's band is one standard deviation of the given values.
        columns = rr.Measurements.columns(values=values, variances=line.reach[rows] ** 2)
    if len(time):
        # At an empty row the viewer ends one line and begins another.
        gaps = gaps[(time[0] < gaps) & (gaps < time[-1])]
        places = np.searchsorted(time, gaps)
        columns = columns.partition(np.insert(np.ones(len(time), dtype=np.int64), places, 0))
        time = np.insert(time, places, gaps)
    follow(recording, path, look, time, columns)


def record_strips(recording: rr.RecordingStream, home: str, strips: Sequence[Strip], view: RunView) -> None:
    """Record strips as states that change over time, which the viewer draws as coloured bands with their texts.

    Args:
        recording: recording to extend.
        home: parent path.
        strips: strips to record.
        view: run with the time range.
    """
    for strip in strips:
        changes, colours = _changes(strip, view)
        if not changes:
            continue
        # All modes are listed, because another part of the run may follow.
        colours |= style.MODES if strip.key == "mode" else {}
        look = rr.StateConfiguration(
            values=list(colours), colors=[(*style.rgb(colour), 255) for colour in colours.values()]
        )
        columns = rr.StateChange.columns(state=[name for _, name in changes])
        follow(recording, f"{home}/{strip.key}", look, np.array([moment for moment, _ in changes]), columns)


def _changes(strip: Strip, view: RunView) -> tuple[list[tuple[float, str]], dict[str, str]]:
    """Return the changes of a strip's state, each with its time in s, and the colours of the states.

    A state is the text of a span. Between stays the state is "on the way".
    """
    begin, end = view.time_range
    states: dict[float, str] = {}
    colours: dict[str, str] = {}
    for span in (span for span in strip.spans if span.kind != "transfer"):
        text = f"not planned: {span.text}" if span.kind == "astray" else span.text
        # A span ends those before it, and replaces changes that were expected after its beginning.
        states = {moment: state for moment, state in states.items() if moment < span.first} | {
            max(span.first, begin): text
        }
        colours[text] = span.colour
        # The last stay extends to the end of the run or the plan.
        if span.kind in ("stay", "astray") and span.last <= end - 2 / view.rate_hz:
            states[span.last] = _ON_THE_WAY
            colours[_ON_THE_WAY] = style.FAINT
    return sorted(states.items()), colours


def record_planes(recording: rr.RecordingStream, home: str, view: RunView, sheets: Sequence[Sheet]) -> None:
    """Record the phase plane of each arm under `home/arm_K`: grid, tubes, orbits, the run and its moving position.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
        sheets: sheet of each arm.
    """
    for arm, sheet in enumerate(sheets):
        path, arm_plane = f"{home}/arm_{arm + 1}", plane(view, arm)
        sheet.grid(recording, path)
        for stable, colour, pale, name in _TUBES:
            strands, cuts = arm_plane.strands[stable][::_EACH], arm_plane.cuts[stable]
            record_curves(recording, f"{path}/{name}", [*map(sheet.drawn, strands)], [pale], 0.5)
            record_curves(recording, f"{path}/{name}/cut", [*map(sheet.drawn, cuts)], [colour], 1.2)
        orbits = [sheet.drawn(points) for _, points in arm_plane.orbits]
        record_curves(recording, f"{path}/orbits", orbits, [colour for colour, _ in arm_plane.orbits], 1.8)
        record_curves(recording, f"{path}/run", [*map(sheet.drawn, arm_plane.run)], [style.INK], 0.7)
    record_places(recording, home, view)


def record_places(recording: rr.RecordingStream, home: str, view: RunView) -> None:
    """Record the position of each arm in its phase plane over time, a dot that moves with the viewer's time.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
    """
    rows = trace_rows(view)
    for arm in range(view.arms):
        look = rr.Points2D.from_fields(colors=[style.rgb(style.LIMIT)], radii=rr.Radius.ui_points(5))
        columns = rr.Points2D.columns(positions=view.state[rows][:, [arm, view.arms + arm]] * [1.0, -_RATE])
        follow(recording, f"{home}/arm_{arm + 1}/now", look, view.time[rows], columns)


def draw_pendulum(recording: rr.RecordingStream, home: str, view: RunView) -> None:
    """Draw the moving arms with their tip's path, the reference grey behind them, the cart, and the track.

    Args:
        recording: recording to extend.
        home: parent path.
        view: run to record.
    """
    rows, reach = trace_rows(view), sum(view.arm_lengths)
    time, arms = view.time[rows], _points(view.state[rows], view, 0.0)
    # Name, joints (K, n+1, 3), m, and thickness as a share of the length of all arms.
    chains = [("arms", arms, 0.028)]
    if view.reference is not None:
        chains.append(("reference", _points(view.reference[rows], view, 0.03), 0.05))
    for name, points, radius in chains:
        for arm in range(view.arms):
            colour = style.arm_colour(arm) if name == "arms" else style.REFERENCE
            look = rr.LineStrips3D.from_fields(colors=[style.rgb(colour)], radii=radius * reach / 2)
            columns = rr.LineStrips3D.columns(strips=list(points[:, arm : arm + 2]))
            follow(recording, f"{home}/{name}/arm_{arm + 1}", look, time, columns)
    # The path lies slightly in front of the arms, so that they do not hide it.
    length, tips = round(_TRACE_SECONDS * TRACE_RATE), arms[:, -1] + [0.0, -0.05, 0.0]
    columns = rr.LineStrips3D.columns(strips=[tips[max(0, k - length) : k + 1] for k in range(len(rows))])
    tint = style.rgb(style.arm_colour(view.arms - 1))
    look = rr.LineStrips3D.from_fields(colors=[tint], radii=rr.Radius.ui_points(1.5))
    follow(recording, f"{home}/tip", look, time, columns)
    if view.has_cart:
        distances = np.abs(view.pivot[np.isfinite(view.pivot)])
        # The track ends at the limits.
        end = view.limits[0] if view.limits else max(distances.max(initial=0.0), reach)
        rail = [[(-end, 0.05, 0.0), (end, 0.05, 0.0)]]
        stops = [[(x, 0.05, -0.06 * reach), (x, 0.05, 0.06 * reach)] for x in (-end, end)]
        tints = [style.rgb(style.FAINT), style.rgb(style.LIMIT), style.rgb(style.LIMIT)]
        recording.log(f"{home}/track", rr.LineStrips3D(rail + stops, colors=tints, radii=0.012 * reach), static=True)
        size, look = [[0.13 * reach, 0.02, 0.05 * reach]], {"colors": [style.rgb(style.CART)], "fill_mode": "solid"}
        columns = rr.Boxes3D.columns(centers=arms[:, 0] + [0.0, 0.02, 0.0])
        follow(recording, f"{home}/cart", rr.Boxes3D.from_fields(half_sizes=size, **look), time, columns)


def _points(states: Array, view: RunView, depth: float) -> Array:
    """Return the joints of the arms in the scene, (K, n+1, 3) in m: pivot, elbows and tip, moved with the cart.

    Args:
        states: angles, rates and, with a cart, its position and velocity, (K, 2n+2) or (K, 2n).
        view: motion with the n arms.
        depth: distance behind the plane of the arms, m, which keeps the reference behind the motion.
    """
    points = arm_points(states[:, : view.arms], view.arm_lengths)
    pivot = states[:, 2 * view.arms] if view.has_cart else np.zeros(len(states))
    return np.stack([points[..., 0] + pivot[:, None], np.full(points.shape[:2], depth), points[..., 1]], axis=-1)


def blueprint(view: RunView, sheets: Sequence[Sheet], *, growing: bool = False) -> rrb.Blueprint:
    """Return the layout of a recording in the viewer.

    Scene, phase planes and texts are at the left, strips and charts of the motion in the middle, checks at the right.

    Args:
        view: the recorded run.
        sheets: sheet of each arm's phase plane, of which the first two are shown.
        growing: True if more data will follow: axes adapt, and the viewer follows the latest time.
    """
    middle, checks = plots(motion_charts(view), growing=growing), plots(check_charts(view), growing=growing)
    if strip_names := {strip.key: strip.name or "symbols" for strip in strips(view)}:
        name = ", ".join(strip_names.values()).capitalize()
        middle.insert(0, rrb.StateTimelineView(name=name, contents=[f"+ /{key}" for key in strip_names]))
    planes = [
        sheet.view(f"/{PLANES}/arm_{arm + 1}", name=f"Arm {arm + 1}: rate over angle")
        for arm, sheet in enumerate(sheets[:2])
    ]
    texts: list[rrb.View] = [summary_view()]
    if view.events:
        columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
        texts.append(rrb.TextLogView(name="Events", origin="/rosout", columns=columns))
    scene = scene_view(view, name="Scene" if view.reference is None else f"Scene: {view.against} grey")
    left = rrb.Vertical(scene, rrb.Horizontal(*planes), rrb.Horizontal(*texts), row_shares=[4, 4, 2.4])
    right: list[rrb.Container] = [rrb.Vertical(*checks, name="Checks")] if checks else []
    if extras := plots(extra_charts(view)):
        right = [rrb.Tabs(*right, rrb.Vertical(*extras, name="Estimated parameters"), active_tab=0)]
    return page([left, rrb.Vertical(*middle), *right], [5, 4.3, 3.7], growing=growing)


def page(
    columns: Sequence[rrb.Container | rrb.View],
    shares: Sequence[float],
    *,
    growing: bool = False,
) -> rrb.Blueprint:
    """Return the layout of a recording: columns of views, with the viewer's own side panels closed.

    Args:
        columns: columns of views.
        shares: relative widths of the columns.
        growing: True to follow the latest time.
    """
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=shares[: len(columns)]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following" if growing else None),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(view: RunView, *, home: str = f"/{SCENE}", name: str = "Scene") -> rrb.View:
    """Return the view of the pendulum in space, seen from the front.

    Args:
        view: recorded run.
        home: path of the scene.
        name: title of the view.
    """
    distance = max(2.4 * sum(view.arm_lengths), 1.9 * view.limits[0] if view.limits else 0.0)
    eye = rrb.EyeControls3D(position=(0.0, -distance, 0.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))
    look = {"eye_controls": eye, "line_grid": False, "background": PAPER}
    return rrb.Spatial3DView(name=name, origin="/", contents=[f"+ {home}/**"], **look)


def summary_view() -> rrb.View:
    """Return the view of a recording's summary."""
    return rrb.TextDocumentView(name="Summary", origin=f"/{SUMMARY}")


def plots(charts: Sequence[Chart], *, growing: bool = False) -> list[rrb.View]:
    """Return the viewer's views of charts, whose lines `record_chart` records.

    Args:
        charts: charts to show; those without a key are omitted.
        growing: True if more data will follow, so that axes adapt and do not keep the range of each chart.
    """
    return [
        rrb.TimeSeriesView(
            name=chart.named,
            origin=f"/{PLOTS}/{chart.key}",
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
            axis_y=rrb.ScalarAxis(range=None if growing else chart.range),
        )
        for chart in charts
        if chart.key
    ]


def write_recording(view: RunView, path: Path) -> None:
    """Write a run or a reference as a recording for the Rerun viewer, with its layout.

    Args:
        view: run or reference.
        path: file, `*.rrd`.

    Raises:
        InputError: the recording cannot be written.
    """
    sheets = [Sheet.around(plane(view, arm)) for arm in range(view.arms)]
    with recording_to(path, view.title, blueprint(view, sheets), _summary(view)) as recording:
        record_strips(recording, "", strips(view), view)
        for chart in (*motion_charts(view), *check_charts(view), *extra_charts(view)):
            record_chart(recording, chart, view)
        record_planes(recording, PLANES, view, sheets)
        draw_pendulum(recording, SCENE, view)
        record_events(recording, view)


@contextmanager
def recording_to(path: Path, name: str, view: rrb.Blueprint, summary: str) -> Iterator[rr.RecordingStream]:
    """Yield a recording with blueprint and summary, which becomes a file if the block ends without an error.

    Args:
        path: file, `*.rrd`.
        name: name of the recording.
        view: blueprint.
        summary: text in Markdown.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(Path(path), suffix=".rrd") as temporary:
        recording = rr.RecordingStream("dpcontrol", send_properties=True)
        # The recording stays in memory until it is complete, because the viewer's writer can hang on a full disk.
        memory = recording.memory_recording()
        recording.send_blueprint(view, make_active=False)
        recording.send_recording_name(name)
        recording.log(SUMMARY, rr.TextDocument(summary, media_type="text/markdown"), static=True)
        yield recording
        recording.flush()
        temporary.write_bytes(memory.drain_as_bytes())


def record_events(recording: rr.RecordingStream, view: RunView) -> None:
    """Record a run's events as lines of a text log with their times.

    Args:
        recording: recording to extend.
        view: run with the events.
    """
    if view.events:
        texts, levels = zip(*((f"[{e.name}] {e.text}", e.level.upper()) for e in view.events), strict=True)
        index = rr.TimeColumn(TIMELINE, duration=[event.time for event in view.events])
        recording.send_columns("rosout", indexes=[index], columns=rr.TextLog.columns(text=texts, level=levels))


def _summary(view: RunView) -> str:
    """Return the text beside a recording in Markdown: verdict, explanation of the phase planes, and metadata."""
    lines = [f"**{view.verdict}**" if view.verdict else "", ""]
    if view.plan.orbits:
        curve_name = "the reference" if view.what == "reference" else "the run"
        lines += [
            "",
            f"Phase planes, rad/s over rad: orbits thick, tubes from them red and to them green, {curve_name} black.",
        ]
    lines += ["", f"{view.title} ({view.path.name})", "", "| | |", "|---|---|"]
    # Long values, such as settings in JSON, would push everything out of sight.
    lines += [f"| {key} | {value} |" for key, value in view.metadata.items() if value and len(value) < 60]
    return "\n".join(lines)
