"""The first frame with its marks, and the strip of frames."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs

from modalcam.report.sections import first_frame, strip
from tracker import FailedTracking


def test_the_strip_shows_start_onset_largest_motion_and_end():
    tracks = runs.recording(0).tracks
    view = strip(tracks, 1.0)
    titles = [frame.lines[:-1] for frame in view.frames]
    flat = [name for names in titles for name in names]
    assert titles[0][0] == "start"
    assert titles[-1][-1] == "end"
    assert sorted(flat) == ["end", "largest motion", "near the onset", "start"]
    near = next(frame for frame in view.frames if "near the onset" in frame.lines)
    # Images at 0, 1, 2, 3 and 4 s.
    assert near.lines[-1].startswith("0.998 s, frame 499")
    scale = view.image_width / tracks.decode.width_px
    for centre, x in zip(view.frames[0].centres, tracks.x_px[0][np.isfinite(tracks.x_px[0])], strict=True):
        assert centre.x == pytest.approx((x + 0.5) * scale, abs=0.01)
    assert strip(replace(tracks, strip=None), 1.0) is None


def test_candidates_are_drawn_when_nothing_could_be_tracked():
    failed = FailedTracking(
        "dark", "a", first_frame=np.zeros((60, 80), np.uint8), seen_px=np.array([[10.0, 20.0], [70.0, 30.0]])
    )
    view = first_frame(failed)
    assert [(m.x, m.y, m.name, m.side) for m in view.marks] == [(10.0, 20.0, "1", 1), (70.0, 30.0, "2", -1)]
    assert not view.tracked
    assert first_frame(replace(failed, first_frame=None)) is None
