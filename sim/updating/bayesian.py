"""Bayesian updating of a beam under gravity: smooth fields, a sampled posterior, and its dependence on the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.beam import BeamProperties
from sim.updating.family import BeamFamily
from sim.updating.least_squares import Misfit
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import Misfits, SmoothPrior, draw, maximum
from tracker import INTERVAL_LEVEL, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Draws of the posterior and what counts as determined."""

    #: [1] posterior draws where no number is given
    #: statistics: The 5 % quantile of 400 draws has the standard error sqrt(0.05 x 0.95 / 400) = 1.1 % of probability.
    draws: int = 400
    #: [1] effective share of the weighted draws below which intervals are called unreliable
    #: statistics: 40 effective of 400 draws: a 90 % interval is uncertain by a fifth of its half width; usual are 90 to
    #: 99 %.
    fewest_share: float = 0.1
    #: [1] draws of the prior, for the prior sd of the frequencies
    #: statistics: The sd of a normal sample of 400 is known to 1 / sqrt(800) = 3.5 %.
    prior_draws: int = 400
    #: [1] share of the prior variance that the data remove above which a direction counts as determined
    #: convention: The data then say more than the prior.
    determined: float = 0.5
    #: [1] modes predicted above the highest measured one where no number is given
    #: convention: Chosen for the table of predicted modes.
    more_modes: int = 3


TUNING = Tuning()
_DEFAULT_PRIOR = SmoothPrior()


class UndecidedError(ArithmeticError):
    """No beam near the configured one has the measured modes."""


@dataclass(frozen=True)
class BayesianUpdate:
    """Posterior of a beam's properties, with the frequencies that it predicts.

    Attributes
    ----------
    properties : BeamProperties
        The most probable beam.
    standard_hz, updated_hz : array, shape (m,)
        Of the beam as given, and of the most probable one.
    log_factor, log_factor_draws : array, shape (v,) and (n, v)
        Log factors (widths, thicknesses, density, modulus) of the most probable beam, and posterior draws of equal
        weight in random order.
    predicted_hz, prior_sd_hz : array, shape (n, c) and (c,)
        Frequencies of modes 1 to c of each draw, measured or not, and their prior standard deviation.
    information : array, shape (d,)
        For each independent direction of the properties on which the data depend, the share of the prior variance that
        they remove, largest first; all other directions retain their prior variance.
    variance_ratio : array, shape (v,)
        Posterior over prior variance of each variable.
    effective_draws : float
        Effective number of the weighted draws.
    log_evidence, log_evidence_laplace : float
        Log marginal likelihood from the draws, and by Laplace's approximation.
    shape_rms : float
        Deviation of the measured shapes from those of the most probable beam, in standard deviations; NaN without
        shapes.
    """

    properties: BeamProperties
    prior: SmoothPrior
    standard_hz: FloatArray
    updated_hz: FloatArray
    log_factor: FloatArray
    log_factor_draws: FloatArray
    predicted_hz: FloatArray
    prior_sd_hz: FloatArray
    information: FloatArray
    variance_ratio: FloatArray
    effective_draws: float
    log_evidence: float
    log_evidence_laplace: float
    shape_rms: float
    seed: int

    @property
    def determined(self) -> int:
        """Number of directions for which the data remove more than half of the prior variance."""
        return int(np.count_nonzero(self.information > TUNING.determined))

    @property
    def undetermined(self) -> int:
        """Number of the other directions, for which the prior dominates."""
        return int(self.log_factor.size - self.determined)

    @property
    def reliable(self) -> bool:
        """Whether the draws represent the posterior: an effective share of at least a tenth."""
        return bool(self.effective_draws > TUNING.fewest_share * self.log_factor_draws.shape[0])

    def frequency_interval_hz(self, level: float = INTERVAL_LEVEL) -> FloatArray:
        """Equal-tailed intervals of the frequencies of modes 1 to c, shape (c, 2)."""
        tail = 0.5 * (1.0 - level)
        return np.asarray(np.quantile(self.predicted_hz, [tail, 1.0 - tail], axis=0).T)

    def factor_interval(self, level: float = INTERVAL_LEVEL) -> FloatArray:
        """Equal-tailed intervals of the factors: widths, thicknesses, density, modulus; shape (v, 2)."""
        tail = 0.5 * (1.0 - level)
        return np.asarray(np.exp(np.quantile(self.log_factor_draws, [tail, 1.0 - tail], axis=0).T))

    def draws(self, count: int) -> tuple[BeamProperties, ...]:
        """The first `count` beams of the posterior draws."""
        n = self.log_factor_draws.shape[0]
        if not 1 <= count <= n:
            msg = f"the posterior has 1 to {n} draws, {count} were requested"
            raise ValueError(msg)
        family = BeamFamily(BeamFamily(self.properties, 1).properties(-self.log_factor), 1)
        return tuple(family.properties(u) for u in self.log_factor_draws[:count])


def update_bayesian(
    properties: BeamProperties,
    measured: MeasuredModes,
    *,
    prior: SmoothPrior = _DEFAULT_PRIOR,
    modes: int | None = None,
    draws: int | None = None,
    seed: int = 0,
) -> BayesianUpdate:
    """Posterior of widths, thicknesses, density and modulus, with the modes that it predicts.

    Parameters
    ----------
    properties : BeamProperties
        The standard ones, at which the prior is centred, with gravity by their orientation.
    modes : int, optional
        Number of the lowest modes to predict; three more than the highest measured one when absent.

    Raises
    ------
    UndecidedError
        If no draw has a solution.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    draws = TUNING.draws if draws is None else draws
    misfit = Misfit.of(properties, measured)
    basis = prior.basis(properties.elements)
    whitened = whiten(misfit, basis)
    rng = np.random.default_rng(seed)
    top = maximum(whitened, np.zeros(basis.shape[1]))
    drawn = draw(whitened, top, draws, rng)
    if drawn.lost == draws:
        msg = (
            f"none of {draws} draws of the updated beam has the measured modes: the configured beam is too far "
            "from the measured one. Check its properties and the mode numbers."
        )
        raise UndecidedError(msg)
    z = drawn.z[drawn.equal(rng)]
    count = min(measured.highest + TUNING.more_modes if modes is None else modes, 2 * properties.elements)
    before = rng.standard_normal((TUNING.prior_draws, basis.shape[1])) @ basis.T
    log_factor, factors = basis @ top.z, z @ basis.T
    predicted = BeamFamily(properties, count)
    squares = top.singular_values**2
    return BayesianUpdate(
        properties=misfit.family.properties(log_factor),
        prior=prior,
        standard_hz=misfit.frequency_hz(np.ones(log_factor.size)),
        updated_hz=misfit.frequency_hz(np.exp(log_factor)),
        log_factor=log_factor,
        log_factor_draws=factors,
        predicted_hz=predicted.modes(factors).frequency_hz,
        prior_sd_hz=np.nanstd(predicted.modes(before).frequency_hz, axis=0),
        information=squares / (1.0 + squares),
        variance_ratio=np.var(factors, axis=0) / np.sum(basis**2, axis=1),
        effective_draws=drawn.effective,
        log_evidence=drawn.log_evidence(misfit.log_normalisation)[0],
        log_evidence_laplace=top.log_evidence(misfit.log_normalisation),
        shape_rms=misfit.shape_rms(np.exp(log_factor)),
        seed=seed,
    )


def whiten(misfit: Misfit, basis: FloatArray) -> Misfits:
    """Misfits as a function of independent standard normal numbers, from which `basis` gives the log factors."""

    def whitened(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, slopes = misfit.at(z @ basis.T, slopes=True)
        return values, slopes @ basis

    return whitened
