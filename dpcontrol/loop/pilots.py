"""Pilots: they plan the flights of a run, in the loop's program or in a second one.

A request holds the state at the first command that is still free. The pilot predicts the state `THINKING` s later under
the braking law or the flight under way, plans a flight from there and makes its gains. Work is counted in iterations,
never in seconds, so runs repeat exactly.
"""

import math
import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import NamedTuple, Protocol

import numpy as np

from dpcontrol.control.flight import STEPS, FlightPlanner, Flights, braking_gains
from dpcontrol.control.interface import clip_number, sampled_model, with_dry_friction
from dpcontrol.control.tracking import TickedMotion, TrackingController, TvlqrSettings, tracking_law
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.processes import end_with_parent, ignoring_interrupts
from dpcontrol.foundation.shown import Brief
from dpcontrol.loop.targets import FlightGoal
from dpcontrol.references.problem import Limits

THINKING = 0.12
"""Time for the search for a flight, s."""
_LAW = TvlqrSettings(closing=1.0)
"""Weights of the feedback along a flight."""
_PATIENCE = 10.0
"""Longest wait of a loop that runs faster than real time, s."""
_GAINS = 125.0
"""Rate at which the gains along a flight change, Hz."""


@dataclass(frozen=True, eq=False)
class Course(Brief):
    """A flight and the law that follows it.

    Attributes:
        law: gains by the loop's ticks. Its first states are those on which pending commands act.
        flights: the flight by its steps.
        duration: duration of the flight, s.
        place: index of the goal's place at its end.
    """

    law: TrackingController
    flights: Flights
    duration: float
    place: int


class Request(NamedTuple):
    """A question for a flight.

    Attributes:
        state: state (N,) at the first tick whose command is free.
        push: acceleration of a lagging drive then, m/s².
        ticks: number of ticks from there to the start of the flight.
        lead: number of ticks with pending commands.
        goal: index of the stop that the flight leads to, -1 for rest.
        course: flight under way, which is replaced only if it misses its goal, or None.
        first: tick of its law at that state.
        latest: time of the plan's reference after which no place is joined, s.
        parameters: parameters (p,) of the arms by the present estimate.
    """

    state: Array
    push: float
    ticks: int
    lead: int
    goal: int
    course: Course | None
    first: int
    latest: float
    parameters: Array


class Answer(NamedTuple):
    """A flight to follow, or None if none was found or the one under way reaches its goal."""

    course: Course | None


class Pilot(Protocol):
    """A search for flights, which a recovery asks and whose answer it reads some ticks later."""

    def ask(self, request: Request) -> None:
        """Begin to plan a flight.

        Args:
            request: state, goal and flight under way, for which a flight is planned.
        """

    def answer(self) -> Answer | None:
        """Return the answer to the last request, or None if it is not ready."""


@dataclass(frozen=True, eq=False)
class Briefing:
    """Model, limits and goals of a pilot, in a form that can be sent to another program.

    Attributes:
        arms: arms of the model.
        rate: rate of the loop, Hz.
        lag: drive lag of the model, s.
        limits: the cart's limits.
        goals: goals of the stops in order, and at last of rest.
    """

    arms: ArmChainParameters
    rate: float
    lag: float
    limits: Limits
    goals: tuple[FlightGoal, ...]


class DirectPilot:
    """A search for flights in this program: `ask` returns when the search is complete.

    Args:
        briefing: model, limits and goals.
    """

    def __init__(self, briefing: Briefing) -> None:
        """Make the models and the planner once; `ask` replaces their parameters by those of each request.

        `_model` is the model of the loop's ticks. The gains along a flight use the coarse model, whose periods are
        longer. `_usual` is the planner with the model's parameters, and `_planner` that with the parameters of the last
        request. `_braking` are the gains of the braking cart, and `_answer` is the answer to the last request.
        """
        self.briefing, rate, lag = briefing, briefing.rate, briefing.lag
        self._model = sampled_model(briefing.arms, rate, lag)
        self._coarse = sampled_model(briefing.arms, rate / max(1, round(rate / _GAINS)), lag)
        arms = with_dry_friction(briefing.arms, rate)
        self._usual, self._braking = FlightPlanner(arms, briefing.limits), braking_gains(arms)
        self._planner = self._usual
        self._answer: Answer | None = None

    def ask(self, request: Request) -> None:
        """Plan a flight with its law, unless the flight under way reaches its goal.

        Args:
            request: state, goal and flight under way, for which a flight is planned.
        """
        for model in (self._model, self._coarse):
            model.parameters[:] = request.parameters
        self._planner = self._usual.with_parameters(request.parameters)
        goal, course = self.briefing.goals[request.goal].until(request.latest), request.course
        predicted_states = self._predicted(request)
        if course is not None and self._lands(
            course, predicted_states[-1], request.first + request.ticks - request.lead, goal
        ):
            self._answer = Answer(None)
            return
        flights = self._planner.plan(predicted_states[-1:], goal.target)
        self._answer = Answer(self._followed(predicted_states[:-1], flights, goal) if flights.reached[0] else None)

    def answer(self) -> Answer | None:
        """Return the answer to the last request, or None before the first one."""
        return self._answer

    def _predicted(self, request: Request) -> Array:
        """Return the states (lead + 1, N) on which pending commands act, of which the last is the start of the flight.

        The state of the request is advanced under the braking law, or under the law of the flight under way. A lagging
        drive approaches the command exponentially. `push` is its acceleration at the start of a tick; `share` is the
        part of the difference between `push` and the command that remains in the tick's mean acceleration.
        """
        model, max_acceleration, push, states = (
            self._model,
            self.briefing.limits.acceleration,
            request.push,
            [request.state],
        )
        share = model.lag / model.period * (1 - model.lag_keeps)
        for tick in range(request.first, request.first + request.ticks):
            state = states[-1]
            if request.course is None:
                command = -float(self._braking @ state[-2:])
            else:
                law = request.course.law
                row = min(tick, len(law.feedforward) - 1)
                command = float(law.feedforward[row] + law.gains[row] @ (law.reference_states[row] - state))
            command = clip_number(command, -max_acceleration, max_acceleration)
            states.append(model.step(state, command + share * (push - command)))
            push = command + model.lag_keeps * (push - command)
        return np.array(states[-(request.lead + 1) :])

    def _lands(self, course: Course, state: Array, elapsed: int, goal: FlightGoal) -> bool:
        """Return True if the law of the flight under way leads from a predicted state to the goal.

        Its remaining steps are simulated with feedback.

        Args:
            course: flight under way.
            state: predicted state (N,).
            elapsed: tick of the flight at that state.
            goal: goal of the flight.
        """
        flights, gains, period = course.flights, course.law.gains, self._model.period
        # The law's first rows are those of the commands that were pending before the flight.
        step, pending = course.duration / STEPS, len(gains) - int(course.duration / period)
        first_step = min(round(elapsed * period / step), STEPS - 1)
        ticks = np.minimum(pending + (np.arange(first_step, STEPS) * step / period).astype(int), len(gains) - 1)
        return self._planner.lands(
            state, flights.nodes[0, first_step:-1], flights.inputs[0, first_step:], gains[ticks], step, goal.target
        )

    def _followed(self, coming: Array, flights: Flights, goal: FlightGoal) -> Course:
        """Return a flight with the law that follows it, in ticks of the loop.

        Args:
            coming: states (lead, N) before the flight, on which pending commands act.
            flights: flights of the planner, of which the only one is followed.
            goal: goal of the flight, whose cost-to-go ends the law.
        """
        period, duration, place = self._model.period, float(flights.durations[0]), int(flights.places[0])
        times = period * np.arange(max(int(duration / period), 1) + 1, dtype=float)
        states, inputs = self._planner.states(flights.nodes[0], flights.inputs[0], duration, times)
        # Flights have inputs by steps; the mean input of a tick is the difference of their integral.
        velocity_change = np.append(0.0, np.cumsum(flights.inputs[0]) * duration / STEPS)
        commands = np.diff(np.interp(times, np.linspace(0.0, duration, STEPS + 1), velocity_change)) / period
        zeros = np.zeros(len(coming))
        motion = TickedMotion(np.concatenate([coming, states]), np.append(zeros, commands), np.append(zeros, inputs))
        max_acceleration, terminal = self.briefing.limits.acceleration, goal.terminal[place]
        law = tracking_law(motion, self._model, _LAW, most=max_acceleration, terminal=terminal, coarse=self._coarse)
        return Course(law, flights, duration, place)


class _DistantPilot:
    """A search for flights in another program, at the end of a pipe, so that a loop in real time need not wait.

    Args:
        pipe: connection to `_serve` in the other program.

    Raises:
        GoalMissed: the other program ended.
    """

    def __init__(self, pipe: Connection) -> None:
        """Begin without a request; `_number` is that of the last request, and `_asked` the time when it was sent, s."""
        self._pipe, self._number, self._asked = pipe, 0, 0.0

    def ask(self, request: Request) -> None:
        """Send a request with a number, by which answers to earlier requests are recognised.

        Args:
            request: state, goal and flight under way, for which a flight is planned.
        """
        self._number += 1
        self._asked = time.monotonic()
        with _ended_told():
            self._pipe.send((self._number, request))

    def answer(self) -> Answer | None:
        """Return the answer to the last request, or None if it is not ready; answers to earlier requests are dropped.

        In real time the loop must not wait. A loop that runs faster waits up to `_PATIENCE` s.
        """
        # A loop that runs faster than real time waits.
        timeout = _PATIENCE if time.monotonic() - self._asked < THINKING / 2 else 0.0
        with _ended_told():
            while self._pipe.poll(timeout):
                number, answer = self._pipe.recv()
                if number == self._number:
                    return answer
        return None


@contextmanager
def _ended_told() -> Iterator[None]:
    """Raise a `GoalMissed` for a pipe that closes because the other program ended."""
    try:
        yield
    except (EOFError, OSError) as error:
        raise GoalMissed("the process that plans flights ended; run again with more memory") from error


@contextmanager
def pilot_beside(briefing: Briefing) -> Iterator[Pilot]:
    """Start a pilot in a second process, for a bench in real time, and end the process at exit.

    Args:
        briefing: model, limits and goals.
    """
    context = multiprocessing.get_context("spawn")
    pipe_end, far_end = context.Pipe()
    process = context.Process(target=_serve, args=(far_end, briefing), daemon=True)
    with ignoring_interrupts():
        process.start()
    far_end.close()
    try:
        # It is ready once its code is compiled.
        with _ended_told():
            pipe_end.recv()
        yield _DistantPilot(pipe_end)
    finally:
        process.terminate()
        process.join()


def _serve(pipe: Connection, briefing: Briefing) -> None:
    """Answer requests from a pipe until the other end closes; earlier requests that wait are skipped.

    A first request, whose answer is not sent, compiles the code.
    """
    end_with_parent()
    pilot, size = DirectPilot(briefing), 2 * briefing.arms.count + 2
    parameters = sampled_model(briefing.arms, briefing.rate).parameters
    pilot.ask(Request(np.zeros(size), 0.0, 1, 0, 0, None, 0, math.inf, parameters))
    pipe.send("ready")
    while True:
        number, request = pipe.recv()
        while pipe.poll():
            number, request = pipe.recv()
        pilot.ask(request)
        pipe.send((number, pilot.answer()))
