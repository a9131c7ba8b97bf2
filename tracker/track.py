"""The whole way of one recording: open, find, calibrate, follow, clock, scale."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import FloatArray, GrayImage
from tracker.follow import Follower, FrameResult
from tracker.follow.filmstrip import StripKeeper
from tracker.follow.frame_results import RowStore
from tracker.follow.frozen import frozen_frames
from tracker.geometry.scale import resolve_scale
from tracker.geometry.time_axis import FrameTimes, NoTimeAxis, resolve_time_axis
from tracker.markers.base import FoundMarkers, NothingFound
from tracker.markers.registry import detect_markers
from tracker.register.calibrate import calibrate
from tracker.register.exposure import (
    FIRST_GUESS,
    LEAST_MOTION_PX,
    ExposureShare,
    believed,
    estimate_exposure,
    largest_motion_px,
)
from tracker.register.marker import Camera, MarkerModel
from tracker.register.refined_noise import refined_noise
from tracker.results import DecodeReport, FailedTracking, MarkerTracks
from tracker.settings import TrackerSettings
from tracker.template.compression import sd_factors, series_sd
from tracker.template.noise import estimate_noise
from tracker.video.base import Frame, FrameSource, SourceInfo, UnreadableVideoError
from tracker.video.gray import to_8_bit
from tracker.video.prefetch import Prefetcher
from tracker.video.registry import open_recording

# Frames from which templates and noise are calibrated: enough to average noise away, few enough for memory.
CALIBRATION_FRAMES = 64
CALIBRATION_BYTES = 256 * 1024 * 1024
# Frames that are identical to the one before, beyond this share, mean a converter at work.
DUPLICATES_WORTH_A_NOTE = 0.02
MAX_FRAMES = 10_000_000

UNTOLD = (
    "Markers move by more than a px between frames, and neither exposure_s nor their blur tells for how long each "
    "frame was exposed: set exposure_s, or their positions may carry the blur."
)

Progress = Callable[[int, int], None]


@dataclass
class _Rows:
    """What was measured in each frame, in the order of decoding."""

    pts: list[int | None]
    results: RowStore
    decoded: int = 0
    corrupt: int = 0
    strip: StripKeeper = field(default_factory=StripKeeper)


@dataclass
class _Measured:
    """Markers, what correlated errors of pixels do to their sd (shape (2, m)), notes, and all frames."""

    models: tuple[MarkerModel, ...]
    sd_factors: FloatArray
    notes: tuple[str, ...]
    rows: _Rows


def track(
    path: Path, settings: TrackerSettings, *, recording: str | None = None, progress: Progress | None = None
) -> MarkerTracks | FailedTracking:
    """Positions of all markers in all frames of a recording, each with its standard deviation.

    Frames are streamed: memory holds the calibration frames and the results, not the recording.

    Parameters
    ----------
    path : Path
        The file.
    settings : TrackerSettings
    recording : str or None
        Name shown in results; the file's name when None.
    progress : callable or None
        Called with frames done and frames declared (0 where the file does not say).

    Returns
    -------
    MarkerTracks or FailedTracking
        The latter, falsy, when the file is no video, no marker or not those announced are seen, or no time axis
        can be made. Damaged frames and lost markers are NaN and flagged, not a failure.
    """
    recording = path.name if recording is None else recording
    try:
        source = open_recording(path)
    except UnreadableVideoError as error:
        return FailedTracking(recording, str(error))
    try:
        return _track_source(source, recording, settings, progress)
    except UnreadableVideoError as error:
        return FailedTracking(recording, str(error))
    finally:
        source.close()


def _track_source(
    source: FrameSource, recording: str, settings: TrackerSettings, progress: Progress | None
) -> MarkerTracks | FailedTracking:
    stream = source.frames()
    head = _head(stream)
    pictures = [frame.image for frame in head if frame.image is not None]
    if not pictures:
        count = len(head)
        reason = f"none of the {count} frames could be decoded" if count else "the file has no frames"
        return FailedTracking(recording, f"{reason}; it may be cut off or damaged: copy or export it again")
    first = to_8_bit(pictures[0])
    found = detect_markers(pictures, settings)
    if isinstance(found, NothingFound):
        return FailedTracking(recording, found.reason, first, found.seen_px)
    detector, markers = found
    info = source.info
    camera = _camera(pictures, info)
    models, exposure_share, missed = _calibrated_with_exposure(pictures, markers, camera, settings, info)
    if not info.lossy:  # what compression leaves in the residuals is not the camera's noise
        camera = replace(camera, noise=refined_noise(pictures, models, camera.noise, exposure_share))
    factors = [sd_factors(pictures, m) if info.lossy else (1.0, 1.0) for m in models]
    if not models:
        return FailedTracking(
            recording, "markers were seen, but none could be registered: contrast may be too low", first
        )
    follower = Follower(models, camera, detector, exposure_share)
    with Prefetcher(stream) as ahead:
        rows = _follow(itertools.chain(head, ahead), follower, info, progress)
    measured = _Measured(models, np.array(factors).T, (*markers.notes, *missed), rows)
    return _assemble(source.info, recording, settings, measured, first)


def _head(stream: Iterator[Frame]) -> list[Frame]:
    """First frames, up to the calibration's number of good ones or its memory."""
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


def _camera(pictures: list[GrayImage], info: SourceInfo) -> Camera:
    """Noise from the pictures; the level of saturation from their depth, or from where they pile up."""
    brightest = max(int(p.max()) for p in pictures[:4])
    saturation = float(info.white_level)
    if info.bit_depth > 8:
        # A 12-bit camera in a 16-bit file saturates at its own white: many pixels at the one largest value.
        share = max(float(np.mean(p == brightest)) for p in pictures[:4])
        if share > 1e-3:
            saturation = float(brightest)
    return Camera(estimate_noise(pictures, white_level=saturation), saturation)


def _calibrated(
    pictures: list[GrayImage], markers: FoundMarkers, camera: Camera, exposure_share: float
) -> tuple[tuple[MarkerModel, ...], tuple[str, ...]]:
    models: list[MarkerModel] = []
    missed: list[str] = []
    for detection in markers.detections:
        model = calibrate(pictures, detection, camera, exposure_share)
        if model is None:
            missed.append(detection.name)
        else:
            models.append(model)
    notes: tuple[str, ...] = ()
    if missed:
        notes = (f"{', '.join(missed)} was seen but could not be registered, and is left out.",)
    return tuple(models), notes


def _calibrated_with_exposure(
    pictures: list[GrayImage],
    markers: FoundMarkers,
    camera: Camera,
    settings: TrackerSettings,
    info: SourceInfo,
) -> tuple[tuple[MarkerModel, ...], float, tuple[str, ...]]:
    """Models, exposure over the time between frames as given or as the blur tells it, and notes."""
    share = _exposure_share(settings, info)
    models, notes = _calibrated(pictures, markers, camera, share)
    if settings.exposure_s is not None or largest_motion_px(models) < LEAST_MOTION_PX:
        return models, share, notes
    told = ExposureShare(FIRST_GUESS, 0.0)
    # Once more with templates that were learned with what the first round told.
    for _ in range(2):
        blurred, blurred_notes = _calibrated(pictures, markers, camera, told.share)
        estimate = estimate_exposure(pictures, blurred, camera)
        if estimate is None:
            return models, share, (*notes, UNTOLD)
        if not believed(estimate, largest_motion_px(blurred)):
            return models, share, notes
        told = estimate
    blurred, blurred_notes = _calibrated(pictures, markers, camera, told.share)
    note = (
        f"exposure_s was not given: the blur of moving markers tells {told.share:.3f} +- {told.sd:.3f} of the "
        "time between frames, and is modelled with that; set exposure_s if you know it."
    )
    return blurred, told.share, (*blurred_notes, note)


def _exposure_share(settings: TrackerSettings, info: SourceInfo) -> float:
    rate = settings.fps or info.frames_per_s
    if settings.exposure_s is None or rate is None:
        return 0.0
    return min(settings.exposure_s * float(rate), 1.0)


def _follow(
    stream: Iterator[Frame], follower: Follower, info: SourceInfo, progress: Progress | None
) -> _Rows:
    rows = _Rows([], RowStore(follower.markers))
    before: GrayImage | None = None
    # A blurred frame is bettered once the next one is in: each result waits that long.
    waiting: FrameResult | None = None
    for frame in stream:
        if len(rows.pts) >= MAX_FRAMES:
            msg = f"the recording has more than {MAX_FRAMES} frames; split it"
            raise UnreadableVideoError(msg)
        rows.pts.append(frame.pts)
        if frame.image is None:
            rows.corrupt += 1
            result = follower.missing(flags.DECODE_CORRUPT.value)
        else:
            rows.decoded += 1
            result = follower.step(frame.image)
            rows.strip.offer(len(rows.pts) - 1, frame.image, result.x_px, result.y_px)
            if before is not None and _same(before, frame.image):
                np.bitwise_or(result.flags, flags.DUPLICATE_FRAME.value, out=result.flags)
            before = frame.image
        if info.lossy:
            np.bitwise_or(result.flags, flags.LOSSY.value, out=result.flags)
        _keep(rows, waiting)
        waiting = result
        if progress is not None:
            progress(len(rows.pts), info.frames_declared)
    follower.finish()
    _keep(rows, waiting)
    return rows


def _keep(rows: _Rows, result: FrameResult | None) -> None:
    if result is not None:
        rows.results.append(result.x_px, result.y_px, result.sd_x_px, result.sd_y_px, result.flags)


def _same(one: GrayImage, other: GrayImage) -> bool:
    """Whether two pictures are equal; the middle row tells most that are not."""
    middle = one.shape[0] // 2
    return bool((one[middle] == other[middle]).all()) and np.array_equal(one, other)


def _shown_order(pts: list[int | None]) -> NDArray[np.int64]:
    """Order of showing: damaged frames may come out of the decoder late."""
    if any(p is None for p in pts):
        return np.arange(len(pts))
    return np.argsort(np.array(pts, dtype=np.int64), kind="stable")


def _assemble(
    info: SourceInfo,
    recording: str,
    settings: TrackerSettings,
    measured: _Measured,
    first: NDArray[np.uint8],
) -> MarkerTracks | FailedTracking:
    models, rows = measured.models, measured.rows
    order = _shown_order(rows.pts) if rows.corrupt else np.arange(len(rows.pts))
    times = resolve_time_axis(
        [rows.pts[k] for k in order],
        time_base=info.time_base,
        container_rate=info.container_rate,
        header_rate=info.header_rate,
        user_fps=settings.fps,
    )
    if isinstance(times, NoTimeAxis):
        return FailedTracking(recording, times.reason, first)
    columns = rows.results.columns(order)
    frozen = frozen_frames(columns["x_px"], columns["y_px"])
    columns["flags"][frozen] |= np.uint32(flags.DUPLICATE_FRAME.value)
    repeated = int(np.count_nonzero(np.any(columns["flags"] & flags.DUPLICATE_FRAME.value, axis=1)))
    sd_notes: tuple[str, ...] = ()
    if info.lossy:
        for axis_name, factor in zip(("x", "y"), measured.sd_factors, strict=True):
            columns[f"sd_{axis_name}_px"] = columns[f"sd_{axis_name}_px"] * factor
            floor = series_sd(columns[f"{axis_name}_px"], predictive=info.predictive)
            columns[f"sd_{axis_name}_px"] = np.fmax(
                columns[f"sd_{axis_name}_px"],
                np.where(np.isfinite(columns[f"{axis_name}_px"]), floor[None, :], np.nan),
            )
        note = (
            f"The footage is compressed with losses ({info.codec}); record raw, FFV1 or high-quality MJPG where "
            "positions matter."
        )
        sd_notes = (note,)
    positions = np.array([m.detection.position_mm for m in models])
    rest = _rest(columns["x_px"], columns["y_px"])
    scaled = resolve_scale(settings, models, rest, positions)
    return MarkerTracks(
        recording=recording,
        markers=tuple(m.detection.name for m in models),
        frame=np.arange(len(order), dtype=np.int64),
        time_s=times.time_s,
        x_px=columns["x_px"],
        y_px=columns["y_px"],
        sd_x_px=columns["sd_x_px"],
        sd_y_px=columns["sd_y_px"],
        flags=columns["flags"].astype(np.uint32),
        positions_mm=positions,
        scale=scaled.scale,
        time_axis=times.time_axis,
        decode=_decode_report(info, rows),
        reference=settings.reference,
        first_frame=first,
        notes=(
            *info.notes,
            *measured.notes,
            *scaled.notes,
            *sd_notes,
            *_count_notes(info, rows, times, repeated),
        ),
        strip=rows.strip.strip(order),
        lens=settings.lens,
        plane=scaled.plane,
        readout_s=settings.readout_s,
    )


def _rest(x_px: FloatArray, y_px: FloatArray) -> FloatArray:
    """Median position of each marker; shape (m, 2), NaN where never seen."""
    out = np.full((x_px.shape[1], 2), np.nan)
    for k in range(x_px.shape[1]):
        seen = np.isfinite(x_px[:, k])
        if seen.any():
            out[k] = np.median(x_px[seen, k]), np.median(y_px[seen, k])
    return out


def _decode_report(info: SourceInfo, rows: _Rows) -> DecodeReport:
    return DecodeReport(
        codec=info.codec,
        pixel_format=info.pixel_format,
        width_px=info.width_px,
        height_px=info.height_px,
        bit_depth=info.bit_depth,
        frames_declared=info.frames_declared,
        frames_decoded=rows.decoded,
        frames_corrupt=rows.corrupt,
        lossy=info.lossy,
    )


def _count_notes(info: SourceInfo, rows: _Rows, times: FrameTimes, repeated: int) -> tuple[str, ...]:
    notes = []
    total = len(rows.pts)
    if info.frames_declared and info.frames_declared != total:
        notes.append(f"The file announces {info.frames_declared} frames, but {total} are there.")
    if rows.corrupt:
        notes.append(f"{rows.corrupt} of {total} frames are damaged and have no positions.")
    if repeated > DUPLICATES_WORTH_A_NOTE * total:
        notes.append(
            f"{repeated} of {total} frames repeat the one before: a converter may have changed the rate, and "
            f"then the time axis ({times.time_axis.source}) is wrong."
        )
    elif repeated:
        notes.append(f"{repeated} of {total} frames repeat the one before and are not used.")
    return tuple(notes)
