"""Stabilisation diagram of the decay: poles of a method that knows nothing of the fit, over its model orders."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from modal_id.data.samples import FitData
from modal_id.fit.poles import frequency_hz
from modal_id.fit.subspace import StabilityDiagram, stability_diagram
from modal_id.results import Identification
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.style.axes import dots, few_ticks
from modalcam.report.style.legend import legend_above
from modalcam.report.style.palette import FAINT, FIT, MEASURED

# Frequencies shown, relative to the highest mode.
_ABOVE = 1.3


def diagram_of(found: Identification) -> StabilityDiagram | None:
    """Poles of the samples that were fitted; None where they are too few."""
    chosen = np.flatnonzero(found.channels_used)
    rows = np.flatnonzero(found.used[:, chosen].any(axis=1))
    if rows.size < 2:
        return None
    cells = np.ix_(rows, chosen)
    weights = (found.used & np.isfinite(found.series.values) & np.isfinite(found.baseline))[cells].astype(
        float
    )
    time_s = found.series.time_s[rows] - found.series.time_s[rows[0]]
    data = FitData(time_s, np.where(weights > 0.0, found.series.values[cells], 0.0), weights)
    baseline = np.where(weights > 0.0, found.baseline[cells], 0.0)
    return stability_diagram(data, baseline, max(mode.frequency_hz for mode in found.modes))


def _draw(figure: Figure, shown: Target) -> bool:
    found = shown.found
    diagram = diagram_of(found)
    if diagram is None:
        return False
    masks = [diagram.stable(index) for index in range(len(diagram.orders))]
    hz = np.concatenate([frequency_hz(poles) for poles in diagram.poles])
    order = np.repeat(np.array(diagram.orders, dtype=float), [poles.size for poles in diagram.poles])
    stable = np.concatenate(masks)
    axes = figure.subplots()
    for k, mode in enumerate(found.modes):
        label = "_" if k else "identified modes"
        axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label=label)
    dots(axes, hz[~stable], order[~stable], FAINT, 2.4, label="new in this order")
    dots(axes, hz[stable], order[stable], MEASURED, 3.2, label="stable")
    few_ticks(axes, x=7)
    highest_hz = max(mode.frequency_hz for mode in found.modes)
    axes.set(xlabel="frequency (Hz)", ylabel="model order", xlim=(0.0, _ABOVE * highest_hz))
    axes.set_ylim(0.0, diagram.orders[-1] + 2.0)
    legend_above(figure, axes.get_legend_handles_labels(), columns=3)
    return True


STABILITY = FigureKind("stability", "recording", RecordingSubject.target, _draw, height_in=2.2)
