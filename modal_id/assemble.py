"""Result of the identification of one decay: modes with shapes, numbers and flags, the fitted motion in all rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData, Prepared, are_many, listed, outlier_share
from modal_id.fit import (
    ModalFit,
    StabilityDiagram,
    fit_amplitude_dependence,
    mean_scatter_rad_s,
    nyquist_hz,
    stability_diagram,
)
from modal_id.modes import (
    Conversion,
    FittedDecay,
    Numbering,
    TargetChoice,
    amplitude_sd,
    choose_target_of,
    combination_tones,
    conversion,
    missing_target,
    mode_flags,
    moving_channels,
    not_established,
    number_modes,
    rejected_modes,
    repeating_shape_sd,
    severities,
    shape_disagreement,
    within_errors,
)
from modal_id.posterior import LINE_BINS, SampledMode, channel_noise_level, noise_level, sample_modes
from modal_id.results import AmplitudeDependence, DrivenMotion, FailedMode, Identification, IdentifiedMode
from modal_id.sentences import ModeFlag, Note, Reason, alias_note
from modal_id.settings import IdentifySettings
from modal_id.solve import LinearSolution, ModeColumns, Problem, frequency_hz, motion, solve_linear
from tracker import BoolArray, DisplacementSeries, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Bands of a driven line."""

    #: [half-widths] outer edge of the band beside a driven line, in which the noise is measured
    beside: float = 6.0


TUNING = Tuning()


def assemble(
    series: DisplacementSeries,
    settings: IdentifySettings,
    prepared: Prepared,
    fitted: FittedDecay,
    first_stream: int = 0,
) -> Identification:
    """Modes, shapes, flags and fitted motion of one decay; random streams from `first_stream` on."""
    model = fitted.model
    poles = model.fit.poles
    # Sampling needs most memory: it precedes the allocation of the arrays below.
    rejected = rejected_modes(frequency_hz(poles), settings)
    sampled = [
        FailedMode.of(Reason.REJECTED(), float(hz)) if outcome is None else outcome
        for hz, outcome in zip(
            frequency_hz(poles), sample_modes(model, ~rejected, settings, first_stream), strict=True
        )
    ]
    everything = _all_channels(prepared, fitted)
    complete, linear = everything.data, everything.linear
    k = len(series.channels)
    shapes = prepared.in_series(linear.amplitudes, k)
    strength = _strength(model)
    numbering = number_modes(frequency_hz(poles), shapes, strength, settings)
    numbers = tuple(None if out else n for out, n in zip(rejected, numbering.numbers, strict=True))
    numbering = replace(numbering, numbers=numbers)
    rate_hz = 2.0 * nyquist_hz(complete.time_s)
    choice = choose_target_of(rejected, frequency_hz(poles), shapes, strength, numbers, settings, rate_hz)
    tones = combination_tones(sampled, linear.amplitudes, rate_hz)
    good = [isinstance(one, SampledMode) and tone is None for one, tone in zip(sampled, tones, strict=True)]
    choice = _strongest_success(choice, np.array(good), strength)
    numbering = _number_the_target(numbering, choice, settings)
    outliers = outlier_share(everything.given.weights, complete.values - everything.motion)
    diagram = _diagram(everything, model, projected=prepared.projection is not None)
    modes, failed = [], []
    clock = _conversion(series, model, outliers)
    hidden = within_errors(linear.amplitudes, series.position_errors, prepared.channels, series.unit)
    repeating = repeating_shape_sd(complete, linear, series.position_errors, prepared.channels)
    for index, outcome in enumerate(sampled):
        number, is_target = numbering.numbers[index], index == choice.index
        if isinstance(outcome, FailedMode):
            failed.append(replace(outcome, number=number, target=is_target))
            continue
        flags, notes = mode_flags(model, index, outcome, shapes[index], number, settings, diagram, outliers)
        side_band = None if clock is None else clock.side_band(index)
        doubts = side_band, tones[index], hidden[index], not_established(outcome, flags)
        no_mode = next((doubt for doubt in doubts if doubt is not None), None)
        # A mode with a number, or the target, is expected there by theory or the user: it is listed with a flag.
        expected = is_target or (number is not None and side_band is None)
        expected = expected and ModeFlag.ADDED not in flags
        if no_mode is not None and not expected:
            hz = float(frequency_hz(poles)[index])
            failed.append(FailedMode.of(no_mode, hz, number, target=is_target))
            continue
        if tones[index] is not None:
            flags.append(ModeFlag.HARMONIC)
        if clock is not None:
            flags.append(ModeFlag.RATE_CONVERTED)
            notes.append(clock.note(float(frequency_hz(poles)[index])))
        factor = _shape_noise(model, index, outcome, everything, fitted)
        noise_sd = amplitude_sd(complete, linear, index) * factor
        shape_sd = prepared.in_series(np.hypot(noise_sd, repeating[index]), k)
        if words := shape_disagreement(shapes[index], shape_sd, number, settings):
            flags.append(ModeFlag.SHAPE_DISAGREES)
            notes.append(words)
        modes.append(
            IdentifiedMode(
                shape=shapes[index],
                shape_sd=shape_sd,
                amplitude=float(np.nanmax(np.abs(shapes[index]))),
                amplitude_unit=series.unit,
                posterior=outcome.posterior,
                amplitude_dependence=_in_channels(outcome.dependence, fitted, index),
                number=number,
                target=is_target,
                mac=numbering.macs[index],
                flags=tuple(flag.name for flag in flags),
                notes=(*(flag.value for flag in flags), *notes),
                severities=severities(model, index, outcome, flags),
            )
        )
    failed += [FailedMode.of(why, hz) for hz, why in model.refused]
    if choice.index is None:
        failed.append(missing_target(choice, settings))
    found = _of_record(series, prepared, fitted, everything)
    notes_of_fit = _notes_of_fit(series, prepared, fitted, everything, outliers)
    fitting = choice.fitting if choice.fitting is None or choice.fitting.otherwise is None else None
    return replace(
        found,
        modes=tuple(modes),
        failed=tuple(failed),
        notes=(*found.notes, *notes_of_fit),
        fitting_rate=fitting,
    )


def converted(series: DisplacementSeries, prepared: Prepared, fitted: FittedDecay) -> bool:
    """Whether the frames of a decay show that a converter chose them."""
    everything = _all_channels(prepared, fitted)
    outliers = outlier_share(everything.given.weights, everything.data.values - everything.motion)
    return _conversion(series, fitted.model, outliers) is not None


def _conversion(series: DisplacementSeries, model: ModalFit, outliers: float) -> Conversion | None:
    predicted = series.position_errors is not None and series.position_errors.predicted
    return conversion(model, steady_noise=not are_many(outliers), predicted=predicted)


def assemble_driven(
    series: DisplacementSeries, settings: IdentifySettings, prepared: Prepared, fitted: FittedDecay
) -> Identification:
    """Lines of a record that is driven throughout, strongest first: frequencies, no damping."""
    model = fitted.model
    # Root mean square over the record, since a motion that builds up is small at its start.
    growth = np.mean(np.exp(2.0 * np.outer(model.fit.poles.real, model.data.time_s)), axis=1)
    strength = np.max(np.abs(model.fit.linear.amplitudes), axis=1) * np.sqrt(growth)
    lines = tuple(
        DrivenMotion(
            frequency_hz=float(model.fit.poles[i].imag) / (2.0 * np.pi),
            frequency_sd_hz=_driven_sd_hz(model, i),
            amplitude=float(strength[i]),
            amplitude_unit=series.unit,
            flags=(ModeFlag.DRIVEN.name,),
            notes=(ModeFlag.DRIVEN.value,),
        )
        for i in np.argsort(-strength, kind="stable")
    )
    hz = lines[0].frequency_hz
    failed = FailedMode.of(Reason.DRIVEN(hz=hz), hz, settings.mode, target=True)
    found = _of_record(series, prepared, fitted, _all_channels(prepared, fitted))
    return replace(found, driven=lines, failed=(failed,))


def _driven_sd_hz(model: ModalFit, index: int) -> float:
    """Standard deviation of the frequency of a line, larger where it is no sinusoid (it varies, or is spliced).

    At least that from the scatter between thirds of the record, which slow errors of the clock increase, too.
    """
    centre, reach = float(frequency_hz(model.fit.poles)[index]), LINE_BINS / model.data.span_s
    spectrum = model.spectrum
    distance = np.abs(spectrum.frequency_hz - centre)
    own, beside = distance < reach, (distance > reach) & (distance < TUNING.beside * reach)
    left = 1.0
    if np.any(own) and np.any(beside):
        left = float(np.max(spectrum.power[own])) / max(float(np.mean(spectrum.power[beside])), 1e-300)
    # The largest of a dozen bins of noise is three times their mean.
    factor = max(noise_level(model, None, index).factor, 1.0) * float(np.sqrt(max(left / 3.0, 1.0)))
    sd = max(float(model.fit.pole_sd[index, 1]) * factor, mean_scatter_rad_s(model, index))
    return sd / (2.0 * np.pi)


@dataclass(frozen=True)
class _AllChannels:
    """Data and fit of all usable channels, those without motion included.

    Attributes
    ----------
    given : FitData
        Samples before the rejection of outliers.
    data : FitData
        With outliers, of the channels that move, at weight 0.
    linear : LinearSolution
    motion : array, shape (n, k)
        Fitted, baseline included.
    moving : bool array, shape (k,)
        Channels that move.
    """

    given: FitData
    data: FitData
    linear: LinearSolution
    motion: FloatArray
    moving: BoolArray


def _all_channels(prepared: Prepared, fitted: FittedDecay) -> _AllChannels:
    given, model, moving = fitted.data, fitted.model, fitted.moving
    if prepared.projection is not None:
        rows = prepared.projection.data.rows(fitted.rows - prepared.first_row)
        # instants that the fit of the components leaves out
        seen = np.any(given.weights > 0.0, axis=1, keepdims=True)
        given = replace(rows, time_s=given.time_s, weights=rows.weights * seen)
    data = replace(given, weights=given.weights.copy())
    if prepared.projection is None:
        data.weights[:, moving] = model.data.weights
    else:
        data.weights[np.all(model.data.weights == 0.0, axis=1)] = 0.0
    poles = model.fit.poles
    linear = solve_linear(Problem(data, model.problem.baseline), ModeColumns(data.time_s, poles))
    if prepared.projection is not None:
        moving = moving_channels(data, linear)
    fitted_motion = motion(data.time_s, poles, linear.amplitudes)
    fitted_motion += linear.baseline
    return _AllChannels(given, data, linear, fitted_motion, moving)


def _shape_noise(
    model: ModalFit, index: int, outcome: SampledMode, everything: _AllChannels, fitted: FittedDecay
) -> float:
    """Factor on the standard deviations of a mode's amplitudes in the channels."""
    if fitted.to_channels is None:
        return outcome.posterior.noise_factor
    residual = everything.linear.residual
    if outcome.dependence is not None and outcome.dependence.significant:
        # The dependence is not noise.
        bent = fit_amplitude_dependence(model.problem, model.fit, index)
        if bent is not None:
            residual = residual + (bent.linear.residual - model.fit.linear.residual) @ fitted.to_channels.T
    return channel_noise_level(model, index, everything.data, residual).factor


def _of_record(
    series: DisplacementSeries,
    prepared: Prepared,
    fitted: FittedDecay,
    everything: _AllChannels,
) -> Identification:
    """Identification without modes: fitted motion, residual, samples and channels used."""
    complete, linear, motion = everything.data, everything.linear, everything.motion
    k = len(series.channels)
    cells = np.ix_(fitted.rows, prepared.channels)
    channels_used = np.zeros(k, dtype=bool)
    channels_used[prepared.channels[everything.moving]] = True
    return Identification(
        series=series,
        onset=fitted.onset,
        modes=(),
        failed=(),
        fitted=_in_series(series, cells, motion),
        baseline=_in_series(series, cells, linear.baseline),
        used=(_in_series(series, cells, complete.weights) > 0.0) & channels_used,
        residual_sd=prepared.in_series(np.sqrt(linear.noise_variance), k),
        channels_used=channels_used,
        notes=(*series.notes, *prepared.notes),
    )


def _in_series(series: DisplacementSeries, cells: tuple[Any, ...], values: FloatArray) -> FloatArray:
    """The values in the series' own rows and channels, NaN elsewhere."""
    result = np.full(series.values.shape, np.nan)
    result[cells] = values
    return result


def _diagram(everything: _AllChannels, model: ModalFit, *, projected: bool) -> StabilityDiagram | None:
    """Stability diagram of the channels, or of the components that stand for them."""
    highest_hz = float(np.max(frequency_hz(model.fit.poles)))
    if projected:
        return stability_diagram(model.data, model.fit.linear.baseline, highest_hz)
    return stability_diagram(everything.data, everything.linear.baseline, highest_hz)


def _in_channels(
    dependence: AmplitudeDependence | None, fitted: FittedDecay, index: int
) -> AmplitudeDependence | None:
    """The dependence as a function of the largest amplitude of a channel, not of a component."""
    if dependence is None or dependence.curve is None or fitted.to_channels is None:
        return dependence
    own = np.max(np.abs(fitted.model.fit.linear.amplitudes[index]))
    scale = float(np.max(np.abs(fitted.amplitudes[index])) / own)
    return replace(dependence, curve=replace(dependence.curve, amplitude=scale * dependence.curve.amplitude))


def _strength(model: ModalFit) -> FloatArray:
    """Square root of the energy of each mode in the record, channels weighted by their noise; shape (m,)."""
    decay = np.maximum(-model.fit.poles.real, 1e-12)
    duration = -np.expm1(-2.0 * decay * model.data.span_s) / (2.0 * decay)
    power = np.sum(np.abs(model.fit.linear.amplitudes) ** 2 / model.fit.linear.noise_variance, axis=1)
    return np.asarray(np.sqrt(power * duration))


def _strongest_success(choice: TargetChoice, good: BoolArray, strength: FloatArray) -> TargetChoice:
    """Without a requested target, the strongest mode that is no combination tone; it may be a hum or a drift."""
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


def _notes_of_fit(
    series: DisplacementSeries,
    prepared: Prepared,
    fitted: FittedDecay,
    everything: _AllChannels,
    outliers: float,
) -> tuple[str, ...]:
    moving = everything.moving
    left_out = fitted.left_out * int(np.count_nonzero(moving))
    notes = []
    still = [series.channels[i] for i in prepared.channels[~moving]]
    if still:
        notes.append(Note.NOT_USED(names=listed(still)))
    given = everything.given.weights[:, moving] > 0.0
    kept = everything.data.weights[:, moving] > 0.0
    total, rejected = int(np.count_nonzero(given)), int(np.count_nonzero(given & ~kept))
    if rejected:
        notes.append(Note.OUTLIERS(count=rejected, total=total))
    if are_many(outliers) and rejected < 0.5 * outliers * total:
        notes.append(Note.CLUSTERS(percent=100.0 * outliers))
    missing = given.size - total - left_out
    if missing:
        notes.append(Note.MISSING(count=missing))
    return tuple(notes)


def in_all_rows(
    found: Identification | Failure,
    series: DisplacementSeries,
    rows: NDArray[np.intp],
    held: int,
) -> Identification | Failure:
    """What was found from `rows` in terms of the whole series, its modes with the other possible frequencies."""
    rate_hz = 1.0 / float(np.median(np.diff(series.time_s)))
    words = Note.ONE_ROW_IN(held=held, rate_hz=rate_hz / held, row_rate_hz=rate_hz)
    if isinstance(found, Failure):
        return replace(found, reason=f"{found.reason} {words}")
    size = series.values.shape
    fitted, baseline, used = np.full(size, np.nan), np.full(size, np.nan), np.zeros(size, dtype=bool)
    fitted[rows], baseline[rows], used[rows] = found.fitted, found.baseline, found.used
    return replace(
        found,
        series=series,
        fitted=fitted,
        baseline=baseline,
        used=used,
        modes=tuple(_with_aliases(mode, rate_hz / held) for mode in found.modes),
        notes=(*found.notes, words),
    )


def _with_aliases(mode: IdentifiedMode, rate_hz: float) -> IdentifiedMode:
    """The mode with the flag of an alias, and the frequencies that fit as well."""
    flag, note = ModeFlag.ALIASED_POSSIBLE, alias_note(rate_hz, mode.frequency_hz, 3)
    if flag.name in mode.flags:
        return replace(mode, notes=(*mode.notes, note))
    return mode.with_flags([flag], note)
