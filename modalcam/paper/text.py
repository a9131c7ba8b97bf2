"""Numbers in sentences: lists, signed percentages, counts; filters of the page's template."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from modalcam.report.style.format import MISSING, percent, significant
from sim.updating import PaperUpdate


def signed_percent(ratio: float, digits: int = 2) -> str:
    """``+0.62 %``: a relative difference to `digits` significant digits; a dash for NaN."""
    if np.isnan(ratio):
        return MISSING
    text = significant(100.0 * ratio, digits)
    return f"{'+' if ratio > 0.0 and text != '0' else ''}{text} %"


def signed_range(ratios: ArrayLike, digits: int = 2) -> str:
    """``−3.1 to +2.8 %``, smallest to largest, without NaN; one value where both read the same."""
    finite = _finite(ratios)
    if finite.size == 0:
        return MISSING
    low, high = (signed_percent(float(v), digits) for v in (finite.min(), finite.max()))
    return low if low == high else f"{low.removesuffix(' %')} to {high}"


def percent_range(ratios: ArrayLike, digits: int = 2) -> str:
    """``0.48 to 15 %``, without signs."""
    return signed_range(np.abs(np.asarray(ratios, dtype=np.float64)), digits).replace("+", "")


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


def _finite(ratios: ArrayLike) -> np.ndarray:
    values = np.atleast_1d(np.asarray(ratios, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])


def listed(parts: Iterable[str]) -> str:
    """``a, b and c``."""
    parts = tuple(parts)
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""


def of_all(part: int, whole: int) -> str:
    """``all 5``, ``3 of 5``, ``none of 5``."""
    if part == whole:
        return f"all {whole}" if whole != 1 else "the one"
    return f"{part or 'none'} of {whole}"


def modes_named(numbers: Sequence[int]) -> str:
    """``mode 3``, ``modes 3 to 5``, ``modes 1, 3 and 5``."""
    return f"mode{'s' if len(numbers) > 1 else ''} {_runs(numbers)}"


def variables_at_bound(update: PaperUpdate) -> str:
    """``7 of them end at the bound: thickness of elements 2 to 4 at +10 %, ...``."""
    fields = {
        "density": [update.density_factor],
        "modulus": [update.elastic_modulus_factor],
        "thickness": update.thickness_factor,
        "width": update.width_factor,
    }
    parts, count = [], 0
    for field, factors in fields.items():
        for sign in ("+", "−"):
            excess = (np.asarray(factors) - 1.0) * (1.0 if sign == "+" else -1.0)
            at = np.flatnonzero(excess > update.bound - 1e-6) + 1
            count += at.size
            elements = (
                f" of element{'s' if at.size > 1 else ''} {_runs(at.tolist())}" if len(excess) > 1 else ""
            )
            parts += [f"{field}{elements} at {sign}{percent(update.bound)}"] if at.size else []
    if not parts:
        return "none of them ends at the bound"
    return f"{count} of them {'ends' if count == 1 else 'end'} at the bound: {listed(parts)}"


def _runs(numbers: Sequence[int]) -> str:
    """``2 to 4 and 9``: consecutive numbers, three or more, as a range."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    parts: list[str] = []
    for run in runs:
        parts += [f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run)
    return listed(parts)


FILTERS = (
    error,
    largest,
    listed,
    modes_named,
    of_all,
    percent_range,
    signed_percent,
    signed_range,
    variables_at_bound,
    within,
)
