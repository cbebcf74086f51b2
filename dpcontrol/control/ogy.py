"""OGY control: an unstable orbit held by one pulse of bounded size from each section to the next.

    at the crossing of section j:   clock := phase of section j,   ξ = x̂ - x*,   p_j = -K_j ξ - s_j · δ̂,  |p_j| ≤ limit
    until section j+1:              u(s) = u*(clock) + p_j sin(π s / duration)

Classic OGY aims the pulse so that the unstable direction vanishes at the next section, p_j = -(f·A_j ξ)/(f·B_j), f the
left eigenvector of the map around the period at section j+1; nothing then holds the cart, and nothing makes up for a
plant that differs from the model. The other law is linear-quadratic over all sections, cart included, and learns (see
`section_law`). An error q grows to q λ in a period: at one section a period no pulse of either law is right.
Source: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), 1196.

Pulses from section to section: linear-quadratic, classic, and corrected by what a run teaches about the plant.

    ξ_{j+1} = A_j ξ_j + B_j p_j + D_j δ,        p_j = -K_j ξ_j - s_j · δ̂

K from the periodic Riccati equation. δ: relative errors of the model's base parameters. A plant that differs from the
model has another orbit, and a law that aims for the model's fights the difference at every section. After each
section what the model foresaw is compared with what came, D_j δ, and δ̂ follows by a Kalman filter (recursive least
squares with prior and drift). s is the optimum for a disturbance D_j δ known for all sections to come:

    s_j = (r + BᵀP_{j+1}B)⁻¹ Bᵀ v_j,    v_j = P_{j+1} D_j + g_{j+1},    g_j = (A_j - B_j K_j)ᵀ v_j

Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 3.4 (known disturbances) and 4.3; Åström &
Wittenmark, Adaptive Control, section 2.2, for the least squares.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import Action, Mode, SampledModel
from dpcontrol.control.lqr import QuadraticWeights
from dpcontrol.control.periodic import check_orbit, periodic_gains
from dpcontrol.control.phase import PhaseTable, phase_table
from dpcontrol.control.tracking import riccati_gains
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import Settings, setting

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SectionMap, SustainedOrbit

Array = NDArray[np.float64]

ANGLE_ERROR, RATE_ERROR = 3e-4, 0.05
"""rad and rad/s: what an estimate from 40,000 counts may be off by while an arm swings."""
DRIFT = 0.02
"""Share of its prior by which a parameter's error may change from section to section."""
_FRICTION = 5.0
"""Friction is known five times worse than inertia."""
_STEP = 5e-4
"""s: of the flights whose differences are the sensitivities; their own error is far below that of the differences."""
_DIFFERENCE = 1e-3
_SETTLED = 1e-9
_MOST_PERIODS = 5000


@dataclass(frozen=True, eq=False)
class Learning:
    """What sections teach: sensitivities D (k, 2n, m), noise (k, 2n, 2n), shifts s (k, m) in m/s², prior (m, m)."""

    sensitivities: Array
    noise: Array
    shifts: Array
    prior: Array

    def updated(self, section: NDArray[np.intp] | int, guess: Array, covariance: Array, surprise: Array
                ) -> tuple[Array, Array]:  # fmt: skip
        """Return δ̂ (…, m) and its covariance (…, m, m) after the flights from `section` (…).

        surprise (…, 2n): the pendulum's state on the section it came to, less what the model foresaw.
        """
        d = self.sensitivities[section]
        spread = covariance + DRIFT**2 * self.prior
        there = d @ spread
        total = there @ np.swapaxes(d, -1, -2) + self.noise[section]
        gain = np.swapaxes(np.linalg.solve(total, there), -1, -2)
        news = surprise - (d @ guess[..., None])[..., 0]
        return guess + (gain @ news[..., None])[..., 0], spread - gain @ there


def section_gains(maps: "tuple[SectionMap, ...]", *, weights: Array, effort: float) -> Array:
    """Return the gains (k, N) of the periodic Riccati equation of the section maps.

    Raises:
        GoalMissed: the recursion does not settle.
    """
    matrices, responses = _arrays(maps)
    return periodic_gains(matrices, responses, weights=weights, effort=effort)


def classic_gains(maps: "tuple[SectionMap, ...]") -> Array:
    """Return the gains (k, N) whose pulses take the unstable direction to zero at the next section.

    Raises:
        GoalMissed: a pulse does not move the unstable direction.
    """
    gains = []
    for j, here in enumerate(maps):
        product = np.eye(len(here.response))
        for later in maps[j + 1 :] + maps[: j + 1]:
            product = later.matrix @ product
        values, left = np.linalg.eig(product.T)
        direction = np.real(left[:, np.argmax(np.abs(values))])
        reach = float(direction @ here.response)
        if abs(reach) <= 1e-12 * float(np.linalg.norm(here.response)):
            raise GoalMissed(f"a pulse after section {j + 1} does not move the unstable direction; take more sections")
        gains.append(direction @ here.matrix / reach)
    return np.array(gains)


def parameter_directions(equations: Equations, parameters: Array) -> Array:
    """Return changes (m, p) of base parameters by their own size: inertia, weights with couplings, friction × 5.

    Weight G_i and coupling S_i = G_i/g belong together: no bench changes gravity.
    """
    n = (equations.dimension - 2) // 2
    inertias = n * (n + 1) // 2
    rows = []
    for i in range(inertias + n):
        row = np.zeros(len(parameters))
        row[i] = parameters[i]
        if i >= inertias:
            row[i + n] = parameters[i + n]
        rows.append(row)
    for i in range(inertias + 2 * n, len(parameters)):
        row = np.zeros(len(parameters))
        row[i] = _FRICTION * parameters[i]
        rows.append(row)
    return np.array(rows)


def sensitivities(orbit: "SustainedOrbit", maps: "tuple[SectionMap, ...]", directions: Array) -> Array:
    """Return D (k, N, m): how the ends of flights between sections change with plants along `directions` (m, p).

    By central differences of Runge-Kutta flights under the orbit's input.
    """
    k, m, duration = len(maps), len(directions), maps[0].duration
    count = max(int(np.ceil(duration / _STEP)), 1)
    step = duration / count
    function = orbit.equations.discrete_step(step)
    plain = function.factory("plain", function.name_in(), [function.name_out(0)]).map(2 * m * k)
    change = _DIFFERENCE * np.concatenate([directions, -directions])
    parameters = np.tile((orbit.parameters + change).T, (1, k))
    states = np.repeat(np.array([a.start.state for a in maps]), 2 * m, axis=0).T
    begins = np.array([a.start.time for a in maps])
    for i in range(count):
        inputs = np.repeat(orbit.input(begins + (i + 0.5) * step), 2 * m)[None, :]
        states = np.array(plain(states, inputs, parameters))
    flown = states.T.reshape(k, 2, m, -1)
    apart = (flown[:, 0] - flown[:, 1]) / (2 * _DIFFERENCE)
    return np.array([a.end.projection @ apart[j].T for j, a in enumerate(maps)])


def learning(
    orbit: "SustainedOrbit",
    maps: "tuple[SectionMap, ...]",
    gains: Array,
    *,
    weights: Array,
    effort: float,
    share: float,
) -> Learning:
    """Return what the sections teach about parameters of which each may be off by `share`; gains of `section_gains`.

    Raises:
        GoalMissed: the shifts do not settle.
    """
    directions = parameter_directions(orbit.equations, orbit.parameters)
    # A parameter that is zero has no relative error.
    directions = directions[np.abs(directions).sum(1) > 0]
    d = sensitivities(orbit, maps, directions)
    n, m = d.shape[1] - 2, len(directions)
    spread = np.array([ANGLE_ERROR**2] * (n // 2) + [RATE_ERROR**2] * (n // 2))
    noise = []
    for here in maps:
        before, after = here.matrix[:n, :n], here.end.projection[:n, :n]
        # The smallest of them keeps the direction along the orbit, which the section leaves out, from being singular.
        noise.append((before * spread) @ before.T + (after * spread) @ after.T + ANGLE_ERROR**2 * np.eye(n))
    shifts = disturbance_shifts(maps, gains, d, weights=weights, effort=effort)
    return Learning(d[:, :n], np.array(noise), shifts, share**2 * np.eye(m))


def disturbance_shifts(
    maps: "tuple[SectionMap, ...]", gains: Array, disturbances: Array, *, weights: Array, effort: float
) -> Array:
    """Return s (k, m): how much less to pulse for each unit of the known periodic disturbances D (k, N, m).

    Raises:
        GoalMissed: they do not settle.
    """
    matrices, responses = _arrays(maps)
    count, size, kinds = disturbances.shape
    costs = [np.diag(weights)] * (count + 1)
    g = np.zeros((size, kinds))
    before = np.full((count, kinds), np.inf)
    shifts = np.zeros((count, kinds))
    for _ in range(_MOST_PERIODS):
        costs[count] = costs[0]
        for j in range(count - 1, -1, -1):
            a, b = matrices[j], responses[j]
            _, costs[j] = riccati_gains(a[None], b[None], weights=weights, effort=effort, terminal=costs[j + 1])
            v = costs[j + 1] @ disturbances[j] + g
            shifts[j] = b @ v / (effort + b @ costs[j + 1] @ b)
            g = (a - np.outer(b, gains[j])).T @ v
        if np.abs(shifts - before).max() <= _SETTLED * max(np.abs(shifts).max(), 1e-300):
            return shifts
        before = shifts.copy()
    raise GoalMissed(
        "the pulses for a plant that differs from the model did not settle; take more sections in a period"
    )


def _arrays(maps: "tuple[SectionMap, ...]") -> tuple[Array, Array]:
    return np.array([m.matrix for m in maps]), np.array([m.response for m in maps])


_EARLY = 0.125
"""Share of a period by which a crossing may come before or after its time, and no more than half way to the next."""


@dataclass(frozen=True)
class ClassicOgySettings(Settings, table="controller"):
    """OGY as published: sections in a period, and the largest pulse in m/s²."""

    kind: str = "ogy-classic"
    sections: int = setting(16, least=1, most=1000)
    pulse_limit: float = setting(5.0, above=0, unit="m/s²")


@dataclass(frozen=True)
class OgySettings(QuadraticWeights):
    """OGY with linear-quadratic pulses: sections in a period, and the largest pulse in m/s².

    parameter_error: share by which the plant's inertial parameters may differ from the model's, friction five times
    as much; what a run shows of them corrects the pulses. Zero: nothing is learnt.
    """

    position: float = 30.0
    velocity: float = 3.0
    effort: float = 0.3
    kind: str = "ogy"
    sections: int = setting(16, least=1, most=1000)
    pulse_limit: float = setting(5.0, above=0, unit="m/s²")
    parameter_error: float = setting(0.05, least=0, most=1)


@dataclass(frozen=True, eq=False)
class OgyController:
    """Sections (k) with their times (k,) s, states, normals and gains (k, N), and the pendulum's projections onto them
    (k, 2n, 2n); pulses of `duration` s.

    model: foresees where a flight between sections comes to; learning: None if nothing is to be learnt; ticks: for how
    long.
    """

    kind: str
    table: PhaseTable
    times: Array
    states: Array
    normals: Array
    projections: Array
    gains: Array
    duration: float
    pulse_limit: float
    model: SampledModel
    learning: Learning | None
    ticks: int
    status: str

    @property
    def first_state(self) -> Array:
        """Return the state (N,) from which it starts: the orbit at its first section, so that a pulse comes at once."""
        return self.states[0]

    @property
    def window(self) -> float:
        """Return by how many seconds a crossing may be off its time."""
        return min(self.duration / 2, _EARLY * self.table.period)

    def begin(self) -> "OgySession":
        """Return a fresh session for one run."""
        return OgySession(self)

    def begin_runs(self, count: int) -> "OgyRuns":
        """Return what answers `commands` for `count` runs, each with a clock and so with a reference of its own."""
        return OgyRuns(self, count)

    def join(self, tick: int, state: Array) -> "OgySession":
        """Return a session that starts at `tick` from `state` (N,), at the nearest phase and on its turns."""
        session = self.begin()
        session.resynchronise(tick, state)
        return session

    def distance(self, state: Array) -> float:
        """Return the scaled distance of the pendulum's `state` (N,) from the orbit, modulo turns."""
        return float(self.table.nearest(state)[1])


class OgySession:
    """The section crossed last, the time since, the pulse under way; and what was learnt about the plant."""

    def __init__(self, controller: OgyController) -> None:
        self._law = controller
        self._tick = 0
        self._lift = np.zeros(len(controller.first_state))
        # As if the last section had just been left behind: the first is crossed at once.
        self._section = len(controller.times) - 1
        self._elapsed = controller.duration
        self._pulse = 0.0
        self._sent = 0.0
        self._foreseen: Array | None = None
        if controller.learning is not None:
            self._guess = np.zeros(len(controller.learning.prior))
            self._covariance = controller.learning.prior
        self.crossings = 0

    @property
    def time(self) -> float:
        """Return the time on the orbit's clock in s."""
        return (float(self._law.times[self._section]) + self._elapsed) % self._law.table.period

    @property
    def orbit_period(self) -> float:
        """Return the orbit's period in s."""
        return self._law.table.period

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return what to do in the period from `tick` at `state` (N,)."""
        law, event = self._law, ""
        period = law.model.period
        passed = tick - self._tick
        self._elapsed += passed * period
        self._tick = tick
        x = state - self._lift
        if self._foreseen is not None:
            self._foreseen = law.model.step(self._foreseen, self._sent) if passed == 1 else None
        if self._elapsed > law.duration - law.window:
            ahead = self._section + 1 if self._section + 1 < len(law.times) else 0
            late = float((x - law.states[ahead]).dot(law.normals[ahead]))
            if late >= 0.0:
                self._cross(ahead, min(late, law.window), x)
            elif self._elapsed > law.duration + law.window:
                event = f"section {ahead + 1} was not crossed: " + self.resynchronise(tick, state)
        clock = float(law.times[self._section]) + self._elapsed
        middle = self._elapsed + period / 2
        feedback = 0.0
        if self._pulse and middle < law.duration:
            feedback = self._pulse * float(np.sin(np.pi * middle / law.duration))
        feedforward = law.table.input(clock + period / 2)
        self._sent = feedforward + feedback
        mode = Mode.PULSING if feedback else Mode.HOLDING
        return Action(feedforward, feedback, law.table.state(clock) + self._lift, mode, event)

    def _cross(self, section: int, late: float, x: Array) -> None:
        law = self._law
        if law.learning is not None and self._foreseen is not None:
            n = len(x) - 2
            surprise = law.projections[section].dot(x[:n] - self._foreseen[:n])
            self._guess, self._covariance = law.learning.updated(self._section, self._guess, self._covariance, surprise)
        self._section, self._elapsed, self._foreseen = section, late, x
        away = x - law.table.state(float(law.times[section]) + late)
        pulse = -float(law.gains[section].dot(away))
        if law.learning is not None:
            pulse -= float(law.learning.shifts[section].dot(self._guess))
        self._pulse = min(max(pulse, -law.pulse_limit), law.pulse_limit)
        self.crossings += 1

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the clock to the phase nearest to `state` (N,); say by how much. The next crossing starts a pulse."""
        law = self._law
        expected = self.time + (tick - self._tick) * law.model.period
        time, _, turns = law.table.nearest(state)
        since = np.mod(float(time) - law.times, law.table.period)
        self._section = int(np.argmin(since))
        self._elapsed, self._tick, self._pulse = float(since[self._section]), tick, 0.0
        self._lift = np.concatenate([turns, np.zeros(len(state) - len(turns))])
        self._foreseen = None
        half = law.table.period / 2
        return f"clock of the orbit moved by {(float(time) - expected + half) % (2 * half) - half:+.4f} s"


class OgyRuns:
    """`OgySession`'s arithmetic for `count` runs in lockstep, all from the first state and at every tick of the loop.

    Runs cross their sections at different ticks, so that each has a clock of its own.
    """

    def __init__(self, controller: OgyController, count: int) -> None:
        self._law = controller
        self._tick = 0
        self._lift = np.zeros((count, len(controller.first_state)))
        self._section = np.full(count, len(controller.times) - 1)
        self._elapsed = np.full(count, controller.duration)
        self._pulse, self._sent = np.zeros(count), np.zeros(count)
        self._foreseen = np.zeros((count, len(controller.first_state)))
        self._flying = np.zeros(count, dtype=bool)
        if controller.learning is not None:
            self._guess = np.zeros((count, len(controller.learning.prior)))
            self._covariance = np.tile(controller.learning.prior, (count, 1, 1))
            self._prepare(count)
        self.missed = np.zeros(count, dtype=int)
        """How often a run did not cross the section it came from."""
        self.cut = np.zeros(count, dtype=int)
        """How many of a run's pulses were cut at the limit."""

    def _prepare(self, count: int) -> None:
        model = self._law.model
        function = model.equations.discrete_step(model.period)
        names = function.name_in()
        self._step = Compiled(function.factory("plain", names, [function.name_out(0)]))
        self._slices = [self._step.slices[name] for name in names]
        self._inputs = np.zeros((self._step.size_in, count))
        self._inputs[self._slices[2]] = model.parameters[:, None]

    def commands(self, tick: int, states: Array, extras: Array | None = None) -> tuple[Array, Array, Array]:
        """Return feedforwards (S,), feedbacks (S,) in m/s² and references (N, S) for `states` (N, S) at `tick`."""
        law = self._law
        period = law.model.period
        passed = tick - self._tick
        self._elapsed += passed * period
        self._tick = tick
        x = states.T - self._lift
        if law.learning is not None and passed == 1:
            self._inputs[self._slices[0]], self._inputs[self._slices[1]] = self._foreseen.T, self._sent
            self._foreseen = self._step(self._inputs, np.empty(states.shape)).T
        elif passed:
            self._flying[:] = False
        ahead = (self._section + 1) % len(law.times)
        late = ((x - law.states[ahead]) * law.normals[ahead]).sum(1)
        near = self._elapsed > law.duration - law.window
        crossing = np.flatnonzero(near & (late >= 0.0))
        if len(crossing):
            self._cross(crossing, ahead[crossing], np.minimum(late[crossing], law.window), x[crossing])
        missed = np.flatnonzero(near & (late < 0.0) & (self._elapsed > law.duration + law.window))
        if len(missed):
            self._resynchronise(missed, states[:, missed].T)
        clock = law.times[self._section] + self._elapsed
        middle = self._elapsed + period / 2
        feedback = np.where(middle < law.duration, self._pulse * np.sin(np.pi * middle / law.duration), 0.0)
        table = law.table
        entries = np.rint(np.mod(clock + period / 2, table.period) / table.step).astype(int)
        feedforward = table.inputs[entries]
        self._sent = feedforward + feedback
        return feedforward, feedback, (table.states_at(clock) + self._lift).T

    def _cross(self, runs: NDArray[np.intp], section: NDArray[np.intp], late: Array, x: Array) -> None:
        law = self._law
        if law.learning is not None:
            taught = self._flying[runs]
            who, n = runs[taught], x.shape[1] - 2
            away = (x[taught] - self._foreseen[who])[:, :n]
            surprise = (law.projections[section[taught]] @ away[..., None])[..., 0]
            self._guess[who], self._covariance[who] = law.learning.updated(
                self._section[who], self._guess[who], self._covariance[who], surprise
            )
        self._section[runs], self._elapsed[runs] = section, late
        self._foreseen[runs], self._flying[runs] = x, True
        pulse = -(law.gains[section] * (x - law.table.states_at(law.times[section] + late))).sum(1)
        if law.learning is not None:
            pulse -= (law.learning.shifts[section] * self._guess[runs]).sum(1)
        self._pulse[runs] = np.clip(pulse, -law.pulse_limit, law.pulse_limit)
        self.cut[runs] += np.abs(pulse) > law.pulse_limit

    def _resynchronise(self, runs: NDArray[np.intp], states: Array) -> None:
        law = self._law
        times, _, turns = law.table.nearest(states)
        since = np.mod(times[:, None] - law.times, law.table.period)
        self._section[runs] = np.argmin(since, axis=1)
        self._elapsed[runs] = since.min(1)
        self._pulse[runs], self._flying[runs] = 0.0, False
        self._lift[runs, : turns.shape[1]] = turns
        self.missed[runs] += 1


def ogy_controller(
    orbit: "SustainedOrbit", model: SampledModel, settings: OgySettings | ClassicOgySettings, *, seconds: float
) -> OgyController:
    """Return the controller that holds `orbit` for `seconds` by pulses.

    Raises:
        InputError: the orbit did not converge or is of other arms, or its sections come faster than every second tick.
        GoalMissed: the section maps cannot be stabilised.
    """
    check_orbit(orbit, model)
    duration = orbit.period / settings.sections
    if duration < 2 * model.period:
        raise InputError(
            f"controller: sections = {settings.sections}: a pulse would last {duration:.2g} s, less than two ticks of "
            f"{model.period:g} s; take at most {int(orbit.period / (2 * model.period))}"
        )
    maps = orbit.section_maps(settings.sections)
    learnt = None
    if isinstance(settings, ClassicOgySettings):
        gains = classic_gains(maps)
    else:
        # The square of a half-sine of height 1 is a half on average.
        weights, effort = settings.weights(model.arms, duration)
        gains = section_gains(maps, weights=weights, effort=effort / 2)
        if settings.parameter_error:
            learnt = learning(orbit, maps, gains, weights=weights, effort=effort / 2, share=settings.parameter_error)
    n = 2 * model.arms
    return OgyController(
        kind=settings.kind,
        table=phase_table(orbit),
        times=np.array([m.start.time for m in maps]),
        states=np.array([m.start.state for m in maps]),
        normals=np.array([m.start.normal for m in maps]),
        projections=np.array([m.start.projection[:n, :n] for m in maps]),
        gains=gains,
        duration=duration,
        pulse_limit=settings.pulse_limit,
        model=model,
        learning=learnt,
        ticks=max(round(seconds / model.period), 1),
        status=f"{settings.sections} sections in a period of {orbit.period:.4g} s",
    )
