"""The stages of the film beside a recording: its own frames while it is at hand, the simulated ones at the end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modal_id.results import Identification
from modalcam.config.resolve import random_words
from modalcam.config.schema import RecordingConfig
from modalcam.pipeline.beam import generic_damping
from modalcam.pipeline.stages import code_of, saved_or
from modalcam.storage.cache import digest
from modalcam.storage.provenance import stage_key
from modalcam.video.kept_frames import read_kept_frames
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage, SimulatedFootage
from modalcam.video.simulated_footage import film_simulation
from sim.beam.properties import BeamProperties
from sim.damping import MeasuredDamping
from tracker.results import MarkerTracks


@dataclass(frozen=True)
class FootageTask:
    """Keep a few frames of one recording."""

    path: Path
    sha256: str
    tracks: MarkerTracks
    identification: Identification
    recording: RecordingConfig
    saved: Path
    force: bool


@dataclass(frozen=True)
class TwinTask:
    """Film the simulated beam beside them."""

    footage: KeptFrames
    sha256: str
    tracks: MarkerTracks
    identification: Identification
    properties: BeamProperties
    damping: MeasuredDamping
    recording: RecordingConfig
    seed: int
    saved: Path
    force: bool


def keep_footage(task: FootageTask) -> KeptFrames | NoKeptFrames:
    """A few frames after the onset."""
    size_mm = task.recording.size_mm
    key = stage_key(
        "footage",
        input=task.sha256,
        tracks=digest(task.tracks),
        identification=digest(task.identification),
        size_mm=size_mm,
        code=code_of("tracker", "modalcam"),
    )
    return saved_or(
        task.saved,
        key,
        task.force,
        lambda: read_kept_frames(task.path, task.tracks, task.identification, size_mm),
    )


def film(task: TwinTask) -> SimulatedFootage | NoSimulatedFootage:
    """The same frames of the simulated beam under the generic damping."""
    key = stage_key(
        "twin",
        footage=digest(task.footage),
        tracks=digest(task.tracks),
        identification=digest(task.identification),
        properties=digest(task.properties),
        damping=task.damping,
        recording=task.recording.model_dump(mode="json"),
        seed=task.seed,
        code=code_of("sim", "modalcam"),
    )
    return saved_or(task.saved, key, task.force, lambda: _filmed(task))


def _filmed(task: TwinTask) -> SimulatedFootage | NoSimulatedFootage:
    return film_simulation(
        task.footage,
        task.tracks,
        task.identification,
        task.recording,
        task.properties,
        generic_damping(task.properties, task.damping),
        highest_mode=max(task.damping.numbers),
        rng=np.random.default_rng((task.seed, *random_words(task.sha256))),
    )
