"""Itineraries drawn at random: walks with wraps, rests, holds, several energies, kept stops, one arm and two."""

from pathlib import Path

import numpy as np

TURNS = {"down-up": ("down-up +", "down-up -"), "up-down": ("up-down +", "up-down -")}
CROSSINGS = {
    "down-up": ("down-up > up-down", "down-up > up-down +", "down-up > up-down -"),
    "up-down": ("up-down > down-up", "up-down > down-up +", "up-down > down-up -"),
}
HOLDS = ("up-up", "down-up", "up-down")


def drawn_walk(random: np.random.Generator, *, high: bool, start: str = "down-up") -> tuple[list[str], str]:
    """Return one to four symbols from a saddle, and their final saddle."""
    walk, here = [], start
    for _ in range(int(random.integers(1, 5))):
        if high and random.random() < 0.4:
            walk.append(str(random.choice(CROSSINGS[here])))
            here = "up-down" if here == "down-up" else "down-up"
        else:
            walk.append(str(random.choice(TURNS[here])))
    return walk, here


def _walk_lines(random: np.random.Generator, *, high: bool, start: str) -> tuple[list[str], str]:
    walk, end = drawn_walk(random, high=high, start=start)
    energy = random.uniform(0.182, 0.3) if high else random.uniform(-0.1, 0.1)
    wraps = random.choice([0, 1, 2, 3], size=len(walk) - 1, p=[0.3, 0.3, 0.3, 0.1])
    texts = ", ".join(f'"{symbol}"' for symbol in walk)
    leads = [f"lead_in = {random.integers(0, 3)}", f"lead_out = {random.integers(0, 3)}"]
    return [f"energy = {energy:.4f}", f"walk = [{texts}]", f"wraps = {wraps.tolist()}", *leads], end


def drawn_itinerary(seed: int) -> str:
    random = np.random.default_rng(seed)
    model = str(random.choice(["lab", "lab-identified"]))
    kind = seed % 6
    head = [f'title = "drawn from seed {seed}"', f'model = "{model}"']
    if kind in (0, 1, 5):
        rests = [f'{end} = "rest"' for end in ("start", "finish") if random.random() < 0.7] if kind == 1 else []
        lines, _ = _walk_lines(random, high=bool(random.random() < 0.6), start="down-up")
        kept = ["[controller]", 'kind = "tvlqr"', 'keep = "tvlqr"'] if kind == 5 else []
        return "\n".join([*head, *rests, *lines, *kept])
    parts: list[str] = []
    here = "down-up"
    for k in range(int(random.integers(1, 4))):
        parts.append("[[parts]]")
        if random.random() < 0.35 or (kind == 4 and k == 0):
            parts += [f'hold = "{random.choice(HOLDS)}"', f"seconds = {random.uniform(0.3, 3.0):.2f}"]
            here = "down-up"
        else:
            lines, here = _walk_lines(random, high=here == "up-down" or bool(random.random() < 0.5), start=here)
            parts += lines
    # A hold at the start or the end has no orbit beside it.
    holds = [part.startswith("hold") for part in parts if not part.startswith(("[", "seconds", "wraps", "lead"))]
    ends = [
        f'{end} = "rest"' for end, held in (("start", holds[0]), ("finish", holds[-1])) if held or random.random() < 0.6
    ]
    return "\n".join([*head, *ends, *parts])


def write_itinerary(folder: Path, seed: int) -> Path:
    file = folder / f"drawn-{seed}.toml"
    file.write_text(drawn_itinerary(seed) + "\n")
    return file
