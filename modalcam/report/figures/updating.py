"""Width and thickness along the beam after updating."""

from __future__ import annotations

import numpy as np

from modalcam.report.figures.axes import few_ticks
from modalcam.report.palette import FIT, MUTED, RAYLEIGH, figure_style, new_figure
from modalcam.report.svg import FigureView, figure_view
from sim.updating import UpdatedBeam


def fields_figure(figure_id: str, updated: UpdatedBeam) -> FigureView:
    """Relative change of each element's width and thickness."""
    edges_mm = np.linspace(0.0, 1e3 * updated.properties.length_m, updated.thickness_factor.size + 1)
    with figure_style(figure_id):
        figure = new_figure(2.1)
        axes = figure.subplots()
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        for values, colour, dash, label in (
            (updated.thickness_factor, FIT, "-", "thickness"),
            (updated.width_factor, RAYLEIGH, "--", "width"),
        ):
            axes.stairs(
                100.0 * (values - 1.0),
                edges_mm,
                baseline=None,
                color=colour,
                linewidth=1.4,
                linestyle=dash,
                label=label,
            )
        few_ticks(axes, x=10)
        axes.margins(y=0.15)
        axes.set_xlabel("distance from the clamp (mm)")
        axes.set_ylabel("change (%)")
        axes.legend(loc="best", ncols=2, borderaxespad=0.2)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="What updating changed along the beam",
            alt="Relative change of thickness and width of each element against the distance from the clamp.",
            caption="A few frequencies cannot decide on so many variables: of all fields that reach the measured "
            "frequencies this is the smoothest and smallest. Do not read it as a measurement of the beam.",
        )
