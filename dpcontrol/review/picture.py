"""A picture of a run: the viewer's where it can draw without a screen, else one drawn by matplotlib."""

from dataclasses import dataclass
from pathlib import Path

from dpcontrol.logs import RunLog
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.viewer import screenshot


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
    if reason is None:
        return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")
    return write_drawn_picture(log, context, path, reason=reason)


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
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")
