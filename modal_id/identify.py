"""A displacement series to its modes with their posterior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data.prepare import Prepared, from_time, prepare, with_base
from modal_id.fit.decay import frequency_hz
from modal_id.fit.linear import FitData, LinearSolution, Problem, solve_linear
from modal_id.fit.order import ModalFit, find_modes, refit, rough_variance
from modal_id.fit.spectrum import nyquist_hz
from modal_id.fit.subspace import stability_diagram
from modal_id.fit.varpro import mode_functions
from modal_id.flags import ModeFlag
from modal_id.modes.mode_flags import of_the_record, outlier_share
from modal_id.modes.numbering import Numbering, TargetChoice, choose_target, number_modes
from modal_id.modes.shapes import amplitude_sd
from modal_id.onset.onset import find_onset, user_onset
from modal_id.posterior.mode import SampledMode, sample_mode
from modal_id.results import (
    AmplitudeDependence,
    FailedIdentification,
    FailedMode,
    Identification,
    IdentifiedMode,
    Onset,
    Posterior,
)
from modal_id.settings import IdentifySettings
from tracker.arrays import ComplexArray, FloatArray
from tracker.results import DisplacementSeries

_MIN_SAMPLES = 24
# A channel whose every mode is below this many standard deviations does not move.
_MOVES = 4.0


def identify(
    series: DisplacementSeries, settings: IdentifySettings | None = None
) -> Identification | FailedIdentification:
    """Identify the modes of one series.

    Parameters
    ----------
    series : DisplacementSeries
        Uneven steps, gaps (NaN) and outliers are all right; nothing is resampled or filled in.
    settings : IdentifySettings or None
        Default settings when None.

    Returns
    -------
    Identification or FailedIdentification
        The latter, falsy and with a reason, when no mode can be told from noise and drift.

    Raises
    ------
    ValueError
        If `settings.expected_shapes` has another number of rows than the series has channels.

    Notes
    -----
    Eq. 1 and Eq. 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation", with poles
    shared by all channels. A constant damping ratio is biased where damping depends on the amplitude; this is
    always tested, flagged, and the interval widened.
    """
    settings = IdentifySettings() if settings is None else settings
    shapes = settings.expected_shapes
    if shapes is not None and shapes.shape[0] != len(series.channels):
        msg = f"expected_shapes must have one row for each of the {len(series.channels)} channels, got {shapes.shape}"
        raise ValueError(msg)
    prepared = prepare(series)
    if isinstance(prepared, str):
        return FailedIdentification(series.name, prepared)
    lowest = _lowest_hz(settings)
    onset = _onset(series, prepared, settings, lowest)
    start = onset.fit_from_s - float(series.time_s[prepared.first_row])
    data = from_time(prepared.data, start)
    if data.time_s.size < _MIN_SAMPLES:
        reason = (
            f"only {data.time_s.size} samples follow the start of the free decay at {onset.time_s:.4g} s; "
            "record longer after the stop or give onset_s"
        )
        return FailedIdentification(series.name, reason)
    model = find_modes(data, settings.max_modes, lowest)
    if model is None:
        reason = (
            "no vibration stands out of noise and drift after the start of the free decay; check that the markers "
            "move, and the onset"
        )
        return FailedIdentification(series.name, reason)
    model, moving = _without_still_channels(model)
    return _assemble(series, settings, prepared, onset, data, model, moving)


def _lowest_hz(settings: IdentifySettings) -> float:
    # Not from the wanted frequency: a stronger mode below it must be fitted, or it ends up in the residual.
    known = settings.expected_frequencies_hz[:1]
    return 0.4 * known[0] if known else 0.0


def _wanted_hz(settings: IdentifySettings) -> float | None:
    expected, number = settings.expected_frequencies_hz, settings.mode
    if number is not None and number <= len(expected):
        return expected[number - 1]
    return settings.target_frequency_hz


def _onset(
    series: DisplacementSeries, prepared: Prepared, settings: IdentifySettings, lowest: float
) -> Onset:
    if settings.onset_s is not None:
        given = user_onset(settings.onset_s)
        first = float(series.time_s[prepared.first_row])
        return replace(given, fit_from_s=max(settings.onset_s, first))
    begin = float(series.time_s[prepared.first_row])
    data, base = with_base(prepared.data, series, prepared.first_row)
    wanted, expected = _wanted_hz(settings), settings.expected_frequencies_hz
    found = find_onset(data, rough_variance(data), lowest, wanted, expected, base)
    return replace(found, time_s=found.time_s + begin, fit_from_s=found.fit_from_s + begin)


def _without_still_channels(model: ModalFit) -> tuple[ModalFit, NDArray[np.bool_]]:
    """Leave channels without motion out of the pole fit; at least one stays."""
    linear = model.fit.linear
    sd = np.stack([amplitude_sd(model.data, linear, i) for i in range(model.fit.poles.size)])
    size = np.max(np.abs(linear.amplitudes) / np.maximum(sd, 1e-300), axis=0)
    moving = size > min(_MOVES, float(np.max(size)) * 0.999)
    if np.all(moving):
        return model, moving
    data = FitData(model.data.time_s, model.data.values[:, moving], model.data.weights[:, moving])
    return refit(model, model.fit.poles, data), moving


def _assemble(
    series: DisplacementSeries,
    settings: IdentifySettings,
    prepared: Prepared,
    onset: Onset,
    data: FitData,
    model: ModalFit,
    moving: NDArray[np.bool_],
) -> Identification:
    poles = model.fit.poles
    everything = FitData(data.time_s, data.values, data.weights.copy())
    everything.weights[:, moving] = model.data.weights
    functions = mode_functions(data.time_s, poles)
    linear = solve_linear(Problem(everything, model.problem.baseline), functions)
    k = len(series.channels)
    shapes = np.full((poles.size, k), complex(np.nan, np.nan))
    shapes[:, prepared.channels] = linear.amplitudes
    strength = _energy(model)
    numbering = number_modes(frequency_hz(poles), shapes, strength, settings)
    rate_hz = 2.0 * nyquist_hz(data.time_s)
    choice = choose_target(frequency_hz(poles), strength, numbering.numbers, settings, rate_hz)
    sampled = [sample_mode(model, index, settings) for index in range(poles.size)]
    choice = _dominant_that_succeeded(choice, sampled, strength)
    numbering = _number_the_target(numbering, choice, settings)
    share = outlier_share(data, data.weights, everything.values - _motion(everything, poles, linear))
    diagram = stability_diagram(everything, linear.baseline, float(np.max(frequency_hz(poles))))
    modes, failed = [], []
    for index, outcome in enumerate(sampled):
        number, is_target = numbering.numbers[index], index == choice.index
        if isinstance(outcome, FailedMode):
            failed.append(replace(outcome, number=number, target=is_target))
            continue
        shape_sd = np.full(k, np.nan)
        shape_sd[prepared.channels] = amplitude_sd(everything, linear, index) * outcome.posterior.noise_factor
        raised, notes = of_the_record(model, index, shapes[index], number, settings, diagram, share)
        told = _Told((*outcome.flags, *raised), notes, number, numbering.macs[index], is_target)
        modes.append(_mode(outcome.posterior, outcome.dependence, shapes[index], shape_sd, series.unit, told))
    if choice.index is None:
        failed.append(FailedMode(choice.reason, choice.frequency_hz, settings.mode, target=True))
    placed = _place(series, prepared, data, everything, model, linear)
    used_channels = np.zeros(k, dtype=bool)
    used_channels[prepared.channels[moving]] = True
    residual_sd = np.full(k, np.nan)
    residual_sd[prepared.channels] = np.sqrt(linear.noise_variance)
    return Identification(
        series=series,
        onset=onset,
        modes=tuple(modes),
        failed=tuple(failed),
        fitted=placed[0],
        baseline=placed[1],
        used=placed[2] & used_channels,
        residual_sd=residual_sd,
        channels_used=used_channels,
        notes=_notes(series, prepared, data, model, moving, share),
    )


def _energy(model: ModalFit) -> FloatArray:
    """Square root of each mode's energy over the record, channels by their noise: what makes a mode dominant."""
    decay = np.maximum(-model.fit.poles.real, 1e-12)
    duration = -np.expm1(-2.0 * decay * model.data.span_s) / (2.0 * decay)
    power = np.sum(np.abs(model.fit.linear.amplitudes) ** 2 / model.fit.linear.noise_variance, axis=1)
    return np.asarray(np.sqrt(power * duration))


def _dominant_that_succeeded(
    choice: TargetChoice, sampled: list[SampledMode | FailedMode], strength: FloatArray
) -> TargetChoice:
    """Where nobody said which mode is wanted, a hum or a drift that turned out to be no mode is not it."""
    good = np.array([isinstance(outcome, SampledMode) for outcome in sampled])
    if choice.wanted or choice.index is None or good[choice.index] or not np.any(good):
        return choice
    return replace(choice, index=int(np.argmax(np.where(good, strength, -1.0))))


def _number_the_target(numbering: Numbering, choice: TargetChoice, settings: IdentifySettings) -> Numbering:
    """Without theory the user's word gives the wanted mode its number; a number by theory stands."""
    if settings.mode is None or choice.index is None or settings.expected_frequencies_hz:
        return numbering
    numbers = list(numbering.numbers)
    numbers[choice.index] = settings.mode
    return replace(numbering, numbers=tuple(numbers))


@dataclass(frozen=True)
class _Told:
    """What is said about a mode beside its numbers."""

    flags: tuple[ModeFlag, ...]
    notes: tuple[str, ...]
    number: int | None
    mac: float
    target: bool


def _mode(
    posterior: Posterior,
    dependence: AmplitudeDependence | None,
    shape: ComplexArray,
    shape_sd: FloatArray,
    unit: str,
    told: _Told,
) -> IdentifiedMode:
    return IdentifiedMode(
        shape=shape,
        shape_sd=shape_sd,
        amplitude=float(np.nanmax(np.abs(shape))),
        amplitude_unit=unit,
        posterior=posterior,
        amplitude_dependence=dependence,
        number=told.number,
        target=told.target,
        mac=told.mac,
        flags=tuple(flag.name for flag in told.flags),
        notes=(*(flag.description for flag in told.flags), *told.notes),
    )


def _motion(data: FitData, poles: ComplexArray, linear: LinearSolution) -> FloatArray:
    return np.asarray(np.real(mode_functions(data.time_s, poles) @ linear.amplitudes) + linear.baseline)


def _place(
    series: DisplacementSeries,
    prepared: Prepared,
    data: FitData,
    everything: FitData,
    model: ModalFit,
    linear: LinearSolution,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Fitted motion, baseline and used samples at the series' own rows and channels."""
    shape = series.values.shape
    fitted, slow, used = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    rows = np.arange(shape[0] - data.time_s.size, shape[0])
    cells = np.ix_(rows, prepared.channels)
    fitted[cells], slow[cells] = _motion(data, model.fit.poles, linear), linear.baseline
    used[cells] = everything.weights > 0.0
    return fitted, slow, used


def _notes(
    series: DisplacementSeries,
    prepared: Prepared,
    data: FitData,
    model: ModalFit,
    moving: NDArray[np.bool_],
    beyond: float,
) -> tuple[str, ...]:
    notes = [*series.notes, *prepared.notes]
    still = [series.channels[i] for i in prepared.channels[~moving]]
    if still:
        notes.append(
            f"The fit does not rest on {', '.join(still)}: no motion above the noise after the onset."
        )
    rejected = int(np.count_nonzero((data.weights[:, moving] > 0.0) & (model.data.weights == 0.0)))
    if rejected:
        total = int(np.count_nonzero(data.weights[:, moving] > 0.0))
        notes.append(
            f"{rejected} of {total} samples were rejected as outliers of the fitted model (over 5 sd)."
        )
    if beyond > 0.03 and rejected < 0.5 * beyond * np.count_nonzero(data.weights[:, moving] > 0.0):
        notes.append(
            f"Up to {100.0 * beyond:.1f} % of a channel's samples lie over 5 sd from the fitted model, in stretches "
            "rather than strewn like outliers: they were kept, and the noise level holds them. Look at the residual."
        )
    missing = int(np.count_nonzero(data.weights[:, moving] == 0.0))
    if missing:
        notes.append(f"{missing} samples after the onset are missing; they were left out, not filled in.")
    return tuple(notes)
