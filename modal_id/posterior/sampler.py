"""Sampling of (natural frequency, damping ratio) of a mode by emcee, linear parameters marginalised in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np

from modal_id.fit.poles import pole
from modal_id.posterior.kde_move import KernelMove
from modal_id.posterior.likelihood import ReducedLikelihood
from modal_id.posterior.noise import NoiseLevel
from modal_id.settings import SamplerSettings
from tracker.arrays import FloatArray

LogProbability = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Draws:
    """Draws of all ensembles with their diagnostics.

    Attributes
    ----------
    omega_n_rad_s, zeta : array, shape (ensembles, draws)
    r_hat, ess : tuple of float
        For frequency and damping ratio.
    autocorrelation_steps, acceptance : float
    long_enough : bool
        Whether every ensemble met the autocorrelation criterion within its budget of steps.
    """

    omega_n_rad_s: FloatArray
    zeta: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    long_enough: bool


@dataclass(frozen=True)
class FailedSampling:
    """Falsy, with the reason why there are no draws."""

    reason: str

    def __bool__(self) -> bool:
        return False


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

    likelihood: ReducedLikelihood
    centre: tuple[float, float]
    scale: tuple[float, float]
    noise: NoiseLevel
    chi_square_min: float
    reach: float = 10.0

    def __call__(self, position: FloatArray) -> FloatArray:
        """Log density, shape (w,), for positions of shape (w, 2); -inf where zeta <= 0."""
        omega, zeta = (self.centre[i] + self.scale[i] * position[:, i] for i in range(2))
        # Beyond the reach the likelihood's series of moments does not hold.
        inside = np.all(np.abs(position) < self.reach, axis=1) & (zeta > 0.0) & (zeta < 1.0) & (omega > 0.0)
        change = np.where(
            inside, pole(omega, np.where(inside, zeta, 0.0)) - self.likelihood.centre_per_s, 0.0
        )
        argument = (self.likelihood.chi_square(change) - self.chi_square_min) / (
            self.noise.dof * self.noise.factor**2
        )
        value = -0.5 * (self.noise.dof + 2.0) * np.log1p(np.maximum(argument, -0.5))
        return np.where(inside & np.isfinite(value), value, -np.inf)


def sample(
    density: PoleDensity,
    correlation: float,
    settings: SamplerSettings,
    streams: tuple[np.random.SeedSequence, ...],
) -> Draws | FailedSampling:
    """Draw from the density with independent ensembles, each with its own random stream.

    Parameters
    ----------
    density : PoleDensity
    correlation : float
        Between omega_n and zeta by Laplace's approximation, for the starting positions.
    settings : SamplerSettings
    streams : tuple of SeedSequence, length ``settings.ensembles``

    Notes
    -----
    emcee: Foreman-Mackey et al. (2013), doi:10.1086/670067. The stream is passed in through ``State``, because samplers
    in one process would otherwise share NumPy's global stream.
    """
    chains, acceptance, tau, enough = [], [], [], []
    for stream in streams:
        try:
            outcome = _one_ensemble(density, correlation, settings, stream)
        except (np.linalg.LinAlgError, ValueError) as error:
            return FailedSampling(
                f"the sampler could not propose steps ({error}); the record hardly determines this mode's parameters"
            )
        if isinstance(outcome, FailedSampling):
            return outcome
        chain, fraction, steps, long_enough = outcome
        chains.append(chain)
        acceptance.append(fraction)
        tau.append(steps)
        enough.append(long_enough)
    shortest = min(chain.shape[0] for chain in chains)
    stacked = np.stack([chain[:shortest] for chain in chains])
    r_hat = tuple(_split_r_hat(stacked[..., i]) for i in range(2))
    if max(r_hat) > settings.max_r_hat:
        return FailedSampling(
            f"the independent ensembles disagree (R-hat {max(r_hat):.2f}, at most {settings.max_r_hat} is allowed); "
            "a longer record or less noise is needed"
        )
    ess = 0.5 * stacked.size / np.max(np.array(tau), axis=0)
    draws = stacked.reshape(stacked.shape[0], -1, 2)
    return Draws(
        density.centre[0] + density.scale[0] * draws[..., 0],
        density.centre[1] + density.scale[1] * draws[..., 1],
        (r_hat[0], r_hat[1]),
        (float(ess[0]), float(ess[1])),
        float(np.max(tau)),
        float(np.mean(acceptance)),
        all(enough),
    )


def _one_ensemble(
    density: LogProbability, correlation: float, settings: SamplerSettings, stream: np.random.SeedSequence
) -> tuple[FloatArray, float, FloatArray, bool] | FailedSampling:
    generator = np.random.Generator(np.random.PCG64(stream))
    start = _first_walkers(density, correlation, settings.walkers, generator)
    if start is None:
        return FailedSampling("the likelihood is not finite near the fitted mode; check the data")
    legacy = np.random.RandomState(np.random.MT19937(stream.spawn(1)[0]))
    sampler = emcee.EnsembleSampler(settings.walkers, 2, density, moves=KernelMove(), vectorize=True)
    state = sampler.run_mcmc(
        emcee.State(start, random_state=legacy.get_state()),
        settings.burn_in_steps,
        skip_initial_state_check=True,
    )
    sampler.reset()
    steps, long_enough = 0, False
    while steps < settings.max_steps and not long_enough:
        count = min(settings.check_steps, settings.max_steps - steps)
        state = sampler.run_mcmc(state, count, skip_initial_state_check=True)
        steps += count
        # Walkers that never moved give 0 / 0.
        with np.errstate(invalid="ignore"):
            tau = np.maximum(emcee.autocorr.integrated_time(sampler.get_chain(), tol=0), 1.0)
        long_enough = bool(np.all(np.isfinite(tau)) and steps >= settings.autocorrelation_times * np.max(tau))
    if not np.all(np.isfinite(tau)):
        return FailedSampling("no proposal was accepted; the record hardly determines this mode's parameters")
    return sampler.get_chain(), float(np.mean(sampler.acceptance_fraction)), tau, long_enough


def _first_walkers(
    density: LogProbability, correlation: float, walkers: int, generator: np.random.Generator
) -> FloatArray | None:
    factor = np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]]))
    good: list[FloatArray] = []
    found = 0
    for _ in range(50):
        trial = generator.standard_normal((walkers, 2)) @ factor.T
        trial = trial[np.isfinite(density(trial))]
        good.append(trial)
        found += trial.shape[0]
        if found >= walkers:
            return np.concatenate(good)[:walkers]
    return None


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
