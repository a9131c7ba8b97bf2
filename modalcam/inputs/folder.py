"""Find the recordings of a folder: regular files with a known ending, and folders of numbered images."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from typing import Any

from modalcam.common import InputError, NoInputError, natural_key, real, recording_names, shown
from modalcam.pipeline import file_sha256
from tracker.video import (
    HEADER_SUFFIXES,
    IMAGE_SUFFIXES,
    PIXEL_SUFFIX,
    TIFF_SUFFIXES,
    ImageSeries,
    image_series,
    is_stack,
    recording_suffixes,
)

MAX_DEPTH = 4
MAX_FILES = 10_000
# More recordings than this are counted, not named.
_MOST_NAMES = 6


@dataclass(frozen=True)
class Found:
    """A recording on disk, a file or a folder of numbered images: name in OUT, relative path, absolute path."""

    name: str
    file: str
    path: Path


@dataclass(frozen=True)
class Discovery:
    """Recordings found, a sentence for each file that was skipped, and places that cannot be read, with the reason."""

    recordings: tuple[Found, ...]
    notes: tuple[str, ...]
    unreadable: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Selection:
    """Which recordings of a folder are wanted: those that match one of `include`, if any, and none of `exclude`.

    A pattern with ``*``, ``?`` or ``[...]`` is compared with the path relative to the folder and with the name alone.
    """

    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def takes(self, file: str) -> bool:
        """Whether the recording with this relative path is wanted."""
        return (not self.include or _matches(file, self.include)) and not _matches(file, self.exclude)

    def of(self, found: Discovery) -> Discovery:
        """The wanted recordings, with a note on the others; InputError without any."""
        wanted = tuple(one for one in found.recordings if self.takes(one.file))
        others = [one.file for one in found.recordings if not self.takes(one.file)]
        if not wanted:
            msg = f"--include and --exclude leave out every recording of the folder: {_names(others)}"
            raise InputError(msg)
        if not others:
            return found
        notes = (*found.notes, f"Left out by --include and --exclude: {_names(others)}.")
        unreadable = tuple(one for one in found.unreadable if self.takes(one[0]))
        return replace(found, recordings=wanted, notes=notes, unreadable=unreadable)


def _matches(file: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(text, p) for p in patterns for text in (file, PurePath(file).name))


def _names(files: list[str]) -> str:
    named = ", ".join(shown(file) for file in files[:_MOST_NAMES])
    return named if len(files) <= _MOST_NAMES else f"{named} and {len(files) - _MOST_NAMES} more"


@dataclass
class _Walk:
    """State of the search: what to skip, and what was found so far."""

    root: Path
    exclude: Path | None
    follow_symlinks: bool
    suffixes: tuple[str, ...]
    files: list[str] = field(default_factory=list)
    folders: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unreadable: list[tuple[str, str]] = field(default_factory=list)
    others: set[str] = field(default_factory=set)


def discover(folder: Path, *, exclude: Path | None = None, follow_symlinks: bool = False) -> Discovery:
    """Recordings below `folder`, at most four levels deep, without the folder `exclude`.

    A folder without videos but with ten or more images numbered in one series is one recording, named after the
    folder; a TIFF of several pages is a recording by itself. The header of a Photron camera represents its `.mraw`; it
    is not a recording if it belongs to a video or to images. Symbolic links are skipped unless `follow_symlinks` is
    set; hidden folders and irregular files are always skipped.

    InputError if `folder` is not a readable folder or holds more than 10 000 recordings; NoInputError if it holds none.
    """
    if not folder.exists():
        msg = f"{shown(str(folder))}: no such folder; give the folder that holds the recordings"
        raise InputError(msg)
    if not folder.is_dir():
        msg = f"{shown(str(folder))}: expected a folder of recordings, found a file; give the folder it is in"
        raise InputError(msg)
    walk = _Walk(folder, exclude, follow_symlinks, recording_suffixes())
    try:
        _walk(folder, "", 0, walk)
    except OSError as error:
        msg = f"{shown(str(error.filename))}: cannot be read ({error.strerror})"
        raise InputError(msg) from error
    if not walk.files and not walk.folders:
        seen = "; it holds no files"
        if walk.others:
            seen = (
                f"; found only {', '.join(sorted(walk.others))} (a table of motion is for modalcam identify)"
            )
        problems = [*walk.notes, *(f"{shown(place)}: {reason}" for place, reason in walk.unreadable)]
        hint = f" ({' '.join(problems)})" if problems else ""
        msg = (
            f"{shown(str(folder))}: no recordings, expected files ending in "
            f"{', '.join(walk.suffixes)}, TIFF stacks or folders of numbered images{seen}{hint}"
        )
        raise NoInputError(msg)
    return Discovery(_named(folder, walk), tuple(walk.notes), tuple(walk.unreadable))


def _named(folder: Path, walk: _Walk) -> tuple[Found, ...]:
    """Recordings in natural order with their names."""
    root = folder.resolve()
    found = {file: (file, root / file) for file in walk.files}
    for relative in walk.folders:
        called = relative or (root.name if root.name not in walk.folders else ".")
        # The name of a folder has no ending; this one is removed in its place.
        found[f"{called}.images"] = (called, root / relative)
    keys = sorted(found, key=lambda key: natural_key(found[key][0]))
    names = recording_names(keys)
    return tuple(Found(name, *found[key]) for name, key in zip(names, keys, strict=True))


def _walk(folder: Path, prefix: str, depth: int, walk: _Walk) -> None:
    with os.scandir(folder) as entries:
        listed = sorted(entries, key=lambda entry: natural_key(entry.name))
    names: list[str] = []
    for entry in listed:
        relative = prefix + entry.name
        if entry.is_symlink() and not walk.follow_symlinks:
            if Path(entry.name).suffix.lower() in walk.suffixes:
                walk.notes.append(
                    f"{shown(relative)} is a symbolic link and was skipped (--follow-symlinks reads it)."
                )
            continue
        try:
            _enter(entry, relative, depth, walk, names)
        except OSError as error:
            walk.unreadable.append((relative, f"cannot be read ({error.strerror}); check the permissions"))
    _sort(folder, prefix, names, walk)
    if len(walk.files) + len(walk.folders) > MAX_FILES:
        msg = f"{shown(str(walk.root))}: more than {MAX_FILES} recordings; give a folder with fewer"
        raise InputError(msg)


def _enter(entry: os.DirEntry[str], relative: str, depth: int, walk: _Walk, names: list[str]) -> None:
    """Walk a folder, or append the name of a file that may be part of a recording to `names`."""
    suffix = Path(entry.name).suffix.lower()
    known = suffix in (*walk.suffixes, PIXEL_SUFFIX, *IMAGE_SUFFIXES)
    if entry.is_dir():
        own_output = walk.exclude is not None and real(Path(entry.path)) == real(walk.exclude)
        if depth < MAX_DEPTH and not entry.name.startswith(".") and not own_output:
            _walk(Path(entry.path), relative + "/", depth + 1, walk)
        return
    if known and entry.is_file():
        names.append(entry.name)
    elif suffix in walk.suffixes:
        walk.notes.append(f"{shown(relative)} is not a regular file and was skipped.")
    if not known and not entry.name.startswith("."):
        walk.others.add(suffix or "files without ending")


def _sort(folder: Path, prefix: str, names: list[str], walk: _Walk) -> None:
    """Sort the files of one folder into recordings and files that belong to them."""
    suffixes = {name: Path(name).suffix.lower() for name in names}
    pixels = {Path(name).stem for name in names if suffixes[name] == PIXEL_SUFFIX}
    videos = [n for n in names if suffixes[n] in recording_suffixes() and suffixes[n] not in HEADER_SUFFIXES]
    series = image_series(names)
    stacks = _stacks(folder, [n for n in names if suffixes[n] in TIFF_SUFFIXES], series)
    if stacks:
        series = tuple(s for s in series if s.files[0][1] not in stacks)
    recordings = [*videos, *stacks]
    # A header represents its pixels, or belongs to a video of its name or to the images; otherwise it is listed alone.
    timed = {Path(name).stem for name in recordings}
    headers = {
        Path(n).stem: n for suffix in reversed(HEADER_SUFFIXES) for n in names if suffixes[n] == suffix
    }
    alone = [n for stem, n in headers.items() if stem in pixels or not (stem in timed or series)]
    recordings += alone
    walk.notes.extend(
        f"{shown(prefix + name)} holds raw pixels, but its header (.cih or .cihx of the same name) is missing."
        for name in names
        if suffixes[name] == PIXEL_SUFFIX and Path(name).stem not in headers
    )
    walk.files.extend(prefix + name for name in recordings)
    if series and not recordings:
        walk.folders.append(prefix.removesuffix("/"))
    elif series:
        walk.notes.append(
            f"{shown(prefix + series[0].files[0][1])} and the following images are in a folder with recordings and "
            "were skipped; move them into a folder of their own to use them as a recording."
        )
    elif not recordings:
        walk.others.update(s for s in suffixes.values() if s in IMAGE_SUFFIXES)


def _stacks(folder: Path, tiffs: list[str], series: tuple[ImageSeries, ...]) -> list[str]:
    """TIFFs of several pages; the first file of a numbered series decides for the series."""
    single: set[str] = set()
    for one in series:
        members = [name for _, name in one.files]
        if members[0] in tiffs and not is_stack(folder / members[0]):
            single.update(members)
    return [name for name in tiffs if name not in single and is_stack(folder / name)]


def hashes_of_inputs(folder: Path, raw: Mapping[str, Any]) -> list[str]:
    """SHA-256 of each `input_file` of a configuration that is not validated; empty where there is no such file."""
    entries = raw.get("recordings", ())
    named = [one for one in entries if isinstance(one, dict)] if isinstance(entries, list) else []
    paths = [
        folder / Path(str(one["file"])).parent / str(one["input_file"])
        for one in named
        if "file" in one and "input_file" in one
    ]
    return [file_sha256(path) if path.is_file() else "" for path in paths]
