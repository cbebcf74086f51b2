"""Which zeros and counts keep an orbit by OGY: the loop to first order with its readings rounded, without a run.

    x_i = A_i x_{i-1} + B_i p s_i                                     state less the orbit's, under pulses of shape s
    η_i = q round((θ*_i + C x_i + z) / q) - (θ*_i + C x_i)            what readings add: counts of q rad, zeros z
    e_i = Φ_i e_{i-1} + G_i η_i                                       estimate less state, by the filter's gain G
    at section j:  x ← x - ẋ* n·(x + e),    p = -K_j (x + e),  |p| ≤ limit;     lost: |w_j·x| > c_j limit

Rounding is no white noise here. It repeats with the orbit from period to period, so that what survives one survives
most; and where an arm moves whole counts in a tick at a section, readings err alike for several ticks, so that more
counts can be worse. So these recursions are iterated for as long as a run lasts, for zeros spread evenly within a count
and with pulses cut at their limit. That is no run: there is no plant, nothing nonlinear but rounding and limit, and no
lab's loop; the filter gives its gains along the orbit.

Source: Widrow & Kollár, Quantization Noise (2008), for rounding in feedback; Roberts, The unreasonable
effectiveness of quasirandom sequences (2018), for the lattice.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpcontrol.bench.ogy_borders import ESTIMATOR, Sections, Task, encoders
from dpcontrol.control.ekf import EkfProgram
from dpcontrol.control.ogy import OgyController

Array = NDArray[np.float64]

LANES = 256
_PERIODS = 3
"""After so many the filter's gains repeat themselves."""
_FAR = 1e3
"""What is lost grows no further than to this."""


@dataclass(frozen=True, eq=False)
class Gait:
    """A period in ticks, from the first section on: states (M, N) and inputs (M,) of the orbit, and A (M, N, N), B
    (M, N) from each tick to the next; ends (k + 1,): the ticks of the sections.
    """

    states: Array
    inputs: Array
    matrices: Array
    responses: Array
    ends: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Stretch:
    """From one section to the next in T ticks, to first order in the state x (N,) there and its pulse p.

    matrix (N, N), response (N,): the state at the end. joints (T n,): the orbit's relative angles at the ticks;
    by_state (T n, N), by_pulse (T n,): how they change.
    """

    matrix: Array
    response: Array
    joints: Array
    by_state: Array
    by_pulse: Array


@dataclass(frozen=True, eq=False)
class Heard:
    """What the filter makes of readings of so many counts: `first` (N, n) of those at the first tick; then for each
    stretch of the first periods `kept` (N, N) of the errors before it and `taken` (N, T n) of what readings add.
    """

    counts: float
    first: Array
    kept: tuple[Array, ...]
    taken: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Foresight:
    """The loop of one orbit and law, to first order."""

    sections: Sections
    controller: OgyController
    gait: Gait
    stretches: tuple[Stretch, ...]

    def heard(self, counts: float) -> Heard:
        """Return what the filter makes of readings of `counts` per turn, its gains those along the orbit."""
        task, gait = self.sections.task, self.gait
        gains = _gains(task, gait, counts)
        count, arms, position = len(gait.states), task.arms.count, task.model.position_indices
        # Outer arms carry what the joints within add.
        shown = np.vstack([np.tril(np.ones((arms, arms))), np.zeros((1, arms))])
        kept, taken = [], []
        for period in range(_PERIODS):
            for begin, end in zip(gait.ends[:-1].tolist(), gait.ends[1:].tolist(), strict=True):
                rest, parts = np.eye(task.model.dimension), []
                for i in reversed(range(begin, end)):
                    gain, moved = gains[period * count + i + 1], gait.matrices[i]
                    parts.append(rest @ gain @ shown)
                    rest = rest @ (moved - gain @ moved[position])
                kept.append(rest)
                taken.append(np.hstack(parts[::-1]))
        return Heard(counts, gains[0] @ shown, tuple(kept), tuple(taken))

    def held(self, heard: Heard, zeros: Array, *, counts: ArrayLike, limits: ArrayLike) -> NDArray[np.bool_]:
        """Return which of S runs hold the orbit for as long as it is to be held.

        zeros (n, S): in counts; counts: per turn, near to those of `heard`; limits: of the pulses, m/s²; each a number
        or (S,).
        """
        law, maps = self.controller, self.sections.maps
        arms, k, runs = len(zeros), len(maps), zeros.shape[1]
        q = 2 * np.pi / np.rint(counts)
        z = zeros * q
        x, holds = np.zeros((len(law.first_state), runs)), np.ones(runs, dtype=bool)
        e = heard.first @ _added(_joints(self.gait.states[0], arms)[None, :, None], z, q)[0]
        for t in range(int(self.sections.task.seconds / self.sections.task.orbit.period * k)):
            j = t % k
            one, start = self.stretches[j], maps[j].start
            late = start.normal @ (x + e)
            x = x - start.rate[:, None] * late
            holds &= np.abs(self.sections.directions[j] @ x) <= limits * self.sections.ranges[j]
            p = np.clip(-law.gains[j] @ (start.projection @ (x + e)), -np.asarray(limits), limits)
            angles = one.joints[:, None] + one.by_state @ x + one.by_pulse[:, None] * p
            added = _added(angles.reshape(-1, arms, runs), z, q).reshape(-1, runs)
            place = t if t < len(heard.kept) else len(heard.kept) - k + j
            e = heard.kept[place] @ e + heard.taken[place] @ added
            x = np.clip(one.matrix @ x + one.response[:, None] * p, -_FAR, _FAR)
        return holds


def foresight(sections: Sections, controller: OgyController) -> Foresight:
    """Return the loop of this law, to first order."""
    task = sections.task
    orbit, model = task.orbit, task.model
    count, k = round(orbit.period / model.period), len(sections.maps)
    step = orbit.period / count
    times = sections.maps[0].start.time + np.arange(count) * step
    states, inputs = orbit.state(times), orbit.input(times + step / 2)
    gait = Gait(states, inputs, *model.linearised(states, inputs), np.rint(np.arange(k + 1) * count / k).astype(int))
    found = []
    for begin, end in zip(gait.ends[:-1].tolist(), gait.ends[1:].tolist(), strict=True):
        matrix, response, all_states, all_pulses = np.eye(model.dimension), np.zeros(model.dimension), [], []
        for i in range(begin, end):
            shape = float(sections.maps[0].pulse((i - begin + 0.5) * step))
            matrix, response = gait.matrices[i] @ matrix, gait.matrices[i] @ response + shape * gait.responses[i]
            all_states.append(_joints(matrix.T, task.arms.count).T)
            all_pulses.append(_joints(response, task.arms.count))
        ticks = np.arange(begin + 1, end + 1) % count
        joints = _joints(states[ticks], task.arms.count).ravel()
        found.append(Stretch(matrix, response, joints, np.concatenate(all_states), np.concatenate(all_pulses)))
    return Foresight(sections, controller, gait, tuple(found))


def spread(size: int, kinds: int) -> Array:
    """Return `size` points (kinds, size) spread evenly between 0 and 1: a lattice by powers of the root of
    g^(kinds + 1) = g + 1.
    """
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (kinds + 1))
    return np.mod(0.5 + np.arange(1, size + 1) * root ** -np.arange(1.0, kinds + 1)[:, None], 1.0)


def _joints(states: Array, arms: int) -> Array:
    """Return the relative angles (…, n) of states (…, N)."""
    out = states[..., :arms].copy()
    out[..., 1:] -= states[..., : arms - 1]
    return out


def _added(angles: Array, zeros: Array, q: Array) -> Array:
    """Return what readings add to relative angles (T, n, S) with zeros (n, S) and counts of q (S,), rad."""
    return q * np.rint((angles + zeros) / q) - angles


def _gains(task: Task, gait: Gait, counts: float) -> Array:
    """Return the filter's gains (_PERIODS M + 1, N, n + 1) for readings along the orbit, from a run's first tick on."""
    noise, arms = encoders(counts).covariance(task.arms.count), task.arms.count
    program, n = EkfProgram(task.model, ESTIMATOR), task.model.dimension
    where, sizes, count = program.slices, np.sqrt(np.diag(noise)), len(gait.states)
    lanes = program.inputs(noise, runs=arms + 2)
    out = np.empty((program.step.size_out, arms + 2))
    memory, found = program.first(gait.states[0]), np.empty((_PERIODS * count + 1, n, arms + 1))
    # Each reading is nudged by its own noise: the estimate is linear in it.
    nudges = np.hstack([np.zeros((arms + 1, 1)), np.diag(sizes)])
    for i in range(len(found)):
        if i:
            memory[:n] = gait.states[(i - 1) % count]
        lanes[where["memory"]] = memory[:, None]
        lanes[where["command"]] = gait.inputs[(i - 1) % count]
        lanes[where["measured"]] = gait.states[i % count, task.model.position_indices, None] + nudges
        (program.step if i else program.update)(lanes, out)
        found[i] = (out[:n, 1:] - out[:n, :1]) / sizes
        memory = out[program.out["memory"], 0].copy()
    return found
