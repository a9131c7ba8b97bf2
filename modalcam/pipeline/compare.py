"""Stages of the comparison: the decay of each recording, simulated with the updated beam, and filmed as recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from modal_id.results import FailedIdentification, Identification
from modal_id.settings import IdentifySettings, SamplerSettings
from modalcam.config.resolve import random_words
from modalcam.config.schema import AirConfig, RecordingConfig
from modalcam.pipeline.beam import damping_candidates, generic_damping, measured_damping
from modalcam.pipeline.combined_modes import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage
from modalcam.video.results import KeptFrames, NoFootage, SimulatedFootage
from sim.beam.properties import BeamProperties
from sim.comparison import BAND_DRAWS, AirDrag, DecayComparison, FailedComparison, compare_decay
from sim.damping import MeasuredDamping, skipped_damping_models
from tracker.results import DisplacementSeries, MarkerTracks

# A simulated decay has no noise: the standard deviation of its damping ratio is 1e-6 of it, whatever the draws.
_FEW_DRAWS = SamplerSettings(walkers=32, autocorrelation_times=10.0)


def compare_models(
    identification: Identification,
    properties: BeamProperties,
    beams: tuple[BeamProperties, ...],
    models: tuple[str, ...],
    damping: MeasuredDamping,
    air: AirConfig,
    seed: int,
) -> DecayComparison | FailedComparison:
    """Measured decay against each damping model, from the fitted state at the onset; `beams` are posterior draws."""
    # Workers only: the main process would hold the libraries of the fit beside all results.
    from modal_id.identify import identify_free_decay  # noqa: PLC0415

    target = identification.target

    def identify_simulated(simulated: DisplacementSeries) -> Identification | FailedIdentification:
        settings = IdentifySettings(
            target_frequency_hz=None if target is None else target.frequency_hz,
            # what a simulation has beside the modes it started with are harmonics and errors of its steps
            max_modes=len(identification.modes),
            seed=seed,
            sampler=_FEW_DRAWS,
        )
        return identify_free_decay(simulated, settings)

    drag = None
    if air.drag_coefficient != 0.0:
        given = None if air.drag_coefficient == "identify" else air.drag_coefficient
        drag = AirDrag(generic_damping(properties, damping), air.density_kg_m3, given)
    return compare_decay(
        properties,
        identification,
        damping_candidates(models, properties, damping),
        identify=identify_simulated,
        air=drag,
        beams=beams,
    )


COMPARING = Stage(
    "simulating",
    "comparison",
    ("sim", "modal_id", "modalcam.pipeline.beam", "modalcam.pipeline.compare", "modalcam.config.resolve"),
    compare_models,
    FailedComparison,
)


def compare_recordings(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> tuple[list[RecordingResult], tuple[str, ...]]:
    """Compare each identified recording with simulations of the updated beam; sentences name skipped models."""
    if beam is None or beam.updated is None:
        return list(recordings), ()
    draws = beam.updated.bayesian
    measured = measured_damping(measured_modes(recordings), beam.standard_modes)
    common = {
        "properties": beam.updated.properties,
        "beams": draws.draws(min(BAND_DRAWS, len(draws.log_factor_draws))),
        "models": context.config.damping.models,
        "damping": measured,
        "air": context.config.air,
        "seed": context.seed,
    }

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | None:
        found = recording.identified
        return {"identification": found, **common} if found is not None and found.modes else None

    skipped = skipped_damping_models(context.config.damping.models, len(measured.numbers))
    return COMPARING.each(context, recordings, inputs), skipped


def film(
    frames: KeptFrames,
    tracks: MarkerTracks,
    identification: Identification,
    properties: BeamProperties,
    damping: MeasuredDamping,
    recording: RecordingConfig,
    seed: tuple[int, ...],
) -> SimulatedFootage | NoFootage:
    """The kept frames as the camera would have seen the updated beam under generic damping."""
    from modalcam.video.simulated_footage import film_simulation  # noqa: PLC0415 - workers only, as above

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
    ("sim", "tracker", "modalcam.video", "modalcam.pipeline.beam", "modalcam.pipeline.compare"),
    film,
    NoFootage,
)


def film_recordings(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> list[RecordingResult]:
    """Film the simulated decay of each recording that was compared."""
    if beam is None or beam.updated is None:
        return list(recordings)
    properties = beam.updated.properties
    damping = measured_damping(measured_modes(recordings), beam.standard_modes)

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | None:
        compared = isinstance(recording.comparison, DecayComparison)
        if not compared or not isinstance(recording.kept_frames, KeptFrames):
            return None
        return {
            "frames": recording.kept_frames,
            "tracks": recording.tracks,
            "identification": recording.identification,
            "properties": properties,
            "damping": damping,
            "recording": context.config.for_recording(recording.file),
            "seed": (context.seed, *random_words(recording.sha256)),
        }

    return FILMING.each(context, recordings, inputs)
