r"""Place and size of one point mass that the description of a beam lacks, from its measured modes.

The prior of the place s is uniform along the beam, that of the mass m half normal, and widths, thicknesses, density
and modulus have the prior of the Bayesian update. A mass at s lowers a frequency by
``m phi_r(s)^2 / 2`` of itself, which as a function of s has as many maxima as the mode: the posterior has several
separate parts. It is therefore computed on a grid of places, at each of which Laplace's approximation gives the
marginal likelihood over the mass and all properties and the conditional distribution of the mass, a normal one
truncated at zero; cells with much probability, or about a maximum, are divided. Where a mass does not improve the fit,
the approximation is that about the beam without it.

Where both ends are alike, frequencies are the same for the place L - s, and both are found; shapes decide between them.
A mass and a smooth change of the section are told apart only as far as the prior of the sections excludes the latter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtr, ndtri

from sim.beam import BeamProperties, PointMass
from sim.updating.bayesian import whiten
from sim.updating.least_squares import Misfit
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import Maximum, SmoothPrior, maximum
from tracker import INTERVAL_ENDS, INTERVAL_LEVEL, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Prior of the mass and grid of its places."""

    #: [mass of the beam] scale of the half-normal prior, its rms
    #: convention: A sensor or marker on a beam: 90 % below a sixth of the beam's mass.
    scale: float = 0.1
    #: [scale] a smaller mass is not tried
    #: physics: Far below what a frequency shows.
    smallest: float = 1e-6
    #: [scale] a larger mass is not tried
    #: physics: Four fifths of the beam's mass, eight standard deviations of the prior.
    largest: float = 8.0
    #: [cells] first grid, for each number of the highest measured mode
    #: physics: The squared shape of a mode has as many maxima as its number: six places for each.
    per_maximum: int = 6
    #: [1] probability of a cell above which it is divided into three
    #: statistics: The probability of a 90 % region is off by part of a cell at its border.
    largest_share: float = 0.04
    #: [1] difference of the log likelihood to a neighbour above which a maximum is divided
    #: statistics: The likelihood at one sd from its maximum: the cell no longer hides one.
    steep: float = 0.5
    #: [ln] distance of a maximum from the largest one above which it is left as it is
    #: statistics: A probability of e^-30 changes no region.
    hopeless: float = 30.0
    #: [cells] largest grid
    #: convention: Limits the computing time: a place costs some ms.
    most: int = 400
    #: [1] draws from which regions and intervals are made
    #: statistics: The probability of a 90 % region is known to 0.5 %.
    draws: int = 4000


TUNING = Tuning()
_DEFAULT_PRIOR = SmoothPrior()


@dataclass(frozen=True)
class Region:
    """A connected part of the likely places: limits, 90 % interval of the mass there, and its probability."""

    low_m: float
    high_m: float
    mass_low_kg: float
    mass_high_kg: float
    probability: float


@dataclass(frozen=True)
class PointMassPosterior:
    """Posterior of the place and size of one point mass.

    Attributes
    ----------
    position_m, cell_m : array, shape (k,)
        Middles of the cells, from the first end, and their lengths.
    weight : array, shape (k,)
        Probability of each cell.
    mass_kg, mass_sd_kg : array, shape (k,)
        Mean and sd of the normal distribution that, truncated at zero, the mass has in each cell; the mean is negative
        where a mass does not improve the fit.
    log_odds : float
        Logarithm of the odds of a beam with this mass against one without it, equal before the measurement.
    """

    position_m: FloatArray
    cell_m: FloatArray
    weight: FloatArray
    mass_kg: FloatArray
    mass_sd_kg: FloatArray
    log_odds: float
    seed: int = 0

    @property
    def most_probable(self) -> PointMass:
        """At the middle of the cell of the largest density, with the most probable mass there."""
        at = int(np.argmax(self.weight / self.cell_m))
        return PointMass(float(self.position_m[at]), max(0.0, float(self.mass_kg[at])))

    @cached_property
    def draws(self) -> tuple[FloatArray, FloatArray]:
        """Draws of the places in m and the masses in kg."""
        rng = np.random.default_rng(self.seed)
        cell = rng.choice(self.weight.size, TUNING.draws, p=self.weight)
        place = self.position_m[cell] + self.cell_m[cell] * rng.uniform(-0.5, 0.5, TUNING.draws)
        mean, sd = self._mass_at(place)
        below = rng.uniform(size=TUNING.draws) * ndtr(mean / sd)
        return place, np.maximum(0.0, mean - sd * ndtri(np.maximum(below, np.finfo(float).tiny)))

    def credibility(self, position_m: float, mass_kg: float) -> float:
        """Probability of the smallest region that reaches this place and mass: below 0.9 inside that of 90 %."""
        density = self._log_density(*self.draws)
        at = self._log_density(np.array([position_m]), np.array([mass_kg]))
        return float(np.mean(density > at))

    def regions(self, level: float = INTERVAL_LEVEL) -> tuple[Region, ...]:
        """Smallest set of places with the probability `level`, its connected parts in order of probability."""
        order = np.argsort(-self.weight / self.cell_m, kind="stable")
        inside = np.zeros(order.size, dtype=np.bool_)
        inside[order[: 1 + int(np.searchsorted(np.cumsum(self.weight[order]), level))]] = True
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
        place, mass = self.draws
        found = []
        for first, end in zip(edges[0::2], edges[1::2], strict=True):
            low = float(self.position_m[first] - 0.5 * self.cell_m[first])
            high = float(self.position_m[end - 1] + 0.5 * self.cell_m[end - 1])
            there = mass[(place >= low) & (place <= high)]
            limits = np.quantile(there, INTERVAL_ENDS) if there.size else np.full(2, np.nan)
            share = float(np.sum(self.weight[first:end]))
            found.append(Region(low, high, float(limits[0]), float(limits[1]), share))
        return tuple(sorted(found, key=lambda region: -region.probability))

    def _mass_at(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = (self.mass_kg, self.mass_sd_kg)
        mean, sd = (np.interp(position_m, self.position_m, value) for value in values)
        return mean, sd

    def _log_density(self, position_m: FloatArray, mass_kg: FloatArray) -> FloatArray:
        density = np.maximum(self.weight, np.finfo(float).tiny) / self.cell_m
        place = np.interp(position_m, self.position_m, np.log(density))
        mean, sd = self._mass_at(position_m)
        return np.asarray(place - 0.5 * ((mass_kg - mean) / sd) ** 2 - np.log(sd) - log_ndtr(mean / sd))


def find_point_mass(
    properties: BeamProperties,
    measured: MeasuredModes,
    *,
    prior: SmoothPrior = _DEFAULT_PRIOR,
    seed: int = 0,
) -> PointMassPosterior:
    """Posterior of a point mass that `properties` lacks; its known point masses are kept.

    Where the modes hardly depend on the mass, near a rigid clamp, its distribution is the prior: half normal with an
    rms of a tenth of the beam's mass.

    Raises
    ------
    BuckledBeamError
        If a standing beam cannot carry its own weight and a tenth of it anywhere.
    """
    without = Misfit.of(properties, measured)
    basis = prior.basis(properties.elements)
    top = maximum(whiten(without, basis), np.zeros(basis.shape[1]))
    cells = TUNING.per_maximum * measured.highest
    edges = np.linspace(0.0, properties.length_m, cells + 1)
    position, length = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    known = np.array([_at(properties, measured, prior, s, top) for s in position])
    while position.size < TUNING.most and np.any(divided := _to_divide(known[:, 0], length)):
        third = length[divided] / 3.0
        added = np.concatenate([position[divided] - third, position[divided] + third])
        more = np.array([_at(properties, measured, prior, s, top) for s in added])
        length[divided] = third
        position, length = np.append(position, added), np.concatenate([length, third, third])
        order = np.argsort(position)
        position, length, known = position[order], length[order], np.concatenate([known, more])[order]
    log_weight = known[:, 0] + np.log(length / properties.length_m)
    total = float(logsumexp(log_weight))
    return PointMassPosterior(
        position_m=position,
        cell_m=length,
        weight=np.exp(log_weight - total),
        mass_kg=known[:, 1] * TUNING.scale * properties.mass_kg,
        mass_sd_kg=known[:, 2] * TUNING.scale * properties.mass_kg,
        log_odds=total - top.log_evidence(without.log_normalisation),
        seed=seed,
    )


def _at(
    properties: BeamProperties,
    measured: MeasuredModes,
    prior: SmoothPrior,
    position_m: float,
    without: Maximum,
) -> tuple[float, float, float]:
    """Log likelihood of a place, and the mass there over the scale of its prior: mean and sd before truncation."""
    body = PointMass(float(position_m), TUNING.scale * properties.mass_kg)
    misfit = Misfit.of(replace(properties, point_masses=(*properties.point_masses, body)), measured, 1)
    basis = prior.basis(properties.elements)

    def whitened(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        mass = np.clip(z[:, -1:], TUNING.smallest, TUNING.largest)
        values, slopes = misfit.at(np.hstack([z[:, :-1] @ basis.T, np.log(mass)]), slopes=True)
        return values, np.concatenate(
            [slopes[:, :, :-1] @ basis, slopes[:, :, -1:] / mass[:, np.newaxis]], axis=2
        )

    # the cost about the beam without a mass, least over all properties: slope * mass + curvature * mass^2 / 2
    by_mass = whitened(np.append(without.z, 0.0)[np.newaxis])[1][0, :, -1]
    j = without.slopes
    follows = np.linalg.solve(np.eye(without.z.size) + j.T @ j, j.T @ by_mass)
    slope, curvature = float(by_mass @ without.misfit), 1.0 + float(by_mass @ (by_mass - j @ follows))
    mean, sd = -slope / curvature, curvature**-0.5
    if mean <= 0.0:
        evidence = without.log_evidence(misfit.log_normalisation) + 0.5 * (mean / sd) ** 2 + np.log(sd)
    else:
        top = maximum(whitened, np.append(without.z - mean * follows, mean))
        if not np.all(np.isfinite(top.misfit)):
            # the beam would buckle under such a mass
            return np.finfo(float).min, 0.0, sd
        mean = max(0.0, float(top.z[-1]))
        sd = float(np.linalg.inv(np.eye(top.z.size) + top.slopes.T @ top.slopes)[-1, -1] ** 0.5)
        evidence = top.log_evidence(misfit.log_normalisation)
    return float(evidence + np.log(2.0) + log_ndtr(mean / sd)), mean, sd


def _to_divide(log_likelihood: FloatArray, length: FloatArray) -> FloatArray:
    """Cells with much probability, and maxima that their neighbours do not resolve; shape (k,), bool."""
    log_weight = log_likelihood + np.log(length)
    likely = log_weight - logsumexp(log_weight) > np.log(TUNING.largest_share)
    around = np.pad(log_likelihood, 1, constant_values=-np.inf)
    left, right = log_likelihood - around[:-2], log_likelihood - around[2:]
    steep = np.maximum(np.where(np.isfinite(left), left, 0.0), np.where(np.isfinite(right), right, 0.0))
    near = log_likelihood > np.max(log_likelihood) - TUNING.hopeless
    return np.asarray(likely | ((left >= 0.0) & (right >= 0.0) & (steep > TUNING.steep) & near))
