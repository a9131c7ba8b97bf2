"""Which decays of a record show the structure, and whether what they show is driven."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from modal_id.assemble import assemble, assemble_driven
from modal_id.data import Prepared
from modal_id.modes import (
    SAME_MOTION,
    FittedDecay,
    by_information,
    combine_decays,
    grows,
    shows_more,
    with_modes,
)
from modal_id.posterior import noise_level
from modal_id.record import Segment
from modal_id.results import DecayValue, Identification, IdentifiedMode
from modal_id.segments import (
    PRIOR,
    PRIOR_AFTER_JUMP,
    PRIOR_BESIDE_A_DECAY,
    drive_probability,
    held_odds,
    is_rather_driven,
    may_be_driven,
    no_onset,
)
from modal_id.sentences import ModeFlag, Note, Reason
from modal_id.settings import IdentifySettings
from modal_id.solve import damping_ratio, frequency_hz
from tracker import DisplacementSeries

# Random streams of a decay, more than modes.
_STREAMS = 1000


def modes_of_decays(
    series: DisplacementSeries,
    settings: IdentifySettings,
    used: Prepared,
    decays: tuple[FittedDecay, ...],
    segments: tuple[Segment, ...],
) -> Identification:
    """Modes of the most informative decay, averaged with the same ones of others, and those that only others show.

    Where the target is rather driven, the strongest free mode is the target instead; without one, all is driven.
    """
    kept = _without_held(decays)
    segments = _as_disturbed(segments, [d for d in decays if all(d is not one for one in kept)], Note.HELD())
    decays = tuple(one for one in kept if not grows(one))
    if not decays:
        return _driven(series, settings, used, kept[by_information(kept)[0]], segments)
    order = by_information(decays)
    position, found = _with_target_in(
        (k, combine_decays(assemble(series, settings, used, decays[k]), decays, k)) for k in order
    )
    main = decays[position]
    probabilities = [_drive_probability(mode, main) for mode in found.modes]
    driven = max((p for p, mode in zip(probabilities, found.modes, strict=True) if mode.target), default=0.0)
    segments = _with_probability(segments, main, driven)
    if is_rather_driven(driven):
        free = [m for m in found.modes if not is_rather_driven(_drive_probability(m, main, beside=False))]
        if settings.target_hz is not None or not free:
            return _driven(series, settings, used, main, segments)
        # The target was the strongest motion, a drift or a hum.
        target = max(free, key=lambda mode: mode.amplitude)
        found = _with_target(found, target, settings)
        driven = _drive_probability(replace(target, target=True), main)
        segments = _with_probability(segments, main, driven)
    # A drift or a hum beside the decay stays in the list, with a flag.
    modes = (
        _doubted(mode) if may_be_driven(max(driven, p)) else mode
        for p, mode in zip(probabilities, found.modes, strict=True)
    )
    found = replace(found, modes=tuple(modes), segments=segments)
    for k in order:
        if k != position and shows_more(decays[k], found):
            # draws of their own, and the same error of the frame rate
            other = assemble(series, settings, used, decays[k], _STREAMS * (k + 1))
            other = combine_decays(other, decays, k)
            free = [m for m in other.modes if not may_be_driven(_drive_probability(m, decays[k]))]
            found = with_modes(found, free, decays[k])
    return found


def _with_target_in(results: Iterator[tuple[int, Identification]]) -> tuple[int, Identification]:
    """The first result that has the target; without one, the first."""
    first = next(results)
    return next((one for one in chain((first,), results) if one[1].target is not None), first)


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
    few = ModeFlag.FEW_CYCLES_LOST.name in mode.flags
    return mode.with_flags([ModeFlag.MAY_BE_DRIVEN]) if few else mode


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


def _without_held(fitted: Sequence[FittedDecay]) -> tuple[FittedDecay, ...]:
    """Decays but those that are more probably held by a hand than free, beside an earlier one of the same motion."""
    values = [_strongest_value(one) for one in fitted]
    return tuple(
        decay
        for decay, one in zip(fitted, values, strict=True)
        # the odds are 0 beside itself and later ones
        if not any(
            abs(free.damped_hz - one.damped_hz) < SAME_MOTION * one.damped_hz and held_odds(free, one) > 1.0
            for free in values
        )
    )


def _strongest_value(one: FittedDecay) -> DecayValue:
    """Values of the strongest mode of a decay, without the part of their sd that only sampling shows."""
    fit, index = one.model.fit, one.model.strongest
    pole = complex(fit.poles[index])
    sd = fit.pole_sd[index] * noise_level(one.model, None, index).factor / abs(pole)
    hz = float(frequency_hz(pole))
    return DecayValue(
        one.onset.fit_from_s,
        hz,
        hz * float(sd[1]),
        float(damping_ratio(pole)),
        float(sd[0]),
        float(np.max(np.abs(one.amplitudes[index]))),
    )
