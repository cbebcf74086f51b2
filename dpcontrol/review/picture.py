"""A picture of what is reviewed: by the Rerun viewer where it can render without a screen, else by matplotlib.

The viewer is a program of its own: opened for the user, or started without a screen under a time limit.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.review.motion import RunView

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dpcontrol.review.comparison import RunComparison
    from dpcontrol.walks.atlas import Atlas

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


@dataclass(frozen=True)
class Picture:
    """A picture that was written.

    Attributes:
        path: the PNG.
        renderer: `viewer` or `matplotlib`.
        status: a sentence that says which it is and why.
    """

    path: Path
    renderer: str
    status: str


def write_picture(view: RunView, path: Path | str) -> Picture:
    """Write a PNG of a run or a reference: of the Rerun viewer if this machine can render it, else by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.page import draw
    from dpcontrol.review.rerun_recording import write_recording

    return _written(path, lambda file: write_recording(view, file), lambda: draw(view), moment=view.moment)


def write_comparison_picture(comparison: "RunComparison", path: Path | str) -> Picture:
    """Write a PNG of several runs, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.comparison import draw_comparison, write_comparison_recording

    return _written(
        path, lambda file: write_comparison_recording(comparison, file), lambda: draw_comparison(comparison),
        moment=comparison.moment,
    )  # fmt: skip


def write_atlas_picture(atlas: "Atlas", path: Path | str) -> Picture:
    """Write a PNG of an atlas, by the viewer or by matplotlib.

    Raises:
        InputError: the file cannot be written.
    """
    from dpcontrol.review.atlas import draw_atlas, write_atlas_recording

    return _written(path, lambda file: write_atlas_recording(atlas, file), lambda: draw_atlas(atlas), moment=0.0)


def _written(
    path: Path | str, record: Callable[[Path], None], draw: Callable[[], "Figure"], *, moment: float
) -> Picture:
    """Write a PNG of what `record` writes, as the viewer shows it at `moment` (s), else what `draw` draws."""
    from dpcontrol.review.page import save_figure

    path = Path(path)
    reason = picture_of(record, path, moment=moment)
    if reason is None:
        return Picture(path, "viewer", f"{path} shows the Rerun viewer, rendered without a screen.")
    save_figure(draw(), path)
    return Picture(path, "matplotlib", f"{path} was drawn by matplotlib, not by the Rerun viewer: {reason}.")
