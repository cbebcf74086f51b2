"""The planner's page, operated like a user."""

import time
from typing import Any

PATIENCE = 600.0
"""Time limit of a plan on a busy machine, s."""


class Page:
    def __init__(self, driver: Any, address: str) -> None:
        self.driver, self.address = driver, address
        driver.get(address)
        self.idle()

    @property
    def state(self) -> dict[str, Any]:
        return self.driver.execute_script("return window.planner.state")

    def until(self, condition: Any) -> dict[str, Any]:
        """Return the first state that fulfils a condition."""
        end = time.monotonic() + PATIENCE
        while not condition(state := self.state):
            assert time.monotonic() < end, (state["busy"], state.get("message"))
            time.sleep(0.1)
        return state

    def idle(self) -> dict[str, Any]:
        return self.until(lambda state: not state["busy"] and "toml" in state)

    def all(self, selector: str) -> list[Any]:
        return self.driver.find_elements("css selector", selector)

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
