"""Ranks of what the studio says about recordings and results: what prevents a result first, then what may harm it."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum


class Rank(IntEnum):
    """In order; a remark is shown with the name of its rank before it."""

    BLOCKING = 0
    DOUBTFUL = 1
    NOTE = 2

    @property
    def word(self) -> str:
        """The name, as it is shown."""
        return self.name.capitalize()


# How the messages of a run begin, and whether this is said by the rank.
_BEGINNINGS = {
    "FAILED ": (Rank.BLOCKING, True),
    "NOT IDENTIFIED ": (Rank.BLOCKING, False),
    "WARNING ": (Rank.DOUBTFUL, True),
    "note: ": (Rank.NOTE, True),
}


def ranked(messages: Iterable[str]) -> list[tuple[Rank, str]]:
    """Messages of a run with their ranks, the worst first, and otherwise as they came."""
    found = []
    for text in messages:
        start = next((start for start in _BEGINNINGS if text.startswith(start)), "")
        rank, is_said = _BEGINNINGS.get(start, (Rank.NOTE, False))
        found.append((rank, text.removeprefix(start) if is_said else text))
    return sorted(found, key=lambda one: one[0])
