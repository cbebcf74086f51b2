"""The viewer's window on a review, and a review's picture by matplotlib.

The viewer is a separate program, opened for the user.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from dpcontrol.foundation.config import configuration
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive_format, is_archive
from dpcontrol.foundation.parts import installed, part
from dpcontrol.judge.of_log import reference_view, run_view
from dpcontrol.judge.run_view import RunView
from dpcontrol.logs import read_log
from dpcontrol.pages.renderers import record
from dpcontrol.references.reference import FORMAT, load_reference

if TYPE_CHECKING:
    from dpcontrol.judge.comparison import RunComparison
    from dpcontrol.walks.atlas import Atlas


def viewer_program() -> Path | None:
    """Return the viewer's executable in the rerun-sdk package, or None."""
    if not installed("rerun_cli"):
        return None
    import rerun_cli

    found = shutil.which("rerun", path=Path(rerun_cli.__file__).parent)
    return None if found is None else Path(found)


_QUIET = {"CI": "1"}
"""Setting against usage reports of the viewer, which it sends except in CI."""
_LOOPBACK = ("--bind", "127.0.0.1")
"""Setting that restricts the viewer to connections from this computer."""
_STARTED = 1.0
"""Time after which a running viewer has found its display, s."""

REVIEW_REMEDY = "write a file with --picture FILE.png or --save FILE.rrd"
LIVE_REMEDY = "leave out --live, and draw the log with `dpcontrol review LOG --picture FILE.png`"


def check_viewer(remedy: str = REVIEW_REMEDY) -> Path:
    """Return the viewer's executable.

    The `remedy` is advice for a user without a display.

    Raises:
        InputError: there is no viewer, or no display to open it on.
        PartMissing: rerun-sdk is not installed.
    """
    part("rerun")
    named = configuration().viewer
    program = Path(os.path.expanduser(named)) if named else viewer_program()
    if named and not os.access(str(program), os.X_OK):
        raise InputError(
            f"viewer = {named!r}: there is no such program; correct it (`dpcontrol config` shows where it is set)"
        )
    if program is None:
        raise InputError("the installed rerun-sdk holds no viewer; install rerun-sdk from PyPI again")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display to open the viewer on (neither DISPLAY nor WAYLAND_DISPLAY is set); {remedy}"
        )
    return program


def viewer_command(*arguments: str) -> tuple[list[str], dict[str, str]]:
    """Return command and environment of a private viewer.

    It accepts local connections only and reports nothing.

    Raises:
        InputError: there is no viewer, or no display to open it on.
    """
    return [str(check_viewer()), *arguments, *_LOOPBACK], {**os.environ, **_QUIET}


def view_in_window(shown: Any, name: str) -> Path:
    """Open a separate viewer on a review and return the name of its recording, which is not kept.

    The viewer outlives this process and accepts local connections only.

    Args:
        shown: run, reference, comparison or atlas.
        name: name of the recording.

    Raises:
        InputError: the viewer or the display is missing, or the viewer ended at once.
        PartMissing: rerun-sdk is not installed.
    """
    command, environment = viewer_command("-")
    silent: dict[str, Any] = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    # The viewer keeps its open file when the folder is removed; Windows keeps the folder instead.
    with tempfile.TemporaryDirectory(prefix="dpcontrol-", ignore_cleanup_errors=True) as folder:
        recording = Path(folder) / f"{name[:40]}.rrd"
        record(shown, recording)
        with recording.open("rb") as content:
            viewer = subprocess.Popen(command, stdin=content, start_new_session=True, env=environment, **silent)
    with contextlib.suppress(subprocess.TimeoutExpired):
        if viewer.wait(_STARTED):
            raise InputError(f"the viewer ended at once; {REVIEW_REMEDY}")
    # The viewer runs on independently and is not waited for.
    viewer.returncode = 0
    return recording


@dataclass(frozen=True)
class Review(Documented):
    """Reviewed files, and what was written.

    Attributes:
        files: logs, an atlas or a reference.
        recording: recording that was saved or opened, or None.
        film: film of the arms, or None.
        aligned: how several logs are aligned, None for one.
    """

    KEYS: ClassVar[str] = "log=files.0 logs=files recording film aligned? status"

    status = "done"
    files: tuple[Path, ...]
    recording: Path | None
    film: Path | None
    aligned: str | None


Shown: TypeAlias = "RunView | RunComparison | Atlas"
"""Objects to review: a run or a reference, several runs, an atlas."""


def opened(files: Sequence[Path], *, symbol: int = 1) -> Shown:
    """Return the view of one or more files.

    Args:
        files: a log, a reference or an atlas; or several logs, which are compared.
        symbol: number of the symbol at which several logs are aligned, from 1.

    Raises:
        InputError: a file is missing or damaged, or one of several files is not a log.
    """
    if not files:
        raise InputError("files = []: give one at least")
    first, *others = files
    if others:
        from dpcontrol.judge.comparison import compare

        if other := next((file for file in files if file.suffix.lower() == ".npz"), None):
            raise InputError(
                f"{other} is not a log: several files can be compared only if all are logs; review it alone"
            )
        return compare([run_view(read_log(file)) for file in files], symbol=symbol)
    if is_archive(first) and archive_format(first) == FORMAT:
        return reference_view(load_reference(first), first)
    if is_archive(first):
        from dpcontrol.plans.atlas import load_atlas

        return load_atlas(first)
    return run_view(read_log(first))
