"""Identification of a series whose input was measured: modes, participation and frequency response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from modal_id.data import MIN_SAMPLES, Prepared, prepare
from modal_id.mode_values import FrequencyResponse
from modal_id.modes import numbered
from modal_id.posterior import MUCH_LEFT, with_rate_error
from modal_id.record import Onset, Segment
from modal_id.response.columns import FIXED, PER_MODE, Channel, Samples, sparse_outputs, unusable
from modal_id.response.known_input import candidates, criterion, fit_response
from modal_id.response.lag import HIGHEST, better_lag, fit_with_lag
from modal_id.response.noise import InputNoise
from modal_id.response.solution import (
    MOST_FREQUENCIES,
    ResponseFit,
    coherence,
    left_at_mode,
    local_polynomial,
    model_bands,
)
from modal_id.results import FailedMode, Identification, IdentifiedMode, Posterior
from modal_id.sentences import ModeFlag, Note, Reason, Refusal, in_hz
from modal_id.settings import IdentifySettings
from modal_id.solve import damping_ratio, frequency_hz, modal_slopes
from tracker import DisplacementSeries, Failure, FloatArray, KnownInput


@dataclass(frozen=True)
class Tuning:
    """Band of the fit, and what a mode and an input must be to be used."""

    #: [1] rows with omitted ones over given rows above which the record is refused
    most_rows: float = 1.5
    #: [samples] longest gap of the input that a spline through its neighbours bridges
    #: physics: It changes a sinusoid of 20 samples a period by (6 pi / 20)^4 / 384 = 0.002 of it.
    bridged: int = 2
    #: [1] largest given lag of the input over the span of the record
    #: convention: Beyond, the channels do not belong together.
    most_lag: float = 0.5
    #: [1] relative sd of the damping ratio above which a mode is not determined
    #: statistics: Its 90 % interval would reach half of the value.
    most_relative_sd: float = 0.3
    #: [1] the same where what the fit leaves follows the input
    #: measurement: In 110 folded records (every second row of "broad" of benchmarks/known_input.py), the 17 modes that
    #: are off by more than 3.5 sd have at least 0.11.
    most_unexplained_sd: float = 0.1
    #: [1] draws of a mode in each ensemble
    #: statistics: Their 5 % quantile has an error of 0.05 sd.
    draws: int = 2000


TUNING = Tuning()
DRAWS = TUNING.draws
_ENSEMBLES = 4
_ACCELERATION = frozenset({"m/s^2", "m/s²", "m/s2", "mm/s^2", "g"})


def identify_response(series: DisplacementSeries, settings: IdentifySettings) -> Identification | Failure:
    """Identify the modes of a series from its response to `DisplacementSeries.known_input`.

    The motion may be anything the input causes (a sweep, random, by hand), with free decay of what moved before, in one
    record. Uneven times are integrated as they are; missing samples of the outputs are left out. Up to two samples of
    the input are taken from a spline through their neighbours; of an input with longer gaps the longest part is used.
    Of `settings`, `max_modes`, `reject_hz`, `onset_s`, `end_s` and the seed are used.

    Returns
    -------
    Identification or Failure
        The latter where the input does not move, is clipped or has gaps, or where no mode exceeds the noise.

    Notes
    -----
    The posterior is normal in the pole: the record determines it to a few per cent or the mode is refused. Damping is
    that of a linear system, biased where it depends on the amplitude.
    """
    known = series.known_input
    if known is None:
        msg = f"{series.name}: the series has no known_input"
        raise ValueError(msg)
    problem = sparse_outputs(series, known)
    prepared = prepare(series) if problem is None else problem
    if isinstance(prepared, Refusal):
        return prepared.at(series.name)
    samples = _samples(series, prepared, known, settings)
    if isinstance(samples, Refusal):
        return samples.at(series.name)
    rows, data = samples
    found = _fitted(data, known, settings)
    if isinstance(found, Refusal):
        return found.at(series.name)
    return with_rate_error(_assembled(series, prepared, rows, known, found, settings))


def _fitted(data: Samples, known: KnownInput, settings: IdentifySettings) -> ResponseFit | Refusal:
    """The fit, with the lag of the input as asked for, or why there is none."""
    options = settings.max_modes, settings.lowest_hz, known.sd
    if settings.input_lag_ms == "auto":
        found = fit_with_lag(data, *options)
        if isinstance(found, Refusal):
            return Reason.NO_LAG(input=known.name, problem=found)
        return found or Reason.NO_RESPONSE(input=known.name)
    if settings.input_lag_ms is not None:
        lag_ms, percent = settings.input_lag_ms, 100.0 * (1.0 - TUNING.most_lag)
        if abs(1e-3 * lag_ms) > TUNING.most_lag * data.span_s:
            return Reason.LAG_LONG(input=known.name, lag_ms=lag_ms, percent=percent, span_s=data.span_s)
        data = data.late(Channel.through(data.time_s, data.input), 1e-3 * lag_ms)
    return fit_response(data, *options) or Reason.NO_RESPONSE(input=known.name)


def _samples(
    series: DisplacementSeries, prepared: Prepared, known: KnownInput, settings: IdentifySettings
) -> tuple[slice, Samples] | Refusal:
    """Rows of the series and samples of the fit, or why there are none."""
    first = prepared.first_row
    end_s = np.inf if settings.end_s is None else settings.end_s
    inside = (series.time_s >= (settings.onset_s or -np.inf)) & (series.time_s <= end_s)
    # Beyond the outputs, the input alone is not fitted.
    recorded = np.flatnonzero(np.isfinite(series.values[:, prepared.channels]).any(axis=1))
    inside[: max(first, recorded[0])] = False
    inside[recorded[-1] + 1 :] = False
    inside[first + prepared.repeated.size :] = False
    used = np.flatnonzero(inside)
    if used.size < MIN_SAMPLES:
        return Reason.FEW_WITH_INPUT(found=used.size, least=MIN_SAMPLES)
    rows = slice(int(used[0]), int(used[-1]) + 1)
    values = known.values[rows]
    problem = unusable(values, np.asarray(np.any(np.isfinite(series.values[rows]), axis=1)), known)
    if problem is not None:
        return problem
    start, stop = _longest_part(series.time_s[rows], values)
    rows, values = slice(rows.start + start, rows.start + stop), values[start:stop]
    if values.size < MIN_SAMPLES:
        return Reason.FEW_OF_INPUT(input=known.name, found=values.size, least=MIN_SAMPLES)
    own = slice(rows.start - first, rows.stop - first)
    time_s, places = _with_omitted_rows(series.time_s[rows] - series.time_s[rows.start])
    if time_s.size > TUNING.most_rows * values.size:
        return Reason.BURSTS(missing=time_s.size - values.size, count=time_s.size)
    given = np.zeros((time_s.size, prepared.channels.size), dtype=bool)
    outputs, full = np.zeros(given.shape), np.full(time_s.size, np.nan)
    given[places] = prepared.data.weights[own] > 0.0
    outputs[places], full[places] = prepared.data.values[own], values
    # Missing outputs begin at a straight line between their neighbours; the fit replaces them by its own motion.
    for out, seen_here in enumerate(given.T):
        outputs[~seen_here, out] = np.interp(time_s[~seen_here], time_s[seen_here], outputs[seen_here, out])
    highest = int(HIGHEST * time_s.size / 2)
    return rows, Samples(time_s, outputs, given, full, highest)


def _longest_part(time_s: FloatArray, values: FloatArray) -> tuple[int, int]:
    """First row and end of the longest part in which the input is recorded: through a gap, no mode can be followed."""
    seen = np.flatnonzero(np.isfinite(values))
    steps_s = np.diff(time_s[seen])
    gaps = np.flatnonzero(steps_s > (TUNING.bridged + 1.5) * np.median(steps_s))
    starts, ends = seen[np.append(0, gaps + 1)], seen[np.append(gaps, seen.size - 1)]
    longest = int(np.argmax(time_s[ends] - time_s[starts]))
    return int(starts[longest]), int(ends[longest]) + 1


def _with_omitted_rows(time_s: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Times with those of omitted samples inserted, and the places of the given ones: bins then are frequencies."""
    steps = np.diff(time_s)
    counts = np.maximum(np.round(steps / np.median(steps)), 1.0).astype(np.intp)
    places = np.concatenate([[0], np.cumsum(counts)])
    return np.interp(np.arange(places[-1] + 1), places, time_s), places


def _assembled(
    series: DisplacementSeries,
    prepared: Prepared,
    rows: slice,
    known: KnownInput,
    found: ResponseFit,
    settings: IdentifySettings,
) -> Identification:
    samples, k = found.samples, len(series.channels)
    time_s, places = _with_omitted_rows(series.time_s[rows] - series.time_s[rows.start])
    # Without those at which a late input was not recorded.
    places -= np.searchsorted(time_s, samples.time_s[0])
    own = np.flatnonzero((places >= 0) & (places < samples.time_s.size))
    places, rows = places[own], slice(rows.start + int(own[0]), rows.start + int(own[-1]) + 1)
    cells = np.ix_(np.arange(rows.start, rows.stop), prepared.channels)
    columns = samples.in_time(found.poles)[places]
    fitted, baseline, used = (np.full((series.time_s.size, k), np.nan) for _ in range(3))
    fitted[cells] = columns @ found.coefficients
    baseline[cells] = columns[:, 2:FIXED] @ found.coefficients[2:FIXED]
    used[cells] = given = samples.given[places]
    left = np.sum((samples.values[places] - fitted[cells]) ** 2 * given, axis=0) / np.sum(given, axis=0)
    words = _unexplained(found, settings.lowest_hz)
    listed = [
        _mode(series, prepared, known, found, index, settings, words) for index in range(found.poles.size)
    ]
    failed = [one for one in listed if isinstance(one, FailedMode)]
    modes = [one for one in listed if isinstance(one, IdentifiedMode)]
    if settings.input_lag_ms is None and (late_s := better_lag(found)) is not None:
        late = Note.INPUT_LATE(input=known.name, lag_ms=1e3 * late_s)
        modes = [mode.with_flags([ModeFlag.INPUT_LATE], late) for mode in modes]
    kept, others = numbered(modes, settings, 1.0 / samples.step_s)
    start_s, end_s = float(series.time_s[rows.start]), float(series.time_s[rows.stop - 1])
    whole = rows.stop - rows.start == series.time_s.size
    part = Note.WHOLE() if whole else Note.PART(start_s=start_s, end_s=end_s)
    missing = np.flatnonzero(np.isnan(known.values))
    if np.any((missing < rows.start) | (missing >= rows.stop)):
        part = Note.WITHOUT_GAP(part=part)
    note = Note.RESPONSE(input=known.name, part=part)
    return Identification(
        series=series,
        onset=Onset(start_s, 0.0, start_s, "record start", 1.0, note),
        modes=kept,
        failed=(*failed, *others),
        fitted=fitted,
        baseline=baseline,
        used=used == 1.0,
        residual_sd=prepared.in_series(np.sqrt(left), k),
        channels_used=np.isin(np.arange(k), prepared.channels),
        notes=(
            *series.notes,
            *prepared.notes,
            note,
            *_notes(known, found),
        ),
        segments=(Segment("driven", start_s, end_s, note),),
        response=_response(series, prepared, known, found, settings),
    )


def _mode(
    series: DisplacementSeries,
    prepared: Prepared,
    known: KnownInput,
    found: ResponseFit,
    index: int,
    settings: IdentifySettings,
    unexplained: str,
) -> IdentifiedMode | FailedMode:
    pole = complex(found.poles[index])
    factor, left, freedom = left_at_mode(found, index)
    if unexplained:
        factor *= freedom
    own = factor * found.covariance[2 * index : 2 * index + 2, 2 * index : 2 * index + 2]
    hz, zeta = float(frequency_hz(pole)), float(damping_ratio(pole))
    slopes = modal_slopes(pole) / [[2.0 * np.pi], [1.0]]  # of the frequency in Hz
    sd = np.sqrt(np.diag(slopes @ own @ slopes.T))
    if sd[1] > (TUNING.most_unexplained_sd if unexplained else TUNING.most_relative_sd) * zeta:
        advice = unexplained.removesuffix(".") or Note.EXCITE()
        return FailedMode.of(Reason.DAMPING_OPEN(zeta=zeta, sd=sd[1], advice=advice), hz)
    driven = found.driven[index]
    values, errors = participation(
        found, index, is_force=known.is_force, of_acceleration=series.unit in _ACCELERATION
    )
    z = found.samples.drive.response(pole)
    largest = z[int(np.argmax(np.abs(z)))]
    k, shape = len(series.channels), driven * largest
    shape_sd = errors / np.maximum(np.abs(values), 1e-300) * np.abs(shape)
    mode = IdentifiedMode(
        shape=prepared.in_series(shape, k),
        shape_sd=prepared.in_series(shape_sd, k),
        amplitude=float(np.nanmax(np.abs(shape))),
        amplitude_unit=series.unit,
        posterior=_posterior(pole, own, (float(sd[0]), float(sd[1])), factor, index, settings),
        participation=prepared.in_series(values, k),
        participation_sd=prepared.in_series(np.sqrt(factor) * errors, k),
    )
    if unexplained:
        mode = mode.with_flags([ModeFlag.INPUT_INCOMPLETE], unexplained)
    return mode.with_flags([ModeFlag.RESIDUAL_AT_MODE]) if left > MUCH_LEFT else mode


def participation(
    found: ResponseFit, index: int, *, is_force: bool, of_acceleration: bool
) -> tuple[FloatArray, FloatArray]:
    """Participation of the outputs in a mode and its standard deviation, shape (k,) each; see `IdentifiedMode`.

    The residue of ``-p s^2 / (s^2 + 2 zeta w s + w^2)`` (base) or ``p / (...)`` (force) at the pole is c / 2. The real
    part: the imaginary part is 0 for modes of proportional damping and synchronous channels.
    """
    pole = found.poles[index]
    factor = 1j * pole.imag
    if not is_force:
        factor = -factor / pole**2
    elif of_acceleration:
        factor = factor / pole**2
    driven = found.driven[index]
    first = FIXED + PER_MODE * index
    # c = a - i b; Re(factor c) = Re(factor) a + Im(factor) b.
    weights = np.array([factor.real, factor.imag])
    variance = [
        weights @ own[first : first + 2, first : first + 2] @ weights for own in found.coefficient_covariance
    ]
    return np.real(factor * driven), np.sqrt(np.array(variance))


def _posterior(
    pole: complex,
    covariance: FloatArray,
    sd: tuple[float, float],
    factor: float,
    index: int,
    settings: IdentifySettings,
) -> Posterior:
    """Draws of frequency and damping ratio for a normal pole; there is no chain, and its diagnostics are NaN."""
    seed = (settings.seed, *settings.seed_key, index)
    generator = np.random.default_rng(seed)
    scores = ndtri((np.arange(_ENSEMBLES * DRAWS) + 0.5) / (_ENSEMBLES * DRAWS))
    normal = np.column_stack([generator.permutation(scores) for _ in range(2)])
    values, vectors = np.linalg.eigh(covariance)
    moved = normal @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    poles = (pole + moved[:, 0] + 1j * moved[:, 1]).reshape(_ENSEMBLES, -1)
    nan = float("nan")
    return Posterior(
        frequency_hz=frequency_hz(poles),
        damping_ratio=damping_ratio(poles),
        r_hat=(nan, nan),
        ess=(nan, nan),
        autocorrelation_steps=nan,
        acceptance=nan,
        noise_factor=float(np.sqrt(factor)),
        laplace_sd=sd,
        seed=seed,
    )


def _notes(known: KnownInput, found: ResponseFit) -> tuple[str, ...]:
    if found.noise.input == 0.0:
        return ()
    sd = float(np.sqrt(found.noise.input))
    given = InputNoise.of(found.samples, known.sd)
    at = frequency_hz(found.poles)
    ratio = (found.noise.input if given.known else given.variance) * np.abs(found.transfer(at)) ** 2
    own = np.column_stack([np.interp(at, found.samples.frequency_hz, o) for o in found.noise.output.T])
    most = at[np.any(ratio > own, axis=1)]
    if not most.size:
        return ()
    if not given.known:
        return (Note.NOISE_UNKNOWN(input=known.name, sd=sd, unit=known.unit, most=given.variance**0.5),)
    places = ", ".join(f"{hz:.4g} Hz" for hz in most)
    return (Note.NOISE_LARGE(input=known.name, sd=sd, unit=known.unit, source=given.text, hz=places),)


def _unexplained(found: ResponseFit, lowest_hz: float) -> str:
    """Where what the fit leaves looks like the response of modes that are not listed; empty where it does not."""
    places = candidates(found, lowest_hz, criterion(found.samples))
    if not places:
        return ""
    return Note.INPUT_INCOMPLETE(hz=in_hz(sorted(set(np.round(frequency_hz(np.array(places)), 1)))))


def _response(
    series: DisplacementSeries,
    prepared: Prepared,
    known: KnownInput,
    found: ResponseFit,
    settings: IdentifySettings,
) -> FrequencyResponse:
    samples = found.samples
    step = max(1, samples.frequency_hz.size // MOST_FREQUENCIES)
    # Bins near a resonance, which a coarser grid would miss, are kept.
    distance = np.abs(samples.frequency_hz[:, None] - frequency_hz(found.poles))
    near = np.any(distance < 3.0 * np.abs(found.poles.real) / np.pi + 3.0 / samples.span_s, axis=1)
    kept = np.flatnonzero((np.arange(samples.frequency_hz.size) % step == 0) | near)
    grid = samples.frequency_hz[kept]
    local, local_sd = local_polynomial(samples)
    low, high = model_bands(found, grid, [settings.seed, *settings.seed_key])
    return FrequencyResponse(
        frequency_hz=grid,
        channels=tuple(series.channels[i] for i in prepared.channels),
        input_name=known.name,
        unit="1" if known.unit == series.unit else f"{series.unit}/{known.unit}",
        model=found.transfer(grid),
        magnitude_q05=low,
        magnitude_q95=high,
        local=local[kept],
        local_sd=local_sd[kept],
        coherence=coherence(samples)[kept],
        input_lag_s=samples.lag_s,
        input_lag_sd_s=found.lag_sd_s,
    )
