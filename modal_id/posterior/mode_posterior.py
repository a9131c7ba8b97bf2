"""Posterior of one mode of a fitted model: noise level, systematic uncertainty, sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.fit import ModalFit, fit_amplitude_dependence, own_decay, with_constant_pole
from modal_id.mode_values import Errors, total_error
from modal_id.posterior.dependence import (
    LITTLE_DECAY,
    MUCH_LEFT,
    damping_limit_sd,
    find_dependence,
    frequency_limit,
    hidden_slope_sd,
    left_at_mode,
)
from modal_id.posterior.noise import noise_level
from modal_id.posterior.sampler import REACH_SD, PoleDensity, SamplingError, reduce_mode, sample
from modal_id.results import (
    AmplitudeDependence,
    DrivenMotion,
    FailedMode,
    Identification,
    IdentifiedMode,
    Posterior,
    SampledDraws,
)
from modal_id.sentences import Note, Reason
from modal_id.settings import IdentifySettings
from modal_id.solve import damping_ratio, frequency_hz, modal_slopes
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What the posterior of a mode includes."""

    #: [1] correlation between poles of two modes above which the uncertainty of one is included in that of the other
    coupled: float = 0.02
    #: [1] relative sd of the frequency from which a motion that need not decay is no mode
    hardly_known: float = 0.02
    #: [1] share of a mode's energy outside as many values as it has parameters below which other poles fit as well
    #: measurement: Of three samples before a gap, half of the frequencies are wrong by a quarter and more, with sd of
    #: 0.6 to 5 %; right modes of 1000 random records leave 3.5 % and more.
    spare_energy: float = 0.01


TUNING = Tuning()
HARDLY_KNOWN = TUNING.hardly_known


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
    errors : mapping of str to (float, float)
        As `Posterior.errors`.
    extrapolation : tuple of float
        As `Posterior.small_amplitude_shift_hz`, `Posterior.extrapolation_frequency_hz` and
        `Posterior.extrapolation_damping_ratio`.
    residual_power : float
        As `left_at_mode` returns it.
    """

    frequency_hz: float
    covariance: FloatArray
    dependence: AmplitudeDependence | None
    density: PoleDensity
    errors: Errors
    extrapolation: tuple[float, float, float]
    residual_power: float

    @property
    def systematic(self) -> tuple[float, float]:
        """Standard deviations of frequency (Hz) and damping ratio for all errors beside the noise."""
        return total_error(self.errors)


@dataclass(frozen=True)
class SampledMode:
    """Posterior of one mode, its amplitude dependence, whether the sampler met its autocorrelation criterion.

    ``residual_power`` is from `left_at_mode`.
    """

    posterior: Posterior
    dependence: AmplitudeDependence | None
    long_enough: bool
    residual_power: float


def sample_modes(
    model: ModalFit, wanted: BoolArray, settings: IdentifySettings, first_stream: int = 0
) -> tuple[SampledMode | FailedMode | None, ...]:
    """Posteriors of the modes that the mask names, None for the others.

    In order of their energy: what depends on its amplitude does not disturb those that follow. Their random streams
    are those from `first_stream` on.
    """
    found: list[SampledMode | FailedMode | None] = [None] * wanted.size
    for index in np.argsort(-model.energy, kind="stable").tolist():
        if wanted[index]:
            one = found[index] = sample_mode(model, index, settings, first_stream + index)
            dependence = one.dependence if isinstance(one, SampledMode) else None
            if dependence is not None and dependence.significant and wanted.size > 1:
                model = with_constant_pole(model, index)
    return tuple(found)


def sample_mode(
    model: ModalFit, index: int, settings: IdentifySettings, stream: int = 0
) -> SampledMode | FailedMode:
    """Posterior of the mode with this index, from the random stream with this number."""
    found = determine_mode(model, index)
    if isinstance(found, FailedMode):
        return found
    sd = np.sqrt(np.diag(found.covariance))
    streams = tuple(
        np.random.SeedSequence(settings.seed, spawn_key=(*settings.seed_key, stream, ensemble))
        for ensemble in range(settings.sampler.ensembles)
    )
    correlation = float(np.clip(found.covariance[0, 1] / (sd[0] * sd[1]), -0.99, 0.99))
    try:
        draws = sample(found.density, correlation, settings.sampler, streams)
    except SamplingError as error:
        return FailedMode.of(Reason.NOT_SAMPLED(hz=found.frequency_hz, error=error), found.frequency_hz)
    frequencies, zetas = draws.omega_n_rad_s / (2.0 * np.pi), draws.zeta
    sampled = SampledDraws(frequencies, zetas, draws.log_density, found.density.noise.dof)
    undetermined = _undetermined(found.frequency_hz, frequencies, zetas)
    if undetermined is not None:
        return undetermined
    posterior = Posterior(
        frequencies,
        zetas,
        draws.r_hat,
        draws.ess,
        draws.autocorrelation_steps,
        draws.acceptance,
        found.density.noise.factor,
        (float(sd[0] / (2.0 * np.pi)), float(sd[1])),
        (settings.seed, *settings.seed_key, stream),
        extrapolation_damping_ratio=found.extrapolation[2],
        sampled=sampled,
        small_amplitude_shift_hz=found.extrapolation[0],
        extrapolation_frequency_hz=found.extrapolation[1],
    )
    posterior = posterior.including(errors=found.errors)
    return SampledMode(posterior, found.dependence, draws.long_enough, found.residual_power)


def _undetermined(frequency_hz: float, frequencies_hz: FloatArray, zetas: FloatArray) -> FailedMode | None:
    """Failure of a motion whose frequency is hardly known and which need not decay: a drift looks like that."""
    sd_hz, zeta_sd = float(np.std(frequencies_hz)), float(np.std(zetas))
    if sd_hz < TUNING.hardly_known * frequency_hz or 2.0 * zeta_sd < float(np.median(zetas)):
        return None
    why = Reason.MAY_BE_DRIFT(hz=frequency_hz, sd_hz=sd_hz, zeta_sd_percent=100.0 * zeta_sd)
    return FailedMode.of(why, frequency_hz)


def determine_mode(model: ModalFit, index: int) -> DeterminedMode | FailedMode:
    """Noise level, dependence on amplitude and posterior density of the mode with this index."""
    pole = complex(model.fit.poles[index])
    frequency, zeta = float(frequency_hz(pole)), float(damping_ratio(pole))
    covariance = _to_modal(model.fit.poles, index, model.fit.covariance)
    sd = np.sqrt(np.diag(covariance))
    own = own_decay(model, index)
    amplitude_fit = fit_amplitude_dependence(own.problem, own.fit, 0)
    noise = noise_level(model, amplitude_fit, index)
    if model.spare < 1.0 or model.spare_energy(index) < TUNING.spare_energy:
        # a fit through all samples, of which some were rejected, knows no noise
        return FailedMode.of(Reason.HARDLY_DETERMINED(hz=frequency), frequency)
    noise = replace(noise, dof=min(noise.dof, model.spare))
    if zeta + 2.0 * sd[1] * noise.factor <= 0.0:
        return FailedMode.of(Reason.FORCED(hz=frequency, zeta=zeta), frequency)
    reach = REACH_SD * noise.factor * float(np.max(model.fit.pole_sd[index]))
    likelihood = reduce_mode(model.problem, model.fit, index, _coupled(model.fit.covariance, index), reach)
    if likelihood is None:
        return FailedMode.of(Reason.HARDLY_DETERMINED(hz=frequency), frequency)
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
    residual_power = left_at_mode(own, amplitude_fit, dependence)
    if dependence is not None and dependence.curve is None and residual_power > MUCH_LEFT:
        dependence = dependence.doubted(frequency, zeta)
    left = model.amplitude_left(index)
    errors = _model_errors(pole, left, dependence, model.unresolved_near(index))
    if residual_power > MUCH_LEFT:
        # The noise factor is that of the noise beside the mode.
        more = noise.factor * float(np.sqrt(residual_power - 1.0))
        errors["unexplained"] = (more * float(sd[0]) / (2.0 * np.pi), more * float(sd[1]))
    errors["positions"] = repeating_sd
    errors = {cause: sd for cause, sd in errors.items() if max(sd) > 0.0}
    beyond = *frequency_limit(frequency, left, dependence), damping_limit_sd(abs(zeta), left, dependence)
    return DeterminedMode(frequency, covariance, dependence, density, errors, beyond, residual_power)


def _model_errors(
    pole: complex,
    left: float,
    dependence: AmplitudeDependence | None,
    pair: ComplexArray | None,
) -> dict[str, tuple[float, float]]:
    """Standard deviations of frequency (Hz) and damping ratio for the error of a constant pole, by cause.

    Where the mode may be an unresolved pair, they include the distances to both of its modes. `left` is the share of
    the amplitude at the end of the record.
    """
    frequency, zeta = float(frequency_hz(pole)), float(damping_ratio(pole))
    errors = {"amplitude": (0.0, 0.0)}
    if dependence is not None and dependence.significant:
        errors["amplitude"] = _reach(frequency, zeta, dependence)
    if pair is not None:
        apart = np.abs(frequency_hz(pair) - frequency), np.abs(damping_ratio(pair) - zeta)
        # a pair beats, which looks like a dependence: the larger of both counts
        more = [
            max(float(np.max(one)) ** 2 - own**2, 0.0)
            for one, own in zip(apart, errors["amplitude"], strict=True)
        ]
        errors["close mode"] = (float(np.sqrt(more[0])), float(np.sqrt(more[1])))
    if left > LITTLE_DECAY:
        # From the mean amplitude, (1 + left) / 2, to the largest and the smallest of the record.
        errors["little decay"] = (0.0, 0.5 * (1.0 - left) * hidden_slope_sd(abs(zeta), dependence))
    return errors


def _reach(frequency: float, zeta: float, dependence: AmplitudeDependence) -> tuple[float, float]:
    """Distances of the constant values to those at zero amplitude or, if further and there is a curve, at the start."""
    if dependence.curve is None:
        return abs(dependence.f0_hz - frequency), abs(dependence.small_amplitude_damping[0] - zeta)
    ends = dependence.curve.frequency_hz[[0, -1]], dependence.curve.damping_ratio[[0, -1]]
    return float(np.max(np.abs(ends[0] - frequency))), float(np.max(np.abs(ends[1] - zeta)))


def _to_modal(poles: ComplexArray, index: int, covariance: FloatArray) -> FloatArray:
    """Covariance of (omega_n, zeta) of one mode from that of (Re, Im) of all poles."""
    slopes, block = modal_slopes(complex(poles[index])), slice(2 * index, 2 * index + 2)
    return np.asarray(slopes @ covariance[block, block] @ slopes.T)


def _coupled(covariance: FloatArray, index: int) -> NDArray[np.intp]:
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.abs(covariance / np.outer(sd, sd))
    own = [2 * index, 2 * index + 1]
    strongest = np.max(correlation[own].reshape(2, -1, 2), axis=(0, 2))
    strongest[index] = 0.0
    return np.flatnonzero(strongest > TUNING.coupled)


def with_rate_error(found: Identification) -> Identification:
    """The identification with the error of the frame rate in every frequency; unchanged where the rate is exact.

    A wrong rate stretches time: all frequencies are wrong by the same factor, damping ratios and ratios of frequencies
    are not. The draws of all modes are therefore multiplied by the same random factors of mean 1; driven motions have
    no draws, and their standard deviations are increased.
    """
    ppm = found.series.rate_sd_ppm
    if ppm == 0.0:
        return found
    return replace(
        found,
        modes=tuple(_widened(mode, ppm) for mode in found.modes),
        driven=tuple(_widened_line(line, ppm) for line in found.driven),
        notes=(*found.notes, Note.RATE_ERROR(ppm=ppm)),
    )


def _widened_line(line: DrivenMotion, ppm: float) -> DrivenMotion:
    return replace(
        line, frequency_sd_hz=float(np.hypot(line.frequency_sd_hz, 1e-6 * ppm * line.frequency_hz))
    )


def _widened(mode: IdentifiedMode, ppm: float) -> IdentifiedMode:
    dependence = mode.amplitude_dependence
    if dependence is not None:
        f0_sd_hz = float(np.hypot(dependence.f0_sd_hz, 1e-6 * ppm * dependence.f0_hz))
        curve = dependence.curve
        if curve is not None:
            curve = replace(
                curve, frequency_sd_hz=np.hypot(curve.frequency_sd_hz, 1e-6 * ppm * curve.frequency_hz)
            )
        dependence = replace(dependence, f0_sd_hz=f0_sd_hz, curve=curve)
    posterior = mode.posterior.including(rate_sd_ppm=ppm)
    return replace(mode, posterior=posterior, amplitude_dependence=dependence)
