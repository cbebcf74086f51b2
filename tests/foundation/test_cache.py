"""The cache returns only what was stored, and its failures are never fatal."""

import errno
import io
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from command_line import dpcontrol

from dpcontrol.foundation import cache as store
from dpcontrol.foundation.cache import KINDS, cache_contents, cache_file, compiler_folder, keep, kept
from dpcontrol.foundation.errors import Remark

KEY = "0123456789abcdef"
COMPILER = "heyoka"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize("content", [b"", b"orbits", bytes(range(256)) * 40])
def test_stored_content_is_read_back(content: bytes, root: Path) -> None:
    file = cache_file("atlases", "lab", KEY)
    assert kept(file) is None
    keep(file, content)
    assert kept(file) == content
    assert os.listdir(file.parent) == [file.name]


def test_truncated_changed_or_renamed_content_counts_as_absent(root: Path) -> None:
    file, other = cache_file("plans", "turn", KEY), cache_file("plans", "cross", KEY)
    keep(file, b"states 1.0 2.0")
    whole = file.read_bytes()
    other.write_bytes(whole)
    assert kept(other) is None
    for damaged in (b"", whole[:-1], whole + b"\n", whole.replace(b"1.0", b"1.5"), b"states 1.5 2.0"):
        file.write_bytes(damaged)
        assert kept(file) is None
    file.unlink()
    file.mkdir()
    assert kept(file) is None


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_without_a_writable_cache_results_are_recomputed_with_one_remark(
    reason: int, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> int:
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr(Path, "write_bytes", full)
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("default", Remark)
        for kind in KINDS:
            keep(cache_file(kind, "turn", KEY), b"content")
    (remark,) = made
    assert os.strerror(reason) in str(remark.message)
    assert "set DPCONTROL_CACHE" in str(remark.message)
    assert not [file for file in root.rglob("*") if file.is_file()]


def test_names_of_any_length_and_characters_stay_within_the_cache(root: Path) -> None:
    for name in ("ü" * 300, "../../etc/passwd", "a\0b", "\udcff"):
        file = cache_file("plans", name, KEY)
        assert file.parent == root / "plans"
        keep(file, b"content")
        assert kept(file) == b"content"


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


def test_the_verb_lists_and_empties_the_cache(root: Path) -> None:
    keep(cache_file("plans", "turn", KEY), b"content")
    shown = dpcontrol("cache", "--json").document
    assert shown["folder"] == str(root)
    assert shown["variable"] == "DPCONTROL_CACHE"
    assert shown["kinds"]["plans"]["entries"] == shown["entries"] == 1
    assert set(shown["kinds"]) == {*KINDS, COMPILER}
    assert f"emptied {root}: 1 entry" in dpcontrol("cache", "--clear").stdout
    assert dpcontrol("cache", "--json").document["entries"] == 0


def test_a_missing_cache_is_empty(root: Path) -> None:
    assert cache_contents(clear=True).entries == 0
    assert not root.exists()
    root.write_text("a file")
    assert cache_contents().entries == 0


def test_a_cache_that_cannot_be_emptied_is_reported(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(cache_file("plans", "turn", KEY), b"content")

    def read_only(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(Path, "unlink", read_only)
    ended = dpcontrol("cache", "--clear")
    assert ended.code == 2
    assert "cannot empty the cache" in ended.message
    assert "DPCONTROL_CACHE" in ended.message


def forbidden(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Make the system deny access to a folder, as for users without search permission."""
    plain = os.stat

    def refused(path: object, **options: object) -> os.stat_result:
        if isinstance(path, str | os.PathLike) and folder in Path(path).parents:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return plain(path, **options)

    monkeypatch.setattr(os, "stat", refused)


def test_a_cache_without_search_permission_counts_as_none_with_one_remark(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root.mkdir()
    forbidden(monkeypatch, root)
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("default", Remark)
        for kind in KINDS:
            assert kept(cache_file(kind, "turn", KEY)) is None
            keep(cache_file(kind, "turn", KEY), b"content")
    (remark,) = made
    assert "Permission denied" in str(remark.message)


def test_an_overlong_cache_folder_counts_as_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / ("c" * 300)))
    file = cache_file("plans", "turn", KEY)
    with pytest.warns(Remark, match=os.strerror(errno.ENAMETOOLONG)):
        keep(file, b"content")
    assert kept(file) is None


def test_a_tilde_in_the_variable_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("DPCONTROL_CACHE", "~/kept")
    assert cache_file("plans", "turn", KEY).parent == tmp_path / "kept" / "plans"


def test_a_home_folder_of_nobody_counts_as_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DPCONTROL_CACHE", "~nobody-here/kept")
    with pytest.warns(Remark, match="there is no home folder '~nobody-here'"):
        keep(cache_file("plans", "turn", KEY), b"content")
    with pytest.warns(Remark, match="there is no home folder '~nobody-here'"):
        assert compiler_folder() is None
    assert "there is no home folder '~nobody-here'" in dpcontrol("cache").message
    assert not list(tmp_path.iterdir())


def test_a_file_in_place_of_a_folder_of_the_cache_is_named(root: Path) -> None:
    root.mkdir()
    for kind in ("plans", COMPILER):
        (root / kind).write_text("in the way")
    with pytest.warns(Remark, match=f"{root}/plans is a file instead of a folder of the cache.*; remove it"):
        keep(cache_file("plans", "turn", KEY), b"content")
    with pytest.warns(Remark, match=f"{root}/{COMPILER} is a file instead of a folder of the cache.*; remove it"):
        assert compiler_folder() is None


def test_a_full_disk_of_heyokas_cache_gives_a_remark(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """heyoka itself is silent when its database cannot grow."""

    class Full(io.BytesIO):
        def write(self, data: object) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store, "TemporaryFile", lambda **_: Full())
    with pytest.warns(Remark, match=f"{os.strerror(errno.ENOSPC)}.*free some space"):
        assert compiler_folder() is None


COMPILES = "from dpcontrol.dynamics.compiled import hy; x = hy.make_vars('x'); hy.cfunc([x * x], [x]); print('{}')"


def compiled(folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile a formula in a separate process with an empty home folder."""
    env = {**os.environ, "DPCONTROL_CACHE": str(folder), "XDG_CACHE_HOME": "", "HOME": str(folder.parent / "home")}
    return subprocess.run([sys.executable, "-c", COMPILES], env=env, capture_output=True, text=True, check=True)


def test_heyokas_machine_code_is_stored_listed_and_deleted_with_the_cache(root: Path) -> None:
    compiled(root)
    assert not (root.parent / "home").exists()
    size = (root / COMPILER / "cache.db").stat().st_size
    assert cache_contents().kinds[COMPILER] == (1, size)
    cache_contents(clear=True)
    assert not any((root / COMPILER).iterdir())


@pytest.mark.parametrize("damage", ["database", "folder"])
def test_a_failing_cache_of_heyoka_has_no_effect_on_results(root: Path, damage: str) -> None:
    root.mkdir()
    if damage == "folder":
        (root / COMPILER).write_text("in the way")
    else:
        (root / COMPILER).mkdir()
        (root / COMPILER / "cache.db").write_text("no database " * 100)
    done = compiled(root)
    assert done.stdout == "{}\n"
    assert done.stderr.count("Remark: ") == 1


def test_every_kind_is_written_by_its_module() -> None:
    """All modules use the store, which adds the checksum."""
    package = Path(store.__file__).parents[1]
    users = [file.read_text() for file in package.rglob("*.py") if file.name not in ("cache.py", "api.py")]
    assert {kind for text in users for kind in re.findall(r"cache_file\(\"([\w-]+)\"", text)} == set(KINDS)
    assert not any("cache_root" in text for text in users)
