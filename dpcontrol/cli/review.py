"""The verbs that read logs: score, review, report, info, recover."""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dpcontrol.cli.verbs import (
    FILMS,
    YES,
    Answer,
    TextTable,
    argument,
    claim,
    draw_result,
    file_option,
    force_option,
    option,
    print_message,
    table,
    verb,
)
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Progress, progress_bar

if TYPE_CHECKING:
    from dpcontrol.judge.campaign import CampaignSummary
    from dpcontrol.judge.score import Score
    from dpcontrol.logs import LogSummary, Recovery


@verb("score", example="dpcontrol score logs/outer-turn-0.mcap --why")
def score_command(
    *,
    logs: tuple[Path, ...] = argument(metavar="LOG|FOLDER..."),
    why: bool = option(default=False, help="Options that complete each failed run, found by simulation."),
    yes: bool = YES,
) -> Answer:
    """Score logged runs: symbols, wraps, limits, tracking, consistency of the estimator.

    For the folder of a long run, the score has uptime, falls with causes, times to return, repetitions, and drift of
    the estimates. With --why, it prints the options of `dpcontrol run` (more travel, half the lag, another law …) that
    complete a failed run more often than harmless changes. It works for simulated runs only. With --json, one log gives
    one object, several give {"runs": [...]}. The exit code is 1 if a run is not completed, or if its log covers only a
    part of it. On a rig, it is 1 if by the estimate a symbol was not done.
    """
    from dpcontrol.foundation.files import is_bag_folder
    from dpcontrol.judge.score import score
    from dpcontrol.logs import read_log

    if nights := [path for path in logs if path.is_dir() and not is_bag_folder(path)]:
        return _nights(nights, [path for path in logs if path not in nights], why=why)
    runs = [read_log(path) for path in logs]
    verdicts = [score(run) for run in runs]
    documents = [verdict.document() for verdict in verdicts]
    lines = [[*score_text(verdict, hint=not why)] for verdict in verdicts]
    if why:
        # Loops and plants, which a score needs nothing of.
        from dpcontrol.runs.run import Run

        for run, document, text in zip(runs, documents, lines, strict=True):
            found = Run(run).why(yes=yes, progress=True)
            document["why"] = found.document()
            text += [f"{_WHY}{found.sentence}", *(f"{' ' * len(_WHY)}{line}" for line in found.lines())]
    failed = [verdict for verdict in verdicts if shortfall(verdict)]
    known = all(verdict.completed is False for verdict in failed)
    return Answer(
        documents[0] if len(documents) == 1 else {"runs": documents},
        (line for text in lines for line in text),
        f"{len(failed)} of {len(verdicts)} not {'' if known else 'known to be '}completed; {failed[0].log}: "
        f"{failed[0].reason}"
        if failed
        else "",
    )


def _nights(folders: list[Path], others: list[Path], *, why: bool) -> Answer:
    from dpcontrol.judge.night import read_night

    if others or why:
        what = "--why tries single runs" if why else f"{others[0]} is a single log"
        raise InputError(f"{folders[0]} is the folder of a long run, and {what}; score the folder alone")
    nights = [read_night(folder) for folder in folders]
    documents = [night.document() for night in nights]
    text = (line for night in nights for line in night.lines())
    return Answer(documents[0] if len(documents) == 1 else {"runs": documents}, text)


_WHY = "  why      "


def score_text(verdict: "Score", *, hint: bool = True) -> Iterator[str]:
    """Yield the lines of a score.

    Args:
        verdict: score of one log.
        hint: True to name the command that explains a failed run.
    """
    pace = "" if verdict.real_time_factor is None else f", {verdict.real_time_factor:.1f} × real time"
    yield verdict.log
    yield f"  {verdict.sentence}"
    yield (
        f"  tracking {verdict.rms_tracking_error * 1e3:.1f} mrad rms; cart {verdict.max_cart_position * 1e3:.1f} mm at "
        f"most, {verdict.rms_cart_acceleration:.3f} m/s² rms; NIS inside its 95 % band "
        f"{verdict.nis_inside_95:.1%}{pace}"
    )
    if verdict.nis_means is not None:
        yield f"  NIS      {verdict.nis_means.sentence}"
    if hint and verdict.completed is False:
        yield f"{_WHY}`dpcontrol score LOG --why` searches for options that complete a simulated run of built-in parts"
    if verdict.thinking is not None:
        median, most = 1e6 * verdict.thinking.median, 1e6 * verdict.thinking.within_99
        yield f"  thinking {median:.3g} µs a tick in the median, 99 % within {most:.3g} µs"


def shortfall(verdict: "Score", *, failed: str = "") -> str:
    """Return the reason why a run is not known to be completed, or "".

    On a rig, the symbols decide without the true state.

    Args:
        verdict: score of one log.
        failed: reason for an early end, or "".
    """
    unfinished = verdict.symbols_completed != verdict.symbols_total or not verdict.whole
    if failed or verdict.completed is False or (verdict.completed is None and unfinished):
        return f"{'failed' if verdict.completed else 'not completed'}: {failed or verdict.reason}"
    return ""


@verb("review", example="dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png")
def review_command(
    *,
    files: tuple[Path, ...] = argument(metavar="LOG...|ATLAS|REFERENCE"),
    align: int = option(default=1, metavar="N", help="Symbol at which several logs are aligned, counted from 1."),
    save: Path | None = file_option(suffix=".rrd", help="Rerun recording to write (.rrd)."),
    picture: Path | None = file_option(suffix=".png", help="Picture to write (.png)."),
    film: Path | None = file_option(
        suffix=FILMS, help="Film of the arms in real time; .mp4 needs pip install 'dpcontrol[film]'."
    ),
    stretch: tuple[float, float] | None = option(
        metavar="BEGIN END", help="With --film: part of the log, s. [default: all]"
    ),
    yes: bool = YES,
) -> Answer:
    """Open a log in the Rerun viewer.

    It shows the arms with the reference as a ghost, the planned and the actual itinerary, angles, rates, command,
    errors, energy, and phase planes with the tubes. Recordings from the bench open too. Several logs open side by side,
    delayed so that all cross the section of symbol N at the same time. An atlas (.npz) opens as tubes, orbits and
    flights, with numbered connections on its cuts. A reference (.npz) opens as motion, command and limits.

    With --save, --picture or --film, no viewer opens. A film shows the arms on their cart, the reference, the path of
    the tip and the itinerary.
    """
    from dpcontrol.pages.picture import opened, view_in_window, write_picture
    from dpcontrol.pages.renderers import record

    first = files[0]
    if stretch is not None and film is None:
        raise InputError("--stretch needs a film: add --film FILE.gif")
    with progress_bar("review") as progress:
        progress("reading", 0.05)
        shown = opened(files, symbol=align)
        document: dict[str, Any] = {"log": first, "recording": None, "picture": None, "film": None, "status": "done"}
        if len(files) > 1:
            document |= {"logs": files, "aligned": shown.status}
        if save is not None:
            progress("recording", 0.2)
            record(shown, save)
            document["recording"] = save
        elif picture is None and film is None:
            progress("recording", 0.2)
            document["recording"] = view_in_window(shown, first.stem)
        if film is not None:
            document["film"] = _filmed(shown, film, stretch, yes=yes, progress=progress)
        if picture is not None:
            progress("picture", 0.5)
            document["picture"] = write_picture(shown, picture)
    kinds = ("recording", "picture", "film", "aligned")
    lines = [f"{kind:<10} {document[kind]}" for kind in kinds if document.get(kind)]
    return Answer(document, lines)


def _filmed(shown: Any, file: Path, stretch: tuple[float, float] | None, *, yes: bool, progress: Progress) -> Path:
    """Write a film of a run or a reference."""
    from dpcontrol.judge.run_view import RunView
    from dpcontrol.pages.film import write_film

    if not isinstance(shown, RunView):
        raise InputError(f"{file}: a film shows one motion; give one log, recording or reference")
    return write_film(shown, file, stretch=stretch, yes=yes, progress=progress)


@verb("report", example="dpcontrol report logs/outer-turn-0.mcap --picture outer-turn.pdf")
def report_command(
    *,
    file: Path = argument(metavar="LOG|FOLDER|CAMPAIGN.parquet"),
    picture: Path | None = file_option(
        suffix=(".png", ".pdf"), help="Page to write (.png or .pdf) [NAME-report.png beside FILE]."
    ),
    margins: bool = option(help="For a log: limits of gain, delay and lag along the reference, in some seconds."),
) -> Answer:
    """Write one page on a log, a long run or a campaign.

    matplotlib draws it.

    The page of a log has the planned and the actual itinerary, a film strip, angles, rates, cart, command, errors,
    energy and phase planes. It also compares the further estimates with the truth, if that is in the log. The page of a
    long run has strips of half an hour with the times on the itinerary and the causes of interruptions. It also has
    times to return, and drift. The page of a campaign has success rates by group with Wilson's intervals, and failures
    by symbol and reason.
    """
    from dpcontrol.foundation.files import checked_source, is_bag_folder

    # A folder may be named by "." alone.
    picture = claim(picture or file.parent / f"{file.stem or file.resolve().name}-report.png")
    of_night, of_campaign = file.is_dir() and not is_bag_folder(file), file.suffix.lower() == ".parquet"
    if not of_night:
        checked_source(file)
    if margins and (of_night or of_campaign):
        remedy = "a log of the folder" if of_night else "a log, or use plan --margins"
        raise InputError(f"{file}: --margins applies to one log; give {remedy}")
    make = _night if of_night else _campaign if of_campaign else partial(_log, margins=margins)
    answer = make(file, picture)
    return Answer({**answer.document, "picture": picture}, [*answer.text, f"page       {picture}"])


def _log(file: Path, picture: Path, *, margins: bool) -> Answer:
    from dpcontrol.judge.of_log import run_view
    from dpcontrol.judge.score import lacking, score
    from dpcontrol.logs import read_log
    from dpcontrol.pages.layout import save_figure
    from dpcontrol.pages.page import draw

    log = read_log(file)
    view = run_view(log)
    borne = None
    if margins:
        from dpcontrol.runs.run import Run

        borne = Run(log).margins()
    save_figure(draw(view), picture)
    if not lacking(log):
        verdict = score(log)
        if borne is None:
            return Answer(verdict.document(), score_text(verdict))
        text = [*score_text(verdict), f"  margins  {borne.status}"]
        return Answer({**verdict.document(), "margins": borne.document()}, text)
    return Answer({"log": file, "completed": None, "reason": view.verdict}, [str(file), f"  {view.verdict}"])


def _night(folder: Path, picture: Path) -> Answer:
    from dpcontrol.judge.night import read_night

    night = read_night(folder)
    draw_result(night, picture)
    return Answer(night.document(), night.lines())


def _campaign(file: Path, picture: Path) -> Answer:
    from dpcontrol.judge.campaign import campaign_summary

    summary = campaign_summary(file)
    draw_result(summary, picture)
    return Answer(summary.document(), _text(summary))


def _text(summary: "CampaignSummary") -> Iterator[str | TextTable]:
    yield f"{summary.path}\n  {summary.status}"
    yield table("", summary.groups, {
        "runs": "{.label}", "completed": "{0.share.successes} of {0.share.runs}", "share": "{0.share.rate:.1%}",
        "95 % interval": "{0.share.low:.1%} to {0.share.high:.1%}",
    })  # fmt: skip
    if summary.reasons:
        yield table("", summary.reasons[:8], {"reason of failure": "{0[0]}", "runs": "{0[1]}"})


_LONG = 200
"""Number of characters of a metadata value to print."""


@verb("info", example="dpcontrol info logs/outer-turn-0.mcap")
def info_command(*, log: Path = argument()) -> Answer:
    """Show a log's topics, types, rates, duration, metadata and attachments.

    Topics also have units and counts.

    All checksums are verified. A truncated or damaged log is rejected, and the message suggests a remedy.
    """
    from dpcontrol.logs import summarise

    summary = summarise(log)
    return Answer(asdict(summary), _info_text(summary))


def _info_text(summary: "LogSummary") -> Iterator[str | TextTable]:
    checked = "integrity not checked" if summary.rewritten else "checksums agree"
    yield (
        f"{summary.log}: {summary.duration:.3f} s at {summary.rate_hz:g} Hz, {summary.size / 1e6:.2f} MB, {checked}; "
        f"layout {summary.format}, by {summary.program}; joints {', '.join(summary.joints)}"
    )
    if summary.recovered:
        yield f"  recovered; lost: {summary.recovered}"
    yield table("", summary.topics, {
        "topic": "{.topic}", "type": "{.type}", "units": "{.units}", "messages": "{.count:,}",
        "Hz": lambda topic: "" if topic.rate_hz is None else f"{topic.rate_hz:.6g}",
    })  # fmt: skip
    for name, size in summary.attachments.items():
        yield f"  attachment {name}: {size:,} bytes"
    for key, value in summary.metadata.items():
        yield f"  {key}: {value if len(value) <= _LONG else f'{value[:_LONG]}…'}"
    for file in summary.partials:
        print_message(f"  beside it: {file}, of an interrupted or current run")


@verb("recover", example="dpcontrol recover logs/outer-turn-0.mcap.partial")
def recover_command(
    *,
    log: Path = argument(),
    out: Path | None = file_option(
        suffix=".mcap",
        help="Log to write [NAME.mcap for NAME.mcap.partial if it does not exist, else NAME-recovered.mcap].",
    ),
    force: bool = force_option(),
) -> Answer:
    """Rebuild a truncated or damaged log, and report the losses.

    The log can also be that of a killed run.

    Intact records are copied bit for bit, sorted and verified. The old file is kept.
    """
    from dpcontrol import api

    done = api.recover_log(log, out, force=force, progress=True)
    return Answer(asdict(done), _recover_text(done))


def _recover_text(done: "Recovery") -> Iterator[str]:
    if done.log == done.source:
        yield f"{done.log} is readable as it is: there is nothing to recover"
        return
    kept = f" and {', '.join(done.attachments)}" if done.attachments else ""
    yield f"{done.log}: {done.ticks:,} ticks to {done.end_s:.3f} s{kept}, read back and sound"
    yield f"  lost: {done.lost}" if done.lost else "  nothing is lost"
    yield f"  {done.source} is kept; remove it once you have checked the new log"
