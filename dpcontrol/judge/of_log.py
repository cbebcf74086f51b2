"""Data to draw of a log, a reference or a sustained orbit, read from its file.

A plan's tubes lead from a stop's orbit to the section of the next symbol, and on to the next stop. The plan stores the
orbit's state, the section with its lifted height, and the hits. The unstable tube of the stop's orbit is cut there
(`orbits.cut`). The stable tube of the next stop is such a tube reversed in time. Of each tube only the branch that
meets the section at the plan's height is drawn. Source: Kaheman et al. (2023), section 3.
"""

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, pendulum_system
from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.causes import OrbitCause
from dpcontrol.foundation.errors import remark
from dpcontrol.foundation.parts import installed
from dpcontrol.judge.decoding import Decoded, decode_run
from dpcontrol.judge.run_view import ACTUAL, PlanView, RunView, Stay, TubeCurve, series_of
from dpcontrol.judge.score import (
    DRAWN_METADATA,
    MODEL_METADATA,
    PLANT_METADATA,
    Flown,
    arms_in,
    counted,
    lacking,
    plan_of,
    score,
    spliced,
    stretches_of,
)
from dpcontrol.logs import RunLog
from dpcontrol.logs.layout import SLOW_RATE
from dpcontrol.orbits.cut import CutSettings, tube_cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit, floquet_multipliers
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.orbit import OrbitOutcome
from dpcontrol.recordings.recording import SUMMARY
from dpcontrol.references.content import PlanContent, PlanOrbit
from dpcontrol.references.reference import Reference
from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.words.runs import lost

STRANDS = 24
"""Number of trajectories that are drawn of a tube."""
INSTANTS = 160
"""Number of states that are drawn of each of these trajectories."""
_HEIGHT = 1e-6
"""Largest distance of a state from a section on which it lies, in units of the section's value."""
_CUT = CutSettings(smallest_phase_step=3e-4)
"""Least visible distance; if doubling the phases brings neighbours no nearer, a cut is drawn open."""


def tubes_of(content: PlanContent, system: System) -> tuple[TubeCurve, ...]:
    """Return the tubes along which a plan's symbols lead, each once, for phase planes and the viewer.

    A symbol leaves along the unstable tube of one stop's orbit, and arrives along the stable tube of the next. Tubes of
    three arms have no sections, and older plans do not store their orbits.

    Args:
        content: content of the plan.
        system: conservative pendulum of the plan.
    """
    if any(symbol.section for symbol in content.symbols) and not installed("heyoka"):
        remark("the tubes along the way are not shown: heyoka is not installed")
        return ()
    # `branches` makes both branches of an orbit's tube, each tube once; sections are looked up by their name.
    sections = {section.name: section for section in (*system.sections.values(), *system.named_sections.values())}
    branches = cache(lambda index, name, **tube: tuple(_flown(system, content.orbits[index], sections[name], **tube)))
    tubes: dict[tuple[Any, ...], TubeCurve] = {}
    for symbol, *stops in zip(content.symbols, content.stops, content.stops[1:], strict=False):
        if symbol.section is None or symbol.section.name not in sections:
            continue
        name, height = symbol.section.name, symbol.section.value
        for stable, stop, hit in zip((False, True), stops, symbol.section.hits, strict=True):
            index, lift = stop.orbits[0 if stable else 1], content.lift(stop)
            curves = _at(branches(index, name, hit=hit, stable=stable), sections[name], lift=lift, height=height)
            key = (index, name, hit, stable, *np.rint(lift).tolist(), round(height, 6))
            tubes |= {(*key, branch): curve for branch, curve in enumerate(curves)}
    return tuple(tubes.values())


def _lyapunov(system: System, place: PlanOrbit) -> LyapunovOrbit:
    """Return the Lyapunov orbit whose state and period a plan stores, as the base of a tube.

    Args:
        system: conservative pendulum of the plan.
        place: orbit in the plan.
    """
    state, period = np.array(place.state), place.free_period
    end, monodromy = system.propagator.flow_with_stm(state, period)
    residual = float(np.abs(end - state).max())
    return LyapunovOrbit(
        saddle=place.saddle,
        energy=place.energy,
        family=0,
        state=state,
        period=period,
        system=system,
        monodromy=monodromy,
        floquet_multipliers=floquet_multipliers(system, state, period, monodromy),
        residual=residual,
        outcome=OrbitOutcome(OrbitCause.MEMBER, residual),
    )


def _flown(system: System, place: PlanOrbit, section: Section, *, hit: int, stable: bool) -> Iterator[TubeCurve]:
    """Yield both branches of an orbit's tube up to a section, before they are moved by the whole turns of a stop.

    A branch consists of `STRANDS` trajectories at most, at even phases of the orbit, and of the curve in which the tube
    meets the section. A branch that does not meet the section is left out.

    Args:
        system: conservative pendulum of the plan.
        place: orbit in the plan.
        section: section that cuts the tube.
        hit: number of the section crossing that is the cut, from 1.
        stable: True for the stable tube, which is the unstable one reversed in time.
    """
    orbit = _lyapunov(system, place)
    manifold = UnstableManifold(orbit)
    cut = tube_cut(manifold, section, hit=hit, settings=_CUT)
    # A row of NaN separates the pieces of a cut, so that no line joins them.
    gap = np.full((1, system.dimension), np.nan)
    for branch in (1, -1):
        pieces = [piece for piece in cut.pieces if piece.branch == branch]
        if not pieces:
            continue
        phases = np.concatenate([piece.phases for piece in pieces]) % 1.0
        times = np.concatenate([piece.times for piece in pieces])
        strand_rows = list(dict.fromkeys(int(np.argmin(np.abs(phases - k / STRANDS))) for k in range(STRANDS)))
        seeds, _ = manifold.seeds(phases[strand_rows], branch)
        instants = np.linspace(0.0, times[strand_rows], INSTANTS, axis=1)
        strands = np.array([system.propagator.sample(*flight) for flight in zip(seeds, instants, strict=True)])
        cut_states = np.vstack(
            [
                part
                for cut_piece in pieces
                for part in (cut_piece.states, cut_piece.states[: int(cut_piece.closed)], gap)
            ]
        )
        if stable:
            strands, cut_states = (
                (states - orbit.centre) @ orbit.reverser.T + orbit.centre for states in (strands, cut_states)
            )
        yield TubeCurve(stable, strands, cut_states)


def _at(curves: Iterable[TubeCurve], section: Section, *, lift: Array, height: float) -> Iterator[TubeCurve]:
    """Yield the parts of tubes that meet the section at the plan's height, moved by the stop's whole turns.

    Args:
        curves: branches of a tube from `_flown`.
        section: section of the symbol.
        lift: whole turns (n,) of the stop, rad.
        height: value of the section's coordinate in the plan, rad.
    """
    move, normal = np.pad(lift, (0, len(lift))), np.asarray(section.normal)
    for curve in curves:
        strands, cut = curve.strands + move, curve.cut + move
        at_section = np.abs(strands[:, -1] @ normal - height) < _HEIGHT
        if at_section.any():
            cut_at_section = np.abs(cut @ normal - height) < _HEIGHT
            yield TubeCurve(curve.stable, strands[at_section], np.where(cut_at_section[:, None], cut, np.nan))


def run_view(log: RunLog) -> RunView:
    """Return the data to draw of a log: series, plan, verdict and decoded itinerary.

    A log without a plan, such as a recording from a bench, has series only.

    Args:
        log: log of a run or a recording.

    Raises:
        InputError: the plan in the log is damaged.
    """
    view, arms = series_of(log), arms_in(log, MODEL_METADATA)
    system = None if arms is None else pendulum_system("model", arms)
    n = len(log.arm_lengths)
    states = log.states.get("truth", log.states.get("estimate"))
    view = replace(view, extra_truth=true_extras(log, view))
    if states is not None and system is not None:
        view = replace(view, energy=system.numeric.hamiltonian(states[:, : 2 * n]))
    if states is None or lacking(log):
        return replace(view, verdict=_without_plan(log))
    plan, verdict = plan_of(log), score(log)
    planned_view = plan_view(plan, system=system)
    if verdict.falls or verdict.catches:
        planned_view, decoded = _with_falls(log, states, plan, planned_view)
    else:
        decoded = decode_run(log.time, states[:, :n], plan)
    seed = "" if verdict.seed is None else f", seed {verdict.seed}"
    return replace(
        view,
        title=f"{plan.content.title} — {plan.content.itinerary}{seed}",
        limits=log.limits or limits_of(plan),
        verdict=verdict.sentence,
        good=verdict.completed,
        plan=planned_view,
        done=tuple(
            Stay(float(log.time[visit.first]), float(log.time[visit.last]), stop.saddle, stop.saddle)
            for visit, stop in zip(decoded.visits, plan.content.stops, strict=False)
        ),
        crossings=decoded.crossings,
    )


def _with_falls(log: RunLog, states: Array, plan: Reference, planned: PlanView) -> tuple[PlanView, Decoded]:
    """Return plan and decoded ticks of a run with falls, both on the clock of the run.

    The plan's clock stands still during a fall, so its times are moved to the ticks that count: those on the itinerary
    that no later stretch repeats.

    Args:
        log: log of the run.
        states: states (K, 2n+2) by which it is judged.
        plan: reference of the plan.
        planned: view of the plan on the plan's clock.
    """
    n, stretches = len(log.arm_lengths), stretches_of(log)
    motion = Flown(
        log.time, states, log.reference[:, :n], log.control["applied"], log.rate_hz, log.limits, stretches=stretches
    )
    counted_motion = spliced(motion, plan)
    rows = np.concatenate([rows for rows, _ in counted(stretches, rate_hz=log.rate_hz)])
    decoded = decode_run(counted_motion.time, counted_motion.angles, plan)

    def clock(time: float) -> float:
        """Return the run's time, s, at a time of the plan, s, by the ticks that count."""
        return float(np.interp(time, counted_motion.time, log.time[rows]))

    visits = (replace(visit, first=int(rows[visit.first]), last=int(rows[visit.last])) for visit in decoded.visits)
    crossings = tuple(None if crossing_time is None else clock(crossing_time) for crossing_time in decoded.crossings)
    plan_on_run_clock = replace(planned.timed(clock), duration=float(log.time[-1]))
    return plan_on_run_clock, replace(decoded, visits=tuple(visits), crossings=crossings)


def limits_of(plan: Reference) -> tuple[float, float, float]:
    """Return the cart's limits in a plan, as views and scores use them: position m, velocity m/s, acceleration m/s².

    Args:
        plan: reference with limits.
    """
    return plan.limits.position, plan.limits.velocity, plan.limits.acceleration


def plan_view(plan: Reference, *, system: System | None) -> PlanView:
    """Return the requirements of a plan, with its tubes if the pendulum is known.

    Args:
        plan: reference, with or without a plan.
        system: conservative pendulum of the plan; None if it is unknown.
    """
    content = plan.plan
    if content is None:
        return PlanView(duration=plan.duration)
    edges = [float(plan.mesh[0]), *(symbol.time for symbol in content.symbols), float(plan.mesh[-1])]
    return PlanView(
        orbits=_placed_orbits(content),
        saddle_energies={name: saddle.energy for name, saddle in content.saddles.items()},
        symbols=tuple((symbol.time, symbol.text) for symbol in content.symbols),
        tubes=() if system is None else tubes_of(content, system),
        planned=tuple(
            Stay(begin, end, stop.saddle, stop.saddle)
            for (first, last), stop in zip(pairwise(edges), content.stops, strict=True)
            for begin, end in _outside(content.transfers, first, last)
        ),
        transfers=content.transfers,
        duration=plan.duration,
    )


def _outside(transfers: tuple[tuple[float, float], ...], first: float, last: float) -> Iterator[tuple[float, float]]:
    """Yield the parts of a time range that no transfer covers, s; a plan's stays are drawn there.

    Args:
        transfers: begin and end of each transfer, s.
        first: begin of the range, s.
        last: end of the range, s.
    """
    overlapping = [transfer for transfer in transfers if transfer[1] > first and transfer[0] < last]
    edges = [first, *(time for transfer in overlapping for time in transfer), last]
    yield from ((begin, end) for begin, end in zip(edges[::2], edges[1::2], strict=True) if begin < end)


def _placed_orbits(content: PlanContent) -> tuple[PlanOrbit, ...]:
    """Return the orbits of a plan, moved by the whole turns of each of its stops, for phase planes."""
    orbits: dict[tuple[Any, ...], PlanOrbit] = {}
    for stop in content.stops:
        lift = content.lift(stop)
        for k in stop.orbits:
            curve = content.orbits[k].curve + np.pad(lift, (0, len(lift)))
            orbits[(k, *np.rint(lift).tolist())] = replace(content.orbits[k], curve=curve)
    return tuple(orbits.values())


def _without_plan(log: RunLog) -> str:
    """Return the text that a view shows in place of a verdict for a log without a plan."""
    seconds = float(log.time[-1] - log.time[0])
    sentence = log.metadata.get(SUMMARY) or (
        f"{len(log.time):,} samples at {log.rate_hz:g} Hz, {seconds:.4g} s; the log has no "
        f"{', '.join(lacking(log))}, so the motion is not judged"
    )
    return f"{sentence}; {lost(log.recovered)}" if log.recovered else sentence


def true_extras(log: RunLog, view: RunView) -> dict[str, Array | float]:
    """Return the true values of the estimated parameters by name, as far as a simulated log has them.

    Views draw them beside the estimates; see `RunView`. With the cart's acceleration as input only ratios to M12 count
    (one arm: M11), so the errors are those of ratios. The drive's error is the cart's acceleration in excess of the
    loop's command.

    Args:
        log: log of a run.
        view: data of that run.
    """
    if log.extras is None:
        return {}
    drawn_values = json.loads(log.metadata.get(DRAWN_METADATA, "{}"))
    extras: dict[str, Array | float] = {
        f"zero_{i}": float(zero) for i, zero in enumerate(np.cumsum(drawn_values.get("zeros", [])), start=1)
    }
    model, plant = arms_in(log, MODEL_METADATA), arms_in(log, PLANT_METADATA)
    if model is not None and plant is not None and model.count == plant.count:
        extras |= _relative_errors(model, plant)
    if view.control is not None and {ACTUAL, "applied"} <= view.control.keys() and len(log.time):
        # A mean over the ticks between two messages; in single ticks the command's noise dominates.
        excess = view.control[ACTUAL] - view.control["applied"]
        width = min(max(1, round(view.rate_hz / SLOW_RATE)), len(excess))
        mean_excess = np.convolve(np.nan_to_num(excess), np.full(width, 1 / width), mode="same")
        extras["drive"] = np.interp(log.extras.time, log.time, mean_excess)
    return {name: value for name, value in extras.items() if name in log.extras.names}


def _relative_errors(model: ArmChainParameters, plant: ArmChainParameters) -> dict[str, float]:
    """Return the relative differences between the plant's and the model's ratios, by the estimated parameter's name.

    Ratios are those of inertias M, couplings S and frictions to M12, or to M11 of one arm. Differences that are not
    finite are left out, and those of frictions if either has additional friction laws.
    """
    n = model.count
    names = [f"M{i}{j}" for i in range(1, n + 1) for j in range(i, n + 1)]
    # Weights lie between inertias and couplings and share the couplings' errors.
    names += ["" for _ in range(n)] + [f"S{i}" for i in range(1, n + 1)] + [f"friction_{i}" for i in range(1, n + 1)]
    unit_index = names.index("M12" if n > 1 else "M11")
    ratios = [arms.base()[: len(names)] / arms.base()[unit_index] for arms in (plant, model)]
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = dict(zip(names, (ratios[0] / ratios[1] - 1).tolist(), strict=True))
    # With additional friction laws a single number cannot describe the error.
    laws = bool(model.friction or plant.friction)
    return {
        name: error
        for name, error in errors.items()
        if name and math.isfinite(error) and not (laws and name.startswith("friction"))
    }


_RATE = 500.0
"""Rate at which references and orbits are sampled for drawing, Hz."""
_POINTS = 600
"""Number of points of a drawn Lyapunov orbit."""
_ARM = 0.2
"""Arm length that is drawn for a reference without arms, m."""


def reference_view(reference: Reference, path: Path) -> RunView:
    """Return the data to draw of a reference as if it were a run, with its input as the command.

    Args:
        reference: reference, with or without a plan.
        path: its file.
    """
    content, arms = reference.plan, reference.arms
    system = None if arms is None else pendulum_system("model", arms)
    plan = plan_view(reference, system=system)
    time = np.arange(reference.mesh[0], reference.mesh[-1], 1 / _RATE)
    states = reference.state(time)
    warning = "" if reference.converged else "NOT CONVERGED: "
    effort = f"{reference.duration:.4g} s, {reference.rms_cart_acceleration:.3g} m/s² rms"
    return RunView(
        path=path,
        title="A reference" if content is None else content.title,
        time=time,
        state=states,
        what="reference",
        arm_lengths=(_ARM,) * (states.shape[1] // 2 - 1) if arms is None else arms.length,
        has_cart=True,
        rate_hz=_RATE,
        control={"feedforward": reference.input(time)[:, 0]},
        energy=reference.energies(states),
        limits=limits_of(reference),
        metadata={} if content is None else {"program": content.origin.program},
        verdict=f"{warning}{reference.status}; {effort}",
        good=None if reference.converged else False,
        plan=plan,
        source=reference,
    )


def sustained_view(orbit: SustainedOrbit, arm_lengths: tuple[float, ...]) -> RunView:
    """Return the data to draw of one period of a sustained orbit, and of its Lyapunov orbit.

    Args:
        orbit: the sustained orbit.
        arm_lengths: lengths (n,), m.
    """
    lyapunov = orbit.lyapunov
    time = np.arange(0.0, orbit.period, 1 / _RATE)
    states = orbit.state(time)
    free_orbit = lyapunov.system.propagator.sample(lyapunov.state, np.linspace(0.0, lyapunov.period, _POINTS))
    effort = f"{orbit.reference.rms_cart_acceleration:.3g} m/s² rms"
    return RunView(
        path=Path(),
        title=f"Sustained orbit about {lyapunov.saddle} at {orbit.energy:g} J",
        time=time,
        state=states,
        what="orbit",
        arm_lengths=arm_lengths,
        has_cart=True,
        rate_hz=_RATE,
        control={"feedforward": orbit.input(time)},
        energy=lyapunov.system.numeric.hamiltonian(states[:, :-2]),
        limits=limits_of(orbit.reference),
        verdict=f"period {orbit.period:.5g} s, {effort}, within {orbit.departure:.2g} of the Lyapunov orbit (scaled)",
        plan=PlanView(
            orbits=(
                PlanOrbit(lyapunov.saddle, orbit.energy, lyapunov.period, lyapunov.unstable_multiplier, free_orbit),
            )
        ),
    )
