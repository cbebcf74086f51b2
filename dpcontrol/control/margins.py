"""Stability margins of the loop with its filter.

The margins are those of gain, further delay and further lag.

Along the reference, the plant, the filter's state, the pending commands and a clock by phase form one linear system
from tick to tick. Law and filter are not modelled again. Their part is the Jacobian of the tick's expression
(`dpcontrol.control.tick`) at readings that equal the filter's prediction. The plant's part is the Jacobian of that
prediction.

    w_{k+1} = T_k w_k + b_k ā_k,   c_k = γ_k w_k,   ā_k: g · (c a delay D + d ago), through a lag τ, mean of period k

Here c is the command and D the assumed delay. The covariance is that of the loop, along the reference from the start or
until it has converged. It has no first-order effect, because it acts only on innovations, which are zero on the
reference. The supervisor has no effect either, since its limits are removed.

The criterion is the largest multiplier of w over a window. For a periodic motion (an orbit or an equilibrium), the
window is a period, the multipliers are the Floquet multipliers of the loop, and the limit is 1. Along a flight, windows
as long as a wobble slide along the reference. Slow errors, such as an unsettled zero, then grow and shrink slightly
from window to window, so the limit is `GROWTH`. On an orbit, both criteria agree within a few per cent, since the
multiplier of a loop that becomes unstable passes both limits at nearly the same point.

Gain g, delay d and lag τ are each changed alone. Within the margins, the feedback is stable for small errors. The
margins do not show how large an error it tolerates.

Sources: Åström & Murray, Feedback Systems (2008), section 9.3. Bittanti & Colaneri, Periodic Systems (2009), chapter 3.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.handover import Fly, Keep, Program
from dpcontrol.control.interface import MANY, Controller
from dpcontrol.control.lqr import HoldController
from dpcontrol.control.periodic import OrbitController
from dpcontrol.control.symbolic import SymbolicController
from dpcontrol.control.tick import UNROLLED, TickEquations, TickProgram
from dpcontrol.control.tracking import PhaseController, TimedController, TrackingController
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.shown import Brief

GROWTH = 1.5
"""Maximum growth of errors per wobble of a flight."""
REPEATED = 1.01
"""Maximum growth per period of a periodic motion; unexcited errors stay at 1 to rounding."""
_PERIODS = 8
"""Periods of an orbit, or wobbles of a hold, until the covariance counts as converged."""
_STEP = 0.5
"""Distance between the starts of windows, in wobbles."""
_WATCHED = frozenset(
    ("covariance", "velocity", "error", "nis", "silent", "restarts", "held", "moved", "restart", "stopped", "still",
     "cut", "was_untrusted", "last", "step", "same", "begin", "away", "origin", "timing", "timed",
     "lateness", "strain", "acted",
     "scale", "scale_covariance", "scale_read", "scale_waited", "scale_level", "scale_surprise", "evidence",
     "drive_watch")
)  # fmt: skip
"""Parts of a tick's memory without first-order effect on commands; see above."""
MOST_GAIN, MOST_DELAY, MOST_LAG = 64.0, 0.128, 0.512
"""Limits of the search: a factor, s, s."""
_FIRST_GAIN, _FIRST_TIME = 1.5, 1e-3
_HALVINGS = 6
_EDGE = 2
"""Windows at the start and at the end of a periodic section."""
_BATCH = 32
"""Number of windows that are computed together."""


@dataclass(frozen=True, eq=False)
class LinearLoop(Brief):
    """Linear loop of K ticks, `period` s apart, in w.

    Plant (N,), the tick's memory, a clock by phase.
    """

    period: float
    delay: float
    """Assumed delay, in periods."""
    moves: Array
    """T (K, d, d)."""
    pushes: Array
    """B (K, N)."""
    commands: Array
    """Γ (K, d)."""
    known_lag: float
    """Assumed lag, s."""
    shifts: Array | None = None
    """Change (K, d) of w per tick of lateness of the clock, its last entry; None without such a clock."""

    def transitions(self, first: NDArray[np.int_], count: int, *, gain: Array, delay: Array, lag: Array) -> Array:
        """Return the transitions (W, M, M) of several windows.

        The state is w, then the state of the lag, then the pending commands, oldest first.

        Args:
            first: first ticks (W,) of the windows.
            count: number of ticks of a window.
            gain: gain (W,) of the plant.
            delay: delay (W,) beyond the model, s.
            lag: lag (W,) beyond the model, s.
        """
        windows, size, inputs = len(first), self.moves.shape[1], self.pushes.shape[1]
        total = self.delay + delay / self.period
        whole = np.floor(total + 1e-9).astype(int)
        part = np.maximum(total - whole, 0.0)
        longest = int(whole.max()) + 1
        slots, each = longest + 1, np.arange(windows)
        state = np.zeros((windows, size, size + 1 + longest))
        state[:, np.arange(size), np.arange(size)] = 1.0
        lagging = np.zeros((windows, state.shape[2]))
        lagging[:, size] = 1.0
        sent = np.zeros((windows, slots, state.shape[2]))
        sent[:, np.arange(longest), size + 1 + np.arange(longest)] = 1.0
        slow = np.maximum(self.known_lag + lag, 1e-9)
        kept = np.exp(-self.period / slow)
        mean = slow / self.period * (1 - kept)
        now = longest
        for k in range(count):
            at = first + k
            sent[:, now] = (self.commands[at][:, None] @ state)[:, 0]
            newer, older = sent[each, (now - whole) % slots], sent[each, (now - whole - 1) % slots]
            acting = gain[:, None] * ((1 - part)[:, None] * newer + part[:, None] * older)
            pushed = acting + mean[:, None] * (lagging - acting)
            lagging = kept[:, None] * lagging + (1 - kept)[:, None] * acting
            state = self.moves[at] @ state
            state[:, :inputs] += self.pushes[at][:, :, None] * pushed[:, None]
            now = (now + 1) % slots
        order = (now + 1 + np.arange(longest)) % slots
        return np.concatenate([state, lagging[:, None], sent[:, order]], axis=1)

    def growth(
        self, first: NDArray[np.int_], count: int, *, gain: Any = 1.0, delay: Any = 0.0, lag: Any = 0.0
    ) -> Array:
        """Return the largest multiplier (W,) of each window.

        Args:
            first: first ticks (W,) of the windows.
            count: number of ticks of a window.
            gain: gain of the plant, a number or (W,), default 1.
            delay: delay beyond the model, s, a number or (W,), default 0.
            lag: lag beyond the model, s, a number or (W,), default 0.
        """
        changes = {"gain": gain, "delay": delay, "lag": lag}
        each = {name: np.broadcast_to(np.asarray(value, dtype=float), first.shape) for name, value in changes.items()}
        with np.errstate(over="ignore", invalid="ignore"):
            over = self.transitions(first, count, **each)
        if self.shifts is not None:
            # Pure lateness persists and is not an error, so other errors are measured relative to the clock.
            clock = self.moves.shape[1] - 1
            over[:, :clock] -= self.shifts[first + count - 1, :clock, None] * over[:, [clock]]
            over = np.delete(np.delete(over, clock, axis=1), clock, axis=2)
        sound = np.array([bool(np.isfinite(one).all()) for one in over])
        values = np.abs(np.linalg.eigvals(np.where(sound[:, None, None], over, 0.0))).max(axis=1)
        return np.where(sound, values, np.inf)


@dataclass(frozen=True, eq=False)
class Margins(Brief):
    """Gain, delay and lag margins of the loop in W windows.

    A margin at a bound of the search is at least that large. A window that is unstable without changes has margins of 1
    and 0.

    Attributes:
        limit: limit of this multiplier.
    """

    times: Array
    windows: Array
    limits: Array
    growth: Array
    """Largest multiplier (W,) without changes."""
    low: Array
    """Lower limit (W,) of the gain."""
    high: Array
    """Upper limit (W,) of the gain."""
    delay: Array
    """Further delay (W,) that is stable, s."""
    lag: Array
    """Further lag (W,) that is stable, s."""
    simulated: Mapping[str, tuple[float, float]] | None = field(default=None, kw_only=True)
    """Margins of the nonlinear run with times of loss in s (`dpcontrol.control.simulated_margins`); None for laws with
    their own clock."""

    @property
    def status(self) -> str:
        """Sentence on the margins and where they are smallest."""
        if self.simulated and not self.simulated["delay"][0]:
            return f"a run is lost after {self.simulated['delay'][1]:.2f} s even if the plant equals the model"
        if not self.simulated and not (self.growth <= self.limits).all():
            k = int(np.argmax(self.growth / self.limits))
            return (
                f"the loop is not stable at {self.times[k]:.2f} s even if the plant equals the model: errors grow by "
                f"{self.growth[k]:.3g} in {self.windows[k]:.2f} s"
            )
        bounds = {"gain_low": np.inf, "gain_high": MOST_GAIN, "delay": MOST_DELAY, "lag": MOST_LAG}
        said: dict[str, str] = {}
        for name, (value, time) in self.least().items():
            text = f"{value:.2g}" if name.startswith("gain") else f"{1e3 * value:.1f} ms"
            said[name] = f"{'at least ' if value >= bounds[name] else ''}{text}"
            if len(self.times) > 1 and np.isfinite(time):
                said[name] += f" (at {time:.1f} s)"
        return (
            f"gain {said['gain_low']} to {said['gain_high']}, further delay {said['delay']}, further lag {said['lag']}"
        )

    def least(self) -> dict[str, tuple[float, float]]:
        """Return each margin by name, with a time, s.

        The time is that of the loss or of the smallest margin. It is NaN at a bound of the search.
        """
        return dict(self.simulated or self.least_of_windows())

    def least_of_windows(self) -> dict[str, tuple[float, float]]:
        """Return the smallest margin over the windows by name.

        Each has the start of its window, s.
        """
        worst = {
            "gain_low": (self.low, np.argmax), "gain_high": (self.high, np.argmin), "delay": (self.delay, np.argmin),
            "lag": (self.lag, np.argmin),
        }  # fmt: skip
        found = {name: (values, int(which(values))) for name, (values, which) in worst.items()}
        return {name: (float(values[k]), float(self.times[k])) for name, (values, k) in found.items()}

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol plan --margins --json`."""
        along = {name: getattr(self, name).tolist() for name in _ALONG}
        least, windows = (
            {name: {"value": value, "time": time if np.isfinite(time) else None} for name, (value, time) in of.items()}
            for of in (self.least(), self.least_of_windows())
        )
        return {
            **least,
            "windows": windows,
            "simulated": self.simulated is not None,
            "growth": float((self.growth / self.limits).max()),
            "along": along,
            "status": self.status,
        }


_ALONG = ("times", "windows", "limits", "growth", "low", "high", "delay", "lag")


def law_margins(
    law: Any, program_of: Callable[[Controller], TickProgram], *, rate: float, wobble: float, repeats: bool, lags: bool
) -> Margins:
    """Return the margins of a loop whose arms match the model.

    Args:
        law: the control law.
        program_of: returns an initialised tick for a law; its supervisor must not interfere on the reference.
        rate: rate of the loop, Hz.
        wobble: length of windows along a flight, s.
        repeats: True if the reference is periodic with this length.
        lags: True if the model's drive lags.

    Raises:
        InputError: the law acts by pulses or not at all and so has no margins, or the delay is too long.
        GoalMissed: the loop does not stay on its reference.
    """
    found: list[Margins] = []
    kept: dict[int, Margins] = {}
    begins, covariance = 0.0, None
    for part in law.segments if isinstance(law, Program) else [law]:
        one: Any = part if part is law else part.controller
        settles = isinstance(one, OrbitController | HoldController)
        period = one.table.period if isinstance(one, OrbitController) else wobble
        window, lasts = max(round(period * rate), 1), one.ticks / rate
        if isinstance(part, Keep):
            lasts = part.wraps * period
        if id(one) not in kept or isinstance(part, Fly):
            timed = _by_the_clock(one, ticks=(_PERIODS + 1) * window, lags=lags)
            course = _Course(timed, program_of, covariance, lags=lags)
            covariance = course.covariance
            window = min(window, course.count)
            last, step = course.count - window, max(round(_STEP * window), 1)
            # A periodic motion differs at its start, while the filter's gains are still large, and at its closing.
            edge = range(0, min(_EDGE * window + 1, last), step)
            same = last if settles else last // 2 if repeats else -1
            if settles:
                first = np.array([*edge, last])
            elif repeats:
                first = np.array(sorted({*edge, same, *(last - k for k in edge)}))
            else:
                first = np.array([*range(0, last, step), last])
            limits = np.where(first == same, REPEATED, GROWTH)
            times = np.minimum(first * course.program.period, max(lasts - window / rate, 0.0))
            windows = np.full(len(first), window / rate)
            kept[id(one)] = Margins(times, windows, limits, *course.margins(first, window, limits))
        margins = kept[id(one)]
        if settles and found:
            # After a flight, a stay begins with a converged filter.
            margins = Margins(*(getattr(margins, name)[-1:] for name in _ALONG))
            margins = replace(margins, times=np.zeros(1))
        found.append(replace(margins, times=margins.times + begins))
        begins += lasts
    return Margins(*(np.concatenate([getattr(one, name) for one in found]) for name in _ALONG))


def _by_the_clock(law: Any, *, ticks: int, lags: bool) -> TimedController | PhaseController | HoldController:
    """Return a law as tabulated gains for `ticks` periods.

    By phase if the orbit's law goes by phase.

    Raises:
        InputError: the law acts by pulses, or has no gains.
    """
    if isinstance(law, HoldController):
        return replace(law, ticks=ticks)
    if isinstance(law, OrbitController):
        table, count = law.table, len(law.gains)
        states = table.state(np.arange(ticks + 1) * law.period, MANY)
        at = np.rint(np.arange(ticks) * law.period / table.step).astype(int) % count
        known: dict[str, Any] = {"kind": law.kind, "status": law.status, "reference_states": states}
        known |= {"feedforward": law.feedforward[at], "gains": law.gains[at]}
        # Its clock counts seconds, the other ticks.
        normals = law.normals[[*at, at[-1]]] / law.period
        # It has no gain on the acceleration of a lagging drive.
        drive = np.zeros((ticks + 1, 2)) if lags else None
        return PhaseController(**known, normals=normals) if law.by_phase else TimedController(**known, drive=drive)
    if not isinstance(law, TimedController | PhaseController):
        raise InputError(
            f'controller: kind = "{law.kind}" acts by pulses, which no gain, delay or lag margin describes; use '
            '"tvlqr", "adaptive" or "lqr" for margins'
        )
    if not law.gains.any() and not isinstance(law, SymbolicController):
        raise InputError(f'controller: kind = "{law.kind}" has no feedback and therefore no margins')
    return law


class _Course:
    """Inputs of a tick along a law's reference.

    Memory, reading and row are columns, one for each of K ticks.

    Arms and sensors match the model, so readings equal the filter's prediction.

    Raises:
        InputError: the law does not fit the arms.
        GoalMissed: the loop does not stay on its reference.
    """

    def __init__(
        self,
        law: TimedController | PhaseController | HoldController,
        program_of: Callable[[Controller], TickProgram],
        covariance: Array | None,
        *,
        lags: bool,
    ) -> None:
        self.phase = law if isinstance(law, PhaseController) else None
        if isinstance(law, PhaseController):
            # By time as long as there are no errors.
            drive = np.zeros((law.ticks + 1, 2)) if lags else None
            law = TrackingController(
                law.kind, law.reference_states, law.feedforward, law.gains, law.status, drive=drive
            )
        self.program = program = program_of(law)
        # The end of the reference truncates its last tick, at which a clock by phase stops.
        equations, self.count = program.equations, law.ticks - (program.lead + 3 if self.phase is not None else 0)
        if not equations.unrolled:
            raise InputError(
                f"drive: margins support delays of up to {UNROLLED} periods, not of {program.lead}; lower the "
                "rate, so that the same delay has fewer periods"
            )
        memory = equations.memory.slices
        if covariance is not None:
            program.memory[memory["covariance"]] = covariance[:, None]
        rows, sees = law.schedule(program.lead).rows, equations.filter.observation
        self.memory = np.empty((equations.memory.size, self.count))
        self.reading, self.row = np.empty((equations.reading.size, self.count)), rows[: self.count].T
        self.acting = np.empty(self.count)
        for k in range(self.count):
            self.memory[:, k] = program.memory[:, 0]
            program.take((sees @ self.memory[memory["z"], k])[:, None], None, 0, None)
            self.reading[:, k] = program.reading[:, 0]
            program.row[:] = rows[k, :, None]
            program.tick()
            self.acting[k] = program.report[program.at["acting"], 0]
            if program.report[program.at["notable"], 0]:
                raise GoalMissed(
                    f"no margins: without any disturbance the loop leaves its reference after {k * program.period:.3f} "
                    "s; inspect a run without mismatch"
                )
        self.covariance = program.memory[memory["covariance"], 0].copy()

    def margins(self, first: NDArray[np.int_], window: int, limits: Array) -> list[Array]:
        """Return growth and margins (W,) of windows.

        The windows begin at ticks `first`; see `Margins`.
        """
        parts: list[list[Array]] = []
        for k in range(0, len(first), _BATCH):
            batch = first[k : k + _BATCH]
            # Windows that are far apart are computed together: a stay has few long ones.
            ticks = np.unique(batch[:, None] + np.arange(window))
            loop, places = self.linear(ticks), np.searchsorted(ticks, batch)
            parts.append(_margins(loop, places, window, limits=limits[k : k + _BATCH]))
        return [np.concatenate(columns) for columns in zip(*parts, strict=True)]

    def linear(self, ticks: NDArray[np.int_]) -> LinearLoop:
        """Return the loop at `ticks` (K,)."""
        program, equations = self.program, self.program.equations
        count = len(ticks)
        numbers = np.tile(program.numbers[:, None], (1, count))
        where = equations.numbers.slices["parameters"]
        numbers[where] = equations.filter.equations.linear(numbers[where, 0])[:, None]
        size, arms = equations.filter.equations.dimension, equations.filter.arms
        sees = equations.filter.observation[:, :size]
        tick, kept = _tick_jacobian(equations)
        given = (self.memory[:, ticks], self.reading[:, ticks], self.row[:, ticks], numbers)
        jacobian = np.array(tick.map(count)(*given)).reshape(tick.size1_out(0), count, -1).transpose(1, 0, 2)
        predicted = _prediction_jacobian(equations)
        z = self.memory[equations.memory.slices["z"]][:, ticks]
        plant = np.array(predicted.map(count)(z, self.acting[None, ticks], numbers)).reshape(size, count, -1)
        plant = plant.transpose(1, 0, 2)
        # Columns: memory, measurement, feedforward. Rows: memory, command, predicted state.
        width = size + kept
        seen = np.zeros((count, kept + 1 + size, width))
        seen[:, :, :size] = jacobian[:, :, kept : kept + arms + 1] @ sees
        seen[:, :, size:] = jacobian[:, :, :kept]
        forward = jacobian[:, :, -1]
        if self.phase is not None:
            seen, forward = self._with_clock(self.phase, seen, forward, ticks)
        total = seen.shape[2]
        moves = np.zeros((count, total, total))
        moves[:, :size, :size] = plant[:, :, :size]
        moves[:, size : size + kept] = seen[:, :kept]
        if total > width:
            moves[:, width] = seen[:, -1]
        shifts = None if self.phase is None else _shifts(self.phase, total)[ticks + 1]
        delay = equations.whole + float(program.numbers[equations.numbers.slices["share"]][0])
        return LinearLoop(program.period, delay, moves, plant[:, :, -1], seen[:, kept], program.model.lag, shifts)

    def _with_clock(
        self, law: PhaseController, seen: Array, forward: Array, ticks: NDArray[np.int_]
    ) -> tuple[Array, Array]:
        """Append the clock's lateness, in ticks, to a tick's matrix.

        It is the last column and the last row.
        """
        count, rows, width = seen.shape
        size = len(law.first_state)
        acts = np.minimum(ticks + self.program.lead, law.ticks)
        rates = np.gradient(law.reference_states, axis=0)[acts]
        across, gains = law.normals[acts], law.gains[np.minimum(acts, law.ticks - 1)]
        out = np.zeros((count, rows + 1, width + 1))
        out[:, :rows, :width] = seen
        out[:, rows, :width] = np.einsum("kn,knw->kw", across, seen[:, rows - size :])
        out[:, rows, width] = 1 - (across * rates).sum(1)
        # The clock moves the reference state of the feedback.
        back = (gains * rates).sum(1)[:, None] * out[:, rows]
        out[:, :rows] += forward[:, :, None] * back[:, None]
        return out, forward


def _shifts(law: PhaseController, total: int) -> Array:
    """Return the difference (K+1, total) between plant and filter at successive ticks."""
    rates = np.gradient(law.reference_states, axis=0)
    size = len(law.first_state)
    out = np.zeros((len(rates), total))
    # The memory begins with the filter's state.
    out[:, :size] = out[:, size : 2 * size] = rates
    out[:, -1] = 1.0
    return out


@lru_cache(maxsize=8)
def _tick_jacobian(equations: TickEquations) -> tuple[ca.Function, int]:
    """Return the Jacobian of a tick, and the memory's length.

    The function maps (memory, reading, row, numbers) to the Jacobian of memory, command and predicted state.

    The derivatives are with respect to the relevant parts of the memory, the measurement and the feedforward.
    """
    layouts = {"memory": equations.memory, "reading": equations.reading, "row": equations.row}
    inputs = {name: layout.symbols(name) for name, layout in {**layouts, "numbers": equations.numbers}.items()}
    whole = {name: vector for name, (vector, _) in inputs.items()}
    parts = [name for name in equations.memory.slices if name not in _WATCHED]
    out, report = equations.function()(*whole.values()), equations.report.slices
    begins = equations.memory.size
    rows = [out[equations.memory.slices[name]] for name in parts]
    rows += [out[begins + report[name].start : begins + report[name].stop] for name in ("command", "ahead")]
    columns = [inputs["memory"][1][name] for name in parts]
    columns += [inputs["reading"][1]["measured"], inputs["row"][1]["feedforward"]]
    jacobian = ca.densify(ca.jacobian(ca.vertcat(*rows), ca.vertcat(*columns)))
    made = ca.Function("tick_jacobian", [*whole.values()], [ca.cse(jacobian)], {"cse": True})
    return made, sum(column.shape[0] for column in columns[:-2])


@lru_cache(maxsize=8)
def _prediction_jacobian(equations: TickEquations) -> ca.Function:
    """Return (z, command, numbers) -> Jacobian of the next state.

    The Jacobian (N, N+1) is that by state and command.
    """
    size = equations.filter.equations.dimension
    z, command = ca.SX.sym("z", equations.filter.dimension), ca.SX.sym("command")
    numbers = ca.SX.sym("numbers", equations.numbers.size)
    # A drive that already gives its command.
    following = equations.moved()(z, command, command, numbers)[:size]
    jacobian = ca.densify(ca.jacobian(following, ca.vertcat(z[:size], command)))
    return ca.Function("prediction_jacobian", [z, command, numbers], [ca.cse(jacobian)], {"cse": True})


def _margins(loop: LinearLoop, first: NDArray[np.int_], window: int, *, limits: Array) -> list[Array]:
    """Return growth and margins (W,) of windows, as `Margins` has them."""
    growth = loop.growth(first, window)
    sound = growth <= limits

    def border(change: Callable[[Array], dict[str, Array]], start: float, factor: float, most: float) -> Array:
        """Return the largest stable changes (W,).

        Start · factor^k is tried, then the step is halved.
        """
        inside, outside = np.full(len(first), np.nan), np.full(len(first), np.nan)
        open_, value = np.flatnonzero(sound), start
        while len(open_):
            stable = loop.growth(first[open_], window, **change(np.full(len(open_), value))) <= limits[open_]
            outside[open_[~stable]] = value
            inside[open_[stable]] = value
            open_ = open_[stable]
            if value >= most:
                break
            value = min(value * factor, most)
        searched = np.flatnonzero(np.isfinite(outside))
        for _ in range(_HALVINGS if len(searched) else 0):
            low = np.where(np.isnan(inside[searched]), outside[searched] / factor, inside[searched])
            middle = np.sqrt(low * outside[searched])
            stable = loop.growth(first[searched], window, **change(middle)) <= limits[searched]
            inside[searched] = np.where(stable, middle, low)
            outside[searched] = np.where(stable, outside[searched], middle)
        return inside

    times = {"start": _FIRST_TIME, "factor": 2.0}
    low = 1 / border(lambda v: {"gain": 1 / v}, _FIRST_GAIN, _FIRST_GAIN, MOST_GAIN)
    high = border(lambda v: {"gain": v}, _FIRST_GAIN, _FIRST_GAIN, MOST_GAIN)
    delay = border(lambda v: {"delay": v}, most=MOST_DELAY, **times)
    lag = border(lambda v: {"lag": v}, most=MOST_LAG, **times)
    unstable = ((low, 1.0), (high, 1.0), (delay, 0.0), (lag, 0.0))
    return [growth, *(np.where(sound, values, none) for values, none in unstable)]
