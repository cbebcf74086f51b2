"""An orbit that follows a walk, on one page: its symbols over time, the arms as a filmstrip, the orbit in space."""

from textwrap import wrap

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpcontrol.review import style, walk_panels, walk_space
from dpcontrol.review.panel_frame import badge, new_figure
from dpcontrol.review.walk_story import WalkStory, symbol_words
from dpcontrol.walks.shadowing import ShadowingOrbit

_WIDTH = 16.0
_BODY = 7.6  # inches below the film at least
_SPACE = 4.5  # inches for the orbit in space at least
_LINE = 0.19  # inches of the list's lines
_HEAD = 0.85
_LISTED = 16  # symbols in the list; beyond that the numbers over time must do


def draw_walk(orbit: ShadowingOrbit, *, arm_lengths: tuple[float, ...] | None, model: str) -> Figure:
    """Return the page as a figure; arm_lengths (n,) in m, None for a system without arms, which has no film."""
    story = WalkStory(orbit, arm_lengths)
    film = 0.0 if arm_lengths is None else _film_height(story)
    count = len(orbit.symbol_times)
    listed = 0.35 + _LINE * (min(count, _LISTED) + 1)
    body = max(_BODY, listed + _SPACE)
    height = _HEAD + film + body
    kind = "A periodic orbit" if orbit.periodic else "An orbit"
    unit = " J" if story.has_angles else ""
    energy = orbit.connections[0].source.energy
    title = f"{kind} of {model} at {energy:g}{unit} that follows {count} symbol{'s' if count > 1 else ''}"
    figure = new_figure(_WIDTH, height, title)
    figure.suptitle(title, x=0.015, y=1 - 0.14 / height, ha="left", va="top", fontsize=16, weight="bold",
                    color=style.INK)  # fmt: skip
    figure.text(0.0155, 1 - 0.52 / height, _verdict(story), fontsize=9.5, color=style.NOTE, va="top")
    if film:
        about = "the arms at some instants of each symbol (s); thin: the tip's path since the instant before"
        figure.text(0.985, 1 - 0.22 / height, about, fontsize=8.5, color=style.MARK, ha="right", va="top")
        walk_panels.film(figure.add_axes((0.01, body / height, 0.98, film / height)), story)
    share = body / height

    def box(left: float, bottom: float, width: float, tall: float) -> tuple[float, float, float, float]:
        return left, bottom * share, width, tall * share

    wide = 0.555
    axes = figure.add_axes(box(0.04, 0.815, wide, 0.075))
    walk_panels.timeline(axes, story)
    lower: list[Axes] = []
    for panel, bottom, tall in ((walk_panels.coordinates, 0.445, 0.31), (walk_panels.distances, 0.065, 0.325)):
        lower.append(figure.add_axes(box(0.04, bottom, wide, tall)))
        panel(lower[-1], story)
        lower[-1].set_xlim(0.0, orbit.duration)
    lower[0].tick_params(labelbottom=False)
    lower[1].set_xlabel("time (s)" if story.has_angles else "time", fontsize=9, color=style.NOTE, labelpad=1)
    tall = listed / body
    if story.arm_lengths is None:
        rest = (0.97 - tall) / 2
        walk_space.space(figure.add_axes(box(0.63, tall + rest, 0.36, rest), projection="3d"), story)
        walk_space.plane(figure.add_axes(box(0.66, tall + 0.06, 0.32, rest - 0.12)), story)
    else:
        walk_space.space(figure.add_axes(box(0.62, tall, 0.38, 0.97 - tall), projection="3d"), story)
    _list(figure.add_axes(box(0.622, 0.02, 0.37, tall - 0.03)), story)
    return figure


def _film_height(story: WalkStory) -> float:
    """Return inches: as tall as the film's width makes it with equal scales."""
    rows, across, poses = walk_panels.film_shape(story)
    broad = (across * (poses + 0.35) - 0.30) * walk_panels.FRAME_STEP
    tall = (rows - 1) * walk_panels.ROW_STEP + 2.9
    return 0.98 * _WIDTH * tall / broad


def _verdict(story: WalkStory) -> str:
    orbit = story.orbit
    parts = [f"largest gap at a node {orbit.residual:.1e}"]
    estimate = orbit.estimate
    if estimate is not None:
        if estimate.radius is not None:
            parts.append(f"estimated distance from the true orbit {estimate.radius:.1e}")
        if estimate.multipliers is not None:
            sign = "−" if estimate.multipliers.sign < 0 else ""
            parts.append(f"unstable multiplier {sign}exp({estimate.multipliers.log_unstable:.4g})")
    if orbit.wraps:
        parts.append(f"wraps {list(orbit.wraps_realised)} as asked")
    unit = " s" if story.has_angles else ""
    parts.insert(0, f"{'period' if orbit.periodic else 'lasts'} {orbit.duration:.3f}{unit}")
    return "\n".join(wrap("; ".join(parts), 230, max_lines=2, placeholder=" …"))


def _list(axes: Axes, story: WalkStory) -> None:
    """Write what each symbol is, and its connection's name."""
    axes.axis("off")
    chain, times = story.orbit.connections, story.orbit.symbol_times
    shown = len(chain) if len(chain) <= _LISTED else _LISTED - 1
    rows = min(len(chain), _LISTED) + 1
    y = [1 - (k + 0.5) / rows for k in range(rows)]
    for place, text in ((0.05, "symbol"), (0.475, "at (s)" if story.has_angles else "at"), (0.57, "connection")):
        axes.text(place, y[0], text, fontsize=9, weight="bold", color=style.INK, va="center_baseline")
    for k in range(shown):
        badge(axes, k + 1, 0.02, y[k + 1], size=6.5)
        axes.text(0.05, y[k + 1], symbol_words(chain[k]), fontsize=8.2, color=style.INK, va="center_baseline")
        axes.text(0.57, y[k + 1], chain[k].name, fontsize=7.4, color=style.NOTE, va="center_baseline")
        axes.text(0.475, y[k + 1], f"{times[k]:.3f}", fontsize=8.2, color=style.NOTE, va="center_baseline")
    if shown < len(chain):
        axes.text(0.05, y[-1], f"… and {len(chain) - shown} more", fontsize=8.2, color=style.INK, va="center_baseline")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
