"""modalcam's tracker in the benchmark: from files, from memory, and compared with decoding alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import av
import numpy as np

from benchmarks.tracking_scenes import FPS, Recording
from tracker import (
    TUNING,
    FailedTracking,
    FloatArray,
    GrayImage,
    MarkerTracks,
    TrackerSettings,
    track,
)
from tracker.follow import Follower
from tracker.markers import NothingFound, detect_markers
from tracker.register import CalibrationFrames, Camera, calibrate
from tracker.template import estimate_noise


def settings_of(recording: Recording) -> TrackerSettings:
    """Settings a user would choose for the scene."""
    return TrackerSettings(fps=FPS, kind=recording.kind, exposure_s=recording.exposure_s or None)


def track_file(path: Path, recording: Recording) -> MarkerTracks:
    """Track a rendered file.

    Raises
    ------
    RuntimeError
        If nothing could be tracked, with the reason reported by the tracker.
    """
    tracks = track(path, settings_of(recording), recording=path.name)
    if isinstance(tracks, FailedTracking):
        raise RuntimeError(tracks.reason)  # noqa: TRY004 - a result, not a type, is wrong
    return tracks


def positions_and_sd(tracks: MarkerTracks) -> tuple[FloatArray, FloatArray]:
    """Positions and standard deviations, shape (n, m, 2)."""
    return (
        np.stack([tracks.x_px, tracks.y_px], axis=-1),
        np.stack([tracks.sd_x_px, tracks.sd_y_px], axis=-1),
    )


def fps_from_memory(images: list[GrayImage], recording: Recording) -> tuple[float, float]:
    """Frames per second of tracking alone, and CPU seconds of the calibration, in one thread."""
    head = images[: TUNING.calibration_frames]
    settings = settings_of(recording)
    camera = Camera(estimate_noise(head, white_level=255.0), 255.0)
    found = detect_markers(head, settings, settings.kind)
    if isinstance(found, NothingFound):
        raise RuntimeError(found.reason)  # noqa: TRY004 - a result, not a type, is wrong
    detector, markers = found
    share = recording.exposure_s * float(FPS)
    frames = CalibrationFrames(head, camera, share)

    def models() -> tuple[Any, ...]:
        return tuple(m for s in markers.detections if (m := calibrate(frames, s)) is not None)

    calibrated = models()  # compiles or loads the cache
    start = time.process_time()
    models()
    calibration_s = time.process_time() - start
    follower = Follower(calibrated, camera, detector, share)
    for image in images[:2]:
        follower.step(image)
    start = time.perf_counter()
    for image in images[2:]:
        follower.step(image)
    return (len(images) - 2) / (time.perf_counter() - start), calibration_s


def decode_only_fps(path: Path) -> float:
    """Frames per second of PyAV, with the gray plane copied to an array.

    Uses the tracker's decoder settings: one slice thread per core (MJPG cannot use them) and no frame threads, because
    they would report a damaged frame at a different packet. With equal decoding, the ratio of the speeds measures the
    cost of tracking.
    """
    count, start = 0, 0.0
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if count == TUNING.calibration_frames:
                start = time.perf_counter()
            plane = frame.planes[0]
            rows = np.frombuffer(plane, np.uint8).reshape(frame.height, plane.line_size)
            np.array(rows[:, : frame.width])
            count += 1
    return (count - TUNING.calibration_frames - 1) / (time.perf_counter() - start)


def decode_and_track_fps(path: Path, recording: Recording) -> tuple[float, float]:
    """Frames per second of the tracker after the calibration frames, and over the whole file."""
    stamps: list[float] = []

    def progress(_done: int, _declared: int) -> None:
        stamps.append(time.perf_counter())

    start = time.perf_counter()
    tracks = track(path, settings_of(recording), recording=path.name, progress=progress)
    if isinstance(tracks, FailedTracking):
        raise RuntimeError(tracks.reason)  # noqa: TRY004 - a result, not a type, is wrong
    first = 2 * TUNING.calibration_frames  # the calibration frames and those decoded during calibration
    steady = (len(stamps) - first - 1) / (stamps[-1] - stamps[first])
    return steady, len(stamps) / (time.perf_counter() - start)


def there_and_back(images: list[GrayImage], frames: int) -> list[GrayImage]:
    """Play the images forwards and backwards alternately: a long recording without jumps."""
    loop = images + images[-2:0:-1]
    return [loop[k % len(loop)] for k in range(frames)]
