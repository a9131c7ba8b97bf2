"""Which of the paper's variables end at their bound, in words."""

from __future__ import annotations

import re
from collections import defaultdict

import numpy as np

from modalcam.paper.words import listed
from modalcam.report.style.format import percent
from sim.updating import PaperUpdate

# As the updating names a variable at its bound: "width of element 4 (+10 %)", "density (-10 %)".
_NAME = re.compile(r"(?P<field>.+?)(?: of element (?P<element>\d+))? \((?P<bound>.+)\)")


def ending_at_bound(update: PaperUpdate) -> str:
    """``7 of them end at the bound: thickness of elements 2 to 4 at +10 %, ...``."""
    if not update.at_bound:
        return "none of them ends at the bound"
    places: dict[tuple[str, str], list[int]] = defaultdict(list)
    for name in update.at_bound:
        found = _NAME.fullmatch(name)
        if found is None:
            msg = f"expected a variable and its bound in parentheses, found {name!r}"
            raise ValueError(msg)
        key = (found["field"], found["bound"].replace("-", "−"))
        places[key] += [] if found["element"] is None else [int(found["element"])]
    parts = [
        f"{field}{_elements(elements)} at {bound}" for (field, bound), elements in sorted(places.items())
    ]
    verb = "ends" if len(update.at_bound) == 1 else "end"
    return f"{len(update.at_bound)} of them {verb} at the bound: {listed(parts)}"


def _elements(numbers: list[int]) -> str:
    if not numbers:
        return ""
    runs: list[list[int]] = []
    for n in sorted(numbers):
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    parts = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    return f" of element{'s' if len(numbers) > 1 else ''} {listed(parts)}"


def least_bound(update: PaperUpdate) -> str:
    """How small the bound could be, in a sentence."""
    if np.isnan(update.smallest_bound):
        return "No bound was found within which these frequencies could be had."
    relation = "would do" if update.smallest_bound < update.bound else "would be needed"
    return f"For the frequencies alone a bound of {percent(update.smallest_bound)} {relation}."


def spread_over_starts(update: PaperUpdate) -> str:
    """How far answers from other starts, which fit as well, lie apart, in a sentence."""
    return (
        "Searches from other starts end elsewhere and fit as well: single variables differ between their "
        f"answers by up to {percent(float(update.start_spread.max()))} (one standard deviation)."
    )
