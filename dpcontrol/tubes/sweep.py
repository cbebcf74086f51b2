"""One step of a sweep in energy: search at both ends, follow what they do not share, locate what happened between.

Connections found at one energy are carried to the next by Newton's method; a connection that arrives there with the
tangency's sign unchanged has met no turn. Those left over on either side are followed round their turns.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.tubes.cut import tube_cut
from dpcontrol.tubes.intersections import ConnectionSettings, intersect_cuts
from dpcontrol.tubes.link_events import Located, locate_graze, locate_turn
from dpcontrol.tubes.link_paths import Path, PathPoint, follow
from dpcontrol.tubes.link_profile import profile
from dpcontrol.tubes.links import Link, LinkProblem
from dpcontrol.tubes.manifold import UnstableManifold

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SweepSettings:
    """How energies are swept. energies: how many at first; halvings: of an interval that does not add up.

    same: largest difference of phases at which two links are one; closest: energies nearer to a saddle's than this
    part of the energy scale are left out, tubes being thinner there than their seeds are far.
    """

    energies: int = 24
    halvings: int = 3
    same: float = 1e-4
    closest: float = 1e-4
    search: ConnectionSettings = field(default_factory=ConnectionSettings)


@dataclass(frozen=True)
class Found:
    """Links found at one energy, each solved, one of every two that the symmetry S exchanges."""

    energy: float
    points: tuple[PathPoint, ...]
    weight: int
    complete: bool
    caveat: str

    @property
    def count(self) -> int:
        return self.weight * len(self.points)


@dataclass(frozen=True)
class Change:
    """An event of one link between two energies and what it adds to the number of links, going up in energy."""

    event: Located
    gain: int
    symmetric: bool


class Sweep:
    """One sweep's problem and its searches."""

    def __init__(self, system: System, source: str, target: str, crossings: int, settings: SweepSettings) -> None:
        self.problem = LinkProblem(system, source, target, distance=settings.search.distance)
        self.section = system.sections[source, target]
        self.crossings, self.settings = crossings, settings
        self.same_saddle = source == target

    def search(self, energy: float) -> Found:
        """Find the links with the asked number of crossings at one energy.

        Where crossings of the cuts do not converge, as next to a graze, the search is repeated with finer cuts.
        """
        try:
            manifolds = self.problem.manifolds(energy)
        except (ArithmeticError, InputError) as error:
            return Found(energy, (), 1, False, str(error))
        settings = self.settings.search
        found = Found(energy, (), 1, False, "")
        for fineness in (1.0, 0.25):
            cut = replace(settings.cut, chord=fineness * settings.cut.chord)
            found = self._searched(energy, manifolds, replace(settings, cut=cut))
            if found.complete:
                break
        return found

    def _searched(
        self, energy: float, manifolds: tuple[UnstableManifold, UnstableManifold], settings: ConnectionSettings
    ) -> Found:
        system = self.problem.system
        # Both tubes fly about equally far.
        hits = (self.crossings // 2 + 1, self.crossings - self.crossings // 2)
        unstable = tube_cut(manifolds[0], self.section, hit=hits[0], settings=settings.cut)
        shared = self.same_saddle and hits[0] == hits[1]
        stable = unstable if shared else tube_cut(manifolds[1], self.section, hit=hits[1], settings=settings.cut)
        crossed, failed = intersect_cuts(system, self.section, manifolds, (unstable, stable), settings)
        points: list[PathPoint] = []
        caveat = ""
        for c in crossed:
            branches = (c.sides[0].branch, c.sides[1].branch)
            phases = (float(c.phases[0]) % 1.0, float(c.phases[1]) % 1.0)
            guess = Link(branches, phases, float(sum(c.times)), tuple(float(k) + 0.0 for k in c.turns))
            try:
                link, match = self.problem.solved(guess, energy)
            except ArithmeticError as error:
                caveat = f"a crossing of the cuts is no connection ({error})"
                continue
            if self.among(link, points) is None:
                points.append(PathPoint(link, energy, match.tangency))
        if failed:
            caveat = f"{failed} crossings of the cuts did not converge"
        for cut in (unstable, stable):
            if not cut.resolved:
                caveat = f"{cut.hit}. crossing: {cut.status}"
        weight = 2 if all(m.branches_are_mirrored for m in manifolds) else 1
        return Found(energy, tuple(points), weight, not caveat, caveat)

    def among(self, link: Link, points: list[PathPoint] | tuple[PathPoint, ...]) -> int | None:
        """Return the index of the point that is this link, None if none is."""
        gaps = [self.problem.distance_between(link, p.link) for p in points]
        if not gaps or min(gaps) > self.settings.same:
            return None
        return int(np.argmin(gaps))

    def count(self, point: PathPoint) -> int:
        """Return how often a solved link crosses the section."""
        return profile(self.problem, point.link, point.energy, self.section).count

    def explain(
        self,
        before: Found,
        after: Found,
        halvings: int,
        counts: list[Found],
        changes: list[Change],
        unexplained: list[tuple[float, float, str]],
    ) -> None:
        """Add the changes between two searches, and `after` to the counts; halve the interval where they do not add
        up."""
        found, reasons = self._changes(before, after)
        gain = sum(c.gain for c in found)
        if not reasons and len(before.points) + gain == len(after.points):
            changes += found
            counts.append(after)
            return
        if halvings > 0 and not before.caveat and not after.caveat:
            middle = self.search((before.energy + after.energy) / 2)
            self.explain(before, middle, halvings - 1, counts, changes, unexplained)
            self.explain(middle, after, halvings - 1, counts, changes, unexplained)
            return
        changes += found
        counts.append(after)
        why = f"{before.count} become {after.count} connections, located events account for {gain * after.weight:+d}"
        unexplained.append((before.energy, after.energy, "; ".join([why, *reasons[:2]])))

    def _changes(self, before: Found, after: Found) -> tuple[list[Change], list[str]]:
        """Follow what two neighbouring searches do not share; return the changes and what stays unexplained."""
        lost, born = set(range(len(before.points))), set(range(len(after.points)))
        for k, point in enumerate(before.points):
            match = self._carried(point, after)
            if match is not None and match in born:
                lost.discard(k)
                born.discard(match)
        changes: list[Change] = []
        reasons: list[str] = []
        for left, start, goal in ((lost, before, after), (born, after, before)):
            while left:
                k = min(left)
                left.discard(k)
                path = follow(self.problem, start.points[k].link, start.energy, goal.energy)
                if path.outcome == "lost":
                    reasons.append(path.reason)
                    continue
                end = path.points[-1]
                arrived = self.among(end.link, (goal if path.outcome == "reached" else start).points)
                if path.outcome == "back" and arrived is not None:
                    left.discard(arrived)
                elif path.outcome == "reached" and arrived is not None and goal is after:
                    born.discard(arrived)
                elif self.count(end) == self.crossings:
                    reasons.append(
                        f"the search at {end.energy:.9g} J missed a connection with phases "
                        f"{end.link.phases[0] % 1:.6f}, {end.link.phases[1] % 1:.6f}"
                    )
                self._along(path, changes, reasons)
        return self._distinct(changes), reasons

    def _carried(self, point: PathPoint, after: Found) -> int | None:
        """Solve for a link at the next energy from its place at this one; return which of the next it is."""
        try:
            link, match = self.problem.solved(point.link, after.energy)
        except ArithmeticError:
            return None
        # A turn between would have changed the sign of the tangency.
        if match.tangency * point.tangency <= 0:
            return None
        return self.among(link, after.points)

    def _along(self, path: Path, changes: list[Change], reasons: list[str]) -> None:
        """Add the turns and touches along a path."""
        points = path.points
        counts = [self.count(p) for p in points]
        for k in range(len(points) - 1):
            if k in path.turns:
                event = locate_turn(self.problem, path, k)
                if event is None:
                    reasons.append(f"a turn in energy near {points[k].energy:.9g} J could not be located")
                    continue
                if counts[k] != counts[k + 1]:
                    reasons.append(f"a touch of the section next to the turn at {event.energy:.9g} J")
                # The partners lie on the side from which the path came.
                up = points[k].energy > event.energy or (
                    points[k].energy == event.energy and points[k - 1].energy > event.energy
                )
                if counts[k] == self.crossings:
                    changes.append(Change(event, 2 if up else -2, self.problem.symmetry(event.link) is not None))
            elif counts[k] != counts[k + 1]:
                touches = locate_graze(self.problem, self.section, points[k], points[k + 1])
                gain = (counts[k + 1] == self.crossings) - (counts[k] == self.crossings)
                if gain and not touches:
                    reasons.append(
                        f"crossings change from {counts[k]} to {counts[k + 1]} between {points[k].energy:.9g} and "
                        f"{points[k + 1].energy:.9g} J without a located touch"
                    )
                elif gain:
                    rising = 1 if points[k + 1].energy > points[k].energy else -1
                    # Of several touches, the one on the side of the asked count changed it.
                    near_end = points[k + 1].energy if gain > 0 else points[k].energy
                    event = min(touches, key=lambda t: abs(t.energy - near_end))
                    symmetric = self.problem.symmetry(event.link) is not None
                    changes.append(Change(event, gain * rising, symmetric))

    def _distinct(self, changes: list[Change]) -> list[Change]:
        """Leave out events met a second time, from the partner's side."""
        kept: list[Change] = []
        for change in changes:
            again = any(
                c.event.kind == change.event.kind
                and abs(c.event.energy - change.event.energy) < 1e-7 * self.problem.system.energy_scale
                and self.problem.distance_between(c.event.link, change.event.link) < 10 * self.settings.same
                for c in kept
            )
            if not again:
                kept.append(change)
        return kept
