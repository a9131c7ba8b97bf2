"""Find the recordings of a folder: regular files with a known ending, and folders of numbered images.

Properties of recordings, without tracking them, and a commented `experiment.toml` for them.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from textwrap import wrap
from typing import Any, Protocol

from modalcam.common import InputError, NoInputError, natural_key, real, recording_names, shown
from modalcam.config import (
    CONFIG_NAME,
    ExperimentConfig,
    RecordingConfig,
    commented_toml,
    load_config,
    toml_value,
    tracker_settings,
)
from tracker.video import (
    HEADER_SUFFIXES,
    IMAGE_SUFFIXES,
    PIXEL_SUFFIX,
    TIFF_SUFFIXES,
    ImageSeries,
    ProbeReport,
    UnreadableVideoError,
    image_series,
    is_stack,
    probe,
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
        seen = f"; found only {', '.join(sorted(walk.others))}" if walk.others else "; it holds no files"
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


# Lengths of time steps that are listed; the others are counted.
_STEPS_SHOWN = 3
_CANDIDATES_SHOWN = 8
# Begins the note on a recording without a recorded rate.
RATE_UNKNOWN = "the recorded rate is unknown"


@dataclass(frozen=True)
class SeenMarker:
    """A marker in the first frames; `code` is the dictionary and the number of a code, empty for other kinds.

    Its centre is that in `frame`: the first, unless it was found only later.
    """

    name: str
    x_px: float
    y_px: float
    size_px: float
    code: str = ""
    frame: int = 0


@dataclass(frozen=True)
class SeenMarkers:
    """Markers that a run would follow, of the kind configured or, without one, of the first that is detected.

    Attributes
    ----------
    kind : str
        Empty where none was detected, for the `reason`.
    markers : tuple of SeenMarker
        In order along the beam where that is known; empty for a line, whose ends are in the notes.
    notes : tuple of str
        How they were chosen, and what was taken for a marker and rejected.
    candidates_px : tuple of (x, y)
        What looks like a marker where none was detected, or not the expected number.
    """

    kind: str = ""
    markers: tuple[SeenMarker, ...] = ()
    reason: str = ""
    notes: tuple[str, ...] = ()
    candidates_px: tuple[tuple[float, float], ...] = ()

    def sentences(self) -> tuple[str, ...]:
        """The same for people: what there is and where, then the notes."""
        if not self.kind:
            at = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in self.candidates_px[:_CANDIDATES_SHOWN])
            more = len(self.candidates_px) - _CANDIDATES_SHOWN
            seen = f"; candidates at {at} px{f' and {more} others' if more > 0 else ''}" if at else ""
            return (
                f"no markers: {self.reason}{seen}; set points or a line with `modalcam pick`",
                *self.notes,
            )
        if not self.markers:
            return (f"a {self.kind}", *self.notes)
        listed = ", ".join(
            f"{m.name} ({m.x_px:.0f}, {m.y_px:.0f}{f' in frame {m.frame}' if m.frame else ''})"
            for m in self.markers
        )
        numbers: dict[str, list[str]] = {}
        for dictionary, _, number in (m.code.rpartition(" ") for m in self.markers if m.code):
            numbers.setdefault(dictionary, []).append(number)
        codes = "".join(f", {dictionary} {', '.join(of)}" for dictionary, of in numbers.items())
        size = sum(m.size_px for m in self.markers) / len(self.markers)
        what = f"{len(self.markers)} marker{'' if len(self.markers) == 1 else 's'} of kind {self.kind}{codes}"
        return (f"{what}, of {size:.0f} px, at x, y: {listed}", *self.notes)


@dataclass(frozen=True)
class Probe:
    """Properties of one recording; `problem` is empty if it can be read."""

    file: str
    codec: str = ""
    size_px: str = ""
    bit_depth: int = 0
    frames_declared: int = 0
    packets: int = 0
    fps_container: float | None = None
    fps_recorded: float | None = None
    nyquist_hz: float | None = None
    time_steps: str = ""
    problem: str = ""
    notes: tuple[str, ...] = ()
    seen: SeenMarkers | None = None


class Failure(Protocol):
    """A call that gave no result; falsy."""

    @property
    def reason(self) -> str:
        """Why."""


# Calls a function with each task, for instance in other processes.
Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


def probe_folder(target: Path, *, follow_symlinks: bool, each: Each = map) -> tuple[Probe, ...]:
    """Probe one file, or every recording of a folder; InputError or NoInputError if there is none.

    `each` calls a function with each of some tasks; where it gives a `Failure`, that is the recording's problem. A
    place in the folder that cannot be read is listed with its problem.
    """
    if target.is_file():
        alone = Found(target.stem, target.name, target.absolute())
        return probe_recordings([alone], ExperimentConfig(), each)
    if not target.exists():
        msg = f"{shown(str(target))}: no such file or folder"
        raise InputError(msg)
    config_path = target / CONFIG_NAME
    config = load_config(config_path) if config_path.exists() else ExperimentConfig()
    found = discover(target, follow_symlinks=follow_symlinks)
    places = (Probe(place, problem=reason) for place, reason in found.unreadable)
    return (*probe_recordings(found.recordings, config, each), *places)


def probe_recordings(
    recordings: Sequence[Found], config: ExperimentConfig, each: Each = map
) -> tuple[Probe, ...]:
    """Probe these recordings, with the rates of a configuration; `each` is that of `probe_folder`."""
    tasks = [(recording, config) for recording in recordings]
    results: Iterable[Probe | Failure] = each(_probe, tasks)
    return tuple(
        result if isinstance(result, Probe) else Probe(found.file, problem=result.reason)
        for (found, _), result in zip(tasks, results, strict=True)
    )


def _probe(task: tuple[Found, ExperimentConfig]) -> Probe:
    found, config = task
    try:
        report = probe(found.path)
    except UnreadableVideoError as error:
        # The message of a reader starts with the file's name.
        return Probe(found.file, problem=str(error).removeprefix(f"{shown(found.path.name)}: "))
    info = report.info
    given = config.for_recording(found.file).fps
    fps, frame_rate = given or info.header_rate, given or info.frames_per_s
    notes = list(info.notes)
    if fps is None:
        which = (
            "the file has none" if info.container_rate is None else "the rate in the file is that of playback"
        )
        notes.append(f"{RATE_UNKNOWN}: {which}; give --fps or [camera] fps")
    if given is None and info.frame_step > 1:
        notes.append(f"the file holds one in {info.frame_step} of the recorded frames")
    if report.stamps_missing:
        notes.append(f"{report.stamps_missing} of {report.packets} frames have no time stamp")
    return Probe(
        file=found.file,
        codec=f"{info.codec} {info.pixel_format}",
        size_px=f"{info.width_px} x {info.height_px}",
        bit_depth=info.bit_depth,
        frames_declared=info.frames_declared,
        packets=report.packets,
        fps_container=None if info.container_rate is None else float(info.container_rate),
        fps_recorded=None if fps is None else float(fps),
        nyquist_hz=None if frame_rate is None else float(frame_rate) / 2.0,
        time_steps=_steps(report),
        problem="" if report.first_frame is not None else "no frame can be decoded",
        notes=tuple(notes),
        seen=None if report.first_frame is None else _seen(found.path, config.for_recording(found.file)),
    )


def _seen(path: Path, recording: RecordingConfig) -> SeenMarkers:
    # Workers only: readers and kernels take long to load.
    from tracker import find_markers  # noqa: PLC0415
    from tracker.markers import NothingFound  # noqa: PLC0415

    try:
        found = find_markers(path, tracker_settings(recording))
    except ValueError as error:
        return SeenMarkers(reason=f"the configuration cannot be used: {error}")
    except UnreadableVideoError as error:
        return SeenMarkers(reason=str(error))
    if isinstance(found, NothingFound):
        seen_px = () if found.seen_px is None else tuple((float(x), float(y)) for x, y in found.seen_px)
        rejected = tuple(f"Not taken for a marker: {text}." for text in found.rejected)
        return SeenMarkers(reason=found.reason, notes=rejected, candidates_px=seen_px)
    kind = found.joint.kind if found.joint is not None else found.detections[0].kind
    placed = ((d, *d.earliest()) for d in found.detections)
    markers = (SeenMarker(d.name, x, y, d.size_px, d.code, frame) for d, frame, x, y in placed)
    return SeenMarkers(kind.name, tuple(markers), notes=found.notes)


def _steps(report: ProbeReport) -> str:
    most = Counter(report.step_ticks).most_common(_STEPS_SHOWN)
    text = ", ".join(f"{ticks} ({count} times)" for ticks, count in most)
    rest = len(report.step_ticks) - _STEPS_SHOWN
    return f"{text} and {rest} others" if rest > 0 else text


def starter_config(folder: Path, *, each: Each = map) -> str:
    """Text of a configuration for the recordings of `folder`; InputError or NoInputError if it holds none.

    `each` is that of `probe_folder`.
    """
    return commented_toml() + "".join(map(_entry, probe_folder(folder, follow_symlinks=False, each=each)))


def _entry(p: Probe) -> str:
    if p.problem:
        return f"\n# {shown(p.file)}: {shown(' '.join(p.problem.split()))}\n"
    if not p.file.isprintable():
        return f"\n# {shown(p.file)}: rename the file to configure it; TOML cannot hold its name\n"
    rate = "unknown" if p.fps_container is None else f"{p.fps_container:g}"
    seen = "" if p.seen is None else "".join(f"# {one}\n" for one in _in_lines(p.seen.sentences()))
    return (
        f"\n# {p.packets} frames of {p.size_px} px, {p.bit_depth} bit, {p.codec}; frame rate in the file: {rate}\n"
        f"{seen}[[recordings]]\nfile = {toml_value(p.file)}\n#mode = 1\n#fps = 1000.0\n"
    )


def _in_lines(sentences: Iterable[str]) -> list[str]:
    """Lines of a comment, of printable text."""
    return [line for sentence in sentences for line in wrap(shown(" ".join(sentence.split())), 110)]
