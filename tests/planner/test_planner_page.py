"""The planner's page in a headless browser, from energy to a saved itinerary that completes."""

import re
from pathlib import Path

import pytest
from browser_page import Page
from PIL import Image

import dpcontrol as dp

pytest.importorskip("websockets")
pytest.importorskip("selenium")
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

pytestmark = pytest.mark.slow
FIRST, SECOND = "down-up>up-down", "up-down>down-up"
READABLE = 4.5
"""Contrast of text of normal size, WCAG 2.2, criterion 1.4.3."""


def test_an_itinerary_is_built_planned_run_and_saved_and_the_command_line_completes_it(page: Page) -> None:
    page.type("energy", "0.2")
    page.connect(FIRST)
    state = page.connect(SECOND)
    assert [name.split("[")[0] for name in state["walk"]] == [FIRST, SECOND]
    wraps = state["wraps"][0]
    assert page.press("wraps-plus", '[data-stop="0"]')["wraps"] == [wraps + 1]
    for end in ("start", "finish"):
        Select(page.role(end)).select_by_value("orbit")
        assert f'{end} = "orbit"' in re.sub(" +", " ", page.idle()["toml"])
    state = page.press("plan")
    assert state["plan"]["converged"], state
    page.type("mismatch", "5" + Keys.TAB)
    state = page.press("run")
    assert state["plan"]
    assert state["run"]["completed"], state["run"]
    page.driver.refresh()
    again = page.idle()
    assert (again["walk"], again["plan"], again["run"]) == (state["walk"], state["plan"], state["run"])
    saved = page.press("save")["saved"]
    assert dp.open_log(saved["log"]).score().completed
    text = Path(saved["toml"]).read_text(encoding="utf-8")
    assert "mismatch      = 0.05" in text
    run = dp.run(saved["toml"])
    assert run.log.attachments["scene.toml"].decode() == text
    assert run.score().completed, run.status
    assert not [entry for entry in page.driver.get_log("browser") if entry["level"] == "SEVERE"]


def on_orbits(text: str) -> str:
    """Return an itinerary of one crossing, without the transfers from rest and to rest that take longest."""
    crossing = text.replace("walk   = []", 'walk = ["down-up > up-down"]')
    return re.sub(r'^(start|finish)(\s*)= "rest"', r'\1\2= "orbit"', crossing, flags=re.MULTILINE)


def test_a_run_is_drawn_filmed_and_repeated_with_twenty_seeds(page: Page) -> None:
    page.type("toml", on_orbits(page.state["toml"]))
    assert page.press("plan")["plan"]["converged"]
    assert page.press("run")["run"]["completed"]
    page.press("page")
    width = "return document.querySelector('#paper[open] img')?.naturalWidth ?? 0"
    assert page.driver.execute_script(width) > 1000
    ActionChains(page.driver).send_keys(Keys.ESCAPE).perform()
    assert not page.all("#paper[open]")
    state = page.press("film")
    with Image.open(state["saved"]["film"]) as film:
        assert film.n_frames / 25 == pytest.approx(state["plan"]["duration"], abs=0.2)
    assert "there is no display" in page.press("rerun")["message"]["text"]
    assert page.role("status").get_attribute("class") == "error"
    assert page.press("seeds")["seeds"]["runs"] == len(page.all("#bar i")) == 20
    assert len(page.all("#bar .good")) == page.state["seeds"]["completed"]


# Lists the controls that another element covers at their centres, and the page's width against the window's.
COVERED = """
const wrong = [...document.querySelectorAll("[data-role]:not([hidden])")].filter((one) => {
  if (one.closest("[hidden]")) return false;
  one.scrollIntoView({ block: "center" });
  const { left, top, width, height } = one.getBoundingClientRect();
  const there = document.elementFromPoint(left + width / 2, top + height / 2);
  return width > 0 && there !== one && !one.contains(there);
});
return [wrong.map((one) => one.dataset.role), document.documentElement.scrollWidth - innerWidth];"""
CONTRAST = """
const light = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map((one) => one / 255)
  .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
  .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
const ground = (one) => {
  const own = getComputedStyle(one).backgroundColor;
  return own === "rgba(0, 0, 0, 0)" && one.parentElement ? ground(one.parentElement) : own;
};
return [...document.querySelectorAll("h1, h2, small, .key, label, #toml, #lines, button.main:enabled")]
  .map((one) => [light(getComputedStyle(one).color), light(ground(one))].sort((a, b) => b - a))
  .map(([high, low]) => (high + 0.05) / (low + 0.05));"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("zoom", ["1", "2"])
def test_every_control_can_be_reached_and_read(page: Page, zoom: str, scheme: str) -> None:
    page.connect(FIRST)
    page.connect(SECOND)
    page.driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    )
    page.driver.execute_script("document.documentElement.style.zoom = arguments[0]", zoom)
    covered, beyond = page.driver.execute_script(COVERED)
    assert covered == []
    assert beyond <= 0
    assert min(page.driver.execute_script(CONTRAST)) >= READABLE
    ground = page.driver.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert (int(ground[4:].split(",")[0]) < 128) == (scheme == "dark")
