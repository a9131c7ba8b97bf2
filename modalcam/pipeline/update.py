"""Stages of the beam: its theory before anything is measured, and the properties updated to the measured modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modalcam.config.resolve import beam_properties, updating_settings
from modalcam.config.schema import ExperimentConfig
from modalcam.errors import ConfigError
from modalcam.pipeline.beam import theory, updated_beam
from modalcam.pipeline.measured import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam.modes import BeamModes
from sim.beam.properties import BeamProperties
from sim.updating import FailedUpdating


@dataclass(frozen=True)
class Theory:
    """The configured beam and its modes, or sentences that say why there are none."""

    properties: BeamProperties | None
    modes: BeamModes | None
    skipped: tuple[str, ...]


THEORY: Stage[BeamModes | str] = Stage(
    "theory of the beam",
    "theory",
    ("sim", "modalcam.pipeline.beam"),
    theory,
    lambda _, reason: f"The modes of the beam were not computed: {reason}.",
    per_run=True,
)


def beam_theory(context: Context) -> Theory:
    """Modes of the configured beam.

    Raises
    ------
    ConfigError
        If the beam's values are impossible.
    """
    config: ExperimentConfig = context.config
    try:
        properties = beam_properties(config.beam)
    except ValueError as error:
        msg = f"[beam]: {error}"
        raise ConfigError(msg) from error
    if isinstance(properties, str):
        return Theory(None, None, (properties,))
    highest = max((r.mode for r in config.recordings if r.mode is not None), default=1)
    modes = THEORY.run_once(context, properties=properties, highest_mode=highest)
    if isinstance(modes, str):
        return Theory(properties, None, (modes,))
    return Theory(properties, modes, ())


UPDATING: Stage[BeamResult | FailedUpdating] = Stage(
    "updating the beam",
    "updating",
    ("sim", "modalcam.pipeline.beam", "modalcam.pipeline.update", "modalcam.pipeline.results"),
    updated_beam,
    lambda _, reason: FailedUpdating(reason),
    per_run=True,
)


def update_beam(
    context: Context, recordings: Sequence[RecordingResult], known: Theory
) -> tuple[BeamResult | None, tuple[str, ...]]:
    """Match the beam to all measured modes; sentences name what could not be done."""
    if known.properties is None or known.modes is None:
        return None, ()
    result = UPDATING.run_once(
        context,
        properties=known.properties,
        modes=known.modes,
        measured=measured_modes(recordings),
        settings=updating_settings(context.config.updating),
        seed=context.seed,
    )
    if isinstance(result, FailedUpdating):
        return None, (f"The beam was not updated: {result.reason}.",)
    return result, (result.note,) if result.note else ()
