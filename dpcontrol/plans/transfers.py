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
from dpcontrol.plans.authority import sensitivity
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
    left: dict[str, Transfer] = {}
    for transfer in wanted:
        if not fresh and (stored := kept(transfer.file)) is not None:
            references[transfer.key] = load_reference(BytesIO(stored))
        else:
            left[transfer.key] = transfer
    missed: list[str] = []
    several = list(left.values())
    workers = workers or (processors() if len(several) >= _SEVERAL else 1)
    alone = workers == 1
    for k, (transfer, (archive, why)) in enumerate(_sought(several, workers, progress)):
        if not alone:
            progress(f"{k + 1} of {len(left)} transfers: {transfer.text}", (k + 1) / len(left))
        if why:
            missed.append(f"{transfer.text}: {why}" if transfer.text else why)
            continue
        keep(transfer.file, archive)
        references[transfer.key] = load_reference(BytesIO(archive))
    if missed:
        more = f"; nor are there {len(missed) - 1} more, the others are kept" if len(missed) > 1 else ""
        raise GoalMissed(missed[0] + more)
    return references


def _sought(
    wanted: Sequence[Transfer], workers: int, progress: Progress
) -> Iterator[tuple[Transfer, tuple[bytes, str]]]:
    if workers > 1 and len(wanted) > 1:
        return in_processes(search, wanted, min(workers, len(wanted)))
    parts = (part_of(progress, k / len(wanted), (k + 1) / len(wanted)) for k in range(len(wanted)))
    return ((transfer, search(transfer, portion)) for transfer, portion in zip(wanted, parts, strict=True))


_ONE_AT_A_TIME = threading.Lock()
"""Threads cannot share the solver."""


def search(wanted: Transfer, progress: Progress = no_progress) -> tuple[bytes, str]:
    """Return the bytes of a transfer's .npz file, or the cause of its absence.

    Args:
        wanted: the transfer.
        progress: receiver of progress reports.
    """

    def report(_: str, done: float) -> None:
        progress(wanted.text, done)

    archive = BytesIO()
    with _ONE_AT_A_TIME:
        try:
            save_reference(archive, find_transfer(wanted, report))
        except GoalMissed as error:
            return b"", str(error)
    return archive.getvalue(), ""


def find_transfer(wanted: Transfer, progress: Progress = no_progress) -> Reference:
    """Return a transfer from the best of its first motions.

    Args:
        wanted: the transfer.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: there is none within the limits.
    """
    scale, failed, durations = Scale.of(wanted.arms), "no first motion leads there", np.zeros(0)
    factors, arms = scale.state(wanted.arms.count), wanted.arms.scaled(scale.length, scale.time)
    start, *ends = (factors * state for state in (wanted.start, *wanted.ends))
    aside, earlier = np.allclose(start[:-2], ends[0][:-2]), list[tuple[Trajectory, Array]]()
    attempts = _attempts(wanted, scale, aside=aside)
    if wanted.near is not None:
        begin = np.array(wanted.start)
        _, end = _between(wanted.near, begin, np.array(wanted.ends))
        near = turned(wanted.near, -whole_turns((wanted.near.states[0, 0] - begin)[: arms.count]))
        first = Trajectory(near.method, near.mesh * scale.time, near.states * factors, near.inputs * scale.acceleration)
        earlier, attempts = [(first, factors * end)], [(TIGHT, np.zeros(0), False), *attempts]
    for share, durations, flies in attempts:
        room = scale.limits(wanted.limits, share)
        ways = [Way(arms, scale.limits(wanted.limits), room, start, ends[0], backwards) for backwards in (False, True)]
        fixed = wanted.pace != SHORTEST
        firsts = (
            flights_between(ways, ends, durations, fixed=fixed)
            if flies
            else [*earlier, *smooth_motions(start, ends, durations)]
        )
        earlier = []
        solved: list[tuple[ReferenceProblem, Trajectory]] = []
        for k, (first, end) in enumerate(firsts):
            progress("transfer", k / len(firsts))
            problem = _problem(arms, room, first, (start, end))
            attempt = solve(problem, first, settings=_COARSE, limits=room, search="rough")
            if attempt.succeeded:
                solved.append((problem, attempt.trajectory))
            failed = attempt.outcome
        solved = sorted(solved, key=lambda candidate: candidate[1].effort if fixed else candidate[1].duration)[:_RANKED]
        for problem, motion in sorted(solved, key=lambda candidate: _rank(wanted, arms, candidate[1])):
            reference = refined_transfer(problem, motion, wanted.settings, cart_weight=CART_WEIGHT)
            if reference.converged:
                return replace(
                    reference,
                    mesh=reference.mesh / scale.time,
                    states=reference.states / factors,
                    inputs=reference.inputs / scale.acceleration,
                    limits=wanted.limits,
                )
            failed = reference.status
    raise _missed(wanted, np.asarray(durations / scale.time), failed)


def _attempts(wanted: Transfer, scale: Scale, *, aside: bool) -> list[tuple[float, Array, bool]]:
    """Return shares of the limits, durations, s, and True to start from flights, in the order of the attempts."""
    # Three arms and more have many directions, and use the longer durations.
    several = MULTIPLES[2 * (wanted.arms.count > 2) :] * NATURAL_TIME
    fallbacks = [(ROOM, SHORTER * NATURAL_TIME, False), (TIGHT, LONGER * NATURAL_TIME, False)]
    if aside and wanted.pace == GENTLE:
        return [(ROOM, several[:1], False), (ROOM, several[1:], False), *fallbacks]
    if wanted.pace == GENTLE:
        return [(ROOM, several, False), *fallbacks, (ROOM, several, True)]
    if isinstance(wanted.pace, str):
        return [(TIGHT, SHORT * NATURAL_TIME, True), (TIGHT, several, False)]
    time = np.array([wanted.pace * scale.time])
    return [(ROOM, time, True), (TIGHT, time, True), (TIGHT, time, False)]


def _rank(wanted: Transfer, arms: ArmChainParameters, motion: Trajectory) -> float:
    """Return the rank of a motion, the best first."""
    return motion.duration if wanted.pace == SHORTEST else sensitivity(arms, motion) ** 2 * motion.effort


def _problem(
    arms: ArmChainParameters, limits: Limits, first: Trajectory, ends: tuple[Array, Array]
) -> ReferenceProblem:
    """Return the problem of a transfer that starts from a first motion."""
    return ReferenceProblem(
        equations_of(arms, Level.CART),
        arms.base(),
        lambda times: first.state(times)[:, :-2],
        first.duration,
        limits=limits,
        ends=EndConditions(start=ends[0], end=ends[1]),
    )


def _missed(wanted: Transfer, durations: Array, failed: str) -> GoalMissed:
    """Return the error of a transfer that was not found in these durations."""
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
    """Return the distance of a motion's ends from a start and the nearest of several ends, whole turns apart."""
    n = len(start) // 2 - 1
    turns = np.pad(whole_turns((motion.states[0, 0] - start)[:n]), (0, n + 2))
    away = [float(np.abs(motion.states[-1, -1] - turns - end).max()) for end in ends]
    nearest = int(np.argmin(away))
    return away[nearest] + float(np.abs(motion.states[0, 0] - turns - start).max()), np.asarray(ends[nearest])


def turned(reference: Reference, angles: Array) -> Reference:
    """Return a reference with `angles` (n,) added.

    Args:
        reference: the reference.
        angles: angles (n,) added to those of its states, rad.
    """
    turns = np.zeros(reference.states.shape[-1])
    turns[: len(angles)] = angles
    return replace(reference, states=reference.states + turns)


def transfer_costs(transfers: Sequence[tuple[str, float, Reference]]) -> tuple[TransferCost, ...]:
    """Return the costs of transfers.

    Args:
        transfers: text, begin in s and motion of each transfer.
    """
    return tuple(
        TransferCost(text, begin, motion.duration, motion.effort, _stroke(motion)) for text, begin, motion in transfers
    )


def _stroke(motion: Reference) -> float:
    """Return the distance between the cart's extreme places, m."""
    times = motion.mesh[0] + np.linspace(0.0, motion.duration, round(motion.duration / _SAMPLING) + 1)
    return float(np.ptp(motion.state(times)[:, -2]))
