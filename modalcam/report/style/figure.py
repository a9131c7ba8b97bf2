"""Conventions of all figures: colours, type, ticks in plain text, the legend above, labels at points.

Each colour is drawn as a fixed hexadecimal value and replaced by a variable of the style sheet in the SVG, so that
figures follow the page into dark mode and print. The hues are those of Okabe and Ito, distinguishable by colour-blind
readers; wherever two lines share a figure they differ in dash or marker too.

matplotlib is imported where something is drawn: a report whose figures are kept does not load it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.text import MINUS, superscript
from sim.damping import DAMPING_MODELS
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#1c2126"
MUTED = "#5c6670"
FAINT = "#c9cfd5"
PAPER = "#fdfdfc"
MEASURED = "#6f7b87"
FIT = "#00825f"
ALERT = "#a8326e"
# The first two damping models; also for other pairs of lines.
GENERIC = DAMPING_MODELS["generic"].colour
RAYLEIGH = DAMPING_MODELS["rayleigh"].colour

_VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    FAINT: "--faint",
    PAPER: "--card",
    MEASURED: "--measured",
    FIT: "--fit",
    ALERT: "--alert",
}


def variables() -> dict[str, str]:
    """Variable of the style sheet for each colour of a figure, those of the damping models included."""
    return _VARIABLES | {entry.colour: f"--damping-{key}" for key, entry in DAMPING_MODELS.items()}


WIDTH_IN = 8.6
# Pixel columns that a trace across the whole figure is thinned to.
COLUMNS = 640

_RC = {
    # Ids are made unique within the page by their figure's prefix.
    "svg.hashsalt": "modalcam",
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.use_mathtext": False,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.loc": "upper right",
    "legend.borderaxespad": 0.0,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Settings under which figures are drawn, independent of the user's matplotlib settings."""
    import matplotlib.style  # noqa: PLC0415 - only to draw

    with matplotlib.style.context(["default", _RC]):
        yield


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure; call within `figure_style`."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only to draw

    from modalcam.report.style.layout import GridLayout  # noqa: PLC0415

    return Figure(figsize=(width_in, height_in), layout=GridLayout())


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
