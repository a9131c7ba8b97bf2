"""Places where an event may be: neighbouring windows of the envelope do not join, or a gap changes the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modal_id.segments.envelope import HOPS, Envelope


@dataclass(frozen=True)
class Tuning:
    """Candidates of events."""

    #: [sd] jump of state or offset between windows that is a candidate
    #: convention: Above noise in all windows; confirmed later.
    jump_sd: float = 8.0
    #: [1] the same over the amplitude
    jump_share: float = 0.15
    #: [1] largest number of candidates that are tried
    #: convention: Limits the computing time.
    most_candidates: int = 24
    #: [half windows] longest candidate
    #: convention: An event without duration disturbs four.
    longest: float = 8.0


TUNING = Tuning()

# Mean square residual within an event relative to that beside it, where the motion goes on as before.
BURST = 9.0


@dataclass(frozen=True)
class EventCandidate:
    """Where an event may be: its most likely time, its reach, and a jump that is over 1 where it is notable."""

    time_s: float
    start_s: float
    end_s: float
    strength: float


def event_candidates(envelope: Envelope) -> list[EventCandidate]:
    """Places where neighbouring windows do not join, strongest kept, in order."""
    half = envelope.half_s
    left, right = slice(None, -HOPS), slice(HOPS, None)
    edge_sd = np.sqrt(16.0 / envelope.samples)
    amplitude = envelope.amplitude
    local = np.maximum(amplitude[left], amplitude[right])
    strength, sharpest = np.zeros(local.size), np.zeros(local.size)
    for state, slope in (
        (envelope.state, envelope.state_slope),
        (envelope.offset, envelope.offset_slope),
    ):
        jump = (state[right] - slope[right] * half - state[left] - slope[left] * half) / envelope.noise
        size = np.sqrt(np.sum(np.abs(jump) ** 2, axis=1))
        score = np.minimum(
            size / (TUNING.jump_sd * edge_sd), size / (TUNING.jump_share * np.maximum(local, 1e-300))
        )
        strength = np.maximum(strength, np.nan_to_num(score))
        sharpest = np.maximum(sharpest, np.nan_to_num(size))
    place = 0.5 * (envelope.time_s[left] + envelope.time_s[right])
    flagged = np.flatnonzero(strength > 1.0)
    groups = np.split(flagged, np.flatnonzero(np.diff(place[flagged]) > half) + 1) if flagged.size else []
    excess = np.nan_to_num(envelope.excess)
    found = _gaps(envelope)
    for group in groups:
        peak = place[group[np.argmax(sharpest[group])]]
        near = np.flatnonzero(np.abs(envelope.time_s - peak) < 2.0 * half)
        # The window with the largest residual contains the event, too.
        worst = envelope.time_s[near[np.argmax(excess[near])]]
        # A sharp event disturbs the comparison of all windows within twice their half length.
        first = min(peak - half, worst - half, place[group[0]] + half)
        last = max(peak + half, worst + half, place[group[-1]] - half)
        if last - first > TUNING.longest * half and not _is_disturbed(envelope, first, last):
            # Beats, or slow changes: only the sharpest place is an event.
            first, last = peak - half, peak + half
        found.append(EventCandidate(float(peak), float(first), float(last), float(np.max(strength[group]))))
    strongest = sorted(found, key=lambda c: -c.strength)[: TUNING.most_candidates]
    return _merged(sorted(strongest, key=lambda c: c.time_s), envelope)


def _gaps(envelope: Envelope) -> list[EventCandidate]:
    """Gaps with another amplitude or offset after them than before; the phase is not compared across a gap."""
    known = np.flatnonzero(np.isfinite(envelope.amplitude))
    edge_sd = np.sqrt(16.0 / envelope.samples)
    found = []
    for left, right in pairwise(known):
        if right == left + 1:
            continue
        levels = envelope.amplitude[[left, right]]
        offset = np.sqrt(np.sum(((envelope.offset[right] - envelope.offset[left]) / envelope.noise) ** 2))
        size = max(abs(float(levels[1] - levels[0])), float(offset))
        strength = min(
            size / (TUNING.jump_sd * edge_sd), size / (TUNING.jump_share * max(float(np.max(levels)), 1e-300))
        )
        start_s, end_s = envelope.time_s[left] + envelope.half_s, envelope.time_s[right] - envelope.half_s
        if strength > 1.0 and end_s > start_s:
            found.append(
                EventCandidate(float(0.5 * (start_s + end_s)), float(start_s), float(end_s), float(strength))
            )
    return found


def _is_disturbed(envelope: Envelope, start_s: float, end_s: float) -> bool:
    """Whether the residual is large in most windows between two times: a burst of noise, not beats."""
    rows = (envelope.time_s >= start_s) & (envelope.time_s <= end_s) & np.isfinite(envelope.excess)
    return bool(np.any(rows)) and float(np.median(envelope.excess[rows])) > BURST


def _merged(candidates: list[EventCandidate], envelope: Envelope) -> list[EventCandidate]:
    """Candidates with too little between them to fit a decay become one."""
    least_s = 2.0 * envelope.half_s
    merged = candidates[:1]
    for one in candidates[1:]:
        last = merged[-1]
        if one.start_s - last.end_s > least_s:
            merged.append(one)
            continue
        stronger = last if last.strength > one.strength else one
        start_s, end_s = min(last.start_s, one.start_s), max(last.end_s, one.end_s)
        # Beats look like a row of events: of these, only the strongest is one.
        long = end_s - start_s > 0.5 * TUNING.longest * least_s
        merged[-1] = (
            stronger
            if long and not _is_disturbed(envelope, start_s, end_s)
            else replace(stronger, start_s=start_s, end_s=end_s)
        )
    return merged
