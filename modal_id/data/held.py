"""Series that hold each sample for several rows, as of a slow logger stored at a higher rate.

The rows between carry nothing, so that all aliases up to half the rate of the rows fit the samples equally well.
Without these rows, half the rate of the samples is the limit, and the lowest alias the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data.repeats import repeated_rows
from modal_id.flags import ModeFlag
from modal_id.results import Identification, IdentifiedMode
from tracker import DisplacementSeries, Failure


@dataclass(frozen=True)
class Tuning:
    """Samples held by a slower clock."""

    #: [1] share of the distances between changes that must be a multiple of the usual distance
    #: convention: A clock that is no whole multiple has two distances, equal samples of a coarse converter any.
    even: float = 0.9
    #: [samples] fewest samples that show it
    least_samples: int = 12


TUNING = Tuning()


def sampled_rows(series: DisplacementSeries) -> tuple[NDArray[np.intp], int] | None:
    """Rows that carry a sample, and their distance in rows; None where every row may."""
    seen = np.flatnonzero(np.any(np.isfinite(series.values), axis=1))
    if seen.size < TUNING.least_samples:
        return None
    steps = np.diff(series.time_s)
    if np.ptp(steps) > 0.5 * float(np.median(steps)):
        return None
    values = series.values[seen]
    values = values[:, np.any(np.isfinite(values), axis=0)]
    repeated = repeated_rows(values)
    repeated[1:] |= np.all((values[1:] == values[:-1]) | np.isnan(values[1:]), axis=1)
    rows = seen[~repeated]
    if rows.size < TUNING.least_samples:
        return None
    lengths = np.diff(rows)
    held = int(np.median(lengths))
    # A sample equal to the one before lies a multiple later.
    return (rows, held) if held > 1 and float(np.mean(lengths % held == 0)) > TUNING.even else None


def of_rows(series: DisplacementSeries, rows: NDArray[np.intp]) -> DisplacementSeries:
    """The series with these rows only."""
    base, base_sd = (None if x is None else x[rows] for x in (series.base, series.base_sd))
    return replace(
        series,
        time_s=series.time_s[rows],
        values=series.values[rows],
        sd=series.sd[rows],
        base=base,
        base_sd=base_sd,
    )


def in_all_rows(
    found: Identification | Failure,
    series: DisplacementSeries,
    rows: NDArray[np.intp],
    held: int,
) -> Identification | Failure:
    """What was found from `rows` in terms of the whole series, its modes with the other possible frequencies."""
    rate_hz = 1.0 / float(np.median(np.diff(series.time_s)))
    words = (
        f"Only one row in {held} carries a sample ({rate_hz / held:.4g} of {rate_hz:.4g} Hz; the others repeat "
        "it or are empty): frequencies are the lowest that fit, below half that rate."
    )
    if isinstance(found, Failure):
        return replace(found, reason=f"{found.reason} {words}")
    size = series.values.shape
    fitted, baseline, used = np.full(size, np.nan), np.full(size, np.nan), np.zeros(size, dtype=bool)
    fitted[rows], baseline[rows], used[rows] = found.fitted, found.baseline, found.used
    return replace(
        found,
        series=series,
        fitted=fitted,
        baseline=baseline,
        used=used,
        modes=tuple(_flagged(mode, rate_hz / held) for mode in found.modes),
        notes=(*found.notes, words),
    )


def _flagged(mode: IdentifiedMode, rate_hz: float) -> IdentifiedMode:
    """The mode with the flag of an alias, and the frequencies that fit as well."""
    flag, hz = ModeFlag.ALIASED_POSSIBLE, mode.frequency_hz
    others = f"{rate_hz - hz:.4g}, {rate_hz + hz:.4g}, {2.0 * rate_hz - hz:.4g}, … Hz"
    note = f"Sampled at {rate_hz:.4g} Hz, a vibration at {others} cannot be distinguished from one at {hz:.4g} Hz."
    if flag.name in mode.flags:
        return replace(mode, notes=(*mode.notes, note))
    return replace(
        mode,
        flags=(*mode.flags, flag.name),
        notes=(*mode.notes, flag.value, note),
        severities=(*mode.severities, (flag.name, flag.usual_severity.name)),
    )
