"""Sample recordings: true values, size, and reproduction by the script in their folder."""

import json
import tomllib
from itertools import islice

import av
import cv2
import numpy as np
import pytest
from kit.films import luma
from support.paths import SAMPLES, script

from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.render import write_video

MAX_BYTES = 25_000_000


@pytest.fixture(scope="module")
def make():
    return script(SAMPLES / "make.py")


@pytest.fixture(scope="module")
def truth():
    return json.loads((SAMPLES / "truth.json").read_text(encoding="utf-8"))


def test_truth_matches_the_simulated_beam(truth):
    frequency = beam_modes(AncfBeam(sample_beam()), 8).frequency_hz
    # The file has nine digits.
    assert np.allclose(truth["frequency_hz"], frequency, rtol=1e-8, atol=0)
    for recording in truth["recordings"]:
        i = recording["mode"] - 1
        assert recording["frequency_hz"] == truth["frequency_hz"][i]
        assert recording["damping_ratio"] == MEASURED_DAMPING_RATIO[i]
        assert abs(recording["frequency_hz"] / MEASURED_FREQUENCY_HZ[i] - 1) < 1e-7


def test_experiment_and_truth_describe_the_same_recordings(make, truth):
    experiment = tomllib.loads((SAMPLES / "experiment.toml").read_text(encoding="utf-8"))
    assert experiment == make.experiment()
    for entry, true in zip(experiment["recordings"], truth["recordings"], strict=True):
        assert (entry["file"], entry["mode"], entry["fps"]) == (true["file"], true["mode"], true["fps"])
        assert entry.get("mm_per_px", experiment["camera"]["mm_per_px"]) == true["mm_per_px"]


def test_recordings_fit_the_repository():
    total = sum(path.stat().st_size for path in SAMPLES.iterdir() if path.is_file())
    assert total <= MAX_BYTES


def test_files_are_complete_and_have_a_playback_rate(truth):
    for recording in truth["recordings"]:
        with av.open(str(SAMPLES / recording["file"])) as container:
            stream = container.streams.video[0]
            assert stream.average_rate == 30
            assert sum(1 for _ in container.demux(video=0) if _.size) == recording["frames"]


def test_markers_are_at_the_true_positions(truth):
    for recording in truth["recordings"]:
        image = next(luma(SAMPLES / recording["file"]))
        background = np.median(image)
        rows, columns = np.indices(image.shape)
        radius = 8.0 if recording["mode"] != 3 else 16.0
        for x, y in recording["centres_first_frame_px"]:
            inside = np.hypot(columns - x, rows - y) < radius
            weight = np.abs(image - background) * inside
            found = np.array([np.sum(weight * columns), np.sum(weight * rows)]) / np.sum(weight)
            # The centroid of an ArUco marker is up to one cell from its centre.
            limit = 0.15 if recording["mode"] != 3 else 4.0
            assert np.max(np.abs(found - (x, y))) < limit, recording["file"]


def test_aruco_markers_of_the_samples_are_detected(truth):
    recording = truth["recordings"][2]
    image = next(luma(SAMPLES / recording["file"])).astype(np.uint8)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, ids, _ = detector.detectMarkers(image)
    assert sorted(ids.ravel().tolist()) == [0, 1, 2, 3, 4, 5]
    for found, i in zip(corners, ids.ravel(), strict=True):
        centre = np.array(recording["centres_first_frame_px"][i])
        assert np.max(np.abs(found[0].mean(axis=0) - centre)) < 0.5


def test_first_frames_are_reproduced_byte_for_byte(make, tmp_path):
    count = 12
    recording = make.RECORDINGS[4]
    path = tmp_path / recording.file
    write_video(
        path,
        islice(make.staged(recording).frames(np.random.default_rng([make.SEED, recording.mode])), count),
        fps_container=make.PLAYBACK_FPS,
        quality=make.QUALITY_SCALE,
    )

    def packets(file):
        with av.open(str(file)) as container:
            return [bytes(packet) for packet in islice(container.demux(video=0), count)]

    assert packets(path) == packets(SAMPLES / recording.file)


@pytest.mark.slow
@pytest.mark.timeout(1200)  # five videos: 90 s on one core, more under load
def test_all_files_are_reproduced(make):
    assert make.main(["--check"]) == 0
