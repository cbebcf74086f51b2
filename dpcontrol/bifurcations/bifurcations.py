"""Energies at which the connections between two saddles change, each with its cause.

At the energies of a sweep the cuts of both tubes are intersected. From one energy to the next every connection is
followed by continuation (never by its name); where the two sets differ, those left over are followed from both sides
until they turn back in energy, split, or change how often they cross the section:

    saddle-node        two connections meet and vanish
    pitchfork          a symmetric connection sheds a mirror pair
    section-artefact   the connection goes on, but touches its section on the way: an earlier crossing is born or lost,
                       so that it leaves (or enters) the list of connections with the crossings asked for

Each is located by its own equations (module sweep). The changes found must add up to the change of the count;
where they do not, the interval is halved and searched again, and what stays unexplained is reported.

A connection with N crossings of the section is met by the unstable tube at crossing n_u and by the stable one at n_s
with n_u + n_s - 1 = N; first hits, [1, 1], are those that cross once.

The diagram of a sweep is a document of plain numbers, to be kept and drawn without the sweep it comes from.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
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
class Mark:
    """A change of the connections with energy, as a diagram shows it.

    energy in J. kind: "saddle-node", "pitchfork" or "section-artefact". point: the first of its crossings of the
    section, in (q, p/p₀). count_below, count_above: connections with the crossings asked for, just below and above, on
    the torus; at_least: lower bounds only, cuts being unresolved next to it.
    """

    energy: float
    kind: str
    point: tuple[float, float]
    count_below: int
    count_above: int
    at_least: bool


@dataclass(frozen=True)
class Bifurcation(Mark):
    """A change that was located.

    state (N,): of the connection there, on the section where it touches it, midway in its flight otherwise. residual:
    of the equations that located it. connections: how many connections, images included, share the event. symmetric:
    whether a reverser carries the connection to itself.
    """

    state: Array
    residual: float
    connections: int
    symmetric: bool
    link: Link

    @property
    def winding(self) -> tuple[int, ...]:
        """Whole turns (n,) of each coordinate from source to target."""
        return tuple(round(k) for k in self.link.turns[: len(self.link.turns) // 2])


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
    counts: tuple[Found, ...]
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
        ends = grid[k], grid[k + 1]
        searched = not any(sweep.search(energy).caveat for energy in ends)
        if not _adds_up(sweep, *ends) and ends[1] - ends[0] > narrowest and searched:
            grid.insert(k + 1, sum(ends) / 2)
            continue
        # A search amended on the way may spoil what was explained before it.
        k = k - 1 if k > 0 and not sweep.explained(grid[k - 1], grid[k]) else k + 1
    progress("bifurcations", 1.0)
    counts = tuple(sweep.search(energy) for energy in grid)
    pairs = list(pairwise(grid))
    unexplained = tuple((a, b, _why(sweep, a, b)) for a, b in pairs if not _adds_up(sweep, a, b))
    events = _with_counts(sweep, [c for a, b in pairs for c in sweep.between(a, b).changes], counts)
    scatters_from = next((c.energy for k, c in enumerate(counts) if not any(d.complete for d in counts[k:])), None)
    return BifurcationSearch(
        system=system,
        source=source,
        target=target,
        section=sweep.section,
        crossings=crossings,
        events=events,
        counts=counts,
        unexplained=unexplained,
        runs=tuple(run for a, b in pairs for run in sweep.between(a, b).runs),
        scatters_from=scatters_from,
        complete=not unexplained and all(c.complete for c in counts),
        status=_status(len(events), counts, unexplained, scatters_from, max(births) if start > low else None),
    )


def _status(
    events: int,
    counts: Sequence[Found],
    unexplained: Sequence[tuple[float, float, str]],
    scatters_from: float | None,
    born: float | None,
) -> str:
    """Return a sweep's outcome in a sentence; born: J of the later saddle, where the sweep begins only above it."""
    status = f"{events} events explain every change of the count over {len(counts)} energies"
    if unexplained:
        status = f"{events} events located, but {len(unexplained)} changes of the count have no located cause: "
        status += "; ".join(f"{a:.6g} to {b:.6g} J, {why}" for a, b, why in unexplained[:5])
    if born is not None:
        first = counts[0]
        there = f"{first.count} connections exist already there" if first.count else "none exist there yet"
        status += f"; swept from {first.energy:.6g} J, just above the energy {born:.6g} J of the later saddle: {there}"
    if scatters_from is not None:
        status += (
            f"; from {scatters_from:.6g} J on counts are lower bounds (at least), of connections found and followed: "
            f"{counts[-1].caveat}"
        )
    single = [c for c in counts if not c.complete and (scatters_from is None or c.energy < scatters_from)]
    if single:
        where = "" if scatters_from is None else " below"
        status += f"; {len(single)} searches{where} are not complete: "
        status += "; ".join(f"at {c.energy:.6g} J {c.caveat}" for c in single[:3])
    return status


def _adds_up(sweep: Sweep, low: float, high: float) -> bool:
    interval = sweep.between(low, high)
    # Only now: a search may have been amended while the interval was followed.
    before, after = sweep.search(low), sweep.search(high)
    return not interval.reasons and len(before.points) + interval.gain == len(after.points)


def _why(sweep: Sweep, low: float, high: float) -> str:
    interval, before, after = sweep.between(low, high), sweep.search(low), sweep.search(high)
    counts = f"{before.count} become {after.count} connections, located events account for "
    return "; ".join([counts + f"{interval.gain * after.weight:+d}", *interval.reasons[:2]])


def _with_counts(sweep: Sweep, changes: Sequence[Change], counts: Sequence[Found]) -> tuple[Bifurcation, ...]:
    """Join images of one event and give each event the running count."""
    weight = max((c.weight for c in counts), default=1)
    near = 1e-8 * sweep.problem.system.energy_scale
    groups: list[list[Change]] = []
    for change in sorted(changes, key=lambda c: c.event.energy):
        kind, energy = change.event.kind, change.event.energy
        same = (g for g in groups if g[0].event.kind == kind and abs(g[0].event.energy - energy) < near)
        group = next(same, None)
        if group is None:
            groups.append([change])
        else:
            group.append(change)
    events: list[Bifurcation] = []
    for group in groups:
        event = group[0].event
        below, above = ([c for c in counts if (c.energy <= event.energy) is side] for side in (True, False))
        # The search just below sets the count anew, so that an unexplained interval does not spoil the rest.
        running = events[-1].count_above if events else 0
        if below and not (events and events[-1].energy > below[-1].energy):
            running = below[-1].count
        link = replace(event.link, phases=(event.link.phases[0] % 1.0, event.link.phases[1] % 1.0))
        events.append(
            Bifurcation(
                energy=event.energy,
                kind=event.kind,
                point=sweep.place(event),
                count_below=running,
                count_above=running + weight * sum(c.gain for c in group),
                at_least=not all(c.complete for c in [*below[-1:], *above[:1]]),
                state=event.state,
                residual=max(c.event.residual for c in group),
                connections=weight * sum(abs(c.gain) for c in group),
                symmetric=sweep.problem.symmetry(event.link) is not None,
                link=link,
            )
        )
    return tuple(events)


@dataclass(frozen=True)
class BranchDiagram:
    """Connections between two saddles against energy.

    runs: each connection as it was followed; marks: the events between; counts: (energy, number on the torus, whether
    the search was complete); scatters_from: J, as in BifurcationSearch.
    """

    source: str
    target: str
    section: str
    runs: tuple[Branch, ...]
    marks: tuple[Mark, ...]
    counts: tuple[tuple[float, int, bool], ...]
    scatters_from: float | None
    unexplained: int

    def document(self) -> dict[str, Any]:
        """Return the diagram as numbers, lists and strings."""
        return {
            **picked(self, "source", "target", "section", "counts", "scatters_from", "unexplained"),
            "runs": [{"energies": run.energies.tolist(), "points": run.points.tolist()} for run in self.runs],
            "marks": [asdict(mark) for mark in self.marks],
        }


def branch_diagram(search: BifurcationSearch) -> BranchDiagram:
    """Return the diagram of a sweep."""
    marks = tuple(Mark(**picked(event, *(field.name for field in fields(Mark)))) for event in search.events)
    counts = tuple((c.energy, c.count, c.complete) for c in search.counts)
    return BranchDiagram(
        search.source, search.target, search.section.name, search.runs, marks, counts, search.scatters_from,
        len(search.unexplained),
    )  # fmt: skip


def diagram_from(document: dict[str, Any]) -> BranchDiagram:
    """Return the diagram that a document holds.

    Raises:
        KeyError, TypeError, ValueError: the document is of no diagram.
    """
    runs = (Branch(np.array(r["energies"], dtype=float), np.array(r["points"], dtype=float)) for r in document["runs"])
    marks = (Mark(**{**m, "point": (float(m["point"][0]), float(m["point"][1]))}) for m in document["marks"])
    counts = tuple((float(e), int(n), bool(c)) for e, n, c in document["counts"])
    return BranchDiagram(**{**document, "runs": tuple(runs), "marks": tuple(marks), "counts": counts})
