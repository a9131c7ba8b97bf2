"""Find the recordings in a folder: regular files with a known ending, in natural order."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from modalcam.errors import InputError, NoInputError
from modalcam.names import natural_key, recording_names, shown

VIDEO_SUFFIXES = (".avi", ".cine", ".gif", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm", ".wmv")
MAX_DEPTH = 4
MAX_FILES = 10_000


@dataclass(frozen=True)
class Found:
    """A recording on disk: its name in OUT, its path relative to the folder, its absolute path."""

    name: str
    file: str
    path: Path


@dataclass(frozen=True)
class Discovery:
    """Recordings found, and what was passed over (full sentences)."""

    recordings: tuple[Found, ...]
    notes: tuple[str, ...]


def discover(folder: Path, *, exclude: Path | None = None, follow_symlinks: bool = False) -> Discovery:
    """Recordings below `folder`, not deeper than four levels, leaving out the folder `exclude`.

    Links are passed over unless `follow_symlinks`; hidden folders, and anything that is no regular file, always.

    Raises
    ------
    InputError
        If `folder` is no readable folder, or holds more than 10 000 recordings.
    NoInputError
        If no recording is found; the text lists the endings looked for.
    """
    if not folder.exists():
        msg = f"{shown(str(folder))}: no such folder; give the folder that holds the recordings"
        raise InputError(msg)
    if not folder.is_dir():
        msg = f"{shown(str(folder))}: expected a folder of recordings, found a file; give the folder it is in"
        raise InputError(msg)
    files: list[str] = []
    notes: list[str] = []
    others: set[str] = set()
    try:
        _walk(folder, "", 0, exclude, follow_symlinks, files, notes, others)
    except OSError as error:
        msg = f"{shown(str(error.filename))}: cannot be read ({error.strerror})"
        raise InputError(msg) from error
    if not files:
        seen = f"; found only {', '.join(sorted(others))}" if others else "; it holds no files"
        hint = f" ({' '.join(notes)})" if notes else ""
        msg = (
            f"{shown(str(folder))}: no recordings, expected files ending in "
            f"{', '.join(VIDEO_SUFFIXES)}{seen}{hint}"
        )
        raise NoInputError(msg)
    files.sort(key=natural_key)
    names = recording_names(files)
    found = tuple(Found(n, f, folder.resolve() / f) for n, f in zip(names, files, strict=True))
    return Discovery(found, tuple(notes))


def _walk(
    folder: Path,
    prefix: str,
    depth: int,
    exclude: Path | None,
    follow: bool,  # noqa: FBT001 - private
    files: list[str],
    notes: list[str],
    others: set[str],
) -> None:
    with os.scandir(folder) as entries:
        listed = sorted(entries, key=lambda entry: natural_key(entry.name))
    for entry in listed:
        relative = prefix + entry.name
        suffix = Path(entry.name).suffix.lower()
        if entry.is_symlink() and not follow:
            if suffix in VIDEO_SUFFIXES:
                notes.append(f"{shown(relative)} is a link and was passed over (--follow-symlinks uses it).")
        elif entry.is_dir():
            own_output = exclude is not None and Path(entry.path).resolve() == exclude.resolve()
            if depth < MAX_DEPTH and not entry.name.startswith(".") and not own_output:
                _walk(Path(entry.path), relative + "/", depth + 1, exclude, follow, files, notes, others)
        elif suffix in VIDEO_SUFFIXES:
            if entry.is_file():
                files.append(relative)
            else:
                notes.append(f"{shown(relative)} is no regular file and was passed over.")
        elif not entry.name.startswith("."):
            others.add(suffix or "files without ending")
        if len(files) > MAX_FILES:
            msg = f"{shown(str(folder))}: more than {MAX_FILES} recordings; give a folder with fewer"
            raise InputError(msg)
