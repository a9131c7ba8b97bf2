"""Division of a record into rest, driving, free decays and disturbances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modal_id.data import FitData, detrended, rough_variance, without_spikes
from modal_id.record import Onset, Segment, SegmentKind
from modal_id.segments.change_point import ChangeSearch, DrivenThenFree
from modal_id.segments.drive_odds import (
    PRIOR,
    PRIOR_AFTER_JUMP,
    decays,
    is_driven_part,
    is_rather_driven,
    probability_of_drive,
)
from modal_id.segments.events import Event, find_events
from modal_id.segments.find_onset import (
    continued_onset,
    drive_then_decay,
    no_onset,
    record_start,
    release_onset,
    settling_s,
    stop_of_shaking,
)
from modal_id.segments.lines import Tones, find_tones, line_blocks, without_swing
from modal_id.segments.partition import Change, likeliest_change
from modal_id.sentences import Note, Reason, Refusal
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Events, rest and driving."""

    #: [sd] deviation that samples at rest do not exceed
    #: statistics: Noise exceeds it once in 5e8 samples.
    within: float = 6.0
    #: [sd] least amplitude of a motion after rest
    #: physics: Half a cycle of such a motion exceeds the limit of rest.
    moves: float = 15.0
    #: [samples] shortest rest
    least_samples: int = 10
    #: [cycles] length of the motion examined after the rest
    motion_cycles: float = 2.0
    #: [samples] samples per cycle of the search for events
    #: convention: The search needs few.
    samples_per_cycle: float = 12.0
    #: [1] amplitude over the record's largest below which it is at rest
    rest_share: float = 0.03
    #: [1] amplitude of a block over its noise below which it is at rest
    #: statistics: Noise exceeds it in one block in 2e5.
    rest_level: float = 3.5
    #: [cycles] shortest segment
    least_cycles: float = 3.0
    #: [samples] the same in samples
    least_rows: int = 12
    #: [cycles] least decay after a drive, unless a pluck ends it
    #: physics: A change in the last few cycles is a jolt or a frozen frame.
    least_free_cycles: float = 5.0


TUNING = Tuning()


def rest_until(data: FitData, variance: FloatArray, tones_hz: tuple[float, ...]) -> float | None:
    """Time of the last sample at rest, where the record is at rest until a motion of these lines begins.

    `variance`, shape (k,), is the noise variance of each channel. None where the record moves within the first half
    cycle of the slowest line, or where no motion as fast as the first line follows.
    """
    first = max(TUNING.least_samples, int(np.ceil(0.5 / (min(tones_hz) * data.step_s))))
    used = data.weights > 0.0
    if data.time_s.size <= 2 * first or not np.all(np.any(used[:first], axis=0)):
        return None
    begins = np.nanmedian(np.where(used, data.values, np.nan)[:first], axis=0)
    # later, the level of the half cycle before: slow drift is rest
    seen = _sums_before(used.astype(float), first)
    seen[seen < 0.5 * first] = np.nan
    level = np.concatenate([np.tile(begins, (first, 1)), _sums_before(used * data.values, first) / seen])
    size = np.nan_to_num(np.abs(data.values - level) * np.sqrt(data.weights / variance))
    moving = np.any(size > TUNING.within, axis=1)
    begin = int(np.argmax(moving))
    follows = size[begin : begin + int(TUNING.motion_cycles / (tones_hz[0] * data.step_s)) + 1]
    if not moving[begin] or begin < first or np.max(follows) < TUNING.moves:
        return None
    return float(data.time_s[begin - 1])


def _sums_before(values: FloatArray, count: int) -> FloatArray:
    """Sums of as many rows before each row from `count` on."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray(total[count:-1] - total[: -count - 1])


@dataclass(frozen=True)
class Decay:
    """A free decay; times relative to the data. ``end_s`` is the last time that belongs to it."""

    onset: Onset
    end_s: float


@dataclass(frozen=True)
class RecordParts:
    """What a record consists of; times relative to the data.

    Attributes
    ----------
    decays : tuple of Decay
        In order of time.
    segments : tuple of Segment
        The whole record in order of time.
    disturbed : bool array, shape (n,)
        Samples within a decay to leave out: a click after which the motion goes on.
    none, why : Onset, Refusal
        Where there is no decay: what the record shows instead.
    """

    decays: tuple[Decay, ...]
    segments: tuple[Segment, ...]
    disturbed: BoolArray
    none: Onset
    why: Refusal = Reason.NO_DECAY()  # noqa: RUF009 - frozen

    def shifted(self, by_s: float) -> RecordParts:
        """The same with all times later by `by_s`."""
        decays = tuple(Decay(_shifted(d.onset, by_s), d.end_s + by_s) for d in self.decays)
        segments = (replace(s, start_s=s.start_s + by_s, end_s=s.end_s + by_s) for s in self.segments)
        return replace(self, decays=decays, segments=tuple(segments))


def divide(
    data: FitData,
    variance: FloatArray,
    lowest_hz: float,
    wanted_hz: float | None,
    base: BoolArray | None = None,
    *,
    begins_free: Onset | None = None,
    end_is_given: bool = False,
) -> RecordParts:
    """Find the free decays of a record, and classify the rest of it.

    Parameters
    ----------
    data : FitData
        From the first sample that may be used, times from there.
    variance : array, shape (k,)
        Noise variance of each channel.
    lowest_hz : float
        Lower end of the search; 0 where unknown.
    wanted_hz : float or None
        Frequency of the target mode, where known.
    base : bool array, shape (k,), or None
        Channels of the moving base, to which the others are relative.
    begins_free : Onset or None
        Onset given by the user: one decay begins with the data, and ends at the first event or with the data.
    end_is_given : bool
        That decay ends with the data, whatever happens in between.
    """
    base = np.zeros(data.values.shape[1], dtype=bool) if base is None else base
    data = without_spikes(data)
    beam = data.channels(~base)
    undisturbed = np.zeros(data.time_s.size, dtype=bool)
    last = float(data.time_s[-1])
    tones = find_tones(beam, variance[~base], lowest_hz, wanted_hz)
    if tones is None:
        # A motion that decays within a cycle or two is no line of the spectrum: the fit decides whether there is one.
        onset = begins_free or record_start(0.0)
        return RecordParts((Decay(onset, last),), (Segment("decay", 0.0, last),), undisturbed, onset)
    rest_s = rest_until(beam, variance[~base], tones.strongest_hz)
    beam = without_swing(beam, variance[~base], tones.dominant_hz, detrended(beam))
    # Events are looked for in the strongest lines: they interrupt them, too.
    per_cycle = TUNING.samples_per_cycle * data.step_s
    fine = beam.averaged(max(1, int(1.0 / (per_cycle * max(tones.strongest_hz)))))
    events, others = find_events(fine, tones.strongest_hz, lowest_hz, rest_s)
    if tones.soon_over:
        # its first cycles, too few for a motion of their own, are no event
        events = [e for e in events if e.start_s > 0.0]
    division = _Division(data, beam, fine, variance, base, tones, lowest_hz, events, others, rest_s)
    if begins_free is None:
        return division.parts()
    return division.from_user(begins_free, end_is_given=end_is_given)


@dataclass(frozen=True)
class _Part:
    """Between two events; `before` is the event that it follows."""

    start_s: float
    end_s: float
    before: Event | None


class _Division:
    """Classifies the parts between events, in order of time."""

    def __init__(
        self,
        data: FitData,
        beam: FitData,
        fine: FitData,
        variance: FloatArray,
        base: BoolArray,
        tones: Tones,
        lowest_hz: float,
        events: list[Event],
        others: list[Change],
        rest_until_s: float | None,
    ) -> None:
        """`fine` are the channels but for the base, averaged; `others` changes that are no events."""
        self.data, self.beam, self.fine, self.variance, self.base = data, beam, fine, variance, base
        self.tones, self.frequency_hz, self.lowest_hz = tones, tones.dominant_hz, lowest_hz
        least_s = 1.0 / (TUNING.samples_per_cycle * self.frequency_hz)
        self.thin = fine.averaged(max(1, int(least_s / fine.step_s)))
        blocks = line_blocks(fine, tones.strongest_hz)
        self.block_s, self.level = blocks.centres_s, blocks.level
        self.others = others
        self.rest_until_s = rest_until_s
        self.segments: list[Segment] = []
        self.decays: list[Decay] = []
        self.disturbed = np.zeros(data.time_s.size, dtype=bool)
        for burst in (e for e in events if e.kind == "burst"):
            self.disturbed |= data.inside(burst.start_s, burst.end_s)
            self._add("disturbed", burst.start_s, burst.end_s, Note.CLICK())
        kept = [e for e in events if e.kind != "burst"]
        starts = [0.0, *(e.end_s for e in kept)]
        ends = [*(e.start_s for e in kept), float(data.time_s[-1])]
        parts = zip(starts, ends, [None, *kept], strict=True)
        self.between_events = [_Part(*one) for one in parts if one[1] > one[0]]

    def from_user(self, onset: Onset, *, end_is_given: bool) -> RecordParts:
        """One decay from the beginning of the data to the first event, or to their end."""
        last = float(self.data.time_s[-1])
        end = self.between_events[0].end_s if self.between_events and not end_is_given else last
        self.decays.append(Decay(onset, end))
        self._add("decay", 0.0, end)
        if end < last:
            self._add("disturbed", end, last, Note.EVENT_ENDS_DECAY())
        return self._result()

    def parts(self) -> RecordParts:
        """All decays."""
        skip = False
        for part, following in pairwise([*self.between_events, None]):
            if skip or part is None:
                skip = False
                continue
            skip = self._classify(part, following)
        return self._result()

    def _classify(self, part: _Part, following: _Part | None) -> bool:
        """Add the segments of a part; whether the following one belongs to its decay."""
        event = part.before
        if self._at_rest(part):
            if event is not None:
                self._add("disturbed", event.start_s, event.end_s, Note.STOPPED())
            self._add("at rest", part.start_s, part.end_s)
            return False
        # Markers may be lost before the part ends: only samples that are present can be steady.
        seen = self.thin.time_s[np.any(self.thin.weights > 0.0, axis=1) & (self.thin.time_s <= part.end_s)]
        last_s = float(np.max(seen, initial=part.start_s))
        cycles = (last_s - part.start_s) * self.frequency_hz
        tail = self.thin.between(0.5 * (part.start_s + last_s), last_s)
        prior = _prior(part)
        long = cycles > 2.0 * TUNING.least_cycles and tail.time_s.size >= TUNING.least_rows
        moves = following is not None and not self._at_rest(following)
        follows = following if moves and following is not None and not _rises(following) else None
        probability = self._probability(tail, prior, follows) if long else 0.0
        # Where a record begins with too few cycles for a motion, a drive may be part of the first event.
        first = event if event is not None and event.start_s <= self.thin.time_s[0] else None
        begin_s = part.start_s if first is None else first.start_s
        late = is_rather_driven(probability) or not long or follows is not None
        near = self._places(part, following if late else None)
        if first is not None:
            near.append((part.end_s, replace(first.place, reach_s=first.end_s - first.start_s)))
        steady_until_s = part.end_s
        for end_s, place in near:
            change = self._change(begin_s, end_s, place)
            if change is None:
                continue
            # A pluck cuts a decay short; before anything else, a change so late is part of it.
            plucked = following is not None and _rises(following) and end_s <= part.end_s
            latest_s = end_s - (0.0 if plucked else TUNING.least_free_cycles / self.frequency_hz)
            changes_s = begin_s + change.time_s
            drives = self._drive_precedes(begin_s, end_s, prior, change)
            if not is_rather_driven(drives):
                continue
            if changes_s <= latest_s:
                onset = self._onset(begin_s, end_s, change)
                self._add("driven", begin_s, onset.time_s, onset.note, min(drives, onset.confidence))
                self._decay(onset, end_s)
                return end_s > part.end_s
            if long and changes_s > tail.time_s[0]:
                steady_until_s = min(steady_until_s, changes_s)
        if steady_until_s < part.end_s:
            # what follows a change tells nothing of the motion before it
            tail = self.thin.between(0.5 * (part.start_s + steady_until_s), steady_until_s)
            probability = self._probability(tail, prior, None)
        if is_driven_part(probability):
            note = Note.STEADY_AT(hz=self.frequency_hz)
            self._add("driven", part.start_s, steady_until_s, note, probability)
        else:
            # What is not known to be driven may tell its damping ratio, with a wide interval.
            self._decay(self._start(part), steady_until_s)
        if steady_until_s < part.end_s:
            self._add("disturbed", steady_until_s, part.end_s, Note.CHANGES_AROUND())
        return False

    def _start(self, part: _Part) -> Onset:
        if part.before is None:
            return record_start(part.start_s)
        if part.before.kind == "rise":
            return release_onset(
                self.beam, self.variance[~self.base], self.frequency_hz, part.before, part.end_s
            )
        return continued_onset(part.before)

    def _places(self, part: _Part, following: _Part | None) -> list[tuple[float, ChangeSearch]]:
        """Where a drive may end, with the end of the decay after it: the next part may belong to it."""
        own = [(part.end_s, one) for one in self._others(part.start_s, part.end_s)]
        event = None if following is None else following.before
        if following is None or event is None or self._at_rest(following):
            return own
        # A base that stops abruptly is an event, too. Where the motion goes on, it may have been found too late.
        late = self._others(part.start_s, following.end_s) if not event.jumps else []
        return [(following.end_s, event.place), *own, *((following.end_s, one) for one in late)]

    def _others(self, start_s: float, end_s: float) -> list[ChangeSearch]:
        """Changes that are no events between two times; without any, the likeliest one."""
        found = [one for one in self.others if start_s < one.low_s and one.high_s < end_s]
        if not found:
            one = likeliest_change(self.fine.between(start_s, end_s), self.tones.strongest_hz)
            found = [] if one is None else [one.later(start_s)]
        return [one.place for one in found]

    def _change(self, start_s: float, end_s: float, place: ChangeSearch) -> DrivenThenFree | None:
        """Where a drive may end between two times, where a change is known or looked for; relative to the first."""
        place = replace(place, time_s=place.time_s - start_s)
        samples = self.data.between(start_s, end_s)
        return drive_then_decay(samples, self.variance, self.tones.wanted_hz, self.base, place)

    def _onset(self, start_s: float, end_s: float, change: DrivenThenFree) -> Onset:
        """Onset where a drive ends between two times, at a known change."""
        samples, hz = self.data.between(start_s, end_s), self.tones.wanted_hz
        return _shifted(stop_of_shaking(samples, change, hz, self.lowest_hz, self.base), start_s)

    def _probability(self, late: FitData, prior: float, follows: _Part | None) -> float:
        """Probability that samples are driven, from what follows them as well; 0 for too few."""
        if late.time_s.size < TUNING.least_rows:
            return 0.0
        after = None if follows is None else self.thin.between(follows.start_s, follows.end_s)
        after = after if after is not None and after.time_s.size >= TUNING.least_rows else None
        return probability_of_drive(late, self.frequency_hz, self.lowest_hz, prior, after)

    def _drive_precedes(self, start_s: float, end_s: float, prior: float, change: DrivenThenFree) -> float:
        """Probability of a drive in the latter half, when the transient of its start is over, or in a few cycles.

        0 for a decay; 1 where there are too few samples to tell.
        """
        step_s, changes_s = self.data.step_s, start_s + change.time_s
        few = change.time_s * self.frequency_hz < 2.0 * TUNING.least_cycles
        late = self.thin.between(start_s if few else 0.5 * (start_s + changes_s), changes_s)
        if late.time_s.size < TUNING.least_rows:
            return 1.0
        if not few and decays(self.thin.between(start_s, changes_s), self.frequency_hz, self.lowest_hz):
            return 0.0
        settled_s = changes_s + settling_s(self.tones.wanted_hz, step_s, change.sd_s, end_s - changes_s)
        return self._probability(late, prior, _Part(settled_s, end_s, None))

    def _at_rest(self, part: _Part) -> bool:
        if self.rest_until_s is not None and part.end_s <= self.rest_until_s:
            return True
        known = np.isfinite(self.level)
        # After a pluck, and where it goes on at its amplitude, the motion moves, for however few cycles.
        if not np.any(known) or (part.before is not None and part.before.kind != "fall"):
            return False
        half_s = float(self.block_s[0])
        within = known & (self.block_s >= part.start_s + half_s) & (self.block_s <= part.end_s - half_s)
        limit = max(TUNING.rest_level, TUNING.rest_share * float(np.max(self.level[known])))
        if np.any(within):
            return float(np.max(self.level[within])) < limit
        # Shorter than a block: the mean square of all samples.
        samples = self.thin.between(part.start_s, part.end_s)
        if not samples.time_s.size:
            return True
        square = np.mean(detrended(samples) ** 2, axis=0)
        largest = TUNING.rest_share * np.max(np.abs(detrended(self.thin)), axis=0)
        return bool(np.all(square < np.maximum(2.0 * rough_variance(self.thin), largest**2)))

    def _decay(self, onset: Onset, end_s: float) -> None:
        self.decays.append(Decay(onset, end_s))
        self._add("decay", onset.time_s, end_s, onset.note)

    def _add(
        self, kind: SegmentKind, start_s: float, end_s: float, note: str = "", driven: float = float("nan")
    ) -> None:
        self.segments.append(Segment(kind, start_s, end_s, note, driven))

    def _without_transients(self) -> None:
        """A decay between two steady motions is the transient of a drive that has changed."""
        order = sorted(self.segments, key=lambda s: s.start_s)
        for first, one, last in zip(order, order[1:], order[2:], strict=False):
            if (first.kind, one.kind, last.kind) == ("driven", "decay", "driven"):
                self.decays = [d for d in self.decays if d.end_s != one.end_s]
                changed = replace(one, kind="driven", note=Note.DRIVE_CHANGES())
                self.segments[self.segments.index(one)] = changed

    def _result(self) -> RecordParts:
        self._without_transients()
        driven = [s for s in self.segments if s.kind == "driven"]
        why = Reason.NO_DECAY()
        if driven:
            why = Reason.DRIVEN_THROUGHOUT(
                hz=self.frequency_hz, start_s=driven[0].start_s, end_s=driven[-1].end_s
            )
        none = no_onset(f"{why.reason}.")
        if not driven and not self.decays and all(s.kind == "at rest" for s in self.segments):
            # Motion too weak to be detected in two cycles: the fit of the whole record decides.
            last = float(self.data.time_s[-1])
            return RecordParts(
                (Decay(record_start(0.0), last),), (Segment("decay", 0.0, last),), self.disturbed, none
            )
        segments = tuple(sorted(self.segments, key=lambda s: (s.start_s, s.end_s)))
        return RecordParts(tuple(self.decays), segments, self.disturbed, none, why)


def _rises(part: _Part) -> bool:
    return part.before is not None and part.before.kind == "rise"


def _prior(part: _Part) -> float:
    """Probability of a drive: a motion that does not join the one before is more often plucked than driven."""
    return PRIOR_AFTER_JUMP if part.before is not None and part.before.jumps else PRIOR


def _shifted(onset: Onset, by_s: float) -> Onset:
    return replace(onset, time_s=onset.time_s + by_s, fit_from_s=onset.fit_from_s + by_s)
