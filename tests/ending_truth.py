"""What is true of a run's ending, found from what nobody at a bench knows: true states, and what was really broken.

An ending is true where its class and every figure of its sentence agree with the true states. The sentences are read
here as a user reads them; nothing of how they were decided is used. What each class must mean:

    is stuck          the sensor that is named had really stuck by then
    no measurement    readings really failed to come
    estimate lost     an estimated angle was wrong by 0.05 rad, or the cart by 0.02 m, within the last 0.3 s, or a
                      sensor really failed
    tracking lost     the true angle was, or has stayed, as far from the reference as is said
    cart at its stop  the true cart was where it is said to be, and as quick, if that is said; had it gone on for
                      another tick, the real drive, braked with half of what it can give, would have left no more than
                      3 cm of the travel and what the cart goes in a tick; the true angle was as far from the reference
                      as is said, and not yet lost
    limit switch      the true cart was at that end of its track
    hard stop         the true cart ran into the end of its track

"As far" is to 0.2 rad and a tenth: less than it takes to tell a run that could be saved from one that could not. A run
that came to the reference's end is judged by its score: see `untrue_score`.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np

import dpcontrol.loop.lockstep as lockstep
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import BatchRun, Ending, JudgedTicks
from dpcontrol.references.reference import Reference
from dpcontrol.review.score import Flown, Verdict, verdict_on
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.run_options import RunOptions

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Flight:
    """A run with all that is known of it: estimates (K, N); verdict by its plan; settings, with what was broken; due s:
    when each symbol crosses its section in the plan.
    """

    scene: str
    seed: int
    settings: LoopSettings
    run: BatchRun
    estimates: Array
    verdict: Verdict
    limits: tuple[float, float, float]
    due: tuple[float, ...]

    @property
    def arms(self) -> int:
        return self.run.references.shape[1]

    @property
    def away(self) -> Array:
        """How far the true angle that is farthest from the reference is from it, at each tick (K,), rad."""
        return np.abs(self.run.truth[:, : self.arms] - self.run.references).max(axis=1)

    @property
    def wrong(self) -> Array:
        """By how much the worst of the estimated angles is wrong at each tick (K,), rad."""
        return np.abs(self.run.truth[:, : self.arms] - self.estimates[:, : self.arms]).max(axis=1)


class _WithEstimates(JudgedTicks):
    """Keeps the estimates as well."""

    made: "_WithEstimates"

    def __init__(self, count: int, runs: int, arms: int) -> None:
        super().__init__(count, runs, arms)
        self.estimates = np.empty((count, 2 * arms + 2, runs))
        type(self).made = self

    def take(self, k, report, at, truth) -> None:
        super().take(k, report, at, truth)
        self.estimates[k] = report[: self.estimates.shape[1]]


def flights(itinerary: Itinerary, reference: Reference, seeds: Sequence[int]) -> list[Flight]:
    """Run these seeds in lockstep where that goes, else one by one."""
    loop, arms = itinerary.loop, itinerary.model.arms
    assembly, limits = Assembly(reference, arms, loop), loop.limits(reference)
    if assembly.lockstep:
        with mock.patch.object(lockstep, "JudgedTicks", _WithEstimates):
            runs = assembly.batch(seeds)
        estimates = [_WithEstimates.made.estimates[: len(run.times), :, k] for k, run in enumerate(runs)]
    else:
        results = [assembly.simulate(seed=seed) for seed in seeds]
        runs, estimates = [BatchRun.of(result) for result in results], [result.ticks.estimates for result in results]
    bounds = (limits.position, limits.velocity, limits.acceleration)
    due = tuple(symbol["time"] for symbol in reference.notes["symbols"])
    out = []
    for seed, run, estimate in zip(seeds, runs, estimates, strict=True):
        ended = "" if run.ending is Ending.FINISHED else run.reason
        flown = Flown(run.times, run.truth, run.references, run.applied, loop.rate, bounds, ended)
        verdict = verdict_on(flown, reference)
        out.append(Flight(itinerary.name, seed, loop, run, estimate, verdict, bounds, due))
    return out


_NUMBER = r"(-?[0-9.]+(?:e[+-]?[0-9]+)?|nan|inf)"


def _read(pattern: str, text: str) -> tuple[float, ...]:
    """Return the numbers that a sentence gives where the pattern has #."""
    found = re.search(re.escape(pattern).replace(r"\#", _NUMBER).replace(r"\ ", " "), text)
    return tuple(map(float, found.groups())) if found else ()


LOST = 1.5
"""rad: farther than that from its reference no run comes back: what it does then is no attempt to follow."""
WRONG = 0.05
"""rad: an estimate that is wrong by more leaves a law that is to hold 0.1 rad no room."""


def untrue(flight: Flight) -> str:
    """Return what is not true of how a run ended, or an empty string."""
    run, text = flight.run, flight.run.reason
    if run.ending is Ending.FINISHED:
        return ""
    (now,) = _read("at t = # s", text) or (float(run.times[-1]),)
    k = min(round(now * flight.settings.rate), len(run.times) - 1)
    before = slice(max(0, k - round(0.3 * flight.settings.rate)), k + 1)
    sensors = flight.settings.sensors
    if "is stuck" in text:
        names = ["the encoder of joint 1", "the encoder of joint 2", "the cart's scale"]
        named = next(i for i, name in enumerate(names) if name in text)
        really = sensors.stuck_at <= now and named == sensors.stuck_sensor
        return "" if really else f"sensor {named} is not stuck"
    if "no measurement for" in text:
        return "" if sensors.dropout else "readings came"
    if "mean NIS" in text or "no longer finite" in text:
        worst = np.nanmax(flight.wrong[before]) if np.isfinite(flight.wrong[before]).any() else np.inf
        cart = np.nanmax(np.abs(run.truth[before, -2] - flight.estimates[before, -2]))
        broken = sensors.stuck_at <= now or sensors.missed_counts > 0
        return "" if broken or worst > WRONG or cart > 0.02 else f"the estimate was right to {worst:.3f} rad"
    if "rad from the encoders" in text:
        (said,) = _read("it is # rad from the encoders", text)
        worst = flight.wrong[before].max()
        return "" if worst > WRONG else f"the estimate was right to {worst:.3f} rad, and not wrong by {said}"
    if "limit switch" in text:
        own = drive_end(flight)
        return "" if abs(run.truth[k, -2]) > own - 1e-6 else f"the cart was at {run.truth[k, -2]:.3f} m"
    if "hard stop" in text:
        x, _ = _read("x = # m at # m/s", text)
        return "" if abs(abs(x) - drive_end(flight)) < 1e-3 else "the cart was not at its hard stop"
    if run.ending is Ending.TRACKING_LOST and (said := _read("an angle has stayed # rad", text)):
        # As it is said to have stayed there, a mean over a second.
        mean, share = 0.0, 1 / flight.settings.rate
        for value in flight.away[: k + 1]:
            mean += (value - mean) * share
        return "" if _near(said[0], mean) else f"the true angle stayed {mean:.2f} rad away"
    if run.ending in (Ending.TRACKING_LOST, Ending.CART_STOP):
        (said,) = _read("an angle is # rad" if run.ending is Ending.TRACKING_LOST else "an angle # rad", text)
        (x,), speed = _read("at # m", text.partition(" s: ")[2]), _read("m with # m/s", text)
        there, quick = run.truth[k, -2:]
        if abs(there - x) > 0.01 or any(abs(quick - v) > 0.1 + 0.1 * abs(quick) for v in speed):
            return f"the cart was at {there:.3f} m with {quick:.2f} m/s"
        if not _near(said, flight.away[k]):
            return f"the true angle was {flight.away[k]:.2f} rad away"
        if flight.away[k] > LOST + SLACK and run.ending is Ending.CART_STOP:
            return f"the arms were already {flight.away[k]:.1f} rad from the reference"
        reached = _stop(flight, k)
        room = ROOM + abs(quick) / flight.settings.rate
        return "" if reached > flight.limits[0] - room else f"the cart had room to stop, at {reached:.3f} m"
    return "" if run.ending is Ending.PLANT_FAILED else f"no such ending: {text}"


def drive_end(flight: Flight) -> float:
    """Return where the limit switches are touched, m from the centre."""
    drive = flight.settings.drive
    return (drive.track if np.isfinite(drive.track) else flight.limits[0]) - drive.switch_margin


SLACK = 0.2
"""rad: what an estimate that is still of use, and a second figure, may miss."""


def _near(said: float, true: float) -> bool:
    return abs(said - true) <= SLACK + 0.1 * true


ROOM = 0.03
"""m: what may be left of the travel where the cart had to brake."""


def _stop(flight: Flight, k: int) -> float:
    """Return where the cart comes to rest if it is told to brake one tick after tick k, m from the centre.

    Told so late the drive does first what it was sent before, and what it lags behind; it gives its own share of a
    command, and half of its limit is counted on.
    """
    drive, rate = flight.settings.drive, flight.settings.rate
    (x, v), (_, before) = flight.run.truth[k, -2:], flight.run.truth[max(k - 1, 0), -2:]
    ticks = round(drive.delay) + 1
    sent = flight.run.applied[k : k + ticks].sum() / rate * drive.response
    brakes = flight.limits[2] * min(drive.response, 1.0)
    speeds = (v, v + drive.lag * (v - before) * rate, v + drive.lag * (v - before) * rate + sent)
    return max(abs(x + w * (ticks / rate + drive.lag) + w * abs(w) / brakes) for w in speeds)


# Troubles.

MOVING = (
    "outer-turn", "cross", "up-up", "turn-from-rest", "double-turn", "triple-turn", "turn-cross-turn-return",
    "two-energies", "dance", "round-trip", "round-trip-from-rest",
)  # fmt: skip
"""The shipped itineraries that move and can go in lockstep."""


def troubled(random: np.random.Generator, *, controller: str, troubles: int, faulty: bool = False) -> RunOptions:
    """Return a bench with so many troubles, each up to where hardly a run is completed; faulty: a sensor's too.

    travel m: TVLQR has the lab's 0.4 m, others 0.8 m, where the track is not the trouble.
    """

    def within(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    kinds: list[Callable[[], dict[str, Any]]] = [
        lambda: {"mismatch": within(0.1, 0.4)},
        lambda: {"lag": within(0.005, 0.04)},
        lambda: {"zero_error": within(0.02, 0.1)},
        lambda: {"tilt": within(-0.15, 0.15)},
        lambda: {"rate": float(random.choice([100.0, 200.0, 500.0]))},
        lambda: {"counts": int(2 ** within(8, 15.3))},
        lambda: {"noise": 10 ** within(-4, -1.7)},
        lambda: {"pushes": int(random.integers(1, 6)), "push_impulse": 10 ** within(-3.3, -1.7)},
        lambda: {"knocks": int(random.integers(1, 6)), "knock_velocity": within(0.1, 2.0)},
        lambda: {"travel": within(0.15, 0.8)},
        lambda: {"response": within(0.3, 1.8)},
        lambda: {"cart_mass": within(0.1, 1.0)},
    ]
    faults: list[Callable[[], dict[str, Any]]] = [
        lambda: {"stuck_at": within(0.0, 6.0), "stuck_sensor": int(random.integers(3))},
        lambda: {"dropout": within(0.05, 0.97)},
        lambda: {"missed_counts": 10 ** within(0, 2)},
    ]
    values: dict[str, Any] = {
        "controller": controller, "travel": 0.4 if controller == "tvlqr" else 0.8, "initial_error": 0.05,
        "lag": 0.005, "command_noise": 0.3, "mismatch": 0.05, "zero_error": 0.02,
    }  # fmt: skip
    for k in random.choice(len(kinds), size=troubles, replace=False):
        values |= kinds[k]()
    if faulty:
        values |= faults[random.integers(len(faults))]()
    return RunOptions(**values)


def class_of(flight: Flight) -> str:
    """Return the class of an ending, stuck sensors, silence and hard stops apart."""
    for name in ("is stuck", "no measurement", "hard stop", "limit switch"):
        if name in flight.run.reason:
            return name
    return flight.run.ending.value


def untrue_score(flight: Flight) -> str:
    """Return what is not true of how a run was scored, or an empty string: each symbol counts while it was followed."""
    symbols, problem = flight.verdict.symbols, flight.verdict.problem
    far = np.flatnonzero(flight.away > LOST)
    if not problem:
        return f"completed, although {flight.away.max():.1f} rad off" if far.size else ""
    if "did not start on" in problem and flight.away[: round(0.05 * flight.settings.rate)].max() < 0.5:
        return "it did start there"
    if not far.size or not symbols:
        return ""
    # By then the last of them was due.
    due = flight.due[symbols - 1] if symbols <= len(flight.due) else 0.0
    return "" if flight.run.times[far[0]] > due - 0.5 else f"symbol {symbols} was due at {due:.2f} s, when it was lost"
