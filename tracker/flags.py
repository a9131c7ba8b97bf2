"""Quality flags of a marker in a frame: one registry for the column, the documentation and the decoder."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FlagDefinition:
    """One bit of the flags column."""

    bit: int
    name: str
    description: str

    @property
    def value(self) -> int:
        """The bit as an integer."""
        return 1 << self.bit


NOT_FOUND = FlagDefinition(0, "NOT_FOUND", "The marker was not found in this frame; its position is NaN.")
DECODE_CORRUPT = FlagDefinition(
    1, "DECODE_CORRUPT", "The frame was damaged in the file; the position is NaN."
)
EDGE = FlagDefinition(2, "EDGE", "The marker touches the edge of the picture; part of it is not seen.")
SATURATED = FlagDefinition(3, "SATURATED", "Pixels of the marker are at the sensor's limit.")
BLURRED = FlagDefinition(4, "BLURRED", "The marker moved by more than a pixel during the exposure.")
POOR_FIT = FlagDefinition(
    5, "POOR_FIT", "The template explains the pixels worse than their noise allows; the sd is enlarged."
)
RECOVERED = FlagDefinition(
    6, "RECOVERED", "The marker had been lost and was found again by detection in this frame."
)
DUPLICATE_FRAME = FlagDefinition(
    7,
    "DUPLICATE_FRAME",
    "The picture repeats the one before: it was put there, and measures nothing.",
)
LOSSY = FlagDefinition(
    8, "LOSSY", "The footage is compressed with losses: positions carry errors that do not average out."
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
)


def flag_names(value: int) -> tuple[str, ...]:
    """Names of the bits set in `value`, in order of the registry.

    Raises
    ------
    ValueError
        If `value` has bits that no flag defines.
    """
    known = sum(flag.value for flag in REGISTRY)
    if value & ~known:
        msg = f"flags value {value:#x} has bits that no flag defines (known: {known:#x})"
        raise ValueError(msg)
    return tuple(flag.name for flag in REGISTRY if value & flag.value)


def format_flags(value: int) -> str:
    """Flags as written to files: names joined by ``|``, empty when none is set."""
    return "|".join(flag_names(value))


def parse_flags(text: str) -> int:
    """Inverse of `format_flags`.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    by_name = {flag.name: flag.value for flag in REGISTRY}
    value = 0
    for name in filter(None, text.split("|")):
        if name not in by_name:
            msg = f"unknown flag {name!r}; known flags are {', '.join(by_name)}"
            raise ValueError(msg)
        value |= by_name[name]
    return value
