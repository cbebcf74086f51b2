"""In `.ci/run`, a test is skipped for what its platform lacks, and fails for what could be installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SKIPS = """
import pytest

@pytest.mark.parametrize("reason", ["signals are POSIX's", "some-compiler is not installed"])
def test_needs(reason):
    pytest.skip(reason)

@pytest.mark.xfail
def test_is_wrong():
    raise AssertionError
"""
MODULE = "import pytest\npytest.importorskip('no_such_package')\n"


@pytest.mark.slow  # A session of its own imports what the tests share.
@pytest.mark.parametrize(
    ("strict", "counts"), [("", "3 skipped, 1 xfailed"), ("1", "1 failed, 1 skipped, 1 xfailed, 1 error")]
)
def test_a_skip_for_a_missing_program_or_package_fails_in_ci(tmp_path: Path, strict: str, counts: str) -> None:
    (tmp_path / "test_skips.py").write_text(SKIPS, encoding="utf-8")
    (tmp_path / "test_module.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "pytest.ini").touch()
    tests = Path(__file__).parent
    paths = os.pathsep.join([str(tests), str(tests.parent)])
    environment = {**os.environ, "PYTHONPATH": paths, "PYTEST_ADDOPTS": "", "DPCONTROL_TESTS_STRICT_SKIPS": strict}
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "--continue-on-collection-errors", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert counts in done.stdout, done.stdout + done.stderr
    assert ("some-compiler is not installed" in done.stdout) == bool(strict)
