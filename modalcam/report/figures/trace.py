"""The sampler's draws in their order, and their autocorrelation."""

from __future__ import annotations

import numpy as np

from modal_id.flags import CHAIN_TOO_SHORT
from modal_id.results import IdentifiedMode
from modalcam.report.figures.axes import dots, few_ticks
from modalcam.report.style.palette import FIT, INK, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from tracker.arrays import FloatArray

_CAUSE = 1.01
_DOTS = 240
_LAGS = 100


def converged(mode: IdentifiedMode) -> bool:
    """Whether the sampler gives no cause to look at its draws: R-hat near 1 and the chain long enough."""
    r_hat = [value for value in mode.posterior.r_hat if np.isfinite(value)]
    return max(r_hat, default=np.inf) < _CAUSE and CHAIN_TOO_SHORT.name not in mode.flags


def trace_figure(figure_id: str, mode: IdentifiedMode) -> FigureView | None:
    """Damping ratio of every ensemble one after the other, and the mean autocorrelation; None without spread."""
    draws = 100.0 * mode.posterior.damping_ratio
    if draws.shape[1] < 2 * _LAGS or not np.all(np.isfinite(draws)) or np.any(np.ptp(draws, axis=1) == 0.0):
        return None
    ensembles, count = draws.shape
    order = np.arange(draws.size)
    every = max(1, draws.size // _DOTS)
    with figure_style(figure_id):
        figure = new_figure(2.3)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        dots(left, order[::every].astype(float), draws.ravel()[::every], MEASURED, 1.3, label="draws")
        running = np.cumsum(draws, axis=1) / np.arange(1, count + 1)
        for k in range(ensembles):
            part = slice(max(1, count // 50), None, max(1, count // 24))
            left.plot(
                k * count + np.arange(count)[part],
                running[k, part],
                color=FIT,
                linewidth=1.3,
                label="mean so far" if k == 0 else "_",
            )
            if k:
                left.axvline(k * count, color=INK, linewidth=0.5)
        left.set_xlabel("draw, ensembles one after the other")
        left.set_ylabel("damping ratio ζ (%)")
        right.axhline(0.0, color=INK, linewidth=0.5)
        right.plot(np.arange(_LAGS), _autocorrelation(draws), color=FIT, linewidth=1.0)
        right.set_xlabel("lag (draws)")
        right.set_ylabel("autocorrelation")
        for axes in (left, right):
            few_ticks(axes, x=5)
        left.legend(loc="upper right", borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Trace of the sampler",
            alt="Draws of the damping ratio in their order with the running mean of each ensemble, and their mean "
            "autocorrelation against the lag.",
            caption="A level band that looks alike in every ensemble, running means that meet, and an autocorrelation "
            "that is near zero from the first lags on are what a sampler that has converged shows. Draws are in the "
            "order in which they were kept, the walkers of a step beside each other.",
        )


def _autocorrelation(draws: FloatArray) -> FloatArray:
    """Mean over the ensembles, by Fourier transform with zeros appended; shape (lags,)."""
    centred = draws - np.mean(draws, axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * draws.shape[1], axis=1)) ** 2
    raw = np.fft.irfft(power, axis=1)[:, :_LAGS]
    return np.asarray(np.mean(raw / raw[:, :1], axis=0))
