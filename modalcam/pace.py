"""How fast frames are worked on, and how long the rest of a stage and of a run will take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

# Shares of the time of a run of the five samples, on two cores with compiled functions saved; others take a hundredth.
_SHARES = {
    "reading": 0.05,
    "tracking": 0.17,
    "identifying": 0.18,
    "updating the beam": 0.18,
    "simulating": 0.21,
    "filming the simulation": 0.02,
    "drawing": 0.17,
    "writing": 0.03,
}
_THEORY = "theory of the beam"
_OF_BEAM = {"updating the beam", "simulating", "filming the simulation"}


def rest_of_run_s(stages: Sequence[str], stage_s: float) -> float | None:
    """Time that a run takes after its current stage, the last of `stages`, which takes `stage_s`; None if unknown.

    As in the run of the samples; without theory of a beam, what needs it is left out.
    """
    names = list(_SHARES)
    if stages[-1] not in names:
        return None
    at = names.index(stages[-1])
    without = at > names.index("tracking") and not {_THEORY, *_OF_BEAM} & set(stages)
    later = sum(_SHARES[name] for name in names[at + 1 :] if not (without and name in _OF_BEAM))
    return stage_s * later / _SHARES[stages[-1]]


def duration(time_s: float) -> str:
    """A time that is known roughly: 50 s, 4 min, 2 h."""
    if time_s < 90.0:
        return f"{5.0 * max(round(time_s / 5.0), 1):.0f} s"
    return f"{time_s / 60.0:.0f} min" if time_s < 5400.0 else f"{time_s / 3600.0:.1f} h"


@dataclass
class Pace:
    """Tasks of a stage that began at `since_s`, and frames of those being worked on."""

    since_s: float
    total: int
    computed: int = 0
    reused: int = 0
    running: dict[str, tuple[int, int]] = field(default_factory=dict)
    done_frames: int = 0
    first: tuple[float, int] | None = None

    def take(self, name: str, frames: int, declared: int) -> None:
        """The recording `name` is at `frames` of `declared`; markers are learned before its first."""
        self.running[name] = frames, declared

    def end(self, name: str, *, reused: bool) -> None:
        """A task has ended."""
        self.done_frames += max(self.running.pop(name, (0, 0)))
        self.reused += reused
        self.computed += not reused

    def left_s(self, now_s: float) -> float | None:
        """Time that the rest of the stage takes at its pace so far; None before there is one."""
        begun = sum(min(done / declared, 1.0) for done, declared in self.running.values() if declared)
        done = (self.computed + begun) / max(self.total - self.reused, 1)
        return (now_s - self.since_s) * (1.0 / done - 1.0) if done > 0.0 else None

    def frames(self, now_s: float) -> str:
        """Frames of the recordings being worked on and the rate of all; empty before the first frame."""
        done, declared = (sum(pair[i] for pair in self.running.values()) for i in (0, 1))
        if done == 0:
            return ""
        said = f"{done} of {declared} frames" if declared >= done else f"{done} frames"
        if self.first is None:
            self.first = now_s, self.done_frames + done
        since_s, before = self.first
        rate = (self.done_frames + done - before) / max(now_s - since_s, 1e-9)
        return f"{said}, {rate:.0f} a second" if rate > 0.0 else said
