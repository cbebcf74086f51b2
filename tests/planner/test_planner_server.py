"""The planner's server accepts only local browsers, and answers invalid commands with messages."""

import http.client
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

connected = pytest.importorskip("websockets.sync.client")
from websockets.exceptions import InvalidStatus  # noqa: E402

pytestmark = pytest.mark.slow


def status(address: str, path: str, **headers: str) -> int:
    place = urlsplit(address)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=60)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": place.netloc, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    return connection.getresponse().status


class Page:
    def __init__(self, address: str, name: str) -> None:
        place = urlsplit(address)
        self.socket = connected.connect(
            f"ws://{place.netloc}/page/{name}?{place.query}", origin=f"http://{place.netloc}", max_size=None
        )
        self.sent = 0

    def until(self, kind: str) -> Any:
        """Return the next message of one kind."""
        while True:
            message = json.loads(self.socket.recv(timeout=120))
            if kind in message:
                return message[kind]

    def send(self, command: Any) -> dict[str, Any]:
        """Return the state after a command."""
        self.sent += 1
        self.socket.send(json.dumps({**command, "n": self.sent} if isinstance(command, dict) else command))
        while True:
            state = self.until("state")
            if state["ack"] == self.sent or not isinstance(command, dict):
                return state


@pytest.fixture
def page(address: str, request: pytest.FixtureRequest) -> Iterator[Page]:
    made = Page(address, "".join(c for c in request.node.name if c.isalnum()))
    yield made
    made.socket.close()


def test_only_the_address_with_its_token_host_and_origin_is_answered(address: str) -> None:
    place = urlsplit(address)
    token = place.query
    for path in ("/", "/planner.js", "/planner.css"):
        assert status(address, f"{path}?{token}") == 200
        assert status(address, f"{path}?{token}", Origin=f"http://{place.netloc}") == 200
        refused = [
            status(address, path),
            status(address, f"{path}?token=wrong"),
            status(address, f"{path}?{token}&{token}"),
            status(address, f"{path}?{token}", Host="evil.example"),
            status(address, f"{path}?{token}", Host=f"localhost:{place.port}"),
            status(address, f"{path}?{token}", Origin="http://evil.example"),
            status(address, f"{path}?{token}", Origin="null"),
        ]
        assert refused == [403] * len(refused)
    assert status(address, "/nothing") == 403
    assert status(address, f"/nothing?{token}") == 404


@pytest.mark.parametrize("wrong", ["token", "origin"])
def test_a_socket_without_token_or_from_another_site_is_refused_without_a_line(
    address: str, wrong: str, capfd: pytest.CaptureFixture[str]
) -> None:
    place = urlsplit(address)
    query = "token=no" if wrong == "token" else place.query
    origin = "http://evil.example" if wrong == "origin" else f"http://{place.netloc}"
    with pytest.raises(InvalidStatus) as refused:
        connected.connect(f"ws://{place.netloc}/page/x?{query}", origin=origin)
    assert refused.value.response.status_code == 403
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "command",
    [
        {"do": "nothing"}, {"do": "set", "values": 3}, {"do": "set", "values": {"title": "x"}}, {}, 7, None, "{",
        {"do": "set", "values": {"energy": float("nan")}}, {"do": "run"}, {"do": "save"}, {"do": "plan"},
        {"do": "name", "name": "../x"}, {"do": "model", "name": "three-body"}, {"do": "run", "seed": -1},
        {"do": "toml", "text": f"energy = {'9' * 400}"}, {"do": "toml", "text": "run.mismatch = 2026-01-01"},
        {"do": "append", "symbol": 7}, {"do": "wraps", "stop": 0, "change": 1},
        {"do": "set", "values": {"start": "\ud800"}},
    ],
)  # fmt: skip
def test_invalid_commands_are_answered_with_a_message(page: Page, command: Any) -> None:
    before = page.until("state")["toml"]
    state = page.send(command)
    assert state["message"]["kind"] == "error" or state["mistake"]
    assert state["toml"] == before or state["mistake"]


def test_an_itinerary_is_saved_without_replacing_another(page: Page, address: str) -> None:
    page.send({"do": "append", "symbol": "down-up +"})
    page.send({"do": "name", "name": "mine"})
    assert page.send({"do": "save"})["saved"]["toml"].endswith("mine.toml")
    assert page.send({"do": "save"})["message"]["kind"] == "good"
    Path("itineraries/mine.toml").write_text("# edited elsewhere\n", encoding="utf-8")
    assert "is not as this page saved it" in page.send({"do": "save"})["message"]["text"]
    assert Path("itineraries/mine.toml").read_text(encoding="utf-8") == "# edited elsewhere\n"
    other = Page(address, "one-more")
    other.send({"do": "append", "symbol": "down-up -"})
    other.send({"do": "name", "name": "mine"})
    assert "choose another name" in other.send({"do": "save"})["message"]["text"]


def test_work_can_be_cancelled_and_a_dead_process_restarted(page: Page) -> None:
    page.until("atlas")
    page.send({"do": "set", "values": {"start": "orbit", "finish": "orbit"}})
    # No other test plans this walk, whose plan would then be read at once.
    for symbol in ("down-up +", "down-up -", "down-up -"):
        page.send({"do": "append", "symbol": symbol})
    assert page.send({"do": "plan"})["busy"]
    state = page.send({"do": "cancel"})
    assert state["busy"] is None
    assert "cancelled" in state["message"]["text"]
    page.send({"do": "plan"})
    page.until("state")
    while not (state := page.until("state"))["busy"] or state["busy"]["what"] == "plan":
        # The process is running once it reports progress.
        pass
    children = subprocess.run(["pgrep", "-P", str(os.getpid())], capture_output=True, text=True, check=True)
    for number in children.stdout.split():
        os.kill(int(number), signal.SIGKILL)
    while not (state := page.until("state"))["retry"]:
        pass
    assert "ended (signal" in state["message"]["text"]
    state = page.send({"do": "retry"})
    while not state["plan"]:
        state = page.until("state")
    assert state["plan"]["converged"]
