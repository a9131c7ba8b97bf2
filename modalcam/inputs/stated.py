"""What a file states beside its values: the rate and the unit of its channels; which values are read at all."""

from __future__ import annotations

import numpy as np
import pandas as pd

from modalcam.common import shown

# More values than any series that can be identified.
MOST_VALUES = 250_000_000
# Integers and floating-point numbers.
REAL_KINDS = "iuf"
RATE_NAMES = ("fs", "rate", "fps", "sampling_rate", "sample_rate")
TIME_NAMES = ("time_s", "time", "t")


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
