"""Whether the modes beside a band explain its spectrum: their coherent responses far from resonance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.ambient.expected import transfer
from modal_id.ambient.model import BandData, BandFit, spectrum
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Iteration."""

    #: [1] largest number of steps
    steps: int = 40
    #: [1] largest number of halvings of a step
    halvings: int = 10
    #: [1] gain in log likelihood that ends it
    #: statistics: A tenth of the gain that moves a parameter by one sd.
    converged: float = 0.05


TUNING = Tuning()


def log_odds_over_tails(fit: BandFit, beside: list[tuple[float, float]]) -> float:
    """Logarithm of the odds of the modes of a band over the tails of modes beside it, by the Schwarz criterion of both.

    Parameters
    ----------
    fit : BandFit
    beside : list of (float, float)
        Frequency in Hz and damping ratio of modes outside the band.

    Notes
    -----
    Far from resonance a receptance h is real, and the spectrum of noise and of modes whose forces are coherent is
    ``N + sum of h_i h_j S_ij`` with real symmetric matrices: two modes on both sides have a minimum between them, in a
    direction that changes, which the power laws of a band's background do not follow. It is linear in the matrices,
    whose likelihood is maximised by least squares that are weighted again in each step.
    """
    data, r = fit.data, fit.data.size
    pairs = np.array(
        [np.real(transfer(data.frequency_hz, *one, data.samples, data.step_s)) for one in beside]
    )
    rows, columns = np.triu_indices(len(beside))
    factors = np.concatenate([np.ones((1, data.bins.size)), pairs[rows] * pairs[columns]])
    factors /= np.linalg.norm(factors, axis=1)[:, None]
    above, across = np.triu_indices(r)
    basis = np.zeros((above.size, r, r))
    basis[np.arange(above.size), above, across] = basis[np.arange(above.size), across, above] = 1.0
    likelihood = _most_likely(data, factors, basis)
    parameters = fit.model.vector.size - len(factors) * len(basis)
    gain = _log_likelihood(spectrum(fit.model, data), data) - likelihood
    return gain - 0.5 * parameters * float(np.log(np.sum(data.bins)))


def _most_likely(data: BandData, factors: FloatArray, basis: FloatArray) -> float:
    """Largest log likelihood of sums of factors, shape (c, g), times symmetric matrices, by Fisher scoring."""

    def matrix(values: FloatArray) -> FloatArray:
        matrices = np.tensordot(values.reshape(len(factors), -1), basis, 1)
        return np.asarray(np.tensordot(factors.T, matrices, 1), dtype=np.float64)

    mean = np.real(np.sum(data.cross, axis=0)) / np.sum(data.bins)
    values = np.zeros(len(factors) * len(basis))
    values[: len(basis)] = np.sum(mean * basis, axis=(1, 2)) / np.sum(basis, axis=(1, 2)) / factors[0, 0]
    best = _log_likelihood(matrix(values), data)
    seen = np.real(data.cross) / data.bins[:, None, None]
    root = np.sqrt(data.bins)[:, None]
    for _ in range(TUNING.steps):
        inverse = np.linalg.inv(np.linalg.cholesky(matrix(values)))
        white = inverse @ seen @ np.swapaxes(inverse, 1, 2)
        terms = inverse[:, None] @ basis @ np.swapaxes(inverse, 1, 2)[:, None]
        terms = terms.reshape(*terms.shape[:2], -1) * root[:, :, None]
        design = np.moveaxis(factors.T[:, :, None, None] * terms[:, None], 3, 1)
        design = design.reshape(design.shape[0] * design.shape[1], -1)
        scale = np.linalg.norm(design, axis=0)
        change = np.linalg.lstsq(design / scale, (white.reshape(len(white), -1) * root).ravel(), rcond=1e-10)
        step, before = change[0] / scale - values, best
        for halving in range(TUNING.halvings):
            trial = values + 0.5**halving * step
            reached = _log_likelihood(matrix(trial), data)
            if reached > best:
                best, values = reached, trial
                break
        if best - before < TUNING.converged:
            break
    return best


def _log_likelihood(matrix: FloatArray | ComplexArray, data: BandData) -> float:
    """Of the band, without priors and constants; minus infinity where a matrix is not positive."""
    values = np.linalg.eigvalsh(matrix)
    if not np.all(values > 0.0):
        return -np.inf
    fit = np.real(np.trace(np.linalg.solve(matrix, data.cross), axis1=1, axis2=2))
    return float(-np.sum(data.bins * np.sum(np.log(values), axis=1) + fit))
