"""Films: what they show, and that they are the same each time."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dpcontrol.judge.run_view import PlanView, RunView
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


def middle_of(frame: Image.Image, colour: str) -> tuple[float, float]:
    pixels = np.asarray(frame.crop((0, 60, frame.width, 400))).astype(int)
    rows, columns = np.nonzero(np.abs(pixels - style.rgb(colour)).max(axis=-1) < 12)
    return float(columns.mean()), float(rows.mean())


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
    for k in (0, 20, 40):
        at = view.state[film.rows[k], 4]
        place = film.scene.transData.transform((at, 0.0))[0]
        assert middle_of(film.frame(k), style.CART)[0] == pytest.approx(place, abs=8.0)
    # At first both arms hang, later the outer arm's bob is elsewhere.
    tip = [middle_of(film.frame(k), style.arm_colour(1)) for k in (0, 12)]
    assert tip[0][1] > tip[1][1] + 20
