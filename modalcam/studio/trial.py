"""Markers of the first frames and a test track, computed in child processes by the functions of the pipeline."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modalcam.execution import FrameCount
from modalcam.studio.decoding import Problem
from modalcam.studio.overlay import Point
from modalcam.studio.trial_windows import FollowedWindow, evenly, followed_windows
from tracker import LEAST_FRAMES, FailedTracking, GrayImage, MarkerTracks, TrackerSettings, track_source
from tracker.line import NoMovingLine, find_line
from tracker.markers import NothingFound, detect_markers, filled, propose_points
from tracker.video import Frame, FrameSource, SourceInfo, UnreadableVideoError, open_recording

# Frames in which markers are sought.
DETECTION_FRAMES = 32
# Windows that are shown of the markers of a test track, evenly spread along the beam.
_MOST_WINDOWS = 6
_MOST_WINDOW_FRAMES = 300
# Fields of tracks that have a row for each frame.
_OF_FRAMES = ("frame", "time_s", "x_px", "y_px", "sd_x_px", "sd_y_px", "flags", "correlation_xy")
# Window around a marker of known size, in its sizes.
_AROUND = 0.7


@dataclass(frozen=True)
class DetectedMarker:
    """A marker of the first frames: name as by its kind, centre and size, as detected without calibration.

    Its centre is that in `frame`: the first, unless it was found only later.
    """

    name: str
    x_px: float
    y_px: float
    size_px: float
    frame: int = 0


@dataclass(frozen=True)
class TrialTask:
    """Frames of a recording to be tracked, from the frame `first` on; the `counter` is told how far it is."""

    path: Path
    file: str
    settings: TrackerSettings
    frames: int
    counter: FrameCount | None = None
    first: int = 0


def detected(task: TrialTask) -> tuple[DetectedMarker, ...] | Problem:
    """Markers in the first frames, in order along the beam."""
    try:
        with closing(open_recording(task.path)) as source:
            images = _images(source, task.frames)
    except UnreadableVideoError as error:
        return Problem(str(error))
    if not images:
        return Problem("no frame can be decoded")
    # Names of a wrong number would hide what is there.
    settings = task.settings.model_copy(update={"names": None})
    found = detect_markers(images, settings, settings.kind)
    if isinstance(found, NothingFound):
        return Problem(found.reason)
    _, markers = found
    placed = ((d, *d.earliest()) for d in markers.detections)
    return tuple(DetectedMarker(d.name, x, y, d.size_px, frame) for d, frame, x, y in placed)


@dataclass(frozen=True)
class Proposals:
    """What could be followed in a recording without markers.

    `points` have texture that moves, best first; `line` holds the clamped and the free end of a strip that moves, or is
    None for the reason `no_line`.
    """

    points: tuple[Point, ...]
    line: tuple[Point, Point] | None
    no_line: str = ""


def proposed(task: TrialTask) -> Proposals | Problem:
    """Points and line that move in the first frames."""
    try:
        with closing(open_recording(task.path)) as source:
            images = _images(source, task.frames)
    except UnreadableVideoError as error:
        return Problem(str(error))
    images = [filled(image, task.settings.leave_out_px) for image in images]
    if not images:
        return Problem("no frame can be decoded")
    points = tuple((float(x), float(y)) for x, y in propose_points(images))
    line = find_line(images)
    if isinstance(line, NoMovingLine):
        return Proposals(points, None, line.reason)
    clamp, free_end = ((round(float(x), 1), round(float(y), 1)) for x, y in line)
    return Proposals(points, (clamp, free_end))


def window_sizes(task: TrialTask) -> tuple[float, ...] | Problem:
    """Side of the window of each patch, as a run chooses it."""
    found = detected(replace(task, frames=1))
    return found if isinstance(found, Problem) else tuple(one.size_px for one in found)


@dataclass(frozen=True)
class Trial:
    """Tracks of some frames, windows that follow some of the markers, and the exposed share of a frame's time.

    ``exposure_share`` is None where the exposure time is not given.
    """

    tracks: MarkerTracks
    windows: tuple[FollowedWindow, ...]
    exposure_share: float | None


def trial_track(task: TrialTask) -> Trial | FailedTracking:
    """Tracks of the frames asked for, from the same functions as those of a run.

    As in a run the markers are those of the first frame, where points and lines are given, and are followed from there.
    """
    first, end = task.first, task.first + task.frames
    try:
        with closing(open_recording(task.path)) as source:
            tracks = track_source(_FirstFrames(source, end), task.file, task.settings, task.counter)
        if not isinstance(tracks, MarkerTracks):
            return tracks
        if len(tracks.frame) - first < LEAST_FRAMES:
            reason = f"expected at least {LEAST_FRAMES} frames from frame {first} on, found {len(tracks.frame)} in all"
            return FailedTracking(task.file, f"{reason}; begin earlier")
        tracks = _beginning_at(tracks, first)
        with closing(open_recording(task.path)) as source:
            images = (
                frame.image
                for frame in itertools.islice(source.frames(), first, min(end, first + _MOST_WINDOW_FRAMES))
            )
            windows = followed_windows(
                tracks, images, evenly(len(tracks.markers), _MOST_WINDOWS), _half_px(task, tracks)
            )
    except UnreadableVideoError as error:
        return FailedTracking(task.file, str(error))
    exposure_s, step_s = task.settings.exposure_s, float(np.median(np.diff(tracks.time_s)))
    return Trial(tracks, windows, None if exposure_s is None else min(exposure_s / step_s, 1.0))


def _beginning_at(tracks: MarkerTracks, first: int) -> MarkerTracks:
    """Tracks without the frames before `first`; times are those of the recording."""
    arrays = {name: getattr(tracks, name) for name in _OF_FRAMES}
    return replace(tracks, **{name: found[first:] for name, found in arrays.items() if found is not None})


def _half_px(task: TrialTask, tracks: MarkerTracks) -> float | None:
    settings = task.settings
    if settings.kind == "patch":
        return None if settings.size_px is None else 0.5 * settings.size_px
    if settings.size_mm is None or tracks.scale is None:
        return None
    return _AROUND * settings.size_mm / tracks.scale.mm_per_px


def _images(source: FrameSource, count: int) -> list[GrayImage]:
    frames = itertools.islice(source.frames(), count)
    return [frame.image for frame in frames if frame.image is not None]


class _FirstFrames:
    """The beginning of an open recording, as a `tracker.video.source.FrameSource`."""

    def __init__(self, source: FrameSource, count: int) -> None:
        self._source = source
        self._count = count

    @property
    def info(self) -> SourceInfo:
        info = self._source.info
        return replace(info, frames_declared=min(info.frames_declared, self._count))

    def frames(self) -> Iterator[Frame]:
        return itertools.islice(self._source.frames(), self._count)

    def stamps(self) -> list[int | None]:
        return self._source.stamps()[: self._count]

    def close(self) -> None:
        self._source.close()
