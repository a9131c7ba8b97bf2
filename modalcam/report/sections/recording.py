"""Everything that the page shows of one recording."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from modal_id.flags import ModeFlag
from modal_id.modes.residual_checks import Check, residual_checks
from modal_id.modes.shapes import mpc
from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RecordingResult
from modalcam.report.derived.signals import shown_mode
from modalcam.report.figures.base import RecordingSubject
from modalcam.report.figures.registry import figures_of
from modalcam.report.sections.alerts import anchor_of
from modalcam.report.sections.footage import MarkerRow, Sampling, marker_rows, repeated_frames, sampling
from modalcam.report.sections.images import Film, Frame, Strip, film, first_frame, strip
from modalcam.report.sections.modes import mode_name, state_of
from modalcam.report.style.damping_models import model_label
from modalcam.report.style.svg import FigureView
from modalcam.report.style.text import sentence
from modalcam.storage.cache import Cache
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage, SimulatedFootage
from sim.beam.modes import BeamModes
from sim.comparison import DecayComparison, FailedComparison
from tracker.results import FailedTracking, MarkerTracks

_MIN_CHANNELS = 3


class Detail(NamedTuple):
    """How much is drawn of each recording, so that a browser can still open the page of many."""

    strips: int
    diagnostics: bool
    figures: bool


class RecordingView(NamedTuple):
    """One section of the page; parts that do not exist are None or empty.

    `found` is the identification, `mode` the mode shown, `cycles` and `samples` the length of the fitted decay.
    """

    anchor: str
    recording: RecordingResult
    found: Identification | None
    mode: IdentifiedMode | None
    tracks: MarkerTracks | None
    state: str
    cycles: float
    samples: int
    notes: tuple[str, ...]
    figures: tuple[FigureView, ...]
    checks: tuple[Check, ...]
    mpc: float
    sampling: Sampling | None
    repeated: int
    markers: tuple[MarkerRow, ...]
    frame: Frame | None
    strip: Strip | None
    tracking_figures: tuple[FigureView, ...]
    film: Film | None


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
) -> RecordingView:
    """Gather one recording; `theory` holds the beam's modes to compare shapes with."""
    anchor = anchor_of(index)
    subject = RecordingSubject(recording, theory, detail.strips)
    figures = partial(
        figures_of, subject=subject, prefix=anchor, only_essential=not detail.diagnostics, cache=cache
    )
    found, tracks = subject.found, recording.tracks
    series = recording.series if found is None else found.series
    tracked = tracks if isinstance(tracks, MarkerTracks) else None
    detailed = tracked if detail.diagnostics else None
    time_s = tracked.time_s if tracked is not None else None if series is None else series.time_s
    used = np.empty(0) if found is None else found.series.time_s[found.used.any(axis=1)]
    mode = None if found is None else shown_mode(found)
    return RecordingView(
        anchor=anchor,
        recording=recording,
        found=found,
        mode=mode,
        tracks=tracked,
        state=state_of(recording),
        cycles=_cycles(found, mode),
        samples=used.size,
        notes=_notes(recording, found),
        figures=tuple(figures("recording")) if detail.figures else (),
        checks=() if found is None or not detail.figures else residual_checks(found),
        mpc=float("nan") if found is None or mode is None else _collinearity(found, mode),
        sampling=None if time_s is None else sampling(time_s),
        repeated=0 if tracked is None else repeated_frames(tracked),
        markers=() if tracked is None else marker_rows(tracked),
        frame=first_frame(tracks) if isinstance(tracks, MarkerTracks | FailedTracking) else None,
        strip=None if detailed is None else strip(detailed, None if found is None else found.onset.time_s),
        tracking_figures=tuple(figures("tracking")) if detail.figures else (),
        film=_film(recording) if detail.diagnostics else None,
    )


def _cycles(found: Identification | None, mode: IdentifiedMode | None) -> float:
    """Cycles of the mode from the start of the fit to the last sample used; NaN without any."""
    if found is None or mode is None or not found.used.any():
        return float("nan")
    last_s = float(found.series.time_s[found.used.any(axis=1)][-1])
    return (last_s - found.onset.fit_from_s) * mode.frequency_hz


def _collinearity(found: Identification, mode: IdentifiedMode) -> float:
    enough = int(found.channels_used.sum()) >= _MIN_CHANNELS
    return mpc(mode.shape[found.channels_used]) if enough else float("nan")


def _film(recording: RecordingResult) -> Film | None:
    kept, simulated = recording.kept_frames, recording.simulated_footage
    if isinstance(kept, KeptFrames) and isinstance(simulated, SimulatedFootage):
        return film(kept, simulated)
    return None


def _notes(recording: RecordingResult, found: Identification | None) -> tuple[str, ...]:
    """Notes of all stages, each once."""
    notes: list[str] = []
    if found is not None:
        # The legend explains the flags.
        flags = {flag.value for flag in ModeFlag}
        notes += [found.onset.note, *found.notes]
        for mode in found.modes:
            notes += [f"{mode_name(mode)}: {sentence(note)}" for note in mode.notes if note not in flags]
    if recording.series is not None:
        notes += recording.series.notes
    comparison = recording.comparison
    if isinstance(comparison, DecayComparison):
        notes += comparison.notes
        notes += [f"{model_label(d.model)}: {sentence(d.note)}" for d in comparison.models if d.note]
    if isinstance(comparison, FailedComparison):
        notes.append(f"The decay was not simulated: {sentence(comparison.reason)}")
    for missing in (recording.kept_frames, recording.simulated_footage):
        if isinstance(missing, NoKeptFrames | NoSimulatedFootage):
            notes.append(f"There is no film of the simulated beam: {sentence(missing.reason)}")
    return tuple(dict.fromkeys(sentence(note) for note in notes if note))
