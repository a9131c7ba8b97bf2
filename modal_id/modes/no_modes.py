"""Lines that are no modes: combination tones of stronger modes, errors of positions, and lines without evidence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.data import BEYOND_SD
from modal_id.fit import HIGHEST_OVERTONE
from modal_id.flags import ModeFlag
from modal_id.modes.aliases import apparent_hz
from modal_id.posterior import SampledMode
from modal_id.results import FailedMode
from modal_id.sentences import Note, Reason, Refusal
from tracker import ComplexArray, FloatArray, PositionErrors


@dataclass(frozen=True)
class Tuning:
    """Lines that are no modes."""

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
