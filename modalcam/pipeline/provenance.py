"""Hashes of inputs, code and versions: the key of a result changes with everything that it depends on."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modalcam import __version__
from modalcam.common import shown
from modalcam.pipeline.atomic import read_json, write_json
from modalcam.pipeline.cache import digest
from modalcam.pipeline.pool import TaskFailure
from modalcam.pipeline.results import RecordingResult
from modalcam.plugins import loaded_plugins, source_sha256

if TYPE_CHECKING:
    from modalcam.pipeline.stage import Context

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "emcee",
    "av",
    "opencv-contrib-python-headless",
    "scikit-image",
    "tifffile",
    "pandas",
    "matplotlib",
    "pydantic",
    "jinja2",
    "h5netcdf",
    "pyuff",
)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def recording_sha256(path: Path) -> str:
    """SHA-256 of a recording: of its file, or of the names and hashes of all files that it consists of."""
    from tracker.video import input_files  # noqa: PLC0415 - loads the readers

    files = input_files(path)
    if files == (path,):
        return file_sha256(path)
    parts = hashlib.sha256()
    for file in files:
        parts.update(os.fsencode(file.name) + b"\0" + file_sha256(file).encode())
    return parts.hexdigest()


class RememberedHashes:
    """Hashes of recordings from earlier runs, valid while no file of the recording has changed.

    A file counts as unchanged while its path, size, inode, modification time and status change time stay the same. The
    last cannot be set back, so that a change is noticed even if the modification time was restored. A file that
    changed less than two seconds before it was hashed is not remembered: the clock of some file systems would not
    show a change directly after it. They are kept in the JSON file `path`; a missing or damaged one holds none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._entries: dict[str, list[Any]] = {}
        with suppress(OSError, ValueError):
            self._entries = read_json(path)

    def get(self, recording: Path) -> str | None:
        """Hash of an unchanged recording, or None."""
        entry = self._entries.get(_ascii(recording.absolute()))
        # Damaged entries are of any type.
        if not isinstance(entry, list) or len(entry) != 2 or entry[0] is None:
            return None
        stamp, sha256 = entry
        return sha256 if isinstance(sha256, str) and stamp == _stamp(recording) else None

    def store(self, stamps: Mapping[Path, Any], hashes: Mapping[Path, str]) -> None:
        """Remember hashes of recordings whose stamps, taken before they were hashed, are given; writes the file."""
        for path, sha256 in hashes.items():
            if stamps[path] is not None:
                self._entries[_ascii(path.absolute())] = [stamps[path], sha256]
        write_json(self._path, self._entries)

    @staticmethod
    def stamp(recording: Path) -> Any:
        """State of the recording's files before they are hashed; None if they changed just now or cannot be read."""
        stamp = _stamp(recording)
        latest = max((entry[-1] for entry in stamp or ()), default=0)
        return stamp if time.time_ns() - latest > _SETTLED_NS else None


_SETTLED_NS = 2_000_000_000


def _ascii(name: str | Path) -> str:
    return os.fsencode(name).decode("ascii", "backslashreplace")


def _stamp(recording: Path) -> list[list[Any]] | None:
    from tracker.video import input_files  # noqa: PLC0415 - loads the readers

    try:
        states = [(file, file.stat()) for file in input_files(recording)]
    except OSError:
        return None
    return [[_ascii(f.name), s.st_size, s.st_ino, s.st_mtime_ns, s.st_ctime_ns] for f, s in states]


@cache
def versions() -> tuple[tuple[str, str], ...]:
    """Versions of modalcam, of Python and of the installed libraries that results depend on."""
    found = [("modalcam", __version__), ("python", platform.python_version())]
    for name in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found.append((name, importlib.metadata.version(name)))
    return tuple(found)


@cache
def processor() -> tuple[tuple[str, str], ...]:
    """Processor, as compilers name it, and the kernels of the BLAS: the last digits of results depend on them."""
    import scipy.linalg  # noqa: F401, PLC0415 - loads the BLAS of most linear algebra
    from llvmlite.binding import get_host_cpu_name  # noqa: PLC0415
    from threadpoolctl import threadpool_info  # noqa: PLC0415

    kernels = {
        f"{library['internal_api']} {library.get('architecture', library['version'])}"
        for library in threadpool_info()
        if library["user_api"] == "blas"
    }
    return ("processor", get_host_cpu_name()), ("BLAS", ", ".join(sorted(kernels)))


# Of modules of ours, which do not change while the program runs.
code_sha256 = cache(source_sha256)


def code_state(*modules: str) -> tuple[object, ...]:
    """Everything but its inputs that a result of `modules` depends on: their source, plugins, other libraries."""
    return code_sha256(*modules), loaded_plugins(), versions()


def stage_key(stage: str, **inputs: Any) -> str:
    """SHA-256 of the name of a stage and of everything that its result depends on."""
    return digest((stage, inputs))


def opencv_wheels() -> tuple[str, ...]:
    """Installed distributions that contain OpenCV; two of them overwrite each other's files."""
    names = (d.metadata["Name"] or "" for d in importlib.metadata.distributions())
    return tuple(sorted({name for name in names if name.startswith("opencv-")}))


def hashed(
    context: Context, recordings: Sequence[RecordingResult], meanwhile: Iterator[object] | None = None
) -> list[RecordingResult]:
    """The recordings with the SHA-256 of each, or the reason why it cannot be read.

    Only recordings that are new or have changed are read, by worker processes; with `force` all of them. Until they
    have been read, this process takes steps of `meanwhile`.
    """
    from tracker import FailedTracking  # noqa: PLC0415 - loads SciPy, which a run without changes does not

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
