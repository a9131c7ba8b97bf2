"""Identification of one displacement series: its modes and their posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.ambient import identify_ambient
from modal_id.assemble import assemble_driven, converted, in_all_rows
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
from modal_id.fit_decays import DecayFits, fit_decays
from modal_id.posterior import with_rate_error
from modal_id.record import Segment
from modal_id.response import identify_response
from modal_id.results import FittedMode, Identification
from modal_id.roles import maybe_held, modes_of_decays
from modal_id.segments import (
    Decay,
    RecordParts,
    divide,
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
    if fits.decays or fits.driven:
        if fits.decays:
            found = modes_of_decays(series, settings, used, fits.decays, segments)
        else:
            found = replace(assemble_driven(series, settings, used, fits.driven[0]), segments=segments)
        asked = found.driven and settings.onset_s is None
        after = _after_drive(found, settings, lowest_hz) if asked else None
        return after or with_rate_error(found)
    without = Reason.SHORT_PIECES() if parts.decays else parts.why
    why = Refusal.joined(fits.reasons or (without,))
    shown = Note.RECORD_SHOWS(segments="; ".join(map(str, segments))) if len(segments) > 1 else ""
    return replace(why, reason=f"{why.reason}. {shown}", where=series.name)


def _after_drive(
    found: Identification, settings: IdentifySettings, lowest_hz: float
) -> Identification | None:
    """Modes of what follows the last drive, free from its start on; None where the target is missing or wrong."""
    series, before = found.series, found.segments
    begin_s = max((s.end_s for s in before if s.kind == "driven"), default=float(series.time_s[-1]))
    own = settings.model_copy(update={"onset_s": begin_s})
    few = np.count_nonzero(series.time_s > begin_s) < MIN_SAMPLES
    samples = None if few else _samples(series, own)
    if samples is None or isinstance(samples, Failure):
        return None
    used, usable_from_s = samples
    parts = _parts(series, used, own, usable_from_s, lowest_hz)
    first = parts.decays[0]
    onset = replace(first.onset, source="model", sd_s=float("nan"), note=Note.AFTER_DRIVE())
    parts = replace(parts, decays=(replace(first, onset=onset), *parts.decays[1:]))
    after = _identified(series, used, parts, own, lowest_hz, whole=False)
    if not isinstance(after, Identification) or after.target is None or after.target.wrong_flags:
        return None
    modes = maybe_held(after.modes, before, after.onset)
    segments = [s for s in before if s.end_s <= begin_s] + [s for s in after.segments if s.start_s >= begin_s]
    return replace(after, modes=tuple(modes), segments=tuple(segments))


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
        settings.target_hz,
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
