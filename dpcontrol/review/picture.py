"""A picture of what is reviewed: the viewer's where it can draw without a screen, else one drawn by matplotlib."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dpcontrol.review.motion import RunView
from dpcontrol.review.viewer import picture_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dpcontrol.review.comparison import RunComparison
    from dpcontrol.walks.atlas import Atlas


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


def write_picture(view: RunView, path: Path | str) -> Picture:
    """Write a PNG of a run or a reference: of the Rerun viewer if this machine can render it, else by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.drawing import draw
    from dpcontrol.review.recording import write_recording

    return _written(path, lambda file: write_recording(view, file), lambda: draw(view), moment=view.moment)


def write_comparison_picture(comparison: "RunComparison", path: Path | str) -> Picture:
    """Write a PNG of several runs, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.comparison_drawing import draw_comparison
    from dpcontrol.review.comparison_recording import write_comparison_recording

    return _written(
        path, lambda file: write_comparison_recording(comparison, file), lambda: draw_comparison(comparison),
        moment=comparison.moment,
    )  # fmt: skip


def write_atlas_picture(atlas: "Atlas", path: Path | str) -> Picture:
    """Write a PNG of an atlas, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.atlas_picture import draw_atlas
    from dpcontrol.review.atlas_recording import write_atlas_recording

    return _written(path, lambda file: write_atlas_recording(atlas, file), lambda: draw_atlas(atlas), moment=0.0)


def _written(
    path: Path | str, record: Callable[[Path], None], draw: Callable[[], "Figure"], *, moment: float
) -> Picture:
    """Write a PNG of what `record` writes, as the viewer shows it at `moment` (s), else what `draw` draws."""
    from dpcontrol.review.panel_frame import save_figure

    path = Path(path)
    reason = picture_of(record, path, moment=moment)
    if reason is None:
        return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")
    save_figure(draw(), path)
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")
