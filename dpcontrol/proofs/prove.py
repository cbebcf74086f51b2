"""Statements about a system at one energy, and their proofs.

`Proof` holds the verdict in words: "proved", or "not proved" with the step that does not close and the sizes that were
tried. An enclosure that does not close disproves nothing.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.document import Documented, counted
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.parts import versions
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.orbits.lyapunov import LyapunovOrbit
from dpcontrol.plans.model import ModelSystem
from dpcontrol.proofs.balls import NotClosed, ball, bound, decimal, flint, located, symmetric, working
from dpcontrol.proofs.charts import Surface
from dpcontrol.proofs.check import FORMAT, digest
from dpcontrol.proofs.connect import Route, enclosure_of, link_data, orbit_data, transversality
from dpcontrol.proofs.covering import ChartSegment, Network, orbit_boxes, proved_link
from dpcontrol.proofs.flow import Field, FlowSettings
from dpcontrol.proofs.periodic import (
    Chain,
    KantorovichBounds,
    closed_chain,
    enclose,
    even,
    improved,
    multipliers,
    newton,
    total_time,
)
from dpcontrol.proofs.statements import EQUATIONS, energies_stated, passing, statement
from dpcontrol.proofs.symbols import Enclosed, check_symbols
from dpcontrol.tubes.connections import Connection
from dpcontrol.tubes.frames import node_count, orbit_nodes
from dpcontrol.walks.shadowing import ShadowingOrbit


@dataclass(frozen=True)
class ProofSettings:
    """Precision, radii and integrator of a proof.

    The working precision is `bits`. Orbits are unique in balls of the scaled `radius`. If it does not close, up to
    `tries` radii are tried: larger than the first step, or else smaller. Boxes around connections have the half-width
    `box`. `flow` and `links` are the integrator's settings for closed orbits and for boxes along connections.
    """

    bits: int = 128
    radius: float = 1e-8
    box: float = 1e-7
    tries: int = 2
    flow: FlowSettings = FlowSettings()  # noqa: RUF009 - frozen, so it may be shared
    links: FlowSettings = FlowSettings(24, 18, 1e-14)  # noqa: RUF009 - for boxes, which are wider than balls


@dataclass(frozen=True)
class Proof(Documented):
    """A statement with its verdict, enclosures and certificate, if any.

    Attributes:
        kind: what is proved: "orbit", "connection", "walk" and so on.
        proved: True if the statement is proved.
        status: result in words.
        statement: the statement in words and numbers.
        figures: enclosures and bounds, by name.
        seconds: duration, s.
        certificate: certificate that `check_proof` checks, or None.
        file: file of the certificate, if it was written.
    """

    KEYS: ClassVar[str] = "kind proved status statement **figures seconds certificate=file"

    kind: str
    proved: bool
    status: str
    statement: str
    figures: dict[str, Any]
    seconds: float
    certificate: dict[str, Any] | None = field(default=None, repr=False)
    file: Path | None = None

    @property
    def missed(self) -> str:
        """The enclosure that does not close."""
        return "" if self.proved else self.status

    def __repr__(self) -> str:
        return f"<proof of {self.kind}: {self.status}>"


@dataclass(frozen=True)
class Energies:
    """All energies within a distance of an exact one, in the system's unit."""

    middle: Fraction
    within: Fraction

    @classmethod
    def of(cls, energy: Any, within: Any = 0) -> "Energies":
        """Return energies as exact numbers: the shortest decimals that represent given doubles.

        Args:
            energy: float, a number whose text is a decimal, or energies, which are returned.
            within: largest distance from it, in one of the same forms; ignored for energies.
        """
        if isinstance(energy, Energies):
            return energy
        return cls(*(Fraction(repr(v) if isinstance(v, float) else str(v)) for v in (energy, within)))

    def __str__(self) -> str:
        """Return the energies as a certificate's statement names them: one energy, or each energy of an interval."""
        return energies_stated(self.middle, self.within)


def surface_of(system: System, energies: Energies) -> Surface:
    """Return the surfaces of constant energy of a system, with exact parameters, at the working precision.

    Parameters are the decimals of the model's file, or else the shortest decimals that read as their doubles.

    Args:
        system: system of two degrees of freedom.
        energies: exact energies.

    Raises:
        InputError: the system has more than two degrees of freedom, or unsupported operations.
    """
    if system.dimension != 4:
        raise InputError(f"{system.name} has {system.dimension // 2} degrees of freedom: proofs support only two")
    values = [Fraction(repr(v)) for v in system.parameters.tolist()]
    exact = system.model.exact_parameters if isinstance(system, ModelSystem) else values
    energy = ball(energies.middle) + symmetric(energies.within)
    return Surface(Field.of(system, exact), energy, tuple(bool(p == 2 * np.pi) for p in system.periods))


def attempted(kind: str, statement: str, bits: int, work: Callable[[], Proof]) -> Proof:
    """Return the proof that `work` computes at a precision, or a verdict with the step that does not close.

    Args:
        kind: kind of the proof.
        statement: statement to prove.
        bits: precision, bits.
        work: function that returns the proof or raises NotClosed.
    """
    begin = time.perf_counter()
    try:
        with working(bits):
            proof = work()
    except (NotClosed, ZeroDivisionError, np.linalg.LinAlgError) as error:
        proof = Proof(kind, False, f"not proved: {error}", statement, {}, 0.0)
    return replace(proof, seconds=time.perf_counter() - begin)


def plain(value: Any) -> Any:
    """Return the content of a certificate as JSON values: exact numbers as decimals, and sequences as lists.

    Args:
        value: nested mappings, lists and numbers.
    """
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return decimal(value) if isinstance(value, Fraction) else repr(value) if isinstance(value, float) else value


def certificate(system: System, energies: Energies, content: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return a certificate with its statement and digest, or None for a system without a model file.

    Args:
        system: system of the proof.
        energies: exact energies.
        content: its other numbers.
    """
    if not isinstance(system, ModelSystem):
        return None
    equations = "double pendulum" if isinstance(system.model.parameters, ArmChainParameters) else "three bodies"
    document = plain(
        {
            "format": FORMAT,
            "versions": {name: number for name, number in versions().items() if name in ("dpcontrol", "python-flint")},
            "system": {
                "equations": equations,
                **{key: system.model.decimals[key] for key in EQUATIONS[equations][1]},
            },
            "energy": energies.middle,
            **({"within": energies.within} if energies.within else {}),
            "scale": system.scale.tolist(),
            **content,
        }
    )
    return sealed(document)


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a certificate's content with its statement, which is composed from its numbers, and with its digest.

    Args:
        document: its other numbers.
    """
    document = {"statement": statement(document), **document}
    return {**document, "digest": digest(document)}


def orbit_certificate(
    system: System,
    energies: Energies,
    legs: Chain,
    proof: tuple[list[ChartSegment], KantorovichBounds],
    claims: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any] | None:
    """Return the certificate of a closed chain with its claims on symbols.

    A chain is a closed sequence of legs, the flights from node to node of an orbit. The result is None without a proof
    that a multiplier is off the unit circle, or without a model file. Its radii include a margin for the enclosures of
    module check, which confirms its bounds.

    Args:
        system: system of the orbit.
        energies: exact energies.
        legs: legs of the chain.
        proof: enclosures of the legs and the Newton step.
        claims: claims on symbols, see `Route.claims`.
    """
    segments, bounds = proof
    pair = multipliers(segments)
    if pair is None:
        return None
    radius_of_existence = max(100 * float(bounds.exists), _LEAST_RADIUS)
    durations = [leg.duration for leg in legs]
    # Each duration is an unknown within the radius; twice their sum leaves a margin.
    reach = Fraction(radius_of_existence) * 2 * len(durations)
    content = {
        "nodes": [leg.first.node for leg in legs],
        # Column 2 of the basis is the flow. Its scaled direction is the normal of the node's section.
        "normals": [
            [float(row[2]) / s**2 for row, s in zip(leg.first.basis, system.scale.tolist(), strict=True)]
            for leg in legs
        ],
        "durations": durations,
        "turns": legs[-1].shift,
        "exists": f"{radius_of_existence:.3e}",
        "unique": f"{max(_UNIQUE, 10 * radius_of_existence):.3e}",
        "period": [sum(durations) - reach, sum(durations) + reach],
        "multiplier_exceeds": f"{0.9 * float(abs(pair[0])):.3e}",
        "symbols": list(claims),
    }
    return certificate(system, energies, content)


_MOST_PIECES = 2**20
"""Largest number of pieces of an interval of energies."""
_LEAST_RADIUS, _UNIQUE = 1e-12, 1e-10
"""Scaled radii of a certificate; the check's integrator has an error of about 1e-15."""


def proved_chain(
    surface: Surface, chain: Chain, settings: ProofSettings, progress: Progress = no_progress
) -> tuple[list[ChartSegment], KantorovichBounds]:
    """Prove that a chain contains exactly one orbit, and return its enclosures and the Newton step.

    A chain is a closed sequence of legs, the flights from node to node of a computed orbit. The orbit is sought in
    balls of one radius about all nodes; a radius closes if Newton–Kantorovich proves a solution in them.

    Args:
        surface: equations and energy.
        chain: legs (K,).
        settings: radii and integrator.
        progress: called with a label and the completed share.

    Raises:
        NotClosed: no radius closes; the message gives the last reason.
    """
    reason, radius, tried = NotClosed("no radius was tried"), settings.radius, list[str]()
    for _ in range(settings.tries):
        tried.append(f"{radius:.0e}")
        try:
            segments = enclose(surface, chain, even(chain, radius), settings.flow, progress)
            bounds = newton(segments, radius)
            if bounds.proved:
                return segments, bounds
            reason = NotClosed(
                f"Newton–Kantorovich gives a contraction of {bound(bounds.contraction)} and a first step of "
                f"{bound(bounds.residual)}, which do not prove a solution"
            )
            # A ball must contain the first step; otherwise, the contraction is smaller in a smaller ball.
            radius = 10 * float(bounds.residual) if bounds.residual > radius else radius / 100
        except NotClosed as error:
            reason, radius = error, radius / 100
    raise NotClosed(f"{reason}; balls of {', '.join(tried)} were tried")


def prove_orbit(
    orbit: LyapunovOrbit,
    *,
    energy: Energies,
    settings: ProofSettings | None = None,
    progress: Progress = no_progress,
) -> Proof:
    """Prove that a periodic orbit exists, is unique nearby and is hyperbolic.

    Newton steps in balls refine the orbit's nodes. The theorem is then applied once with a ball of uniqueness.
    The period and the multipliers are enclosed over a ball that contains the orbit.

    Args:
        orbit: computed orbit.
        energy: exact energies, J.
        settings: precision, radii and integrator.
        progress: called with a label and the completed share.

    Raises:
        InputError: a system without two degrees of freedom, or with unsupported operations.
        GoalMissed: the computed orbit did not converge.
    """
    settings = settings or ProofSettings()
    if not orbit.converged:
        raise GoalMissed(f"no orbit to prove: {orbit.status}")
    system, count = orbit.system, node_count(orbit)
    stated = (
        f"{system.name} at {energy}: exactly one orbit near the computed one about {orbit.saddle} "
        f"{passing(count)}, and it is hyperbolic"
    )

    def work() -> Proof:
        """Return the proof; NotClosed is raised at the first step that does not close."""
        surface = surface_of(system, energy)
        chain = closed_chain(system, *orbit_nodes(orbit, count), [0] * 4)
        segments, bounds = proved_chain(surface, chain, settings, part_of(progress, 0.0, 0.25))
        fine = replace(settings.flow, order=44, left=1e-28)
        # After two Newton steps, the theorem is applied to nodes accurate to the precision.
        for share in (0.25, 0.5):
            chain = improved(surface, chain, segments, bounds)
            segments = enclose(surface, chain, even(chain, bounds.unique), fine, part_of(progress, share, share + 0.25))
            bounds = newton(segments, bounds.unique)
        if not bounds.proved:
            raise NotClosed("the theorem holds at the initial nodes, but not at the refined ones")
        # These boxes for period and multipliers contain the proved orbit.
        narrow_radius = bounds.exists * 1000 + flint.arb(1) / 10**24
        narrow_segments = enclose(
            surface, chain, even(chain, narrow_radius), replace(fine, box_order=40), part_of(progress, 0.75, 1.0)
        )
        pair = multipliers(narrow_segments)
        period, start_box = total_time(narrow_segments, bounds.exists), [symmetric(bounds.exists)] * 2
        start_state, _ = chain[0].first.lift(surface.field, surface.energy, start_box)
        figures = {
            "period": period.str(30),
            "multipliers": None if pair is None else [v.str(20) for v in pair],
            "exists_within": bound(bounds.exists),
            "unique_within": bound(bounds.unique, lower=True),
            "contraction": bound(bounds.contraction),
            "state": [v.str(30) for v in start_state],
            "steps": sum(len(segment.spans) for segment in narrow_segments),
        }
        if pair is None:
            return Proof(
                "orbit", False, "not proved: the orbit exists and is unique, but its multipliers are not proved to lie "
                "off the unit circle", stated, figures, 0.0,
            )  # fmt: skip
        return Proof(
            "orbit", True, f"proved: {_unique(bounds, count)}", stated, figures, 0.0,
            orbit_certificate(system, energy, chain, (narrow_segments, bounds)),
        )  # fmt: skip

    return attempted("orbit", stated, settings.bits, work)


def _unique(bounds: KantorovichBounds, count: int) -> str:
    """Return the words of a verdict: exactly one orbit closes after `count` sections within the proved radii."""
    return (
        f"exactly one orbit within {bound(bounds.unique, lower=True)} of the nodes {passing(count)}, with the enclosed "
        f"flight times; it is within {bound(bounds.exists)}"
    )


def prove_walk(
    walk: ShadowingOrbit,
    *,
    energy: Energies,
    rivals: Sequence[Connection] = (),
    settings: ProofSettings | None = None,
    progress: Progress = no_progress,
) -> Proof:
    """Prove existence of a walk's orbit, and its symbols; that of a closed walk is unique.

    `prove_network` proves an open walk. For a closed one, `work` returns the proof at the precision that `attempted`
    sets, and raises NotClosed at the first step that does not close. It gives each symbol the segments (`stretches`)
    between two joints, which are the segments in the middle of the stops, and its marked node on the section.

    Args:
        walk: computed orbit of a walk.
        energy: exact energies, J.
        rivals: other connections at this energy.
        settings: precision, radii and integrator.
        progress: called with a label and the completed share.

    Raises:
        InputError: unsupported equations.
        GoalMissed: the walk's orbit did not converge.
    """
    settings = settings or ProofSettings()
    if not walk.converged:
        raise GoalMissed(f"no orbit to prove: {walk.status}")
    if not walk.periodic:
        return prove_network("walk", [walk], energy=energy, rivals=rivals, settings=settings, progress=progress)
    system, orbit = walk.orbit.system, walk.orbit
    count = len(orbit.states) - 1
    stated = (
        f"{system.name} at {energy}: exactly one orbit near the computed one {passing(count)}, and "
        f"it follows {', '.join(walk.walk)} with wraps {[int(n) for n in walk.wraps]}"
    )

    def work() -> Proof:
        surface = surface_of(system, energy)
        assert orbit.turn is not None
        lengths = zip(orbit.turn, system.turn_lengths, strict=True)
        turns = [round(float(turn / length)) if length else 0 for turn, length in lengths]
        if any(turn and not turning for turn, turning in zip(turns, surface.turns, strict=True)):
            raise InputError(f"{system.name} turns in a coordinate with a period other than 2π; it cannot be proved")
        chain = closed_chain(system, orbit.states[:-1], np.diff(orbit.times), turns)
        segments, bounds = proved_chain(surface, chain, settings, progress)
        pair = multipliers(segments)
        joints, marks = walk.shot.guess.joints, sorted(walk.shot.guess.markers)
        stretches = list(zip([0, *(k + 1 for k in joints)], joints, strict=False))
        claims = Route.of(walk).claims(stretches, marks, rivals)
        figures = {
            "period": total_time(segments, bounds.exists).str(20),
            "multipliers": None if pair is None else [v.str(8) for v in pair],
            "exists_within": bound(bounds.exists),
            "unique_within": bound(bounds.unique, lower=True),
            "contraction": bound(bounds.contraction),
            "nodes": len(chain),
            "steps": sum(len(segment.spans) for segment in segments),
            "symbols": [
                {"symbol": connection.name, "crossings": sum(connection.hits) - 1, "wraps": int(wraps)}
                for connection, wraps in zip(walk.connections, walk.wraps, strict=True)
            ],
        }
        flights, nodes, times = zip(*((piece.spans, piece.start, piece.time) for piece in segments), strict=True)
        with located("a closed orbit exists and is unique, but it is not proved to follow its symbols:"):
            check_symbols(
                claims,
                Enclosed(
                    flights, nodes, times, turns, surface.turns, [ball(v) for v in system.scale], surface.field.rates
                ),
            )
        return Proof(
            "walk", True, f"proved: {_unique(bounds, count)}, and it follows its symbols", stated, figures, 0.0,
            orbit_certificate(system, energy, chain, (segments, bounds), claims),
        )  # fmt: skip

    return attempted("walk", stated, settings.bits, work)


def prove_network(
    kind: str,
    flights: Sequence[Connection | ShadowingOrbit],
    *,
    energy: Energies,
    rivals: Sequence[Connection] | None = None,
    settings: ProofSettings | None = None,
    progress: Progress = no_progress,
) -> Proof:
    """Prove connections or an open walk by covering relations, or the graph of all connections with its entropy.

    A connection that is not proved fails the proof, except in a graph, which is then proved without it. Of two links
    whose chains are not proved to avoid each other's box on the section, a graph has the first one only. Walks on the
    links of a graph are realised without the links that are left out.

    `work` returns the proof of the links along `routes` at the precision that `attempted` sets. It raises NotClosed if
    the boxes of an orbit do not cover one another, or if orbits of different walks are not proved to differ. `ends`
    holds the indices of the two orbits that a route leaves and joins.

    Args:
        kind: "connection", "walk", "horseshoe" or "graph".
        flights: computed connections or one open walk.
        energy: exact energies, J.
        rivals: for a walk: connections that its orbit must not follow.
        settings: precision, radii and integrator.
        progress: called with a label and the completed share.

    Raises:
        InputError: no connections, or unsupported equations.
    """
    settings = settings or ProofSettings()
    if not flights:
        raise InputError("no connections to prove; find some with `dpcontrol connect`")
    routes, system = [Route.of(flight) for flight in flights], flights[0].orbit.system
    end_orbits = [(route.stops[0], route.stops[-1]) for route in routes]
    # Connections have equal copies of an orbit.
    orbits = {(stop.saddle, stop.period): stop for pair in end_orbits for stop in pair}
    ends = [[list(orbits).index((stop.saddle, stop.period)) for stop in pair] for pair in end_orbits]
    stated = f"{system.name} at {energy}: {network_stated(kind, routes)}"

    def work() -> Proof:
        """Return the proof of the links between the orbits; NotClosed is raised at the first step that fails."""
        surface, failed = surface_of(system, energy), list[str]()
        enclosure = enclosure_of(surface, system.scale, settings.links)
        numbers = [orbit_data(orbit, settings.box, tilted=energy.within > 0) for orbit in orbits.values()]
        network, link_figures, proved = Network([], [], enclosure), list[dict[str, Any]](), list[Route]()
        for (saddle, _), data in zip(orbits, numbers, strict=True):
            with located(f"the orbit about {saddle}:"):
                network.orbits.append(orbit_boxes(data, enclosure))
        for k, (route, pair) in enumerate(zip(routes, ends, strict=True)):
            progress(route.name, k / len(routes))
            try:
                link = proved_link(link_data(route, pair, numbers, settings.box, rivals), numbers, enclosure)
                angle = transversality(surface, route.connections[0], link, network.orbits)
                if angle is None and kind == "connection":
                    raise NotClosed("the cones of both manifolds are not proved to be disjoint")
                state = [x.str(8) for x in link.legs[link.marks[0]].start]
                degrees = None if angle is None else angle.str(8, more=True)
                link_figures.append({"name": route.name, "angle_deg": degrees, "state": state})
                network.links.append(link)
                proved.append(route)
            except NotClosed as error:
                failed.append(f"{route.name}: {error}")
        if kind == "graph":
            apart = network.apart()
            failed += [f"{proved[k].name}: not proved to be apart" for k in range(len(proved)) if k not in apart]
            link_figures, proved = [link_figures[k] for k in apart], [proved[k] for k in apart]
            network = replace(network, links=[network.links[k] for k in apart])
        figures: dict[str, Any] = {"box": settings.box, "links": link_figures, "failed": failed}
        if failed and not (kind == "graph" and link_figures):
            status = f"not proved: {len(failed)} of {len(routes)} ({failed[0]})"
            return Proof(kind, False, status, stated, figures, 0.0)
        claims = network_claims(network, kind)
        content = {"orbits": numbers, "links": [link.data for link in network.links], **claims}
        content.pop("least", None)
        status = network_status(kind, [row["angle_deg"] for row in link_figures], claims)
        status += f"; left out: {counted(len(failed), 'connection')}" * bool(failed)
        conclusion = f"{system.name} at {energy}: {network_stated(kind, proved)}"
        return Proof(kind, True, status, conclusion, figures | claims, 0.0, certificate(system, energy, content))

    return attempted(kind, stated, settings.bits, work)


def over_range(energies: Energies, prove: Callable[[Energies], Proof]) -> Proof:
    """Prove a statement for an interval of energies piece by piece, with narrower pieces if a proof does not close.

    Args:
        energies: interval to cover.
        prove: function that computes and proves the statement for a piece of it.

    Returns:
        The proof with the weakest claim of all pieces, or the failed proof of a piece that cannot be narrower.
    """
    low, high, half = energies.middle - energies.within, energies.middle + energies.within, energies.within
    pieces = list[Proof]()
    while not pieces or low < high:
        half = min(half, (high - low) / 2)
        proof = prove(Energies(low + half, half))
        if proof.proved:
            pieces.append(proof)
            low += 2 * half
        elif half <= energies.within / _MOST_PIECES:
            return proof
        else:
            half /= 2
    if len(pieces) == 1:
        return pieces[0]
    figures_of_pieces = [piece.figures for piece in pieces]
    figures = {"pieces": figures_of_pieces} | {
        key: worst(piece_figures[key] for piece_figures in figures_of_pieces)
        for key, worst in (("wraps", max), ("entropy", min))
        if key in figures_of_pieces[0]
    }
    weakest = min(pieces, key=lambda piece: piece.figures.get("entropy", 0.0))
    status = f"{weakest.status}; this or more holds in each of {len(pieces)} intervals, which cover {energies}"
    certificates = [piece.certificate for piece in pieces]
    document = None if None in certificates else sealed({"format": FORMAT, "pieces": certificates})
    seconds = sum(piece.seconds for piece in pieces)
    return replace(weakest, status=status, figures=figures, seconds=seconds, certificate=document)


def network_claims(network: Network, kind: str) -> dict[str, Any]:
    """Return the fewest wraps and the entropy of a graph or a horseshoe, after proving that its walks differ.

    Wraps are rounds about an orbit between two links, and the entropy is the growth rate of the number of walks. The
    check confirms the entropy with its own enclosures of durations.

    Args:
        network: proved links.
        kind: "connection", "walk", "horseshoe" or "graph".

    Returns:
        "wraps", the largest of the fewest wraps between two links; "entropy" per time unit; and "least", the fewest
            wraps (L, L) between links. Empty for the other kinds.

    Raises:
        NotClosed: orbits of different walks are not proved to separate.
    """
    if kind != "walk":
        network.check_marks()
    if kind not in ("horseshoe", "graph"):
        return {}
    least, low, high = network.fewest_wraps(), 0, 10_000_000
    # The entropy is bisected in multiples of 1e-5 per time unit.
    while high - low > 1:
        middle = (low + high) // 2
        # Other enclosures of durations need the relative margin of 1e-6.
        low, high = (middle, high) if network.has_entropy(flint.arb(middle) / 99999.9) else (low, middle)
    return {"wraps": max(n for row in least for n in row if n is not None), "entropy": low / 1e5, "least": least}


def network_stated(kind: str, routes: Sequence[Route]) -> str:
    """Return the statement that a proof of links aims at, in words.

    Args:
        kind: "connection", "walk", "horseshoe" or "graph".
        routes: computed links.
    """
    first, *_, last = saddles = [end.saddle for route in routes for end in (route.stops[0], route.stops[-1])]
    if kind == "walk":
        return (
            f"an orbit leads from the orbit about {first} to that about {last} and follows {routes[0].name} with wraps "
            f"{list(routes[0].wraps)}"
        )
    if kind == "connection":
        return f"{counted(len(routes), 'transversal connection')} from the orbit about {first} to that about {last}"
    return (
        f"{counted(len(routes), 'connection')} between the orbits about {' and '.join(dict.fromkeys(saddles))}, and "
        f"orbits along all walks on {'; '.join(route.name for route in routes)}"
    )


def network_status(kind: str, angles: Sequence[str | None], claims: Mapping[str, Any]) -> str:
    """Return the verdict on proved links in words.

    Args:
        kind: "connection", "walk", "horseshoe" or "graph".
        angles: enclosed angle of each link, None where its cones are not proved to be disjoint.
        claims: wraps and entropy of a graph.
    """
    if kind == "walk":
        return "proved: an orbit leads from orbit to orbit in boxes about the computed one, and follows its symbols"
    walks_and_entropy = (
        "; every walk on them, open or closed, with at least {wraps} wraps at each stop is realised by an orbit, and "
        "the topological entropy is at least {entropy} per second"
    )
    transversal_count = len(angles) - angles.count(None)
    links = (
        counted(transversal_count, "distinct transversal connection")
        if transversal_count == len(angles)
        else f"{counted(len(angles), 'distinct connection')}, of which {transversal_count} are proved to be transversal"
    )
    return f"proved: {links}" + (walks_and_entropy.format(**claims) if claims else "")
