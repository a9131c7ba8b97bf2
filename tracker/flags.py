"""Quality flags of a marker in a frame: one registry for data, documentation and decoder.

The severity of a flag states what it means for the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class Tuning:
    """Shares of the frames from which a flag matters."""

    #: [1] share of the frames below which a flag does not matter
    #: convention: chosen; effect on the headline only
    rare: float = 0.01
    #: [1] share above which the frames that are left may be selected by the motion
    #: convention: chosen; effect on the headline only
    most: float = 0.5
    #: [1] relative increase of a standard deviation that matters
    #: convention: chosen; effect on the headline only
    noticeable: float = 0.1


TUNING = Tuning()


class Severity(Enum):
    """In order; the value states the meaning in report and documentation."""

    WRONG = "The value may be wrong by more than its interval."
    INTERVAL = "The interval is right, and wider for this reason; or part of the record is missing."
    INFORMATION = "The value and its interval account for it."


@dataclass(frozen=True)
class FlagDefinition:
    """One bit of the flags column; `severity` is that of a marker with the flag in a good part of the frames."""

    bit: int
    name: str
    description: str
    severity: Severity = Severity.INFORMATION

    @property
    def value(self) -> int:
        """The bit as an integer."""
        return 1 << self.bit

    def severity_in(self, share: float) -> Severity:
        """Severity for a marker with the flag in this share of the frames.

        Missing frames, a share s of all, raise the standard deviations by ``(1 - s)^-1/2``. Where most are missing,
        those that are left may be selected by the motion.
        """
        if self.severity is not Severity.INTERVAL:
            return self.severity if share > TUNING.rare else Severity.INFORMATION
        if share > TUNING.most:
            return Severity.WRONG
        return Severity.INTERVAL if (1.0 - share) ** -0.5 > 1.0 + TUNING.noticeable else Severity.INFORMATION


NOT_FOUND = FlagDefinition(
    0, "NOT_FOUND", "The marker was not found in this frame; its position is NaN.", Severity.INTERVAL
)
DECODE_CORRUPT = FlagDefinition(
    1, "DECODE_CORRUPT", "The frame was damaged in the file; the position is NaN.", Severity.INTERVAL
)
EDGE = FlagDefinition(
    2, "EDGE", "The marker touches the edge of the image; part of it is not visible.", Severity.WRONG
)
SATURATED = FlagDefinition(3, "SATURATED", "Pixels of the marker are saturated.", Severity.WRONG)
BLURRED = FlagDefinition(4, "BLURRED", "The marker moved by more than a pixel during the exposure.")
POOR_FIT = FlagDefinition(
    5, "POOR_FIT", "The residuals exceed the noise of the pixels; the sd is enlarged accordingly."
)
RECOVERED = FlagDefinition(6, "RECOVERED", "The marker was lost before and was recovered in this frame.")
DUPLICATE_FRAME = FlagDefinition(
    7, "DUPLICATE_FRAME", "The frame repeats the previous image: it was inserted and carries no measurement."
)
LOSSY = FlagDefinition(
    8, "LOSSY", "The footage is lossily compressed: positions have errors that do not average out."
)
AMBIGUOUS = FlagDefinition(
    9,
    "AMBIGUOUS",
    "Markers of the same appearance could not be told from each other; the position is NaN.",
    Severity.INTERVAL,
)
OTHER_RATE = FlagDefinition(
    10,
    "OTHER_RATE",
    "The frame was recorded at another rate than the part of the file that is used; it is left out.",
)

REGISTRY: tuple[FlagDefinition, ...] = (
    NOT_FOUND,
    DECODE_CORRUPT,
    EDGE,
    SATURATED,
    BLURRED,
    POOR_FIT,
    RECOVERED,
    DUPLICATE_FRAME,
    LOSSY,
    AMBIGUOUS,
    OTHER_RATE,
)
# Frames with these are no measurements: they are not part of displacements.
LEFT_OUT = DUPLICATE_FRAME.value | OTHER_RATE.value


def flag_names(value: int) -> tuple[str, ...]:
    """Names of the flags set in `value`, in order of the registry; undefined bits are an error."""
    known = sum(flag.value for flag in REGISTRY)
    if value & ~known:
        msg = f"flags value {value:#x} has undefined bits (defined: {known:#x})"
        raise ValueError(msg)
    return tuple(flag.name for flag in REGISTRY if value & flag.value)


def format_flags(value: int) -> str:
    """Flags as text: names joined by ``|``, empty when none is set."""
    return "|".join(flag_names(value))


def parse_flags(text: str) -> int:
    """Inverse of `format_flags`; an unknown name is an error."""
    by_name = {flag.name: flag.value for flag in REGISTRY}
    value = 0
    for name in filter(None, text.split("|")):
        if name not in by_name:
            msg = f"unknown flag {name!r}; expected one of {', '.join(by_name)}"
            raise ValueError(msg)
        value |= by_name[name]
    return value
