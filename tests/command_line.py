"""Calls of the command line: in this process for speed, as a program if streams matter."""

import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from dpcontrol.cli.main import main

PROGRAM = Path(sys.executable).parent / "dpcontrol"
"""The console script, beside the Python that runs the tests."""


@dataclass(frozen=True)
class Ended:
    """A call of the program that has ended."""

    code: int
    stdout: str
    stderr: str

    @property
    def document(self) -> Any:
        """The output of --json, which must be exactly one document."""
        return json.loads(self.stdout)

    @property
    def message(self) -> str:
        """The last line on stderr, which is the program's final message."""
        lines = self.stderr.strip().splitlines()
        return lines[-1] if lines else ""


def dpcontrol(*arguments: str | Path) -> Ended:
    """Call the console script's function in this process."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return Ended(ended.value.code, out.getvalue(), err.getvalue())


def dpcontrol_program(*arguments: str | Path, folder: Path) -> Ended:
    """Call the installed program in `folder`, including the output of compiled libraries."""
    done = subprocess.run(
        [PROGRAM, *map(str, arguments)], cwd=folder, capture_output=True, text=True, env=os.environ, check=False
    )
    return Ended(done.returncode, done.stdout, done.stderr)
