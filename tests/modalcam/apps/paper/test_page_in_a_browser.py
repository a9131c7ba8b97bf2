"""The page of `modalcam paper` in a browser."""

from support.browser import NEEDS_CHROMIUM, assert_drawn, text_brightness

from modalcam.apps.paper import OptimumColumn, Recomputed, equations, standard_column
from modalcam.apps.paper import page as paper

pytestmark = NEEDS_CHROMIUM


def test_the_page_of_the_paper_is_drawn_within_the_window(opened, paper_run):
    """The page of `modalcam paper` for the same run, with the optimum column taken from its updating."""
    updated = paper_run.beam.updated
    frequency_hz = updated.paper.updated_hz
    optimum = OptimumColumn(frequency_hz, frequency_hz, reached=updated.paper, to_test=updated)
    recomputed = Recomputed(standard_column(), optimum, equations())
    page = opened(paper.paper_html(paper.paper_page(paper_run, recomputed, {})))
    for width, scheme in ((320, "light"), (1200, "dark")):
        page.set_viewport_size({"width": width, "height": 800})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        assert_drawn(page)
        assert (text_brightness(page) > 600) == (scheme == "dark")
