"""What there is to see of a reference, from its file alone, and of a sustained orbit."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dpcontrol.dynamics.chain import pendulum_system
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.reference import load_reference
from dpcontrol.references.summary import ReferenceSummary, summarised
from dpcontrol.references.sustained import SustainedOrbit
from dpcontrol.review.context import PlacedOrbit, PlanView
from dpcontrol.review.motion import RunView
from dpcontrol.review.of_log import limits_of, plan_view

_RATE = 500.0  # Hz
_POINTS = 600  # of an orbit
_ARM = 0.2  # m: drawn where a reference does not say for which arms it was made


def read_reference_view(file: Path) -> RunView:
    """Return what there is to see of a reference's file; its error between nodes is measured anew.

    Raises:
        InputError: the file is no reference, or its notes are not those of a plan.
    """
    reference = load_reference(file)
    try:
        return reference_view(summarised(reference), Path(file))
    except InputError as error:
        raise InputError(f"{file}: {error}") from error


def reference_view(summary: ReferenceSummary, path: Path) -> RunView:
    """Return what there is to see of a reference, its input as the command.

    Raises:
        InputError: its notes are not those of a plan.
    """
    reference = summary.reference
    notes: Mapping[str, Any] = reference.notes
    system = None if summary.arms is None else pendulum_system("model", summary.arms)
    plan = plan_view(reference, system=system)
    time = np.arange(reference.mesh[0], reference.mesh[-1], 1 / _RATE)
    states = reference.state(time)
    state = "" if reference.converged else "NOT CONVERGED: "
    effort = f"{reference.duration:.4g} s, {reference.rms_cart_acceleration:.3g} m/s² rms"
    made_from = notes.get("made_from") or {}
    return RunView(
        path=path,
        title=str(notes.get("title") or notes.get("itinerary") or "A reference"),
        time=time,
        state=states,
        what="reference",
        arm_lengths=(_ARM,) * (states.shape[1] // 2 - 1) if summary.arms is None else summary.arms.length,
        has_cart=True,
        rate_hz=_RATE,
        control={"feedforward": reference.input(time)[:, 0]},
        energy=summary.energies(states),
        limits=limits_of(reference),
        metadata={"program": str(made_from.get("program", ""))},
        verdict=f"{state}{reference.status}; {effort}",
        good=None if reference.converged else False,
        plan=plan,
        summary=summary,
    )


def sustained_view(orbit: SustainedOrbit, arm_lengths: tuple[float, ...]) -> RunView:
    """Return what there is to see of one period of a sustained orbit, beside its Lyapunov orbit; arm_lengths in m."""
    lyapunov = orbit.lyapunov
    time = np.arange(0.0, orbit.period, 1 / _RATE)
    states = orbit.state(time)
    free = lyapunov.system.propagator.sample(lyapunov.state, np.linspace(0.0, lyapunov.period, _POINTS))
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
        plan=PlanView(orbits=(PlacedOrbit("Lyapunov orbit", free, lyapunov.saddle),)),
    )
