"""Conditions that put results at risk; the report names them before the results."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RecordingResult, RunResult
from tracker.results import MarkerTracks

R_HAT_LIMIT = 1.05
_INTRA_ONLY = ("mjpeg", "jpeg2000", "prores", "dnxhd")


class Alert(NamedTuple):
    """A warning: `kind` selects its text in the template; the recordings concerned as anchor and file."""

    kind: str
    level: str
    recordings: tuple[tuple[str, str], ...]


def alerts(result: RunResult) -> tuple[Alert, ...]:
    """Warnings over all recordings, the most serious first."""
    kinds: tuple[tuple[str, str, Callable[[RecordingResult], bool]], ...] = (
        ("playback", "danger", lambda r: _tracked(r, lambda tracks: tracks.time_axis.is_playback_guess)),
        ("failed", "care", lambda r: bool(r.failure)),
        ("damaged", "care", lambda r: _tracked(r, lambda tracks: tracks.decode.frames_corrupt > 0)),
        ("lossy", "care", lambda r: _tracked(r, _lossy)),
        ("sampler", "care", _not_converged),
    )
    found = (
        Alert(kind, level, tuple((anchor_of(i), r.file) for i, r in enumerate(result.recordings) if holds(r)))
        for kind, level, holds in kinds
    )
    return tuple(alert for alert in found if alert.recordings)


def anchor_of(index: int) -> str:
    """Anchor of the section of the recording at `index`, 0 first."""
    return f"r{index + 1}"


def _tracked(recording: RecordingResult, holds: Callable[[MarkerTracks], bool]) -> bool:
    return isinstance(recording.tracks, MarkerTracks) and holds(recording.tracks)


def _lossy(tracks: MarkerTracks) -> bool:
    # Errors of frames coded one by one are little above the noise; those of predicted frames follow the motion.
    return tracks.decode.lossy and tracks.decode.codec not in _INTRA_ONLY


def _not_converged(recording: RecordingResult) -> bool:
    found = recording.identification
    return isinstance(found, Identification) and any(_worst_r_hat(m) > R_HAT_LIMIT for m in found.modes)


def _worst_r_hat(mode: IdentifiedMode) -> float:
    return max((value for value in mode.posterior.r_hat if np.isfinite(value)), default=float("nan"))
