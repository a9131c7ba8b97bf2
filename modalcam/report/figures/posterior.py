"""Joint posterior of frequency and damping ratio, with its marginals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter

from modal_id.results import IdentifiedMode
from modalcam.report.figures.axes import dots, few_ticks
from modalcam.report.style.format import fixed
from modalcam.report.style.palette import FIT, INK, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from tracker.arrays import FloatArray

_LEVELS = (0.9, 0.5)
_BINS = 48
_DOTS = 300


def posterior_figure(figure_id: str, mode: IdentifiedMode) -> FigureView | None:
    """Draws, the regions that hold 50 and 90 % of them, and both marginals; None without finite draws."""
    frequency = mode.posterior.frequency_hz.ravel()
    damping = 100.0 * mode.posterior.damping_ratio.ravel()
    good = np.isfinite(frequency) & np.isfinite(damping)
    frequency, damping = frequency[good], damping[good]
    if frequency.size < 2 or np.ptp(frequency) == 0.0 or np.ptp(damping) == 0.0:
        return None
    scale, unit = _frequency_unit(frequency)
    decimals = _offset_decimals(frequency)
    x = (frequency - round(mode.frequency_hz, decimals)) * scale
    with figure_style(figure_id):
        figure = new_figure(3.5, 6.2)
        grid = figure.add_gridspec(2, 2, width_ratios=(4, 1), height_ratios=(1, 3))
        main = figure.add_subplot(grid[1, 0])
        above = figure.add_subplot(grid[0, 0], sharex=main)
        beside = figure.add_subplot(grid[1, 1], sharey=main)
        _joint(main, x, damping)
        _marginal(above, x, horizontal=False)
        _marginal(beside, damping, horizontal=True)
        few_ticks(main, x=6, y=6)
        main.set_xlabel(f"natural frequency − {fixed(mode.frequency_hz, decimals)} Hz ({unit})")
        main.set_ylabel("damping ratio ζ (%)")
        main.legend(loc="upper right", markerscale=2.0, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Posterior of frequency and damping ratio",
            alt="Scatter of posterior draws of natural frequency against damping ratio with the regions that hold 50 "
            "and 90 percent of them, and a histogram of each with its 5, 50 and 95 percent quantiles.",
            caption="One compact, roughly elliptic cloud is what a well-determined mode gives. Several islands, a "
            "cloud cut off at ζ = 0, or a strong tilt are reasons for care. Lines on the histograms are the 5, 50 and "
            "95 % quantiles quoted in the table.",
        )


def _joint(axes: Axes, x: FloatArray, y: FloatArray) -> None:
    ranges = [_padded(x), _padded(y)]
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=_BINS, range=ranges)
    density = gaussian_filter(counts, 1.6, mode="constant")
    levels = [_region_level(density, level) for level in _LEVELS]
    every = max(1, x.size // _DOTS)
    dots(axes, x[::every], y[::every], MEASURED, 1.5, label="draws")
    x_mid, y_mid = 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1])
    if levels[0] < levels[1]:
        axes.contour(
            x_mid,
            y_mid,
            density.T,
            levels=levels,
            colors=[FIT],
            linewidths=[1.6, 1.0],
            linestyles=["-", "--"],
        )
    axes.plot([], [], "-", color=FIT, linewidth=1.6, label="90 % region")
    axes.plot([], [], "--", color=FIT, linewidth=1.0, label="50 % region")
    axes.set_xlim(*ranges[0])
    axes.set_ylim(*ranges[1])


def _marginal(axes: Axes, values: FloatArray, *, horizontal: bool) -> None:
    counts, edges = np.histogram(values, bins=40, range=_padded(values))
    axes.stairs(
        counts,
        edges,
        orientation="horizontal" if horizontal else "vertical",
        fill=True,
        facecolor=FIT,
        alpha=0.25,
        edgecolor=FIT,
    )
    for quantile, width in ((0.05, 0.8), (0.5, 1.4), (0.95, 0.8)):
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
    """Density above which `share` of the whole lies."""
    ordered = np.sort(density.ravel())[::-1]
    held = np.cumsum(ordered)
    return float(ordered[min(np.searchsorted(held, share * held[-1]), ordered.size - 1)])


def _frequency_unit(frequency_hz: FloatArray) -> tuple[float, str]:
    spread = float(np.std(frequency_hz))
    if spread < 2e-4:
        return 1e6, "µHz"
    return (1e3, "mHz") if spread < 0.2 else (1.0, "Hz")


def _offset_decimals(frequency_hz: FloatArray) -> int:
    spread = float(np.std(frequency_hz))
    return int(np.clip(np.ceil(-np.log10(spread)) + 1, 2, 9))
