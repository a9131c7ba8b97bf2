"""Several decays in one record: in order of what they tell, their modes and the values of these combined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data import OUTLIER_SD, FitData
from modal_id.fit import ModalFit
from modal_id.mode_values import damped_hz
from modal_id.modes.combine import combine
from modal_id.posterior import determine_mode, noise_level
from modal_id.record import Onset
from modal_id.results import DecayValue, FailedMode, Identification, IdentifiedMode
from modal_id.segments import BETWEEN_SD
from modal_id.sentences import ModeFlag, Note
from modal_id.solve import damping_ratio, frequency_hz
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Modes of several decays."""

    #: [1] relative distance of the frequencies of oscillations within which two decays show the same motion
    #: convention: A hand shifts the frequency, too, by less.
    same_motion: float = 0.05
    #: [1] relative distance of frequencies of two decays within which modes are the same
    same: float = 0.02
    #: [sd] rate over zero below which a motion may not decay
    #: statistics: 2.3 % of driven motions exceed it.
    decays_sd: float = 2.0


TUNING = Tuning()
DECAYS_SD, SAME_MOTION = TUNING.decays_sd, TUNING.same_motion
# Flags of a mode that one decay alone does not establish.
_DOUBTS = {ModeFlag.SHORT_RECORD.name, ModeFlag.DAMPING_TOUCHES_ZERO.name, ModeFlag.NOT_CONFIRMED.name}


@dataclass(frozen=True)
class FittedDecay:
    """Fit of one decay, or of a driven stretch, before its modes are sampled.

    Attributes
    ----------
    onset : Onset
        In the time of the series.
    end_s : float
        Last time of the decay.
    rows : array of int
        Rows of the series that the fit covers.
    left_out : int
        How many of them were left out as repeated or disturbed.
    data : FitData
        Their samples, of all usable channels; times from ``onset.fit_from_s``.
    model : ModalFit
        Fit of the channels that move.
    moving : bool array
        Mask of these among the usable channels.
    to_channels : array, shape (k, moving), or None
        Values of the channels for unit values of those that move, where these are components.
    """

    onset: Onset
    end_s: float
    rows: NDArray[np.intp]
    left_out: int
    data: FitData
    model: ModalFit
    moving: BoolArray
    to_channels: FloatArray | None = None

    @property
    def amplitudes(self) -> ComplexArray:
        """Amplitude of each mode in each channel that the fit stands for, shape (m, k)."""
        own = self.model.fit.linear.amplitudes
        return own if self.to_channels is None else own @ self.to_channels.T


def grows(one: FittedDecay) -> bool:
    """Whether the strongest motion grows by at least two standard deviations of its rate."""
    fit = one.model.fit
    strongest = int(np.argmax(np.max(np.abs(fit.linear.amplitudes), axis=1)))
    growth, sd = float(fit.poles[strongest].real), float(fit.pole_sd[strongest, 0])
    return growth > 0.0 and growth >= DECAYS_SD * sd * noise_level(one.model, None, strongest).factor


def by_information(fitted: Sequence[FittedDecay]) -> list[int]:
    """Indices of the decays, first the one that determines the damping ratio of its strongest mode best.

    Those whose strongest motion may not decay are last.
    """
    return sorted(range(len(fitted)), key=lambda index: _uncertainty(fitted[index].model))


def _uncertainty(model: ModalFit) -> tuple[bool, float]:
    """Whether the strongest motion may not decay, and the standard deviation of its damping ratio."""
    pole, sd = complex(model.fit.poles[model.strongest]), float(model.fit.pole_sd[model.strongest, 0])
    return bool(-pole.real <= DECAYS_SD * sd), sd / abs(pole)


def combine_decays(found: Identification, fitted: Sequence[FittedDecay], main: int) -> Identification:
    """Identification of the decay with index `main`, its modes combined with their values in the other free decays.

    The combination is a random-effects mean, so that the scatter between decays (a clamp that settles, amplitudes that
    differ) is part of the standard deviations. Shapes, amplitudes, flags and the dependence on amplitude remain those
    of the main decay; `DECAYS_DIFFER` is added where damping ratios scatter by more than those of one structure.
    """
    if len(fitted) < 2:
        return found
    modes, used = [], 0
    for mode in found.modes:
        each = (_value_of(mode, one) if k == main else _same_mode(mode, one) for k, one in enumerate(fitted))
        values = [one for one in each if one is not None]
        used = max(used, len(values))
        modes.append(mode if len(values) < 2 else _combined(mode, values))
    words = Note.ONE_DECAY if used < 2 else Note.COMBINED
    start_s, end_s = found.onset.fit_from_s, fitted[main].end_s
    note = Note.SEVERAL_DECAYS(count=len(fitted), used=words(count=used), start_s=start_s, end_s=end_s)
    return replace(found, modes=tuple(modes), notes=(*found.notes, note))


def shows_more(one: FittedDecay, found: Identification) -> bool:
    """Whether the fit of a decay has a motion that is none of the modes found."""
    return any(_is_new(pole.imag / (2.0 * np.pi), 0.0, found) for pole in one.model.fit.poles)


def with_modes(found: Identification, modes: Iterable[IdentifiedMode], one: FittedDecay) -> Identification:
    """The identification with those of another decay's modes that it lacks and against which no flag speaks.

    A motion at the frequency of one of them that failed is no failure then.
    """
    taken = {mode.number for mode in found.modes}
    note = Note.OTHER_DECAY(start_s=one.onset.fit_from_s, end_s=one.end_s)
    new = tuple(
        replace(
            mode,
            number=None if mode.number in taken else mode.number,
            target=False,
            other_from_s=one.onset.fit_from_s,
            notes=(*mode.notes, note),
        )
        for mode in modes
        if _is_new(damped_hz(mode.frequency_hz, mode.damping_ratio), mode.frequency_sd_hz, found)
        and not mode.wrong_flags
        and _DOUBTS.isdisjoint(mode.flags)
    )
    failed = (
        f for f in found.failed if all(abs(f.frequency_hz / m.frequency_hz - 1.0) > TUNING.same for m in new)
    )
    every = sorted((*found.modes, *new), key=lambda mode: mode.frequency_hz)
    return replace(found, modes=tuple(every), failed=tuple(failed)) if new else found


def _is_new(hz: float, sd_hz: float, found: Identification) -> bool:
    """Whether an oscillation is that of no mode found, held by a hand or not."""
    for mode in found.modes:
        own_hz = damped_hz(mode.frequency_hz, mode.damping_ratio)
        if abs(own_hz - hz) < max(SAME_MOTION * own_hz, OUTLIER_SD * (mode.frequency_sd_hz + sd_hz)):
            return False
    return True


def _value_of(mode: IdentifiedMode, one: FittedDecay) -> DecayValue:
    return DecayValue(
        one.onset.fit_from_s,
        mode.frequency_hz,
        mode.frequency_sd_hz,
        mode.damping_ratio,
        mode.damping_ratio_sd,
        mode.amplitude,
    )


def _same_mode(mode: IdentifiedMode, one: FittedDecay) -> DecayValue | None:
    """Values of the mode in another decay; None where that decay does not show or determine it."""
    fit = one.model.fit
    distance = np.abs(frequency_hz(fit.poles) / mode.frequency_hz - 1.0)
    index = int(np.argmin(distance))
    if distance[index] > TUNING.same:
        return None
    found = determine_mode(one.model, index)
    if isinstance(found, FailedMode):
        return None
    sd = np.sqrt(np.diag(found.covariance)) * found.density.noise.factor
    return DecayValue(
        one.onset.fit_from_s,
        found.frequency_hz,
        float(np.hypot(sd[0] / (2.0 * np.pi), found.systematic[0])),
        float(damping_ratio(complex(fit.poles[index]))),
        float(np.hypot(sd[1], found.systematic[1])),
        float(np.max(np.abs(one.amplitudes[index]))),
    )


def _combined(mode: IdentifiedMode, values: Sequence[DecayValue]) -> IdentifiedMode:
    frequency = combine([v.frequency_hz for v in values], [v.frequency_sd_hz for v in values])
    zeta = combine([v.damping_ratio for v in values], [v.damping_ratio_sd for v in values])
    # What changes with the amplitude changes in every decay: more of them do not average it out.
    least_hz, least = mode.posterior.systematic
    between = frequency.between_sd, zeta.between_sd
    posterior = mode.posterior.including(
        errors={**mode.posterior.errors, **({"decays": between} if max(between) > 0.0 else {})},
        mean=((frequency.value, max(frequency.sd, least_hz)), (zeta.value, max(zeta.sd, least))),
    )
    ordered = tuple(sorted(values, key=lambda v: v.start_s))
    differ = zeta.between_sd > BETWEEN_SD * zeta.value
    return replace(mode, posterior=posterior, decays=ordered).with_flags([ModeFlag.DECAYS_DIFFER] * differ)
