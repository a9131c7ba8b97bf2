"""The stages of a run on one recording, each a function of one task that a worker process can take.

A stage saves its result under the hash of all that it rests on, and takes the saved one when the hash is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from modal_id.identify import identify as identify_series
from modal_id.results import FailedIdentification, Identification
from modal_id.settings import IdentifySettings
from modalcam.config.resolve import identify_settings, tracker_settings
from modalcam.config.schema import AirConfig, RecordingConfig
from modalcam.pipeline.beam import (
    beam_result,
    damping_candidates,
    generic_damping,
    measured_by_theory,
    updated_beam,
)
from modalcam.pipeline.exposure import correct_amplitudes
from modalcam.pipeline.measured import MeasuredMode
from modalcam.pipeline.results import BeamResult
from modalcam.storage.cache import digest, load, save
from modalcam.storage.provenance import code_sha256, recording_sha256, stage_key, versions
from sim.beam.modes import BeamModes
from sim.beam.properties import BeamProperties
from sim.comparison import AirDrag, DecayComparison, FailedComparison, compare_decay
from sim.damping import MeasuredDamping
from sim.updating import UpdatingSettings
from tracker.displacement import displacement_series
from tracker.results import DisplacementSeries, FailedTracking, MarkerTracks
from tracker.track import track as track_file

Result = TypeVar("Result")


@dataclass(frozen=True)
class TrackTask:
    """Track one recording."""

    name: str
    file: str
    path: Path
    recording: RecordingConfig
    saved: Path
    force: bool


@dataclass(frozen=True)
class Tracked:
    """Result of `track`: the file's hash and its tracks."""

    sha256: str
    tracks: MarkerTracks | FailedTracking


@dataclass(frozen=True)
class IdentifyTask:
    """Identify the modes of one recording's displacement."""

    series: DisplacementSeries
    sha256: str
    recording: RecordingConfig
    modes: BeamModes | None
    seed: int
    saved: Path
    force: bool


@dataclass(frozen=True)
class CompareTask:
    """Simulate the decay of one recording with each damping model; `beams` are draws of the updated one."""

    identification: Identification
    properties: BeamProperties
    beams: tuple[BeamProperties, ...]
    models: tuple[str, ...]
    damping: MeasuredDamping
    air: AirConfig
    recording: RecordingConfig
    seed: int
    saved: Path
    force: bool


@dataclass(frozen=True)
class UpdateTask:
    """Match the beam to the measured modes of all recordings."""

    properties: BeamProperties
    modes: BeamModes
    measured: tuple[MeasuredMode, ...]
    settings: UpdatingSettings
    seed: int
    saved: Path
    force: bool


def track(task: TrackTask) -> Tracked:
    """Marker positions of one recording."""
    try:
        sha256 = recording_sha256(task.path)
    except OSError as error:
        reason = f"the file cannot be read ({error.strerror})"
        return Tracked("", FailedTracking(task.file, reason))
    try:
        settings = tracker_settings(task.recording)
    except ValueError as error:
        return Tracked(sha256, FailedTracking(task.file, f"the configuration cannot be used: {error}"))
    key = stage_key("track", file=task.file, input=sha256, settings=settings, code=code_of("tracker"))
    value = saved_or(
        task.saved, key, task.force, lambda: track_file(task.path, settings, recording=task.file)
    )
    return Tracked(sha256, value)


def displacement(tracks: MarkerTracks) -> DisplacementSeries | FailedIdentification:
    """Displacement of the markers along the common direction of motion."""
    if not np.isfinite(tracks.x_px).any():
        return FailedIdentification(tracks.recording, "no marker was seen in any frame")
    try:
        return displacement_series(tracks)
    except ValueError as error:
        return FailedIdentification(tracks.recording, str(error))


def identify(task: IdentifyTask) -> Identification | FailedIdentification:
    """Modes of one recording."""
    series = task.series
    settings = identify_settings(
        task.recording,
        seed=task.seed,
        sha256=task.sha256,
        positions_mm=series.positions_mm,
        modes=task.modes,
    )
    key = stage_key(
        "identify",
        series=digest(series),
        settings=settings,
        shapes=None if settings.expected_shapes is None else settings.expected_shapes.tolist(),
        exposure_s=task.recording.exposure_s,
        code=code_of("modal_id", "tracker"),
    )
    return saved_or(task.saved, key, task.force, lambda: _identified(task, settings))


def _identified(task: IdentifyTask, settings: IdentifySettings) -> Identification | FailedIdentification:
    found = identify_series(task.series, settings)
    return (
        correct_amplitudes(found, task.recording.exposure_s) if isinstance(found, Identification) else found
    )


def compare(task: CompareTask) -> DecayComparison | FailedComparison:
    """Measured decay against each damping model, from the fitted state at the onset."""
    target = task.identification.target

    def identify_simulated(simulated: DisplacementSeries) -> Identification | FailedIdentification:
        settings = identify_settings(
            RecordingConfig(
                file=task.recording.file,
                target_frequency_hz=None if target is None else target.frequency_hz,
                onset_s=task.identification.onset.fit_from_s,
            ),
            seed=task.seed,
            sha256="0" * 64,
            positions_mm=simulated.positions_mm,
            modes=None,
        )
        return identify_series(simulated, settings)

    key = stage_key(
        "compare",
        identification=digest(task.identification),
        properties=digest(task.properties),
        beams=digest(task.beams),
        models=task.models,
        damping=task.damping,
        air=task.air.model_dump(),
        seed=task.seed,
        code=code_of("sim", "modal_id", "modalcam"),
    )
    return saved_or(
        task.saved,
        key,
        task.force,
        lambda: compare_decay(
            task.properties,
            task.identification,
            damping_candidates(task.models, task.properties, task.damping),
            identify=identify_simulated,
            air=_air_drag(task),
            beams=task.beams,
        ),
    )


def _air_drag(task: CompareTask) -> AirDrag | None:
    given = task.air.drag_coefficient
    if given == 0.0:
        return None
    generic = generic_damping(task.properties, task.damping)
    return AirDrag(generic, task.air.density_kg_m3, None if given == "identify" else given)


def update_beam(task: UpdateTask) -> BeamResult:
    """The beam matched to the measured modes in each way."""
    measured = measured_by_theory(task.measured, task.modes)
    if measured is None:
        return beam_result(task.properties, task.modes, task.measured, None)
    key = stage_key(
        "update",
        properties=digest(task.properties),
        modes=task.modes.count,
        measured=digest(measured),
        settings=task.settings,
        seed=task.seed,
        code=code_of("sim"),
    )
    updated = saved_or(
        task.saved,
        key,
        task.force,
        lambda: updated_beam(task.properties, task.modes, measured, task.settings, task.seed),
    )
    return beam_result(task.properties, task.modes, task.measured, updated)


def saved_or(path: Path, key: str, force: bool, compute: Callable[[], Result]) -> Result:  # noqa: FBT001
    """What was saved under `key`, else computed and saved."""
    saved = None if force else load(path, key)
    if saved is not None:
        return cast("Result", saved)
    value = compute()
    save(path, key, value)
    return value


def code_of(*packages: str) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The code that a result rests on: hash of packages of ours, versions of others'."""
    return code_sha256(*packages), versions()
