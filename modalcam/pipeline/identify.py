"""Stage of the identification: modes of each recording from the displacement of its markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from modal_id.identify import identify
from modal_id.results import FailedIdentification, Identification
from modal_id.settings import IdentifySettings
from modalcam.config.resolve import identify_settings
from modalcam.pipeline.exposure import correct_amplitudes
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam.modes import BeamModes
from tracker.results import DisplacementSeries


def identify_series(
    series: DisplacementSeries, settings: IdentifySettings, exposure_s: float | None
) -> Identification | FailedIdentification:
    """Modes of one recording, their amplitudes corrected for the exposure time."""
    found = identify(series, settings)
    return correct_amplitudes(found, exposure_s) if isinstance(found, Identification) else found


IDENTIFYING = Stage(
    "identifying",
    "modes",
    ("modal_id", "tracker", "modalcam.pipeline.exposure"),
    identify_series,
    FailedIdentification,
)


def identify_recordings(
    context: Context, recordings: Sequence[RecordingResult], modes: BeamModes | None
) -> list[RecordingResult]:
    """Identify the modes of each recording that has a displacement series; `modes` are those of the beam's theory."""
    inputs = {}
    for recording in recordings:
        if recording.series is not None:
            config = context.config.for_recording(recording.file)
            settings = identify_settings(
                config,
                seed=context.seed,
                sha256=recording.sha256,
                positions_mm=recording.series.positions_mm,
                modes=modes,
            )
            inputs[recording.name] = {
                "series": recording.series,
                "settings": settings,
                "exposure_s": config.exposure_s,
            }
    found = IDENTIFYING.run(context, inputs)
    return [replace(r, identification=found.get(r.name, r.identification)) for r in recordings]
