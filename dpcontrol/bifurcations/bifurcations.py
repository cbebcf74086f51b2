"""Energies at which the connections between two saddles change, each with its cause.

At the energies of a sweep the cuts of both tubes are intersected. From one energy to the next every connection is
followed by continuation (never by its name); where the two sets differ, those left over are followed from both sides
until they turn back in energy, split, or change how often they cross the section:

    saddle-node        two connections meet and vanish
    pitchfork          a symmetric connection sheds a mirror pair
    section-artefact   the connection goes on, but touches its section on the way: an earlier crossing is born or lost,
                       so that it leaves (or enters) the list of connections with the crossings asked for

Each is located by its own equations (module link_paths). The changes found must add up to the change of the count;
where they do not, the interval is halved and searched again, and what stays unexplained is reported.

A connection with N crossings of the section is met by the unstable tube at crossing n_u and by the stable one at n_s
with n_u + n_s - 1 = N; first hits, [1, 1], are those that cross once.

The diagram of a sweep: where each connection crosses its section at every energy, with the events between.

A document of plain numbers, to be kept and drawn without the sweep it comes from.
"""

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.bifurcations.links import Link
from dpcontrol.bifurcations.sweep import Branch, Change, Found, Sweep, SweepSettings
from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import picked
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.orbits.symmetric_shooting import equilibrium

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bifurcation:
    """One change of the connections.

    energy in J; kind: "saddle-node", "pitchfork" or "section-artefact"; state (N,): of the connection there, on the
    section where it touches it, midway in its flight otherwise. count_below, count_above: connections with the
    crossings asked for, just below and above, on the torus; at_least: lower bounds only, cuts being unresolved next to
    it. residual: of the equations that located it. connections: how many connections, images included, share the
    event. symmetric: whether a reverser carries the connection to itself. point (2,): the first of its crossings of
    the section, in (q, p/p₀).
    """

    energy: float
    kind: str
    state: Array
    count_below: int
    count_above: int
    at_least: bool
    residual: float
    connections: int
    symmetric: bool
    link: Link
    point: Array

    @property
    def winding(self) -> tuple[int, ...]:
        """Whole turns (n,) of each coordinate from source to target."""
        return tuple(round(k) for k in self.link.turns[: len(self.link.turns) // 2])


@dataclass(frozen=True)
class SweepPoint:
    """What a search found at one energy: number of connections on the torus, and why it may not be complete."""

    energy: float
    count: int
    complete: bool
    caveat: str


@dataclass(frozen=True)
class BifurcationSearch:
    """Events in order of energy, the counts they explain, and the changes of count without a located cause.

    unexplained: (low, high, sentence) of energy intervals. complete: none, and every search was complete.
    scatters_from: the lowest energy in J from which on no search is complete, trajectories of a tube scattering
    before they arrive so that connections accumulate without end; counts are lower bounds there, of those connections
    that were found and followed; None where there is none. runs: every connection as it was followed; where a
    symmetry exchanges the branches of the tubes, one of every two.
    """

    system: System
    source: str
    target: str
    section: Section
    crossings: int
    events: tuple[Bifurcation, ...]
    counts: tuple[SweepPoint, ...]
    unexplained: tuple[tuple[float, float, str], ...]
    runs: tuple[Branch, ...]
    scatters_from: float | None
    complete: bool
    status: str

    def __repr__(self) -> str:
        return f"<bifurcations: {self.status}>"

    def document(self) -> dict[str, Any]:
        """Return what `dpcontrol bifurcations --json` prints, the energies that were asked for apart."""
        event = ("energy", "kind", "state", "count_below", "count_above", "at_least", "symmetric", "winding")
        return {
            "events": [picked(e, *event, "residual", "point") for e in self.events],
            "counts": [picked(c, "energy", "count", "complete", "caveat") for c in self.counts],
            "unexplained": [{"energies": [low, high], "reason": reason} for low, high, reason in self.unexplained],
            **picked(self, "scatters_from", "complete", "status"),
            "section": self.section.name,
            "from": self.source,
            "to": self.target,
            "hits": self.crossings,
        }


def find_bifurcations(
    system: System,
    source: str,
    target: str,
    *,
    energies: tuple[float, float],
    crossings: int = 1,
    settings: SweepSettings | None = None,
    progress: Progress = no_progress,
) -> BifurcationSearch:
    """Find every change of the connections from `source` to `target` between two energies in J.

    crossings: how often the connections cross their section; 1 are the first hits.

    Raises:
        InputError: no section between the saddles, an unknown saddle, bounds without orbits, or a system of other
            than two degrees of freedom.
    """
    settings = settings or SweepSettings()
    if (source, target) not in system.sections:
        raise InputError(f"{system.name} has no section between {source} and {target}")
    if crossings < 1:
        raise InputError(f"hits = {crossings}: connections cross their section at least once")
    low, high = energies
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"energies {low:g} to {high:g} J: must be two finite numbers, the lower first")
    births = [equilibrium(system, name).energy for name in (source, target)]
    floor = max(births) + settings.closest * system.energy_scale
    start = max(low, floor)
    if start >= high:
        raise InputError(
            f"energies {low:g} to {high:g} J: both orbits, and with them connections, exist only above "
            f"{max(births):.6g} J"
        )
    sweep = Sweep(system, source, target, crossings, settings)
    grid = [float(e) for e in np.linspace(start, high, settings.energies)]
    narrowest = 1.001 * (grid[1] - grid[0]) / 2**settings.halvings
    k = 0
    while k < len(grid) - 1:
        progress(f"{source} → {target} at {grid[k]:.4f} J", (grid[k] - start) / (high - start))
        low_end, high_end = grid[k], grid[k + 1]
        if (
            not _adds_up(sweep, low_end, high_end)
            and high_end - low_end > narrowest
            and _searched(sweep, grid[k : k + 2])
        ):
            grid.insert(k + 1, (low_end + high_end) / 2)
            continue
        # A search amended on the way may spoil what was explained before it.
        k = k - 1 if k > 0 and not sweep.explained(grid[k - 1], grid[k]) else k + 1
    progress("bifurcations", 1.0)
    counts = [sweep.search(energy) for energy in grid]
    pairs = list(pairwise(grid))
    changes = [c for a, b in pairs for c in sweep.between(a, b).changes]
    unexplained = [(a, b, _why(sweep, a, b)) for a, b in pairs if not _adds_up(sweep, a, b)]
    events = _with_counts(sweep, changes, counts)
    incomplete = [c for c in counts if not c.complete]
    scatters_from = next((c.energy for k, c in enumerate(counts) if not any(d.complete for d in counts[k:])), None)
    status = f"{len(events)} events explain every change of the count over {len(counts)} energies"
    if unexplained:
        status = f"{len(events)} events located, but {len(unexplained)} changes of the count have no located cause: "
        status += "; ".join(f"{a:.6g} to {b:.6g} J, {why}" for a, b, why in unexplained[:5])
    if start > low:
        first = counts[0].count
        there = f"{first} connections exist already there" if first else "none exist there yet"
        status += f"; swept from {start:.6g} J, just above the energy {max(births):.6g} J of the later saddle: {there}"
    if scatters_from is not None:
        status += (
            f"; from {scatters_from:.6g} J on counts are lower bounds (at least), of connections found and followed: "
            f"{counts[-1].caveat}"
        )
    single = [c for c in incomplete if scatters_from is None or c.energy < scatters_from]
    if single:
        where = "" if scatters_from is None else " below"
        status += f"; {len(single)} searches{where} are not complete: "
        status += "; ".join(f"at {c.energy:.6g} J {c.caveat}" for c in single[:3])
    return BifurcationSearch(
        system=system,
        source=source,
        target=target,
        section=sweep.section,
        crossings=crossings,
        events=events,
        counts=tuple(SweepPoint(c.energy, c.count, c.complete, c.caveat) for c in counts),
        unexplained=tuple(unexplained),
        runs=tuple(run for a, b in pairs for run in sweep.between(a, b).runs),
        scatters_from=scatters_from,
        complete=not unexplained and not incomplete,
        status=status,
    )


def _adds_up(sweep: Sweep, low: float, high: float) -> bool:
    interval = sweep.between(low, high)
    # Only now: a search may have been amended while the interval was followed.
    before, after = sweep.search(low), sweep.search(high)
    return not interval.reasons and len(before.points) + interval.gain == len(after.points)


def _searched(sweep: Sweep, energies: list[float]) -> bool:
    return not any(sweep.search(energy).caveat for energy in energies)


def _why(sweep: Sweep, low: float, high: float) -> str:
    interval, before, after = sweep.between(low, high), sweep.search(low), sweep.search(high)
    counts = f"{before.count} become {after.count} connections, located events account for "
    return "; ".join([counts + f"{interval.gain * after.weight:+d}", *interval.reasons[:2]])


def _with_counts(sweep: Sweep, changes: list[Change], counts: list[Found]) -> tuple[Bifurcation, ...]:
    """Join images of one event and give each event the running count."""
    weight = max((c.weight for c in counts), default=1)
    near = 1e-8 * sweep.problem.system.energy_scale
    groups: list[list[Change]] = []
    for change in sorted(changes, key=lambda c: c.event.energy):
        for group in groups:
            if group[0].event.kind == change.event.kind and abs(group[0].event.energy - change.event.energy) < near:
                group.append(change)
                break
        else:
            groups.append([change])
    events = []
    running = 0
    for group in groups:
        first = group[0]
        # The search just below sets the count anew, so that an unexplained interval does not spoil the rest.
        below = [c for c in counts if c.energy <= first.event.energy]
        if below:
            since = [g for g in groups if below[-1].energy < g[0].event.energy < first.event.energy]
            running = below[-1].count + weight * sum(c.gain for g in since for c in g)
        gain = weight * sum(c.gain for c in group)
        event = first.event
        around = [c for c in counts if c.energy <= event.energy][-1:] + [c for c in counts if c.energy > event.energy][
            :1
        ]
        events.append(
            Bifurcation(
                energy=event.energy,
                kind=event.kind,
                state=event.state,
                count_below=running,
                count_above=running + gain,
                at_least=not all(c.complete for c in around),
                residual=max(c.event.residual for c in group),
                connections=weight * sum(abs(c.gain) for c in group),
                symmetric=first.symmetric,
                link=replace(event.link, phases=(event.link.phases[0] % 1.0, event.link.phases[1] % 1.0)),
                point=sweep.place(event),
            )
        )
    return tuple(events)


@dataclass(frozen=True)
class Mark:
    """An event in a diagram: energy in J, kind, point (q, p/p₀) on the section, counts below and above."""

    energy: float
    kind: str
    point: tuple[float, float]
    count_below: int
    count_above: int
    at_least: bool


@dataclass(frozen=True)
class BranchDiagram:
    """Connections between two saddles against energy.

    runs: of each connection followed, energies in J and points (q, p/p₀), in order along it; counts: (energy, number
    on the torus, whether the search was complete); scatters_from: J, as in BifurcationSearch.
    """

    source: str
    target: str
    section: str
    runs: tuple[tuple[Array, Array], ...]
    marks: tuple[Mark, ...]
    counts: tuple[tuple[float, int, bool], ...]
    scatters_from: float | None
    unexplained: int

    def document(self) -> dict[str, Any]:
        """Return the diagram as numbers, lists and strings."""
        runs = [{"energies": e.tolist(), "points": p.tolist()} for e, p in self.runs]
        return {**asdict(self), "runs": runs}


def branch_diagram(search: BifurcationSearch) -> BranchDiagram:
    """Return the diagram of a sweep."""
    return BranchDiagram(
        source=search.source,
        target=search.target,
        section=search.section.name,
        runs=tuple((run.energies, run.points) for run in search.runs),
        marks=tuple(
            Mark(e.energy, e.kind, (float(e.point[0]), float(e.point[1])), e.count_below, e.count_above, e.at_least)
            for e in search.events
        ),
        counts=tuple((c.energy, c.count, c.complete) for c in search.counts),
        scatters_from=search.scatters_from,
        unexplained=len(search.unexplained),
    )


def diagram_from(document: dict[str, Any]) -> BranchDiagram:
    """Return the diagram that a document holds.

    Raises:
        KeyError, TypeError, ValueError: the document is of no diagram.
    """
    return BranchDiagram(
        source=str(document["source"]),
        target=str(document["target"]),
        section=str(document["section"]),
        runs=tuple(
            (np.array(r["energies"], dtype=float), np.array(r["points"], dtype=float)) for r in document["runs"]
        ),
        marks=tuple(Mark(**{**m, "point": (float(m["point"][0]), float(m["point"][1]))}) for m in document["marks"]),
        counts=tuple((float(e), int(n), bool(c)) for e, n, c in document["counts"]),
        scatters_from=document["scatters_from"],
        unexplained=int(document["unexplained"]),
    )
