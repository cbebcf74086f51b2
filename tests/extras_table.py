"""The guide's table of extras, from pyproject.toml: `python tests/extras_table.py` writes it."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "dpcontrol" / "guide" / "start.md"
TABLE = re.compile(r"\| extra \| adds \|\n(\|.*\n)+")


def extras_table() -> str:
    """Return the table: the extras that `all` contains, `all` itself, and the others."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras, adds = project["project"]["optional-dependencies"], project["tool"]["dpcontrol"]["extras"]
    (contained,) = (re.findall(r"[\w-]+", text.partition("[")[2]) for text in extras["all"])
    adds = adds | {"all": f"the {len(contained)} above"}
    rows = [*contained, "all", *(name for name in adds if name not in (*contained, "all"))]
    assert sorted(rows) == sorted(extras)
    return "".join(["| extra | adds |\n|---|---|\n", *(f"| `{name}` | {adds[name]} |\n" for name in rows)])


if __name__ == "__main__":
    PAGE.write_text(TABLE.sub(lambda _: extras_table(), PAGE.read_text(encoding="utf-8")), encoding="utf-8")
