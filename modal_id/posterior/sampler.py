"""Sampling of (natural frequency, damping ratio) of a mode by emcee, linear parameters marginalised in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from emcee.moves import Move
from emcee.state import State

from modal_id.fit.poles import pole
from modal_id.posterior.kernels import propose_from_kernels
from modal_id.posterior.likelihood import Likelihood
from modal_id.posterior.noise import NoiseLevel
from modal_id.settings import SamplerSettings
from tracker.arrays import BoolArray, FloatArray

# Positions beyond this are outside the likelihood's series of moments; in Laplace's standard deviations.
REACH_SD = 10.0


class SamplingError(Exception):
    """Sampling failed; the message gives the reason."""


@dataclass(frozen=True)
class Draws:
    """Draws of all ensembles with their diagnostics, as in `Posterior`.

    ``long_enough`` states whether every ensemble met the autocorrelation criterion within its budget of steps.
    """

    omega_n_rad_s: FloatArray
    zeta: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    long_enough: bool


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
        """Log density, shape (w,), for positions of shape (w, 2); -inf where zeta <= 0."""
        omega, zeta = (self.centre[i] + self.scale[i] * position[:, i] for i in range(2))
        inside = np.all(np.abs(position) < REACH_SD, axis=1) & (zeta > 0.0) & (zeta < 1.0) & (omega > 0.0)
        change = np.where(
            inside, pole(omega, np.where(inside, zeta, 0.0)) - self.likelihood.centre_per_s, 0.0
        )
        increase = self.likelihood.chi_square(change) - self.chi_square_min
        argument = increase / (self.noise.dof * self.noise.factor**2)
        value = -0.5 * (self.noise.dof + 2.0) * np.log1p(np.maximum(argument, -0.5))
        return np.where(inside & np.isfinite(value), value, -np.inf)


class KernelMove(Move):  # type: ignore[misc]  # emcee has no types
    """Independence proposal from a Gaussian kernel density of the complementary walkers, bandwidth by Scott's factor.

    The move of kombine (Farr & Farr 2015) and of `emcee.moves.KDEMove`, with an autocorrelation time of about 1.5 steps
    where the stretch move has about 30. Compiled, because `scipy.stats.gaussian_kde` and emcee's loop over walkers take
    longer than the likelihood. The halves are drawn anew in each step, and each is moved given the other,
    as in `emcee.moves.RedBlueMove`. For samplers with ``vectorize=True``.

    The walkers are those of several independent ensembles, one after the other, each with the random stream of the same
    index: they share the calls of the likelihood and nothing else.
    """

    def __init__(self, streams: Sequence[np.random.RandomState]) -> None:
        self._streams = tuple(streams)

    def propose(self, model: Any, state: State) -> tuple[State, BoolArray]:
        """Move both halves of each ensemble once; returns the new state and a mask of the walkers that moved."""
        coords, log_prob = state.coords, state.log_prob
        n = coords.shape[0] // len(self._streams)
        accepted = np.zeros(coords.shape[0], dtype=bool)
        orders = [n * e + random.permutation(n) for e, random in enumerate(self._streams)]
        first, second = [order[: n // 2] for order in orders], [order[n // 2 :] for order in orders]
        for halves, others in ((first, second), (second, first)):
            own = np.concatenate(halves)
            proposed, ratio, chance = self._proposals(coords[np.array(halves)], coords[np.array(others)])
            if not np.all(np.isfinite(proposed)):
                msg = "the walkers coincide"
                raise np.linalg.LinAlgError(msg)
            value = model.log_prob_fn(proposed)
            take = ratio + value - log_prob[own] > np.log(chance)
            coords[own[take]], log_prob[own[take]] = proposed[take], value[take]
            accepted[own[take]] = True
        return state, accepted

    def _proposals(self, own: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Proposed positions of halves, shape (ensembles, walkers, 2), log ratios of their density, random numbers."""
        size = own.shape[1]
        draws = [
            (
                random.randint(other.shape[1], size=size),
                random.standard_normal((size, 2)),
                random.random_sample(size),
            )
            for random in self._streams
        ]
        picks, normals, chance = (np.array(part) for part in zip(*draws, strict=True))
        proposed, ratio = propose_from_kernels(own, other, picks, normals)
        return proposed.reshape(-1, 2), ratio.ravel(), chance.ravel()


def sample(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> Draws:
    """Draw from the density with independent ensembles, each with its own random stream.

    `correlation` of omega_n and zeta by Laplace's approximation shapes the starting positions.

    Raises
    ------
    SamplingError

    Notes
    -----
    emcee: Foreman-Mackey et al. (2013), doi:10.1086/670067. The stream is passed in through ``State``, because samplers
    in one process would otherwise share NumPy's global stream.
    """
    try:
        stacked, acceptance, tau, enough = _run(density, correlation, settings, streams)
    except (np.linalg.LinAlgError, ValueError) as error:
        msg = f"the sampler could not propose steps ({error}); the record hardly determines this mode's parameters"
        raise SamplingError(msg) from error
    r_hat = (_split_r_hat(stacked[..., 0]), _split_r_hat(stacked[..., 1]))
    if max(r_hat) > settings.max_r_hat:
        msg = (
            f"the independent ensembles disagree (R-hat {max(r_hat):.2f}, at most {settings.max_r_hat} is allowed); "
            "a longer record or less noise is needed"
        )
        raise SamplingError(msg)
    ess = 0.5 * stacked.size / np.max(tau, axis=0)
    draws = stacked.reshape(stacked.shape[0], -1, 2)
    return Draws(
        density.centre[0] + density.scale[0] * draws[..., 0],
        density.centre[1] + density.scale[1] * draws[..., 1],
        r_hat,
        (float(ess[0]), float(ess[1])),
        float(np.max(tau)),
        acceptance,
        enough,
    )


def _run(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> tuple[FloatArray, float, FloatArray, bool]:
    """Chains (ensembles, steps, walkers, 2), acceptance, autocorrelation times (ensembles, 2); whether long enough."""
    count, walkers = len(streams), settings.walkers
    start = [_first_walkers(density, correlation, walkers, np.random.default_rng(one)) for one in streams]
    legacy = [np.random.RandomState(np.random.MT19937(one.spawn(1)[0])) for one in streams]
    sampler = emcee.EnsembleSampler(count * walkers, 2, density, moves=KernelMove(legacy), vectorize=True)
    # emcee uses this stream only to choose a move, and there is one.
    state = State(np.concatenate(start), random_state=np.random.RandomState(0).get_state())
    state = sampler.run_mcmc(state, settings.burn_in_steps, skip_initial_state_check=True)
    sampler.reset()
    steps, long_enough = 0, False
    while steps < settings.max_steps and not long_enough:
        more = min(settings.check_steps, settings.max_steps - steps)
        state = sampler.run_mcmc(state, more, skip_initial_state_check=True)
        steps += more
        chains = np.moveaxis(sampler.get_chain().reshape(steps, count, walkers, 2), 1, 0)
        # Walkers that never moved give 0 / 0.
        with np.errstate(invalid="ignore"):
            tau = np.array([np.maximum(emcee.autocorr.integrated_time(one, tol=0), 1.0) for one in chains])
        long_enough = bool(np.all(np.isfinite(tau)) and steps >= settings.autocorrelation_times * np.max(tau))
    if not np.all(np.isfinite(tau)):
        msg = "no proposal was accepted; the record hardly determines this mode's parameters"
        raise SamplingError(msg)
    return np.ascontiguousarray(chains), float(np.mean(sampler.acceptance_fraction)), tau, long_enough


def _first_walkers(
    density: PoleDensity, correlation: float, walkers: int, generator: np.random.Generator
) -> FloatArray:
    factor = np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]]))
    good = np.empty((0, 2))
    for _ in range(50):
        trial = generator.standard_normal((walkers, 2)) @ factor.T
        good = np.concatenate([good, trial[np.isfinite(density(trial))]])
        if good.shape[0] >= walkers:
            return good[:walkers]
    msg = "the likelihood is not finite near the fitted mode; check the data"
    raise SamplingError(msg)


def _split_r_hat(chains: FloatArray) -> float:
    """Potential scale reduction over halves of ensembles; `chains` has shape (ensembles, steps, walkers).

    Gelman et al., Bayesian Data Analysis, 3rd ed., section 11.4, with each half of an ensemble as one chain.
    """
    half = chains.shape[1] // 2
    parts = np.concatenate([chains[:, :half], chains[:, half : 2 * half]]).reshape(2 * chains.shape[0], -1)
    within = float(np.mean(np.var(parts, axis=1, ddof=1)))
    between = float(np.var(np.mean(parts, axis=1), ddof=1))
    if within <= 0.0:
        return float("inf")
    return float(np.sqrt((parts.shape[1] - 1) / parts.shape[1] + between / within))
