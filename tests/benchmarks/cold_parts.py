"""Processor time of cold commands by parts: libraries, compilation by LLVM, and the rest.

    python tests/benchmarks/cold_parts.py

Each command runs in a new process with an empty cache, and prints a row of the table in the guide's page `speed`. The
modules are compiled before, as an installer does.
"""

import compileall
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from dpcontrol.foundation.version import PACKAGE

COMMANDS = (
    "orbit lab --saddle down-up --energy 0.2",
    "connect three-body --from L1 --to L2 --energy -1.5175 --hits 2",
    "plan cross",
    "run cross --out cross.mcap",
    "atlas lab --energy 0.2",
)
TIMED = """
import sys, time
import numpy, casadi, heyoka
loaded, compiled = time.process_time(), 0.0

def timed(make):
    def call(*arguments, **options):
        global compiled
        begin = time.process_time()
        made = make(*arguments, **options)
        compiled += time.process_time() - begin
        return made
    return call

for name in ("cfunc", "taylor_adaptive", "taylor_adaptive_batch"):
    setattr(heyoka, name, timed(getattr(heyoka, name)))
from dpcontrol.cli.main import main
try:
    main()
finally:
    print(loaded, compiled, time.process_time(), file=sys.stderr)
"""


def row(command: str) -> str:
    """Run a command with an empty cache, and return its row of the table."""
    with TemporaryDirectory() as folder:
        environment = os.environ | {"DPCONTROL_CACHE": str(Path(folder) / "cache"), "OMP_NUM_THREADS": "1"}
        words = [sys.executable, "-c", TIMED, *command.split()]
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    loaded, compiled, total = map(float, done.stderr.splitlines()[-1].split())
    values = (total, loaded, compiled, total - loaded - compiled)
    return f"| `{command.removesuffix(' --out cross.mcap')}` | {' | '.join(f'{value:.2f}' for value in values)} |"


if __name__ == "__main__":
    compileall.compile_dir(PACKAGE, quiet=1)
    sys.stdout.write("| cold command | total, s | libraries | compilation | rest |\n|---|---|---|---|---|\n")
    for command in COMMANDS:
        sys.stdout.write(f"{row(command)}\n")
