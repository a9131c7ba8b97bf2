"""The picture of the first frame of a recording without markers."""

import cv2
import numpy as np
import pytest

from modalcam.tables import write_first_frame
from tracker import FailedTracking


def written(path, **values):
    rng = np.random.default_rng(1)
    frame = rng.integers(90, 110, (100, 400), dtype=np.uint8)
    write_first_frame(path, FailedTracking("no markers", "$x_1$^.avi", first_frame=frame, **values))
    return path.read_bytes(), cv2.imread(str(path)).astype(int)


def orange(image):
    """Pixels of the proposed points."""
    blue, green, red = np.moveaxis(image, 2, 0)
    return np.count_nonzero((red > 200) & (green > 120) & (blue < 60))


def test_the_picture_shows_the_points_and_is_the_same_each_time(tmp_path):
    data, image = written(tmp_path / "a.png", proposed_px=np.array([[50.0, 20.0], [300.0, 80.0]]))
    assert written(tmp_path / "b.png", proposed_px=np.array([[50.0, 20.0], [300.0, 80.0]]))[0] == data
    assert image.shape[1] >= 1000, "a pixel of the frame is at least two of the picture"
    assert orange(image) > 50
    assert orange(written(tmp_path / "c.png")[1]) == 0


def test_a_recording_without_a_frame_has_no_picture(tmp_path):
    with pytest.raises(ValueError, match="without a frame"):
        write_first_frame(tmp_path / "a.png", FailedTracking("damaged", "a"))
