"""Labels and legends against the boxes that matplotlib's own renderer gives them."""

from itertools import combinations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from modalcam.report.style import INK, PointLabel, figure_style, legend_above, new_figure, place_labels

LONG = "simulated, Rayleigh damping with the initial, undeformed stiffness matrix of the whole beam"


def crowded():
    """Two rows of close points with a curve through the upper one, the lower one just above the axis."""
    figure = new_figure(3.5, 4.0)
    axes = figure.subplots()
    x = np.array([1.85, 10.2, 26.8, 53.2, 88.6])
    low, high = np.array([1.0, 0.28, 0.28, 0.23, 0.30]), np.array([2.1, 1.1, 0.6, 0.75, 1.05])
    axes.set(xscale="log", xlim=(1.2, 130.0), ylim=(0.0, 2.4))
    labels = [PointLabel(f"mode {k}", *at, INK) for k, at in enumerate(zip(x, low, strict=True), 1)]
    labels += [PointLabel("×4.0", *at, INK, first=(-1, 1), bold=True) for at in zip(x, high, strict=True)]
    symbols = np.array([(a, b, 3.75) for row in (low, high) for a, b in zip(x, row, strict=True)])
    curve = np.column_stack((np.geomspace(1.2, 130.0, 160), np.full(160, 0.5)))
    place_labels(figure, axes, labels, symbols, curve)
    return figure, axes, symbols


def test_labels_stay_apart_within_the_axes_and_off_the_symbols():
    with figure_style():
        figure, axes, symbols = crowded()
        FigureCanvasAgg(figure).draw()
        boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 10
    assert [(a, b) for (a, one), (b, other) in combinations(enumerate(boxes), 2) if one.overlaps(other)] == []
    centres = axes.transData.transform(symbols[:, :2])
    assert not any(box.contains(*centre) for box in boxes for centre in centres)
    # A label nearest to the symbol of another mode would name that one.
    for mode, box in enumerate(boxes[:5]):
        outside = [(max(box.x0 - x, x - box.x1, 0), max(box.y0 - y, y - box.y1, 0)) for x, y in centres[:5]]
        assert int(np.argmin(np.hypot(*np.transpose(outside)))) == mode, f"mode {mode + 1}"
    frame = axes.get_window_extent().padded(1.0)
    assert all(frame.x0 <= b.x0 and b.x1 <= frame.x1 and frame.y0 <= b.y0 and b.y1 <= frame.y1 for b in boxes)


def test_a_wide_legend_takes_more_rows_and_leaves_the_axes_their_height():
    heights = []
    for labels in (("a", "b", "c", "d"), ("measured", LONG, "c" * 40, "d" * 40)):
        with figure_style():
            figure = new_figure(2.5, 4.0)
            axes = figure.subplots()
            for label in labels:
                axes.plot([0, 1], [0, 1], label=label)
            legend_above(figure, columns=2)
            FigureCanvasAgg(figure).draw()
            legend, frame = figure.legends[0].get_window_extent(), figure.bbox
            heights.append(axes.get_window_extent().height)
            assert frame.x0 <= legend.x0 < legend.x1 <= frame.x1, f"{legend} in {frame}"
            assert legend.y0 > axes.get_window_extent().y1, "the legend is above the axes"
    assert abs(heights[0] - heights[1]) < 1.0, "pixels"
