"""An orbit that follows a walk, on one page: its symbols over time, the arms as a filmstrip, the orbit in space."""

from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dpcontrol.review import film, panels, story_panels, style, walk_space
from dpcontrol.review.motion import RunView
from dpcontrol.review.panel_frame import badge, mark_times, new_figure
from dpcontrol.review.walk_story import WalkStory, symbol_words
from dpcontrol.walks.shadowing import ShadowingOrbit

_WIDTH = 16.0
_HEAD, _STRIP = 0.85, 0.95  # inches above the film: title, and symbols over time
_BODY = 6.6  # inches below the film at least
_SPACE = 4.5  # inches for the orbit in space at least
_LINE = 0.19  # inches of the list's lines
_LISTED = 16  # symbols in the list; beyond that the numbers over time must do
FILM_SYMBOLS = 48


def draw_walk(orbit: ShadowingOrbit, *, arm_lengths: tuple[float, ...] | None, model: str) -> Figure:
    """Return the page as a figure; arm_lengths (n,) in m, None for a system without arms, which has no film."""
    story = WalkStory(orbit, arm_lengths)
    view = story.view(model)
    filmed = [] if arm_lengths is None else _film_rows(story, view)
    listed = 0.35 + _LINE * (min(len(view.symbols), _LISTED) + 1)
    body = max(_BODY, listed + _SPACE)
    height = _HEAD + _STRIP + sum(tall for _, _, tall in filmed) + body
    figure = new_figure(_WIDTH, height)
    figure.text(0.022, 1 - 0.32 / height, view.title, fontsize=17, weight="bold", color=style.INK, va="center")
    verdict = "\n".join(wrap(view.verdict, 200, max_lines=2, placeholder=" …"))
    figure.text(0.022, 1 - 0.68 / height, verdict, fontsize=9.5, color=style.NOTE, va="center")
    story_panels.story(figure.add_axes((0.062, 1 - (_HEAD + 0.42) / height, 0.925, 0.2 / height)), view)
    top = height - _HEAD - _STRIP
    for first, times, tall in filmed:
        axes = figure.add_axes((0.01, (top - tall) / height, 0.98, tall / height))
        film.draw_film(axes, view, frames=times.size, times=times.ravel())
        for k in range(len(times)):
            badge(axes, first + k + 1, film.frame_place(view, k * times.shape[1]) - 0.3 * sum(view.arm_lengths),
                  axes.get_ylim()[1])  # fmt: skip
        top -= tall
    share = body / height

    def box(left: float, bottom: float, width: float, tall: float) -> tuple[float, float, float, float]:
        return left, bottom * share, width, tall * share

    for chart, bottom in ((story.coordinates(), 0.54), (story.nearness(), 0.075)):
        axes = figure.add_axes(box(0.045, bottom, 0.555, 0.38))
        panels.draw_chart(axes, chart, view)
        axes.set_xlim(0.0, orbit.duration)
        axes.set_xlabel("time (s)" if story.has_angles else "time", fontsize=8.5, color=style.NOTE, labelpad=1)
        mark_times(axes, list(orbit.symbol_times))
    tall = listed / body
    if arm_lengths is None:
        rest = (0.97 - tall) / 2
        walk_space.space(figure.add_axes(box(0.63, tall + rest, 0.36, rest), projection="3d"), story)
        walk_space.plane(figure.add_axes(box(0.66, tall + 0.06, 0.32, rest - 0.12)), story)
    else:
        walk_space.space(figure.add_axes(box(0.62, tall, 0.38, 0.97 - tall), projection="3d"), story)
    _list(figure.add_axes(box(0.622, 0.02, 0.37, tall - 0.03)), story, view)
    return figure


def film_shape(count: int) -> tuple[int, int, int]:
    """Return (rows, symbols in a row, poses of a symbol) of the film of so many symbols."""
    count = min(count, FILM_SYMBOLS)
    poses = 9 if count == 1 else 7 if count == 2 else 5 if count <= 6 else 3 if count <= 16 else 1
    rows = int(np.ceil(count * poses / 18))
    return rows, int(np.ceil(count / rows)), poses


def _film_rows(story: WalkStory, view: RunView) -> list[tuple[int, NDArray[np.float64], float]]:
    """Return the film's rows: the first symbol's index, instants (symbols, poses) in s about each, and inches."""
    orbit = story.orbit
    _, across, poses = film_shape(len(orbit.symbol_times))
    share = np.linspace(-0.55, 0.55, poses) if poses > 1 else np.zeros(1)
    spans = np.array([[c.time_in if s > 0 else c.time_out for s in share] for c in orbit.connections])
    every = (orbit.symbol_times[:, None] + share * spans)[:FILM_SYMBOLS]
    rows = []
    for first in range(0, len(every), across):
        times = every[first : first + across]
        horizontal, vertical = film.film_extent(view, frames=across * poses, times=times.ravel())
        tall = 0.98 * _WIDTH * (vertical[1] - vertical[0]) / (horizontal[1] - horizontal[0])
        rows.append((first, times, tall + 0.1))
    return rows


def _list(axes: Axes, story: WalkStory, view: RunView) -> None:
    """Write what each symbol is, and its connection's name."""
    axes.axis("off")
    chain = story.orbit.connections
    shown = len(chain) if len(chain) <= _LISTED else _LISTED - 1
    rows = min(len(chain), _LISTED) + 1
    y = [1 - (k + 0.5) / rows for k in range(rows)]
    columns = {"symbol": 0.05, "at (s)" if story.has_angles else "at": 0.475, "connection": 0.57}
    look: dict[str, Any] = {"color": style.INK, "va": "center_baseline"}
    for text, place in columns.items():
        axes.text(place, y[0], text, fontsize=9, weight="bold", **look)
    for k, (connection, (_, at, _)) in enumerate(zip(chain[:shown], view.symbols[:shown], strict=True)):
        badge(axes, k + 1, 0.02, y[k + 1], size=6.5)
        words = (symbol_words(connection), f"{at:.3f}", connection.name)
        for place, text, size in zip(columns.values(), words, (8.2, 8.2, 7.4), strict=True):
            axes.text(place, y[k + 1], text, fontsize=size, **look)
    if shown < len(chain):
        axes.text(0.05, y[-1], f"… and {len(chain) - shown} more", fontsize=8.2, **look)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
