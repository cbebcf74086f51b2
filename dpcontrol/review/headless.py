"""Take a picture of a recording in a viewer without a screen; run as a program by `picture.picture_of`.

Arguments: the viewer's executable, the recording, the picture, the time in s to show. Exits with 0 and the picture
written, or with 1 and the reason as the last line on standard output.
"""

import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rerun.experimental import ViewerClient

_POLL = 0.1
_SETTLED = 1.0
"""Seconds without a report from any view before the picture is taken: software rendering needs some frames."""


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def take(program: Path, recording: Path, picture: Path, *, moment: float) -> str | None:
    """Write `picture`; return None, or why there is none. Waits as long as the viewer loads: time it from outside."""
    with ViewerClient.spawn(
        headless=True, executable_path=str(program), port=_free_port(), hide_welcome_screen=True
    ) as viewer:
        viewer.open(str(recording))
        state = viewer.get_state()
        while state.loading or not any(item.timelines for item in state.recordings):
            time.sleep(_POLL)
            state = viewer.get_state()
        viewer.set_time(duration=moment, play_state="paused")
        reports, calm, begin = [], 0.0, time.monotonic()
        # Views complain while their data arrive; only complaints that stay count.
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


def main(arguments: Sequence[str]) -> int:
    """Run `take` with the command line's arguments; return the exit code."""
    program, recording, picture, moment = arguments
    try:
        reason = take(Path(program), Path(recording), Path(picture), moment=float(moment))
    except Exception as error:  # noqa: BLE001 - whatever the viewer's client raises is the reason asked for
        reason = f"the viewer failed: {' '.join(str(error).split())}"
    if reason:
        sys.stdout.write(reason + "\n")
    return 1 if reason else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
