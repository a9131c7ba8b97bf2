"""The sampler's draws in their order, and their autocorrelation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modal_id import IdentifiedMode, ModeFlag
from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.style import FIT, INK, MEASURED, dots, few_ticks
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SUSPECT_R_HAT = 1.01
_DOTS = 240
_LAGS = 100


def converged(mode: IdentifiedMode) -> bool:
    """Whether R-hat is near 1 and the chain long enough, so that the draws need no inspection."""
    r_hat = [value for value in mode.posterior.r_hat if np.isfinite(value)]
    return max(r_hat, default=np.inf) < _SUSPECT_R_HAT and ModeFlag.CHAIN_TOO_SHORT.name not in mode.flags


def _shows(subject: RecordingSubject) -> FloatArray | None:
    """Draws of the damping ratio in percent, shape (ensembles, draws), unless they need no inspection."""
    target = subject.target()
    if target is None or converged(target.mode):
        return None
    draws = 100.0 * target.mode.posterior.damping_ratio
    good = draws.shape[1] >= 2 * _LAGS and np.all(np.isfinite(draws)) and np.all(np.ptp(draws, axis=1) > 0.0)
    return draws if good else None


def _draw(figure: Figure, draws: FloatArray) -> None:
    ensembles, count = draws.shape
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    order = np.arange(draws.size, dtype=np.float64)
    every = max(1, draws.size // _DOTS)
    dots(left, order[::every], draws.ravel()[::every], MEASURED, 1.3, label="draws")
    running = np.cumsum(draws, axis=1) / np.arange(1, count + 1)
    part = slice(max(1, count // 50), None, max(1, count // 24))
    for k in range(ensembles):
        at = k * count + np.arange(count)[part]
        left.plot(at, running[k, part], color=FIT, linewidth=1.3, label="_" if k else "running mean")
        if k:
            left.axvline(k * count, color=INK, linewidth=0.5)
    left.set(xlabel="draw, ensembles one after the other", ylabel="damping ratio ζ (%)")
    right.axhline(0.0, color=INK, linewidth=0.5)
    right.plot(np.arange(_LAGS), _autocorrelation(draws), color=FIT, linewidth=1.0)
    right.set(xlabel="lag (draws)", ylabel="autocorrelation")
    for axes in (left, right):
        few_ticks(axes, x=5)
    left.legend()


def _autocorrelation(draws: FloatArray) -> FloatArray:
    """Mean over the ensembles, by Fourier transform with zeros appended; shape (lags,)."""
    centred = draws - np.mean(draws, axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * draws.shape[1], axis=1)) ** 2
    raw = np.fft.irfft(power, axis=1)[:, :_LAGS]
    return np.asarray(np.mean(raw / raw[:, :1], axis=0))


TRACE = FigureKind("trace", "recording", _shows, _draw, height_in=2.3)
