"""What the page shows of one recording: frames, and mode shapes in motion by the style sheet alone."""

from __future__ import annotations

import base64
from collections.abc import Collection
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode, ModeFlag, Segment
from modal_id.modes import mpc
from modalcam.pipeline import Cache, RecordingResult
from modalcam.report.figures import MOST_POINTS, RecordingSubject, figures_of, shape_of
from modalcam.report.sections.alerts import anchor_of, flag_counts
from modalcam.report.sections.section import SECTIONS, added_sections
from modalcam.report.signals import main_modes, nrmse_of_fit, shown_mode
from modalcam.report.style import figure_label, mode_name, sentence
from sim.beam import BeamModes
from sim.comparison import DecayComparison
from sim.damping import DAMPING_MODELS
from tracker import DUPLICATE_FRAME, FailedTracking, Failure, FloatArray, FrameStrip, MarkerTracks, Severity

_LONGEST_SIDE_PX = 420
MOST_CANDIDATES = 60
# Of more markers, such as the stations of a line, the first, the last and a few between them are named.
_MOST_NAMES, _NAMED = 30, 6
# Most that a letter of a name takes, in units of `Frame.unit`.
_LETTER = 11.0


class Mark(NamedTuple):
    """A marker in an image: position, name, whether it is a reference, and the side of its name (1 is right).

    The name is empty where it is not shown, and stands beside the image where it would cross its right edge.
    """

    x: float
    y: float
    name: str
    reference: bool
    side: int = 1
    beside: bool = False


class Frame(NamedTuple):
    """The first frame as a data URI; `tracked` is False where the marks are candidates."""

    data_uri: str
    width: int
    height: int
    marks: tuple[Mark, ...]
    tracked: bool

    @property
    def radius(self) -> float:
        """Of the circles in units: smaller where they would cover each other."""
        return 7.0 if len(self.marks) <= _MOST_NAMES else 2.0

    @property
    def drawn_width(self) -> float:
        """Width including the names next to the image."""
        named = (mark for mark in self.marks if mark.beside)
        ends = [self.width + self.unit * (4.0 + _LETTER * len(mark.name)) for mark in named]
        return round(max([float(self.width), *ends]), 1)

    @property
    def unit(self) -> float:
        """Length in frame pixels that is drawn about one pixel wide."""
        return _unit(self.width, self.height)


class StripFrame(NamedTuple):
    """One image of a strip, the lines above it, and the fitted centres in it."""

    data_uri: str
    lines: tuple[str, ...]
    centres: tuple[Mark, ...]


class Strip(NamedTuple):
    """Frames side by side; lengths in pixels of the reduced images."""

    frames: tuple[StripFrame, ...]
    image_width: int
    image_height: int

    @property
    def arm(self) -> int:
        """Half the width of the crosses: smaller where they would cover each other."""
        return 5 if all(len(frame.centres) <= _MOST_NAMES for frame in self.frames) else 1


def first_frame(tracks: MarkerTracks | FailedTracking) -> Frame | None:
    """The first frame with the markers, or the candidates of a failed tracking; None without a frame."""
    frame = tracks.first_frame
    if frame is None or frame.size == 0 or frame.ndim != 2:
        return None
    height, width = frame.shape
    marks = []
    if isinstance(tracks, MarkerTracks):
        for k, name in enumerate(tracks.markers):
            seen = np.flatnonzero(np.isfinite(tracks.x_px[:, k] + tracks.y_px[:, k]))
            for row in seen[:1]:
                label, reference = figure_label(name, limit=12), name in tracks.reference
                marks.append(Mark(tracks.x_px[row, k], tracks.y_px[row, k], label, reference))
    elif tracks.seen_px is not None:
        candidates = enumerate(tracks.seen_px[:MOST_CANDIDATES], 1)
        marks = [Mark(x, y, str(k), reference=False) for k, (x, y) in candidates if np.isfinite(x + y)]
    named = named_among(len(marks)) if isinstance(tracks, MarkerTracks) else range(len(marks))
    wide = width > 0.5 * height

    def crosses(mark: Mark) -> bool:
        return bool(mark.x + (18.0 + _LETTER * len(mark.name)) * _unit(width, height) > width)

    placed = tuple(
        mark._replace(
            x=round(float(mark.x), 1),
            y=round(float(mark.y), 1),
            name=mark.name if k in named else "",
            side=-1 if wide and (mark.x > 0.75 * width or crosses(mark)) else 1,
            beside=k in named and not wide and crosses(mark),
        )
        for k, mark in enumerate(marks)
    )
    shrink = _LONGEST_SIDE_PX / max(height, width)
    if shrink < 1.0:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Frame(_jpeg(frame), width, height, placed, isinstance(tracks, MarkerTracks))


def _unit(width: int, height: int) -> float:
    return max(width, height) / _LONGEST_SIDE_PX


def named_among(count: int) -> Collection[int]:
    """Which of a number of markers are named: all, or a few that are evenly spread."""
    if count <= _MOST_NAMES:
        return range(count)
    return set(np.linspace(0, count - 1, _NAMED).round().astype(int).tolist())


def strip(tracks: MarkerTracks, onset_s: float | None) -> Strip | None:
    """Start, onset, largest displacement and end of a recording; None when no frames were kept."""
    kept = tracks.strip
    if kept is None or kept.frame.size == 0 or kept.images.ndim != 3:
        return None
    picks = sorted(_picks(tracks, kept, onset_s).items())
    height, width = kept.images.shape[1:]
    return Strip(tuple(_strip_frame(tracks, kept, index, names) for index, names in picks), width, height)


def _picks(tracks: MarkerTracks, kept: FrameStrip, onset_s: float | None) -> dict[int, list[str]]:
    """Indices of the frames shown with their names; a frame can have several."""
    time_s = tracks.time_s[kept.frame]
    named: dict[int, list[str]] = {0: ["start"]}
    if onset_s is not None and np.isfinite(onset_s):
        named.setdefault(int(np.argmin(np.abs(time_s - onset_s))), []).append("near the onset")
    moved = np.hypot(tracks.x_px - tracks.x_px[0], tracks.y_px - tracks.y_px[0])[kept.frame]
    if np.isfinite(moved).any():
        named.setdefault(int(np.nanargmax(np.fmax.reduce(moved, axis=1))), []).append("largest motion")
    named.setdefault(kept.frame.size - 1, []).append("end")
    return named


def _strip_frame(tracks: MarkerTracks, kept: FrameStrip, index: int, names: list[str]) -> StripFrame:
    row = int(kept.frame[index])
    # Reducing keeps areas: the edge of the image stays in place, not the centre of its first pixel.
    centres = tuple(
        Mark(
            round((x + 0.5) / kept.shrink, 2),
            round((y + 0.5) / kept.shrink, 2),
            name,
            name in tracks.reference,
        )
        for name, x, y in zip(
            tracks.markers, tracks.x_px[row].tolist(), tracks.y_px[row].tolist(), strict=True
        )
        if np.isfinite(x + y)
    )
    lines = (*names, f"{tracks.time_s[row]:.4g} s, frame {row}")
    return StripFrame(_jpeg(kept.images[index]), lines, centres)


def _jpeg(frame: NDArray[np.uint8]) -> str:
    # Camera noise makes PNG ten times as large without a visible gain.
    return data_uri("jpeg", np.ascontiguousarray(frame), [cv2.IMWRITE_JPEG_QUALITY, 82])


def data_uri(kind: str, image: NDArray[np.uint8], options: list[int]) -> str:
    """An image as a data URI, coded as `kind`, such as "jpeg", with options of OpenCV; ValueError if it cannot be."""
    done, coded = cv2.imencode(f".{kind}", image, options)
    if not done:
        msg = f"an image of shape {image.shape} could not be coded as {kind}"
        raise ValueError(msg)
    return f"data:image/{kind};base64," + base64.b64encode(coded.tobytes()).decode("ascii")


# Length of the beam and largest amplitude, in the units of the drawing.
LENGTH, AMPLITUDE = 200.0, 28.0


class MovingShape(NamedTuple):
    """A mode shape at one extreme: y is down, the beam at rest lies on y = 0 from the clamp at x = 0.

    `points` are the markers; of many, such as the stations of a line, `measured` is the path instead. Paths are empty
    where there is none.
    """

    points: tuple[tuple[float, float], ...]
    measured: str
    theory: str


def moving_shape(subject: RecordingSubject) -> MovingShape | None:
    """Shape of the mode shown, its component in phase; None where it has no shape."""
    shown = shape_of(subject)
    if shown is None:
        return None
    at, real = shown.position_mm, shown.shape.real
    theory_at, theory = (np.empty(0), np.empty(0)) if shown.curve is None else shown.curve
    longest = float(np.max(np.concatenate((at, theory_at))))
    largest = float(np.max(np.abs(np.concatenate((real, theory)))))
    if not (longest > 0.0 and largest > 0.0):
        return None
    x, y = LENGTH * at / longest, -AMPLITUDE * real / largest
    many = at.size > MOST_POINTS
    return MovingShape(
        points=()
        if many
        else tuple((round(float(a), 1), round(float(b), 1)) for a, b in zip(x, y, strict=True)),
        measured=_path(x, y) if many else "",
        theory=_path(LENGTH * theory_at[::3] / longest, -AMPLITUDE * theory[::3] / largest),
    )


def _path(x: FloatArray, y: FloatArray) -> str:
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True)) if x.size else ""


_MIN_CHANNELS = 3


class Detail(NamedTuple):
    """Level of detail for each recording, reduced for many recordings so that a browser can open the page."""

    strips: int
    diagnostics: bool
    figures: bool


def detail_for(recordings: int) -> Detail:
    """Full detail for up to 12 recordings, essential figures for up to 40, none for more."""
    if recordings <= 12:
        return Detail(strips=8, diagnostics=True, figures=True)
    return Detail(strips=2, diagnostics=False, figures=recordings <= 40)


def recording_view(
    index: int,
    recording: RecordingResult,
    theory: BeamModes | None,
    detail: Detail,
    cache: Cache | None = None,
) -> dict[str, Any]:
    """Variables of the template ``recording.html.j2``; parts that do not exist are None or empty.

    `theory` holds the beam's modes to compare shapes with.
    """
    anchor = anchor_of(index)
    subject = RecordingSubject(recording, theory, detail.strips)
    figures = partial(
        figures_of, subject=subject, prefix=anchor, only_essential=not detail.diagnostics, cache=cache
    )
    found = recording.identified
    mode = None if found is None else shown_mode(found)
    main = [] if found is None else main_modes(found)
    segments = [] if found is None else _segments(found)
    told = {note for _, note in segments} if len(segments) > 1 else set()
    tracks = recording.tracks if isinstance(recording.tracks, MarkerTracks) else None
    timed = tracks or recording.series if found is None or tracks else found.series
    time_s = None if timed is None else timed.time_s
    onset_s = None if found is None else found.onset.time_s
    listed = [] if tracks is None else named_among(len(tracks.markers))
    markers = (
        [] if tracks is None else [_marker(tracks, k, shown=k in listed) for k in range(len(tracks.markers))]
    )
    return {
        "anchor": anchor,
        "recording": recording,
        "found": found,
        "mode": mode,
        "main": main,
        "participations": [] if found is None else _participations(found),
        "informing": {flag for m in main for flag in m.flags if m.severity_of(flag) is Severity.INFORMATION},
        "others": [] if found is None else [m for m in found.modes if m not in main],
        "tracks": tracks,
        "comparison": recording.comparison if mode and recording.comparison else None,
        "floor": None if found is None else nrmse_of_fit(found),
        "state": _state(recording, mode),
        "segments": segments,
        "notes": [note for note in _notes(recording) if note not in told],
        "figures": list(figures("recording")) if detail.figures else [],
        "checks": found.checks if found is not None and detail.figures else (),
        "mpc": _collinearity(found, mode) if found and mode and detail.figures else float("nan"),
        "time_s": time_s,
        # Shortest, median and longest step.
        "steps": None if time_s is None or time_s.size < 2 else np.quantile(np.diff(time_s), (0.0, 0.5, 1.0)),
        "repeated": 0 if tracks is None else int((tracks.flags & DUPLICATE_FRAME.value).any(axis=1).sum()),
        "markers": markers,
        "information": _information(markers),
        "frame": None if recording.tracks is None else first_frame(recording.tracks),
        "strip": strip(tracks, onset_s) if tracks and detail.diagnostics else None,
        "tracking_figures": list(figures("tracking")) if detail.figures else [],
        "moving": moving_shape(subject) if detail.figures else None,
        "sections": added_sections(recording, cache) if detail.diagnostics else [],
    }


def _participations(found: Identification) -> list[tuple[IdentifiedMode, str, float, float]]:
    """Each mode that a measured input drives, with the channel of the largest participation, its value and sd."""
    rows = []
    for mode in found.modes:
        if mode.participation is not None and mode.participation_sd is not None:
            k = int(np.nanargmax(np.abs(mode.participation)))
            rows.append(
                (
                    mode,
                    found.series.channels[k],
                    float(mode.participation[k]),
                    float(mode.participation_sd[k]),
                )
            )
    return rows


def _segments(found: Identification) -> list[tuple[Segment, str]]:
    """Parts of the record, each with its note unless an earlier part has the same."""
    out: list[tuple[Segment, str]] = []
    for segment in found.segments:
        note = sentence(segment.note)
        out.append((segment, "" if any(note == earlier for _, earlier in out) else note))
    return out


def _state(recording: RecordingResult, mode: IdentifiedMode | None) -> str:
    """Quality of a recording's result: "good", "care" or "failed"."""
    if recording.identified is not None and recording.identified.driven:
        return "care"
    if recording.failure or mode is None:
        return "failed"
    concerns = any(mode.severity_of(flag) is not Severity.INFORMATION for flag in mode.flags)
    return "care" if concerns or (recording.mode is not None and not mode.target) else "good"


def _collinearity(found: Identification, mode: IdentifiedMode) -> float:
    enough = int(found.channels_used.sum()) >= _MIN_CHANNELS
    return mpc(mode.shape[found.channels_used]) if enough else float("nan")


def _marker(tracks: MarkerTracks, k: int, *, shown: bool) -> dict[str, Any]:
    """One marker: frames in which it was found, median sd, number of frames with each flag, and if it is listed."""
    sd_x, sd_y = (
        float(np.median(good)) if (good := sd[np.isfinite(sd)]).size else float("nan")
        for sd in (tracks.sd_x_px[:, k], tracks.sd_y_px[:, k])
    )
    counts = flag_counts(tracks, k)
    return {
        "name": tracks.markers[k],
        "shown": shown,
        "position_mm": float(tracks.positions_mm[k]),
        "found": int(np.count_nonzero(np.isfinite(tracks.x_px[:, k] + tracks.y_px[:, k]))),
        "sd_x_px": sd_x,
        "sd_y_px": sd_y,
        "sd_mm": np.hypot(sd_x, sd_y) / np.sqrt(2.0) * (tracks.scale.mm_per_px if tracks.scale else np.nan),
        "flags": [(name, n) for name, n, severity in counts if severity is not Severity.INFORMATION],
        "information": [(name, n) for name, n, severity in counts if severity is Severity.INFORMATION],
    }


def _information(markers: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """Flags that the standard deviations account for, with their number over all markers and frames."""
    total: dict[str, int] = {}
    for marker in markers:
        for name, frames in marker["information"]:
            total[name] = total.get(name, 0) + frames
    return list(total.items())


def _notes(recording: RecordingResult) -> list[str]:
    """Notes of all stages, each once."""
    notes: list[str] = []
    found, comparison = recording.identified, recording.comparison
    if found is not None:
        # The legend explains the flags.
        flags = {flag.value for flag in ModeFlag}
        notes += [found.onset.note, *found.notes]
        for mode in found.modes:
            notes += [f"{mode_name(mode)}: {sentence(note)}" for note in mode.notes if note not in flags]
    if recording.series is not None:
        notes += recording.series.notes
    if isinstance(comparison, DecayComparison):
        notes += comparison.notes
        notes += [f"{DAMPING_MODELS[d.model].label}: {sentence(d.note)}" for d in comparison.models if d.note]
    if isinstance(comparison, Failure):
        notes.append(f"The decay was not simulated: {sentence(comparison.reason)}")
    for section in SECTIONS.values():
        notes += () if section.notes is None else section.notes(recording)
    return list(dict.fromkeys(sentence(note) for note in notes if note))
