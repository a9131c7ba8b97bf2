"""Errors of tracked positions that repeat with the motion: estimated with the modes; what they add to the poles' sd."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from modal_id.data.prepare import Projection
from modal_id.fit.model_order import ModalFit, refit
from modal_id.fit.poles import mode_functions, pole_slopes
from tracker.arrays import FloatArray
from tracker.results import PositionErrors

# The shrinkage by a codec is a smooth function of asinh(amplitude / (this number * its sd)), the logarithm of large
# amplitudes, and hardly changes below this number of sd. Correlation length in that variable, spacing of knots.
_SMALL = 5.0
_CORRELATION, _SPACING = 0.6, 0.5


@dataclass(frozen=True)
class _Channel:
    """Normal equations of one channel: poles and shared unknowns first, then its own periodic error."""

    own: FloatArray
    shared: FloatArray
    gram: FloatArray
    score: FloatArray


def without_repeating_errors(
    model: ModalFit, errors: PositionErrors, channels: NDArray[np.intp], mixed: Projection | None = None
) -> ModalFit:
    """Fit of the modes with the errors of positions marginalised.

    Parameters
    ----------
    errors : PositionErrors
        Of all channels of the series.
    channels : int array, shape (k,)
        Index in the series of each channel of `model`; with `mixed`, of each channel that its components stand for.
    mixed : Projection or None
        Of the channels on the components of `model`.

    Returns
    -------
    ModalFit
        Fitted to data less the most probable errors. ``repeating`` is the covariance of (Re, Im) of each pole in turn
        due to the remaining uncertainty of the errors, to be added to that of noise.

    Notes
    -----
    Every error is a sum of known functions of time with normal coefficients of known variance: one linear
    least-squares step from the fit, jointly for poles, amplitudes, baselines and these coefficients. The periodic
    error of each marker has its own coefficients, which show in the harmonics of the motion; the shrinkage of small
    motions by a predictive codec is one function of the amplitude for all markers, and ends where the motion is fast.
    The errors add the marginal less the conditional covariance of the poles. The periodic errors of many channels, each
    with its own coefficients, average out in their components: they are not estimated, but the covariance that they
    cause is added.
    """
    q, data = 2 * model.fit.poles.size, model.data
    parts = _channels(model, errors, channels, mixed)
    shared = parts[0].shared.shape[1]
    information, gradient = np.zeros((q + shared, q + shared)), np.zeros(q + shared)
    information[q:, q:] += np.eye(shared)
    eliminated = []
    for part in parts:
        first = slice(0, q + shared)
        own = part.gram[q + shared :, q + shared :] + np.eye(part.own.shape[1])
        cross = part.gram[first, q + shared :]
        bound = np.linalg.solve(own, np.column_stack([cross.T, part.score[q + shared :]]))
        information += part.gram[first, first] - cross @ bound[:, :-1]
        gradient += part.score[first] - cross @ bound[:, -1]
        eliminated.append(bound)
    covariance = np.linalg.pinv(information, hermitian=True)
    solution = covariance @ gradient
    values = data.values.copy()
    for k, (part, bound) in enumerate(zip(parts, eliminated, strict=True)):
        own = bound[:, -1] - bound[:, :-1] @ solution
        values[:, k] -= part.own @ own + part.shared @ solution[q:]
    corrected = replace(data, values=np.where(data.weights > 0.0, values, data.values))
    fitted = refit(model, model.fit.poles, corrected)
    repeating = covariance[:q, :q] - model.fit.covariance
    if mixed is not None:
        repeating = repeating + _of_periodic_errors(model, errors, channels, mixed)
    return replace(fitted, repeating=_positive(repeating))


def _channels(
    model: ModalFit, errors: PositionErrors, channels: NDArray[np.intp], mixed: Projection | None
) -> list[_Channel]:
    linear, data = model.fit.linear, model.data
    slopes, weights = pole_slopes(data.time_s, linear)
    group_of = {int(c): group for group, (members, _) in enumerate(data.groups) for c in members}
    own_errors = _amplitude_errors(model, errors, channels, mixed)
    if mixed is None:
        shapes = list(own_errors)
        motion = np.real(mode_functions(data.time_s, model.fit.poles) @ linear.amplitudes) + linear.baseline
    else:
        shapes = _summed(own_errors, mixed.from_channels)
    found = []
    for k in range(data.values.shape[1]):
        scale = 1.0 / np.sqrt(linear.noise_variance[k])
        own = (
            errors.periodic(int(channels[k]), motion[:, k])
            if mixed is None
            else np.zeros((data.time_s.size, 0))
        )
        columns = np.column_stack([slopes @ weights[k], shapes[k], own])
        gram, score = _projected(model, group_of[k], k, scale * columns)
        found.append(_Channel(own, shapes[k], gram, scale * score))
    return found


def _summed(columns: Iterable[FloatArray], weights: FloatArray) -> list[FloatArray]:
    """Sums over channels of their columns times the weights, shape (r, k), for each of r components."""
    total: list[FloatArray] = []
    for own, of_channel in zip(columns, weights.T, strict=True):
        parts = [weight * own for weight in of_channel]
        total = parts if not total else [one + part for one, part in zip(total, parts, strict=True)]
    return total


def _of_periodic_errors(
    model: ModalFit, errors: PositionErrors, channels: NDArray[np.intp], mixed: Projection
) -> FloatArray:
    """Covariance of the poles, shape (2 m, 2 m), due to the periodic errors of the channels behind components."""
    linear, data, problem = model.fit.linear, model.data, model.problem
    slopes, weights = pole_slopes(data.time_s, linear)
    group_of = {int(c): group for group, (members, _) in enumerate(data.groups) for c in members}
    sensitivity = []
    for k in range(data.values.shape[1]):
        part, own = problem.slow[group_of[k]], linear.factors[group_of[k]]
        columns = slopes @ weights[k]
        weighted = data.weights[:, k : k + 1] * columns
        cross = problem.sparse.T @ weighted
        fast = cho_solve(own.factor, linear.columns.T @ weighted - own.slow.T @ cross, check_finite=False)
        slow = part.factor.solve(cross) - own.slow @ fast
        left = columns - linear.columns @ fast - problem.sparse @ slow
        sensitivity.append(data.weights[:, k : k + 1] * left / linear.noise_variance[k])
    components = np.real(mode_functions(data.time_s, model.fit.poles) @ linear.amplitudes)
    score = np.zeros((2 * model.fit.poles.size,) * 2)
    for channel, to_channel, weight in zip(channels, mixed.to_channels, mixed.from_channels.T, strict=True):
        periodic = errors.periodic(int(channel), components @ to_channel)
        own_score = sum(w * s for w, s in zip(weight, sensitivity, strict=True)).T @ periodic
        score += own_score @ own_score.T
    return np.asarray(model.fit.covariance @ score @ model.fit.covariance)


def _projected(model: ModalFit, group: int, k: int, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of the columns of one channel, its mode functions and baseline projected out, and their score."""
    problem, linear = model.problem, model.fit.linear
    part, own = problem.slow[group], linear.factors[group]
    weighted = model.data.weights[:, k : k + 1] * columns
    cross = problem.sparse.T @ weighted
    mixed = linear.columns.T @ weighted - own.slow.T @ cross
    gram = weighted.T @ columns - cross.T @ part.factor.solve(cross)
    gram -= mixed.T @ cho_solve(own.factor, mixed, check_finite=False)
    return gram, weighted.T @ linear.residual[:, k]


def _amplitude_errors(
    model: ModalFit, errors: PositionErrors, channels: NDArray[np.intp], mixed: Projection | None
) -> Iterator[FloatArray]:
    """For each channel the functions of time of the errors in and out of phase with each mode; shape (n, q)."""
    sd, amplitudes = errors.shrinkage_sd[channels], model.fit.linear.amplitudes
    if mixed is not None:
        amplitudes = amplitudes @ mixed.to_channels.T
    time_s, poles = model.data.time_s, model.fit.poles
    strong = np.flatnonzero(np.max(np.abs(amplitudes) - sd, axis=1) > 0.0)
    if not np.any(sd > 0.0) or strong.size == 0:
        yield from (np.zeros((time_s.size, 0)) for _ in channels)
        return
    growth = max(1.0, float(np.max(np.exp(poles.real * model.data.span_s))))
    largest = growth * float(np.max(np.abs(amplitudes[strong]) / (_SMALL * sd)))
    knots = np.arange(0.0, np.arcsinh(largest) + _SPACING, _SPACING)
    root = np.linalg.cholesky(_kernel(knots, knots) + 1e-6 * np.eye(knots.size))
    functions = mode_functions(time_s, poles)
    # Of a sampled sine from one frame to the next, whether it is aliased or not.
    steps = np.abs(functions * (np.exp(1j * poles.imag * errors.frame_s) - 1.0)) ** 2
    for k, channel in enumerate(channels.tolist()):
        columns = []
        omitted = errors.omitted(channel, np.sqrt(steps @ np.abs(amplitudes[:, k]) ** 2))
        for mode in strong:
            motion = amplitudes[mode, k] * functions[:, mode]
            size = np.abs(motion)
            wave = motion / np.maximum(size, 1e-300)
            smooth = np.linalg.solve(root, _kernel(knots, np.arcsinh(size / (_SMALL * sd[k]))))
            smooth *= omitted
            columns += [(sd[k] * wave.real * smooth).T, (errors.lag_sd[channel] * wave.imag * smooth).T]
        yield np.column_stack(columns)


def _kernel(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((one[:, None] - other[None, :]) / _CORRELATION) ** 2))


def _positive(covariance: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues: rounding may leave small ones."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
