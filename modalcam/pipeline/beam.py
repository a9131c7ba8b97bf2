"""The beam of the run: theory before anything is measured, updating and damping models after it."""

from __future__ import annotations

import numpy as np

from modalcam.pipeline.measured import MeasuredMode
from modalcam.pipeline.results import BeamResult
from sim.beam.ancf import AncfBeam
from sim.beam.modes import BeamModes, beam_modes
from sim.beam.properties import BeamProperties
from sim.beam.statics import BuckledBeamError, NoEquilibriumError
from sim.comparison import Candidate
from sim.damping import DAMPING_MODELS, GenericDamping, MeasuredDamping, generic_from, rayleigh_from
from sim.updating import (
    MOST_ELEMENTS,
    FailedUpdating,
    MeasuredModes,
    Updating,
    UpdatingSettings,
    update,
)
from tracker.arrays import FloatArray

# The paper identifies five modes; a few more number what else rings.
THEORY_MODES = 8


def theory(properties: BeamProperties, highest_mode: int) -> BeamModes | str:
    """Modes of the configured beam up to the highest that was excited, or a sentence that says why there are none."""
    # One above the highest, where the damping of the modes that are not measured is placed.
    count = min(max(THEORY_MODES, highest_mode + 1), 2 * properties.elements)
    try:
        return beam_modes(AncfBeam(properties), count)
    except (BuckledBeamError, NoEquilibriumError) as error:
        return f"The beam as configured was not simulated: {error}"


def beam_result(
    properties: BeamProperties,
    modes: BeamModes,
    measured: tuple[MeasuredMode, ...],
    updated: Updating | FailedUpdating | None,
) -> BeamResult:
    """The beam with what updating made of it; None stands for nothing measured that theory knows."""
    usable = known_modes(measured, modes)
    if updated is None:
        note = "No measured mode could be numbered, so the beam's properties were not updated."
        return BeamResult(properties, modes, note=note)
    alpha, beta = float("nan"), float("nan")
    notes = []
    if len(usable) > 1:
        rayleigh = rayleigh_from(measured_damping(usable))
        alpha, beta = rayleigh.alpha_1_s, rayleigh.beta_s
    found = updated if isinstance(updated, Updating) else None
    if isinstance(updated, FailedUpdating):
        notes.append(f"The beam was not updated: {updated.reason}")
    return BeamResult(
        standard=properties,
        standard_modes=modes,
        updated=found,
        updated_modes=None if found is None else _modes_of(found, modes.count),
        rayleigh_alpha_1_s=alpha,
        rayleigh_beta_s=beta,
        note=" ".join(notes),
    )


def measured_by_theory(measured: tuple[MeasuredMode, ...], modes: BeamModes) -> MeasuredModes | None:
    """What updating is told of the measured modes; None where theory knows none of them."""
    usable = known_modes(measured, modes)
    if not usable:
        return None
    return MeasuredModes(
        np.array([m.number for m in usable]),
        np.array([m.frequency_hz for m in usable]),
        np.array([m.frequency_sd_hz for m in usable]),
        tuple(m.shape for m in usable if m.shape is not None),
    )


def updated_beam(
    properties: BeamProperties,
    modes: BeamModes,
    measured: MeasuredModes,
    settings: UpdatingSettings,
    seed: int,
) -> Updating | FailedUpdating:
    """The beam updated in each way; a worker process runs this, so that linear algebra has one thread."""
    count = min(modes.count, 2 * min(properties.elements, MOST_ELEMENTS))
    return update(properties, measured, settings, modes=count, seed=seed)


def _modes_of(updated: Updating, count: int) -> BeamModes:
    beam = AncfBeam(updated.properties)
    return beam_modes(beam, min(count, 2 * updated.properties.elements))


def known_modes(measured: tuple[MeasuredMode, ...], modes: BeamModes) -> tuple[MeasuredMode, ...]:
    """Measured modes that theory knows."""
    return tuple(m for m in measured if m.number <= modes.count)


def measured_damping(measured: tuple[MeasuredMode, ...]) -> MeasuredDamping:
    """Frequencies and damping ratios of the measured modes, with their draws."""
    return MeasuredDamping(
        tuple(m.number for m in measured),
        tuple(m.frequency_hz for m in measured),
        tuple(m.damping_ratio for m in measured),
        tuple(m.frequency_draws_hz for m in measured),
        tuple(m.damping_draws for m in measured),
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
        if entry.build is not None and len(measured.numbers) >= entry.least_modes:
            draws = tuple(entry.build(draw, omega) for draw in drawn[:: entry.draw_stride])
            candidates[key] = Candidate(entry.build(measured, omega), draws)
    return candidates


def generic_damping(properties: BeamProperties, measured: MeasuredDamping) -> GenericDamping:
    """Generic damping of all measured modes."""
    return generic_from(measured, _omega_rad_s(properties, measured))


def _omega_rad_s(properties: BeamProperties, measured: MeasuredDamping) -> FloatArray:
    """Angular frequencies of the beam's modes up to the highest measured one."""
    return beam_modes(AncfBeam(properties), max(measured.numbers)).omega_rad_s
