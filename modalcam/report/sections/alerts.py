"""What endangers the results, to be said before them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from modal_id.results import Identification
from modalcam.pipeline.results import RunResult
from modalcam.report.sections.modes import anchor_of, worst_sampler
from modalcam.report.style.format import count
from tracker.results import MarkerTracks

_R_HAT_LIMIT = 1.05
_INTRA_ONLY = ("mjpeg", "jpeg2000", "prores", "dnxhd")


@dataclass(frozen=True)
class Alert:
    """A warning, the recordings it holds for (anchor and file), and how loud it is: "danger" or "care"."""

    level: str
    title: str
    text: str
    recordings: tuple[tuple[str, str], ...] = ()


def alerts(result: RunResult) -> tuple[Alert, ...]:
    """Warnings over all recordings, the most serious first."""
    found = (_playback(result), _failed(result), _damaged(result), _lossy(result), _sampler(result))
    return tuple(alert for alert in found if alert is not None)


def _playback(result: RunResult) -> Alert | None:
    hit = _where(result, lambda tracks: tracks.time_axis.is_playback_guess)
    if not hit:
        return None
    return Alert(
        "danger",
        "The time axis is a playback rate",
        f"For {count(len(hit), 'recording')} the only frame rate known is the one that the file plays at. High-speed "
        "footage is played back slower than it was recorded, so every frequency below is probably wrong, by the ratio "
        "of the two rates; damping ratios do not depend on it. Give the recorded rate: camera.fps in experiment.toml, "
        "or --fps on the command line.",
        hit,
    )


def _failed(result: RunResult) -> Alert | None:
    hit = tuple((anchor_of(i), r.file) for i, r in enumerate(result.recordings) if r.failure)
    if not hit:
        return None
    return Alert(
        "care",
        f"{count(len(hit), 'recording')} without a result",
        "The reason stands in the section of each.",
        hit,
    )


def _damaged(result: RunResult) -> Alert | None:
    hit = _where(result, lambda tracks: tracks.decode.frames_corrupt > 0)
    if not hit:
        return None
    return Alert(
        "care",
        "Damaged frames",
        "Frames of these files could not be decoded. They are kept as missing samples, so times after them are right.",
        hit,
    )


def _lossy(result: RunResult) -> Alert | None:
    # Frames coded one by one carry errors little above the noise; those predicted from others follow the motion.
    hit = _where(result, lambda tracks: tracks.decode.lossy and tracks.decode.codec not in _INTRA_ONLY)
    if not hit:
        return None
    return Alert(
        "care",
        "Compressed footage",
        "These files predict frames from one another, with losses: markers are moved by errors that follow the "
        "motion and do not average out. Record raw, FFV1 or high-quality MJPG where damping matters.",
        hit,
    )


def _sampler(result: RunResult) -> Alert | None:
    hit = tuple(
        (anchor_of(i), r.file)
        for i, r in enumerate(result.recordings)
        if isinstance(r.identification, Identification)
        and any(worst_sampler(mode) > _R_HAT_LIMIT for mode in r.identification.modes)
    )
    if not hit:
        return None
    return Alert(
        "care",
        "A posterior has not converged",
        f"R̂ over independent ensembles is above {_R_HAT_LIMIT}: the intervals of these modes cannot be relied on.",
        hit,
    )


def _where(result: RunResult, holds: Callable[[MarkerTracks], bool]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (anchor_of(i), r.file)
        for i, r in enumerate(result.recordings)
        if isinstance(r.tracks, MarkerTracks) and holds(r.tracks)
    )
