"""Proposals from a kernel density of the other half of an ensemble, for few parameters and many walkers."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from emcee.moves import Move
from emcee.state import State
from numpy.typing import NDArray

from tracker.arrays import FloatArray


class KernelMove(Move):  # type: ignore[misc]  # emcee has no types
    """Independence proposal from a Gaussian kernel density of the complementary walkers.

    The move of kombine (Farr & Farr 2015) and of `emcee.moves.KDEMove`, with an autocorrelation time of about 1.5 steps
    where the stretch move has about 30. Implemented here because `scipy.stats.gaussian_kde` and emcee's loop over
    walkers take ten times as long as the likelihood. Bandwidth by Scott's factor. The halves are drawn anew in each
    step, and each is moved given the other, as in `emcee.moves.RedBlueMove`. For samplers with ``vectorize=True``.
    """

    def propose(self, model: Any, state: State) -> tuple[State, NDArray[np.bool_]]:
        """Move both halves of the ensemble once; returns the new state and a mask of the walkers that moved."""
        random = model.random
        coords, log_prob = state.coords, state.log_prob
        n, d = coords.shape
        accepted = np.zeros(n, dtype=bool)
        order = random.permutation(n)
        halves = (order[: n // 2], order[n // 2 :])
        for own, other in (halves, halves[::-1]):
            picks = random.randint(other.size, size=own.size)
            proposed, ratio = _proposals(
                coords[own], coords[other], picks, random.standard_normal((own.size, d))
            )
            new = model.log_prob_fn(proposed)
            take = ratio + new - log_prob[own] > np.log(random.random_sample(own.size))
            coords[own[take]], log_prob[own[take]] = proposed[take], new[take]
            accepted[own[take]] = True
        return state, accepted


@numba.njit(cache=True, error_model="numpy")
def _log_densities(points: FloatArray, centres: FloatArray) -> FloatArray:
    """Log of the sum of unit Gaussian kernels, up to a constant."""
    result = np.empty(points.shape[0])
    distance = np.empty(centres.shape[0])
    for i in range(points.shape[0]):
        nearest = np.inf
        for j in range(centres.shape[0]):
            distance[j] = 0.0
            for axis in range(points.shape[1]):
                distance[j] += (points[i, axis] - centres[j, axis]) ** 2
            nearest = min(nearest, distance[j])
        total = 0.0
        for j in range(centres.shape[0]):
            total += np.exp(-0.5 * (distance[j] - nearest))
        result[i] = np.log(total) - 0.5 * nearest
    return result


@numba.njit(cache=True, error_model="numpy")
def _proposals(
    own: FloatArray, others: FloatArray, picks: NDArray[np.int64], normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Draws from the kernel density of `others`, and the log ratio of that density at the old and the new points."""
    n, d = others.shape
    # Scott's factor for the bandwidth; raises LinAlgError where the walkers coincide.
    factor = np.linalg.cholesky(np.cov(others.T) * n ** (-2.0 / (d + 4)))
    proposed = others[picks] + normals @ factor.T
    whiten = np.ascontiguousarray(np.linalg.inv(factor).T)
    centres = others @ whiten
    return proposed, _log_densities(own @ whiten, centres) - _log_densities(proposed @ whiten, centres)
