"""Decode the completed part of a plan from the arms' angles.

The part consists of stops, symbols and wraps.

A plan gives the time, the angles and the direction of each symbol's section crossing. The decoder searches the run for
the same crossings in sequence. They relate the run's clock to the plan's: at each tick the nearest crossing gives the
offset, so a longer or shorter stay does not disturb later symbols. On that clock the run must stay close to the plan:

    min over |s| ≤ w of max over arms |θ(t) - θ*(τ(t) + s)| ≤ 1.5 rad            τ: the plan's time at run time t

Angles are not wrapped, so a missing turn, a turn the wrong way, a left-out symbol and another saddle are all at least
half a turn off. The window w is a quarter of the shortest period: a run may be early or late by less than a wrap. The
wait at rest before a first transfer is not judged. A stop counts once the run is halfway through it, or half a period
after its arrival, whichever comes first.

Wraps are counted from the times between two crossings, because small orbits are hard to detect:

    N = N* + round((Δt - Δt*) / T)            N*, Δt*: of the plan; T: the period of the stop's orbit

A threshold on the time nearest to a saddle is not enough. At H = 0.2 the orbit about Down-Up swings the inner arm by
1.8 rad, so other saddles are nearer for much of each period.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import ShortfallCause
from dpcontrol.references.content import REST_BEFORE, PlanContent, PlanStop, PlanSymbol
from dpcontrol.references.reference import Reference
from dpcontrol.words.searches import Concluded

FOLLOWS = 1.5
"""Greatest distance of a run from its plan, rad; half of the way to another saddle is π/2."""
_GRID = 0.01
"""Spacing of the plan's samples for the comparison with a run, s."""
_BESIDE = 5e-3
"""Interval on either side of a crossing that determines its direction in the plan, s."""


@dataclass(frozen=True)
class Visit:
    """A stay at a stop that a run has reached.

    Attributes:
        angles: the saddle's angles (n,), rad.
        first: first tick near them.
        last: last tick near them.
    """

    angles: tuple[float, ...]
    first: int
    last: int


@dataclass(frozen=True)
class Decoded:
    """The part of a plan that a run completed.

    Attributes:
        visits: the stops reached, in order.
        crossings: section crossing time of each symbol between them, s; None for a transfer.
        wraps: at each interior stop between two crossings, otherwise None.
        lost: first tick farther than `FOLLOWS` from the plan, or None.
    """

    visits: tuple[Visit, ...]
    crossings: tuple[float | None, ...]
    wraps: tuple[int | None, ...]
    lost: int | None

    @property
    def matched(self) -> int:
        """Number of stops reached."""
        return len(self.visits)


def judged_from(content: PlanContent) -> float:
    """Return the plan's time from which a run must follow it, s.

    The planner adds a wait at rest before the first transfer. The itinerary does not require it, so the arms may be
    anywhere until the transfer begins.

    Args:
        content: content of the plan.
    """
    begin = min((begin for begin, _ in content.transfers), default=np.inf)
    return begin if begin <= REST_BEFORE + _GRID and content.stops[0].saddle == content.rest else 0.0


def shortest_period(content: PlanContent) -> float:
    """Return the shortest period of a plan's orbits, s, by which the tolerance of a run's timing is measured.

    Args:
        content: content of the plan.
    """
    return min(orbit.period for orbit in content.orbits)


def decode_run(time: Array, angles: Array, plan: Reference) -> Decoded:
    """Decode the part of a plan that a run has completed: stops, crossings, wraps, and the tick at which it was lost.

    A symbol is a motion between two stops, at which the plan stays on an orbit or equilibrium. Crossings of the
    symbols' sections relate the plan's times to the run's. A stop counts if the run is on the plan until half a period
    after the arrival at its orbit, or until the middle of the stay if that is earlier.

    Args:
        time: times (K,), s; the first one is on the plan's clock.
        angles: angles (K, n), rad, not wrapped.
        plan: reference of the plan.
    """
    content = plan.content
    due_times = _due(plan, angles.shape[1])
    crossings = _crossings(time, angles, plan, due_times, carries=True)
    clock = _plan_time(time, due_times, crossings)
    lost_tick = _lost(angles, clock, plan)
    stop_spans, arrivals = _spans(content, due_times, plan.duration)
    half_period = shortest_period(content) / 2
    visits: list[Visit] = []
    for stop, (begin, end), arrival in zip(content.stops, stop_spans, arrivals, strict=True):
        halfway_tick = int(np.searchsorted(clock, min(arrival + half_period, (begin + end) / 2)))
        if halfway_tick >= len(clock) or (lost_tick is not None and halfway_tick > lost_tick):
            break
        ticks_at_stop = np.flatnonzero((clock >= begin) & (clock <= end))
        if not ticks_at_stop.size:
            # Crossings far from their due times can move the clock past a whole stop.
            break
        visits.append(_visit(angles, ticks_at_stop, stop, content))
    crossings = crossings[: max(0, len(visits) - 1)]
    return Decoded(tuple(visits), crossings, _wraps(crossings, due_times, content), lost_tick)


def stays(plan: Reference) -> tuple[tuple[float, float], ...]:
    """Return begin and end of the reference's stay at each stop, s, where flights may join the itinerary.

    Args:
        plan: reference of the plan.
    """
    times = np.arange(0.0, plan.duration, _GRID)
    angles = plan.state(plan.mesh[0] + times)[:, : len(plan.content.stops[0].angles)]
    return tuple((visit.first * _GRID, visit.last * _GRID) for visit in decode_run(times, angles, plan).visits)


def _due(plan: Reference, arms: int) -> list[float]:
    """Return the time at which the reference crosses the section of each symbol, s; for a transfer, its middle.

    A run should cross at these times. The time stored with a symbol is that of the shadowed orbit, not of the
    reference.

    Args:
        plan: reference of the plan.
        arms: number of arms.
    """
    times = np.arange(0.0, plan.duration, _GRID)
    stored_times = [symbol.time for symbol in plan.content.symbols]
    crossings = _crossings(times, plan.state(plan.mesh[0] + times)[:, :arms], plan, stored_times, carries=False)
    return [
        crossing_time if crossing_time is not None else time
        for crossing_time, time in zip(crossings, stored_times, strict=True)
    ]


def _crossings(
    time: Array, angles: Array, plan: Reference, planned: Sequence[float], *, carries: bool
) -> tuple[float | None, ...]:
    """Return the time at which a motion crosses the section of each symbol, s, to relate its clock to the plan's.

    Without a crossing, it is the due time, or the crossing before if that is later. A transfer has no section, so its
    entry is None.

    Args:
        time: times (K,), s.
        angles: angles (K, n), rad.
        plan: reference of the plan.
        planned: due times on the plan's clock, s.
        carries: True if a delay also delays the following symbols.
    """
    crossings: list[float | None] = []
    last_crossing, delay = float(time[0]), 0.0
    for symbol, planned_time in zip(plan.content.symbols, planned, strict=True):
        due = planned_time + delay
        if symbol.section is not None:
            crossed_at = crossing(time, angles, symbol, plan, between=(last_crossing, due))
            last_crossing = max(due, last_crossing) if crossed_at is None else crossed_at
            delay = last_crossing - planned_time if carries else 0.0
        crossings.append(None if symbol.section is None else last_crossing)
    return tuple(crossings)


def crossing(
    time: Array, angles: Array, symbol: PlanSymbol, plan: Reference, *, between: tuple[float, float]
) -> float | None:
    """Return the time at which a motion crosses a symbol's section with the plan's direction and angles, or None, s.

    The time is interpolated between two ticks. The angles at the crossing must be within `FOLLOWS` rad of the plan's.

    Args:
        time: times (K,), s.
        angles: angles (K, n), rad.
        symbol: a connection of the plan.
        plan: reference of the plan.
        between: earliest and due time of the crossing; that nearest to the due time is returned, s.
    """
    section, n = symbol.section, angles.shape[1]
    assert section is not None
    earliest, due = between
    normal = np.asarray(section.normal[:n])
    ahead, behind = (plan.state(plan.mesh[0] + symbol.time + side)[:n] for side in (_BESIDE, -_BESIDE))
    # Signed so that the plan crosses upwards.
    height = (angles @ normal - section.value) * (1.0 if (ahead - behind) @ normal > 0 else -1.0)
    rows = np.flatnonzero((height[:-1] <= 0) & (height[1:] > 0) & (time[:-1] >= earliest))
    rows = rows[np.abs(angles[rows] - section.angles).max(axis=1) <= FOLLOWS]
    if not rows.size:
        return None
    row = rows[np.argmin(np.abs(time[rows] - due))]
    fraction = height[row] / (height[row] - height[row + 1])
    return float(time[row] + fraction * (time[row + 1] - time[row]))


def _plan_time(time: Array, due: Sequence[float], crossings: tuple[float | None, ...]) -> Array:
    """Return the plan's time (K,) at each tick, s, shifted by the offset of the nearest crossing.

    At the start the offset is zero. So a stay that lasts longer than planned does not disturb the symbols after it.

    Args:
        time: times (K,) of the run, s.
        due: due times of the crossings, s.
        crossings: their times in the run, s, None for transfers.
    """
    anchors, offsets = [float(time[0])], [0.0]
    for crossed_at, due_time in zip(crossings, due, strict=True):
        if crossed_at is not None:
            anchors.append(crossed_at)
            offsets.append(crossed_at - due_time)
    middles = [(anchor + next_anchor) / 2 for anchor, next_anchor in pairwise(anchors)]
    return np.asarray(time - np.asarray(offsets)[np.searchsorted(middles, time)])


def _lost(angles: Array, clock: Array, plan: Reference) -> int | None:
    """Return the first tick at which the angles differ from the plan by more than `FOLLOWS` rad, or None.

    From this tick on, no symbol counts. The nearest time of the plan within a window counts, because a run may be early
    or late by less than a wrap, one period of a stop's orbit.

    Args:
        angles: angles (K, n), rad.
        clock: the plan's time (K,) at each tick, s.
        plan: reference of the plan.
    """
    content, n = plan.content, angles.shape[1]
    planned_angles = plan.state(plan.mesh[0] + np.arange(0.0, plan.duration + _GRID, _GRID).clip(max=plan.duration))[
        :, :n
    ]
    # A sustained orbit has the plant's period, so any phase of it may match.
    has_kept_stops = content.segments or not content.symbols
    window = max(orbit.period for orbit in content.orbits) / 2 if has_kept_stops else shortest_period(content) / 4
    most_offset = int(np.ceil(window / _GRID))
    # After the plan's end a run may continue around the last orbit, period by period.
    last_period = _period(content, -1)
    planned_angles = np.concatenate([planned_angles, planned_angles[-round(last_period / _GRID) :]])
    clock = clock - np.ceil((clock - plan.duration).clip(min=0.0) / last_period) * last_period
    planned_rows = np.rint(clock / _GRID).astype(np.intp)

    def distances(far_rows: NDArray[np.intp], offset: int) -> Array:
        """Return the largest angle difference (M,) of ticks `far_rows` (M,) from the plan, rad.

        They are compared with the plan's sample at their time on its clock, and `offset` samples later.
        """
        return np.asarray(
            np.abs(
                angles[far_rows] - planned_angles[(planned_rows[far_rows] + offset).clip(0, len(planned_angles) - 1)]
            ).max(axis=1)
        )

    # Not-a-number counts as far.
    far_rows = np.flatnonzero(clock >= judged_from(content))
    # Small offsets first: they match most ticks, which larger ones then skip.
    for offset in sorted(range(-most_offset, most_offset + 1), key=abs):
        far_rows = far_rows[~(distances(far_rows, offset) <= FOLLOWS)]
        if not far_rows.size:
            return None
    return int(far_rows[0])


def _spans(
    content: PlanContent, due: Sequence[float], duration: float
) -> tuple[list[tuple[float, float]], list[float]]:
    """Return the plan's time range at each stop, s, and the time of arrival at each stop's orbit, s.

    Ranges end at the crossings of sections and exclude transfers, which are planned motions without a section.

    Args:
        content: content of the plan.
        due: time of each symbol in the plan, s.
        duration: duration of the plan, s.
    """
    begins, ends, arrivals = [0.0], [], [0.0]
    for symbol, due_time in zip(content.symbols, due, strict=True):
        transfers = content.transfers if symbol.section is None else ()
        begin, end = next(
            (
                (transfer_begin, transfer_end)
                for transfer_begin, transfer_end in transfers
                if transfer_begin <= due_time <= transfer_end
            ),
            (due_time, due_time),
        )
        ends.append(begin)
        begins.append(end)
        arrivals.append(end if symbol.section is None else due_time + symbol.time_in)
    return list(zip(begins, [*ends, duration], strict=True)), arrivals


def _visit(angles: Array, inside: NDArray[np.intp], stop: PlanStop, content: PlanContent) -> Visit:
    """Return the stay at a stop from the first to the last tick whose nearest saddle is that of the stop.

    The distances are those of the angles, to the other saddles modulo whole turns. Views show these stays. Without such
    a tick, the stay is the tick closest to the saddle.

    Args:
        angles: angles (K, n) of the run, rad.
        inside: ticks in the stop's time range.
        stop: the stop.
        content: content of the plan, with the other saddles.
    """
    stop_angles, saddle = angles[inside], stop.angles
    distances = np.square(stop_angles - saddle).sum(axis=1)
    saddles = [np.asarray(content.saddles[name].angles) for name in {other_stop.saddle for other_stop in content.stops}]
    nearest = np.min(
        [np.square((stop_angles - other + np.pi) % (2 * np.pi) - np.pi).sum(axis=1) for other in saddles], axis=0
    )
    near_ticks = inside[distances <= nearest + 1e-6]
    near_ticks = near_ticks if near_ticks.size else inside[[int(np.argmin(distances))]]
    return Visit(saddle, int(near_ticks[0]), int(near_ticks[-1]))


def _wraps(crossings: tuple[float | None, ...], due: Sequence[float], content: PlanContent) -> tuple[int | None, ...]:
    """Return the wraps at each interior stop reached: periods on its orbit, from the time between its crossings.

    They are the plan's, and a wrap more or less for each period by which the run takes longer or shorter. None stands
    for stops beside a transfer, and for stops that change the orbit.

    Args:
        crossings: crossing times of the completed symbols, s, None for transfers.
        due: their times in the plan, s.
        content: content of the plan.
    """
    counts: list[int | None] = []
    for k, (arrival, departure) in enumerate(pairwise(crossings)):
        planned = planned_wraps(content, k)
        if arrival is None or departure is None or planned is None:
            counts.append(None)
        else:
            extra_time = (departure - arrival) - (due[k + 1] - due[k])
            counts.append(round(planned) + round(extra_time / _period(content, k + 1)))
    return tuple(counts)


def _period(content: PlanContent, stop: int) -> float:
    """Return the period of the orbit at a stop, s, which is the length of a wrap; stop -1 is the last one."""
    return content.orbit(content.stops[stop]).period


def planned_wraps(content: PlanContent, stop: int) -> float | None:
    """Return the unrounded number of wraps, periods on the orbit of an interior stop, that the plan's times give.

    Times and phases of the connections before and after the stop give the time on its orbit.

    Args:
        content: content of the plan.
        stop: number of the interior stop, counted from 0.

    Returns:
        The wraps; None beside a transfer, and at stops that change the orbit.
    """
    arriving, leaving = content.symbols[stop : stop + 2]
    if arriving.section is None or leaving.section is None or content.stops[stop + 1].arrived_on is not None:
        return None
    if content.polished:
        # A plan's crossings already count its wraps, which need not last the orbit's period.
        return None if (required := content.wraps[stop]) is None else float(required)
    phase_gap = (leaving.phase_out - arriving.phase_in) % 1.0
    time_on_orbit = leaving.time - arriving.time - arriving.time_in - leaving.time_out
    return time_on_orbit / _period(content, stop + 1) - phase_gap


NEAR_LAST_ORBIT = 0.1
"""Largest distance of a completed run from its last orbit in the last period, rad."""
_DENSER = 8
"""Points on each chord between an orbit's samples for measuring the distance."""


def _leaves(orbit: Array, angles: Array, *, ticks: float) -> float:
    """Return the greatest distance of angles from a periodic orbit, rad, or 0 if it is at most `NEAR_LAST_ORBIT`.

    Args:
        orbit: angles (M, n) over one period, rad.
        angles: angles (K, n) of successive ticks, rad. If one is not finite, the distance is infinite.
        ticks: number of ticks in a period.
    """
    if not np.isfinite(angles).all():
        return np.inf
    # The point of equal phase is no nearer than the nearest one, and much faster to find.
    samples = max(len(orbit) - bool(np.abs(orbit[0] - orbit[-1]).max() < 1e-6), 1)
    first_phase = int(np.argmin(np.abs(orbit - angles[0]).max(axis=1)))
    phase_steps = np.rint(np.arange(len(angles)) * (samples / ticks)).astype(np.intp)
    late_angles = angles[np.abs(orbit[(first_phase + phase_steps) % samples] - angles).max(axis=1) > NEAR_LAST_ORBIT]
    far_angles = [point for point in late_angles if np.abs(orbit - point).max(axis=1).min() > NEAR_LAST_ORBIT]
    if not far_angles:
        return 0.0
    fraction = np.arange(_DENSER)[:, None, None] / _DENSER
    points = (orbit * (1 - fraction) + np.roll(orbit, -1, axis=0) * fraction).reshape(-1, orbit.shape[1])
    distance = max(float(np.abs(points - point).max(axis=1).min()) for point in far_angles)
    return distance if distance > NEAR_LAST_ORBIT else 0.0


def last_gap(time: Array, angles: Array, plan: Reference, *, rate_hz: float) -> float:
    """Return the distance of the last period from the last orbit, rad, by which a run's end is judged.

    At an equilibrium the last period is at most as long as the plan's stay there.

    Args:
        time: times (K,), s.
        angles: angles (K, n), rad.
        plan: reference of the plan.
        rate_hz: rate of the ticks, Hz.

    Returns:
        The distance, or 0 if it is small enough.
    """
    content, n = plan.content, angles.shape[1]
    stop = content.stops[-1]
    orbit = content.orbit(stop)
    begin = max([time[-1] - orbit.period, *(end for _, end in content.transfers if end < time[-1])])
    last_angles = angles[time >= begin] - content.lift(stop)
    return _leaves(orbit.curve[:, :n], last_angles, ticks=orbit.period * rate_hz)


_REACHES = 0.3
"""Greatest scaled distance of a visit from its orbit, rad. Visits without a wrap come within 0.03."""
_RATE_UNIT = 8.0
"""Rate that counts as 1 rad, rad/s: about the orbits' frequency, so the distance hardly depends on the phase."""
_COUNTED = 0.3
"""Tolerance of the wraps about a whole number."""
_SETTLED = 2
"""Wobbles at the end beyond which a reference comes no nearer to its last orbit."""


@dataclass(frozen=True)
class Shortfall(Concluded):
    """Reason for which an exact run of a reference would not be completed.

    Attributes:
        cause: the cause.
        content: content of the plan.
        stop: index of the stop, or the number of stops passed.
        gap: distance from its orbit, rad, or the number of wraps.
        allowed: largest allowed distance, rad.
        settled: True if a longer lead-out brings the reference no nearer.
    """

    cause: ShortfallCause
    content: PlanContent
    stop: int
    gap: float = 0.0
    allowed: float = NEAR_LAST_ORBIT
    settled: bool = False


def shortfall(plan: Reference) -> Shortfall | None:
    """Return the reason why even an exact run of the reference would fail, or None if it succeeds.

    A plan with such a reference counts as not converged.

    Args:
        plan: reference of the plan.
    """
    content = plan.content
    stops = content.stops
    times = np.arange(0.0, plan.duration, _GRID / 10)
    states = plan.state(plan.mesh[0] + times)
    angles = states[:, : len(stops[0].angles)]
    spans, _ = _spans(content, _due(plan, angles.shape[1]), plan.duration)
    # A polished plan need not approach the orbits.
    near_orbits = () if content.polished else enumerate(zip(stops, spans, strict=True))
    for k, (stop, (begin, end)) in near_orbits:
        distance = orbit_distance(states[(times >= begin) & (times <= end)][::10], stop, plan)
        if distance > _REACHES:
            return Shortfall(ShortfallCause.FAR if k else ShortfallCause.FIRST_FAR, content, k, distance)
    for k, required in enumerate(content.wraps):
        planned = planned_wraps(content, k)
        if planned is not None and required is not None and abs(planned - required) > _COUNTED:
            return Shortfall(ShortfallCause.WRAPS, content, k + 1, planned)
    if last_distance := last_gap(times, angles, plan, rate_hz=10 / _GRID):
        settled = content.lead_out >= _SETTLED
        return Shortfall(ShortfallCause.LAST_FAR, content, len(stops) - 1, last_distance, settled=settled)
    matched_stops = decode_run(times, angles, plan).matched
    return Shortfall(ShortfallCause.NOT_DECODED, content, matched_stops) if matched_stops < len(stops) else None


def orbit_distance(states: Array, stop: PlanStop, plan: Reference) -> float:
    """Return the least scaled distance between states and the orbit of a stop.

    The distance is the largest difference of a component; `_RATE_UNIT` rad/s count as 1 rad.

    Args:
        states: states (K, 2n+2).
        stop: a stop of the plan, on whose turns the orbit is taken.
        plan: reference of the plan.
    """
    n = len(stop.angles)
    curve = plan.content.orbit(stop).curve[:, : 2 * n] / np.repeat([1.0, _RATE_UNIT], n)
    scaled_states = states[:, : 2 * n] - np.pad(plan.content.lift(stop), (0, n))
    scaled_states /= np.repeat([1.0, _RATE_UNIT], n)
    return min((float(np.abs(curve - state).max(axis=1).min()) for state in scaled_states), default=np.inf)
