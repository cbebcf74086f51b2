"""Without heyoka, which pip has only for Linux, everything works except the search for new orbits.

The same applies without the extras and without POSIX features. Each verb runs in a program that starts without
these modules, and so do those that it starts itself. No test here replaces one on Windows or macOS.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_recordings import rig_variables, table_columns, write_csv, write_mat
from command_line import Ended, dpcontrol

from dpcontrol.dynamics import compiled
from dpcontrol.dynamics.chain import Level, equations_of
from dpcontrol.plans.model import load_model

WITHOUT = """
import io, json, sys
from contextlib import redirect_stderr, redirect_stdout
from dpcontrol.cli.main import main

ended = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as end:
            ended.append((end.code, out.getvalue(), err.getvalue()))
print(json.dumps(ended))
"""
"""Verbs one after the other, in one program: each would take a second to start."""
HEYOKA = ("heyoka",)


def without(modules: tuple[str, ...], folder: Path, *lines: str) -> list[Ended]:
    """Call the program in `folder` for each line, without access to these modules."""
    site = folder / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(f"import sys\nsys.modules |= dict.fromkeys({modules!r})\n")
    path = os.pathsep.join([str(site), str(Path(compiled.__file__).parents[2])])
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, json.dumps([line.split() for line in lines])],
        cwd=folder, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [Ended(*one) for one in json.loads(done.stdout)]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plan in a file and in the cache, made where heyoka is."""
    folder = tmp_path_factory.mktemp("bench")
    assert dpcontrol("plan", "outer-turn", "--out", folder / "turn.npz").code == 0
    return folder


@pytest.mark.slow  # Half a minute: every verb that the sentence below is not for.
def test_all_that_needs_no_new_orbit_works(bench: Path) -> None:
    lines = [
        "plan outer-turn --json",
        "run outer-turn --seed 3 --rate 500 --out here.mcap --json",
        "score here.mcap --json",
        "run --from here.mcap --out again.mcap --json",
        "review here.mcap --save here.rrd --json",
        "report here.mcap --picture here.pdf --json",
        "info here.mcap --json",
        "recover here.mcap --json",
        "campaign turn.npz --runs 2 --set rate=500 --out turn.parquet --json",
        "report turn.parquet --picture campaign.png --json",
        "export turn.npz --out controller --json",
        "cache --json",
        "import swing.mat --out mat.mcap --json",
        "replay mat.mcap --json",
        "identify mat.mcap --no-zeros --out models/own.toml --json",
        "model own --json",
    ]
    write_mat(bench / "swing.mat", rig_variables(segments=3))
    ended = dict(zip(lines, without(HEYOKA, bench, *lines), strict=True))
    assert {line: one.stderr for line, one in ended.items() if one.code} == {}
    assert "tubes along the way are not shown" in ended[lines[4]].stderr
    assert (bench / "controller" / "Makefile").is_file()
    # The same run but for rounding, which the seconds on an unstable orbit enlarge.
    here, there = (
        ended[lines[2]].document,
        dpcontrol(*lines[1].replace("here", str(bench / "there")).split()).document,
    )
    assert here["completed"]
    assert here["rms_tracking_error"] == pytest.approx(there["rms_tracking_error"], rel=0.05)
    assert here["max_cart_position"] == pytest.approx(there["max_cart_position"], rel=1e-3)


@pytest.mark.slow
def test_a_request_for_an_orbit_or_a_plan_names_the_package_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Nothing that another test has computed, and that would do.
    monkeypatch.setenv("DPCONTROL_CACHE", str(tmp_path / "cache"))
    lines = [
        "orbit lab --saddle down-up --energy -0.07",
        "connect lab --from down-up --to down-up --energy -0.07",
        "bifurcations lab --from down-up --to down-up --energies -0.11 -0.09 --samples 6",
        "atlas lab --energy -0.07",
        "walk lab --energy -0.07 --length 3 --from down-up --to down-up",
        "plan cross --fresh",
        "run round-trip",
    ]
    for ended in without(HEYOKA, tmp_path, *lines):
        assert ended.code == 2
        assert "conda install -c conda-forge heyoka.py" in ended.message


@pytest.mark.parametrize("points", [(), (8,)])
def test_casadis_virtual_machine_agrees_with_the_compiled_code(points: tuple[int, ...]) -> None:
    arms = load_model("lab").arms
    function = compiled.fixed_step(equations_of(arms, Level.CART))
    step = compiled.Compiled(function)
    inputs = np.random.default_rng(0).normal(size=(step.size_in, *points))
    for name, value in (("duration", np.array([1e-3])), ("parameters", np.array(arms.base()))):
        inputs[step.slices[name]] = value.reshape(-1, *[1] * len(points))
    expected = step(inputs, np.empty((step.size_out, *points)))
    found = compiled._ByCasadi(function)(inputs, np.empty((step.size_out, *points)))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


EXTRAS = ("rerun", "rerun_cli", "rerun_bindings", "psutil", "pyarrow", "matio", "h5py", "pandas")
POSIX = ("fcntl", "resource", "pwd", "grp", "termios")


@pytest.mark.slow  # Six seconds: nine verbs.
def test_without_extras_and_posix_all_else_works_and_a_sentence_names_the_extra(bench: Path) -> None:
    (bench / "mat.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(1000))
    write_csv(bench / "swing.csv", table_columns())
    lines = {
        "run turn.npz --rate 500 --out bare.mcap": "",
        "score bare.mcap": "",
        "import swing.csv --out swing.mcap": "",
        "review bare.mcap --picture bare.png": "",
        "review bare.mcap": "dpcontrol[viewer]",
        "review bare.mcap --save bare.rrd": "dpcontrol[viewer]",
        "campaign turn.npz --runs 1 --workers 1": "dpcontrol[tables]",
        "import swing.parquet": "dpcontrol[tables]",
        "import mat.mat": "dpcontrol[matlab]",
    }
    (bench / "swing.parquet").write_bytes(b"PAR1")
    ended = without((*EXTRAS, *POSIX, "heyoka"), bench, *lines)
    for (line, extra), one in zip(lines.items(), ended, strict=True):
        assert (line, one.code) == (line, 2 if extra else 0), one.stderr
        assert f"pip install '{extra}'" in one.message if extra else True, one.stderr
    assert (bench / "bare.png").stat().st_size > 100_000
