"""Files are complete or absent, and temporary files of killed writers are removed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dpcontrol.foundation.files import write_whole

WRITING = """
import sys
from pathlib import Path
from dpcontrol.foundation.files import whole_file
with whole_file(Path(sys.argv[1])) as temporary:
    temporary.write_bytes(b"half")
    print(temporary, flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")
def test_temporary_files_of_killed_writers_are_deleted_and_those_of_live_ones_kept(tmp_path: Path) -> None:
    file = tmp_path / "table.parquet"
    (beside := tmp_path / ".table.parquet.notes.partial").write_text("the user's own")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    writers = [subprocess.Popen([sys.executable, "-c", WRITING, str(file)], **pipes) for _ in range(2)]
    try:
        killed, living = (Path(writer.stdout.readline().strip()) for writer in writers)
        writers[0].send_signal(signal.SIGKILL)
        writers[0].wait()
        assert killed.exists()
        write_whole(file, b"whole")
        assert (killed.exists(), living.exists(), beside.exists()) == (False, True, True)
        assert file.read_bytes() == b"whole"
        writers[1].communicate()
        assert file.read_bytes() == b"half"
    finally:
        for writer in writers:
            writer.kill()
    assert sorted(tmp_path.iterdir()) == [beside, file]
