"""Which flags an identified mode receives, and the notes that explain them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import beyond_limit
from modal_id.fit import ModalFit, StabilityDiagram, nyquist_hz
from modal_id.flags import ModeFlag
from modal_id.modes.numbering import possible_aliases
from modal_id.posterior import LITTLE_DECAY, MUCH_LEFT, SampledMode, left_at_mode
from modal_id.settings import IdentifySettings
from modal_id.solve import frequency_hz
from tracker import ComplexArray, FloatArray

MANY_OUTLIERS = 0.03
LOW_SNR = 10.0
LEAST_CYCLES = 10.0


@dataclass(frozen=True)
class Tuning:
    """Flags of a mode."""

    #: [1] residual power of the amplitude curve over the noise below which no pair of modes is needed
    explained: float = 1.5
    #: [1] the same, over the residual power that constant values leave
    mostly_explained: float = 0.01
    #: [1] smallest amplitude of the curve over the largest above which no decade of amplitudes is seen
    #: convention: A tenth.
    decade: float = 0.1
    #: [1] half-width of the band in which the residual is misfit of a mode, over its frequency
    own_share: float = 0.05
    #: [bins] the same, where a bin is 1 / span of the record
    own_bins: float = 3.0


TUNING = Tuning()


def mode_flags(
    model: ModalFit,
    index: int,
    mode: SampledMode,
    shape: ComplexArray,
    number: int | None,
    settings: IdentifySettings,
    diagram: StabilityDiagram | None,
    outliers: float,
) -> tuple[list[ModeFlag], list[str]]:
    """Flags of a mode and notes that explain them; `outliers` is the share of outliers in the record."""
    data, fit = model.data, model.fit
    all_hz = frequency_hz(fit.poles)
    frequency = float(all_hz[index])
    best = signal_to_noise(model, index)
    draws = mode.posterior.damping_ratio
    distance = np.abs(np.delete(all_hz, index) / frequency - 1.0)
    nyquist = nyquist_hz(data.time_s)
    aliases = possible_aliases(frequency, shape, number, 2.0 * nyquist, settings)
    raised = {
        ModeFlag.SHORT_RECORD: data.span_s * frequency < LEAST_CYCLES,
        ModeFlag.ADDED: is_added(model, index),
        ModeFlag.LOW_SNR: best < LOW_SNR,
        ModeFlag.AMPLITUDE_DEPENDENT: mode.dependence is not None and mode.dependence.significant,
        ModeFlag.CLOSE_MODE: bool(np.any(distance < 0.1)),
        ModeFlag.CHAIN_TOO_SHORT: not mode.long_enough,
        ModeFlag.FEW_CYCLES_LOST: float(np.exp(fit.poles[index].real * data.span_s)) > LITTLE_DECAY,
        ModeFlag.UNRESOLVED: model.unresolved_near(index) is not None and not _is_one_curve(mode),
        # A normal density with this ratio has 2 % of its mass below zero; a half-normal one has a ratio of 1.1.
        ModeFlag.DAMPING_TOUCHES_ZERO: float(np.median(draws)) < 2.0 * _sd_below(mode),
        ModeFlag.RESIDUAL_AT_MODE: left_at_mode(mode.dependence) > MUCH_LEFT,
        ModeFlag.ALIASED_POSSIBLE: frequency > 0.9 * nyquist or bool(aliases),
        ModeFlag.NOT_CONFIRMED: diagram is not None and not diagram.confirms(frequency),
        ModeFlag.MANY_OUTLIERS: outliers > MANY_OUTLIERS,
    }
    notes = []
    if frequency > 0.9 * nyquist:
        notes.append(
            f"At a sampling rate of {2.0 * nyquist:.4g} Hz, a vibration at {2.0 * nyquist - frequency:.4g} Hz cannot "
            f"be distinguished from one at {frequency:.4g} Hz."
        )
    notes += [
        f"At a sampling rate of {2.0 * nyquist:.4g} Hz, mode {other}, which theory predicts at "
        f"{settings.expected_frequencies_hz[other - 1]:.4g} Hz, would appear near {frequency:.4g} Hz."
        for other in aliases
    ]
    return [flag for flag, is_raised in raised.items() if is_raised], notes


def is_added(model: ModalFit, index: int) -> bool:
    """Whether a mode was fitted because the user names its frequency."""
    hz = frequency_hz(model.fit.poles)
    return any(int(np.argmin(np.abs(hz - named))) == index for named in model.added_hz)


def signal_to_noise(model: ModalFit, index: int) -> float:
    """Largest ratio, over channels, of the amplitude of a mode and the noise of a sample.

    The residual at the modes is not counted as noise, since it includes misfit where damping depends on the amplitude.
    """
    spectrum, linear = model.spectrum, model.fit.linear
    beside = np.ones(spectrum.frequency_hz.size, dtype=bool)
    for hz in frequency_hz(model.fit.poles):
        reach = max(TUNING.own_share * float(hz), TUNING.own_bins / model.data.span_s)
        beside &= np.abs(spectrum.frequency_hz - hz) > reach
    share = float(np.mean(spectrum.power[beside]) / np.mean(spectrum.power)) if np.any(beside) else 1.0
    noise = np.sqrt(linear.noise_variance * min(share, 1.0))
    return float(np.max(np.abs(linear.amplitudes[index]) / np.maximum(noise, 1e-300)))


def _sd_below(mode: SampledMode) -> float:
    """Standard deviation of the damping ratio, without the distance to its values at other amplitudes."""
    variance = float(np.var(mode.posterior.damping_ratio))
    if mode.dependence is not None and mode.dependence.significant:
        variance -= mode.posterior.systematic_damping_ratio**2
    return float(np.sqrt(max(variance, 0.0)))


def _is_one_curve(mode: SampledMode) -> bool:
    """Whether one mode with any dependence on amplitude explains the motion over a decade of amplitudes.

    Over a smaller range, a curve may imitate part of a beat.
    """
    curve = None if mode.dependence is None else mode.dependence.curve
    if curve is None or curve.amplitude[1] > TUNING.decade * curve.amplitude[-1]:
        return False
    return curve.residual_power < max(
        TUNING.explained, TUNING.mostly_explained * curve.constant_residual_power
    )


def outlier_share(weights: FloatArray, residual: FloatArray) -> float:
    """Largest share, over channels, of the used samples beyond the limit of rejection."""
    bad = np.count_nonzero(beyond_limit(weights, residual), axis=0)
    used = np.count_nonzero(weights > 0.0, axis=0)
    return float(np.max(bad / np.maximum(used, 1), initial=0.0))
