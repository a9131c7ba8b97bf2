"""Hashes of inputs, code and versions: the key of a result changes with everything that it depends on."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from modalcam import __version__
from modalcam.plugins import loaded_plugins
from modalcam.storage.atomic import write_text
from modalcam.storage.cache import digest
from tracker.video.registry import input_files

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
    "xarray",
    "h5netcdf",
    "pyuff",
)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def recording_sha256(path: Path) -> str:
    """SHA-256 of a recording: of its file, or of the names and hashes of all files that it consists of."""
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
    show a change directly after it.

    Parameters
    ----------
    path : Path
        JSON file of the hashes; a missing or damaged one holds none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._entries: dict[str, list[Any]] = {}
        with suppress(OSError, ValueError):
            self._entries = dict(json.loads(path.read_text("utf-8")))

    def get(self, recording: Path) -> str | None:
        """Hash of an unchanged recording, or None."""
        stamp, sha256 = self._entries.get(_entry_name(recording), (None, None))
        return sha256 if stamp is not None and stamp == _stamp(recording) else None

    def store(self, stamps: Mapping[Path, Any], hashes: Mapping[Path, str]) -> None:
        """Remember hashes of recordings whose stamps, taken before they were hashed, are given; writes the file."""
        for path, sha256 in hashes.items():
            if stamps[path] is not None:
                self._entries[_entry_name(path)] = [stamps[path], sha256]
        write_text(self._path, json.dumps(self._entries, indent=1) + "\n")

    @staticmethod
    def stamp(recording: Path) -> Any:
        """State of the recording's files before they are hashed; None if they changed just now or cannot be read."""
        stamp = _stamp(recording)
        latest = max((entry[-1] for entry in stamp or ()), default=0)
        return stamp if time.time_ns() - latest > _SETTLED_NS else None


_SETTLED_NS = 2_000_000_000


def _entry_name(recording: Path) -> str:
    return os.fsencode(recording.absolute()).decode("ascii", "backslashreplace")


def _stamp(recording: Path) -> list[list[Any]] | None:
    try:
        return [
            [
                os.fsencode(file.name).decode("ascii", "backslashreplace"),
                s.st_size,
                s.st_ino,
                s.st_mtime_ns,
                s.st_ctime_ns,
            ]
            for file in input_files(recording)
            for s in [file.stat()]
        ]
    except OSError:
        return None


def versions() -> tuple[tuple[str, str], ...]:
    """Versions of modalcam, of Python and of the installed libraries that results depend on."""
    found = [("modalcam", __version__), ("python", platform.python_version())]
    for name in LIBRARIES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found.append((name, importlib.metadata.version(name)))
    return tuple(found)


@cache
def code_sha256(*modules: str) -> str:
    """SHA-256 of the source of packages (with all they contain) or modules of ours."""
    parts = hashlib.sha256()
    for name in modules:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            msg = f"there is no package or module {name}"
            raise ValueError(msg)
        origin = Path(spec.origin)
        files = [origin]
        if spec.submodule_search_locations is not None:
            files = sorted(origin.parent.rglob("*.py"))
        for path in files:
            parts.update(path.relative_to(origin.parent).as_posix().encode())
            parts.update(path.read_bytes())
    return parts.hexdigest()


def code_state(*modules: str) -> tuple[object, ...]:
    """Everything but its inputs that a result of `modules` depends on: their source, plugins, other libraries."""
    return code_sha256(*modules), loaded_plugins(), versions()


def stage_key(stage: str, **inputs: Any) -> str:
    """SHA-256 of the name of a stage and of everything that its result depends on.

    Parameters
    ----------
    stage : str
    **inputs :
        Values that `modalcam.storage.cache.digest` takes.
    """
    return digest((stage, inputs))


def opencv_wheels() -> tuple[str, ...]:
    """Installed distributions that contain OpenCV; two of them overwrite each other's files."""
    names = (d.metadata["Name"] or "" for d in importlib.metadata.distributions())
    return tuple(sorted({name for name in names if name.startswith("opencv-")}))
