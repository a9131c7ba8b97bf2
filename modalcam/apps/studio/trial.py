"""Markers of the first frames and a test track: the windows that follow them, numbers, and advice where it is bad.

Both are computed in child processes by the functions of the pipeline.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.apps.studio.frames import Point
from modalcam.pipeline import FrameCount
from tracker import (
    MEDIAN_MODULUS,
    FailedTracking,
    Failure,
    FloatArray,
    GrayImage,
    MarkerTracks,
    TrackerSettings,
    track_source,
)
from tracker import TUNING as TRACKING
from tracker.line import find_line
from tracker.markers import NothingFound, detect_markers, filled, kind_of, propose_points
from tracker.video import Frame, FrameSource, SourceInfo, UnreadableVideoError, open_recording

Picture = NDArray[np.uint8]
_USUAL_HALF_PX, _LARGEST_HALF_PX = 16, 64
# Pixels of the picture that is shown for one of the window, at most.
_ENLARGED = 4
_SHOWN_PX = 160
# Pairs of frames from which the noise of a pixel is estimated.
_MOST_DIFFERENCES = 16


@dataclass(frozen=True)
class FollowedWindow:
    """Window that follows a marker: its mean picture, and the standard deviation over the frames as PNG.

    ``unexplained`` is the standard deviation over the frames beyond that of still parts of the picture, as a share of
    the contrast of the mean: 0 where the window shows one rigid object in the light of the first frames.
    """

    name: str
    mean_png: bytes
    residual_png: bytes
    unexplained: float


def followed_windows(
    tracks: MarkerTracks,
    images: Iterable[GrayImage | None],
    chosen: tuple[int, ...],
    half_px: float | None = None,
) -> tuple[FollowedWindow, ...]:
    """Windows of the markers of these indices, from the frames of the track; frames without image are left out."""
    half = round(_USUAL_HALF_PX if half_px is None else min(half_px, _LARGEST_HALF_PX))
    reach = np.arange(-half, half + 1, dtype=np.float64)
    count = np.zeros(len(chosen))
    sums = np.zeros((2, len(chosen), reach.size, reach.size))
    noises: list[float] = []
    before: NDArray[np.float32] | None = None
    for row, image in zip(range(len(tracks.time_s)), images, strict=False):
        if image is None:
            continue
        gray = image.astype(np.float32)
        for number, k in enumerate(chosen):
            x, y = tracks.x_px[row, k], tracks.y_px[row, k]
            if np.isfinite(x) and np.isfinite(y):
                window = _window(gray, x + reach, y + reach)
                count[number] += 1
                sums[:, number] += window, window**2
        if before is not None and len(noises) < _MOST_DIFFERENCES:
            # Most of a picture is at rest: the median of the differences is that of noise alone.
            noises.append(float(np.median(np.abs(gray - before))) / MEDIAN_MODULUS / np.sqrt(2.0))
        before = gray
    noise = float(np.median(noises)) if noises else 0.0
    return tuple(
        _followed(tracks.markers[k], count[number], sums[:, number], noise)
        for number, k in enumerate(chosen)
        if count[number] > 2
    )


def _window(gray: NDArray[np.float32], x: FloatArray, y: FloatArray) -> FloatArray:
    columns, rows = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    found = cv2.remap(gray, columns, rows, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float64)


def _followed(name: str, count: float, sums: FloatArray, noise: float) -> FollowedWindow:
    """Window from the sums of its pixels and of their squares."""
    mean = sums[0] / count
    variance = np.maximum(sums[1] / count - mean**2, 0.0) * count / (count - 1.0)
    contrast = max(float(np.std(mean)), 1e-9)
    beyond = float(np.sqrt(max(np.mean(variance) - noise**2, 0.0)))
    residual = np.clip(255.0 * np.sqrt(variance) / contrast, 0.0, 255.0)
    return FollowedWindow(name, _png(_stretched(mean)), _png(residual.astype(np.uint8)), beyond / contrast)


def _stretched(mean: FloatArray) -> Picture:
    """Gray levels stretched from the darkest to the brightest."""
    low, high = float(mean.min()), float(mean.max())
    return np.asarray(np.rint(255.0 * (mean - low) / max(high - low, 1e-9)), dtype=np.uint8)


def _png(picture: Picture) -> bytes:
    factor = max(1, min(_ENLARGED, _SHOWN_PX // picture.shape[0]))
    shown = np.kron(picture, np.ones((factor, factor), dtype=np.uint8))
    return bytes(cv2.imencode(".png", shown)[1].tobytes())


def evenly(count: int, most: int) -> tuple[int, ...]:
    """Indices of at most `most` of `count` things, evenly spread, the first and the last among them."""
    return tuple(sorted({round(float(k)) for k in np.linspace(0, count - 1, min(count, most))}))


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


class TrialCancelledError(Exception):
    """A test track was cancelled."""


@dataclass(frozen=True)
class TrialCount(FrameCount):
    """A count whose removal cancels the test track that counts."""

    def __call__(self, done: int, declared: int) -> None:
        """Note the frames done; TrialCancelledError if the count was removed."""
        if not self.path.exists():
            raise TrialCancelledError
        super().__call__(done, declared)


@dataclass(frozen=True)
class TrialTask:
    """Frames of a recording to be tracked, from the frame `first` on; the `counter` is told how far it is."""

    path: Path
    file: str
    settings: TrackerSettings
    frames: int
    counter: FrameCount | None = None
    first: int = 0


def detected(task: TrialTask) -> tuple[DetectedMarker, ...] | Failure:
    """Markers in the first frames, in order along the beam."""
    images = _first_images(task)
    if isinstance(images, Failure):
        return images
    # Names of a wrong number would hide what is there.
    settings = task.settings.model_copy(update={"names": None})
    found = detect_markers(images, settings, settings.kind)
    if isinstance(found, NothingFound):
        return Failure(found.reason)
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


def proposed(task: TrialTask) -> Proposals | Failure:
    """Points and line that move in the first frames."""
    images = _first_images(task)
    if isinstance(images, Failure):
        return images
    # What is followed already need not be proposed.
    found = detected(task)
    known = () if isinstance(found, Failure) else found
    images = [filled(image, task.settings.leave_out_px) for image in images]
    points = tuple(
        (float(x), float(y))
        for x, y in propose_points(images)
        if all(np.hypot(x - one.x_px, y - one.y_px) > one.size_px for one in known)
    )
    line = find_line(images)
    if isinstance(line, Failure):
        return Proposals(points, None, line.reason)
    clamp, free_end = ((round(float(x), 1), round(float(y), 1)) for x, y in line)
    return Proposals(points, (clamp, free_end))


def window_sizes(task: TrialTask) -> tuple[float, ...] | Failure:
    """Side of the window of each patch, as a run chooses it."""
    found = detected(replace(task, frames=1))
    return found if isinstance(found, Failure) else tuple(one.size_px for one in found)


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
        if len(tracks.frame) - first < TRACKING.least_frames:
            least = TRACKING.least_frames
            reason = (
                f"expected at least {least} frames from frame {first} on, found {len(tracks.frame)} in all"
            )
            return FailedTracking(f"{reason}; begin earlier", task.file)
        tracks = _beginning_at(tracks, first)
        with closing(open_recording(task.path)) as source:
            images = (
                frame.image
                for frame in itertools.islice(source.frames(), first, min(end, first + _MOST_WINDOW_FRAMES))
            )
            windows = followed_windows(
                tracks, images, evenly(len(tracks.markers), _MOST_WINDOWS), _half_px(task, tracks)
            )
    except TrialCancelledError:
        return FailedTracking("the test track was cancelled", task.file)
    except UnreadableVideoError as error:
        return FailedTracking(str(error), task.file)
    exposure_s, step_s = task.settings.exposure_s, float(np.median(np.diff(tracks.time_s)))
    return Trial(tracks, windows, None if exposure_s is None else min(exposure_s / step_s, 1.0))


def _beginning_at(tracks: MarkerTracks, first: int) -> MarkerTracks:
    """Tracks without the frames before `first`; times are those of the recording."""
    arrays = {name: getattr(tracks, name) for name in _OF_FRAMES}
    return replace(tracks, **{name: found[first:] for name, found in arrays.items() if found is not None})


def _half_px(task: TrialTask, tracks: MarkerTracks) -> float | None:
    settings = task.settings
    if not kind_of(settings.kind).is_sought:
        return None if settings.size_px is None else 0.5 * settings.size_px
    if settings.size_mm is None or tracks.scale is None:
        return None
    return _AROUND * settings.size_mm / tracks.scale.mm_per_px


def _first_images(task: TrialTask) -> list[GrayImage] | Failure:
    try:
        with closing(open_recording(task.path)) as source:
            frames = itertools.islice(source.frames(), task.frames)
            images = [frame.image for frame in frames if frame.image is not None]
    except UnreadableVideoError as error:
        return Failure(str(error))
    return images or Failure("no frame can be decoded")


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


# Markers listed and drawn, evenly spread: the stations of a line are many.
MOST_LISTED = 24
_MOST_NAMES = 6


@dataclass(frozen=True)
class Tuning:
    """Beyond these a marker of a test track gets advice."""

    #: [px] sd of a position that is worth another choice of the point
    coarse: float = 0.05
    #: [px] motion between frames beyond which a short exposure matters
    fast: float = 3.0
    #: [px] motion during the exposure
    blurred: float = 5.0
    #: [1] share of frames without a position
    lost: float = 0.02
    #: [sd] a smaller motion is none
    #: statistics: A normal error exceeds it in 6e-7 of cases.
    least_motion: float = 5.0
    #: [1] share of a window's contrast that one picture that moves does not explain
    unexplained: float = 0.3


TUNING = Tuning()


@dataclass(frozen=True)
class TrialRow:
    """One marker of a test track.

    Median sd in px and mm (NaN without a scale), motion, largest step between frames, largest motion blur (NaN without
    an exposure time), share of frames lost, and what its window does not explain (NaN where that was not computed).
    """

    name: str
    sd_px: float
    sd_mm: float
    motion_px: float
    step_px: float
    blur_px: float
    lost: float
    unexplained: float

    def as_text(self) -> tuple[str, ...]:
        """Cells of the table; a value that is not known is a dash."""
        numbers = (
            f"{self.sd_px:.4f}",
            f"{self.sd_mm:.5f}",
            f"{self.motion_px:.2f}",
            f"{self.step_px:.2f}",
            f"{self.blur_px:.2f}",
            f"{100.0 * self.lost:.0f}",
            f"{100.0 * self.unexplained:.0f}",
        )
        return (self.name, *("–" if number == "nan" else number for number in numbers))


@dataclass(frozen=True)
class TrialSummary:
    """Rows of the markers, their paths (name, x, y), and sentences on what to change."""

    rows: tuple[TrialRow, ...]
    trails: tuple[tuple[str, list[float], list[float]], ...]
    advice: tuple[str, ...]


def summarised(trial: Trial) -> TrialSummary:
    """Numbers of the markers of a test track, at most 24, in order along the beam."""
    tracks = trial.tracks
    sd_px = _measured_sd(tracks, tracks.sd_x_px, tracks.sd_y_px)
    sd_mm = _measured_sd(tracks, tracks.sd_x_mm, tracks.sd_y_mm)
    share = float("nan") if trial.exposure_share is None else trial.exposure_share
    unexplained = {window.name: window.unexplained for window in trial.windows}
    rows, trails = [], []
    for k in evenly(len(tracks.markers), MOST_LISTED):
        xy = np.column_stack([tracks.x_px[:, k], tracks.y_px[:, k]])
        seen = np.all(np.isfinite(xy), axis=1)
        rows.append(
            _row(
                tracks.markers[k],
                xy,
                seen,
                (_median(sd_px[:, k]), _median(sd_mm[:, k])),
                share,
                unexplained.get(tracks.markers[k], float("nan")),
            )
        )
        if seen.any():
            trails.append((tracks.markers[k], xy[seen, 0].tolist(), xy[seen, 1].tolist()))
    return TrialSummary(tuple(rows), tuple(trails), advice(rows))


def _row(
    name: str,
    xy: FloatArray,
    seen: np.ndarray[tuple[int], np.dtype[np.bool_]],
    sd: tuple[float, float],
    exposure_share: float,
    unexplained: float,
) -> TrialRow:
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    step = float(np.nanmax(steps)) if np.isfinite(steps).any() else float("nan")
    return TrialRow(
        name,
        *sd,
        float(np.max(np.ptp(xy[seen], axis=0))) if seen.any() else float("nan"),
        step,
        step * exposure_share,
        1.0 - float(seen.mean()),
        unexplained,
    )


def _measured_sd(tracks: MarkerTracks, sd_x: FloatArray, sd_y: FloatArray) -> FloatArray:
    """Of the component that is measured: the errors of a station in x and y are parts of one across the line."""
    return np.asarray(np.fmin(sd_x, sd_y) if tracks.correlation_xy is None else np.hypot(sd_x, sd_y))


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def advice(rows: Sequence[TrialRow]) -> tuple[str, ...]:
    """What to change, for each concern that some of the markers raise."""
    t = TUNING
    concerns = (
        (
            [row.sd_px > t.coarse for row in rows],
            (
                f"the position is uncertain by more than {t.coarse} px; choose a point with more contrast, or a larger "
                "window."
            ),
        ),
        (
            [row.lost > t.lost for row in rows],
            "lost in some frames; choose a point that stays in the picture and does not look like its surroundings.",
        ),
        (
            [row.blur_px > t.blurred for row in rows],
            f"blurred by more than {t.blurred:g} px; shorten the exposure and add light.",
        ),
        (
            [row.step_px > t.fast and not np.isfinite(row.blur_px) for row in rows],
            (
                f"moves by more than {t.fast:g} px between frames; give the exposure time, and record faster if "
                "the marker is lost."
            ),
        ),
        (
            [row.unexplained > t.unexplained for row in rows],
            (
                "the picture in its window changes; delete it where it is not on what vibrates, or choose a smaller "
                "or a round window, which leaves out what does not move with it."
            ),
        ),
        (
            [row.motion_px < t.least_motion * row.sd_px for row in rows],
            "hardly moves in these frames; choose a point farther from the clamp, unless it is a fixed reference.",
        ),
    )
    return tuple(
        f"{_listed([row.name for row, is_so in zip(rows, found, strict=True) if is_so])}: {text}"
        for found, text in concerns
        if any(found)
    )


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
