"""The server of the studio: on the loopback interface of this machine only, behind `Guard`.

`Guard` stands in front of the whole application, its websocket included: a request must be for this host by its own
name (a page of another site can make a name of its own lead to this machine), must not come from a page of another
origin, and must carry the cookie that the address with the token gives.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
import socket
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable, MutableMapping
from contextlib import asynccontextmanager, closing, suppress
from functools import partial
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from fastapi import FastAPI, Response
from nicegui import run, ui
from starlette.background import BackgroundTask
from starlette.responses import FileResponse

from modalcam.apps.studio.session import Studio
from tracker import Failure

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

# The studio needs forms and events, no files.
MOST_BODY_BYTES = 1_000_000
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host}; frame-src 'self'; "
    "object-src 'none'; base-uri 'self'; form-action 'none'; frame-ancestors 'self'"
)
# The report may come from another machine: its scripts run, with an origin of their own.
_REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
# NiceGUI answers every other path with the page.
_PATHS = ("/", "/done", "/report", "/favicon.ico")
_FOLDERS = ("/frame/", "/thumbnail/", "/_nicegui")
# The cookie is set by a page of our own, not by a redirect: one that another page leads to would not send it back.
_ENTRY = (
    b'<!doctype html><html lang="en"><title>modalcam studio</title>'
    b'<meta http-equiv="refresh" content="0;url=/"><p><a href="/">Continue to the studio</a></p></html>'
)
_REFUSALS = {
    403: b"This is modalcam studio. Open the address that it printed when it was started; it contains a key.\n",
    404: b"modalcam studio has no such page.\n",
    413: b"modalcam studio takes no files.\n",
    421: b"modalcam studio answers only to the address that it printed when it was started.\n",
}


class Guard:
    """ASGI application that lets only requests of the studio's own page pass to another.

    Parameters
    ----------
    app : callable
        The application behind it.
    port : int
        Port of the server, on the loopback interface.
    """

    def __init__(self, app: App, port: int) -> None:
        self.app = app
        self.token = secrets.token_urlsafe(32)
        self._session = secrets.token_urlsafe(32)
        # Cookies are shared by all ports of a host.
        self._cookie = f"modalcam-studio-{port}"
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")

    @property
    def address(self) -> str:
        """Address to open in the browser."""
        return f"http://{self._hosts[0]}/?token={self.token}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or refuse one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = _headers(scope)
        status = self._refusal(scope, headers)
        if status == 200:
            policy = _REPORT_POLICY if scope["path"] == "/report" else _POLICY.format(host=headers["host"][0])
            try:
                await self.app(scope, receive, _with_headers(send, policy))
            except (LookupError, TypeError, ValueError):
                # A message that no page sends ends its connection; events of the page raise within NiceGUI.
                if scope["type"] != "websocket":
                    raise
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        elif status == 403 and self._has_token(scope, headers):
            await _respond(send, 200, _ENTRY, [(b"set-cookie", self._set_cookie())])
        else:
            await _respond(send, status, _REFUSALS[status], [])

    def _refusal(self, scope: Scope, headers: dict[str, list[str]]) -> int:
        """Status of the refusal of a connection, or 200."""
        if len(headers.get("host", ())) != 1 or headers["host"][0] not in self._hosts:
            return 421
        same = f"http://{headers['host'][0]}"
        origins = headers.get("origin", [])
        # Browsers name the origin of each websocket and of each request that changes something.
        must_be_named = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if any(origin != same for origin in origins) or (must_be_named and not origins):
            return 403
        if not self._has_cookie(headers) or headers.get("sec-fetch-site", ["none"])[0] not in (
            "same-origin",
            "none",
        ):
            return 403
        if scope["path"] not in _PATHS and not scope["path"].startswith(_FOLDERS):
            return 404
        # A body of unknown length has none of these lengths.
        length = headers.get("content-length", [""] if must_be_named and scope["type"] == "http" else ["0"])[
            0
        ]
        return 413 if not length.isdecimal() or int(length) > MOST_BODY_BYTES else 200

    def _has_cookie(self, headers: dict[str, list[str]]) -> bool:
        try:
            cookie = SimpleCookie("; ".join(headers.get("cookie", []))).get(self._cookie)
        except CookieError:
            return False
        return cookie is not None and hmac.compare_digest(cookie.value.encode(), self._session.encode())

    def _has_token(self, scope: Scope, headers: dict[str, list[str]]) -> bool:
        """Whether the address with the token is opened; a page of another site cannot know it."""
        if scope["method"] != "GET" or scope["path"] != "/" or "origin" in headers:
            return False
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self.token.encode())

    def _set_cookie(self) -> bytes:
        return f"{self._cookie}={self._session}; Path=/; HttpOnly; SameSite=Strict".encode()


def _headers(scope: Scope) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return found


def _safety(policy: str) -> list[tuple[bytes, bytes]]:
    return [
        (b"content-security-policy", policy.encode()),
        (b"cross-origin-resource-policy", b"same-origin"),
        (b"referrer-policy", b"no-referrer"),
        (b"x-content-type-options", b"nosniff"),
    ]


def _with_headers(send: Send, policy: str) -> Send:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_safety(policy)]}
        await send(message)

    return sending


async def _respond(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    kind = b"text/html; charset=utf-8" if status == 200 else b"text/plain; charset=utf-8"
    own = [
        (b"content-type", kind),
        (b"content-length", str(len(body)).encode()),
        (b"cache-control", b"no-store"),
    ]
    start = {"type": "http.response.start", "status": status}
    await send({**start, "headers": [*own, *headers, *_safety("default-src 'none'; form-action 'none'")]})
    await send({"type": "http.response.body", "body": body})


_THUMBNAIL_PX = 320
# Without an icon of its own, the browser would ask the server for one, which has ended.
_DONE = (
    '<!doctype html><html lang="en"><title>modalcam pick</title><link rel="icon" href="data:,">'
    "<p>Done. This page can be closed.</p></html>"
)
# Connections of open pages do not end by themselves.
_PATIENCE_S = 1


def serve(
    studio: Studio, page: Callable[[Studio], None], announce: Callable[[str], object], *, browser: bool
) -> None:
    """Serve the studio until it is interrupted; `announce` is called with its address.

    Parameters
    ----------
    page : callable
        Builds the page, in NiceGUI's context of a browser tab.
    browser : bool
        Open the address in the browser of this machine.
    """
    with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as listener:
        listener.bind(("127.0.0.1", 0))
        # A browser that comes before the server answers waits.
        listener.listen()
        guard = Guard(_application(studio, page), listener.getsockname()[1])
        config = uvicorn.Config(
            guard,
            log_level="error",
            access_log=False,
            timeout_graceful_shutdown=_PATIENCE_S,
            server_header=False,
        )
        server = uvicorn.Server(config)
        studio.stop = partial(setattr, server, "should_exit", True)  # noqa: FBT003 - a value, not an option
        announce(guard.address)
        if browser:
            webbrowser.open(guard.address)
        # The server ends at the first interrupt and then raises it again.
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


def _application(studio: Studio, page: Callable[[Studio], None]) -> FastAPI:
    """Pictures, report and page. A recording is named by its number: no request names a file."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=_quiet)

    @app.get("/frame/{number}/{index}.png")
    async def frame(number: int, index: int) -> Response:
        return _picture(await run.io_bound(studio.frame, number, index))

    @app.get("/thumbnail/{number}.png")
    async def thumbnail(number: int) -> Response:
        return _picture(await run.io_bound(studio.frame, number, 0, _THUMBNAIL_PX))

    @app.get("/report")
    async def report() -> Response:
        found = await run.io_bound(studio.report)
        if found is None:
            return Response(status_code=404)
        return FileResponse(
            found, media_type="text/html; charset=utf-8", headers={"cache-control": "no-store"}
        )

    @app.get("/done")
    async def done() -> Response:
        if not studio.is_done:
            return Response(status_code=404)
        return Response(_DONE, media_type="text/html; charset=utf-8", background=BackgroundTask(studio.stop))

    # Without language and colour scheme of its own, the page follows those of the browser.
    ui.run_with(
        app,
        root=lambda: page(studio),
        title="modalcam studio",
        dark=None,
        language="en-US",
        show_welcome_message=False,
        reconnect_timeout=10.0,
    )
    return app


@asynccontextmanager
async def _quiet(_app: FastAPI) -> AsyncIterator[None]:
    """Say nothing of messages on the websocket that the page would not send: their tracebacks concern no user."""
    for name in ("engineio.server", "socketio.server"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    asyncio.get_running_loop().set_exception_handler(_unless_a_message)
    yield


def _unless_a_message(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    task = context.get("future")
    coroutine = task.get_coro() if isinstance(task, asyncio.Task) else None
    # Errors of the page's own events do not reach the task: NiceGUI reports them.
    if getattr(coroutine, "__qualname__", "") != "AsyncServer._handle_event_internal":
        loop.default_exception_handler(context)


def _picture(png: bytes | Failure) -> Response:
    if isinstance(png, Failure):
        return Response(
            png.reason.encode("utf-8", "backslashreplace"), 404, media_type="text/plain; charset=utf-8"
        )
    return Response(png, media_type="image/png", headers={"cache-control": "private, max-age=60"})
