"""Numbers for people: each rounded to two digits of its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from modal_id import IdentifiedMode

MISSING = "–"
MINUS = "−"
_MOST_DECIMALS = 9
_LARGEST = 1e7
_SUPERSCRIPT = str.maketrans("-0123456789.", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹·")


def decimals_of(sd: float, *, digits: int = 2) -> int:
    """Decimals that show `digits` significant digits of `sd`; negative left of the point.

    Raises
    ------
    ValueError
        If `sd` is not finite and positive.
    """
    if not (math.isfinite(sd) and sd > 0.0):
        msg = f"sd must be finite and positive, got {sd}"
        raise ValueError(msg)
    # The mantissa after rounding decides: 0.0996 to two digits is 0.10, one decimal less than 0.0994.
    exponent = int(f"{sd:.{digits - 1}e}".partition("e")[2])
    return digits - 1 - exponent


def fixed(value: float, decimals: int) -> str:
    """Value with `decimals` decimals, rounded left of the point where that is negative; a dash for NaN."""
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def significant(value: float, digits: int = 3) -> str:
    """Value with `digits` significant digits; in powers of ten where it is very small or large."""
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return fixed(value, 0)
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < 6:
        return fixed(value, max(digits - 1 - power, 0))
    return f"{mantissa.replace('-', MINUS)} × 10{superscript(power)}"


def with_sd(value: float, sd: float) -> str:
    """``value ± sd``, both to two significant digits of `sd`.

    The value alone, to four digits, where `sd` is NaN, infinite or 0: the number of significant digits is unknown.
    """
    if math.isnan(value):
        return MISSING
    if not (math.isfinite(sd) and sd > 0.0 and math.isfinite(value)):
        return significant(value, 4)
    decimals = decimals_of(sd)
    if decimals > _MOST_DECIMALS or max(abs(value), sd) >= _LARGEST:
        return _scientific(value, sd)
    return f"{fixed(value, decimals)} ± {fixed(sd, decimals)}"


def in_unit(text: str, unit: str) -> str:
    """A formatted number followed by its unit; alone where it is dimensionless, unit "1"."""
    return text if unit == "1" else f"{text} {unit}"


def interval(low: float, high: float, sd: float) -> str:
    """``low … high`` with the decimals of `with_sd`."""
    if math.isnan(low) or math.isnan(high):
        return MISSING
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{significant(low, 4)} … {significant(high, 4)}"
    decimals = decimals_of(sd)
    if decimals > _MOST_DECIMALS or max(abs(low), abs(high)) >= _LARGEST:
        return f"{significant(low, 4)} … {significant(high, 4)}"
    return f"{fixed(low, decimals)} … {fixed(high, decimals)}"


def percent(ratio: float, digits: int = 2) -> str:
    """Ratio in percent, to `digits` significant digits."""
    return MISSING if math.isnan(ratio) else f"{significant(100.0 * ratio, digits)} %"


def count(number: int, singular: str, plural: str = "") -> str:
    """``1 marker``, ``3 markers``; thousands set apart by a thin space."""
    return f"{thousands(number)} {singular if number == 1 else plural or singular + 's'}"


def thousands(number: int) -> str:
    """Whole number, thousands set apart by a narrow space from 10 000 on."""
    text = f"{abs(number):,}".replace(",", "\u202f") if abs(number) >= 10_000 else str(abs(number))
    return text if number >= 0 else f"{MINUS}{text}"


def signed(value: float, decimals: int) -> str:
    """Value with its sign and `decimals` decimals."""
    text = fixed(value, decimals)
    return f"+{text}" if round(value, decimals) > 0.0 else text


def p_value(value: float, least: float) -> str:
    """Probability with three decimals, or ``< least``."""
    return f"< {least:g}" if value < least else fixed(value, 3)


def odds(log_odds: float) -> str:
    """``12 : 1`` from the natural logarithm of the odds; a power of ten above 10 000."""
    if log_odds < math.log(1e4):
        return f"{significant(math.exp(log_odds), 2)} : 1"
    return f"10{superscript(round(log_odds / math.log(10.0)))} : 1"


def superscript(power: float | str) -> str:
    """Number in superscript characters."""
    return str(power).translate(_SUPERSCRIPT)


def rate(fps: Fraction | None) -> str:
    """``59.94 fps``: frame rate, with the exact fraction where it is not a short decimal; a dash for None."""
    if fps is None:
        return MISSING
    text = f"{float(fps):.6g}"
    exact = Fraction(text) == fps
    return f"{text} fps" if exact else f"{float(fps):.7g} fps ({fps.numerator}/{fps.denominator})"


def listed(words: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def mode_name(mode: IdentifiedMode) -> str:
    """``Mode 3``, or its frequency if its number is unknown."""
    if mode.number is None:
        return f"Mode at {significant(mode.frequency_hz, 4)} Hz"
    return f"Mode {mode.number}"


def _scientific(value: float, sd: float) -> str:
    power = math.floor(math.log10(max(abs(value), sd)))
    # Dividing by 10.0**power would underflow to 0 for the smallest doubles.
    scaled, scaled_sd = (
        float(f"{v:.17e}e".partition("e")[0]) * 10.0 ** _shift(v, power) for v in (value, sd)
    )
    decimals = decimals_of(scaled_sd) if scaled_sd > 0.0 else 3
    return f"({fixed(scaled, decimals)} ± {fixed(scaled_sd, decimals)}) × 10{superscript(power)}"


def _shift(value: float, power: int) -> int:
    return int(f"{value:.17e}".partition("e")[2]) - power
