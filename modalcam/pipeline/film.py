"""Stages of the images beside a recording: some of its own frames, and the simulated beam filmed at the same times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from modal_id.results import Identification
from modalcam.config.resolve import random_words
from modalcam.config.schema import RecordingConfig
from modalcam.pipeline.beam import generic_damping, measured_damping
from modalcam.pipeline.measured import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, InputFile, Stage
from modalcam.video.kept_frames import read_kept_frames
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage, SimulatedFootage
from modalcam.video.simulated_footage import film_simulation
from sim.beam.properties import BeamProperties
from sim.comparison import DecayComparison
from sim.damping import MeasuredDamping
from tracker.results import MarkerTracks


def keep(
    recording: InputFile, tracks: MarkerTracks, identification: Identification, size_mm: float | None
) -> KeptFrames | NoKeptFrames:
    """A few frames of the recording after the onset of its decay."""
    return read_kept_frames(recording.path, tracks, identification, size_mm)


KEEPING = Stage("keeping frames", "frames", ("tracker", "modalcam.video"), keep, NoKeptFrames)


def keep_frames(
    context: Context, recordings: Sequence[RecordingResult], paths: Sequence[Path]
) -> list[RecordingResult]:
    """Keep a few frames of each identified recording while it is at hand."""
    inputs = {
        r.name: {
            "recording": InputFile(path, r.sha256),
            "tracks": r.tracks,
            "identification": r.identification,
            "size_mm": context.config.for_recording(r.file).size_mm,
        }
        for r, path in zip(recordings, paths, strict=True)
        if isinstance(r.tracks, MarkerTracks)
        and isinstance(r.identification, Identification)
        and r.identification.modes
    }
    kept = KEEPING.run(context, inputs)
    return [replace(r, kept_frames=kept.get(r.name)) for r in recordings]


def film(
    frames: KeptFrames,
    tracks: MarkerTracks,
    identification: Identification,
    properties: BeamProperties,
    damping: MeasuredDamping,
    recording: RecordingConfig,
    seed: tuple[int, ...],
) -> SimulatedFootage | NoSimulatedFootage:
    """The kept frames as the camera would have seen the updated beam under generic damping."""
    return film_simulation(
        frames,
        tracks,
        identification,
        recording,
        properties,
        generic_damping(properties, damping),
        highest_mode=max(damping.numbers),
        rng=np.random.default_rng(seed),
    )


FILMING = Stage(
    "filming the simulation",
    "simulated",
    ("sim", "modalcam.video", "modalcam.pipeline.beam"),
    film,
    NoSimulatedFootage,
)


def film_recordings(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> list[RecordingResult]:
    """Film the simulated decay of each recording that was compared."""
    if beam is None or beam.updated is None:
        return list(recordings)
    damping = measured_damping(measured_modes(recordings), beam.standard_modes)
    inputs = {
        r.name: {
            "frames": r.kept_frames,
            "tracks": r.tracks,
            "identification": r.identification,
            "properties": beam.updated.properties,
            "damping": damping,
            "recording": context.config.for_recording(r.file),
            "seed": (context.seed, *random_words(r.sha256)),
        }
        for r in recordings
        if isinstance(r.kept_frames, KeptFrames) and isinstance(r.comparison, DecayComparison)
    }
    filmed = FILMING.run(context, inputs)
    return [replace(r, simulated_footage=filmed.get(r.name)) for r in recordings]
