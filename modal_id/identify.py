"""Identification of one displacement series: its modes and their posterior."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from modal_id.data.prepare import MIN_SAMPLES, Prepared, prepare, with_base
from modal_id.data.samples import FitData, rough_variance
from modal_id.fit.linear import Problem, solve_linear
from modal_id.fit.model_order import ModalFit, find_modes, refit
from modal_id.fit.poles import frequency_hz, mode_functions
from modal_id.fit.repeating_errors import without_repeating_errors
from modal_id.fit.spectrum import nyquist_hz
from modal_id.fit.subspace import stability_diagram
from modal_id.modes.flag_rules import MANY_OUTLIERS, mode_flags, outlier_share
from modal_id.modes.numbering import Numbering, TargetChoice, choose_target, number_modes
from modal_id.modes.severities import severities
from modal_id.modes.shapes import amplitude_sd
from modal_id.onset.find_onset import find_onset, user_onset
from modal_id.posterior.frame_rate import with_rate_error
from modal_id.posterior.mode_posterior import SampledMode, sample_mode
from modal_id.results import FailedIdentification, FailedMode, Identification, IdentifiedMode, Onset
from modal_id.settings import IdentifySettings
from tracker.arrays import BoolArray, FloatArray
from tracker.results import DisplacementSeries

# A channel in which every mode is below this many standard deviations has no motion.
_MOVES = 4.0


def identify(
    series: DisplacementSeries, settings: IdentifySettings | None = None
) -> Identification | FailedIdentification:
    """Identify the modes of one series.

    Parameters
    ----------
    series : DisplacementSeries
        May have uneven time steps, gaps (NaN) and outliers; nothing is resampled or interpolated.
    settings : IdentifySettings or None
        Default settings when None.

    Returns
    -------
    Identification or FailedIdentification
        The latter, falsy and with a reason, when no mode can be distinguished from noise and drift.

    Raises
    ------
    ValueError
        If the number of rows of `settings.expected_shapes` differs from the number of channels of the series.

    Notes
    -----
    Eq. 1 and Eq. 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation", with poles shared by
    all channels. A constant damping ratio is biased where damping depends on the amplitude: this is always tested, and
    where it is significant the mode is flagged and its interval widened. The error of the frame rate
    (`DisplacementSeries.rate_sd_ppm`) is in the draws of all frequencies as one common factor.
    """
    settings = IdentifySettings() if settings is None else settings
    shapes = settings.expected_shapes
    if shapes is not None and shapes.shape[0] != len(series.channels):
        msg = f"expected_shapes must have one row for each of the {len(series.channels)} channels, found {shapes.shape}"
        raise ValueError(msg)
    prepared = prepare(series)
    if isinstance(prepared, str):
        return FailedIdentification(series.name, prepared)
    lowest = _lowest_hz(settings)
    onset = _onset(series, prepared, settings, lowest)
    start = onset.fit_from_s - float(series.time_s[prepared.first_row])
    data = prepared.data.from_time(start)
    if data.time_s.size < MIN_SAMPLES:
        reason = (
            f"only {data.time_s.size} samples follow the start of the free decay at {onset.time_s:.4g} s; "
            "record longer after the stop, or set onset_s"
        )
        return FailedIdentification(series.name, reason)
    model = find_modes(data, settings.max_modes, lowest)
    if model is None:
        reason = (
            "no vibration exceeds noise and drift after the start of the free decay; check that the markers move, and "
            "check the onset"
        )
        return FailedIdentification(series.name, reason)
    model, moving = _without_still_channels(model)
    if series.position_errors is not None:
        model = without_repeating_errors(model, series.position_errors, prepared.channels[moving])
    return with_rate_error(_assemble(series, settings, prepared, onset, data, model, moving))


def _lowest_hz(settings: IdentifySettings) -> float:
    # Not from the target frequency: a stronger mode below it must be fitted, or it remains in the residual.
    expected = settings.expected_frequencies_hz
    return 0.4 * expected[0] if expected else 0.0


def _target_hz(settings: IdentifySettings) -> float | None:
    expected, number = settings.expected_frequencies_hz, settings.mode
    if number is not None and number <= len(expected):
        return expected[number - 1]
    return settings.target_frequency_hz


def _onset(
    series: DisplacementSeries, prepared: Prepared, settings: IdentifySettings, lowest: float
) -> Onset:
    begin = float(series.time_s[prepared.first_row])
    if settings.onset_s is not None:
        return replace(user_onset(settings.onset_s), fit_from_s=max(settings.onset_s, begin))
    data, base = with_base(prepared.data, series, prepared.first_row)
    found = find_onset(data, rough_variance(data), lowest, _target_hz(settings), base)
    return replace(found, time_s=found.time_s + begin, fit_from_s=found.fit_from_s + begin)


def _without_still_channels(model: ModalFit) -> tuple[ModalFit, BoolArray]:
    """Exclude channels without motion from the fit of the poles; at least one channel is kept."""
    linear = model.fit.linear
    sd = np.stack([amplitude_sd(model.data, linear, i) for i in range(model.fit.poles.size)])
    size = np.max(np.abs(linear.amplitudes) / np.maximum(sd, 1e-300), axis=0)
    moving = size > min(_MOVES, float(np.max(size)) * 0.999)
    if np.all(moving):
        return model, moving
    return refit(model, model.fit.poles, model.data.channels(moving)), moving


def _assemble(
    series: DisplacementSeries,
    settings: IdentifySettings,
    prepared: Prepared,
    onset: Onset,
    data: FitData,
    model: ModalFit,
    moving: BoolArray,
) -> Identification:
    poles = model.fit.poles
    # All usable channels, including those without motion; outliers of the others at weight 0.
    complete = FitData(data.time_s, data.values, data.weights.copy())
    complete.weights[:, moving] = model.data.weights
    linear = solve_linear(Problem(complete, model.problem.baseline), mode_functions(data.time_s, poles))
    motion = np.real(mode_functions(data.time_s, poles) @ linear.amplitudes) + linear.baseline
    k = len(series.channels)
    shapes = np.full((poles.size, k), complex(np.nan, np.nan))
    shapes[:, prepared.channels] = linear.amplitudes
    strength = _energy(model)
    numbering = number_modes(frequency_hz(poles), shapes, strength, settings)
    rate_hz = 2.0 * nyquist_hz(data.time_s)
    choice = choose_target(frequency_hz(poles), strength, numbering.numbers, settings, rate_hz)
    sampled = [sample_mode(model, index, settings) for index in range(poles.size)]
    choice = _strongest_success(choice, sampled, strength)
    numbering = _number_the_target(numbering, choice, settings)
    outliers = outlier_share(data.weights, complete.values - motion)
    diagram = stability_diagram(complete, linear.baseline, float(np.max(frequency_hz(poles))))
    modes, failed = [], []
    for index, outcome in enumerate(sampled):
        number, is_target = numbering.numbers[index], index == choice.index
        if isinstance(outcome, FailedMode):
            failed.append(replace(outcome, number=number, target=is_target))
            continue
        shape_sd = np.full(k, np.nan)
        shape_sd[prepared.channels] = amplitude_sd(complete, linear, index) * outcome.posterior.noise_factor
        flags, notes = mode_flags(model, index, outcome, shapes[index], number, settings, diagram, outliers)
        modes.append(
            IdentifiedMode(
                shape=shapes[index],
                shape_sd=shape_sd,
                amplitude=float(np.nanmax(np.abs(shapes[index]))),
                amplitude_unit=series.unit,
                posterior=outcome.posterior,
                amplitude_dependence=outcome.dependence,
                number=number,
                target=is_target,
                mac=numbering.macs[index],
                flags=tuple(flag.name for flag in flags),
                notes=(*(flag.value for flag in flags), *notes),
                severities=severities(model, index, outcome, flags),
            )
        )
    if choice.index is None:
        failed.append(FailedMode(choice.reason, choice.frequency_hz, settings.mode, target=True))
    cells = np.ix_(np.arange(series.time_s.size - data.time_s.size, series.time_s.size), prepared.channels)
    channels_used = np.zeros(k, dtype=bool)
    channels_used[prepared.channels[moving]] = True
    residual_sd = np.full(k, np.nan)
    residual_sd[prepared.channels] = np.sqrt(linear.noise_variance)
    return Identification(
        series=series,
        onset=onset,
        modes=tuple(modes),
        failed=tuple(failed),
        fitted=_in_series(series, cells, motion),
        baseline=_in_series(series, cells, linear.baseline),
        used=(_in_series(series, cells, complete.weights) > 0.0) & channels_used,
        residual_sd=residual_sd,
        channels_used=channels_used,
        notes=_notes(series, prepared, data, model, moving, outliers),
    )


def _in_series(series: DisplacementSeries, cells: tuple[Any, ...], values: FloatArray) -> FloatArray:
    """The values in the series' own rows and channels, NaN elsewhere."""
    result = np.full(series.values.shape, np.nan)
    result[cells] = values
    return result


def _energy(model: ModalFit) -> FloatArray:
    """Square root of each mode's energy in the record, with channels weighted by their noise."""
    decay = np.maximum(-model.fit.poles.real, 1e-12)
    duration = -np.expm1(-2.0 * decay * model.data.span_s) / (2.0 * decay)
    power = np.sum(np.abs(model.fit.linear.amplitudes) ** 2 / model.fit.linear.noise_variance, axis=1)
    return np.asarray(np.sqrt(power * duration))


def _strongest_success(
    choice: TargetChoice, sampled: list[SampledMode | FailedMode], strength: FloatArray
) -> TargetChoice:
    """Without a requested target, the strongest motion that was identified as a mode; it may be a hum or a drift."""
    good = np.array([isinstance(outcome, SampledMode) for outcome in sampled])
    if choice.requested or choice.index is None or good[choice.index] or not np.any(good):
        return choice
    return replace(choice, index=int(np.argmax(np.where(good, strength, -1.0))))


def _number_the_target(numbering: Numbering, choice: TargetChoice, settings: IdentifySettings) -> Numbering:
    """Without theory the target mode takes the number given by the user; numbers from theory are kept."""
    if settings.mode is None or choice.index is None or settings.expected_frequencies_hz:
        return numbering
    numbers = list(numbering.numbers)
    numbers[choice.index] = settings.mode
    return replace(numbering, numbers=tuple(numbers))


def _notes(
    series: DisplacementSeries,
    prepared: Prepared,
    data: FitData,
    model: ModalFit,
    moving: BoolArray,
    outliers: float,
) -> tuple[str, ...]:
    notes = [*series.notes, *prepared.notes]
    still = [series.channels[i] for i in prepared.channels[~moving]]
    if still:
        notes.append(f"The fit does not use {', '.join(still)}: no motion above the noise after the onset.")
    given = data.weights[:, moving] > 0.0
    total, rejected = int(np.count_nonzero(given)), int(np.count_nonzero(given & (model.data.weights == 0.0)))
    if rejected:
        notes.append(
            f"{rejected} of {total} samples were rejected as outliers (more than 5 sd from the fitted model)."
        )
    if outliers > MANY_OUTLIERS and rejected < 0.5 * outliers * total:
        notes.append(
            f"Up to {100.0 * outliers:.1f} % of the samples of a channel deviate from the fitted model by more than 5 "
            "sd, in clusters rather than at random: they were kept, and the noise level includes them. Inspect the "
            "residual."
        )
    missing = given.size - total
    if missing:
        notes.append(f"{missing} samples after the onset are missing; they were left out, not interpolated.")
    return tuple(notes)
