"""Dependence of a mode's damping and frequency on its amplitude, and whether it is significant."""

from __future__ import annotations

import numpy as np
from scipy.stats import f as f_distribution

from modal_id.curve.average import amplitude_curve
from modal_id.fit.amplitude_dependence import AmplitudeFit
from modal_id.fit.model_order import ModalFit
from modal_id.posterior.noise import NoiseLevel
from modal_id.results import AmplitudeCurve, AmplitudeDependence

_FALSE_ALARM = 0.01


def find_dependence(
    model: ModalFit, amplitude_fit: AmplitudeFit | None, noise: NoiseLevel, index: int
) -> AmplitudeDependence | None:
    """Linear form of all samples and curve of any form; None where the record determines neither.

    Significant where the linear form improves the fit by more than chance does in 1 % of records with constant values,
    or where the posterior probability of constant values is below 1 %.
    """
    curve = amplitude_curve(model, index)
    if amplitude_fit is not None:
        return _linear(model, amplitude_fit, noise, index, curve)
    if curve is None or not _varies(curve):
        return None
    zeta, zeta_sd = curve.damping_ratio[[0, -1]], curve.damping_ratio_sd[[0, -1]]
    f, f_sd = curve.frequency_hz[[0, -1]], curve.frequency_sd_hz[[0, -1]]
    return AmplitudeDependence(
        zeta0=float(zeta[0]),
        zeta0_sd=float(zeta_sd[0]),
        zeta1=float(zeta[1] - zeta[0]),
        zeta1_sd=float(np.hypot(*zeta_sd)),
        f0_hz=float(f[0]),
        f0_sd_hz=float(f_sd[0]),
        f2_hz=float(f[1] - f[0]),
        f2_sd_hz=float(np.hypot(*f_sd)),
        significant=True,
        curve=curve,
    )


def _varies(curve: AmplitudeCurve | None) -> bool:
    return curve is not None and curve.constant_probability < _FALSE_ALARM


def _linear(
    model: ModalFit, amplitude_fit: AmplitudeFit, noise: NoiseLevel, index: int, curve: AmplitudeCurve | None
) -> AmplitudeDependence:
    variance, own_variance = model.fit.linear.noise_variance, amplitude_fit.linear.noise_variance
    # The noise factor is relative to the fit with constant poles; covariance and statistic to the amplitude fit.
    weight = np.abs(model.fit.linear.amplitudes[index]) ** 2 / variance
    factor = noise.factor * float(np.sqrt(np.sum(weight * (variance / own_variance)) / np.sum(weight)))
    p = [float(value) for value in amplitude_fit.parameters]
    sd = [float(value) for value in np.sqrt(np.diag(amplitude_fit.covariance)) * factor]
    omega = float(np.hypot(p[0], p[1]))
    drop = float(np.sum((model.fit.linear.rss - amplitude_fit.linear.rss) / own_variance))
    statistic = 0.5 * max(drop, 0.0) / factor**2
    improves = bool(f_distribution.sf(statistic, 2.0, noise.dof) < _FALSE_ALARM)
    return AmplitudeDependence(
        zeta0=p[0] / omega,
        zeta0_sd=sd[0] / omega,
        zeta1=p[2] / omega,
        zeta1_sd=sd[2] / omega,
        f0_hz=omega / (2.0 * np.pi),
        f0_sd_hz=sd[1] / (2.0 * np.pi),
        f2_hz=p[3] / (2.0 * np.pi),
        f2_sd_hz=sd[3] / (2.0 * np.pi),
        significant=improves or _varies(curve),
        curve=curve,
    )
