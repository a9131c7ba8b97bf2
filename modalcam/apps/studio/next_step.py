"""What the studio says: what to do next, which views are done, and the rank of each remark, the worst first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

# Files named in a sentence.
_MOST_NAMES = 3


@dataclass(frozen=True)
class Stand:
    """How far the work on a folder is.

    `without_rate` are the recordings of the run whose recorded rate is not known, `problem` is what contradicts in the
    options of one of them. A report is one of the configuration as it is; `failures` are its recordings without result.
    """

    is_read: bool = True
    recordings: int = 1
    without_rate: tuple[str, ...] = ()
    problem: str = ""
    has_beam: bool = False
    markers_seen: bool = False
    is_tracked: bool = False
    is_running: bool = False
    is_reported: bool = False
    failures: int = 0
    decay_seen: bool = False


def next_step(stand: Stand) -> str:
    """One sentence that says what to do next."""
    more = len(stand.without_rate) - _MOST_NAMES
    names = ", ".join(stand.without_rate[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
    are_seen = stand.markers_seen or stand.is_tracked or stand.is_reported
    steps = (
        (stand.is_running, "wait for the run; Run and report shows how far it is."),
        (not stand.is_read, "wait until the recordings are read."),
        (not stand.recordings, "include a recording in the run, under Recordings."),
        (bool(names), f"give the recorded rate of {names}, under Recordings: every frequency depends on it."),
        (bool(stand.problem), f"correct the options, under Markers: {stand.problem}."),
        (not are_seen, "look at the markers: detect them, or set patches or a line, under Markers."),
        (not stand.is_reported, "run, under Run and report; a test track shows before what is followed."),
        (stand.failures > 0, f"read why {stand.failures} of the recordings failed, under Run and report."),
        (not stand.decay_seen, "read the report, and look at the fit of each recording, under Decay."),
    )
    said = (f"Next: {text}" for applies, text in steps if applies)
    return next(said, "The report is that of these settings.")


def done_views(stand: Stand) -> frozenset[str]:
    """Names of the views in which nothing is left to do."""
    done = {
        "Recordings": stand.is_read and stand.recordings > 0 and not stand.without_rate,
        "Markers": (stand.markers_seen or stand.is_tracked or stand.is_reported) and not stand.problem,
        "Beam": stand.has_beam,
        "Test track": stand.is_tracked,
        "Run and report": stand.is_reported and not stand.failures,
        "Decay": stand.is_reported and stand.decay_seen,
    }
    return frozenset(name for name, is_done in done.items() if is_done)


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
