"""Samples of a tube's cut: seeds flown to the section, refined in phase until neighbouring points are close."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System, momentum_scale
from dpcontrol.tubes.manifold import UnstableManifold

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CutSettings:
    """How a tube is cut.

    chord: between neighbours in (q, p/p₀), in units of the system's section scale; longest: periods of the orbit that
    a trajectory may take, None for the system's own number; most_jumps: more phase intervals than this that stay wide
    below fine_phase_step mean that the curve is not a curve there (its trajectories scatter chaotically before they
    arrive), and refinement stops. grazing: a normal rate below this share of the largest means a grazing crossing.
    """

    first_phases: int = 100
    chord: float = 0.05
    smallest_phase_step: float = 1e-9
    longest: float | None = None
    most_points: int = 20_000
    fine_phase_step: float = 1e-4
    most_jumps: int = 40
    grazing: float = 0.01


def longest_flight(manifold: UnstableManifold, settings: CutSettings) -> float:
    """Return how many periods of its orbit a trajectory of the tube may take to the section."""
    return manifold.orbit.system.flight_periods if settings.longest is None else settings.longest


def section_points(system: System, section: Section, states: Array) -> Array:
    """Return (q, p/p₀), (…, 2), of states (…, N) on a section."""
    states = np.asarray(states, dtype=float)
    q = states @ np.asarray(section.position)
    p = system.numeric.momentum(states) @ np.asarray(section.momentum)
    return np.stack([q, p / momentum_scale(system, section)], axis=-1)


@dataclass(frozen=True)
class Sample:
    """One phase's trajectory: None where it never arrives."""

    phase: float
    state: Array | None
    time: float
    direction: int
    point: Array | None
    normal_rate: float


class Sampler:
    """Flies seeds of one branch to the section."""

    def __init__(
        self, manifold: UnstableManifold, section: Section, hit: int, branch: int, settings: CutSettings
    ) -> None:
        self.manifold, self.section, self.hit, self.branch = manifold, section, hit, branch
        self.settings = settings
        self.scale = momentum_scale(manifold.orbit.system, section)
        self.chord = settings.chord * manifold.orbit.system.section_scale
        self.longest = longest_flight(manifold, settings)

    def fly(self, phases: Array) -> list[Sample]:
        """Return the samples at phases (K,), flown together."""
        system = self.manifold.orbit.system
        seeds, _ = self.manifold.seeds(phases, self.branch)
        longest = self.longest * self.manifold.orbit.period
        crossings = system.propagator.crossings(seeds, self.section, longest=longest, hit=self.hit)
        arrived = [c for c in crossings if c is not None]
        if not arrived:
            return [Sample(float(p), None, np.inf, 0, None, 0.0) for p in phases]
        states = np.array([c.state for c in arrived])
        normal = system.numeric.rate(states) @ np.asarray(self.section.normal)
        q = states @ np.asarray(self.section.position)
        p = system.numeric.momentum(states) @ np.asarray(self.section.momentum) / self.scale
        out, k = [], 0
        for phase, c in zip(phases, crossings, strict=True):
            if c is None:
                out.append(Sample(float(phase), None, np.inf, 0, None, 0.0))
            else:
                point = np.array([q[k], p[k]])
                rate = float(normal[k])
                out.append(Sample(float(phase), c.state, c.time, int(np.sign(rate)), point, rate))
                k += 1
        return out


def continuous(a: Sample, b: Sample, limit: float) -> bool:
    """Whether two neighbouring samples are near each other on one curve."""
    if a.point is None or b.point is None or a.direction != b.direction:
        return False
    return math.dist(a.point, b.point) <= limit


def refined(sampler: Sampler, start: float) -> tuple[list[Sample], str]:
    """Sample one period from phase `start`, halving until chords are short or phases indistinguishable.

    Returns the samples and why refinement stopped early, empty if it did not.
    """
    settings = sampler.settings
    samples = sampler.fly(start + np.arange(settings.first_phases + 1) / settings.first_phases)
    while len(samples) < settings.most_points:
        wide = [
            k
            for k in range(len(samples) - 1)
            if not (samples[k].point is None and samples[k + 1].point is None)
            and samples[k + 1].phase - samples[k].phase > settings.smallest_phase_step
            and not continuous(samples[k], samples[k + 1], sampler.chord)
        ]
        if not wide:
            return samples, ""
        jumps = sum(samples[k + 1].phase - samples[k].phase < settings.fine_phase_step for k in wide)
        if jumps > settings.most_jumps:
            return samples, (
                f"branch {sampler.branch:+d} scatters before crossing {sampler.hit}: more than {settings.most_jumps} "
                f"jumps between phases {settings.fine_phase_step:g} apart; allow less time"
            )
        middles = sampler.fly(np.array([(samples[k].phase + samples[k + 1].phase) / 2 for k in wide]))
        merged, fresh = [], dict(zip(wide, middles, strict=True))
        for k, sample in enumerate(samples):
            merged.append(sample)
            if k in fresh:
                merged.append(fresh[k])
        samples = merged
    return samples, f"branch {sampler.branch:+d}: {settings.most_points} points leave wide chords; allow more"
