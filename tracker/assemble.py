"""From the results of all frames to marker tracks: order, time axis, standard deviations, scale, notes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import BoolArray, FloatArray, IntArray
from tracker.follow import FollowedFrames, repeated_frames
from tracker.geometry import (
    NoTimeAxis,
    SizedMarker,
    TimeAxis,
    median_over_time,
    resolve_scale,
    resolve_time_axis,
)
from tracker.markers import JointCalibration
from tracker.register import Calibration, MarkerModel, fixed_point_px, with_motion_errors
from tracker.results import DecodeReport, FailedTracking, MarkerTracks
from tracker.settings import TrackerSettings
from tracker.template import series_sd
from tracker.video import SourceInfo

# A larger share of repeated frames indicates a converter.
DUPLICATES_WORTH_A_NOTE = 0.02
LISTED_RUNS = 3


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
    if isinstance(times, NoTimeAxis):
        return FailedTracking(recording, times.reason, first_frame)
    values, marks = rows.results.columns(order)
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
        correlation_xy=values[4] if len(values) > 4 else None,
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
    if count > DUPLICATES_WORTH_A_NOTE * total:
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
    return "frames " + ", ".join(runs[:LISTED_RUNS]) + (" and others" if len(runs) > LISTED_RUNS else "")
