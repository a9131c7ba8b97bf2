"""Conventions of all figures: ticks in plain text, direct labels, lines of fixed meaning.

matplotlib is imported where something is drawn: a report whose figures are kept does not load it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.format import MINUS, superscript
from modalcam.report.style.palette import COLUMNS, INK
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Keyword arguments of an artist.
Style = dict[str, Any]


def log_y(axes: Axes, subs: tuple[float, ...] = (1.0,)) -> None:
    """A logarithmic vertical axis, its ticks at `subs` times the powers of ten, written without markup."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415 - only to draw

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(base=10.0, subs=subs, numticks=7))
    axes.yaxis.set_major_formatter(FuncFormatter(_power))
    axes.yaxis.set_minor_formatter(NullFormatter())


def few_ticks(axes: Axes, *, x: int = 6, y: int = 4) -> None:
    """At most that many ticks on linear axes: making and drawing ticks is a third of the time of a figure."""
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 - only to draw

    axes.xaxis.set_major_locator(MaxNLocator(x))
    axes.yaxis.set_major_locator(MaxNLocator(y))


def share_time(rows: Iterable[Axes]) -> None:
    """Ticks of the common time axis under the last row alone."""
    for axes, _ in pairwise(rows):
        axes.xaxis.set_visible(False)


def trace(
    axes: Axes,
    time_s: NDArray[np.float64],
    values: NDArray[np.float64],
    colour: str,
    *,
    width: float = 0.8,
    columns: int = COLUMNS,
    dash: str | tuple[float, tuple[float, ...]] = "-",
    label: str = "",
    alpha: float = 1.0,
) -> None:
    """Draw a trace thinned to its extremes in each pixel column."""
    if not np.isfinite(values).any():
        return
    t, v = min_max(time_s, values, columns)
    axes.plot(t, v, color=colour, linewidth=width, linestyle=dash, label=label or "_", alpha=alpha)


def dots(
    axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], colour: str, size: float, *, label: str = ""
) -> None:
    """Dots as one path of points with round caps: a fifth of the size of a marker each."""
    from matplotlib.patches import PathPatch  # noqa: PLC0415 - only to draw
    from matplotlib.path import Path  # noqa: PLC0415

    good = np.isfinite(x) & np.isfinite(y)
    points = np.repeat(np.column_stack((x[good], y[good])), 2, axis=0)
    codes = np.tile([Path.MOVETO, Path.LINETO], points.shape[0] // 2)
    style: Style = {"color": colour, "linewidth": size, "capstyle": "round"}
    path = Path(points, codes)
    # Simplification would drop points that lie close together.
    path.should_simplify = False
    axes.add_patch(PathPatch(path, fill=False, **style))
    axes.update_datalim(points)
    axes.autoscale_view()
    axes.plot([], [], "o", color=colour, markersize=max(size, 3.0), markeredgewidth=0, label=label or "_")


def onset_line(axes: Axes, onset_s: float, *, label: bool = False) -> None:
    """Mark where the free decay begins."""
    axes.axvline(onset_s, color=INK, linewidth=0.9, linestyle=(0, (2, 2)))
    if label:
        axes.annotate(
            "onset",
            (onset_s, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2.5),
            textcoords="offset points",
            ha="center",
            va="bottom",
            annotation_clip=False,
            fontsize=8,
            color=INK,
        )


def _power(value: float, _: object = None) -> str:
    if value <= 0.0:
        return ""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -3 <= exponent <= 3:
        return f"{value:g}".replace("-", MINUS)
    multiple = round(value / 10.0**exponent)
    return f"{'' if multiple == 1 else f'{multiple} × '}10{superscript(exponent)}"


def min_max(time_s: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Trace thinned for drawing: the smallest and the largest sample in each of `columns` equal spans of time.

    A span without any value keeps one NaN, so that the line breaks there; a trace that is short enough is untouched.
    """
    if time_s.size <= 2 * columns:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], columns + 1)[1:-1]
    starts = np.unique(np.concatenate([[0], np.searchsorted(time_s, edges)]))
    starts = starts[starts < time_s.size]
    missing = np.isnan(values)
    low = _first_extremes(np.where(missing, np.inf, values), starts, np.minimum)
    high = _first_extremes(np.where(missing, -np.inf, values), starts, np.maximum)
    keep = np.union1d(low, high)
    return time_s[keep], values[keep]


def _first_extremes(values: FloatArray, starts: NDArray[np.intp], extreme: np.ufunc) -> NDArray[np.intp]:
    """Index of the first extreme value of each part, which begin at `starts`."""
    part = np.repeat(np.arange(starts.size), np.diff(starts, append=values.size))
    at = np.flatnonzero(values == extreme.reduceat(values, starts)[part])
    return np.asarray(at[np.unique(part[at], return_index=True)[1]])
