"""What the verbs of recordings print."""

from collections.abc import Iterator, Sequence
from statistics import fmean, median
from typing import Any

from dpcontrol.words.table import Line, TextTable, table


def imported(found: Any) -> Iterator[Line]:
    """Yield the content of an imported recording.

    Args:
        found: an `ImportedRecording`.
    """
    recording = found.recording
    if found.log is not None:
        yield str(found.log)
    arms, segments = recording.arms, len(recording.segments)
    yield (
        f"  {arms} arm{'s' * (arms != 1)}, {segments} segment{'s' * (segments != 1)}, "
        f"{found.document()['duration']:.3f} s at {1 / recording.dt:g} Hz; {len(recording.time)} samples"
    )
    for part in ("rates", "cart", "command"):
        yield f"  {part:<8} {'none' if getattr(recording, part) is None else 'recorded'}"
    for note in recording.notes:
        yield f"  mended   {note}"


def identification(found: Any) -> Iterator[Line]:
    """Yield candidates, numbers with standard errors, and what is not determined.

    Args:
        found: an `Identification`.
    """
    rows = [_errors("the starting model", found.started_at)]
    for k, one in enumerate(found.candidates):
        rows.append(_errors(" + ".join(one.terms), one.left_out, "chosen" if k == found.chosen else ""))
    left = sum(not segment.used for segment in found.segments)
    title = f"Error on {left} of {len(found.segments)} segments, left out"
    yield TextTable(title, ("terms", "rms (mrad)", "median", "worst", ""), rows)
    columns = {"name": "{0[0]}", "value": "{0[1]:.9g}", "standard error": "{0[2]:.2g}"}
    numbers = zip(found.names, found.values, found.errors, strict=True)
    yield table("Ratios in SI units, zeros in rad", numbers, columns)
    yield "Not determined:"
    yield from (f"  {sentence}" for sentence in found.undetermined)
    yield found.status
    if found.file is not None:
        yield str(found.file)


def _errors(name: str, rms: Sequence[float], note: str = "") -> tuple[str, ...]:
    values = (fmean(one**2 for one in rms) ** 0.5, median(rms), max(rms))
    return (name, *(f"{1e3 * value:.3f}" for value in values), note)


def design(found: Any) -> Iterator[Line]:
    """Yield the most informative experiments.

    Args:
        found: a `Design`.
    """
    columns = {"experiment": "{.text}", "information": "{.information:.2f}", "error growth": "{.amplification:.3g}"}
    yield table("Most informative experiments", found.ranked()[:8], columns)
    first, second = found.best_pair()
    yield from (f"best pair: {first.text}; {second.text}", found.status)


def replay(found: Any) -> Iterator[Line]:
    """Yield errors of prediction and estimate.

    Args:
        found: a `Replay`.
    """
    columns: dict[str, Any] = {"segment": "{0[index]}", "start (s)": "{0[start]:.3f}"}
    for i in range(1, found.recording.arms + 1):
        columns[f"angle {i} (mrad)"] = lambda one, i=i: f"{1e3 * one[f'rms_angle_{i}']:.2f}"
    columns["all (mrad)"] = lambda one: f"{1e3 * one['rms']:.2f}"
    yield table(f"{found.model} over {found.recording.name}: rms of whole segments", found.stretch_errors, columns)
    if found.cart:
        yield f"  cart      moved by {found.cart}"
    for samples, rms in found.ahead.items():
        yield f"  {samples} ahead   {', '.join(f'{1e3 * value:.3f}' for value in rms)} mrad rms from the estimate"
    if found.rates_rms is not None:
        yield f"  rates     {', '.join(f'{value:.3f}' for value in found.rates_rms)} rad/s rms from those recorded"
    yield f"  NIS       {found.nis_inside_95:.1%} inside its 95 % band, {found.nis_below_95:.1%} below its top"
    if found.nis_means is not None:
        yield f"            {found.nis_means.sentence}"
    if found.log is not None:
        yield str(found.log)
