"""Fits of all decays of a record, and of its driven stretches where nothing decays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

from modal_id.data import Prepared
from modal_id.modes import FittedDecay
from modal_id.pieces.fit_pieces import Piece, PieceFitter
from modal_id.pieces.spread import with_spread
from modal_id.record import Segment
from modal_id.segments import RecordParts, holds_a_decay, keeps_amplitude, record_start
from tracker import DisplacementSeries


@dataclass(frozen=True)
class Tuning:
    """Division into pieces."""

    #: [1] largest number of divisions of a record
    most_splits: int = 6
    #: [1] share of the motion's power that a fit may leave where free decays explain no piece
    #: convention: It stands with wide intervals.
    most_rough: float = 0.1


TUNING = Tuning()

_ROUGH = "Free decays leave {:.2g} % of the power: the intervals include the differences between parts of the decay."


@dataclass(frozen=True)
class DecayFits:
    """Fitted decays and driven stretches of a record, its segments, and why the other decays have no fit."""

    decays: tuple[FittedDecay, ...]
    driven: tuple[FittedDecay, ...]
    segments: tuple[Segment, ...]
    reasons: tuple[str, ...]


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
        pieces += _with_drives(tuple(fitter.pieces(decay.onset, decay.end_s, splits)))
    segments = [s for s in parts.segments if s.kind != "decay"] + [one.segment for one in pieces]
    segments += [click for one in pieces if one.fit is not None for click in one.fit.clicks]
    decays = [one.fit for one in pieces if one.fit is not None and one.segment.kind != "driven"]
    driven = [one.fit for one in pieces if one.fit is not None and one.segment.kind == "driven"]
    if not decays:
        decays, others, segments = _driven_stretches(fitter, parts, segments)
        driven += others
    if not decays and not driven:
        decays, segments = _rough_decay(fitter.rough, segments)
    reasons = tuple(dict.fromkeys(one.reason for one in pieces if one.reason))
    return DecayFits(tuple(decays), tuple(driven), tuple(segments), reasons)


def _with_drives(pieces: tuple[Piece, ...]) -> list[Piece]:
    """The pieces of a divided decay in order of time; a steady one before a change is driven."""
    found = list(pieces)
    for k, (one, follows) in enumerate(pairwise(pieces)):
        model = None if follows.fit is None else follows.fit.model
        if one.fit is not None and keeps_amplitude(one.fit.model, model):
            note = "The motion is steady until it changes."
            found[k] = replace(one, segment=replace(one.segment, kind="driven", note=note))
    return found


def _driven_stretches(
    fitter: PieceFitter, parts: RecordParts, segments: list[Segment]
) -> tuple[list[FittedDecay], list[FittedDecay], list[Segment]]:
    """Fits of the driven stretches: a decay beside a line that hardly decays, the driven ones, and the segments."""
    driven: list[FittedDecay] = []
    for stretch in (s for s in parts.segments if s.kind == "driven"):
        onset = replace(parts.none, time_s=stretch.start_s, fit_from_s=stretch.start_s)
        one = fitter.fit(onset, stretch.end_s)
        if isinstance(one, str):
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
    segments.append(Segment("decay", one.onset.time_s, one.end_s, _ROUGH.format(100.0 * share)))
    return [replace(one, model=with_spread(one.model))], segments
