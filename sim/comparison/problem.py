"""Common data of all simulations of one recorded decay: beam, matched modes, initial state, times.

Identified modes are matched to those of the beam; envelope and phase of a simulated decay are compared with the
measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from sim.beam import AncfBeam, BeamModes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, State, longest_step_s, simulate, state_with_coordinates
from tracker import ComplexArray, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Matching modes, steps of the simulations, correction of the initial state, windows of envelope and phase."""

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
    #: [sd] slope of the damping ratio above which the damping varies with amplitude, and drag is fitted by simulation
    #: statistics: 0.27 % of decays with constant damping exceed it; smaller slopes also result from large rotation.
    changes: float = 3.0
    #: [1] relative distance in frequency within which a mode without a number matches one of the beam
    #: physics: Covers errors of thickness of 15 %; modes 1 to 5 of a cantilever lie a factor of 1.65 or more apart.
    near: float = 0.15
    #: [periods] shortest window of envelope and phase
    #: convention: Whole periods make the offset orthogonal to the sine; two for a stable fit. Chosen.
    periods: int = 2
    #: [1] samples of a window at least, half of which must be known
    #: physics: Four times the three unknowns of a window.
    samples: int = 12


TUNING = Tuning()


@dataclass(frozen=True)
class MatchedModes:
    """Identified modes that match modes of the beam, in the state at the beginning of the fit.

    Attributes
    ----------
    numbers, omega_rad_s : array, shape (m,)
        Measured angular frequencies at small amplitude.
    coordinate, rate : complex array, shape (m,)
        Modal coordinates (m kg^1/2) and their rates; the real parts are the state.
    axis : tuple of float
        Unit vector in the beam's image (x right, y up) along which the target mode moves the markers, with the sign of
        the series. The measured displacement is along the same line of the body for any rotation of the camera.
    shapes : array, shape (k, modes)
        Displacement of each marker along the axis, in m per unit of each mode of the beam.
    missed_mm : complex array, shape (k,)
        Residual of the measured shape of the target from that of the beam; 0 at markers without a measured value.
    """

    target: IdentifiedMode
    target_number: int
    numbers: NDArray[np.int64]
    coordinate: ComplexArray
    rate: ComplexArray
    omega_rad_s: FloatArray
    axis: tuple[float, float]
    shapes: FloatArray
    missed_mm: ComplexArray
    notes: tuple[str, ...]

    @property
    def target_coordinate(self) -> complex:
        """Modal coordinate of the target."""
        return complex(self.coordinate[int(np.flatnonzero(self.numbers == self.target_number)[0])])


def match_modes(identification: Identification, modes: BeamModes) -> MatchedModes | Failure:
    """Match the identified modes to those of the beam, or return why the target has no match.

    The complex shape of each mode is projected on that of the beam by least squares over the markers.
    """
    target = identification.target or max(identification.fitted_modes, key=lambda mode: mode.amplitude)
    chosen, notes = _numbered(identification, target, modes)
    number = next((n for n, mode in chosen.items() if mode is target), None)
    if number is None:
        near = f"the mode identified at {target.frequency_hz:.4g} Hz"
        return Failure(f"{near} matches none of the beam's first {modes.count}")
    used = identification.channels_used
    motion = _motion(modes, identification.series.positions_mm * 1e-3)
    axis = _axis(motion[used, number - 1], modes, identification.series.direction)
    everywhere = motion @ axis
    shapes = everywhere[used]
    order = np.array(sorted(chosen), dtype=np.int64)
    coordinate = np.array([_projected(chosen[int(n)].shape[used], shapes[:, n - 1]) for n in order])
    # at small amplitude: the simulated beam itself softens with amplitude
    omega = np.array([2.0 * np.pi * chosen[int(n)].small_amplitude_frequency[0] for n in order])
    zeta = np.array([chosen[int(n)].damping_ratio for n in order])
    own = target.shape[used]
    missed = own - shapes[:, number - 1] * _projected(own, shapes[:, number - 1]) * 1e3
    missed_mm = np.zeros(used.size, dtype=np.complex128)
    missed_mm[used] = missed
    notes.append(
        f"The beam's shape of mode {number} differs from the measured one by "
        f"{100 * np.linalg.norm(missed) / np.linalg.norm(own):.2g} % (rms over the markers); this part of the errors "
        "is the same for every damping model."
    )
    return MatchedModes(
        target=target,
        target_number=number,
        numbers=order,
        coordinate=coordinate,
        rate=coordinate * omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2)),
        omega_rad_s=omega,
        axis=(float(axis[0]), float(axis[1])),
        shapes=everywhere,
        missed_mm=missed_mm,
        notes=tuple(notes),
    )


def _numbered(
    identification: Identification, target: IdentifiedMode, modes: BeamModes
) -> tuple[dict[int, IdentifiedMode], list[str]]:
    chosen: dict[int, IdentifiedMode] = {}
    notes = []
    for mode in sorted(identification.fitted_modes, key=lambda mode: mode is not target):
        number = mode.number or _nearest(mode.frequency_hz, modes.frequency_hz)
        if number is None or number > modes.count or number in chosen:
            notes.append(
                f"The mode at {mode.frequency_hz:.4g} Hz matches none of the beam's modes and was omitted."
            )
            continue
        chosen[number] = mode
    return chosen, notes


def _nearest(frequency_hz: float, theory_hz: FloatArray) -> int | None:
    distance = np.abs(theory_hz / frequency_hz - 1.0)
    best = int(np.argmin(distance))
    return best + 1 if distance[best] < TUNING.near else None


def _motion(modes: BeamModes, positions_m: FloatArray) -> FloatArray:
    """Displacement of the points in the image by each mode, shape (k, m, 2)."""
    # positions are linear in the coordinates, so the difference of two states is exact
    rest = np.stack(modes.beam.points(positions_m, modes.equilibrium)[:2], axis=-1)
    moved = np.stack(modes.beam.points(positions_m, modes.equilibrium + modes.phi.T)[:2], axis=-1)
    return np.asarray((moved - rest).transpose(1, 0, 2))


def _axis(motion: FloatArray, modes: BeamModes, direction: tuple[float, float]) -> FloatArray:
    """Principal direction of a mode's motion, shape (2,), with the sign of the series, or of the beam where unknown."""
    axis = np.linalg.svd(motion, full_matrices=False)[2][0]
    towards = direction if np.all(np.isfinite(direction)) else modes.beam.transverse
    return np.asarray(-axis if float(np.dot(axis, towards)) < 0.0 else axis)


def _projected(shape: ComplexArray, column: FloatArray) -> complex:
    """Coordinate in m of a shape in mm."""
    return 1e-3 * complex(column @ shape) / float(column @ column)


def envelope_and_phase_error(
    time_s: FloatArray, measured: FloatArray, simulated: FloatArray, omega_rad_s: float
) -> tuple[float, float]:
    """Errors of amplitude and phase of a simulated motion, demodulated at `omega_rad_s`; NaN where it was not measured.

    Returns
    -------
    envelope : float
        rms of the difference of the amplitudes over the decay, relative to the rms of the measured amplitude.
    phase_rad : float
        rms of the difference of the phases, weighted by the square of the measured amplitude.

    Notes
    -----
    Amplitude and phase in each window of whole periods are those of a least squares sine with an offset. NaN for a
    record shorter than one window.
    """
    known = np.isfinite(measured)
    one = _amplitudes(time_s, np.where(known, measured, 0.0), known, omega_rad_s)
    other = _amplitudes(time_s, np.where(known, simulated, 0.0), known, omega_rad_s)
    power = np.abs(one) ** 2
    if not power.sum() > 0.0:
        return float("nan"), float("nan")
    envelope = np.sum((np.abs(other) - np.abs(one)) ** 2)
    phase = np.angle(other * np.conj(one))
    return float(np.sqrt(envelope / power.sum())), float(np.sqrt(power @ phase**2 / power.sum()))


def _amplitudes(
    time_s: FloatArray, values: FloatArray, known: NDArray[np.bool_], omega_rad_s: float
) -> ComplexArray:
    """Complex amplitude in each window, relative to ``exp(i omega t)``."""
    period_s = 2.0 * np.pi / omega_rad_s
    interval_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else np.inf
    span_s = period_s * max(TUNING.periods, np.ceil(TUNING.samples * interval_s / period_s))
    found = []
    for begin in np.arange(time_s[0], time_s[-1] - span_s + interval_s, span_s):
        inside = known & (time_s >= begin) & (time_s < begin + span_s)
        if np.count_nonzero(inside) < TUNING.samples // 2:
            continue
        carrier = np.exp(1j * omega_rad_s * time_s[inside])
        columns = np.stack([carrier.real, -carrier.imag, np.ones(carrier.size)], axis=1)
        cosine, sine, _ = np.linalg.lstsq(columns, values[inside], rcond=None)[0]
        found.append(complex(cosine, sine))
    return np.array(found, dtype=np.complex128)


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
