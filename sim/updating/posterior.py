r"""Posterior of a beam's properties: its maximum, Gaussian evidence, and weighted independent draws.

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

from sim.updating.least_squares import uniform_basis
from tracker import FloatArray, checked

# z, (n, k), to misfits, (n, m), and their slopes, (n, m, k)
Misfits = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Tuning:
    """Convergence of the maximum and of the draws; what the prior keeps."""

    #: [1] Gauss-Newton iterations to the maximum
    iterations: int = 60
    #: [1] share of a Gauss-Newton step below which it is not halved again: the point counts as the maximum
    #: convention: Thirteen halvings; chosen.
    smallest_share: float = 1e-4
    #: [prior sd] largest move at the maximum
    #: physics: The error of the log evidence is the square of this times the precision of the data, 1e6: 1e-6.
    settled: float = 1e-6
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
    for _ in range(TUNING.iterations):
        rows = np.vstack([slopes, np.eye(size)])
        move = np.linalg.lstsq(rows, -np.concatenate([g, z]), rcond=None)[0]
        share = 1.0
        while share > TUNING.smallest_share:
            trial = z + share * move
            then, then_slopes = _one(misfits, trial)
            # NaN, of a beam that buckles, is never better
            if then @ then + trial @ trial < g @ g + z @ z:
                break
            share *= 0.5
        else:
            return Maximum(z, g, slopes)
        z, g, slopes = trial, then, then_slopes
        if np.max(np.abs(share * move)) < TUNING.settled:
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
