"""Transfers of an itinerary, cached, with their costs.

A transfer is cached by content as soon as it is found, at the turns of its start's name. So interrupted planning
continues from there, and repeated motions, also of other itineraries, cost nothing.

Of several motions between the same places that leave margin for feedback, the least sensitive one is used. Let e be the
distance of the state from the motion under linear-quadratic feedback K. To first order in a relative error of one of
the arms' parameters,

    e_{k+1} = (A_k - B_k K_k) e_k + E_k,      e_0 = 0.

The sensitivity is the largest root of the sum of squares of the angles' errors, over all arms and parameters. It orders
the failures of transfers from rest to Down-Up on plants with errors of 0.3. With sensitivities of 2.3, 2.5, 3.3 and
4.7, runs fail 5, 6, 28 and 51 times in 200. Effort gives the reverse order.

The cost is the time, the cart's effort ∫u² and its stroke.
"""

import json
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path

import numpy as np

from dpcontrol.control.interface import SampledModel
from dpcontrol.control.tracking import TvlqrSettings, riccati_gains, terminal_cost
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.processes import in_processes, processors
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.references.content import TransferCost
from dpcontrol.references.find import find_transfer
from dpcontrol.references.problem import PLANNING, Limits, ReferenceSettings
from dpcontrol.references.reference import Reference, load_reference, save_reference
from dpcontrol.references.trajectory import Trajectory

_SAMPLING = 2e-3
"""Interval of the places from which a stroke is taken, s."""
_PERIOD, _SHARE = 5e-3, 1e-4
"""Period of the feedback in the comparison of motions, s, and step of difference quotients."""


@dataclass(frozen=True)
class Transfer:
    """A required transfer to one of several ends.

    It leads from `start` (N,) to one of `ends` (N,), and has all its inputs.

    text: its name. model: name of its arms' model.
    """

    text: str
    model: str
    arms: ArmChainParameters
    limits: Limits
    settings: ReferenceSettings
    start: tuple[float, ...]
    ends: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, itinerary: Itinerary, text: str, start: Array, ends: Sequence[Array]) -> "Transfer":
        """Return the transfer with an itinerary's arms, limits and reference settings.

        Args:
            itinerary: arms, limits and settings of the reference.
            text: name of the transfer.
            start: state (N,) at the start.
            ends: possible states (N,) at the end.
        """
        return cls(
            text, itinerary.model.name, itinerary.model.arms.planned(), itinerary.limits, itinerary.reference,
            tuple(start.tolist()), tuple(tuple(end.tolist()) for end in ends),
        )  # fmt: skip

    @property
    def key(self) -> str:
        """Hash of the motion's inputs, as 16 hexadecimal digits."""
        content = {
            "code": PLANNING,
            "parameters": asdict(self.arms),
            "start": self.start,
            "ends": self.ends,
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
    """Return transfers by key, and cache each one when it is found.

    A transfer that does not exist does not prevent the search for the others.

    Args:
        wanted: transfers to find.
        workers: processes of the search, 0 for one per processor if there are several transfers.
        fresh: ignore the cache.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: some do not exist within the limits; the message has the cause.
    """
    found: dict[str, Reference] = {}
    left: dict[str, Transfer] = {}
    for one in wanted:
        if not fresh and (known := kept(one.file)) is not None:
            found[one.key] = load_reference(BytesIO(known))
        else:
            left[one.key] = one
    missed: list[str] = []
    several = list(left.values())
    workers = workers or (processors() if len(several) >= _SEVERAL else 1)
    alone = workers == 1
    for k, (one, (archive, why)) in enumerate(_sought(several, workers, progress)):
        if not alone:
            progress(f"{k + 1} of {len(left)} transfers: {one.text}", (k + 1) / len(left))
        if why:
            missed.append(f"{one.text}: {why}" if one.text else why)
            continue
        keep(one.file, archive)
        found[one.key] = load_reference(BytesIO(archive))
    if missed:
        more = f"; nor are there {len(missed) - 1} more, the others are kept" if len(missed) > 1 else ""
        raise GoalMissed(missed[0] + more)
    return found


def _sought(
    wanted: Sequence[Transfer], workers: int, progress: Progress
) -> Iterator[tuple[Transfer, tuple[bytes, str]]]:
    if workers > 1 and len(wanted) > 1:
        remedy = "Those that were found are kept: run the same command again, with fewer --workers"
        return in_processes(search, wanted, min(workers, len(wanted)), remedy=remedy)
    parts = (part_of(progress, k / len(wanted), (k + 1) / len(wanted)) for k in range(len(wanted)))
    return ((one, search(one, here)) for one, here in zip(wanted, parts, strict=True))


_ONE_AT_A_TIME = threading.Lock()
"""Threads cannot share the solver."""


def search(wanted: Transfer, progress: Progress = no_progress) -> tuple[bytes, str]:
    """Return a transfer's bytes, or the cause of its absence.

    The bytes are those of its .npz file.

    Args:
        wanted: the transfer.
        progress: receiver of progress reports.
    """

    def here(_: str, done: float) -> None:
        progress(wanted.text, done)

    archive = BytesIO()
    with _ONE_AT_A_TIME:
        try:
            found = find_transfer(
                equations_of(wanted.arms, Level.CART), wanted.arms.base(), start=np.array(wanted.start),
                ends=[np.array(end) for end in wanted.ends], limits=wanted.limits, settings=wanted.settings,
                sensitivity=lambda motion: sensitivity(wanted.arms, motion), progress=here,
            )  # fmt: skip
        except GoalMissed as error:
            return b"", str(error)
        save_reference(archive, found)
    return archive.getvalue(), ""


def sensitivity(arms: ArmChainParameters, motion: Trajectory) -> float:
    """Return the largest deviation of angles by the parameters.

    The largest deviation is per unit relative error of the arms' parameters, rad.

    It is infinite if the motion's end cannot be stabilised.

    Args:
        arms: parameters of the arms.
        motion: motion of arms and cart.
    """
    model = SampledModel(equations_of(arms, Level.CART), arms.base(), period=_PERIOD)
    count, n = max(round(motion.duration / _PERIOD), 1), arms.count
    times = np.arange(count) * _PERIOD
    states, commands = motion.state(times), motion.input(times + _PERIOD / 2)[:, 0]
    a, b = model.linearised(states, commands)
    diagonal, effort = TvlqrSettings().weights(n, _PERIOD)
    try:
        terminal = terminal_cost(a[-1], b[-1], weights=np.diag(diagonal), effort=effort)
    except GoalMissed:
        return float("inf")
    gains, _, _ = riccati_gains(a, b, weights=diagonal, effort=effort, terminal=terminal)
    effects = _effects(arms, model, states, commands)
    strayed, largest = np.zeros(effects.shape[1:]), 0.0
    for k in range(count):
        strayed = a[k] @ strayed - b[k][:, None] * (gains[k] @ strayed) + effects[k]
        largest = max(largest, float(np.linalg.norm(strayed[:n])))
    return largest


def _effects(arms: ArmChainParameters, model: SampledModel, states: Array, commands: Array) -> Array:
    """Return E (K, N, p).

    Change of a period's step per relative error of each number of each arm.
    """
    nominal = model.parameters.copy()

    def steps(base: Array) -> Array:
        # The model's array, which its steps read.
        model.parameters[:] = base
        return np.array([model.step(state, float(command)) for state, command in zip(states, commands, strict=True)])

    here, columns = steps(nominal), []
    for name in ("mass", "centre_of_mass", "length", "inertia"):
        for i in range(arms.count):
            values = list(getattr(arms, name))
            values[i] *= 1 + _SHARE
            columns.append((steps(replace(arms, **{name: tuple(values)}).base()) - here) / _SHARE)
    model.parameters[:] = nominal
    return np.stack(columns, axis=2)


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
