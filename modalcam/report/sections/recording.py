"""Everything that the page shows of one recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from modal_id.flags import REGISTRY
from modal_id.results import Identification
from modalcam.pipeline.results import RecordingResult
from modalcam.report.derived.model_decays import model_label
from modalcam.report.derived.signals import shown_mode
from modalcam.report.figures.base import RecordingSubject
from modalcam.report.figures.frame import FrameView, frame_view
from modalcam.report.figures.registry import figures_of
from modalcam.report.figures.strip import StripView, strip_view
from modalcam.report.sections.checks import CheckRow, check_rows
from modalcam.report.sections.clock import ClockView, clock_view, step_facts
from modalcam.report.sections.detail import Detail
from modalcam.report.sections.modes import Verdict, anchor_of, mode_name, recording_verdict
from modalcam.report.sections.sampler import SamplerRow, dependence_text, sampler_rows
from modalcam.report.sections.tracking import TrackingView, tracking_view
from modalcam.report.sections.twin import TwinView, twin_view
from modalcam.report.style.format import count, percent, significant, thousands, with_sd
from modalcam.report.style.svg import FigureView
from modalcam.report.style.text import sentence
from modalcam.storage.cache import Cache
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage, SimulatedFootage
from sim.beam.modes import BeamModes
from sim.comparison import DecayComparison, FailedComparison
from tracker.results import FailedTracking, MarkerTracks

_ONSET_SOURCE = {
    "user": "given by the user",
    "model": "found from the change between driven and free motion",
    "peak": "taken at the largest amplitude",
    "record start": "the record is a decay from its first sample on",
    "none": "no free decay was found",
}


@dataclass(frozen=True)
class RecordingView:
    """One section of the page; parts that do not exist are None or empty."""

    anchor: str
    file: str
    name: str
    sha256: str
    verdict: Verdict
    flags: tuple[str, ...]
    fit_facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    failed_modes: tuple[tuple[str, str], ...]
    figures: tuple[FigureView, ...]
    sampler: tuple[SamplerRow, ...]
    checks: tuple[CheckRow, ...]
    clock: ClockView | None
    sampling: tuple[tuple[str, str], ...]
    tracking: TrackingView | None
    frame: FrameView | None
    strip: StripView | None
    tracking_figures: tuple[FigureView, ...]
    twin: TwinView | None


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
    found = recording.identification if isinstance(recording.identification, Identification) else None
    tracks = recording.tracks if isinstance(recording.tracks, MarkerTracks) else None
    failed = recording.tracks if isinstance(recording.tracks, FailedTracking) else None
    series = recording.series if found is None else found.series
    return RecordingView(
        anchor=anchor,
        file=recording.file,
        name=recording.name,
        sha256=recording.sha256,
        verdict=recording_verdict(recording),
        flags=_flags(found),
        fit_facts=() if found is None else _fit_facts(found),
        notes=_notes(recording, found),
        failed_modes=() if found is None else _failed_modes(found),
        figures=tuple(figures("recording")) if detail.figures else (),
        sampler=() if found is None else sampler_rows(found),
        checks=() if found is None or not detail.figures else check_rows(found),
        clock=None if tracks is None else clock_view(tracks),
        sampling=() if tracks is not None or series is None else step_facts(series.time_s),
        tracking=None if tracks is None else tracking_view(tracks),
        frame=frame_view(failed.first_frame, seen_px=failed.seen_px)
        if failed is not None
        else None
        if tracks is None
        else frame_view(tracks.first_frame, tracks),
        strip=strip_view(tracks, None if found is None else found.onset.time_s)
        if tracks is not None and detail.diagnostics
        else None,
        tracking_figures=tuple(figures("tracking")) if detail.figures else (),
        twin=twin_view(recording.kept_frames, recording.simulated_footage)
        if isinstance(recording.kept_frames, KeptFrames)
        and isinstance(recording.simulated_footage, SimulatedFootage)
        and detail.diagnostics
        else None,
    )


def _flags(found: Identification | None) -> tuple[str, ...]:
    mode = None if found is None else shown_mode(found)
    return () if mode is None else mode.flags


def _fit_facts(found: Identification) -> tuple[tuple[str, str], ...]:
    onset = found.onset
    used = int(found.used.any(axis=1).sum())
    mode = shown_mode(found)
    length: tuple[tuple[str, str], ...] = ()
    if mode is not None and used:
        last_s = float(found.series.time_s[found.used.any(axis=1)][-1])
        cycles = significant((last_s - onset.fit_from_s) * mode.frequency_hz)
        length = (("Length of decay", f"{cycles} cycles"),)
    return (
        ("Onset", f"{with_sd(onset.time_s, onset.sd_s)} s, {_ONSET_SOURCE[onset.source]}"),
        ("Confidence in the onset", percent(onset.confidence, 3)),
        ("Fitted from", f"{significant(onset.fit_from_s, 5)} s"),
        *length,
        ("Samples", f"{thousands(used)} times, {count(int(found.channels_used.sum()), 'channel')}"),
    )


def _notes(recording: RecordingResult, found: Identification | None) -> tuple[str, ...]:
    notes: list[str] = []
    if found is not None:
        notes += [found.onset.note, *found.notes]
        for mode in found.modes:
            # What a flag says stands in its legend.
            said = {flag.description for flag in REGISTRY}
            notes += [f"{mode_name(mode)}: {sentence(note)}" for note in mode.notes if note not in said]
        mode_shown = shown_mode(found)
        if mode_shown is not None:
            notes.append(dependence_text(mode_shown))
    if recording.series is not None:
        notes += list(recording.series.notes)
    if isinstance(recording.comparison, DecayComparison):
        notes += list(recording.comparison.notes)
        notes += [
            f"{model_label(d.model)}: {sentence(d.note)}" for d in recording.comparison.models if d.note
        ]
    if isinstance(recording.comparison, FailedComparison):
        notes.append(f"The decay was not simulated: {sentence(recording.comparison.reason)}")
    for missing in (recording.kept_frames, recording.simulated_footage):
        if isinstance(missing, NoKeptFrames | NoSimulatedFootage):
            notes.append(f"There is no film of the simulated beam: {sentence(missing.reason)}")
    seen: dict[str, None] = {}
    for note in notes:
        if note:
            seen.setdefault(sentence(note))
    return tuple(seen)


def _failed_modes(found: Identification) -> tuple[tuple[str, str], ...]:
    return tuple(
        (
            f"Mode {failed.number}"
            if failed.number is not None
            else f"Mode at {significant(failed.frequency_hz, 4)} Hz"
            if math.isfinite(failed.frequency_hz)
            else "A mode",
            sentence(failed.reason),
        )
        for failed in found.failed
    )
