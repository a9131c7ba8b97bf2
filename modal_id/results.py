"""What identification gives: modes with posteriors, or reasons why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import ComplexArray, FloatArray

# The series is part of what identification gives, and reaches the later rooms from here.
from tracker.results import DisplacementSeries as DisplacementSeries  # noqa: PLC0414 - re-exported


@dataclass(frozen=True)
class Onset:
    """When the free decay begins.

    Attributes
    ----------
    time_s : float
        Start of the free decay.
    sd_s : float
        Its standard deviation; 0 when the user gave it, NaN when nothing tells.
    fit_from_s : float
        First time used in the fit: a little after `time_s`, when the transient of the stop is over.
    source : str
        "user", "model" (driven-then-free change found in the data), "peak" (release from the largest amplitude),
        "record start" (the record is a decay from its first sample on), or "none" (steady motion throughout, or no
        motion: there is no free decay).
    confidence : float
        Posterior probability, 0 to 1, that the change found is a real one; 1 when the user gave it.
    note : str
        A sentence for the report.
    """

    time_s: float
    sd_s: float
    fit_from_s: float
    source: Literal["user", "model", "peak", "record start", "none"]
    confidence: float
    note: str = ""


@dataclass(frozen=True)
class Posterior:
    """emcee's draws of one mode's (frequency, damping ratio), ensembles kept apart.

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
    noise_factor : float
        By which the white-noise standard deviation was multiplied for the colour of the residual near the mode.
    systematic_frequency_hz, systematic_damping_ratio : float
        Standard deviation that was added for a model error (amplitude dependence, seen or beyond what the record can
        show); 0 when there is none. The draws include it.
    laplace_sd : tuple of float
        Standard deviations of (frequency_hz, damping_ratio) by Laplace's approximation, before noise colour and
        systematic parts: a check on the sampler.
    seed : tuple of int
        What the random streams were spawned from.
    """

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    r_hat: tuple[float, float]
    ess: tuple[float, float]
    autocorrelation_steps: float
    acceptance: float
    noise_factor: float
    systematic_frequency_hz: float
    systematic_damping_ratio: float
    laplace_sd: tuple[float, float]
    seed: tuple[int, ...]


@dataclass(frozen=True)
class AmplitudeDependence:
    """zeta(a) = zeta0 + zeta1 a and f(a) = f0 + f2 a^2, a the amplitude relative to that at the start of the fit.

    Each value stands beside its standard deviation. ``significant`` tells whether the data prefer this model to a
    constant frequency and damping ratio.
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


@dataclass(frozen=True)
class IdentifiedMode:
    """One mode of one recording.

    The fitted motion of channel k is ``Re(shape[k] exp(lambda (t - onset.fit_from_s)))`` with
    ``lambda = -zeta omega_n + i omega_n sqrt(1 - zeta^2)``, which is Eq. 1 with x0 and v0 in the complex amplitude.

    Attributes
    ----------
    frequency_hz : float
        omega_n / 2 pi, posterior median; sd and the 5 % and 95 % quantiles beside it.
    damping_ratio : float
        zeta, posterior median; sd and quantiles beside it.
    shape : complex array, shape (k,)
        Complex amplitude of each channel at `Onset.fit_from_s`, in the series' unit.
    shape_sd : array, shape (k,)
        Standard deviation of the real and of the imaginary part of `shape`.
    amplitude : float
        Largest modulus of `shape` over the channels.
    number : int or None
        Number of the beam's mode, 1 first; None where unknown.
    target : bool
        Whether the recording was made for this mode.
    mac : float
        Modal assurance criterion with the beam's theory; NaN where no theory was given.
    flags : tuple of str
        Names from `modal_id.flags`.
    notes : tuple of str
        Sentences for the report.
    """

    frequency_hz: float
    frequency_sd_hz: float
    frequency_q05_hz: float
    frequency_q95_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    damping_ratio_q05: float
    damping_ratio_q95: float
    shape: ComplexArray
    shape_sd: FloatArray
    amplitude: float
    amplitude_unit: str
    posterior: Posterior
    amplitude_dependence: AmplitudeDependence | None = None
    number: int | None = None
    target: bool = False
    mac: float = float("nan")
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def omega_n_rad_s(self) -> float:
        """Undamped natural angular frequency."""
        return 2.0 * np.pi * self.frequency_hz

    @property
    def small_amplitude_frequency(self) -> tuple[float, float]:
        """Natural frequency of linear theory in Hz and its standard deviation.

        The limit at zero amplitude where the frequency was seen to depend on it, `frequency_hz` otherwise.
        """
        bent = self.amplitude_dependence
        if bent is not None and bent.significant:
            return bent.f0_hz, bent.f0_sd_hz
        return self.frequency_hz, self.frequency_sd_hz

    def frequency_interval_hz(self, level: float) -> tuple[float, float]:
        """Central credible interval of the natural frequency at `level` (0.9, 0.99, ...)."""
        return _central(self.posterior.frequency_hz, level)

    def damping_interval(self, level: float) -> tuple[float, float]:
        """Central credible interval of the damping ratio at `level`."""
        return _central(self.posterior.damping_ratio, level)


@dataclass(frozen=True)
class FailedMode:
    """A mode that could not be identified: falsy, with the reason and what to try."""

    reason: str
    frequency_hz: float = float("nan")
    number: int | None = None
    target: bool = False

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class Identification:
    """Everything identified from one series.

    Attributes
    ----------
    series : DisplacementSeries
        As given.
    onset : Onset
    modes : tuple of IdentifiedMode
        In order of frequency.
    failed : tuple of FailedMode
        Modes that were looked for, or seen, and could not be identified.
    fitted : array, shape (n, k)
        Fitted motion (all modes and baseline) at the series' times; NaN before `onset.fit_from_s`.
    baseline : array, shape (n, k)
        Offset and slow drift within `fitted`.
    used : bool array, shape (n, k)
        Samples that the fit rests on: not missing, after the onset, not rejected as outliers.
    residual_sd : array, shape (k,)
        Standard deviation of the residual of each channel.
    channels_used : bool array, shape (k,)
        Channels that the fit rests on (a channel with no motion or no data is left out and named in `notes`).
    notes : tuple of str
    """

    series: DisplacementSeries
    onset: Onset
    modes: tuple[IdentifiedMode, ...]
    failed: tuple[FailedMode, ...]
    fitted: FloatArray
    baseline: FloatArray
    used: NDArray[np.bool_]
    residual_sd: FloatArray
    channels_used: NDArray[np.bool_]
    notes: tuple[str, ...] = ()

    @property
    def target(self) -> IdentifiedMode | None:
        """The mode that the recording was made for, or None when it was not identified."""
        return next((mode for mode in self.modes if mode.target), None)


@dataclass(frozen=True)
class FailedIdentification:
    """A series from which nothing can be identified: falsy, with the reason and what to try."""

    name: str
    reason: str

    def __bool__(self) -> bool:
        return False


def _central(draws: FloatArray, level: float) -> tuple[float, float]:
    if not 0.0 < level < 1.0:
        msg = f"level must lie between 0 and 1, got {level}"
        raise ValueError(msg)
    low, high = np.quantile(draws, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)
