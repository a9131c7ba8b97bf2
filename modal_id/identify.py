"""Identification of one displacement series: its modes and their posterior."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from modal_id.ambient import identify_ambient
from modal_id.assemble import assemble, assemble_driven, converted, in_all_rows
from modal_id.data import (
    MIN_SAMPLES,
    Prepared,
    of_rows,
    prepare,
    project,
    rough_variance,
    sampled_rows,
    with_base,
)
from modal_id.fit import ModalFit, fit_amplitude_dependence, own_decay
from modal_id.flags import ModeFlag
from modal_id.modes import (
    FittedDecay,
    combine_decays,
    grows,
    most_informative,
    without_held,
)
from modal_id.pieces import DecayFits, fit_decays
from modal_id.posterior import with_rate_error
from modal_id.record import Segment
from modal_id.response import identify_response
from modal_id.results import FittedMode, Identification, IdentifiedMode
from modal_id.segments import (
    PRIOR,
    PRIOR_AFTER_JUMP,
    PRIOR_BESIDE_A_DECAY,
    Decay,
    RecordParts,
    divide,
    drive_probability,
    is_rather_driven,
    may_be_driven,
    no_onset,
    record_start,
    user_onset,
    whole_record,
)
from modal_id.sentences import Note, Reason, Refusal
from modal_id.settings import IdentifySettings
from modal_id.solve import damping_ratio, frequency_hz
from tracker import DisplacementSeries, Failure


def identify(
    series: DisplacementSeries, settings: IdentifySettings | None = None
) -> Identification | Failure:
    """Identify the modes of one series.

    Parameters
    ----------
    series : DisplacementSeries
        May have uneven time steps, gaps (NaN) and outliers; nothing is resampled or interpolated.
    settings : IdentifySettings or None
        Default settings when None.

    Returns
    -------
    Identification or Failure
        The latter, falsy and with a reason, when no mode can be distinguished from noise and drift.

    Raises
    ------
    ValueError
        If the number of rows of `settings.expected_shapes` differs from the number of channels of the series.

    Notes
    -----
    Eq. 1 and Eq. 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation", with poles shared by
    all channels. A constant damping ratio is biased where damping depends on the amplitude: `assemble` always tests
    this, and where it is significant the mode is flagged and its interval widened. The error of the frame rate
    (`DisplacementSeries.rate_sd_ppm`) is in the draws of all frequencies as one common factor.
    """
    settings = IdentifySettings() if settings is None else settings
    if series.known_input is not None and not settings.output_only:
        if settings.excitation == "ambient":
            return Reason.TWO_EXCITATIONS().at(series.name)
        return identify_response(series, settings)
    if series.known_input is None and settings.input_lag_ms is not None:
        return Reason.NO_INPUT().at(series.name)
    sampled = sampled_rows(series)
    if sampled is not None:
        # the other samples repeat these
        rows, distance = sampled
        return in_all_rows(identify(of_rows(series, rows), settings), series, rows, distance)
    samples = _samples(series, settings)
    if isinstance(samples, Failure):
        return samples
    used, usable_from_s = samples
    if settings.excitation == "ambient":
        return identify_ambient(series, used, settings)
    whole = settings.onset_s is not None and settings.end_s is not None
    parts = _parts(series, used, settings, usable_from_s, settings.lowest_hz)
    found = _identified(series, used, parts, settings, settings.lowest_hz, whole=whole)
    if not found and settings.lowest_hz > 0.0:
        # The lowest frequency is from theory; that of another beam may exclude the motion.
        parts = _parts(series, used, settings, usable_from_s, 0.0)
        found = _identified(series, used, parts, settings, 0.0, whole=whole) or found
    return found


def identify_free_decay(
    series: DisplacementSeries, settings: IdentifySettings | None = None
) -> Identification | Failure:
    """Identify a series known to be one free decay from its first sample to its last.

    As `identify`, without the search for parts, which takes most of its time; a motion that is driven is named.
    """
    settings = IdentifySettings() if settings is None else settings
    samples = _samples(series, settings)
    if isinstance(samples, Failure):
        return samples
    used, _ = samples
    return _identified(series, used, _one_decay(series, used), settings, settings.lowest_hz, whole=True)


def fit_free_decay(series: DisplacementSeries, max_modes: int) -> tuple[FittedMode, ...] | Failure:
    """Fit a decay without noise, such as a simulation, from its first sample to its last.

    The errors of a simulation are no noise: its modes have no posterior, which takes most of the time otherwise.
    """
    samples = _samples(series, IdentifySettings())
    if isinstance(samples, Failure):
        return samples
    used, _ = samples
    fits = fit_decays(series, used, _one_decay(series, used), max_modes, 0.0, whole=True)
    if not fits.decays:
        return (Refusal.joined(fits.reasons) if fits.reasons else Reason.STEADY()).at(series.name)
    one = fits.decays[0]
    return tuple(
        FittedMode(
            float(frequency_hz(pole)),
            float(damping_ratio(pole)),
            float(np.max(np.abs(one.amplitudes[index]))),
            _frequency_shift(one.model, index),
        )
        for index, pole in enumerate(one.model.fit.poles)
    )


def _frequency_shift(model: ModalFit, index: int) -> float:
    own = own_decay(model, index)
    dependence = fit_amplitude_dependence(own.problem, own.fit, 0)
    if dependence is None:
        return float("nan")
    p = dependence.parameters
    return float(p[3] / np.hypot(p[0], p[1]))


def _one_decay(series: DisplacementSeries, used: Prepared) -> RecordParts:
    """The record as one free decay, in the time of the series."""
    last_s = float(used.data.time_s[-1])
    disturbed = np.zeros(used.data.time_s.size, dtype=bool)
    onset = record_start(0.0)
    parts = RecordParts((Decay(onset, last_s),), (Segment("decay", 0.0, last_s),), disturbed, onset)
    return parts.shifted(float(series.time_s[used.first_row]))


def _samples(series: DisplacementSeries, settings: IdentifySettings) -> tuple[Prepared, float] | Failure:
    """Samples to identify from, reduced to components where there are many channels, or why there are none.

    With the time from which the series is usable.
    """
    shapes = settings.expected_shapes
    if shapes is not None and shapes.shape[0] != len(series.channels):
        msg = f"expected_shapes must have one row for each of the {len(series.channels)} channels, found {shapes.shape}"
        raise ValueError(msg)
    prepared = prepare(series)
    if isinstance(prepared, Refusal):
        return prepared.at(series.name)
    used = _of_interval(series, prepared, settings)
    if isinstance(used, Refusal):
        return used.at(series.name)
    return project(used, settings.components), float(series.time_s[prepared.first_row])


def _identified(
    series: DisplacementSeries,
    used: Prepared,
    parts: RecordParts,
    settings: IdentifySettings,
    lowest_hz: float,
    *,
    whole: bool,
) -> Identification | Failure:
    """Modes of the decays of a divided record, motion that is driven, or why there is neither."""
    named_hz = settings.add_hz
    fits = fit_decays(series, used, parts, settings.max_modes, lowest_hz, whole=whole, named_hz=named_hz)
    if (
        not whole
        and (undivided := _of_uneven_frames(series, used, parts, fits, settings, lowest_hz)) is not None
    ):
        fits = undivided
    segments = whole_record(series.time_s, used.first_row, used.repeated, fits.segments)
    if fits.decays:
        return with_rate_error(_of_decays(series, settings, used, fits.decays, segments))
    if fits.driven:
        found = assemble_driven(series, settings, used, fits.driven[0])
        return with_rate_error(replace(found, segments=segments))
    why = Refusal.joined(fits.reasons or (Reason.SHORT_PIECES() if parts.decays else parts.why,))
    shown = Note.RECORD_SHOWS(segments="; ".join(map(str, segments))) if segments else ""
    return replace(why, reason=f"{why.reason}. {shown}", where=series.name)


def _of_uneven_frames(
    series: DisplacementSeries,
    used: Prepared,
    parts: RecordParts,
    fits: DecayFits,
    settings: IdentifySettings,
    lowest_hz: float,
) -> DecayFits | None:
    """One decay in place of several where a frame-rate converter, and no change of the motion, parts them; or None."""
    if not parts.decays:
        return None
    first, last_s = parts.decays[0].onset, float(series.time_s[used.first_row + used.repeated.size - 1])
    after = [s for s in fits.segments if s.kind in ("decay", "disturbed") and s.start_s >= first.time_s]
    if len(after) < 2:
        return None
    before = tuple(s for s in parts.segments if s.start_s < first.time_s)
    as_one = replace(parts, decays=(Decay(first, last_s),), segments=before)
    undivided = fit_decays(
        series, used, as_one, settings.max_modes, lowest_hz, whole=True, named_hz=settings.add_hz
    )
    # A fit with a reason leaves motion that no free decay explains: frames were not the cause of the division.
    if not undivided.decays or undivided.reasons or not converted(series, used, undivided.decays[0]):
        return None
    return undivided


def _of_decays(
    series: DisplacementSeries,
    settings: IdentifySettings,
    used: Prepared,
    decays: tuple[FittedDecay, ...],
    segments: tuple[Segment, ...],
) -> Identification:
    """Modes of the most informative decay, averaged with the same ones of others.

    Where the target is rather driven, the strongest free mode is the target instead; without one, all is driven.
    """
    kept = without_held(decays)
    segments = _as_disturbed(segments, [d for d in decays if all(d is not one for one in kept)], Note.HELD())
    decays = kept
    position = most_informative(decays)
    main = decays[position]
    if all(grows(one) for one in decays):
        return _driven(series, settings, used, main, segments)
    found = combine_decays(assemble(series, settings, used, main), decays, position)
    probabilities = [_drive_probability(mode, main) for mode in found.modes]
    driven = max((p for p, mode in zip(probabilities, found.modes, strict=True) if mode.target), default=0.0)
    segments = _with_probability(segments, main, driven)
    if is_rather_driven(driven):
        free = [m for m in found.modes if not is_rather_driven(_drive_probability(m, main, beside=False))]
        if _target_hz(settings) is not None or not free:
            return _driven(series, settings, used, main, segments)
        # The target was the strongest motion, a drift or a hum.
        found = _with_target(found, max(free, key=lambda mode: mode.amplitude), settings)
        driven = 0.0 if found.target is None else _drive_probability(found.target, main)
        segments = _with_probability(segments, main, driven)
    # A drift or a hum beside the decay stays in the list, with a flag.
    modes = (
        _doubted(mode) if may_be_driven(max(driven, p)) else mode
        for p, mode in zip(probabilities, found.modes, strict=True)
    )
    return replace(found, modes=tuple(modes), segments=segments)


def _with_probability(segments: tuple[Segment, ...], main: FittedDecay, driven: float) -> tuple[Segment, ...]:
    """The segments, with the probability that the target in the main decay is driven."""
    start_s = main.onset.time_s
    return tuple(
        replace(s, driven_probability=driven) if s.kind == "decay" and s.start_s == start_s else s
        for s in segments
    )


def _with_target(found: Identification, target: IdentifiedMode, settings: IdentifySettings) -> Identification:
    """The result with another target. Without theory it takes the number that the user gave; others have none."""
    modes = (replace(mode, target=mode is target) for mode in found.modes)
    if not settings.expected_frequencies_hz:
        modes = (replace(mode, number=settings.mode if mode.target else None) for mode in modes)
    return replace(found, modes=tuple(modes))


def _drive_probability(mode: IdentifiedMode, one: FittedDecay, *, beside: bool = True) -> float:
    """Probability that a mode of a decay is a drive: 0 after the user's onset, and of a further mode of theory.

    With `beside`, another mode than the target has the prior of a motion beside one that decays.
    """
    if one.onset.source == "user" or (mode.number is not None and not mode.target):
        return 0.0
    after = PRIOR_AFTER_JUMP if one.onset.source == "peak" else PRIOR
    prior = PRIOR_BESIDE_A_DECAY if beside and not mode.target else after
    phase = 2.0 * np.pi * mode.frequency_hz * one.data.span_s
    # what the logarithm of the amplitude loses, and its sd
    lost, sd = mode.damping_ratio * phase, mode.damping_ratio_sd * phase
    return drive_probability(lost, sd, phase, prior)


def _as_disturbed(
    segments: tuple[Segment, ...], decays: Iterable[FittedDecay], note: str
) -> tuple[Segment, ...]:
    """The segments, with those of the given decays as disturbed."""
    starts = {one.onset.time_s for one in decays}
    return tuple(
        replace(s, kind="disturbed", note=note) if s.kind == "decay" and s.start_s in starts else s
        for s in segments
    )


def _doubted(mode: IdentifiedMode) -> IdentifiedMode:
    """A mode of a motion that is not known to be free, flagged where little of its amplitude is lost."""
    if ModeFlag.FEW_CYCLES_LOST.name not in mode.flags:
        return mode
    flag = ModeFlag.MAY_BE_DRIVEN
    return replace(
        mode,
        flags=(flag.name, *mode.flags),
        notes=(flag.value, *mode.notes),
        severities=((flag.name, flag.usual_severity.name), *mode.severities),
    )


def _driven(
    series: DisplacementSeries,
    settings: IdentifySettings,
    used: Prepared,
    one: FittedDecay,
    segments: tuple[Segment, ...],
) -> Identification:
    """Result of a record whose target is driven, or whose motions all grow: its decays are called driven."""
    onset = replace(no_onset(Reason.STEADY.words), fit_from_s=one.onset.fit_from_s)
    found = assemble_driven(series, settings, used, replace(one, onset=onset))
    steady = tuple(
        replace(s, kind="driven", note=Reason.STEADY.words) if s.kind in ("decay", "driven") else s
        for s in segments
    )
    return replace(found, segments=steady)


def _target_hz(settings: IdentifySettings) -> float | None:
    expected, number = settings.expected_frequencies_hz, settings.mode
    if number is not None and number <= len(expected):
        return expected[number - 1]
    return settings.target_frequency_hz


def _of_interval(
    series: DisplacementSeries, prepared: Prepared, settings: IdentifySettings
) -> Prepared | Refusal:
    """Samples from `onset_s` to `end_s`, as far as these are given; the reason for a refusal where they are too few."""
    time_s = series.time_s[prepared.first_row : prepared.first_row + prepared.repeated.size]
    first = 0 if settings.onset_s is None else int(np.searchsorted(time_s, settings.onset_s - 1e-12))
    last = time_s.size if settings.end_s is None else int(np.searchsorted(time_s, settings.end_s + 1e-12))
    if last - first < MIN_SAMPLES:
        given = " and ".join(name for name in ("onset_s", "end_s") if getattr(settings, name) is not None)
        found, (start_s, end_s) = max(last - first, 0), series.time_s[[0, -1]]
        return Reason.FEW_INSIDE(found=found, given=given, least=MIN_SAMPLES, start_s=start_s, end_s=end_s)
    data = prepared.data.rows(slice(first, last))
    data = replace(data, time_s=data.time_s - data.time_s[0])
    repeated = prepared.repeated[first:last]
    return replace(prepared, data=data, first_row=prepared.first_row + first, repeated=repeated)


def _parts(
    series: DisplacementSeries,
    used: Prepared,
    settings: IdentifySettings,
    usable_from_s: float,
    lowest_hz: float,
) -> RecordParts:
    """Parts of the record in the time of the series, which is usable from `usable_from_s` on (after any clipping)."""
    data, base = with_base(used.data, series, used.first_row)
    parts = divide(
        data,
        rough_variance(data),
        lowest_hz,
        _target_hz(settings),
        base,
        begins_free=None if settings.onset_s is None else user_onset(0.0),
        end_is_given=settings.end_s is not None,
    )
    parts = parts.shifted(float(series.time_s[used.first_row]))
    if settings.onset_s is None or not parts.decays:
        return parts
    onset = user_onset(max(settings.onset_s, float(series.time_s[0])))
    onset = replace(onset, fit_from_s=max(settings.onset_s, usable_from_s))
    return replace(parts, decays=(replace(parts.decays[0], onset=onset), *parts.decays[1:]))
