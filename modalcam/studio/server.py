"""The server of the studio: on the loopback interface of this machine only, behind `Guard`."""

from __future__ import annotations

import asyncio
import logging
import socket
import webbrowser
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing, suppress
from functools import partial
from typing import Any

import uvicorn
from fastapi import FastAPI, Response
from nicegui import run, ui
from starlette.background import BackgroundTask
from starlette.responses import FileResponse

from modalcam.studio.decoding import Problem
from modalcam.studio.guard import Guard
from modalcam.studio.session import Studio

_THUMBNAIL_PX = 192
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


def _picture(png: bytes | Problem) -> Response:
    if isinstance(png, Problem):
        return Response(
            png.reason.encode("utf-8", "backslashreplace"), 404, media_type="text/plain; charset=utf-8"
        )
    return Response(png, media_type="image/png", headers={"cache-control": "private, max-age=60"})
