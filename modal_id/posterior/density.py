"""Posterior density of natural frequency and damping ratio of a mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.posterior.likelihood import Likelihood
from modal_id.posterior.noise import NoiseLevel
from modal_id.solve import pole
from tracker import FloatArray

# Positions further than this from the best fit are outside the likelihood's series of moments, which may have any
# value there; in Laplace's standard deviations.
REACH_SD = 10.0


@dataclass(frozen=True)
class PoleDensity:
    """Log posterior density of (omega_n, zeta), in units of their Laplace standard deviations from the best fit.

    Notes
    -----
    The prior is flat in (omega_n, zeta) for zeta > 0, and flat in the amplitudes measured by their energy in the record
    (the conditional reference prior). With a prior flat in the amplitudes themselves each channel would bias zeta
    upwards by the factor |G|^(-1/2) of its Gram matrix, and the bias would grow with the number of markers. The noise
    level near the mode is estimated with a finite number of degrees of freedom; marginalised over it (Jeffreys' prior),
    the density is Student's t in the increase of chi-square.
    """

    likelihood: Likelihood
    centre: tuple[float, float]
    scale: tuple[float, float]
    noise: NoiseLevel
    chi_square_min: float

    def __call__(self, position: FloatArray) -> FloatArray:
        """Log density, shape (w,), for positions of shape (w, 2); -inf where zeta <= 0 or out of reach."""
        omega, zeta = (self.centre[i] + self.scale[i] * position[:, i] for i in range(2))
        inside = np.hypot(*position.T) < REACH_SD
        inside &= (zeta > 0.0) & (zeta < 1.0) & (omega > 0.0)
        change = np.where(
            inside, pole(omega, np.where(inside, zeta, 0.0)) - self.likelihood.centre_per_s, 0.0
        )
        increase = self.likelihood.chi_square(change) - self.chi_square_min
        argument = increase / (self.noise.dof * self.noise.factor**2)
        value = -0.5 * (self.noise.dof + 2.0) * np.log1p(np.maximum(argument, -0.5))
        return np.where(inside & np.isfinite(value), value, -np.inf)
