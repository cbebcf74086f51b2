"""CONTRIBUTING.md shows the house as it is: its packages in their order, and ways along calls that exist."""

import ast
import importlib
import re
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest

from dpcontrol.loop.loop import ControlLoop
from dpcontrol.loop.protocols import UserRig
from dpcontrol.loop.result import Rig
from dpcontrol.rig.client import UdpRig

TOP = Path(__file__).parents[1]
PAGE = (TOP / "CONTRIBUTING.md").read_text(encoding="utf-8")
PACKAGES = re.findall(r"^(\w+) +[\d,]+  \w", PAGE, re.MULTILINE)
ROWS = [line.split("|")[2:5] for line in PAGE.splitlines() if re.match(r"\| \d+ \|", line)]
WAYS = [[name for cell in column for name in re.findall(r"`([a-z_.]+)`", cell)] for column in zip(*ROWS, strict=True)]
LONGEST = 12  # stations that a reader can keep in mind
BY_PROTOCOL = {("rig.client", "loop.loop")}
"""Neighbours of which neither imports the other, because the loop reads any object of a protocol."""


def path_of(module: str) -> Path:
    return TOP / "dpcontrol" / f"{module.replace('.', '/')}.py"


def imported_by(module: str) -> set[str]:
    """Return the modules of the package that a module imports, and those that define what it imports from packages."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path_of(module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (source := node.module or "").startswith("dpcontrol."):
            names |= {source, *(f"{source}.{alias.name}" for alias in node.names)}
            if (TOP / source.replace(".", "/")).is_dir():
                values = [getattr(importlib.import_module(source), alias.name, None) for alias in node.names]
                names |= {str(getattr(value, "__module__", "")) for value in values}
    return {name.removeprefix("dpcontrol.") for name in names}


def test_the_packages_stand_in_the_order_in_which_they_may_import() -> None:
    contracts = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    assert [layer.removeprefix("dpcontrol.") for layer in layers] == PACKAGES


@pytest.mark.parametrize("way", WAYS, ids=["reading", "itinerary", "search"])
def test_a_way_is_short_and_each_station_imports_the_next_or_is_imported_by_it(way: list[str]) -> None:
    assert len(way) == len(set(way)) <= LONGEST
    assert [station for station in way if not path_of(station).is_file()] == []
    imports = {station: imported_by(station) for station in way}
    apart = {(a, b) for a, b in pairwise(way) if a not in imports[b] and b not in imports[a]}
    assert apart <= BY_PROTOCOL


def test_the_client_of_a_rig_is_an_object_that_the_loop_reads() -> None:
    assert ControlLoop.run.__annotations__["rig"] is Rig
    assert {"read", "command", "stop"} == {name for name in vars(UserRig) if name in dir(UdpRig) and name[0] != "_"}
