"""Delay of the rows of an image, from the phases of mode shapes along them: a rolling shutter that was not stated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modal_id.modes.shapes import in_phase
from modal_id.results import Identification, IdentifiedMode
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The delay of rows."""

    #: [1] least signal over noise of the modes and channels used
    least_snr: float = 20.0
    #: [1] fewest such channels
    least_channels: int = 5
    #: [sd] least delay that is reported
    #: statistics: Noise exceeds it once in 5e8.
    clear_sd: float = 6.0
    #: [rad] least change of phase from the first to the last channel
    least_phase: float = 0.01
    #: [1] the same, over the damping ratio
    #: physics: Shapes with unevenly distributed damping are complex by about the damping ratio.
    least_ratios: float = 5.0
    #: [1] number of groups of neighbouring channels, each left out once
    #: convention: Their errors may be correlated.
    groups: int = 8
    #: [sd] largest difference between modes that agree
    #: convention: Eight groups know an sd to a quarter.
    agree_sd: float = 6.0
    #: [1] number of passes
    passes: int = 4
    #: [1] largest readout time over the time between frames
    #: physics: 1, but for the error of the delay.
    longest_readout: float = 1.05


TUNING = Tuning()


class RowDelay(NamedTuple):
    """Time from one row of the image to the next and its standard deviation, in s; negative from the bottom up."""

    per_row_s: float
    sd_s: float


def row_delay(found: Identification, rows_px: FloatArray) -> RowDelay | None:
    """Delay of the rows that explains the phases of the shapes; None where there is none to be seen.

    Parameters
    ----------
    found : Identification
    rows_px : array, shape (k,)
        Row of each channel at rest, y down; NaN where unknown.

    Notes
    -----
    A channel that is exposed later by the time t has a phase larger by omega t. The out-of-phase part of each shape is
    regressed on the in-phase part and on that times the row, weighted by their sd; the sd of the slope is that of the
    jackknife over groups of neighbouring channels. All modes must agree.
    """
    each = [(mode, _slope(mode, rows_px)) for mode in found.modes]
    known = [(mode, delay) for mode, delay in each if delay is not None]
    if not known:
        return None
    values, sd = np.array([delay for _, delay in known]).T
    weights = sd**-2 / np.sum(sd**-2)
    per_row, total_sd = float(weights @ values), float(np.sum(sd**-2) ** -0.5)
    clearest = known[int(np.argmin(sd))][0]
    span = float(np.ptp(rows_px[np.isfinite(rows_px) & np.isfinite(clearest.shape)]))
    phase = abs(per_row) * span * clearest.omega_n_rad_s
    if (
        abs(per_row) < TUNING.clear_sd * total_sd
        or phase < max(TUNING.least_phase, TUNING.least_ratios * clearest.damping_ratio)
        or np.any(np.abs(values - per_row) > TUNING.agree_sd * np.hypot(sd, total_sd))
    ):
        return None
    return RowDelay(per_row, total_sd)


def readout_note(found: Identification, rows_px: FloatArray, height_px: int) -> str:
    """Sentence on a rolling shutter that the shapes show, in an image of `height_px` rows; empty without one."""
    delay = row_delay(found, rows_px)
    if delay is None:
        return ""
    readout_s, sd_s = (height_px - 1) * np.array(delay)
    if abs(readout_s) > TUNING.longest_readout * float(np.median(np.diff(found.series.time_s))):
        return ""
    grow = "grow" if readout_s > 0.0 else "fall"
    return (
        f"The phases of the mode shapes {grow} down the image by {1e6 * abs(delay.per_row_s):.3g} ± "
        f"{1e6 * delay.sd_s:.1g} µs per row: a rolling shutter exposes one row after another. Set readout_s = "
        f"{readout_s:.3g} in [camera] (sd {sd_s:.1g} s), so that all markers refer to one time."
    )


def _slope(mode: IdentifiedMode, rows_px: FloatArray) -> RowDelay | None:
    """Delay per row of one mode; None where too few channels tell."""
    good = np.isfinite(rows_px) & np.isfinite(mode.shape) & np.isfinite(mode.shape_sd) & (mode.shape_sd > 0.0)
    if np.count_nonzero(good) < TUNING.least_channels or not np.ptp(rows_px[good]) > 1.0:
        return None
    order = np.flatnonzero(good)[np.argsort(rows_px[good], kind="stable")]
    shape, sd, rows = mode.shape[order], mode.shape_sd[order], rows_px[order]
    if np.max(np.abs(shape) / sd) < TUNING.least_snr:
        return None
    everything = np.ones(order.size, dtype=bool)
    whole = _phase_slope(shape, sd, rows, everything)
    groups = np.array_split(np.arange(order.size), min(TUNING.groups, order.size))
    without = []
    for group in groups:
        kept = everything.copy()
        kept[group] = False
        without.append(_phase_slope(shape, sd, rows, kept)[0])
    jackknife = (len(groups) - 1.0) / len(groups) * np.sum((np.array(without) - whole[0]) ** 2)
    slope_sd = max(float(np.sqrt(jackknife)), whole[1])
    return RowDelay(whole[0] / mode.omega_n_rad_s, slope_sd / mode.omega_n_rad_s)


def _phase_slope(
    shape: ComplexArray, sd: FloatArray, rows: FloatArray, kept: BoolArray
) -> tuple[float, float]:
    """Change of the phase per row and its sd for white noise."""
    shape, weight, along = shape[kept], 1.0 / sd[kept], rows[kept] - np.mean(rows)
    shape = in_phase(shape)
    phase = np.zeros(2)
    for _ in range(TUNING.passes):
        turned = shape * np.exp(-1j * (phase[0] + phase[1] * along))
        design = (turned.real * weight)[:, None] * np.stack([np.ones_like(along), along], axis=1)
        covariance = np.linalg.pinv(design.T @ design, hermitian=True)
        phase = phase + covariance @ (design.T @ (turned.imag * weight))
    return float(phase[1]), float(np.sqrt(covariance[1, 1]))
