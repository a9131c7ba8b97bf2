"""Pages in Chromium, from disk, offline."""

import shutil
from contextlib import contextmanager
from importlib.util import find_spec

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-headless-shell"))), None)
NEEDS_CHROMIUM = pytest.mark.skipif(
    CHROMIUM is None or find_spec("playwright") is None,
    reason="no Chromium: install Debian's package chromium or chromium-headless-shell, and playwright",
)


@contextmanager
def chromium():
    """The browser, without a window."""
    from playwright.sync_api import sync_playwright

    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        ) as browser,
    ):
        yield browser


@contextmanager
def opening(browser, path):
    """Gives a function that opens a report; any console message, error, dialog or request fails at the end."""
    events, contexts = [], []

    def open_report(html, **options):
        path.write_text(html, encoding="utf-8")
        context = browser.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: events.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: events.append(f"error: {error}"))
        page.on("dialog", lambda dialog: events.append(f"dialog: {dialog.message}"))
        page.on("requestfailed", lambda request: events.append(f"failed: {request.url[:80]}"))

        def requested(request):
            if request.url != path.as_uri() and not request.url.startswith("data:"):
                events.append(f"request: {request.url}")

        context.on("request", requested)
        page.goto(path.as_uri())
        page.wait_for_load_state("load")
        return page

    yield open_report
    for context in contexts:
        context.close()
    assert not events


def assert_drawn(page):
    boxes = page.evaluate(
        "() => [...document.querySelectorAll(':is(svg, img, image):not(.paper *)')].map(e => {"
        " const b = e.getBoundingClientRect(); return [e.tagName, b.width, b.height]; })"
    )
    assert boxes
    assert all(width > 20 and height > 20 for _, width, height in boxes), boxes


def text_brightness(page):
    colour = page.evaluate("() => getComputedStyle(document.querySelector('.drawing svg text')).fill")
    return sum(int(c) for c in colour[4:-1].split(","))
