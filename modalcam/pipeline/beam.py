"""The beam of the run: theory before anything is measured, updating and damping models after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.pipeline.measured import MeasuredMode
from modalcam.pipeline.results import BeamResult
from sim.beam.ancf import AncfBeam
from sim.beam.modes import BeamModes, beam_modes
from sim.beam.properties import BeamProperties
from sim.beam.statics import BuckledBeamError, NoEquilibriumError
from sim.comparison import Candidate
from sim.damping import GenericDamping, RayleighDamping
from sim.updating import (
    MOST_ELEMENTS,
    FailedUpdating,
    MeasuredModes,
    Updating,
    UpdatingSettings,
    update,
)
from tracker.arrays import FloatArray

# label of Rayleigh damping with the stiffness of the undeformed beam
CONSTANT_STIFFNESS = "rayleigh_constant_k"
_CONSTANT_EVERY = 4
# The paper identifies five modes; a few more number what else rings.
THEORY_MODES = 8


@dataclass(frozen=True)
class DampingInput:
    """Measured modes that the damping models are built from, in order of mode number; draws of each beside."""

    numbers: tuple[int, ...]
    frequency_hz: tuple[float, ...]
    damping_ratio: tuple[float, ...]
    frequency_draws_hz: tuple[tuple[float, ...], ...] = ()
    damping_draws: tuple[tuple[float, ...], ...] = ()

    def drawn(self) -> tuple[DampingInput, ...]:
        """The same with each draw of all modes in place of the values."""
        pairs = zip(
            zip(*self.frequency_draws_hz, strict=True), zip(*self.damping_draws, strict=True), strict=True
        )
        return tuple(DampingInput(self.numbers, frequency, ratio) for frequency, ratio in pairs)


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
        tuple(m.frequency_draws_hz for m in measured),
        tuple(m.damping_draws for m in measured),
    )


def rayleigh_from(damping: DampingInput, *, constant_stiffness: bool = False) -> RayleighDamping:
    """Linear damping through the two lowest measured modes (Eq. 3, 4)."""
    w1, w2 = (2.0 * np.pi * f for f in damping.frequency_hz[:2])
    z1, z2 = damping.damping_ratio[:2]
    return RayleighDamping.from_modes((w1, w2), (z1, z2), constant_stiffness=constant_stiffness)


def damping_candidates(properties: BeamProperties, damping: DampingInput) -> dict[str, Candidate]:
    """Generic damping from all measured modes, and Rayleigh damping where two are known; each with its draws.

    Rayleigh damping comes with the current stiffness K(q), and with that of the undeformed beam, which is a trap.
    A mode below the highest measured one that was not measured itself takes the damping ratio interpolated over
    frequency between its neighbours.
    """
    omega = beam_modes(AncfBeam(properties), max(damping.numbers)).omega_rad_s
    drawn = damping.drawn()
    candidates = {
        "generic": Candidate(_generic(omega, damping), tuple(_generic(omega, draw) for draw in drawn))
    }
    if len(damping.numbers) > 1:
        for name, constant in (("rayleigh", False), (CONSTANT_STIFFNESS, True)):
            # A constant stiffness has no lanes, and costs several times as much.
            some = drawn[::_CONSTANT_EVERY] if constant else drawn
            candidates[name] = Candidate(
                rayleigh_from(damping, constant_stiffness=constant),
                tuple(rayleigh_from(draw, constant_stiffness=constant) for draw in some),
            )
    return candidates


def generic_damping(properties: BeamProperties, damping: DampingInput) -> GenericDamping:
    """Generic damping from all measured modes, as `damping_candidates` has it."""
    omega = beam_modes(AncfBeam(properties), max(damping.numbers)).omega_rad_s
    return _generic(omega, damping)


def _generic(omega_rad_s: FloatArray, damping: DampingInput) -> GenericDamping:
    at = np.array(damping.numbers) - 1
    ratios = np.interp(omega_rad_s, omega_rad_s[at], np.array(damping.damping_ratio))
    return GenericDamping(tuple(float(r) for r in ratios))
