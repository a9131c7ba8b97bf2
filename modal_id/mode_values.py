"""Values of a mode: posterior, dependence on the amplitude, values in each of several decays, frequency responses."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from modal_id.columns import DAMPING, FREQUENCY
from tracker import Column, ComplexArray, FloatArray, data_frame, dataset

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes

# Separates the random stream of the frame rate from those of modes and ensembles.
_RATE_STREAM = 0xF75
# Errors that a mean over several decays does not include.
_ROLES = ("held", "driven")


# Errors beside the noise, by their cause: the standard deviations of the frequency in Hz and of the damping ratio.
Errors = Mapping[str, tuple[float, float]]


def total_error(errors: Errors) -> tuple[float, float]:
    """Standard deviations, of frequency in Hz and damping ratio, of all errors together; they are independent."""
    hz, zeta = (reduce(np.hypot, (one[k] for one in errors.values()), 0.0) for k in (0, 1))
    return float(hz), float(zeta)


class Table(ABC):
    """HTML display in notebooks of anything with a table. Such results compare by identity, since they hold arrays."""

    @abstractmethod
    def to_dataframe(self) -> pd.DataFrame:
        """The values as a table."""

    def _repr_html_(self) -> str:
        title = escape(repr(self).splitlines()[0])
        table = self.to_dataframe().to_html(index=False, max_rows=10, na_rep="")
        return f"<p>{title}</p>{table}"


@dataclass(frozen=True, repr=False, eq=False)
class SampledDraws:
    """Draws as emcee sampled them, before they are widened by errors of the model and of the frame rate.

    Attributes
    ----------
    frequency_hz, damping_ratio : array, shape (ensembles, draws)
    log_density : array, shape (ensembles, draws)
        Relative to the best fit. The prior is flat, so that it is also the log-likelihood of the decay, amplitudes,
        baseline and noise level marginalised: ``-(nu + 2) / 2 ln(1 + increase / (nu f^2))`` for the increase of
        chi-square over that of the best fit, with `Posterior.noise_factor` f.
    noise_dof : float
        nu, the degrees of freedom of the estimate of f^2.
    """

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    log_density: FloatArray
    noise_dof: float


@dataclass(frozen=True, repr=False, eq=False)
class Posterior(Table):
    """Draws of the frequency and damping ratio of one mode, ensembles kept apart.

    They are emcee's, or those of a normal density where the modes respond to a measured input: `r_hat`, `ess`,
    `autocorrelation_steps` and `acceptance` are then NaN.

    Attributes
    ----------
    frequency_hz, damping_ratio : array, shape (ensembles, draws)
        omega_n / 2 pi and zeta.
    r_hat : tuple of float
        Split R-hat over the independent ensembles (never over walkers) for frequency and damping ratio.
    ess : tuple of float
        Effective sample size of each.
    autocorrelation_steps : float
        Longest integrated autocorrelation time, in steps.
    acceptance : float
        Mean share of accepted proposals.
    noise_factor : float
        Factor on the white-noise standard deviation for the noise level near the mode.
    errors : mapping of str to (float, float)
        Standard deviations of frequency (Hz) and damping ratio that the draws include beside the noise, by cause:
        "amplitude" (frequency and damping depend on it), "close mode" (the mode may be two), "little decay" (the record
        shows few amplitudes), "unexplained" (motion that the fit leaves at the mode), "positions" (errors that return
        with the motion), "decays" (scatter between those of the record), "held" (a hand may hold the decay), "driven"
        (it may be a drive).
    mean : tuple of (float, float), or None
        Value and standard deviation of frequency (Hz) and damping ratio over several decays, which the draws have, the
        errors "held" and "driven" beside it.
    rate_sd_ppm : float
        Relative standard deviation of the frame rate in parts per million, which the draws of the frequency include:
        one factor in each draw, the same for all modes of a recording.
    laplace_sd : tuple of float
        Standard deviations of (frequency_hz, damping_ratio) by Laplace's approximation for white noise, without
        `noise_factor` and `errors`: a check on the sampler.
    seed : tuple of int
        Seed and spawn key of the random streams.
    extrapolation_damping_ratio, extrapolation_frequency_hz : float
        Standard deviations from damping ratio and frequency to their limits at zero amplitude, for a dependence on the
        amplitude that noise hides; the draws, which belong to the record's amplitudes, do not include them.
    small_amplitude_shift_hz : float
        Most probable limit of the frequency at zero amplitude less the frequency, where no dependence is significant.
    sampled : SampledDraws or None
        The draws before they were widened, those of the most informative decay of a record of several.

    Notes
    -----
    `frequency_hz` and `damping_ratio` follow from `sampled`, `errors`, `mean` and `rate_sd_ppm`, in this order;
    `including` derives them. Without `sampled`, a normal density includes all errors but that of the rate.
    """

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    noise_factor: float
    laplace_sd: tuple[float, float]
    seed: tuple[int, ...]
    rate_sd_ppm: float = 0.0
    extrapolation_damping_ratio: float = 0.0
    sampled: SampledDraws | None = None
    small_amplitude_shift_hz: float = 0.0
    extrapolation_frequency_hz: float = 0.0
    errors: Errors = field(default_factory=dict)
    mean: tuple[tuple[float, float], tuple[float, float]] | None = None

    def including(
        self,
        *,
        errors: Errors | None = None,
        mean: tuple[tuple[float, float], tuple[float, float]] | None = None,
        rate_sd_ppm: float | None = None,
    ) -> Posterior:
        """The posterior with draws for other errors, another mean or error of the rate than its own.

        Parameters
        ----------
        errors : mapping of str to (float, float), or None
            Standard deviations of frequency (Hz) and damping ratio by cause, in place of `errors`.
        mean : tuple of (float, float), or None
            Value and standard deviation of frequency (Hz) and of damping ratio, in place of `mean`.
        rate_sd_ppm : float or None
            Relative standard deviation of the frame rate in parts per million, in place of `rate_sd_ppm`.

        Notes
        -----
        None keeps what the posterior has. Derived from `sampled` with the random stream of `seed`: calls may come in
        any order, and the same errors give the same draws.
        """
        errors, mean = (self.errors if errors is None else errors), mean or self.mean
        ppm = self.rate_sd_ppm if rate_sd_ppm is None else rate_sd_ppm
        frequency_hz, zeta = self.frequency_in_record_hz, self.damping_ratio
        if self.sampled is not None:
            frequency_hz, zeta = self.sampled.frequency_hz, self.sampled.damping_ratio
            extra_sd = total_error({cause: sd for cause, sd in errors.items() if cause != "decays"})
            if max(extra_sd) > 0.0:
                key = (*self.seed[1:], frequency_hz.shape[0])
                rng = np.random.default_rng(np.random.SeedSequence(self.seed[0], spawn_key=key))
                frequency_hz, zeta = _widened(frequency_hz, zeta, extra_sd, rng)
            if mean is not None:
                doubts = (sd for cause, (_, sd) in errors.items() if cause in _ROLES)
                sd = float(np.linalg.norm([mean[1][1], *doubts]))
                # Reflected at zero: damping ratios stay positive.
                frequency_hz, zeta = _moved(frequency_hz, *mean[0]), np.abs(_moved(zeta, mean[1][0], sd))
        one = replace(
            self, frequency_hz=frequency_hz, damping_ratio=zeta, errors=errors, mean=mean, rate_sd_ppm=ppm
        )
        return replace(one, frequency_hz=frequency_hz * one.rate_factors(ppm))

    @property
    def systematic(self) -> tuple[float, float]:
        """Standard deviations of frequency (Hz) and damping ratio for all `errors`."""
        return total_error(self.errors)

    @property
    def frequency_in_record_hz(self) -> FloatArray:
        """Draws of the frequency without the error of the frame rate: by the clock of the record itself."""
        return self.frequency_hz / self.rate_factors(self.rate_sd_ppm)

    def rate_factors(self, ppm: float) -> FloatArray:
        """Random factors of mean 1 and relative sd `ppm`, the same for all modes of a recording; shape of the draws."""
        size = self.frequency_hz.size
        # The last number of the seed is the index of the mode.
        generator = np.random.default_rng([_RATE_STREAM, *self.seed[:-1]])
        scores = ndtri((np.arange(size) + 0.5) / size)
        return np.asarray(1.0 + 1e-6 * ppm * generator.permutation(scores).reshape(self.frequency_hz.shape))

    def to_dataframe(self) -> pd.DataFrame:
        """One row per draw: ensemble, frequency_hz, damping_ratio."""
        ensembles, draws = self.frequency_hz.shape
        values = {
            "ensemble": np.repeat(np.arange(ensembles), draws),
            "frequency_hz": self.frequency_hz.ravel(),
            "damping_ratio": self.damping_ratio.ravel(),
        }
        return data_frame(values, (*FREQUENCY, *DAMPING))

    def to_xarray(self) -> xarray.Dataset:
        """The draws over chain, an ensemble, and draw, as ArviZ takes them; ImportError without xarray."""
        given = {one.name: (one.of(self), {"units": one.unit}) for one in (FREQUENCY[0], DAMPING[0])}
        return dataset({name: (("chain", "draw"), *value) for name, value in given.items()})

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draws of frequency and damping ratio as a scatter plot."""
        axes = axes_or_new(ax)
        axes.plot(self.frequency_hz.ravel(), self.damping_ratio.ravel(), ",", alpha=0.5)
        axes.set(xlabel="natural frequency (Hz)", ylabel="damping ratio")
        return axes

    def __repr__(self) -> str:
        ensembles, draws = self.frequency_hz.shape
        quality = f"R-hat {max(self.r_hat):.3f}, effective sample size {min(self.ess):.0f}"
        if np.isnan(self.acceptance):
            quality = "of a normal density"
        return f"Posterior: {ensembles} ensembles of {draws} draws, {quality}"


def _widened(
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


def _moved(draws: FloatArray, value: float, sd: float) -> FloatArray:
    """The draws shifted and scaled to a value and standard deviation."""
    return np.asarray(value + sd / max(float(np.std(draws)), 1e-300) * (draws - np.median(draws)))


@dataclass(frozen=True, eq=False)
class AmplitudeCurve:
    """Frequency and damping ratio of a mode as functions of its amplitude, averaged over laws weighted by evidence.

    Attributes
    ----------
    amplitude : array, shape (p,)
        Amplitude of the channel that moves most, in the series' unit: 0, then from the lowest amplitude that the record
        determines to that at the start of the fit. Below the lowest amplitude the curve is extrapolated.
    damping_ratio, damping_ratio_sd, frequency_hz, frequency_sd_hz : array, shape (p,)
        The standard deviations include the spread between the laws and their misfit.
    law : str
        Name of the most probable law: "constant", "saturating", "spline", or the powers of a power law.
    constant_probability : float
        Posterior probability that frequency and damping ratio are constant.
    residual_power : float
        Power that the most probable law leaves at the mode, relative to the noise beside it; 1 where it is adequate.
    constant_residual_power : float
        The same for constant values; NaN where they could not be fitted.
    """

    amplitude: FloatArray
    damping_ratio: FloatArray
    damping_ratio_sd: FloatArray
    frequency_hz: FloatArray
    frequency_sd_hz: FloatArray
    law: str
    constant_probability: float
    residual_power: float
    constant_residual_power: float

    def decay(self, time_s: FloatArray) -> FloatArray:
        """Amplitude at times after the start of the fit, shape as `time_s`; NaN where the curve allows no decay."""
        rate = 2.0 * np.pi * self.frequency_hz * self.damping_ratio
        if np.any(rate <= 0.0):
            return np.full(np.shape(time_s), np.nan)
        log_a, slowness = np.log(self.amplitude[:0:-1]), 1.0 / rate[:0:-1]
        passed = np.append(0.0, np.cumsum(-0.5 * np.diff(log_a) * (slowness[1:] + slowness[:-1])))
        # Below the lowest amplitude the rate is that at zero.
        beyond = np.maximum(time_s - passed[-1], 0.0) * rate[0]
        return np.asarray(np.exp(np.interp(time_s, passed, log_a) - beyond))


@dataclass(frozen=True)
class AmplitudeDependence:
    """zeta(a) = zeta0 + zeta1 a and f(a) = f0 + f2 a^2, a being the amplitude relative to that at the start of the fit.

    Attributes ending in ``sd`` are standard deviations. ``significant`` is True where the data prefer a dependence on
    the amplitude, of this or any other form, to a constant frequency and damping ratio. ``curve`` is the dependence of
    any form; None where the record is too short or too noisy for it. ``averaged`` is the damping ratio at zero
    amplitude with its standard deviation, over forms that are linear in a and in a^2 weighted by their likelihood; NaN
    where only one of them can be fitted.
    """

    zeta0: float
    zeta0_sd: float
    zeta1: float
    zeta1_sd: float
    f0_hz: float
    f0_sd_hz: float
    f2_hz: float
    f2_sd_hz: float
    significant: bool
    curve: AmplitudeCurve | None = None
    averaged: tuple[float, float] = (float("nan"), float("nan"))

    def doubted(self, frequency_hz: float, damping_ratio: float) -> AmplitudeDependence:
        """With the distances to these constant values in its standard deviations: the record follows neither."""
        curve, averaged = self.curve, self.averaged
        if curve is not None:
            curve = replace(
                curve,
                damping_ratio_sd=np.hypot(curve.damping_ratio_sd, curve.damping_ratio - damping_ratio),
                frequency_sd_hz=np.hypot(curve.frequency_sd_hz, curve.frequency_hz - frequency_hz),
            )
        return replace(
            self,
            zeta0_sd=float(np.hypot(self.zeta0_sd, self.zeta0 - damping_ratio)),
            f0_sd_hz=float(np.hypot(self.f0_sd_hz, self.f0_hz - frequency_hz)),
            averaged=(averaged[0], float(np.hypot(averaged[1], averaged[0] - damping_ratio))),
            curve=curve,
        )

    @property
    def small_amplitude_frequency(self) -> tuple[float, float]:
        """Natural frequency in Hz in the limit of zero amplitude, and its standard deviation."""
        if self.curve is None:
            return self.f0_hz, self.f0_sd_hz
        return float(self.curve.frequency_hz[0]), float(self.curve.frequency_sd_hz[0])

    @property
    def small_amplitude_damping(self) -> tuple[float, float]:
        """Damping ratio in the limit of zero amplitude, and its standard deviation."""
        if self.curve is None:
            return self.averaged if np.isfinite(self.averaged[0]) else (self.zeta0, self.zeta0_sd)
        return float(self.curve.damping_ratio[0]), float(self.curve.damping_ratio_sd[0])


def damped_hz(frequency_hz: float, damping_ratio: float) -> float:
    """Frequency of the oscillation in Hz, which a hand that damps it hardly changes; 0 from critical damping on."""
    return frequency_hz * math.sqrt(max(1.0 - damping_ratio**2, 0.0))


@dataclass(frozen=True)
class DecayValue:
    """Frequency and damping ratio of a mode in one of several decays of a record, with standard deviations.

    ``start_s`` is the time at which the fit of that decay begins, ``amplitude`` the mode's largest amplitude there.
    """

    start_s: float
    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    amplitude: float

    @property
    def damped_hz(self) -> float:
        """As the function of this name."""
        return damped_hz(self.frequency_hz, self.damping_ratio)


def axes_or_new(ax: Axes | None) -> Axes:
    """The given axes, or those of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # noqa: PLC0415 - slow to import, and only plots need it

    return plt.subplots(layout="constrained")[1]


_UNIT = "unit"
# Each an array of shape (f, k) of a `FrequencyResponse`; the rows of a table are its channels one after the other.
RESPONSE_COLUMNS = (
    Column(
        "channel", "", "name of the output", lambda r: np.tile(np.array(r.channels), (r.frequency_hz.size, 1))
    ),
    Column(
        "frequency_hz", "Hz", "frequency", lambda r: np.tile(r.frequency_hz[:, None], (1, len(r.channels)))
    ),
    Column("real", _UNIT, "real part of the response of the fitted modes", lambda r: r.model.real),
    Column("imaginary", _UNIT, "its imaginary part", lambda r: r.model.imag),
    Column("magnitude", _UNIT, "its modulus", lambda r: np.abs(r.model)),
    Column("magnitude_q05", _UNIT, "5 % quantile of the modulus, from the uncertainty of all parameters"),
    Column("magnitude_q95", _UNIT, "95 % quantile"),
    Column("local_real", _UNIT, "real part of the estimate without modes", lambda r: r.local.real),
    Column("local_imaginary", _UNIT, "its imaginary part", lambda r: r.local.imag),
    Column("local_sd", _UNIT, "standard deviation of each part, from the scatter about the polynomial"),
    Column("coherence", "1", "squared coherence of the output with the input in windows of 13 bins"),
    Column(
        "unit",
        "",
        "unit of the response: 1, or that of the output over that of the force",
        lambda r: np.full(r.model.shape, r.unit),
    ),
)


@dataclass(frozen=True, repr=False, eq=False)
class FrequencyResponse(Table):
    """Transmissibility (input of the outputs' own kind) or receptance (force) by two methods.

    Attributes
    ----------
    frequency_hz : array, shape (f,)
    channels : tuple of str
        Outputs, k of them.
    input_name : str
    unit : str
        Of the response: that of the outputs over that of the input.
    model : complex array, shape (f, k)
        Of the fitted modes, with quasi-static terms of the modes beyond the band.
    magnitude_q05, magnitude_q95 : array, shape (f, k)
        Central 90 % interval of its modulus, from draws of poles and coefficients.
    local : complex array, shape (f, k)
        Local-polynomial estimate, without a model of modes; NaN where the input has too little power.
    local_sd : array, shape (f, k)
        Standard deviation of the real and of the imaginary part of it.
    coherence : array, shape (f, k)
        Squared coherence of output and input in windows of neighbouring bins, 0 to 1; 1 - coherence contains the error
        of the estimate's resolution beside the noise.
    input_lag_s : float
        By which the input was taken to be late; 0 where no lag was asked for.
    input_lag_sd_s : float
        Its standard deviation; NaN where it was not estimated.
    """

    frequency_hz: FloatArray
    channels: tuple[str, ...]
    input_name: str
    unit: str
    model: ComplexArray
    magnitude_q05: FloatArray
    magnitude_q95: FloatArray
    local: ComplexArray
    local_sd: FloatArray
    coherence: FloatArray
    input_lag_s: float = 0.0
    input_lag_sd_s: float = float("nan")

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each channel and frequency."""
        values = {one.name: np.asarray(one.of(self)).T.ravel() for one in RESPONSE_COLUMNS}
        units = {one.name: self.unit if one.unit == _UNIT else one.unit for one in RESPONSE_COLUMNS}
        return data_frame(values, units)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Modulus over frequency: of the modes with its 90 % interval, and of the estimate without modes as dots."""
        axes = axes_or_new(ax)
        for k, channel in enumerate(self.channels):
            (line,) = axes.semilogy(self.frequency_hz, np.abs(self.model[:, k]), label=channel)
            interval = self.magnitude_q05[:, k], self.magnitude_q95[:, k]
            axes.fill_between(self.frequency_hz, *interval, alpha=0.3, color=line.get_color())
            axes.plot(self.frequency_hz, np.abs(self.local[:, k]), ".", markersize=2, color=line.get_color())
        axes.set(xlabel="frequency (Hz)", ylabel=f"response to {self.input_name} ({self.unit})")
        axes.legend()
        return axes

    def __repr__(self) -> str:
        low, high = self.frequency_hz[[0, -1]]
        return f"response of {', '.join(self.channels)} to {self.input_name} ({self.unit}), {low:.4g} to {high:.4g} Hz"
