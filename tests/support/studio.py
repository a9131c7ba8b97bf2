"""The studio as a process, and a browser for its page."""

import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager

from support.browser import chromium
from support.paths import ROOT

# A step of the page, and a run, on a busy machine.
PATIENCE_MS, RUN_MS = 120_000, 500_000
# The picture is loaded and has the size that it is fitted to; it has the same place in two frames of the display.
IS_FITTED = """() => {
    const img = document.querySelector('.frame-image img'), box = img?.closest('.frame-box');
    return img?.naturalWidth > 0 && box.dataset.size === `${img.naturalWidth}x${img.naturalHeight}`;
}"""
AT_REST = """() => new Promise((done) => {
    let last = "";
    const look = () => {
        const now = JSON.stringify(document.querySelector('.frame-image img').getBoundingClientRect());
        if (now === last) return done();
        last = now;
        requestAnimationFrame(look);
    };
    look();
})"""


@contextmanager
def running_studio(*arguments, cwd, address_on="stdout", stderr=None):
    """Start ``modalcam ARGUMENTS --no-browser`` and give its address; it must end cleanly when it is interrupted."""
    command = [sys.executable, "-m", "modalcam", *map(str, arguments), "--no-browser"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": stderr} | {address_on: subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, cwd=cwd, env=environment) as process:
        try:
            address = getattr(process, address_on).readline().strip()
            assert address.startswith("http://127.0.0.1:"), address
            yield address, process
        finally:
            if process.poll() is None:
                process.send_signal(2)
            code = process.wait(60)
    assert code == 0


def answer(address, path="/", **headers):
    """Status and body of a request without a browser."""
    request = urllib.request.Request(address.split("/?")[0] + path, headers=headers)  # noqa: S310 - loopback
    try:
        with urllib.request.urlopen(request, timeout=30) as response:  # noqa: S310
            return response.status, response.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


@contextmanager
def opened(address, *, expect_missing=False, **options):
    """Page of the studio in Chromium; it must say nothing on the console and ask no other host.

    With `expect_missing`, the browser may report pictures that are not there.
    """
    events = []
    own = address.split("?")[0]

    def requested(request):
        if not request.url.startswith((own, "data:", "blob:", own.replace("http:", "ws:"))):
            events.append(f"request: {request.url}")

    def said(message):
        if not (expect_missing and "404 (Not Found)" in message.text):
            events.append(f"console: {message.type}: {message.text}")

    with chromium() as browser:
        context = browser.new_context(**({"viewport": {"width": 1280, "height": 900}} | options))
        context.on("request", requested)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("websocket", requested)
        page.on("console", said)
        page.on("pageerror", lambda error: events.append(f"error: {error}"))
        page.goto(address)
        page.get_by_role("heading", level=1).wait_for()
        yield page
        context.close()
    assert not events, events


@contextmanager
def another_browser(page, address):
    """Page of the same studio in a browser of its own, without the cookies of `page`."""
    context = page.context.browser.new_context()
    other = context.new_page()
    other.set_default_timeout(PATIENCE_MS)
    other.goto(address)
    other.get_by_role("heading", level=1).wait_for()
    yield other
    context.close()


def click_frame(page, x_px, y_px):
    """Click on a point of the frame, in pixels of the image, where pixel centres are at integers."""
    image = page.locator(".frame-image img").first
    page.wait_for_function(IS_FITTED)
    image.scroll_into_view_if_needed()
    page.evaluate(AT_REST)
    scale = image.evaluate("img => img.clientWidth / img.naturalWidth")
    image.click(position={"x": (x_px + 0.5) * scale, "y": (y_px + 0.5) * scale})


def show(page, view):
    """Open a view of the page."""
    page.get_by_role("tab", name=view).click()
    page.get_by_role("heading", name=view, level=2).wait_for()


def save_and_run(page):
    """Save what was changed, if anything, run, and wait for the report."""
    show(page, "Run and report")
    changed = page.get_by_text("unsaved changes").count() > 0
    page.get_by_role("button", name="Save and run").click()
    if changed:
        page.get_by_role("dialog").get_by_role("button", name="Save and run").click()
    page.get_by_text("The run took").wait_for(timeout=RUN_MS)
    page.frame_locator("iframe").get_by_role("heading").first.wait_for()


def targets(out):
    """Target mode of each recording of a finished run, by file."""
    recordings = json.loads((out / "summary.json").read_text())["recordings"]
    return {one["file"]: next(m for m in one["modes"] if m["target"]) for one in recordings if one["modes"]}
