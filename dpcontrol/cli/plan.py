"""The verbs of references: plan, reference."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import (
    WORK,
    YES,
    Answer,
    TextTable,
    argument,
    draw_result,
    drawn_to,
    file_option,
    option,
    table,
    verb,
)
from dpcontrol.foundation.errors import InputError

if TYPE_CHECKING:
    from dpcontrol.plans.plan import Plan
    from dpcontrol.runs.polish import Polished


@verb(
    "plan",
    example="dpcontrol plan outer-turn",
    note="ITINERARY is a name (in ./itineraries or shipped) or the path of a .toml, or of a plan from --out.",
)
def plan_command(
    *,
    itinerary: str = argument(),
    fresh: bool = option(help="New plan, even if one is cached."),
    out: Path | None = file_option(suffix=".npz", help="Reference to write (.npz)."),
    margins: bool = option(help="Limits of gain, delay and lag along the plan, in some seconds."),
    polish: bool = option(
        help="Joint optimisation of a motion from rest to rest, compared with the robust plan, in a minute or two. "
        "--out then writes the polished plan."
    ),
    explore_energy: Path | None = file_option(
        suffix=".png", help="Chart of the effort with feedback at ±5 % over energies (.png), in a minute."
    ),
    workers: int = option(
        type=click.IntRange(min=0),
        default=0,
        show_default=False,
        group=WORK,
        help="Processes that search for transfers [one per processor if there are at least four].",
    ),
    yes: bool = YES,
) -> Answer:
    """Plan an itinerary: connections, shadowing orbit and reference.

    Plans are cached by content, so the same itinerary is planned once. Each transfer is cached too, so interrupted
    planning resumes with the next one.
    """
    from dpcontrol import api
    from dpcontrol.foundation.files import write_whole

    if explore_energy is not None:
        from dpcontrol.bench.energies import only_walk
        from dpcontrol.plans.itinerary import load_itinerary

        only_walk(load_itinerary(itinerary))
    plan = api.plan(itinerary, fresh=fresh, workers=workers, yes=yes, progress=True)
    document = plan.document()
    polished = None
    if polish and plan.converged:
        polished = api.polish(plan, fresh=fresh, workers=workers, yes=yes, progress=True)
        document["polish"] = polished.document()
    wanted = plan if polished is None else polished.polished
    if out is not None and wanted.converged:
        write_whole(out, wanted.archive)
        (document if polished is None else document["polish"]["plan"])["file"] = out
    found = api.closed_loop(plan).margins() if margins and plan.converged else None
    if found is not None:
        document["margins"] = found.document()
    missed = "" if wanted.converged else f"{plan.itinerary.name}: {wanted.status}"
    text = [*_plan_text(plan, document["file"])] if plan.converged else []
    if polished is not None and polished.converged:
        text += _polish_text(polished, document["polish"]["plan"]["file"])
    if found is not None:
        text.append(f"  margins          {found.status}")
    if explore_energy is not None and not missed:
        chart = api.explore_energies(plan, picture=explore_energy, progress=True)
        document["energies"] = {**chart.document(), "file": explore_energy}
        text += [f"  energy           {chart.chosen}", *drawn_to(explore_energy)]
    return Answer(document, text, missed)


def _plan_text(plan: "Plan", file: Path | None) -> Iterator[str | TextTable]:
    reference, content = plan.reference, plan.content
    yield plan.itinerary.title
    for symbol in content.symbols:
        yield (
            f"  {symbol.text!r} is {symbol.name}"
            if symbol.name
            else (f"  {symbol.text}, a transfer at {symbol.time:.2f} s")
        )
    if (residual := content.shadowing.residual) is not None:
        yield f"  shadowing orbit  {content.shadowing.duration:.3f} s, residual {residual:.1e}"
    yield f"  reference        {reference.status}"
    yield (
        f"  cart             {reference.max_cart_position * 1e3:.1f} mm at most, "
        f"{reference.rms_cart_acceleration:.3f} m/s² rms, {reference.max_cart_acceleration:.3f} m/s² at most"
    )
    yield f"  file             {file or 'none: the cache cannot be written'}{' (cached)' if plan.cached else ''}"
    if costs := content.costs:
        columns: dict[str, Any] = {
            "transfer": "{0.text}",
            "duration (s)": "{0.duration:.3g}",
            "∫u² (m²/s³)": "{0.effort:.3g}",
            "stroke (m)": "{0.stroke:.3g}",
        }
        for k, family in enumerate(costs[0].closest):
            columns[f"closest to {family.orbit}"] = (
                f"{{0.closest[{k}].distance:.2f}} at {{0.closest[{k}].energy:.3g}} J"
            )
        yield table("", costs, columns)


def _polish_text(found: "Polished", file: Path | None) -> Iterator[str | TextTable]:
    yield f"  polished         {found.status}"
    yield f"  file             {file or 'none: the cache cannot be written'}"
    shares = {
        f"completed at ±{mismatch:.0%}": lambda side, m=mismatch: "{0.successes} of {0.runs}".format(side.completed[m])
        for mismatch in found.sides[0].completed
    }
    yield table("", found.sides, {
        "plan": "{0.name}", "∫u² (m²/s³)": "{0.effort:.3g}", "peak (m/s²)": "{0.peak:.3g}",
        "travel (m)": "{0.travel:.3g}", "from the orbits": "{0.nearest:.2g}", **shares,
    })  # fmt: skip
    yield "  The polished plan keeps crossings, windings and wraps; it need not come near the orbits."


_ORIGIN = ("program", "code", "scene_hash", "model_hash")


@verb("reference", example="dpcontrol plan cross --out cross.npz; dpcontrol reference cross.npz")
def reference_command(
    *,
    file: Path = argument(),
    picture: Path | None = file_option(suffix=".png", help="Picture of the reference (.png)."),
    transitions: Path | None = file_option(
        suffix=".png", help="Picture of the transfers between equilibria (.png), from rows to columns."
    ),
) -> Answer:
    """Show a reference: motion, limits, effort, mesh, error and origin.

    FILE is a .npz from `dpcontrol plan --out`. numpy can read it; dpcontrol.references.reference documents its layout.
    The error between nodes is measured again.
    """
    from dpcontrol.references.reference import load_reference

    if picture is not None and transitions is not None and picture.resolve() == transitions.resolve():
        raise InputError(f"--picture and --transitions both name {picture}: give two names")
    reference = load_reference(file)
    document = reference.document()
    square = None
    if transitions is not None:
        from dpcontrol.pages.transitions import draw_transitions

        # It can be refused, and must be before another picture is written.
        square = draw_transitions(reference)
    if picture is not None:
        from dpcontrol.judge.of_log import reference_view

        draw_result(reference_view(reference, file), picture)
    if square is not None and transitions is not None:
        from dpcontrol.pages.layout import save_figure

        save_figure(square, transitions)
    document = {"file": file, **document, "picture": picture, "transitions": transitions}
    return Answer(document, [*_reference_text(document), *drawn_to(picture), *drawn_to(transitions)])


def _reference_text(document: Mapping[str, Any]) -> Iterator[str | TextTable]:
    yield f"{document['file']}: {document.get('title', 'a reference')}"
    if "itinerary" in document:
        yield f"  itinerary    {document['itinerary']}, model {document['model']}, plan {document['plan']}"
    yield f"  status       {document['status']}"
    yield (
        f"  mesh         {document['duration']:.6g} s in {document['intervals']} intervals of {document['method']}, "
        f"{1e3 * document['shortest_interval']:.3g} to {1e3 * document['longest_interval']:.3g} ms"
    )
    measured = document["measured_error_between_nodes"]
    anew = f"{measured:.1e} measured again" if measured is not None else "not measured again: the file names no arms"
    if measured is None and "made_from" in document:
        anew = "not measured again: this needs heyoka, which is not installed"
    yield f"  error        {document['max_error_between_nodes']:.1e} between nodes as stored, {anew}"
    yield f"  effort       {document['rms_cart_acceleration']:.4g} m/s² rms, ∫u² {document['effort']:.4g} m²/s³"
    if origin := document.get("made_from"):
        yield "  made from    " + ", ".join(f"{key} {origin.get(key)}" for key in _ORIGIN)
    yield table("", document["limits"].items(), {
        "limit": "cart {0[0]}", "allowed": "±{0[1][bound]:g} {0[1][unit]}", "largest": "{0[1][largest]:.4g}",
        "used": "{0[1][share]:.1%}", "at (s)": "{0[1][time]:.3f}",
    })  # fmt: skip
    if document.get("symbols"):
        yield table("", enumerate(document["symbols"], start=1), {
            "symbol": "{0[0]}", "time (s)": "{0[1][time]:.3f}", "text": "{0[1][text]}",
            "arrives at": "{0[1][arrives_at]}", "connection": lambda row: row[1]["name"] or "a transfer",
        })  # fmt: skip
