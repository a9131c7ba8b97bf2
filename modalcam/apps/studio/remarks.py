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


# How the messages of a run begin, which their rank says, too.
_BEGINNINGS = {
    "FAILED ": Rank.BLOCKING,
    "NOT IDENTIFIED ": Rank.BLOCKING,
    "WARNING ": Rank.DOUBTFUL,
    "note: ": Rank.NOTE,
}


def ranked(messages: Iterable[str]) -> list[tuple[Rank, str]]:
    """Messages of a run with their ranks, the worst first, and otherwise as they came."""
    starts = ((next((s for s in _BEGINNINGS if text.startswith(s)), ""), text) for text in messages)
    found = [(_BEGINNINGS.get(start, Rank.NOTE), text.removeprefix(start)) for start, text in starts]
    return sorted(found, key=lambda one: one[0])
