"""dpcontrol reference"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from dpcontrol.cli.output import checked_suffix, json_option, print_json, print_table, reports_failure
from dpcontrol.foundation.errors import InputError

if TYPE_CHECKING:
    from dpcontrol.references.summary import ReferenceSummary

_ORIGIN = ("program", "code", "scene_hash", "model_hash")


@click.command("reference", epilog="Example:  dpcontrol plan cross --out cross.npz; dpcontrol reference cross.npz")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw it to this PNG.")
@json_option
@reports_failure
def command(*, file: Path, picture: Path | None, as_json: bool) -> None:
    """Show a reference: what it does, its use of the cart's limits, its effort, mesh and error, what it was made from.

    FILE is a .npz as `dpcontrol plan --out` writes it; its layout is told in dpcontrol.references.reference, and numpy
    alone reads it. The error between nodes is measured anew.
    """
    from dpcontrol.references.reference import load_reference
    from dpcontrol.references.summary import summarised

    if picture is not None:
        checked_suffix(picture, ".png", option="--picture")
    reference = load_reference(file)
    try:
        summary = summarised(reference)
        document = _document(summary)
        if picture is not None:
            from dpcontrol.review.drawing import draw
            from dpcontrol.review.of_reference import reference_view
            from dpcontrol.review.panel_frame import save_figure

            save_figure(draw(reference_view(summary, file)), picture)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(f"{file} is a reference, but its notes are not those of a plan: {error}") from error
    document = {"file": str(file), **document, "picture": None if picture is None else str(picture)}
    if as_json:
        print_json(document)
    else:
        _show(document)


def _document(summary: "ReferenceSummary") -> dict[str, Any]:
    reference, notes = summary.reference, summary.reference.notes
    lengths = np.diff(reference.mesh)
    made_from: Mapping[str, Any] = notes.get("made_from") or {}
    stops = list(notes.get("stops") or [])
    return {
        "title": str(notes.get("title") or ""),
        "itinerary": notes.get("itinerary"),
        "model": notes.get("model"),
        "energy": notes.get("energy"),
        "plan": notes.get("plan"),
        "made_from": dict(made_from),
        "symbols": [
            {
                "time": float(symbol["time"]),
                "text": str(symbol["text"]),
                "name": symbol["name"],
                "arrives_at": str(stop["saddle"]),
            }
            for symbol, stop in zip(notes.get("symbols") or [], stops[1:], strict=True)
        ],
        "wraps": list(notes.get("wraps") or []),
        "transfers": [[float(begin), float(end)] for begin, end in notes.get("transfers") or []],
        "starts_at": str(stops[0]["saddle"]) if stops else None,
        "duration": reference.duration,
        "intervals": len(lengths),
        "shortest_interval": float(lengths.min()),
        "longest_interval": float(lengths.max()),
        "method": reference.method.name,
        "limits": {
            use.name: {
                "unit": use.unit,
                "bound": use.bound,
                "largest": use.largest,
                "share": use.share,
                "time": use.time,
            }
            for use in summary.uses
        },
        "effort": summary.effort,
        "rms_cart_acceleration": reference.rms_cart_acceleration,
        "max_error_between_nodes": reference.max_error_between_nodes,
        "measured_error_between_nodes": None if summary.errors is None else float(summary.errors.max()),
        "constraint_violation": reference.constraint_violation,
        "iterations": reference.iterations,
        "solve_seconds": reference.solve_seconds,
        "arrays": {"states": reference.states.shape, "inputs": reference.inputs.shape}
        | {name: np.shape(array) for name, array in reference.extra.items()},
        "converged": reference.converged,
        "status": reference.status,
    }


def _show(document: Mapping[str, Any]) -> None:
    click.echo(f"{document['file']}: {document['title'] or 'a reference'}")
    if document["itinerary"]:
        click.echo(f"  itinerary    {document['itinerary']}, model {document['model']}, plan {document['plan']}")
    click.echo(f"  status       {document['status']}")
    click.echo(
        f"  mesh         {document['duration']:.6g} s in {document['intervals']} intervals of {document['method']}, "
        f"{1e3 * document['shortest_interval']:.3g} to {1e3 * document['longest_interval']:.3g} ms"
    )
    measured = document["measured_error_between_nodes"]
    anew = "not measured anew: the file names no arms" if measured is None else f"{measured:.1e} measured anew"
    click.echo(f"  error        {document['max_error_between_nodes']:.1e} between nodes as stored, {anew}")
    click.echo(f"  effort       {document['rms_cart_acceleration']:.4g} m/s² rms, ∫u² {document['effort']:.4g} m²/s³")
    origin = document["made_from"]
    if origin:
        click.echo("  made from    " + ", ".join(f"{key} {origin.get(key)}" for key in _ORIGIN))
    rows = [
        (
            f"cart {name}",
            f"±{use['bound']:g} {use['unit']}",
            f"{use['largest']:.4g}",
            f"{use['share']:.1%}",
            f"{use['time']:.3f}",
        )
        for name, use in document["limits"].items()
    ]
    print_table("", ("limit", "allowed", "largest", "used", "at (s)"), rows)
    if document["symbols"]:
        symbols = [
            (str(k), f"{symbol['time']:.3f}", symbol["text"], symbol["arrives_at"], symbol["name"] or "a transfer")
            for k, symbol in enumerate(document["symbols"], start=1)
        ]
        print_table("", ("symbol", "time (s)", "text", "arrives at", "connection"), symbols)
    if document["picture"]:
        click.echo(f"drawn to {document['picture']}")
