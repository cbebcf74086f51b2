"""The planner's speed on an idle machine, and the film of it in README: run by `pytest -m benchmark tests/planner`.

DPCONTROL_STORE_FILM=1 replaces the film in README.
"""

import io
import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from browser_page import Page
from PIL import Image

pytest.importorskip("starlette")
pytest.importorskip("selenium")
from selenium.webdriver.common.keys import Keys

pytestmark = pytest.mark.benchmark
ENERGY, CONNECTIONS = "0.2", ("down-up>up-down", "up-down>down-up")
"""Energy, J, and the ends of the connections of the planned walk."""
CLICKS, SECONDS = 12, 60.0
"""Bounds from the first click to a saved itinerary, if the atlas is cached."""
ANSWER, INTERVAL = 0.2, 0.018
"""Bounds on the answer to a click and on the median interval between changed frames, s."""
WATCHED = 10.0
"""Time for which changed frames are counted, s."""
FILM = Path(__file__).parents[2] / ".assets" / "planner.webp"
RATE = 10
"""Frames per second of the film."""
LONGEST, LARGEST = 15.5, 4_000_000
"""Bounds on the film's duration, s, and size, bytes."""

ANSWERED = """
const done = arguments[1], begin = performance.now(), before = JSON.stringify(window.planner.state.wraps);
document.querySelector(arguments[0]).click();
(function wait() {
  const { wraps, busy } = window.planner.state;
  if (!busy && JSON.stringify(wraps) !== before) done(performance.now() - begin);
  else setTimeout(wait, 1);
})();"""
INTERVALS = """
const [seconds, done] = arguments, canvas = document.getElementById("stage"), begin = performance.now(), found = [];
const pen = canvas.getContext("2d", { willReadFrequently: true });
let shown = null, last = begin;
requestAnimationFrame(function look(now) {
  const pixels = new Uint32Array(pen.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  const sum = pixels.reduce((sum, pixel, place) => (31 * sum + pixel + place) | 0, 0);
  if (sum !== shown) found.push(now - last);
  if (sum !== shown) last = now;
  shown = sum;
  if (now - begin < 1000 * seconds) requestAnimationFrame(look);
  else done(found.slice(1).sort((a, b) => a - b)[Math.floor(found.length / 2)]);
});"""


def test_a_saved_itinerary_takes_few_clicks_and_a_minute_and_arms_move_smoothly(page: Page) -> None:
    page.driver.set_script_timeout(60)
    begin, clicks = time.monotonic(), 4 + len(CONNECTIONS)
    page.type("energy", ENERGY)
    for ends in CONNECTIONS:
        page.connect(ends)
    page.press("wraps-plus")
    assert page.press("plan")["plan"]["converged"]
    page.type("mismatch", "5" + Keys.TAB)
    assert page.press("run")["run"]["completed"]
    page.press("save")
    assert clicks <= CLICKS
    seconds = time.monotonic() - begin
    assert seconds <= SECONDS
    answer = page.driver.execute_async_script(ANSWERED, '[data-role="wraps-plus"]')
    assert answer <= 1e3 * ANSWER
    page.idle()
    interval = page.driver.execute_async_script(INTERVALS, WATCHED)
    sys.stdout.write(f"{clicks} clicks, {seconds:.1f} s; answer {answer:.0f} ms, frames {interval:.1f} ms apart\n")
    assert interval is not None
    assert interval <= 1e3 * INTERVAL


# Replaces the page's clock by one that the recorder advances, and adds a visible pointer.
STEPPED = """
const waiting = [];
let now = 0;
window.requestAnimationFrame = (act) => waiting.push(act);
window.advance = (milliseconds) => {
  now += milliseconds;
  waiting.splice(0).forEach((act) => act(now));
};
window.pointer = (x, y, pressed) => {
  document.getElementById("pointer")?.remove();
  const made = document.createElement("div");
  made.id = "pointer";
  made.style.cssText = `position: fixed; z-index: 9; pointer-events: none; left: ${x - 9}px; top: ${y - 9}px;
    width: 18px; height: 18px; border-radius: 9px; border: 2px solid #c2185b;
    background: ${pressed ? "#c2185b" : "#c2185b40"}`;
  document.body.append(made);
};"""
PLACE = """
arguments[0].scrollIntoView({ block: "nearest" });
const { left, top, width, height } = arguments[0].getBoundingClientRect();
return [left + width / 2, top + height / 2];"""


class Recorder:
    """A film of the page, frame by frame, with its own clock."""

    def __init__(self, page: Page) -> None:
        self.page, self.at = page, (640.0, 420.0)
        self.frames: list[Image.Image] = []

    def record(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE)):
            self.page.driver.execute_script("advance(arguments[0])", 1000 / RATE)
            picture = Image.open(io.BytesIO(self.page.driver.get_screenshot_as_png()))
            self.frames.append(picture.convert("RGB"))

    def move(self, to: tuple[float, float]) -> None:
        (x, y), steps = self.at, 4
        for k in range(1, steps + 1):
            share = k / steps
            place = (x + share * (to[0] - x), y + share * (to[1] - y))
            self.page.driver.execute_script("pointer(...arguments)", *place, False)
            self.mouse("mouseMoved", place)
            self.record(1 / RATE)
        self.at = to

    def mouse(self, kind: str, place: tuple[float, float]) -> None:
        event = {"type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1}
        self.page.driver.execute_cdp_cmd("Input.dispatchMouseEvent", event)

    def press(self, element: Any, *, rest: float = 0.0, after: float = 0.5) -> None:
        """Move to an element, rest, click it, and record the answer."""
        self.move(tuple(self.page.driver.execute_script(PLACE, element)))
        self.record(rest)
        self.page.driver.execute_script("pointer(...arguments)", *self.at, True)
        self.mouse("mousePressed", self.at)
        self.mouse("mouseReleased", self.at)
        self.record(2 / RATE)
        self.page.driver.execute_script("pointer(...arguments)", *self.at, False)
        self.page.idle()
        self.record(after)


def test_the_film_in_readme_shows_the_planner_in_use(page: Page, tmp_path: Path) -> None:
    page.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": STEPPED})
    page.driver.refresh()
    page.type("energy", ENERGY)
    recorder = Recorder(page)
    recorder.record(0.5)
    for ends in CONNECTIONS:
        recorder.press(page.role("connection", f'[data-name^="{ends}"]'), rest=1.2, after=0.2)
    recorder.press(page.role("wraps-plus", '[data-stop="0"]'))
    recorder.press(page.role("plan"), after=2.2)
    page.type("mismatch", "5" + Keys.TAB)
    recorder.press(page.role("run"), after=3.0)
    recorder.press(page.role("seeds"), after=0.8)
    recorder.press(page.role("save"), after=1.2)
    assert page.state["saved"]
    film = FILM if os.environ.get("DPCONTROL_STORE_FILM") == "1" else tmp_path / FILM.name
    first, *rest = recorder.frames
    first.save(film, save_all=True, append_images=rest, duration=1000 // RATE, loop=0, quality=60, method=2)
    assert len(recorder.frames) / RATE <= LONGEST
    assert film.stat().st_size <= LARGEST
