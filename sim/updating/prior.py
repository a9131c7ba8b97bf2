"""Prior of the properties: Gaussian in the logarithms of the factors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.updating.uniform_beam import uniform_basis
from tracker import FloatArray

# directions with a prior variance below this share of the largest change no frequency by 1e-6
_NEGLIGIBLE = 1e-8


@dataclass(frozen=True)
class SmoothPrior:
    """Prior of widths and thicknesses that vary smoothly along the beam, and of density and modulus.

    The logarithm of each factor has the standard deviation `sd`, by default half the paper's bound; those of two
    elements have the correlation ``exp(-(ds / l)^2 / 2)``, separately for widths and thicknesses, with l in lengths of
    the beam. An infinite l makes them uniform.
    """

    sd: float = 0.05
    correlation_length: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < self.sd <= 0.3:
            msg = f"sd of the prior must lie between 0 and 0.3, got {self.sd}"
            raise ValueError(msg)
        if not self.correlation_length > 0.0:
            msg = f"correlation_length must be positive, got {self.correlation_length}"
            raise ValueError(msg)

    def basis(self, elements: int) -> FloatArray:
        """Matrix from independent standard normal numbers to the logarithms of the factors, shape (2 ne + 2, k)."""
        if np.isinf(self.correlation_length):
            return self.sd * uniform_basis(elements)
        s = (np.arange(elements) + 0.5) / elements
        distance = (s[:, np.newaxis] - s) / self.correlation_length
        values, vectors = np.linalg.eigh(np.exp(-0.5 * distance**2))
        kept = values > _NEGLIGIBLE * values[-1]
        # smoothest first, with a fixed sign, so that the same numbers give the same field on every machine
        field = (vectors[:, kept] * np.sqrt(values[kept]))[:, ::-1]
        field = field * np.where(np.sum(field, axis=0) < 0.0, -1.0, 1.0)
        k = field.shape[1]
        out = np.zeros((2 * elements + 2, 2 * k + 2))
        out[:elements, :k] = field
        out[elements : 2 * elements, k : 2 * k] = field
        out[-2, -2] = out[-1, -1] = 1.0
        return np.asarray(self.sd * out)
