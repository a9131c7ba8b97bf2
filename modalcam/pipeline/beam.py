"""Stages of the beam: theory before anything is measured, updating and damping models after it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from modalcam.config import beam_properties, updating_settings
from modalcam.pipeline.identify import MeasuredMode, measured_modes
from modalcam.pipeline.results import RUN, BeamResult, RecordingResult
from modalcam.pipeline.stage import Context, Stage, added_stages, run_together
from sim.beam import AncfBeam, BeamModes, BeamProperties, BuckledBeamError, NoEquilibriumError, beam_modes
from sim.comparison import Candidate
from sim.damping import (
    DAMPING_MODELS,
    BeamSection,
    GenericDamping,
    Material,
    MeasuredDamping,
    beam_section,
    compare_laws,
    generic_from,
    rayleigh_from,
)
from sim.updating import (
    MeasuredModes,
    Method,
    UpdatePart,
    UpdatingSettings,
    all_updates,
    chosen_methods,
    update_by,
)
from tracker import Failure, FloatArray

# The paper identifies five modes; a few more are needed to number other modes that are excited.
THEORY_MODES = 8


def theory(properties: BeamProperties, highest_mode: int) -> BeamModes | str:
    """Modes of the configured beam up to the highest that was excited, or the reason why there are none."""
    # one above the highest, for the residual damping
    count = min(max(THEORY_MODES, highest_mode + 1), 2 * properties.elements)
    try:
        return beam_modes(AncfBeam(properties), count)
    except (BuckledBeamError, NoEquilibriumError) as error:
        return f"The beam as configured was not simulated: {error}"


def usable_modes(measured: tuple[MeasuredMode, ...], modes: BeamModes) -> tuple[MeasuredMode, ...]:
    """Measured modes that are among the beam's modes."""
    return tuple(m for m in measured if m.number <= modes.count)


def modes_to_match(usable: tuple[MeasuredMode, ...]) -> MeasuredModes:
    """Frequencies and shapes that the beam is updated to."""
    return MeasuredModes(
        np.array([m.number for m in usable]),
        np.array([m.frequency_hz for m in usable]),
        np.array([m.frequency.sd for m in usable]),
        tuple(m.shape for m in usable if m.shape is not None),
        rate_sd=max(m.rate_sd for m in usable),
    )


def updated_beam(
    properties: BeamProperties,
    modes: BeamModes,
    usable: tuple[MeasuredMode, ...],
    settings: UpdatingSettings,
    parts: dict[Method, UpdatePart],
    material: Material | None,
    air_density_kg_m3: float,
) -> BeamResult:
    """The beam before and after updating, and damping laws over the measured modes.

    A worker runs this, because its linear algebra has one thread.
    """
    if not usable:
        note = "No measured mode could be numbered, so the beam's properties were not updated."
        return BeamResult(properties, modes, note=note)
    found = all_updates(modes_to_match(usable), settings, parts)
    own = properties if isinstance(found, Failure) else found.properties
    laws = compare_laws(small_damping(usable, beam_section(own, material, air_density_kg_m3)))
    alpha, beta = float("nan"), float("nan")
    if len(usable) > 1:
        rayleigh = rayleigh_from(measured_damping(usable, modes))
        alpha, beta = rayleigh.alpha_1_s, rayleigh.beta_s
    if isinstance(found, Failure):
        note = f"The beam was not updated: {found.reason}"
        return BeamResult(properties, modes, None, None, alpha, beta, note, laws)
    after = beam_modes(AncfBeam(found.properties), min(modes.count, 2 * found.properties.elements))
    return BeamResult(properties, modes, found, after, alpha, beta, laws=laws)


def measured_damping(measured: tuple[MeasuredMode, ...], modes: BeamModes) -> MeasuredDamping:
    """Frequencies and damping ratios, with their draws, of the measured modes that are among the beam's modes."""
    usable = usable_modes(measured, modes)
    return MeasuredDamping(
        tuple(m.number for m in usable),
        tuple(m.frequency_hz for m in usable),
        tuple(m.damping_ratio for m in usable),
        tuple(m.frequency_draws_hz for m in usable),
        tuple(m.damping_draws for m in usable),
        tuple(m.damping_ratio_sd for m in usable),
    )


def small_damping(usable: tuple[MeasuredMode, ...], section: BeamSection) -> MeasuredDamping:
    """Damping ratios at small amplitude, where the laws hold: none depends on the amplitude."""
    return MeasuredDamping(
        tuple(m.number for m in usable),
        tuple(m.frequency_hz for m in usable),
        tuple(m.small_damping.value for m in usable),
        damping_sd=tuple(m.small_damping.sd for m in usable),
        section=section,
    )


def damping_candidates(
    models: tuple[str, ...], properties: BeamProperties, measured: MeasuredDamping
) -> dict[str, Candidate]:
    """The chosen damping models that can be built from the measured modes, each with its posterior draws."""
    omega = _omega_rad_s(properties, measured)
    drawn = measured.draws()
    candidates = {}
    for key in models:
        entry = DAMPING_MODELS[key]
        if entry.build is not None and not entry.missing(measured):
            # a draw of a damping ratio that is hardly known may be 0, which a law cannot have
            used = (draw for draw in drawn[:: entry.draw_stride] if not entry.missing(draw))
            draws = tuple(entry.build(draw, omega) for draw in used)
            candidates[key] = Candidate(entry.build(measured, omega), draws)
    return candidates


def generic_damping(properties: BeamProperties, measured: MeasuredDamping) -> GenericDamping:
    """Generic damping of all measured modes."""
    return generic_from(measured, _omega_rad_s(properties, measured))


def _omega_rad_s(properties: BeamProperties, measured: MeasuredDamping) -> FloatArray:
    """Angular frequencies of the beam's modes up to the highest measured one."""
    return beam_modes(AncfBeam(properties), max(measured.numbers)).omega_rad_s


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
    properties = beam_properties(config.beam)
    if isinstance(properties, str):
        return properties
    highest = max((r.mode for r in config.recordings if r.mode is not None), default=1)
    return THEORY.once(context, properties=properties, highest_mode=highest)


_CODE = ("sim", "modalcam.pipeline.beam", "modalcam.pipeline.results")
UPDATES: Stage[UpdatePart] = Stage(
    "updating the beam", "updates", _CODE, update_by, lambda _, reason: Failure(f"{reason}.")
)
UPDATING: Stage[BeamResult | Failure] = Stage(
    "modes of the updated beam", "updating", _CODE, updated_beam, lambda _, reason: Failure(reason)
)


def update_beam(
    context: Context, recordings: Sequence[RecordingResult], theory_modes: BeamModes | str
) -> tuple[BeamResult | None, tuple[str, ...], list[RecordingResult]]:
    """Match the beam to all measured modes; returns the recordings last, with the results of stages added beside.

    Sentences name what could not be done, the theory of the beam included. Added stages run without it too.
    """
    recordings = list(recordings)
    added = [
        (
            one.stage,
            {r.name: given for r in recordings if (given := one.inputs(context, r, None)) is not None},
        )
        for one in added_stages("updating")
    ]
    if isinstance(theory_modes, str):
        return None, (theory_modes,), _with_added(recordings, added, run_together(context, *added))
    properties, settings = theory_modes.beam.properties, updating_settings(context.config.updating)
    usable = usable_modes(measured_modes(recordings), theory_modes)
    methods: dict[str, dict[str, Any]] = {}
    if usable:
        common = {
            "properties": properties,
            "measured": modes_to_match(usable),
            "settings": settings,
            "modes": theory_modes.count,
            "seed": context.seed,
        }
        methods = {f"{RUN}.{name}": {"method": name, **common} for name in chosen_methods(settings)}
    found, *others = run_together(context, (UPDATES, methods), *added)
    recordings = _with_added(recordings, added, others)
    result = UPDATING.once(
        context,
        properties=properties,
        modes=theory_modes,
        usable=usable,
        settings=settings,
        parts={name.rpartition(".")[2]: part for name, part in found.items()},
        material=None if context.config.beam is None else context.config.beam.material,
        air_density_kg_m3=context.config.air.density_kg_m3,
    )
    if isinstance(result, Failure):
        return None, (f"The beam was not updated: {result.reason}.",), recordings
    return result, (result.note,) if result.note else (), recordings


def _with_added(
    recordings: list[RecordingResult],
    added: list[tuple[Stage[Any], dict[str, Any]]],
    found: list[dict[str, Any]],
) -> list[RecordingResult]:
    for (stage, _), results in zip(added, found, strict=True):
        recordings = stage.filled(recordings, results)
    return recordings
