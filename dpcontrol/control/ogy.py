"""OGY control: one bounded pulse per section stabilises an unstable orbit.

    at the crossing of section j:   clock := phase of section j,   ξ = x̂ - x*,   p_j = -K_j ξ - s_j · δ̂,  |p_j| ≤
    limit
    until section j+1:              u(s) = u*(clock) + p_j sin(π s / duration)

Classic OGY chooses the pulse so that the unstable direction vanishes at the next section: p_j = -(f·A_j ξ)/(f·B_j),
with f the left eigenvector of the period's map at section j+1. It does not control the cart, and it does not compensate
for a plant that differs from the model. The other law is linear-quadratic over all sections, includes the cart, and
learns (see `section_law`). An error q grows to q λ in a period, so one section per period is not enough for either law.
Source: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), 1196.

Pulses from section to section are linear-quadratic or classic, and corrected by data of the run about the plant.

    ξ_{j+1} = A_j ξ_j + B_j p_j + D_j δ,        p_j = -K_j ξ_j - s_j · δ̂

K comes from the periodic Riccati equation. δ are relative errors of the model's base parameters. A plant that differs
from the model has another orbit, and a law that aims for the model's orbit needs a pulse at every section. After each
section, the model's prediction is compared with the measurement, D_j δ. A Kalman filter (recursive least squares with
prior and drift) then updates δ̂. s is optimal for a disturbance D_j δ that is known for all future sections:

    s_j = (r + BᵀP_{j+1}B)⁻¹ Bᵀ v_j,    v_j = P_{j+1} D_j + g_{j+1},    g_j = (A_j - B_j K_j)ᵀ v_j

Sources: Anderson & Moore, Optimal Control: Linear Quadratic Methods, sections 3.4 (known disturbances) and 4.3. Åström
& Wittenmark, Adaptive Control, section 2.2, for the least squares.
"""

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.interface import MANY, ONE, Action, ClockedSession, Mode, SampledModel
from dpcontrol.control.lqr import QuadraticWeights
from dpcontrol.control.periodic import PhaseTable, periodic_gains, phase_table
from dpcontrol.control.tracking import riccati_gains
from dpcontrol.dynamics.equations import Equations
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.settings import Setting, Settings
from dpcontrol.foundation.shown import Brief

if TYPE_CHECKING:
    from dpcontrol.references.sustained import SectionMap, SustainedOrbit


ANGLE_ERROR, RATE_ERROR = 3e-4, 0.05
"""Errors of an estimate from encoders with 40,000 counts while an arm swings, rad and rad/s."""
DRIFT = 0.02
"""Drift of a parameter's error per section, as a share of its prior."""
_FRICTION = 5.0
"""The uncertainty of friction is five times that of inertia."""
_STEP = 5e-4
"""Step of the flights for sensitivities, s; its error is far smaller than the differences."""
_DIFFERENCE = 1e-3
_SETTLED = 1e-9
_MOST_PERIODS = 5000


@dataclass(frozen=True, eq=False)
class Learning(Brief):
    """Filter of the model's m relative parameter errors δ, updated at each of k sections.

    Attributes:
        sensitivities: D (k, 2n, m), derivatives of the pendulum's state at the next section by the errors.
        noise: covariance (k, 2n, 2n) of measured minus predicted states at the next section for a correct model.
        shifts: s (k, m), changes of the pulse after each section by a unit of each error, m/s².
        prior: covariance (m, m) of the errors before the run.
    """

    sensitivities: Array
    noise: Array
    shifts: Array
    prior: Array

    def updated(self, section: NDArray[np.intp] | int, guess: Array, covariance: Array, surprise: Array
                ) -> tuple[Array, Array]:  # fmt: skip
        """Return the estimated errors δ̂ (…, m) and their covariance (…, m, m) after flights from section to section.

        Args:
            section: section (…) at which each flight began.
            guess: δ̂ (…, m) before.
            covariance: its covariance (…, m, m) before.
            surprise: measured minus predicted state (…, 2n) of the pendulum at the next section.
        """
        sensitivity = self.sensitivities[section]
        spread = covariance + DRIFT**2 * self.prior
        projected = sensitivity @ spread
        innovation_covariance = projected @ np.swapaxes(sensitivity, -1, -2) + self.noise[section]
        gain = np.swapaxes(np.linalg.solve(innovation_covariance, projected), -1, -2)
        innovation = surprise - (sensitivity @ guess[..., None])[..., 0]
        return guess + (gain @ innovation[..., None])[..., 0], spread - gain @ projected


def classic_gains(maps: "tuple[SectionMap, ...]") -> Array:
    """Return the gains (k, N) of classic OGY, whose pulses remove the unstable direction at the next section.

    Args:
        maps: maps from each of k sections to the next.

    Raises:
        GoalMissed: a pulse does not move the unstable direction.
    """
    gains = []
    for j, section_map in enumerate(maps):
        product = np.eye(len(section_map.response))
        for next_map in maps[j + 1 :] + maps[: j + 1]:
            product = next_map.matrix @ product
        values, left_vectors = np.linalg.eig(product.T)
        direction = np.real(left_vectors[:, np.argmax(np.abs(values))])
        reach = float(direction @ section_map.response)
        if abs(reach) <= 1e-12 * float(np.linalg.norm(section_map.response)):
            raise GoalMissed(f"a pulse after section {j + 1} does not move the unstable direction; use more sections")
        gains.append(direction @ section_map.matrix / reach)
    return np.array(gains)


def parameter_directions(equations: Equations, parameters: Array) -> Array:
    """Return the changes (m, p) of base parameters due to a plant's relative errors, one row for each kind of error.

    They are inertia, weights with couplings, and friction × 5, because it is less certain. Weight G_i and coupling S_i
    = G_i/g change together, since gravity is constant.

    Args:
        equations: equations of the model.
        parameters: base parameters (p,), SI.
    """
    n = (equations.dimension - 2) // 2
    inertias = n * (n + 1) // 2
    directions = np.diag(parameters)
    # Each weight changes together with its coupling.
    directions[inertias : inertias + n] += directions[inertias + n : inertias + 2 * n]
    return np.concatenate([directions[: inertias + n], _FRICTION * directions[inertias + 2 * n :]])


def sensitivities(orbit: "SustainedOrbit", maps: "tuple[SectionMap, ...]", directions: Array) -> Array:
    """Return D (k, N, m), derivatives of the states at the next section by errors of the plant's parameters.

    They are central differences of Runge-Kutta flights under the orbit's input.

    Args:
        orbit: the sustained orbit.
        maps: maps from each of k sections to the next.
        directions: changes (m, p) of the plant's base parameters.
    """
    k, kinds, duration = len(maps), len(directions), maps[0].duration
    count = max(int(np.ceil(duration / _STEP)), 1)
    step = duration / count
    function = orbit.equations.discrete_step(step)
    plain = function.factory("plain", function.name_in(), [function.name_out(0)]).map(2 * kinds * k)
    change = _DIFFERENCE * np.concatenate([directions, -directions])
    parameters = np.tile((orbit.parameters + change).T, (1, k))
    states = np.repeat(np.array([section_map.start.state for section_map in maps]), 2 * kinds, axis=0).T
    begins = np.array([section_map.start.time for section_map in maps])
    for i in range(count):
        inputs = np.repeat(orbit.input(begins + (i + 0.5) * step), 2 * kinds)[None, :]
        states = np.array(plain(states, inputs, parameters))
    ends = states.T.reshape(k, 2, kinds, -1)
    derivatives = (ends[:, 0] - ends[:, 1]) / (2 * _DIFFERENCE)
    return np.array([section_map.end.projection @ derivatives[j].T for j, section_map in enumerate(maps)])


def learning(
    orbit: "SustainedOrbit", maps: "tuple[SectionMap, ...]", gains: Array, *, weights: Array, effort: float,
    share: float,
) -> Learning:  # fmt: skip
    """Return the data of the filter that learns relative errors of the plant's parameters during a run.

    Args:
        orbit: the sustained orbit.
        maps: maps from each of k sections to the next.
        gains: gains (k, N) of the pulses.
        weights: diagonal (N,) of Q.
        effort: weight r of a pulse.
        share: standard deviation of the relative errors.

    Raises:
        GoalMissed: the shifts do not converge.
    """
    directions = parameter_directions(orbit.equations, orbit.parameters)
    # A zero parameter has no relative error.
    directions = directions[np.abs(directions).sum(1) > 0]
    derivatives = sensitivities(orbit, maps, directions)
    n, kinds = derivatives.shape[1] - 2, len(directions)
    spread = np.array([ANGLE_ERROR**2] * (n // 2) + [RATE_ERROR**2] * (n // 2))
    noise = []
    for section_map in maps:
        # Errors of the estimates at both sections are the noise of the learning filter.
        start_map, end_projection = section_map.matrix[:n, :n], section_map.end.projection[:n, :n]
        # The smallest of them regularises the direction along the orbit, which the section omits.
        noise.append(
            (start_map * spread) @ start_map.T
            + (end_projection * spread) @ end_projection.T
            + ANGLE_ERROR**2 * np.eye(n)
        )
    shifts = disturbance_shifts(maps, gains, derivatives, weights=weights, effort=effort)
    return Learning(derivatives[:, :n], np.array(noise), shifts, share**2 * np.eye(kinds))


def disturbance_shifts(
    maps: "tuple[SectionMap, ...]", gains: Array, disturbances: Array, *, weights: Array, effort: float
) -> Array:
    """Return shifts s (k, m) of the pulses, m/s², that anticipate known periodic disturbances of one unit each.

    Args:
        maps: maps from each of k sections to the next.
        gains: gains (k, N) of the pulses.
        disturbances: disturbances D (k, N, m).
        weights: diagonal (N,) of Q.
        effort: weight r of a pulse.

    Raises:
        GoalMissed: the shifts do not converge.
    """
    matrices, responses = _arrays(maps)
    count, size, kinds = disturbances.shape
    costs = [np.diag(weights)] * (count + 1)
    g = np.zeros((size, kinds))
    previous = np.full((count, kinds), np.inf)
    shifts = np.zeros((count, kinds))
    for _ in range(_MOST_PERIODS):
        costs[count] = costs[0]
        for j in range(count - 1, -1, -1):
            matrix, response = matrices[j], responses[j]
            *_, section_costs = riccati_gains(
                matrix[None], response[None], weights=weights, effort=effort, terminal=costs[j + 1]
            )
            costs[j] = section_costs[0]
            v = costs[j + 1] @ disturbances[j] + g
            shifts[j] = response @ v / (effort + response @ costs[j + 1] @ response)
            g = (matrix - np.outer(response, gains[j])).T @ v
        if np.abs(shifts - previous).max() <= _SETTLED * max(np.abs(shifts).max(), 1e-300):
            return shifts
        previous = shifts.copy()
    raise GoalMissed(
        "the pulses for a plant that differs from the model did not converge; use more sections per period"
    )


def _arrays(maps: "tuple[SectionMap, ...]") -> tuple[Array, Array]:
    """Return the matrices A (k, N, N) and responses B (k, N) of the maps from each section to the next."""
    return np.array([m.matrix for m in maps]), np.array([m.response for m in maps])


_EARLY = 0.125
"""Largest time error of a crossing, as a share of the period; at most half the time to the next section."""


@dataclass(frozen=True)
class ClassicOgySettings(Settings, table="controller"):
    """OGY as published: sections per period, and largest pulse in m/s²."""

    kind: str = "ogy-classic"
    sections: Annotated[int, Setting(least=1, most=1000, help="Sections in a period.")] = 16
    pulse_limit: Annotated[float, Setting(above=0, unit="m/s²", help="Largest pulse.")] = 5.0


@dataclass(frozen=True)
class OgySettings(QuadraticWeights):
    """OGY with linear-quadratic pulses: sections per period, and largest pulse in m/s².

    Attributes:
        parameter_error: relative error of the plant's inertial parameters, five times as much for friction; the run's
            data correct the pulses. Zero disables learning.
    """

    position: float = 30.0
    velocity: float = 3.0
    effort: float = 0.3
    kind: str = "ogy"
    sections: Annotated[int, Setting(least=1, most=1000, help="Sections in a period.")] = 16
    pulse_limit: Annotated[float, Setting(above=0, unit="m/s²", help="Largest pulse.")] = 5.0
    parameter_error: Annotated[
        float, Setting(least=0, most=1, help="Assumed relative error of the plant's parameters.")
    ] = 0.05


@dataclass(frozen=True, eq=False)
class OgyController(Brief):
    """OGY controller with k sections and pulses of `duration` s."""

    kind: str
    table: PhaseTable
    times: Array
    """Times (k,) of the sections, s."""
    states: Array
    """States (k, N) of the orbit on the sections."""
    normals: Array
    """Normals (k, N) of the sections, by which a deviation from `states` gives the time since the crossing, s."""
    projections: Array
    """Projections (k, 2n, 2n) of the pendulum onto the sections."""
    gains: Array
    """Gains (k, N)."""
    duration: float
    pulse_limit: float
    model: SampledModel
    """Predicts the flight between sections."""
    learning: Learning | None
    """Data for learning, or None."""
    ticks: int
    """Number of periods."""

    @property
    def first_state(self) -> Array:
        """Return the initial state (N,): the orbit at its first section, so that a pulse comes at once."""
        return self.states[0]

    @cached_property
    def window(self) -> float:
        """Return the largest time error of a crossing, s; if it is later, the section counts as not crossed."""
        return min(self.duration / 2, _EARLY * self.table.period)

    def begin(self) -> "OgySession":
        """Return a new session, the state of this law during one run."""
        return OgySession(self)

    def begin_many(self, count: int) -> "OgySession":
        """Return a session for many runs in lockstep, each with its own clock.

        Args:
            count: number of runs.
        """
        return OgySession(self, count)

    def join(self, tick: int, state: Array) -> "OgySession":
        """Return a session from a tick at the phase nearest to a state, for a handover from another law.

        It keeps the state's turns.

        Args:
            tick: first tick.
            state: state (N,) at that tick.
        """
        session = self.begin()
        session.resynchronise(tick, state)
        return session

    def distance(self, state: Array) -> float:
        """Return the distance of a state from the nearest point of the orbit, see `PhaseTable.distance`.

        Args:
            state: state (N,), whose cart is ignored.
        """
        return self.table.distance(state)


_Course = namedtuple("_Course", "section elapsed pulse foreseen flying lift guess covariance crossings")
"""The last crossed section, the time since, s, the active pulse, m/s², and the plant errors of one or S runs.

foreseen (N,): the model's prediction since that section; flying: True if it is valid. lift (N,): whole turns between
run and orbit, rad. guess (m,), covariance (m, m): estimated relative errors δ̂ of the plant's parameters. crossings:
number of crossings in time. For S runs, all values have a first axis (S,).
"""


class OgySession(ClockedSession):
    """The course of a run under OGY control.

    With `count`, the session serves as many lockstep runs from the first state. The values are then arrays (S,), since
    runs cross their sections at different ticks.

    `course` (`_Course`) belongs to tick `_tick`, the last one in which the law was called. `_sent`, m/s², is the
    command of that tick, by which the model predicts the next one (`_step`). `_lost` is set in the ticks in which a
    section was found not to be crossed: its index and the clock's shift, s; otherwise it is None.
    """

    def __init__(self, controller: OgyController, count: int | None = None) -> None:
        """Begin at the first state, due for a pulse at its section.

        Args:
            controller: the controller.
            count: number of runs in lockstep; None for a single run.
        """
        self._law = law = controller
        self.lanes = ONE if count is None else MANY
        self.orbit_period = law.table.period
        """s"""
        # Plain floats are faster for one run.
        self._times: Any = law.times.tolist() if count is None else law.times
        self._tick = 0
        self._lost: tuple[NDArray[np.intp] | int, Array | float] | None = None
        prior = np.zeros((0, 0)) if law.learning is None else law.learning.prior
        origin = np.zeros(len(law.first_state))
        first = _Course(
            section=len(law.times) - 1,
            elapsed=law.duration,
            pulse=0.0,
            foreseen=origin,
            flying=False,
            lift=origin,
            guess=np.zeros(len(prior)),
            covariance=prior,
            crossings=0,
        )
        self.course = first if count is None else _Course(*(np.array([value] * count) for value in first))
        self._sent: Any = 0.0
        self._step = law.model.step if count is None else _many_steps(law.model, count)

    @property
    def time(self) -> Any:
        """Return the time on the orbit's clock, s."""
        return self._clock % self.orbit_period

    @property
    def _clock(self) -> Any:
        """Return the time on the orbit's clock, s, which a late crossing of the next section can extend."""
        return self._times[self.course.section] + self.course.elapsed

    def command(self, tick: int, state: Array, extra: Array) -> Action:
        """Return the action for the period from a tick, with a sentence in its event if a section was not crossed.

        Args:
            tick: the tick in which the command acts.
            state: predicted state (N,) at the tick.
            extra: ignored.
        """
        forward, feedback, reference = self.steer(tick, state)
        event = ""
        if self._lost is not None:
            section, moved = self._lost
            event = f"section {section + 1} was not crossed: clock of the orbit moved by {moved:+.4f} s"
        return Action(float(forward), float(feedback), reference, Mode.PULSING if feedback else Mode.HOLDING, event)

    def steer(self, tick: int, states: Array) -> tuple[Any, Any, Array]:
        """Return feedforward and feedback, m/s², and the reference's state, after a check for a crossed section.

        They are numbers and (N,) for one run, (S,) and (S, N) for many.

        Args:
            tick: the tick in which the command acts.
            states: state (N,) of one run, or states (S, N).
        """
        law, lanes, period, ticks_passed = self._law, self.lanes, self._law.model.period, tick - self._tick
        self._pass(tick)
        self._lost, course = None, self.course
        if law.learning is not None and ticks_passed:
            # The prediction is valid if no tick since the section was left out.
            foreseen = self._step(course.foreseen, self._sent)
            self.course = course = course._replace(foreseen=foreseen, flying=course.flying & (ticks_passed == 1))
        without_turns = states - course.lift
        # A section counts as crossed within the window about its expected time only.
        near = course.elapsed > law.duration - law.window
        if lanes is MANY or near:
            next_section = (course.section + 1) % len(law.times)
            lateness = lanes.dot(without_turns - law.states[next_section], law.normals[next_section])
            due = lateness >= 0.0
            overdue = (course.elapsed > law.duration + law.window) & (lateness < 0.0)
            if lanes is MANY or due or overdue:
                self._where(near & due, self._crossed, next_section, lateness, without_turns)
                self._where(overdue, self._moved_on, next_section, states)
            course = self.course
        clock, middle = self._clock, course.elapsed + period / 2
        # Adding zero converts minus zero to zero.
        feedback = course.pulse * (middle < law.duration) * np.sin(np.pi * middle / law.duration) + 0.0
        feedforward = law.table.input(clock + period / 2, lanes)
        self._sent = feedforward + feedback
        return feedforward, feedback, law.table.state(clock, lanes) + course.lift

    def _pass(self, tick: int) -> None:
        """Advance the orbit's clock to a tick of the loop, without a check of the sections."""
        elapsed = self.course.elapsed + (tick - self._tick) * self._law.model.period
        self.course, self._tick = self.course._replace(elapsed=elapsed), tick

    def _where(self, holds: Any, change: Callable[..., _Course], *given: Any) -> None:
        """Change the course of the runs for which `holds` is True, such as those that cross a section in this tick.

        `holds`: a bool, or (S,) in lockstep. `change`: function of a course and of `given`, which returns the new
        course. `given`: its further arguments, with one entry for each run in lockstep.
        """
        if self.lanes is ONE:
            if holds:
                self.course = change(self.course, *given)
        elif len(runs := np.flatnonzero(holds)):
            changed_course = change(_Course(*(value[runs] for value in self.course)), *(value[runs] for value in given))
            for run_values, changed in zip(self.course, changed_course, strict=True):
                run_values[runs] = changed

    def _crossed(self, course: _Course, section: Any, late: Any, x: Array) -> _Course:
        """Return the course after a crossing, from which the plant's errors are learnt and the next pulse follows.

        `section`: number of the crossed section, or (S,). `late`: time since the crossing, s. `x`: state (N,) or (S, N)
        without whole turns.
        """
        law, lanes, learning = self._law, self.lanes, self._law.learning
        late = lanes.clip(late, 0.0, law.window)
        guess, covariance = course.guess, course.covariance
        if learning is not None:
            deviation = (x - course.foreseen)[..., :-2, None]
            surprise = (law.projections[section] @ deviation)[..., 0]
            counts = np.asarray(course.flying)[..., None]
            new_guess, new_covariance = learning.updated(course.section, guess, covariance, surprise)
            guess, covariance = (
                np.where(counts, new_guess, guess),
                np.where(counts[..., None], new_covariance, covariance),
            )
        pulse = -lanes.dot(law.gains[section], x - law.table.state(law.times[section] + late, lanes))
        if learning is not None:
            pulse = pulse - lanes.dot(learning.shifts[section], guess)
        pulse = lanes.clip(pulse, -law.pulse_limit, law.pulse_limit)
        return _Course(section, late, pulse, x, True, course.lift, guess, covariance, course.crossings + 1)

    def _moved_on(self, course: _Course, section: Any, states: Array) -> _Course:
        """Return the course after a section that was not crossed in time, with the clock at the nearest phase.

        The section and the clock's shift are stored for the log's event.

        Args:
            course: state of the law before the section.
            section: index of the section that was due, or one for each of S runs.
            states: present state (N,), or (S, N).
        """
        course, moved = self._nearest(course, states)
        self._lost = section, moved
        return course

    def _nearest(self, course: _Course, states: Array) -> tuple[_Course, Any]:
        """Return the course with its clock at the phase nearest to a state (N,) or states (S, N), and its shift, s."""
        law, expected = self._law, (self._law.times[course.section] + course.elapsed) % self.orbit_period
        time, _, lift = law.table.nearest(states)
        times_since = np.mod(time[..., None] - law.times, self.orbit_period)
        section, elapsed = np.argmin(times_since, axis=-1), times_since.min(-1)
        corrected = course._replace(section=section, elapsed=elapsed, pulse=0.0, flying=False, lift=lift)
        return corrected, law.table.shift(time, expected)

    def resynchronise(self, tick: int, state: Array) -> str:
        """Move the orbit's clock to the phase nearest to a state, and return a sentence for the log.

        The loop calls it if the arms have been far from the reference for some time. The next crossing starts a pulse.

        Args:
            tick: present tick.
            state: state (N,) at that tick.
        """
        self._pass(tick)
        self.course, moved = self._nearest(self.course, state)
        return f"clock of the orbit moved by {moved:+.4f} s"


def _many_steps(model: SampledModel, count: int) -> Callable[[Array, Array], Array]:
    """Return a function of states (S, N) and commands (S,), m/s², that returns the states a period later.

    `count` is the number S of lockstep runs.
    """
    parameters = np.repeat(model.parameters[:, None], count, axis=1)
    return lambda states, commands: (
        model.machine(np.concatenate([states.T, commands[None], parameters]), np.empty(states.T.shape)).T
    )


def ogy_controller(
    orbit: "SustainedOrbit", model: SampledModel, settings: OgySettings | ClassicOgySettings, *, seconds: float
) -> OgyController:
    """Return the controller that holds an orbit by pulses.

    Args:
        orbit: the sustained orbit.
        model: model of arms and drive from tick to tick.
        settings: sections, largest pulse and weights.
        seconds: duration of the hold, s.

    Raises:
        InputError: its sections are less than two ticks apart.
        GoalMissed: the section maps cannot be stabilised.
    """
    duration = orbit.period / settings.sections
    if duration < 2 * model.period:
        raise InputError(
            f"controller: sections = {settings.sections}: a pulse would last {duration:.2g} s, less than two ticks of "
            f"{model.period:g} s; use at most {int(orbit.period / (2 * model.period))}"
        )
    maps = orbit.section_maps(settings.sections)
    learning_data = None
    if isinstance(settings, ClassicOgySettings):
        gains = classic_gains(maps)
    else:
        # The mean square of a half-sine of height 1 is a half.
        weights, effort = settings.weights(model.arms, duration)
        gains = periodic_gains(*_arrays(maps), weights=weights, effort=effort / 2)
        if settings.parameter_error:
            learning_data = learning(
                orbit, maps, gains, weights=weights, effort=effort / 2, share=settings.parameter_error
            )
    n = 2 * model.arms
    starts = [section_map.start for section_map in maps]
    return OgyController(
        settings.kind, phase_table(orbit),
        np.array([section.time for section in starts]), np.array([section.state for section in starts]),
        np.array([section.normal for section in starts]),
        np.array([section.projection[:n, :n] for section in starts]), gains, duration,
        settings.pulse_limit, model, learning_data, max(round(seconds / model.period), 1),
    )  # fmt: skip
