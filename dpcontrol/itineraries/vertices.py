"""A closed shadowing orbit as a vertex of the connection graph: any hyperbolic periodic orbit has tubes of its own.

The nodes of multiple shooting become the vertex's, so that nothing is integrated over its period, whose multiplier may
be 1e20. Time starts on the mirror that carries the orbit into itself: a reverser R with γ(-φ) = R γ(φ) about a resting
point, looked for among the system's reversers.

Source: Kaheman et al. (2023), section 4; Lamb & Roberts, Time-reversal symmetry in dynamical systems (1998).
"""

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.errors import InputError
from dpcontrol.itineraries.closed import ClosedOrbit
from dpcontrol.itineraries.shadowing import ShadowingOrbit
from dpcontrol.tubes.vertex import HyperbolicOrbit, hyperbolic_orbit

Array = NDArray[np.float64]

_ON_ORBIT = 1e-8  # scaled; states of one orbit and its mirror image agree to 1e-11
_SAMPLES = 24  # between neighbouring nodes, from which the nearest point is sought


def closed_vertex(orbit: ShadowingOrbit, *, name: str) -> HyperbolicOrbit:
    """Return a periodic shadowing orbit as a vertex called `name`, to be the source or target of connections.

    Raises:
        InputError: the orbit is not periodic, has not converged, or no reverser carries it into itself.
    """
    closed = orbit.orbit
    if not isinstance(closed, ClosedOrbit):
        raise InputError("an open walk's orbit is an edge of the graph: only a periodic one becomes a vertex")
    if not orbit.converged or orbit.certificate is None or orbit.certificate.multipliers is None:
        raise InputError(f"only an orbit that has converged becomes a vertex of the graph: {orbit.status}")
    system, multipliers = closed.system, orbit.certificate.multipliers
    for mirror in system.reversers:
        start = _mirrored_at(closed, float(orbit.symbol_times[0]), mirror)
        if start is not None:
            break
    else:
        raise InputError(
            f"the orbit of the walk {list(orbit.walk)} is not its own mirror image, so that its stable tube is not its "
            "unstable one turned around; choose a walk that reads the same either way, of symmetric connections"
        )
    first = closed.sample(np.array([start]))[0]
    lengths = system.turn_lengths
    halves = np.where(lengths > 0, lengths / 2, 1.0)
    # The resting point's part that the mirror turns over; what it keeps may be anything.
    rest = np.where(lengths > 0, np.rint((first - mirror @ first) / 2 / halves) * halves, 0.0)
    first = rest + ((first - rest) + mirror @ (first - rest)) / 2
    times, states = [0.0], [first]
    for rounds in (0, 1):
        for time, state in zip(closed.times[:-1], closed.states[:-1], strict=True):
            since = float(time) + rounds * closed.period - start
            if 1e-3 * closed.period / len(closed.times) < since < closed.period * (1 - 1e-3 / len(closed.times)):
                times.append(since)
                states.append(state + rounds * closed.turn)
    winding = np.where(lengths > 0, np.rint(closed.turn / np.where(lengths > 0, lengths, 1.0)), 0.0)
    return hyperbolic_orbit(
        system,
        name,
        energy=orbit.shot.guess.energy,
        multiplier=multipliers.sign * float(np.exp(multipliers.log_unstable)),
        mirror=mirror,
        rest=rest,
        winding=winding,
        times=np.array([*times, closed.period]),
        states=np.vstack([*states, first + closed.turn]),
        residual=orbit.residual,
        newton_residual=orbit.residual,
        status=orbit.status,
    )


def _mirrored_at(closed: ClosedOrbit, time: float, mirror: Array) -> float | None:
    """Return a time in [0, period) at which an orbit lies on the mirror, None if it is not its own mirror image."""
    system = closed.system
    image = mirror @ closed.sample(np.array([time]))[0]
    shares = np.arange(_SAMPLES) / _SAMPLES
    grid = (closed.times[:-1, None] + np.diff(closed.times)[:, None] * shares).ravel()
    at = float(grid[np.argmin(system.scaled_distance(closed.sample(grid), image))])
    for _ in range(8):
        near = closed.sample(np.array([at]))[0]
        gap = image - near
        gap = (gap - system.nearest_turns(gap) * system.turn_lengths) / system.scale
        slope = system.numeric.rate(near) / system.scale
        at += float(gap @ slope / (slope @ slope))
    # At one symbol, the orbit of an asymmetric walk may be as near its image as the stops beside it are long.
    images = closed.sample(time + at - closed.times)
    if float(system.scaled_distance(closed.states @ mirror.T, images).max()) > _ON_ORBIT:
        return None
    # A point and its image lie as far before the mirror as behind it.
    return ((time + at) / 2) % closed.period
