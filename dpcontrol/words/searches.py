"""Sentences on orbits, tubes, connections and walks.

`r` is the result that is put into words: of a search, or of a part of it, with the numbers that belong to its cause.
"""

import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

from dpcontrol.foundation.causes import (
    BranchCause,
    CautionCause,
    CutCause,
    DepartureCause,
    FamilyEndCause,
    FlightCause,
    GapCause,
    GridCause,
    ObstacleCause,
    OpenEndCause,
    OrbitCause,
    ReferenceCause,
    RefinementCause,
    SearchCause,
    ShootingCause,
    ShortfallCause,
    TransportCause,
    WalkCause,
    WrapsCause,
)
from dpcontrol.foundation.document import counted


class Concluded:
    """Base of results that end with a member of an enumeration, `cause`."""

    cause: Any

    @property
    def status(self) -> str:
        """The cause as a sentence."""
        return SENTENCES[type(self.cause)][self.cause](self)


def _failed(why: str) -> Callable[[Any], str]:
    """Return a function for `SENTENCES` that makes the sentence on a search which did not converge.

    Args:
        why: reason in words, with the remedy.
    """
    return lambda r: f"not converged: gap {r.residual:.1e} after {r.iterations} iterations ({why})"


def _joule(r: Any, energy: float, digits: int = 6) -> str:
    """Return an energy as text with `digits` significant digits; J follows if the system of `r` has SI units."""
    return f"{energy:.{digits}g}{r.system.unit('J')}"


def _second(r: Any, time: float) -> str:
    """Return a duration as text; s follows if the system of the result `r` has SI units."""
    return f"{time:.3g}{r.system.unit('s')}"


def _joined(*clauses: tuple[object, str]) -> str:
    """Return a sentence of the clauses whose conditions hold, separated by semicolons."""
    return "; ".join(text for holds, text in clauses if holds)


def _missed(r: Any, text: str) -> str:
    """Return the sentence on a flight that misses its target, with the remedy, if a larger limit was found to help.

    Args:
        r: search for the flight; its `remedy` is a pair of the limit's name and the value that suffices.
        text: how the best flight misses.
    """
    if r.remedy:
        return f"{text}; with a limit of {r.remedy[1]:g} on the {r.remedy[0]} one is found"
    return f"{text}; neither a track nor an acceleration of twice the size helps; give another target"


def _cut(r: Any, *clauses: str) -> str:
    """Return the sentence on a cut of a tube: its clauses, and a note if the refinement used up its processor time.

    `r` is the cut: `r.spent` is True if the time is used up, and `r.seconds` is its limit, which may be infinite.
    """
    out_of_time = f"partial: the cut reached its limit of {r.seconds:g} s of processor time: allow more seconds"
    return _joined(*((True, clause) for clause in clauses), (r.spent and math.isfinite(r.seconds), out_of_time))


def _tubes(r: Any) -> str:
    """Return the outcomes of both cuts of a search `r` for connections, of the unstable and of the stable tube."""
    return f"unstable tube {r.cuts[0].status}; stable tube {r.cuts[1].status}"


def _searched(r: Any) -> str:
    """Return the sentence on a search for connections by the tubes of two orbits.

    It states the number of connections, and each reason for which there may be more, with its remedy. `r` is a
    `ConnectionSearch`. A cut is the curve in which a tube meets the section. It is open if some trajectories of the
    tube do not arrive or separate too much; an open end hides connections, or leads to later crossings.
    """
    remedy = "try another energy" if r.settings.thorough else "search thoroughly"
    or_other_energy = "" if r.settings.thorough else ", or at another energy"
    ends = [end for cut in r.cuts for end in cut.open_ends]
    may_hide_some, may_arrive_later = any(end.hides and not end.later for end in ends), any(end.later for end in ends)
    # "at least 0" would be empty.
    at_least = "at least " if r.connections and not r.complete else ""
    ending = "" if r.connections or r.complete else " found"
    return _joined(
        (True, f"{at_least}{counted(len(r.connections), 'connection')}{ending}: {_tubes(r)}"),
        (
            not r.even,
            "closed cuts cross more often in one direction than in the other, so crossings were missed: " + remedy,
        ),
        (r.failed, f"{r.failed} crossings of the cuts did not converge: {remedy}{or_other_energy}"),
        (
            r.partial,
            f"partial: the search reached its limit of {r.seconds:.3g} s of processor time"
            f"{f' with {r.left} places left' if r.left else ''}: allow more seconds, or use an energy nearer to the "
            "saddles', where tubes cross less often",
        ),
        (
            r.tangent,
            f"the tubes are tangent to rounding at {r.tangent}, each of which may be several near a bifurcation",
        ),
        (
            may_hide_some,
            f"the cuts are open (see open_cuts) and may hide connections{'' if r.partial else f': {remedy}'}",
        ),
        (
            may_arrive_later,
            f"longer flights {'may exist' if r.settings.cut.longest is None else 'exist'} beyond --longest (longest in "
            "Python) and may include connections"
            # Longer tubes scatter even more.
            + (f": raise it above {r.cuts[0].longest:g} periods of the orbit" * all(cut.resolved for cut in r.cuts)),
        ),
        (
            not (may_arrive_later or may_hide_some) and any(end.cause is not OpenEndCause.ESCAPES for end in ends),
            "the cuts are open (see open_cuts), so crossings beyond their ends belong to other hits",
        ),
    )


def _on_laps(r: Any) -> str:
    """Return the sentence on a search in which the tube of one orbit crosses the section on every lap of the orbit.

    Only some of these crossings are searched, so the number of connections is no total. `r` is a `ConnectionSearch`,
    whose first searched crossing is `r.first`.
    """
    cut, orbit = next((cut, orbit) for cut, orbit in zip(r.cuts, (r.source, r.target), strict=True) if orbit.laps)
    if not r.connections:
        crossings = f"none at crossings {r.first} to {cut.hit} of {cut.section.name}"
        return f"{crossings} by the tube of {orbit.saddle}; later crossings may have some"
    return _joined(
        (
            True,
            f"{counted(len(r.connections), 'connection')} at crossing {cut.hit} of {cut.section.name} by the tube of "
            f"{orbit.saddle}; other crossings may have more",
        ),
        (r.failed, f"{r.failed} crossings of the cuts did not converge: try another energy"),
        (r.partial, f"partial: the search reached its limit of {r.seconds:.3g} s of processor time"),
        (not (r.partial or cut.resolved), "not every cut is resolved: take an earlier crossing"),
    )


def _on_grid(beyond: Callable[[Any], str]) -> Callable[[Any], str]:
    """Return a function for `SENTENCES` that makes the sentence on a search over a range of energies.

    Args:
        beyond: function of the search that returns the reason for its end before the highest energy, or "".
    """
    return lambda r: _joined(
        (
            True,
            f"at least {len(r.connections)} between {r.searched[0]:g} and {r.searched[1]:g} J, each at a different "
            "energy and with a mirror image that turns the other way",
        ),
        (r.failed, f"{r.failed} candidates did not converge: search a narrower range"),
        (beyond(r), f"not searched beyond: {beyond(r)}"),
        (r.left, f"{r.left} candidates were not refined: the time limit was reached"),
        (r.partial, f"partial: give the search more than {r.seconds:.3g} s, or a narrower range"),
    )


def family_sentence(r: Any) -> str:
    """Return the sentence on a family of Lyapunov orbits: its number of orbits, their energies, and its end.

    Args:
        r: a `LyapunovFamily`.
    """
    ends = f"{r.members[0].energy:.9g} to {r.members[-1].energy:.9g}{r.ends[1].system.unit('J')}"
    return f"{len(r.members)} orbits from {ends}; {r.ends[1].status}"


def rotating_family_sentence(r: Any) -> str:
    """Return the sentence on a family of rotating orbits: number, energies, changes of stability, folds.

    Args:
        r: a `RotatingFamily`.
    """
    return _joined(
        (
            True,
            f"{len(r.members)} orbits from {r.members[0].energy:.9g} to {r.members[-1].energy:.9g} J, "
            f"{len(r.changes)} changes of stability, {len(r.folds)} folds in energy",
        ),
        *((end.cause is FamilyEndCause.STUCK, end.status) for end in r.ends),
    )


def caveat_sentence(r: Any) -> str:
    """Return the reason for which the count of connections at one energy may be too small, or "" if it is complete.

    Args:
        r: search at one energy of a search for bifurcations. `r.unresolved` are cuts that were not refined enough,
            `r.failed` and `r.unmatched` are numbers of crossings, and `r.orbits` is empty if an orbit or its tube does
            not exist.
    """
    if r.unresolved:
        return f"{r.unresolved[-1].hit}. crossing: {r.unresolved[-1].status}"
    if r.failed:
        return f"{r.failed} crossings of the cuts did not converge"
    if r.unmatched:
        return f"{r.unmatched} crossings of the cuts are not connections"
    return "" if r.orbits else "an orbit or its tube does not exist"


def _followed(gap: Any, k: int) -> str:
    """Return the parameter that a search for bifurcations varies, with its value at end `k` (0 or 1) of a gap.

    `gap` is an interval between two searches in which the count changes without a located cause.
    """
    return f"{gap.course.quantity} = {gap.values[k]:.9g}{gap.course.unit}"


def bifurcations_sentence(r: Any) -> str:
    """Return the sentence on a search for bifurcations: located events, unexplained changes, incomplete counts.

    Args:
        r: a `BifurcationSearch`, which varies the energy or another parameter, `r.course`. `r.counts` are the numbers
            of connections at its values, `r.unexplained` their changes without a located event. Above
            `r.scatters_from`, unless None, no count is complete. `r.born` is the energy of the higher saddle, if the
            search starts just above it, or None.
    """
    count, unit = counted(len(r.events), "event"), r.course.unit
    unexplained = [(*change.values, change.reason) for change in r.unexplained[:5]]
    gaps = "; ".join(f"{low:.6g} to {high:.6g}{unit}, {reason}" for low, high, reason in unexplained)
    incomplete = [c for c in r.counts if not c.complete and (r.scatters_from is None or c.value < r.scatters_from)]
    caveats = "; ".join(f"at {c.value:.6g}{unit} {c.caveat}" for c in incomplete[:3])
    start = f"{r.counts[0].value:.6g}{unit}, just above the higher saddle's energy of {r.born or 0:.6g}{unit}"
    return _joined(
        (not gaps, f"{count}; every change of the count over {len(r.counts)} {r.course.plural} is explained"),
        (
            gaps,
            f"{count} located, but not the cause of {counted(len(r.unexplained), 'change')} of the count: {gaps}",
        ),
        (r.born is not None, f"swept from {start}: {counted(r.counts[0].count, 'connection')} there"),
        (
            r.scatters_from is not None,
            f"above {r.scatters_from or 0:.6g}{unit} counts are lower bounds (at least), of connections found and "
            f"followed: {r.counts[-1].caveat}",
        ),
        (
            incomplete,
            f"{len(incomplete)} searches{'' if r.scatters_from is None else ' below'} are not complete: {caveats}",
        ),
    )


def _passed(use: Any) -> str:
    """Return the clause on a limit of the cart that a motion passes, with the largest value and its time.

    `use` is a `LimitUse`: the largest value of the cart's position, velocity or acceleration, and its bound.
    """
    return f"cart {use.name} of {use.largest:.4g} {use.unit} where {use.bound:.4g} is allowed (at t = {use.time:.2f} s)"


def _mesh(r: Any) -> str:
    """Return the clause on the accuracy of a reference `r`: its error between the nodes of the mesh, scaled."""
    return f"error between nodes {r.error:.1e} on {r.intervals} intervals"


def _longer(r: Any) -> str:
    """Return the advice to stay on the last orbit for one more wrap than the itinerary of the reference `r` has."""
    return f"raise lead_out to {r.content.lead_out + 1}"


def _symbol(r: Any) -> str:
    """Return the number and the text of the symbol at which a reference falls short; `r` is the shortfall."""
    symbols = r.content.symbols
    return f"symbol {r.stop} of {len(symbols)} ({symbols[r.stop - 1].text!r})"


def _far(r: Any) -> str:
    """Return the clause on the smallest distance, rad, between a motion and the orbit of a stop; `r` is a shortfall."""
    return f"no nearer than {r.gap:.2f} rad to the orbit about {r.content.stops[r.stop].saddle}"


SENTENCES: Mapping[type[StrEnum], Mapping[Any, Callable[[Any], str]]] = {
    ShootingCause: {
        ShootingCause.CONVERGED: lambda r: f"converged in {r.iterations} iterations to a gap of {r.residual:.1e}",
        ShootingCause.ITERATIONS: _failed("all iterations are used: use more wraps or more nodes"),
        ShootingCause.ROUNDING: _failed("rounding errors grow too much over a segment: use more nodes"),
        ShootingCause.OTHER_SIDE: _failed(
            "the orbit leaves its first or joins its last periodic orbit on the other side of the tube"
        ),
        ShootingCause.SINGULAR: _failed(
            "the linear system is singular: two tubes are tangent here; choose another energy"
        ),
        ShootingCause.STRETCHED: _failed("a segment is too far from its guessed length: use more wraps or more nodes"),
        ShootingCause.NO_STEP: _failed(
            "no step reduces the error, however short: near a tangency of two tubes there may be no orbit; use more "
            "wraps beside this symbol"
        ),
        ShootingCause.DIVERGED: _failed("a segment could not be propagated: use more wraps or more nodes"),
    },
    RefinementCause: {
        RefinementCause.REFINED: lambda r: (
            f"refined in {r.iterations} iterations to a gap of {float(r.residual):.1e}; the double nodes were off by "
            f"{r.correction:.1e}"
        ),
        RefinementCause.STALLED: lambda r: (
            f"not refined: the gap stays at {float(r.residual):.1e} after {r.iterations} iterations; use more nodes, "
            "or use double precision"
        ),
    },
    WalkCause: {
        WalkCause.CONVERGED: lambda r: r.orbit.status,
        WalkCause.CONNECTION: lambda r: (
            f"converged: the connection itself, at {_joule(source := r.connections[0].source, source.energy, 12)}"
        ),
        WalkCause.SHOOTING: lambda r: f"symbol {r.fault + 1} of {len(r.walk)} ({r.walk[r.fault]}): {r.orbit.status}",
        WalkCause.RIVAL: lambda r: (
            f"symbol {r.fault + 1} of {len(r.walk)}: converged, but the orbit follows {r.rival} instead of "
            f"{r.walk[r.fault]}: use more wraps next to it"
        ),
        WalkCause.OTHER_WRAPS: lambda r: (
            f"symbol {r.fault + 1} of {len(r.walk)}: converged, but with wraps {list(r.wraps_realised)} instead of "
            f"{list(r.wraps)}: use more wraps"
        ),
    },
    WrapsCause: {
        WrapsCause.TOO_FEW: lambda r: f"wraps {list(r.tried)} are too few: must be at least {list(r.wraps)}",
        WrapsCause.OTHERS_WORK: lambda r: f"wraps {list(r.wraps)} work where {list(r.tried)} do not",
        WrapsCause.NONE_SUFFICE: lambda r: f"no wraps up to {r.most} suffice: {r.failed.status}",
    },
    OrbitCause: {
        OrbitCause.CONTINUED: lambda r: f"converged in {r.outcome.steps} continuation steps",
        OrbitCause.MEMBER: lambda r: (
            f"converged to a residual of {r.outcome.newton_residual:.1e}, as a member of its family"
        ),
        OrbitCause.NEARBY: lambda r: f"converged from the orbit at {_joule(r, r.outcome.reached, 9)}",
        OrbitCause.ROTATING: lambda r: (
            f"converged to a residual of {r.outcome.newton_residual:.1e}; closed to {r.residual:.1e}"
        ),
        OrbitCause.LOST: lambda r: (
            f"not converged: the family could be followed only to {_joule(r, r.outcome.reached, 6)} (residual "
            f"{r.outcome.newton_residual:.1e} beyond); use an energy nearer to the saddle's"
        ),
    },
    FamilyEndCause: {
        FamilyEndCause.SADDLE: lambda r: (
            f"the orbits shrink to {r.equilibrium} itself at its energy of {_joule(r, r.energy, 9)}"
        ),
        FamilyEndCause.ENERGY_BOUND: lambda r: f"reached the bound of {_joule(r, r.energy)}; the family continues",
        FamilyEndCause.HYPERBOLICITY_LOST: lambda r: (
            f"hyperbolicity is lost at {_joule(r, r.energy, 12)}: a multiplier crosses {r.multiplier:+.0f} and "
            f"{'the family branches or folds' if r.multiplier > 0 else 'the period doubles'}"
        ),
        FamilyEndCause.HOMOCLINICS: lambda r: (
            f"ends in the homoclinics of {r.equilibrium}: the period grows without bound (followed to "
            f"{_second(r, r.period)}, multiplier {r.multiplier:.1e}) as the energy tends to "
            f"{_joule(r, r.limit, 6)}, extrapolated; "
            f"{r.equilibrium} has {_joule(r, r.height, 6)}"
        ),
        FamilyEndCause.PASSES_EQUILIBRIUM: lambda r: (
            f"ends in the homoclinics of {r.equilibrium}: at {_joule(r, r.energy, 9)} the period has grown to "
            f"{_second(r, r.period)} and the orbit passes {r.equilibrium} ({_joule(r, r.height, 9)}) at a scaled "
            f"distance of {r.distance:.1g}"
        ),
        FamilyEndCause.LONG_PERIOD: lambda r: (
            f"stopped at {_joule(r, r.energy, 9)}: the period has grown to {_second(r, r.period)}"
        ),
        FamilyEndCause.LARGE_MULTIPLIER: lambda r: (
            f"stopped at {_joule(r, r.energy, 9)}: multipliers above {r.limit:g} exceed double precision"
        ),
        FamilyEndCause.MANY_MEMBERS: lambda r: (
            f"stopped after {r.limit} members at {_joule(r, r.energy, 9)}; allow more"
        ),
        FamilyEndCause.STUCK: lambda r: (
            f"could not be followed beyond {_joule(r, r.energy, 9)} (residual {r.residual:.1e})"
        ),
    },
    CutCause: {
        CutCause.RESOLVED: lambda r: _cut(r, f"resolved to chords of {r.chord:g} by {r.trajectories} trajectories"),
        CutCause.UNRESOLVED: lambda r: _cut(
            r, f"not resolved by {r.trajectories} trajectories", *(branch.status for branch in r.unresolved)
        ),
        CutCause.ESCAPES: lambda r: _cut(r, f"escapes: no trajectory returns to {r.section.name}"),
        CutCause.NEVER_ARRIVES: lambda r: _cut(
            r,
            f"no trajectory of the tube reaches crossing {r.hit} of {r.section.name} within {r.longest:g} periods",
            *["allow longer flights, or use another energy"] * any(end.later for end in r.open_ends),
        ),
    },
    GapCause: {
        GapCause.COUNT: lambda r: (
            f"the count changes from {r.counts[0]} to {r.counts[1]}, but located events account for {r.counts[2]:+d}"
        ),
        GapCause.TURN: lambda r: f"a turn near {_followed(r, 0)} could not be located",
        GapCause.TOUCH_AT_TURN: lambda r: f"a touch of the section next to the turn at {_followed(r, 0)}",
        GapCause.TOUCH: lambda r: (
            f"crossings change from {r.counts[0]} to {r.counts[1]} between "
            f"{_followed(r, 0)} and {r.values[1]:.9g}{r.course.unit} without a located touch"
        ),
        GapCause.UNMATCHED: lambda r: f"a connection could not be matched: {r.error}",
        GapCause.UNFOLLOWED: lambda r: (
            f"a connection with a flight of {_second(r.course, r.duration)} could not be followed beyond "
            f"{_followed(r, 0)}"
        ),
        GapCause.UNSEARCHED: lambda r: f"continuation meets {r.counts[0]} connections that the searches do not find",
    },
    BranchCause: {
        BranchCause.SCATTERS: lambda r: (
            f"branch {r.sampler.branch:+d} scatters before crossing {r.sampler.hit}: more than "
            f"{r.sampler.settings.most_jumps} jumps between phases {r.sampler.settings.fine_phase_step:g} apart; "
            "shorten --longest (longest in Python)"
        ),
        BranchCause.POINTS: lambda r: (
            f"branch {r.sampler.branch:+d}: {r.points} points leave wide chords; shorten --longest (longest in Python)"
        ),
        BranchCause.TIME: lambda r: (
            f"branch {r.sampler.branch:+d}: {r.points} points leave wide chords after its share of the processor time"
        ),
    },
    OpenEndCause: {
        OpenEndCause.NEVER_ARRIVES: lambda r: (
            f"never arrives: {len(r.samples)} phases do not reach crossing {r.sampler.hit} of {r.sampler.section.name} "
            f"within {r.sampler.longest:g} periods"
        ),
        OpenEndCause.ESCAPES: lambda r: (
            f"escapes: {len(r.samples)} phases leave for ever and never reach {r.sampler.section.name}"
        ),
        OpenEndCause.JUMPS: lambda r: (
            f"jumps: neighbouring trajectories separate before crossing {r.sampler.hit} (normal rates "
            f"{r.samples.rates[0]:.3g} and {r.samples.rates[1]:.3g}); they pass near another orbit or were not refined "
            "further"
        ),
        OpenEndCause.GRAZES: lambda r: (
            f"grazes the section: crossing {r.sampler.hit} jumps where the normal rate falls to "
            f"{min(abs(r.samples.rates)):.1e}{r.sampler.manifold.orbit.system.unit('rad/s')}"
        ),
    },
    TransportCause: {
        TransportCause.FINITE: lambda r: (
            f"the neck of {r.saddle} is passed every {r.mean_time:.4g}{r.unit('s')} on average, half of the times each "
            "way"
        ),
        TransportCause.UNBOUNDED: lambda r: (
            f"no mean time between passages of {r.saddle}: at {r.energy:g}{r.unit('J')} motions escape, because the "
            "energy surface is unbounded; use a lower energy"
        ),
        TransportCause.OTHER_KINETIC_ENERGY: lambda r: (
            f"no mean time between passages of {r.saddle}: the kinetic energy is not a positive quadratic form of the "
            "momenta, which the volume of the energy surface requires"
        ),
    },
    SearchCause: {
        SearchCause.TUBES: _searched,
        SearchCause.REVERSED: lambda r: (
            f"{counted(len(r.connections), 'connection')} by time reversal of {r.target.saddle} to {r.source.saddle}: "
            f"{_tubes(r)}"
        ),
        SearchCause.LAPS: _on_laps,
    },
    FlightCause: {
        FlightCause.REACHED: lambda r: f"reaches {r.target} in {r.duration:.3f} s, cost-to-go {r.cost:.2g}",
        FlightCause.MISSED: lambda r: _missed(
            r, f"misses {r.target}: the best flight of {r.duration:.3f} s ends at a cost-to-go of {r.cost:.3g}"
        ),
        FlightCause.OUTSIDE: lambda r: _missed(
            r, f"misses {r.target}: the cart of the best flight passes its limits of position or velocity"
        ),
    },
    ReferenceCause: {
        ReferenceCause.CONVERGED: lambda r: f"converged in {r.iterations} iterations; {_mesh(r)}",
        ReferenceCause.REST: lambda r: f"at rest for {r.times[0]:g} s",
        ReferenceCause.SHADOWING_ORBIT: lambda r: f"the shadowing orbit itself; {_mesh(r)}",
        ReferenceCause.PIECES: lambda r: f"converged in {r.iterations} iterations; {_mesh(r)} of {r.parts} pieces",
        ReferenceCause.FLIGHTS: lambda r: (
            f"converged in {r.iterations} iterations; {_mesh(r)}: {r.parts} flights, {r.parts + 1} stays"
        ),
        ReferenceCause.STORED: lambda r: r.text,
        ReferenceCause.ROUNDS: lambda r: _joined(
            (
                True,
                f"not converged in {r.rounds} rounds: error between nodes {r.error:.1e} where {r.allowed:.1e} is "
                "required",
            ),
            (r.uses, f"a {' and a '.join(map(_passed, r.uses))}"),
            (True, "start with a shorter interval, loosen the tolerance, or allow more rounds"),
        ),
        ReferenceCause.SOLVER: lambda r: f"no reference: the solver stopped with {r.answer!r}; {r.obstacle.status}",
        ReferenceCause.OTHER_MOTION: lambda r: (
            f"no reference near the guess: the motion found passes {r.distance:.2f} (scaled) from it at t = "
            f"{r.times[0]:.2f} s, {r.allowed:g} is allowed, so it is not the itinerary's motion; check that the guess "
            f"is an orbit of the same arms, or lower the friction; {r.obstacle.status}"
        ),
        ReferenceCause.NO_ORBIT: lambda r: (
            f"not converged: the guess is {r.error:.1e} from a frictionless motion where {r.allowed:.1e} is required; "
            'check that it is an orbit of the same arms, or use level "cart"'
        ),
        ReferenceCause.OTHER_PERIOD: lambda r: (
            f"no sustained orbit: the period left that of the Lyapunov orbit, {r.times[0]:.4g} s, by {r.allowed:.0%}, "
            "which gives another orbit; choose an energy nearer to the saddle's or less friction"
        ),
        ReferenceCause.ENERGY_CHANGE: lambda r: (
            f"no change of energy from {r.energies[0]:g} J to {r.energies[1]:g} J at {r.saddle}: {r.inner.status}"
        ),
        ReferenceCause.NO_TRANSFER: lambda r: (
            f"no transfer in {', '.join(f'{time:g}' for time in r.times)} s within the cart's limits: "
            f"{r.inner.status if r.inner else r.answer}; {r.obstacle.status}"
        ),
        ReferenceCause.NO_CHEAPER: lambda r: (
            f"no cheaper motion keeps the walk: {r.inner.status if r.inner else 'no search converged'}; use the "
            "robust plan"
        ),
        ReferenceCause.SHORTFALL: lambda r: (
            f"the reference converged, but a run that follows it would not be completed: {r.inner.status}"
        ),
    },
    ObstacleCause: {
        ObstacleCause.AUTHORITY: lambda r: (
            "the cart's acceleration moves no arm, so friction cannot be compensated; check the arms' parameters"
        ),
        ObstacleCause.GUESS: lambda r: (
            "without limits it finds no solution either: check that the guess is an orbit of the same arms, or lower "
            "the friction"
        ),
        ObstacleCause.LIMITS: lambda r: (
            f"without limits it takes a {' and a '.join(map(_passed, r.uses))}; these values suffice as limits: widen "
            "them, or choose a gentler itinerary"
        ),
        ObstacleCause.MESH: lambda r: (
            "the limits are not the cause: the same motion is found without them; use shorter intervals"
        ),
        ObstacleCause.NO_MOTION: lambda r: (
            "there is no motion near the guess even without friction and limits: check that it is an orbit of the "
            "same arms"
        ),
        ObstacleCause.FRICTION: lambda r: (
            f"friction is out of reach: {r.share:.0%} of it can be compensated within the limits; lower the friction, "
            "widen the limits or choose a gentler itinerary"
        ),
    },
    ShortfallCause: {
        ShortfallCause.FIRST_FAR: lambda r: f"it starts {_far(r)}; raise lead_in to {r.content.lead_in + 1}",
        ShortfallCause.FAR: lambda r: (
            f"{_symbol(r)} comes {_far(r)}; "
            + ("raise the wraps there by 1" if r.stop < len(r.content.symbols) else _longer(r))
        ),
        ShortfallCause.WRAPS: lambda r: (
            f"wraps at stop {r.stop} are {r.gap:.1f} instead of {r.content.wraps[r.stop - 1]}; ask for {round(r.gap)} "
            "wraps there"
        ),
        ShortfallCause.LAST_FAR: lambda r: (
            f"over the last period it is up to {r.gap:.2f} rad from the orbit about {r.content.stops[-1].saddle} "
            f"(allowed: {r.allowed:g}); "
            + ('friction keeps it off that orbit; set finish = "rest"' if r.settled else _longer(r))
        ),
        ShortfallCause.NOT_DECODED: lambda r: (
            f"{_symbol(r) if r.stop else 'the first stop'} does not show in its angles; {_longer(r)}"
        ),
    },
    DepartureCause: {
        DepartureCause.NO_CROSSING: lambda r: f"symbol {r.symbol!r} does not cross its section",
        DepartureCause.ORDER: lambda r: "it crosses the walk's sections in another order",
        DepartureCause.WRAPS: lambda r: f"{r.wraps:g} wraps at stop {r.stop} instead of {r.wanted:g}",
    },
    GridCause: {
        GridCause.REACHED: _on_grid(lambda r: ""),
        GridCause.TIME: _on_grid(lambda r: f"the time limit was reached before {r.beyond.energy:g} J"),
        GridCause.ORBIT: _on_grid(lambda r: r.beyond.status),
        GridCause.UNSTABLE_DIRECTIONS: _on_grid(
            lambda r: f"at {r.beyond.energy:g} J the orbit has {r.beyond.unstable_directions} unstable directions"
        ),
    },
    CautionCause: {
        CautionCause.AUTHORITY: lambda r: (
            f"{r.place} needs {r.figure:.0f} m/s² per rad of feedback (reliable: {r.limit:.0f})"
        ),
        CautionCause.GAINS: lambda r: (
            f"hidden angles, most of them due to {r.place}, cost the feedback up to {r.figure:.2g} times the drive's "
            f"acceleration (reliable: {r.limit:g})"
        ),
        CautionCause.START: lambda r: (
            f"the errors of the start ask for {r.figure:.2g} times the drive's acceleration (reliable: {r.limit:g})"
        ),
        CautionCause.LAG: lambda r: (
            f"errors grow by e^{r.figure:.2g} within the part of the drive's lag that the controller does not know "
            f"(reliable: e^{r.limit:g})"
        ),
        CautionCause.LATE: lambda r: (
            f"errors grow by e^{r.figure:.2g} until a command acts (reliable: e^{r.limit:g}), most in the {r.place}"
        ),
    },
}
"""The sentence of each cause, made of a result with that cause."""

CAUTION_REMEDIES: Mapping[str, str] = {
    "": "no weight at the outer tip helps: take a walk or a hold without this stop",
    "tip_mass": "a weight of {value:.2g} kg at the outer tip brings it to {changed:.0f}, or take a walk without it",
    "counts": "encoders of {value:.0f} counts bring it to {changed:.2g}",
    "noise": "readings without noise bring it to {changed:.2g}",
    "play": "joints without play bring it to {changed:.2g}",
    "friction": "joints without dry friction bring it to {changed:.2g}",
    "initial_error": "begin within {value:.2g} rad, or at rest",
    "drive_lag": "tell the controller: --set drive_lag={value:g}, which `commission` measures",
    "delay": "a delay shorter by {value:.2g} s brings it to {changed:.2g}",
    "lag": "a lag shorter by {value:.2g} s brings it to {changed:.2g}",
    "belt": "a stiffer belt brings it to {changed:.2g}",
}
"""Remedies by the change that was tried, composed of the fields of a `Caution`."""
