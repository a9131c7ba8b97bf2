"""Gauss-Newton normal equations of the nonlinear parameters, with everything linear projected out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modal_id.solve.linear import LinearSolution, Problem, projected_grams
from modal_id.solve.weighting import LongArray
from tracker import ComplexArray, FloatArray


def slope_weights(amplitudes: ComplexArray, slope: NDArray[np.intp], factor: ComplexArray) -> FloatArray:
    """Weights that combine real and imaginary parts of slopes into the derivatives of each channel.

    Parameter i changes channel k by ``Re(amplitudes[i, k] factor[i] s)``, where s is the function with index
    ``slope[i]``; `amplitudes` has shape (q, k), the result (k, 2 slopes, q).
    """
    result = np.zeros((amplitudes.shape[1], 2 * int(np.max(slope, initial=-1) + 1), slope.size))
    place = np.arange(slope.size)
    value = (amplitudes * factor[:, None]).T
    result[:, 2 * slope, place] = value.real
    result[:, 2 * slope + 1, place] = -value.imag
    return result


def normal_equations(
    problem: Problem, linear: LinearSolution, columns: LongArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fisher information of the parameters, shape (q, q), and gradient of the log likelihood, shape (q,).

    `columns`, shape (n, c), are the real and imaginary parts of the slopes; `weights`, shape (k, c, q), are from
    `slope_weights`.
    """
    q = weights.shape[2]
    information, gradient = np.zeros((q, q)), np.zeros(q)
    grams = projected_grams(problem, linear, columns)
    for (channels, _), (gram, score) in zip(problem.data.groups, grams, strict=True):
        own = weights[channels]
        weighted = own / linear.noise_variance[channels, None, None]
        information += np.tensordot(weighted, gram @ own, axes=((0, 1), (0, 1)))
        gradient += np.tensordot(weighted, score.T, axes=((0, 1), (0, 1)))
    return information, gradient
