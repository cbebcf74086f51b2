"""The verb `walk`, which lists walks and solves their orbits."""

import math
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import (
    ENERGY,
    FILMS,
    FOLDER,
    OUTPUT,
    YES,
    Answer,
    Hits,
    Precision,
    argument,
    drawn_to,
    extended_text,
    file_option,
    option,
    table,
    verb,
)
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, announce, progress_bar

if TYPE_CHECKING:
    from dpcontrol.plans.model import Model
    from dpcontrol.walks.edges import Edges
    from dpcontrol.walks.symbols import Symbol
    from dpcontrol.walks.walks import WalkAnswer, WalkRequest

REFINED = 4
"""Largest number of walks for --precision extended."""
LONGEST = 10_000
"""Largest --length: the number of such walks has thousands of digits."""
WALKS, WRAPS, ORBITS = "Walks", "Wraps", "Orbits"


class _Wraps(click.ParamType):
    """Wraps at the stops, for example 2,3,2."""

    name = "n,n,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        try:
            return tuple(int(n) for n in str(value).replace(",", " ").split())
        except ValueError:
            self.fail(f"{value!r} is not a list of whole numbers, as in 2,3,2.", param, ctx)


@verb("walk", example='dpcontrol walk lab --energy 0.2 -s "down-up +" -s "down-up > up-down" --solve')
def walk_command(
    *,
    model: str = argument(),
    energy: Decimal = ENERGY,
    hits: tuple[int, int] = option(
        type=Hits(), default="1", help="Last section crossings of the connections: K, or N,M."
    ),
    symbols: tuple[str, ...] = option(
        "-s",
        "--symbol",
        group=WALKS,
        help="Symbol of one walk, in order, as in an itinerary, or to and from rotating orbits.",
    ),
    through: tuple[str, ...] = option(
        metavar="SADDLE", group=WALKS, help="Stop of the shortest walk through all given stops."
    ),
    length: int | None = option(
        type=click.IntRange(1, LONGEST), group=WALKS, help="Number of symbols of the listed walks."
    ),
    source: str | None = option("--from", group=WALKS, help="With --length: first saddle of the walks."),
    target: str | None = option("--to", group=WALKS, help="With --length: last saddle of the walks."),
    count: int | None = option("--random", type=click.IntRange(1), group=WALKS, help="Number of random walks."),
    lengths: tuple[int, int] = option(
        default=(1, 8), group=WALKS, help="Least and greatest number of symbols of a random walk."
    ),
    seed: int = option(type=click.IntRange(0), default=0, group=WALKS, help="Seed of the random walks."),
    periodic: bool = option(group=WALKS, help="Closed walks: periodic orbits, with one more stop."),
    compare: float | None = option(
        metavar="ENERGY",
        group=WALKS,
        help="Other energy, J. Energies at which symbols select other connections are reported.",
    ),
    wraps: tuple[int, ...] | None = option(
        type=_Wraps(),
        multiple=False,
        group=WRAPS,
        help="Wraps at the stops of -s or --through, such as 2,3. [default: the fewest that work]",
    ),
    extra_wraps: tuple[int, int] = option(
        default=(0, 0), group=WRAPS, help="Range of random additional wraps at each stop."
    ),
    lead_in: int = option(type=click.IntRange(0), default=2, group=WRAPS, help="Wobbles before the first symbol."),
    lead_out: int = option(type=click.IntRange(0), default=2, group=WRAPS, help="Wobbles after the last symbol."),
    solve: bool = option(group=ORBITS, help="Orbit of each walk."),
    precision: Precision = option(
        default="double",
        group=ORBITS,
        help=f"Precision of the orbits; extended refines up to {REFINED} in 113-bit arithmetic, in seconds per symbol.",
    ),
    out: Path | None = option(type=FOLDER, group=OUTPUT, help="Folder for the orbits (.npz)."),
    picture: Path | None = file_option(suffix=".png", help="Picture of the orbit of the walk (.png)."),
    film: Path | None = file_option(suffix=FILMS, help="Film of the orbit of the walk, in real time."),
    yes: bool = YES,
) -> Answer:
    """List, count and create walks on the connection graph.

    --solve computes the orbit that follows each walk, with an estimate of its error. The orbit is homoclinic,
    heteroclinic, or with --periodic periodic. Give one walk by its symbols (-s) or its stops (--through). --length
    lists all walks of a length, and --random draws some. Without these options, the graph itself is shown.

    A symbol selects the connection at the largest angle. At other energies this can be another connection; --compare
    reports the energies of such changes.

    A symbol is "down-up +", "down-up > up-down", any connection's name that `dpcontrol connect` lists, or a
    composite edge ("(down-up +)·1·(down-up -)": symbols, and the wraps between them). It can also lead to or from a
    rotating orbit: "down-up > outer-rotating" (also inner-rotating, outer-rotating-back, outer-rotating-2: faster ones
    first). There, a wrap is a turn.
    """
    choices = {"-s": symbols, "--through": through, "--length": length, "--random": count}
    chosen = [name for name, given in choices.items() if given]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} both choose walks: give one of them")
    if wraps is not None and not (symbols or through):
        raise InputError(
            "--wraps applies to one walk: give its symbols (-s) or stops (--through), or use --extra-wraps"
        )
    if compare is not None and not (symbols or through):
        raise InputError("--compare follows the symbols of a walk: give them (-s), or its stops (--through)")
    if compare is not None and solve:
        raise InputError("--compare and --solve exclude each other: give one of them")
    if solve and not chosen:
        raise InputError("--solve needs walks: give -s, --through, --length or --random")
    needs = {
        "--out writes orbits": out is not None,
        "--picture draws an orbit": picture is not None,
        "--film shows an orbit": film is not None,
        "--precision extended refines orbits": precision == "extended",
    }
    for what, given in needs.items():
        if given and not solve:
            raise InputError(f"{what}: give --solve as well")

    with progress_bar("connections") as progress:
        progress("loading", 0.0)
        from dpcontrol.plans.model import load_model
        from dpcontrol.walks.edges import find_edges
        from dpcontrol.walks.symbols import parse_walk
        from dpcontrol.walks.walks import (
            LISTED,
            all_walks,
            count_walks,
            counted,
            drawn_requests,
            is_closed,
            request,
            resolve,
            vertex_names,
            walks_cost,
            ways,
        )
        from dpcontrol.walks.walks import through as shortest

        def announced(number: int, longest: int, key: str) -> None:
            more = max(sum(wraps or ()), extra_wraps[1] * longest)
            announce(walks_cost(number, symbols=longest, wraps=more, solve=solve, key=key), yes=yes)

        if count is not None:
            announced(count, max(lengths), "--random" if count > max(lengths) else "--lengths")
        elif symbols or through:
            announced(1, len(symbols or through), "--wraps" if wraps else chosen[0])
        loaded = load_model(model)
        numbers = {(a, b) for a in range(1, hits[0] + 1) for b in range(1, hits[1] + 1)}
        requested = parse_walk(symbols, vertex_names(loaded.system)) if symbols else ways(through)
        if compare is not None:
            return _changes(loaded, requested, float(energy), compare, progress)
        edges = find_edges(loaded.system, float(energy), hits=numbers, symbols=requested, yes=yes, progress=progress)
    leads = (lead_in, lead_out)
    if not chosen:
        return _graph(edges)
    if count is not None:
        requests = drawn_requests(
            edges, count, lengths=lengths, extra=extra_wraps, seed=seed, periodic=periodic, leads=leads
        )
    else:
        if length is None:
            walks = [resolve(symbols, edges) if symbols else shortest(through, edges)]
        else:
            total = count_walks(edges, length, source=source, target=target)
            if total > LISTED:
                raise InputError(
                    f"--length {length}: there are {counted(total)} such walks, more than the {LISTED:,} that are "
                    "listed; draw some with --random"
                )
            announced(total, length, "--length")
            walks = all_walks(edges, length, source=source, target=target)
            walks = [walk for walk in walks if not periodic or is_closed(walk)]
        requests = [request(walk, wraps=wraps, extra=extra_wraps[0], periodic=periodic, leads=leads) for walk in walks]
    if not solve:
        return _walks(edges, requests)
    for name, given in (("--picture draws", picture), ("--film shows", film)):
        if given is not None and len(requests) != 1:
            raise InputError(f"{name} one walk, but there are {len(requests)}: give its symbols with -s")
    if precision == "extended" and len(requests) > REFINED:
        raise InputError(f"--precision extended: {len(requests)} walks; at most {REFINED} are possible")
    return _solve(edges, requests, loaded, energy if precision == "extended" else None, out, picture, film)


def _changes(model: "Model", symbols: "Sequence[Symbol]", begin: float, end: float, progress: Progress) -> Answer:
    """Report the energies at which symbols select other connections."""
    from dpcontrol.walks.following import symbol_changes

    if begin == end or not math.isfinite(end):
        raise InputError(f"--compare {end:g}: must be a finite energy other than --energy {begin:g}")
    found = symbol_changes(model.system, symbols, (begin, end), progress=progress)
    span = f"between {begin:g} and {end:g}{model.unit('J')}"
    status = f"{len(found)} changes of the selected connections {span}"
    document = {"symbol_changes": [one.document() for one in found], "energies": (begin, end), "status": status}
    return Answer(document, [*(one.sentence for one in found), status])


def _graph(edges: "Edges") -> Answer:
    """Show the connections of an energy, and the number of walks."""
    from dpcontrol.walks.walks import count_walks

    counts = {str(k): count_walks(edges, k) for k in range(1, 9)}
    text = [
        table(
            f"connections at {edges.energy:g}{edges.system.unit('J')}",
            edges.searched,
            {
                "from → to": "{0[0]} → {0[1]}",
                "count": lambda pair: str(len(edges.between(*pair))),
            },
        ),
        *(f"  {c.name}" for c in edges.connections),
        "walks by number of symbols: " + ", ".join(f"{k}: {n:,}" for k, n in counts.items()),
        *(f"not there: {reason}" for _, reason in edges.absent),
        *(f"perhaps more: {note}" for note in edges.notes),
    ]
    return Answer({**edges.document(), "walks_by_length": counts}, text)


def _walks(edges: "Edges", requests: "Sequence[WalkRequest]") -> Answer:
    """Show walks without their orbits."""
    walks = [one.document() for one in requests]
    document = {"energy": edges.energy, "count": len(walks), "walks": walks, "notes": edges.notes}
    end = "1 walk; --solve finds its orbit" if len(walks) == 1 else f"{len(walks)} walks; --solve finds their orbits"
    return Answer(document, [*("  ".join(c.name for c in one.chain) for one in requests), end])


def _solve(
    edges: "Edges",
    requests: "Sequence[WalkRequest]",
    model: "Model",
    exact_energy: Decimal | None,
    out: Path | None,
    picture: Path | None,
    film: Path | None,
) -> Answer:
    """Solve, save and draw walks.

    They are refined if the exact energy is given.
    """
    from dpcontrol import api
    from dpcontrol.walks.shadowing import WalkSolver
    from dpcontrol.walks.walks import refined_answer, save_walk, solved

    solver = WalkSolver(edges.connections)
    answers: list[tuple[WalkAnswer, Path | None]] = []
    with progress_bar("walks") as progress:
        for k, answer in enumerate(solved(requests, solver)):
            if exact_energy is not None:
                progress("refining in 113-bit arithmetic", (k + 0.5) / len(requests))
                answer = refined_answer(answer, energy=exact_energy, parameters=model.exact_parameters)
            file = None
            if answer.orbit is None or not answer.converged:
                picture = film = None
            else:
                if out is not None:
                    file = out / f"walk-{k + 1}.npz"
                    save_walk(file, model.name, answer.orbit, refined=answer.refined)
                if picture is not None or film is not None:
                    api.picture(answer.orbit, file=picture, film=film)
            answers.append((answer, file))
            progress("walks", (k + 1) / len(requests))
    failed = [(k, answer.status) for k, (answer, _) in enumerate(answers, start=1) if not answer.converged]
    status = f"{len(answers) - len(failed)} of {len(answers)} walks converged"
    if failed:
        status += "; walk {}: {}".format(*failed[0])
    document = {
        "energy": edges.energy,
        "walks": [{**answer.document(), "file": file} for answer, file in answers],
        "least_seen": [{"before": a, "after": b, "wraps": n} for (a, b), n in sorted(solver.least_seen.items())],
        "notes": edges.notes,
        "picture": picture,
        "film": film,
        "status": status,
    }
    text = [line for k, found in enumerate(answers, start=1) for line in _answer_text(k, *found)]
    return Answer(document, [*text, *drawn_to(picture), *drawn_to(film), status], status if failed else "")


def _answer_text(number: int, answer: "WalkAnswer", file: Path | None) -> Iterator[str]:
    """Yield the text on a solved walk.

    It includes the error estimate and the file.
    """
    yield f"walk {number}: " + "  ".join(c.name for c in answer.request.chain)
    orbit = answer.orbit
    if orbit is None or not answer.converged:
        yield f"  {answer.status}"
        return
    least = "" if answer.least is None else f" (least {_listing(answer.least)})"
    yield (
        f"  {'periodic, ' if orbit.periodic else ''}wraps {_listing(orbit.wraps_realised)}{least}, "
        f"{orbit.duration:.3f}{orbit.system.unit('s')}; {orbit.status}"
    )
    estimate = orbit.estimate
    assert estimate is not None
    h = "not measured" if estimate.kantorovich is None else f"{estimate.kantorovich:.1e}"
    radius = "unknown, as h ≥ 1/2" if estimate.radius is None else f"{estimate.radius:.1e}"
    yield (
        f"  estimate: condition {estimate.condition:.1e}, Kantorovich h {h}, radius without rounding {radius}, "
        f"energy error {estimate.energy_error:.1e}"
    )
    if estimate.multipliers is not None:
        multipliers = estimate.multipliers
        yield (
            f"  multipliers: ±exp(±{multipliers.log_unstable:.9g}), sign {multipliers.sign:+d}, product off 1 by "
            f"{multipliers.reciprocity:.1e}"
        )
    if answer.refined is not None:
        yield f"  in 113-bit arithmetic: {answer.refined.status}; at the first symbol's section"
        yield from extended_text(answer.refined.digits, "    ")
        if orbit.periodic:
            yield f"    period      {answer.refined.duration}"
    if file is not None:
        yield f"  {file}"


def _listing(wraps: Sequence[int]) -> str:
    return f"[{','.join(map(str, wraps))}]"
