"""Dependence of a mode's frequency and damping ratio on its amplitude, and their limits at zero amplitude."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, fdtrc

from modal_id.curve import LEAST_CYCLES, amplitude_curve, explains
from modal_id.data import BEYOND_SD, are_many, outlier_share
from modal_id.fit import DECAY_TIMES, FALSE_ALARM, AmplitudeFit, ModalFit, fit_amplitude_dependence
from modal_id.posterior.noise import NoiseLevel
from modal_id.results import AmplitudeCurve, AmplitudeDependence
from modal_id.solve import damping_ratio, frequency_hz


@dataclass(frozen=True)
class Tuning:
    """What counts as a dependence, and what a record that hides it may have."""

    #: [1] prior sd of the slope zeta1 over zeta
    #: measurement: The damping of metal cantilevers in air falls by a third while the amplitude falls to a third.
    slope_prior: float = 0.25
    #: [1] prior sd of the change of the frequency from small amplitude to that at the start, over the frequency
    #: measurement: The sample beam's modes 2 to 5 fall by 1e-4, a strip of 400 mm at 2 mm in mode 2 by 3e-5.
    frequency_prior: float = 1e-3
    #: [bins] distance from a frequency within which the power of a line there lies, where a bin is 1 / length of the
    #: part of the record
    #: statistics: The power of seven bins of noise exceeds four times its mean six times in ten million.
    bins: int = 3
    #: [1] number of stretches of this length in the record, at least
    #: statistics: The noise is the median of the later ones, three at least.
    least_stretches: int = 4
    #: [1] power that the fit leaves at a mode, relative to the noise, above which the fit is not adequate
    #: statistics: See `bins`.
    much_left: float = 4.0
    #: [1] least weight of either form where both are averaged
    #: measurement: Unknown weak modes make the wrong form fit better by 7 to 8 in chi-square; the limit at zero was off
    #: by 4.7 sd (seeds 12604 and 12610 of `benchmarks.records`).
    least_weight: float = 0.1
    #: [1] share of the amplitude left at the end above which a dependence of damping on it is only extrapolated
    little_decay: float = 0.6


TUNING = Tuning()
MUCH_LEFT, LITTLE_DECAY = TUNING.much_left, TUNING.little_decay
LINE_BINS = TUNING.bins

# Middles of parts of a record, over its length.
_PARTS = (np.arange(400) + 0.5) / 400


def find_dependence(
    model: ModalFit,
    own: ModalFit,
    amplitude_fit: AmplitudeFit | None,
    noise: NoiseLevel,
    index: int,
    repeating_sd: tuple[float, float],
) -> AmplitudeDependence | None:
    """Linear form of all samples and curve of any form; None where the record determines neither.

    Significant where the linear form improves the fit by more than chance does in 1 % of records with constant values,
    or where the posterior probability of constant values is below 1 %. `own` is the fit that `amplitude_fit` extends,
    as from `own_decay`. `repeating_sd` are the standard deviations of frequency (Hz) and damping ratio for errors that
    repeat with the motion: the curve includes them, and a change of less than three of them is not significant. Where
    no curve explains the record, and two modes do or the linear form leaves many outliers, the standard deviations
    include the distances to the constant values.
    """
    curve = amplitude_curve(model, index, own)
    varies = False
    if curve is not None:
        curve = replace(
            curve,
            frequency_sd_hz=np.hypot(curve.frequency_sd_hz, repeating_sd[0]),
            damping_ratio_sd=np.hypot(curve.damping_ratio_sd, repeating_sd[1]),
        )
        varies = _varies(curve, repeating_sd)
    if amplitude_fit is not None:
        found = _linear(model, own, amplitude_fit, noise, index, curve, varies=varies)
        if curve is not None and explains(curve):
            return found
        outliers = outlier_share(own.data.weights, amplitude_fit.linear.residual)
        if not are_many(outliers) and model.unresolved_near(index) is None:
            return found
        pole = model.fit.poles[index]
        return found.doubted(float(frequency_hz(pole)), float(damping_ratio(pole)))
    if curve is None or not varies:
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


def left_at_mode(
    own: ModalFit, amplitude_fit: AmplitudeFit | None, dependence: AmplitudeDependence | None
) -> float:
    """Residual power at the mode relative to the noise.

    That of the curve where the dependence is significant, else that of constant values. Without a curve, that of the
    first decay times about the frequency of the mode over that of later stretches as long: what a strongly damped mode
    leaves vanishes in the noise of a long record. NaN where fewer than four such stretches fit into the record.
    """
    significant = dependence is not None and dependence.significant
    if dependence is not None and dependence.curve is not None:
        curve = dependence.curve
        return curve.residual_power if significant else curve.constant_residual_power
    linear = own.fit.linear if amplitude_fit is None or not significant else amplitude_fit.linear
    data, pole = own.data, complex(own.fit.poles[0])
    hz = abs(pole.imag) / (2.0 * np.pi)
    length_s = max(DECAY_TIMES / max(-pole.real, 1e-300), LEAST_CYCLES / max(hz, 1e-300))
    count = int(data.span_s / length_s)
    if count < TUNING.least_stretches:
        return float("nan")
    bins_hz = hz + np.arange(-LINE_BINS, LINE_BINS + 1) / length_s
    weights = data.weights / linear.noise_variance
    edges = np.searchsorted(data.time_s, data.time_s[0] + length_s * np.arange(count))
    power = np.zeros(count)
    for bin_hz in bins_hz[bins_hz > 0.5 / length_s]:
        wave = np.exp(-2j * np.pi * bin_hz * data.time_s)
        scores = np.add.reduceat(weights * linear.residual * wave[:, None], edges)
        power += np.sum(np.abs(scores) ** 2, axis=1)
    information = np.sum(np.add.reduceat(weights, edges), axis=1)
    relative = power[information > 0.0] / information[information > 0.0]
    return (
        float(relative[0] / np.median(relative[1:]))
        if relative.size >= TUNING.least_stretches
        else float("nan")
    )


def _varies(curve: AmplitudeCurve, repeating_sd: tuple[float, float]) -> bool:
    changes = float(np.ptp(curve.frequency_hz)), float(np.ptp(curve.damping_ratio))
    beyond = any(change > BEYOND_SD * sd for change, sd in zip(changes, repeating_sd, strict=True))
    return curve.constant_probability < FALSE_ALARM and beyond


def _linear(
    model: ModalFit,
    own: ModalFit,
    amplitude_fit: AmplitudeFit,
    noise: NoiseLevel,
    index: int,
    curve: AmplitudeCurve | None,
    *,
    varies: bool,
) -> AmplitudeDependence:
    variance, own_variance = model.fit.linear.noise_variance, amplitude_fit.linear.noise_variance
    # The noise factor is relative to the fit with constant poles; covariance and statistic to the amplitude fit.
    weight = np.abs(model.fit.linear.amplitudes[index]) ** 2 / variance
    factor = noise.factor * float(np.sqrt(np.sum(weight * (variance / own_variance)) / np.sum(weight)))
    p = [float(value) for value in amplitude_fit.parameters]
    sd = [float(value) for value in np.sqrt(np.diag(amplitude_fit.covariance)) * factor]
    omega = float(np.hypot(p[0], p[1]))
    drop = float(np.sum((own.fit.linear.rss - amplitude_fit.linear.rss) / own_variance))
    statistic = 0.5 * max(drop, 0.0) / factor**2
    # Below the lowest amplitude of the record the form is an assumption: another power changes the values at zero.
    lowest = model.amplitude_left(index)
    beyond = (0.5 * abs(p[2]) * lowest / omega, abs(p[3]) * lowest**2 / (2.0 * np.pi))
    improves = bool(fdtrc(2.0, noise.dof, statistic) < FALSE_ALARM)
    zeta0, zeta0_sd = p[0] / omega, float(np.hypot(sd[0] / omega, beyond[0]))
    averaged = (float("nan"), float("nan"))
    if curve is None and improves:
        averaged = _over_forms(own, amplitude_fit, factor, (zeta0, zeta0_sd), lowest)
    return AmplitudeDependence(
        zeta0=zeta0,
        zeta0_sd=zeta0_sd,
        zeta1=p[2] / omega,
        zeta1_sd=sd[2] / omega,
        f0_hz=omega / (2.0 * np.pi),
        f0_sd_hz=float(np.hypot(sd[1] / (2.0 * np.pi), beyond[1])),
        f2_hz=p[3] / (2.0 * np.pi),
        f2_sd_hz=sd[3] / (2.0 * np.pi),
        significant=improves or varies,
        curve=curve,
        averaged=averaged,
    )


def _over_forms(
    own: ModalFit, linear: AmplitudeFit, factor: float, zeta0: tuple[float, float], lowest: float
) -> tuple[float, float]:
    """Damping ratio at zero amplitude and its sd over forms linear in a and in a^2; NaN where the latter has no fit.

    `zeta0` are those of the linear form, `factor` is the noise factor, `lowest` the lowest amplitude of the record.
    """
    square = fit_amplitude_dependence(own.problem, own.fit, 0, 2)
    if square is None:
        return float("nan"), float("nan")
    p = square.parameters
    omega = float(np.hypot(p[0], p[1]))
    sd = float(np.sqrt(square.covariance[0, 0])) * factor / omega
    values = np.array([zeta0[0], float(p[0]) / omega])
    # What the form does below the lowest amplitude is an assumption.
    variances = np.array([zeta0[1] ** 2, sd**2 + (0.5 * float(p[2]) * lowest / omega) ** 2])
    gain = float(np.sum((linear.linear.rss - square.linear.rss) / linear.linear.noise_variance)) / factor**2
    share = float(np.clip(expit(0.5 * gain), TUNING.least_weight, 1.0 - TUNING.least_weight))
    weights = np.array([1.0 - share, share])
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (variances + (values - mean) ** 2)))


def hidden_slope_sd(zeta: float, dependence: AmplitudeDependence | None) -> float:
    """Standard deviation of zeta1 in zeta(a) = zeta0 + zeta1 a from prior and record, where the record hardly shows it.

    The constant damping ratio is that at the mean amplitude m = (1 + left) / 2 of the record, h = (1 - left) / 2 from
    its ends: an error of zeta1 adds h zeta1 to it, as long as the amplitude stays in the record's range, and m zeta1 to
    the limit at zero amplitude. m^2 = h^2 + left.
    """
    precision = (TUNING.slope_prior * zeta) ** -2.0
    if dependence is not None:
        precision += dependence.zeta1_sd**-2.0
    return 1.0 / float(np.sqrt(precision))


def damping_limit_sd(zeta: float, left: float, dependence: AmplitudeDependence | None) -> float:
    """Standard deviation of the limit at zero amplitude beyond that of the constant damping ratio.

    m zeta1; where little of the amplitude is lost, h zeta1 is in the constant ratio already, and the rest is left. That
    no dependence is significant does not mean that there is none.
    """
    share = np.sqrt(left) if left > LITTLE_DECAY else 0.5 * (1.0 + left)
    return hidden_slope_sd(zeta, dependence) * float(share)


def frequency_limit(
    frequency_hz: float, left: float, dependence: AmplitudeDependence | None
) -> tuple[float, float]:
    """Mean and standard deviation of the limit at zero amplitude less the constant frequency: f2 in f0 + f2 a^2.

    The constant frequency is the slope of the phase, fitted with the squared amplitude as weight: f0 + f2 / 4 where all
    amplitude is lost, f0 + f2 where none is. f2 is that of the record where its prior is wide.
    """
    prior, record = (TUNING.frequency_prior * frequency_hz) ** -2.0, 0.0
    if dependence is not None:
        record = dependence.f2_sd_hz**-2.0
    # nothing is left of a strong decay in a long record
    weight = max(left, 1e-300) ** (2.0 * _PARTS)
    phase = (np.cumsum(weight) - 0.5 * weight) / _PARTS.size
    at = _PARTS - np.average(_PARTS, weights=weight)
    share = float(np.sum(weight * at * phase) / np.sum(weight * at**2))
    f2_hz = 0.0 if dependence is None else dependence.f2_hz * record / (prior + record)
    return -share * f2_hz, share / float(np.sqrt(prior + record))
