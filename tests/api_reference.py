"""The guide's reference of the Python interface, from docstrings: `python tests/api_reference.py` writes its pages."""

import inspect
import re
from functools import cache
from pathlib import Path

import griffe
from griffe2md import render_object_docs
from result_attributes import ITEMS, attributes, methods, results_of

import dpcontrol as dp
from dpcontrol import api

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "dpcontrol" / "guide"
FUNCTIONS = [name for name in dp.__all__ if inspect.isfunction(getattr(dp, name))]
GROUPS = {
    "api-models": ("Models", ["load_model", "describe", "equilibria", "mjcf", "schema"]),
    "api-orbits": (
        "Orbits and tubes",
        [
            "find_orbits",
            "orbit",
            "family",
            "rotating_orbits",
            "rotating_families",
            "sustained_orbit",
            "find_connections",
            "connections",
            "refine",
            "find_bifurcations",
            "transport",
            "atlas",
            "open_atlas",
            "draw_figures",
        ],
    ),
    "api-walks": (
        "Walks",
        [
            "find_walks",
            "graph",
            "shadow",
            "count_walks",
            "list_walks",
            "random_walks",
            "shortest_walk",
            "symbol_changes",
            "prove_statement",
            "prove_graph",
            "prove",
            "check_proof",
        ],
    ),
    "api-references": (
        "References",
        ["plan", "reference", "open_plan", "open_reference", "polish", "explore_energies", "open_planner", "picture"],
    ),
    "api-loop": (
        "Closed loop",
        ["closed_loop", "ClosedLoop", "flight", "export", "rig_link", "start_bench", "commission", "preflight"],
    ),
    "api-runs": (
        "Runs and campaigns",
        ["run", "Run", "learn", "launch", "repeat", "demo", "campaign", "open_campaign", "open_night"],
    ),
    "api-logs": ("Logs", ["open_log", "log_summary", "recover_log", "compare_logs", "score", "review", "report"]),
    "api-recordings": (
        "Recordings",
        ["open_recording", "import_recording", "write_recording", "swings", "identify", "design_experiments", "replay"],
    ),
    "api-other": ("Cache, guide and charts", ["cache", "config", "read_guide", "draw_charts"]),
}
"""Title of each page, and the functions of `dp` and the classes on it, in order."""
CLASSES = {"ClosedLoop": "runs/closed_loop.py", "Run": "runs/run.py"}
FILES = {"load_model": "plans/model.py"}
"""Modules of functions that `dpcontrol.api` only passes on."""
OPTIONS = {"show_root_full_path": False, "docstring_section_style": "list", "members_order": "source", "summary": False}


@cache
def module(file: str) -> griffe.Module:
    """Return a module of the package with parsed docstrings, without an import."""
    path = ROOT / "dpcontrol" / file
    code = path.read_text(encoding="utf-8")
    return griffe.visit(f"dpcontrol.{path.stem}", filepath=path, code=code, docstring_parser="google")


def page(stem: str) -> str:
    """Return a page of the reference in Markdown: functions, then the results that no earlier page describes."""
    title, names = GROUPS[stem]
    note = "Generated from docstrings by `python tests/api_reference.py`; see [python](python.md) for an introduction."
    return "\n\n".join([f"# {title}", note, *map(entry, names), *map(result, results(stem))]) + "\n"


def results(stem: str) -> list[type]:
    """Return the classes of results to describe on a page: those of its functions, and of their items."""
    earlier: list[type] = []
    for one, (_, names) in GROUPS.items():
        found = [kind for name in names if name not in CLASSES for kind in results_of(name)]
        items = [ITEMS[kind] for kind in found if kind in ITEMS]
        here = [
            kind for kind in dict.fromkeys([*found, *items]) if kind not in earlier and kind.__name__ not in CLASSES
        ]
        if one == stem:
            return here
        earlier += here
    return []


def result(kind: type) -> str:
    summary = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
    listed = [f"- **{name}** – {text}" for name, text in (attributes(kind) | methods(kind)).items()]
    return "\n\n".join([f"## `{kind.__name__}`", summary, "\n".join(listed)])


def entry(name: str) -> str:
    """Return a function, or a class with its public methods."""
    found = module(CLASSES.get(name) or FILES.get(name, "api.py"))[name]
    text = render_object_docs(found, {**OPTIONS, "heading_level": 2})
    text = re.sub(r"\[([^][]+)\]\(#[^)]*\)", r"\1", text)
    text = re.sub(r"</?code>", "`", text)
    text = re.sub(rf"\b(?:{'|'.join(api.STAGES)})\.(?=[A-Z])", "", text)
    text = text.replace("```python\n>>>", "```pycon\n>>>").replace("```python\n", "```text\n")
    text = re.sub(r"^(#+) `(?:[\w.]+\.)?(\w+)`$", lambda m: heading(m[1], m[2], name), text, flags=re.MULTILINE)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(line.rstrip() for line in text.splitlines())).strip()


def heading(level: str, found: str, name: str) -> str:
    own = name in CLASSES
    return f"{level} `{f'{name}.{found}' if own and found != name else found if own else f'dp.{found}'}`"


if __name__ == "__main__":
    for stem in GROUPS:
        (GUIDE / f"{stem}.md").write_text(page(stem), encoding="utf-8")
