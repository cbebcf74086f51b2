"""The planner's web server, for browsers on this computer only.

It listens on 127.0.0.1. Every request must have the token of the address, the server's Host header, and the server's
Origin if it has an Origin. Other requests are answered with status 403. Other computers, other users of this computer
and pages of other sites therefore have no access.
"""

import asyncio
import json
import logging
import secrets
import socket
import threading
import webbrowser
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.shipped import shipped_names
from dpcontrol.planner.session import PageSession
from dpcontrol.planner.shown import fitting_model, shown_model
from dpcontrol.planner.workers import Workers

servers, exceptions = Later("websockets.asyncio.server"), Later("websockets.exceptions")
_STATIC = Path(__file__).parent / "static"
_FILES = {
    "/": ("index.html", "text/html"),
    "/planner.js": ("planner.js", "text/javascript"),
    "/planner.css": ("planner.css", "text/css"),
}
_HEADERS = {
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}
_LONGEST = 1 << 20
"""Largest message from a page, bytes."""
_POLL = 0.1
"""Longest time until the server notices that it is closed, s."""
_SILENT = logging.Logger("planner", logging.CRITICAL + 1)
"""Refused and broken connections are no error of the planner."""


class Planner(AbstractContextManager["Planner"]):
    """A running planner, also usable as a context manager.

    Its page is at `address`.
    """

    def __init__(self, model: str, *, port: int = 0) -> None:
        """Start the server for pages that begin with a model.

        Args:
            model: name or path of the model.
            port: port of the server, 0 for any free one.

        Raises:
            InputError: the model cannot be used, or the port is in use.
            PartMissing: websockets is not installed.
        """
        self._serving = servers.serve
        self._model = model
        # Imports and the model's equilibria take a second, so they are loaded before a page connects.
        shown_model(fitting_model(model))
        # Secret part of the page's address, without which requests are rejected.
        self._token = secrets.token_urlsafe(24)
        self._socket = _listening(port)
        self._host = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self.address = f"http://{self._host}/?token={self._token}"
        # Sessions of pages by the path of their address; windows with the same path share one.
        self._sessions: dict[str, PageSession] = {}
        self._workers, self._closed = Workers(), False
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> bool:
        """Open the page in a browser; return False without a browser."""
        return webbrowser.open(self.address)

    def document(self) -> dict[str, str]:
        """Return the address as JSON value."""
        return {"address": self.address}

    def serve(self) -> None:
        """Block until the server is closed or the program is interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def close(self) -> None:
        """Stop the server and its workers."""
        self._closed = True
        self._thread.join()

    async def _serve(self) -> None:
        """Serve pages until the planner is closed, then end their sessions and all processes."""
        options = {"max_size": _LONGEST, "close_timeout": 1, "server_header": None, "logger": _SILENT}
        try:
            await self._workers.prepare()
            async with self._serving(self._page, sock=self._socket, process_request=self._answer, **options):
                while not self._closed:
                    await asyncio.sleep(_POLL)
        finally:
            for session in self._sessions.values():
                session.close()
            await self._workers.close()

    def _answer(self, connection: Any, request: Any) -> Any:
        """Return the response to a request for a file or with an error, or None to let a page open its connection.

        The library calls it before each connection with its `ServerConnection` and the browser's `Request`, and
        expects a `Response` or None.
        """
        path, _, query = request.path.partition("?")
        name, kind = _FILES.get(path, ("", "text/plain"))
        if not self._admits(query, request.headers):
            kind, answer = "text/plain", (403, "403: open the address that `dpcontrol planner` printed\n")
        elif name:
            answer = 200, (_STATIC / name).read_text(encoding="utf-8").replace("{token}", self._token)
        elif path.startswith("/page/"):
            return None
        else:
            answer = 404, "404: there is no such file\n"
        response = connection.respond(*answer)
        del response.headers["content-type"]
        response.headers.update({**_HEADERS, "content-type": f"{kind}; charset=utf-8"})
        return response

    def _admits(self, query: str, headers: Any) -> bool:
        """Return True if a request has the token in its query, this server as host, and no origin but this server.

        `headers` are the request's, of the library's class `Headers`. Other programs and pages in the user's browser
        are thus rejected.
        """
        tokens = parse_qs(query).get("token", [])
        return (
            headers.get_all("host") == [self._host]
            and all(origin == f"http://{self._host}" for origin in headers.get_all("origin"))
            and len(tokens) == 1
            and secrets.compare_digest(tokens[0].encode(), self._token.encode())
        )

    async def _page(self, window: Any) -> None:
        """Receive the commands of one of the page's windows and send its data, until the window is closed.

        `window` is the library's `ServerConnection` to it. Windows with the same path share a session, so that a reload
        shows the same itinerary.
        """
        name = window.request.path.partition("?")[0]
        if name not in self._sessions:
            self._sessions[name] = PageSession(self._workers, self._model, servers.broadcast)
        session = self._sessions[name]
        models = await asyncio.to_thread(self._models)
        session.windows.add(window)
        for text in (models, *session.everything()):
            servers.broadcast([window], text)
        with suppress(exceptions.ConnectionClosed):
            async for text in window:
                await session.command(text)
        session.windows.discard(window)

    def _models(self) -> str:
        """Return the message with the models that a page offers, each with the reason why it cannot be used, or ""."""
        names = dict.fromkeys([self._model, *shipped_names("models")])
        return json.dumps({"models": [{"name": name, "problem": _problem(name)} for name in names]})


def _problem(model: str) -> str:
    """Return the reason why a model cannot be used in the planner, or "", for the page's list of models."""
    try:
        fitting_model(model)
    except InputError as error:
        return str(error)
    return ""


def _listening(port: int) -> socket.socket:
    """Return a socket that listens on a port of this computer only, 0 for any free one.

    Raises:
        InputError: the port is in use or cannot be used.
    """
    listener = socket.socket()
    try:
        listener.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise InputError(f"--port {port}: {getattr(error, 'strerror', error)}; choose another, or 0 for any") from error
    # Early connections are queued until the server is ready.
    listener.listen(64)
    return listener
