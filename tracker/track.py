"""Tracking of one recording: open, detect, calibrate, follow, and assemble the tracks of its markers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import BoolArray, FloatArray, GrayImage, IntArray
from tracker.checks import Failure
from tracker.follow import FollowedFrames, Follower, Progress, follow_recording, repeated_frames
from tracker.geometry import SizedMarker, TimeAxis, median_over_time, resolve_scale, resolve_time_axis
from tracker.markers import (
    FoundMarkers,
    FrameFollower,
    JointCalibration,
    MarkerDetector,
    NothingFound,
    detect_markers,
    propose_points,
)
from tracker.register import (
    Calibration,
    MarkerModel,
    calibrate_all,
    fixed_point_px,
    initial_camera,
    with_motion_errors,
    without_edges,
)
from tracker.results import DecodeReport, FailedTracking, MarkerTracks
from tracker.settings import TrackerSettings
from tracker.template import series_sd
from tracker.video import (
    Frame,
    FrameSource,
    SourceInfo,
    UnreadableVideoError,
    open_recording,
    prefetched,
    to_8_bit,
)


@dataclass(frozen=True)
class Tuning:
    """Frames that a recording needs, and what is noted."""

    #: [1] share of repeated frames that indicates a converter
    #: convention: chosen; a note changes no result
    duplicates_worth_a_note: float = 0.02
    #: [1] runs of frames that a note lists
    #: convention: a line of text
    listed_runs: int = 3
    #: [frames] from which templates and noise are calibrated
    #: convention: enough to average out noise, few enough for memory
    calibration_frames: int = 64
    #: [bytes] of these frames, at most
    #: convention: a quarter of a GiB
    calibration_bytes: int = 268_435_456
    #: [1] multiple of these frames in which as many good ones must be found
    damaged_head: int = 8
    #: [frames] of a recording
    #: physics: with fewer no mode can be identified
    least_frames: int = 12
    #: [1] exposure or readout over the time between frames
    #: convention: they end before the next frame; the rate may be rounded
    longest_share: float = 1.05


TUNING = Tuning()


@dataclass(frozen=True)
class TrackedMarkers:
    """The m markers that were followed: what all kinds have in common.

    ``placed_mm`` (m,) are the positions of those that were placed independently of each other, from which a scale can
    be found; ``motion_sd`` (m,) errors relative to the motion, ``sd_factors`` (2, m) factors on the sd of x and y,
    ``ends_sd_mm`` the sd of the ends between which they were placed, if they were, ``fixed_points_px`` as in
    `MarkerTracks`.
    """

    kind: str
    names: tuple[str, ...]
    positions_mm: FloatArray
    placed_mm: FloatArray
    sized: tuple[SizedMarker | None, ...]
    motion_sd: FloatArray
    sd_factors: FloatArray
    notes: tuple[str, ...]
    ends_sd_mm: tuple[float, float] | None = None
    fixed_points_px: FloatArray | None = None


def from_templates(calibration: Calibration) -> TrackedMarkers:
    """Markers that are each registered with a template."""
    models = calibration.models
    positions_mm = np.array([m.detection.position_mm for m in models])
    return TrackedMarkers(
        models[0].detection.kind.name,
        tuple(m.detection.name for m in models),
        positions_mm,
        positions_mm,
        tuple(_sized(m) for m in models),
        np.array([m.motion_sd for m in models]),
        calibration.sd_factors,
        calibration.notes,
        fixed_points_px=np.stack([fixed_point_px(m) for m in models], axis=1),
    )


def from_joint(kind: str, calibration: JointCalibration) -> TrackedMarkers:
    """Markers that are registered together."""
    m = len(calibration.names)
    # Of a line, both ends are known and the stations are at equal distances between them.
    placed_mm = np.full(m, np.nan)
    placed_mm[[0, -1]] = calibration.positions_mm[[0, -1]]
    return TrackedMarkers(
        kind,
        calibration.names,
        calibration.positions_mm,
        placed_mm,
        (None,) * m,
        np.zeros(m),
        calibration.sd_factors,
        calibration.notes,
        calibration.ends_sd_mm,
    )


def assemble(
    info: SourceInfo,
    recording: str,
    settings: TrackerSettings,
    markers: TrackedMarkers,
    rows: FollowedFrames,
    notes: tuple[str, ...],
    first_frame: NDArray[np.uint8],
) -> MarkerTracks | FailedTracking:
    """Tracks of a recording; a failure when no time axis can be determined.

    `info` is that after the last frame, `notes` are those of the detection.
    """
    order = _presentation_order(rows.pts) if rows.corrupt else np.arange(len(rows.pts))
    times = resolve_time_axis(
        [rows.pts[k] for k in order],
        time_base=info.time_base,
        container_rate=info.container_rate,
        header_rate=info.header_rate,
        user_fps=settings.fps,
        rate_sd_ppm=settings.fps_tolerance_ppm,
    )
    if isinstance(times, Failure):
        return FailedTracking(times.reason, recording, first_frame=first_frame)
    values, marks, correlation = rows.results.columns(order)
    repeated = repeated_frames(np.array(rows.changes)[order], values[0], values[1])
    if times.used is not None:
        marks[~times.used] |= np.uint32(flags.OTHER_RATE.value)
    marks[repeated] |= np.uint32(flags.DUPLICATE_FRAME.value)
    if info.lossy:
        _enlarge_sd(values, markers.sd_factors, predictive=info.predictive)
    for axis in range(2):
        values[2 + axis] = with_motion_errors(values[axis], values[2 + axis], markers.motion_sd)
    rest_px = median_over_time(np.moveaxis(values[:2], 1, 0)).T
    scaled = resolve_scale(settings, markers.sized, rest_px, markers.placed_mm)
    return MarkerTracks(
        recording=recording,
        markers=markers.names,
        frame=np.arange(len(order), dtype=np.int64),
        time_s=times.time_s,
        x_px=values[0],
        y_px=values[1],
        sd_x_px=values[2],
        sd_y_px=values[3],
        flags=marks,
        positions_mm=markers.positions_mm,
        scale=scaled.scale,
        time_axis=times.time_axis,
        decode=DecodeReport(
            codec=info.codec,
            pixel_format=info.pixel_format,
            width_px=info.width_px,
            height_px=info.height_px,
            bit_depth=info.bit_depth,
            frames_declared=info.frames_declared,
            frames_decoded=rows.decoded,
            frames_corrupt=rows.corrupt,
            lossy=info.lossy,
            predictive=info.predictive,
            reordered=info.reordered,
        ),
        reference=settings.reference,
        input=settings.input,
        first_frame=first_frame,
        notes=(
            *info.notes,
            *notes,
            *markers.notes,
            *scaled.notes,
            *_frame_notes(info, rows, times.time_axis, repeated),
        ),
        strip=rows.strip.strip(order),
        lens=settings.lens,
        plane=scaled.plane,
        readout_s=settings.readout_s,
        kind=markers.kind,
        correlation_xy=correlation,
        ends_sd_mm=markers.ends_sd_mm,
        fixed_points_px=markers.fixed_points_px,
    )


def _presentation_order(pts: list[int | None]) -> IntArray:
    """Rows in order of presentation: damaged frames may leave the decoder late."""
    if any(p is None for p in pts):
        return np.arange(len(pts))
    return np.argsort(np.array(pts, dtype=np.int64), kind="stable")


def _enlarge_sd(values: FloatArray, factors: FloatArray, *, predictive: bool) -> None:
    """Apply the correlation of compression errors in space, and their size in the series, to the sd in `values`."""
    for axis in range(2):
        positions, sd = values[axis], values[2 + axis]
        least = np.where(np.isfinite(positions), series_sd(positions, predictive=predictive)[None, :], np.nan)
        values[2 + axis] = np.fmax(sd * factors[axis], least)


def _sized(model: MarkerModel) -> SizedMarker | None:
    kind = model.detection.kind
    if not kind.has_nominal_size:
        return None
    return SizedMarker(
        model.detection.name,
        model.detection.size_px,
        model.warp,
        is_fitted=model.source == "parametric",
        has_shape=kind.has_nominal_shape,
    )


def _frame_notes(
    info: SourceInfo, rows: FollowedFrames, time_axis: TimeAxis, repeated: BoolArray
) -> tuple[str, ...]:
    notes = []
    if info.lossy:
        notes.append(
            f"The footage is lossily compressed ({info.codec}); record raw, FFV1 or high-quality MJPG where "
            "positions matter."
        )
    total = len(rows.pts)
    if info.frames_declared and info.frames_declared != total:
        notes.append(f"The file declares {info.frames_declared} frames, but contains {total}.")
    if rows.corrupt:
        notes.append(f"{rows.corrupt} of {total} frames are damaged and have no positions.")
    count = int(np.count_nonzero(repeated))
    if count > TUNING.duplicates_worth_a_note * total:
        notes.append(
            f"{count} of {total} frames repeat the previous one and are not used: a converter may have changed the "
            f"rate, and then the time axis ({time_axis.source}) is wrong."
        )
    elif count:
        notes.append(
            f"{count} of {total} frames repeat the previous one and are not used: {_runs(repeated)}."
        )
    return tuple(notes)


def _runs(chosen: BoolArray) -> str:
    """Runs of frames as text, at most three."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    runs = [str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return (
        "frames "
        + ", ".join(runs[: TUNING.listed_runs])
        + (" and others" if len(runs) > TUNING.listed_runs else "")
    )


_NONE = f"the file has no frames, but at least {TUNING.least_frames} are needed"


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
        return FailedTracking(str(error), recording)


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
        return FailedTracking(impossible, recording)
    stream = source.frames()
    head = _head(stream)
    images = [frame.image for frame in head if frame.image is not None]
    if not images:
        count = len(head)
        reason = f"none of the {count} frames could be decoded" if count else _NONE
        return FailedTracking(
            f"{reason}; it may be incomplete or damaged: copy or export it again", recording
        )
    first = to_8_bit(images[0])
    found = detect_markers(images, settings, settings.kind)
    if isinstance(found, NothingFound):
        return FailedTracking(
            found.reason,
            recording,
            first_frame=first,
            seen_px=found.seen_px,
            proposed_px=propose_points(images),
        )
    calibrated = _calibrated(images, *found, settings, source.info)
    if isinstance(calibrated, NothingFound):
        return FailedTracking(calibrated.reason, recording, first_frame=first)
    follower, markers = calibrated
    with closing(prefetched(stream)) as ahead:
        rows = follow_recording(itertools.chain(head, ahead), follower, source.info, progress)
    tracks = assemble(source.info, recording, settings, markers, rows, found[1].notes, first)
    if isinstance(tracks, MarkerTracks) and not np.isfinite(tracks.x_px).any():
        white_level = float(source.info.white_level)
        white = without_edges(images, found[1].detections, white_level)
        return FailedTracking(white, recording, first_frame=first) if white else tracks
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
        if (
            good >= TUNING.calibration_frames
            or size >= TUNING.calibration_bytes
            or len(head) > TUNING.damaged_head * TUNING.calibration_frames
        ):
            break
    return head


def _longer_than_a_frame(settings: TrackerSettings, info: SourceInfo) -> str:
    """Sentence on an exposure or a readout that takes longer than the time between frames; empty without one."""
    rate = settings.fps or info.frames_per_s
    for key, value_s in (("exposure_s", settings.exposure_s), ("readout_s", settings.readout_s)):
        if rate is not None and value_s is not None and abs(value_s) * float(rate) > TUNING.longest_share:
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
