"""Stage of the comparison: the decay of each recording, simulated with the updated beam and each damping model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from modal_id.identify import identify
from modal_id.results import FailedIdentification, Identification
from modalcam.config.resolve import identify_settings
from modalcam.config.schema import AirConfig, RecordingConfig
from modalcam.pipeline.beam import damping_candidates, generic_damping, measured_damping
from modalcam.pipeline.measured import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam.properties import BeamProperties
from sim.comparison import BAND_DRAWS, AirDrag, DecayComparison, FailedComparison, compare_decay
from sim.damping import MeasuredDamping, skipped_damping_models
from tracker.results import DisplacementSeries


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
    target = identification.target

    def identify_simulated(simulated: DisplacementSeries) -> Identification | FailedIdentification:
        config = RecordingConfig(
            file=simulated.name,
            target_frequency_hz=None if target is None else target.frequency_hz,
            onset_s=identification.onset.fit_from_s,
        )
        positions_mm = simulated.positions_mm
        settings = identify_settings(
            config, seed=seed, sha256="0" * 64, positions_mm=positions_mm, modes=None
        )
        return identify(simulated, settings)

    return compare_decay(
        properties,
        identification,
        damping_candidates(models, properties, damping),
        identify=identify_simulated,
        air=_air_drag(air, properties, damping),
        beams=beams,
    )


def _air_drag(air: AirConfig, properties: BeamProperties, damping: MeasuredDamping) -> AirDrag | None:
    given = air.drag_coefficient
    if given == 0.0:
        return None
    return AirDrag(
        generic_damping(properties, damping), air.density_kg_m3, None if given == "identify" else given
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
    inputs = {
        r.name: {"identification": r.identification, **common}
        for r in recordings
        if isinstance(r.identification, Identification) and r.identification.modes
    }
    compared = COMPARING.run(context, inputs)
    skipped = skipped_damping_models(context.config.damping.models, len(measured.numbers))
    return [replace(r, comparison=compared.get(r.name)) for r in recordings], skipped
