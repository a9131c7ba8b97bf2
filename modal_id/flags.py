"""Quality flags of an identified mode, and checks of the residual: their names and descriptions."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from modal_id.sentences import Note, in_hz
from tracker import Severity


class ModeFlag(Enum):
    """Name of a flag, as in the flags column; its value is the description in report and documentation."""

    DRIVEN = (
        "The motion is steady throughout: its frequency is that of the drive, not a natural frequency, and damping "
        "cannot be measured. Record the free decay after the drive stops."
    )
    MAY_BE_DRIVEN = (
        "The motion may be driven: its amplitude decreases by less than 40 %, and the probability that it is a drive "
        "exceeds 5 %. The damping ratio then means nothing. Record until the motion has decayed, or give onset_s where "
        "it is known to be free."
    )
    MAY_BE_HELD = (
        "The mode follows a drive after which no decay was recognised: a hand that stops the motion looks like strong "
        "damping. The values are those of the structure only if nothing touched it."
    )
    SHORT_RECORD = "The record contains fewer than ten cycles of the mode after the onset."
    ADDED = (
        "The mode was fitted because add_hz names it: its line does not exceed the threshold of the search."
    )
    LOW_SNR = "The amplitude of the mode is less than ten times the noise of a single sample."
    AMPLITUDE_DEPENDENT = (
        "Damping or frequency depends on the amplitude: the constant values are averages over this record, and their "
        "standard deviations include the distances to the values at small amplitude and at the start. Use the values "
        "at small amplitude, or the curve."
    )
    CLOSE_MODE = "Another mode within 10 % of this frequency is also excited."
    CHAIN_TOO_SHORT = (
        "The sampler reached its maximum number of steps before the autocorrelation criterion was met."
    )
    ALIASED_POSSIBLE = (
        "The frequency is close to half the sampling rate, or to the alias of a beam mode above half the sampling "
        "rate: the true frequency may be different. Record at another frame rate to decide."
    )
    FEW_CYCLES_LOST = (
        "The amplitude decreased by less than 40 % during the record: a dependence of damping on amplitude would "
        "hardly be visible. The damping ratio is that at the amplitudes of the record; the interval of its value at "
        "small amplitude allows for what cannot be seen. Record longer."
    )
    UNRESOLVED = (
        "Two modes too close to be resolved in this record explain the motion better than one mode, with constant "
        "or amplitude-dependent damping: the values may belong to neither. Record longer."
    )
    NOT_CONFIRMED = (
        "Covariance-driven stochastic subspace identification, used as an independent check, has no stable pole at "
        "this frequency."
    )
    MANY_OUTLIERS = (
        "In at least one channel, more than 3 % of the samples deviate from the fitted model by more than five "
        "standard deviations."
    )
    HARMONIC = (
        "Frequency and decay rate are those of a harmonic or combination tone of stronger modes: it may be a "
        "distortion of their motion."
    )
    DAMPING_TOUCHES_ZERO = (
        "The damping ratio is less than two sd above zero; the prior admits positive values only."
    )
    SHAPE_DISAGREES = (
        "The shape is not that of the beam's mode with this number: frequency and damping ratio may belong to another "
        "mode, or the positions are wrong. Check clamp_side and positions_mm: both are counted from the clamp."
    )
    RATE_CONVERTED = (
        "The frames are not evenly spaced in time, as in a file whose frame rate was converted by leaving out, "
        "repeating or blending frames: the frequency may be wrong by the ratio of the two rates. Use the file as the "
        "camera wrote it."
    )
    RESIDUAL_AT_MODE = (
        "What the fit leaves at the frequency of the mode has more than four times the power of the noise beside it: "
        "the motion is not of the form that was fitted. The standard deviations were increased accordingly."
    )
    INPUT_LATE = (
        "The measured input explains the motion better when it is shifted in time: input and outputs do not share a "
        "clock, or a sensor delays one of them. Frequency and damping ratio may be wrong."
    )
    INPUT_INCOMPLETE = (
        "What the fit leaves follows the measured input as more modes would, which the record does not determine: "
        "modes are missing, the input holds frequencies above half the sampling rate, something else drives the "
        "structure in step with it, or the motion is not linear. The standard deviations are those if all that is left "
        "near the mode is such a response, and not noise."
    )

    @property
    def usual_severity(self) -> Severity:
        """Severity where the effect of the flag on the result was not computed."""
        return _USUAL.get(self, Severity.INFORMATION)


# Flags of a mode whose own note console and report quote, and how that begins.
QUOTED = {
    ModeFlag.MAY_BE_DRIVEN: ModeFlag.MAY_BE_DRIVEN.value,
    ModeFlag.SHAPE_DISAGREES: Note.SHAPE_DISAGREES.beginning,
    ModeFlag.RATE_CONVERTED: Note.CONVERTED.beginning,
    ModeFlag.INPUT_LATE: Note.INPUT_LATE.beginning,
    ModeFlag.INPUT_INCOMPLETE: Note.INPUT_INCOMPLETE.beginning,
}


def quoted_note(flag: ModeFlag, notes: Iterable[str]) -> str:
    """The note that says what a flag of a mode means for it; empty where there is none."""
    start = QUOTED.get(flag)
    return next((note for note in notes if start is not None and note.startswith(start)), "")


def alias_note(rate_hz: float, hz: float, count: int = 1) -> str:
    """The note that at this sampling rate the next `count` of the frequencies above fit as well as `hz`."""
    others = in_hz((rate_hz - hz, rate_hz + hz, 2.0 * rate_hz - hz)[:count]) + ", …" * (count > 1)
    return Note.ALIAS(rate_hz=rate_hz, others=others, hz=hz)


_USUAL = {
    ModeFlag.DRIVEN: Severity.WRONG,
    ModeFlag.MAY_BE_DRIVEN: Severity.WRONG,
    ModeFlag.MAY_BE_HELD: Severity.WRONG,
    ModeFlag.ALIASED_POSSIBLE: Severity.WRONG,
    ModeFlag.UNRESOLVED: Severity.WRONG,
    ModeFlag.HARMONIC: Severity.WRONG,
    ModeFlag.RESIDUAL_AT_MODE: Severity.WRONG,
    ModeFlag.SHAPE_DISAGREES: Severity.WRONG,
    ModeFlag.RATE_CONVERTED: Severity.WRONG,
    ModeFlag.INPUT_LATE: Severity.WRONG,
    ModeFlag.NOT_CONFIRMED: Severity.WRONG,
    ModeFlag.INPUT_INCOMPLETE: Severity.INTERVAL,
    ModeFlag.AMPLITUDE_DEPENDENT: Severity.INTERVAL,
    ModeFlag.FEW_CYCLES_LOST: Severity.INTERVAL,
    ModeFlag.MANY_OUTLIERS: Severity.INTERVAL,
    ModeFlag.DAMPING_TOUCHES_ZERO: Severity.INTERVAL,
    ModeFlag.CHAIN_TOO_SHORT: Severity.INTERVAL,
}

#: Of each check of the residual its name, what a small p-value tells, and what to do.
CHECKS = (
    (
        "unmodelled vibration",
        "A vibration was not modelled: a weak mode, mains hum, or a harmonic of a strong mode.",
        "Where it changes the values by more than a standard deviation, remove its source and record again.",
    ),
    (
        "correlation of neighbouring residuals",
        "The noise is correlated in time, or contains fast motion.",
        "The intervals already include the noise level at the mode (noise factor); stabilise camera and lighting.",
    ),
    (
        "power just above the baseline's band",
        "A drift is faster than the baseline: camera motion, changing light, or a slow swing.",
        "Add a reference marker on a fixed point; keep camera and lighting steady.",
    ),
    (
        "score for damping that depends on amplitude",
        "The decay may not be exponential: damping that depends on the amplitude, or noise that is not white.",
        "The recording states whether a dependence is established; record smaller amplitudes, or longer.",
    ),
    (
        "kurtosis of the residual",
        "Single samples deviate strongly: lost or wrongly located markers, or shocks.",
        "Inspect the frames with the largest residuals; improve lighting and markers.",
    ),
)
