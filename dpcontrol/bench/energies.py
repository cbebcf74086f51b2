"""Chart of an itinerary's effort and peak gain over energies, to judge the chosen one.

A walk of the same connections exists at many energies. The connections are continued from the itinerary's energy,
because its symbols may mean others elsewhere. Each walk is planned, and flown by the itinerary's law on plants with 5 %
mismatch. The result is ∫u² of the whole loop, reference and correction, over completed runs.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dpcontrol.bench.chart import ChartPage, Diagram, Missing, Point
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.lyapunov import equilibrium
from dpcontrol.plans.authority import peak_gains
from dpcontrol.plans.itinerary import Itinerary, WalkPart
from dpcontrol.plans.plan import Plan
from dpcontrol.plans.planning import planned
from dpcontrol.runs.campaign import Case, Job, run_job
from dpcontrol.walks.following import SymbolBranches
from dpcontrol.walks.symbols import parse_walk

MISMATCH = 0.05
"""Mismatch of the plants on which walks are run."""
ENERGIES = (0.25, 0.4, 0.65, 1.0, 1.5, 2.5)
"""Energies to try, as multiples of the itinerary's energy above that of its highest saddle."""
RUNS = 16
"""Number of runs at each energy."""
POOR = 1.1
"""Multiple of the least effort above which an itinerary's energy is a poor choice."""


def energies_chart(itinerary: Itinerary, progress: Progress = no_progress) -> ChartPage:
    """Return the chart of an itinerary's effort over energies, of the reference and of the loop at ±5 %.

    Args:
        itinerary: one walk at one energy.
        progress: called with a label and the completed share.

    Raises:
        InputError: the itinerary is not one walk at one energy.
        GoalMissed: its energy cannot be planned, or no run completes.
    """
    walk, system = only_walk(itinerary), itinerary.model.system
    symbols = parse_walk(walk.walk, system.saddles)
    names = {saddle for symbol in symbols for part in symbol.simple for saddle in (part.source, part.target)}
    floor = max(equilibrium(system, name).energy for name in names)
    points, missing = [], []
    branches = {
        parsed_symbol.text: SymbolBranches(system, parsed_symbol)
        for parsed_symbol in symbols
        if not parsed_symbol.parts and parsed_symbol.name is None
    }
    connection_of_symbol = {text: branch.chosen(walk.energy) for text, branch in branches.items()}

    def symbol_at_energy(text: str, energy: float) -> str:
        """Return a symbol's text at another energy, J, to which its connection is followed, or raise GoalMissed."""
        connection = connection_of_symbol.get(text)
        if connection is None or energy == walk.energy:
            return text
        followed = branches[text].followed(connection, energy)
        if followed is None:
            raise GoalMissed(f"{text}: its connection at {walk.energy:.4g} J cannot be followed to this energy")
        return followed.name

    for k, factor in enumerate(ENERGIES):
        energy = walk.energy if factor == 1.0 else floor + factor * (walk.energy - floor)
        label = f"{energy:.3g} J"
        progress(label, k / len(ENERGIES))
        try:
            texts = tuple(symbol_at_energy(text, energy) for text in walk.walk)
            effort = at_energy(itinerary, replace(walk, energy=energy, walk=texts), RUNS)
        except (InputError, GoalMissed) as error:
            missing.append(Missing("loop", label, str(error)))
            continue
        points.append(Point("reference", label, energy - floor, effort["reference"], others=effort))
        if effort["completed"]:
            note = f"{effort['completed']:.0%} come through"
            points.append(Point("loop", label, energy - floor, effort["loop"], factor == 1.0, note=note, others=effort))
        else:
            missing.append(Missing("loop", label, f"no run completes at ±{MISMATCH:.0%}"))
    if not any(p.default for p in points):
        raise GoalMissed(f"{itinerary.name}: no comparison without its energy: {missing[0].reason}")
    axis = "energy above the highest saddle's, J"
    effort_diagram = Diagram(itinerary.title, axis, "∫u², m²/s³", tuple(points), missing=tuple(missing), judged=False)
    gains = tuple(
        replace(p, method="peak gain", error=p.others["peak_gain"]) for p in points if p.method == "reference"
    )
    gain_diagram = Diagram("What it asks of the feedback", axis, "peak gain, m/s² per rad", gains, judged=False)
    return ChartPage(
        name=f"{itinerary.name}-energies",
        title=f"{itinerary.name}: effort over energies",
        reading=(
            "A mark is the whole itinerary planned at one energy; the ring marks the itinerary's.",
            "reference: the effort of the plan alone, on a plant equal to the model.",
            f"loop: mean effort of completed runs, of {RUNS} plants off by {MISMATCH:.0%}. The connections of "
            f"{walk.energy:.4g} J are followed to the other energies.",
            "peak gain: the largest gain of the feedback on an arm's angle; it multiplies what hides the angle.",
        ),
        chosen=energy_text(walk.energy, points),
        parts=(effort_diagram, gain_diagram),
    )


def only_walk(itinerary: Itinerary) -> WalkPart:
    """Return the single walk of an itinerary, because a comparison of energies needs one.

    Raises:
        InputError: the itinerary has other parts.
    """
    if len(itinerary.parts) == 1 and itinerary.walks:
        return itinerary.walks[0]
    parts = f"has {len(itinerary.parts)} parts" if len(itinerary.parts) > 1 else "is no walk"
    raise InputError(
        f"{itinerary.path}: --explore-energy compares energies of one walk, and this itinerary {parts}; "
        "name one that is a single walk"
    )


def at_energy(itinerary: Itinerary, walk: WalkPart, runs: int) -> dict[str, float]:
    """Return the figures of a walk at its energy: efforts of reference and loop, and the share of completed runs.

    Args:
        itinerary: itinerary of the walk.
        walk: walk at another energy.
        runs: number of runs at the mismatch `MISMATCH`, ±5 %.

    Returns:
        Efforts ∫u² dt of the "reference" and of the "loop", m²/s³; that of the loop is the mean of completed runs, NaN
            without any. The share "completed", the "duration", s, the "energy", J, and the "peak_gain" of the arms
            along the reference.

    Raises:
        GoalMissed: no reference was found at this energy.
    """
    # The plan is not cached: its content quotes the itinerary's text, which has another energy.
    reference = planned(replace(itinerary, parts=(walk,)))
    if not reference.converged:
        raise GoalMissed(reference.status)
    plan = Plan(itinerary, reference, Path(), cached=False)
    case = Case("", (), replace(itinerary.loop, mismatch=MISMATCH))
    job = Job(itinerary.name, plan.archive, itinerary.model.arms, case, tuple(range(runs)), "compiled", replayed=0)
    completed_rows = [row for row in run_job(job) if row["completed"]]
    efforts = [row["rms_cart_acceleration"] ** 2 * row["simulated_seconds"] for row in completed_rows]
    return {
        "reference": reference.rms_cart_acceleration**2 * reference.duration,
        "loop": float(np.mean(efforts)) if efforts else float("nan"),
        "completed": len(completed_rows) / runs, "duration": reference.duration, "energy": walk.energy,
        "peak_gain": float(peak_gains(itinerary.model.arms, reference).max()),
    }  # fmt: skip


def energy_text(chosen: float, points: Sequence[Point]) -> str:
    """Return a sentence that judges the itinerary's energy by the effort of completed runs.

    Energies at which fewer runs complete do not count as better.

    Args:
        chosen: energy of the itinerary, J.
        points: points "reference" and "loop" at each energy, with the effort as error; the itinerary's is the default.
    """
    loop_points = [point for point in points if point.method == "loop"]
    best_share = max(point.others["completed"] for point in loop_points)
    best = min(
        (point for point in loop_points if point.others["completed"] == best_share), key=lambda point: point.error
    )
    present = next(point for point in loop_points if point.default)
    completed = present.others["completed"]
    if completed == best_share and present.error <= POOR * best.error:
        return (
            f"{chosen:.4g} J is a good choice: at ±{MISMATCH:.0%} no energy tried takes {1 - 1 / POOR:.0%} less effort"
        )
    runs = "" if completed == best_share else f", and {best_share:.0%} of runs complete it, not {completed:.0%}"
    return (
        f"{chosen:.4g} J is a poor choice: {best.others['energy']:.4g} J takes {best.error:.3g} m²/s³ at "
        f"±{MISMATCH:.0%}, not {present.error:.3g}{runs}"
    )
