"""The modes of all recordings: the headline, the table, and each recording's result in one line."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.measured import MeasuredMode, measured_modes
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.derived.signals import shown_mode
from modalcam.report.sections.alerts import anchor_of
from modalcam.report.style.format import significant


class ModeRow(NamedTuple):
    """One mode of the table; `amplitude_sd` in the unit of its amplitude."""

    anchor: str
    recording: str
    mode: IdentifiedMode
    amplitude_sd: float


class Headline(NamedTuple):
    """Number of recordings, of those with a mode, and the main modes of these."""

    total: int
    good: int
    modes: tuple[IdentifiedMode, ...]


def mode_rows(result: RunResult) -> tuple[ModeRow, ...]:
    """A row for each identified mode, in order of recordings, targets first."""
    rows = []
    for index, recording in enumerate(result.recordings):
        if isinstance(recording.identification, Identification):
            modes = sorted(recording.identification.modes, key=lambda m: (not m.target, m.frequency_hz))
            rows += [ModeRow(anchor_of(index), recording.name, m, _amplitude_sd(m)) for m in modes]
    return tuple(rows)


def headline(result: RunResult) -> Headline:
    """What the run found."""
    found = [r.identification for r in result.recordings if isinstance(r.identification, Identification)]
    good = [identification for identification in found if identification.modes]
    modes = [mode for identification in good for mode in _main_modes(identification)]
    return Headline(len(result.recordings), len(good), tuple(modes))


def across_rows(result: RunResult) -> tuple[MeasuredMode, ...]:
    """Modes that more than one recording gives a value of."""
    return tuple(mode for mode in measured_modes(result.recordings) if len(mode.recordings) > 1)


def state_of(recording: RecordingResult) -> str:
    """Quality of a recording's result: "good", "care" or "failed"."""
    found = recording.identification
    mode = shown_mode(found) if isinstance(found, Identification) else None
    if recording.failure or mode is None:
        return "failed"
    return "care" if mode.flags or (recording.mode is not None and not mode.target) else "good"


def mode_name(mode: IdentifiedMode) -> str:
    """``Mode 3``, or its frequency if its number is unknown."""
    if mode.number is None:
        return f"Mode at {significant(mode.frequency_hz, 4)} Hz"
    return f"Mode {mode.number}"


def _main_modes(found: Identification) -> list[IdentifiedMode]:
    mode = shown_mode(found)
    return [m for m in found.modes if m.target] or ([mode] if mode else [])


def _amplitude_sd(mode: IdentifiedMode) -> float:
    return float(mode.shape_sd[int(np.argmax(np.abs(mode.shape)))]) if mode.shape.size else float("nan")
