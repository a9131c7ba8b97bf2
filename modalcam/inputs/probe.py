"""Properties of recordings, without tracking them, and a commented `experiment.toml` for them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

from modalcam.common import InputError, shown
from modalcam.config import (
    CONFIG_NAME,
    ExperimentConfig,
    RecordingConfig,
    commented_toml,
    load_config,
    toml_value,
    tracker_settings,
)
from modalcam.inputs.folder import Found, discover
from tracker import Failure
from tracker.video import ProbeReport, UnreadableVideoError, probe

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
