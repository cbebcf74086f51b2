"""The cache returns only what was stored, and its failures are never fatal."""

import errno
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from dpcontrol.foundation.cache import KINDS, cache_contents, cache_file, keep, kept, load_or_make
from dpcontrol.foundation.errors import Remark

KEY = "0123456789abcdef"
COMPILER = "heyoka"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_content_is_read_back_and_counts_as_absent_if_truncated_changed_or_renamed(root: Path) -> None:
    file, other = cache_file("plans", "turn", KEY), cache_file("plans", "cross", KEY)
    assert kept(file) is None
    keep(file, b"states 1.0 2.0")
    assert kept(file) == b"states 1.0 2.0"
    assert [*file.parent.iterdir()] == [file]
    whole = file.read_bytes()
    other.write_bytes(whole)
    assert kept(other) is None
    for damaged in (b"", whole[:-1], whole + b"\n", whole.replace(b"1.0", b"1.5"), b"states 1.5 2.0"):
        file.write_bytes(damaged)
        assert kept(file) is None


def test_an_object_is_made_once_and_made_again_if_its_file_cannot_be_read(root: Path) -> None:
    file, made = cache_file("controllers", "law", KEY), iter(({"gain": 1.5}, {"gain": 2.5}))
    assert load_or_make(file, lambda: next(made)) == {"gain": 1.5}
    assert load_or_make(file, lambda: next(made)) == {"gain": 1.5}
    keep(file, b"no pickle")
    assert load_or_make(file, lambda: next(made)) == {"gain": 2.5}


def test_without_a_writable_cache_results_are_recomputed_with_one_remark(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("default", Remark)
        for kind in KINDS:
            keep(cache_file(kind, "turn", KEY), b"content")
    (remark,) = made
    assert os.strerror(errno.ENOSPC) in str(remark.message)
    assert not [file for file in root.rglob("*") if file.is_file()]


def test_emptying_the_cache_keeps_files_of_other_programs(root: Path) -> None:
    for kind in KINDS:
        keep(cache_file(kind, "turn", KEY), b"content")
    half = root / "plans" / f".turn-{KEY}.npz.x3_y.partial"
    others = [root / "notes.txt", root / "plans" / "thesis.npz", root / "logs" / f"turn-{KEY}.npz"]
    for file in (half, *others):
        file.parent.mkdir(exist_ok=True)
        file.write_text("mine")
    found = cache_contents()
    assert found.entries == len(KINDS) + 1
    assert found.bytes == sum(f.stat().st_size for f in root.rglob(f"*{KEY}*") if f not in others)
    assert cache_contents(clear=True).kinds == found.kinds
    assert cache_contents().entries == 0
    assert all(file.read_text() == "mine" for file in others)


def test_heyokas_machine_code_is_stored_listed_and_deleted_with_the_cache(root: Path) -> None:
    compiles = "from dpcontrol.dynamics.compiled import hy; x = hy.make_vars('x'); hy.cfunc([x * x], [x])"
    env = {**os.environ, "DPCONTROL_CACHE": str(root), "XDG_CACHE_HOME": "", "HOME": str(root.parent / "home")}
    subprocess.run([sys.executable, "-c", compiles], env=env, check=True)
    assert not (root.parent / "home").exists()
    size = (root / COMPILER / "cache.db").stat().st_size
    assert cache_contents().kinds[COMPILER] == (1, size)
    cache_contents(clear=True)
    assert not any((root / COMPILER).iterdir())
