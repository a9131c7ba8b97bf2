"""The page in a browser, from disk, offline."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from kit import runs
from support.browser import NEEDS_CHROMIUM, assert_drawn, opening, text_brightness

from modalcam.tables import summary

pytestmark = NEEDS_CHROMIUM


@pytest.fixture(scope="module")
def one_result():
    return runs.run_result(runs.compared(runs.paper_recordings(1)))


@pytest.fixture(scope="module")
def one_html(one_result, build):
    return build(one_result)


@pytest.fixture(scope="module")
def paper_page(browser, tmp_path_factory, paper_html):
    """The report of five recordings, opened once for the tests that change nothing in it."""
    with opening(browser, tmp_path_factory.mktemp("paper") / "report.html") as open_report:
        yield open_report(paper_html)


@pytest.fixture
def changed_page(paper_page):
    """The same page for tests that change its window, what is folded or how it is shown: restored after each."""
    yield paper_page
    paper_page.emulate_media(media="null", color_scheme="null", reduced_motion="null")
    paper_page.set_viewport_size({"width": 1280, "height": 720})
    paper_page.get_by_label("Unfold all").uncheck()
    paper_page.evaluate(
        "() => { document.querySelectorAll('details').forEach(one => { one.open = false; });"
        " document.activeElement.blur(); scrollTo(0, 0); }"
    )


def test_the_page_opens_without_messages_and_every_figure_is_drawn(paper_page):
    page = paper_page
    assert_drawn(page)
    outside = page.evaluate(
        "() => [...document.querySelectorAll('.drawing svg')].flatMap(s => { const b = s.getBoundingClientRect();"
        " return [...s.querySelectorAll('text')].filter(t => { const r = t.getBoundingClientRect();"
        " return r.left < b.left - 2 || r.right > b.right + 2 || r.top < b.top - 2 || r.bottom > b.bottom + 2; })"
        ".map(t => s.closest('figure').id + ': ' + t.textContent); })"
    )
    assert outside == []


def test_the_table_of_modes_equals_the_run(paper_page, paper_run):
    rows = paper_page.locator("table.modes tbody tr")
    modes = [(r.name, m) for r in paper_run.recordings for m in r.identification.modes]
    shown = []
    for row in rows.all():
        name = row.locator("th").text_content()
        values = [float(v.get_attribute("value")) for v in row.locator("data").all()]
        # folded rows have no inner text
        texts = [v.text_content() for v in row.locator("data").all()]
        shown.append((name, *values))
        for value, text, factor in zip(values, texts, (1.0, 100.0), strict=True):
            mean, sd = (float(part) for part in text.rstrip("†").split(" ± "))
            assert abs(mean - factor * value) <= 0.05 * sd * 1.06, text
    expected = [(name, mode.frequency_hz, mode.damping_ratio) for name, mode in modes]
    assert sorted(shown) == sorted(expected)


def test_hostile_names_are_escaped(opened, hostile_html):
    name = runs.HOSTILE[0]
    page = opened(hostile_html)
    assert page.evaluate("() => window.PWN === undefined")
    assert page.evaluate("() => document.scripts.length") == 1, "that of the page"
    assert page.title() == f"Modal parameters: {name}"
    assert page.locator("h1").inner_text() == name
    assert page.locator("summary:has(+ #r5) h3").inner_text() == "$x_1$^.avi"
    assert page.locator("summary:has(+ #r4) h3").inner_text() == "{{7*7}}{% raw %}.avi"
    assert_drawn(page)


def test_the_page_does_not_scroll_horizontally(changed_page):
    page = changed_page
    for width in (320, 400, 1200):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        assert_drawn(page)


def test_the_alert_is_above_the_results_and_cannot_be_dismissed(opened, build):
    page = opened(build(runs.run_result([runs.recording(0, time_axis=runs.PLAYBACK, seconds=1.0)])))
    box = page.locator(".alert.danger")
    assert box.count() == 1
    assert box.bounding_box()["y"] < page.locator("#modes").bounding_box()["y"]
    assert box.bounding_box()["y"] < 800, "in the first screen"
    assert page.locator(".alert button, .alert input, .alert details, details .alert").count() == 0


def printed(page, size="A4"):
    """Text of each printed page, with single spaces."""
    pypdf = pytest.importorskip("pypdf", reason="pypdf is not installed")
    pdf = pypdf.PdfReader(io.BytesIO(page.pdf(format=size, prefer_css_page_size=True)))
    return [" ".join(one.extract_text().split()) for one in pdf.pages]


def test_the_result_takes_two_screens_and_all_else_is_folded(changed_page):
    """Verdict, picture, one row for each target and failed checks; all else is folded, and can be unfolded."""
    page = changed_page
    page.set_viewport_size({"width": 1280, "height": 800})
    assert page.locator(".hero").bounding_box()["y"] < 400, "the picture is in the upper half of the screen"
    assert page.locator("#checks").bounding_box()["y"] < 1600, "the checks are in the second screen"
    assert page.locator("#modes table.modes").first.locator("tbody tr").count() == 5
    assert page.locator("details[open]").count() == 0
    page.get_by_label("Unfold all").check()
    assert page.evaluate("() => document.querySelector('#r5-decay').checkVisibility()")


@pytest.mark.parametrize(("size", "width_mm", "height_mm"), [("A4", 210, 297), ("Letter", 215.9, 279.4)])
def test_a_printed_page_of_each_recording_none_half_empty(changed_page, paper_run, size, width_mm, height_mm):
    page, count = changed_page, len(paper_run.recordings)
    pages = printed(page, size)
    ratios = page.locator("#modes table.modes:not(.also) td:nth-child(4) data").all_text_contents()
    assert all(ratio in pages[0] for ratio in ratios), "the answer on the first page"
    first = next(k for k, text in enumerate(pages) if text.startswith(paper_run.recordings[0].file))
    for k, (recording, ratio) in enumerate(zip(paper_run.recordings, ratios, strict=True), first):
        assert pages[k].startswith(recording.file)
        missing = [text for text in (ratio, "90 % interval", "Recorded at", "Onset") if text not in pages[k]]
        assert not missing, (recording.file, missing)
        # in the table, and with its meaning below it
        flags = [flag for mode in recording.identification.modes if mode.target for flag in mode.flags]
        assert all(pages[k].count(flag) >= 2 for flag in flags), (recording.file, flags)
    titles = tuple(" ".join(title.split()) for title in page.locator("h2, h3").all_text_contents())
    assert not [text[-60:] for text in pages if text.endswith(titles)], "a heading without what it heads"
    rest = " ".join(pages[first + count :])
    order = [rest.index(title) for title in ("Predictive", "Model updating", "checks, largest", "Budget")]
    assert order == sorted(order)
    assert not [word for word in ("Hold still", "Drag over", "Unfold", "BibTeX") if word in " ".join(pages)]
    page.get_by_label("Unfold all").check()
    assert "BibTeX" in " ".join(printed(page, size)), "the appendix is printed on demand"
    page.get_by_label("Unfold all").uncheck()
    # Heights in pixels of 1/96 inch, without margins of 12 mm. What is kept whole after the recordings is, with two
    # headings above it, less than half a page: every page but the last is half full, which limits their number.
    page.set_viewport_size({"width": round((width_mm - 24) / 25.4 * 96), "height": 800})
    page.emulate_media(media="print")
    total, whole, headings = page.evaluate(
        "() => { const parts = [...document.querySelectorAll('main > details, #checks')].filter("
        " e => e.checkVisibility());"
        " const height = e => e.getBoundingClientRect().height, most = (all, of) => Math.max(...parts.flatMap("
        " p => [...p.querySelectorAll(all)].filter(of).map(height)));"
        " return [parts.reduce((sum, e) => sum + height(e), 0),"
        " most('*', e => getComputedStyle(e).breakInside === 'avoid'), 2 * most('h2, h3', () => true) ]; }"
    )
    usable = (height_mm - 24) / 25.4 * 96
    assert whole + headings < usable / 2
    assert first <= 2
    assert len(pages) <= first + count + math.ceil(total / (usable - whole - headings))


def test_a_phone_shows_frequency_and_damping_of_every_mode_and_letters_of_10_pixels(changed_page):
    page = changed_page
    page.set_viewport_size({"width": 390, "height": 844})
    rows = page.locator("#modes table.modes").first.locator("tbody tr").all()
    boxes = [[v.bounding_box() for v in row.locator("data").all()] for row in rows]
    assert all(b["x"] >= 0 and b["x"] + b["width"] <= 390 for row in boxes for b in row)
    assert all(f["x"] + f["width"] <= z["x"] for f, z in boxes), "side by side, not over each other"
    scale = "svg => svg.getBoundingClientRect().width / svg.viewBox.baseVal.width"
    # Labels have 8.5 units of the drawing, ticks 8.
    assert 8.5 * page.locator("#all-damping svg").evaluate(scale) >= 10.0
    drawing = page.locator("#r1-decay .drawing")
    page.get_by_label("Unfold all").check()
    assert page.locator("#r1-decay svg").bounding_box()["width"] <= 390, "the whole figure"
    drawing.focus()
    assert 8.0 * page.locator("#r1-decay svg").evaluate(scale) >= 10.0, "legible after a tap"


def test_a_link_opens_the_folded_section_it_leads_to(changed_page):
    page = changed_page
    page.locator("#modes a[href='#r3']").first.click()
    assert page.locator("details:has(> #r3)").get_attribute("open") is not None
    box = page.locator("summary:has(+ #r3)").bounding_box()
    nav = page.locator("nav").bounding_box()
    assert nav["y"] <= 1, "the contents stay in view"
    assert box["y"] >= nav["y"] + nav["height"] - 1, "and do not cover the section"


@pytest.mark.parametrize("unfolded", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_axe_finds_nothing(opened, one_html, unfolded):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-playwright-python")
    page = opened(one_html, color_scheme="light")
    for scheme, rules in (("light", None), ("dark", {"runOnly": ["color-contrast"]})):
        # all other rules concern the elements alone
        page.emulate_media(color_scheme=scheme)
        page.get_by_label("Unfold all").set_checked(unfolded)
        found = axe.Axe().run(page, options=rules).response
        assert [(v["id"], v["nodes"][0]["html"]) for v in found["violations"]] == []
        assert "color-contrast" in {rule["id"] for rule in found["passes"]}, scheme


def test_every_measured_number_equals_the_summary(paper_page, paper_run):
    table = json.loads(json.dumps(summary(paper_run)))
    known = {m[k] for r in table["recordings"] for m in r["modes"] for k in ("frequency_hz", "damping_ratio")}
    columns = ("damping_ratio_simulated", "frequency_simulated_hz", "nrmse")
    known |= {row[key] for row in table["comparison"] for key in columns}
    sums = [score[key] for score in table["scores"] for key in ("log_density", "crps")]
    known |= {one["total"] / one["samples"] for one in sums}
    known |= {score["coverage"] for score in table["scores"]}
    known |= {s["log_density_gain"]["total"] for s in table["scores"]}
    for selector in ("table.modes", "table.comparison", "table.scores"):
        shown = [float(v.get_attribute("value")) for v in paper_page.locator(f"{selector} data").all()]
        assert len(shown) >= 6
        assert set(shown) <= known, set(shown) - known


def test_figures_follow_the_colour_scheme(opened, one_html):
    page = opened(one_html, color_scheme="light")
    assert text_brightness(page) < 200
    page.emulate_media(color_scheme="dark")
    assert text_brightness(page) > 600


@pytest.mark.parametrize(
    ("count", "scripts"), [(0, True), (1, False), (50, True), pytest.param(50, False, marks=pytest.mark.slow)]
)
def test_any_number_of_recordings(opened, build, count, scripts):
    html = build(runs.run_result([runs.recording(0, seconds=1.0)] * count))
    # The size of the page of five recordings in docs/files.md.
    assert len(html) < 2e6
    page = opened(html, java_script_enabled=scripts)
    assert page.locator("article").count() == count
    assert page.locator("table.modes:not(.also) tbody tr").count() == count
    assert page.locator("script").count() == (count <= 12), "figures that are not drawn need no zoom"


def test_mode_shapes_swing_as_one_and_rest_where_motion_is_not_wanted(opened, build, one_result, paper_run):
    html = build(replace(one_result, beam=paper_run.beam))
    assert html.count('class="theory moving"') == 1
    # y of the last marker over that at rest, and the factor of the line of theory beside it
    at = """() => { const svg = document.querySelector('.sways svg'), dots = svg.querySelectorAll('circle');
      const dot = dots[dots.length - 1], of = e => new DOMMatrix(getComputedStyle(e).transform);
      return [of(dot).m42 / parseFloat(dot.style.getPropertyValue('--y')), of(svg.querySelector('.theory')).m22]; }"""
    page = opened(html)
    page.get_by_label("Unfold all").check()
    seen = []
    for _ in range(20):
        seen.append(page.evaluate(at))
        page.wait_for_timeout(70)
    dots, line = np.array(seen).T
    np.testing.assert_allclose(dots, line, atol=0.01)
    assert np.ptp(line) > 1.0
    assert np.max(np.abs(line)) <= 1.0 + 1e-6
    page.emulate_media(reduced_motion="reduce")
    assert page.evaluate(at) == pytest.approx([1.0, 1.0])
    page.emulate_media(reduced_motion="no-preference", media="print")
    assert page.evaluate(at) == pytest.approx([1.0, 1.0])


def zoomed(page, kind, start, end):
    """Drag over a share of the width of the first axes of a figure; its SVG, with the range and the labels in it."""
    page.get_by_label("Unfold all").check()
    svg = page.locator(f"#r1-{kind} svg")
    svg.scroll_into_view_if_needed()
    x, y, width, height, *limits = json.loads(svg.get_attribute("data-axes"))[0]
    points = page.evaluate(
        "([s, points]) => points.map(([x, y]) => { const p = new DOMPoint(x, y).matrixTransform("
        "document.querySelector(s).getScreenCTM()); return [p.x, p.y]; })",
        [f"#r1-{kind} svg", [[x + share * width, y + 0.5 * height] for share in (start, end)]],
    )
    page.mouse.move(*points[0])
    page.mouse.down()
    page.mouse.move(*points[1])
    page.mouse.up()
    return svg, limits


def ticks_below(svg):
    """Numbers under the lowest axes, and where they stand."""
    return svg.evaluate(
        "svg => [...[...svg.querySelectorAll('g.axes')].at(-1).querySelector('.axis').querySelectorAll('text')]"
        ".filter(t => t.getClientRects().length && !isNaN(t.textContent))"
        ".map(t => [Number(t.textContent), Number(t.getAttribute('x'))])"
    )


def numbers_below(svg):
    return [number for number, _ in ticks_below(svg)]


def test_a_figure_is_zoomed_by_dragging_and_restored_by_a_double_click(opened, one_html):
    page = opened(one_html, viewport={"width": 1200, "height": 900})
    before = page.evaluate("() => document.querySelector('#r1-decay svg').getBoundingClientRect().toJSON()")
    whole = numbers_below(page.locator("#r1-decay svg"))
    svg, (low, high, *_) = zoomed(page, "decay", 0.25, 0.5)
    seen = numbers_below(svg)
    first, last = low + 0.25 * (high - low), low + 0.5 * (high - low)
    # A pointer stands on whole pixels: the range is known to a few thousandths of the width.
    slack = 0.005 * (high - low)
    assert len(seen) >= 3
    assert seen != whole
    assert first - slack <= min(seen) < max(seen) <= last + slack
    x, _, width, *_ = json.loads(svg.get_attribute("data-axes"))[0]
    for number, at in ticks_below(svg):
        assert at == pytest.approx(x + width * (number - first) / (last - first), abs=0.02 * width)
    # The curve of every axes above the same time axis is stretched about the same instant, and lines keep their width.
    shift = svg.evaluate(
        "svg => [...svg.querySelectorAll('g.axes')].map(a => [...a.querySelectorAll('path[transform]')]"
        ".map(p => [p.transform.baseVal.consolidate().matrix.a, p.style.vectorEffect]))"
    )
    assert all(axes for axes in shift)
    for stretch, effect in (one for axes in shift for one in axes):
        assert stretch == pytest.approx(4.0, rel=0.02)
        assert effect == "non-scaling-stroke"
    svg.dblclick()
    assert numbers_below(svg) == whole
    after = page.evaluate("() => document.querySelector('#r1-decay svg').getBoundingClientRect().toJSON()")
    assert (after["width"], after["height"]) == (before["width"], before["height"])


def test_a_figure_is_zoomed_by_keys(opened, one_html):
    page = opened(one_html)
    page.get_by_label("Unfold all").check()
    svg = page.locator("#r1-spectrum svg")
    whole = numbers_below(svg)
    page.locator("#r1-spectrum .drawing").focus()
    page.keyboard.press("+")
    near = numbers_below(svg)
    assert max(near) - min(near) < 0.7 * (max(whole) - min(whole))
    page.keyboard.press("ArrowRight")
    assert max(numbers_below(svg)) > max(near)
    page.keyboard.press("0")
    assert numbers_below(svg) == whole


@pytest.mark.parametrize(
    ("plots", "scripts"), [("interactive", True), ("interactive", False), ("static", True)]
)
def test_the_page_says_and_shows_the_same_without_its_script(opened, build, one_result, plots, scripts):
    html = build(one_result, plots=plots)
    if plots == "static":
        assert "script" not in html[: html.index("<style>")], "the policy of the page allows none"
    page = opened(html, java_script_enabled=scripts)
    assert page.locator("script").count() == (plots == "interactive")
    assert page.locator("#r1-decay svg path").count() > 10
    assert page.locator("#modes table.modes data").count() == 2
    page.get_by_text("Unfold all").click()
    hint = page.locator(".zoom-hint")
    assert (hint.count() == 1 and hint.is_visible()) == (plots == "interactive" and scripts)


def test_no_script_but_that_of_the_page_runs(browser, tmp_path, one_html):
    """As if a name had not been escaped: the page allows one script by its hash."""
    html = one_html.replace(
        "<main", "<script>window.PWN=1</script><img src='data:,' alt='' onerror='window.PWN=1'><main", 1
    )
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    page = browser.new_page()
    page.goto(path.as_uri())
    state = page.evaluate("() => [window.PWN === undefined, document.documentElement.className]")
    assert state == [True, "zoomable"]
    page.close()
