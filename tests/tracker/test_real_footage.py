"""Recordings by others: a tuning fork, a marker held in the hand, photographs, cameras' own formats."""

import json
from fractions import Fraction

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares
from support.paths import REALDATA as REAL

from tracker import flags
from tracker.displacement import displacement_series
from tracker.markers.aruco import ArucoDetector, opencv_detector, read_codes
from tracker.settings import TrackerSettings
from tracker.track import track
from tracker.video.ffmpeg import VideoSource

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="recordings by others (realdata) are not here")
FORK = REAL / "tuning_forks" / "tuning_hz32_fps1000_50-1_640x420.mp4"


def fitted_hz(time_s, values):
    """Frequency of a damped sine on a cubic trend, by least squares: nothing of ours."""
    seen = np.isfinite(values)
    t, y = time_s[seen], values[seen]

    def residual(p):
        w = 2 * np.pi * p[0]
        decay = np.exp(-p[1] * w * t)
        trend = [(t - t.mean()) ** k for k in range(4)]
        design = np.stack([decay * np.cos(w * t), decay * np.sin(w * t), *trend], axis=1)
        return y - design @ np.linalg.lstsq(design, y, rcond=None)[0]

    fit = least_squares(residual, [32.0, 3e-4], x_scale=[0.01, 1e-4])
    return fit.x[0], float(np.std(fit.fun))


def test_tuning_fork_by_patches():
    points = ((298.0, 102.0), (364.0, 103.0))
    settings = TrackerSettings(fps=Fraction(1000), kind="patch", points_px=points)
    tracks = track(FORK, settings, recording="fork")
    assert tracks.decode.frames_decoded == 3336
    assert np.all(tracks.flags & flags.LOSSY.value)
    # The clip's last ten frames or so are one picture.
    repeated = (tracks.flags[:, 0] & flags.DUPLICATE_FRAME.value) > 0
    assert repeated[-8:].all()
    assert repeated.sum() < 20
    series = displacement_series(tracks)
    assert abs(series.direction[0]) > 0.99
    for k in range(2):
        frequency_hz, rms_px = fitted_hz(series.time_s, series.values[:, k])
        # 31.971 Hz by another method; a record of 3.3 s with 0.05 px of 1.3 px settles it to about 1 mHz.
        assert frequency_hz == pytest.approx(31.971, abs=0.005)
        assert rms_px < 0.06
    assert np.corrcoef(np.nan_to_num(series.values).T)[0, 1] < -0.98, "the prongs move against each other"


def test_without_a_rate_the_fork_is_loudly_at_playback_speed():
    settings = TrackerSettings(kind="patch", points_px=((298.0, 102.0),))
    clip = track(FORK, settings, recording="fork")
    assert clip.time_axis.is_playback_guess
    assert "50 fps is a playback rate" in clip.time_axis.notes[0]


def test_handheld_marker_is_followed_and_never_invented():
    path = REAL / "aruco_handheld" / "aruco2.mp4"
    settings = TrackerSettings(kind="aruco", dictionary="DICT_6X6_100")
    tracks = track(path, settings, recording="hand")
    assert tracks.markers == ("id0",)
    seen = np.isfinite(tracks.x_px[:, 0])
    assert seen.sum() >= 355
    assert np.all((tracks.flags[~seen, 0] & flags.NOT_FOUND.value) > 0)
    steps = np.diff(tracks.x_px[:, 0]) ** 2 + np.diff(tracks.y_px[:, 0]) ** 2
    assert not np.any(steps == 0.0), "no position is held"
    # Against the detector's own corners, frame by frame: their mean is within 2 px where both see it.
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_100)
    detector = cv2.aruco.ArucoDetector(dictionary)
    distances = []
    source = VideoSource(path)
    for k, frame in enumerate(source.frames()):
        if k % 10 == 0 and seen[k]:
            corners, ids, _ = detector.detectMarkers(frame.image)
            if ids is not None and ids.ravel().tolist() == [0]:
                a, b, c, d = corners[0].reshape(4, 2).astype(float)
                t = np.linalg.solve(np.stack([c - a, -(d - b)], axis=1), b - a)[0]
                distances.append(np.linalg.norm(a + t * (c - a) - [tracks.x_px[k, 0], tracks.y_px[k, 0]]))
    source.close()
    assert len(distances) > 20
    assert np.median(distances) < 1.0
    assert np.max(distances) < 6.0


GOLD = REAL / "opencv_aruco" / "gold_corners.json"


def golden_pictures():
    """Pictures that are here and have golden corners, with their dictionary and corners by id."""
    gold = json.loads(GOLD.read_text()) if GOLD.is_file() else {}
    return [
        (name, entry["dictionary"], {int(k): np.array(c, dtype=float) for k, c in entry["corners"].items()})
        for name, entry in gold.items()
        if "corners" in entry and (GOLD.parent / name).is_file()
    ]


@pytest.mark.parametrize(("name", "dictionary", "gold"), golden_pictures())
def test_photographs_have_their_golden_ids_and_corners(name, dictionary, gold):
    picture = cv2.imread(str(GOLD.parent / name), cv2.IMREAD_GRAYSCALE)
    if dictionary.endswith(".yml"):
        own = cv2.aruco.Dictionary()
        # The file must stay open for as long as its nodes are read.
        storage = cv2.FileStorage(str(GOLD.parent / dictionary), cv2.FILE_STORAGE_READ)
        own.readDictionary(storage.root())
        storage.release()
    else:
        own = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        found = ArucoDetector(dictionary, None).detect([picture])
        assert sorted(int(s.name.removeprefix("id")) for s in found.detections) == sorted(gold)
    corners = {d.marker_id: d.corners_px for d in read_codes(picture, opencv_detector(own, strict=False))}
    assert sorted(corners) == sorted(gold), f"{name}: every golden id and no other"
    # The golden corners are whole pixels of an unrefined detector.
    worst = max(float(np.abs(corners[i] - gold[i]).max()) for i in gold)
    assert worst <= 1.0, f"{name}: a corner is {worst:.2f} px from the golden one"


@pytest.mark.parametrize(
    ("name", "frames", "size", "rate"),
    [
        ("data_small_cine.cine", 235, (256, 32), 100),
        ("cine_legacy.cine", 97, (128, 128), 35087),
        ("cine_781.cine", 15, (256, 256), 90000),
    ],
)
def test_cine_files_have_their_headers_facts(name, frames, size, rate):
    source = VideoSource(REAL / "highspeed_formats" / name)
    read = list(source.frames())
    assert len(read) == frames
    assert all(f.image is not None for f in read)
    assert (source.info.width_px, source.info.height_px) == size
    assert source.info.header_rate == rate
    assert read[0].image.dtype == np.uint16
