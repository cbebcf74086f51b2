"""Transfers of an itinerary: found once and kept, and told apart by what each of them takes and passes.

A transfer is kept by content as soon as it is found, at the turns that its start is named at, so that planning that was
interrupted goes on where it was, and a motion that comes again, in the same itinerary or another, costs nothing.

Of several motions between the same places, the least sensitive of those that leave the feedback room is taken. With e
the state's distance from the motion under linear-quadratic feedback K, to first order in a relative error of one of the
arms' parameters,

    e_{k+1} = (A_k - B_k K_k) e_k + E_k,      e_0 = 0,

and its sensitivity is the largest root of the sum of squares of the angles' errors, over all arms and parameters. The
runs that transfers from rest lose to plants that are off by 0.3 are in its order: 5, 6, 28 and 51 of 200 where it is
2.3, 2.5, 3.3 and 4.7 on the way to Down-Up; effort puts them the other way round.

What each takes is its time, the cart's effort ∫u² and stroke. What it passes are the families of Lyapunov orbits: of
each, the orbit to which the pendulum comes closest, the distance being the largest component of the scaled gap. A
family shrinks to its saddle, so that is at no distance from a transfer that begins or ends there.
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
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.processes import in_processes, on_cluster, processors
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.family import lyapunov_family
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibrium
from dpcontrol.orbits.manifold import OrbitCurve
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.references.find import find_transfer
from dpcontrol.references.problem import PLANNING, Limits, ReferenceSettings
from dpcontrol.references.reference import (
    ApproachNote,
    Reference,
    TransferNote,
    load_reference,
    save_reference,
)
from dpcontrol.references.trajectory import Trajectory

_SAMPLING = 2e-3
"""s between the states that are held against the orbits."""
_PERIOD, _SHARE = 5e-3, 1e-4
"""Of the feedback with which motions are compared, s; and of the differences that stand for derivatives."""
_MET = 1e-6
"""Scaled distance from a saddle at which a transfer's end is at it."""


@dataclass(frozen=True)
class Transfer:
    """A transfer that is wanted, from `start` (N,) to one of `ends` (N,), with all that it depends on.

    text: how it is named; model: the name of its arms'.
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
        """Return the transfer with an itinerary's arms, limits and reference settings."""
        return cls(
            text, itinerary.model.name, itinerary.model.arms.planned(), itinerary.limits, itinerary.reference,
            tuple(start.tolist()), tuple(tuple(end.tolist()) for end in ends),
        )  # fmt: skip

    @property
    def key(self) -> str:
        """What the motion depends on, as 16 hexadecimal digits."""
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
        """Where it is kept once it is found."""
        return cache_file("transfers", self.model, self.key)


_SEVERAL = 4
"""Transfers from which processes of their own are worth their start."""


def kept_transfer(
    itinerary: Itinerary, start: Array, ends: Sequence[Array], *, progress: Progress = no_progress
) -> Reference:
    """Return a transfer from `start` (N,) to one of `ends` (N,), from the cache where it is kept.

    Raises:
        GoalMissed: there is none within the limits; says what stood in the way.
    """
    wanted = Transfer.of(itinerary, "", start, ends)
    return find_transfers([wanted], progress=progress)[wanted.key]


def find_transfers(
    wanted: Sequence[Transfer],
    *,
    workers: int = 1,
    scheduler: str = "",
    fresh: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Reference]:
    """Return transfers by key, from the cache unless `fresh`; each that is found is kept at once.

    workers: processes in which they are sought, 0 for one on each processor if there are several; scheduler: address of
    a Dask cluster, or empty. One that there is not does not keep the others from being found.

    Raises:
        InputError: no cluster answers.
        GoalMissed: there are none of some within the limits; says what stood in the way.
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
    alone = workers == 1 and not scheduler
    for k, (one, (archive, why)) in enumerate(_sought(several, workers, scheduler, progress)):
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
    wanted: Sequence[Transfer], workers: int, scheduler: str, progress: Progress
) -> Iterator[tuple[Transfer, tuple[bytes, str]]]:
    if scheduler:
        return on_cluster(search, wanted, scheduler)
    if workers > 1 and len(wanted) > 1:
        remedy = "Those that were found are kept: run the same command again, with fewer --workers"
        return in_processes(search, wanted, min(workers, len(wanted)), remedy=remedy)
    parts = (part_of(progress, k / len(wanted), (k + 1) / len(wanted)) for k in range(len(wanted)))
    return ((one, search(one, here)) for one, here in zip(wanted, parts, strict=True))


_ONE_AT_A_TIME = threading.Lock()
"""The solver is not to be shared between threads, and a Dask worker may have several."""


def search(wanted: Transfer, progress: Progress = no_progress) -> tuple[bytes, str]:
    """Return the bytes of a transfer's .npz file, or why there is none."""

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
    """Return how far in rad angles stray, at most, for a unit of each relative error of the arms' parameters.

    Infinite where the motion's end cannot be stabilised.
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
    """Return E (K, N, p): by how much a relative error of each number of each arm changes a period's step."""
    nominal = model.parameters.copy()

    def steps(base: Array) -> Array:
        # The model's own array, from which it steps.
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
    """Return a reference with `angles` (n,) added to its own."""
    turns = np.zeros(reference.states.shape[-1])
    turns[: len(angles)] = angles
    return replace(reference, states=reference.states + turns)


def transfer_notes(
    system: System,
    transfers: Sequence[tuple[str, float, Reference]],
    *,
    progress: Progress = no_progress,
) -> list[TransferNote]:
    """Return what transfers take and pass, each given by its text, the time at which it begins, s, and its motion."""
    times = [np.linspace(0.0, one.duration, round(one.duration / _SAMPLING) + 1) for _, _, one in transfers]
    states = [one.state(at) for (_, _, one), at in zip(transfers, times, strict=True)]
    notes: list[TransferNote] = [
        {
            "text": text, "begin": begin, "duration": one.duration,
            "effort": one.rms_cart_acceleration**2 * one.duration, "stroke": float(np.ptp(rows[:, -2])),
            "closest": [],
        }
        for (text, begin, one), rows in zip(transfers, states, strict=True)
    ]  # fmt: skip
    pendulum = [rows[:, :-2] for rows in states]
    energies = [system.numeric.hamiltonian(rows) for rows in pendulum]
    span = min(float(e.min()) for e in energies), max(float(e.max()) for e in energies)
    for k, saddle in enumerate(system.saddles):
        progress(f"closest approach to the orbits about {saddle}", k / len(system.saddles))
        here = part_of(progress, k / len(system.saddles), (k + 1) / len(system.saddles))
        for orbits in _families(system, saddle, span, here):
            for note, at, rows in zip(notes, times, pendulum, strict=True):
                note["closest"].append(_closest(orbits, at, rows))
    return notes


def _families(
    system: System, saddle: str, energies: tuple[float, float], progress: Progress
) -> list[Sequence[LyapunovOrbit]]:
    """Return the families of orbits about a saddle, as far as they exist at these energies (lowest, highest) in J."""
    values = equilibrium(system, saddle).eigenvalues
    found: list[Sequence[LyapunovOrbit]] = []
    for family in range(sum(v.imag > 1e-6 * abs(v) for v in values)):
        try:
            found.append(lyapunov_family(system, saddle, energies=energies, family=family, progress=progress).members)
        except InputError:
            # It begins above all that the transfers reach.
            continue
    return found


def _closest(orbits: Sequence[LyapunovOrbit], times: Array, states: Array) -> ApproachNote:
    """Return where states (K, 2n) at `times` (K,) come closest to one of a family's orbits, or to its saddle."""
    first = orbits[0]
    away = first.system.scaled_distance(states[[0, -1]], first.centre)
    if away.min() < _MET:
        end = int(np.argmin(away))
        energy = equilibrium(first.system, first.saddle).energy
        return {"orbit": first.name, "distance": 0.0, "energy": energy, "time": float(times[-end])}
    found: list[tuple[float, float, float]] = []
    for orbit in orbits:
        distances = OrbitCurve(orbit).distances(states)[1]
        k = int(np.argmin(distances))
        found.append((float(distances[k]), orbit.energy, float(times[k])))
    distance, energy, time = min(found)
    return {"orbit": first.name, "distance": distance, "energy": energy, "time": time}
