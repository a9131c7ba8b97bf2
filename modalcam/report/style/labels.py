"""Labels of points, placed where they cover neither a curve, a symbol nor another label and stay within the axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modalcam.report.style.legend import text_width_pt
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_PT = 8.5
_BOLD_WIDER = 1.12
_HEIGHT_PT = 9.5
# Directions from the symbol, x to the right and y up, each tried at every distance from its edge.
_DIRECTIONS = ((0, -1), (0, 1), (-1, 1), (1, 1), (-1, 0), (1, 0), (-1, -1), (1, -1))
_DISTANCES_PT = (2.5, 8.0)
# Points of a covered curve that weigh as much as covering a symbol wholly, or standing closer to another of its colour.
_COVERED = 40.0


@dataclass(frozen=True)
class PointLabel:
    """Text at a point in data coordinates; `first` is the preferred direction."""

    text: str
    x: float
    y: float
    colour: str
    first: tuple[int, int] = (0, -1)
    bold: bool = False


def place_labels(
    figure: Figure, axes: Axes, labels: Sequence[PointLabel], symbols: FloatArray, curves: FloatArray
) -> None:
    """Write each label at the best of the positions around its point.

    Call when limits, legend and layout of the figure are final.

    Parameters
    ----------
    figure : Figure
    axes : Axes
        Of `figure`.
    labels : sequence of PointLabel
        The first are placed first.
    symbols : array, shape (n, 3)
        Centres of the symbols in data coordinates and their radii in points.
    curves : array, shape (m, 2)
        Points of the curves in data coordinates.
    """
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
    left, bottom, width, height = axes.get_position().bounds * np.tile(72.0 * figure.get_size_inches(), 2)
    inside = np.array([left, bottom, left + width, bottom + height])
    at, radius = _points(axes, symbols[:, :2]), symbols[:, 2:]
    boxes = [*np.hstack((at - radius, at + radius))]
    line = _points(axes, curves)
    for label in labels:
        centre = _points(axes, np.array([[label.x, label.y]]))[0]
        near = np.hypot(*(at - centre).T) < 1.0
        own = float(radius[near].max(initial=0.0))
        width_pt = (_BOLD_WIDER if label.bold else 1.0) * text_width_pt(label.text, SIZE_PT)
        half = 0.5 * np.array([width_pt, _HEIGHT_PT])
        ways = (label.first, *(way for way in _DIRECTIONS if way != label.first))
        offsets = [np.array(way) * (own + gap + half) for gap in _DISTANCES_PT for way in ways]
        found = [np.concatenate((centre + offset - half, centre + offset + half)) for offset in offsets]
        alike = np.array([(x.x, x.y) for x in labels if x.colour == label.colour and x is not label])
        others = _points(axes, alike)
        costs = [
            _cost(box, boxes, line, inside) + _COVERED * (_gap(box, others) < _gap(box, centre[None]))
            for box in found
        ]
        best = int(np.argmin(costs))
        boxes.append(found[best])
        axes.annotate(
            label.text,
            (label.x, label.y),
            xytext=tuple(offsets[best]),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=SIZE_PT,
            color=label.colour,
            fontweight="bold" if label.bold else "normal",
        )


def _points(axes: Axes, data: FloatArray) -> FloatArray:
    """Positions on the figure in points."""
    return np.asarray(axes.transData.transform(data.reshape(-1, 2)) * 72.0 / axes.figure.dpi)


def _cost(box: FloatArray, boxes: Sequence[FloatArray], line: FloatArray, inside: FloatArray) -> float:
    """Points of the curves in the box, and more for areas shared with other boxes or outside the axes."""
    area = float(np.prod(box[2:] - box[:2]))
    shared = sum(_shared(box, other) for other in boxes)
    outside = area - _shared(box, inside)
    covered = np.count_nonzero(np.all((line > box[:2] - 1.0) & (line < box[2:] + 1.0), axis=1))
    return float(round(covered + _COVERED * (shared + 4.0 * outside) / area, 3))


def _gap(box: FloatArray, points: FloatArray) -> float:
    """Distance of a box from the nearest of the points."""
    outside = np.maximum(np.maximum(box[:2] - points, points - box[2:]), 0.0)
    return float(np.hypot(*outside.T).min(initial=np.inf))


def _shared(one: FloatArray, other: FloatArray) -> float:
    return float(np.prod(np.clip(np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2]), 0.0, None)))
