r"""What the description of a beam may lack, from its measured modes: one point mass, or the stiffnesses of its clamp.

Widths, thicknesses, density and modulus have the prior of the Bayesian update.

*Point mass.* The prior of the place s is uniform along the beam, that of the mass m half normal. A mass at s lowers a
frequency by ``m phi_r(s)^2 / 2`` of itself, which as a function of s has as many maxima as the mode: the posterior has
several separate parts. It is therefore computed on a grid of places, at each of which Laplace's approximation gives the
marginal likelihood over the mass and all properties and the conditional distribution of the mass, a normal one
truncated at zero; cells with much probability, or about a maximum, are divided. Where a mass does not improve the fit,
the approximation is that about the beam without it.

Where both ends are alike, frequencies are the same for the place L - s, and both are found; shapes decide between them.
A mass and a smooth change of the section are told apart only as far as the prior of the sections excludes the latter.

*Clamp.* Before the measurement the logarithms of both stiffnesses are normal, over the decades in which a clamp is
neither a hinge nor rigid to the accuracy of a measurement. A clamp that turns lowers all modes of a uniform cantilever
by about the same ``2 E I / (k_r L)``, as a lower modulus does: its stiffness is known as well as the modulus is before
the measurement. One that gives way lowers mode n by ``2 (beta_n sigma_n L)^2 E I / (k_t L^3)``, which grows with the
mode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtr, ndtri

from sim.beam import BeamProperties, ElasticClamp, PointMass
from sim.updating.least_squares import Misfit
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import DEFAULT_PRIOR, Maximum, SmoothPrior, UndecidedError, draw, maximum, whiten
from tracker import INTERVAL_ENDS, INTERVAL_LEVEL, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Priors of the mass and of the stiffnesses, grid of places, and draws."""

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
    #: [E I / L^3] median of the stiffness against translation
    #: physics: It lowers mode 5 by 0.4 %.
    translation: float = 1e5
    #: [ln] its standard deviation
    #: physics: 90 % lower mode 5 by between 50 % and 0.003 %, less than the default error of the model.
    translation_sd: float = 3.0
    #: [E I / L] median of that against rotation
    #: physics: It lowers all modes by 0.7 %.
    rotation: float = 300.0
    #: [ln] its standard deviation
    #: physics: 90 % lower all modes by between 40 % and 0.01 %.
    rotation_sd: float = 2.5
    #: [prior sd] distance of the starts of the search from the medians
    #: physics: The stiff end is flat: a search from there may stay.
    apart: float = 1.5
    #: [prior sd] distance beyond which stiffnesses are not tried
    #: physics: A hinge, whose beam may have no equilibrium; one of 400 draws of the prior is beyond.
    farthest: float = 3.0
    #: [1] draws from which intervals are made
    #: statistics: The 5 % quantile of 2000 draws has the standard error 0.5 % of probability.
    clamp_draws: int = 2000
    #: [1] probability beyond the 5 % and 95 % quantiles of the prior from which a side of an interval is open
    #: statistics: A fifth of that of the prior: the modes say little of stiffnesses there.
    left: float = 0.01


TUNING = Tuning()


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

    def regions(self) -> tuple[Region, ...]:
        """Smallest set of places with the probability 90 %, its connected parts in order of probability."""
        order = np.argsort(-self.weight / self.cell_m, kind="stable")
        inside = np.zeros(order.size, dtype=np.bool_)
        inside[order[: 1 + int(np.searchsorted(np.cumsum(self.weight[order]), INTERVAL_LEVEL))]] = True
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
    properties: BeamProperties, measured: MeasuredModes, *, prior: SmoothPrior = DEFAULT_PRIOR, seed: int = 0
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


@dataclass(frozen=True)
class ClampPosterior:
    """Posterior of the stiffnesses of a clamp.

    Attributes
    ----------
    most_probable : ElasticClamp
    stiffness : array, shape (n, 2)
        Draws of equal weight: against translation in N/m, against rotation in N m/rad.
    prior_median, prior_log_sd : array, shape (2,)
        Of the stiffnesses in the same order, and of their logarithms.
    effective_draws : float
        Effective number of the weighted draws.
    log_odds : float
        Logarithm of the odds of a beam with such a clamp against one with a rigid one, equal before the measurement.
    """

    most_probable: ElasticClamp
    stiffness: FloatArray
    prior_median: FloatArray
    prior_log_sd: FloatArray
    effective_draws: float
    log_odds: float

    def interval(self, level: float = INTERVAL_LEVEL) -> FloatArray:
        """Intervals of both stiffnesses, shape (2, 2), in the order of `stiffness`.

        A side is open, with the limit 0 or infinity, where the modes hardly exclude stiffnesses beyond the 5 % or 95 %
        quantile of the prior; the other limit then leaves out ``1 - level``.
        """
        beyond = (np.log(self.stiffness / self.prior_median) / self.prior_log_sd)[:, :, np.newaxis] * [
            -1.0,
            1.0,
        ]
        is_open = np.mean(beyond > ndtri(0.95), axis=0) > TUNING.left
        found = np.empty((2, 2))
        for of, (low, high) in enumerate(is_open):
            tail = (1.0 - level) / (1.0 if low != high else 2.0)
            found[of] = np.quantile(self.stiffness[:, of], [tail, 1.0 - tail])
        return np.where(is_open, [0.0, np.inf], found)


def find_clamp(
    properties: BeamProperties, measured: MeasuredModes, *, prior: SmoothPrior = DEFAULT_PRIOR, seed: int = 0
) -> ClampPosterior:
    """Posterior of the clamp of `properties` at its first end, in place of the one that it has.

    Raises
    ------
    UndecidedError
        If the first end is not clamped, or no beam has the measured modes.
    BuckledBeamError
        If a standing beam with a rigid clamp cannot carry its own weight.
    """
    if properties.ends[0] != "clamped":
        msg = f"an elastic clamp needs a clamped first end; it is {properties.ends[0]}"
        raise UndecidedError(msg)
    bend = properties.elastic_modulus_pa * float(np.mean(properties.second_moment_m4))
    length = properties.length_m
    median = bend * np.array([TUNING.translation / length**3, TUNING.rotation / length])
    log_sd = np.array([TUNING.translation_sd, TUNING.rotation_sd])
    clamp = ElasticClamp(float(median[1]), float(median[0]))
    misfit = Misfit.of(replace(properties, clamp=clamp), measured, clamp=True)
    own = prior.basis(properties.elements)
    basis = np.zeros((own.shape[0] + 2, own.shape[1] + 2))
    basis[:-2, :-2] = own
    basis[-2:, -2:] = np.diag(log_sd)
    free = whiten(misfit, basis)

    def tried(z: FloatArray) -> FloatArray:
        return np.clip(z[..., -2:], -TUNING.farthest, TUNING.farthest)

    def whitened(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        return free(np.hstack([z[:, :-2], tried(z)]))

    starts = np.zeros((5, basis.shape[1]))
    starts[1:, -2:] = TUNING.apart * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
    tops = [maximum(whitened, start) for start in starts]
    # NaN of a beam that buckles is never the smallest
    top = min(tops, key=lambda one: np.nan_to_num(one.z @ one.z + one.misfit @ one.misfit, nan=np.inf))
    rng = np.random.default_rng(seed)
    drawn = draw(whitened, top, TUNING.clamp_draws, rng)
    if drawn.lost == TUNING.clamp_draws:
        msg = "no beam near the configured one has the measured modes with any clamp"
        raise UndecidedError(msg)
    rigid = Misfit.of(replace(properties, clamp=None), measured)
    without = maximum(whiten(rigid, own), np.zeros(own.shape[1]))
    return ClampPosterior(
        most_probable=clamp.scaled(np.exp(tried(top.z) * log_sd)),
        stiffness=median * np.exp(tried(drawn.z[drawn.equal(rng)]) * log_sd),
        prior_median=median,
        prior_log_sd=log_sd,
        effective_draws=drawn.effective,
        log_odds=drawn.log_evidence(misfit.log_normalisation)[0]
        - without.log_evidence(rigid.log_normalisation),
    )
