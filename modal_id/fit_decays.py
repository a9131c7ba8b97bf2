"""Fits of all decays of a record, and of its driven stretches where nothing decays.

A piece that free decays do not explain is divided where the motion changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from modal_id.curve import amplitude_curve, explains
from modal_id.data import MIN_SAMPLES, FitData, Prepared, Projection
from modal_id.fit import (
    ModalFit,
    Omissions,
    find_modes,
    misfit,
    refit,
    with_named,
    with_rounding_errors,
    with_scale_errors,
    with_spread,
    without_repeating_errors,
)
from modal_id.modes import FittedDecay, moving_channels
from modal_id.posterior import noise_level
from modal_id.record import Onset, Segment, SegmentKind
from modal_id.segments import (
    Boundary,
    RecordParts,
    changed_onset,
    from_largest_deflection,
    holds_a_decay,
    likeliest_change,
    locate_boundary,
    no_line,
    record_start,
)
from modal_id.sentences import Note, Reason, Refusal
from modal_id.solve import frequency_hz
from tracker import BoolArray, DisplacementSeries


@dataclass(frozen=True)
class Tuning:
    """Pieces that free decays explain, and division into pieces."""

    #: [1] share of the power that a free decay may leave
    #: measurement: A few parts in ten thousand with a camera's errors, per cent with a hand, a pluck or driving.
    most_left: float = 0.003
    #: [1] residual power of an amplitude curve over the noise up to which it explains that
    explained: float = 3.0
    #: [cycles] shortest piece of a divided decay
    #: measurement: With three, a public recording of dry friction is cut and has two false modes (decision 0063).
    least_cycles: float = 6.0
    #: [samples] samples per cycle of the fastest mode in the search for the time of a change
    samples_per_cycle: float = 8.0
    #: [cycles] length from which a piece is long
    many_cycles: float = 12.0
    #: [1] largest number of divisions of a record
    most_splits: int = 6
    #: [1] share of the motion's power that a fit may leave where free decays explain no piece
    #: convention: It stands with wide intervals.
    most_rough: float = 0.1


TUNING = Tuning()


@dataclass(frozen=True)
class Piece:
    """A piece of a decay: its segment, and its fit or the reason why there is none (None for a short piece)."""

    segment: Segment
    fit: FittedDecay | None = None
    why: Refusal | None = None


@dataclass(frozen=True)
class PieceFitter:
    """Fits of pieces of one series.

    Attributes
    ----------
    series : DisplacementSeries
    used : Prepared
        Its samples.
    disturbed : bool array, shape (n,)
        Samples to leave out.
    max_modes : int
    lowest_hz : float
        Lower end of the search for modes.
    named_hz : tuple of float
        Frequencies at which a mode is fitted even where the search finds none.
    rough : list of (float, FittedDecay)
        Fits that do not explain their piece, with the share of the motion that they leave.
    """

    series: DisplacementSeries
    used: Prepared
    disturbed: BoolArray
    max_modes: int
    lowest_hz: float
    named_hz: tuple[float, ...] = ()
    rough: list[tuple[float, FittedDecay]] = field(default_factory=list)

    def pieces(self, onset: Onset, end_s: float, splits: int) -> Iterator[Piece]:
        """Pieces of a decay that free decays explain, and reasons for the others.

        At most `splits` times, the first piece that they do not explain is divided.
        """
        waiting: list[tuple[Onset, float, SegmentKind]] = [(onset, end_s, "decay")]
        while waiting:
            onset, end_s, otherwise = waiting.pop()
            one = self.fit(onset, end_s)
            if isinstance(one, Refusal) and isinstance(released := self._released(onset, end_s), FittedDecay):
                held = Segment("disturbed", onset.time_s, released.onset.time_s, Note.HELD_UNTIL_RELEASE())
                yield Piece(held)
                onset, one = released.onset, released
            if isinstance(one, Refusal):
                note = onset.note if otherwise == "decay" else ""
                yield Piece(Segment(otherwise, onset.time_s, end_s, note), None, one)
                continue
            left = misfit(one.model, self._omissions(one.model, one.moving))
            if left.share < TUNING.most_left or _is_one_curve(one.model):
                yield Piece(Segment("decay", one.onset.time_s, one.end_s, one.onset.note), one)
                continue
            self.rough.append((left.share, one))
            change = self._change(one) if splits > 0 else None
            splits -= 1
            if change is None:
                start_s, percent = onset.fit_from_s, 100.0 * left.share
                most_s = start_s + 0.5 * (left.start_s + left.end_s)
                why = Reason.NOT_FREE_DECAYS(start_s=start_s, end_s=end_s, percent=percent, most_s=most_s)
                yield Piece(Segment("disturbed", onset.time_s, end_s, f"{why.reason}."), None, why)
                continue
            before, after = _divided(one, change)
            for begin, end in (after, before):
                if end - begin.fit_from_s > TUNING.least_cycles * _cycle_s(one):
                    waiting.append((begin, end, "disturbed"))
                else:
                    yield Piece(Segment("disturbed", begin.time_s, end, Note.CHANGES_AROUND()))

    def _change(self, one: FittedDecay) -> Boundary | None:
        """Where the motion changes, relative to the fit's data; None where these are too few."""
        cycle_s, fastest_hz = _cycle_s(one), float(np.max(frequency_hz(one.model.fit.poles)))
        # A pluck may have been taken for a click of the motion as a whole.
        rows = one.rows - self.used.first_row
        unused = (self.disturbed | self.used.repeated)[rows]
        data = _without(replace(one.data, weights=self.used.data.weights[rows]), unused)
        thin = data.averaged(max(1, int(1.0 / (TUNING.samples_per_cycle * fastest_hz * data.step_s))))
        change = likeliest_change(thin, (1.0 / cycle_s,))
        if change is None:
            return None
        limits = change.low_s, change.high_s
        found = locate_boundary(thin, 0.0, limits, float(thin.time_s[-1]), cycle_s, self.lowest_hz)
        return found or Boundary(*limits, change.place.sd_s)

    def _released(self, onset: Onset, end_s: float) -> FittedDecay | Refusal | None:
        """Fit from a release within a decay of few cycles that begins with the record."""
        if onset.source != "record start":
            return None
        start_s = float(self.series.time_s[self.used.first_row])
        found = from_largest_deflection(self.used.data.between(onset.time_s - start_s, end_s - start_s))
        if found is None:
            return None
        when = found.time_s + onset.time_s
        return self.fit(replace(found, time_s=when, fit_from_s=when), end_s)

    def fit(self, onset: Onset, end_s: float) -> FittedDecay | Refusal:
        """Fit of one piece, or the reason why there is none."""
        series, used = self.series, self.used
        time_s = series.time_s[used.first_row : used.first_row + used.data.time_s.size]
        inside = slice(
            *np.searchsorted(time_s, (onset.fit_from_s - 1e-12, np.nextafter(end_s + 1e-12, np.inf)))
        )
        found = inside.stop - inside.start
        if found < MIN_SAMPLES:
            return Reason.FEW_AFTER_ONSET(found=max(found, 0), onset_s=onset.time_s, end_s=end_s)
        # A view of the values, and of the weights where none becomes 0: no fit changes them.
        data = used.data.rows(inside)
        left_out = (self.disturbed | used.repeated)[inside]
        data = _without(replace(data, time_s=time_s[inside] - onset.fit_from_s), left_out)
        model = with_named(find_modes(data, self.max_modes, self.lowest_hz), data, self.named_hz)
        if model is None:
            names = [series.channels[i] for i in used.channels]
            if used.projection is not None:
                names = [f"component {q + 1}" for q in range(data.values.shape[1])]
            return no_line(data, names, series.unit, (onset.fit_from_s, end_s))
        model, moving = _without_still_channels(model)
        mixed = self._mixed(moving)
        if series.position_errors is not None:
            own = used.channels[moving] if mixed is None else used.channels
            level = (
                noise_level(model, None, model.strongest).factor if series.position_errors.predicted else 1.0
            )
            model = without_repeating_errors(model, series.position_errors, own, mixed, level=max(level, 1.0))
        elif mixed is None:
            model = with_rounding_errors(model, series, used.channels[moving])
        if series.scale_change is not None:
            model = with_scale_errors(model, series.scale_change, onset.fit_from_s)
        rows = used.first_row + np.arange(inside.start, inside.stop, dtype=np.int32)
        channels = None if mixed is None else mixed.to_channels
        count = int(np.count_nonzero(left_out))
        return FittedDecay(onset, end_s, rows, count, data, model, moving, channels)

    def _mixed(self, moving: BoolArray) -> Projection | None:
        """The channels on the components that move; None where channels are fitted."""
        return None if self.used.projection is None else self.used.projection.of_components(moving)

    def _omissions(self, model: ModalFit, moving: BoolArray) -> Omissions | None:
        """What a codec may have left out of the fitted channels or components."""
        errors, mixed = self.series.position_errors, self._mixed(moving)
        if errors is None or not errors.predicted:
            return None
        channels = self.used.channels[moving] if mixed is None else self.used.channels
        return Omissions(model, errors, channels, mixed)


def _without(data: FitData, rows: BoolArray) -> FitData:
    """The data with these rows at weight 0."""
    return replace(data, weights=np.where(rows[:, None], 0.0, data.weights)) if np.any(rows) else data


def _cycle_s(one: FittedDecay) -> float:
    """Cycle of the strongest mode; of those with many cycles in the piece, where there are any."""
    hz = frequency_hz(one.model.fit.poles)
    many = hz * one.model.data.span_s >= TUNING.many_cycles
    energy = np.where(many, one.model.energy, 0.0) if np.any(many) else one.model.energy
    return 1.0 / float(hz[np.argmax(energy)])


def _divided(one: FittedDecay, change: Boundary) -> list[tuple[Onset, float]]:
    """Onset and end of the pieces before and after a change, given in the time of the fit's data."""
    origin_s = one.onset.fit_from_s
    after = changed_onset(origin_s + change.start_s, change.sd_s)
    return [(one.onset, origin_s + change.end_s), (after, one.end_s)]


def _is_one_curve(model: ModalFit) -> bool:
    """Whether a dependence on amplitude explains what constant poles leave of the strongest mode."""
    curve, most = amplitude_curve(model, model.strongest), TUNING.explained
    return curve is not None and curve.constant_residual_power > most and explains(curve, most)


def _without_still_channels(model: ModalFit) -> tuple[ModalFit, BoolArray]:
    """Exclude channels without motion from the fit of the poles; at least one channel is kept."""
    moving = moving_channels(model.data, model.fit.linear)
    if np.all(moving):
        return model, moving
    return refit(model, model.fit.poles, model.data.channels(moving)), moving


@dataclass(frozen=True)
class DecayFits:
    """Fitted decays and driven stretches of a record, its segments, and why the other decays have no fit."""

    decays: tuple[FittedDecay, ...]
    driven: tuple[FittedDecay, ...]
    segments: tuple[Segment, ...]
    reasons: tuple[Refusal, ...]


def fit_decays(
    series: DisplacementSeries,
    used: Prepared,
    parts: RecordParts,
    max_modes: int,
    lowest_hz: float,
    *,
    whole: bool = False,
    named_hz: tuple[float, ...] = (),
) -> DecayFits:
    """Fit every decay of a divided record; with `whole`, none is divided further.

    `named_hz` are frequencies at which a mode is fitted even where the search finds none.
    """
    fitter = PieceFitter(series, used, parts.disturbed, max_modes, lowest_hz, named_hz)
    splits = 0 if whole else TUNING.most_splits
    pieces: list[Piece] = []
    for decay in parts.decays:
        pieces += fitter.pieces(decay.onset, decay.end_s, splits)
    segments = [s for s in parts.segments if s.kind != "decay"] + [one.segment for one in pieces]
    decays = [one.fit for one in pieces if one.fit is not None]
    driven: list[FittedDecay] = []
    if not decays:
        decays, driven, segments = _driven_stretches(fitter, parts, segments)
    if not decays and not driven:
        decays, segments = _rough_decay(fitter.rough, segments)
    reasons = tuple(one.why for one in pieces if one.why is not None)
    return DecayFits(tuple(decays), tuple(driven), tuple(segments), reasons)


def _driven_stretches(
    fitter: PieceFitter, parts: RecordParts, segments: list[Segment]
) -> tuple[list[FittedDecay], list[FittedDecay], list[Segment]]:
    """Fits of the driven stretches: a decay beside a line that hardly decays, the driven ones, and the segments."""
    driven: list[FittedDecay] = []
    for stretch in (s for s in parts.segments if s.kind == "driven"):
        onset = replace(parts.none, time_s=stretch.start_s, fit_from_s=stretch.start_s)
        one = fitter.fit(onset, stretch.end_s)
        if isinstance(one, Refusal):
            continue
        if holds_a_decay(one.model):
            onset = record_start(stretch.start_s)
            decay = replace(stretch, kind="decay", note=onset.note)
            segments = [decay if s == stretch else s for s in segments]
            return [replace(one, onset=onset)], driven, segments
        driven.append(one)
    return [], driven, segments


def _rough_decay(
    rough: list[tuple[float, FittedDecay]], segments: list[Segment]
) -> tuple[list[FittedDecay], list[Segment]]:
    """The fit that leaves least, with wide intervals, unless it leaves too much; and the segments with it."""
    share, one = min(rough, key=lambda pair: pair[0], default=(1.0, None))
    if one is None or share > TUNING.most_rough:
        return [], segments
    segments = [s for s in segments if s.end_s <= one.onset.time_s or s.start_s >= one.end_s]
    segments.append(Segment("decay", one.onset.time_s, one.end_s, Note.ROUGH(percent=100.0 * share)))
    return [replace(one, model=with_spread(one.model))], segments
