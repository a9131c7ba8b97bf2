"""Settings of each stage for one recording, from the configuration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from modal_id import IdentifyOptions, IdentifySettings
from modalcam.common import ConfigError
from modalcam.config.schema import ExperimentConfig, RecordingConfig, UpdatingConfig
from sim.beam import BeamModes
from sim.updating import UpdatingSettings
from tracker import CameraOptions, MarkerOptions, TrackerSettings
from tracker.geometry import Lens


def tracker_settings(recording: RecordingConfig) -> TrackerSettings:
    """Settings of the tracker for one recording; ValueError if options contradict each other."""
    options = (*CameraOptions.model_fields, *MarkerOptions.model_fields)
    found = recording.lens
    if isinstance(found, str):
        msg = f"{recording.file}: the lens {found!r} was not loaded; load_config reads the file"
        raise ConfigError(msg)
    lens = None
    if found is not None:
        rms_px = float("nan") if found.rms_px is None else found.rms_px
        lens = Lens(
            found.width_px, found.height_px, found.focal_px, found.centre_px, found.distortion, rms_px
        )
    try:
        return TrackerSettings(lens=lens, **{name: getattr(recording, name) for name in options})
    except ValidationError as error:
        raise ValueError(
            "; ".join(one["msg"].removeprefix("Value error, ") for one in error.errors())
        ) from None


def unusable_recordings(config: ExperimentConfig) -> list[str]:
    """Sentences on listed recordings whose options contradict each other; on all, where none is listed."""
    sentences = []
    for file in [recording.file for recording in config.recordings] or ["all recordings"]:
        try:
            tracker_settings(config.for_recording(file))
        except ValueError as error:
            sentences.append(f"{file}: {error}")
    return sentences


def identify_settings(
    recording: RecordingConfig,
    *,
    seed: int,
    sha256: str,
    positions_mm: NDArray[np.float64],
    modes: BeamModes | None,
) -> IdentifySettings:
    """Settings of identification for one recording: target, onset, theory of the beam, random streams.

    `positions_mm` are those of the channels, `modes` those of the beam as configured.
    """
    return IdentifySettings(
        **expected_of_theory(modes, positions_mm),
        **{name: getattr(recording, name) for name in IdentifyOptions.model_fields},
        seed=seed,
        seed_key=random_words(sha256),
    )


def expected_of_theory(modes: BeamModes | None, positions_mm: NDArray[np.float64]) -> dict[str, Any]:
    """Expected frequencies, and shapes at the channels if all their positions are known and on the beam."""
    if modes is None:
        return {}
    expected: dict[str, Any] = {"expected_frequencies_hz": tuple(map(float, modes.frequency_hz))}
    on_beam = (positions_mm >= 0.0) & (positions_mm <= 1e3 * modes.beam.properties.length_m)
    if positions_mm.size and np.all(on_beam):
        positions_m = positions_mm * 1e-3
        expected["expected_shapes"] = modes.transverse_at(positions_m)
        expected["reversed_shapes"] = modes.transverse_at(modes.beam.properties.length_m - positions_m)
    return expected


def random_words(sha256: str) -> tuple[int, ...]:
    """Four words of an input's hash, which separate the random streams of recordings."""
    return tuple(int(sha256[start : start + 8], 16) for start in range(0, 32, 8))


def updating_settings(updating: UpdatingConfig) -> UpdatingSettings:
    """Settings of updating, as configured."""
    return UpdatingSettings(**dict(updating))
