"""The guide's list of functions, from their docstrings: `python tests/guide_functions.py` updates it."""

import doctest
import inspect
from pathlib import Path

import dpcontrol as dp
from dpcontrol import api

PAGE = Path(__file__).parents[1] / "dpcontrol" / "guide" / "python.md"
FUNCTIONS = [name for name in dp.__all__ if inspect.isfunction(getattr(api, name))]


def listed() -> str:
    """Return one line and one example of each function, in Markdown."""
    return "\n".join(_entry(name) for name in FUNCTIONS)


def _entry(name: str) -> str:
    text = inspect.getdoc(getattr(api, name)) or ""
    (first, *_), examples = text.splitlines(), doctest.DocTestParser().get_examples(text)
    shown = "".join(f">>> {one.source}{one.want}" for one in examples)
    return f"`dp.{name}`: {first}\n\n```pycon\n{shown}```\n"


def with_functions(page: str) -> str:
    """Return the page with its section of functions updated."""
    before, heading, rest = page.partition("## Functions\n\n")
    return before + heading + listed() + rest[rest.index("\n## ") :]


if __name__ == "__main__":
    PAGE.write_text(with_functions(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
