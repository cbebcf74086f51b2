"""Transfers of an itinerary, cached, with their costs.

A transfer is cached by content as soon as it is found, at the turns of its start's name. So interrupted planning
continues from there, and repeated motions, also of other itineraries, cost nothing.

Of several motions that leave margin for feedback, the one with the least product of effort and squared sensitivity is
used (see `dpcontrol.plans.authority`). With sensitivities of 2.3, 2.5, 3.3 and 4.7, transfers from rest to Down-Up fail
5, 6, 28 and 51 times in 200 on plants with errors of 0.3. Effort gives the reverse order.

The cost is the time, the cart's effort ∫u² and its stroke.
"""

import json
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path

import numpy as np

from dpcontrol.control.interface import whole_turns
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.plans.authority import peak_gains, sensitivity
from dpcontrol.plans.candidates import (
    CART_WEIGHT,
    Way,
    flights_between,
    smooth_motions,
)
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.plans.layout import GENTLE, SHORTEST, Pace
from dpcontrol.references.content import TransferCost
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.find import refined_transfer, wanting
from dpcontrol.references.problem import (
    NATURAL_TIME,
    PLANNING,
    EndConditions,
    Limits,
    ReferenceProblem,
    ReferenceSettings,
    Scale,
)
from dpcontrol.references.reference import Reference, load_reference, save_reference
from dpcontrol.references.trajectory import Trajectory
from dpcontrol.references.transcription import solve

_SAMPLING = 2e-3
"""Interval of the places from which a stroke is taken, s."""
ROOM, TIGHT = 0.7, 0.9
"""Shares of each limit that leave room for feedback, and that the shortest transfers use."""
SHORT = np.arange(0.5, 1.6, 0.25)
"""First durations of the shortest flights in natural times."""
MULTIPLES = np.array([1.3633, 1.8178, 2.2722, 2.7266])
"""Durations of gentle transfers in natural times."""
SHORTER, LONGER = np.array([1.15, 1.53, 1.91]), np.array([3.5, 4.5])
"""Durations of transfers that are found in none of them."""
_FULL_DRIVE_ANGLE = 0.01
"""Angle, rad, at which no gain along a transfer should ask for the whole acceleration."""
_RANKED = 8
"""Number of motions that are compared, those of the least effort."""
_COARSE = ReferenceSettings(pendulum_weight=0.0, cart_weight=CART_WEIGHT)
"""Settings of the solutions that are compared."""


@dataclass(frozen=True)
class Transfer:
    """A required transfer, with all its inputs, from `start` (N,) to one of several `ends` (N,).

    text: its name. model: name of its arms' model. near: motion near which it is sought first.
    """

    text: str
    model: str
    arms: ArmChainParameters
    limits: Limits
    settings: ReferenceSettings
    start: tuple[float, ...]
    ends: tuple[tuple[float, ...], ...]
    pace: Pace = GENTLE
    near: Reference | None = None

    @classmethod
    def of(cls, itinerary: Itinerary, text: str, start: Array, ends: Sequence[Array], pace: Pace) -> "Transfer":
        """Return the transfer with an itinerary's arms, limits and reference settings.

        Args:
            itinerary: arms, limits and settings of the reference.
            text: name of the transfer.
            start: state (N,) at the start.
            ends: possible states (N,) at the end.
            pace: time of the transfer, "" for the itinerary's.
        """
        return cls(
            text, itinerary.model.name, itinerary.model.arms.planned(), itinerary.limits, itinerary.reference,
            tuple(start.tolist()), tuple(tuple(end.tolist()) for end in ends), pace or itinerary.transfer,
            min(itinerary.near, key=lambda motion: _between(motion, start, ends)[0], default=None),
        )  # fmt: skip

    @property
    def key(self) -> str:
        """Hash of the motion's inputs, as 16 hexadecimal digits."""
        content = {
            "code": PLANNING,
            "parameters": asdict(self.arms),
            "start": self.start,
            "ends": self.ends,
            "pace": self.pace,
            "limits": asdict(self.limits),
            "reference": asdict(self.settings),
        }
        return content_hash(json.dumps(content, sort_keys=True))

    @property
    def file(self) -> Path:
        """Its file in the cache."""
        return cache_file("transfers", self.model, self.key)


_SEVERAL = 4
"""Number of transfers that justifies separate processes."""


def find_transfers(
    wanted: Sequence[Transfer],
    *,
    workers: int = 1,
    fresh: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Reference]:
    """Return transfers by key, and cache each one when its search ends.

    A transfer that does not exist does not prevent the search for the others.

    Args:
        wanted: transfers to find.
        workers: processes of the search, 0 for one per processor if there are several transfers.
        fresh: ignore the cache.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: some do not exist within the limits; the message has the cause.
    """
    references: dict[str, Reference] = {}
    uncached: dict[str, Transfer] = {}
    for transfer in wanted:
        if not fresh and (stored := kept(transfer.file)) is not None:
            references[transfer.key] = load_reference(BytesIO(stored))
        else:
            uncached[transfer.key] = transfer
    failures: list[str] = []
    searches = list(uncached.values())
    workers = workers or (processors() if len(searches) >= _SEVERAL else 1)
    in_this_process = workers == 1
    for k, (transfer, (archive, reason)) in enumerate(_sought(searches, workers, progress)):
        if not in_this_process:
            progress(f"{k + 1} of {len(uncached)} transfers: {transfer.text}", (k + 1) / len(uncached))
        if reason:
            failures.append(f"{transfer.text}: {reason}" if transfer.text else reason)
            continue
        keep(transfer.file, archive)
        references[transfer.key] = load_reference(BytesIO(archive))
    if failures:
        further_failures = f"; nor are there {len(failures) - 1} more, the others are kept" if len(failures) > 1 else ""
        raise GoalMissed(failures[0] + further_failures)
    return references


def _sought(
    wanted: Sequence[Transfer], workers: int, progress: Progress
) -> Iterator[tuple[Transfer, tuple[bytes, str]]]:
    """Yield each transfer with the result of its `search`, in up to `workers` processes if there are several.

    The result is the bytes of the transfer's file and "", or no bytes and the cause of its absence.
    """
    if workers > 1 and len(wanted) > 1:
        return in_processes(search, wanted, min(workers, len(wanted)))
    portions = (part_of(progress, k / len(wanted), (k + 1) / len(wanted)) for k in range(len(wanted)))
    return ((transfer, search(transfer, portion)) for transfer, portion in zip(wanted, portions, strict=True))


_ONE_AT_A_TIME = threading.Lock()
"""Threads cannot share the solver."""


def search(wanted: Transfer, progress: Progress = no_progress) -> tuple[bytes, str]:
    """Return the bytes of a found transfer's .npz file, or the cause of its absence, in a form that processes exchange.

    Args:
        wanted: the transfer.
        progress: receiver of progress reports.

    Returns:
        The bytes and "", or no bytes and the cause.
    """

    def report(_: str, done: float) -> None:
        """Report the completed share under the transfer's own name."""
        progress(wanted.text, done)

    archive = BytesIO()
    with _ONE_AT_A_TIME:
        try:
            save_reference(archive, find_transfer(wanted, report))
        except GoalMissed as error:
            return b"", str(error)
    return archive.getvalue(), ""


def find_transfer(wanted: Transfer, progress: Progress = no_progress) -> Reference:
    """Return the reference of a transfer: of several solved first motions, the best one that can be refined.

    Each attempt has a share of the limits, durations of its first motions, and True if these are flights instead of
    smooth motions. First motions are solved on a coarse mesh. The eight of them with the least effort (for the shortest
    transfers, duration) are refined in the order of `_rank` until one converges. A motion near which the transfer is
    sought (`near`) is tried before.

    Args:
        wanted: the transfer.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: there is none within the limits.
    """
    # The search is done in the units of the laboratory's arms, see module `candidates`.
    scale, failure, durations = Scale.of(wanted.arms), "no first motion leads there", np.zeros(0)
    state_units, arms = scale.state(wanted.arms.count), wanted.arms.scaled(scale.length, scale.time)
    start, *ends = (state_units * state for state in (wanted.start, *wanted.ends))
    is_side_step, similar_motions = np.allclose(start[:-2], ends[0][:-2]), list[tuple[Trajectory, Array]]()
    attempts = _attempts(wanted, scale, aside=is_side_step)
    if wanted.near is not None:
        unscaled_start = np.array(wanted.start)
        _, end = _between(wanted.near, unscaled_start, np.array(wanted.ends))
        similar = turned(wanted.near, -whole_turns((wanted.near.states[0, 0] - unscaled_start)[: arms.count]))
        first_motion = Trajectory(
            similar.method, similar.mesh * scale.time, similar.states * state_units, similar.inputs * scale.acceleration
        )
        similar_motions, attempts = [(first_motion, state_units * end)], [(TIGHT, np.zeros(0), False), *attempts]
    for share, durations, from_flights in attempts:
        flight_limits = scale.limits(wanted.limits, share)
        ways = [
            Way(arms, scale.limits(wanted.limits), flight_limits, start, ends[0], backwards)
            for backwards in (False, True)
        ]
        fixed = wanted.pace != SHORTEST
        first_motions = (
            flights_between(ways, ends, durations, fixed=fixed)
            if from_flights
            else [*similar_motions, *smooth_motions(start, ends, durations)]
        )
        similar_motions = []
        coarse_solutions: list[tuple[ReferenceProblem, Trajectory]] = []
        for k, (first_motion, end) in enumerate(first_motions):
            progress("transfer", k / len(first_motions))
            problem = _problem(arms, flight_limits, first_motion, (start, end))
            attempt = solve(problem, first_motion, settings=_COARSE, limits=flight_limits, search="rough")
            if attempt.succeeded:
                coarse_solutions.append((problem, attempt.trajectory))
            failure = attempt.outcome
        coarse_solutions = sorted(
            coarse_solutions, key=lambda candidate: candidate[1].effort if fixed else candidate[1].duration
        )[:_RANKED]
        for problem, motion in sorted(coarse_solutions, key=lambda candidate: _rank(wanted, arms, candidate[1])):
            reference = refined_transfer(problem, motion, wanted.settings, cart_weight=CART_WEIGHT)
            if reference.converged:
                return replace(
                    reference,
                    mesh=reference.mesh / scale.time,
                    states=reference.states / state_units,
                    inputs=reference.inputs / scale.acceleration,
                    limits=wanted.limits,
                )
            failure = reference.status
    raise _missed(wanted, np.asarray(durations / scale.time), failure)


def _attempts(wanted: Transfer, scale: Scale, *, aside: bool) -> list[tuple[float, Array, bool]]:
    """Return the attempts of a search for a transfer, in order, each with its share of the limits and its durations.

    Args:
        wanted: the transfer.
        scale: natural units of its arms.
        aside: True if only the cart moves, from one place to another.

    Returns:
        Shares of the limits, durations (D,), s, and True to start from flights instead of smooth motions.
    """
    # Three arms and more have many directions, and use the longer durations.
    gentle_durations = MULTIPLES[2 * (wanted.arms.count > 2) :] * NATURAL_TIME
    fallbacks = [(ROOM, SHORTER * NATURAL_TIME, False), (TIGHT, LONGER * NATURAL_TIME, False)]
    if aside and wanted.pace == GENTLE:
        return [(ROOM, gentle_durations[:1], False), (ROOM, gentle_durations[1:], False), *fallbacks]
    if wanted.pace == GENTLE:
        return [(ROOM, gentle_durations, False), *fallbacks, (ROOM, gentle_durations, True)]
    if isinstance(wanted.pace, str):
        return [(TIGHT, SHORT * NATURAL_TIME, True), (TIGHT, gentle_durations, False)]
    time = np.array([wanted.pace * scale.time])
    return [(ROOM, time, True), (TIGHT, time, True), (TIGHT, time, False)]


def _rank(wanted: Transfer, arms: ArmChainParameters, motion: Trajectory) -> float:
    """Return the rank of a solved motion among several, the smallest of which is refined first.

    It is the duration for the shortest transfers, otherwise the effort ∫u² times the square of the sensitivity, which
    is the angles' deviation per relative error of the arms' parameters. Gains that ask for
    more than the whole acceleration at `_FULL_DRIVE_ANGLE` count in proportion, squared.
    """
    if wanted.pace == SHORTEST:
        return motion.duration
    excess = peak_gains(arms, motion).max() * _FULL_DRIVE_ANGLE / wanted.limits.acceleration
    return float((sensitivity(arms, motion) * max(excess, 1.0)) ** 2 * motion.effort)


def _problem(
    arms: ArmChainParameters, limits: Limits, first: Trajectory, ends: tuple[Array, Array]
) -> ReferenceProblem:
    """Return the optimisation problem of a transfer between two states `ends` (N,), guessed by the motion `first`."""
    return ReferenceProblem(
        equations_of(arms, Level.CART),
        arms.base(),
        lambda times: first.state(times)[:, :-2],
        first.duration,
        limits=limits,
        ends=EndConditions(start=ends[0], end=ends[1]),
    )


def _missed(wanted: Transfer, durations: Array, failed: str) -> GoalMissed:
    """Return the error of a transfer that was not found, with the obstacle that explains it.

    Args:
        wanted: the transfer.
        durations: durations that were tried last, s.
        failed: outcome of the last attempt.
    """
    start, end = np.array(wanted.start), np.array(wanted.ends[0])
    ((first, _),) = smooth_motions(start, [end], durations[:1])
    problem = _problem(wanted.arms, wanted.limits, first, (start, end))
    ending = ReferenceEnding(
        ReferenceCause.NO_TRANSFER,
        times=tuple(durations.tolist()),
        answer=failed,
        obstacle=wanting(problem, first, _COARSE),
    )
    return GoalMissed(ending.status)


def _between(motion: Reference, start: Array, ends: Sequence[Array] | Array) -> tuple[float, Array]:
    """Return the distance of a motion's ends from a required start and the nearest of several ends, and that end (N,).

    Whole turns of the motion do not count. A stored motion with a small distance is a good first motion. `start` (N,)
    and each of `ends` (N,) are states of arms and cart.
    """
    n = len(start) // 2 - 1
    turns = np.pad(whole_turns((motion.states[0, 0] - start)[:n]), (0, n + 2))
    end_distances = [float(np.abs(motion.states[-1, -1] - turns - end).max()) for end in ends]
    nearest = int(np.argmin(end_distances))
    return end_distances[nearest] + float(np.abs(motion.states[0, 0] - turns - start).max()), np.asarray(ends[nearest])


def turned(reference: Reference, angles: Array) -> Reference:
    """Return a reference with angles added to its states, such as whole turns, which leave its motion the same.

    Args:
        reference: the reference.
        angles: angles (n,) added to those of its states, rad.
    """
    turns = np.zeros(reference.states.shape[-1])
    turns[: len(angles)] = angles
    return replace(reference, states=reference.states + turns)


def transfer_costs(transfers: Sequence[tuple[str, float, Reference]]) -> tuple[TransferCost, ...]:
    """Return the time, effort and stroke of each transfer of a plan.

    Args:
        transfers: text, begin in s and motion of each transfer.
    """
    return tuple(
        TransferCost(text, begin, motion.duration, motion.effort, _stroke(motion)) for text, begin, motion in transfers
    )


def _stroke(motion: Reference) -> float:
    """Return the distance between the cart's extreme places in a motion, m."""
    times = motion.mesh[0] + np.linspace(0.0, motion.duration, round(motion.duration / _SAMPLING) + 1)
    return float(np.ptp(motion.state(times)[:, -2]))
