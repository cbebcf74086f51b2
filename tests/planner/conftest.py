"""The planner and a headless browser."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from browser_page import Page

import dpcontrol as dp

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
)  # fmt: skip
WIDTH, HEIGHT = 1280, 720
SLOWLY = "window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 250);"
"""Frames of the animation four times a second: a browser without a graphics card draws them on the processor."""
BROKEN = 'title = "Broken"\n[arms\n'
"""Text of the model "broken" in the planner's folder."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("planner")
        (folder / "models").mkdir()
        (folder / "models" / "broken.toml").write_text(BROKEN, encoding="utf-8")
        patch.chdir(folder)
        # The viewer has no display in any test.
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        with dp.open_planner("lab", browser=False) as planner:
            yield planner.address


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if not (BROWSER and DRIVER):
        pytest.skip("needs chromium and chromedriver (Debian: chromium-driver)")
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    made = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield made
    made.quit()


@pytest.fixture
def page(driver: Any, address: str) -> Iterator[Page]:
    driver.switch_to.new_window("tab")
    # The window's frame takes some of its height.
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False},
    )
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": SLOWLY})
    yield Page(driver, address)
    driver.close()
    driver.switch_to.window(driver.window_handles[0])
