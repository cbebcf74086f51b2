"""Films: what they show, that they are the same each time, and what is refused."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.run_view import PlanView, RunView, Stay
from dpcontrol.pages import style
from dpcontrol.pages.film import RATE, Film, write_film


def swinging(seconds: float = 4.0, **more) -> RunView:
    """Return a view of two arms on a cart that turns evenly and drifts to the right, ahead of its reference."""
    time = np.arange(0.0, seconds, 0.01)
    state = np.zeros((len(time), 6))
    state[:, 0], state[:, 1], state[:, 4] = 2.0 * time, 3.0 * time, 0.05 * time
    behind = state - np.array([0.4, 0.4, 0, 0, 0, 0])
    plan = PlanView(symbols=((1.0, "down-up +"),), duration=seconds)
    return RunView(
        path=Path(), title="A turn", time=time, state=state, what="plant", arm_lengths=(0.2, 0.3), has_cart=True,
        rate_hz=100.0, reference=behind, limits=(0.4, 3.0, 30.0), plan=plan, **more,
    )  # fmt: skip


def frames_of(file) -> list[Image.Image]:
    with Image.open(file) as film:
        found = []
        for k in range(film.n_frames):
            film.seek(k)
            found.append(film.convert("RGB").copy())
        return found


def middle_of(frame: Image.Image, colour: str) -> tuple[float, float]:
    """Return the mean place of a colour's pixels above the story."""
    pixels = np.asarray(frame.crop((0, 60, frame.width, 400))).astype(int)
    rows, columns = np.nonzero(np.abs(pixels - style.rgb(colour)).max(axis=-1) < 12)
    return float(columns.mean()), float(rows.mean())


def has_arms(frame: Image.Image) -> bool:
    return bool((np.abs(np.asarray(frame).astype(int) - style.rgb(style.arm_colour(0))).max(axis=-1) < 12).any())


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_lasts_as_long_as_the_motion_and_is_the_same_each_time(tmp_path, suffix) -> None:
    one, two = (write_film(swinging(0.4), tmp_path / f"{name}{suffix}") for name in "ab")
    assert one.read_bytes() == two.read_bytes()
    with Image.open(one) as film:
        assert film.n_frames == round(0.39 * RATE) + 1
        film.load()
        assert film.info["duration"] == pytest.approx(1000 / RATE)


def test_arms_and_cart_are_at_the_position_of_the_state(tmp_path) -> None:
    view = swinging(2.0)
    film = Film(view, (0.0, 1.99))
    scene = film.still[1]
    for k in (0, 20, 40):
        at = view.state[film.rows[k], 4]
        place = scene.transData.transform((at, 0.0))[0] / 2
        assert middle_of(film.frame(k), style.CART)[0] == pytest.approx(place, abs=8.0)
    # At first both arms hang, later the outer arm's bob is elsewhere.
    tip = [middle_of(film.frame(k), style.arm_colour(1)) for k in (0, 12)]
    assert tip[0][1] > tip[1][1] + 20


def test_a_part_is_selected_and_a_gap_is_marked(tmp_path) -> None:
    view = swinging(4.0)
    view.state[200:] = np.nan
    file = write_film(view, tmp_path / "part.gif", stretch=(1.8, 2.6))
    frames = frames_of(file)
    assert len(frames) == 21
    assert has_arms(frames[0])
    assert not has_arms(frames[-1])


def test_a_file_that_is_not_a_film_is_rejected_in_one_sentence(tmp_path) -> None:
    with pytest.raises(InputError, match=r"a film is a \.gif, \.webp or \.mp4 file"):
        write_film(swinging(), tmp_path / "a.avi")
    with pytest.raises(InputError, match=r"lasts from 0\.00 to 3\.99 s"):
        write_film(swinging(), tmp_path / "a.gif", stretch=(3.0, 2.0))
    with pytest.raises(InputError, match="and this system has none"):
        write_film(replace(swinging(), arm_lengths=()), tmp_path / "a.gif")
    assert not list(tmp_path.iterdir())


def test_a_motion_without_angles_or_shorter_than_a_frame_is_rejected(tmp_path) -> None:
    blank = swinging()
    blank.state[:] = np.nan
    with pytest.raises(InputError, match="holds no angles"):
        write_film(blank, tmp_path / "a.gif")
    with pytest.raises(InputError, match=r"shorter than the 0\.04 s of a frame"):
        write_film(swinging(), tmp_path / "a.gif", stretch=(1.0, 1.01))
    assert not list(tmp_path.iterdir())


def test_a_recording_slower_than_the_film_has_its_pose_in_every_frame() -> None:
    fast = swinging(4.0)
    slow = replace(fast, time=fast.time[::25], state=fast.state[::25], reference=fast.reference[::25], rate_hz=4.0)
    assert (Film(slow, slow.time_range).rows >= 0).all()


def test_symbols_outside_the_stretch_are_neither_numbered_nor_named() -> None:
    stay = Stay(0.0, 3.99, "down-up", "down-up")
    symbols = ((0.5, "before"), (1.5, "within"), (2.5, "after"))
    view = replace(swinging(), plan=PlanView(symbols=symbols, planned=(stay,), duration=4.0))
    told = Film(view, (1.0, 2.0)).still[2]
    assert told is not None
    assert {text.get_text() for text in told.texts} - {"down-up"} == {"2", "within"}


def test_a_film_that_is_too_long_is_rejected_with_the_option_for_a_part(tmp_path) -> None:
    hours = replace(swinging(), time=np.linspace(0.0, 1e4, 400), rate_hz=0.04)
    with pytest.raises(InputError, match=r"a\.gif of 10000 s \(--stretch takes a part\): 250,001 frames will take"):
        write_film(hours, tmp_path / "a.gif")


def test_an_mp4_is_reproducible_or_its_missing_part_is_named(tmp_path, monkeypatch) -> None:
    pytest.importorskip("imageio_ffmpeg")
    one, two = (write_film(swinging(0.2), tmp_path / f"{name}.mp4") for name in "ab")
    assert one.read_bytes() == two.read_bytes()
    assert one.read_bytes()[4:8] == b"ftyp"
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'dpcontrol\[film\]'"):
        write_film(swinging(0.2), tmp_path / "c.mp4")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


@pytest.mark.slow
def test_ten_seconds_stay_within_three_megabytes(tmp_path) -> None:
    """Slow: 250 frames in each of two formats, of arms that turn all the time, the most that can change."""
    for suffix in (".gif", ".webp"):
        assert write_film(swinging(10.0), tmp_path / f"ten{suffix}").stat().st_size <= 3e6


CUT = """#!{python}
import subprocess, sys
done = subprocess.run(["{ffmpeg}", *sys.argv[1:]])
if sys.argv[-1].endswith(".mp4"):
    with open(sys.argv[-1], "r+b") as file:
        file.truncate(file.seek(0, 2) // 2)
sys.exit({code})
"""


@pytest.mark.parametrize("code", [0, 1])
def test_a_film_that_ffmpeg_cannot_finish_is_an_error_and_leaves_nothing(tmp_path, monkeypatch, code) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    ffmpeg = tmp_path / "bin" / "ffmpeg"
    ffmpeg.parent.mkdir()
    ffmpeg.write_text(CUT.format(python=sys.executable, ffmpeg=imageio_ffmpeg.get_ffmpeg_exe(), code=code))
    ffmpeg.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(ffmpeg))
    with pytest.raises(InputError, match=r"film\.mp4: ffmpeg wrote 0 of 5 frames"):
        write_film(swinging(0.16), tmp_path / "film.mp4")
    assert [file.name for file in tmp_path.iterdir()] == ["bin"]
