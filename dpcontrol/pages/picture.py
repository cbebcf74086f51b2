"""A picture of a review, by the Rerun viewer or by matplotlib.

The viewer draws the picture if it can render without a screen, otherwise matplotlib does.

The viewer is a separate program: opened for the user, or started without a screen under a time limit. Run as a program,
this module takes the picture. Its arguments are the viewer's executable, the recording, the picture and the time in s.
It exits with 0 after writing the picture, or with 1 and the reason as the last line on standard output.
"""

import contextlib
import os
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from dpcontrol.foundation.config import configuration
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive_format, is_archive, write_whole
from dpcontrol.foundation.parts import installed, part
from dpcontrol.foundation.rendering import render
from dpcontrol.judge.of_log import read_reference_view, run_view
from dpcontrol.judge.run_view import RunView
from dpcontrol.logs import read_log
from dpcontrol.pages.renderers import record
from dpcontrol.references.reference import FORMAT as REFERENCE

if TYPE_CHECKING:
    from dpcontrol.judge.comparison import RunComparison
    from dpcontrol.walks.atlas import Atlas

_SECONDS = 120.0
"""Time limit, s; a software renderer on a busy machine takes half of it."""
_LEAST_BYTES = 20_000
"""Least size of a picture with something in its views, bytes."""
_PACKAGES = "mesa-vulkan-drivers libegl1 libgl1 libxkbcommon-x11-0 fonts-dejavu-core"


def viewer_program() -> Path | None:
    """Return the viewer's executable in the rerun-sdk package, or None."""
    if not installed("rerun_cli"):
        return None
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    return next((folder / name for name in ("rerun", "rerun.exe") if (folder / name).is_file()), None)


_QUIET = {"CI": "1"}
"""Setting against usage reports of the viewer, which it sends except in CI."""
_LOOPBACK = ("--bind", "127.0.0.1")
"""Setting that restricts the viewer to connections from this computer."""
_STARTED = 1.0
"""Time after which a running viewer has found its display, s."""
_WATCH = """
import shutil, subprocess, sys
folder, *viewer = sys.argv[1:]
try:
    code = subprocess.call(viewer)
finally:
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
sys.exit(code != 0)
"""
"""A program that waits for the end of the viewer and removes its temporary folder."""


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


def open_viewer(recording: Path, *, temporary: Path | None = None) -> None:
    """Open a recording in a separate viewer.

    The viewer outlives this process and accepts local connections only.

    Args:
        recording: the recording.
        temporary: folder to remove when the viewer is closed.

    Raises:
        InputError: the recording, the viewer or the display is missing, or the viewer ended at once.
    """
    if not Path(recording).is_file():
        raise InputError(f"there is no recording {recording}; write one with `dpcontrol review LOG --save {recording}`")
    viewer, environment = viewer_command(str(recording))
    silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    watch = subprocess.Popen(
        [sys.executable, "-I", "-c", _WATCH, str(temporary or ""), *viewer], start_new_session=True,
        env=environment, **silent,
    )  # fmt: skip
    with contextlib.suppress(subprocess.TimeoutExpired):
        if watch.wait(_STARTED):
            raise InputError(f"the viewer ended at once; {REVIEW_REMEDY}")
    # The viewer runs on independently and is not waited for.
    watch.returncode = 0


def view_in_window(shown: Any, name: str) -> Path:
    """Open a viewer on a review and return its recording.

    The recording is removed when the viewer is closed or fails.

    Args:
        shown: run, reference, comparison or atlas.
        name: name of the recording.

    Raises:
        InputError: the viewer or the display is missing, or the viewer ended at once.
        PartMissing: rerun-sdk is not installed.
    """
    check_viewer()
    folder = Path(tempfile.mkdtemp(prefix="dpcontrol-"))
    recording = folder / f"{name[:40]}.rrd"
    try:
        record(shown, recording)
        open_viewer(recording, temporary=folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return recording


def missing_renderer() -> str | None:
    """Return the obstacle to drawing without a screen, or None.

    None means that the viewer might be able to.
    """
    if not installed("rerun"):
        return "rerun-sdk is not installed (pip install 'dpcontrol[viewer]')"
    if viewer_program() is None:
        return "the installed rerun-sdk holds no viewer"
    if sys.platform != "linux":
        return None
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    if named:
        found = any(Path(name).is_file() for name in named.split(os.pathsep))
    else:
        home = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
        folders = ["/usr/share", "/usr/local/share", "/etc", home]
        # Unlike Path.glob, this finds nothing in a folder that is not accessible.
        found = any(glob("*.json", root_dir=f"{folder}/vulkan/icd.d") for folder in folders)
    return None if found else f"no Vulkan driver is installed (on Debian or Ubuntu: {_PACKAGES})"


def picture_of(write: Callable[[Path], None], path: Path, *, moment: float, seconds: float = _SECONDS) -> str | None:
    """Write a picture (PNG) of the viewer.

    The viewer shows the recording from `write`.

    The viewer runs under a separate process, which is ended with all its children after `seconds`.
    Returns None if the picture was written, otherwise the reason.

    Args:
        write: function that writes the recording to a file.
        path: file of the picture.
        moment: displayed time, s.
        seconds: time limit, s.

    Raises:
        InputError: the picture cannot be written to `path`.
    """
    reason = missing_renderer()
    if reason is not None:
        return reason
    with tempfile.TemporaryDirectory(prefix="dpcontrol-") as folder:
        recording, picture = Path(folder) / "run.rrd", Path(folder) / "run.png"
        write(recording)
        # The viewer's window library requires a private folder even without a window.
        # Temporary folders left by the viewer are removed with this one.
        environment = {"XDG_RUNTIME_DIR": folder, **os.environ, **_QUIET, "TMPDIR": folder}
        program = [sys.executable, "-m", "dpcontrol.pages.picture", str(viewer_program())]
        reason = _run([*program, str(recording), str(picture), repr(moment)], environment, seconds=seconds)
        if reason is not None:
            return reason
        content = picture.read_bytes() if picture.is_file() else b""
        if len(content) < _LEAST_BYTES:
            return "the viewer's picture is blank"
        write_whole(Path(path), content)
    return None


def _run(arguments: list[str], environment: dict[str, str], *, seconds: float) -> str | None:
    """Run a program with its children; return the error, if any.

    All are ended when time is up.
    """
    quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, text=True, **quiet) as child:
        try:
            output, _ = child.communicate(timeout=seconds)
        except BaseException as error:
            _end(child.pid)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            return f"the viewer took longer than {seconds:g} s"
    lines = output.strip().splitlines()
    if child.returncode == 0:
        return None
    return lines[-1] if lines else f"the viewer ended with code {child.returncode}"


def _end(pid: int) -> None:
    """End a process started here, and the viewer it started.

    The viewer has a separate process group.
    """
    import psutil

    try:
        parent = psutil.Process(pid)
        family = [*parent.children(recursive=True), parent]
    except psutil.NoSuchProcess:
        return
    for process in family:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    psutil.wait_procs(family, timeout=5)


@dataclass(frozen=True)
class Picture:
    """A picture on disk.

    Attributes:
        path: the PNG.
        renderer: `viewer` or `matplotlib`.
        status: sentence on the renderer and the reason for it.
    """

    path: Path
    renderer: str
    status: str


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
    if archive_format(first) == REFERENCE:
        return read_reference_view(first)
    if is_archive(first):
        from dpcontrol.plans.atlas import load_atlas

        return load_atlas(first)
    return run_view(read_log(first))


def write_picture(shown: Shown, path: Path | str) -> Picture:
    """Write a PNG of a review.

    It comes from the Rerun viewer if this machine can render it, otherwise from matplotlib.

    Args:
        shown: run, reference, comparison or atlas.
        path: file, `*.png`.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.pages.layout import save_figure

    path = Path(path)
    reason = picture_of(partial(record, shown), path, moment=getattr(shown, "moment", 0.0))
    if reason is None:
        return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")
    save_figure(render(shown), path)
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")


_POLL = 0.1
_SETTLED = 1.0
"""Quiet time without reports from any view before the picture, s: software rendering needs some frames."""


def _bound(program: Path, folder: Path) -> Path:
    """Return a script that starts the viewer on the loopback.

    The script is in `folder`. The viewer's client has no setting for this.
    """
    if os.name != "posix":
        return program
    script = folder / "viewer"
    script.write_text(f'#!/bin/sh\nexec {shlex.quote(str(program))} {" ".join(_LOOPBACK)} "$@"\n')
    script.chmod(0o700)
    return script


def take(program: Path, recording: Path, picture: Path, *, moment: float) -> str | None:
    """Write `picture`; return None, or the reason for failure.

    No time limit applies: set one from outside.

    Args:
        program: the viewer's executable.
        recording: recording to show, `*.rrd`.
        picture: file to write, `*.png`.
        moment: displayed time, s.
    """
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    look: dict[str, Any] = {"headless": True, "hide_welcome_screen": True}
    with ViewerClient.spawn(executable_path=str(_bound(program, picture.parent)), port=port, **look) as viewer:
        viewer.open(str(recording))
        state = viewer.get_state()
        while state.loading or not any(item.timelines for item in state.recordings):
            time.sleep(_POLL)
            state = viewer.get_state()
        viewer.set_time(duration=moment, play_state="paused")
        reports, calm, begin = [], 0.0, time.monotonic()
        # Views report errors while their data arrive; only persistent ones count.
        while calm < _SETTLED and time.monotonic() - begin < 10 * _SETTLED:
            time.sleep(_POLL)
            views = viewer.get_state().views
            reports = [f"{view.name}: {report.summary}" for view in views for report in view.reports]
            calm = 0.0 if reports or not views else calm + _POLL
        if reports:
            return f"a view of the viewer failed: {reports[0]}"
        viewer.save_screenshot(str(picture))
        begin = time.monotonic()
        while not picture.is_file() and time.monotonic() - begin < 10 * _SETTLED:
            time.sleep(_POLL)
    return None if picture.is_file() else "the viewer wrote no picture"


def main(program: str, recording: str, picture: str, moment: str) -> int:
    """Take the picture given on the command line; return the exit code.

    Args:
        program: the viewer's executable.
        recording: recording to show, `*.rrd`.
        picture: file to write, `*.png`.
        moment: displayed time, s.
    """
    try:
        reason = take(Path(program), Path(recording), Path(picture), moment=float(moment))
    except Exception as error:  # noqa: BLE001 - any exception of the viewer's client is the reason to report
        reason = f"the viewer failed: {' '.join(str(error).split())}"
    if reason:
        sys.stdout.write(reason + "\n")
    return 1 if reason else 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
