"""Rows of the table of modes, and the verdicts in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.derived.signals import shown_mode
from modalcam.report.style.format import count, interval, significant, with_sd
from modalcam.report.style.text import sentence


@dataclass(frozen=True)
class ModeRow:
    """One mode as the table shows it; `frequency_hz` and `damping_ratio` are kept in full for machines."""

    anchor: str
    recording: str
    mode: IdentifiedMode
    number: str
    frequency: str
    frequency_interval: str
    damping: str
    damping_interval: str
    amplitude: str
    flags: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """A result in one line: `state` is "good", "care" or "failed"."""

    state: str
    text: str


def anchor_of(index: int) -> str:
    """Anchor of the section of the recording at `index`, 0 first."""
    return f"r{index + 1}"


def mode_rows(result: RunResult) -> tuple[ModeRow, ...]:
    """A row for each identified mode, in order of recordings, the mode a recording was made for first."""
    rows = []
    for index, recording in enumerate(result.recordings):
        if isinstance(recording.identification, Identification):
            modes = sorted(recording.identification.modes, key=lambda m: (not m.target, m.frequency_hz))
            rows += [_row(anchor_of(index), recording, mode) for mode in modes]
    return tuple(rows)


def mode_name(mode: IdentifiedMode) -> str:
    """``Mode 3``, or its frequency where the number is not known."""
    return (
        f"Mode {mode.number}"
        if mode.number is not None
        else f"Mode at {significant(mode.frequency_hz, 4)} Hz"
    )


def recording_verdict(recording: RecordingResult) -> Verdict:
    """What one recording gave."""
    found = recording.identification
    if recording.failure:
        return Verdict("failed", f"No result: {sentence(recording.failure)}")
    if not isinstance(found, Identification):
        return Verdict("failed", "No result: nothing was identified from this recording.")
    mode = shown_mode(found)
    if mode is None:
        return Verdict("failed", "No result: no mode was found.")
    name = "" if mode.number is None else f"{mode_name(mode)}: "
    text = (
        f"{name}{with_sd(mode.frequency_hz, mode.frequency_sd_hz)} Hz, "
        f"damping ratio {with_sd(100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd)} %"
    )
    if recording.mode is not None and not mode.target:
        return Verdict(
            "care", f"Mode {recording.mode}, for which it was made, was not found. Strongest: {text}."
        )
    return Verdict("care" if mode.flags else "good", f"{text}.")


def headline(result: RunResult) -> tuple[str, ...]:
    """What the run found, in one or two sentences."""
    if not result.recordings:
        return ("No recording was found in the folder, so there is nothing to report.",)
    good = [
        r
        for r in result.recordings
        if isinstance(r.identification, Identification) and r.identification.modes
    ]
    total = len(result.recordings)
    if not good:
        return (f"{_of(0, total)} gave a mode. The reasons are listed below.",)
    modes = [
        m for r in good if isinstance(r.identification, Identification) for m in _main_modes(r.identification)
    ]
    f = [m.frequency_hz for m in modes]
    z = [100.0 * m.damping_ratio for m in modes]
    if len(modes) == 1:
        span = f"{significant(f[0], 4)} Hz with a damping ratio of {significant(z[0], 3)} %"
    else:
        span = (
            f"{count(len(modes), 'mode')} from {significant(min(f), 4)} to {significant(max(f), 4)} Hz with damping "
            f"ratios from {significant(min(z), 2)} to {significant(max(z), 2)} %"
        )
    return (f"{_of(len(good), total)} gave a result: {span}.",)


def worst_sampler(mode: IdentifiedMode) -> float:
    """Largest R-hat of the mode; NaN where there is none."""
    values = [v for v in mode.posterior.r_hat if np.isfinite(v)]
    return max(values, default=float("nan"))


def _main_modes(found: Identification) -> list[IdentifiedMode]:
    mode = shown_mode(found)
    return [m for m in found.modes if m.target] or ([mode] if mode else [])


def _of(part: int, total: int) -> str:
    if total == 1:
        return "The recording" if part else "Not even the one recording"
    if part == total:
        return f"All {total} recordings"
    return f"{part or 'None'} of {total} recordings"


def _row(anchor: str, recording: RecordingResult, mode: IdentifiedMode) -> ModeRow:
    z, z_sd = 100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd
    low, high = mode.damping_interval()
    amplitude_sd = (
        float(mode.shape_sd[int(np.argmax(np.abs(mode.shape)))]) if mode.shape.size else float("nan")
    )
    return ModeRow(
        anchor=anchor,
        recording=recording.name,
        mode=mode,
        number="" if mode.number is None else str(mode.number),
        frequency=with_sd(mode.frequency_hz, mode.frequency_sd_hz),
        frequency_interval=interval(*mode.frequency_interval_hz(), mode.frequency_sd_hz),
        damping=with_sd(z, z_sd),
        damping_interval=interval(100.0 * low, 100.0 * high, z_sd),
        amplitude=f"{with_sd(mode.amplitude, amplitude_sd)} {mode.amplitude_unit}",
        flags=mode.flags,
    )
