"""Width and thickness along the beam after updating."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modalcam.report.figures.base import FigureKind
from modalcam.report.style import FIT, MUTED, RAYLEIGH, Style, few_ticks
from sim.updating import Updating

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Z_90 = 1.6449


def _draw(figure: Figure, shown: Updating) -> None:
    from modalcam.report.style import GridLayout  # noqa: PLC0415 - loads matplotlib

    posterior, paper = shown.bayesian, shown.paper
    ne = posterior.properties.elements
    edges_mm = np.linspace(0.0, 1e3 * posterior.properties.length_m, ne + 1)
    bands = 100.0 * (posterior.factor_interval() - 1.0)
    median = 100.0 * (np.exp(np.median(posterior.log_factor_draws, axis=0)) - 1.0)
    prior = 100.0 * _Z_90 * posterior.prior.sd
    # Legends are placed next to the panels.
    figure.set_layout_engine(GridLayout(right=112.0))
    panels = figure.subplots(2, 1, sharex=True)
    fields = (
        ("thickness", FIT, slice(ne, 2 * ne), paper.thickness_factor),
        ("width", RAYLEIGH, slice(0, ne), paper.width_factor),
    )
    for axes, (name, colour, at, of_paper) in zip(panels, fields, strict=True):
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        for edge in (-prior, prior):
            axes.axhline(edge, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)))
        style: Style = {"fill": True, "color": colour, "alpha": 0.25, "label": "90 % interval"}
        axes.stairs(bands[at, 1], edges_mm, baseline=bands[at, 0], **style)
        style = {"color": colour, "linewidth": 1.6, "label": f"{name}, posterior"}
        axes.stairs(median[at], edges_mm, baseline=None, **style)
        style = {"color": MUTED, "linewidth": 1.1, "linestyle": "--", "label": "method of the paper"}
        axes.stairs(100.0 * (of_paper - 1.0), edges_mm, baseline=None, **style)
        few_ticks(axes, x=7)
        # The edge of a band would otherwise be the edge of the axes.
        axes.use_sticky_edges = False
        axes.margins(x=0.0, y=0.12)
        axes.set_ylabel(f"{name} (%)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    panels[-1].set_xlabel("distance from the clamp (mm)")


FIELDS = FigureKind(
    "fields", "updating", lambda result: result.beam and result.beam.updated, _draw, height_in=3.4
)
