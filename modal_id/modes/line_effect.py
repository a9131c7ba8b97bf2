"""How far a vibration that was not fitted can have shifted the frequency and the damping ratio of a mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modal_id.solve import pole
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Numerical derivatives."""

    #: [1] step of the damping ratio and, relative, of the frequency
    #: physics: Between rounding and curvature.
    step: float = 1e-6


TUNING = Tuning()

# Columns of `_products`, and samples of which they are held at a time.
_WAVES, _SLOPES, _LINE, _OWN = slice(0, 2), slice(2, 4), slice(4, 6), 6
_BLOCK = 65_536


class LineEffect(NamedTuple):
    """Change of the frequency in Hz and of the damping ratio, each without a sign."""

    frequency_hz: float
    damping_ratio: float


def line_effect(found: Identification, mode: IdentifiedMode, line_hz: float) -> LineEffect:
    """Largest first-order change of a mode's values by a steady vibration at `line_hz` that its residual contains.

    Parameters
    ----------
    found : Identification
    mode : IdentifiedMode
        One of its modes.
    line_hz : float
        Frequency of the vibration. Its amplitude and phase in each channel are those that fit the residual best.

    Notes
    -----
    The linearised fit of Eq. 1, amplitudes free in each channel, applied to the vibration instead of the record. The
    residual holds what the fit left of the vibration: below a distance of about one bin, ``1 / span``, from the mode
    the change is underestimated. A vibration that decays changes the values less than a steady one.
    """
    normal, right = np.zeros((2, 2)), np.zeros((2, 2))
    residual = found.series.values - found.fitted
    for channel in np.flatnonzero(found.channels_used & np.isfinite(mode.shape)):
        rows = found.used[:, channel] & np.isfinite(residual[:, channel])
        if np.count_nonzero(rows) < 8:
            continue
        time_s = found.series.time_s[rows] - found.onset.fit_from_s
        own = residual[rows, channel]
        products = _products(mode, int(channel), line_hz, time_s, own)
        size = np.linalg.lstsq(products[_LINE, _LINE], products[_LINE, _OWN], rcond=None)[0]
        # In phase with the fitted vibration, and a quarter of a cycle later: all channels may move with either.
        line = np.array([[size[0], size[1]], [size[1], -size[0]]]).T
        absorbed = np.linalg.solve(products[_WAVES, _WAVES], products[_WAVES, :])
        left = products[_SLOPES, :] - products[_SLOPES, _WAVES] @ absorbed
        variance = max(float(np.var(own)), np.finfo(float).tiny)
        normal += left[:, _SLOPES] / variance
        right += left[:, _LINE] @ line / variance
    if np.linalg.matrix_rank(normal) < 2:
        return LineEffect(np.nan, np.nan)
    relative, damping = np.linalg.norm(np.linalg.solve(normal, right), axis=1)
    return LineEffect(float(relative) * mode.frequency_hz, float(damping))


def _products(
    mode: IdentifiedMode, channel: int, line_hz: float, time_s: FloatArray, own: FloatArray
) -> FloatArray:
    """Inner products of the columns of one channel: its waves, slopes and vibration, then `own`; shape (7, 7)."""
    total = np.zeros((_OWN + 1, _OWN + 1))
    for first in range(0, time_s.size, _BLOCK):
        rows = slice(first, first + _BLOCK)
        t = time_s[rows]
        phase = 2.0 * np.pi * line_hz * t
        waves, slopes = _waves(mode, t), _slopes(mode, t, channel)
        columns = np.column_stack([waves, slopes, np.cos(phase), np.sin(phase), own[rows]])
        total += columns.T @ columns
    return total


def _waves(mode: IdentifiedMode, time_s: FloatArray) -> FloatArray:
    wave = np.exp(pole(mode.omega_n_rad_s, mode.damping_ratio) * time_s)
    return np.stack([wave.real, wave.imag], axis=1)


def _slopes(mode: IdentifiedMode, time_s: FloatArray, channel: int) -> FloatArray:
    """Derivatives of the channel's motion by log frequency and by the damping ratio; shape (n, 2)."""

    def motion(factor: float, change: float) -> FloatArray:
        moved = pole(mode.omega_n_rad_s * factor, mode.damping_ratio + change)
        return np.real(mode.shape[channel] * np.exp(moved * time_s))

    pairs = (
        (motion(1.0 + TUNING.step, 0.0), motion(1.0 - TUNING.step, 0.0)),
        (motion(1.0, TUNING.step), motion(1.0, -TUNING.step)),
    )
    return np.stack([(up - down) / (2.0 * TUNING.step) for up, down in pairs], axis=1)
