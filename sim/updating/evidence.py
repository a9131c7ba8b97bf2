r"""Model selection: marginal likelihoods of uniform, tapered and smooth beams.

The marginal likelihood is the probability density of the measured values under a model, integrated over the prior of
its properties: it penalises misfit as well as flexibility. It is computed by Laplace's approximation and, without bias
and with known scatter, from weighted draws.

No simple model is accurate to a measured sd of 1e-5, and with the stated `model_sd` alone every model that misfits by
a per cent would be impossible. The discrepancy between model and beam, one relative standard deviation :math:`\tau`
for all frequencies, is therefore integrated out as well, with a uniform prior in its logarithm from 1e-4 to 1e-1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from sim.beam import BeamProperties
from sim.updating.least_squares import Misfit, uniform_basis
from sim.updating.measured_modes import TUNING as MEASURED
from sim.updating.measured_modes import MeasuredModes
from sim.updating.posterior import DEFAULT_PRIOR, SmoothPrior, draw, maximum, whiten
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """The discrepancies integrated over, and when models are undecided."""

    #: [1] largest discrepancy between model and beam, a relative sd of the frequencies
    #: convention: Chosen: a beam with more is another beam.
    largest: float = 0.1
    #: [1] discrepancies from it down to the stated error of the model, equally spaced in their logarithm
    #: convention: Two a decade; chosen: the evidence changes slowly with the discrepancy.
    grid: int = 7
    #: [1] draws that check Laplace's approximation at the likely discrepancy
    #: measurement: They agree with it within 0.2 (docs/theory.md); their own standard error is on the result.
    check_draws: int = 32
    #: [1] odds between two models below which neither is favoured
    #: convention: Jeffreys: odds below 3.2 are worth no more than a mention (Kass, Raftery 1995, doi:10.2307/2291091).
    undecided_odds: float = 3.0


TUNING = Tuning()


@dataclass(frozen=True)
class ModelEvidence:
    """Marginal likelihood of one model.

    Attributes
    ----------
    name : str
        "uniform", "taper" or "smooth", with "+gravity" where it acts.
    parameters : int
        Number of free parameters.
    log_evidence : float
        With the discrepancy integrated out, by Laplace's approximation at each value.
    likely_discrepancy : float
        Discrepancy with the largest evidence.
    discrepancy, log_evidence_laplace : array, shape (t,)
        Grid, decreasing, and the evidence on it.
    log_evidence_drawn, log_evidence_drawn_sd, effective_share : float
        Evidence at the likely discrepancy from weighted draws, and their effective share, between 0 and 1.
    log_evidence_stated : float
        By Laplace's approximation at the stated `model_sd`.
    largest_error : float
        Largest relative error of a frequency for the most probable beam with the stated `model_sd`.
    """

    name: str
    parameters: int
    log_evidence: float
    likely_discrepancy: float
    discrepancy: FloatArray
    log_evidence_laplace: FloatArray
    log_evidence_drawn: float
    log_evidence_drawn_sd: float
    effective_share: float
    log_evidence_stated: float
    largest_error: float

    @property
    def discrepancy_weight(self) -> FloatArray:
        """Posterior probability of each discrepancy of the grid, shape (t,)."""
        weight = _trapezoid(self.discrepancy.size) * np.exp(
            self.log_evidence_laplace - np.max(self.log_evidence_laplace)
        )
        return np.asarray(weight / weight.sum())

    @property
    def laplace_error(self) -> float:
        """Difference of Laplace's approximation from the value of the draws."""
        at = int(np.argmax(self.log_evidence_laplace))
        return float(self.log_evidence_laplace[at] - self.log_evidence_drawn)


@dataclass(frozen=True)
class ModelComparison:
    """Marginal likelihoods of several models of one beam, the most probable first."""

    models: tuple[ModelEvidence, ...]

    @property
    def undecided(self) -> tuple[str, ...]:
        """Names of the models within odds of 3 of the most probable one, which is the first."""
        best = self.models[0].log_evidence
        return tuple(
            m.name for m in self.models if best - m.log_evidence < float(np.log(TUNING.undecided_odds))
        )

    def odds(self, name: str) -> float:
        """Log odds of the most probable model against the model `name`."""
        found = next(m for m in self.models if m.name == name)
        return self.models[0].log_evidence - found.log_evidence


def compare_models(
    properties: BeamProperties, measured: MeasuredModes, *, prior: SmoothPrior = DEFAULT_PRIOR, seed: int = 0
) -> ModelComparison:
    """Marginal likelihoods of uniform, linearly tapering and smooth beams, with gravity (if there is any) and without.

    The standard deviation of `prior` applies to every model, its correlation length to the smooth one.

    Raises
    ------
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    without = replace(properties, orientation="none", angle_deg=None)
    beams = {"": without}
    if properties.orientation != "none" and properties.gravity_m_s2 > 0.0:
        beams["+gravity"] = properties
    ne = properties.elements
    bases = {
        "uniform": prior.sd * uniform_basis(ne),
        "taper": prior.sd * _taper_basis(ne),
        "smooth": prior.basis(ne),
    }
    found = [
        _evidence(kind + gravity, beam, measured, basis, seed)
        for kind, basis in bases.items()
        for gravity, beam in beams.items()
    ]
    return ModelComparison(tuple(sorted(found, key=lambda model: -model.log_evidence)))


def _evidence(
    name: str, beam: BeamProperties, measured: MeasuredModes, basis: FloatArray, seed: int
) -> ModelEvidence:
    z, laplace, tops = np.zeros(basis.shape[1]), [], []
    powers = np.linspace(np.log10(TUNING.largest), np.log10(MEASURED.model_sd), TUNING.grid)
    discrepancies = tuple(float(10.0**power) for power in powers)
    misfits = [Misfit.of(beam, replace(measured, model_sd=sd)) for sd in discrepancies]
    for misfit in misfits:
        top = maximum(whiten(misfit, basis), z)
        z = top.z
        laplace.append(top.log_evidence(misfit.log_normalisation))
        tops.append(top)
    at = int(np.argmax(laplace))
    drawn = draw(whiten(misfits[at], basis), tops[at], TUNING.check_draws, np.random.default_rng(seed))
    value, sd = drawn.log_evidence(misfits[at].log_normalisation)
    misfit = Misfit.of(beam, measured)
    stated = maximum(whiten(misfit, basis), z)
    off = misfit.frequency_hz(np.exp(basis @ stated.z)) / measured.frequency_hz - 1.0
    return ModelEvidence(
        name=name,
        parameters=int(basis.shape[1]),
        log_evidence=_over_discrepancies(np.array(laplace)),
        likely_discrepancy=discrepancies[at],
        discrepancy=np.array(discrepancies),
        log_evidence_laplace=np.array(laplace),
        log_evidence_drawn=value,
        log_evidence_drawn_sd=sd,
        effective_share=drawn.effective / TUNING.check_draws,
        log_evidence_stated=stated.log_evidence(misfit.log_normalisation),
        largest_error=float(np.max(np.abs(off))),
    )


def _over_discrepancies(laplace: FloatArray) -> float:
    """Mean over the logarithm of the discrepancy, by the trapezoidal rule."""
    return float(logsumexp(laplace, b=_trapezoid(laplace.size)))


def _trapezoid(size: int) -> FloatArray:
    """Weights of equally spaced points, their sum 1."""
    weight = np.ones(size)
    weight[[0, -1]] = 0.5
    return np.asarray(weight / weight.sum())


def _taper_basis(elements: int) -> FloatArray:
    """Basis of width and thickness that vary linearly along the beam, by their values at clamp and tip; (v, 6)."""
    s = (np.arange(elements) + 0.5) / elements
    out = np.zeros((2 * elements + 2, 6))
    for field, at in ((0, slice(0, elements)), (2, slice(elements, 2 * elements))):
        out[at, field], out[at, field + 1] = 1.0 - s, s
    out[-2, 4] = out[-1, 5] = 1.0
    return out
