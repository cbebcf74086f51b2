"""Rates at which motions pass the neck of a saddle, without simulation.

At an energy above its saddle, a Lyapunov orbit bounds a surface across the neck that motions pass in either direction.
The flux in each direction is the orbit's action A = ∮ p dq. The invariant measure δ(H - E) dq dp of the energy surface
has the volume

    Ω = ∫ 2π √(det M(q)) dq,      V(q) < E,

with the mass matrix M and the energy V at rest. A motion that visits its part of the energy surface evenly therefore
passes the neck every Ω/2A on average, once in Ω/A each way. This part extends from both sides of the neck through all
open necks, so the orbits of one energy usually share its volume.

Motions inside a tube meet a section in its cut, whose canonical area is A. Those in the cuts of an unstable and of a
stable tube pass the neck again at once, before they return to the section.

A grid covers the places. In each cell, the border V = E is taken as a line across V's gradient, so the volume converges
with the square of the cells' size.

Source: MacKay, Flux over a saddle, Physics Letters A 145 (1990).
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.foundation.arrays import Array, Flags
from dpcontrol.foundation.causes import TransportCause
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.units import InUnits
from dpcontrol.orbits.cut import Cut
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.words.searches import Concluded

ndimage = Later("scipy.ndimage")
_CELLS = 240
"""Cells along each coordinate."""
_FARTHEST = 64.0
"""Distance from the saddle beyond which an energy surface is unbounded, in the system's scale."""
_BLOCK = 2.5
"""Half-width of the square about a saddle that the saddle's energy opens or closes, in cells."""
_MOMENTS = 256
_RADII = np.sqrt((np.arange(64) + 0.5) / 64)
"""Distances of points from the middle of a cut, in equal parts of its area."""
_CLOSED = 0.01
"""Largest relative difference of a cut's area from the action if the cut is closed."""


@dataclass(frozen=True)
class Transport(Concluded, InUnits, Documented):
    """Rates of passage through the neck of a Lyapunov orbit.

    Attributes:
        saddle: saddle of the neck.
        energy: energy of the orbit, J.
        action: ∮ p dq of the orbit, the flux through the neck in each direction, J s.
        volume: volume of the energy surface that extends from both sides of the neck, J s²; infinite if it is
            unbounded, NaN if it is unknown.
        returns: shares of the passages in each direction, by the branches +1 and -1 of the unstable tube, after which
            the neck is passed again before the section is met again; None for a cut that is open.
        cause: whether the rates are known.
        si: True for SI units.
    """

    KEYS: ClassVar[str] = "saddle energy action volume mean_time returns status"

    saddle: str
    energy: float
    action: float
    volume: float
    returns: tuple[float | None, float | None]
    cause: TransportCause
    si: bool = True

    @property
    def converged(self) -> bool:
        """True if there is a mean time."""
        return self.cause is TransportCause.FINITE

    @property
    def mean_time(self) -> float:
        """Mean time between passages in either direction, s; those in one direction are twice as far apart."""
        return self.volume / (2 * self.action)


def transport(orbit: LyapunovOrbit) -> Transport:
    """Return the rates of passage through the neck of an orbit.

    Args:
        orbit: orbit of a system of two coordinates.

    Raises:
        GoalMissed: the orbit did not converge.
        InputError: the system has another number of coordinates.
    """
    system, tube = orbit.system, orbit.manifold()
    if system.dimension != 4:
        raise InputError(
            f"{system.name} has {system.dimension // 2} coordinates: orbits surround necks for two coordinates only"
        )
    states = orbit.sample(_MOMENTS + 1)[1:]
    action_rate = np.sum(system.numeric.momentum(states) * system.numeric.rate(states)[:, :2], axis=1)
    action = float(action_rate.mean()) * orbit.period
    volume, cause = _volume(orbit, states)
    section = system.sections.get((orbit.saddle, orbit.saddle))
    cut = tube.cut(section) if section is not None and section.kept_by(orbit.reverser, orbit.centre) else None
    branches = (1, 1) if tube.manifold.branches_are_mirrored else (1, -1)
    shares = {branch: None if cut is None else _share(orbit, cut, action, branch) for branch in branches}
    first, second = (shares[branch] for branch in branches)
    return Transport(orbit.saddle, orbit.energy, action, volume, (first, second), cause, system.si)


def _at_rest(system: System, states: Array) -> Array:
    """Return the states (…, N) at the same places at rest, with coordinates' rates of zero.

    The second half of a state can be momenta, which are not zero at rest in every frame. The values without rates are
    therefore solved for.
    """
    rates, slopes = system.numeric.rate(states)[..., :2], system.numeric.jacobian(states)[..., :2, 2:]
    return states - np.concatenate([0 * rates, np.linalg.solve(slopes, rates[..., None])[..., 0]], axis=-1)


def _volume(orbit: LyapunovOrbit, states: Array) -> tuple[float, TransportCause]:
    """Return the volume of the energy surface on both sides of an orbit's neck, J s², and whether it is finite.

    A box about the saddle grows until it contains all places that motions reach from the neck. `states` (K, N): of the
    orbit.
    """
    system, centre, mass = orbit.system, orbit.centre[:2], orbit.system.numeric.mass_matrix
    if not np.allclose(mass(states), mass(_at_rest(system, states))) or np.linalg.eigvalsh(mass(states)).min() <= 0:
        return np.nan, TransportCause.OTHER_KINETIC_ENERGY
    periodic = np.isfinite(system.periods[:2])
    size = np.where(periodic, system.turn_lengths[:2] / 2, system.scale[:2])
    box, tiles = centre + np.outer([-1, 1], size), np.where(periodic, 3, 1)
    while (np.abs(box - centre) <= _FARTHEST * size).all():
        widths = (box[1] - box[0]) / _CELLS
        places = box[0] + widths * (np.moveaxis(np.indices((_CELLS, _CELLS)), 0, -1) + 0.5)
        rest_states = _at_rest(system, np.concatenate([places, 0 * places], axis=-1))
        covered = _covered(system, orbit.energy, rest_states, widths)
        passable = covered > 0
        for saddle in (system.equilibria[name] for name in system.saddles):
            # Necks narrower than a cell are open or closed by the energy of their saddle.
            differences = rest_states - saddle - system.nearest_turns(rest_states - saddle) * system.turn_lengths
            neck = (np.abs(differences[..., :2]) < _BLOCK * widths).all(axis=-1)
            passable[neck] = system.numeric.hamiltonian(saddle) < orbit.energy
        # Of three copies along an angle, parts that leave the middle one continue in the others.
        labelled: Any = ndimage.label(np.tile(passable, tiles))
        start = np.floor((centre - box[0]) / widths).astype(int) + _CELLS * (tiles // 2)
        reached = labelled[0] == labelled[0][tuple(start)]
        reached = reached.reshape(tiles[0], _CELLS, tiles[1], _CELLS).any(axis=(0, 2))
        touched_edges = ~periodic & [[reached[k].any(), reached[:, k].any()] for k in (0, -1)]
        if not touched_edges.any():
            weight = 2 * np.pi * np.sqrt(np.linalg.det(mass(rest_states[reached])))
            return float(weight @ covered[reached]) * float(widths.prod()), TransportCause.FINITE
        box = box + touched_edges * np.outer([-1, 1], box[1] - box[0])
    return np.inf, TransportCause.UNBOUNDED


def _covered(system: System, energy: float, rest: Array, widths: Array) -> Array:
    """Return the share (…) of each cell in which V < E, with V linear about the states (…, N) at rest.

    `energy`: E, J. `rest` (…, N): states at the cells' middles. `widths`: widths of a cell along both coordinates. The
    area of a half-plane's part of a rectangle is the mixed second difference of x²/2, x > 0.
    """
    slopes = np.abs(system.numeric.gradient(rest)[..., :2]) * widths
    first, second = np.moveaxis(np.maximum(slopes, 1e-3 * slopes.max(axis=-1, keepdims=True) + 1e-12), -1, 0)
    largest_height = (first + second) / 2
    height = np.clip(energy - system.numeric.hamiltonian(rest), -largest_height, largest_height)
    corners = [
        first_sign * second_sign * np.maximum(height + (first_sign * first + second_sign * second) / 2, 0) ** 2
        for first_sign in (1, -1)
        for second_sign in (1, -1)
    ]
    return np.nan_to_num(sum(corners) / (2 * first * second))


def _share(orbit: LyapunovOrbit, cut: Cut, action: float, branch: int) -> float | None:
    """Return the share of a branch's cut that is inside the cuts of the stable tube, or None for an open cut.

    `cut`: unstable cut of the orbit. `action`: area of a closed cut, the orbit's ∮ p dq, J s. `branch`: +1 or -1. A cut
    consists of sectors about its middle, of which those beyond a bend are negative. Points (q, p/p₀) are complex.
    """
    system, section, stable = orbit.system, cut.section, orbit.manifold(stable=True)
    pieces, position = [piece for piece in cut.pieces if piece.branch == branch], np.asarray(section.position)
    radii = [piece.points @ [1, 1j] - np.mean(piece.points @ [1, 1j]) for piece in pieces]
    sectors = [(np.conj(radius) * np.roll(radius, -1)).imag / 2 for radius in radii]
    area = sum(abs(float(sector.sum())) for sector in sectors)
    if abs(area * momentum_scale(system, section) / (position @ position) / action - 1) > _CLOSED:
        return None
    whole_turn, shared_area = np.abs(position) @ system.turn_lengths, 0.0
    arriving = [stable.placed(piece, section) for piece in cut.pieces]
    for piece, radius, sector in zip(pieces, radii, sectors, strict=True):
        middles = np.mean(piece.points @ [1, 1j]) + np.outer(_RADII, radius + np.roll(radius, -1)).ravel() / 2
        curves = [curve.points @ [1, 1j] for curve in arriving if curve.direction == piece.direction]
        inside = [_is_inside(curve, middles + k * whole_turn) for curve in curves for k in (-1, 0, 1)]
        shared_area += abs(float(np.mean(np.any(inside, axis=0).reshape(len(_RADII), -1) @ sector))) if curves else 0.0
    return shared_area / area


def _is_inside(curve: Array, points: Array) -> Flags:
    """Return True (M,) for points (M,) inside a curve (K,), from which a ray crosses it an odd number of times."""
    next_points, column = np.roll(curve, -1), points[:, None]
    crosses = (curve.imag > column.imag) != (next_points.imag > column.imag)
    left_of_edge = (np.conj(next_points - curve) * (column - curve)).imag > 0
    return np.sum(crosses & (left_of_edge == (next_points.imag > curve.imag)), axis=1) % 2 == 1
