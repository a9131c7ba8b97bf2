"""All stages of a run in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from modal_id.results import FailedIdentification
from modalcam.config.toml import dump_config
from modalcam.pipeline.compare import compare_recordings
from modalcam.pipeline.film import film_recordings, keep_frames
from modalcam.pipeline.identify import identify_recordings
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.pipeline.sources import SourceFile
from modalcam.pipeline.stage import Context
from modalcam.pipeline.track import track_recordings, with_displacement
from modalcam.pipeline.update import Theory, beam_theory, update_beam
from modalcam.storage.output_folder import RunRecord, Source
from modalcam.storage.provenance import versions
from tracker.results import FailedTracking


@dataclass(frozen=True)
class Measured:
    """Recordings through identification, and the theory of the configured beam."""

    recordings: tuple[RecordingResult, ...]
    known: Theory


def unmeasured(source: Source) -> RecordingResult:
    """Recording before the first stage; one that cannot be read has failed already."""
    failed = FailedTracking(source.file, source.failure) if source.failure else None
    return RecordingResult(source.name, source.file, source.sha256, source.mode, tracks=failed)


def track_sources(context: Context, files: Sequence[SourceFile]) -> list[RecordingResult]:
    """Track the markers of all recordings."""
    recordings = [unmeasured(file.source) for file in files]
    return track_recordings(context, recordings, [file.path for file in files])


def measure(context: Context, files: Sequence[SourceFile]) -> Measured:
    """Track, identify and keep frames of all recordings."""
    recordings = track_sources(context, files)
    known = beam_theory(context)
    recordings = identify_recordings(context, [with_displacement(r) for r in recordings], known.modes)
    if known.modes is not None:
        recordings = keep_frames(context, recordings, [file.path for file in files])
    return Measured(tuple(recordings), known)


def measure_series(context: Context, recording: RecordingResult) -> Measured:
    """Identify a single recording whose tracks or series are given."""
    known = beam_theory(context)
    recordings = identify_recordings(context, [with_displacement(recording)], known.modes)
    return Measured(tuple(recordings), known)


def simulate(context: Context, measured: Measured, record: RunRecord) -> tuple[RunResult, RunRecord]:
    """Update the beam, compare and film; returns the result of the run and its completed record."""
    beam, notes = update_beam(context, measured.recordings, measured.known)
    compared, skipped_models = compare_recordings(context, measured.recordings, beam)
    recordings = film_recordings(context, compared, beam)
    skipped = (*measured.known.skipped, *notes, *skipped_models)
    record = completed(replace(record, skipped=skipped), context, recordings)
    result = RunResult(
        folder=record.folder,
        recordings=tuple(recordings),
        beam=beam,
        not_done=(*record.notes, *record.skipped),
        resolved_config=dump_config(context.config),
        versions=record.versions,
        command_line=record.command_line,
        seed=record.seed,
        internal_errors=context.pool.internal_errors,
    )
    return result, record


def completed(record: RunRecord, context: Context, recordings: Sequence[RecordingResult]) -> RunRecord:
    """Record with the recordings, the keys of all results and the versions that computed them."""
    sources = tuple(
        Source(r.name, r.file, r.sha256, r.mode, _unsaved_failure(context, r)) for r in recordings
    )
    return replace(record, sources=sources, results=context.results, versions=versions())


def _unsaved_failure(context: Context, recording: RecordingResult) -> str:
    """Reason of a failure that no saved result holds: an unreadable file, or a task without a result."""
    saved = context.results.get(recording.name, {})
    if isinstance(recording.tracks, FailedTracking):
        return "" if "tracks" in saved else recording.tracks.reason
    if isinstance(recording.identification, FailedIdentification) and recording.series is not None:
        return "" if "modes" in saved else recording.identification.reason
    return ""
