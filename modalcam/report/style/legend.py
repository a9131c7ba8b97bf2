"""The legend above a figure, in as many columns as its width holds."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Height of a line, in points.
LEGEND_LINE = 12.5
_FONT_PT = 8.0
# Handle, gap to its text and gap to the next column, in matplotlib's default multiples of the font size.
_HANDLE_PT = 2.8 * _FONT_PT
_GAP_PT = 2.0 * _FONT_PT
_EDGES_PT = 10.0


def legend_above(figure: Figure, entries: tuple[Any, Any] | None = None, *, columns: int) -> None:
    """Legend above the axes; fewer columns and broken labels where it would be wider than the figure.

    The figure grows by the rows that this adds, so that its axes keep their height.

    Parameters
    ----------
    figure : Figure
    entries : (handles, labels) or None
        As of ``Axes.get_legend_handles_labels``; None for those of all axes.
    columns : int
        Most columns.
    """
    if entries is None:
        pairs = [pair for axes in figure.axes for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
        handles, labels = [handle for handle, _ in pairs], [label for _, label in pairs]
    else:
        handles, labels = entries
    if not labels:
        return
    width_pt = 72.0 * figure.get_figwidth() - _EDGES_PT
    widths = [text_width_pt(label) for label in labels]
    fitting = next((n for n in range(columns, 0, -1) if _taken_pt(widths, n) <= width_pt), 1)
    broken = [
        _broken(label, width, width_pt - _HANDLE_PT) for label, width in zip(labels, widths, strict=True)
    ]
    figure.legend(handles, broken, ncols=fitting, loc="upper right" if fitting > 1 else "upper center")
    extra = legend_lines(broken, fitting) - math.ceil(len(labels) / columns)
    figure.set_figheight(figure.get_figheight() + extra * LEGEND_LINE / 72.0)


def legend_lines(labels: Sequence[str], columns: int) -> int:
    """Lines of the longest column: matplotlib fills one column after the other."""
    parts = np.array_split([label.count("\n") + 1 for label in labels], columns)
    return max(int(part.sum()) for part in parts)


def text_width_pt(text: str, size_pt: float = _FONT_PT) -> float:
    """Width of a line of text in the figures' font."""
    from matplotlib.font_manager import FontProperties  # noqa: PLC0415 - only to draw
    from matplotlib.textpath import text_to_path  # noqa: PLC0415

    font = FontProperties(family="DejaVu Sans", size=size_pt)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


def _taken_pt(widths_pt: list[float], columns: int) -> float:
    """Width of the legend: matplotlib fills one column after the other."""
    parts = [part for part in np.array_split(widths_pt, columns) if part.size]
    return float(sum(part.max() + _HANDLE_PT for part in parts) + _GAP_PT * (len(parts) - 1))


def _broken(label: str, width_pt: float, most_pt: float) -> str:
    return label if width_pt <= most_pt else textwrap.fill(label, int(len(label) * most_pt / width_pt))
