"""Parts of a record: kind of motion in each stretch of time, start of a free decay; another rate that would fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from modal_id.sentences import Note

SegmentKind = Literal["at rest", "driven", "decay", "disturbed", "repeated", "not used", "ambient"]


@dataclass(frozen=True)
class Segment:
    """A stretch of the record.

    Attributes
    ----------
    kind : str
        "decay" (free decay, fitted), "driven" (steady motion), "at rest", "disturbed" (a click, handling, a stop by
        hand, or what follows it), "repeated" (frames that repeat the one before), "not used" (excluded by `onset_s`,
        `end_s` or clipping), or "ambient" (motion under a random force, of which the modes were identified).
    start_s, end_s : float
        First and last time, in the time of the series.
    note : str
        A sentence for the report.
    driven_probability : float
        Posterior probability that the motion is driven and not free; before a stop, that of the stop
        (`Onset.confidence`) where it is lower; NaN where it was not asked.
    """

    kind: SegmentKind
    start_s: float
    end_s: float
    note: str = field(default="", repr=False)
    driven_probability: float = field(default=float("nan"), repr=False)

    def __str__(self) -> str:
        return Note.SEGMENT(kind=self.kind, start_s=self.start_s, end_s=self.end_s)


@dataclass(frozen=True)
class Onset:
    """Start of the free decay.

    Attributes
    ----------
    time_s : float
        Start of the free decay.
    sd_s : float
        Its standard deviation; 0 when the user gave the time, NaN when it could not be estimated.
    fit_from_s : float
        First time used in the fit: a little after `time_s`, when the transients of the stop have decayed.
    source : str
        "user", "model" (change from driven to free motion found in the data), "peak" (release from the largest
        deflection), "interruption" (the motion goes on after a click or a step, and is fitted from there), "record
        start" (the record is a decay from its first sample on), or "none" (steady motion throughout, or no motion:
        there is no free decay).
    confidence : float
        Posterior probability, 0 to 1, of the change that was found; 1 when the user gave the time.
    note : str
        A sentence for the report.
    """

    time_s: float
    sd_s: float
    fit_from_s: float
    source: Literal["user", "model", "peak", "interruption", "record start", "none"]
    confidence: float
    note: str = field(default="", repr=False)


@dataclass(frozen=True)
class FittingRate:
    """Sampling rate at which a line of the record would be a mode of the beam, which it is not at the recorded one.

    Attributes
    ----------
    recorded_hz : float
        As the series states it.
    limits_hz : (float, float)
        Lowest and highest rate that fits; equal where a rate that cameras offer does.
    ratio : float
        Of the rate that fits to the recorded one.
    line_hz : float
        Frequency of the line at the recorded rate.
    number : int
        The mode of the beam that the line would be.
    otherwise : int or None
        The mode that the line is near at the recorded rate, where no shape decides between the two.
    """

    recorded_hz: float
    limits_hz: tuple[float, float]
    ratio: float
    line_hz: float
    number: int
    otherwise: int | None = None

    @property
    def rate(self) -> str:
        """The rate that fits: ``500 Hz`` or ``314 to 384 Hz``."""
        low, high = self.limits_hz
        return f"{low:g} Hz" if low == high else f"{low:.3g} to {high:.3g} Hz"

    def __str__(self) -> str:
        text = Note.FITTING_RATE(
            rate=self.rate,
            recorded_hz=self.recorded_hz,
            ratio=self.ratio,
            hz=self.line_hz,
            number=self.number,
        )
        return text if self.otherwise is None else Note.UNLESS(fitting=text, number=self.otherwise)
