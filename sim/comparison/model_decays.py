"""Predictive density of every sample; scores, errors and coverage of each model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from modal_id import FittedMode, Identification, IdentifiedMode
from sim.comparison.bands import Simulated
from sim.comparison.matching import envelope_and_phase_error
from sim.comparison.problem import DecaySetting
from sim.comparison.results import ModelDecay
from sim.comparison.scores import (
    SD_OF_90,
    Prediction,
    Samples,
    crps,
    log_density,
    score_difference,
    score_sum,
)
from tracker import FloatArray


def noise_sd_mm(
    setting: DecaySetting, identification: Identification, models: Mapping[str, Simulated]
) -> FloatArray:
    """Standard deviation of every sample's noise, shape (n, k).

    The series gives the relative standard deviations of the samples of a channel, the residual its noise level: that
    of the identification's fit, or of a simulation where that is smaller, as for an amplitude-dependent damping ratio,
    which Eq. 1 does not describe.
    """
    after = identification.decay_rows
    given = identification.series.sd[after]
    relative = np.where(np.isfinite(given) & (given > 0.0), given, np.nan)
    valid = setting.used & np.isfinite(setting.measured_mm)
    left = [_rms(np.where(valid, setting.measured_mm - m.central, 0.0), valid) for m in models.values()]
    # ignores NaN
    level = np.fmin.reduce([identification.residual_sd, *left])
    typical = _rms(np.where(valid, np.nan_to_num(relative, nan=0.0), 0.0), valid & np.isfinite(relative))
    share = np.where(
        np.isfinite(relative) & (typical > 0.0), relative / np.where(typical > 0.0, typical, 1.0), 1.0
    )
    return np.asarray(level * share)


def model_decays(
    setting: DecaySetting,
    identification: Identification,
    runs: Mapping[str, Simulated],
    identified: Mapping[str, tuple[FittedMode | None, str]],
    fitted_mm: FloatArray | None = None,
) -> tuple[ModelDecay, ...]:
    """Every model's decay with its scores; gains are those of the first over each.

    `identified` holds the target mode identified from each simulated decay, or None and the reason. `fitted_mm` is the
    fit whose residual is the noise, that of the identification when absent.
    """
    noise = noise_sd_mm(setting, identification, runs)
    if fitted_mm is None:
        after = identification.decay_rows
        fitted_mm = np.nan_to_num((identification.fitted - identification.baseline)[after])
    samples = Samples(
        time_s=setting.time_s,
        values=setting.measured_mm,
        used=setting.used & np.isfinite(noise),
        fitted=fitted_mm,
        noise_sd=np.nan_to_num(noise, nan=1.0),
        period_s=2.0 * np.pi / float(setting.omega_rad_s[setting.at]),
    )
    predictions = _predictions(setting, runs, samples.noise_sd)
    valid = samples.used & np.isfinite(samples.values)
    measured = setting.coordinate_of(setting.measured_mm)
    first = next(iter(predictions.values()))
    decays = []
    for label, prediction in predictions.items():
        run, (mode, note) = runs[label], identified[label]
        missed = (prediction.mean - samples.values)[valid]
        envelope, phase = envelope_and_phase_error(
            setting.time_s, measured, setting.coordinate_of(prediction.mean), abs(setting.exponent)
        )
        decays.append(
            ModelDecay(
                model=label,
                simulated=run.central,
                nrmse=float(np.sqrt(np.mean(missed**2) / np.mean(samples.values[valid] ** 2))),
                frequency_hz=float("nan") if mode is None else mode.frequency_hz,
                damping_ratio=float("nan") if mode is None else mode.damping_ratio,
                frequency_shift=float("nan") if mode is None else mode.frequency_shift,
                envelope_error=envelope,
                phase_error_rad=phase,
                band_low=run.low,
                band_high=run.high,
                predictive_sd=np.where(np.isfinite(noise), prediction.sd, np.nan),
                log_density=score_sum(samples, log_density, prediction),
                crps=score_sum(samples, crps, prediction),
                log_density_gain=score_difference(samples, log_density, first, prediction),
                crps_gain=score_difference(samples, crps, first, prediction),
                coverage=float(np.mean(np.abs(missed) <= SD_OF_90 * prediction.sd[valid])),
                note=" ".join(part for part in (note, run.note) if part),
            )
        )
    return tuple(decays)


def frequency_shift(mode: IdentifiedMode) -> tuple[float, float]:
    """Relative frequency shift at the initial amplitude, and its standard deviation."""
    amplitude_fit = mode.amplitude_dependence
    if amplitude_fit is None or not amplitude_fit.f0_hz > 0.0:
        return float("nan"), float("nan")
    return amplitude_fit.f2_hz / amplitude_fit.f0_hz, amplitude_fit.f2_sd_hz / amplitude_fit.f0_hz


def _predictions(
    setting: DecaySetting, runs: Mapping[str, Simulated], noise_mm: FloatArray
) -> dict[str, Prediction]:
    """Predictive density of each model: noise, draws, and the larger of scatter and misfit of the beam's shape."""
    # rms over a period of the misfit, which decays as measured
    decay = np.exp(setting.exponent.real * setting.time_s)
    misfit = np.outer(decay, np.abs(setting.matched.missed_mm)) / np.sqrt(2.0)
    return {
        label: Prediction(
            np.nan_to_num(run.central),
            np.sqrt(noise_mm**2 + run.sd**2 + np.maximum(misfit, run.shape_sd) ** 2),
        )
        for label, run in runs.items()
    }


def _rms(values: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Rms of each channel; NaN without valid samples."""
    count = valid.sum(axis=0)
    total = (values**2).sum(axis=0)
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)))
