"""The Rerun viewer as a program: opened for a look, or started without a screen for a picture."""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole

_SECONDS = 120.0
"""A software renderer on a busy machine takes half of it."""
_LEAST_BYTES = 20_000
"""A picture of the viewer with nothing in its views is smaller."""
_PACKAGES = "mesa-vulkan-drivers libegl1 libgl1 libxkbcommon-x11-0 fonts-dejavu-core"


def viewer_program() -> Path | None:
    """Return the viewer's executable as the rerun-sdk package ships it, or None where it does not."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    return next((folder / name for name in ("rerun", "rerun.exe") if (folder / name).is_file()), None)


def open_viewer(recording: Path) -> None:
    """Open a recording in a viewer of its own, which outlives this process.

    Raises:
        InputError: there is no such recording, or no viewer.
    """
    program = viewer_program()
    if not Path(recording).is_file():
        raise InputError(f"there is no recording {recording}; write one with `dpcontrol review LOG --save {recording}`")
    if program is None:
        raise InputError("the installed rerun-sdk holds no viewer; install rerun-sdk from PyPI again")
    subprocess.Popen(
        [str(program), str(recording)],
        start_new_session=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def missing_renderer() -> str | None:
    """Return why the viewer cannot draw without a screen here, or None if it may be able to."""
    if viewer_program() is None:
        return "the installed rerun-sdk holds no viewer"
    if sys.platform != "linux":
        return None
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    if named:
        found = any(Path(name).is_file() for name in named.split(os.pathsep))
    else:
        home = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
        folders = [Path("/usr/share"), Path("/usr/local/share"), Path("/etc"), home]
        found = any(any((folder / "vulkan" / "icd.d").glob("*.json")) for folder in folders)
    return None if found else f"no Vulkan driver is installed (on Debian or Ubuntu: {_PACKAGES})"


def picture_of(write: Callable[[Path], None], path: Path, *, moment: float, seconds: float = _SECONDS) -> str | None:
    """Write a picture (PNG) of the viewer showing the recording that `write` writes, at `moment` (s).

    The viewer runs under a process of its own, which is ended with all its children after `seconds`.
    Returns None if the picture was written, else why not.

    Raises:
        InputError: the picture cannot be written to `path`.
    """
    reason = missing_renderer()
    if reason is not None:
        return reason
    with tempfile.TemporaryDirectory(prefix="dpcontrol-") as folder:
        recording, picture = Path(folder) / "run.rrd", Path(folder) / "run.png"
        write(recording)
        # The viewer's window library wants a private folder even when there is no window; and the viewer reports
        # its use to its makers except in CI, which a picture made on the side should not do.
        environment = {"XDG_RUNTIME_DIR": folder, "CI": "1", **os.environ}
        program = [sys.executable, "-m", "dpcontrol.review.headless", str(viewer_program())]
        reason = _run([*program, str(recording), str(picture), repr(moment)], environment, seconds=seconds)
        if reason is not None:
            return reason
        content = picture.read_bytes() if picture.is_file() else b""
        if len(content) < _LEAST_BYTES:
            return "the viewer's picture is blank"
        write_whole(Path(path), content)
    return None


def _run(arguments: list[str], environment: dict[str, str], *, seconds: float) -> str | None:
    """Run a program with all its children until it ends or time is up; return what went wrong, if anything."""
    with subprocess.Popen(
        arguments,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as child:
        try:
            output, _ = child.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            _end(child.pid)
            return f"the viewer took longer than {seconds:g} s"
        except BaseException:
            _end(child.pid)
            raise
    lines = output.strip().splitlines()
    if child.returncode == 0:
        return None
    return lines[-1] if lines else f"the viewer ended with code {child.returncode}"


def _end(pid: int) -> None:
    """End a process that was started here, and the viewer it started, which has a process group of its own."""
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
