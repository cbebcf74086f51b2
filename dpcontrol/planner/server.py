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
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self
from urllib.parse import parse_qs

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.shipped import known
from dpcontrol.planner.session import PageSession
from dpcontrol.planner.shown import fitting_model, shown_model
from dpcontrol.planner.workers import Workers

uvicorn, starlette = Later("uvicorn"), Later("starlette")
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


class Planner:
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
            _ = Later(needed).__name__
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
        config = uvicorn.Config(
            self._guarded(self._application()), log_level="error", ws="websockets-sansio", ws_max_size=_LONGEST,
            lifespan="off", timeout_graceful_shutdown=1, server_header=False, date_header=False,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> bool:
        """Open the page in a browser; return False without a browser."""
        return webbrowser.open(self.address)

    def wait(self) -> None:
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

    def _application(self) -> Any:
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import Response
        from starlette.routing import Route, WebSocketRoute

        async def file(request: Request) -> Response:
            name, kind = _FILES[request.url.path]
            content = (_STATIC / name).read_text(encoding="utf-8").replace("{token}", self._token)
            return Response(content, media_type=kind, headers=_HEADERS)

        routes: list[Any] = [Route(path, file) for path in _FILES]
        return Starlette(routes=[*routes, WebSocketRoute("/page/{session}", self._page)])

    def _guarded(self, application: Any) -> Callable[..., Any]:
        """Wrap an application with checks of token, Host and Origin."""

        async def guarded(scope: Any, receive: Any, send: Any) -> None:
            if scope["type"] in ("http", "websocket") and not self._admits(scope):
                if scope["type"] == "websocket":
                    # The server answers a connection closed before acceptance with 403.
                    await receive()
                    await send({"type": "websocket.close", "code": 1008})
                    return
                from starlette.responses import PlainTextResponse

                refused = PlainTextResponse("403: open the address that `dpcontrol planner` printed\n", 403, _HEADERS)
                await refused(scope, receive, send)
                return
            await application(scope, receive, send)

        return guarded

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

    async def _page(self, socket: Any) -> None:
        """Receive the commands of one page and send its data."""
        from starlette.websockets import WebSocketDisconnect

        name = socket.path_params["session"]
        await socket.accept()
        messages: asyncio.Queue[str] = asyncio.Queue()
        session = self._session(name)
        self._pages.setdefault(name, set()).add(messages)
        for text in (self._models(), *self._marks.values(), *session.everything()):
            messages.put_nowait(text)

        async def send() -> None:
            with suppress(WebSocketDisconnect, RuntimeError):
                while True:
                    await socket.send_text(await messages.get())

        sending = asyncio.create_task(send())
        try:
            while True:
                text = await socket.receive_text()
                try:
                    request = json.loads(text)
                except (ValueError, RecursionError):
                    request = None
                session.command(request)
        except (WebSocketDisconnect, KeyError):
            # A message of bytes causes a KeyError; our pages send text only.
            pass
        finally:
            sending.cancel()
            self._pages[name].discard(messages)

    def _session(self, name: str) -> PageSession:
        """Return the session with this name, created if necessary."""
        if name in self._sessions:
            return self._sessions[name]

        def send(text: str) -> None:
            for messages in self._pages.get(name, ()):
                messages.put_nowait(text)

        return self._sessions.setdefault(name, PageSession(self._workers, self._model, send))

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
        for pages in self._pages.values():
            for messages in pages:
                messages.put_nowait(self._marks[model])


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
