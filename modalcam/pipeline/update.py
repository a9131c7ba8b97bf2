"""Stages of the beam: its theory before anything is measured, and the properties updated to the measured modes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from modalcam.config import beam_properties, updating_settings
from modalcam.errors import ConfigError
from modalcam.pipeline.beam import modes_to_match, theory, updated_beam, usable_modes
from modalcam.pipeline.combined_modes import measured_modes
from modalcam.pipeline.results import RUN, BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage, run_together
from modalcam.pipeline.track import KEEPING, frames_to_keep
from sim.beam import BeamModes
from sim.updating import METHODS, MOST_ELEMENTS, FailedUpdating, UpdatePart, update_by

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


_CODE = ("sim", "modalcam.pipeline.beam", "modalcam.pipeline.update", "modalcam.pipeline.results")
UPDATES: Stage[UpdatePart] = Stage(
    "updating the beam", "updates", _CODE, update_by, lambda _, reason: FailedUpdating(f"{reason}.")
)
UPDATING: Stage[BeamResult | FailedUpdating] = Stage(
    "modes of the updated beam", "updating", _CODE, updated_beam, lambda _, reason: FailedUpdating(reason)
)


def update_beam(
    context: Context, recordings: Sequence[RecordingResult], theory_modes: BeamModes | str
) -> tuple[BeamResult | None, tuple[str, ...], list[RecordingResult]]:
    """Match the beam to all measured modes, and keep frames of the recordings; returns them last.

    Sentences name what could not be done, the theory of the beam included; without it no frames are kept.
    """
    if isinstance(theory_modes, str):
        return None, (theory_modes,), list(recordings)
    properties, settings = theory_modes.beam.properties, updating_settings(context.config.updating)
    usable = usable_modes(measured_modes(recordings), theory_modes)
    methods: dict[str, dict[str, Any]] = {}
    if usable:
        common = {
            "properties": properties,
            "measured": modes_to_match(usable),
            "settings": settings,
            "modes": min(theory_modes.count, 2 * min(properties.elements, MOST_ELEMENTS)),
            "seed": context.seed,
        }
        methods = {f"{RUN}.{method}": {"method": method, **common} for method in METHODS}
    found, frames = run_together(context, (UPDATES, methods), (KEEPING, frames_to_keep(context, recordings)))
    recordings = KEEPING.filled(recordings, frames)
    result = UPDATING.once(
        context,
        properties=properties,
        modes=theory_modes,
        usable=usable,
        settings=settings,
        parts={name.rpartition(".")[2]: part for name, part in found.items()},
    )
    if isinstance(result, FailedUpdating):
        return None, (f"The beam was not updated: {result.reason}.",), recordings
    return result, (result.note,) if result.note else (), recordings
