"""Tracking of one recording: open, detect, calibrate, follow, assemble."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from tracker.arrays import GrayImage
from tracker.assemble import TrackedMarkers, assemble, from_joint, from_templates
from tracker.follow import Follower, Progress, follow_recording
from tracker.markers import (
    FoundMarkers,
    FrameFollower,
    MarkerDetector,
    NothingFound,
    detect_markers,
    propose_points,
)
from tracker.register import calibrate_all, initial_camera, without_edges
from tracker.results import FailedTracking, MarkerTracks
from tracker.settings import TrackerSettings
from tracker.video import (
    Frame,
    FrameSource,
    SourceInfo,
    UnreadableVideoError,
    open_recording,
    prefetched,
    to_8_bit,
)

# Frames from which templates and noise are calibrated: enough to average out noise, few enough for memory.
CALIBRATION_FRAMES = 64
CALIBRATION_BYTES = 256 * 1024 * 1024
# With fewer, no mode can be identified.
LEAST_FRAMES = 12
# Exposure and readout over the time between frames; the rate may be rounded.
_LONGEST_SHARE = 1.05
_NONE = f"the file has no frames, but at least {LEAST_FRAMES} are needed"


def track(
    path: Path, settings: TrackerSettings, *, recording: str | None = None, progress: Progress | None = None
) -> MarkerTracks | FailedTracking:
    """Positions of all markers in all frames of a recording, each with its standard deviation.

    Frames are streamed: memory holds the calibration frames and the results, not the recording.

    Parameters
    ----------
    path : Path
        A video file, a camera file, or a folder of numbered images.
    recording : str or None
        Name shown in results; the file's name when None.
    progress : callable or None
        Called with the number of frames tracked and the number declared (0 where the file does not state it).

    Returns
    -------
    MarkerTracks or FailedTracking
        The latter, falsy, when the file is not a video, no markers or not the expected ones are detected, or no time
        axis can be determined. Damaged frames and lost markers are NaN and flagged, not a failure.
    """
    recording = path.name if recording is None else recording
    try:
        with closing(open_recording(path)) as source:
            return track_source(source, recording, settings, progress)
    except UnreadableVideoError as error:
        return FailedTracking(recording, str(error))


def find_markers(path: Path, settings: TrackerSettings) -> FoundMarkers | NothingFound:
    """Markers that `track` would begin with, detected in the first frames; `UnreadableVideoError` as `probe`."""
    with closing(open_recording(path)) as source:
        images = [frame.image for frame in _head(source.frames()) if frame.image is not None]
    if not images:
        return NothingFound("no frame can be decoded")
    found = detect_markers(images, settings, settings.kind)
    return found if isinstance(found, NothingFound) else found[1]


def track_source(
    source: FrameSource, recording: str, settings: TrackerSettings, progress: Progress | None = None
) -> MarkerTracks | FailedTracking:
    """As `track`, from an open source, which remains open; raises `UnreadableVideoError` where it fails."""
    impossible = _longer_than_a_frame(settings, source.info)
    if impossible:
        return FailedTracking(recording, impossible)
    stream = source.frames()
    head = _head(stream)
    images = [frame.image for frame in head if frame.image is not None]
    if not images:
        count = len(head)
        reason = f"none of the {count} frames could be decoded" if count else _NONE
        return FailedTracking(
            recording, f"{reason}; it may be incomplete or damaged: copy or export it again"
        )
    first = to_8_bit(images[0])
    found = detect_markers(images, settings, settings.kind)
    if isinstance(found, NothingFound):
        return FailedTracking(recording, found.reason, first, found.seen_px, propose_points(images))
    calibrated = _calibrated(images, *found, settings, source.info)
    if isinstance(calibrated, NothingFound):
        return FailedTracking(recording, calibrated.reason, first)
    follower, markers = calibrated
    with closing(prefetched(stream)) as ahead:
        rows = follow_recording(itertools.chain(head, ahead), follower, source.info, progress)
    tracks = assemble(source.info, recording, settings, markers, rows, found[1].notes, first)
    if isinstance(tracks, MarkerTracks) and not np.isfinite(tracks.x_px).any():
        white_level = float(source.info.white_level)
        white = without_edges(images, found[1].detections, white_level)
        return FailedTracking(recording, white, first) if white else tracks
    return tracks


def _calibrated(
    images: list[GrayImage],
    detector: MarkerDetector,
    found: FoundMarkers,
    settings: TrackerSettings,
    info: SourceInfo,
) -> tuple[FrameFollower, TrackedMarkers] | NothingFound:
    """Follower of the calibrated markers."""
    camera = initial_camera(images, bit_depth=info.bit_depth, white_level=info.white_level)
    share = _exposure_share(settings, info)
    if found.joint is not None:
        pixels = np.append(camera.noise.as_array(), camera.saturation)
        joint = found.joint.calibrated(images, pixels, share, lossy=info.lossy)
        if isinstance(joint, NothingFound):
            return joint
        return joint.follower, from_joint(found.joint.kind.name, joint)
    calibration = calibrate_all(images, found.detections, camera, exposure_share=share, lossy=info.lossy)
    if not calibration.models:
        return NothingFound(
            without_edges(images, found.detections, camera.saturation)
            or "markers were detected, but none could be registered: the contrast may be too low"
        )
    follower = Follower(calibration.models, calibration.camera, detector, calibration.exposure_share)
    return follower, from_templates(calibration)


def _head(stream: Iterator[Frame]) -> list[Frame]:
    """First frames, up to the number of good ones or the memory for calibration."""
    head: list[Frame] = []
    good, size = 0, 0
    for frame in stream:
        head.append(frame)
        if frame.image is not None:
            good += 1
            size += frame.image.nbytes
        if good >= CALIBRATION_FRAMES or size >= CALIBRATION_BYTES or len(head) > 8 * CALIBRATION_FRAMES:
            break
    return head


def _longer_than_a_frame(settings: TrackerSettings, info: SourceInfo) -> str:
    """Sentence on an exposure or a readout that takes longer than the time between frames; empty without one."""
    rate = settings.fps or info.frames_per_s
    for key, value_s in (("exposure_s", settings.exposure_s), ("readout_s", settings.readout_s)):
        if rate is not None and value_s is not None and abs(value_s) * float(rate) > _LONGEST_SHARE:
            return (
                f"{key} = {value_s:g} s is longer than the time between frames, {1.0 / float(rate):.3g} s; give it in "
                "seconds, and fps as it was recorded"
            )
    return ""


def _exposure_share(settings: TrackerSettings, info: SourceInfo) -> float | None:
    """Exposure over the time between frames, 0 where no rate is known; None where the exposure is not given."""
    if settings.exposure_s is None:
        return None
    rate = settings.fps or info.frames_per_s
    return 0.0 if rate is None else min(settings.exposure_s * float(rate), 1.0)
