"""Results of identification: modes with their posterior, or the reason for a failure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from modal_id.columns import FLAGS, IDENTITY, MODE_COLUMNS, OF_MODE, OF_RECORD

# Values of a mode and parts of the record are results too; packages that use results import them from here.
from modal_id.mode_values import AmplitudeCurve as AmplitudeCurve  # noqa: PLC0414 - re-exported
from modal_id.mode_values import AmplitudeDependence as AmplitudeDependence  # noqa: PLC0414 - re-exported
from modal_id.mode_values import DecayValue as DecayValue  # noqa: PLC0414 - re-exported
from modal_id.mode_values import FrequencyResponse, Table, axes_or_new
from modal_id.mode_values import Posterior as Posterior  # noqa: PLC0414 - re-exported
from modal_id.mode_values import SampledDraws as SampledDraws  # noqa: PLC0414 - re-exported
from modal_id.record import FittingRate, Onset, Segment
from modal_id.sentences import ModeFlag, Refusal
from tracker import (
    INTERVAL_LEVEL,
    BoolArray,
    ComplexArray,
    FloatArray,
    Severity,
    data_frame,
    table_row,
)

# The series is part of an identification; packages that use results import it from here.
from tracker import DisplacementSeries as DisplacementSeries  # noqa: PLC0414 - re-exported

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# p-value below which a check of the residual fails.
ALARM = 0.01


@dataclass(frozen=True)
class Check:
    """One statistic of the residual, with the likely cause of a small p-value and what to do, a sentence each.

    ``typical`` is the median of the replicates; ``p_value`` is the share of values at least as large, among the
    replicates and the record itself. ``frequency_hz`` is that of the line which the statistic measures, else NaN.
    """

    name: str
    value: float
    typical: float
    p_value: float
    cause: str
    remedy: str
    frequency_hz: float = float("nan")

    @property
    def holds(self) -> bool:
        """Whether the record is not among the most extreme 1 %."""
        return self.p_value > ALARM


@dataclass(frozen=True, repr=False, eq=False)
class IdentifiedMode(Table):
    """One mode of one recording.

    The fitted motion of channel k is ``Re(shape[k] exp(lambda (t - onset.fit_from_s)))`` with
    ``lambda = -zeta omega_n + i omega_n sqrt(1 - zeta^2)``, which is Eq. 1 with x0 and v0 in the complex amplitude.

    Attributes
    ----------
    shape : complex array, shape (k,)
        Complex amplitude of each channel at `Onset.fit_from_s` or `other_from_s`, in the series' unit; NaN for channels
        not used.
    shape_sd : array, shape (k,)
        Standard deviation of the real and of the imaginary part of `shape`.
    amplitude : float
        Largest modulus of `shape` over the channels.
    amplitude_unit : str
    posterior : Posterior
    amplitude_dependence : AmplitudeDependence or None
        None where the record does not determine it.
    number : int or None
        Number of the beam's mode, from 1; None where unknown.
    target : bool
        Whether the recording was made for this mode.
    mac : float
        Modal assurance criterion with the theoretical shape; NaN where no theory was given.
    flags : tuple of str
        Names from `modal_id.sentences`.
    severities : tuple of (flag, severity)
        Names of the `tracker.flags.Severity` of each flag by its effect on the result, as a share of the interval.
    notes : tuple of str
        Sentences for the report.
    other_from_s : float or None
        Where only another decay shows the mode, the start of its fit, at which `shape` is; None for a fitted one.
    decays : tuple of DecayValue
        Where several decays of the record show the mode: the values of each, which frequency and damping ratio combine.
    participation, participation_sd : array, shape (k,), or None
        With a measured input, and their standard deviations; NaN for channels not used. Of the motion of the base:
        relative motion of the channel in this mode per motion of the base far above the resonance,
        ``Gamma phi_k`` [1]. Of a force: modal constant ``phi_k phi_force / m``, in the unit of a channel per unit of
        the force and s^2; at the channel where the force acts, 1 over it is the modal mass for ``phi = 1`` there.
    """

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
    severities: tuple[tuple[str, str], ...] = ()
    other_from_s: float | None = None
    decays: tuple[DecayValue, ...] = ()
    participation: FloatArray | None = None
    participation_sd: FloatArray | None = None

    def severity_of(self, flag: str) -> Severity:
        """What a flag of this mode means for its values; the usual severity where its effect was not computed."""
        found = dict(self.severities).get(flag)
        return ModeFlag[flag].usual_severity if found is None else Severity[found]

    def with_flags(self, flags: Sequence[ModeFlag], *words: str) -> IdentifiedMode:
        """The mode with further flags of their usual severity, and notes after those that explain the flags."""
        texts, others = self.notes[: len(self.flags)], self.notes[len(self.flags) :]
        return replace(
            self,
            flags=(*self.flags, *(flag.name for flag in flags)),
            notes=(*texts, *(flag.value for flag in flags), *others, *words),
            severities=(*self.severities, *((flag.name, flag.usual_severity.name) for flag in flags)),
        )

    @property
    def in_fit(self) -> bool:
        """Whether `Identification.fitted` contains the mode."""
        return self.other_from_s is None

    @property
    def wrong_flags(self) -> tuple[str, ...]:
        """Flags by which a value may be off by more than its interval."""
        return tuple(flag for flag in self.flags if self.severity_of(flag) is Severity.WRONG)

    @cached_property
    def frequency_hz(self) -> float:
        """Natural frequency omega_n / 2 pi, posterior median."""
        return float(np.quantile(self.posterior.frequency_hz, 0.5))

    @cached_property
    def frequency_sd_hz(self) -> float:
        """Posterior standard deviation of the natural frequency."""
        return float(np.std(self.posterior.frequency_hz))

    @cached_property
    def damping_ratio(self) -> float:
        """Damping ratio zeta, posterior median."""
        return float(np.quantile(self.posterior.damping_ratio, 0.5))

    @cached_property
    def damping_ratio_sd(self) -> float:
        """Posterior standard deviation of the damping ratio."""
        return float(np.std(self.posterior.damping_ratio))

    @property
    def amplitude_sd(self) -> float:
        """Standard deviation of the channel of the largest modulus, as in `shape_sd`."""
        return float(self.shape_sd[np.nanargmax(np.abs(self.shape))])

    @property
    def omega_n_rad_s(self) -> float:
        """Undamped natural angular frequency."""
        return 2.0 * np.pi * self.frequency_hz

    @property
    def small_amplitude_frequency(self) -> tuple[float, float]:
        """Natural frequency of linear theory in Hz and its standard deviation.

        The limit at zero amplitude of a significant dependence. Otherwise nearly `frequency_hz`, the value at the
        amplitudes of the record: the mean and the standard deviation allow for a dependence that noise hides.
        """
        dependence = self.amplitude_dependence
        if dependence is not None and dependence.significant:
            return dependence.small_amplitude_frequency
        draws = self.posterior
        sd = float(np.hypot(self.frequency_sd_hz, draws.extrapolation_frequency_hz))
        return self.frequency_hz + draws.small_amplitude_shift_hz, sd

    @property
    def small_amplitude_damping(self) -> tuple[float, float]:
        """Damping ratio of linear theory and its standard deviation, as `small_amplitude_frequency`.

        The standard deviation exceeds that of `damping_ratio`, the value at the amplitudes of the record, by what a
        dependence on the amplitude that noise hides may change: most after little decay.
        """
        dependence = self.amplitude_dependence
        if dependence is not None and dependence.significant:
            return dependence.small_amplitude_damping
        beyond = self.posterior.extrapolation_damping_ratio
        return self.damping_ratio, float(np.hypot(self.damping_ratio_sd, beyond))

    def frequency_interval_hz(self, level: float = INTERVAL_LEVEL) -> tuple[float, float]:
        """Central credible interval of the natural frequency at `level` (0.9, 0.99, ...)."""
        return _central(self.posterior.frequency_hz, level)

    def damping_interval(self, level: float = INTERVAL_LEVEL) -> tuple[float, float]:
        """Central credible interval of the damping ratio at `level`."""
        return _central(self.posterior.damping_ratio, level)

    def to_dataframe(self) -> pd.DataFrame:
        """One row with the mode's columns of ``modes.csv``."""
        return _frame((self,))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Histogram of the damping ratio's posterior with its 90 % interval."""
        axes = axes_or_new(ax)
        axes.hist(self.posterior.damping_ratio.ravel(), bins=60, histtype="stepfilled", alpha=0.5)
        axes.axvspan(*self.damping_interval(), alpha=0.15, label="90 % interval")
        axes.set(xlabel=f"damping ratio at {self.frequency_hz:.4g} Hz", yticks=[])
        axes.legend()
        return axes

    def __repr__(self) -> str:
        name = "mode" if self.number is None else f"mode {self.number}"
        flags = f", {'|'.join(self.flags)}" if self.flags else ""
        return (
            f"{name}{' (target)' if self.target else ''}: {self.frequency_hz:.6g} Hz (sd {self.frequency_sd_hz:.2g}), "
            f"damping ratio {self.damping_ratio:.5g} (sd {self.damping_ratio_sd:.2g}){flags}"
        )


@dataclass(frozen=True)
class DrivenMotion:
    """A steady motion: its frequency is that of the drive, not a natural frequency, and it does not show damping.

    The damping ratio, its interval and the values at small amplitude are NaN. ``flags`` contain DRIVEN.
    """

    frequency_hz: float
    frequency_sd_hz: float
    amplitude: float
    amplitude_unit: str
    flags: tuple[str, ...] = ("DRIVEN",)
    notes: tuple[str, ...] = ()
    number: int | None = None
    target: bool = False
    damping_ratio: float = float("nan")
    damping_ratio_sd: float = float("nan")
    small_amplitude_frequency: tuple[float, float] = (float("nan"), float("nan"))
    small_amplitude_damping: tuple[float, float] = (float("nan"), float("nan"))

    def frequency_interval_hz(self, level: float = INTERVAL_LEVEL) -> tuple[float, float]:
        """Central normal interval of the frequency at `level`."""
        reach = float(ndtri(0.5 * (1.0 + level))) * self.frequency_sd_hz
        return self.frequency_hz - reach, self.frequency_hz + reach

    def severity_of(self, flag: str) -> Severity:
        """What a flag means for the values."""
        return ModeFlag[flag].usual_severity

    def damping_interval(self, level: float = INTERVAL_LEVEL) -> tuple[float, float]:  # noqa: ARG002 - as of a mode
        """NaN: a steady motion does not show damping."""
        return float("nan"), float("nan")

    def __repr__(self) -> str:
        return f"driven: {self.frequency_hz:.6g} Hz (sd {self.frequency_sd_hz:.2g}), damping not measurable"


@dataclass(frozen=True)
class FailedMode(Refusal):
    """A mode that could not be identified."""

    frequency_hz: float = float("nan")
    number: int | None = None
    target: bool = False

    @classmethod
    def of(cls, why: Refusal, hz: float, number: int | None = None, *, target: bool = False) -> FailedMode:
        """For this reason, at a frequency in Hz, NaN where unknown."""
        return cls(why.reason, "", "", why.codes, why.values, hz, number, target)


@dataclass(frozen=True, eq=False)
class AmbientBand:
    """Band of the spectrum of an ambient record in which modes were sought.

    Attributes
    ----------
    low_hz, high_hz : float
    frequency_hz : array, shape (g,)
    fitted : array, shape (g,)
        Largest singular value of the fitted spectral density matrix, in units of that of the noise.
    modes : int
        Number of modes that the evidence asks for; 0 where the band holds none.
    """

    low_hz: float
    high_hz: float
    frequency_hz: FloatArray
    fitted: FloatArray
    modes: int


@dataclass(frozen=True, eq=False)
class AmbientRecord:
    """Spectrum of an ambient record and its bands.

    Attributes
    ----------
    frequency_hz : array, shape (b,)
    singular_values : array, shape (b, r)
        Largest of the spectral density matrix, in units of the noise's.
    bands : tuple of AmbientBand
    """

    frequency_hz: FloatArray
    singular_values: FloatArray
    bands: tuple[AmbientBand, ...]


@dataclass(frozen=True, repr=False, eq=False)
class Identification(Table):
    """Everything identified from one series.

    Attributes
    ----------
    series : DisplacementSeries
        As given.
    onset : Onset
    modes : tuple of IdentifiedMode
        In order of frequency.
    failed : tuple of FailedMode
        Modes that were requested or detected but could not be identified.
    fitted : array, shape (n, k)
        Fitted motion (all modes and baseline) at the series' times; NaN outside the fitted decay.
    baseline : array, shape (n, k)
        Offset and slow drift within `fitted`.
    used : bool array, shape (n, k)
        Samples used by the fit: not missing, within the decay, not rejected as outliers.
    residual_sd : array, shape (k,)
        Standard deviation of the residual of each channel.
    channels_used : bool array, shape (k,)
        Channels used by the fit (a channel with no motion or no data is left out and named in `notes`).
    notes : tuple of str
    segments : tuple of Segment
        The whole record in order of time. Of several decays, `onset`, `fitted`, `used` and the shapes are those of the
        most informative one.
    driven : tuple of DrivenMotion
        Lines of a record that is driven throughout; there are no modes then.
    fitting_rate : FittingRate or None
        Another sampling rate, at which the lines would be modes of the beam; None where the recorded one fits.
    ambient : AmbientRecord or None
        Of a record under ambient excitation: there is no decay then, `fitted` and `baseline` are NaN, and the amplitude
        of a mode is that of a sinusoid of the same power.
    checks : tuple of Check
        Those of `modal_id.modes.checks`, where they were made.
    response : FrequencyResponse or None
        To the measured input; None where the series has none.
    """

    series: DisplacementSeries
    onset: Onset
    modes: tuple[IdentifiedMode, ...]
    failed: tuple[FailedMode, ...]
    fitted: FloatArray
    baseline: FloatArray
    used: BoolArray
    residual_sd: FloatArray
    channels_used: BoolArray
    notes: tuple[str, ...] = ()
    segments: tuple[Segment, ...] = ()
    driven: tuple[DrivenMotion, ...] = ()
    checks: tuple[Check, ...] = ()
    fitting_rate: FittingRate | None = None
    ambient: AmbientRecord | None = None
    response: FrequencyResponse | None = None

    @property
    def has_decay(self) -> bool:
        """Whether free decays were fitted: not under ambient excitation, nor with a measured input."""
        return self.ambient is None and self.response is None

    @property
    def fitted_modes(self) -> tuple[IdentifiedMode, ...]:
        """Modes that are part of `fitted`; only other decays show the others."""
        return tuple(mode for mode in self.modes if mode.in_fit)

    @property
    def motions(self) -> tuple[IdentifiedMode | DrivenMotion, ...]:
        """Modes, and driven motions where there are no modes: the rows of ``modes.csv``."""
        return (*self.modes, *self.driven)

    @property
    def decay_rows(self) -> BoolArray:
        """Mask of the rows of the series that the fit covers, used or not: those of the decay; shape (n,)."""
        return np.asarray(np.isfinite(self.fitted).any(axis=1))

    @property
    def target(self) -> IdentifiedMode | None:
        """The target mode of the recording, or None when it was not identified."""
        return next((mode for mode in self.modes if mode.target), None)

    def to_dataframe(self) -> pd.DataFrame:
        """One row per mode or driven motion: the columns of ``modes.csv`` but the recording's name.

        ``mode`` is NA where unknown.
        """
        return _frame(self.motions, self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Measured displacement of the channel that moves most, with the fitted motion and, of a decay, the onset."""
        axes = axes_or_new(ax)
        strongest = self.target or max(self.fitted_modes, key=lambda mode: mode.amplitude, default=None)
        size = np.nanstd(self.series.values, axis=0) if strongest is None else np.abs(strongest.shape)
        channel = int(np.nanargmax(size))
        time_s = self.series.time_s
        axes.plot(time_s, self.series.values[:, channel], ".", markersize=2, label="measured")
        if (strongest is not None or self.driven) and not self.ambient:
            label = "fitted motion" if self.driven else "fitted decay"
            axes.plot(time_s, self.fitted[:, channel], linewidth=0.8, label=label)
        if self.onset.source != "none":
            axes.axvline(self.onset.time_s, color="0.5", linestyle="--", label="onset")
        name = self.series.channels[channel]
        axes.set(
            xlabel="time (s)", ylabel=f"displacement of {name} ({self.series.unit})", title=self.series.name
        )
        axes.legend()
        return axes

    def __repr__(self) -> str:
        found = f"{len(self.modes)} mode{'' if len(self.modes) == 1 else 's'}"
        lost = f", {len(self.failed)} not identified" if self.failed else ""
        head = f"Identification of {self.series.name!r}: {found}{lost}, "
        if self.response is not None:
            kind = f"driven by {self.response.input_name}"
        else:
            kind = "ambient excitation" if self.ambient else f"free decay from {self.onset.time_s:.5g} s"
        head += "driven throughout" if self.driven else kind
        return "\n  ".join([head, *(repr(mode) for mode in self.motions)])


@dataclass(frozen=True)
class FittedMode:
    """Mode of a decay without noise, as fitted: there is nothing to draw from.

    Attributes
    ----------
    frequency_hz, damping_ratio : float
    amplitude : float
        Largest of a channel, in the unit of the series.
    frequency_shift : float
        Relative change of the frequency from small amplitude to that at the start; NaN if it was not determined.
    """

    frequency_hz: float
    damping_ratio: float
    amplitude: float
    frequency_shift: float


def _frame(
    modes: tuple[IdentifiedMode | DrivenMotion, ...], found: Identification | None = None
) -> pd.DataFrame:
    columns: dict[str, Any] = {column.name: [column.of(mode) for mode in modes] for column in OF_MODE}
    if found is not None:
        columns |= table_row(OF_RECORD, found)
    columns[FLAGS.name] = [FLAGS.of(mode) for mode in modes]
    return data_frame(columns, MODE_COLUMNS).astype({IDENTITY[0].name: "Int64"})


def _central(draws: FloatArray, level: float) -> tuple[float, float]:
    if not 0.0 < level < 1.0:
        msg = f"level must lie between 0 and 1, got {level}"
        raise ValueError(msg)
    # Rounded, so that a level of 0.9 means the quantiles 0.05 and 0.95 to the last digit.
    low, high = np.quantile(draws, np.round([0.5 * (1.0 - level), 0.5 * (1.0 + level)], 12))
    return float(low), float(high)
