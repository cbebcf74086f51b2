"""dpcontrol identify"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, TextTable, drawn_to, file_option, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.identification.design import Design
    from dpcontrol.identification.identify import Identification


@verb("identify", example="dpcontrol identify logs/lab_free_swing.mcap --model lab --out models/rig.toml")
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--model", default="lab", show_default=True, help="Model to start from: a name or a TOML file.")
@click.option("--zeros/--no-zeros", default=None, help="Fit the encoders' zeros or not [by the segments left out].")
@click.option("--design", is_flag=True, help="Instead, report which swings would tell most about the model.")
@file_option("--out", suffix=".toml", help="Model to write [models/NAME.toml].")
@file_option("--picture", suffix=".png", help="Draw the result to this PNG.")
def command(
    *, logs: tuple[Path, ...], model: str, zeros: bool | None, design: bool, out: Path | None, picture: Path | None
) -> Answer:
    """Identify a model from LOGS that `dpcontrol import` wrote: inertia ratios, friction laws, encoder zeros.

    Every third segment is left out, and the friction laws are chosen by how well these are predicted. With --design no
    log is needed.
    """
    if design:
        if logs:
            raise click.UsageError("--design needs no logs: it compares swings that could be recorded")
        return _design(model, picture)
    if not logs:
        raise click.UsageError("give at least one log that `dpcontrol import` wrote")
    from dpcontrol.identification.identify import IdentificationSettings, identify
    from dpcontrol.recordings.recording import load_recording
    from dpcontrol.scenes.model import load_model, write_model

    start = load_model(model)
    recordings = [load_recording(path) for path in logs]
    target = out or Path("models") / f"{logs[0].stem}.toml"
    settings = IdentificationSettings(zeros={None: "chosen", True: "free", False: "none"}[zeros])
    with progress_bar("identify") as progress:
        found = identify(recordings, start.arms, settings=settings, progress=progress)
        title = f"{start.title}, identified from {', '.join(r.name for r in recordings)}"
        write_model(found, target, title=title, logs=[path.name for path in logs], starting_model=start.name)
        if picture is not None:
            from dpcontrol.identification.identify import profiles
            from dpcontrol.review.identification_figure import draw_identification
            from dpcontrol.review.panel_frame import save_figure

            save_figure(draw_identification(found, profiles(found, progress=progress), title=title), picture)
    document = {**found.document(), "file": str(target), "picture": None if picture is None else str(picture)}
    return Answer(document, _text(found, target, picture))


def _text(found: "Identification", target: Path, picture: Path | None) -> Iterator[str | TextTable]:
    import numpy as np

    def errors(name: str, rms: "np.ndarray", note: str = "") -> tuple[str, ...]:
        return (name, *(f"{1e3 * value:.3f}" for value in (np.sqrt((rms**2).mean()), np.median(rms), rms.max())), note)

    candidates = [
        errors(" + ".join(c.terms), c.left_out, "chosen" if k == found.chosen else "")
        for k, c in enumerate(found.candidates)
    ]
    left = sum(not s.used for s in found.segments)
    yield TextTable(
        f"Error on {left} of {len(found.segments)} segments, left out",
        ("terms", "rms (mrad)", "median", "worst", ""),
        [errors("the starting model", found.started_at), *candidates],
    )
    numbers = [
        (name, f"{value:.9g}", f"{error:.2g}")
        for name, value, error in zip(found.names, found.values, found.errors, strict=True)
    ]
    yield TextTable("Ratios in SI units, zeros in rad", ("name", "value", "standard error"), numbers)
    yield "Not determined:"
    yield from (f"  {sentence}" for sentence in found.undetermined)
    yield from (found.status, str(target), *drawn_to(picture))


def _design(model: str, picture: Path | None) -> Answer:
    """Compare experiments by what they tell."""
    from dpcontrol.identification.design import design_experiments
    from dpcontrol.scenes.model import load_model

    start = load_model(model)
    with progress_bar("design") as progress:
        design = design_experiments(start.arms, progress=progress)
        if picture is not None:
            from dpcontrol.review.identification_figure import draw_design
            from dpcontrol.review.panel_frame import save_figure

            save_figure(draw_design(design, title=start.title), picture)
    document = {**design.document(), "picture": None if picture is None else str(picture)}
    return Answer(document, _design_text(design, picture))


def _design_text(design: "Design", picture: Path | None) -> Iterator[str | TextTable]:
    rows = [(e.text, f"{e.information:.2f}", f"{e.amplification:.3g}") for e in design.ranked()[:8]]
    yield TextTable("Most informative experiments", ("experiment", "information", "error growth"), rows)
    first, second = design.best_pair()
    yield f"best pair: {first.text}; {second.text}"
    yield from (design.status, *drawn_to(picture))
