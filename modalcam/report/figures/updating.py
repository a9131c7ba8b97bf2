"""Width and thickness along the beam after updating."""

from __future__ import annotations

import numpy as np

from modalcam.report.figures.axes import few_ticks
from modalcam.report.style.palette import FIT, MUTED, RAYLEIGH, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from sim.updating import Updating


def fields_figure(figure_id: str, updated: Updating) -> FigureView:
    """Relative change of each element's thickness and width: posterior with its 90 % band, and the paper's answer."""
    posterior, paper = updated.bayesian, updated.paper
    ne = posterior.properties.elements
    edges_mm = np.linspace(0.0, 1e3 * posterior.properties.length_m, ne + 1)
    bands = 100.0 * (posterior.factor_interval() - 1.0)
    middle = 100.0 * (np.exp(np.median(posterior.log_factor_draws, axis=0)) - 1.0)
    prior = 100.0 * 1.6449 * posterior.prior.sd
    with figure_style(figure_id):
        figure = new_figure(3.4)
        panels = figure.subplots(2, 1, sharex=True)
        fields = (
            ("thickness", FIT, slice(ne, 2 * ne), paper.thickness_factor),
            ("width", RAYLEIGH, slice(0, ne), paper.width_factor),
        )
        for axes, (name, colour, at, of_paper) in zip(panels, fields, strict=True):
            axes.axhline(0.0, color=MUTED, linewidth=0.7)
            for edge in (-prior, prior):
                axes.axhline(edge, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)))
            axes.stairs(
                bands[at, 1],
                edges_mm,
                baseline=bands[at, 0],
                fill=True,
                color=colour,
                alpha=0.25,
                label="90 %",
            )
            axes.stairs(
                middle[at], edges_mm, baseline=None, color=colour, linewidth=1.6, label=f"{name}, posterior"
            )
            axes.stairs(
                100.0 * (of_paper - 1.0),
                edges_mm,
                baseline=None,
                color=MUTED,
                linewidth=1.1,
                linestyle="--",
                label="as the paper",
            )
            few_ticks(axes, x=10)
            axes.margins(y=0.12)
            axes.set_ylabel(f"{name} (%)")
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        panels[-1].set_xlabel("distance from the clamp (mm)")
        return figure_view(
            figure,
            figure_id=figure_id,
            title="What updating changed along the beam",
            alt="Relative change of thickness and width of each element against the distance from the clamp.",
            caption="Line and band: median and 90 % of the posterior, with gravity. Where the band is as wide as the "
            "prior (dotted) the data say nothing. Dashed: the paper's own answer without gravity, one of many.",
        )
