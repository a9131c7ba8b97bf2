"""Figures of the page: damping ratios, decays and their envelopes, and the paper's variables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from modalcam.apps.paper.recomputed import Recomputed
from modalcam.apps.paper.tables import Decay, Measured
from modalcam.pipeline import RunResult
from modalcam.report import measured_envelope, shown_channel
from modalcam.report.figures import (
    DAMPING,
    SIMULATED,
    DampingPoint,
    Reference,
    damping_shown,
    measured_point,
    simulated_shown,
)
from modalcam.report.style import (
    ALERT,
    FIT,
    MEASURED,
    MUTED,
    RAYLEIGH,
    FigureView,
    dots,
    few_ticks,
    figure_style,
    figure_svg,
    legend_above,
    log_y,
    new_figure,
)
from sim import reference as printed
from sim.damping import DAMPING_MODELS
from sim.updating import PaperUpdate
from tracker import FloatArray

_COLUMNS = 3


def damping_ratios(
    result: RunResult, measured: Sequence[Measured], shown: Sequence[Decay], paper: Recomputed
) -> FigureView | None:
    """Damping ratio against frequency: printed, measured and simulated."""
    points = [measured_point(row.mode) for row in measured if row.mode is not None]
    table = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    own = tuple(DampingPoint(f, z) for f, z in table)
    reference = Reference("paper, Table 2", own, paper.equations.alpha_1_s, paper.equations.beta_s)
    simulated = [(model, decay.mode.damping_ratio) for decay in shown for model in decay.models]
    data = damping_shown(points, simulated, result.beam, reference)
    return None if data is None else DAMPING.view("paper-damping", data)


def decay_figures(shown: Sequence[Decay]) -> list[tuple[Decay, FigureView]]:
    """Each decay with its figure."""
    out = []
    for decay in shown:
        channel = decay.found.series.channels[shown_channel(decay.found)]
        data = simulated_shown(decay.comparison, channel)
        view = None if data is None else SIMULATED.view(f"paper-decay-{decay.number}", data)
        if view is not None:
            out.append((decay, view))
    return out


def envelopes(shown: Sequence[Decay]) -> str:
    """SVG of the amplitude of each decay on a logarithmic axis: measured, and with the damping of each simulation."""
    rows = -(-len(shown) // _COLUMNS)
    with figure_style():
        figure = new_figure(0.5 + 1.9 * rows)
        panels = figure.subplots(rows, min(_COLUMNS, len(shown)), squeeze=False).ravel()
        for axes, decay in zip(panels, shown, strict=False):
            _envelope(axes, decay)
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
        figure.supxlabel("time since the start of the fit (s)", fontsize=8.5)
        figure.supylabel(f"amplitude ({shown[0].found.series.unit})", fontsize=8.5)
        legend_above(figure, panels[0].get_legend_handles_labels(), columns=3)
        return figure_svg(figure)


def _envelope(axes: Axes, decay: Decay) -> None:
    channel = shown_channel(decay.found)
    mode, start = decay.mode, decay.found.onset.fit_from_s
    time_s, amplitude = measured_envelope(decay.found, mode, channel)
    size = float(np.abs(mode.shape[channel]))
    end = float(time_s[-1]) - start if time_s.size else 1.0 / mode.frequency_hz
    axis_s = np.linspace(0.0, end, 40)

    def line(ratio: float) -> FloatArray:
        return np.asarray(size * np.exp(-ratio * mode.omega_n_rad_s * axis_s))

    high, low = (line(ratio) for ratio in mode.damping_interval())
    axes.fill_between(axis_s, low, high, color=MEASURED, alpha=0.3, linewidth=0)
    positive = amplitude > 0.0
    dots(axes, time_s[positive] - start, amplitude[positive], MEASURED, 2.6, label="measured")
    for model in decay.models:
        entry, values = DAMPING_MODELS[model.model], line(model.damping_ratio)
        if np.all(np.isfinite(values)):
            axes.plot(axis_s, values, entry.line_style, color=entry.colour, linewidth=1.5, label=entry.name)
    few_ticks(axes, x=4)
    log_y(axes, (1.0, 2.0, 5.0))
    # Two decades at most: below are noise and lines far from the dots.
    lowest = 0.5 * float(min(low[-1], amplitude[positive].min(initial=size)))
    axes.set(title=f"Mode {decay.number} ({decay.panel})", ylim=(max(size * 1e-2, lowest), 1.6 * size))


def variables(update: PaperUpdate) -> str:
    """SVG of the fitted width and thickness of each element, with the bound."""
    edges_mm = np.linspace(0.0, 1e3 * update.properties.length_m, update.width_factor.size + 1)
    middle_mm = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    limit = 100.0 * update.bound
    with figure_style():
        figure = new_figure(2.3)
        axes = figure.subplots()
        for value, label in ((-limit, "_"), (limit, "bound")):
            axes.axhline(value, color=ALERT, linewidth=1.0, linestyle=(0, (1, 2)), label=label)
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        for factors, colour, dash, label in (
            (update.thickness_factor, FIT, "-", "thickness"),
            (update.width_factor, RAYLEIGH, "--", "width"),
        ):
            change = 100.0 * (factors - 1.0)
            axes.stairs(
                change, edges_mm, baseline=None, label=label, color=colour, linewidth=1.4, linestyle=dash
            )
            at = np.abs(np.abs(change) - limit) < 1e-4
            axes.plot(middle_mm[at], change[at], "s", color=colour, markersize=4.0)
        few_ticks(axes, x=10)
        axes.set(
            xlabel="distance from the clamp (mm)", ylabel="change (%)", ylim=(-1.35 * limit, 1.35 * limit)
        )
        legend_above(figure, columns=3)
        return figure_svg(figure)
