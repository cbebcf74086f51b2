"""Arms on their cart: at several times side by side, in a film over the itinerary, and in transfers from row to column.

The motion is a run, a recording, a reference or an orbit.

Static parts of a film (title, track, limits, the story over time) are drawn once as on a page. Each frame draws its
moving parts over them: the pose of the arms as in a filmstrip, a cursor in the story, the time and the last symbol.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.parts import part
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress
from dpcontrol.judge.of_log import reference_view
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, key, text_width
from dpcontrol.pages.planes import Range, arm_points
from dpcontrol.pages.story import add_story
from dpcontrol.references.reference import Reference

_FRAME_STEP = 2.12
"""Distance between the film's frames, in lengths of all arms: enough for two stretched towards one another."""
_TRACE = 0.25
"""Longest visible path of the tip, s."""


def _draw_film(axes: Axes, view: RunView, times: Array, rows: NDArray[np.int64], box: tuple[Range, Range]) -> None:
    """Draw a filmstrip: a pose for each time, side by side, with its time and the cart's position below.

    Below a pose whose position is not finite, the text is "lost" in place of the position.

    Args:
        axes: panel to draw on.
        view: motion to draw.
        times: (K,) s of the frames; those outside the motion are marked as empty.
        rows: (K,) tick of each frame.
        box: horizontal and vertical range of the panel, m.
    """
    pivot, reach, (horizontal, vertical) = view.pivot, sum(view.arm_lengths), box
    axes.set(xlim=horizontal, ylim=vertical, aspect="equal")
    for i, (time, row) in enumerate(zip(times, rows, strict=True)):
        centre = i * _FRAME_STEP * reach
        if not view.time[0] <= time <= view.time[-1]:
            look = {"ha": "center", "va": "center", "fontsize": style.SMALL, "color": style.MARK}
            axes.text(centre, 0, f"no data at\n{time:.2f} s", **look)
            continue
        if view.has_cart:
            axes.plot(
                [centre - 0.98 * reach, centre + 0.98 * reach], [0, 0], color=style.FAINT, linewidth=2.5, zorder=1
            )
        trace_ticks = max(1, round((_TRACE if i else 0.1) * view.rate_hz))
        # The path of the tip begins no earlier than the previous frame.
        draw_pose(axes, view, (max(rows[i - 1] if i else 0, row - trace_ticks), row), at=centre, thick=2.6)
        cart = f"\ncart {round(1000 * float(pivot[row])):+d} mm" if np.isfinite(pivot[row]) else "\nlost"
        text = f"{view.time[row]:.2f} s{cart if view.has_cart else ''}"
        look = {"ha": "center", "va": "top", "fontsize": style.SMALL, "color": style.NOTE, "linespacing": 1.25}
        axes.text(centre, vertical[0] + 0.46 * reach, text, **look)
    axes.axis("off")


def draw_pose(
    axes: Axes, view: RunView, ticks: tuple[int, int], *, at: float, thick: float, shade: float = 1.0
) -> None:
    """Draw the arms at a tick on their cart, with the tip's path, and the reference in grey behind them.

    Args:
        axes: panel to draw on.
        view: motion to draw.
        ticks: first tick of the tip's path, and tick of the pose.
        at: drawn position of the pivot, m.
        thick: width of the arms, points.
        shade: opacity of the arms and the cart.
    """
    look: dict[str, Any]
    since, row = ticks
    arms, reach, pivot = view.arms, sum(view.arm_lengths), view.pivot
    tip = style.arm_colour(arms - 1)
    if view.has_cart:
        corner, look = (at - 0.13 * reach, -0.05 * reach), {"color": style.CART, "alpha": shade, "zorder": 2}
        axes.add_patch(Rectangle(corner, 0.26 * reach, 0.1 * reach, **look))
    points = arm_points(view.state[since : row + 1, :arms], view.arm_lengths)
    points[..., 0] += at + (pivot[since : row + 1] - pivot[row])[:, None]
    axes.plot(*points[:, -1].T, color=tip, linewidth=thick / 2, alpha=0.4)
    for arm in range(arms):
        look = {"color": style.arm_colour(arm), "alpha": shade, "solid_capstyle": "round", "zorder": 3}
        # Outer arms are drawn narrower, so that overlapping arms remain visible.
        axes.plot(*points[-1, arm : arm + 2].T, linewidth=thick * (1 - 0.8 * arm / arms), **look)
    axes.plot(*points[-1, :-1].T, "o", color=style.INK, markersize=1.2 * thick, alpha=shade, zorder=4)
    axes.plot(*points[-1, -1], "o", color=tip, markersize=2.0 * thick, alpha=shade, zorder=4)
    if view.reference is not None:
        ghost = arm_points(view.reference[row : row + 1, :arms], view.arm_lengths)[0]
        shift = at + (view.reference[row, 2 * arms] - pivot[row] if view.has_cart else 0.0)
        look = {"color": style.REFERENCE, "linewidth": 2.0 * thick, "solid_capstyle": "round", "zorder": 1.5}
        axes.plot(shift + ghost[:, 0], ghost[:, 1], **look)


def add_film(page: Page, view: RunView, times: Array) -> None:
    """Add a filmstrip to a page, as high as equal scales require, with the reference in grey behind the arms.

    The tip's path begins at the last frame. Times outside the motion are empty.

    Args:
        page: page to extend.
        view: motion in the film.
        times: (K,) s of the frames.
    """
    rows = np.searchsorted(view.time, times).clip(0, len(view.time) - 1)
    reach, trace_ticks = sum(view.arm_lengths), round(_TRACE * view.rate_hz)
    ticks = np.unique(np.add.outer(rows, np.arange(-trace_ticks, 1)).clip(0))
    motions = [view.state] if view.reference is None else [view.state, view.reference]
    states_of_frames = np.concatenate([states[ticks, : view.arms] for states in motions])
    heights = arm_points(states_of_frames[np.isfinite(states_of_frames).all(axis=1)], view.arm_lengths)[..., 1]
    low = float(heights.min(initial=-0.2 * reach)) - 0.62 * reach
    high = float(heights.max(initial=0.1 * reach)) + 0.1 * reach
    left, right = -0.53 * _FRAME_STEP * reach, (len(times) - 0.47) * _FRAME_STEP * reach
    draw_film = partial(_draw_film, view=view, times=times, rows=rows, box=((left, right), (low, high)))
    page.row(draw_film, height=page.width * (high - low) / (right - left))


def film_times(view: RunView, *, frames: int) -> Array:
    """Return (frames,) times in s for a filmstrip, about the symbols' crossings, otherwise evenly.

    On either side of a crossing they span a third of the period of a simple pendulum as long as all arms. A run that
    failed has one crossing more, as long before its end, so that frames show how it ended.

    Args:
        view: motion in the film.
        frames: number of frames.
    """
    begin, end = view.time_range
    half_span = 0.33 * 2 * np.pi * np.sqrt(sum(view.arm_lengths) / 9.81)
    crossings = [done or planned for _, planned, done in view.symbols if begin <= (done or planned) <= end]
    if view.good is False:
        crossings.append(end - half_span)
    if not crossings:
        return np.linspace(begin, end, frames)
    centres = np.array(crossings)[np.linspace(0, len(crossings) - 1, min(len(crossings), frames)).astype(int)]
    frame_counts = [len(cluster) for cluster in np.array_split(np.arange(frames), len(centres))]
    clusters = [
        centre + half_span * np.linspace(-1, 1, count + 2)[1:-1]
        for centre, count in zip(centres, frame_counts, strict=True)
    ]
    return np.sort(np.clip(np.concatenate(clusters), begin, end))


RATE = 25
"""Frames per second."""
_INCHES, _HIGHEST = 7.2, 4.8
"""Width of a film, and greatest height of the pendulum's view."""
_PIXELS = 100
"""Pixels per inch."""
_TRACK = "#dfe3e7"
"""Colour of the cart's track."""
_FILMED_TRACE = 0.9
"""Duration of the visible tip path, s."""
_COLOURS = 96
"""Number of colours of a GIF."""
_SECONDS = 0.03
"""Time to draw and write a frame, s."""


class Film:
    """A motion between two times in s, as frames, which are pictures of the arms above the story of the run.

    Attributes:
        times: times (K,) of the frames, s.
        rows: tick (K,) of each frame; -1 without a pose, or in a gap of more than two frames or ticks.
        scene: axes of the pendulum.
    """

    def __init__(self, view: RunView, stretch: Range) -> None:
        self.view, self.pivots = view, view.pivot
        self.times: Array = np.arange(stretch[0], stretch[1] + 0.5 / RATE, 1 / RATE)
        # A tick at the time of a frame must not be missed by rounding.
        rows = np.searchsorted(view.time, self.times - 1e-9).clip(0, len(view.time) - 1)
        has_tick = np.abs(view.time[rows] - self.times) <= 2 / min(RATE, view.rate_hz)
        posed = np.isfinite(view.state[rows, : view.arms]).all(axis=1) & np.isfinite(self.pivots[rows])
        self.rows: NDArray[np.int64] = np.where(has_tick & posed, rows, -1)
        page = Page("", width=_INCHES).text(view.title, colour=style.INK, size=style.VERDICT)
        (left, right), (low, high) = box = self._box()
        page.row(partial(self._draw_scene, box=box), height=_INCHES * (high - low) / (right - left))
        add_story(page, view, span=stretch)
        figure = page.figure()
        figure.set_dpi(_PIXELS)
        # The picture without moving parts is drawn once, kept as pixels, and restored for each frame.
        self._canvas: Any = figure.canvas
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)
        self.scene, *self._stories = figure.axes
        self.scene.autoscale(False)
        # Artists that each frame must not draw again, since they are in the still picture.
        self._static = {artist for axes in figure.axes for artist in axes.get_children()}

    def _box(self) -> tuple[Range, Range]:
        """Return the ranges (x, y) of the pendulum's view, m, which hold all places of the cart and the arms.

        The picture is as large as the greatest height of the view allows.
        """
        view, reach, rows = self.view, 1.12 * sum(self.view.arm_lengths), self.rows[self.rows >= 0]
        pivots = self.pivots[rows] if rows.size else np.zeros(1)
        heights = arm_points(view.state[rows, : view.arms], view.arm_lengths)[..., 1]
        low, high = float(heights.min(initial=0.0)) - 0.12 * reach, float(heights.max(initial=0.0)) + 0.12 * reach
        middle = float(pivots.min() + pivots.max()) / 2
        half = max(float(np.ptp(pivots)) / 2 + reach, (high - low) * _INCHES / _HIGHEST / 2)
        return (middle - half, middle + half), (low, high)

    def _draw_scene(self, axes: Axes, box: tuple[Range, Range]) -> None:
        """Draw the parts of the pendulum's view that do not move: its ranges, the track, the cart's limits and the key.

        Args:
            axes: panel of the pendulum.
            box: ranges of x and y, m.
        """
        view, reach = self.view, sum(self.view.arm_lengths)
        axes.set_aspect("equal", adjustable="datalim")
        axes.axis("off")
        entries: list[tuple[str, str | dict[str, Any]]] = []
        if view.reference is not None:
            entries.append((view.against, {"color": style.REFERENCE, "linewidth": 5, "solid_capstyle": "round"}))
        if view.has_cart:
            axes.axhline(0.0, color=_TRACK, linewidth=3.0)
        if view.has_cart and view.limits is not None:
            look = {"color": style.LIMIT, "linewidth": 1.5}
            axes.vlines([-view.limits[0], view.limits[0]], -0.08 * reach, 0.08 * reach, **look)
            entries.append(("the cart's limit", look))
        key(axes, entries)
        axes.set_xlim(*box[0])
        # The aspect may extend this range.
        axes.set_ylim(*box[1], auto=True)

    def frame(self, number: int) -> Image.Image:
        """Return a frame: the still picture with the arms, the time, the last symbol and the cursors in the story.

        Args:
            number: number of the frame, counted from zero.
        """
        view, scene, time, row = self.view, self.scene, float(self.times[number]), int(self.rows[number])
        self._canvas.restore_region(self._still)
        look: dict[str, Any] = {"transform": scene.transAxes, "fontsize": style.SMALL}
        scene.text(0.0, 1.01, f"{time:.2f} s", color=style.INK, va="bottom", **look)
        # A symbol counts from its crossing, or without one from its planned time.
        symbols_so_far = [
            f"{k + 1}: {name}" for k, (name, planned, done) in enumerate(view.symbols) if (done or planned) <= time
        ]
        scene.text(0.0, 0.99, symbols_so_far[-1] if symbols_so_far else "", color=style.NOTE, va="top", **look)
        if row < 0:
            scene.text(0.5, 0.5, "no data", color=style.MARK, ha="center", **look)
        else:
            # The path of the tip begins no earlier than the last gap in the ticks.
            first_row = int(np.searchsorted(view.time, view.time[row] - _FILMED_TRACE))
            first_row = max(first_row, int(view.breaks[view.breaks <= row].max(initial=0)))
            points_per_metre = float(np.ptp(scene.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0])) * 72 / _PIXELS
            width = 0.055 * sum(view.arm_lengths) * points_per_metre
            draw_pose(scene, view, (first_row, row), at=float(self.pivots[row]), thick=width)
        for axes in self._stories:
            axes.axvline(time, color=style.LIMIT, linewidth=1.4)
        # Only the moving artists are drawn, over the still picture, and then removed for the next frame.
        for axes in (scene, *self._stories):
            moving = [artist for artist in axes.get_children() if artist not in self._static]
            for artist in sorted(moving, key=lambda artist: artist.get_zorder()):
                axes.draw_artist(artist)
                artist.remove()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())[..., :3].copy())

    def frames(self, progress: Progress = no_progress) -> Iterator[Image.Image]:
        """Yield the frames of the film in order, as the writers of all formats take them.

        Args:
            progress: called with a label and the completed share.
        """
        for k in range(len(self.times)):
            progress("film", k / len(self.times))
            yield self.frame(k)


def write_film(
    view: Any,
    file: Path | str,
    *,
    stretch: Range | None = None,
    yes: bool = False,
    progress: Progress = no_progress,
) -> Path:
    """Write a film in real time, 25 frames per second.

    The suffix selects GIF, WebP or (with imageio-ffmpeg) MP4. The same view gives the same bytes.

    Args:
        view: `RunView` of a run, recording, reference or orbit.
        file: the film.
        stretch: time range in s; all by default.
        yes: accept any duration of the writing.
        progress: called with a label and the completed share.

    Raises:
        InputError: the suffix is unknown, the file cannot be written, the motion has no arms, the range lies outside
            the motion or has no angles, or writing would take too long.
        PartMissing: imageio-ffmpeg is missing.
    """
    file = Path(file)
    kind = file.suffix.lower()
    if kind not in _WRITERS:
        raise InputError(f"{file}: a film is a .gif, .webp or .mp4 file; choose a name that ends so")
    if not isinstance(view, RunView):
        raise InputError(f"{file}: a film shows one motion; give one log, recording, reference or walk")
    if not view.arm_lengths:
        raise InputError(f"{file}: a film shows arms, and this system has none; use --picture")
    begin, end = view.time_range
    film_start, film_end = (begin, end) if stretch is None else (stretch[0], min(stretch[1], end))
    if not begin <= film_start < film_end:
        raise InputError(
            f"--stretch {film_start:g} {film_end:g}: must be a part of the motion, {begin:.2f} to {end:.2f} s"
        )
    film = Film(view, (film_start, film_end))
    count = len(film.times)
    if count < 2 or (film.rows < 0).all():
        raise InputError(
            f"{file}: the motion from {film_start:g} to {film_end:g} s has no angles, or is shorter than a frame"
        )
    # A GIF keeps every frame in memory until its end.
    memory = 3e8 + count * film.frame(0).width * film.frame(0).height * (kind == ".gif")
    name = f"--film {file.name} of {film_end - film_start:.0f} s (--stretch takes a part)"
    announce(Cost(f"{count:,} frames", _SECONDS * count, memory, name), yes=yes)
    with whole_file(file, suffix=kind) as temporary:
        _WRITERS[kind](film, temporary, progress)
    return file


def _write_gif(film: Film, file: Path, progress: Progress) -> None:
    """Write a film as GIF, with one palette for all frames."""
    # One palette serves all frames: colours do not flicker, and static parts are stored once.
    samples = [np.asarray(film.frame(k)) for k in np.linspace(0, len(film.times) - 1, 4).astype(int)]
    palette = Image.fromarray(np.concatenate(samples)).quantize(_COLOURS, method=Image.Quantize.FASTOCTREE)
    frames = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in film.frames(progress))
    next(frames).save(file, save_all=True, append_images=frames, duration=1000 // RATE, loop=0, optimize=False)


def _write_webp(film: Film, file: Path, progress: Progress) -> None:
    """Write a film as WebP, frame by frame."""
    frames = film.frames(progress)
    next(frames).save(file, save_all=True, append_images=frames, duration=1000 // RATE, loop=0, quality=70, method=2)


def _write_mp4(film: Film, file: Path, progress: Progress) -> None:
    """Write a film as MP4 in H.264 through the ffmpeg of the package imageio-ffmpeg."""
    # Time and program are omitted, so that the same film has the same bytes. H.264 requires even sizes.
    parameters = ["-crf", "20", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1", "-threads", "1"]
    options = {"fps": RATE, "codec": "libx264", "quality": None, "macro_block_size": 2, "output_params": parameters}
    writer = part("imageio_ffmpeg").write_frames(str(file), film.frame(0).size, **options)
    # The writer is a generator: the first call starts it, each further one adds a frame.
    writer.send(None)
    for frame in film.frames(progress):
        writer.send(frame.tobytes())
    writer.close()


_WRITERS = {".gif": _write_gif, ".webp": _write_webp, ".mp4": _write_mp4}


_NAMES = 0.65
"""Width of the names beside the pictures, inches."""
_POSES, _FAINTEST = 9, 0.12
"""Number of drawn poses of the arms, and opacity of the first."""


def draw_transitions(reference: Reference) -> Figure:
    """Draw each transfer once, in the cell of its two equilibria, as a table of pictures on a page.

    Raises:
        InputError: the reference has no plan, or no transfers between equilibria.
    """
    content, view = reference.content, reference_view(reference, Path())
    transfers: dict[tuple[str, str], Range] = {}
    # Number of the symbol, and number of the transfer that is this symbol's motion.
    for k, index in content.transitions():
        symbol, (begin, end) = content.symbols[k], content.transfers[index]
        transfers[symbol.source, symbol.target] = begin, end
        # On the diagonal each equilibrium is drawn at one instant of a transfer.
        transfers[symbol.source, symbol.source] = begin, begin
        transfers[symbol.target, symbol.target] = end, end
    if not transfers:
        raise InputError(
            f"{content.itinerary} has no transfers from one equilibrium to another to draw; "
            "plan an itinerary of holds, such as twelve"
        )
    names = [name for name in sorted(content.saddles) if (name, name) in transfers]
    travel = max(float(np.abs(_ways(view, transfer)[1]).max()) for transfer in transfers.values())
    height = 1.12 * sum(view.arm_lengths)
    box, cell = (height + travel, height), (style.WIDTH - _NAMES) / len(names)
    page = Page(
        content.title,
        "From each row's equilibrium to each column's: the arms at equal times, later ones darker, with the tip's "
        "path. Below each picture: duration, and the cart's greatest distance from its start in the middle.",
    )
    for source in names:
        cells = [
            partial(
                _cell,
                view=view,
                transfer=transfers.get((source, target)),
                box=box,
                title=target if source == names[0] else "",
                name=source if target == names[0] else "",
            )
            for target in names
        ]
        page.row(*cells, height=cell * box[1] / box[0] + 0.3 + 0.2 * (source == names[0]))
    return page.figure()


def _ways(view: RunView, transfer: Range) -> tuple[list[int], np.ndarray]:
    """Return the ticks of a transfer, and the cart's distances from its start at these ticks, m.

    Args:
        view: reference with the transfer.
        transfer: start and end of the transfer, s.
    """
    first_row, last_row = np.searchsorted(view.time, transfer).clip(0, len(view.time) - 1)
    rows = np.arange(first_row, last_row + 1)
    return rows.tolist(), view.pivot[rows] - view.pivot[first_row]


def _cell(axes: Axes, view: RunView, transfer: Range | None, box: Range, *, title: str, name: str) -> None:
    """Draw one transfer in its cell: the arms at equal times, with its duration and the cart's greatest distance.

    Args:
        axes: panel of the cell.
        view: reference with the transfer.
        transfer: start and end, s, which are equal for an equilibrium. None leaves the cell empty.
        box: half the width and half the height of the cell, m.
        title: name of the target above the first row, "" elsewhere.
        name: name of the source beside the first column, "" elsewhere.
    """
    half_width, half_height = box
    axes.set(xlim=(-half_width, half_width), ylim=(-half_height, half_height), xticks=[], yticks=[], aspect="equal")
    axes.spines[:].set_visible(True)
    axes.grid(False)
    axes.set_title(title, loc="center")
    words = name.split("-")
    # Names of equal width keep the columns below one another.
    missing_width = text_width("down", style.HEAD) - max(text_width(word, style.HEAD) for word in words)
    look: dict[str, Any] = {
        "rotation": 0,
        "ha": "right",
        "va": "center",
        "labelpad": 4 + 72 * missing_width * bool(name),
    }
    axes.set_ylabel("\n".join(words), fontsize=style.HEAD, color=style.INK, **look)
    if transfer is None:
        return
    rows, cart = _ways(view, transfer)
    axes.axhline(0.0, color=style.GRID, linewidth=1.0, zorder=0)
    for share in np.linspace(0, 1, _POSES) if len(rows) > 1 else (1.0,):
        k, shade = round(share * (len(rows) - 1)), _FAINTEST + (1 - _FAINTEST) * share**2
        # The last pose has the whole path of the tip.
        draw_pose(axes, view, (rows[0 if share == 1 else k], rows[k]), at=cart[k], thick=1.5, shade=shade)
    if len(rows) > 1:
        text = f"{transfer[1] - transfer[0]:.3g} s, {100 * np.abs(cart).max():.0f} cm"
        axes.set_xlabel(text, fontsize=style.SMALL, color=style.NOTE, labelpad=2)
    else:
        axes.set_facecolor("#f4f6f8")
