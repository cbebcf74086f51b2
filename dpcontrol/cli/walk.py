"""dpcontrol walk"""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import (
    DecimalNumber,
    Hits,
    checked_suffix,
    json_option,
    print_json,
    progress_bar,
    reports_failure,
)
from dpcontrol.cli.walk_output import print_answer, show_graph, show_walks
from dpcontrol.foundation.errors import GoalMissed, InputError

if TYPE_CHECKING:
    from dpcontrol.scenes.model import Model
    from dpcontrol.scenes.walks import WalkAnswer, WalkRequest
    from dpcontrol.walks.edges import Edges

REFINED = 4
"""Walks that --precision extended may refine."""
LISTED = 100_000
"""Walks that --length may list; beyond that they are counted."""


class _Wraps(click.ParamType):
    """Wraps at the stops, as in 2,3,2."""

    name = "n,n,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        try:
            return tuple(int(n) for n in re.split(r"[,\s]+", str(value).strip()) if n)
        except ValueError:
            self.fail(f"{value!r} is not a list of whole numbers, as in 2,3,2.", param, ctx)


@click.command("walk", epilog='Example:  dpcontrol walk lab --energy 0.2 -s "down-up +" -s "down-up > up-down" --solve')
@click.argument("model")
@click.option("--energy", required=True, type=DecimalNumber(), help="Energy in J, zero at the pivot's height.")
@click.option(
    "-s",
    "--symbol",
    "symbols",
    multiple=True,
    help="A symbol of one walk, in order: as in an itinerary; also to and from rotating orbits.",
)
@click.option("--through", multiple=True, metavar="SADDLE", help="A stop of the shortest walk through given stops.")
@click.option("--length", type=click.IntRange(1), help="List all walks of this many symbols.")
@click.option("--from", "source", help="With --length: only walks from this saddle.")
@click.option("--to", "target", help="With --length: only walks to this saddle.")
@click.option("--random", "count", type=click.IntRange(1), help="Draw this many walks.")
@click.option("--lengths", type=(int, int), default=(1, 8), show_default=True, help="Symbols of a drawn walk.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the walks that are drawn.")
@click.option(
    "--wraps", type=_Wraps(), help="Wraps at the stops of -s or --through.  [default: the least that suffice]"
)
@click.option(
    "--extra-wraps",
    type=(int, int),
    default=(0, 0),
    show_default=True,
    help="Wraps beyond the least that suffice at each stop: drawn from this range.",
)
@click.option("--lead-in", type=click.IntRange(0), default=2, show_default=True, help="Wobbles before the walk.")
@click.option("--lead-out", type=click.IntRange(0), default=2, show_default=True, help="Wobbles after it.")
@click.option("--periodic", is_flag=True, help="Walks that close: periodic orbits, with one more stop.")
@click.option("--hits", type=Hits(), default="1", show_default=True, help="Last crossings of the sections that count.")
@click.option(
    "--precision",
    type=click.Choice(["double", "extended"]),
    default="double",
    show_default=True,
    help=f"extended: refine the orbits of up to {REFINED} walks in 113-bit arithmetic; seconds for each symbol.",
)
@click.option("--solve", is_flag=True, help="Find the orbit of each walk.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Write each orbit to this folder (.npz).")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw the walk's orbit to this PNG.")
@json_option
@reports_failure
def command(
    *,
    model: str,
    energy: Decimal,
    symbols: tuple[str, ...],
    through: tuple[str, ...],
    length: int | None,
    source: str | None,
    target: str | None,
    count: int | None,
    lengths: tuple[int, int],
    seed: int,
    wraps: tuple[int, ...] | None,
    extra_wraps: tuple[int, int],
    lead_in: int,
    lead_out: int,
    periodic: bool,
    hits: tuple[int, int],
    precision: str,
    solve: bool,
    out: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """List, count and make walks on the connection graph of an energy, and the orbits that follow them.

    One walk is given by its symbols (-s) or its stops (--through); --length lists all walks of a length, --random
    draws some. With none of these the graph itself is shown. --solve finds each walk's orbit: homoclinic, heteroclinic,
    or periodic with --periodic, with an estimate of its error.

    A symbol is "down-up +", "down-up > up-down", any connection's name that `dpcontrol connect` lists, an edge grown
    from a walk ("(down-up +)·1·(down-up -)": symbols, and the wraps between them), or leads to or from a rotating
    orbit: "down-up > outer-rotating" (also inner-rotating, outer-rotating-back, outer-rotating-2: faster ones first),
    where a wrap is a turn.
    """
    from dpcontrol.scenes.model import load_model
    from dpcontrol.scenes.walks import drawn_requests, request
    from dpcontrol.walks.edges import find_edges
    from dpcontrol.walks.symbols import parse_walk
    from dpcontrol.walks.walks import resolve, vertex_names, ways
    from dpcontrol.walks.walks import through as shortest

    choices = {"-s": symbols, "--through": through, "--length": length, "--random": count}
    chosen = [name for name, given in choices.items() if given]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} both choose walks: give one of them")
    if wraps is not None and not (symbols or through):
        raise InputError("--wraps are those of one walk: give its symbols (-s) or stops (--through), or --extra-wraps")
    if out is not None and not solve:
        raise InputError("--out writes orbits: give --solve as well")
    if precision == "extended" and not solve:
        raise InputError("--precision extended refines orbits: give --solve as well")
    if picture is not None:
        checked_suffix(picture, ".png", option="--picture")
        if not solve:
            raise InputError("--picture draws an orbit: give --solve as well")
    loaded = load_model(model)
    system = loaded.system
    numbers = {(a, b) for a in range(1, hits[0] + 1) for b in range(1, hits[1] + 1)}
    asked = parse_walk(symbols, vertex_names(system)) if symbols else ways(through)
    with progress_bar("connections") as progress:
        edges = find_edges(system, float(energy), hits=numbers, symbols=asked, progress=progress)
    leads = (lead_in, lead_out)
    if symbols or through:
        chain = resolve(symbols, edges) if symbols else shortest(through, edges)
        requests = [request(chain, wraps=wraps, extra=extra_wraps[0], periodic=periodic, leads=leads)]
    elif length is not None:
        requests = _listed(edges, length, source, target, periodic, extra_wraps[0], leads)
    elif count is not None:
        requests = drawn_requests(
            edges, count, lengths=lengths, extra=extra_wraps, seed=seed, periodic=periodic, leads=leads
        )
    elif solve:
        raise InputError("--solve needs walks: give -s, --through, --length or --random")
    else:
        show_graph(edges, as_json)
        return
    if not solve:
        show_walks(edges, requests, as_json)
        return
    if picture is not None and len(requests) != 1:
        raise InputError(f"--picture draws one walk, and here are {len(requests)}: give its symbols with -s")
    if precision == "extended" and len(requests) > REFINED:
        raise InputError(f"--precision extended refines {REFINED} walks at most, and here are {len(requests)}")
    exact = energy if precision == "extended" else None
    _solve(edges, requests, loaded, exact, out, picture, as_json)


def _listed(
    edges: "Edges",
    length: int,
    source: str | None,
    target: str | None,
    periodic: bool,
    extra: int,
    leads: tuple[int, int],
) -> "list[WalkRequest]":
    from dpcontrol.scenes.walks import request
    from dpcontrol.walks.walks import all_walks, count_walks, is_closed

    total = count_walks(edges, length, source=source, target=target)
    if total > LISTED:
        raise InputError(
            f"--length {length}: there are {total:,} such walks, more than the {LISTED:,} that are listed; draw some "
            "with --random"
        )
    walks = all_walks(edges, length, source=source, target=target)
    return [request(walk, wraps=None, extra=extra, periodic=periodic, leads=leads)
            for walk in walks if not periodic or is_closed(walk)]  # fmt: skip


def _solve(
    edges: "Edges",
    requests: "Sequence[WalkRequest]",
    model: "Model",
    exact_energy: Decimal | None,
    out: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Solve, keep, draw and print walks; refine them where their energy is given exactly."""
    from dpcontrol.scenes.walks import refined_answer, save_walk, solved, walk_document
    from dpcontrol.walks.shadowing import WalkSolver

    solver = WalkSolver(edges.connections)
    answers: list[WalkAnswer] = []
    files: list[str | None] = []
    with progress_bar("walks") as progress:
        for k, found in enumerate(solved(requests, solver)):
            answer = found
            if exact_energy is not None:
                progress("refining in 113-bit arithmetic", (k + 0.5) / len(requests))
                answer = refined_answer(found, energy=exact_energy, parameters=model.exact_parameters)
            answers.append(answer)
            file = None
            if out is not None and answer.orbit is not None and answer.converged:
                file = str(out / f"walk-{k + 1}.npz")
                save_walk(Path(file), model.name, answer.orbit, refined=answer.refined)
            files.append(file)
            progress("walks", (k + 1) / len(requests))
    drawn = picture if picture is not None and _drawn(answers[0], picture, model) else None
    failed = [k for k, answer in enumerate(answers, start=1) if not answer.converged]
    status = f"{len(answers) - len(failed)} of {len(answers)} walks converged"
    if failed:
        status += f"; walk {failed[0]}: {answers[failed[0] - 1].status}"
    if as_json:
        print_json(
            {
                "energy": edges.energy,
                "walks": [{**walk_document(a), "file": file} for a, file in zip(answers, files, strict=True)],
                "least_seen": [
                    {"before": a, "after": b, "wraps": n} for (a, b), n in sorted(solver.least_seen.items())
                ],
                "notes": edges.notes,
                "picture": None if drawn is None else str(drawn),
                "status": status,
            }
        )
    else:
        for k, answer in enumerate(answers, start=1):
            print_answer(k, answer, files[k - 1])
        if drawn is not None:
            click.echo(f"drawn to {drawn}")
        click.echo(status)
    if failed:
        raise GoalMissed(status)


def _drawn(answer: "WalkAnswer", picture: Path, model: "Model") -> bool:
    """Draw the orbit of a walk; return whether there was one to draw."""
    from dpcontrol.dynamics.chain import ArmChainParameters
    from dpcontrol.review.panel_frame import save_figure
    from dpcontrol.review.walk_figure import draw_walk

    if answer.orbit is None or not answer.converged:
        return False
    arms = model.parameters
    lengths = arms.length if isinstance(arms, ArmChainParameters) else None
    save_figure(draw_walk(answer.orbit, arm_lengths=lengths, model=model.name), picture)
    return True
