"""Figures of the page: damping ratios, envelopes of the five decays, and the paper's variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from modalcam.paper.decays import Decay
from modalcam.paper.recomputed import Recomputed
from modalcam.paper.table2 import Row
from modalcam.pipeline.results import BeamResult, RunResult
from modalcam.report.derived.signals import measured_envelope, shown_channel
from modalcam.report.figures.axes import dots, few_ticks, log_y
from modalcam.report.figures.damping import DAMPING, DampingPoint, Reference, damping_shown
from modalcam.report.style.damping_models import model_colour, model_line_style, model_name
from modalcam.report.style.format import percent
from modalcam.report.style.palette import ALERT, FIT, MEASURED, MUTED, RAYLEIGH, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from sim.reference import paper_tables as printed
from sim.updating import PaperUpdate
from tracker.arrays import FloatArray

_COLUMNS = 3


def damping_ratios(
    result: RunResult, measured: Sequence[Row], shown: Sequence[Decay], paper: Recomputed
) -> FigureView | None:
    """Damping ratio against frequency: printed, measured and simulated."""
    points = [
        DampingPoint(
            row.frequency.value,
            0.01 * row.damping.value,
            0.01 * row.damping.interval_90[0],
            0.01 * row.damping.interval_90[1],
            f"mode {row.number}",
        )
        for row in measured
    ]
    table = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    reference = Reference(
        "paper, Table 2",
        tuple(DampingPoint(f, z) for f, z in table),
        paper.equations.alpha_1_s,
        paper.equations.beta_s,
    )
    simulated = [model for decay in shown for model in decay.models]
    data = damping_shown(points, simulated, result.beam, reference)
    view = None if data is None else DAMPING.view("paper-damping", data)
    if view is None:
        return None
    caption = (
        f"{view.caption} Diamonds: the paper’s Table 2; dotted curve: Eq. 3 and 4 through its modes 1 and 2."
    )
    return replace(view, title="Damping ratios: paper and recordings", caption=caption)


def envelopes(shown: Sequence[Decay]) -> FigureView | None:
    """Amplitude of each decay on a logarithmic axis: measured, and with the damping of each simulation."""
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    with figure_style():
        figure = new_figure(0.5 + 1.9 * rows)
        grid = figure.subplots(rows, min(_COLUMNS, len(shown)), squeeze=False)
        panels = list(grid.flat)
        for axes, decay in zip(panels, shown, strict=False):
            _envelope(axes, decay)
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
        figure.supxlabel("time since the start of the fit (s)", fontsize=8.5)
        figure.supylabel(f"amplitude ({shown[0].found.series.unit})", fontsize=8.5)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id="paper-envelopes",
            title="Fig. 2 to 4: envelopes",
            alt="Amplitude against time on a logarithmic axis for each mode: measured values as dots, and "
            "straight lines with the damping ratio identified from each simulated decay.",
            caption="Constant damping is a straight line on this axis. Dots: measured amplitude. Lines start at the "
            "amplitude fitted at the start; their slopes are the damping ratios identified from the simulated decays. "
            "A line below the dots belongs to a model that damps this mode too much. Pale wedge: 90 % interval of the "
            "measured damping.",
        )


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
        values = line(model.damping_ratio)
        if np.all(np.isfinite(values)):
            axes.plot(
                axis_s,
                values,
                color=model_colour(model.model),
                linewidth=1.5,
                linestyle=model_line_style(model.model),
                label=model_name(model.model),
            )
    few_ticks(axes, x=4)
    log_y(axes, (1.0, 2.0, 5.0))
    # Two decades at most: below are noise and lines far from the dots.
    axes.set_ylim(
        max(size * 1e-2, 0.5 * float(min(low[-1], amplitude[positive].min(initial=size)))), 1.6 * size
    )
    axes.set_title(f"Mode {decay.number} ({decay.panel})")


def variables(paper: Recomputed, beam: BeamResult | None) -> tuple[FigureView, ...]:
    """The paper's variables fitted to its optimum column and, if there is a measured beam, to the recordings."""
    views = [
        variables_figure(
            "paper-variables",
            paper.optimum.reached,
            title="The paper’s variables, fitted to Table 3’s optimum column",
            aim="reach the printed optimum",
        )
    ]
    if beam is not None and beam.updated is not None:
        views.append(
            variables_figure(
                "recorded-variables",
                beam.updated.paper,
                title="The paper’s variables, fitted to these recordings",
                aim="match the measured frequencies and shapes",
            )
        )
    return tuple(views)


def variables_figure(figure_id: str, update: PaperUpdate, *, title: str, aim: str) -> FigureView:
    """Fitted width and thickness of each element, with the bound."""
    edges_mm = np.linspace(0.0, 1e3 * update.properties.length_m, update.width_factor.size + 1)
    middle_mm = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    limit = 100.0 * update.bound
    with figure_style():
        figure = new_figure(2.3)
        axes = figure.subplots()
        for value in (-limit, limit):
            axes.axhline(
                value,
                color=ALERT,
                linewidth=1.0,
                linestyle=(0, (1, 2)),
                label="bound" if value > 0.0 else "_",
            )
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
        axes.set_ylim(-1.35 * limit, 1.35 * limit)
        axes.set_xlabel("distance from the clamp (mm)")
        axes.set_ylabel("change (%)")
        figure.legend(loc="upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title=title,
            alt="Change of width and thickness of each element against the distance from the clamp, "
            f"between bounds of {percent(update.bound)}; those at the bound are marked.",
            caption=f"Of all fields within the bound that {aim}, the one nearest to the standard beam. "
            "Squares: elements at the bound. This is one solution of the search, not a measurement of the beam.",
        )
