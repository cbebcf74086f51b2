"""Colours and small manners shared by recordings and pictures."""

ARMS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15")
"""One colour for each arm, from the pivot outwards; repeated beyond the fifth."""

CART = "#5b6470"
REFERENCE = "#9aa3ad"
INK = "#22262b"
PALE_INK = "#e8ebee"
"""For lines on the viewer's dark plots."""
FAINT = "#c9ced4"
LIMIT = "#b3261e"
MODES = {
    "idle": "#d5d9de",
    "tracking": "#8fbce6",
    "holding": "#9fd3a8",
    "pulsing": "#f2c46d",
    "saturated": "#e8877f",
    "stopped": "#b9bec5",
    "aborted": "#b3261e",
}


SADDLES = {"down-down": "#8d96a0", "down-up": "#0f8b8d", "up-down": "#8a4fa3", "up-up": "#b0851e"}
"""Where a run stays, apart from the arms' colours."""
UNSTABLE, STABLE = "#d4544b", "#3c9c5f"
"""The usual red for tubes that leave an orbit and green for those that come to it."""
RUNS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15", "#c2185b")
"""One colour for each of several runs compared."""


def saddle_colour(saddle: str) -> str:
    """Return the colour of a stay near a saddle."""
    return SADDLES.get(saddle, CART)


def arm_colour(arm: int) -> str:
    """Return the colour of an arm, counted from zero."""
    return ARMS[arm % len(ARMS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return `#rrggbb` as three numbers from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
