"""Joint posterior of frequency and damping ratio with its marginals, and the sampler's draws in their order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter

from modal_id import IdentifiedMode, ModeFlag
from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.style import FIT, INK, MEASURED, Style, dots, few_ticks, fixed
from tracker import INTERVAL_ENDS, INTERVAL_LEVEL, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEVELS = (INTERVAL_LEVEL, 0.5)
_BINS = 48
_DOTS = 300


def _shows(subject: RecordingSubject) -> IdentifiedMode | None:
    target = subject.target()
    return None if target is None else target.mode


def _draw(figure: Figure, shown: IdentifiedMode) -> bool:
    frequency, y = shown.posterior.frequency_hz.ravel(), 100.0 * shown.posterior.damping_ratio.ravel()
    good = np.isfinite(frequency) & np.isfinite(y)
    frequency, y = frequency[good], y[good]
    if frequency.size < 2 or np.ptp(frequency) == 0.0 or np.ptp(y) == 0.0:
        return False
    spread = float(np.std(frequency))
    scale, unit = (1e6, "µHz") if spread < 2e-4 else (1e3, "mHz") if spread < 0.2 else (1.0, "Hz")
    decimals = int(np.clip(np.ceil(-np.log10(spread)) + 1, 2, 9))
    x = (frequency - round(shown.frequency_hz, decimals)) * scale
    grid = figure.add_gridspec(2, 2, width_ratios=(4, 1), height_ratios=(1, 3))
    main = figure.add_subplot(grid[1, 0])
    _joint(main, x, y)
    _marginal(figure.add_subplot(grid[0, 0], sharex=main), x, horizontal=False)
    _marginal(figure.add_subplot(grid[1, 1], sharey=main), y, horizontal=True)
    few_ticks(main, x=6, y=6)
    xlabel = f"natural frequency − {fixed(shown.frequency_hz, decimals)} Hz ({unit})"
    main.set(xlabel=xlabel, ylabel="damping ratio ζ (%)")
    main.legend(markerscale=2.0)
    return True


def _joint(axes: Axes, x: FloatArray, y: FloatArray) -> None:
    ranges = [_padded(x), _padded(y)]
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=_BINS, range=ranges)
    density = gaussian_filter(counts, 1.6, mode="constant")
    levels = [_region_level(density, level) for level in _LEVELS]
    every = max(1, x.size // _DOTS)
    dots(axes, x[::every], y[::every], MEASURED, 1.5, label="draws")
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (x_edges, y_edges)]
    style: Style = {"colors": [FIT], "linewidths": [1.6, 1.0], "linestyles": ["-", "--"]}
    if levels[0] < levels[1]:
        axes.contour(*middles, density.T, levels=levels, **style)
    axes.plot([], [], "-", color=FIT, linewidth=1.6, label="90 % region")
    axes.plot([], [], "--", color=FIT, linewidth=1.0, label="50 % region")
    axes.set(xlim=ranges[0], ylim=ranges[1])


def _marginal(axes: Axes, values: FloatArray, *, horizontal: bool) -> None:
    counts, edges = np.histogram(values, bins=40, range=_padded(values))
    style: Style = {"orientation": "horizontal" if horizontal else "vertical", "fill": True}
    axes.stairs(counts, edges, facecolor=FIT, alpha=0.25, edgecolor=FIT, **style)
    for quantile, width in ((INTERVAL_ENDS[0], 0.8), (0.5, 1.4), (INTERVAL_ENDS[1], 0.8)):
        line = axes.axhline if horizontal else axes.axvline
        line(float(np.quantile(values, quantile)), color=INK, linewidth=width)
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(labelleft=False, labelbottom=False, left=False, bottom=False)


def _padded(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.001, 0.999])
    margin = 0.08 * (high - low)
    return float(low - margin), float(high + margin)


def _region_level(density: FloatArray, share: float) -> float:
    """Density that encloses `share` of the total."""
    ordered = np.sort(density.ravel())[::-1]
    cumulated = np.cumsum(ordered)
    return float(ordered[min(np.searchsorted(cumulated, share * cumulated[-1]), ordered.size - 1)])


POSTERIOR = FigureKind("posterior", "recording", _shows, _draw, height_in=3.5, width_in=6.2, essential=True)


@dataclass(frozen=True)
class Tuning:
    """Which chains are shown."""

    #: [1] chains with a larger R-hat are shown for inspection
    #: convention: Vehtari et al. 2021, doi:10.1214/20-BA1221.
    r_hat: float = 1.01


TUNING = Tuning()
_DOTS_OF_TRACE = 240
_LAGS = 100


def converged(mode: IdentifiedMode) -> bool:
    """Whether R-hat is near 1 and the chain long enough, or there is no chain, so that the draws need no inspection."""
    if np.isnan(mode.posterior.acceptance):
        return True
    r_hat = [value for value in mode.posterior.r_hat if np.isfinite(value)]
    return max(r_hat, default=np.inf) < TUNING.r_hat and ModeFlag.CHAIN_TOO_SHORT.name not in mode.flags


def _shows_trace(subject: RecordingSubject) -> FloatArray | None:
    """Draws of the damping ratio in percent, shape (ensembles, draws), unless they need no inspection."""
    target = subject.target()
    if target is None or converged(target.mode):
        return None
    draws = 100.0 * target.mode.posterior.damping_ratio
    good = draws.shape[1] >= 2 * _LAGS and np.all(np.isfinite(draws)) and np.all(np.ptp(draws, axis=1) > 0.0)
    return draws if good else None


def _draw_trace(figure: Figure, draws: FloatArray) -> None:
    ensembles, count = draws.shape
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    order = np.arange(draws.size, dtype=np.float64)
    every = max(1, draws.size // _DOTS_OF_TRACE)
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


TRACE = FigureKind("trace", "recording", _shows_trace, _draw_trace, height_in=2.3)
