"""Quality flags of an identified mode: one registry for the column, the documentation and the report."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModeFlag:
    """A name for the flags column and what it tells."""

    name: str
    description: str


SHORT_RECORD = ModeFlag("SHORT_RECORD", "Fewer than ten cycles of the mode were recorded after the onset.")
LOW_SNR = ModeFlag("LOW_SNR", "The amplitude of the mode is less than ten times the noise of a sample.")
AMPLITUDE_DEPENDENT = ModeFlag(
    "AMPLITUDE_DEPENDENT",
    "Damping or frequency changes with the amplitude: the constant values hold for this record's range only, "
    "and their intervals were widened to reach the values at small amplitude.",
)
CLOSE_MODE = ModeFlag("CLOSE_MODE", "Another mode lies within ten percent of the frequency and rings along.")
CHAIN_TOO_SHORT = ModeFlag(
    "CHAIN_TOO_SHORT", "The sampler used its budget before the autocorrelation criterion was met."
)
ALIASED_POSSIBLE = ModeFlag(
    "ALIASED_POSSIBLE",
    "The frequency lies near half the sampling rate, or where a mode of the beam above half the sampling rate would "
    "appear: the true one may be a mirror image. A recording at another rate tells.",
)
FEW_CYCLES_LOST = ModeFlag(
    "FEW_CYCLES_LOST",
    "Less than 40 % of the amplitude was lost while recorded: whether damping depends on the amplitude is hardly "
    "seen, and its interval allows for it. Record longer.",
)
UNRESOLVED = ModeFlag(
    "UNRESOLVED",
    "Two modes too close to be told apart in this record explain the motion better than one, whether its damping "
    "depends on the amplitude or not: the values may be those of neither. Record longer.",
)
NOT_CONFIRMED = ModeFlag(
    "NOT_CONFIRMED",
    "The stabilised subspace method (covariance-driven SSI), run beside the order selection, finds no stable pole "
    "here.",
)
MANY_OUTLIERS = ModeFlag(
    "MANY_OUTLIERS",
    "More than 3 % of a channel's samples lie over five standard deviations from the fitted model.",
)
HARMONIC = ModeFlag(
    "HARMONIC", "The frequency is a multiple of a stronger mode's: perhaps its distortion, not a mode."
)
DAMPING_TOUCHES_ZERO = ModeFlag(
    "DAMPING_TOUCHES_ZERO", "The data allow a damping ratio of zero; only positive values were admitted."
)

REGISTRY: tuple[ModeFlag, ...] = (
    SHORT_RECORD,
    LOW_SNR,
    AMPLITUDE_DEPENDENT,
    CLOSE_MODE,
    CHAIN_TOO_SHORT,
    ALIASED_POSSIBLE,
    FEW_CYCLES_LOST,
    UNRESOLVED,
    NOT_CONFIRMED,
    MANY_OUTLIERS,
    HARMONIC,
    DAMPING_TOUCHES_ZERO,
)


def describe(name: str) -> str:
    """What the flag of this name tells.

    Raises
    ------
    ValueError
        If no flag has the name.
    """
    for flag in REGISTRY:
        if flag.name == name:
            return flag.description
    known = ", ".join(flag.name for flag in REGISTRY)
    msg = f"unknown flag {name!r}; known flags are {known}"
    raise ValueError(msg)
