"""All stages of a run in their order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from modalcam.config import dump_config
from modalcam.pipeline.beam import beam_theory, update_beam
from modalcam.pipeline.compare import compare_recordings
from modalcam.pipeline.identify import identify_recordings
from modalcam.pipeline.output_folder import RunRecord, Source
from modalcam.pipeline.provenance import processor, versions
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.pipeline.stage import Context, added_stages
from modalcam.pipeline.track import track_recordings, with_displacement
from sim.beam import BeamModes
from tracker import FailedTracking, Failure


@dataclass(frozen=True)
class Measured:
    """Recordings through identification, and the modes of the configured beam or why there are none."""

    recordings: tuple[RecordingResult, ...]
    theory: BeamModes | str


def measure(
    context: Context,
    recordings: Sequence[RecordingResult],
    with_input: Callable[[RecordingResult], RecordingResult] | None = None,
) -> Measured:
    """Track and identify all recordings; tracks or a series that are given are used.

    `with_input` adds an input that was recorded beside them, or a failure.
    """
    tracked = [with_displacement(r) for r in track_recordings(context, recordings)]
    driven = tracked if with_input is None else [with_input(r) for r in tracked]
    theory = beam_theory(context)
    modes = None if isinstance(theory, str) else theory
    identified = identify_recordings(context, driven, modes)
    return Measured(tuple(identified), theory)


def simulate(context: Context, measured: Measured, record: RunRecord) -> tuple[RunResult, RunRecord]:
    """Update the beam, compare and film; returns the result of the run and its completed record."""
    beam, notes, kept = update_beam(context, measured.recordings, measured.theory)
    recordings, skipped_models = compare_recordings(context, kept, beam)
    record = completed(replace(record, skipped=(*notes, *skipped_models)), context, recordings)
    result = RunResult(
        folder=record.folder,
        recordings=tuple(recordings),
        beam=beam,
        not_done=(*record.notes, *record.skipped),
        resolved_config=dump_config(context.config),
        versions=record.versions,
        command_line=record.command_line,
        seed=record.seed,
    )
    added = {
        one.stage.file: one.stage.once(context, **given)
        for one in added_stages("run")
        if (given := one.inputs(context, result, None)) is not None
    }
    return replace(result, added=added, internal_errors=context.pool.internal_errors), record


def completed(record: RunRecord, context: Context, recordings: Sequence[RecordingResult]) -> RunRecord:
    """Record with the recordings, the keys of all results and the versions that computed them."""
    sources = tuple(
        Source(r.name, r.file, r.sha256, r.mode, _unsaved_failure(context, r)) for r in recordings
    )
    return replace(record, sources=sources, results=context.results, versions=(*versions(), *processor()))


def _unsaved_failure(context: Context, recording: RecordingResult) -> str:
    """Reason of a failure that no saved result holds: an unreadable file, or a task without a result."""
    saved = context.results.get(recording.name, {})
    if isinstance(recording.tracks, FailedTracking):
        return "" if "tracks" in saved else recording.tracks.reason
    if isinstance(recording.identification, Failure) and recording.series is not None:
        return "" if "modes" in saved else recording.identification.reason
    return ""
