"""A random pattern on a surface, whose image through a lens is known in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import FloatArray

# waves in the sum: enough for a nearly normal distribution of gray levels
_WAVES = 96


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Random pattern of gray levels with mean 0, the same for the same seed.

    Attributes
    ----------
    sd : float
        Standard deviation in counts.
    grain_mm : float
        Correlation length g: the correlation at distance r is ``exp(-r^2 / (2 g^2))``.
    seed : int

    Notes
    -----
    A sum of waves with random directions, lengths and phases and equal amplitudes (Rahimi and Recht, Random features
    for large-scale kernel machines, 2007). A Gaussian point spread function multiplies each wave by a number.
    """

    sd: float
    grain_mm: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sd) and self.sd >= 0.0):
            msg = f"sd of a texture must be finite and not negative, got {self.sd}"
            raise ValueError(msg)
        if not (np.isfinite(self.grain_mm) and self.grain_mm > 0.0):
            msg = f"grain_mm of a texture must be finite and positive, got {self.grain_mm}"
            raise ValueError(msg)

    @property
    def step_mm(self) -> float:
        """Distance of samples between which cubic interpolation is exact to ``0.0234 h^4 3 / g^4``: 2e-5 of `sd`."""
        return self.grain_mm / 8.0

    def on_grid(
        self,
        x_mm: FloatArray,
        y_mm: FloatArray,
        *,
        box_mm: float = 0.0,
        blur_mm: float = 0.0,
    ) -> FloatArray:
        """Counts at all pairs of `x_mm`, (c,), and `y_mm`, (r,), shape (r, c).

        Averaged over a square of the side `box_mm` and blurred by a Gaussian of the standard deviation `blur_mm`.
        """
        rng = np.random.default_rng(self.seed)
        # an even spread of wave lengths, whatever the seed
        radius = np.sqrt(-2.0 * np.log((np.arange(_WAVES) + 0.5) / _WAVES)) / self.grain_mm
        direction = np.pi * (np.arange(_WAVES) * (np.sqrt(5.0) - 1.0) + rng.uniform())
        phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        kx, ky = radius * np.cos(direction), radius * np.sin(direction)
        amplitude = self.sd * np.sqrt(2.0 / _WAVES) * np.exp(-0.5 * (blur_mm * radius) ** 2)
        amplitude *= np.sinc(kx * box_mm / (2.0 * np.pi)) * np.sinc(ky * box_mm / (2.0 * np.pi))
        along_y = np.asarray(y_mm)[:, None] * ky
        along_x = np.asarray(x_mm)[:, None] * kx + phase
        return np.asarray(
            (np.cos(along_y) * amplitude) @ np.cos(along_x).T
            - (np.sin(along_y) * amplitude) @ np.sin(along_x).T
        )
