"""Regular expressions are used on texts that come from outside, never on texts of the program."""

import ast
from pathlib import Path

import dpcontrol

ROOT = Path(dpcontrol.__file__).parent

USES = {
    "cli/commands.py": "reads the arguments of a docstring, and marks their defaults for the help",
    "control/export.py": "takes apart C that casadi generated, and the linker's list of sizes",
    "dynamics/system.py": "names of a user's system",
    "foundation/cache.py": "names of files in the cache's folder",
    "foundation/errors.py": "shortens and escapes texts from outside for the terminal",
    "foundation/guide.py": "the list of pages in the guide's README",
    "foundation/toml.py": "the line of a TOML error, which Python 3.13 gives in its text only",
    "logs/recovery.py": "the beginning of a damaged file, and names of interrupted logs",
    "logs/rewritten.py": "URDF and message definitions in logs of other programs",
    "proofs/balls.py": "decimal numbers of a certificate",
    "recordings/bags.py": "names of fields and message definitions in bags",
    "recordings/importing.py": "numbers and paths of variables in a laboratory's tables",
    "rig/client.py": "addresses of rigs",
    "walks/symbols.py": "symbols and names of connections that users type",
}
"""Modules that import `re`, each with the text that it reads."""


def test_each_module_with_regular_expressions_has_a_reason() -> None:
    users = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.Import) and any(alias.name == "re" for alias in node.names))
        or (isinstance(node, ast.ImportFrom) and node.module == "re")
    }
    assert users - USES.keys() == set()
