"""Any frame of a recording equals that of reading all frames in order."""

from contextlib import closing

import numpy as np
import pytest
from kit import films as media
from kit.camera_files import WRITERS, images_for

from modalcam.inputs import discover
from tracker.video import UnreadableVideoError, frame_stamps, open_recording, read_frame


def in_order(path):
    with closing(open_recording(path)) as source:
        return [frame.image for frame in source.frames()]


def assert_same(path, picks=None):
    expected, stamps = in_order(path), frame_stamps(path)
    assert len(stamps) == len(expected)
    for k in picks or [len(expected) - 1, 0, *range(1, len(expected), 7)]:
        assert np.array_equal(read_frame(path, k, stamps), expected[k]), f"{path.name}: frame {k}"


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mp4", "libx264", {"g": "12", "bf": "3"}),
        ("a.mkv", "libx264", {"g": "12", "bf": "2"}),
        ("a.avi", "mpeg4", {"g": "12"}),
    ],
)
def test_videos(tmp_path, name, codec, options):
    media.write(tmp_path / name, media.images(40), codec=codec, options=options)
    assert_same(tmp_path / name)


def test_a_video_without_time_stamps_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "a.h264"
    media.write(path, media.images(20), codec="libx264", container_format="h264")
    assert set(frame_stamps(path)) == {None}
    assert_same(path)


@pytest.mark.parametrize("case", WRITERS)
def test_every_format(tmp_path, case):
    WRITERS[case](tmp_path, images_for(case, 12, width=64, height=48))
    assert_same(discover(tmp_path).recordings[0].path, (11, 0, 5))


def test_images_with_a_gap(tmp_path):
    import cv2

    pictures = media.images(12)
    for k, image in enumerate(pictures):
        if k != 5:
            cv2.imwrite(str(tmp_path / f"f{k + 3}.png"), image)
    stamps = frame_stamps(tmp_path)
    assert len(stamps) == 12
    for k in (0, 4, 6, 11):
        assert np.array_equal(read_frame(tmp_path, k, stamps), pictures[k])
    with pytest.raises(UnreadableVideoError, match="frame 5 is damaged or missing"):
        read_frame(tmp_path, 5, stamps)


@pytest.mark.parametrize("index", [-1, 12])
def test_a_frame_outside_is_refused(tmp_path, index):
    media.write(tmp_path / "a.avi", media.images(12))
    with pytest.raises(UnreadableVideoError, match="expected one from 0 to 11"):
        read_frame(tmp_path / "a.avi", index, frame_stamps(tmp_path / "a.avi"))


def test_a_header_beside_the_video_leaves_the_file_s_own_stamps(tmp_path):
    path = tmp_path / "a.avi"
    media.write(path, media.images(12))
    (tmp_path / "a.cih").write_text(
        "Record Rate(fps) : 1000\nTotal Frame : 12\nImage Width : 160\nImage Height : 120\nSkip Frame : 2\n"
    )
    assert frame_stamps(path) == tuple(range(12))
    assert_same(path)
