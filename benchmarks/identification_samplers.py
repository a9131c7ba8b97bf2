"""Effective samples per CPU second: modalcam's posterior and emcee on all six parameters."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import emcee
import numpy as np

from benchmarks.identification_peers import eq1_curve, filled, least_squares
from benchmarks.identification_scenes import Decay
from modal_id import IdentifySettings
from modal_id.data import Prepared, prepare
from modal_id.fit import find_modes
from modal_id.posterior import SampledMode, sample_mode
from tracker import INTERVAL_ENDS

_WALKERS = 32


@dataclass(frozen=True)
class Sampling:
    """Effective samples of zeta, their CPU time in seconds, and the limits of the 90 % interval of zeta."""

    tool: str
    effective: float
    cpu_s: float
    interval: tuple[float, float]
    note: str = ""

    @property
    def per_second(self) -> float:
        """Effective samples per CPU second."""
        return self.effective / self.cpu_s


def ours(decay: Decay) -> Sampling:
    """emcee on reduced data (no approximation), with amplitudes, offset and noise level marginalised.

    Raises
    ------
    RuntimeError
        If the mode could not be sampled, with the reason reported by the identification.
    """
    prepared = prepare(decay.series)
    if not isinstance(prepared, Prepared):
        raise RuntimeError(prepared)  # noqa: TRY004 - a result, not a type, is wrong
    model = find_modes(prepared.data, 1)
    if model is None:
        msg = "no mode above the noise"
        raise RuntimeError(msg)
    start = time.process_time()
    sampled = sample_mode(model, 0, IdentifySettings())
    cpu = time.process_time() - start
    if not isinstance(sampled, SampledMode):
        raise RuntimeError(sampled.reason)  # noqa: TRY004 - a result, not a type, is wrong
    posterior = sampled.posterior
    low, high = np.quantile(posterior.damping_ratio, INTERVAL_ENDS)
    worst = max(posterior.r_hat)
    return Sampling("modalcam", posterior.ess[1], cpu, (float(low), float(high)), f"R-hat {worst:.3f}")


def naive(decay: Decay, steps: int) -> Sampling:
    """emcee's default move on frequency, zeta, two amplitudes, offset and noise level, without data reduction."""
    time_s, values = filled(decay.time_s, decay.values)
    fit = least_squares(time_s, values, decay.frequency_hz)
    sd0 = float(np.std(values - np.mean(values)))

    def log_probability(p: np.ndarray) -> float:
        if p[1] <= 0.0 or p[1] >= 1.0:
            return -np.inf
        residual = values - eq1_curve(time_s, p[0], p[1], p[2], p[3], p[4])
        return float(-values.size * p[5] - 0.5 * np.exp(-2.0 * p[5]) * (residual @ residual))

    columns = np.column_stack(
        [eq1_curve(time_s, fit.frequency_hz, fit.zeta, *unit) for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    )
    linear = np.linalg.lstsq(columns, values, rcond=None)[0]
    noise = float(np.std(values - columns @ linear))
    centre = np.array([fit.frequency_hz, fit.zeta, *linear, np.log(noise)])
    spread = np.array([1e-4 * fit.frequency_hz, 1e-2 * fit.zeta, *(1e-2 * sd0 for _ in range(3)), 1e-2])
    rng = np.random.default_rng(1)
    state = emcee.State(
        centre + 0.1 * spread * rng.standard_normal((_WALKERS, 6)),
        random_state=np.random.RandomState(1).get_state(),
    )
    sampler = emcee.EnsembleSampler(_WALKERS, 6, log_probability)
    start = time.process_time()
    sampler.run_mcmc(state, steps)
    cpu = time.process_time() - start
    chain = sampler.get_chain()[steps // 4 :, :, 1]
    logging.getLogger("emcee").setLevel(logging.ERROR)  # the note states the autocorrelation time
    tau = float(emcee.autocorr.integrated_time(chain[:, :, None], quiet=True)[0])
    low, high = np.quantile(chain, INTERVAL_ENDS)
    return Sampling(
        "emcee, six parameters", chain.size / tau, cpu, (float(low), float(high)), f"tau {tau:.0f} steps"
    )
