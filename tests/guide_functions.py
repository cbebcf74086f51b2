"""The guide's list of functions, from their docstrings: `python tests/guide_functions.py` updates it."""

import inspect
from pathlib import Path

import dpcontrol as dp

PAGE = Path(__file__).parents[1] / "dpcontrol" / "guide" / "python.md"
FUNCTIONS = [name for name in dp.__all__ if inspect.isfunction(getattr(dp, name))]


def listed() -> str:
    """Return one line about each function, as a list in Markdown."""
    lines = {name: (inspect.getdoc(getattr(dp, name)) or "").splitlines()[0] for name in FUNCTIONS}
    return "".join(f"- `dp.{name}`: {line}\n" for name, line in lines.items())


def with_functions(page: str) -> str:
    """Return the page with its section of functions updated."""
    before, heading, rest = page.partition("## Functions\n\n")
    return before + heading + listed() + rest[rest.index("\n## ") :]


if __name__ == "__main__":
    PAGE.write_text(with_functions(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
