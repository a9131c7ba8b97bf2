"""How far a vibration that was not fitted can have shifted the frequency and the damping ratio of a mode."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modal_id.fit.poles import pole
from modal_id.results import Identification, IdentifiedMode
from tracker.arrays import FloatArray

# Step of the numerical derivative by the damping ratio and, relative, by the frequency.
_STEP = 1e-6


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
        slopes = _without(_waves(mode, time_s), _slopes(mode, time_s, int(channel)))
        phase = 2.0 * np.pi * line_hz * time_s
        quadratures = np.stack([np.cos(phase), np.sin(phase)], axis=1)
        size = np.linalg.lstsq(quadratures, own, rcond=None)[0]
        # In phase with the fitted vibration, and a quarter of a cycle later: all channels may move with either.
        line = quadratures @ np.array([[size[0], size[1]], [size[1], -size[0]]]).T
        variance = max(float(np.var(own)), np.finfo(float).tiny)
        normal += slopes.T @ slopes / variance
        right += slopes.T @ line / variance
    if np.linalg.matrix_rank(normal) < 2:
        return LineEffect(np.nan, np.nan)
    relative, damping = np.linalg.norm(np.linalg.solve(normal, right), axis=1)
    return LineEffect(float(relative) * mode.frequency_hz, float(damping))


def _waves(mode: IdentifiedMode, time_s: FloatArray) -> FloatArray:
    wave = np.exp(pole(mode.omega_n_rad_s, mode.damping_ratio) * time_s)
    return np.stack([wave.real, wave.imag], axis=1)


def _slopes(mode: IdentifiedMode, time_s: FloatArray, channel: int) -> FloatArray:
    """Derivatives of the channel's motion by log frequency and by the damping ratio; shape (n, 2)."""

    def motion(factor: float, change: float) -> FloatArray:
        moved = pole(mode.omega_n_rad_s * factor, mode.damping_ratio + change)
        return np.real(mode.shape[channel] * np.exp(moved * time_s))

    pairs = ((motion(1.0 + _STEP, 0.0), motion(1.0 - _STEP, 0.0)), (motion(1.0, _STEP), motion(1.0, -_STEP)))
    return np.stack([(up - down) / (2.0 * _STEP) for up, down in pairs], axis=1)


def _without(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns with their projection on the basis subtracted."""
    orthonormal, _ = np.linalg.qr(basis)
    return np.asarray(columns - orthonormal @ (orthonormal.T @ columns))
