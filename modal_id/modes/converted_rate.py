"""Recordings whose frame rate a converter changed, recognised by the times at which their frames were recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from modal_id.data import OUTLIER_SD
from modal_id.fit import ModalFit
from modal_id.modes.frame_clock import TUNING as CLOCK
from modal_id.modes.frame_clock import Clock, ClockFit, DecayRecord, Kind, Waves, decay_record
from modal_id.sentences import Note, Reason, Refusal
from tracker import MEDIAN_MODULUS, BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Films converted to another rate."""

    #: [1] probability with which a record of nothing but noise or stationary motion is taken for another one
    #: statistics: One record in ten thousand.
    false_alarm: float = 1e-4
    #: [1] line of the residual that is followed up
    #: statistics: White noise has one in 2 % of records.
    line: float = 4.0
    #: [1] largest number of lines that are followed up
    #: convention: Limits the computing time.
    lines: int = 3
    #: [1] largest number of patterns that are fitted
    #: convention: Limits the computing time.
    most_patterns: int = 6
    #: [periods] fewest periods of a pattern in the record
    #: convention: Fewer jumps may be changes of the motion.
    least_periods: float = 4.0
    #: [periods] periods below which blended frames must gain twice what noise reaches
    #: convention: Noise has slow changes.
    slow_periods: float = 8.0
    #: [1] number of phases tried first
    #: physics: The nearest is off by a sixteenth of a recorded frame, a fifth of what moves the frames.
    phases: int = 8
    #: [1] share of independent samples below which blended frames are not judged
    #: convention: What a fit leaves of the motion has a periodic power, too.
    mostly_noise: float = 0.5
    #: [1] number of phases that each have their own noise variance
    #: measurement: With one for all, 10 of 36 unconverted films in H.264 were taken for blended ones.
    variances: int = 8
    #: [1] number of lags over which the correlation of the noise is summed
    lags: int = 30
    #: [1] share of rows without a sample from which these rows are tried as inserted frames
    #: convention: The tracker notes as many repeated ones.
    skipped: float = 0.02


TUNING = Tuning()
RARE = TUNING.false_alarm

# Whole recorded frames per frame of the file, beside the fraction.
_WHOLE = (1, 2)
# The strongest line may be a multiple of the frequency of the pattern.
_ORDERS = (2, 3)
# Errors of positions that repeat with the motion make harmonics of the mode, which patterns at such multiples of its
# frequency, within one bin, would make side bands: on film, 3 f and 5 f were taken for side bands of a pattern at 2 f.
_REPEATING = (1, 2, 3, 4)
# With another displacement of the frames the fit must be worse: predicted frames lag by a part of a frame.
_OTHER_SHARES = (0.6, 1.4)

_UNMIXED: FloatArray = np.zeros(0)

_HOW: dict[Kind, Note] = {"moved": Note.MOVED, "blended": Note.BLENDED, "inserted": Note.INSERTED}


@dataclass(frozen=True)
class Conversion:
    """How a converter chose the frames of a file.

    Attributes
    ----------
    kind : str
        "moved" (recorded frames were left out or repeated), "blended" (frames are means of two), "inserted" (the rows
        without samples, as of repeated frames, are additional to the recorded ones).
    ratio : float
        Recorded frames per frame of the file: frequencies are too high by this factor if the rate is the camera's.
    evidence : float
        Twice the gain of the log-likelihood, without that expected by chance.
    side_bands : bool array, shape (m,)
        Modes of the fit that are side bands of the strongest one.
    """

    kind: Kind
    ratio: float
    evidence: float
    side_bands: BoolArray

    def side_band(self, index: int) -> Refusal | None:
        """That the mode with this index is a side band, or None."""
        return Reason.SIDE_BAND() if self.side_bands[index] else None

    def note(self, hz: float) -> str:
        """What the conversion means for a mode at this frequency in Hz."""
        return Note.CONVERTED(how=_HOW[self.kind](), ratio=self.ratio, true_hz=hz / self.ratio, hz=hz)


def conversion(model: ModalFit, *, steady_noise: bool, predicted: bool) -> Conversion | None:
    """The conversion that explains a decay clearly better than evenly spaced frames; None where there is none.

    Parameters
    ----------
    steady_noise : bool
        Whether the noise is the same throughout, without clusters of outliers; only then its variance tells of blended
        frames.
    predicted : bool
        Whether a codec predicted frames from others: every other one, by turns that change at key frames. Blended
        frames that alternate with others, as from half the rate, are not told from these.

    Notes
    -----
    Patterns are sought in the residual times the velocity of the strongest mode (displaced frames), times its
    displacement and squared (a mean of two frames has a smaller amplitude and less noise), and among modes that may be
    side bands. Hypotheses are compared by the Bayesian information criterion of the samples, which count less where
    the noise is correlated. Time steps must be even: otherwise the result is None. A ratio that is an integer leaves
    no trace.
    """
    record = decay_record(model)
    if record is None:
        return None
    even = record.fit(record.evenly(), record.all_modes)
    skipped = 1.0 - record.rows.size / record.length
    if skipped > TUNING.skipped:
        counted = Clock("inserted", 1.0 - skipped, 0.0)
        fit = record.fit_clock(counted)
        evidence = _evidence(record, even, fit)
        if evidence > 0.0:
            return Conversion("inserted", counted.ratio, evidence, ~fit.modes)
    _, velocity = record.motion(even)
    patterns = [*_patterns_of_modes(record), *_lines(record, even.residual * velocity)]
    found = _best(record, even, "moved", patterns)
    if found is not None:
        return found
    spread = np.median(np.abs(even.residual), axis=0) / MEDIAN_MODULUS
    kept = np.all(np.abs(even.residual) <= OUTLIER_SD * spread, axis=1)
    record = replace(record.only(kept), steady_noise=steady_noise, predicted=predicted)
    even = record.fit(record.evenly(), record.all_modes)
    displacement, _ = record.motion(even)
    patterns = _lines(record, even.residual * displacement)
    patterns += _lines(record, even.residual**2 - 1.0) if steady_noise else []
    patterns += _patterns_of_modes(record)
    if predicted:
        patterns = [one for one in patterns if (0.5 - one) * record.length > CLOCK.separate_bins]
    even = replace(even, cost=any_variance_cost(record, even)) if steady_noise else even
    return _best(record, even, "blended", patterns)


def least_gain(record: DecayRecord) -> float:
    """Twice the gain of the log-likelihood that noise reaches in a share `RARE` of records."""
    tries = record.length * TUNING.phases * len(_WHOLE) * 8.0
    return 2.0 * float(np.log(tries / RARE))


def any_variance_cost(record: DecayRecord, even: ClockFit) -> float:
    """Cost of evenly spaced frames where the noise of eight successive ones differs, or varies with the motion's phase.

    Codecs predict frames from others in such an order, and errors of positions grow with the speed. Each variance but
    one gains 1 by chance.
    """
    own = record.poles[record.strongest].imag / (2.0 * np.pi)
    others = (_flickering(record, even, cycles).cost for cycles in (1.0 / TUNING.variances, own))
    return min(even.cost, min(others) + TUNING.variances - 1)


def _best(record: DecayRecord, even: ClockFit, kind: Kind, patterns: Iterable[float]) -> Conversion | None:
    """The conversion of a kind with the first of the patterns that shows one."""
    for clocks in _clocks(record, kind, patterns):
        fits = [(_fit(record, clock), clock, record.mixing(clock)) for clock in clocks]
        judged = [(_evidence(record, even, fit, mixing), fit, clock, mixing) for fit, clock, mixing in fits]
        evidence, fit, clock, mixing = max(judged, key=lambda one: one[0])
        if evidence <= (least_gain(record) if _is_slow(record, clock) else 0.0):
            continue
        if kind == "blended" and _independent(fit.residual, mixing) < TUNING.mostly_noise:
            continue
        if _of_further_mode(record, clock) > evidence:
            continue
        if not _resembles(record, even, clock, fit):
            return Conversion(kind, clock.ratio, evidence, ~fit.modes)
        if kind == "blended":
            # What flickers has many lines, none of which shows more.
            return None
    return None


def _fit(record: DecayRecord, clock: Clock) -> ClockFit:
    """Fit of a clock, with all modes where errors that repeat with the motion would make the same side bands."""
    if _repeats(record, clock):
        return record.fit(record.waves(clock)._replace(double=None), record.all_modes)
    return record.fit_clock(clock)


def _repeats(record: DecayRecord, clock: Clock) -> bool:
    own = record.poles[record.strongest].imag / (2.0 * np.pi)
    return any(abs(_folded(order * own) - _folded(clock.ratio)) < 1.0 / record.length for order in _REPEATING)


def _is_slow(record: DecayRecord, clock: Clock) -> bool:
    return clock.kind == "blended" and _folded(clock.ratio) * record.length < TUNING.slow_periods


def _clocks(record: DecayRecord, kind: Kind, patterns: Iterable[float]) -> Iterator[tuple[Clock, ...]]:
    """The best clocks for each pattern: for its frequency, and for those it is a multiple of."""
    least = TUNING.least_periods / record.length
    seen: list[float] = []
    for pattern in patterns:
        if pattern < least or any(abs(pattern - other) < 0.5 / record.length for other in seen):
            continue
        seen.append(pattern)
        first = _of_pattern(record, kind, pattern)
        if first is not None:
            lower = [pattern / order for order in _ORDERS if pattern / order > least]
            others = (_of_pattern(record, kind, one) for one in lower)
            yield (first, *(one for one in others if one is not None))
        if len(seen) == TUNING.most_patterns:
            return


def _lines(record: DecayRecord, product: FloatArray) -> list[float]:
    """Cycles per frame of the strongest lines of a product, shape (n, r), summed over the components."""
    size = 2 * next_fast_len(2 * record.length)
    series = np.zeros(record.length)
    series[record.rows] = np.sum(product, axis=1)
    power = np.abs(rfft(series, size)) ** 2
    # In units of the mean of white noise, whose power is exponential.
    power /= max(float(np.median(power)) / np.log(2.0), 1e-300)
    # The last bin, half a cycle per frame, may be a peak.
    inner, above = power[1:], np.append(power[2:], 0.0)
    peaks = 1 + np.flatnonzero(
        (inner > power[:-1]) & (inner >= above) & (inner > np.log(record.length) + TUNING.line)
    )
    return [float(k) / size for k in peaks[np.argsort(-power[peaks])][: TUNING.lines]]


def _patterns_of_modes(record: DecayRecord) -> list[float]:
    """Cycles per frame by which modes that look like side bands are beside the strongest one."""
    cycles = record.poles.imag / (2.0 * np.pi)
    own = cycles[record.strongest]
    return [_folded(value) for other in cycles[record.alike] for value in (other - own, other + own)]


def _folded(cycles: float) -> float:
    """Alias between 0 and half a cycle per frame."""
    return float(abs(cycles - np.rint(cycles)))


def _of_pattern(record: DecayRecord, kind: Kind, pattern: float) -> Clock | None:
    """The most likely clock with this pattern in cycles per frame; None where none tells enough more than even frames.

    Both without the modes that are side bands: a phase that is not exact loses a small part of what the side bands
    have, but may lose more than they leave.
    """
    first = _cheapest(
        record,
        (
            Clock(kind, 1.0 + sign * pattern, k / TUNING.phases)
            for sign in (1.0, -1.0)
            for k in range(TUNING.phases)
        ),
    )
    sign = np.sign(first.ratio - 1.0)
    starts = [replace(first, ratio=whole + sign * pattern) for whole in _WHOLE]
    starts = [start for start in starts if _tells(record, start)]
    if not starts:
        return None
    best = _cheapest(record, [_refined(record, start, (0.5, 0.25)) for start in starts], exact=True)
    return _refined(record, best, (0.125, 0.06), exact=True)


def _tells(record: DecayRecord, start: Clock) -> bool:
    """Whether the nearest phase that was tried first has half of what noise reaches; it loses a tenth at most."""
    fit = record.fit_clock(start)
    return fit.cost + 0.5 * least_gain(record) < record.fit(record.evenly(), fit.modes).cost


def _refined(record: DecayRecord, clock: Clock, steps: tuple[float, ...], *, exact: bool = False) -> Clock:
    """The best clock around this one; half a bin of the ratio moves the ends by a quarter of a frame."""
    for step in steps:
        around = (
            replace(clock, ratio=clock.ratio + a * step / record.length, phase=clock.phase + b * step / 8.0)
            for a in (-1, 0, 1)
            for b in (-2, -1, 0, 1, 2)
        )
        clock = _cheapest(record, around, exact=exact)
    return clock


def _cheapest(record: DecayRecord, clocks: Iterable[Clock], *, exact: bool = False) -> Clock:
    return min(clocks, key=lambda one: record.fit_clock(one, exact=exact).cost)


def _evidence(record: DecayRecord, even: ClockFit, found: ClockFit, mixing: FloatArray = _UNMIXED) -> float:
    """Twice the gain of the log-likelihood over evenly spaced frames, without what noise may reach.

    Samples count as many times as they are independent, but for the correlation by `mixing` of frames; a mode that is
    left out makes the residual correlated, and the loss counts as that of the residual with it. The clock must explain
    what is left out: without these modes, it gains as much over even frames.
    """
    without = record.fit(record.evenly(), found.modes)
    explained = (without.cost - found.cost) * _independent(found.residual, mixing)
    gain = even.cost - found.cost
    share = _independent(found.residual, mixing) if gain > 0.0 else _independent(even.residual)
    per_parameter = float(np.log(max(share * record.values.size, 2.0)))
    gain = share * gain + (even.parameters - found.parameters) * per_parameter
    return min(gain, explained) - least_gain(record)


def _resembles(record: DecayRecord, even: ClockFit, clock: Clock, found: ClockFit) -> bool:
    """Whether another displacement of the frames, or noise of another periodic variance, explains the record better."""
    if clock.kind == "moved":
        others = (record.fit(record.waves(clock, share), found.modes).cost for share in _OTHER_SHARES)
        return any(cost < found.cost for cost in others)
    # Noise with any variance at each phase of the pattern, as of light that flickers. That of predicted frames has many
    # periods: a parameter costs no more than Akaike's criterion asks for.
    flicker = _flickering(record, even, clock.ratio)
    each = 2.0 if record.predicted else float(np.log(record.values.size))
    return flicker.cost + (flicker.parameters + TUNING.variances - found.parameters) * each < found.cost


def _of_further_mode(record: DecayRecord, clock: Clock) -> float:
    """Evidence for a weak mode that the fit lacks, where the clock has a side band of the strongest one.

    A conversion has side bands on both sides, of which one mode explains one.
    """
    even = record.fit(record.evenly(), record.all_modes)
    found = []
    for side in (2j, -2j):
        place = record.poles[record.strongest] + side * np.pi * clock.ratio
        more = replace(record, poles=np.append(record.poles, place), alike=np.append(record.alike, False))
        fit = more.fit(more.evenly(), more.all_modes)
        per_parameter = float(np.log(record.values.size))
        found.append(even.cost - fit.cost - (fit.parameters - even.parameters) * per_parameter)
    return max(found)


def _flickering(record: DecayRecord, even: ClockFit, cycles: float) -> ClockFit:
    """Evenly spaced frames whose noise has any variance at each phase of so many cycles per frame."""
    power = np.mean(even.residual**2, axis=1)
    phase = (np.mod(cycles * record.rows + 1e-6, 1.0) * TUNING.variances).astype(np.intp)
    counts = np.bincount(phase, minlength=TUNING.variances)
    variance = np.bincount(phase, power, minlength=TUNING.variances) / np.maximum(counts, 1)
    return record.fit(Waves(record.evenly().modes, np.maximum(variance[phase], 1e-3)), record.all_modes)


def _independent(residual: FloatArray, mixing: FloatArray = _UNMIXED) -> float:
    """Share of the samples, shape (n, r), that are independent, by their autocorrelation beyond that of `mixing`."""
    n = residual.shape[0]
    size = next_fast_len(2 * n)
    power = np.mean(np.abs(rfft(residual, size, axis=0)) ** 2, axis=1)
    correlation = irfft(power, size)[: min(TUNING.lags, n // 4) + 1]
    correlation = correlation / max(float(correlation[0]), 1e-300)
    correlation[1 : mixing.size + 1] -= mixing
    # What noise adds to the sum of squares.
    excess = np.maximum(correlation[1:] ** 2 - 4.0 / residual.size, 0.0)
    return float(1.0 / (1.0 + 2.0 * np.sum(excess)))
