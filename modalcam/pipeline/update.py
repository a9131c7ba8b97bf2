"""Stages of the beam: its theory before anything is measured, and the properties updated to the measured modes."""

from __future__ import annotations

from collections.abc import Sequence

from modalcam.config.resolve import beam_properties, updating_settings
from modalcam.errors import ConfigError
from modalcam.pipeline.beam import theory, updated_beam
from modalcam.pipeline.combined_modes import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam.modes import BeamModes
from sim.updating import FailedUpdating

THEORY: Stage[BeamModes | str] = Stage(
    "theory of the beam",
    "theory",
    ("sim", "modalcam.pipeline.beam"),
    theory,
    lambda _, reason: f"The modes of the beam were not computed: {reason}.",
)


def beam_theory(context: Context) -> BeamModes | str:
    """Modes of the configured beam, or a sentence that says why there are none; ConfigError for impossible values."""
    config = context.config
    try:
        properties = beam_properties(config.beam)
    except ValueError as error:
        msg = f"[beam]: {error}"
        raise ConfigError(msg) from error
    if isinstance(properties, str):
        return properties
    highest = max((r.mode for r in config.recordings if r.mode is not None), default=1)
    return THEORY.once(context, properties=properties, highest_mode=highest)


UPDATING: Stage[BeamResult | FailedUpdating] = Stage(
    "updating the beam",
    "updating",
    ("sim", "modalcam.pipeline.beam", "modalcam.pipeline.update", "modalcam.pipeline.results"),
    updated_beam,
    lambda _, reason: FailedUpdating(reason),
)


def update_beam(
    context: Context, recordings: Sequence[RecordingResult], theory_modes: BeamModes | str
) -> tuple[BeamResult | None, tuple[str, ...]]:
    """Match the beam to all measured modes; sentences name what could not be done, the theory of the beam included."""
    if isinstance(theory_modes, str):
        return None, (theory_modes,)
    result = UPDATING.once(
        context,
        properties=theory_modes.beam.properties,
        modes=theory_modes,
        measured=measured_modes(recordings),
        settings=updating_settings(context.config.updating),
        seed=context.seed,
    )
    if isinstance(result, FailedUpdating):
        return None, (f"The beam was not updated: {result.reason}.",)
    return result, (result.note,) if result.note else ()
