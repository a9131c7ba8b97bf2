"""The studio in a browser: from a recording to its configuration."""

import json
import shutil
import tomllib

import numpy as np
import pytest
from kit.films import write_decay, write_faint_mode
from support.browser import NEEDS_CHROMIUM
from support.paths import ROOT
from support.studio import RUN_MS, answer, click_frame, opened, running_studio, save_and_run, show, targets

from modalcam.config import load_config

pytestmark = [NEEDS_CHROMIUM, pytest.mark.timeout(600)]


BEAM = {
    "Length / mm": "500",
    "Width / mm": "5",
    "Thickness / mm": "0.5",
    "Density / (kg/m³)": "8000",
    "Elastic modulus / MPa": "210000",
}


def test_markers_set_by_clicks_are_saved(tmp_path):
    folder, out = write_decay(tmp_path / "videos", name='<img src=x onerror="alert(1)">'), tmp_path / "out"
    before = (folder / "experiment.toml").read_bytes()
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _):
        assert answer(address)[0] == 403
        assert answer(address, "/frame/0/0.png")[0] == 403
        assert answer(address, "/?" + address.split("?")[1], Host="evil.example")[0] == 421
        with opened(address) as page:
            page.get_by_text("64 x 32").wait_for()
            rate = page.get_by_label("Recorded rate of all recordings / fps")
            assert rate.input_value() == "100"
            rate.fill("200")
            page.keyboard.press("Tab")
            page.get_by_text("unsaved changes").wait_for()
            page.get_by_label("Tolerance of the clock / ppm").fill("20")
            page.get_by_label("Number of the mode of").fill("1")
            page.keyboard.press("Tab")
            show(page, "Beam")
            page.get_by_role("button", name="Remove the beam").click()
            page.get_by_text("Without a beam nothing is simulated.").wait_for()
            for name, value in BEAM.items():
                page.get_by_label(name).fill(value)
                page.keyboard.press("Tab")
            page.get_by_text("The beam is complete.").wait_for()
            page.get_by_label("Orientation").click()
            page.get_by_role("option", name="angled").click()
            page.get_by_label("Angle / °").fill("0")
            page.keyboard.press("Tab")
            page.get_by_text("Next: look at the markers").wait_for()
            show(page, "Recordings")
            page.get_by_role("button", name="Set markers of").click()
            page.get_by_text("of 140 (0 to 139)").wait_for()
            click_frame(page, 20, 12)
            page.get_by_role("button", name="Delete m1").wait_for()
            page.get_by_text("Next: run").wait_for()
            click_frame(page, 40, 20)
            page.get_by_role("button", name="Delete m2").wait_for()
            page.get_by_role("button", name="Undo").click()
            page.get_by_role("button", name="Delete m2").wait_for(state="detached")
            page.get_by_label("What drives the beam").click()
            page.get_by_text("Wind, traffic: not measured").click()
            page.get_by_label("Markers on the clamp").fill("m1")
            page.keyboard.press("Tab")
            assert (folder / "experiment.toml").read_bytes() == before
            assert (out / "state" / "draft.json").is_file()
            page.get_by_role("button", name="Save", exact=True).click()
            dialog = page.get_by_role("dialog")
            dialog.get_by_text("+fps = 200").wait_for()
            dialog.get_by_role("button", name="Save").click()
            page.get_by_text("saved", exact=True).wait_for()
    saved = tomllib.loads((folder / "experiment.toml").read_text())
    (entry,) = saved["recordings"]
    assert np.allclose(entry["points_px"], [[20, 12]], atol=0.2), "a click is placed to a tenth of a pixel"
    assert (entry["excitation"], entry["input"]) == ("ambient", ["m1"])
    assert (saved["camera"]["fps"], saved["camera"]["fps_tolerance_ppm"], entry["mode"]) == (200, 20, 1)
    assert [*saved["beam"].values()] == [*map(float, BEAM.values()), "angled", 0]
    assert not (out / "state" / "draft.json").exists()
    names = [p.name for p in sorted(folder.iterdir())]
    assert names == ['<img src=x onerror="alert(1)">.mkv', "experiment.toml"]


@pytest.mark.slow  # the same frame view is that of the studio, above
def test_picked_points_are_printed(tmp_path):
    write_decay(tmp_path)
    with running_studio("pick", tmp_path / "take.mkv", cwd=tmp_path, address_on="stderr") as (address, ran):
        with opened(address) as page:
            page.get_by_text("of 140 (0 to 139)").wait_for()
            click_frame(page, 20, 12)
            page.get_by_role("button", name="Delete m1").wait_for()
            page.get_by_role("button", name="Done").click()
            page.get_by_text("This page can be closed").wait_for()
        printed = tomllib.loads(ran.stdout.read())
    (entry,) = printed["recordings"]
    assert entry["file"] == "take.mkv"
    assert entry["kind"] == "patch"
    assert np.allclose(entry["points_px"], [[20, 12]], atol=0.2)


def serious(page, within=None):
    """What axe-core finds, but for its minor remarks; of the whole page, or within an element."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page, context=within).response["violations"]
    return [(one["id"], [node["html"] for node in one["nodes"]]) for one in found if one["impact"] != "minor"]


IS_OPAQUE = "() => !document.querySelector('[role=dialog] .q-dialog__inner').getAnimations().length"


def press_until(page, key, focused, most=80, keyboard=None):
    """Press a key until an element has the focus, given by a function of the element in the page or frame."""
    for _ in range(most):
        if page.evaluate(f"() => ({focused})(document.activeElement)"):
            return
        (keyboard or page.keyboard).press(key)
    raise AssertionError((key, focused))


def labelled(name):
    return f"e => (e.ariaLabel || e.labels?.[0]?.innerText || e.innerText || '').trim().startsWith({name!r})"


def press_on(page, name):
    """Go on to a control by Tab and press it."""
    press_until(page, "Tab", labelled(name))
    page.keyboard.press("Enter")


def type_into(page, name, text):
    press_until(page, "Tab", labelled(name))
    page.keyboard.press("Control+A")
    page.keyboard.type(text)


def open_view(page, name):
    """Go back to the tabs and along them by the arrow keys."""
    page.keyboard.press("Control+Home")
    press_until(page, "Shift+Tab", "e => e.role === 'tab' || e.getAttribute('role') === 'tab'", most=200)
    page.keyboard.press("Home")
    press_until(page, "ArrowRight", labelled(name))
    page.keyboard.press("Enter")
    page.get_by_role("heading", name=name, level=2).wait_for()


def checked(page, width):
    # A message that fades has any contrast.
    page.locator(".q-notification").first.wait_for(state="detached")
    assert serious(page) == []
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width


@pytest.mark.slow  # the path with the mouse is above
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (800, "dark")])
def test_by_keyboard_alone_and_without_findings_of_axe(tmp_path, width, scheme):
    """From the recorded rate to a link in the report; the film shows 10.2 Hz at 100 fps, said to be 200 fps."""
    folder, out = write_decay(tmp_path / "videos"), tmp_path / "out"
    options = {"viewport": {"width": width, "height": 900}, "color_scheme": scheme}
    with (
        running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _),
        opened(address, **options) as page,
    ):
        page.get_by_text("64 x 32").wait_for()
        checked(page, width)
        type_into(page, "Recorded rate of all", "200")
        press_on(page, "Set markers of")
        page.get_by_text("of 140 (0 to 139)").wait_for()
        type_into(page, "x / px", "32")
        type_into(page, "y / px", "16")
        press_on(page, "Add")
        page.get_by_role("button", name="Delete m1").wait_for()
        type_into(page, "Name of m1", "dot")
        page.keyboard.press("Tab")
        page.locator(".frame-image text", has_text="dot").wait_for(state="attached")
        checked(page, width)
        open_view(page, "Test track")
        press_on(page, "Track")
        page.get_by_role("heading", name="This would give").wait_for()
        checked(page, width)
        open_view(page, "Decay")
        page.locator(".chart").last.wait_for()
        type_into(page, "Frequency of another mode", "33")
        press_on(page, "Fit a mode there")
        page.get_by_text("Added: 33 Hz").wait_for()
        type_into(page, "Frequency of another mode", "20.4")
        press_on(page, "Make it the target")
        page.get_by_text("Target now: 20.4 Hz").wait_for()
        checked(page, width)
        open_view(page, "Run and report")
        press_on(page, "Save and run")
        page.get_by_role("dialog").wait_for()
        page.wait_for_function(IS_OPAQUE)
        # Of buttons behind it, axe takes the page's background for their own: white on #00664a is 7.0 to 1.
        assert serious(page, "[role=dialog]") == []
        press_until(page, "Tab", "e => e.closest('[role=dialog]') && e.innerText.trim() === 'Save and run'")
        page.keyboard.press("Enter")
        page.get_by_text("The run took").wait_for(timeout=RUN_MS)
        report = page.frame_locator("iframe")
        report.get_by_role("heading").first.wait_for()
        checked(page, width)
        press_until(page, "Tab", "e => e.tagName === 'IFRAME'")
        # The frame holds a document of its own: its link has the focus there.
        inside = page.frames[-1]
        press_until(inside, "Tab", "e => e.tagName === 'A'", keyboard=page.keyboard)
    saved = load_config(folder / "experiment.toml").for_recording("take.mkv")
    assert (saved.fps, saved.kind, saved.points_px) == (200, "patch", ((32.0, 16.0),))
    assert (saved.names, saved.target_frequency_hz, saved.add_hz) == (("dot",), 20.4, (33.0,))
    assert targets(out)["take.mkv"]["frequency_hz"] == pytest.approx(20.4, rel=0.01)


@pytest.mark.slow  # the model of these steps is tested in test_session and test_markers_edit
def test_a_proposed_line_is_accepted_and_dots_are_named_by_keyboard(tmp_path):
    folder = tmp_path / "videos"
    folder.mkdir()
    shutil.copy(ROOT / "sample_bare" / "mode3.avi", folder)
    write_decay(folder)
    (folder / "experiment.toml").write_text("[camera]\nfps = 100\n")
    out = tmp_path / "out"
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        press_on(page, "Set markers of mode3.avi")
        page.get_by_text("of 460 (0 to 459)").wait_for()
        press_on(page, "Propose")
        page.get_by_role("button", name="Use the line").wait_for()
        assert page.locator(".frame-image .proposed-beam").count() == 1
        assert page.locator(".frame-image .station").count() == 60, "as many as are drawn of a long line"
        checked(page, 1280)
        press_on(page, "Use the line")
        page.get_by_role("button", name="Remove the line").wait_for()
        assert page.locator(".frame-image .beam").count() == 1
        assert page.locator(".frame-image .proposed-beam").count() == 0
        open_view(page, "Recordings")
        press_on(page, "Set markers of take.mkv")
        page.get_by_text("of 140 (0 to 139)").wait_for()
        press_on(page, "Detect markers")
        page.get_by_text("1 markers detected: m1").wait_for()
        type_into(page, "Name of m1", "tip")
        page.keyboard.press("Tab")
        page.locator(".frame-image text", has_text="tip").wait_for(state="attached")
        # The focus goes on to the next control.
        assert page.evaluate("() => document.activeElement.ariaLabel") == "Leave out m1"
        press_on(page, "Undo")
        page.locator(".frame-image text", has_text="m1").wait_for(state="attached")
        assert page.get_by_label("Name of m1").input_value() == "m1"
        draft = tomllib.loads(json.loads((out / "state" / "draft.json").read_text())["text"])
    (line,) = (one for one in draft["recordings"] if one["file"] == "mode3.avi")
    assert line["kind"] == "line"
    assert np.allclose(line["line_px"], [[16, 9], [16, 508]], atol=4.0), "as its configuration has it"


FAINT_HZ, FAINT_PX = 33.0, 0.014
# Position in the page of a frequency on the spectrum, the last chart.
PLACE_ON_SPECTRUM = """(hz) => {
    const box = [...document.querySelectorAll('.chart')].at(-1), chart = getElement(Number(box.id.slice(1))).chart;
    const middle = chart.getHeight() / 2, at = box.getBoundingClientRect();
    return [at.x + chart.convertToPixel({xAxisIndex: 0}, hz), at.y + middle];
}"""


@pytest.mark.slow  # the table of modes is used in the test above
def test_a_mode_below_the_threshold_is_added_by_a_click_on_the_spectrum(tmp_path):
    """A mode of 0.7 sd of a position, known to 0.06 Hz from six dots; at 41 Hz there is none."""
    folder = tmp_path / "videos"
    folder.mkdir()
    write_faint_mode(folder, FAINT_HZ, FAINT_PX)
    (folder / "experiment.toml").write_text('[camera]\nfps = 100\n[markers]\nkind = "blob"\n')
    out = tmp_path / "out"
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        page.get_by_role("button", name="Set markers of").wait_for()
        show(page, "Test track")
        page.get_by_label("Length").click()
        page.get_by_role("option", name="all frames").click()
        page.get_by_role("button", name="Track", exact=True).click()
        page.get_by_text("400 frames of").wait_for()
        show(page, "Decay")
        rows = page.locator("tr").filter(has=page.get_by_role("button", name="Reject"))
        rows.first.wait_for()
        assert rows.count() == 1
        page.locator(".chart").last.scroll_into_view_if_needed()
        page.mouse.click(*page.evaluate(PLACE_ON_SPECTRUM, FAINT_HZ))
        wanted = page.get_by_label("Frequency of another mode / Hz")
        page.wait_for_function("(e) => e.value !== ''", arg=wanted.element_handle())
        assert float(wanted.input_value()) == pytest.approx(FAINT_HZ, abs=0.5)
        page.get_by_role("button", name="Fit a mode there").click()
        page.get_by_role("cell", name="ADDED").wait_for()
        found_hz = float(rows.nth(1).locator("td").first.inner_text())
        assert found_hz == pytest.approx(FAINT_HZ, abs=0.24), "four standard deviations"
        wanted.fill("41")
        page.get_by_role("button", name="Fit a mode there").click()
        page.get_by_text("does not determine a mode at 41 Hz").wait_for()
        assert rows.count() == 2
        page.get_by_role("button", name="Remove 41 Hz").click()
        page.get_by_text("does not determine a mode").wait_for(state="detached")
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        page.get_by_text("saved", exact=True).wait_for()
    (hz,) = load_config(folder / "experiment.toml").for_recording("take.mkv").add_hz
    assert hz == pytest.approx(FAINT_HZ, abs=0.5)


@pytest.mark.slow  # the model of each view is tested in this folder
def test_every_view_is_shown_without_an_error_before_and_after_a_run(tmp_path):
    """Charts change while another view is open, and are not drawn: `opened` fails for what the console says."""
    folder, out = write_decay(tmp_path / "videos"), tmp_path / "out"
    write_decay(folder, name="other", seed=3)
    views = ("Recordings", "Markers", "Beam", "Test track", "Run and report", "Decay")
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        for is_run in (False, True):
            for view in views:
                show(page, view)
            if not is_run:
                save_and_run(page)
                page.get_by_role("cell", name="10.2").first.wait_for()
        for file in ("other.mkv", "take.mkv"):
            page.get_by_label("Recording").click()
            page.get_by_role("option", name=file).click()
            for _ in range(2):
                page.get_by_role("button", name="Show the last run").click()
            show(page, "Markers")
            page.get_by_role("button", name="Detect markers").click()
            # By the process that has read both decays before.
            page.get_by_text("1 markers detected").wait_for()
            show(page, "Decay")
        page.get_by_role("button", name="Reject").first.wait_for()
        page.get_by_text("The report is that of these settings.").wait_for()
