"""Pages on many runs: a campaign, a long run, and the forecast of a preflight.

The page of a campaign shows the shares of completed runs, and where and why the others failed.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dpcontrol.foundation.causes import Cause
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.statistics import wilson
from dpcontrol.foundation.units import prefixed
from dpcontrol.judge.campaign import CampaignSummary, Group
from dpcontrol.judge.night import BETWEEN, BRAKING, FLYING, ITINERARY, STOPPED, UNKNOWN, Night
from dpcontrol.judge.preflight import HazardBorder, Preflight
from dpcontrol.logs import read_log
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, Panel
from dpcontrol.pages.panels import Bar, bars, name_curves, readable_ticks
from dpcontrol.words.runs import conditions, conditions_of

_MOST, _APART = 28, 6
"""Most bars, and most mismatches that are drawn as separate bars."""
_SYMBOLS = 8
"""Most bars of failures by symbol."""


def draw_campaign(summary: CampaignSummary) -> Figure:
    """Return the page of a campaign, many runs of an itinerary with different seeds, as a figure.

    It shows the shares of completed runs by group and by level of trouble, and where and why the others failed.
    """
    page = Page(f"Campaign {summary.path.stem}", summary.status, summary.good)
    if record := summary.record:
        shared_conditions = conditions([*record["cases"].values()], simulated=True)
        page.origin(summary.path, f"model {record['model']}", shared_conditions, f"dpcontrol {record['version']}")
    bar_count = min(len(_bars_of(summary)), _MOST)
    upper_panels: list[Panel] = [Panel(partial(draw_groups, summary=summary), 1.3)]
    if summary.levels:
        upper_panels.append(Panel(partial(_draw_levels, summary=summary)))
    page.row(*upper_panels, height=max(2.6, 0.8 + 0.21 * bar_count))
    if summary.failed_symbols or summary.reasons:
        lower_panels = [
            Panel(partial(_draw_symbols, summary=summary)),
            Panel(partial(_draw_reasons, summary=summary), 1.3),
        ]
        page.row(*lower_panels, height=2.4)
    return page.figure()


def _group_colours(summary: CampaignSummary, labels: Sequence[str]) -> list[str]:
    """Return a colour for each of the labels; one family of groups has the same colour on the whole page.

    Args:
        summary: campaign with the groups.
        labels: families of groups, such as a controller and an estimator.
    """
    families = list(dict.fromkeys(group.family for group in summary.groups))
    return [style.RUNS[families.index(label) % len(style.RUNS)] for label in labels]


def _bars_of(summary: CampaignSummary) -> list[tuple[Group, str]]:
    """Return the groups of runs to draw as bars, with their labels.

    If the campaign varies the mismatch over a few values, each value has a bar; otherwise the groups have one each.
    """
    families = {level.label for level in summary.levels}
    if summary.axis == "mismatch" and 0 < len(summary.levels) <= _APART * len(families):
        return [(level, f"{level.label} · mismatch {level.low:.3g}") for level in summary.levels]
    # Controllers of one kind of trouble are adjacent.
    groups = sorted(summary.groups, key=lambda group: (group.names.get("kind", ""), -group.share.rate))
    return [(group, group.label) for group in groups]


def draw_groups(axes: Axes, summary: CampaignSummary) -> None:
    """Draw the shares of completed runs of each group, with their 95 % intervals.

    Args:
        axes: panel to draw on.
        summary: campaign with the groups.
    """
    all_bars = _bars_of(summary)
    drawn_bars = all_bars[:_MOST]
    remark = f"… and {len(all_bars) - len(drawn_bars)} groups more" if len(all_bars) > len(drawn_bars) else ""
    colours = _group_colours(summary, [group.family for group, _ in drawn_bars])
    rows = [
        Bar(label, g.share.rate, colour, (g.share.low, g.share.high), f"{g.share.successes} of {g.share.runs}")
        for (g, label), colour in zip(drawn_bars, colours, strict=True)
    ]
    bars(axes, "Runs completed; lines: Wilson's 95 % interval", rows, x=remark)
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def _draw_levels(axes: Axes, summary: CampaignSummary) -> None:
    """Draw the shares of completed runs over the level of trouble or over the mismatch, a curve for each group.

    `summary.axis` selects the abscissa, "level" or "mismatch". A point stands in the middle of a range of levels.

    Args:
        axes: panel to draw on.
        summary: campaign with levels.
    """
    by_level = summary.axis == "level"
    axis_label = "level of each kind of trouble" if by_level else "mismatch, share of each parameter"
    abscissa = "over the level, of all kinds" if by_level else "over the mismatch"
    labels = list(dict.fromkeys(level.label for level in summary.levels))
    drawn_labels = labels[: len(style.RUNS)]
    remark = f"; first {len(drawn_labels)} of {len(labels)} groups" if len(labels) > len(drawn_labels) else ""
    axes.set(title=f"Runs completed {abscissa}{remark}", xlabel=axis_label, ylim=(-0.03, 1.03))
    names: list[tuple[float, str, str]] = []
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    reach = max(level.high for level in summary.levels) - min(level.low for level in summary.levels)
    for k, (label, colour) in enumerate(zip(drawn_labels, _group_colours(summary, drawn_labels), strict=True)):
        levels = [level for level in summary.levels if level.label == label]
        # Groups are offset slightly, so that their intervals do not overlap.
        x = np.array([(level.low + level.high) / 2 for level in levels]) + 0.006 * reach * (k - len(drawn_labels) / 2)
        low, rates, high = np.array([(level.share.low, level.share.rate, level.share.high) for level in levels]).T
        spread = np.maximum([rates - low, high - rates], 0)
        axes.errorbar(x, rates, yerr=spread, color=colour, marker="o", markersize=4.5, linewidth=1.3, capsize=2)
        names.append((float(rates[-1]), shorten(label, 24, placeholder=" …"), colour))
    if by_level:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    if len(labels) > 1:
        name_curves(axes, names)


def _draw_symbols(axes: Axes, summary: CampaignSummary) -> None:
    """Draw the numbers of failed runs by the symbol that was not done, the most frequent at the top.

    `summary.failed_symbols` has a group's name, the number of the symbol from 1, or 0 if it is unknown, and the number
    of runs that failed at it.
    """
    failed = sorted(summary.failed_symbols, key=lambda failure: -failure[2])[:_SYMBOLS]
    colours = _group_colours(summary, [label for label, _, _ in failed])
    rows = [
        Bar(f"{label}, {f'symbol {symbol}' if symbol else 'not named'}".removeprefix(", "), count, colour)
        for (label, symbol, count), colour in zip(failed, colours, strict=True)
    ]
    bars(axes, "Failed runs by the symbol that was not done; beyond the last: not held to the end", rows)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_reasons(axes: Axes, summary: CampaignSummary) -> None:
    """Draw the numbers of failed runs by cause; beyond six causes the others are counted together."""
    other_count = sum(count for _, count in summary.reasons[6:])
    counts = [*summary.reasons[:6], *([("other reasons", other_count)] if other_count else [])]
    bars(axes, "Failed runs by cause", [Bar(text, count, style.LIMIT) for text, count in counts])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


_COLOURS = {
    ITINERARY: style.MODES["holding"],
    BRAKING: style.MODES["saturated"],
    FLYING: style.MODES["pulsing"],
    BETWEEN: style.MODES["tracking"],
    UNKNOWN: style.INK,
    STOPPED: style.PAPER,
}
"""Colours of a night's activities in the strip."""
_ROW = 1800.0
"""Duration of a row of the strip, s, short enough to show absences of seconds; longer in long nights."""
_ROWS = 32
"""Greatest number of rows of the strip."""
_REMAINDER = 5.0
"""Time at the end of a night, s, that gets no separate row, for example while the cart is braked."""


def draw_night(night: Night) -> Figure:
    """Return the page of a night: a run of hours that repeats its itinerary and returns to it after falls.

    It shows the activities as rows of a strip, the time of each, the falls by cause, the times until the itinerary was
    joined again, and the drift of estimated parameters.
    """
    duration = max(span.end for span in night.spans)
    # Short nights have one row or rows of ten minutes; in long ones a row lasts a multiple of half an hour.
    row_duration = (
        duration
        if duration <= 600.0 + _REMAINDER
        else 600.0
        if duration <= 3600.0
        else _ROW * math.ceil(duration / _ROW / _ROWS)
    )
    rows = max(1, math.ceil((duration - _REMAINDER) / row_duration))
    drifts = {
        "Encoder zeros": [name for name in night.estimated if name.startswith("zero_")],
        "Other parameters": [name for name in night.estimated if not name.startswith("zero_")],
    }
    page = Page(night.folder.name, night.sentence).origin(night.folder, *_conditions(night))
    page.row(partial(_draw_strip, night=night, row=row_duration, rows=rows), height=1.0 + 0.36 * rows)
    panels = [partial(_draw_times, night=night), Panel(partial(draw_causes, night=night), 1.1)]
    page.row(*panels, *([partial(_draw_returns, night=night)] if len(night.returns) else []), height=2.1)
    drift_panels = [
        partial(_draw_drift, night=night, what=what, names=names) for what, names in drifts.items() if names
    ]
    return page.row(*drift_panels, height=2.3).figure()


def _conditions(night: Night) -> tuple[str, ...]:
    """Return the conditions of a night (model, bench, program), from its last log that can be read."""
    for log in sorted(night.folder.glob("*.mcap"), reverse=True):
        with suppress(InputError):
            return conditions_of(read_log(log).metadata)
    return ()


_FALLS: dict[str, str] = {
    Cause.TRACKING_LOST: style.LIMIT,
    Cause.FALLEN: style.LIMIT,
    Cause.TOO_FAST: style.LIMIT,
    Cause.NOT_HELD: style.LIMIT,
    Cause.ESTIMATE_LOST: style.ESTIMATE,
    Cause.CART: style.SERIES[5],
    Cause.SWITCH: style.SERIES[5],
    Cause.STUCK: style.SERIES[0],
    Cause.SILENT: style.SERIES[2],
}
"""Colours of falls by cause."""


def _draw_strip(axes: Axes, night: Night, row: float, rows: int) -> None:
    """Draw what the rig did in a night, as rows of equal duration below one another, with the falls as triangles.

    At the right of each row is the share of its recorded time on the itinerary.

    Args:
        axes: panel to draw on.
        night: night with spans of activities and falls.
        row: duration of a row, s.
        rows: number of rows.
    """
    for k in range(rows):
        begin, recorded, on_itinerary = k * row, 0.0, 0.0
        for span in night.spans:
            span_begin, span_end = max(span.first, begin), min(span.end, begin + row)
            if span_end <= span_begin:
                continue
            # The edge keeps short absences visible.
            edge = 0.0 if span.kind in (ITINERARY, STOPPED) else 0.8
            look = {"facecolor": _COLOURS[span.kind], "edgecolor": _COLOURS[span.kind], "linewidth": edge}
            axes.broken_barh([((span_begin - begin) / 60, (span_end - span_begin) / 60)], (k - 0.39, 0.78), **look)
            recorded += (span_end - span_begin) * (span.kind != UNKNOWN)
            on_itinerary += (span_end - span_begin) * (span.kind == ITINERARY)
        text = f"{on_itinerary / recorded:.0%}" if recorded else ""
        axes.text(1.008, k, text, transform=axes.get_yaxis_transform(), va="center", fontsize=style.SMALL)
    for fall in night.falls:
        k = min(int(fall.time / row), rows - 1)
        look = {"color": _FALLS.get(fall.cause, style.INK), "markersize": 4.5, "clip_on": False}
        axes.plot((fall.time - k * row) / 60, k - 0.42, "v", **look)
    minutes = [round(k * row / 60) for k in range(rows)]
    axes.set(
        title="Rows of up to half an hour, with the share on the itinerary; triangles are falls",
        xlabel="minutes",
        xlim=(0, row / 60),
        ylim=(rows - 0.5, -0.65),
        yticks=range(rows),
        yticklabels=[f"{m // 60}:{m % 60:02d} h" if row >= _ROW else f"{m} min" for m in minutes],
    )


def _draw_times(axes: Axes, night: Night) -> None:
    """Draw the total time of each activity in a night, in minutes or hours."""
    times = {kind: sum(s.end - s.first for s in night.spans if s.kind == kind) for kind in _COLOURS if kind != STOPPED}
    times = {kind: time for kind, time in times.items() if time}
    scale, unit = (1 / 3600, "hours") if max(times.values(), default=0.0) > 3600 else (1 / 60, "minutes")
    rows = [Bar(kind, scale * time, _COLOURS[kind]) for kind, time in times.items()]
    bars(axes, f"Time by activity ({unit}), in the strip's colours", rows)


def _draw_returns(axes: Axes, night: Night) -> None:
    """Draw the distribution of the times from a fall back onto the itinerary, s."""
    returns = night.returns
    median, percentile_99 = np.quantile(returns, (0.5, 0.99))
    times = f"s; median {median:.1f}, 99 % within {percentile_99:.1f}"
    axes.ecdf(returns, color=style.ARMS[0])
    axes.set(title="Time from the fall back onto the itinerary", xlabel=times, ylabel="share of falls within")
    axes.set(xlim=(0, 1.3 * max(returns)), ylim=(0, 1.08))


def draw_causes(axes: Axes, night: Night) -> None:
    """Draw the numbers of falls of a night by cause.

    Args:
        axes: panel to draw on.
        night: night with the falls.
    """
    rows = [Bar(cause, count, _FALLS.get(cause, style.INK)) for cause, count in night.causes.items()]
    bars(axes, "Falls by cause, in the triangles' colours", rows)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_drift(axes: Axes, night: Night, what: str, names: Sequence[str]) -> None:
    """Draw the changes of estimated parameters since the first file of a night, a curve for each.

    Args:
        axes: panel to draw on.
        night: night with the estimates.
        what: title of the panel, such as "Encoder zeros".
        names: parameters, all angles or all shares.
    """
    courses = [night.course(name) for name in names]
    are_angles = names[0].startswith("zero_")
    largest = max(float(np.abs(values - values[0]).max()) for _, values in courses)
    scale, unit = prefixed(largest, "rad") if are_angles else (100.0, "%")
    axes.set(title=f"{what}, change since the first file ({unit})", xlabel="hours")
    curve_names: list[tuple[float, str, str, str]] = []
    for k, (name, (hours, values)) in enumerate(zip(names, courses, strict=True)):
        colour = style.RUNS[k % len(style.RUNS)]
        change = scale * (values - values[0])
        dashes = ("-", "--", ":")[k // len(style.RUNS) % 3]
        axes.plot(hours, change, dashes, color=colour, marker="o", markersize=2.5, linewidth=1.1)
        curve_names.append((float(change[-1]), name, colour, dashes))
    name_curves(axes, curve_names)


_WIDTH = 8.27
"""A4 in portrait, inches."""
_COLUMNS = 4
"""Panels of borders in a row."""


def draw_preflight(preflight: Preflight) -> Figure:
    """Return the page of a preflight, the forecast of the first run on a rig, as a figure.

    It shows the bench as described, the endings of simulated runs that failed, the border of each trouble at which half
    as many runs complete, and the gains by changes of the settings.
    """
    page = Page(f"Before the first run: {preflight.itinerary}", preflight.status, preflight.likely, width=_WIDTH)
    page.text(preflight.advice, colour=style.INK, size=style.TEXT)
    shortened = partial(shorten, placeholder=" …")
    page.text(f"The bench as described, model {preflight.model}", colour=style.INK, size=style.HEAD).table(
        [(fact.name, shortened(fact.value, 30), shortened(fact.source, 48)) for fact in preflight.known]
    )
    runs, endings = preflight.share.runs, preflight.endings[:_REASONS]
    rows = [
        (f"{ending.runs / runs:.1%}", shortened(ending.cause, 24), shortened(ending.example, 64)) for ending in endings
    ]
    page.text("Endings of failed runs, share of all runs", colour=style.INK, size=style.HEAD).table(
        rows or [("", "none: every run completed", "")]
    )
    if preflight.borders:
        title = "Borders: half as many runs complete as on the bench as described"
        panels = [partial(_border, border=border) for border in preflight.borders]
        page.text(title, colour=style.INK, size=style.HEAD).grid(panels, across=_COLUMNS, height=1.55).text(
            "Dots: share of completed runs, relative to the bench as described; to the right it gets worse. Dashed "
            "green: the bench as described. Red: border with its 95 % interval."
        )
    if preflight.changes:
        page.row(partial(_changes, preflight=preflight), height=0.75 + 0.19 * len(preflight.changes))
    else:
        page.text("No change was tried, because no run failed or none was compared.")
    for note in preflight.notes:
        page.text(f"Mind: {note}")
    for caution in preflight.warnings:
        page.text(f"Caution: {caution.status}: {caution.remedy}")
    return page.figure()


_REASONS = 5
"""Greatest number of listed endings."""


def _border(axes: Axes, border: HazardBorder) -> None:
    """Draw how the share of completed runs falls when one property of the bench gets worse, and where it is halved.

    Shares are relative to the runs that complete on the bench as described, on the same seeds. The border is the value
    at which half of these still complete.

    Args:
        axes: panel to draw on.
        border: tried values of the property, the shares of completed runs, and the border with its interval.
    """
    margin = "" if border.margin is None else f" ({border.margin:.1f}×)"
    set_value = border.set if border.set and math.isfinite(border.set) else None
    values = [point.value for point in border.points]
    for point in border.points:
        band = wilson(min(point.completed, point.reference), point.reference)
        axes.plot([point.value] * 2, [band.low, band.high], color=style.CART, linewidth=0.9, alpha=0.6)
        axes.plot(point.value, min(point.share, 1.0), "o", color=style.INK, markersize=3)
    if set_value is not None:
        axes.axvline(set_value, color=style.GOOD, linewidth=1.2, linestyle=style.DASHED)
        values.append(set_value)
    if border.border is not None:
        # An end of the interval that is not known is replaced by the border itself.
        axes.axvspan(border.low or border.border, border.high or border.border, color=style.LIMIT, alpha=0.15)
        axes.axvline(border.border, color=style.LIMIT, linewidth=1.2)
    axes.axhline(0.5, color=style.MARK, linewidth=0.7, linestyle=style.DASHED)
    axes.set(
        title=f"{border.name}: {border.sentence}{margin}",
        xlabel=border.unit,
        xscale="log",
        xlim=(min(values) / 1.3, max(values) * 1.3),
        ylim=(-0.03, 1.06),
        yticks=[0, 0.5, 1],
    )
    readable_ticks(axes.xaxis, "")
    if border.falling:
        axes.invert_xaxis()
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _changes(axes: Axes, preflight: Preflight) -> None:
    """Draw the gain of each tried change of the settings, in percent of all runs, with two standard errors.

    A gain is the increase of the share of completed runs by the change. One that exceeds two standard errors is green.
    """
    rows = [
        Bar(change.text, gain, style.GOOD if gain > two_errors else style.FAINT, (gain - two_errors, gain + two_errors))
        for change, gain, two_errors in (
            (change, 100 * change.gain, 200 * change.error) for change in preflight.changes
        )
    ]
    bars(axes, "Gain of each change, on the same seeds; lines: two standard errors", rows, x="points of all runs")
    axes.axvline(0, color=style.MARK, linewidth=0.8)


def whole_preflight(axes: Axes, preflight: Preflight) -> None:
    """Draw the shares of completed runs and of each other ending.

    Args:
        axes: panel to draw on.
        preflight: preflight to draw.
    """
    rows = [Bar("completed", preflight.share.rate, style.GOOD)]
    rows += [Bar(ending.cause, ending.runs / preflight.share.runs, style.LIMIT) for ending in preflight.endings]
    bars(axes, preflight.status, rows, x="share of runs that end so")
