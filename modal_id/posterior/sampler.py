"""Sampling of (natural frequency, damping ratio) of a mode by emcee, linear parameters marginalised in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import emcee
import numpy as np
from emcee.state import State
from scipy.fft import irfft, next_fast_len, rfft

from modal_id.posterior.density import REACH_SD, PoleDensity
from modal_id.posterior.proposal import IndependenceMove, PolarProposal, polar_proposal
from modal_id.settings import SamplerSettings
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """The autocorrelation."""

    #: [autocorrelation times] steps over which an autocorrelation is summed
    #: convention: As emcee does (Sokal).
    window: float = 5.0


TUNING = Tuning()


class SamplingError(Exception):
    """Sampling failed; the message gives the reason."""


@dataclass(frozen=True)
class Draws:
    """Draws of all ensembles with their diagnostics, as in `Posterior`.

    ``long_enough`` states whether every ensemble met the autocorrelation criterion within its budget of steps.
    """

    omega_n_rad_s: FloatArray
    zeta: FloatArray
    log_density: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    long_enough: bool


def sample(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> Draws:
    """Draw from the density with independent ensembles, each with its own random stream.

    `correlation` of omega_n and zeta by Laplace's approximation shapes the proposals.

    Raises
    ------
    SamplingError

    Notes
    -----
    emcee: Foreman-Mackey et al. (2013), doi:10.1086/670067. The stream is passed in through ``State``, because samplers
    in one process would otherwise share NumPy's global stream.
    """
    try:
        stacked, log_density, acceptance, tau, enough = _run(density, correlation, settings, streams)
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
        log_density.reshape(draws.shape[:2]),
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
) -> tuple[FloatArray, FloatArray, float, FloatArray, bool]:
    """Chains (ensembles, steps, walkers, 2), their log density, acceptance, autocorrelation times (ensembles, 2).

    And whether the chains are long enough.
    """
    count, walkers = len(streams), settings.walkers
    proposal = polar_proposal(density, correlation, REACH_SD)
    if proposal is None:
        msg = "the likelihood is not finite near the fitted mode; check the data"
        raise SamplingError(msg)
    generators = [np.random.default_rng(stream) for stream in streams]
    start = [_first_walkers(density, proposal, walkers, generator) for generator in generators]
    move = IndependenceMove(proposal, generators)
    sampler = emcee.EnsembleSampler(count * walkers, 2, density, moves=move, vectorize=True)
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
        tau = autocorrelation_times(chains)
        long_enough = bool(np.all(np.isfinite(tau)) and steps >= settings.autocorrelation_times * np.max(tau))
    if not np.all(np.isfinite(tau)):
        msg = "no proposal was accepted; the record hardly determines this mode's parameters"
        raise SamplingError(msg)
    values = np.moveaxis(sampler.get_log_prob().reshape(steps, count, walkers), 1, 0)
    acceptance = float(np.mean(sampler.acceptance_fraction))
    return np.ascontiguousarray(chains), values, acceptance, tau, long_enough


def _first_walkers(
    density: PoleDensity, proposal: PolarProposal, walkers: int, generator: np.random.Generator
) -> FloatArray:
    good = np.empty((0, 2))
    for _ in range(50):
        trial = proposal.draw(generator.random((walkers, 3)))
        good = np.concatenate([good, trial[np.isfinite(density(trial))]])
        if good.shape[0] >= walkers:
            return good[:walkers]
    msg = "the likelihood is not finite near the fitted mode; check the data"
    raise SamplingError(msg)


def autocorrelation_times(chains: FloatArray) -> FloatArray:
    """Integrated autocorrelation time in steps, at least 1, of each ensemble and parameter; shape (ensembles, p).

    `chains` has shape (ensembles, steps, walkers, p). NaN where a walker never moved. That of
    `emcee.autocorr.integrated_time`, for all walkers at once: the mean autocorrelation of the walkers, summed over a
    window of five times.
    """
    steps = chains.shape[1]
    length = next_fast_len(2 * steps, real=True)
    spectrum = rfft(chains - np.mean(chains, axis=1, keepdims=True), length, axis=1)
    products = irfft(spectrum.real**2 + spectrum.imag**2, length, axis=1)[:, :steps]
    # Walkers that never moved give 0 / 0.
    with np.errstate(invalid="ignore"):
        mean = np.mean(products / products[:, :1], axis=2)
        times = 2.0 * np.cumsum(mean, axis=1) - 1.0
        outside = np.arange(steps)[:, None] >= TUNING.window * times
    window = np.where(np.any(outside, axis=1), np.argmax(outside, axis=1), steps - 1)
    return np.maximum(np.take_along_axis(times, window[:, None], axis=1)[:, 0], 1.0)


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
