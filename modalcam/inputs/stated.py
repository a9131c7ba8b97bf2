"""What a file states beside its values: the rate and the unit of its channels; which values are read at all."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import pandas as pd

from modalcam.common import InputError, shown

# More values than any series that can be identified.
MOST_VALUES = 250_000_000
# Integers and floating-point numbers.
REAL_KINDS = "iuf"
RATE_NAMES = ("fs", "rate", "fps", "sampling_rate", "sample_rate")
TIME_NAMES = ("time_s", "time", "t")
_PREFIXED = r"(?:da|[kMGcdmuµμnp])?(?:m|g|s|N|V|A|Pa|Hz|rad|ε|strain)"
_OTHERS = "1|%|°|deg|in|inch|ft|mil|lbf?|psi|px|pixels?|counts?|digits?|LSB"
_FACTOR = rf"(?:{_PREFIXED}|{_OTHERS})(?:(?:\^|\*\*)?-?[1-3]|²|³)?"
_UNIT = re.compile(rf"{_FACTOR}(?:[/*·. ]{_FACTOR})*")


def insert_times(columns: pd.DataFrame, notes: list[str], rates: set[float], start_s: float = 0.0) -> None:
    """Insert the times, and a note on them, where a file states samples per second instead; ValueError for two."""
    if not rates or any(str(name).lower().split(" ")[0] in TIME_NAMES for name in columns.columns):
        return
    if len(rates) > 1 or not 0.0 < min(rates) < np.inf:
        msg = f"samples per second of {', '.join(f'{rate:g}' for rate in sorted(rates))}; state one positive number"
        raise ValueError(msg)
    (rate,) = rates
    columns.insert(0, "time", start_s + np.arange(len(columns)) / rate)
    notes.append(f"Its times are those of {rate:g} samples per second, as the file says.")


def note_unit(columns: pd.DataFrame, notes: list[str], units: set[str]) -> None:
    """Keep the one unit that the channels of a file state, or note that they state several: they are one quantity."""
    given = sorted(shown(unit) for unit in units if unit)
    if len(units) == 1 and given:
        columns.attrs["unit"] = given[0]
    elif given:
        notes.append(
            f"The channels of the file state {', '.join(given)} as their units; they are read as one quantity."
        )


def unit_in_names(names: Iterable[str]) -> str:
    """The unit in brackets at the end of all these names; empty unless each has one, and the same."""
    inside = (re.search(r"[\[(]([^\])]*)[\])]$", name.strip()) for name in names)
    units = {found[1] if found and _UNIT.fullmatch(found[1]) else "" for found in inside}
    return units.pop() if len(units) == 1 else ""


def checked_unit(unit: str, option: str) -> str:
    """The unit; InputError for what is none."""
    if not _UNIT.fullmatch(unit):
        msg = f"{option}: expected a unit such as mm, um, m/s2, g, V, rad, counts or 1, found {shown(unit)}"
        raise InputError(msg)
    return unit
