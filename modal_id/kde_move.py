"""Proposal from a kernel density of the other half of an ensemble, for few parameters and many walkers."""

from __future__ import annotations

from typing import Any

import numpy as np
from emcee.moves import RedBlueMove
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class KernelMove(RedBlueMove):  # type: ignore[misc]
    """Independence proposal from a Gaussian kernel density of the complementary walkers.

    The move of kombine (Farr & Farr 2015) and of `emcee.moves.KDEMove`, whose autocorrelation time is near 1.5
    steps where the stretch move has some 30. Written out in NumPy because `scipy.stats.gaussian_kde` spends
    ten times the time of the likelihood on setting itself up. Scott's factor for the bandwidth.
    """

    def get_proposal(
        self, sample: FloatArray, complement: list[FloatArray], random: Any
    ) -> tuple[FloatArray, FloatArray]:
        """Proposed positions and log ratio of the proposal density at the old and the new ones."""
        others = np.concatenate(complement, axis=0)
        n, d = others.shape
        factor = np.linalg.cholesky(np.cov(others.T) * n ** (-2.0 / (d + 4)))
        centres = others[random.randint(n, size=sample.shape[0])]
        proposed = centres + random.standard_normal(sample.shape) @ factor.T
        inverse = np.linalg.inv(factor)
        both = np.concatenate([sample, proposed]) @ inverse.T
        distance = np.sum((both[:, None, :] - (others @ inverse.T)[None, :, :]) ** 2, axis=2)
        nearest = np.min(distance, axis=1)
        density = np.log(np.sum(np.exp(-0.5 * (distance - nearest[:, None])), axis=1)) - 0.5 * nearest
        return proposed, density[: sample.shape[0]] - density[sample.shape[0] :]
