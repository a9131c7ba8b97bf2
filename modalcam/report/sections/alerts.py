"""Conditions that may make results wrong; the report lists them before the results."""

from __future__ import annotations

from collections.abc import Callable

from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.style.format import mode_name, significant
from tracker.results import MarkerTracks
from tracker.severity import Severity

R_HAT_LIMIT = 1.05
# Severities of the flags listed before the results, and the most modes named with each flag.
_SHOWN = (Severity.WRONG, Severity.INTERVAL)
_MOST = 6
_INTRA_ONLY = ("mjpeg", "jpeg2000", "prores", "dnxhd")


def alerts(result: RunResult) -> dict[str, list[tuple[str, str]]]:
    """Recordings concerned by each kind of warning, as anchor and file; the most serious kind first."""
    kinds: dict[str, Callable[[RecordingResult], bool]] = {
        "playback": lambda r: _tracked(r, lambda tracks: tracks.time_axis.is_playback_guess),
        "failed": lambda r: bool(r.failure),
        "damaged": lambda r: _tracked(r, lambda tracks: tracks.decode.frames_corrupt > 0),
        # Errors of frames coded one by one are little above the noise; those of predicted frames follow the motion.
        "lossy": lambda r: _tracked(
            r, lambda tracks: tracks.decode.lossy and tracks.decode.codec not in _INTRA_ONLY
        ),
        "sampler": _not_converged,
    }
    found = {
        kind: [(anchor_of(i), r.file) for i, r in enumerate(result.recordings) if holds(r)]
        for kind, holds in kinds.items()
    }
    found |= {severity.name.lower(): _flagged(result, severity) for severity in _SHOWN}
    return {kind: recordings for kind, recordings in found.items() if recordings}


def _flagged(result: RunResult, severity: Severity) -> list[tuple[str, str]]:
    """Anchor and text of each flag of this severity: its name and the modes that have it."""
    lines: dict[str, tuple[str, list[str]]] = {}
    for i, recording in enumerate(result.recordings):
        found = recording.identified
        modes = [(mode, mode_name(mode)) for mode in found.modes] if found else []
        driven = [(line, f"{significant(line.frequency_hz, 4)} Hz") for line in found.driven] if found else []
        for flagged, name in [*modes, *driven]:
            for flag in flagged.flags:
                if flagged.severity_of(flag) is severity:
                    lines.setdefault(flag, (anchor_of(i), []))[1].append(f"{recording.name}, {name}")
    return [
        (
            anchor,
            f"{flag}: {'; '.join(modes[:_MOST])}{f' and {len(modes) - _MOST} more' if len(modes) > _MOST else ''}",
        )
        for flag, (anchor, modes) in lines.items()
    ]


def anchor_of(index: int) -> str:
    """Anchor of the section of the recording at `index`, 0 first."""
    return f"r{index + 1}"


def _tracked(recording: RecordingResult, holds: Callable[[MarkerTracks], bool]) -> bool:
    return isinstance(recording.tracks, MarkerTracks) and holds(recording.tracks)


def _not_converged(recording: RecordingResult) -> bool:
    found = recording.identified
    # A NaN is not above the limit.
    return found is not None and any(r > R_HAT_LIMIT for m in found.modes for r in m.posterior.r_hat)
