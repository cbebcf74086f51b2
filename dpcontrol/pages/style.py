"""The visual standard of all pages, figures, films and recordings: type scale, palette, numbers (see `guide/style.md`).

A colour has one meaning. The roles in `ROLES` remain distinct for people with deuteranopia, protanopia or tritanopia.
`SERIES` numbers items without a role, such as the runs of a comparison.
"""

from typing import Any

WIDTH = 11.7
"""Width of a page, inches: A4 in landscape or A3 in portrait. Pages are printed at this size."""
TITLE, VERDICT, HEAD, TEXT, SMALL = 15.0, 11.0, 9.5, 9.0, 8.0
"""Type scale in points: title of a page, its verdict, title of a panel, text, and the smallest text."""

PLANT, REFERENCE, ESTIMATE, COMMAND = "#22262b", "#a6adb5", "#d01fab", "#4db8ff"
"""Motion of the plant, its reference, its estimate, and the command to the drive."""
ARMS = ("#1a60f7", "#ea8b16", "#009e73", "#cc79a7", "#7d5a00")
"""One colour for each arm, from the pivot outwards, repeated after the fifth."""
UNSTABLE, STABLE, CUT = "#a31928", "#60c480", "#c9b458"
"""Tubes that lead out of an orbit and into it, and their cuts on a section."""
PALE_UNSTABLE, PALE_STABLE = "#dda1a6", "#bfe6cb"
"""Second branches of these tubes."""
LIMIT, GOOD = "#cc160a", "#2c8542"
"""Limits and failures; completed runs and favourable verdicts."""
INK, NOTE, MARK, FAINT, GRID, PAPER = "#22262b", "#555c64", "#7a828b", "#c9ced4", "#e6e9ec", "#ffffff"
"""Neutral colours: text, remarks, marks, areas, grid lines, background."""
CART = "#5b6470"
"""The cart's body."""
PRINTED: Any = {
    "font.size": SMALL,
    "axes.titlesize": HEAD,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 4,
    "axes.labelsize": SMALL,
    "axes.labelcolor": NOTE,
    "axes.labelpad": 1,
    "axes.edgecolor": FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": NOTE,
    "ytick.color": NOTE,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "legend.borderpad": 0.0,
}
"""Settings of matplotlib for pages: plain frames and grids."""
ON_DARK = {PLANT: "#f0f3f6", REFERENCE: "#6e7681", UNSTABLE: "#e0566a", "#124f62": "#2f9bb5", "#6310b2": "#a371f7"}
"""Colours of the viewer's dark plots that are too dark or too similar there."""
MODES = {
    "idle": "#d5d9de",
    "tracking": "#8fbce6",
    "holding": "#9fd3a8",
    "pulsing": "#f2c46d",
    "saturated": "#e8877f",
    "stopped": "#b9bec5",
    "aborted": LIMIT,
}
"""Modes of the controller, as areas."""
SADDLES = {
    "down-down": "#8d96a0",
    "down-up": "#124f62",
    "up-down": "#6310b2",
    "up-up": "#b0851e",
    "L1": "#124f62",
    "L2": "#6310b2",
    "L3": "#b0851e",
    "inner-rotating": "#9a6b15",
    "outer-rotating": "#c2185b",
}
"""Saddles and rotating orbits."""
ROLES = {
    "plant": PLANT,
    "reference": REFERENCE,
    "estimate": ESTIMATE,
    "inner arm": ARMS[0],
    "outer arm": ARMS[1],
    "tube out": UNSTABLE,
    "tube in": STABLE,
    "limit": LIMIT,
    "completed": GOOD,
    "down-up": SADDLES["down-up"],
    "up-down": SADDLES["up-down"],
}
"""Colours with a meaning that stays the same on every page and in the viewer."""
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#404751")
"""Numbered items without a role, such as connections and runs."""
CONNECTIONS, RUNS = SERIES, SERIES[:6]
DOTTED, DASHED = (0, (2, 2)), (0, (5, 3))
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def saddle_colour(saddle: str) -> str:
    """Return the colour of everything that belongs to a saddle: its orbits, stays and energy.

    A saddle that is not listed in `SADDLES` gets one of the colours `CONNECTIONS`, always the same for its name.
    """
    return SADDLES.get(saddle) or CONNECTIONS[sum(map(ord, saddle)) % len(CONNECTIONS)]


def arm_colour(arm: int) -> str:
    """Return the colour of an arm, counted from zero."""
    return ARMS[arm % len(ARMS)]


def verdict_colour(good: bool | None) -> str:
    """Return the colour of a verdict; None means that nothing was judged."""
    return {True: GOOD, False: LIMIT, None: NOTE}[good]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour `#rrggbb` as red, green and blue, 0 to 255 each, as Rerun takes it."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def number(i: int) -> str:
    """Return the number of an arm, counted from zero, as a subscript that counts from one."""
    return str(i + 1).translate(_SUBSCRIPTS)


def in_pi(half_turns: float) -> str:
    """Return half turns as an angle in units of π.

    Args:
        half_turns: angle, half turns.
    """
    if abs(half_turns) < 1e-9:
        return "0"
    text = f"{half_turns:.6g}"
    return {"1": "π", "-1": "−π"}.get(text, f"{text}π".replace("-", "−"))
