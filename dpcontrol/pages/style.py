"""Colours and text shared by recordings, pages and figures."""

ARMS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15")
"""One colour for each arm, from the pivot outwards, repeated after the fifth."""

CART = "#5b6470"
REFERENCE = "#9aa3ad"
INK = "#22262b"
PALE_INK = "#e8ebee"
"""Replacement for ink on the viewer's dark plots."""
NOTE = "#555c64"
MARK = "#7a828b"
FAINT = "#c9ced4"
GRID = "#e6e9ec"
LIMIT = "#b3261e"
GOOD = "#1e7a3c"
MODES = {
    "idle": "#d5d9de",
    "tracking": "#8fbce6",
    "holding": "#9fd3a8",
    "pulsing": "#f2c46d",
    "saturated": "#e8877f",
    "stopped": "#b9bec5",
    "aborted": "#b3261e",
}


SADDLES = {
    "down-down": "#8d96a0",
    "down-up": "#0f8b8d",
    "up-down": "#8a4fa3",
    "up-up": "#b0851e",
    "L1": "#0f8b8d",
    "L2": "#8a4fa3",
    "L3": "#b0851e",
    "inner-rotating": "#9a6b15",
    "outer-rotating": "#c2185b",
}
"""Colour of a saddle's or a rotating orbit's items, except the arms."""
CONNECTIONS = ("#1f6fb4", "#d9640d", "#c2185b", "#9a6b15", "#5b6470", "#6b8e23", "#404751")
"""Colours of connections, and of saddles without a fixed colour."""
UNSTABLE, STABLE = "#d4544b", "#3c9c5f"
PALE_UNSTABLE, PALE_STABLE = "#f0a39d", "#a5d3b4"
"""Colours of tubes: the usual red for unstable and green for stable ones, pale for the second branch."""
CUT = "#b0851e"
"""Colour of the cuts of tubes on their section."""
RUNS = ("#1f6fb4", "#d9640d", "#2c8a4b", "#8a4fa3", "#9a6b15", "#c2185b")
"""Colours of the runs in a comparison."""
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def saddle_colour(saddle: str) -> str:
    """Return the colour of a saddle's items."""
    return SADDLES.get(saddle) or CONNECTIONS[sum(map(ord, saddle)) % len(CONNECTIONS)]


def arm_colour(arm: int) -> str:
    """Return the colour of an arm, counted from zero."""
    return ARMS[arm % len(ARMS)]


def verdict_colour(good: bool | None) -> str:
    """Return the colour of a verdict; None means that nothing was judged."""
    return {True: GOOD, False: LIMIT, None: NOTE}[good]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return `#rrggbb` as three numbers from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def number(i: int) -> str:
    """Return the number of an arm as a subscript.

    The argument counts from zero, the subscript from one.
    """
    return str(i + 1).translate(_SUBSCRIPTS)


def in_pi(half_turns: float, *, digits: int = 3) -> str:
    """Return half turns as an angle in units of π."""
    if abs(half_turns) < 1e-9:
        return "0"
    text = f"{half_turns:.{digits}g}"
    return {"1": "π", "-1": "−π"}.get(text, f"{text}π".replace("-", "−"))
