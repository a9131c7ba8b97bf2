"""Which lines are no modes, which flags a mode receives, the notes that explain them, and their severity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.curve import is_one_curve
from modal_id.data import BEYOND_SD, are_many
from modal_id.fit import DECAY_TIMES, HIGHEST_OVERTONE, OWN_BAND, ModalFit, StabilityDiagram, nyquist_hz
from modal_id.modes.aliases import apparent_hz
from modal_id.modes.decays import DECAYS_SD
from modal_id.modes.numbering import possible_aliases
from modal_id.posterior import HARDLY_KNOWN, LINE_BINS, LITTLE_DECAY, MUCH_LEFT, SampledMode
from modal_id.results import AmplitudeDependence, FailedMode
from modal_id.sentences import ModeFlag, Note, Reason, Refusal, alias_note
from modal_id.settings import IdentifySettings
from modal_id.solve import frequency_hz
from tracker import ComplexArray, FloatArray, PositionErrors, Severity


@dataclass(frozen=True)
class Tuning:
    """Flags of a mode, what affects an interval, lines that are no modes."""

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
    #: [1] least ratio of the amplitudes of the motions to that of the distortion they cause
    weaker: float = 3.0
    #: [1] largest probability that some combination agrees by chance
    #: statistics: One line in twenty.
    chance: float = 0.05
    #: [1] highest order of a harmonic
    highest_order: int = 40
    #: [sd] amplitude of a line below which it may be an error that repeats with a motion
    error_sd: float = 2.0
    #: [1] least amplitude of that motion over the line's
    cause: float = 10.0
    #: [1] share of the sd of what predicted frames omit that may look like another line
    #: convention: It follows the amplitude slowly.
    slow_share: float = 0.5


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
        ModeFlag.FEW_CYCLES_LOST: model.amplitude_left(index) > LITTLE_DECAY,
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


# Damping ratios of the modes of one structure are spread over about this range.
_DECADES = 2.0 * float(np.log(10.0))


def combination_tones(
    sampled: Sequence[SampledMode | FailedMode], amplitudes: ComplexArray, rate_hz: float
) -> tuple[Refusal | None, ...]:
    """For each mode that it is a combination tone of stronger modes, or None.

    Nonlinearity of the structure or of the sensor, and errors of positions, turn the strongest motion, at f_1 and
    with the decay rate r_1, and another one into lines at a f_1 + b f_2 with the rate |a| r_1 + |b| r_2. A harmonic
    (b = 0) decays at a rate from r_1 (slip, play) to a r_1 (a smooth characteristic). Above half the sampling rate
    the line appears at its alias. A mode is such a line when frequency and rate agree within three standard
    deviations and what their dependence on the amplitude allows. Combinations are tried by order |a| + |b|, until one
    would agree by chance in 5 % of cases; harmonics first.

    Parameters
    ----------
    amplitudes : complex array, shape (m, k)
        Of the m modes.
    rate_hz : float
        Sampling rate.

    Notes
    -----
    Nayfeh & Mook, Nonlinear Oscillations (1979), sections 2.3 and 4.2: combination tones.
    """
    strength = np.max(np.abs(amplitudes), axis=1)
    lines = [None if isinstance(one, FailedMode) else _line(one) for one in sampled]
    found = []
    for k, own in enumerate(lines):
        stronger = [
            (strength[i], line)
            for i, line in enumerate(lines)
            if line and strength[i] > TUNING.weaker * strength[k]
        ]
        parents = [line for _, line in sorted(stronger, key=lambda pair: -pair[0])]
        found.append(_tone(own, parents, rate_hz) if own and parents else None)
    return tuple(found)


def within_errors(
    amplitudes: ComplexArray, errors: PositionErrors | None, channels: NDArray[np.intp], unit: str
) -> tuple[Refusal | None, ...]:
    """For each mode that it does not exceed the errors of positions beside a larger motion, or None.

    `amplitudes`, in `unit`, has shape (m, k), and `channels` are the indices of these k in the series, which `errors`
    describe.
    """
    size = np.abs(amplitudes)
    if errors is None:
        return (None,) * len(size)
    variance = 2.0 * np.sum(errors.periodic_sd**2, axis=0) + (TUNING.slow_share * errors.shrinkage_sd) ** 2
    limit = TUNING.error_sd * np.sqrt(variance)[channels]
    largest = float(np.max(size, initial=0.0))
    return tuple(
        _hidden(own, limit, unit)
        if TUNING.cause * float(np.max(own)) < largest and np.all(own < limit)
        else None
        for own in size
    )


def not_established(mode: SampledMode, flags: Sequence[ModeFlag]) -> Refusal | None:
    """That a line is not listed because signal, confirmation and decay are all in doubt, or None.

    Of a mode that only the user has named, that it decays must not be in doubt.
    """
    zeta, sd = (float(value(mode.posterior.damping_ratio)) for value in (np.median, np.std))
    if {ModeFlag.ADDED, ModeFlag.DAMPING_TOUCHES_ZERO} <= set(flags):
        return Reason.NAMED_NEED_NOT_DECAY(zeta_percent=100.0 * zeta, sd_percent=100.0 * sd)
    if zeta > sd or not {ModeFlag.LOW_SNR, ModeFlag.NOT_CONFIRMED} <= set(flags):
        return None
    return Reason.NOT_ESTABLISHED(zeta_percent=100.0 * zeta, sd_percent=100.0 * sd)


def _hidden(amplitude: FloatArray, limit: FloatArray, unit: str) -> Refusal:
    most = int(np.argmax(amplitude))
    return Reason.WITHIN_ERRORS(amplitude=amplitude[most], limit=limit[most], unit=unit)


@dataclass(frozen=True)
class _Line:
    """Frequency in Hz and decay rate in 1/s, each with its noise and its distance to the values at other amplitudes."""

    frequency: float
    frequency_sd: float
    frequency_reach: float
    rate: float
    rate_sd: float
    rate_reach: float


def _line(one: SampledMode) -> _Line:
    draws = one.posterior
    f, zeta = float(np.median(draws.frequency_hz)), float(np.median(draws.damping_ratio))
    omega = 2.0 * np.pi * f
    sd = [draws.noise_factor * value for value in draws.laplace_sd]
    reach_hz, reach = draws.systematic
    return _Line(f, sd[0], reach_hz, omega * zeta, omega * sd[1], omega * reach)


def _tone(own: _Line, parents: list[_Line], rate_hz: float) -> Refusal | None:
    """That a line is a combination tone of the first of its stronger lines, or None."""
    multiples = _multiples(parents[0], own.frequency)
    first = _agrees(own, multiples, rate_hz)
    return _agrees(own, _combinations(parents), rate_hz) if first is None else first


def _agrees(own: _Line, tones: Iterator[tuple[tuple[int, _Line], ...]], rate_hz: float) -> Refusal | None:
    chance = 0.0
    for parts in tones:
        true = abs(sum(n * line.frequency for n, line in parts))
        f = apparent_hz(true, rate_hz)
        highest = sum(abs(n) * line.rate for n, line in parts)
        lowest = parts[0][1].rate if len(parts) == 1 else highest
        f_reach = BEYOND_SD * float(
            np.hypot(own.frequency_sd, _root(n * line.frequency_sd for n, line in parts))
        )
        # A line and its distortion depend on the same amplitude.
        f_reach += max(own.frequency_reach, sum(abs(n) * line.frequency_reach for n, line in parts))
        reach = BEYOND_SD * float(np.hypot(own.rate_sd, _root(n * line.rate_sd for n, line in parts)))
        reach += max(own.rate_reach, sum(abs(n) * line.rate_reach for n, line in parts))
        likely = np.log((highest + reach) / max(lowest - reach, 1e-300)) / _DECADES
        chance += min(float(likely), 1.0) * min(2.0 * f_reach / own.frequency, 1.0)
        if chance > TUNING.chance:
            return None
        if abs(f - own.frequency) < f_reach and lowest - reach < own.rate < highest + reach:
            terms = " and ".join(Note.MULTIPLE(factor=abs(n), hz=line.frequency) for n, line in parts)
            if true > 0.5 * rate_hz:
                terms = Note.ALIASED(terms=terms, true_hz=true, rate_hz=rate_hz)
            return Reason.TONE(terms=terms)
    return None


def _multiples(strongest: _Line, frequency: float) -> Iterator[tuple[tuple[int, _Line], ...]]:
    for order in range(2, max(int(1.5 * frequency / strongest.frequency) + 2, HIGHEST_OVERTONE + 1)):
        yield ((order, strongest),)


def _combinations(parents: list[_Line]) -> Iterator[tuple[tuple[int, _Line], ...]]:
    """Multiples of each other line, and its sums and differences with the first, by ascending order."""
    strongest, others = parents[0], parents[1:]
    for order in range(2, TUNING.highest_order + 1):
        for other in others:
            yield ((order, other),)
            for n in range(1, order):
                yield (n, strongest), (order - n, other)
                yield (n, strongest), (n - order, other)


def _root(values: Iterable[float]) -> float:
    return float(np.sqrt(sum(value**2 for value in values)))
