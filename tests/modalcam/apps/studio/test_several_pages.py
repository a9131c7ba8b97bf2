"""Several pages of one studio, files that change under it, and pages that close while a run goes on."""

import tomllib

import pytest
from kit.films import write_decay
from support.browser import NEEDS_CHROMIUM
from support.studio import RUN_MS, another_browser, click_frame, opened, running_studio, show, targets

pytestmark = [
    NEEDS_CHROMIUM,
    pytest.mark.slow,  # drafts, runs and deleted recordings are tested without a browser in this folder
    pytest.mark.timeout(900),
]
RATE = "Recorded rate of all recordings / fps"


@pytest.fixture
def folder(tmp_path):
    return write_decay(tmp_path / "videos")


def test_two_browsers_edit_one_draft_and_one_of_them_runs(folder, tmp_path):
    out = tmp_path / "out"
    with (
        running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _),
        opened(address) as first,
        another_browser(first, address) as second,
    ):
        second.get_by_text("64 x 32").wait_for()
        first.get_by_label(RATE).fill("200")
        first.keyboard.press("Tab")
        second.wait_for_function(f"() => document.querySelector('[aria-label=\"{RATE}\"]')?.value === '200'")
        first.get_by_text("unsaved changes").wait_for()
        second.get_by_role("button", name="Undo").click()
        first.get_by_text("saved", exact=True).wait_for()
        assert first.get_by_label(RATE).input_value() == "100"
        for page in (first, second):
            show(page, "Run and report")
        first.get_by_role("button", name="Save and run").click()
        second.get_by_role("columnheader", name="tracking").wait_for()
        assert second.get_by_role("button", name="Save and run").is_disabled()
        # The tab of the one who started it is closed: the run goes on and the other page shows its end.
        first.goto("about:blank")
        second.get_by_text("The run took").wait_for(timeout=RUN_MS)
        second.frame_locator("iframe").get_by_role("heading").first.wait_for()
        second.get_by_role("button", name="Save and run").click()
        second.get_by_text("up to date").wait_for()
        second.get_by_role("cell", name="done").first.wait_for(state="detached")
    assert targets(out)["take.mkv"]["frequency_hz"] == pytest.approx(10.2, abs=0.02)


def test_a_page_that_closes_during_a_run_finds_it_again(folder, tmp_path):
    out = tmp_path / "out"
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        show(page, "Run and report")
        page.get_by_role("button", name="Save and run").click()
        page.get_by_role("columnheader", name="tracking").wait_for()
        page.goto("about:blank")
        page.goto(address)
        show(page, "Run and report")
        page.get_by_role("button", name="Cancel the run").click()
        page.get_by_text("The run took").wait_for(timeout=RUN_MS)
        # It may have ended before the click.
        ended = page.get_by_text("The run took").inner_text()
        assert "cancelled; what was finished is kept" in ended or "finished" in ended


def test_files_that_change_under_the_studio(folder, tmp_path):
    config = folder / "experiment.toml"
    with (
        running_studio("studio", folder, "-o", tmp_path / "out", cwd=tmp_path) as (address, _),
        opened(address, expect_missing=True) as page,
    ):
        page.get_by_text("64 x 32").wait_for()
        page.get_by_role("button", name="Set markers of").click()
        page.get_by_text("of 140 (0 to 139)").wait_for()
        click_frame(page, 20, 12)
        page.get_by_role("button", name="Delete m1").wait_for()
        config.write_text(config.read_text() + "# by hand\n")
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        page.get_by_text("was changed by another program").wait_for()
        assert config.read_text().endswith("# by hand\n")
        page.get_by_role("button", name="Start over").click()
        page.get_by_role("button", name="Delete m1").wait_for(state="detached")
        page.get_by_role("button", name="Undo").click()
        page.get_by_role("button", name="Delete m1").wait_for()
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        page.get_by_text("saved", exact=True).wait_for()
        (folder / "take.mkv").unlink()
        page.get_by_label("Frame", exact=True).first.fill("50")
        page.get_by_text("the recording is no longer there").wait_for()
        show(page, "Test track")
        page.get_by_role("button", name="Track", exact=True).click()
        page.get_by_text("the recording is no longer there").last.wait_for()
    assert "points_px" in tomllib.loads(config.read_text())["recordings"][0]
