"""From recordings to their report in the browser: patches, lines, printed markers, an existing configuration."""

import json
import re
import shutil

import pytest
from kit.beams import experiment
from support.browser import NEEDS_CHROMIUM
from support.paths import REALDATA, REALDATA_ABSENT, SAMPLES
from support.studio import RUN_MS, click_frame, opened, running_studio, save_and_run, show, targets

from modalcam.apps.film import film_config
from modalcam.config import beam_properties, load_config
from modalcam.pipeline import Progress
from sim.beam import AncfBeam, beam_modes
from sim.render import RecordingPlan

pytestmark = [
    NEEDS_CHROMIUM,
    pytest.mark.slow,  # the path to the configuration is in test_studio_browser; the run is that of the command line
    pytest.mark.timeout(900),
]
FORKS = REALDATA / "tuning_forks"


@pytest.mark.skipif(not FORKS.is_dir(), reason=REALDATA_ABSENT)
@pytest.mark.parametrize(
    ("tool", "clicks", "shown", "markers"),
    [
        # The weights of the prongs; one prong from the edge of the picture to its weight.
        (None, ((298, 102), (364, 102)), "Delete m{}", 2),
        ("Line", ((346, 412), (358, 140)), "Remove the line", 24),
    ],
)
def test_from_a_fork_without_markers_to_its_report(tmp_path, tool, clicks, shown, markers):
    """31.971 Hz by an independent fit, as in test_real_recordings."""
    folder, out = tmp_path / "fork", tmp_path / "out"
    folder.mkdir()
    (source,) = FORKS.glob("tuning_hz32_fps1000*.mp4")
    shutil.copy(source, folder)
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        page.get_by_text("640 x 420").wait_for()
        page.get_by_label("Recorded rate of all recordings / fps").fill("1000")
        page.get_by_role("button", name="Set markers of").click()
        page.get_by_text("of 3336").wait_for()
        if tool is not None:
            page.get_by_role("radio", name=tool).click()
        for number, (x, y) in enumerate(clicks, 1):
            click_frame(page, x, y)
            if tool is None:
                page.get_by_role("button", name=shown.format(number)).wait_for()
        page.get_by_role("button", name=shown.format(len(clicks))).wait_for()
        show(page, "Test track")
        page.get_by_role("button", name="Track", exact=True).click()
        page.get_by_text("128 frames of").wait_for()
        rows = page.locator("table.list:visible").first.locator("tbody tr")
        assert rows.count() == markers
        page.get_by_role("heading", name="This would give").wait_for()
        save_and_run(page)
        page.frame_locator("iframe").get_by_text("31.97").first.wait_for()
    (target,) = targets(out).values()
    assert abs(target["frequency_hz"] - 31.97) < 0.03


CODES = experiment(
    """\
[camera]
fps = 200
mm_per_px = 1.0

[markers]
kind = "aruco"
dictionary = "DICT_4X4_50"
size_mm = 16.0
positions_mm = [40.0, 120.0, 200.0, 290.0]

""",
    length_mm=300.0,
    width_mm=20.0,
    thickness_mm=0.6,
    elements=12,
)


def test_from_printed_markers_to_the_report(tmp_path):
    """Two rendered clips: the frequencies are those of the theory of the beam, to 1 % for its motion at this size."""
    folder, out = tmp_path / "codes", tmp_path / "out"
    folder.mkdir()
    config = tmp_path / "made.toml"
    config.write_text(CODES)
    for mode in (1, 2):
        plan = RecordingPlan(mode_number=mode, tip_amplitude_m=3e-3 / mode, shake_s=0.5, decay_s=2.5)
        film_config(config, folder / f"mode{mode}.avi", plan, 0.01, mode, Progress())
    theory = beam_modes(AncfBeam(beam_properties(load_config(config).beam)), 2).frequency_hz
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        page.get_by_role("button", name="Set markers of mode1.avi").wait_for()
        page.get_by_label("Recorded rate of all recordings / fps").fill("200")
        page.get_by_role("button", name="Set markers of mode1.avi").click()
        page.get_by_role("button", name="Detect markers").click()
        page.get_by_text("4 markers detected: id0, id1, id2, id3").wait_for()
        page.get_by_label("Name of id3").fill("tip")
        page.keyboard.press("Tab")
        page.locator(".frame-image text", has_text="tip").wait_for(state="attached")
        save_and_run(page)
    found = targets(out)
    assert [found[f"mode{mode}.avi"]["frequency_hz"] for mode in (1, 2)] == pytest.approx(theory, rel=0.01)
    saved = load_config(folder / "experiment.toml")
    assert saved.camera.fps == 200
    assert [recording.names for recording in saved.recordings] == [("id0", "id1", "id2", "tip")]


def test_the_samples_keep_every_other_byte_of_their_configuration(tmp_path):
    """All five films, with the frequencies that they were rendered with."""
    folder, out = tmp_path / "samples", tmp_path / "out"
    folder.mkdir()
    for path in SAMPLES.glob("*.avi"):
        shutil.copy(path, folder)
    text = (SAMPLES / "experiment.toml").read_text()
    comments = "# films of the sample beam\n\n" + text.replace("mode = 4", "mode = 4   # struck at the tip")
    (folder / "experiment.toml").write_text(comments)
    with running_studio("studio", folder, "-o", out, cwd=tmp_path) as (address, _), opened(address) as page:
        # The pace needs the numbers of frames.
        page.get_by_text("64 x 544").wait_for()
        page.get_by_role("button", name="Set markers of mode4.avi").click()
        size = page.get_by_label("Size of a marker / mm")
        assert size.input_value() == "12"
        page.get_by_label("Exposure time / s").fill("0.0004")
        page.keyboard.press("Tab")
        page.get_by_text("unsaved changes").wait_for()
        show(page, "Run and report")
        page.get_by_role("button", name="Save and run").click()
        page.get_by_role("dialog").get_by_role("button", name="Save and run").click()
        # The pace is known before the first recording is finished.
        page.get_by_text(re.compile(r"^tracking: 0 of 5, .* frames a second, about .* s left")).wait_for()
        page.get_by_role("cell", name=re.compile(r"^\d+ %$")).first.wait_for()
        page.get_by_text("The run took").wait_for(timeout=RUN_MS)
        page.frame_locator("iframe").get_by_role("heading").first.wait_for()
    found = {file: target["frequency_hz"] for file, target in targets(out).items()}
    known = json.loads((SAMPLES / "truth.json").read_text())["recordings"]
    assert found == pytest.approx({one["file"]: one["frequency_hz"] for one in known}, rel=1e-3)
    after = (folder / "experiment.toml").read_text()
    # Other recordings take the exposure of [camera]: the entry of this one gets its own.
    assert after == comments.replace(
        'file = "mode4.avi"\nmode = 4   # struck at the tip\nfps = 500.0\n',
        'file = "mode4.avi"\nmode = 4   # struck at the tip\nfps = 500.0\nexposure_s = 0.0004\n',
    )
