"""The beam of the run: theory before anything is measured, updating and damping models after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.measured import MeasuredMode
from modalcam.run_result import BeamResult
from sim.ancf import AncfBeam
from sim.beam import BeamProperties
from sim.damping import DampingModel, GenericDamping, RayleighDamping
from sim.modes import BeamModes, beam_modes
from sim.statics import BuckledBeamError, NoEquilibriumError
from sim.updating import (
    MOST_ELEMENTS,
    FailedUpdating,
    MeasuredModes,
    Updating,
    UpdatingSettings,
    update,
)

# The paper identifies five modes; a few more number what else rings.
THEORY_MODES = 8


@dataclass(frozen=True)
class DampingInput:
    """Measured modes that the damping models are built from, in order of mode number."""

    numbers: tuple[int, ...]
    frequency_hz: tuple[float, ...]
    damping_ratio: tuple[float, ...]


@dataclass(frozen=True)
class TheoryTask:
    """The beam as configured, and the highest mode that a recording was made for."""

    properties: BeamProperties
    highest_mode: int


def theory(task: TheoryTask) -> BeamModes | str:
    """Modes of the beam as configured, or a sentence that says why there are none."""
    properties = task.properties
    # One above the highest, where the damping of the modes that are not measured is placed.
    count = min(max(THEORY_MODES, task.highest_mode + 1), 2 * properties.elements)
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
        rayleigh = rayleigh_from(damping_input(usable))
        alpha, beta = rayleigh.alpha_1_s, rayleigh.beta_s
    else:
        notes.append(
            "Only one mode was measured: Rayleigh damping (Eq. 4) needs two, so there is no linear model."
        )
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


def damping_input(measured: tuple[MeasuredMode, ...]) -> DampingInput:
    """What the damping models need of the measured modes."""
    return DampingInput(
        tuple(m.number for m in measured),
        tuple(m.frequency_hz for m in measured),
        tuple(m.damping_ratio for m in measured),
    )


def rayleigh_from(damping: DampingInput) -> RayleighDamping:
    """Linear damping through the two lowest measured modes (Eq. 3, 4)."""
    w1, w2 = (2.0 * np.pi * f for f in damping.frequency_hz[:2])
    z1, z2 = damping.damping_ratio[:2]
    return RayleighDamping.from_modes((w1, w2), (z1, z2))


def damping_models(properties: BeamProperties, damping: DampingInput) -> dict[str, DampingModel]:
    """Generic damping from all measured modes, and Rayleigh damping where two are known.

    A mode below the highest measured one that was not measured itself takes the damping ratio interpolated over
    frequency between its neighbours.
    """
    modes = beam_modes(AncfBeam(properties), max(damping.numbers))
    at = np.array(damping.numbers) - 1
    ratios = np.interp(modes.omega_rad_s, modes.omega_rad_s[at], np.array(damping.damping_ratio))
    models: dict[str, DampingModel] = {"generic": GenericDamping(tuple(float(r) for r in ratios))}
    if len(damping.numbers) > 1:
        models["rayleigh"] = rayleigh_from(damping)
    return models
