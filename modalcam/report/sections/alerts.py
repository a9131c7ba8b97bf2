"""Conditions that may make results wrong; the report lists them before the results."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modal_id.results import DrivenMotion, IdentifiedMode
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.style.format import mode_name, percent, significant
from tracker.flags import REGISTRY
from tracker.results import MarkerTracks
from tracker.severity import Severity

R_HAT_LIMIT = 1.05
# Severities of the flags listed before the results, and the largest number of modes and markers named with each.
_SHOWN = (Severity.WRONG, Severity.INTERVAL)
_MOST = 6


def alerts(result: RunResult) -> dict[str, list[tuple[str, str]]]:
    """Anchor and text of each warning by its kind: recordings concerned, then flags in order of their severity."""
    kinds: dict[str, Callable[[RecordingResult], bool]] = {
        "playback": lambda r: _tracked(r, lambda tracks: tracks.time_axis.is_playback_guess),
        "failed": lambda r: bool(r.failure),
        "damaged": lambda r: _tracked(r, lambda tracks: tracks.decode.frames_corrupt > 0),
        # Errors of frames coded one by one are little above the noise; those of predicted frames follow the motion.
        "lossy": lambda r: _tracked(r, lambda tracks: tracks.decode.lossy and tracks.decode.predictive),
        "sampler": _not_converged,
    }
    found = {
        kind: [(anchor_of(i), r.file) for i, r in enumerate(result.recordings) if holds(r)]
        for kind, holds in kinds.items()
    }
    found |= {severity.name.lower(): _flagged(result, severity) for severity in _SHOWN}
    return {kind: recordings for kind, recordings in found.items() if recordings}


def _flagged(result: RunResult, severity: Severity) -> list[tuple[str, str]]:
    """Anchor and text of each flag of this severity: its name, and the modes and markers that have it."""
    lines: dict[str, tuple[str, list[str]]] = {}
    for i, recording in enumerate(result.recordings):
        found = recording.identified
        flagged: list[IdentifiedMode | DrivenMotion] = [*found.modes, *found.driven] if found else []
        for mode in flagged:
            name = _name(mode)
            for flag in mode.flags:
                if mode.severity_of(flag) is severity:
                    lines.setdefault(flag, (anchor_of(i), []))[1].append(f"{recording.name}, {name}")
        if isinstance(recording.tracks, MarkerTracks):
            for name, text in _of_markers(recording.tracks, severity):
                lines.setdefault(name, (anchor_of(i), []))[1].append(f"{recording.name}, {text}")
    return [(anchor, f"{flag}: {_listed(named)}") for flag, (anchor, named) in lines.items()]


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST
    return "; ".join(names[:_MOST]) + (f" and {more} more" if more > 0 else "")


def flag_counts(tracks: MarkerTracks, k: int) -> list[tuple[str, int, Severity]]:
    """Flags of a marker, with the number of frames that have each and its severity there."""
    counts = [(flag, int(np.count_nonzero(tracks.flags[:, k] & flag.value))) for flag in REGISTRY]
    return [(flag.name, n, flag.severity_in(n / tracks.frame.size)) for flag, n in counts if n]


def _name(mode: IdentifiedMode | DrivenMotion) -> str:
    return f"{significant(mode.frequency_hz, 4)} Hz" if isinstance(mode, DrivenMotion) else mode_name(mode)


def _of_markers(tracks: MarkerTracks, severity: Severity) -> list[tuple[str, str]]:
    """Name of each flag of this severity, with marker and share of the frames."""
    return [
        (name, f"marker {tracks.markers[k]} ({percent(n / tracks.frame.size)} of its frames)")
        for k in range(len(tracks.markers))
        for name, n, own in flag_counts(tracks, k)
        if own is severity
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
