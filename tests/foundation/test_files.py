"""Files are complete or absent, and temporary files of killed writers are removed."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_folder, write_whole
from dpcontrol.logs import LogWriter
from dpcontrol.logs.container import McapFile


def write_log(path: Path) -> None:
    with LogWriter(path, arm_lengths=(0.1, 0.2), rate_hz=100.0, has_cart=False):
        pass


@pytest.mark.parametrize("write", [lambda p: write_whole(p, "whole"), lambda p: write_folder(p, {"a": "b"}), write_log])
def test_a_full_disk_leaves_no_new_folders(
    write: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for owner, name in ((Path, "write_bytes"), (Path, "write_text"), (McapFile, "add_metadata")):
        monkeypatch.setattr(owner, name, full)
    (tmp_path / "old").mkdir()
    for place in ("new/deep/file", "old/file"):
        with pytest.raises(InputError, match=os.strerror(errno.ENOSPC)):
            write(tmp_path / place)
    assert [path.name for path in tmp_path.rglob("*")] == ["old"]


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
