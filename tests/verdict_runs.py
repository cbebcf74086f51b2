"""Runs with verdicts of two decoders, and failed runs derived from completed ones."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from independent_decoder import LAST, Plan, faults, last_gap, plan_of

from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import Flown, verdict_on
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import BatchRun
from dpcontrol.plans.itinerary import Itinerary
from dpcontrol.references.reference import Reference

Array = np.ndarray

UNSURE = 0.004
"""Tolerance of the last period's gap between two samplings, rad."""


@dataclass(frozen=True, eq=False)
class Case:
    """A run with its description."""

    text: str
    flown: Flown


def drawn_options(random: np.random.Generator) -> dict[str, Any]:
    """Return an easy, ordinary or hard bench."""

    def within(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    values: dict[str, Any] = {"mismatch": random.choice([0.0, 0.02, 0.05, 0.1, 0.2, 0.35]), "travel": 0.8}
    values |= random.choice([
        {}, {"initial_error": within(0.0, 0.15)}, {"lag": within(0.0, 0.02), "command_noise": within(0.0, 1.0)},
        {"travel": within(0.15, 0.5)}, {"pushes": 3, "push_impulse": 10 ** within(-3.3, -1.8)},
        {"controller": "tvlqr"}, {"controller": "feedforward", "mismatch": 0.001}, {"zero_error": within(0.0, 0.1)},
        {"controller": "feedforward"}, {"tilt": within(-0.1, 0.1)}, {"response": within(0.5, 1.4)},
        {"knocks": 2, "knock_velocity": within(0.05, 1.0)},
    ])  # fmt: skip
    return values


def runs(itinerary: Itinerary, reference: Reference, options: Mapping[str, Any], seeds: list[int]) -> Iterator[Case]:
    """Fly these seeds."""
    scene = itinerary.with_run(options)
    loop, arms = scene.loop, scene.model.arms
    assembly, limits = Assembly(reference, arms, loop, stays=stays(reference)), loop.limits(reference.limits)
    lockstep = assembly.lockstep
    draws = (assembly.draw(seed=seed) for seed in seeds)
    flights = assembly.batch(seeds) if lockstep else [BatchRun.of(assembly.simulate(draw=draw)) for draw in draws]
    for seed, run in zip(seeds, flights, strict=True):
        flown = Flown.of(run, rate_hz=loop.rate, limits=limits)
        yield Case(f"seed {seed}, {options}", flown)


def counted_states(flown: Flown, plan: Plan) -> Array:
    """Return the relevant true states of a run with falls, each flight up to the next restart."""
    if not flown.stretches:
        return flown.states
    n, out = plan.arms, []
    for k, flight in enumerate(flown.stretches):
        later = min((f.at for f in flown.stretches[k + 1 :]), default=np.inf)
        count = round(min(flight.end - flight.first, (later - flight.at) * plan.rate))
        if count <= 0:
            continue
        piece = flown.states[flight.first : flight.first + count].copy()
        due = plan.states[min(round(flight.at * plan.rate), len(plan.states) - 1), :n]
        wanted = flown.reference_angles[flight.first]
        piece[:, :n] -= 2 * np.pi * np.rint((wanted - due) / (2 * np.pi))
        out.append(piece)
    return np.concatenate(out)


def disagreement(case: Case, reference: Reference, plan: Plan) -> str:
    """Return the difference between two decoders' verdicts, or an empty string."""
    verdict = verdict_on(case.flown, reference)
    states = counted_states(case.flown, plan)
    found = faults(plan, states)
    if case.flown.stretches:
        found += [
            f"{name} beyond its limit in a return"
            for at, name, bound in ((-2, "position", plan.limits[0]), (-1, "velocity", plan.limits[1]))
            if np.abs(case.flown.states[:, at]).max() > bound + 1e-9
        ]
    if verdict.completed != bool(found):
        return ""
    if np.isfinite(states).all() and abs(last_gap(plan, states) - LAST) < UNSURE:
        return ""
    return f"{case.text}: the score says {verdict.reason!r}, the other decoder {found or 'completed'}"


# Wrong runs.


def mutants(case: Case, plan: Plan, random: np.random.Generator) -> Iterator[Case]:
    """Derive failed runs from a completed one by changes of both states and reference."""
    n, flown, notes = plan.arms, case.flown, plan.notes
    stops, symbols = notes["stops"], notes["symbols"]

    def with_rows(text: str, rows: Array, turns: Array) -> Case:
        states, wanted = flown.states[rows].copy(), flown.reference_angles[rows] + turns
        states[:, :n] += turns
        time = np.arange(len(rows)) / flown.rate_hz
        changed = replace(flown, states=states, reference_angles=wanted, time=time, applied=flown.applied[rows])
        return Case(f"{case.text}, {text}", changed)

    count = len(flown.states)
    whole, none = np.arange(count), np.zeros((count, n))
    if any(abs(angle) > 1e-9 for stop in stops for angle in stop["angles"]):
        mirrored = flown.states.copy()
        mirrored[:, : 2 * n] *= -1
        yield Case(f"{case.text}, mirrored", replace(flown, states=mirrored))
    if symbols:
        at = round(float(random.choice([s["time"] for s in symbols])) * flown.rate_hz)
        turns = none.copy()
        turns[at:, int(random.integers(n))] += 2 * np.pi * random.choice([-1, 1])
        yield with_rows("a turn more from one symbol on", whole, turns)
        drop = round(symbols[-1]["time"] * flown.rate_hz) - round(0.3 * flown.rate_hz)
        yield with_rows("stopped before the last symbol", whole[: max(drop, 2)], none[: max(drop, 2)])
    for k, asked in enumerate(notes["wraps"]):
        if asked is None or "arrived_on" in stops[k + 1]:
            continue
        period = round(notes["orbits"][stops[k + 1]["orbit"]]["period"] * flown.rate_hz)
        middle = round((symbols[k]["time"] + symbols[k + 1]["time"]) / 2 * flown.rate_hz)
        more = np.concatenate([whole[: middle + period // 2], whole[middle - period + period // 2 :]])
        yield with_rows(f"a wobble more at stop {k + 1}", more, none[more])
        if asked >= 2:
            less = np.concatenate([whole[: middle - period // 2], whole[middle - period // 2 + period :]])
            yield with_rows(f"a wobble less at stop {k + 1}", less, none[less])
        if stops[k]["saddle"] == stops[k + 1]["saddle"] == stops[k + 2]["saddle"]:
            # The second symbol and its wraps are omitted.
            first, second = (round(s["time"] * flown.rate_hz) for s in symbols[k : k + 2])
            skipped = np.concatenate([whole[:first], whole[second:]])
            turns = none[skipped].copy()
            turns[first:] -= np.array(stops[k + 1]["angles"]) - np.array(stops[k]["angles"])
            if np.abs(np.array(stops[k + 2]["angles"]) - np.array(stops[k + 1]["angles"])).max() > 1:
                yield with_rows(f"symbol {k + 1} left out", skipped, turns)


@dataclass
class Comparison:
    """Counts of runs judged by both decoders, completed ones, derived failures and false verdicts."""

    runs: int = 0
    completed: int = 0
    wrong: int = 0
    false: list[str] = field(default_factory=list)

    def add(self, plan: Any, options: Mapping[str, Any], seeds: list[int], random: np.random.Generator) -> None:
        """Simulate these seeds of a plan, and failed runs derived from the first completed one."""
        reference, made, read = plan.reference, False, None
        for case in runs(plan.itinerary, reference, options, seeds):
            assert case.flown.limits is not None
            read = read or plan_of(reference, case.flown.rate_hz, case.flown.limits)
            self.runs += 1
            if text := disagreement(case, reference, read):
                self.false.append(f"{plan.itinerary.name}, {text}")
            if not verdict_on(case.flown, reference).completed:
                continue
            self.completed += 1
            if made or case.flown.stretches:
                continue
            made = True
            for mutant in mutants(case, read, random):
                self.wrong += 1
                if verdict_on(mutant.flown, reference).completed:
                    self.false.append(f"{plan.itinerary.name}, {mutant.text}: completed by the score")
                if not faults(read, mutant.flown.states):
                    self.false.append(f"{plan.itinerary.name}, {mutant.text}: completed by the other decoder")


def for_plan(options: Mapping[str, Any], plan: Any) -> dict[str, Any]:
    """Return suitable options for a plan; kept stops require a special law."""
    values = options
    if len(plan.content.segments) > 1:
        values.pop("controller", None)
    return {**values}
