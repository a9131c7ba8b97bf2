"""Third-party recordings: tuning forks, a handheld marker, photographs, camera formats."""

import json
from fractions import Fraction

import cv2
import numpy as np
import pytest
from kit import films as media
from kit.series import least_squares_fit
from support.paths import REALDATA as REAL
from support.paths import REALDATA_ABSENT

from tracker import TrackerSettings, flags, track
from tracker.markers import ArucoDetector, opencv_detector, read_codes
from tracker.video import VideoSource

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=REALDATA_ABSENT)
FORK = REAL / "tuning_forks" / "tuning_hz32_fps1000_50-1_640x420.mp4"


@pytest.mark.parametrize(
    ("name", "points", "frequency_hz", "frames"),
    [
        # Fast: the same rate in test_patches.py, rendered.
        pytest.param(
            "fork64_on_bricks_fps250", ((456.0, 176.0), (554.0, 179.0)), 64.017, 888, marks=pytest.mark.slow
        ),
        *(
            pytest.param(
                "fork128_on_bricks_fps250", ((451.0, 198.0), (530.0, 201.0)), 122.045, frames, marks=marks
            )
            for frames, marks in ((400, ()), (888, pytest.mark.slow))
        ),
    ],
)
def test_forks_before_bricks_are_followed_in_every_frame(name, points, frequency_hz, frames, tmp_path):
    settings = TrackerSettings(fps=Fraction(250), kind="patch", points_px=points, size_px=41.0)
    film = media.first_frames(REAL / "ordinary" / f"{name}.mp4", tmp_path / f"{name}.mp4", frames)
    tracks = track(film, settings, recording=name)
    lost = int(np.count_nonzero(tracks.flags & flags.NOT_FOUND.value))
    assert lost == 0, f"{lost} positions were lost; Lucas-Kanade (pyidi 1.4.0, window of 41 px) loses none"
    # Frequencies by pyidi's Lucas-Kanade and least squares, 128 Hz as its alias. Its residual after three modes is
    # 0.040 to 0.053 px in x; at 0.27 px of motion 888 frames, 3.5 s, of that determine the frequency to 3 mHz,
    # others in proportion to their number to the power -3/2. Three and a third times that is allowed.
    allowed_hz = 0.01 * (888 / frames) ** 1.5
    for k in range(2):
        found_hz = least_squares_fit(tracks.time_s, tracks.x_px[:, k], frequency_hz)[0]
        assert found_hz == pytest.approx(frequency_hz, abs=allowed_hz), f"patch {k + 1}: {found_hz:.3f} Hz"


def test_without_a_rate_the_fork_is_tracked_at_playback_speed_with_a_warning(tmp_path):
    settings = TrackerSettings(kind="patch", points_px=((298.0, 102.0),))
    clip = track(media.first_frames(FORK, tmp_path / FORK.name, 100), settings, recording="fork")
    assert clip.time_axis.is_playback_guess
    assert "50 fps is a playback rate" in clip.time_axis.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "least", "every", "exposure_s"),
    # From the second key frame on, the marker is hidden three times. The exposure is not estimated there: too few of
    # these frames are sharp. In the fast suite: photographs of codes, below, and rendered ones.
    [(0, 355, 10, None), (300, 60, 2, 0.01)],
)
def test_a_handheld_marker_is_tracked_only_where_it_is_visible(start, least, every, exposure_s, tmp_path):
    path = media.part(REAL / "aruco_handheld" / "aruco2.mp4", tmp_path / "hand.mp4", start)
    settings = TrackerSettings(kind="aruco", dictionary="DICT_6X6_100", exposure_s=exposure_s)
    tracks = track(path, settings, recording="hand")
    assert tracks.markers == ("id0",)
    found = np.isfinite(tracks.x_px[:, 0])
    assert found.sum() >= least
    assert not found.all(), "it is hidden in some of the frames"
    assert np.all((tracks.flags[~found, 0] & flags.NOT_FOUND.value) > 0)
    steps = np.diff(tracks.x_px[:, 0]) ** 2 + np.diff(tracks.y_px[:, 0]) ** 2
    assert not np.any(steps == 0.0), "no position is held"
    # Against the corners of OpenCV's detector, frame by frame, where both detect the marker.
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_100)
    detector = cv2.aruco.ArucoDetector(dictionary)
    distances = []
    source = VideoSource(path)
    for k, frame in enumerate(source.frames()):
        if k % every == 0 and found[k]:
            corners, ids, _ = detector.detectMarkers(frame.image)
            if ids is not None and ids.ravel().tolist() == [0]:
                a, b, c, d = corners[0].reshape(4, 2).astype(float)
                t = np.linalg.solve(np.stack([c - a, -(d - b)], axis=1), b - a)[0]
                distances.append(np.linalg.norm(a + t * (c - a) - [tracks.x_px[k, 0], tracks.y_px[k, 0]]))
    source.close()
    assert len(distances) > 20
    assert np.median(distances) < 1.0
    assert np.max(distances) < 6.0


REFERENCE = REAL / "opencv_aruco" / "gold_corners.json"


def reference_images():
    """Available images with reference corners: name, dictionary and corners by id."""
    reference = json.loads(REFERENCE.read_text()) if REFERENCE.is_file() else {}
    return [
        (name, entry["dictionary"], {int(k): np.array(c, dtype=float) for k, c in entry["corners"].items()})
        for name, entry in reference.items()
        if "corners" in entry and (REFERENCE.parent / name).is_file()
    ]


@pytest.mark.parametrize(("name", "dictionary", "reference"), reference_images())
def test_photographs_match_their_reference_ids_and_corners(name, dictionary, reference):
    image = cv2.imread(str(REFERENCE.parent / name), cv2.IMREAD_GRAYSCALE)
    if dictionary.endswith(".yml"):
        code_set = cv2.aruco.Dictionary()
        # The file must stay open for as long as its nodes are read.
        storage = cv2.FileStorage(str(REFERENCE.parent / dictionary), cv2.FILE_STORAGE_READ)
        code_set.readDictionary(storage.root())
        storage.release()
    else:
        code_set = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        found = ArucoDetector(dictionary, None).detect([image])
        assert sorted(int(s.name.removeprefix("id")) for s in found.detections) == sorted(reference)
    corners = {d.marker_id: d.corners_px for d in read_codes(image, opencv_detector(code_set, strict=False))}
    assert sorted(corners) == sorted(reference), f"{name}: every reference id and no other"
    # The reference corners are whole pixels, from a detector without refinement.
    worst = max(float(np.abs(corners[i] - reference[i]).max()) for i in reference)
    assert worst <= 1.0, f"{name}: a corner is {worst:.2f} px from the reference"
