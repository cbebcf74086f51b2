"""A plan from rest to rest re-optimised as one problem, with the robust plan that it starts from beside it.

    minimise ∫ u² + w_x x² dt      subject to  the plan's dynamics, time and ends, and shares of the cart's limits

The parts of a plan are solved one by one, which costs several times the joint optimum. Here they are solved together.
Interior holds stay as they are, and so does the end of the final rest, by which runs are judged. The motion may use
`SHARE` of each limit, or as much as the robust plan: at the full track the supervisor ends every run.

Such programs have many minima, whose efforts differ by up to a third. Several searches start from the joined parts,
with different meshes and polynomials. The least costly motion that keeps the walk is refined.

A motion keeps the walk if it crosses the same sections as the robust plan, in the same order and direction and on the
same turns of each arm. It must also have the same number of wraps at each interior stop. The joint optimum can leave
the neighbourhood of the orbits: nearness is a property of the robust plan, which the user trades for less effort. If no
free motion keeps the walk, a weight holds the motion near the robust plan.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import groupby, pairwise
from typing import ClassVar

import numpy as np

from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.causes import DepartureCause, ReferenceCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress, part_of
from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.judge.decoding import crossing, orbit_distance, shortfall
from dpcontrol.orbits.lyapunov import resting_place
from dpcontrol.plans.pieces import STILL
from dpcontrol.plans.plan import Plan
from dpcontrol.plans.transfers import transfer_costs
from dpcontrol.references.content import PlanSymbol
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.find import find_reference, on_mesh, tail
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import PLANNING, EndConditions, Guess, Limits, ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference, joined, load_reference
from dpcontrol.references.trajectory import Trajectory, even_mesh
from dpcontrol.references.transcription import solve
from dpcontrol.runs.campaign import Case, Job
from dpcontrol.runs.preflight import outcomes, seconds_of
from dpcontrol.words.searches import Concluded

POLISHING = 1
"""Version of polishing, part of the cache keys: raise it whenever a polished plan changes."""
SHARE = 0.7
"""Share of each limit that the motion may use: 1 leaves no margin for feedback, 0.7 costs 2 to 3 % of effort."""


@dataclass(frozen=True)
class _JointSearch:
    """One search for the joint optimum.

    Attributes:
        method: name of the transcription.
        interval: length of the mesh intervals, s.
        weight: weight of the distance to the robust plan.
        iterations: limit of iterations.
        far: True if IPOPT adapts its barrier. Long motions need it. Short ones then may end in a more costly minimum.
    """

    method: str
    interval: float
    weight: float = 0.0
    iterations: int = 300
    far: bool = False


_SEARCHES = (
    _JointSearch("radau-7", 0.05), _JointSearch("radau-7", 0.05, far=True),
    _JointSearch("radau-5", 0.05, far=True), _JointSearch("radau-3", 0.02),
    _JointSearch("radau-5", 0.05, weight=1.0), _JointSearch("radau-5", 0.05, weight=10.0),
)  # fmt: skip
"""Tried in turn; those with a weight stay near the robust plan, at more effort."""
_HOLD = 10.0
"""Weight of the distance to the motion whose mesh is refined."""
CART_WEIGHT = 0.01
"""Weight w_x of the cart's squared position, 1/s⁴."""
MISMATCHES, RUNS = (0.05, 0.2), 48
"""Mismatches at which both plans are run, and the runs at each."""
_PACE, _AT_FIRST = 5.0, 10.0
"""Time of one processor for a second of motion, and before the first second, s."""
_LOOK = 1e-3
"""Time between the states whose crossings are counted, s."""


@dataclass(frozen=True)
class Side(Documented):
    """Effort, cart use and success rates of one plan.

    Attributes:
        effort: ∫u² dt, m²/s³.
        peak: largest acceleration, m/s².
        travel: to either side, m.
        nearest: largest of its scaled distances to the orbits.
        completed: share of runs by mismatch.
    """

    KEYS: ClassVar[str] = "name effort peak travel nearest completed:successes,runs,rate,low,high"

    name: str
    effort: float
    peak: float
    travel: float
    nearest: float
    completed: dict[float, Share]


@dataclass(frozen=True, repr=False)
class Polished(Documented):
    """A robust plan and the polished one with their figures.

    One side if the polished plan did not converge.

    Attributes:
        robust: plan part by part.
        polished: plan as one problem.
        sides: figures of the plans, the robust one first.
    """

    KEYS: ClassVar[str] = "sides plan=polished status"

    robust: Plan
    polished: Plan
    sides: tuple[Side, ...]

    @property
    def converged(self) -> bool:
        """True if there is a polished plan."""
        return self.polished.converged

    @property
    def status(self) -> str:
        """Method of the polished plan, or the reason for its absence."""
        return self.polished.status

    def __repr__(self) -> str:
        return f"<polished {self.robust.itinerary.name!r}: {self.status}>"


def polish(
    plan: Plan, *, fresh: bool = False, runs: int = RUNS, workers: int = 0, yes: bool = False,
    progress: Progress = no_progress,
) -> Polished:  # fmt: skip
    """Re-optimise the walk of a plan from rest to rest as a whole.

    Args:
        plan: robust plan.
        fresh: ignore the cache.
        runs: runs of each plan at each of the `MISMATCHES`.
        workers: processes, 0 for one per processor.
        yes: accept any duration.
        progress: receiver of progress reports.

    Raises:
        InputError: the plan is not from rest to rest, is already polished, or it would take too long.
        GoalMissed: the plan did not converge, or no controller can be made for it.
    """
    check_polishable(plan.followed())
    loop = plan.itinerary.loop
    seconds = plan.reference.duration
    run_seconds = 2 * len(MISMATCHES) * runs * seconds * loop.rate * seconds_of(loop) / (workers or processors())
    file = cache_file("plans", f"{plan.itinerary.name}-polished", _key(plan))
    content = None if fresh else kept(file)
    solution_seconds = _AT_FIRST + _PACE * seconds if content is None else 0.0
    announce(
        Cost(f"{seconds:.1f} s of motion as one", solution_seconds + run_seconds, 5e8, f"polish {plan.itinerary.name}"),
        yes=yes,
    )
    if content is not None:
        polished = Plan(plan.itinerary, load_reference(BytesIO(content)), file, cached=True)
    else:
        polished = Plan(plan.itinerary, _polished(plan, part_of(progress, 0.0, 0.8)), file, cached=False)
        if polished.converged:
            keep(file, polished.archive)
    named_plans = [("robust", plan)] + [("polished", polished)] * polished.converged
    return Polished(
        plan, polished, tuple(_sides(named_plans, runs, workers or processors(), part_of(progress, 0.8, 1.0)))
    )


def check_polishable(plan: Plan) -> None:
    """Raise an `InputError` unless a plan leads from rest to rest and is not polished already.

    Args:
        plan: plan to check.

    Raises:
        InputError: one of the two fails.
    """
    content, itinerary = plan.content, plan.itinerary
    resting_saddle = resting_place(itinerary.model.system)
    ends = [content.stops[k].saddle for k in (0, -1)]
    if content.polished:
        raise InputError(f"{itinerary.path} is polished already; polish the itinerary that it was made from")
    if (
        not content.symbols
        or ends != [resting_saddle, resting_saddle]
        or itinerary.start == "orbit"
        or content.segments
    ):
        raise InputError(
            f"{itinerary.path}: --polish needs a motion from rest to rest, and this one leads from {ends[0]} to "
            f"{ends[1]}; "
            'set start = "rest" and finish = "rest", or omit --polish'
        )


def _key(plan: Plan) -> str:
    """Return the hash of all inputs of polishing, by which a polished plan is found in the cache."""
    # Starts after a fall belong to the robust plan, and are not polished.
    motion = plan.reference
    arrays = [array.tobytes() for array in (motion.mesh, motion.states, motion.inputs)]
    settings = json.dumps([plan.itinerary.text, plan.itinerary.model.text, plan.itinerary.limits.named()])
    return content_hash(f"polishing {POLISHING}, planning {PLANNING}", settings, *arrays)


def _polished(plan: Plan, progress: Progress) -> Reference:
    """Return the polished reference of a plan, or the robust one with the reason in its status.

    A plan consists of moving parts, which are polished, and of rests, which stay. Each moving part has several
    candidates, the least costly first. The k-th candidates of all parts are refined and joined, for rising k, until
    the motion keeps the walk and would be completed. If a part has no k-th candidate, the robust plan is returned.
    """
    robust, no_turns = plan.reference, np.zeros(plan.itinerary.model.arms.count)
    time_ranges = list(stretches(robust))
    parts = [tail(robust, begin, seconds=end - begin, turns=no_turns) for begin, end, _ in time_ranges]
    moving_parts = [k for k, span in enumerate(time_ranges) if span[2]]
    candidates: dict[int, list[Trajectory]] = {}
    for count, k in enumerate(moving_parts):
        part_progress = part_of(progress, 0.8 * count / len(moving_parts), 0.8 * (count + 1) / len(moving_parts))
        candidates[k] = _searched(_problem(plan, parts[k]), parts[k], plan.itinerary.reference, part_progress)
    # The least costly motions of all parts are tried first, then the second best of all. `reason` is the obstacle of
    # the last attempt, None for a motion that has passed all checks so far.
    reason: Concluded | None = None
    for rank in range(min(map(len, candidates.values()), default=1)):
        progress("refining", 0.8)
        pieces = [
            _refined(plan, part, candidates[k][rank]) if k in candidates else part for k, part in enumerate(parts)
        ]
        motion = joined(pieces)[0]
        reason = departure(robust, motion) if motion.converged else motion.ending
        if reason is None:
            motion = _noted(plan, motion)
            reason = shortfall(motion)
        if reason is None:
            progress("polished", 1.0)
            return motion
    return replace(robust, converged=False, ending=ReferenceEnding(ReferenceCause.NO_CHEAPER, inner=reason))


def _problem(plan: Plan, part: Reference) -> ReferenceProblem:
    """Return the optimisation problem of one part of the robust plan: same time, same ends, shares of the limits.

    The robust plan may use more of a limit than `SHARE`; then the part may do so too.
    """
    robust, arms = plan.reference, plan.itinerary.model.arms.planned()
    bounds = {name: max(SHARE * bound, robust.largest[name]) for name, bound in robust.limits.named().items()}
    ends = EndConditions(start=part.state(0.0), end=part.state(part.duration))
    return ReferenceProblem(
        equations_of(arms, Level.CART), arms.base(), _along(part), part.duration, limits=Limits(**bounds), ends=ends
    )


def _along(motion: Trajectory) -> Guess:
    """Return a motion as a guess for a search: a function of times, s, that returns the pendulum's states."""
    return lambda times: motion.state(times)[:, :-2]


def _searched(
    problem: ReferenceProblem, part: Reference, settings: ReferenceSettings, progress: Progress
) -> list[Trajectory]:
    """Return the motions that all searches from a part of the robust plan find, the least costly first; maybe none.

    Args:
        problem: problem of the part.
        part: the part of the robust plan, from which searches start.
        settings: settings of the plan's references.
        progress: receiver of a label with the part's duration, and of the completed share of the searches.
    """
    motions: list[Trajectory] = []
    for k, search in enumerate(_SEARCHES):
        progress(f"as one, {part.duration:.1f} s", k / len(_SEARCHES))
        search_settings = _settings(settings, search.weight, search.method, search.iterations)
        initial_trajectory = on_mesh(part, even_mesh(part.duration, search.interval), method_named(search.method))
        solution = solve(
            problem,
            initial_trajectory,
            settings=search_settings,
            limits=problem.limits,
            search="far" if search.far else "fresh",
        )
        if solution.succeeded:
            motions.append(solution.trajectory)
    return sorted(motions, key=lambda motion: motion.effort)


def _settings(settings: ReferenceSettings, weight: float, method: str, iterations: int) -> ReferenceSettings:
    """Return the settings of a joint search.

    Args:
        settings: settings of the plan's references.
        weight: weight of the distance to the guess, which holds the motion near the robust plan.
        method: name of the transcription, such as "radau-7".
        iterations: largest number of the solver's iterations.
    """
    return replace(
        settings, level="cart", solver="ipopt", method=method, pendulum_weight=weight, cart_weight=CART_WEIGHT,
        end_tolerance=0.0, iterations=iterations,
    )  # fmt: skip


def _refined(plan: Plan, part: Reference, motion: Trajectory) -> Reference:
    """Return a motion of a part of the plan, refined within the plan's tolerance on a mesh of its method.

    A weight holds it near the motion of the search, so that refinement does not lead to another minimum. If the first
    solution on the plan's mesh fails, refinement starts from the motion itself. The result may not have converged.

    Args:
        plan: robust plan.
        part: part of its reference, which gives time and ends.
        motion: result of a search for this part.
    """
    plan_settings = plan.itinerary.reference
    settings = _settings(plan_settings, _HOLD, plan_settings.method, max(plan_settings.iterations, 100))
    problem = replace(_problem(plan, part), guess=_along(motion))
    on_plan_mesh = on_mesh(motion, even_mesh(part.duration, plan_settings.interval), method_named(plan_settings.method))
    solution = solve(problem, on_plan_mesh, settings=settings, limits=problem.limits)
    reference = find_reference(problem, settings, near=solution.trajectory if solution.succeeded else on_plan_mesh)
    return replace(reference, limits=plan.reference.limits)


def stretches(robust: Reference) -> Iterator[tuple[float, float, bool]]:
    """Yield begin and end, s, of each part of a plan, and True for a moving part, which is polished.

    An interior hold and the final rest are False: they are not changed. A hold is a stop at an equilibrium, whose orbit
    has the multiplier 1; it lasts from the transfer that leads to it to the next one. The final rest is the last
    `STILL` s at most.

    Args:
        robust: reference of the robust plan.
    """
    content, begin_of_part = robust.content, 0.0
    transfers = content.transfers
    for stop, symbol in zip(content.stops[1:-1], content.symbols, strict=False):
        # Only an equilibrium has the multiplier 1 exactly.
        if content.orbit(stop).multiplier != 1.0:
            continue
        k = next(k for k, (begin, end) in enumerate(transfers) if begin <= symbol.time <= end)
        yield begin_of_part, transfers[k][1], True
        yield transfers[k][1], transfers[k + 1][0], False
        begin_of_part = transfers[k + 1][0]
    begin_of_rest = robust.duration - min(STILL, robust.duration - transfers[-1][1])
    yield begin_of_part, begin_of_rest, True
    yield begin_of_rest, robust.duration, False


@dataclass(frozen=True, eq=False)
class _Crossed:
    """Crossings of a plan's sections by a motion, by which walks are compared.

    Attributes:
        times: times of the symbols, s.
        events: crossings of each walk in order, as section, turn and direction.
        halves: half wraps at each interior stop, or None if it has no count.
    """

    times: list[float]
    events: list[list[tuple[int, int, int]]]
    halves: list[int | None]


@dataclass(frozen=True)
class Departure(Concluded):
    """Departure of a polished motion from the walk of its robust plan.

    Attributes:
        cause: the cause.
        symbol: symbol whose section is not crossed.
        stop: number of the stop with other wraps, from 1.
        wraps: wraps there.
        wanted: wraps of the robust plan.
    """

    cause: DepartureCause
    symbol: str = ""
    stop: int = 0
    wraps: float = 0.0
    wanted: float = 0.0


def departure(robust: Reference, motion: Reference) -> Departure | None:
    """Return the first difference between the walks of a polished motion and its robust plan, or None.

    A walk is the order, direction and turns of section crossings, with the wraps between them.

    Args:
        robust: reference of the robust plan.
        motion: reference of the polished motion.
    """
    planned = _crossed(robust, robust)
    try:
        polished = _crossed(robust, motion)
    except LookupError as error:
        return Departure(DepartureCause.NO_CROSSING, symbol=error.args[0])
    if planned.events != polished.events:
        return Departure(DepartureCause.ORDER)
    for k, (planned_halves, polished_halves) in enumerate(zip(planned.halves, polished.halves, strict=True)):
        if planned_halves is not None and polished_halves is not None and abs(polished_halves - planned_halves) > 1:
            return Departure(DepartureCause.WRAPS, stop=k + 1, wraps=polished_halves / 2, wanted=planned_halves / 2)
    return None


def _crossed(robust: Reference, motion: Reference) -> _Crossed:
    """Return the crossings of a robust plan's sections by a motion, to compare its walk with the plan's.

    The symbols of the plan are crossings of sections, or transfers, which have no section and separate walks. A
    crossing is sought after the one before it, near the time of its symbol.

    Raises:
        LookupError: the motion does not cross a symbol's section on its turns; the argument is the symbol's text.
    """
    content = robust.content
    n = len(content.stops[0].angles)
    grid = np.arange(0.0, motion.duration, _LOOK)
    angles = motion.state(motion.mesh[0] + grid)[:, :n]
    times, last_crossing = list[float](), 0.0
    for symbol in content.symbols:
        if symbol.section is None:
            times.append(symbol.time)
            continue
        crossing_time = crossing(grid, angles, symbol, robust, between=(last_crossing, symbol.time))
        if crossing_time is None:
            raise LookupError(symbol.text)
        times.append(last_crossing := crossing_time)
    events = list[list[tuple[int, int, int]]]()
    # Successive symbols with a section form a walk.
    for transfer, group in groupby(zip(content.symbols, times, strict=True), lambda pair: pair[0].section is None):
        if not transfer:
            walk = list(group)
            during_walk = (grid >= walk[0][1] - _LOOK) & (grid <= walk[-1][1] + _LOOK)
            events.append(_events([symbol for symbol, _ in walk], angles[during_walk]))
    halves: list[int | None] = []
    for k, (arrival, departure_time) in enumerate(pairwise(times)):
        stop = content.stops[k + 1]
        # The arm that swings farther on the stop's orbit counts its wraps.
        arm = int(np.argmax(np.ptp(content.orbit(stop).curve[:, :n], axis=0)))
        # Each wrap crosses the saddle's angle twice, which gives half wraps.
        is_above = angles[(grid >= arrival) & (grid <= departure_time), arm] > stop.angles[arm]
        halves.append(None if content.wraps[k] is None else int(np.count_nonzero(is_above[1:] != is_above[:-1])))
    return _Crossed(times, events, halves)


def _events(walk: list[PlanSymbol], angles: Array) -> list[tuple[int, int, int]]:
    """Return the crossings of a walk's sections in order, as number of the section, turn and direction.

    Two motions with the same crossings keep the same walk. A section is the set of angles with normal · angles = value,
    but for whole turns. Sections with different normals are numbered from 1, the last one of the walk
    first.

    Args:
        walk: symbols of the walk.
        angles: angles (K, n) of the motion, rad.
    """
    events = list[tuple[int, int, int, int]]()
    # The first value of each normal counts.
    sections = [symbol.section for symbol in reversed(walk) if symbol.section is not None]
    values = {section.normal: section.value for section in sections}
    for number, (normal, value) in enumerate(values.items(), start=1):
        # A change of the whole number of turns beyond the section's value is a crossing.
        turn = np.floor((angles @ np.asarray(normal[: angles.shape[1]]) - value) / (2 * np.pi)).astype(int)
        for row in np.flatnonzero(np.diff(turn)):
            direction = int(np.sign(turn[row + 1] - turn[row]))
            events.append((int(row), number, int(max(turn[row], turn[row + 1])), direction))
    return [(number, turn, direction) for _, number, turn, direction in sorted(events)]


def _noted(plan: Plan, motion: Reference) -> Reference:
    """Return a polished motion with the plan's content, whose crossing times and transfers are those of the motion.

    Scores and views need the content.
    """
    content, n = plan.content, plan.itinerary.model.arms.count
    times = _crossed(plan.reference, motion).times
    angles = motion.state(motion.mesh[0] + np.array(times))[:, :n].tolist()
    symbols = tuple(
        symbol
        if symbol.section is None
        else replace(symbol, time=time, section=replace(symbol.section, angles=tuple(place)))
        for symbol, time, place in zip(content.symbols, times, angles, strict=True)
    )
    transfers = [
        (cost.text, begin, tail(motion, begin, seconds=end - begin, turns=np.zeros(n)))
        for cost, (begin, end) in zip(content.costs, content.transfers, strict=True)
    ]
    content = replace(content, symbols=symbols, costs=transfer_costs(transfers), key=_key(plan))
    return replace(motion, plan=replace(content, polished=nearness(replace(motion, plan=content))))


def nearness(plan: Reference) -> tuple[float, ...]:
    """Return the least scaled distance to each stop's orbit, measured from stop to stop as in the plan's reference.

    Args:
        plan: reference of a plan.
    """
    times = [0.0, *(symbol.time for symbol in plan.content.symbols), plan.duration]
    return tuple(
        orbit_distance(plan.state(plan.mesh[0] + np.linspace(begin, end, 400)), stop, plan)
        for stop, (begin, end) in zip(plan.content.stops, pairwise(times), strict=True)
    )


def _sides(plans: list[tuple[str, Plan]], runs: int, workers: int, progress: Progress) -> Iterator[Side]:
    """Yield the figures of both plans, with success rates from `runs` runs at each mismatch.

    Args:
        plans: name and plan of the robust and of the polished one.
        runs: number of runs of a plan at a mismatch.
        workers: number of processes.
        progress: receiver of progress reports.
    """
    jobs = {
        (name, mismatch): Job(
            plan.itinerary.name, plan.archive, plan.itinerary.model.arms,
            Case(f"mismatch={mismatch:g}", (), replace(plan.itinerary.loop, mismatch=mismatch)),
            tuple(range(runs)), "compiled", plan.itinerary.uncertainty, replayed=0,
        )
        for name, plan in plans for mismatch in MISMATCHES
    }  # fmt: skip
    job_endings = in_processes(outcomes, [*jobs.values()], workers, what="jobs flown", progress=progress)
    completed_runs = {job.key: sum(row.completed for row in rows) for job, rows in job_endings}
    for name, plan in plans:
        motion = plan.reference
        shares = {mismatch: wilson(completed_runs[jobs[name, mismatch].key], runs) for mismatch in MISMATCHES}
        yield Side(
            name, motion.effort, motion.max_cart_acceleration,
            motion.max_cart_position, max(nearness(motion)), shares,
        )  # fmt: skip
