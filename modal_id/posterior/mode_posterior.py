"""Posterior of one mode of a fitted model: noise level, amplitude dependence, systematic uncertainty, sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, fdtrc, ndtri

from modal_id.curve import amplitude_curve, explains
from modal_id.data import are_many, outlier_share
from modal_id.fit import AmplitudeFit, ModalFit, fit_amplitude_dependence, own_decay
from modal_id.posterior.likelihood import REACH_SD, PoleDensity, reduce_mode
from modal_id.posterior.noise import NoiseLevel, noise_level
from modal_id.posterior.sampler import SamplingError, sample
from modal_id.results import (
    AmplitudeCurve,
    AmplitudeDependence,
    DrivenMotion,
    FailedMode,
    Identification,
    IdentifiedMode,
    Posterior,
    SampledDraws,
)
from modal_id.settings import IdentifySettings
from modal_id.solve import damping_ratio, frequency_hz
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Dependence of damping on the amplitude, and what the posterior includes."""

    #: [1] probability that noise alone shows a dependence
    #: statistics: One mode in a hundred.
    false_alarm: float = 0.01
    #: [sd] change over the record that errors which repeat with the motion do not explain
    #: statistics: 0.3 % exceed it.
    beyond: float = 3.0
    #: [1] correlation between poles of two modes above which the uncertainty of one is included in that of the other
    coupled: float = 0.02
    #: [1] prior sd of the slope zeta1 over zeta
    #: measurement: The damping of metal cantilevers in air falls by a third while the amplitude falls to a third.
    slope_prior: float = 0.25
    #: [1] prior sd of the change of the frequency from small amplitude to that at the start, over the frequency
    #: measurement: The sample beam's modes 2 to 5 fall by 1e-4, a strip of 400 mm at 2 mm in mode 2 by 3e-5.
    frequency_prior: float = 1e-3
    #: [1] relative sd of the frequency from which a motion that need not decay is no mode
    hardly_known: float = 0.02


TUNING = Tuning()


# Middles of parts of a record, over its length.
_PARTS = (np.arange(400) + 0.5) / 400

# Power that the fit leaves at a mode, relative to the noise beside it, above which the fit is not adequate.
MUCH_LEFT = 4.0


def find_dependence(
    model: ModalFit,
    own: ModalFit,
    amplitude_fit: AmplitudeFit | None,
    noise: NoiseLevel,
    index: int,
    repeating_sd: tuple[float, float] = (0.0, 0.0),
) -> AmplitudeDependence | None:
    """Linear form of all samples and curve of any form; None where the record determines neither.

    Significant where the linear form improves the fit by more than chance does in 1 % of records with constant values,
    or where the posterior probability of constant values is below 1 %. `own` is the fit that `amplitude_fit` extends,
    as from `own_decay`. `repeating_sd` are the standard deviations of
    frequency (Hz) and damping ratio for errors that repeat with the motion: the curve includes them, and a change of
    less than three of them is not significant. Where no curve explains the record, and two
    modes do or the linear form leaves many outliers, the standard deviations include the distances to the constant
    values.
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


def left_at_mode(dependence: AmplitudeDependence | None) -> float:
    """Residual power at the mode relative to the noise, NaN without a curve.

    That of the curve where the dependence is significant, else that of constant values.
    """
    if dependence is None or dependence.curve is None:
        return float("nan")
    curve = dependence.curve
    return curve.residual_power if dependence.significant else curve.constant_residual_power


def _varies(curve: AmplitudeCurve, repeating_sd: tuple[float, float]) -> bool:
    changes = float(np.ptp(curve.frequency_hz)), float(np.ptp(curve.damping_ratio))
    beyond = any(change > TUNING.beyond * sd for change, sd in zip(changes, repeating_sd, strict=True))
    return curve.constant_probability < TUNING.false_alarm and beyond


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
    lowest = min(float(np.exp(model.fit.poles[index].real * model.data.span_s)), 1.0)
    beyond = (0.5 * abs(p[2]) * lowest / omega, abs(p[3]) * lowest**2 / (2.0 * np.pi))
    improves = bool(fdtrc(2.0, noise.dof, statistic) < TUNING.false_alarm)
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
    share = expit(0.5 * gain)
    weights = np.array([1.0 - share, share])
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (variances + (values - mean) ** 2)))


# Above this share of the initial amplitude at the end of the record, a dependence of damping on the amplitude can
# only be extrapolated.
LITTLE_DECAY = 0.6


@dataclass(frozen=True)
class DeterminedMode:
    """Everything that determines a mode's posterior before sampling.

    Attributes
    ----------
    frequency_hz : float
        Best fit.
    covariance : array, shape (2, 2)
        Of (omega_n, zeta) for white noise.
    dependence : AmplitudeDependence or None
    density : PoleDensity
        Log posterior density that emcee samples.
    systematic : tuple of float
        Standard deviations of frequency (Hz) and damping ratio added to the draws for model error.
    extrapolation : tuple of float
        As `Posterior.small_amplitude_shift_hz`, `Posterior.extrapolation_frequency_hz` and
        `Posterior.extrapolation_damping_ratio`.
    """

    frequency_hz: float
    covariance: FloatArray
    dependence: AmplitudeDependence | None
    density: PoleDensity
    systematic: tuple[float, float]
    extrapolation: tuple[float, float, float]


@dataclass(frozen=True)
class SampledMode:
    """Posterior of one mode, its amplitude dependence, and whether the sampler met its autocorrelation criterion."""

    posterior: Posterior
    dependence: AmplitudeDependence | None
    long_enough: bool


def sample_mode(model: ModalFit, index: int, settings: IdentifySettings) -> SampledMode | FailedMode:
    """Posterior of the mode with this index."""
    found = determine_mode(model, index)
    if isinstance(found, FailedMode):
        return found
    sd = np.sqrt(np.diag(found.covariance))
    streams = tuple(
        np.random.SeedSequence(settings.seed, spawn_key=(*settings.seed_key, index, ensemble))
        for ensemble in range(settings.sampler.ensembles)
    )
    correlation = float(np.clip(found.covariance[0, 1] / (sd[0] * sd[1]), -0.99, 0.99))
    try:
        draws = sample(found.density, correlation, settings.sampler, streams)
    except SamplingError as error:
        return FailedMode(f"near {found.frequency_hz:.4g} Hz {error}", frequency_hz=found.frequency_hz)
    frequencies, zetas = draws.omega_n_rad_s / (2.0 * np.pi), draws.zeta
    sampled = SampledDraws(frequencies, zetas, draws.log_density, found.density.noise.dof)
    undetermined = _undetermined(found.frequency_hz, frequencies, zetas)
    if undetermined is not None:
        return undetermined
    if max(found.systematic) > 0.0:
        key = (*settings.seed_key, index, settings.sampler.ensembles)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=key))
        frequencies, zetas = widened(frequencies, zetas, found.systematic, rng)
    posterior = Posterior(
        frequencies,
        zetas,
        draws.r_hat,
        draws.ess,
        draws.autocorrelation_steps,
        draws.acceptance,
        found.density.noise.factor,
        *found.systematic,
        (float(sd[0] / (2.0 * np.pi)), float(sd[1])),
        (settings.seed, *settings.seed_key, index),
        extrapolation_damping_ratio=found.extrapolation[2],
        sampled=sampled,
        small_amplitude_shift_hz=found.extrapolation[0],
        extrapolation_frequency_hz=found.extrapolation[1],
    )
    return SampledMode(posterior, found.dependence, draws.long_enough)


def _undetermined(frequency_hz: float, frequencies_hz: FloatArray, zetas: FloatArray) -> FailedMode | None:
    """Failure of a motion whose frequency is hardly known and which need not decay: a drift looks like that."""
    sd_hz, zeta_sd = float(np.std(frequencies_hz)), float(np.std(zetas))
    if sd_hz < TUNING.hardly_known * frequency_hz or 2.0 * zeta_sd < float(np.median(zetas)):
        return None
    return FailedMode(
        f"the record does not determine the motion near {frequency_hz:.3g} Hz (standard deviation {sd_hz:.2g} Hz, that "
        f"of the damping ratio {100.0 * zeta_sd:.2g} %): it may be a drift instead of a vibration; film a free decay "
        "of at least ten cycles",
        frequency_hz=frequency_hz,
    )


def determine_mode(model: ModalFit, index: int) -> DeterminedMode | FailedMode:
    """Noise level, dependence on amplitude and posterior density of the mode with this index."""
    pole = complex(model.fit.poles[index])
    frequency, zeta = float(frequency_hz(pole)), float(damping_ratio(pole))
    covariance = _to_modal(model.fit.poles, index, model.fit.covariance)
    sd = np.sqrt(np.diag(covariance))
    own = own_decay(model, index)
    amplitude_fit = fit_amplitude_dependence(own.problem, own.fit, 0)
    noise = noise_level(model, amplitude_fit, index)
    if zeta + 2.0 * sd[1] * noise.factor <= 0.0:
        return FailedMode(
            f"the motion at {frequency:.4g} Hz does not decay (damping ratio {zeta:.2g}): it is a forced vibration, a "
            "hum, or noise; record the free decay after the stop",
            frequency_hz=frequency,
        )
    reach = REACH_SD * noise.factor * float(np.max(model.fit.pole_sd[index]))
    likelihood = reduce_mode(model.problem, model.fit, index, _coupled(model.fit.covariance, index), reach)
    if likelihood is None:
        return FailedMode(
            f"this record hardly determines frequency and damping near {frequency:.4g} Hz; "
            "a longer record or less noise is needed",
            frequency_hz=frequency,
        )
    density = PoleDensity(
        likelihood,
        (abs(pole), zeta),
        (float(sd[0] * noise.factor), float(sd[1] * noise.factor)),
        noise,
        float(likelihood.chi_square(np.zeros(1, dtype=complex))[0]),
    )
    repeating = (
        np.zeros((2, 2)) if model.repeating is None else _to_modal(model.fit.poles, index, model.repeating)
    )
    repeating_sd = (float(np.sqrt(repeating[0, 0])) / (2.0 * np.pi), float(np.sqrt(repeating[1, 1])))
    inflation = float(np.sqrt(1.0 + repeating[1, 1] / (covariance[1, 1] * noise.factor**2)))
    inflated = replace(noise, factor=noise.factor * inflation)
    dependence = find_dependence(model, own, amplitude_fit, inflated, index, repeating_sd)
    noise_sd = (float(sd[0] / (2.0 * np.pi)) * noise.factor, float(sd[1]) * noise.factor)
    extra = _systematic(pole, model.data.span_s, dependence, noise_sd, model.unresolved_near(index))
    extra = (float(np.hypot(extra[0], repeating_sd[0])), float(np.hypot(extra[1], repeating_sd[1])))
    left = min(float(np.exp(pole.real * model.data.span_s)), 1.0)
    beyond = *_frequency_beyond(frequency, left, dependence), _beyond(abs(zeta), left, dependence)
    return DeterminedMode(frequency, covariance, dependence, density, extra, beyond)


def _systematic(
    pole: complex,
    span_s: float,
    dependence: AmplitudeDependence | None,
    noise_sd: tuple[float, float],
    pair: ComplexArray | None,
) -> tuple[float, float]:
    """Standard deviations of frequency (Hz) and damping ratio for the error of a constant pole.

    Where the mode may be an unresolved pair, they include the distances to both of its modes.
    """
    frequency, zeta = float(frequency_hz(pole)), float(damping_ratio(pole))
    extra = (0.0, 0.0)
    left = min(float(np.exp(pole.real * span_s)), 1.0)
    if dependence is not None and dependence.significant:
        extra = _reach(frequency, zeta, dependence)
    elif (left_power := left_at_mode(dependence)) > MUCH_LEFT:
        # The noise factor is that of the noise beside the mode.
        more = float(np.sqrt(left_power - 1.0))
        extra = (more * noise_sd[0], more * noise_sd[1])
    if pair is not None:
        apart = np.abs(frequency_hz(pair) - frequency), np.abs(damping_ratio(pair) - zeta)
        extra = (max(extra[0], float(np.max(apart[0]))), max(extra[1], float(np.max(apart[1]))))
    if left > LITTLE_DECAY:
        # From the mean amplitude, (1 + left) / 2, to the largest and the smallest of the record.
        unseen = 0.5 * (1.0 - left) * _unseen_slope_sd(abs(zeta), dependence)
        extra = (extra[0], float(np.hypot(extra[1], unseen)))
    return extra


def _reach(frequency: float, zeta: float, dependence: AmplitudeDependence) -> tuple[float, float]:
    """Distances of the constant values to those at zero amplitude or, if further and there is a curve, at the start."""
    if dependence.curve is None:
        return abs(dependence.f0_hz - frequency), abs(dependence.small_amplitude_damping[0] - zeta)
    ends = dependence.curve.frequency_hz[[0, -1]], dependence.curve.damping_ratio[[0, -1]]
    return float(np.max(np.abs(ends[0] - frequency))), float(np.max(np.abs(ends[1] - zeta)))


def _to_modal(poles: ComplexArray, index: int, covariance: FloatArray) -> FloatArray:
    """Covariance of (omega_n, zeta) of one mode from that of (Re, Im) of all poles."""
    pole = complex(poles[index])
    omega, re, im = abs(pole), pole.real, pole.imag
    to_modal = np.array([[re / omega, im / omega], [-(im**2) / omega**3, re * im / omega**3]])
    block = slice(2 * index, 2 * index + 2)
    return np.asarray(to_modal @ covariance[block, block] @ to_modal.T)


def _unseen_slope_sd(zeta: float, dependence: AmplitudeDependence | None) -> float:
    """Standard deviation of zeta1 in zeta(a) = zeta0 + zeta1 a from prior and record, where the record hardly shows it.

    The constant damping ratio is that at the mean amplitude m = (1 + left) / 2 of the record, h = (1 - left) / 2 from
    its ends: an error of zeta1 adds h zeta1 to it, as long as the amplitude stays in the record's range, and m zeta1 to
    the limit at zero amplitude. m^2 = h^2 + left.
    """
    precision = (TUNING.slope_prior * zeta) ** -2.0
    if dependence is not None:
        precision += dependence.zeta1_sd**-2.0
    return 1.0 / float(np.sqrt(precision))


def _beyond(zeta: float, left: float, dependence: AmplitudeDependence | None) -> float:
    """Standard deviation of the limit at zero amplitude beyond that of the constant damping ratio.

    m zeta1; where little of the amplitude is lost, h zeta1 is in the constant ratio already, and the rest is left. That
    no dependence is significant does not mean that there is none.
    """
    share = np.sqrt(left) if left > LITTLE_DECAY else 0.5 * (1.0 + left)
    return _unseen_slope_sd(zeta, dependence) * float(share)


def _frequency_beyond(
    frequency_hz: float, left: float, dependence: AmplitudeDependence | None
) -> tuple[float, float]:
    """Mean and standard deviation of the limit at zero amplitude less the constant frequency: f2 in f0 + f2 a^2.

    The constant frequency is the slope of the phase, fitted with the squared amplitude as weight: f0 + f2 / 4 where all
    amplitude is lost, f0 + f2 where none is. f2 is that of the record where its prior is wide.
    """
    prior, record = (TUNING.frequency_prior * frequency_hz) ** -2.0, 0.0
    if dependence is not None:
        record = dependence.f2_sd_hz**-2.0
    weight = left ** (2.0 * _PARTS)
    phase = (np.cumsum(weight) - 0.5 * weight) / _PARTS.size
    at = _PARTS - np.average(_PARTS, weights=weight)
    share = float(np.sum(weight * at * phase) / np.sum(weight * at**2))
    f2_hz = 0.0 if dependence is None else dependence.f2_hz * record / (prior + record)
    return -share * f2_hz, share / float(np.sqrt(prior + record))


def _coupled(covariance: FloatArray, index: int) -> NDArray[np.intp]:
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.abs(covariance / np.outer(sd, sd))
    own = [2 * index, 2 * index + 1]
    strongest = np.max(correlation[own].reshape(2, -1, 2), axis=(0, 2))
    strongest[index] = 0.0
    return np.flatnonzero(strongest > TUNING.coupled)


def widened(
    frequencies_hz: FloatArray,
    zetas: FloatArray,
    extra_sd: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Draws of frequency and damping ratio plus a normal error of standard deviations `extra_sd`, in any shape.

    The medians do not change. Damping ratios stay positive: a sum below half of the draw is mapped by an exponential
    that joins smoothly. A reflection at zero would raise the median.
    """
    # Normal scores in random order: the sum of the errors is zero.
    scores = ndtri((np.arange(zetas.size) + 0.5) / zetas.size)
    wide_hz = frequencies_hz + extra_sd[0] * rng.permutation(scores).reshape(zetas.shape)
    wide = zetas + extra_sd[1] * rng.permutation(scores).reshape(zetas.shape)
    half = 0.5 * zetas
    return wide_hz, np.where(wide < half, half * np.exp(np.minimum(wide / half, 1.0) - 1.0), wide)


def with_rate_error(found: Identification) -> Identification:
    """The identification with the error of the frame rate in every frequency; unchanged where the rate is exact.

    A wrong rate stretches time: all frequencies are wrong by the same factor, damping ratios and ratios of frequencies
    are not. The draws of all modes are therefore multiplied by the same random factors of mean 1; driven motions have
    no draws, and their standard deviations are increased.
    """
    ppm = found.series.rate_sd_ppm
    if ppm == 0.0:
        return found
    note = (
        f"The frame rate is known to {ppm:g} ppm (relative sd): the interval of every frequency includes it. The error "
        "is common to all modes and to all recordings of one camera, and does not affect damping ratios. If the rate "
        "is known better, give fps_tolerance_ppm."
    )
    return replace(
        found,
        modes=tuple(_widened(mode, ppm) for mode in found.modes),
        driven=tuple(_widened_line(line, ppm) for line in found.driven),
        notes=(*found.notes, note),
    )


def _widened_line(line: DrivenMotion, ppm: float) -> DrivenMotion:
    return replace(
        line, frequency_sd_hz=float(np.hypot(line.frequency_sd_hz, 1e-6 * ppm * line.frequency_hz))
    )


def _widened(mode: IdentifiedMode, ppm: float) -> IdentifiedMode:
    posterior, dependence = mode.posterior, mode.amplitude_dependence
    frequency_hz = posterior.frequency_hz * posterior.rate_factors(ppm)
    if dependence is not None:
        f0_sd_hz = float(np.hypot(dependence.f0_sd_hz, 1e-6 * ppm * dependence.f0_hz))
        curve = dependence.curve
        if curve is not None:
            curve = replace(
                curve, frequency_sd_hz=np.hypot(curve.frequency_sd_hz, 1e-6 * ppm * curve.frequency_hz)
            )
        dependence = replace(dependence, f0_sd_hz=f0_sd_hz, curve=curve)
    widened = replace(posterior, frequency_hz=frequency_hz, rate_sd_ppm=ppm)
    return replace(mode, posterior=widened, amplitude_dependence=dependence)
