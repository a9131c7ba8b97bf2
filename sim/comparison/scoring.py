"""Predictive density of every sample; scores, errors and coverage of each model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification
from sim.comparison.bands import Simulated
from sim.comparison.errors import envelope_and_phase_error
from sim.comparison.problem import DecaySetting
from sim.comparison.scores import (
    SD_OF_90,
    Prediction,
    Samples,
    ScoreSum,
    crps,
    log_density,
    score_difference,
    score_sum,
)
from tracker.arrays import FloatArray


@dataclass(frozen=True)
class Scores:
    """Scores of one model for one recording; fields as in `sim.comparison.results.ModelDecay`."""

    nrmse: float
    envelope_error: float
    phase_error_rad: float
    predictive_sd: FloatArray
    log_density: ScoreSum
    crps: ScoreSum
    log_density_gain: ScoreSum
    crps_gain: ScoreSum
    coverage: float


def noise_sd_mm(
    setting: DecaySetting, identification: Identification, models: Mapping[str, Simulated]
) -> FloatArray:
    """Standard deviation of every sample's noise, shape (n, k).

    The series gives the relative standard deviations of the samples of a channel, the residual its noise level: that
    of the identification's fit, or of a simulation where that is smaller, as for an amplitude-dependent damping ratio,
    which Eq. 1 does not describe.
    """
    after = identification.series.time_s >= identification.onset.fit_from_s
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


def scored(
    setting: DecaySetting,
    identification: Identification,
    models: Mapping[str, Simulated],
    fitted_mm: FloatArray | None = None,
) -> dict[str, Scores]:
    """Scores of every model; gains are those of the first over each.

    `fitted_mm` is the fit whose residual is the noise, by default that of the identification.
    """
    noise = noise_sd_mm(setting, identification, models)
    after = identification.series.time_s >= identification.onset.fit_from_s
    samples = Samples(
        time_s=setting.time_s,
        values=setting.measured_mm,
        used=setting.used & np.isfinite(noise),
        fitted=np.nan_to_num((identification.fitted - identification.baseline)[after])
        if fitted_mm is None
        else fitted_mm,
        noise_sd=np.nan_to_num(noise, nan=1.0),
        period_s=2.0 * np.pi / float(setting.omega_rad_s[setting.at]),
    )
    shape = _shape_sd_mm(setting)
    predictions = {
        label: Prediction(
            np.nan_to_num(model.central),
            np.sqrt(samples.noise_sd**2 + model.sd**2 + np.maximum(shape, model.shape_sd) ** 2),
        )
        for label, model in models.items()
    }
    first = next(iter(predictions.values()))
    return {
        label: _scores(setting, samples, prediction, first, noise)
        for label, prediction in predictions.items()
    }


def _scores(
    setting: DecaySetting, samples: Samples, prediction: Prediction, first: Prediction, noise: FloatArray
) -> Scores:
    valid = samples.used & np.isfinite(samples.values)
    missed = (prediction.mean - samples.values)[valid]
    measured = setting.coordinate_of(setting.measured_mm)
    envelope, phase = envelope_and_phase_error(
        setting.time_s, measured, setting.coordinate_of(prediction.mean), abs(setting.exponent)
    )
    return Scores(
        nrmse=float(np.sqrt(np.mean(missed**2) / np.mean(samples.values[valid] ** 2))),
        envelope_error=envelope,
        phase_error_rad=phase,
        predictive_sd=np.where(np.isfinite(noise), prediction.sd, np.nan),
        log_density=score_sum(samples, log_density, prediction),
        crps=score_sum(samples, crps, prediction),
        log_density_gain=score_difference(samples, log_density, first, prediction),
        crps_gain=score_difference(samples, crps, first, prediction),
        coverage=float(np.mean(np.abs(missed) <= SD_OF_90 * prediction.sd[valid])),
    )


def _shape_sd_mm(setting: DecaySetting) -> FloatArray:
    """Rms over a period of the misfit of the beam's shape, decaying as measured, shape (n, k)."""
    decay = np.exp(setting.exponent.real * setting.time_s)
    return np.asarray(np.outer(decay, np.abs(setting.matched.missed_mm)) / np.sqrt(2.0))


def _rms(values: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Rms of each channel; NaN without valid samples."""
    count = valid.sum(axis=0)
    total = (values**2).sum(axis=0)
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)))
