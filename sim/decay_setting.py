"""What all simulations of one recorded decay share: the beam, its matched modes, the start, the recording's times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification
from sim.ancf import AncfBeam
from sim.damping import DampingModel
from sim.excitation import state_with_coordinates
from sim.matching import MatchedModes
from sim.modes import BeamModes
from sim.posterior_decays import posterior_decays
from sim.trajectory import FailedSimulation, State

FloatArray = NDArray[np.float64]

# the most of a period of the highest identified mode that a step may take, as omega h
_LARGEST_PHASE = 0.35
# of the motion held in memory at a time
_LARGEST_BATCH_BYTES = 2e8
# The start is corrected while the amplitude is above this share of that at the start ...
_START_SHARE = 0.3
# ... as long as the correction is larger than this share of it, and than so many of its standard deviations.
_SMALLEST_CORRECTION = 2e-3
_SURE = 3.0
_CORRECTIONS = 4
# Below this share of the length a swing is small; above this many standard deviations a change of damping is one.
_LARGE_SWING, _CHANGES = 0.02, 3.0


@dataclass(frozen=True)
class DecaySetting:
    """One recorded decay, ready to be simulated.

    Attributes
    ----------
    beam : AncfBeam
    modes : BeamModes
    matched : MatchedModes
    coordinate : complex
        Modal coordinate (m kg^1/2) of the target mode at the start.
    omega_rad_s : array, shape (m,)
        Angular frequency of each mode of `modes`: measured at small amplitude where it was identified.
    time_s : array, shape (n,)
        From the start of the fit.
    positions_m : array, shape (k,)
    measured_mm : array, shape (n, k)
        Baseline removed.
    baseline_mm : array, shape (n, k)
        Offset and slow drift that were removed.
    used : bool array, shape (n, k)
    step_s : float
    """

    beam: AncfBeam
    modes: BeamModes
    matched: MatchedModes
    coordinate: complex
    omega_rad_s: FloatArray
    time_s: FloatArray
    positions_m: FloatArray
    measured_mm: FloatArray
    baseline_mm: FloatArray
    used: NDArray[np.bool_]
    step_s: float

    @property
    def at(self) -> int:
        """Place of the target among the beam's modes."""
        return self.matched.target_number - 1

    @property
    def exponent(self) -> complex:
        """Of the target mode as measured."""
        zeta = self.matched.target.damping_ratio
        return float(self.omega_rad_s[self.at]) * complex(-zeta, np.sqrt(1.0 - zeta**2))

    @property
    def shape(self) -> FloatArray:
        """Displacement of each point in m by a unit of the target's coordinate, shape (k,)."""
        return self.matched.shapes[:, self.at]

    def with_target(self, coordinate: complex, omega_rad_s: float) -> DecaySetting:
        """The same with another start and frequency of the target mode."""
        omega = self.omega_rad_s.copy()
        omega[self.at] = omega_rad_s
        return replace(self, coordinate=coordinate, omega_rad_s=omega)

    def start(self, coordinate: complex | None = None) -> State:
        """State at time 0, with another coordinate of the target where one is given."""
        matched = self.matched
        displacement, velocity = np.zeros(self.modes.count), np.zeros(self.modes.count)
        displacement[matched.numbers - 1] = matched.coordinate.real
        velocity[matched.numbers - 1] = matched.rate.real
        own = self.coordinate if coordinate is None else coordinate
        displacement[self.at], velocity[self.at] = own.real, (own * self.exponent).real
        return state_with_coordinates(self.beam, self.modes, displacement, velocity)

    def simulated_mm(
        self,
        models: Sequence[DampingModel],
        starts: Sequence[State] | None = None,
        target_omega_rad_s: FloatArray | None = None,
    ) -> tuple[FloatArray, tuple[FailedSimulation | None, ...]]:
        """Displacement along the axis of motion for each model, shape (models, n, k); NaN where it failed.

        Parameters
        ----------
        models : sequence of DampingModel
        starts : sequence of State, optional
            One a model; the setting's own where absent.
        target_omega_rad_s : array, shape (models,), optional
            Of the target mode.
        """
        begun = [self.start()] * len(models) if starts is None else list(starts)
        omega = np.tile(self.omega_rad_s, (len(models), 1))
        if target_omega_rad_s is not None:
            omega[:, self.at] = target_omega_rad_s
        steps = self.time_s[-1] / self.step_s
        batch = max(1, int(_LARGEST_BATCH_BYTES / (16.0 * (steps + 4.0) * self.positions_m.size)))
        moved: list[FloatArray] = []
        failed: list[FailedSimulation | None] = []
        for first in range(0, len(models), batch):
            part = slice(first, first + batch)
            run = posterior_decays(
                self.beam,
                self.modes,
                models[part],
                states=begun[part],
                time_s=self.time_s,
                positions_m=self.positions_m,
                step_s=self.step_s,
                direction=self.matched.axis,
                target_omega_rad_s=omega[part],
            )
            moved.append(1e3 * run.displacement_m)
            failed += run.failed
        return np.concatenate(moved), tuple(failed)

    def coordinate_of(self, displacement_mm: FloatArray) -> FloatArray:
        """Coordinate of the target by least squares over the samples used, shape (n,); NaN where there are none."""
        valid = self.used & np.isfinite(self.measured_mm)
        weight = np.where(valid, self.shape, 0.0)
        power = (weight**2).sum(axis=1)
        total = (weight * np.where(valid, displacement_mm, 0.0)).sum(axis=1)
        return np.asarray(1e-3 * np.divide(total, power, out=np.full_like(total, np.nan), where=power > 0.0))


def decay_setting(
    beam: AncfBeam, modes: BeamModes, identification: Identification, matched: MatchedModes, step_s: float
) -> DecaySetting:
    """The setting of one identified recording; `step_s` is made smaller for high modes."""
    series, start_s = identification.series, identification.onset.fit_from_s
    after = series.time_s >= start_s
    omega = modes.omega_rad_s.copy()
    omega[matched.numbers - 1] = matched.omega_rad_s
    own = complex(matched.coordinate[np.flatnonzero(matched.numbers == matched.target_number)[0]])
    return DecaySetting(
        beam=beam,
        modes=modes,
        matched=matched,
        coordinate=own,
        omega_rad_s=omega,
        time_s=series.time_s[after] - start_s,
        positions_m=series.positions_mm * 1e-3,
        measured_mm=(series.values - identification.baseline)[after],
        baseline_mm=identification.baseline[after],
        used=identification.used[after],
        step_s=min(step_s, _LARGEST_PHASE / float(matched.omega_rad_s.max())),
    )


def with_corrected_start(setting: DecaySetting, model: DampingModel) -> DecaySetting:
    """Correct the start where the motion is too large for the linear shapes that it was projected on.

    The simulated and the measured coordinate differ by ``(dc + d1 t + d2 t^2) exp(lambda t)`` early in the decay:
    dc corrects the start, and the rest takes what the damping model makes of the decay, so that the start does not
    depend on the model. Small motion whose damping does not change with the amplitude needs no correction.
    """
    if not _needs_correction(setting):
        return setting
    decay = -setting.exponent.real
    early = setting.time_s <= -np.log(_START_SHARE) / decay if decay > 0.0 else setting.time_s >= 0.0
    t = setting.time_s[early]
    scaled = t / max(float(t[-1]), 1e-12)
    wave = np.exp(setting.exponent * t)[:, np.newaxis] * scaled[:, np.newaxis] ** np.arange(3)
    columns = np.concatenate([wave.real, -wave.imag], axis=1)
    for _ in range(_CORRECTIONS):
        moved, failed = setting.simulated_mm([model])
        if failed[0] is not None:
            return setting
        missed = setting.coordinate_of(setting.measured_mm - moved[0])[early]
        known = np.isfinite(missed)
        if np.count_nonzero(known) <= 2 * columns.shape[1]:
            return setting
        found, _, rank, _ = np.linalg.lstsq(columns[known], missed[known], rcond=None)
        if rank < columns.shape[1]:
            return setting
        left = missed[known] - columns[known] @ found
        variance = left @ left / (left.size - columns.shape[1])
        spread = np.diag(np.linalg.inv(columns[known].T @ columns[known])) * variance
        correction, sd = complex(found[0], found[3]), float(np.sqrt(spread[0] + spread[3]))
        if abs(correction) < max(_SMALLEST_CORRECTION * abs(setting.coordinate), _SURE * sd):
            return setting
        setting = replace(setting, coordinate=setting.coordinate + correction)
    return setting


def _needs_correction(setting: DecaySetting) -> bool:
    length = setting.beam.properties.length_m
    tip = setting.modes.transverse_at(np.array([length]))[0, setting.at]
    bent = setting.matched.target.amplitude_dependence
    changes = bent is not None and abs(bent.zeta1) > _CHANGES * bent.zeta1_sd
    return bool(changes or abs(setting.coordinate * tip) > _LARGE_SWING * length)
