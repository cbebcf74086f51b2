"""The planner's page in a headless browser, from energy to a saved itinerary that completes."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import dpcontrol as dp

pytest.importorskip("starlette")
webdriver = pytest.importorskip("selenium.webdriver")
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import Select  # noqa: E402

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="needs chromium and chromedriver (Debian: chromium-driver)"),
]
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--window-size=1280,860",
)  # fmt: skip
PATIENCE = 600.0
"""Time limit of a plan on a busy machine, s."""


class Page:
    """The planner's page, operated like a user."""

    def __init__(self, driver: Any, address: str) -> None:
        self.driver, self.address = driver, address
        driver.get(address)
        self.idle()

    @property
    def state(self) -> dict[str, Any]:
        return self.driver.execute_script("return window.planner.state")

    def idle(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while (state := self.state)["busy"] or "toml" not in state:
            assert time.monotonic() < end, state["busy"]
            time.sleep(0.05)
        return state

    def role(self, name: str, more: str = "") -> Any:
        return self.driver.find_element("css selector", f'[data-role="{name}"]{more}')

    def press(self, name: str, more: str = "") -> dict[str, Any]:
        self.role(name, more).click()
        return self.idle()

    def type(self, name: str, text: str) -> dict[str, Any]:
        self.role(name).clear()
        self.role(name).send_keys(text)
        return self.idle()

    def connect(self, ends: str) -> dict[str, Any]:
        return self.press("connection", f'[data-name^="{ends}"]')


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("planner"))
        with dp.open_planner("lab", browser=False) as planner:
            yield planner.address


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    made = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield made
    made.quit()


@pytest.fixture
def page(driver: Any, address: str) -> Iterator[Page]:
    driver.switch_to.new_window("tab")
    yield Page(driver, address)
    driver.close()
    driver.switch_to.window(driver.window_handles[0])


def test_an_itinerary_is_built_planned_run_and_saved_and_the_command_line_completes_it(page: Page) -> None:
    page.type("energy", "0.2")
    page.connect("down-up>up-down")
    state = page.connect("up-down>down-up")
    assert [name.split("[")[0] for name in state["walk"]] == ["down-up>up-down", "up-down>down-up"]
    wraps = state["wraps"][0]
    assert page.press("wraps-plus", '[data-stop="0"]')["wraps"] == [wraps + 1]
    for end in ("start", "finish"):
        Select(page.role(end)).select_by_value("rest")
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


def test_impossible_symbols_are_grey_with_the_reason_and_undo_reverts(page: Page) -> None:
    page.connect("down-up>up-down")
    button = page.role("connection", '[data-name^="down-up>down-up"]')
    assert button.get_attribute("aria-disabled") == "true"
    assert "the walk is at Up-Down" in button.get_attribute("title")
    assert len(page.press("connection", '[data-name^="down-up>down-up"]')["walk"]) == 1
    assert page.press("undo")["walk"] == []
    assert len(page.press("redo")["walk"]) == 1


def test_text_and_page_are_synchronised_and_errors_mark_their_line(page: Page) -> None:
    text = page.idle()["toml"]
    edited = text.replace("walk   = []", 'walk   = ["down-up +", "down-up -"]').replace("wraps  = []", "wraps = [1]")
    state = page.type("toml", edited)
    assert (state["walk"], state["wraps"]) == (["down-up +", "down-up -"], [1])
    assert "wraps = [2]" in page.press("wraps-plus")["toml"]
    page.type("toml", text.replace("energy = ", "energy = high"))
    assert page.driver.find_element("css selector", "#lines b").get_attribute("textContent") == "3"
    assert not page.role("plan").is_enabled()


def test_an_unknown_symbol_is_named_and_framed(page: Page) -> None:
    page.connect("up-down>up-down")
    page.type("energy", "-0.07")
    state = page.idle()
    assert (state["unknown"], state["mistake"]["line"]) == ([0], 3)
    assert "only above" in state["mistake"]["message"]
    assert page.driver.find_elements("css selector", "#walk .fault")
    assert page.type("energy", "0.2")["mistake"] is None


def test_the_keyboard_alone_appends_plays_and_saves(page: Page) -> None:
    first = page.driver.find_element("css selector", '[data-role="connection"]')
    page.driver.execute_script("arguments[0].focus()", first)
    active = page.driver.switch_to.active_element
    active.send_keys(Keys.ARROW_DOWN)
    page.driver.switch_to.active_element.send_keys(Keys.ENTER)
    assert len(page.idle()["walk"]) == 1
    page.role("name").clear()
    page.role("name").send_keys("by-keys" + Keys.TAB)
    page.idle()
    page.driver.switch_to.active_element.send_keys(Keys.CONTROL + "s")
    assert page.idle()["saved"] == {"toml": "itineraries/by-keys.toml"}


def test_two_pages_do_not_disturb_each_other(page: Page, driver: Any, address: str) -> None:
    page.connect("down-up>up-down")
    mine = driver.current_window_handle
    driver.execute_script("window.open(location.href)")
    driver.switch_to.window(next(h for h in driver.window_handles if h not in (mine, driver.window_handles[0])))
    other = Page(driver, address)
    assert other.state["walk"] == []
    other.connect("up-down>down-up")
    driver.close()
    driver.switch_to.window(mine)
    assert [name.split("[")[0] for name in page.state["walk"]] == ["down-up>up-down"]
