"""What goes wrong: a caller's mistake is an exception, an expected failure a value."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Failure:
    """A result that could not be had: falsy, with the reason.

    Attributes
    ----------
    reason : str
        What was expected and what was found.
    where : str
        Recording, series, mode or file; empty where the holder of this value says it.
    next_step : str
        What to do; empty where the reason says it.
    """

    reason: str
    where: str = ""
    next_step: str = ""

    def __bool__(self) -> bool:
        return False

    def __str__(self) -> str:
        text = f"{self.where}: {self.reason}" if self.where else self.reason
        return f"{text}; {self.next_step}" if self.next_step else text


def checked(
    name: str, value: float, *, positive: bool = False, at_least: float = -math.inf, at_most: float = math.inf
) -> float:
    """The value, which a caller gave for `name`.

    Raises
    ------
    ValueError
        If it is not finite, or not positive where it must be, or outside the limits.
    """
    if math.isfinite(value) and at_least <= value <= at_most and (value > 0.0 or not positive):
        return value
    wanted = ["finite", *(["positive"] if positive else [])]
    if at_least == 0.0:
        wanted.append("not negative")
    elif at_least > -math.inf:
        wanted.append(f"at least {at_least:g}")
    if at_most < math.inf:
        wanted.append(f"at most {at_most:g}")
    msg = f"{name} must be {' and '.join(wanted)}, got {value}"
    raise ValueError(msg)
