"""Mode shapes: modal assurance criterion, phase collinearity, uncertainty of complex amplitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from modal_id.data import FitData
from modal_id.solve import LinearSolution
from tracker import BoolArray, ComplexArray, FloatArray, PositionErrors

# A part of the samples determines these standard deviations well enough; they are spread by the golden section, which
# has no common period with the motion.
_SAMPLES, _GOLDEN = 2048, 0.6180339887498949


def repeating_shape_sd(
    data: FitData, linear: LinearSolution, errors: PositionErrors | None, channels: NDArray[np.intp]
) -> FloatArray:
    """Standard deviations of the shapes of m modes in k channels due to periodic errors; shape (m, k).

    Parameters
    ----------
    channels : int array, shape (k,)
        Index in `errors` of each channel of `linear`.

    Notes
    -----
    Noise averages out over the samples, a function of the position does not: its part that is proportional to the
    motion is the same in every cycle. That part is the projection of the periodic functions, whose multiples
    are normal, on the modes; both real and imaginary parts take all of it, since its phase is that of the motion.
    """
    modes_count, channels_count = linear.amplitudes.shape
    sd = np.zeros((modes_count, channels_count))
    if errors is None or not errors.periodic_sd.size:
        return sd
    count = data.time_s.size
    rows = np.arange(count)
    if count > _SAMPLES:
        rows = np.unique((np.arange(1, _SAMPLES + 1) * _GOLDEN % 1.0 * count).astype(np.intp))
    columns = np.ascontiguousarray(linear.columns[rows])
    project = np.linalg.pinv(columns)
    modes = columns.view(np.complex128)
    for k, channel in enumerate(channels.tolist()):
        functions = errors.periodic(channel, np.real(modes @ linear.amplitudes[:, k]))
        parts = project @ (functions - functions.mean(axis=0))
        sd[:, k] = np.sqrt(np.sum((parts**2).reshape(modes_count, -1), axis=1))
    return sd


@dataclass(frozen=True)
class Tuning:
    """Channels without motion."""

    #: [sd] amplitude below which a channel has no motion
    #: statistics: Noise exceeds it in 6e-5 of the channels.
    moves: float = 4.0


TUNING = Tuning()


def mac(first: ComplexArray | FloatArray, second: ComplexArray | FloatArray) -> float:
    """Modal assurance criterion, 0 to 1; entries that are NaN in either are left out.

    NaN when fewer than two entries are left or one shape is zero.

    Notes
    -----
    ``|a^H b|^2 / (a^H a b^H b)``: Allemang & Brown (1982).
    """
    good = np.isfinite(first) & np.isfinite(second)
    a, b = np.asarray(first)[good], np.asarray(second)[good]
    norm = float(np.vdot(a, a).real * np.vdot(b, b).real)
    if a.size < 2 or norm <= 0.0:
        return float("nan")
    return float(abs(np.vdot(a, b)) ** 2 / norm)


def mpc(shape: ComplexArray) -> float:
    """Modal phase collinearity, 0 to 1: 1 where all points move in phase or against it; NaN entries are left out.

    NaN when fewer than two entries are left or the shape is zero.

    Notes
    -----
    Squared relative difference of the principal moments of the shape's points in the complex plane: Juang & Pappa
    (1985), doi:10.2514/3.20031, without subtracting the mean, because the clamp is at rest.
    """
    good = shape[np.isfinite(shape)]
    total = float(np.sum(np.abs(good) ** 2))
    if good.size < 2 or total <= 0.0:
        return float("nan")
    return float(abs(np.sum(good**2)) / total) ** 2


def in_phase(shape: ComplexArray, sd: FloatArray | float = 1.0) -> ComplexArray:
    """The shape turned so that the sum of squares of its imaginary part over its sd is smallest.

    Entries that are NaN remain so and do not count.
    """
    squares = (shape / sd) ** 2
    return np.asarray(shape * np.exp(-0.5j * np.angle(np.sum(squares[np.isfinite(squares)]))))


def amplitude_sd(data: FitData, linear: LinearSolution, mode: int) -> FloatArray:
    """White-noise standard deviation of a mode's real and imaginary part in each channel (their root mean square).

    The poles are held: their uncertainty is a phase and a scale common to all channels.
    """
    result = np.empty(data.values.shape[1])
    for (channels, _), factor in zip(data.groups, linear.factors, strict=True):
        unit = np.zeros((linear.columns.shape[1], 2))
        unit[2 * mode, 0] = unit[2 * mode + 1, 1] = 1.0
        inverse = cho_solve(factor.factor, unit, check_finite=False)
        mean = 0.5 * (inverse[2 * mode, 0] + inverse[2 * mode + 1, 1])
        result[channels] = np.sqrt(np.maximum(mean, 0.0) * linear.noise_variance[channels])
    return result


def moving_channels(data: FitData, linear: LinearSolution) -> BoolArray:
    """Mask of the channels in which some mode exceeds four standard deviations; at least one, shape (k,)."""
    sd = np.stack([amplitude_sd(data, linear, i) for i in range(linear.amplitudes.shape[0])])
    size = np.max(np.abs(linear.amplitudes) / np.maximum(sd, 1e-300), axis=0)
    return np.asarray(size > min(TUNING.moves, float(np.max(size)) * 0.999))
