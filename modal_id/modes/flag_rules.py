"""Which flags an identified mode receives, the notes that explain them, and their severity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.curve import is_one_curve
from modal_id.data import are_many
from modal_id.fit import DECAY_TIMES, OWN_BAND, ModalFit, StabilityDiagram, nyquist_hz
from modal_id.flags import ModeFlag, alias_note
from modal_id.modes.decays import DECAYS_SD
from modal_id.modes.numbering import possible_aliases
from modal_id.posterior import HARDLY_KNOWN, LINE_BINS, LITTLE_DECAY, MUCH_LEFT, SampledMode
from modal_id.results import AmplitudeDependence
from modal_id.sentences import Note
from modal_id.settings import IdentifySettings
from modal_id.solve import frequency_hz
from tracker import ComplexArray, Severity


@dataclass(frozen=True)
class Tuning:
    """Flags of a mode, and what affects an interval."""

    #: [1] part of the standard deviation over it that affects the interval
    share: float = 0.5
    #: [1] relative increase of the standard deviation that affects the interval
    noticeable: float = 0.1
    #: [1] residual power over the noise from which the values may be wrong
    far_too_much_left: float = 10.0
    #: [1] relative change of the frequency over the record below which it has no practical consequence
    #: convention: Chosen; effect on a severity.
    small_frequency_change: float = 5e-4
    #: [1] the same of the damping ratio; both must be small
    #: convention: As above.
    small_damping_change: float = 0.05
    #: [1] standard deviation of the frequency, over its value, from which an interval is wide
    #: convention: Chosen; effect on a severity.
    wide_frequency: float = 0.01
    #: [1] the same of the damping ratio
    #: convention: As above.
    wide_damping: float = 0.2
    #: [1] amplitude over the noise of a sample below which a mode is faint
    #: convention: Chosen; effect on a flag.
    low_snr: float = 10.0
    #: [cycles] in a record, below which it is short
    #: convention: Chosen; effect on a flag.
    least_cycles: float = 10.0
    #: [1] relative distance of frequencies below which modes are close
    #: convention: Chosen; effect on a flag.
    close: float = 0.1
    #: [1] share of the Nyquist frequency from which a line may be an alias
    #: convention: Chosen; effect on a flag.
    near_nyquist: float = 0.9


TUNING = Tuning()
CLOSE = TUNING.close


def severities(
    model: ModalFit, index: int, mode: SampledMode, flags: list[ModeFlag]
) -> tuple[tuple[str, str], ...]:
    """Name and severity of each flag of the mode with this index."""
    draws = mode.posterior
    values = (float(np.median(draws.frequency_hz)), float(np.median(draws.damping_ratio)))
    sd = (float(np.std(draws.frequency_hz)), float(np.std(draws.damping_ratio)))
    shares = [part / max(whole, 1e-300) for part, whole in zip(draws.systematic, sd, strict=True)]
    limits = (TUNING.wide_frequency, TUNING.wide_damping)
    wide = any(own > limit * value for own, value, limit in zip(sd, values, limits, strict=True))
    weak = signal_to_noise(model, index) < TUNING.low_snr
    affects = {
        ModeFlag.AMPLITUDE_DEPENDENT: max(shares) > TUNING.share and not _is_small(mode.dependence),
        ModeFlag.FEW_CYCLES_LOST: draws.extrapolation_damping_ratio > TUNING.share * sd[1],
        ModeFlag.SHORT_RECORD: wide,
        ModeFlag.LOW_SNR: wide,
        ModeFlag.CLOSE_MODE: _coupling(model, index) > 1.0 + TUNING.noticeable,
        ModeFlag.CHAIN_TOO_SHORT: min(draws.ess) < TUNING.noticeable**-2.0,
    }
    found = {flag: flag.usual_severity for flag in flags}
    for flag in flags:
        if flag in affects:
            found[flag] = Severity.INTERVAL if affects[flag] else Severity.INFORMATION
    if ModeFlag.FEW_CYCLES_LOST in found and ModeFlag.DAMPING_TOUCHES_ZERO in found:
        # Both flags are due to little decay; one of them is enough at the higher severity.
        found[ModeFlag.DAMPING_TOUCHES_ZERO] = Severity.INFORMATION
    # Of modes of few cycles, and strongest modes that are seen for few, 10 of 106 that are not confirmed are wrong in
    # 3000 random records; of others, 3 of 212. Of 1500 more, one of 85 others is wrong, one of four hardly known.
    seen_s = min(model.data.span_s, DECAY_TIMES / (2.0 * np.pi * values[0] * values[1]))
    few = index == model.strongest and values[0] * seen_s < TUNING.least_cycles
    doubtful = weak or few or ModeFlag.SHORT_RECORD in found or sd[0] > HARDLY_KNOWN * values[0]
    if ModeFlag.NOT_CONFIRMED in found and not doubtful:
        found[ModeFlag.NOT_CONFIRMED] = Severity.INFORMATION
    if ModeFlag.RESIDUAL_AT_MODE in found and mode.residual_power < TUNING.far_too_much_left:
        found[ModeFlag.RESIDUAL_AT_MODE] = Severity.INTERVAL
    return tuple((flag.name, severity.name) for flag, severity in found.items())


def _is_small(dependence: AmplitudeDependence | None) -> bool:
    """Whether the changes of frequency and damping ratio over the record have no practical consequence."""
    if dependence is None:
        return True
    if dependence.curve is None:
        changes = (dependence.f2_hz / dependence.f0_hz, dependence.zeta1 / dependence.zeta0)
    else:
        curve = dependence.curve
        ranges = (np.ptp(curve.frequency_hz), np.ptp(curve.damping_ratio))
        changes = (ranges[0] / curve.frequency_hz[0], ranges[1] / curve.damping_ratio[0])
    limits = (TUNING.small_frequency_change, TUNING.small_damping_change)
    return all(abs(float(change)) < limit for change, limit in zip(changes, limits, strict=True))


def _coupling(model: ModalFit, index: int) -> float:
    """Standard deviation of the pole relative to that with all other poles known; the larger of both parts."""
    covariance = model.fit.covariance
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance * np.outer(scale, scale)
    own = slice(2 * index, 2 * index + 2)
    alone = np.linalg.inv(np.linalg.pinv(correlation, hermitian=True)[own, own])
    return float(np.sqrt(np.max(np.diag(correlation[own, own]) / np.maximum(np.diag(alone), 1e-12))))


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
    rate_hz, expected = 2.0 * nyquist_hz(data.time_s), settings.expected_frequencies_hz
    at_nyquist = frequency > TUNING.near_nyquist * 0.5 * rate_hz
    aliases = possible_aliases(frequency, shape, number, rate_hz, settings)
    curve = None if mode.dependence is None else mode.dependence.curve
    raised = {
        ModeFlag.SHORT_RECORD: data.span_s * frequency < TUNING.least_cycles,
        ModeFlag.ADDED: is_added(model, index),
        ModeFlag.LOW_SNR: best < TUNING.low_snr,
        ModeFlag.AMPLITUDE_DEPENDENT: mode.dependence is not None and mode.dependence.significant,
        ModeFlag.CLOSE_MODE: bool(np.any(distance < CLOSE)),
        ModeFlag.CHAIN_TOO_SHORT: not mode.long_enough,
        ModeFlag.FEW_CYCLES_LOST: float(np.exp(fit.poles[index].real * data.span_s)) > LITTLE_DECAY,
        ModeFlag.UNRESOLVED: model.unresolved_near(index) is not None and not is_one_curve(curve),
        # The ratio of a half-normal density is 1.1.
        ModeFlag.DAMPING_TOUCHES_ZERO: float(np.median(draws)) < DECAYS_SD * _sd_below(mode),
        ModeFlag.RESIDUAL_AT_MODE: mode.residual_power > MUCH_LEFT,
        ModeFlag.ALIASED_POSSIBLE: at_nyquist or bool(aliases),
        ModeFlag.NOT_CONFIRMED: diagram is not None and not diagram.confirms(frequency),
        ModeFlag.MANY_OUTLIERS: are_many(outliers),
    }
    notes = []
    if at_nyquist:
        notes.append(alias_note(rate_hz, frequency))
    notes += [
        Note.ALIAS_OF_THEORY(rate_hz=rate_hz, number=other, theory_hz=expected[other - 1], hz=frequency)
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
        reach = max(OWN_BAND * float(hz), LINE_BINS / model.data.span_s)
        beside &= np.abs(spectrum.frequency_hz - hz) > reach
    share = float(np.mean(spectrum.power[beside]) / np.mean(spectrum.power)) if np.any(beside) else 1.0
    noise = np.sqrt(linear.noise_variance * min(share, 1.0))
    return float(np.max(np.abs(linear.amplitudes[index]) / np.maximum(noise, 1e-300)))


def _sd_below(mode: SampledMode) -> float:
    """Standard deviation of the damping ratio, without the distance to its values at other amplitudes."""
    variance = float(np.var(mode.posterior.damping_ratio))
    if mode.dependence is not None and mode.dependence.significant:
        variance -= mode.posterior.systematic[1] ** 2
    return float(np.sqrt(max(variance, 0.0)))
