"""Recordings of a run before anything is computed: their names, paths and hashes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from modalcam.execution.pool import TaskFailure
from modalcam.pipeline.stage import Context
from modalcam.storage.output_folder import Source
from modalcam.storage.provenance import RememberedHashes, recording_sha256


@dataclass(frozen=True)
class SourceFile:
    """A recording and where it is."""

    source: Source
    path: Path


def hashed(context: Context, files: Sequence[SourceFile]) -> tuple[SourceFile, ...]:
    """The same with the SHA-256 of each recording, or the reason why it cannot be read.

    Only recordings that are new or have changed are read, by worker processes; with `force` all of them.
    """
    remembered = RememberedHashes(context.workspace.hashes)
    readable = [file.path for file in files if not file.source.failure]
    sha256 = {} if context.force else {path: remembered.get(path) for path in readable}
    todo = [path for path in readable if not sha256.get(path)]
    failures: dict[Path, str] = {}
    if todo:
        context.progress.begin("reading", len(todo))
        stamps = {path: remembered.stamp(path) for path in todo}
        results = context.pool.map(
            _hash_or_reason, todo, done=lambda i: context.progress.advance(todo[i].name)
        )
        new = {}
        for path, result in zip(todo, results, strict=True):
            if isinstance(result, TaskFailure):
                failures[path] = result.reason
            elif result[1]:
                failures[path] = result[1]
            else:
                new[path] = result[0]
        remembered.store(stamps, new)
        sha256 |= new
    return tuple(
        replace(
            file,
            source=replace(
                file.source,
                sha256=sha256.get(file.path) or "",
                failure=failures.get(file.path, file.source.failure),
            ),
        )
        for file in files
    )


def _hash_or_reason(path: Path) -> tuple[str, str]:
    try:
        return recording_sha256(path), ""
    except OSError as error:
        return "", f"the file cannot be read ({error.strerror})"
