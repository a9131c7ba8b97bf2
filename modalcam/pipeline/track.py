"""Stages that read a recording: its marker tracks, and their displacement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from modalcam.config import tracker_settings
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, InputFile, Stage
from tracker import FailedTracking, Failure, MarkerTracks, displacement_series

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


def not_tracked(file: str, reason: str) -> FailedTracking:
    """Failure of this stage."""
    return FailedTracking(reason, file)


TRACKING = Stage("tracking", "tracks", ("tracker",), track_recording, not_tracked, counts_frames=True)


def track_recordings(context: Context, recordings: Sequence[RecordingResult]) -> list[RecordingResult]:
    """Track each recording that has been hashed."""

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | FailedTracking | None:
        if recording.tracks is not None or recording.path is None:
            return None
        try:
            settings = tracker_settings(context.config.for_recording(recording.file))
        except ValueError as error:
            return FailedTracking(f"the configuration cannot be used: {error}", recording.file)
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
    return replace(recording, identification=Failure(reason, tracks.recording))
