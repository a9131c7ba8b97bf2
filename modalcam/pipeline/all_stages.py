"""All stages of a run in their order.

Hashes of the recordings of a run; this module loads little, since it is the first that worker processes import.

Results of a finished run, read from OUT; nothing is computed and no process is started.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from modal_id import FailedIdentification
from modalcam.common import InputError, shown
from modalcam.config import dump_config
from modalcam.pipeline.beam import beam_theory, update_beam
from modalcam.pipeline.cache import load
from modalcam.pipeline.compare import compare_recordings
from modalcam.pipeline.identify import identify_recordings
from modalcam.pipeline.output_folder import RunRecord, Source, Workspace
from modalcam.pipeline.pool import TaskFailure
from modalcam.pipeline.provenance import RememberedHashes, processor, recording_sha256, versions
from modalcam.pipeline.results import RUN, STAGE_FIELDS, RecordingResult, RunResult
from modalcam.pipeline.stage import Context
from modalcam.pipeline.track import track_recordings, with_displacement
from modalcam.plugins import load_plugins
from sim.beam import BeamModes
from tracker import FailedTracking


@dataclass(frozen=True)
class Measured:
    """Recordings through identification, and the modes of the configured beam or why there are none."""

    recordings: tuple[RecordingResult, ...]
    theory: BeamModes | str


def measure(context: Context, recordings: Sequence[RecordingResult]) -> Measured:
    """Track and identify all recordings; tracks or a series that are given are used."""
    tracked = track_recordings(context, recordings)
    theory = beam_theory(context)
    modes = None if isinstance(theory, str) else theory
    identified = identify_recordings(context, [with_displacement(r) for r in tracked], modes)
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
        internal_errors=context.pool.internal_errors,
    )
    return result, record


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
    if isinstance(recording.identification, FailedIdentification) and recording.series is not None:
        return "" if "modes" in saved else recording.identification.reason
    return ""


def hashed(
    context: Context, recordings: Sequence[RecordingResult], meanwhile: Iterator[object] | None = None
) -> list[RecordingResult]:
    """The recordings with the SHA-256 of each, or the reason why it cannot be read.

    Only recordings that are new or have changed are read, by worker processes; with `force` all of them. Until they
    have been read, this process takes steps of `meanwhile`.
    """
    remembered = RememberedHashes(context.workspace.hashes)
    paths = [r.path for r in recordings if r.path is not None and r.tracks is None]
    known = {} if context.force else {path: remembered.get(path) for path in paths}
    found: dict[Path | None, str | TaskFailure] = {path: sha256 for path, sha256 in known.items() if sha256}
    todo = [path for path in paths if path not in found]
    if todo:
        context.progress.begin("reading", len(todo))
        stamps = {path: remembered.stamp(path) for path in todo}
        results = context.pool.map(
            _sha256, todo, done=lambda i: context.progress.advance(todo[i].name), meanwhile=meanwhile
        )
        found.update(zip(todo, results, strict=True))
        new = {path: found[path] for path in todo}
        remembered.store(stamps, {path: value for path, value in new.items() if isinstance(value, str)})

    def with_hash(recording: RecordingResult) -> RecordingResult:
        value = found.get(recording.path, "")
        if isinstance(value, TaskFailure):
            return replace(recording, tracks=FailedTracking(recording.file, value.reason))
        return replace(recording, sha256=value)

    return [with_hash(recording) for recording in recordings]


def duplicates(recordings: Sequence[RecordingResult]) -> tuple[str, ...]:
    """A sentence for each group of recordings with the same content: they are no repeated measurement."""
    files: dict[str, list[str]] = {}
    for recording in recordings:
        if recording.sha256:
            files.setdefault(recording.sha256, []).append(shown(recording.file))
    return tuple(
        f"{', '.join(same[:-1])} and {same[-1]} have the same content: they are one measurement, not {len(same)}."
        for same in files.values()
        if len(same) > 1
    )


def _sha256(path: Path) -> str | TaskFailure:
    try:
        return recording_sha256(path)
    except OSError as error:
        return TaskFailure(f"the file cannot be read ({error.strerror})")


# Results that `simulate` starts from.
MEASURED = ("tracks", "modes", "frames")


def load_run(out: str | Path, plugins: tuple[str, ...] = ()) -> RunResult:
    """Read a finished run; its recordings, beam and configuration are loaded when first used.

    Parameters
    ----------
    out : str or Path
        Folder of the results of `modalcam run`, `identify` or `simulate`.
    plugins : tuple of str
        Modules to load first, in addition to the plugins of installed distributions; the run needs all that it used.

    Raises
    ------
    InputError
        If OUT holds no run. A result that is missing or was saved by another version of modalcam raises it when
        `recordings` or `beam` is first used.

    Examples
    --------
    >>> import modalcam as mc
    >>> result = mc.load_run("out")  # doctest: +SKIP
    >>> result.recordings[0].identification.target  # doctest: +SKIP
    """
    load_plugins(plugins)
    workspace = Workspace(Path(out))
    state = workspace.read_state()

    def results() -> dict[str, Any]:
        record = workspace.read_record()
        return {
            "recordings": tuple(load_recording(workspace, record, source) for source in record.sources),
            "beam": _result(workspace, record, RUN, "updating"),
            "resolved_config": dump_config(record.config),
        }

    light = {name: state[name] for name in ("folder", "versions", "command_line", "seed")}
    return RunResult.saved(results, not_done=(*state["notes"], *state["skipped"]), **light)


def load_recording(
    workspace: Workspace, record: RunRecord, source: Source, files: tuple[str, ...] = tuple(STAGE_FIELDS)
) -> RecordingResult:
    """One recording with those of its saved results that are in `files`; InputError if one cannot be read."""
    from modal_id import FailedIdentification, Identification  # noqa: PLC0415 - heavy
    from modalcam.pipeline.track import with_displacement  # noqa: PLC0415
    from tracker import FailedTracking, MarkerTracks  # noqa: PLC0415

    found = {STAGE_FIELDS[name]: _result(workspace, record, source.name, name) for name in files}
    if source.failure and found["tracks"] is None:
        found["tracks"] = FailedTracking(source.file, source.failure)
    identification = found.pop("identification")
    recording = RecordingResult(source.name, source.file, source.sha256, source.mode, **found)
    if isinstance(identification, Identification):
        return replace(recording, series=identification.series, identification=identification)
    recording = with_displacement(recording)
    if identification is None and source.failure and isinstance(recording.tracks, MarkerTracks):
        identification = FailedIdentification(source.name, source.failure)
    return recording if identification is None else replace(recording, identification=identification)


def _result(workspace: Workspace, record: RunRecord, name: str, file: str) -> Any:
    key = record.results.get(name, {}).get(file)
    if key is None:
        return None
    path = workspace.state(name, file)
    value = load(path, key)
    if value is None:
        msg = f"{path}: expected the result of the run in {workspace.out}, found none; run the same command again"
        raise InputError(msg)
    return value
