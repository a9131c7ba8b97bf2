"""Annotated footage: every frame of the recording, with marks at the tracked positions."""

from dataclasses import replace

import av
import numpy as np
import pytest
from kit.scenes import Recording
from kit.tracks import decoded, sample_tracks

from modalcam.tables import annotate
from tracker import POOR_FIT


@pytest.fixture
def track(tmp_path, modalcam, in_process):
    folder = tmp_path / "videos"
    folder.mkdir()
    Recording("blob", frames=24, markers=2, width_px=121, height_px=80).write(folder / "take.mkv")

    def call(target, preview):
        args = ("-o", tmp_path / "out", "--fps", 1000, "--jobs", 1, "--preview", preview)
        code, _, err = modalcam("track", folder / target, *args)
        return code, err

    return call, folder, tmp_path


def test_the_preview_has_every_frame_and_is_reproducible(track):
    call, _, tmp_path = track
    assert call("take.mkv", tmp_path / "a.mp4")[0] == 0
    with av.open(str(tmp_path / "a.mp4")) as container:
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(frames) == 24
    # 121 x 80 px enlarged four times: the longer side is at least 480 px, and both sides are even.
    assert frames[0].shape == (320, 484, 3)
    yellow = (frames[5][..., 0] > 180) & (frames[5][..., 2] < 130)
    assert yellow.sum() > 50
    assert call("take.mkv", tmp_path / "b.mp4")[0] == 0
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "b.mp4", "out", "videos"]


@pytest.mark.parametrize(
    ("target", "preview", "words"),
    [
        ("take.mkv", "videos/a.mp4", "never written among the recordings"),
        ("take.mkv", "videos/sub/a.mp4", "never written among the recordings"),
        ("take.mkv", "a.txt", "ending in .mp4"),
        (".", "a.mp4", "shows one recording"),
    ],
)
def test_invalid_preview_paths_are_rejected(track, target, preview, words):
    call, folder, tmp_path = track
    code, err = call(target, tmp_path / preview)
    assert code == 2
    assert words in err
    assert [p.name for p in folder.iterdir()] == ["take.mkv"]


def test_marks_are_at_the_positions_and_poor_fits_are_red():
    tracks = sample_tracks()
    flags = tracks.flags.copy()
    flags[1, 0] = POOR_FIT.value
    y_px = np.full_like(tracks.y_px, 200.0)
    tracks = replace(tracks, decode=decoded(12, size=(300, 300)), flags=flags, y_px=y_px)
    plain = np.zeros((300, 300), np.uint8)
    good, poor = annotate(plain, tracks, 0), annotate(plain, tracks, 1)
    yellow = (good[..., 2] > 200) & (good[..., 1] > 150)
    yellow[:100] = False
    rows, columns = np.nonzero(yellow[:, : round(2 * tracks.x_px[0].min()) + 12])
    # Enlarged twice; circles of radius 7 px around (x, 200), with names on the right.
    assert rows.mean() == pytest.approx(2 * 200.5 - 0.5, abs=1.5)
    assert columns.min() == pytest.approx(2 * tracks.x_px[0].min() - 7, abs=2)
    assert ((poor[..., 2] > 200) & (poor[..., 1] < 120)).any()
