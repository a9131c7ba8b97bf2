"""Identified modes matched to those of the beam, and errors of envelope and phase of a simulated decay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from sim.beam import BeamModes
from tracker import ComplexArray, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Which modes match, and the windows of envelope and phase."""

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
    target = identification.target or max(identification.modes, key=lambda mode: mode.amplitude)
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
    for mode in sorted(identification.modes, key=lambda mode: mode is not target):
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
