"""Hashes of the recordings of a run; this module loads little, since it is the first that worker processes import."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from modalcam.common import shown
from modalcam.pipeline.pool import TaskFailure
from modalcam.pipeline.provenance import RememberedHashes, recording_sha256
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context
from tracker import FailedTracking


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
            return replace(recording, tracks=FailedTracking(value.reason, recording.file))
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
