"""The verbs of recordings: import, identify, replay."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.verbs import (
    YES,
    Answer,
    TextTable,
    argument,
    claim,
    claim_free,
    drawn_to,
    file_option,
    force_option,
    option,
    table,
    verb,
)
from dpcontrol.foundation.config import log_folder
from dpcontrol.foundation.errors import remark
from dpcontrol.foundation.progress import announce, progress_bar

if TYPE_CHECKING:
    from dpcontrol.identification.fit import Design
    from dpcontrol.identification.identify import Identification
    from dpcontrol.identification.replay import Replay
    from dpcontrol.recordings.recording import Recording

SIMULATED = "With --simulated"


@verb("import", example="dpcontrol import swing.csv --mapping my-rig.toml --repair nan,gaps")
def import_command(
    *,
    file: Path | None = argument(),
    mapping: str | None = option(
        help="Mapping of the columns, a name or a TOML file [by contents for .mat, joint-states for bags and "
        ".mcap, otherwise table]."
    ),
    model: str | None = option(help="Model of the arms, for remarks on contradictions."),
    repair: str = option(default="", help="Faults to correct, with commas: nan,time,gaps,wrap,spikes,sampling."),
    simulated: str | None = option(
        metavar="MODEL", group=SIMULATED, help="Model whose free swings replace the file, as encoders measure them."
    ),
    swings: int = option(default=9, group=SIMULATED, help="Number of swings."),
    seconds: float = option(default=2.667, group=SIMULATED, help="Duration of each swing, s."),
    seed: int = option(default=0, group=SIMULATED, help="Seed of the initial states and the encoder zeros."),
    out: Path | None = file_option(suffix=".mcap", help="Log to write [logs/NAME.mcap]."),
    force: bool = force_option(),
    yes: bool = YES,
) -> Answer:
    """Import a recording of the bench as a log.

    It reads MATLAB, CSV, Parquet, MCAP and ROS bags. Gaps, repeated times, missing numbers, wrapped angles and
    contradicting columns are rejected with their row. --repair selects the faults to correct, and the log records the
    corrections. Segments count from 0, rows from 1. Unusual but possible data cause a remark: a constant angle, and
    with --model a recording that its arms cannot have made. --simulated gives data with known truth for `identify` and
    `replay`.
    """
    from dpcontrol import api
    from dpcontrol.plans.model import load_model
    from dpcontrol.recordings.checks import constant_angles, contradiction
    from dpcontrol.recordings.importing import import_recording
    from dpcontrol.recordings.recording import swings_cost, write_recording

    if (file is None) == (simulated is None):
        raise click.UsageError("give a FILE, or a model to swing with --simulated")
    repairs = [name.strip() for name in repair.split(",") if name.strip()]
    own = None if model is None else load_model(model)
    if file is None:
        announce(swings_cost(swings, seconds, written=True), yes=yes)
    with progress_bar("import") as progress:
        if file is None:
            recording = api.swings(load_model(str(simulated)), count=swings, seconds=seconds, seed=seed, yes=yes)
        else:
            recording = import_recording(file, mapping, repairs=repairs, progress=progress)
        progress("writing", 0.7)
        write, named = partial(write_recording, recording, force=force), log_folder() / f"{recording.name}.mcap"
        log = claim_free(named, write) if out is None else write(claim(out))
    against = "" if own is None else contradiction(recording, own.arms, model=own.name)
    remarks = [*constant_angles(recording), *filter(None, [against])]
    for sentence in remarks:
        remark(f"{file or recording.source}: {sentence}")
    document = {"log": log, "source": file or recording.source, **recording.document(), "remarks": remarks}
    return Answer(document, _import_text(recording, document))


def _import_text(recording: "Recording", document: dict[str, Any]) -> Iterator[str]:
    yield str(document["log"])
    arms = "1 arm" if recording.arms == 1 else f"{recording.arms} arms"
    segments = len(recording.segments)
    count = "1 segment" if segments == 1 else f"{segments} segments"
    rate = f"{1 / recording.dt:g} Hz; {len(recording.time)} samples"
    yield f"  {arms}, {count}, {document['duration']:.3f} s at {rate}"
    for part, there in (("rates", recording.rates), ("cart", recording.cart), ("command", recording.command)):
        yield f"  {part:<8} {'recorded' if there is not None else 'none'}"
    for note in recording.notes:
        yield f"  mended   {note}"


@verb("identify", example="dpcontrol identify logs/lab_free_swing.mcap --model lab --out models/rig.toml")
def identify_command(
    *,
    logs: tuple[Path, ...] = argument(required=False),
    model: str = option(default="lab", help="Initial model, a name or a TOML file."),
    zeros: bool | None = option(
        "--zeros/--no-zeros", help="Fit of the encoder zeros [if it predicts the held-out segments better]."
    ),
    design: bool = option(help="Most informative swings for recording, instead of an identification."),
    out: Path | None = file_option(suffix=".toml", help="Model to write [models/NAME.toml]."),
    force: bool = force_option(),
    picture: Path | None = file_option(suffix=".png", help="Picture of the result (.png)."),
) -> Answer:
    """Identify a model from LOGS that `dpcontrol import` wrote.

    The model gets inertia ratios, friction laws and encoder zeros. Every third segment is held out, and the friction
    laws are chosen by the error on these segments. --design needs no log.
    """
    if design:
        if logs:
            raise click.UsageError("--design compares possible recordings: omit LOGS")
        return _design(model, picture)
    if not logs:
        raise click.UsageError("give at least one log that `dpcontrol import` wrote")
    from dpcontrol import api
    from dpcontrol.plans.model import check_model_replaced, load_model, write_model
    from dpcontrol.recordings.recording import load_recording

    start = load_model(model)
    recordings = [load_recording(path) for path in logs]
    target, names = claim(out or Path("models") / f"{logs[0].stem}.toml"), [path.name for path in logs]
    check_model_replaced(target, logs=names, starting_model=start.name, force=force)
    with progress_bar("identify") as progress:
        found = api.identify(recordings, model=start, zeros=zeros, progress=progress)
        title = f"{start.title}, identified from {', '.join(r.name for r in recordings)}"
        # A model's file names the logs as they were given.
        write_model(found, target, title=title, logs=names, starting_model=start.name)
        if picture is not None:
            from dpcontrol.identification.identify import profiles
            from dpcontrol.pages.identification import draw_identification
            from dpcontrol.pages.layout import save_figure

            save_figure(draw_identification(found, profiles(found, progress=progress), title=title), picture)
    document = {**found.document(), "file": target, "picture": picture}
    return Answer(document, _identify_text(found, target, picture))


def _identify_text(found: "Identification", target: Path, picture: Path | None) -> Iterator[str | TextTable]:
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
    yield table("Ratios in SI units, zeros in rad", zip(found.names, found.values, found.errors, strict=True), {
        "name": "{0[0]}", "value": "{0[1]:.9g}", "standard error": "{0[2]:.2g}"
    })  # fmt: skip
    yield "Not determined:"
    yield from (f"  {sentence}" for sentence in found.undetermined)
    yield from (found.status, str(target), *drawn_to(picture))


def _design(model: str, picture: Path | None) -> Answer:
    """Compare experiments by their information."""
    from dpcontrol import api
    from dpcontrol.plans.model import load_model

    start = load_model(model)
    design = api.design_experiments(start, progress=True)
    if picture is not None:
        from dpcontrol.pages.experiments import draw_design
        from dpcontrol.pages.layout import save_figure

        save_figure(draw_design(design, title=start.title), picture)
    document = {**design.document(), "picture": picture}
    return Answer(document, _design_text(design, picture))


def _design_text(design: "Design", picture: Path | None) -> Iterator[str | TextTable]:
    columns = {"experiment": "{.text}", "information": "{.information:.2f}", "error growth": "{.amplification:.3g}"}
    yield table("Most informative experiments", design.ranked()[:8], columns)
    first, second = design.best_pair()
    yield f"best pair: {first.text}; {second.text}"
    yield from (design.status, *drawn_to(picture))


ESTIMATOR = "Estimator"


@verb("replay", example="dpcontrol replay logs/lab_free_swing.mcap --model lab --estimator ukf")
def replay_command(
    *,
    log: Path = argument(),
    model: str = option(default="lab", help="Model for the prediction, a name or a path."),
    ahead: int = option(default=100, help="Number of samples of the n-step prediction error."),
    span: float | None = option(help="Longest prediction in one piece, s [5, or 0.5 if the cart moved]."),
    estimator: str = option(default="ekf", group=ESTIMATOR, help="Kind of estimator: ekf, ukf."),
    counts: int = option(default=40_000, group=ESTIMATOR, help="Encoder counts per turn, for the assumed noise."),
    mean_over: float | None = option(group=ESTIMATOR, help="Duration of its means, s [0.015, or 0 if the cart moved]."),
    model_error: float = option(
        type=click.FloatRange(0, 1e6),
        default=0.003,
        group=ESTIMATOR,
        help="Assumed relative error of the accelerations.",
    ),
    out: Path | None = file_option(suffix=".mcap", help="Log to write [logs/NAME-replay.mcap]."),
    force: bool = force_option(),
) -> Answer:
    """Predict a recording by a model, and run an estimator.

    The log contains the prediction, the estimates and the measurements. Each segment is predicted in one piece from its
    best initial state. The prediction is the reference of the log, so `dpcontrol review` shows both. If the cart moved,
    as in a log of `dpcontrol run`, its command or its recorded motion is the input of the model. The encoder zeros of
    the model file are subtracted.
    """
    from dpcontrol.identification.replay import ReplaySettings, filter_settings, replay_recording, write_replay
    from dpcontrol.plans.model import load_model
    from dpcontrol.recordings.checks import contradiction
    from dpcontrol.recordings.recording import load_recording

    settings = ReplaySettings(counts=counts, mean_over=mean_over, ahead=ahead, span=span)
    filters = filter_settings(estimator, model_error=model_error)
    loaded, recording = load_model(model), load_recording(log)
    with progress_bar("replay") as progress:
        result = replay_recording(
            recording, loaded.arms, filters, settings, zeros=loaded.encoder_zeros, progress=progress
        )
        write = partial(write_replay, result, model=loaded.name, model_text=loaded.text, force=force)
        written = claim_free(log_folder() / f"{log.stem}-replay.mcap", write) if out is None else write(out)
    if against := contradiction(recording, loaded.arms, model=loaded.name):
        remark(f"{log}: {against}")
    document = {"log": written, "model": loaded.name, "estimator": estimator, **result.document()}
    missed = "" if all(fit.converged for fit in result.fits) else result.status
    return Answer(document, _replay_text(result, loaded.name, written), missed)


def _replay_text(result: "Replay", model: str, written: Path) -> Iterator[str | TextTable]:
    arms = range(1, result.recording.arms + 1)
    yield table(f"{model} over {result.recording.name}: rms of whole segments", result.stretch_errors, {
        "segment": "{0[index]}",
        "start (s)": "{0[start]:.3f}",
        **{f"angle {i} (mrad)": lambda one, i=i: f"{1e3 * one[f'rms_angle_{i}']:.2f}" for i in arms},
        "all (mrad)": lambda one: f"{1e3 * one['rms']:.2f}",
    })  # fmt: skip
    if result.cart:
        yield f"  cart      moved by {result.cart}"
    for samples, rms in result.ahead.items():
        yield f"  {samples} ahead   {', '.join(f'{1e3 * value:.3f}' for value in rms)} mrad rms from the estimate"
    if result.rates_rms is not None:
        yield f"  rates     {', '.join(f'{value:.3f}' for value in result.rates_rms)} rad/s rms from those recorded"
    yield f"  NIS       {result.nis_inside_95:.1%} inside its 95 % band, {result.nis_below_95:.1%} below its top"
    if result.nis_means is not None:
        yield f"            {result.nis_means.sentence}"
    yield str(written)
