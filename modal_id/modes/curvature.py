"""Curvature of a mode shape that is known at many places along a cantilever, with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from modal_id.modes.shapes import in_phase
from tracker import ComplexArray, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Shapes between the stations."""

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
    #: [1] number of passes
    passes: int = 3
    #: [1] sd of the position of either end, over the mean distance of stations
    #: physics: A px where a station has five.
    end_sd: float = 0.2


TUNING = Tuning()

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
    reason = _unknown_ends(x, spacing)
    if reason:
        return Failure(reason)
    real = np.real(in_phase(values, error))
    number = _dominant(x, real, error)
    least = number + TUNING.free_beyond + TUNING.more_stations
    if x.size < least:
        return Failure(f"{x.size} stations are too few for a shape of mode {number}: {least} are needed")
    at = position_mm if at_mm is None else at_mm
    second = _basis(at / length_mm, number + TUNING.free_beyond + TUNING.restrained)[1]
    end_sd = np.full(2, TUNING.end_sd * spacing) if end_sd_mm is None else np.array(end_sd_mm) / length_mm
    value, variance, factor = _over_ends(x, real, error, number + TUNING.free_beyond, end_sd, second)
    per_m2 = (1e3 / length_mm) ** 2
    return Curvature(at, per_m2 * value, per_m2 * np.sqrt(variance), factor)


def _unknown_ends(x: FloatArray, spacing: float) -> str:
    """Why the boundary conditions at the ends are unknown; empty where the stations reach both."""
    if not spacing > 0.0:
        return "the free length of the beam, or the places of the stations along it, are unknown"
    if max(x.min(), 1.0 - x.max()) <= TUNING.largest_gap * spacing and x.min() >= 0.0 and x.max() <= 1.0:
        return ""
    return (
        f"the stations reach from {100.0 * x.min():.0f} to {100.0 * x.max():.0f} % of the free length: what the beam "
        "does at an end that they do not show is unknown"
    )


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
