"""First stages: the hash of each recording, its marker tracks, and the displacement of the markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from modal_id.results import FailedIdentification
from modalcam.config.resolve import tracker_settings
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, InputFile, Stage
from tracker.displacement import displacement_series
from tracker.results import DisplacementSeries, FailedTracking, MarkerTracks
from tracker.settings import TrackerSettings
from tracker.track import track


def track_file(recording: InputFile, file: str, settings: TrackerSettings) -> MarkerTracks | FailedTracking:
    """Marker positions of one recording."""
    return track(recording.path, settings, recording=file)


TRACKING = Stage("tracking", "tracks", ("tracker",), track_file, FailedTracking)


def track_recordings(
    context: Context, recordings: Sequence[RecordingResult], paths: Sequence[Path]
) -> list[RecordingResult]:
    """Track each recording that has been hashed."""
    inputs, failed = {}, {}
    for recording, path in zip(recordings, paths, strict=True):
        if recording.tracks is not None:
            continue
        try:
            settings = tracker_settings(context.config.for_recording(recording.file))
        except ValueError as error:
            reason = f"the configuration cannot be used: {error}"
            failed[recording.name] = FailedTracking(recording.file, reason)
            continue
        source = InputFile(path, recording.sha256)
        inputs[recording.name] = {"recording": source, "file": recording.file, "settings": settings}
    tracks = TRACKING.run(context, inputs) | failed
    return [replace(r, tracks=tracks.get(r.name, r.tracks)) for r in recordings]


def with_displacement(recording: RecordingResult) -> RecordingResult:
    """Add the displacement series of a tracked recording, or the reason why there is none."""
    if recording.series is not None or not isinstance(recording.tracks, MarkerTracks):
        return recording
    series = displacement(recording.tracks)
    if isinstance(series, FailedIdentification):
        return replace(recording, identification=series)
    return replace(recording, series=series)


def displacement(tracks: MarkerTracks) -> DisplacementSeries | FailedIdentification:
    """Displacement of the markers along the common direction of motion."""
    if not np.isfinite(tracks.x_px).any():
        return FailedIdentification(tracks.recording, "no marker was found in any frame")
    try:
        return displacement_series(tracks)
    except ValueError as error:
        return FailedIdentification(tracks.recording, str(error))
