"""Numbers in sentences: signed percentages, counts, mode numbers; filters of the page's templates."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import ArrayLike

from modalcam.report.style import MISSING, inline, listed, percent, significant
from tracker import FloatArray


def signed_percent(ratio: float, digits: int = 2) -> str:
    """``+0.62 %``: a relative difference to `digits` significant digits; a dash for NaN."""
    if np.isnan(ratio):
        return MISSING
    text = significant(100.0 * ratio, digits)
    return f"{'+' if ratio > 0.0 and text != '0' else ''}{text} %"


def signed_range(ratios: ArrayLike) -> str:
    """``−3.1 to +2.8 %``, smallest to largest, without NaN; one value where both read the same."""
    finite = _finite(ratios)
    if finite.size == 0:
        return MISSING
    low, high = (signed_percent(float(v)) for v in (finite.min(), finite.max()))
    return low if low == high else f"{low.removesuffix(' %')} to {high}"


def percent_range(ratios: ArrayLike) -> str:
    """``0.48 to 15 %``, without signs."""
    return signed_range(np.abs(ratios)).replace("+", "")


def within(ratios: ArrayLike) -> str:
    """Largest absolute value in per cent, at least 0.0001 %; a dash if all are NaN."""
    value = largest(ratios)
    return "0.0001 %" if value < 1e-6 else percent(value)


def error(ratio: float) -> str:
    """As `signed_percent`; errors below any measurement as ``< 0.0001 %``."""
    return "< 0.0001 %" if abs(ratio) < 1e-6 else signed_percent(ratio)


def largest(ratios: ArrayLike) -> float:
    """Largest absolute value, without NaN; NaN if all are."""
    finite = np.abs(_finite(ratios))
    return float(finite.max()) if finite.size else float("nan")


def _finite(ratios: ArrayLike) -> FloatArray:
    values = np.atleast_1d(np.asarray(ratios, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])


def column(rows: Iterable[object], name: str) -> FloatArray:
    """One attribute of all rows."""
    return np.array([attrgetter(name)(row) for row in rows])


def of_all(part: int, total: int) -> str:
    """``all 5``, ``3 of 5``, ``none of 5``."""
    if part == total:
        return f"all {total}" if total != 1 else "the one"
    return f"{part or 'none'} of {total}"


def numbered(numbers: Sequence[int], noun: str) -> str:
    """``mode 3``, ``modes 3 to 5``, ``modes 1, 3 and 5``: three or more consecutive numbers as a range."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    parts: list[str] = []
    for run in runs:
        parts += [f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run)
    return f"{noun}{'s' if len(numbers) > 1 else ''} {listed(parts)}"


def exponential(value: float) -> float:
    """Exponential function; infinite beyond the largest number, for odds of any size."""
    with np.errstate(over="ignore"):
        return float(np.exp(value))


FILTERS = (
    column,
    error,
    exponential,
    inline,
    largest,
    numbered,
    of_all,
    percent_range,
    signed_percent,
    signed_range,
    within,
)
