"""Modes that several recordings show: their common value, and whether the recordings agree."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modal_id.modes.combine import DISAGREE, Combined
from modalcam.pipeline.measured import MeasuredMode, measured_modes
from modalcam.pipeline.results import RunResult
from modalcam.report.style.format import MISSING, fixed, with_sd


@dataclass(frozen=True)
class AcrossRow:
    """One mode of the beam over all recordings that show it."""

    mode: str
    recordings: tuple[str, ...]
    frequency: str
    damping: str
    p_values: str
    least_mac: str
    agrees: bool
    text: str


def across_rows(result: RunResult) -> tuple[AcrossRow, ...]:
    """A row for each mode that more than one recording gives a value of; empty where there is none."""
    return tuple(_row(mode) for mode in measured_modes(result.recordings) if len(mode.recordings) > 1)


def _row(mode: MeasuredMode) -> AcrossRow:
    wrong = [
        _disagreement(what, one, unit, scale)
        for what, one, unit, scale in (
            ("frequencies", mode.frequency, "Hz", 1.0),
            ("damping ratios", mode.damping, "%", 100.0),
        )
        if one.disagree
    ]
    return AcrossRow(
        mode=f"Mode {mode.number}",
        recordings=mode.recordings,
        frequency=f"{with_sd(mode.frequency_hz, mode.frequency_sd_hz)} Hz",
        damping=f"{with_sd(100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd)} %",
        p_values=f"{_p(mode.frequency.p_value)} / {_p(mode.damping.p_value)}",
        least_mac=fixed(mode.least_mac, 4) if math.isfinite(mode.least_mac) else MISSING,
        agrees=not wrong,
        text=" ".join(wrong) or "The recordings agree within their standard deviations.",
    )


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else fixed(value, 3)


def _disagreement(what: str, one: Combined, unit: str, scale: float) -> str:
    return (
        f"The {what} differ by more than chance (χ² = {one.chi_square:.3g}, {one.dof} degrees of freedom; p below "
        f"{DISAGREE:g}): between recordings they vary by {scale * one.between_sd:.2g} {unit}, which is part of the "
        "standard deviation. Look for what changed: amplitude, clamping, temperature, the recorded frame rate."
    )
