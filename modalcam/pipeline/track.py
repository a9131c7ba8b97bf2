"""Stages that read a recording: its marker tracks, their displacement, and a few frames kept for the report.

Motion from a table, an array or a universal file instead of a recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from modal_id import FailedIdentification
from modalcam.common import InputError, shown
from modalcam.config import RecordingConfig, tracker_settings
from modalcam.inputs import (
    ENDINGS,
    Table,
    is_tracks,
    read_table,
    read_uff,
    series_from_table,
    tracks_from_table,
)
from modalcam.pipeline.pool import Limits, TaskFailure, worker_pool
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, InputFile, Stage
from tracker import FailedTracking, MarkerTracks, displacement_series

if TYPE_CHECKING:
    from tracker import TrackerSettings
    from tracker.follow import Progress


def track_recording(
    path: Path, recording: str, settings: TrackerSettings, progress: Progress
) -> MarkerTracks | FailedTracking:
    """As `tracker.track.track`."""
    # Workers only: readers and kernels take longer to load than a report takes to write.
    from tracker import track  # noqa: PLC0415

    return track(path, settings, recording=recording, progress=progress)


TRACKING = Stage("tracking", "tracks", ("tracker",), track_recording, FailedTracking, counts_frames=True)


def track_recordings(context: Context, recordings: Sequence[RecordingResult]) -> list[RecordingResult]:
    """Track each recording that has been hashed."""

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | FailedTracking | None:
        if recording.tracks is not None or recording.path is None:
            return None
        try:
            settings = tracker_settings(context.config.for_recording(recording.file))
        except ValueError as error:
            return FailedTracking(recording.file, f"the configuration cannot be used: {error}")
        source = InputFile(recording.path, recording.sha256)
        return {"path": source, "recording": recording.file, "settings": settings}

    return TRACKING.each(context, recordings, inputs)


def with_displacement(recording: RecordingResult) -> RecordingResult:
    """Add the displacement series of a tracked recording, or the reason why there is none."""
    tracks = recording.tracks
    if recording.series is not None or not isinstance(tracks, MarkerTracks):
        return recording
    reason = "no marker was found in any frame"
    if np.isfinite(tracks.x_px).any():
        try:
            return replace(recording, series=displacement_series(tracks))
        except ValueError as error:
            reason = str(error)
    return replace(recording, identification=FailedIdentification(tracks.recording, reason))


def motion_of(
    path: Path, name: str, given: RecordingConfig, limits: Limits, *, unit: str, rate_hz: float | None
) -> dict[str, Any]:
    """Series or tracks of a file, as the field of a `RecordingResult`; the table that they are made from is not kept.

    `unit` is that of channels that do not state it, `rate_hz` the samples per second of a table without times.
    """
    positions_mm = given.positions_mm
    motion: dict[str, Any] = {}
    if path.suffix.lower() in ENDINGS:
        if rate_hz is not None:
            msg = f"{shown(str(path))}: a universal file holds its times; --rate is for tables without times"
            raise InputError(msg)
        motion["series"] = read_uff(path, name=name, unit=unit, positions_mm=positions_mm)
    elif is_tracks(table := _table(path, rate_hz, limits)):
        reference = given.reference or ()
        motion["tracks"] = tracks_from_table(table, name=name, positions_mm=positions_mm, reference=reference)
    else:
        motion["series"] = series_from_table(table, name=name, unit=unit, positions_mm=positions_mm)
    return _with_rate_sd(given.fps_tolerance_ppm or 0.0, motion)


def _table(path: Path, rate_hz: float | None, limits: Limits) -> Table:
    """Columns of a file; a MATLAB file, of which a damaged one ends its reader by a signal, in another process."""
    if path.suffix.lower() != ".mat":
        return read_table(path, rate_hz)
    with worker_pool(1, limits) as pool:
        (found,) = pool.map(partial(read_table, rate_hz=rate_hz), [path])
    if isinstance(found, TaskFailure):
        msg = f"{shown(str(path))}: {found.reason}"
        raise InputError(msg)
    return found


def _with_rate_sd(ppm: float, motion: dict[str, Any]) -> dict[str, Any]:
    """The motion with the relative standard deviation of its rate; a table has no source of a rate to take it from."""
    if "tracks" in motion:
        axis = replace(motion["tracks"].time_axis, rate_sd_ppm=ppm)
        return {"tracks": replace(motion["tracks"], time_axis=axis)}
    return {"series": replace(motion["series"], rate_sd_ppm=ppm)}
