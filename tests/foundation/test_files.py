"""Files are complete or absent, and one command at a time writes them."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import InTheWay, claimed, write_folder, write_whole
from dpcontrol.logs import LogWriter
from dpcontrol.logs.container import McapFile


def write_log(path: Path) -> None:
    with LogWriter(path, arm_lengths=(0.1, 0.2), rate_hz=100.0, has_cart=False):
        pass


@pytest.mark.parametrize("write", [lambda p: write_whole(p, "whole"), lambda p: write_folder(p, {"a": "b"}), write_log])
def test_a_full_disk_leaves_no_file(
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
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


CLAIMING = """
import sys
from pathlib import Path
from dpcontrol.foundation.files import claimed
with claimed(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="files are opened exclusively on POSIX systems only")
def test_a_second_writer_is_refused_until_the_first_ends_or_is_killed(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    for ends in ("is killed", "ends"):
        with subprocess.Popen([sys.executable, "-c", CLAIMING, str(file)], **pipes) as first:
            assert first.stdout.readline() == "claimed\n"
            with pytest.raises(InTheWay, match="another dpcontrol command is writing it"), claimed(file):
                pass
            if ends == "is killed":
                first.kill()
            first.communicate()
        with claimed(file):
            pass
    assert not list(tmp_path.iterdir())
