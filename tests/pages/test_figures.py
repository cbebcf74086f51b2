"""Figures and reviews of an atlas: drawn whole, with words, and refused with a sentence."""

import json
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.pages.atlas import draw_atlas
from dpcontrol.pages.atlas_flights import FLIGHT
from dpcontrol.pages.atlas_parts import colours, connections_of, kind_of, one_of_each, stable_direction
from dpcontrol.pages.atlas_recording import write_atlas_recording
from dpcontrol.pages.figures import FIGURES, draw_figures
from dpcontrol.pages.gallery import Gallery
from dpcontrol.pages.panels import wrapped_runs
from dpcontrol.pages.picture import viewer_program, write_picture
from dpcontrol.pages.style import in_pi
from dpcontrol.plans.atlas import AtlasSettings, compute_atlas, make_atlas, make_branches
from dpcontrol.plans.model import load_model
from tests.command_line import dpcontrol

LATER = ("double-homoclinics", "triple-homoclinics", "three-body")
FEW_ENERGIES = {
    ("down-up", "down-up"): (-0.145, -0.138),
    ("up-down", "up-down"): (0.1775, 0.1790),
    ("down-up", "up-down"): (0.1880, 0.1890),
}
"""In J, about a first event of each kind of connection: whole sweeps take minutes."""
LEAST_BYTES = 20_000  # of a PNG: empty axes of these sizes take about 8,000


@pytest.fixture(scope="module")
def low():
    return compute_atlas(load_model("lab"), -0.07)


@pytest.fixture(scope="module")
def gallery():
    """As the verb makes it; atlases are shared with it through the session's cache."""
    return Gallery(
        system=lambda name: load_model(name).system,
        atlas=lambda name, energy, hits: make_atlas(load_model(name), energy, settings=AtlasSettings(hits=hits)).atlas,
        branches=lambda name, source, target, told: make_branches(
            load_model(name), source, target, energies=FEW_ENERGIES[source, target], samples=3, progress=told
        ),
    )


def size_of(picture):
    """Return width and height that a PNG's header gives."""
    content = picture.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", content[16:24])


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in FIGURES if n not in LATER])
def test_every_figure_is_drawn_with_a_caption_and_its_differences(name, gallery, tmp_path):
    (drawn,) = draw_figures([name], gallery, tmp_path)
    assert drawn.file == tmp_path / f"{name}.png"
    assert min(size_of(drawn.file)) > 300
    assert drawn.file.stat().st_size > LEAST_BYTES
    words = json.loads((tmp_path / "captions.json").read_text())
    assert words == {name: {"file": f"{name}.png", "caption": drawn.caption, "differs": drawn.differs}}
    assert len(drawn.caption) > 100
    assert len(drawn.differs) > 50


@pytest.mark.slow
def test_the_drawn_atlas_shows_every_flight_in_space(low):
    figure = draw_atlas(low)
    space = next(axes for axes in figure.axes if axes.name == "3d")
    flights = [line.get_data_3d() for line in space.lines if line.get_color() == FLIGHT]
    assert len(flights) == len(low.connections) == 8
    for drawn, c in zip(flights, low.connections, strict=True):
        assert np.array_equal(np.array(drawn).T, c.states[:, [0, 1, 2]])


@pytest.mark.slow
@pytest.mark.parametrize("name", LATER)
def test_figures_of_later_hits_are_drawn(name, gallery, tmp_path):
    (drawn,) = draw_figures([name], gallery, tmp_path)
    assert drawn.file.stat().st_size > LEAST_BYTES


@pytest.mark.slow
def test_sweeps_report_how_far_a_figure_is(gallery, tmp_path):
    def halfway(*arguments):
        arguments[-1]("swept", 0.5)
        return gallery.branches(*arguments)

    told = []
    draw_figures(
        ["energy-landscape", "branches"],
        replace(gallery, branches=halfway),
        tmp_path,
        progress=lambda what, done: told.append((what, done)),
    )
    shares = [done for what, done in told if what == "swept"]
    # The second of two figures, each of its three sweeps half done.
    assert shares == pytest.approx([7 / 12, 9 / 12, 11 / 12])


@pytest.mark.slow
def test_captions_of_figures_drawn_before_are_kept_in_the_papers_order(gallery, tmp_path):
    draw_figures(["graph"], gallery, tmp_path)
    draw_figures(["energy-landscape"], gallery, tmp_path)
    assert list(json.loads((tmp_path / "captions.json").read_text())) == ["energy-landscape", "graph"]
    (tmp_path / "captions.json").write_text("damaged")
    draw_figures(["energy-landscape"], gallery, tmp_path)
    assert list(json.loads((tmp_path / "captions.json").read_text())) == ["energy-landscape"]


def test_an_unknown_figure_is_rejected_before_anything_is_drawn(gallery, tmp_path):
    with pytest.raises(InputError, match="there is no figure 'tube'"):
        draw_figures(["energy-landscape", "tube"], gallery, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_verb_prints_the_captions_and_accepts_every_name(tmp_path):
    done = dpcontrol("figures", "energy-landscape", "--out", tmp_path, "--json")
    assert done.code == 0
    assert [f["name"] for f in done.document["figures"]] == ["energy-landscape"]
    # Lines break after hyphens too.
    listed = "".join(dpcontrol("figures", "--help").stdout.split())
    assert all(name in listed for name in FIGURES)
    assert dpcontrol("figures", "nonsense").code == 2


def test_a_circle_wrapped_into_a_period_is_split_at_the_edges():
    t = np.linspace(0, 2 * np.pi, 400)
    circle = np.column_stack([3 + np.cos(t), np.sin(t)])
    runs = wrapped_runs(circle, (2 * np.pi, None))
    assert len(runs) == 3
    step = np.abs(np.diff(circle, axis=0)).max()
    assert all(np.abs(run[:, 0]).max() <= np.pi + step for run in runs)
    assert all(np.abs(np.diff(run, axis=0)).max() < 2 * step for run in runs)


def test_angles_are_written_in_units_of_pi():
    assert [in_pi(v) for v in (0.0, 1.0, -1.0, 0.5, -2.0)] == ["0", "π", "−π", "0.5π", "−2π"]


def test_mirror_images_share_a_colour_and_different_connections_do_not(low):
    connections = low.between("down-up", "down-up")
    look = colours(connections)
    kept = one_of_each(connections)
    # Two symmetric ones and one pair, in either sense.
    assert len(kept) == 3
    assert len({look[c.name] for c in kept}) == 3
    for c in connections:
        for d in connections:
            same = abs(c.transversality_angle - d.transversality_angle) < 1e-6
            assert (look[c.name] == look[d.name]) == same


def test_connections_lie_on_cuts_crossed_in_the_same_direction(low):
    kind = kind_of(low, "down-up", "down-up")
    cut = low.cut("down-up", kind.section, 1)
    for c in connections_of(low, kind):
        on = [
            {sign(p) for p in cut.pieces if np.linalg.norm(points(p) - c.point, axis=1).min() < 0.05}
            for points, sign in (
                (lambda p: p.points, lambda p: p.direction),
                (lambda p: p.stable_points, lambda p: stable_direction(low, cut, p.direction)),
            )
        ]
        assert on[0] & on[1]


def test_the_recording_of_an_atlas_is_verified_by_the_viewers_own_tool_and_holds_everything(low, tmp_path):
    write_atlas_recording(low, tmp_path / "a.rrd")
    program = viewer_program()
    assert program is not None
    for verb in (["rrd", "verify"], ["rrd", "print"]):
        done = subprocess.run(
            [str(program), *verb, str(tmp_path / "a.rrd")], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr
    for path in ("/space/orbits/down_up", "/space/tubes/down_up/hit_1", "/sections/down_up_to_down_up_1_1"):
        assert path in done.stdout
    assert done.stdout.count("/now") >= len(low.connections)


@pytest.mark.slow
def test_a_model_without_connections_can_be_reviewed(tmp_path, monkeypatch):
    triple = compute_atlas(load_model("triple"), 0.0)
    write_atlas_recording(triple, tmp_path / "a.rrd")
    picture = write_picture(triple, tmp_path / "a.png")
    assert picture.stat().st_size > LEAST_BYTES


@pytest.mark.slow
def test_the_review_verb_opens_an_atlas_and_rejects_other_archives(low, tmp_path, monkeypatch):
    assert dpcontrol("atlas", "lab", "--energy", "-0.07", "--out", tmp_path / "low.npz").code == 0
    files: list[str | Path] = [tmp_path / "low.npz", "--save", tmp_path / "low.rrd", "--picture", tmp_path / "low.png"]
    done = dpcontrol("review", *files, "--json")
    assert done.code == 0
    assert (tmp_path / "low.png").stat().st_size > LEAST_BYTES
    assert (tmp_path / "low.rrd").is_file()
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    refused = dpcontrol("review", tmp_path / "other.npz", "--picture", tmp_path / "b.png")
    assert refused.code == 2
    assert "is not an atlas of dpcontrol" in refused.message
