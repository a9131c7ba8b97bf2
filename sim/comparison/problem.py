"""Common data of all simulations of one recorded decay: beam, matched modes, initial state, times."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from modal_id import Identification
from sim.beam import AncfBeam, BeamModes
from sim.comparison.matching import MatchedModes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, State, longest_step_s, simulate, state_with_coordinates
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Steps of the simulations, and the correction of the initial state."""

    #: [s] longest step for differences between simulations, whose common error of the step cancels
    #: measurement: Bands move by less than 2 % of their width against 0.5 ms (tests/sim/comparison/test_bands.py).
    longest_coarse_step_s: float = 4e-3
    #: [1] the initial coordinate is corrected from the part of the decay above this share of its amplitude
    #: convention: The part that the nonlinearity shapes and the damping model has not yet bent; chosen.
    start_share: float = 0.3
    #: [1] correction of the initial coordinate, over it, below which it is left
    #: physics: 0.2 % of the amplitude is a fifth of the sample's noise at a hundredth.
    smallest_correction: float = 2e-3
    #: [sd] correction below this many standard deviations is left
    #: statistics: The square of a complex number over its variance: exp(-9), one decay in 8000 without an error, is
    #: corrected.
    sure: float = 3.0
    #: [1] rounds of corrections
    corrections: int = 4
    #: [rad] change of the phase at the end of the record below which the frequency has converged
    #: physics: Moves a sample by a thousandth of the amplitude at that time, below the noise.
    in_phase_rad: float = 1e-3
    #: [lengths] amplitude of the tip above which the initial state is corrected
    #: physics: 10 mm of 500: the tip of mode 1 turns by 1.4 times that, 0.03 rad, and its cosine differs from 1 by
    #: 4e-4.
    large_motion: float = 0.02
    #: [sd] slope of the damping ratio above which the damping varies with amplitude
    #: statistics: 0.27 % of decays with constant damping exceed it.
    changes: float = 3.0


TUNING = Tuning()


@dataclass(frozen=True)
class DecaySetting:
    """One recorded decay, n instants and k points, prepared for simulation.

    Attributes
    ----------
    coordinate : complex
        Initial modal coordinate (m kg^1/2) of the target mode.
    omega_rad_s : array, shape (m,)
        Angular frequency of each mode of `modes`, for identified ones as measured, at small amplitude.
    time_s : array, shape (n,)
        From the start of the fit.
    measured_mm, baseline_mm : array, shape (n, k)
        Displacement without offset and slow drift, and these.
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
        """Index of the target among the beam's modes."""
        return self.matched.target_number - 1

    @property
    def exponent(self) -> complex:
        """Complex exponent of the target mode as measured."""
        zeta = self.matched.target.damping_ratio
        return float(self.omega_rad_s[self.at]) * complex(-zeta, np.sqrt(1.0 - zeta**2))

    @property
    def shape(self) -> FloatArray:
        """Displacement of each point in m per unit of the target's coordinate, shape (k,)."""
        return self.matched.shapes[:, self.at]

    @property
    def tip_amplitude_m(self) -> float:
        """Initial amplitude of the target mode at the tip or its antinode, by the beam's shape."""
        tip = self.modes.transverse_at(self.modes.antinode_m(self.at + 1))[0, self.at]
        return abs(self.coordinate * float(tip))

    @property
    def coarse(self) -> DecaySetting:
        """With longer steps, for differences between simulations with these."""
        return replace(
            self, step_s=longest_step_s(float(self.matched.omega_rad_s.max()), TUNING.longest_coarse_step_s)
        )

    def with_target(self, coordinate: complex, omega_rad_s: float) -> DecaySetting:
        """Copy with another initial coordinate and frequency of the target mode."""
        omega = self.omega_rad_s.copy()
        omega[self.at] = omega_rad_s
        return replace(self, coordinate=coordinate, omega_rad_s=omega)

    def start(self, coordinate: complex | None = None) -> State:
        """State at time 0, with another coordinate of the target if given."""
        matched = self.matched
        displacement, velocity = np.zeros(self.modes.count), np.zeros(self.modes.count)
        displacement[matched.numbers - 1] = matched.coordinate.real
        velocity[matched.numbers - 1] = matched.rate.real
        own = self.coordinate if coordinate is None else coordinate
        displacement[self.at], velocity[self.at] = own.real, (own * self.exponent).real
        return state_with_coordinates(self.beam, self.modes, displacement, velocity)

    def simulated_mm(
        self, model: DampingModel, start: State | None = None, target_omega_rad_s: float | None = None
    ) -> FloatArray | FailedSimulation:
        """Displacement along the axis of motion, shape (n, k), with another start or target frequency if given."""
        omega = self.omega_rad_s.copy()
        if target_omega_rad_s is not None:
            omega[self.at] = target_omega_rad_s
        steps = max(3, int(np.ceil(self.time_s[-1] / self.step_s * (1.0 - 1e-12))))
        run = simulate(
            self.beam,
            model,
            state=self.start() if start is None else start,
            duration_s=steps * self.step_s,
            step_s=self.step_s,
            output_positions_m=self.positions_m,
            modes=self.modes,
            target_omega_rad_s=omega,
        )
        if isinstance(run, FailedSimulation):
            return run
        rest_x, rest_y, _ = self.beam.points(self.positions_m, self.modes.equilibrium)
        moved = (run.x_m - rest_x) * self.matched.axis[0] + (run.y_m - rest_y) * self.matched.axis[1]
        return np.asarray(1e3 * scipy.interpolate.CubicSpline(run.time_s, moved)(self.time_s))

    def coordinate_of(self, displacement_mm: FloatArray) -> FloatArray:
        """Coordinate of the target by least squares over the samples used, shape (n,); NaN without samples."""
        valid = self.used & np.isfinite(self.measured_mm)
        weight = np.where(valid, self.shape, 0.0)
        power = (weight**2).sum(axis=1)
        total = (weight * np.where(valid, displacement_mm, 0.0)).sum(axis=1)
        return np.asarray(1e-3 * np.divide(total, power, out=np.full_like(total, np.nan), where=power > 0.0))


def decay_setting(
    beam: AncfBeam, modes: BeamModes, identification: Identification, matched: MatchedModes
) -> DecaySetting:
    """Setting of one identified recording."""
    series, start_s = identification.series, identification.onset.fit_from_s
    after = identification.decay_rows
    omega = modes.omega_rad_s.copy()
    omega[matched.numbers - 1] = matched.omega_rad_s
    return DecaySetting(
        beam=beam,
        modes=modes,
        matched=matched,
        coordinate=matched.target_coordinate,
        omega_rad_s=omega,
        time_s=series.time_s[after] - start_s,
        positions_m=series.positions_mm * 1e-3,
        measured_mm=(series.values - identification.baseline)[after],
        baseline_mm=identification.baseline[after],
        used=identification.used[after],
        step_s=longest_step_s(float(matched.omega_rad_s.max())),
    )


def with_corrected_start(setting: DecaySetting, model: DampingModel) -> DecaySetting:
    """Correct initial coordinate and frequency of the target for the nonlinearity of the beam.

    A beam softens with amplitude, so the frequency measured over a decay is not that at small amplitude, which the data
    may not determine: the frequency is shifted until the simulated decay is in phase with the measured one on average.
    If the motion is too large for the linear shapes used in the projection, or the damping varies with amplitude, the
    initial coordinate is first corrected from the early part of the decay.
    """
    large = _is_large(setting)
    if large:
        setting = _with_early_start(setting, model)
    t = setting.time_s
    for _ in range(TUNING.corrections):
        found = _missed(setting, model, np.ones(t.size, dtype=np.bool_), 2)
        if found is None:
            return setting
        start, slope = (complex(value) for value in found[0])
        shift = float((slope / max(float(t[-1]), 1e-12) / setting.coordinate).imag)
        moved = setting.coordinate if large else setting.coordinate + start
        setting = setting.with_target(moved, float(setting.omega_rad_s[setting.at]) + shift)
        if abs(shift) * float(t[-1]) < TUNING.in_phase_rad:
            return setting
    return setting


def _with_early_start(setting: DecaySetting, model: DampingModel) -> DecaySetting:
    """Correct the initial coordinate, with as little dependence on the damping model as possible.

    Early in the decay the simulated and the measured coordinate differ by ``(dc + d1 t + d2 t^2) exp(lambda t)``: dc is
    the correction, and the other terms absorb errors of the damping model.
    """
    decay = -setting.exponent.real
    early = setting.time_s <= -np.log(TUNING.start_share) / decay if decay > 0.0 else setting.time_s >= 0.0
    for _ in range(TUNING.corrections):
        found = _missed(setting, model, early, 3)
        if found is None:
            return setting
        coefficients, sd = found
        correction = complex(coefficients[0])
        if abs(correction) < max(TUNING.smallest_correction * abs(setting.coordinate), TUNING.sure * sd):
            return setting
        setting = replace(setting, coordinate=setting.coordinate + correction)
    return setting


def _missed(
    setting: DecaySetting, model: DampingModel, rows: NDArray[np.bool_], powers: int
) -> tuple[NDArray[np.complex128], float] | None:
    """Measured minus simulated coordinate as ``exp(lambda t)`` times a polynomial in the relative time.

    Coefficients of the powers, and the standard deviation of the first; None if undetermined.
    """
    t = setting.time_s[rows]
    scaled = t / max(float(t[-1]), 1e-12)
    wave = np.exp(setting.exponent * t)[:, np.newaxis] * scaled[:, np.newaxis] ** np.arange(powers)
    columns = np.concatenate([wave.real, -wave.imag], axis=1)
    moved = setting.simulated_mm(model)
    if isinstance(moved, FailedSimulation):
        return None
    missed = setting.coordinate_of(setting.measured_mm - moved)[rows]
    known = np.isfinite(missed)
    if np.count_nonzero(known) <= 2 * columns.shape[1]:
        return None
    found, _, rank, _ = np.linalg.lstsq(columns[known], missed[known], rcond=None)
    if rank < columns.shape[1]:
        return None
    left = missed[known] - columns[known] @ found
    variance = left @ left / (left.size - columns.shape[1])
    spread = np.diag(np.linalg.inv(columns[known].T @ columns[known])) * variance
    return found[:powers] + 1j * found[powers:], float(np.sqrt(spread[0] + spread[powers]))


def _is_large(setting: DecaySetting) -> bool:
    amplitude_fit = setting.matched.target.amplitude_dependence
    changes = amplitude_fit is not None and abs(amplitude_fit.zeta1) > TUNING.changes * amplitude_fit.zeta1_sd
    return bool(changes or setting.tip_amplitude_m > TUNING.large_motion * setting.beam.properties.length_m)
