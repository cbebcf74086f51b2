"""The planner's speed on an idle machine: run by `pytest -m benchmark tests/planner`."""

import sys
import time

import pytest
from browser_page import Page

pytest.importorskip("websockets")
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
