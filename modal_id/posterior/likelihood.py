"""Likelihood of one mode's pole from moments about the fitted pole, which replace the samples exactly."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modal_id.posterior.noise import NoiseLevel
from modal_id.posterior.reduction import ReducedLikelihood, Reduction, reduction
from modal_id.solve import ModeColumns, PoleFit, Problem, pole, solve_linear, thinning
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the likelihood."""

    #: [1] relative size of the first neglected term of the series
    #: physics: Far below a change of the log likelihood that matters.
    remainder: float = 1e-9
    #: [1] largest number of terms of the series
    max_terms: int = 60
    #: [1] logarithm of the largest energy of a wave, or density, over one that is negligible
    #: physics: exp(-13.8) = 1e-6.
    negligible: float = 13.8
    #: [1] side of a tile over its least decay rate
    #: physics: Its diagonal times the time in which the slowest wave becomes negligible is then 2.5.
    side: float = 0.25
    #: [1] number of terms within a tile
    #: physics: They leave the same remainder.
    tile_terms: int = 20
    #: [1] largest number of samples in all tiles together
    #: convention: Limits the memory.
    max_tile_samples: int = 4_000_000


TUNING = Tuning()
NEGLIGIBLE = TUNING.negligible


class Likelihood(Protocol):
    """Weighted residual sum of squares of one mode's pole, all other parameters eliminated."""

    @property
    def centre_per_s(self) -> complex:
        """The fitted pole."""

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """Residual sum of squares over the noise variance for poles ``centre + change``; shape (w,) in and out."""


@dataclass(frozen=True)
class TiledLikelihood:
    """Likelihood of a pole that is too uncertain for one series: a series for each square tile of the complex plane.

    A wave that decays faster is shorter, and its tile larger: from one octave of decay rates to the next, the side
    doubles. Below `least_per_s`, all waves last as long as the record. Tiles are computed when a pole first lies in
    them; their values do not depend on the order.
    """

    reduction: Reduction
    centre_per_s: complex
    least_per_s: float
    tiles: dict[tuple[float, complex], ReducedLikelihood] = field(default_factory=dict)

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """As in `Likelihood`."""
        poles = self.centre_per_s + change_per_s
        side = _side(poles.real, self.least_per_s)
        place = np.floor(poles.real / side) + 1j * np.floor(poles.imag / side)
        result = np.empty(poles.size)
        for width, corner in {*zip(side.tolist(), place.tolist(), strict=True)}:
            here = (side == width) & (place == corner)
            middle = width * (corner + 0.5 + 0.5j)
            tile = (width, corner)
            if tile not in self.tiles:
                self.tiles[tile] = self.reduction.about(middle, TUNING.tile_terms)
            result[here] = self.tiles[tile].chi_square(poles[here] - middle)
        return result


def reduce_mode(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> Likelihood | None:
    """Likelihood of the pole with index `mode`.

    `close` are the indices of the poles whose uncertainty contributes to that of this one, `reach_per_s` is the largest
    change of the pole for which the likelihood must hold. Where one series would need more than 60 terms, because the
    pole is hardly determined, the plane is divided into tiles, and neighbouring samples are averaged to 24 per cycle,
    which costs 0.3 % of the information. None when even that takes too long.
    """
    centre = complex(fit.poles[mode])
    time = problem.data.time_s
    # The series must hold for the slowest wave, too, which lasts longest.
    terms = _terms_needed(time, min(centre.real + reach_per_s, 0.0), reach_per_s)
    if terms is not None:
        return reduction(problem, fit, mode, close).about(centre, terms)
    factor = thinning(time, 2.0 * fit.poles)
    if factor > 1:
        problem = problem.thinned(factor)
        linear = solve_linear(problem, ModeColumns(problem.data.time_s, fit.poles))
        # The weights of averages count their samples: the variance of one is that of the whole fit.
        fit = replace(fit, linear=replace(linear, noise_variance=fit.linear.noise_variance))
    least = 0.5 * NEGLIGIBLE / problem.data.span_s
    tiles = (2.0 * reach_per_s / float(_side(np.array(centre.real), least)) + 1.0) ** 2
    if tiles * problem.data.time_s.size > TUNING.max_tile_samples:
        return None
    return TiledLikelihood(reduction(problem, fit, mode, close), centre, least)


def _side(real_per_s: FloatArray, least_per_s: float) -> FloatArray:
    """Side of the tile that holds a pole with this real part."""
    octave = np.floor(np.log2(np.maximum(-real_per_s / least_per_s, 1.0)))
    return np.asarray(TUNING.side * least_per_s * 2.0**octave)


def _terms_needed(time_s: FloatArray, growth_per_s: float, reach_per_s: float) -> int | None:
    # The radius is set by the time at which the wave has lost its energy; doubled for exp(2 lambda t).
    radius, size = 2.0 * reach_per_s * _last_s(time_s, growth_per_s), 1.0
    for power in range(1, TUNING.max_terms):
        size *= radius / power
        if size < TUNING.remainder and power >= 6:
            return power + 1
    return None


def _last_s(time_s: FloatArray, growth_per_s: float) -> float:
    """Time after which a millionth of the energy of a wave is left."""
    energy = np.gradient(time_s)
    energy *= np.exp(2.0 * growth_per_s * time_s)
    np.cumsum(energy, out=energy)
    return float(
        time_s[min(int(np.searchsorted(energy, (1.0 - np.exp(-NEGLIGIBLE)) * energy[-1])), time_s.size - 1)]
    )


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
