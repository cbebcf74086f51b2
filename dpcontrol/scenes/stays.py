"""Itineraries that go nowhere: one equilibrium held, or one periodic orbit kept, for so many seconds.

The orbit is the one that friction and cart sustain (`references.sustained`), repeated for whole periods.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.method import method_named
from dpcontrol.references.reference import Reference, joined, still
from dpcontrol.references.sustained import SustainedSettings, sustained_orbit
from dpcontrol.scenes.itinerary import HoldPart, Itinerary, OrbitPart
from dpcontrol.scenes.notes import STILL, notes_of

Array = NDArray[np.float64]


def plan_stay(
    itinerary: Itinerary, part: HoldPart | OrbitPart, *, progress: Progress = no_progress
) -> tuple[Reference, dict[str, Any], dict[str, Array]]:
    """Return the reference that stays, its notes and the arrays that go with them.

    Raises:
        GoalMissed: the orbit was not found.
    """
    system, arms = itinerary.model.system, itinerary.model.arms
    n = system.dimension // 2
    if isinstance(part, HoldPart):
        state = system.equilibrium(part.hold)
        settings = itinerary.reference
        interval = max(settings.interval, 0.05)
        whole = np.concatenate([state, [0.0, 0.0]])
        method = method_named(settings.method)
        reference = still(whole, part.seconds, method=method, limits=itinerary.limits, interval=interval)
        name, energy = part.hold, float(system.numeric.hamiltonian(state))
        orbit = {"saddle": name, "energy": energy, "period": STILL, "multiplier": 1.0}
        samples = np.vstack([state, state])
        stay: dict[str, Any] = {"kind": "hold", "hold": name}
    else:
        lyapunov = lyapunov_orbit(system, part.orbit, energy=part.energy, family=part.family)
        if not lyapunov.converged:
            raise GoalMissed(f"the Lyapunov orbit about {part.orbit} at {part.energy:g} J: {lyapunov.status}")
        sustained = SustainedSettings(limits=itinerary.limits)
        found = sustained_orbit(lyapunov, arms, settings=sustained, progress=progress)
        if not found.converged:
            raise GoalMissed(f"the sustained orbit about {part.orbit} at {part.energy:g} J: {found.status}")
        one = found.reference
        reference, _ = joined([one] * max(1, round(part.seconds / found.period)))
        reference = replace(reference, status=one.status, iterations=one.iterations, solve_seconds=one.solve_seconds)
        name, energy = part.orbit, part.energy
        orbit = {"saddle": name, "energy": energy, "period": found.period, "multiplier": lyapunov.unstable_multiplier}
        samples = np.asarray(found.state(np.linspace(0.0, found.period, 401))[:, : 2 * n])
        state = system.equilibrium(name)
        stay = {
            "kind": "orbit",
            "orbit": name,
            "energy": energy,
            "family": part.family,
            "intervals": len(one.mesh) - 1,
            "lyapunov_period": lyapunov.period,
        }
    stop = {"saddle": name, "angles": state[:n].tolist(), "orbit": 0}
    notes = notes_of(itinerary, stops=[stop], symbols=[], wraps=[], orbits=[orbit], energy=energy)
    return reference, {**notes, "stay": stay}, {"orbit_0": samples}
