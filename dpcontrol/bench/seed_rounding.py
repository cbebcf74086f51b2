"""What rounding leaves of a search for connections whose tubes are seeded very near their orbit.

A seed at phase φ lies δ (scaled) from its orbit along the unstable vector v(φ), of scaled length |v|. With μ = ln λ,
all seeds of one trajectory, near or far, have the same

    ψ = φ + ln|v|/μ - ln δ/μ

so that a tube's cut is a curve P(ψ). Rounding ρ at the seed changes its amplitude by the share ρ/δ. That moves its
arrival along the curve, to P(ψ + α), and nowhere else; α is independent from flight to flight, with a standard
deviation of σ(φ)/δ. Newton's method answers the rounding of its last step and meets that of the next one. After the
steps that answer its guess, the gap that it finds between both tubes is

    P₁' (α_k - α_{k-1}) - P₂' (β_k - β_{k-1}),      k = 1 … n

and a meeting is found when one of these n gaps lies below `accept`. Closed cuts cross evenly: where the meetings found
do not, a search begins anew, with chords half as long. That a meeting may also be found from one close beside it is
left out.

P' and σ are measured with seeds at the default distance, far from where searches fail. σ is about 2e-17.
Source: for rounding, Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., section 2.8.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.tubes.cut import Cut, tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, Intersection, TubeSide, balanced, intersect_cuts
from dpcontrol.tubes.manifold import UnstableManifold
from dpcontrol.tubes.orbit_curve import local_manifold

Array = NDArray[np.float64]

DEFAULT = ConnectionSettings().distance
ANEW = 1e-6
"""Share of the distance whose change draws all rounding anew, and changes nothing else."""
ANSWERING = 2
"""Newton's steps from a guess to rounding: guesses are good to 1e-4 of a phase, and a step about squares that."""
_SAME = 1e-6
"""Scaled: how far a meeting may lie from that at the default distance; rounding leaves less, others are 1e-3 away."""
_BESIDE = 1e-13
"""Phase between arrivals that differ by rounding alone."""
_FLIGHTS = 40
_PHASES = 48
_TURN = 0.5
"""Phases that far apart are images under the half turn, and so is their rounding."""
_SEQUENCES = 1000


def cut_from(manifold: UnstableManifold, settings: ConnectionSettings) -> Cut:
    """Return a tube's cut with the section of its orbit's saddle."""
    orbit = manifold.orbit
    return tube_cut(manifold, orbit.system.section_between(orbit.saddle, orbit.saddle), hit=1, settings=settings.cut)


def meetings(manifold: UnstableManifold, cut: Cut, settings: ConnectionSettings) -> list[Intersection]:
    """Return where an orbit's tubes meet, no two of them images under the half turn; `cut` gives the first guesses."""
    pair = (manifold, manifold)
    return intersect_cuts(manifold.orbit.system, cut.section, pair, (cut, cut), settings)[0]


class Searches:
    """Searches for an orbit's connections with itself, up to where multiple shooting refines what they have found.

    wanted: the meetings that a search finds at the default distance. Each draw has rounding of its own; the cuts of a
    distance are made once, for they give first guesses only.
    """

    def __init__(self, orbit: LyapunovOrbit) -> None:
        self.orbit = orbit
        self.settings = ConnectionSettings()
        self.manifold = local_manifold(orbit, DEFAULT)
        self.cut = cut_from(self.manifold, self.settings)
        self.wanted = meetings(self.manifold, self.cut, self.settings)
        self._cuts: dict[tuple[float, float], Cut] = {}

    def found(self, distance: float, draw: int, *, again: bool = True) -> NDArray[np.bool_]:
        """Return which meetings (K,) one search finds; again: it begins anew where those found cross unevenly."""
        settings = replace(self.settings, distance=distance)
        manifold = local_manifold(self.orbit, distance * (1 + ANEW * draw))
        while True:
            key = (distance, settings.cut.chord)
            if key not in self._cuts:
                self._cuts[key] = cut_from(local_manifold(self.orbit, distance), settings)
            cut = self._cuts[key]
            here = meetings(manifold, cut, settings)
            finer = replace(settings, cut=replace(settings.cut, chord=settings.cut.chord / 2))
            if not again or balanced(here, (cut, cut)) or finer.cut.chord < settings.finest:
                break
            settings = finer
        apart = self.orbit.system.scaled_distance
        return np.array([any(bool(apart(h.states[0], w.states[0]) < _SAME) for h in here) for w in self.wanted])


def places(manifold: UnstableManifold, phases: Array) -> tuple[Array, Array]:
    """Return φ + ln|v|/μ at phases φ (K,), and its derivative by φ (K,)."""
    frame, scale = manifold.frame(phases), manifold.orbit.system.scale
    along = np.sum(frame.vectors * frame.vector_slopes / scale**2, axis=1) / frame.lengths**2
    return np.asarray(phases + np.log(frame.lengths) / manifold.exponent), 1 + along / manifold.exponent


def rounding(side: TubeSide, phase: float) -> float:
    """Return σ at a phase: the scatter of ψ among arrivals, times the distance of the seeds; NaN where none arrives."""
    manifold, arrival = side.manifold, side.arrive(phase)
    if arrival is None:
        return np.nan
    state, slope, _ = arrival
    offsets = _BESIDE * np.arange(-_FLIGHTS // 2, _FLIGHTS // 2)
    # One by one, as Newton's method asks for them: seeds made together share some of their rounding.
    seeds = np.array([manifold.seeds(np.array([phase + offset]), side.branch)[0][0] for offset in offsets])
    flown = manifold.orbit.system.propagator.crossings(seeds, side.section, longest=side.longest, hit=side.hit)
    here = np.array([crossing is not None for crossing in flown])
    states = side.turned(np.array([crossing.state for crossing in flown if crossing is not None]))
    shifts = (states - state) @ slope / (slope @ slope) - offsets[here]
    return float(np.std(shifts) * places(manifold, np.array([phase]))[1][0]) * manifold.distance


@dataclass(frozen=True)
class Chances:
    """How likely a search from seeds at some distance finds each meeting, and all of them, by the module's theory."""

    searches: Searches

    @cached_property
    def _rounding(self) -> tuple[Array, Array]:
        """Phases (K,), and σ there (K,)."""
        phases = np.linspace(0.0, _TURN, _PHASES, endpoint=False)
        side = self.searches.wanted[0].sides[0]
        sigma = np.array([rounding(side, float(phase)) for phase in phases])
        return phases[np.isfinite(sigma)], sigma[np.isfinite(sigma)]

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """φ + ln|v|/μ (K,) and phases φ (K,) along half a period."""
        phases = np.linspace(0.0, _TURN, 201)
        return places(self.searches.manifold, phases)[0], phases

    @cached_property
    def _curves(self) -> list[list[tuple[float, Array]]]:
        """For each meeting and tube: φ + ln|v|/μ of its seed at the default distance, and P' (N,)."""
        curves = []
        for meeting in self.searches.wanted:
            pair = []
            for side, phase in zip(meeting.sides, meeting.phases, strict=True):
                arrival = side.arrive(float(phase))
                assert arrival is not None, "a meeting arrives"
                place, rate = (float(value[0]) for value in places(side.manifold, np.array([phase])))
                pair.append((place, arrival[1] / rate))
            curves.append(pair)
        return curves

    @cached_property
    def _draws(self) -> Array:
        """Changes (K, 2, sequences, n) from step to step of rounding of unit deviation."""
        steps = self.searches.settings.newton_iterations - ANSWERING
        shape = (len(self.searches.wanted), 2, _SEQUENCES, steps + 1)
        return np.diff(np.random.default_rng(0).standard_normal(shape), axis=-1)

    @cached_property
    def _uneven(self) -> list[NDArray[np.bool_]]:
        """The sets of meetings (K,) that make a search begin anew."""
        wanted, cuts = self.searches.wanted, (self.searches.cut, self.searches.cut)
        every = [np.array(kept, dtype=bool) for kept in product((False, True), repeat=len(wanted))]
        return [kept for kept in every if not balanced([wanted[k] for k in np.flatnonzero(kept)], cuts)]

    def deviation(self, place: float, distance: float) -> float:
        """Return that of α; place: φ + ln|v|/μ at the default distance of the trajectory whose seed is moved."""
        goal = place + np.log(distance / DEFAULT) / self.searches.manifold.exponent
        known, phases = self._places
        within = known[0] + (goal - known[0]) % _TURN
        return float(np.interp(np.interp(within, known, phases), *self._rounding, period=_TURN)) / distance

    def each(self, distance: float) -> Array:
        """Return the chance (K,) of each meeting, in a search that does not begin anew."""
        chances = []
        for draws, pair in zip(self._draws, self._curves, strict=True):
            first, second = (
                changes[..., None] * (self.deviation(place, distance) * slope)
                for changes, (place, slope) in zip(draws, pair, strict=True)
            )
            gaps = np.abs(first - second).max(axis=-1).min(axis=-1)
            chances.append(np.mean(gaps < self.searches.settings.accept))
        return np.array(chances)

    def all(self, distance: float) -> float:
        """Return the chance that a search finds all meetings."""
        settings, each = self.searches.settings, self.each(distance)
        at_once = float(np.prod(each))
        anew = sum(float(np.prod(np.where(kept, each, 1 - each))) for kept in self._uneven)
        chance = at_once
        for _ in range(int(np.log2(settings.cut.chord / settings.finest))):
            chance = at_once + anew * chance
        return chance

    def distance(self, chance: float = 0.5) -> float:
        """Return the distance at which a search finds all meetings with a chance."""
        low, high = 1e-4 * DEFAULT, DEFAULT
        while high / low > 1.01:
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if self.all(middle) >= chance else (middle, high)
        return float(np.sqrt(low * high))
