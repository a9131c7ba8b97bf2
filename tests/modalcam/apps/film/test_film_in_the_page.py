"""The films of the report in a browser."""

import numpy as np
from kit import runs
from support.browser import NEEDS_CHROMIUM

from modalcam.apps.film import KeptFrames, SimulatedFootage
from modalcam.pipeline import RecordingResult

pytestmark = NEEDS_CHROMIUM


def filmed_page(build):
    """Report of one recording with a film of ten frames: a dark block that moves to the right."""
    images = np.full((10, 120, 40), 200, np.uint8)
    for k, image in enumerate(images):
        image[40:60, 2 * k : 2 * k + 12] = 30
    time_s = 1.0 + np.arange(10) / 200.0
    footage = KeptFrames("take.avi", np.arange(10), time_s, images, 1, 0, 0, 0.0, 0.05)
    film = SimulatedFootage("take.avi", time_s, images[::-1].copy(), 0.5, 0.05, 3.0, 0.1, (16.0, 50.0))
    recording = RecordingResult("take", "take.avi", "0" * 64, 1, added={"frames": footage, "simulated": film})
    return build(runs.run_result((recording,)))


def test_the_film_advances_by_frames_can_be_paused_and_respects_reduced_motion(opened, build):
    at = "() => new DOMMatrix(getComputedStyle(document.querySelector('.film img')).transform).m41"
    page = opened(filmed_page(build))
    page.get_by_label("Unfold all").check()
    x_px = set()
    for _ in range(40):
        x_px.add(page.evaluate(at))
        page.wait_for_timeout(40)
    width = page.locator(".film").first.bounding_box()["width"]
    assert len(x_px) > 3
    assert all(abs(x / width - round(x / width)) < 1e-3 and -10 < x / width <= 0 for x in x_px), (x_px, width)
    page.get_by_label("Pause").check()
    # an animation stops with the next frame that the browser draws
    page.wait_for_timeout(300)
    paused = page.evaluate(at)
    page.wait_for_timeout(300)
    assert page.evaluate(at) == paused
    page.get_by_label("Pause").uncheck()
    page.emulate_media(reduced_motion="reduce")
    page.set_viewport_size({"width": 320, "height": 800})
    moving = "() => getComputedStyle(document.querySelector('.film img')).animationName"
    assert page.evaluate(moving) == "none"
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 320
    assert not page.get_by_label("Pause").is_visible()
