"""Checks of the fit in words: what was looked at, what it says, what to try."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modal_id.modes.residual_checks import Check, residual_checks
from modal_id.modes.shapes import mpc
from modal_id.results import Identification
from modalcam.report.derived.signals import shown_mode
from modalcam.report.style.format import fixed, significant
from modalcam.report.style.text import sentence

_STRAIGHT = 0.95
_MIN_CHANNELS = 3


@dataclass(frozen=True)
class CheckRow:
    """One check as the table shows it."""

    name: str
    value: str
    typical: str
    p_value: str
    holds: bool
    text: str


def check_rows(found: Identification) -> tuple[CheckRow, ...]:
    """Checks of the residual and of the shape's phases; empty where there is no mode."""
    rows = [_row(check) for check in residual_checks(found)]
    mode = shown_mode(found)
    if mode is not None and int(found.channels_used.sum()) >= _MIN_CHANNELS:
        value = mpc(mode.shape[found.channels_used])
        if math.isfinite(value):
            rows.append(_collinearity(value))
    return tuple(rows)


def _row(check: Check) -> CheckRow:
    return CheckRow(
        sentence(check.name).rstrip("."),
        significant(check.value, 3),
        significant(check.typical, 3),
        "< 0.003" if check.p_value < 0.003 else fixed(check.p_value, 3),
        check.holds,
        "As expected." if check.holds else f"{check.cause} {check.remedy}",
    )


def _collinearity(value: float) -> CheckRow:
    holds = value > _STRAIGHT
    text = (
        "The markers move in phase or against it, as in a normal mode."
        if holds
        else "The markers do not move in phase: a wave travels, two modes are mixed, or a rolling shutter's delays "
        "were not corrected. Look at the shape; give readout_s."
    )
    return CheckRow("Modal phase collinearity (MPC)", fixed(value, 4), "1", "", holds, text)
