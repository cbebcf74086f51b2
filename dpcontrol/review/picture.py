"""A picture of what is reviewed: the viewer's where it can draw without a screen, else one drawn by matplotlib."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dpcontrol.logs import RunLog
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.viewer import picture_of, screenshot

if TYPE_CHECKING:
    from dpcontrol.review.comparison import Comparison
    from dpcontrol.review.of_reference import ReferenceReview


@dataclass(frozen=True)
class Picture:
    """A picture that was written.

    Attributes:
        path: the PNG.
        renderer: `viewer` or `matplotlib`.
        status: a sentence that says which it is and why.
    """

    path: Path
    renderer: str
    status: str


def write_picture(log: RunLog, context: ReviewContext, path: Path | str) -> Picture:
    """Write a PNG of the run: of the Rerun viewer if this machine can render it, else drawn by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    reason = screenshot(log, context, path)
    return of_viewer(path) if reason is None else write_drawn_picture(log, context, path, reason=reason)


def write_drawn_picture(
    log: RunLog, context: ReviewContext, path: Path | str, *, reason: str = "it was asked for"
) -> Picture:
    """Write a PNG of the run drawn by matplotlib, for `reason`.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.drawing import write_drawing

    path = Path(path)
    write_drawing(log, context, path)
    return drawn(path, reason)


def write_comparison_picture(comparison: "Comparison", path: Path) -> Picture:
    """Write a PNG of several runs, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.comparison_drawing import draw_comparison
    from dpcontrol.review.comparison_recording import write_comparison_recording
    from dpcontrol.review.drawing import save_figure

    moment = comparison.moment
    reason = picture_of(lambda file: write_comparison_recording(comparison, file), path, moment=moment)
    if reason is None:
        return of_viewer(path)
    save_figure(draw_comparison(comparison), path)
    return drawn(path, reason)


def write_reference_picture(reference: "ReferenceReview", path: Path) -> Picture:
    """Write a PNG of a reference, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.recording import write_motion_recording
    from dpcontrol.review.reference_figure import write_reference_figure

    motion, context = reference.motion, reference.context
    moment = context.symbols[0][0] if context.symbols else sum(motion.time_range) / 2
    reason = picture_of(lambda file: write_motion_recording(motion, context, file), path, moment=moment)
    if reason is None:
        return of_viewer(path)
    write_reference_figure(reference.summary, path)
    return drawn(path, reason)


def of_viewer(path: Path) -> Picture:
    """Return the note on a picture that the viewer made."""
    return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")


def drawn(path: Path, reason: str) -> Picture:
    """Return the note on a picture that was drawn, for `reason`."""
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")
