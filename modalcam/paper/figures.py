"""Figures beside the tables: damping ratios, envelopes of the five decays, and the paper's variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from modalcam.paper.decays import Decay
from modalcam.paper.recomputed import Recomputed
from modalcam.pipeline.results import RunResult
from modalcam.report.derived.model_decays import ModelDecay, model_colour, model_line_style, model_name
from modalcam.report.derived.signals import measured_envelope, shown_channel
from modalcam.report.figures.axes import dots, few_ticks, log_y
from modalcam.report.figures.damping import DampingPoint, Reference, damping_figure
from modalcam.report.style.format import percent
from modalcam.report.style.palette import ALERT, FIT, MEASURED, MUTED, RAYLEIGH, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from sim.reference import paper_tables as printed
from sim.updating import PaperUpdate

_COLUMNS = 3


def damping_ratios(
    result: RunResult, measured: Sequence[DampingPoint], shown: Sequence[Decay], paper: Recomputed
) -> FigureView | None:
    """Damping ratio against frequency: the paper's, ours, and what the models make of them."""
    simulated: dict[str, list[DampingPoint]] = {}
    for decay in shown:
        for model in decay.models:
            if np.isfinite(model.damping_ratio) and np.isfinite(model.frequency_hz):
                point = DampingPoint(model.frequency_hz, model.damping_ratio)
                simulated.setdefault(model.model, []).append(point)
    nan = float("nan")
    view = damping_figure(
        "paper-damping",
        measured,
        simulated,
        alpha_1_s=nan if result.beam is None else result.beam.rayleigh_alpha_1_s,
        beta_s=nan if result.beam is None else result.beam.rayleigh_beta_s,
        reference=Reference(
            "paper, Table 2",
            tuple(
                DampingPoint(f, z)
                for f, z in zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
            ),
            paper.equations.alpha_1_s,
            paper.equations.beta_s,
        ),
    )
    if view is None:
        return None
    own = "Diamonds are the paper’s Table 2, the dotted curve is Eq. 3 and 4 through its modes 1 and 2."
    caption = f"{view.caption} {own}"
    return replace(view, title="Damping ratios, the paper’s and these", caption=caption)


def envelopes(shown: Sequence[Decay]) -> FigureView | None:
    """Amplitude of each decay on a logarithmic axis: measured, and at the damping of each simulated decay."""
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    with figure_style("paper-envelopes"):
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
        figure.legend(handles, labels, loc="outside upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id="paper-envelopes",
            title="Fig. 2 to 4 at a glance: envelopes",
            alt="Amplitude against time on a logarithmic axis for each mode: measured as dots, and "
            "straight lines with the damping ratio identified from each simulated decay.",
            caption="On this axis one damping ratio is one slope. Dots are the measured amplitude; a line "
            "that falls away from them belongs to a model that damps this mode too much. Lines start at the "
            "amplitude fitted at the start, their slopes are those identified from the simulated decays; the "
            "pale wedge is the measured damping’s 90 % interval.",
        )


def _envelope(axes: Axes, decay: Decay) -> None:
    channel = shown_channel(decay.found)
    mode, start = decay.mode, decay.found.onset.fit_from_s
    time_s, amplitude = measured_envelope(decay.found, mode, channel)
    size = float(np.abs(mode.shape[channel]))
    end = float(time_s[-1]) - start if time_s.size else 1.0 / mode.frequency_hz
    axis_s = np.linspace(0.0, end, 40)

    def line(ratio: float) -> np.ndarray:
        return np.asarray(size * np.exp(-ratio * mode.omega_n_rad_s * axis_s))

    high, low = (line(ratio) for ratio in mode.damping_interval())
    axes.fill_between(axis_s, low, high, color=MEASURED, alpha=0.3, linewidth=0)
    positive = amplitude > 0.0
    dots(axes, time_s[positive] - start, amplitude[positive], MEASURED, 2.6, label="measured")
    for model in decay.models:
        _model_line(axes, model, axis_s, line(model.damping_ratio))
    few_ticks(axes, x=4)
    log_y(axes, (1.0, 2.0, 5.0))
    # Two decades at most: what lies below is noise or a line that has long left the dots.
    axes.set_ylim(
        max(size * 1e-2, 0.5 * float(min(low[-1], amplitude[positive].min(initial=size)))), 1.6 * size
    )
    axes.set_title(f"Mode {decay.number} ({decay.panel})")


def _model_line(axes: Axes, model: ModelDecay, axis_s: np.ndarray, values: np.ndarray) -> None:
    if np.all(np.isfinite(values)):
        axes.plot(
            axis_s,
            values,
            color=model_colour(model.model),
            linewidth=1.5,
            linestyle=model_line_style(model.model),
            label=model_name(model.model),
        )


def variables_figure(figure_id: str, update: PaperUpdate, *, title: str, aim: str) -> FigureView:
    """Width and thickness of each element as the paper's variables end, with their bound."""
    edges_mm = np.linspace(0.0, 1e3 * update.properties.length_m, update.width_factor.size + 1)
    middle_mm = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    limit = 100.0 * update.bound
    with figure_style(figure_id):
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
        figure.legend(loc="outside upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title=title,
            alt="Change of width and thickness of each element against the distance from the clamp, "
            f"between bounds of {percent(update.bound)}; those at the bound are marked.",
            caption=f"Of all fields within the bound that {aim}, the one nearest to the standard beam. "
            "Squares mark elements at the bound. It is an answer of the search, not a measurement of the beam.",
        )
