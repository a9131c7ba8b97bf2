"""Fits of all decays of a record, and of its driven stretches where nothing decays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modal_id.data import Prepared
from modal_id.fit import ModalFit
from modal_id.modes import FittedDecay
from modal_id.pieces.fit_pieces import Piece, PieceFitter
from modal_id.record import Segment
from modal_id.segments import RecordParts, holds_a_decay, record_start, strongest_is_driven
from modal_id.sentences import Note, Refusal
from modal_id.solve import Problem, fit_poles, frequency_hz, own_problem
from tracker import ComplexArray, DisplacementSeries, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Spread over parts of a decay, division into pieces."""

    #: [1] number of parts
    parts: int = 3
    #: [cycles] shortest part
    least_cycles: float = 2.0
    #: [samples] the same
    least_rows: int = 12
    #: [1] largest number of divisions of a record
    most_splits: int = 6
    #: [1] share of the motion's power that a fit may leave where free decays explain no piece
    #: convention: It stands with wide intervals.
    most_rough: float = 0.1


TUNING = Tuning()


def with_spread(model: ModalFit) -> ModalFit:
    """The fit with the largest differences between its poles and those of thirds of the decay as further errors.

    The parts hold equal energy of each mode. A mode whose parts cannot be fitted may have any decay rate up to twice
    the fitted one, and a frequency as uncertain.
    """
    spread = np.concatenate([_largest_difference(model, index) for index in range(model.fit.poles.size)])
    known = np.zeros((spread.size, spread.size)) if model.repeating is None else model.repeating
    return replace(model, repeating=known + np.diag(spread**2))


def mean_scatter_rad_s(model: ModalFit, index: int) -> float:
    """Standard deviation of a line's angular frequency from its scatter between thirds of the record; 0 if unknown."""
    apart = np.imag(_differences(model, index))
    return float(np.sqrt(np.mean(apart**2) / apart.size)) if apart.size else 0.0


def _largest_difference(model: ModalFit, index: int) -> FloatArray:
    """Of (Re, Im) of the pole with this index."""
    found = _differences(model, index)
    if found.size < 2:
        return np.full(2, abs(complex(model.fit.poles[index]).real))
    return np.array([np.max(np.abs(found.real)), np.max(np.abs(found.imag))])


def _differences(model: ModalFit, index: int) -> ComplexArray:
    """Poles of the parts less that of the fit, as far as the parts can be fitted."""
    pole = complex(model.fit.poles[index])
    data = own_problem(model.problem, model.fit, np.array([index])).data
    energy = np.cumsum(
        np.exp(2.0 * np.minimum(pole.real, 0.0) * data.time_s) * np.any(data.weights > 0.0, axis=1)
    )
    edges = np.searchsorted(energy, np.linspace(0.0, energy[-1], TUNING.parts + 1))
    edges[-1] = data.time_s.size
    least = max(TUNING.least_rows, int(TUNING.least_cycles / (float(frequency_hz(pole)) * data.step_s)))
    found = []
    for first, last in pairwise(edges):
        if last - first < least:
            continue
        part = data.rows(slice(int(first), int(last)))
        part = part.from_time(float(part.time_s[0]))
        fit = fit_poles(Problem(part, np.ones((part.time_s.size, 1))), np.array([pole]))
        if fit.converged:
            found.append(complex(fit.poles[0]) - pole)
    return np.array(found, dtype=complex)


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
    reasons = tuple(one.why for one in pieces if one.why is not None)
    return DecayFits(tuple(decays), tuple(driven), tuple(segments), reasons)


def _with_drives(pieces: tuple[Piece, ...]) -> list[Piece]:
    """The pieces of a divided decay in order of time; a steady one before a change is driven.

    That from the user's onset is free, as the user says.
    """
    found = list(pieces)
    for k, (one, follows) in enumerate(pairwise(pieces)):
        model = None if follows.fit is None else follows.fit.model
        if one.fit is None or one.fit.onset.source == "user":
            continue
        if strongest_is_driven(one.fit.model, model):
            driven = replace(one.segment, kind="driven", note=Note.STEADY_UNTIL_CHANGE())
            found[k] = replace(one, segment=driven)
    return found


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
