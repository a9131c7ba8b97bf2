"""Numbers put into sentences: lists, signed percentages, and how many of how many."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from modalcam.report.style.format import MISSING, fixed, percent, significant


def signed_percent(ratio: float, digits: int = 2) -> str:
    """``+0.62 %``: a relative difference with its sign, to `digits` significant digits; a dash for NaN."""
    if np.isnan(ratio):
        return MISSING
    text = significant(100.0 * ratio, digits)
    return f"{'+' if ratio > 0.0 and text != '0' else ''}{text} %"


def signed_range(ratios: ArrayLike, digits: int = 2) -> str:
    """``−3.1 to +2.8 %``, from the smallest to the largest; one value alone where both read the same."""
    known = np.asarray(ratios, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return MISSING
    low, high = (signed_percent(float(v), digits) for v in (known.min(), known.max()))
    return low if low == high else f"{low.removesuffix(' %')} to {high}"


def percent_range(ratios: ArrayLike, digits: int = 2) -> str:
    """``0.48 to 15 %``, without signs."""
    return signed_range(np.abs(np.asarray(ratios, dtype=np.float64)), digits).replace("+", "")


def within(ratio: float) -> str:
    """A bound on errors in per cent; what is less than anyone measures is not spelt out."""
    return "0.0001 %" if abs(ratio) < 1e-6 else percent(ratio)


def largest(ratios: ArrayLike) -> float:
    """Largest modulus of the known ones; NaN where none is known."""
    known = np.abs(np.asarray(ratios, dtype=np.float64))
    known = known[np.isfinite(known)]
    return float(known.max()) if known.size else float("nan")


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
    if len(numbers) == 1:
        return f"mode {numbers[0]}"
    if len(numbers) > 2 and list(numbers) == list(range(numbers[0], numbers[-1] + 1)):
        return f"modes {numbers[0]} to {numbers[-1]}"
    return f"modes {listed(str(n) for n in numbers)}"


def hertz(value: float) -> str:
    """Frequency with two decimals, as the paper prints it."""
    return fixed(value, 2)
