r"""Stiffnesses of the clamp of a beam, from its measured modes.

Before the measurement the logarithms of both stiffnesses are normal, over the decades in which a clamp is neither a
hinge nor rigid to the accuracy of a measurement, and widths, thicknesses, density and modulus have the prior of the
Bayesian update. The draws are those of `sim.updating.posterior`.

A clamp that turns lowers all modes of a uniform cantilever by about the same ``2 E I / (k_r L)``, as a lower modulus
does: its stiffness is known as well as the modulus is before the measurement. One that gives way lowers mode n by
``2 (beta_n sigma_n L)^2 E I / (k_t L^3)``, which grows with the mode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from sim.beam import BeamProperties, ElasticClamp
from sim.updating.bayesian import UndecidedError, whiten
from sim.updating.least_squares import Misfit
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import SmoothPrior, draw, maximum
from tracker import INTERVAL_LEVEL, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Prior of the stiffnesses, and draws."""

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
    draws: int = 2000
    #: [1] probability beyond the 5 % and 95 % quantiles of the prior from which a side of an interval is open
    #: statistics: A fifth of that of the prior: the modes say little of stiffnesses there.
    left: float = 0.01


TUNING = Tuning()
_DEFAULT_PRIOR = SmoothPrior()


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
    properties: BeamProperties,
    measured: MeasuredModes,
    *,
    prior: SmoothPrior = _DEFAULT_PRIOR,
    seed: int = 0,
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
    drawn = draw(whitened, top, TUNING.draws, rng)
    if drawn.lost == TUNING.draws:
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
