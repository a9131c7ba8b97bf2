"""The studio in a browser: from a recording to its configuration, and to the report."""

import json
import shutil
import tomllib

import numpy as np
import pytest
from support.decay_clip import write_decay
from support.paths import REALDATA
from support.studio import CHROMIUM, answer, click_frame, opened, running_studio

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: install Debian's package chromium"),
    pytest.mark.timeout(600),
]
# A step of the page on a busy machine.
PATIENCE_MS = 120_000


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
            page.set_default_timeout(PATIENCE_MS)
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
            assert "+fps = 200" in dialog.inner_text()
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
            page.set_default_timeout(PATIENCE_MS)
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


FORKS = REALDATA / "tuning_forks"


@pytest.mark.slow  # the same path without the run is above; the run is that of the command line
@pytest.mark.skipif(not FORKS.is_dir(), reason="the folder of real recordings, ../shared/realdata, is absent")
def test_from_a_fork_without_markers_to_its_report(tmp_path):
    """31.971 Hz by an independent fit, as in test_real_recordings."""
    folder, out = tmp_path / "fork", tmp_path / "out"
    folder.mkdir()
    (source,) = FORKS.glob("tuning_hz32_fps1000*.mp4")
    shutil.copy(source, folder)
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        page.set_default_timeout(PATIENCE_MS)
        page.get_by_text("640 x 420").wait_for()
        page.get_by_label("Recorded rate of all recordings / fps").fill("1000")
        page.get_by_role("button", name="Set markers of").click()
        page.get_by_text("of 3336").wait_for()
        click_frame(page, 298, 102)
        page.get_by_role("button", name="Delete m1").wait_for()
        click_frame(page, 364, 102)
        page.get_by_role("button", name="Delete m2").wait_for()
        page.get_by_role("tab", name="Test track").click()
        page.get_by_role("button", name="Track", exact=True).click()
        page.get_by_text("128 frames of").wait_for()
        assert page.locator("table.list:visible tbody tr").count() == 2
        page.get_by_role("tab", name="Run and report").click()
        page.get_by_role("button", name="Save and run").click()
        page.get_by_role("dialog").get_by_role("button", name="Save and run").click()
        page.get_by_text("The run took").wait_for(timeout=500_000)
        page.frame_locator("iframe").get_by_text("31.97").first.wait_for()
    (recording,) = json.loads((out / "summary.json").read_text())["recordings"]
    target = next(mode for mode in recording["modes"] if mode["target"])
    assert abs(target["frequency_hz"] - 31.97) < 0.03
