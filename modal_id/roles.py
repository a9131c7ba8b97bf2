"""Which decays of a record show the structure, and whether what they show is driven."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from modal_id.assemble import assemble, assemble_driven
from modal_id.data import Prepared
from modal_id.modes import (
    DECAYS_SD,
    SAME_MOTION,
    FittedDecay,
    by_information,
    combine_decays,
    grows,
    shows_more,
    with_modes,
)
from modal_id.posterior import noise_level
from modal_id.record import Onset, Segment, SegmentKind
from modal_id.results import DecayValue, Identification, IdentifiedMode
from modal_id.segments import (
    HAND,
    HELD_LEAST,
    LOUDER,
    PRIOR,
    PRIOR_AFTER_JUMP,
    PRIOR_BESIDE_A_DECAY,
    Roles,
    is_rather_driven,
    may_be_driven,
    no_onset,
    roles_of,
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

    Where the target is rather driven, the strongest mode that is free beyond doubt takes its place; without one, all
    is driven.
    """
    roles = _roles(decays)
    of_onset = {one.onset.time_s: role for one, role in zip(decays, roles, strict=True)}
    segments = tuple(_in_role(s, decays, roles) for s in segments)
    kept = tuple(one for one, role in zip(decays, roles, strict=True) if role.kind == "decay") or decays
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
        free = [m for m in found.modes if not may_be_driven(_drive_probability(m, main, beside=False))]
        if settings.target_hz is not None or not free:
            return _driven(series, settings, used, main, segments)
        # The target was the strongest motion, a drift or a hum.
        target = max(free, key=lambda mode: mode.amplitude)
        found = _with_target(found, target, settings)
        driven = _drive_probability(replace(target, target=True), main)
        segments = _with_probability(segments, main, driven)
    # A drift or a hum beside the decay stays in the list, with a flag.
    flagged = (
        _doubted(mode) if may_be_driven(max(driven, p)) else mode
        for p, mode in zip(probabilities, found.modes, strict=True)
    )
    role = of_onset[main.onset.time_s]
    doubt = role.doubt if may_be_driven(driven) else 0.0
    known = (_with_error(mode, "driven", doubt) if mode.target else mode for mode in flagged)
    modes = tuple(maybe_held(known, segments, main.onset, role.held))
    found = replace(found, modes=modes, segments=segments)
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
    """Probability that a mode of a decay is a drive: 0 for a further mode of theory.

    With `beside`, another mode than the target has the prior of a motion beside one that decays.
    """
    if mode.number is not None and not mode.target:
        return 0.0
    return _roles_of(mode, one, PRIOR_BESIDE_A_DECAY if beside and not mode.target else None).driven


def _roles_of(
    value: IdentifiedMode | DecayValue,
    one: FittedDecay,
    prior: float | None = None,
    after: tuple[float, float] | None = None,
) -> Roles:
    """What a motion with these values in a decay is, and what follows it; no drive after the user's onset."""
    if one.onset.source == "user":
        prior = 0.0
    if prior is None:
        prior = PRIOR_AFTER_JUMP if one.onset.source == "peak" else PRIOR
    phase = 2.0 * np.pi * value.frequency_hz * one.data.span_s
    # what the logarithm of the amplitude loses, and its sd
    lost, sd = value.damping_ratio * phase, value.damping_ratio_sd * phase
    return roles_of(lost, sd, phase, prior, after)


def maybe_held(
    modes: Iterable[IdentifiedMode], segments: Iterable[Segment], onset: Onset, held: float | None = None
) -> Iterator[IdentifiedMode]:
    """Modes of a decay, flagged where a hand may hold it: if what is called driven before it is free, or by `held`.

    Their damping ratio is then that of the hand, and far above that of the structure. No hand holds what is plucked,
    nor a decay of which a mode is known to be free. `held` is the probability by an earlier decay; without one, and
    without a drive, a motion that goes on may be held.
    """
    modes = tuple(modes)
    doubts = [] if held is None else [held]
    driven = [s for s in segments if s.kind == "driven" and s.end_s <= onset.fit_from_s]
    if driven:
        last = max(driven, key=lambda s: s.end_s)
        doubts.append(float(np.nan_to_num(1.0 - last.driven_probability, nan=1.0 - PRIOR)))
    if not doubts and onset.source == "interruption":
        doubts.append(HAND)
    least = (m.damping_ratio + DECAYS_SD * m.damping_ratio_sd for m in modes if not m.wrong_flags)
    free = min(least, default=np.inf) < HELD_LEAST
    doubt = 0.0 if free or onset.source == "peak" else max(doubts, default=0.0)
    for mode in modes:
        if mode.damping_ratio > HELD_LEAST and may_be_driven(doubt):
            wider = _with_error(mode, "held", float(np.sqrt(doubt)) * mode.damping_ratio)
            yield wider.with_flags([ModeFlag.MAY_BE_HELD])
        else:
            yield mode


def _with_error(mode: IdentifiedMode, cause: str, sd: float) -> IdentifiedMode:
    """The mode with a further error of the damping ratio, if there is one."""
    if sd == 0.0:
        return mode
    errors = {**mode.posterior.errors, cause: (0.0, sd)}
    return replace(mode, posterior=mode.posterior.including(errors=errors))


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


@dataclass(frozen=True)
class _Role:
    """What a decay is beside the others of the same motion, with the probability that it is a drive where it is one.

    ``doubt`` is the error of its damping ratio for the probability that it is a drive nonetheless, ``held`` the
    probability that a hand holds it, by the earlier decays; None without one.
    """

    kind: SegmentKind = "decay"
    driven: float = float("nan")
    doubt: float = 0.0
    held: float | None = None


def _roles(fitted: Sequence[FittedDecay]) -> list[_Role]:
    """The role of each decay: free, driven, or held by a hand."""
    found = [_Role()] * len(fitted)
    for k, one in enumerate(fitted):
        if found[k].kind != "decay":
            continue
        values = {j: both for j, other in enumerate(fitted) if j != k and (both := _shared_mode(one, other))}
        pairs = {j: _pair(own, one, later) for j, (own, later) in values.items()}
        likeliest = [pair.likeliest for pair in pairs.values()]
        # one that decays as another does is neither
        if "driven" in likeliest and "free" not in likeliest:
            pair = max(pairs.values(), key=lambda pair: pair.driven)
            found[k] = _Role("driven", pair.driven / (pair.driven + pair.held))
            continue
        for j, pair in pairs.items():
            own, later = values[j]
            if later.start_s >= own.start_s:
                found[j] = replace(found[j], held=max(found[j].held or 0.0, pair.held))
            if pair.likeliest == "held":
                found[j] = _Role("disturbed")
                error = float(np.sqrt(pair.driven)) * abs(later.damping_ratio - own.damping_ratio)
                found[k] = replace(found[k], doubt=max(found[k].doubt, error))
    return found


def _pair(one: DecayValue, decay: FittedDecay, other: DecayValue) -> Roles:
    """What a decay and another of the same motion are: free where the other is earlier, larger or grows.

    Damping that depends on the amplitude is as likely a cause where it is larger.
    """
    after = other.start_s >= one.start_s and other.amplitude < LOUDER * one.amplitude
    if not (after and other.damping_ratio > 0.0):
        return Roles(1.0, 0.0, 0.0)
    return _roles_of(one, decay, after=(other.damping_ratio, other.damping_ratio_sd))


def _shared_mode(one: FittedDecay, other: FittedDecay) -> tuple[DecayValue, DecayValue] | None:
    """Values in both decays of the mode with most energy in the first, or else in the other; None without one."""
    hz, other_hz = (decay.model.fit.poles.imag / (2.0 * np.pi) for decay in (one, other))
    same = np.abs(hz[:, None] / other_hz - 1.0)
    index = one.model.strongest
    nearest = int(np.argmin(same[index]))
    if same[index, nearest] >= SAME_MOTION:
        nearest = other.model.strongest
        index = int(np.argmin(same[:, nearest]))
    return (_value(one, index), _value(other, nearest)) if same[index, nearest] < SAME_MOTION else None


def _in_role(segment: Segment, decays: Sequence[FittedDecay], roles: Sequence[_Role]) -> Segment:
    """A decay's segment as what the decay is."""
    for one, role in zip(decays, roles, strict=True):
        if segment.kind == "decay" and segment.start_s == one.onset.time_s and role.kind != "decay":
            note = Note.HELD() if role.kind == "disturbed" else Reason.STEADY.words
            return replace(segment, kind=role.kind, note=note, driven_probability=role.driven)
    return segment


def _value(one: FittedDecay, index: int) -> DecayValue:
    """Values of a mode of a decay, without the part of their sd that only sampling shows."""
    fit = one.model.fit
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
