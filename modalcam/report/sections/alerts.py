"""Conditions that may make results wrong; the report lists them before the results."""

from __future__ import annotations

from collections.abc import Callable

from modalcam.pipeline.results import RecordingResult, RunResult
from tracker.results import MarkerTracks

R_HAT_LIMIT = 1.05
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
    return {kind: recordings for kind, recordings in found.items() if recordings}


def anchor_of(index: int) -> str:
    """Anchor of the section of the recording at `index`, 0 first."""
    return f"r{index + 1}"


def _tracked(recording: RecordingResult, holds: Callable[[MarkerTracks], bool]) -> bool:
    return isinstance(recording.tracks, MarkerTracks) and holds(recording.tracks)


def _not_converged(recording: RecordingResult) -> bool:
    found = recording.identified
    # A NaN is not above the limit.
    return found is not None and any(r > R_HAT_LIMIT for m in found.modes for r in m.posterior.r_hat)
