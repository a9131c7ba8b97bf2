"""Layout of a figure's grid of axes: room for tick labels, axis labels, titles and the figure's legend.

matplotlib's constrained layout measures every artist twice, which takes half of the time that a figure of the report
takes to draw. Here the margins follow from the tick labels alone. A file of its own because it loads matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.layout_engine import LayoutEngine
from matplotlib.textpath import text_to_path
from numpy.typing import NDArray

from modalcam.report.style.figure import LEGEND_LINE, legend_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

# All lengths are in points.
_EDGE = 4.0
_TICK = 7.0
_LABEL = 14.0
_BETWEEN = 6.0


class GridLayout(LayoutEngine):
    """Place the axes of a figure's only grid, side by side with the ratios of the grid.

    Parameters
    ----------
    right : float
        Width kept free at the right edge, such as for legends next to the axes.
    """

    def __init__(self, right: float = 0.0) -> None:
        super().__init__()
        self._adjust_compatible = True
        self._colorbar_gridspec = True
        self._right = right

    def execute(self, fig: Figure) -> None:
        """Set the position of every axes and of its labels."""
        placed = [(axes, _cells(axes)) for axes in fig.axes if axes.get_subplotspec() is not None]
        if not placed:
            return
        grid: Any = placed[0][0].get_gridspec()
        width, height = (72.0 * length for length in fig.get_size_inches())
        left, right = np.zeros(grid.ncols), np.zeros(grid.ncols)
        bottom, top = np.zeros(grid.nrows), np.zeros(grid.nrows)
        needs = [_needs(axes) for axes, _ in placed]
        for (_, (row, column)), (ticks_x, ticks_y, half, label_x, label_y, title) in zip(
            placed, needs, strict=True
        ):
            left[column] = max(left[column], ticks_y + label_y, half)
            right[column] = max(right[column], half)
            bottom[row] = max(bottom[row], ticks_x + label_x)
            top[row] = max(top[row], title)
        left[0] += _EDGE + (_LABEL + _BETWEEN if fig.get_supylabel() else 0.0)
        right[-1] += _EDGE + self._right
        bottom[-1] += _EDGE + (_LABEL if fig.get_supxlabel() else 0.0)
        top[0] += _EDGE + max((_legend_height(legend) for legend in fig.legends), default=0.0)
        left[1:] += _BETWEEN
        top[1:] += _BETWEEN
        widths = _shares(width - left.sum() - right.sum(), grid.get_width_ratios(), grid.ncols)
        heights = _shares(height - bottom.sum() - top.sum(), grid.get_height_ratios(), grid.nrows)
        for (axes, (row, column)), (ticks_x, ticks_y, *_) in zip(placed, needs, strict=True):
            x = left[: column + 1].sum() + right[:column].sum() + widths[:column].sum()
            y = bottom[row:].sum() + top[row + 1 :].sum() + heights[row + 1 :].sum()
            axes.set_position(
                (x / width, y / height, widths[column] / width, heights[row] / height), which="both"
            )
            # Fixed positions spare the search for the tick labels' boxes.
            axes.xaxis.set_label_coords(0.5, -(ticks_x + 1.0) / heights[row])
            axes.yaxis.set_label_coords(-(ticks_y + 3.0) / widths[column], 0.5)


def _cells(axes: Axes) -> tuple[int, int]:
    spec: Any = axes.get_subplotspec()
    return spec.rowspan.start, spec.colspan.start


def _needs(axes: Axes) -> tuple[float, float, float, float, float, float]:
    """Height of the x tick labels, width of those of y, half the widest of x, the labels' heights, the title's."""
    x, y = _tick_widths(axes.xaxis), _tick_widths(axes.yaxis)
    titled = any(axes.get_title(loc=side) for side in ("left", "center", "right"))
    return (
        _TICK + 9.0 if x else 0.0,
        _TICK + max(y) if y else 0.0,
        0.5 * max(x) if x else 0.0,
        _LABEL if axes.get_xlabel() else 0.0,
        _LABEL if axes.get_ylabel() else 0.0,
        _LABEL + 1.0 if titled else 5.0 if y else 0.0,
    )


def _tick_widths(axis: Axis) -> list[float]:
    """Widths of the tick labels that are drawn."""
    if not axis.get_visible() or not axis.axes.axison:
        return []
    label = axis.get_major_ticks(1)[0].label1
    if not label.get_visible():
        return []
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    positions = list(axis.get_majorticklocs())
    # Asking the axis for its labels would lay out its ticks, which drawing does again.
    return [
        text_to_path.get_text_width_height_descent(text, label.get_fontproperties(), ismath=False)[0]
        for text, at in zip(axis.get_major_formatter().format_ticks(positions), positions, strict=True)
        if text and low - slack <= at <= high + slack
    ]


def _legend_height(legend: Legend) -> float:
    columns = max(1, int(legend._ncols))  # type: ignore[attr-defined]  # noqa: SLF001 - matplotlib has no getter
    return LEGEND_LINE * legend_lines([text.get_text() for text in legend.get_texts()], columns) + 3.0


def _shares(length: float, ratios: Any, count: int) -> NDArray[np.float64]:
    shares = np.ones(count) if ratios is None else np.asarray(ratios, dtype=np.float64)
    return np.asarray(max(length, 1.0) * shares / shares.sum())
