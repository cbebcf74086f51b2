"""dpcontrol identify"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from dpcontrol.cli.output import (
    checked_suffix,
    json_option,
    print_json,
    print_table,
    progress_bar,
    reports_failure,
)

if TYPE_CHECKING:
    from dpcontrol.identification.identify import Identification


@click.command(
    "identify", epilog="Example:  dpcontrol identify logs/lab_free_swing.mcap --model lab --out models/rig.toml"
)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--model", default="lab", show_default=True, help="Model to start from: a name or a TOML file.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Model to write [models/NAME.toml].")
@click.option("--zeros/--no-zeros", default=None, help="Fit the encoders' zeros or not [by the segments left out].")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw the result to this PNG.")
@click.option("--design", is_flag=True, help="Instead, say which swings would tell most about the model.")
@json_option
@reports_failure
def command(
    *,
    logs: tuple[Path, ...],
    model: str,
    out: Path | None,
    zeros: bool | None,
    picture: Path | None,
    design: bool,
    as_json: bool,
) -> None:
    """Identify a model from LOGS that `dpcontrol import` wrote: inertia ratios, friction laws, encoder zeros.

    Every third segment is left out, and the friction laws are chosen by how well these are predicted. With --design no
    log is needed.
    """
    if picture is not None:
        checked_suffix(picture, ".png", option="--picture")
    if design:
        _design(model, logs, picture, as_json)
        return
    if not logs:
        raise click.UsageError("give at least one log that `dpcontrol import` wrote")
    from dpcontrol.identification.identify import IdentificationSettings, identify
    from dpcontrol.recordings.recording import load_recording
    from dpcontrol.scenes.model import load_model, write_model

    start = load_model(model)
    recordings = [load_recording(path) for path in logs]
    target = out or Path("models") / f"{logs[0].stem}.toml"
    checked_suffix(target, ".toml", option="--out")
    choice = {None: "chosen", True: "free", False: "none"}[zeros]
    with progress_bar("identify") as progress:
        found = identify(recordings, start.arms, settings=IdentificationSettings(zeros=choice), progress=progress)
        title = f"{start.title}, identified from {', '.join(r.name for r in recordings)}"
        write_model(found, target, title=title, logs=[path.name for path in logs], starting_model=start.name)
        if picture is not None:
            from dpcontrol.review.identification_figure import write_identification_figure

            write_identification_figure(found, picture, title=title, progress=progress)
    if as_json:
        print_json({**_document(found, target), "picture": None if picture is None else str(picture)})
        return
    _show(found, target)
    if picture is not None:
        click.echo(f"drawn to {picture}")


def _document(found: "Identification", target: Path) -> dict[str, Any]:
    return {
        "parameters": {
            name: {"value": float(value), "standard_error": float(error)}
            for name, value, error in zip(found.names, found.values, found.errors, strict=True)
        },
        "undetermined": list(found.undetermined),
        "friction_terms": list(found.friction_terms),
        "zeros": found.zeros,
        "candidates": [
            {
                "terms": list(c.terms),
                "left_out_rms": c.left_out_rms,
                "left_out_median": float(np.median(c.left_out)),
                "left_out_worst": float(c.left_out.max()),
                "chosen": k == found.chosen,
            }
            for k, c in enumerate(found.candidates)
        ],
        "segments": [
            {"index": s.index, "used": s.used, "rms": s.rms, "log": s.log, "start": s.start, "seconds": s.seconds}
            for s in found.segments
        ],
        "starting_model_left_out_rms": float(np.sqrt((found.started_at**2).mean())),
        "correlation": found.correlation,
        "file": str(target),
        "status": found.status,
    }


def _show(found: "Identification", target: Path) -> None:
    rows = [
        (" + ".join(c.terms), f"{1e3 * c.left_out_rms:.3f}", f"{1e3 * np.median(c.left_out):.3f}",
         f"{1e3 * c.left_out.max():.3f}", "chosen" if k == found.chosen else "")
        for k, c in enumerate(found.candidates)
    ]  # fmt: skip
    before = found.started_at
    rows.insert(
        0,
        (
            "the starting model",
            f"{1e3 * np.sqrt((before**2).mean()):.3f}",
            f"{1e3 * np.median(before):.3f}",
            f"{1e3 * before.max():.3f}",
            "",
        ),
    )
    left = sum(not s.used for s in found.segments)
    print_table(
        f"Error on {left} of {len(found.segments)} segments, left out",
        ("terms", "rms (mrad)", "median", "worst", ""),
        rows,
    )
    numbers = [
        (name, f"{value:.9g}", f"{error:.2g}")
        for name, value, error in zip(found.names, found.values, found.errors, strict=True)
    ]
    print_table("Ratios in SI units, zeros in rad", ("name", "value", "standard error"), numbers)
    click.echo("Not determined:")
    for sentence in found.undetermined:
        click.echo(f"  {sentence}")
    click.echo(f"{found.status}")
    click.echo(f"{target}")


def _design(model: str, logs: tuple[Path, ...], picture: Path | None, as_json: bool) -> None:
    """Show which experiments tell most."""
    from dpcontrol.identification.design import design_experiments
    from dpcontrol.scenes.model import load_model

    if logs:
        raise click.UsageError("--design needs no logs: it compares swings that could be recorded")
    start = load_model(model)
    with progress_bar("design") as progress:
        design = design_experiments(start.arms, progress=progress)
        if picture is not None:
            from dpcontrol.review.identification_figure import write_design_figure

            write_design_figure(design, picture, title=start.title)
    ranked = design.ranked()
    if as_json:
        print_json(
            {
                "unknowns": list(design.names),
                "experiments": [
                    {
                        "kind": e.kind,
                        "angles": e.angles,
                        "amplitude": e.amplitude,
                        "frequency": e.frequency,
                        "information": e.information,
                        "amplification": e.amplification,
                        "usable": e.usable,
                    }
                    for e in design.experiments
                ],
                "best": [e.text for e in ranked[:5]],
                "pair": [e.text for e in design.best_pair()],
                "picture": None if picture is None else str(picture),
            }
        )
        return
    rows = [(e.text, f"{e.information:.2f}", f"{e.amplification:.3g}") for e in ranked[:8]]
    print_table("Experiments that tell most", ("experiment", "information", "error growth"), rows)
    first, second = design.best_pair()
    click.echo(f"best pair: {first.text}; {second.text}")
    click.echo(design.status)
    if picture is not None:
        click.echo(f"drawn to {picture}")
