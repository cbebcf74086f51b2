"""What `dpcontrol walk` prints: the graph, walks, and the orbits found for them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.output import print_json, print_table

if TYPE_CHECKING:
    from dpcontrol.scenes.walks import WalkAnswer, WalkRequest
    from dpcontrol.walks.edges import Edges


def show_graph(edges: "Edges", as_json: bool) -> None:
    """Print the connections of an energy, and how many walks they allow."""
    from dpcontrol.walks.walks import count_walks

    counts = {str(k): count_walks(edges, k) for k in range(1, 9)}
    if as_json:
        print_json(
            {
                "energy": edges.energy,
                "saddles": edges.saddles,
                "absent": [{"saddle": saddle, "reason": reason} for saddle, reason in edges.absent],
                "edges": [
                    {"name": c.name, "from": c.source.saddle, "to": c.target.saddle, "winding": c.winding,
                     "sense": c.sense, "transversality_angle_deg": c.transversality_angle}
                    for c in edges.connections
                ],
                "walks_by_length": counts,
                "notes": edges.notes,
            }
        )  # fmt: skip
        return
    rows = [(f"{a} → {b}", str(len(edges.between(a, b)))) for a, b in edges.searched]
    print_table(f"connections at {edges.energy:g} J", ("from → to", "count"), rows)
    for c in edges.connections:
        click.echo(f"  {c.name}")
    click.echo("walks by number of symbols: " + ", ".join(f"{k}: {n:,}" for k, n in counts.items()))
    for _, reason in edges.absent:
        click.echo(f"not there: {reason}")
    for note in edges.notes:
        click.echo(f"perhaps more: {note}")


def show_walks(edges: "Edges", requests: "Sequence[WalkRequest]", as_json: bool) -> None:
    """Print walks that were not solved."""
    from dpcontrol.scenes.walks import asked_document

    if as_json:
        print_json(
            {"energy": edges.energy, "count": len(requests), "walks": [asked_document(r) for r in requests],
             "notes": edges.notes}
        )  # fmt: skip
        return
    for asked in requests:
        click.echo("  ".join(c.name for c in asked.chain))
    one = len(requests) == 1
    click.echo("1 walk; --solve finds its orbit" if one else f"{len(requests)} walks; --solve finds their orbits")


def print_answer(number: int, answer: "WalkAnswer", file: str | None) -> None:
    """Print one walk that was solved, its error estimate, and where it was written to."""
    click.echo(f"walk {number}: " + "  ".join(c.name for c in answer.request.chain))
    orbit = answer.orbit
    if orbit is None or not answer.converged:
        click.echo(f"  {answer.status}")
        return
    least = "" if answer.least is None else f" (least {_listing(answer.least)})"
    click.echo(
        f"  {'periodic, ' if orbit.periodic else ''}wraps {_listing(orbit.wraps_realised)}{least}, "
        f"{orbit.duration:.3f} s; {orbit.status}"
    )
    estimate = orbit.estimate
    assert estimate is not None
    h = "not measured" if estimate.kantorovich is None else f"{estimate.kantorovich:.1e}"
    radius = "unknown, as h ≥ 1/2" if estimate.radius is None else f"{estimate.radius:.1e}"
    click.echo(
        f"  estimate: condition {estimate.condition:.1e}, Kantorovich h {h}, distance from the true orbit {radius}, "
        f"energy error {estimate.energy_error:.1e}"
    )
    if estimate.multipliers is not None:
        multipliers = estimate.multipliers
        click.echo(
            f"  multipliers: ±exp(±{multipliers.log_unstable:.9g}), sign {multipliers.sign:+d}, product off 1 by "
            f"{multipliers.reciprocity:.1e}"
        )
    if answer.refined is not None:
        click.echo(f"  in 113-bit arithmetic: {answer.refined.status}; at the first symbol's section")
        state = answer.refined.digits
        for k, value in enumerate(state):
            click.echo(f"    {'position' if k < len(state) // 2 else 'rate'} {k % (len(state) // 2) + 1}  {value}")
        if orbit.periodic:
            click.echo(f"    period      {answer.refined.duration}")
    if file is not None:
        click.echo(f"  {file}")


def _listing(wraps: Sequence[int]) -> str:
    return f"[{','.join(map(str, wraps))}]"
