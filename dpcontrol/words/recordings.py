"""Lines of the results of recordings."""

from collections.abc import Iterator, Sequence
from statistics import fmean, median
from typing import Any

from dpcontrol.words.table import Line, TextTable, table


def imported(result: Any) -> Iterator[Line]:
    """Yield the content of an imported recording.

    Args:
        result: an `ImportedRecording`.
    """
    recording = result.recording
    if result.log is not None:
        yield str(result.log)
    arms, segments = recording.arms, len(recording.segments)
    yield (
        f"  {arms} arm{'s' * (arms != 1)}, {segments} segment{'s' * (segments != 1)}, "
        f"{result.document()['duration']:.3f} s at {1 / recording.dt:g} Hz; {len(recording.time)} samples"
    )
    for part in ("rates", "cart", "command"):
        yield f"  {part:<8} {'none' if getattr(recording, part) is None else 'recorded'}"
    for note in recording.notes:
        yield f"  mended   {note}"


def identification(result: Any) -> Iterator[Line]:
    """Yield candidates, numbers with standard errors, and what is not determined.

    Args:
        result: an `Identification`.
    """
    rows = [_errors("the starting model", result.started_at)]
    for k, candidate in enumerate(result.candidates):
        rows.append(_errors(" + ".join(candidate.terms), candidate.left_out, "chosen" if k == result.chosen else ""))
    left = sum(not segment.used for segment in result.segments)
    title = f"Error on {left} of {len(result.segments)} segments, left out"
    yield TextTable(title, ("terms", "rms (mrad)", "median", "worst", ""), rows)
    columns = {"name": "{0[0]}", "value": "{0[1]:.9g}", "standard error": "{0[2]:.2g}"}
    numbers = zip(result.names, result.values, result.errors, strict=True)
    yield table("Ratios in SI units, zeros in rad", numbers, columns)
    yield "Not determined:"
    yield from (f"  {sentence}" for sentence in result.undetermined)
    yield result.status
    if result.file is not None:
        yield str(result.file)


def _errors(name: str, rms: Sequence[float], note: str = "") -> tuple[str, ...]:
    values = (fmean(error**2 for error in rms) ** 0.5, median(rms), max(rms))
    return (name, *(f"{1e3 * value:.3f}" for value in values), note)


def design(result: Any) -> Iterator[Line]:
    """Yield the most informative experiments.

    Args:
        result: a `Design`.
    """
    columns = {"experiment": "{.text}", "information": "{.information:.2f}", "error growth": "{.amplification:.3g}"}
    yield table("Most informative experiments", result.ranked()[:8], columns)
    first, second = result.best_pair()
    yield from (f"best pair: {first.text}; {second.text}", result.status)


def replay(result: Any) -> Iterator[Line]:
    """Yield errors of prediction and estimate.

    Args:
        result: a `Replay`.
    """
    columns: dict[str, Any] = {"segment": "{0[index]}", "start (s)": "{0[start]:.3f}"}
    for i in range(1, result.recording.arms + 1):
        columns[f"angle {i} (mrad)"] = lambda model, i=i: f"{1e3 * model[f'rms_angle_{i}']:.2f}"
    columns["all (mrad)"] = lambda model: f"{1e3 * model['rms']:.2f}"
    yield table(f"{result.model} over {result.recording.name}: rms of whole segments", result.stretch_errors, columns)
    if result.cart:
        yield f"  cart      moved by {result.cart}"
    for samples, rms in result.ahead.items():
        yield f"  {samples} ahead   {', '.join(f'{1e3 * value:.3f}' for value in rms)} mrad rms from the estimate"
    if result.rates_rms is not None:
        yield f"  rates     {', '.join(f'{value:.3f}' for value in result.rates_rms)} rad/s rms from those recorded"
    yield f"  NIS       {result.nis_inside_95:.1%} inside its 95 % band, {result.nis_below_95:.1%} below its top"
    if result.nis_means is not None:
        yield f"            {result.nis_means.sentence}"
    if result.log is not None:
        yield str(result.log)
