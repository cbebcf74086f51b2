"""The planner's web server, for browsers on this computer only.

It listens on 127.0.0.1. Every request must have the token of the address, the server's Host header, and the server's
Origin if it has an Origin. Other requests are answered with status 403. Other computers, other users of this computer
and pages of other sites therefore have no access.
"""

import asyncio
import json
import secrets
import socket
import threading
import webbrowser
from contextlib import AbstractContextManager, suppress
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later, part
from dpcontrol.foundation.shipped import known
from dpcontrol.planner.session import PageSession
from dpcontrol.planner.shown import fitting_model, shown_model
from dpcontrol.planner.workers import Workers

uvicorn, applications, responses = Later("uvicorn"), Later("starlette.applications"), Later("starlette.responses")
routing, websockets = Later("starlette.routing"), Later("starlette.websockets")
_STATIC = Path(__file__).parent / "static"
_FILES = {"/": ("index.html", "text/html"), "/planner.js": ("planner.js", "text/javascript"),
          "/planner.css": ("planner.css", "text/css")}  # fmt: skip
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


class Planner(AbstractContextManager["Planner"]):
    """A running planner, also usable as a context manager.

    Its page is at `address`.
    """

    def __init__(self, model: str, *, port: int = 0) -> None:
        """Start the server.

        Raises:
            InputError: the model cannot be used, or the port is in use.
            PartMissing: starlette, uvicorn or websockets is not installed.
        """
        for needed in ("starlette.applications", "uvicorn", "websockets"):
            part(needed)
        self._model = model
        # Imports and the model's equilibria take a second, so they are loaded before a page connects.
        shown_model(fitting_model(model))
        self._token = secrets.token_urlsafe(24)
        self._socket = _listening(port)
        self._host = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self.address = f"http://{self._host}/?token={self._token}"
        self._sessions: dict[str, PageSession] = {}
        self._pages: dict[str, set[asyncio.Queue[str]]] = {}
        self._marks: dict[str, str] = {}
        self._application = applications.Starlette(
            routes=[
                *(routing.Route(path, self._file) for path in _FILES),
                routing.WebSocketRoute("/page/{session}", self._page),
            ]
        )
        self._server = uvicorn.Server(
            uvicorn.Config(
                self._guarded,
                interface="asgi3",
                log_level="error",
                ws="websockets-sansio",
                ws_max_size=_LONGEST,
                lifespan="off",
                timeout_graceful_shutdown=1,
                server_header=False,
                date_header=False,
            )
        )
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
        self._server.should_exit = True
        self._thread.join()

    async def _serve(self) -> None:
        self._workers = Workers(self._mark)
        try:
            await self._workers.prepare()
            await self._server.serve(sockets=[self._socket])
        finally:
            for session in self._sessions.values():
                session.close()
            await self._workers.close()
            self._socket.close()

    async def _guarded(self, scope: Any, receive: Any, send: Any) -> None:
        """Forward requests that pass the checks; answer others with status 403."""
        # Uvicorn logs any answer to a socket other than a close as an error.
        refusal = (
            websockets.WebSocketClose()
            if scope["type"] == "websocket"
            else responses.PlainTextResponse("403: open the address that `dpcontrol planner` printed\n", 403, _HEADERS)
        )
        await (self._application if self._admits(scope) else refusal)(scope, receive, send)

    def _admits(self, scope: Any) -> bool:
        headers = [(name.decode("latin-1"), value.decode("latin-1")) for name, value in scope["headers"]]
        hosts = [value for name, value in headers if name == "host"]
        origins = [value for name, value in headers if name == "origin"]
        tokens = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        return (
            hosts == [self._host]
            and all(origin == f"http://{self._host}" for origin in origins)
            and len(tokens) == 1
            and secrets.compare_digest(tokens[0].encode(), self._token.encode())
        )

    async def _file(self, request: Any) -> Any:
        name, kind = _FILES[request.url.path]
        content = (_STATIC / name).read_text(encoding="utf-8").replace("{token}", self._token)
        return responses.Response(content, media_type=kind, headers=_HEADERS)

    async def _page(self, socket: Any) -> None:
        """Receive the commands of one page and send its data."""
        name = socket.path_params["session"]
        await socket.accept()
        messages: asyncio.Queue[str] = asyncio.Queue()
        session = self._session(name)
        self._pages.setdefault(name, set()).add(messages)
        for text in (await asyncio.to_thread(self._models), *self._marks.values(), *session.everything()):
            messages.put_nowait(text)

        async def send() -> None:
            with suppress(websockets.WebSocketDisconnect, RuntimeError):
                while True:
                    await socket.send_text(await messages.get())

        sending = asyncio.create_task(send())
        try:
            # A message of bytes causes a KeyError; our pages send text only.
            with suppress(KeyError):
                async for text in socket.iter_text():
                    await session.command(text)
        finally:
            sending.cancel()
            self._pages[name].discard(messages)

    def _session(self, name: str) -> PageSession:
        """Return the session with this name, created if necessary."""
        if name not in self._sessions:
            self._sessions[name] = PageSession(self._workers, self._model, partial(self._send, name))
        return self._sessions[name]

    def _send(self, name: str, text: str) -> None:
        for messages in self._pages.get(name, ()):
            messages.put_nowait(text)

    def _models(self) -> str:
        listed = []
        for name in dict.fromkeys([self._model, *known("models")]):
            problem = ""
            try:
                fitting_model(name)
            except InputError as error:
                problem = str(error)
            listed.append({"name": name, "problem": problem})
        return json.dumps({"models": listed}, ensure_ascii=False)

    def _mark(self, model: str, found: str) -> None:
        """Send the energies of a model's bifurcations to all pages."""
        self._marks[model] = f'{{"marks":{{"model":{json.dumps(model)},"found":{found}}}}}'
        for name in self._pages:
            self._send(name, self._marks[model])


def _listening(port: int) -> socket.socket:
    listener = socket.socket()
    try:
        listener.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise InputError(f"--port {port}: {getattr(error, 'strerror', error)}; choose another, or 0 for any") from error
    # Early connections are queued until the server is ready.
    listener.listen(64)
    return listener
