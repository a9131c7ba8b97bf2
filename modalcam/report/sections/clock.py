"""The time axis in words: where it came from and what it allows."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.format import MISSING, significant
from tracker.flags import DUPLICATE_FRAME
from tracker.results import MarkerTracks, TimeAxis

_SOURCE = {
    "user": "given by the user",
    "camera header": "the camera's header",
    "time stamps": "the time stamps of the frames, used as they are",
    "container": "the container's rate, which is only a playback rate",
    "unknown": "unknown",
}


@dataclass(frozen=True)
class ClockView:
    """Pairs of label and value, and sentences; `danger` when the axis rests on a playback rate."""

    danger: bool
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def clock_view(tracks: MarkerTracks) -> ClockView:
    """The box on the time axis of one recording."""
    clock = tracks.time_axis
    repeated = int(np.count_nonzero((tracks.flags & np.uint32(DUPLICATE_FRAME.value)).any(axis=1)))
    facts = (
        ("Source", _SOURCE[clock.source]),
        ("Recorded at", _recorded_text(clock)),
        ("Container says", fps_text(clock.fps_container)),
        ("Ratio", ratio_text(clock.fps_recorded, clock.fps_container, guess=clock.is_playback_guess)),
        *step_facts(tracks.time_s),
        ("Repeated pictures", str(repeated)),
    )
    return ClockView(clock.is_playback_guess, facts, clock.notes)


def step_facts(time_s: NDArray[np.float64]) -> tuple[tuple[str, str], ...]:
    """Length, steps and the highest frequency that can be told apart."""
    if time_s.size < 2:
        return (("Length", f"{time_s.size} frames"),)
    steps = np.diff(time_s)
    median = float(np.median(steps))
    uneven = float(np.ptp(steps)) / median
    spread = (
        "even"
        if uneven < 1e-6
        else f"{significant(1e3 * steps.min())} to {significant(1e3 * steps.max())} ms"
    )
    return (
        ("Length", f"{significant(float(time_s[-1] - time_s[0]), 4)} s in {time_s.size} frames"),
        ("Step", f"{significant(1e3 * median, 4)} ms, {spread}"),
        ("Nyquist frequency", f"{significant(0.5 / median, 4)} Hz"),
    )


def _recorded_text(clock: TimeAxis) -> str:
    text = fps_text(clock.fps_recorded)
    return f"not known; {text} assumed" if clock.is_playback_guess else text


def fps_text(fps: Fraction | None) -> str:
    """Frame rate for people; a fraction beside it where it is not a short decimal."""
    if fps is None:
        return MISSING
    value = float(fps)
    text = f"{value:.6g}"
    exact = Fraction(text) == fps
    return f"{text} fps" if exact else f"{value:.7g} fps ({fps.numerator}/{fps.denominator})"


def ratio_text(recorded: Fraction | None, container: Fraction | None, *, guess: bool) -> str:
    """How much slower the footage plays than it was recorded."""
    if guess:
        return "not known: give the recorded rate"
    if recorded is None or container is None or container <= 0:
        return MISSING
    ratio = float(recorded / container)
    if abs(ratio - 1.0) < 1e-4:
        return "plays at the speed at which it was recorded"
    if ratio > 1.0:
        return f"plays {ratio:.4g} × slower than recorded"
    return f"plays {1.0 / ratio:.4g} × faster than recorded"
