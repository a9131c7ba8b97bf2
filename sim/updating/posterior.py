r"""Bayesian updating of a beam under gravity: posterior of its properties, its maximum, evidence and weighted draws.

The prior is Gaussian in the logarithms of the factors. In whitened coordinates z (prior standard normal,
``log factor = B z``) the posterior is

.. math::  \pi(z) \propto \exp(-\tfrac12 |z|^2 - \tfrac12 |g(z)|^2)

with g the misfits in standard deviations. Measured frequencies are a thousand times more precise than the prior, so
the posterior is a thin curved sheet, for which neither a Gaussian nor a random walk is suitable. The draws are those
of randomised maximum likelihood with exact weights ("randomise then optimise"): with the singular value decomposition
of the slopes at the maximum, ``dg/dz = U S V^T``, each standard normal xi is mapped to the z that solves

.. math::

   z - V V^T z = \xi - V V^T \xi, \qquad (1 + S^2)^{-1/2} (V^T z + S U^T g(z)) = V^T \xi ,

one equation per direction on which the data depend. For a linear g the result is distributed as the posterior;
otherwise its density is ``N(T(z)) |det dT/dz|``, and the ratio of the posterior to it is the weight of the draw. The
mean weight is the evidence, the marginal likelihood of the model, independent of the Gaussian approximation.

References
----------
Bardsley, Solonen, Haario, Laine, "Randomize-then-optimize: a method for sampling from posterior distributions in
nonlinear inverse problems", SIAM J. Sci. Comput. 36 (2014) A1895-A1910, doi:10.1137/140964023.
Bardsley, Cui, Marzouk, Wang, "Scalable optimization-based sampling on function space", SIAM J. Sci. Comput. 42 (2020)
A1317-A1347, doi:10.1137/19M1245220.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.beam import BeamProperties
from sim.updating.family import BeamFamily
from sim.updating.least_squares import TUNING as STEPS
from sim.updating.least_squares import Misfit, uniform_basis
from sim.updating.measured_modes import MeasuredModes
from tracker import INTERVAL_LEVEL, FloatArray, checked

# z, (n, k), to misfits, (n, m), and their slopes, (n, m, k)
Misfits = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Tuning:
    """Draws of the posterior, and what counts as determined."""

    #: [1] Newton iterations for one draw; beyond, it has no solution and no weight
    draw_iterations: int = 25
    #: [sd of the draw] error of the equations at which the iteration of a draw ends
    #: physics: The weight is exact for the point reached: the error is one of the draw's place only.
    draw_error: float = 1e-6
    #: [prior sd] longest step of the iteration of a draw
    longest_step: float = 1.0
    #: [1] prior variance of a direction, over the largest, below which it is left out
    #: measurement: Left-out directions change no frequency by 1e-6.
    negligible: float = 1e-8
    #: [1] posterior draws where no number is given, and draws of the prior
    #: statistics: The 5 % quantile of 400 draws has the standard error sqrt(0.05 x 0.95 / 400) = 1.1 % of probability.
    draws: int = 400
    #: [1] effective share of the weighted draws below which intervals are called unreliable
    #: statistics: 40 effective of 400 draws: a 90 % interval is uncertain by a fifth of its half width; usual are 90 to
    #: 99 %.
    fewest_share: float = 0.1
    #: [1] share of the prior variance that the data remove above which a direction counts as determined
    #: convention: The data then say more than the prior.
    determined: float = 0.5
    #: [1] modes predicted above the highest measured one where no number is given
    #: convention: Chosen for the table of predicted modes.
    more_modes: int = 3


TUNING = Tuning()


@dataclass(frozen=True)
class Maximum:
    """Maximum of the posterior: z, shape (k,), the misfits, (m,), and their slopes, (m, k)."""

    z: FloatArray
    misfit: FloatArray
    slopes: FloatArray

    @property
    def singular_values(self) -> FloatArray:
        """Ratio of prior to measured standard deviation in each direction, shape (min(m, k),)."""
        return np.asarray(np.linalg.svd(self.slopes, compute_uv=False))

    def log_evidence(self, log_normalisation: float) -> float:
        """Laplace's approximation, Gauss-Newton's Hessian; `log_normalisation` is that of the misfits' density."""
        shrunk = 0.5 * float(np.sum(np.log1p(self.singular_values**2)))
        square = float(self.z @ self.z + self.misfit @ self.misfit)
        return -0.5 * square - shrunk + log_normalisation


@dataclass(frozen=True)
class Draws:
    """Independent weighted draws, shape (n, k).

    The log weights, (n,), are those of the posterior (without normalisation) over the density of the draw; minus
    infinity where the equations have no solution.
    """

    z: FloatArray
    log_weight: FloatArray

    @property
    def weight(self) -> FloatArray:
        """Normalised, shape (n,)."""
        over = np.exp(self.log_weight - np.max(self.log_weight))
        return np.asarray(over / over.sum())

    @property
    def effective(self) -> float:
        """Effective number of draws, ``1 / sum w^2`` (Kish); 0 if none has a solution."""
        return 0.0 if self.lost == self.log_weight.size else float(1.0 / np.sum(self.weight**2))

    @property
    def lost(self) -> int:
        """Number of draws without a solution."""
        return int(np.count_nonzero(~np.isfinite(self.log_weight)))

    def log_evidence(self, log_normalisation: float) -> tuple[float, float]:
        """Logarithm of the marginal likelihood and its standard deviation; minus infinity if no draw has a solution."""
        if self.lost == self.log_weight.size:
            return -float("inf"), float("nan")
        top = float(np.max(self.log_weight))
        over = np.exp(self.log_weight - top)
        mean = float(np.mean(over))
        sd = float(np.std(over, ddof=1)) / mean / np.sqrt(over.size)
        return top + float(np.log(mean)) + log_normalisation, float(sd)

    def equal(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """Indices of equally weighted draws by systematic resampling, in random order."""
        n = self.log_weight.size
        edges = np.cumsum(self.weight)
        picked = np.searchsorted(edges, (np.arange(n) + rng.uniform()) / n * edges[-1])
        return np.asarray(rng.permutation(np.minimum(picked, n - 1)), dtype=np.int64)


def maximum(misfits: Misfits, start: FloatArray) -> Maximum:
    """Maximum of the posterior, by Gauss-Newton with step halving from `start`, shape (k,)."""
    z, size = start, start.size
    g, slopes = _one(misfits, z)
    for _ in range(STEPS.iterations):
        rows = np.vstack([slopes, np.eye(size)])
        move = np.linalg.lstsq(rows, -np.concatenate([g, z]), rcond=None)[0]
        share = 1.0
        while share > STEPS.smallest_share:
            trial = z + share * move
            then, then_slopes = _one(misfits, trial)
            # NaN, of a beam that buckles, is never better
            if then @ then + trial @ trial < g @ g + z @ z:
                break
            share *= 0.5
        else:
            return Maximum(z, g, slopes)
        z, g, slopes = trial, then, then_slopes
        if np.max(np.abs(share * move)) < STEPS.settled:
            return Maximum(z, g, slopes)
    return Maximum(z, g, slopes)


def draw(misfits: Misfits, top: Maximum, count: int, rng: np.random.Generator) -> Draws:
    """Independent draws of the posterior with their weights, from its maximum."""
    u, s, vt = np.linalg.svd(top.slopes, full_matrices=False)
    v = vt.T
    widen = 1.0 / np.sqrt(1.0 + s**2)
    xi = rng.standard_normal((count, top.z.size))
    target = xi @ v
    across = xi - target @ vt
    # solution of the linearised equations
    offset = (top.misfit - top.slopes @ top.z) @ u
    a = widen**2 * (target / widen - s * offset)
    z = across + a @ vt
    log_weight = np.full(count, -np.inf)
    todo = np.arange(count)
    for _ in range(TUNING.draw_iterations):
        g, slopes = misfits(z[todo])
        inner = np.einsum("mr,nmk,ks->nrs", u, slopes, v, optimize=True)
        turned = widen[:, np.newaxis] * (np.eye(s.size) + s[:, np.newaxis] * inner)
        value = widen * (z[todo] @ v + s * (g @ u))
        good = np.isfinite(value).all(axis=1) & np.isfinite(turned).all(axis=(1, 2))
        todo, g, turned, value = todo[good], g[good], turned[good], value[good]
        error = value - target[todo]
        done = np.max(np.abs(error), axis=1) < TUNING.draw_error * (
            1.0 + np.max(np.abs(target[todo]), axis=1)
        )
        if np.any(done):
            at = todo[done]
            square = np.sum(z[at] ** 2, axis=1) + np.sum(g[done] ** 2, axis=1)
            of_draw = np.sum(across[at] ** 2, axis=1) + np.sum(value[done] ** 2, axis=1)
            log_weight[at] = 0.5 * (of_draw - square) - np.linalg.slogdet(turned[done])[1]
        todo, turned, error = todo[~done], turned[~done], error[~done]
        if todo.size == 0:
            break
        step = -np.linalg.solve(turned, error[:, :, np.newaxis])[:, :, 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        z[todo] += (step * np.minimum(1.0, TUNING.longest_step / np.maximum(length, 1e-300))) @ vt
    return Draws(z, log_weight)


def _one(misfits: Misfits, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    g, slopes = misfits(z[np.newaxis])
    return g[0], slopes[0]


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
        checked("sd of the prior", self.sd, positive=True, at_most=0.3)
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
        kept = values > TUNING.negligible * values[-1]
        # smoothest first, with a fixed sign, so that the same numbers give the same field on every machine
        field = (vectors[:, kept] * np.sqrt(values[kept]))[:, ::-1]
        field = field * np.where(np.sum(field, axis=0) < 0.0, -1.0, 1.0)
        k = field.shape[1]
        out = np.zeros((2 * elements + 2, 2 * k + 2))
        out[:elements, :k] = field
        out[elements : 2 * elements, k : 2 * k] = field
        out[-2, -2] = out[-1, -1] = 1.0
        return np.asarray(self.sd * out)


DEFAULT_PRIOR = SmoothPrior()


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
    prior: SmoothPrior = DEFAULT_PRIOR,
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
    before = rng.standard_normal((TUNING.draws, basis.shape[1])) @ basis.T
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
