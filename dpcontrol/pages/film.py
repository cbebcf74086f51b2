"""A film of a motion: the arms over the itinerary.

The motion is a run, a recording, a reference or an orbit. The arms move on their cart, in real time.

Static parts (title, track, limits, the story over time) are drawn once by matplotlib as on a page. Moving parts are
drawn over them for each frame by Pillow: the reference's ghost, the tip's path, cart, arms, and a cursor in the story.
"""

import errno
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.layout import Page, cropped, key
from dpcontrol.pages.planes import arm_points
from dpcontrol.pages.ranges import Range
from dpcontrol.pages.story import story, story_height, story_rows

Point = tuple[float, float]

RATE = 25
"""Frames per second."""
_INCHES, _SCENE = 7.2, 3.7
"""Width of a film, and height of the pendulum's view."""
_PIXELS = 100
"""Pixels per inch; frames are drawn at twice the size and halved to smooth their lines."""
_FINE = 2
_HEAD = 0.42
_GHOST, _TRACK = style.REFERENCE, "#dfe3e7"
_TRACE, _PIECES = 0.9, 12
"""Duration of the visible tip path, s, and number of shades as it fades."""
_COLOURS = 96
_SECONDS = {".gif": 0.03, ".webp": 0.05, ".mp4": 0.03}
"""Time to draw and write a frame, s; a GIF also keeps every frame in memory until its end."""


@dataclass(frozen=True, eq=False)
class Film:
    """Content of a film: a view and a time range in s."""

    view: RunView
    stretch: Range

    @property
    def times(self) -> Array:
        """(K,) in s of the frames."""
        first, last = self.stretch
        return np.arange(first, last + 0.5 / RATE, 1 / RATE)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """(K,) tick of each frame, or -1.

        Frames without a pose, or in a gap of more than two frames or ticks, have -1.
        """
        time = self.view.time
        rows = np.searchsorted(time, self.times - 1e-9).clip(0, len(time) - 1)
        near = np.abs(time[rows] - self.times) <= 2 / min(RATE, self.view.rate_hz)
        posed = np.isfinite(self.view.state[rows, : self.view.arms]).all(axis=1) & np.isfinite(self.pivots[rows])
        return np.where(near & posed, rows, -1)

    @cached_property
    def pivots(self) -> Array:
        """(N,) position of the pivot at each tick, m."""
        return self.view.pivot

    @cached_property
    def still(self) -> tuple[Image.Image, Axes, Axes | None]:
        """Static image at twice the size, with its axes.

        The axes are those of the pendulum and of the story, if any.
        """
        view, strips = self.view, story_rows(self.view)
        page = Page("", width=_INCHES)
        page.text(cropped(view.title, style.VERDICT, _INCHES - 1.4), colour=style.INK, size=style.VERDICT)
        page.strip(self._draw_scene, height=_SCENE)
        if strips:
            strip = partial(story, view=view, span=self.stretch, width=_INCHES)
            page.strip(strip, height=story_height(view, span=self.stretch))
        figure = page.figure()
        figure.set_dpi(_FINE * _PIXELS)
        image = _image(figure)
        scene, *others = figure.axes
        return image, scene, others[0] if others else None

    def _extent(self) -> tuple[Range, Range]:
        """Return the range of a film's moving parts, m.

        The range is the range of arms, ghost and cart along x and y.
        """
        view, reach = self.view, sum(self.view.arm_lengths)
        rows, cart = self.rows[self.rows >= 0], 0.16 * reach
        spots = [np.array([(middle + side, 0.0) for middle in self.pivots[rows] for side in (-cart, cart)])]
        for states in (view.state, view.reference):
            if states is not None:
                points = arm_points(states[rows, : view.arms], view.arm_lengths)
                points[..., 0] += self.pivots[rows, None]
                spots.append(points)
        places = np.concatenate([np.zeros((1, 2)), *(spot.reshape(-1, 2) for spot in spots)])
        places = places[np.isfinite(places).all(axis=1)]
        (left, low), (right, high) = places.min(axis=0), places.max(axis=0)
        edge = 0.12 * reach
        return (float(left - edge), float(right + edge)), (float(low - edge), float(high + edge))

    def _draw_scene(self, axes: Axes) -> None:
        view, reach = self.view, sum(self.view.arm_lengths)
        (left, right), (low, high) = self._extent()
        half = max((right - left) / _INCHES, (high - low) / _SCENE, 0.8 * reach / _SCENE) / 2
        middle, level = (left + right) / 2, (low + high) / 2
        axes.set_aspect("equal", adjustable="datalim")
        axes.axis("off")
        entries: list[tuple[str, str | dict[str, Any]]] = []
        if view.reference is not None:
            entries.append((view.against, {"color": _GHOST, "linewidth": 5, "solid_capstyle": "round"}))
        if view.has_cart:
            axes.axhline(0.0, color=_TRACK, linewidth=3.0)
            most = np.inf if view.limits is None else view.limits[0]
            within = [at for at in (-most, most) if abs(at - middle) < half * _INCHES]
            for at in within:
                axes.plot([at, at], [-0.09 * reach, 0.09 * reach], color=style.LIMIT, linewidth=1.5)
            if within:
                entries.append(("the cart's limit", {"color": style.LIMIT, "linewidth": 1.5}))
        if entries:
            key(axes, entries)
        axes.set_xlim(middle - half * _INCHES, middle + half * _INCHES)
        # The aspect may extend this range.
        axes.set_ylim(level - half * _SCENE, level + half * _SCENE, auto=True)

    def frame(self, number: int) -> Image.Image:
        """Return a frame, counted from zero."""
        still, scene, strip_axes = self.still
        view, reach = self.view, sum(self.view.arm_lengths)
        time, row = float(self.times[number]), int(self.rows[number])
        frame = still.copy()
        draw = ImageDraw.Draw(frame)
        # The time stands beside the title, and the last symbol below the key.
        right, inch = 0.98 * frame.width, _FINE * _PIXELS
        draw.text((right, 0.07 * inch), f"{time:.2f} s", fill=style.INK, font=_font(), anchor="rt")
        past = [f"{k + 1}: {name}" for k, (name, at, done) in enumerate(view.symbols) if (done or at) <= time]
        if past:
            draw.text((right, (_HEAD + 0.12) * inch), past[-1], fill=style.NOTE, font=_font(), anchor="rt")
        if strip_axes is not None:
            draw.line(
                _placed(frame, strip_axes, [time, time], strip_axes.get_ylim()), fill=style.LIMIT, width=2 * _FINE
            )
        if row < 0:
            middle = _placed(frame, scene, [np.mean(scene.get_xlim())], [np.mean(scene.get_ylim())])[0]
            draw.text(middle, "no data", fill=style.MARK, font=_font(), anchor="mm")
            return frame.reduce(_FINE)
        at = self.pivots[row]
        unit = float(np.ptp(scene.transData.transform([(0.0, 0.0), (1.0, 0.0)])[:, 0]))
        thick = 0.055 * reach * unit

        def joints(states: Array, pivot: float) -> list[Point]:
            points = arm_points(states[row : row + 1, : view.arms], view.arm_lengths)[0]
            return _placed(frame, scene, points[:, 0] + pivot, points[:, 1])

        if view.reference is not None and np.isfinite(view.reference[row, : view.arms]).all():
            there = view.reference[row, 2 * view.arms] if view.has_cart else 0.0
            _bar(draw, joints(view.reference, there if np.isfinite(there) else at), _GHOST, 1.7 * thick)
        self._draw_trace(frame, draw, row)
        if view.has_cart:
            (left, upper), (right, lower) = _placed(
                frame, scene, [at - 0.14 * reach, at + 0.14 * reach], [0.05 * reach, -0.05 * reach]
            )
            draw.rounded_rectangle((left, upper, right, lower), radius=0.02 * reach * unit, fill=style.CART)
        places = joints(view.state, at)
        for arm in range(view.arms):
            _bar(draw, places[arm : arm + 2], style.arm_colour(arm), thick)
        for place in places[:-1]:
            _disc(draw, place, style.INK, 0.42 * thick)
        _disc(draw, places[-1], style.arm_colour(view.arms - 1), 0.95 * thick)
        return frame.reduce(_FINE)

    def _draw_trace(self, frame: Image.Image, draw: ImageDraw.ImageDraw, row: int) -> None:
        """Draw the tip's path up to a tick, fading with age."""
        view = self.view
        first = int(np.searchsorted(view.time, view.time[row] - _TRACE))
        if len(view.breaks):
            first = max(first, int(view.breaks[view.breaks <= row].max(initial=0)))
        ticks = np.unique(np.linspace(first, row, 10 * _PIECES).round().astype(int))
        tips = arm_points(view.state[ticks, : view.arms], view.arm_lengths)[:, -1]
        points = _placed(frame, self.still[1], tips[:, 0] + self.pivots[ticks], tips[:, 1])
        colour = np.array(style.rgb(style.arm_colour(view.arms - 1)))
        for piece in range(_PIECES):
            begin, end = (len(points) * k // _PIECES for k in (piece, piece + 1))
            part = points[begin : end + 1]
            if len(part) > 1 and np.isfinite(part).all():
                share = 0.55 * (piece + 1) / _PIECES
                faded = tuple(round(float(c)) for c in 255 + share * (colour - 255))
                draw.line(part, fill=faded, width=_FINE * 2, joint="curve")


@cache
def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(findfont(FontProperties(family="DejaVu Sans")), round(_FINE * _PIXELS * style.SMALL / 72))


def _placed(frame: Image.Image, axes: Axes, x: Any, y: Any) -> list[Point]:
    """Return positions on axes as pixels of a frame.

    Pixels are counted from its upper left corner.
    """
    points = axes.transData.transform(np.column_stack([x, y]))
    return [(float(px), frame.height - float(py)) for px, py in points]


def _image(figure: Figure) -> Image.Image:
    figure.canvas.draw()
    return Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())  # type: ignore[attr-defined]


def _bar(draw: ImageDraw.ImageDraw, points: list[Point], colour: str, thick: float) -> None:
    """Draw a bar with round ends and joints."""
    draw.line(points, fill=colour, width=round(thick))
    for point in points:
        _disc(draw, point, colour, thick / 2)


def _disc(draw: ImageDraw.ImageDraw, at: Point, colour: str, radius: float) -> None:
    draw.ellipse((at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius), fill=colour)


def write_film(
    view: RunView,
    file: Path | str,
    *,
    stretch: Range | None = None,
    yes: bool = False,
    progress: Progress = no_progress,
) -> Path:
    """Write a film in real time, 25 frames per second.

    The suffix selects GIF, WebP or (with imageio-ffmpeg) MP4.

    The same view gives the same bytes.

    Args:
        view: run, recording, reference or orbit to show.
        file: the film.
        stretch: time range in s; all by default.
        yes: accept any duration of the writing.
        progress: called with a label and the completed share.

    Raises:
        InputError: the suffix is unknown, the file cannot be written, the motion has no arms, the range lies outside
            the motion or has no angles, writing would take too long, or imageio-ffmpeg is missing.
    """
    file = Path(file)
    kind = file.suffix.lower()
    if kind not in _WRITERS:
        raise InputError(f"{file}: a film is a .gif, .webp or .mp4 file; choose a name that ends so")
    if not view.arm_lengths:
        raise InputError(f"{file}: a film shows arms, and this system has none; use --picture")
    begin, end = view.time_range
    first, last = (begin, end) if stretch is None else stretch
    if not begin <= first < last or first >= end:
        raise InputError(
            f"--stretch {first:g} {last:g}: no stretch of the motion, which lasts from {begin:.2f} to {end:.2f} s; "
            "give a begin and a later end within it"
        )
    last = min(last, end)
    film = Film(view, (first, last))
    count = len(film.times)
    if count < 2 or (film.rows < 0).all():
        why = "holds no angles" if count > 1 else f"is shorter than the {1 / RATE:g} s of a frame"
        raise InputError(f"{file}: the motion from {first:g} to {last:g} s {why}; film another log or stretch")
    size = _INCHES * (_HEAD + _SCENE + 1.2) * _PIXELS**2
    memory = 3e8 + count * size * (kind == ".gif")
    key = f"--film {file.name} of {last - first:.0f} s (--stretch takes a part)"
    announce(Cost(f"{count:,} frames", _SECONDS[kind] * count, memory, key), yes=yes)

    with whole_file(file, suffix=kind) as temporary:
        _WRITERS[kind](film, temporary, progress)
    return file


def _shown(film: Film, progress: Progress) -> Iterator[Image.Image]:
    count = len(film.times)
    for k in range(count):
        progress("film", k / count)
        yield film.frame(k)


def _write_gif(film: Film, file: Path, progress: Progress) -> None:
    # One palette serves all frames: colours do not flicker, and static parts are stored once.
    samples = [film.frame(k) for k in np.linspace(0, len(film.times) - 1, 4).astype(int)]
    sheet = Image.fromarray(np.concatenate([np.asarray(sample) for sample in samples]))
    palette = sheet.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in _shown(film, progress))
    first.save(file, save_all=True, append_images=rest, duration=1000 // RATE, loop=0, optimize=False)


def _write_webp(film: Film, file: Path, progress: Progress) -> None:
    frames = _shown(film, progress)
    next(frames).save(file, save_all=True, append_images=frames, duration=1000 // RATE, loop=0, quality=70, method=2)


def _write_mp4(film: Film, file: Path, progress: Progress) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError(
            f"{file.suffix} needs imageio-ffmpeg: pip install 'dpcontrol[film]', or choose .gif or .webp"
        ) from error
    # H.264 requires even sizes. Time and program are omitted, so that the same film has the same bytes.
    width, height = (length // 2 * 2 for length in film.frame(0).size)
    exact = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1", "-threads", "1"]
    writer = imageio_ffmpeg.write_frames(
        str(file), (width, height), fps=RATE, codec="libx264", quality=8, macro_block_size=2, output_params=exact
    )
    writer.send(None)
    try:
        for frame in _shown(film, progress):
            writer.send(frame.crop((0, 0, width, height)).tobytes())
    except OSError:
        # ffmpeg has ended, as its frame count below shows; the error repeats all of its output.
        pass
    finally:
        writer.close()
    # The exit code of ffmpeg is not available.
    count = 0
    with suppress(RuntimeError, OSError):
        count = imageio_ffmpeg.count_frames_and_secs(str(file))[0] or 0
    if count < len(film.times):
        raise OSError(errno.EIO, f"ffmpeg wrote {count} of {len(film.times)} frames, as on a full disk")


_WRITERS = {".gif": _write_gif, ".webp": _write_webp, ".mp4": _write_mp4}
