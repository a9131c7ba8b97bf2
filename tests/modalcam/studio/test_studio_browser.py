"""The studio in a browser: from a recording to its configuration."""

import tomllib

import numpy as np
import pytest
from support.decay_clip import write_decay
from support.studio import CHROMIUM, answer, click_frame, opened, running_studio

from modalcam.config.toml import load_config

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: install Debian's package chromium"),
    pytest.mark.timeout(600),
]


def test_markers_set_by_clicks_are_saved(tmp_path):
    folder, out = tmp_path / "videos", tmp_path / "out"
    folder.mkdir()
    write_decay(folder, name='<img src=x onerror="alert(1)">')
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
            page.get_by_role("button", name="Set markers of").click()
            page.get_by_text("of 140 (0 to 139)").wait_for()
            click_frame(page, 20, 12)
            page.get_by_role("button", name="Delete m1").wait_for()
            click_frame(page, 40, 20)
            page.get_by_role("button", name="Delete m2").wait_for()
            page.get_by_role("button", name="Undo").click()
            page.get_by_role("button", name="Delete m2").wait_for(state="detached")
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
    assert saved["camera"]["fps"] == 200
    assert not (out / "state" / "draft.json").exists()
    assert sorted(p.name for p in folder.iterdir()) == [
        '<img src=x onerror="alert(1)">.mkv',
        "experiment.toml",
    ]


@pytest.mark.slow  # the same frame view is that of the studio, above
def test_picked_points_are_printed(tmp_path):
    write_decay(tmp_path)
    with running_studio("pick", tmp_path / "take.mkv", cwd=tmp_path, address_on="stderr") as (
        address,
        process,
    ):
        with opened(address) as page:
            page.get_by_text("of 140 (0 to 139)").wait_for()
            click_frame(page, 20, 12)
            page.get_by_role("button", name="Delete m1").wait_for()
            page.get_by_role("button", name="Done").click()
            page.get_by_text("This page can be closed").wait_for()
        printed = tomllib.loads(process.stdout.read())
    (entry,) = printed["recordings"]
    assert entry["file"] == "take.mkv"
    assert entry["kind"] == "patch"
    assert np.allclose(entry["points_px"], [[20, 12]], atol=0.2)


def serious(page):
    """What axe-core finds, but for its minor remarks."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [(one["id"], [node["html"] for node in one["nodes"]]) for one in found if one["impact"] != "minor"]


def press_until(page, key, focused, most=80):
    """Press a key until an element has the focus, given by a function of the element in the page."""
    for _ in range(most):
        if page.evaluate(f"() => ({focused})(document.activeElement)"):
            return
        page.keyboard.press(key)
    raise AssertionError((key, focused))


def labelled(name):
    return f"e => (e.ariaLabel || e.labels?.[0]?.innerText || e.innerText || '').trim().startsWith({name!r})"


@pytest.mark.slow  # the path with the mouse is above
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (800, "dark")])
def test_by_keyboard_alone_and_without_findings_of_axe(tmp_path, width, scheme):
    folder = tmp_path / "videos"
    folder.mkdir()
    write_decay(folder)
    options = {"viewport": {"width": width, "height": 900}, "color_scheme": scheme}
    with (
        running_studio("studio", folder, "-o", tmp_path / "out", cwd=tmp_path) as (address, _),
        opened(address, **options) as page,
    ):
        page.get_by_text("64 x 32").wait_for()
        assert serious(page) == []
        press_until(page, "Tab", labelled("Recorded rate of all"))
        page.keyboard.press("Control+A")
        page.keyboard.type("200")
        press_until(page, "Tab", labelled("Set markers of"))
        page.keyboard.press("Enter")
        page.get_by_text("of 140 (0 to 139)").wait_for()
        for name, value in (("x / px", "20"), ("y / px", "12")):
            press_until(page, "Tab", labelled(name))
            page.keyboard.press("Control+A")
            page.keyboard.type(value)
        press_until(page, "Tab", labelled("Add"))
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Delete m1").wait_for()
        assert serious(page) == []
        for tab in ("Test track", "Run and report", "Decay"):
            page.get_by_role("tab", name=tab).focus()
            page.keyboard.press("Enter")
            page.get_by_role("heading", name=tab, level=2).wait_for()
            assert serious(page) == [], tab
            assert page.evaluate("() => document.documentElement.scrollWidth") <= width
            if tab == "Test track":
                press_until(page, "Tab", labelled("Track"))
                page.keyboard.press("Enter")
                page.get_by_role("heading", name="This would give").wait_for()
                assert serious(page) == [], tab
        press_until(page, "Tab", labelled("Identify the test track"))
        page.keyboard.press("Enter")
        page.locator(".chart").last.wait_for()
        assert serious(page) == []
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        page.keyboard.press("Control+Home")
        press_until(page, "Shift+Tab", labelled("Save"))
        page.keyboard.press("Enter")
        page.get_by_role("dialog").wait_for()
        press_until(page, "Tab", "e => e.closest('[role=dialog]') && e.innerText.trim() === 'Save'")
        page.keyboard.press("Enter")
        page.get_by_text("experiment.toml saved").wait_for()
    saved = load_config(folder / "experiment.toml").for_recording("take.mkv")
    assert (saved.fps, saved.kind, saved.points_px) == (200, "patch", ((20.0, 12.0),))
