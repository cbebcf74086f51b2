"""The verb `prove`, which proves orbits and connections and checks certificates."""

from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import click

from dpcontrol.cli.verbs import (
    YES,
    Answer,
    argument,
    file_option,
    hits_option,
    option,
    verb,
)
from dpcontrol.cli.walk import _Wraps
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Cost, Progress, announce, part_of, progress_bar

if TYPE_CHECKING:
    from dpcontrol.proofs.prove import Proof, ProofSettings

What = Literal["orbit", "walk", "connection", "horseshoe", "check"]
STATEMENT, ENCLOSURES = "Statement", "Enclosures"


@verb("prove", example="dpcontrol prove orbit lab --saddle down-up --energy -0.07")
def prove_command(
    *,
    what: What = argument(),
    model: str = argument(metavar="MODEL_OR_FILE"),
    energy: Decimal | None = option(group=STATEMENT, help="Energy, J, as an exact decimal."),
    saddle: str | None = option(group=STATEMENT, help="For orbit: saddle inside the orbit."),
    family: int = option(
        default=0, group=STATEMENT, help="For orbit: family of orbits about the saddle, slowest first."
    ),
    symbols: tuple[str, ...] = option(
        "-s", "--symbol", group=STATEMENT, help="For walk: symbol, in order, as for `dpcontrol walk`."
    ),
    wraps: tuple[int, ...] | None = option(
        type=_Wraps(),
        multiple=False,
        group=STATEMENT,
        help="For walk: wraps at the stops, such as 2,3. [default: the fewest that work]",
    ),
    periodic: bool = option(group=STATEMENT, help="For walk: closed walk, which is required for a proof."),
    source: str | None = option("--from", group=STATEMENT, help="For connection, horseshoe: first saddle."),
    target: str | None = option("--to", group=STATEMENT, help="For connection: last saddle. [default: that of --from]"),
    name: tuple[str, ...] = option(
        group=STATEMENT, help="For connection: name from the list of `dpcontrol connect`. [default: all]"
    ),
    hits: tuple[int, int] | None = hits_option("1", group=STATEMENT),
    bits: int = option(type=click.IntRange(64, 1024), default=128, group=ENCLOSURES, help="Working precision, bits."),
    radius: float = option(
        type=click.FloatRange(1e-20, 1e-3),
        default=1e-8,
        group=ENCLOSURES,
        help="Radius of the balls in which orbits are unique, scaled.",
    ),
    box: float = option(
        type=click.FloatRange(1e-12, 1e-4),
        default=1e-7,
        group=ENCLOSURES,
        help="For connection, horseshoe: half-width of the boxes, scaled.",
    ),
    out: Path | None = file_option(
        suffix=".json", help="For orbit, walk: certificate to write (.json), for `prove check`."
    ),
    yes: bool = YES,
) -> Answer:
    """Prove in ball arithmetic that orbits exist, or check a certificate.

    Statements concern an orbit, a closed walk, a connection or a horseshoe. Parameters and energy are exact decimals.
    The answer is "proved", or "not proved" with the enclosure that does not close. The latter is not a disproof.
    Separate code checks certificates.
    """
    from dpcontrol.foundation.parts import part

    part("flint")
    from dpcontrol.proofs.prove import ProofSettings

    if out is not None and what not in ("orbit", "walk"):
        raise InputError(f"--out {out}: only orbits and walks have certificates; omit it")
    if what == "check":
        return _check(Path(model))
    if energy is None:
        raise InputError("--energy is missing: give the energy, J")
    settings = ProofSettings(bits=bits, radius=radius)
    with progress_bar("proof") as progress:
        if what == "orbit":
            proof = _orbit(model, saddle, family, energy, settings, progress)
        elif what != "walk":
            query = _Query(source or saddle, target, name, hits or (1, 1), what == "horseshoe")
            proof = _connections(model, query, energy, replace(settings, box=box), yes, progress)
        else:
            proof = _walk(model, symbols, wraps, periodic, energy, settings, yes, progress)
    return _answer(proof, out)


def _orbit(
    model: str, saddle: str | None, family: int, energy: Decimal, settings: "ProofSettings", progress: Progress
) -> "Proof":
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.plans.model import load_model
    from dpcontrol.proofs.prove import exact_energy, prove_orbit

    if saddle is None:
        raise InputError("--saddle is missing: give the saddle inside the orbit, such as down-up")
    orbit = lyapunov_orbit(load_model(model).system, saddle, energy=float(energy), family=family)
    return prove_orbit(orbit, energy=exact_energy(energy), settings=settings, progress=progress)


class _Query(NamedTuple):
    """A query for connections between two orbits."""

    source: str | None
    target: str | None
    names: tuple[str, ...]
    hits: tuple[int, int]
    whole: bool


def _connections(
    model: str, query: _Query, energy: Decimal, settings: "ProofSettings", yes: bool, progress: Progress
) -> "Proof":
    from dpcontrol.orbits.lyapunov import lyapunov_orbit
    from dpcontrol.plans.model import load_model
    from dpcontrol.proofs.prove import exact_energy, prove_connections
    from dpcontrol.tubes.connections import find_connections

    if query.source is None:
        raise InputError("--from is missing: give the first saddle of the connections, such as down-up")
    system = load_model(model).system
    orbit = lyapunov_orbit(system, query.source, energy=float(energy))
    joined = orbit
    if query.target not in (None, query.source):
        if query.whole:
            raise InputError("a horseshoe needs homoclinics of one orbit: omit --to")
        joined = lyapunov_orbit(system, str(query.target), energy=float(energy))
    found = find_connections(
        orbit, joined, hits=query.hits, section=system.section_between(orbit.saddle, joined.saddle),
        progress=part_of(progress, 0.0, 0.1),
    )  # fmt: skip
    chosen = [c for c in found.connections if not query.names or c.name in query.names]
    for one in set(query.names) - {c.name for c in chosen}:
        raise InputError(f"no connection is named {one!r}; see `dpcontrol connect {model}`")
    announce(_cost(sum(4 + (c.time_out + c.time_in) / orbit.period for c in chosen)), yes=yes)
    return prove_connections(
        chosen,
        energy=exact_energy(energy),
        settings=settings,
        whole=query.whole,
        progress=part_of(progress, 0.1, 1.0),
    )


def _walk(
    model: str,
    symbols: tuple[str, ...],
    wraps: tuple[int, ...] | None,
    periodic: bool,
    energy: Decimal,
    settings: "ProofSettings",
    yes: bool,
    progress: Progress,
) -> "Proof":
    from dpcontrol.plans.model import load_model
    from dpcontrol.proofs.prove import exact_energy, prove_walk
    from dpcontrol.walks.edges import find_edges
    from dpcontrol.walks.shadowing import WalkSolver
    from dpcontrol.walks.symbols import parse_walk
    from dpcontrol.walks.walks import resolve, vertex_names

    if not symbols:
        raise InputError("-s is missing: give the walk's symbols, such as -s 'down-up +'")
    if not periodic:
        raise InputError("only closed walks can be proved: add --periodic")
    system = load_model(model).system
    query = parse_walk(symbols, vertex_names(system))
    edges = find_edges(system, float(energy), symbols=query, yes=yes, progress=part_of(progress, 0.0, 0.2))
    solver, chain = WalkSolver(edges.known), resolve(symbols, edges)
    counts = solver.least(chain, periodic=True) if wraps is None else wraps
    walk = solver.solve(chain, counts, periodic=True)
    announce(_cost(walk.duration / chain[0].source.period), yes=yes)
    return prove_walk(
        walk, energy=exact_energy(energy), rivals=edges.known, settings=settings, progress=part_of(progress, 0.2, 1.0)
    )


def _cost(periods: float) -> Cost:
    """Estimate the cost of a proof, 0.8 to 1.5 s per period."""
    return Cost(f"{periods:.3g} periods of orbits", 1.5 * periods, 2e8, "prove")


def _check(file: Path) -> Answer:
    """Check a certificate's file."""
    from dpcontrol.proofs.check import check_file

    with progress_bar("check") as progress:
        found = check_file(file, progress)
    if not found.proved:
        return Answer(found._asdict(), [found.status], found.status)
    return Answer(
        found._asdict(), [f"checked: {found.status}", *(f"  {one}" for one in str(found.statement).splitlines())]
    )


def _answer(proof: "Proof", out: Path | None) -> Answer:
    """Show a proof's verdict and figures, and write its certificate.

    Not every proof has a certificate.
    """
    from dpcontrol.foundation.files import write_whole

    lines = [proof.statement, f"  {proof.status}"]
    for name, value in proof.figures.items():
        if value == []:
            continue
        if isinstance(value, list) and value and isinstance(value[0], dict):
            lines += ["  " + ", ".join(f"{key} {one[key]}" for key in one) for one in value]
        else:
            shown = "  ".join(map(str, value)) if isinstance(value, list) else str(value)
            lines.append(f"  {name.replace('_', ' '):<14} {shown}")
    lines.append(f"  {proof.seconds:.1f} s")
    document = proof.document()
    if out is not None and proof.proved and proof.certificate is not None:
        import json

        write_whole(out, json.dumps(proof.certificate, indent=1) + "\n")
        document["certificate"] = str(out)
        lines.append(f"  certificate    {out}")
    elif out is not None and proof.proved:
        lines.append("  certificate    none: its multipliers are not enclosed")
    return Answer(document, lines, "" if proof.proved else proof.status)
