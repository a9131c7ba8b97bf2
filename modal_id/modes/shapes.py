"""Mode shapes: modal assurance criterion, phase collinearity, uncertainty of complex amplitudes, nodes, curvature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from modal_id.data import FitData
from modal_id.sentences import Reason, Refusal
from modal_id.solve import LinearSolution
from tracker import BoolArray, ComplexArray, Failure, FloatArray, PositionErrors


@dataclass(frozen=True)
class Tuning:
    """Channels without motion, nodes of a shape, shapes between the stations."""

    #: [sd] amplitude that noise does not explain
    #: statistics: Noise exceeds it in 6e-5 of channels, stations or lines.
    clear_sd: float = 4.0
    #: [1] half the window of the fit about a crossing, over the span of the stations
    half_window: float = 0.08
    #: [1] fewest stations in the window
    least_stations: int = 6
    #: [1] number of unrestrained modes beyond the dominant one
    free_beyond: int = 3
    #: [1] number of modes beyond those, restrained by the evidence
    restrained: int = 20
    #: [1] power of the wave number with which their amplitudes fall
    #: physics: That of a smooth shape less the deflection by a force at the end.
    fall: float = 8.0
    #: [1] fewest stations in excess of the unrestrained modes
    more_stations: int = 6
    #: [1] largest distance of the outer stations from the ends, over the mean distance of stations
    largest_gap: float = 2.0
    #: [1] sd of the position of either end, over the mean distance of stations
    #: physics: A px where a station has five.
    end_sd: float = 0.2
    #: [1] number of passes
    passes: int = 3


TUNING = Tuning()
CLEAR_SD = TUNING.clear_sd


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
    return np.asarray(size > min(CLEAR_SD, float(np.max(size)) * 0.999))


class Node(NamedTuple):
    """Distance of a node from the clamp along the beam and its standard deviation, in mm."""

    position_mm: float
    sd_mm: float


def find_nodes(position_mm: FloatArray, shape: ComplexArray, sd: FloatArray) -> tuple[Node, ...]:
    """Places at which the in-phase part of a shape crosses zero.

    Parameters
    ----------
    position_mm : array, shape (k,)
        Stations where it, the shape or its sd is NaN are left out.
    shape : complex array, shape (k,)
    sd : array, shape (k,)
        Of the real and of the imaginary part, independent from station to station.

    Returns
    -------
    tuple of Node
        In order of their position; none where the stations are too far apart: fewer than six within 16 % of their
        span. The sd has no share from the scale of the positions.

    Notes
    -----
    A weighted cubic through the stations within 8 % of the span of a crossing; the sd is that of its value there
    over its slope, larger where the shape scatters more about the cubic than its sd states. The fourth derivative of
    the shape of a uniform beam is proportional to the shape, so that it vanishes with it: at a node the cubic has no
    bias of fourth order.
    """
    good = np.isfinite(position_mm) & np.isfinite(shape) & np.isfinite(sd) & (sd > 0.0)
    order = np.flatnonzero(good)[np.argsort(position_mm[good], kind="stable")]
    at, values, error = position_mm[order], shape[order], sd[order]
    if np.unique(at).size < TUNING.least_stations:
        return ()
    real = np.real(in_phase(values, error))
    half = TUNING.half_window * float(np.ptp(at))
    found: list[Node] = []
    for k in np.flatnonzero(np.diff(np.sign(real)) != 0.0):
        crossing = 0.5 * float(at[k] + at[k + 1])
        node = _node(at, real, error, crossing, half)
        if node is not None and all(abs(node.position_mm - other.position_mm) > half for other in found):
            found.append(node)
    return tuple(found)


def _node(at: FloatArray, real: FloatArray, error: FloatArray, crossing: float, half: float) -> Node | None:
    """Root of the cubic nearest to a crossing; None where noise may have caused the crossing."""
    for _ in range(3):
        near = np.abs(at - crossing) <= half
        x, y, weight = (at[near] - crossing) / half, real[near], 1.0 / error[near]
        clear = y * weight
        sides = clear[x < 0.0], clear[x > 0.0]
        if np.unique(x).size < TUNING.least_stations or not all(side.size for side in sides):
            return None
        design = np.stack([np.ones_like(x), x, x**2, x**3], axis=1)
        covariance = np.linalg.inv(design.T @ (weight[:, None] ** 2 * design))
        fitted = covariance @ (design.T @ (weight**2 * y))
        value, slope, bend, _ = fitted
        step = -value / slope if slope else np.inf
        # The crossing of a beam at rest, as at its clamp, is one of noise.
        if np.max(sides[0] * -np.sign(slope)) < CLEAR_SD or np.max(sides[1] * np.sign(slope)) < CLEAR_SD:
            return None
        if abs(step) > 1.0:
            return None
        crossing += half * float(step - bend * step**2 / slope)
    left = weight * (y - design @ fitted)
    # Errors that return with the motion (compression, the pixels) leave more than the noise that the sd state.
    factor = float(np.sqrt(max(1.0, float(left @ left) / max(x.size - 4, 1))))
    return Node(crossing, factor * half * float(np.sqrt(covariance[0, 0])) / abs(float(slope)))


_SCALES = np.geomspace(1e-6, 1.0, 25)


class Curvature(NamedTuple):
    """Second derivative of the in-phase part of a shape by the distance from the clamp, and its sd; both (n,).

    `value` and `sd` are in the unit of the shape per square metre, zero at the free end. `noise_factor` is the scatter
    of the shape about the fit relative to its sd where that is larger, otherwise 1.
    """

    position_mm: FloatArray
    value: FloatArray
    sd: FloatArray
    noise_factor: float


class _Fit(NamedTuple):
    """Amplitudes, mean and covariance; log evidence; scatter relative to the sd, at least 1."""

    mean: FloatArray
    covariance: FloatArray
    log_evidence: float
    noise_factor: float


def beam_curvature(
    position_mm: FloatArray,
    shape: ComplexArray,
    sd: FloatArray,
    length_mm: float,
    at_mm: FloatArray | None = None,
    end_sd_mm: tuple[float, float] | None = None,
) -> Curvature | Failure:
    """Curvature of a cantilever's shape.

    Parameters
    ----------
    position_mm : array, shape (k,)
        Distances of the stations from the clamp; those where it, the shape or its sd is NaN are left out.
    shape : complex array, shape (k,)
    sd : array, shape (k,)
        Of the real and of the imaginary part, independent from station to station.
    length_mm : float
        Free length of the beam: clamped at 0, free at `length_mm`.
    at_mm : array, shape (n,), optional
        Where the curvature is wanted; at the stations without it.
    end_sd_mm : tuple of float, optional
        Sd of the positions of the clamp and of the free end along the beam; a fifth of the distance between stations
        without it.

    Returns
    -------
    Curvature or Failure
        The latter where the stations are too few or do not reach the ends, whose boundary conditions would be unknown.

    Notes
    -----
    The shape is a sum of the modes of a uniform cantilever (Euler-Bernoulli), which have the curvature of a clamped and
    a free end, and of the deflection by a force at the free end, such as that of a mass there. The modes up to the
    third beyond the dominant one are free. Twenty more have amplitudes of mean zero and of an sd that falls with the
    eighth power of the wave number; its scale is averaged over, weighted by the evidence.
    Errors of the ends' positions are not fitted, because other shapes than the true one would explain them: the fit is
    repeated for four places of the ends, and the sd includes the scatter of the curvatures.
    Errors that are common to many stations, as of compression and of a textured background, look like a shape. An
    elastic clamp is not modelled: its shape has a slope where the model has none.
    """
    good = np.isfinite(position_mm) & np.isfinite(shape) & np.isfinite(sd) & (sd > 0.0)
    x, values, error = position_mm[good] / length_mm, shape[good], sd[good]
    spacing = float(np.ptp(x)) / max(x.size - 1, 1) if x.size else np.nan
    unknown = _unknown_ends(x, spacing)
    if unknown is not None:
        return unknown
    real = np.real(in_phase(values, error))
    number = _dominant(x, real, error)
    least = number + TUNING.free_beyond + TUNING.more_stations
    if x.size < least:
        return Reason.FEW_STATIONS(found=x.size, number=number, least=least)
    at = position_mm if at_mm is None else at_mm
    second = _basis(at / length_mm, number + TUNING.free_beyond + TUNING.restrained)[1]
    end_sd = np.full(2, TUNING.end_sd * spacing) if end_sd_mm is None else np.array(end_sd_mm) / length_mm
    value, variance, factor = _over_ends(x, real, error, number + TUNING.free_beyond, end_sd, second)
    per_m2 = (1e3 / length_mm) ** 2
    return Curvature(at, per_m2 * value, per_m2 * np.sqrt(variance), factor)


def _unknown_ends(x: FloatArray, spacing: float) -> Refusal | None:
    """Why the boundary conditions at the ends are unknown; None where the stations reach both."""
    if not spacing > 0.0:
        return Reason.UNKNOWN_LENGTH()
    if max(x.min(), 1.0 - x.max()) <= TUNING.largest_gap * spacing and x.min() >= 0.0 and x.max() <= 1.0:
        return None
    return Reason.UNKNOWN_ENDS(first_percent=100.0 * x.min(), last_percent=100.0 * x.max())


def _dominant(x: FloatArray, real: FloatArray, error: FloatArray) -> int:
    """Number of the mode that contributes most, from 1."""
    count = max(x.size // 2, 1)
    shapes = _modes(x, count)[0] / error[:, None]
    return int(np.argmax(np.abs(np.linalg.lstsq(shapes, real / error, rcond=None)[0]))) + 1


def _over_ends(
    x: FloatArray, real: FloatArray, error: FloatArray, free: int, end_sd: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Curvature with the basis `second`, its variance, and the scatter relative to the sd, over places of the ends."""
    means, variances, factors = [], [], []
    # Four places with the mean and the covariance of their errors.
    for first, last in np.sqrt(2.0) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * end_sd:
        shapes = _basis(x + first * (1.0 - x) + last * x, free + TUNING.restrained)[0]
        mean, covariance, factor = _averaged(shapes, real, error, free)
        means.append(second @ mean)
        variances.append(np.einsum("nk,kj,nj->n", second, covariance, second))
        factors.append(factor)
    variance = np.mean(variances, axis=0) + np.var(means, axis=0)
    return np.mean(means, axis=0), variance, float(np.mean(factors))


def _averaged(
    shapes: FloatArray, real: FloatArray, error: FloatArray, free: int
) -> tuple[FloatArray, FloatArray, float]:
    """Amplitudes, their covariance and the scatter relative to the sd, over the scales of the restrained modes."""
    roots = _roots(shapes.shape[1] - 1)
    fits = []
    for scale in _SCALES * float(np.max(np.abs(real))):
        prior = np.zeros(shapes.shape[1])
        prior[free:-1] = (roots[free:] / roots[free - 1]) ** (2.0 * TUNING.fall) / scale**2
        fits.append(_fitted(shapes / error[:, None], real / error, prior))
    weights = np.array([fit.log_evidence for fit in fits])
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()
    each = np.stack([fit.mean for fit in fits])
    mean = weights @ each
    covariance = np.einsum("f,fkj->kj", weights, np.stack([fit.covariance for fit in fits]))
    covariance += (weights * (each - mean).T) @ (each - mean)
    return mean, covariance, float(weights @ np.array([fit.noise_factor for fit in fits]))


def _fitted(design: FloatArray, aim: FloatArray, prior: FloatArray) -> _Fit:
    """Least squares of values with an sd of 1, with the inverse prior variances of the amplitudes."""
    factor = 1.0
    for _ in range(TUNING.passes):
        normal = design.T @ design / factor**2 + np.diag(prior)
        decomposed = cho_factor(normal)
        mean = cho_solve(decomposed, design.T @ aim / factor**2)
        covariance = cho_solve(decomposed, np.eye(prior.size))
        left = aim - design @ mean
        freedom = max(aim.size - float(np.trace(covariance @ (design.T @ design))) / factor**2, 1.0)
        before, factor = factor, max(1.0, float(np.sqrt(left @ left / freedom)))
    misfit = float(left @ left) / before**2 + float(mean @ (prior * mean))
    known = prior[prior > 0.0]
    log_evidence = 0.5 * float(np.sum(np.log(known))) - float(np.sum(np.log(np.diag(decomposed[0]))))
    return _Fit(mean, covariance, log_evidence - 0.5 * misfit - aim.size * np.log(before), before)


def _roots(count: int) -> FloatArray:
    """Wave numbers of a uniform cantilever's modes times its length: cos(b) cosh(b) = -1."""
    roots = (np.arange(count) + 0.5) * np.pi
    for _ in range(8):
        roots -= (np.cos(roots) + 1.0 / np.cosh(roots)) / (-np.sin(roots) - np.tanh(roots) / np.cosh(roots))
    return np.asarray(roots)


def _basis(x: FloatArray, modes: int) -> tuple[FloatArray, FloatArray]:
    """The modes of a uniform cantilever and, last, its deflection by a force at the free end; second derivatives."""
    shapes, bends = _modes(x, modes)
    return np.column_stack([shapes, x**2 * (3.0 - x)]), np.column_stack([bends, 6.0 * (1.0 - x)])


def _modes(x: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Shapes of the modes, mean square 1, and their second derivatives at shares of the length; (k, count).

    Of both exponentials, the growing one is that from the free end: hyperbolic functions would cancel.
    """
    b = _roots(count)
    z = b * x[:, None]
    decay = np.exp(-b)
    below = 1.0 - decay**2 + 2.0 * decay * np.sin(b)
    ratio = (1.0 + decay**2 + 2.0 * decay * np.cos(b)) / below
    hyperbolic = np.exp(z - b) * (np.sin(b) - np.cos(b) - decay) / below + 0.5 * (1.0 + ratio) * np.exp(-z)
    circular = np.cos(z) - ratio * np.sin(z)
    return hyperbolic - circular, b**2 * (hyperbolic + circular)
