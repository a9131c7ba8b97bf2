"""Along the beam: a mode shape against theory, the displacement v(s, t) of a line, the section after updating."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modal_id import IdentifiedMode
from modal_id.modes import Node, find_nodes, mac
from modalcam.report.figures.base import BAND_SD, FigureKind, RecordingSubject
from modalcam.report.style import FIT, INK, MUTED, RAYLEIGH, Style, few_ticks, figure_label, significant
from sim.beam import BeamModes
from sim.updating import Updating
from tracker import FloatArray, MarkerTracks
from tracker.markers import kind_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More points than this, the stations of a line, are drawn as a curve with its 90 % band.
MOST_POINTS = 16


class ShownShape(NamedTuple):
    """Shape of one mode at its channels, and that of theory."""

    unit: str
    position_mm: FloatArray
    shape: NDArray[np.complex128]
    sd: FloatArray
    # Theory scaled to the markers: distances from the clamp in mm, values.
    curve: tuple[FloatArray, FloatArray] | None
    # With the curve at the markers. That of the mode may be with another beam: the one configured, before updating.
    mac: float
    nodes: tuple[Node, ...] = ()


def shape_of(subject: RecordingSubject) -> ShownShape | None:
    """Shape of the mode shown at the channels of known position; None where fewer than two have one."""
    target = subject.target()
    if target is None:
        return None
    found, mode, _ = target
    position_mm = found.series.positions_mm
    good = np.isfinite(position_mm) & np.isfinite(mode.shape) & found.channels_used
    if np.count_nonzero(good) < 2:
        return None
    position_mm, shape = position_mm[good], in_phase(mode.shape[good])
    curve, criterion = _theory(mode, subject.theory, position_mm, shape)
    if curve is not None and curve[1][-1] < 0.0:
        shape, curve = -shape, (curve[0], -curve[1])
    sd = np.nan_to_num(mode.shape_sd[good], posinf=0.0)
    return ShownShape(
        found.series.unit, position_mm, shape, sd, curve, criterion, find_nodes(position_mm, shape, sd)
    )


def in_phase(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Shape rotated by the common phase that minimises the sum of squares of its imaginary part."""
    angle = 0.5 * np.angle(np.sum(values**2))
    return np.asarray(values * np.exp(-1j * angle))


def _theory(
    mode: IdentifiedMode, theory: BeamModes | None, position_mm: FloatArray, shape: NDArray[np.complex128]
) -> tuple[tuple[FloatArray, FloatArray] | None, float]:
    """Curve of theory scaled to the shape, and their modal assurance criterion; None and NaN without theory."""
    nothing = None, float("nan")
    if theory is None or mode.number is None or mode.number > theory.count:
        return nothing
    length_mm = 1e3 * theory.beam.properties.length_m
    axis_mm = np.linspace(0.0, length_mm, 121)
    at_markers = theory.transverse_at(1e-3 * np.clip(position_mm, 0.0, length_mm))[:, mode.number - 1]
    power = float(at_markers @ at_markers)
    if power == 0.0:
        return nothing
    scale = float(at_markers @ shape.real) / power
    curve = axis_mm, scale * theory.transverse_at(1e-3 * axis_mm)[:, mode.number - 1]
    return curve, mac(shape, at_markers)


def _draw(figure: Figure, shown: ShownShape) -> None:
    if shown.position_mm.size > MOST_POINTS and shown.curve is not None:
        axes, difference = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        figure.set_figheight(3.6)
        _draw_difference(difference, shown, shown.curve)
    else:
        axes = difference = figure.subplots()
    axes.axhline(0.0, color=MUTED, linewidth=0.7)
    if shown.curve is not None:
        axes.plot(*shown.curve, color=INK, linewidth=1.1, linestyle="--", label="beam theory, scaled")
    if shown.position_mm.size > MOST_POINTS:
        _draw_field(axes, shown)
    else:
        style: Style = {"fmt": "o", "color": FIT, "markersize": 5, "capsize": 2.5, "linewidth": 1.0}
        axes.errorbar(shown.position_mm, shown.shape.real, shown.sd, label="measured (±1 sd)", **style)
        axes.plot(shown.position_mm, shown.shape.imag, "x", color=MUTED, markersize=4.5, label="out of phase")
    few_ticks(axes, x=7)
    axes.set(ylabel=f"amplitude ({figure_label(shown.unit)})")
    difference.set(xlabel="distance from the clamp (mm)")
    axes.legend(loc="best")


def _draw_field(axes: Axes, shown: ShownShape) -> None:
    """Shape of many stations with its band, too many for single symbols."""
    at, real = shown.position_mm, shown.shape.real
    axes.plot(at, real, color=FIT, linewidth=1.4, label="measured")
    axes.fill_between(
        at, real - BAND_SD * shown.sd, real + BAND_SD * shown.sd, color=FIT, alpha=0.3, linewidth=0.0
    )
    axes.plot(at, shown.shape.imag, color=MUTED, linewidth=0.9, linestyle=":", label="out of phase")


def _draw_difference(axes: Axes, shown: ShownShape, curve: tuple[FloatArray, FloatArray]) -> None:
    """Measured shape less theory with its band, which the shape itself hides."""
    at = shown.position_mm
    left = shown.shape.real - np.interp(at, *curve)
    axes.axhline(0.0, color=INK, linewidth=1.1, linestyle="--")
    axes.plot(at, left, color=FIT, linewidth=1.0)
    band = BAND_SD * shown.sd
    axes.fill_between(at, left - band, left + band, color=FIT, alpha=0.3, linewidth=0.0, label="90 % band")
    few_ticks(axes, x=7)
    axes.set(ylabel="− theory")
    axes.legend(loc="best")


SHAPE = FigureKind("shape", "recording", shape_of, _draw, essential=True)


# Cycles in each panel, and most instants that are drawn of them.
_CYCLES = 6.0
_MOST_COLUMNS = 160
# Each panel has the scale of this quantile of its displacements, so that single outliers do not hide the motion.
_LARGEST = 0.998


class _Panel(NamedTuple):
    title: str
    time_s: FloatArray
    values: FloatArray


class _Shown(NamedTuple):
    unit: str
    position_mm: FloatArray
    panels: tuple[_Panel, ...]


def _shows(subject: RecordingSubject) -> _Shown | None:
    target, tracks = subject.decaying(), subject.recording.tracks
    if target is None or not isinstance(tracks, MarkerTracks) or not kind_of(tracks.kind).follows_line:
        return None
    found, mode, _ = target
    series = found.series
    known = np.isfinite(series.positions_mm) & found.channels_used
    if np.count_nonzero(known) < 2:
        return None
    span_s = _CYCLES / mode.frequency_hz
    last_s = float(series.time_s[found.decay_rows][-1])
    begins = (found.onset.fit_from_s, max(found.onset.fit_from_s, last_s - span_s))
    moved = series.values - found.baseline
    panels = []
    for title, begin_s in zip(("At the start of the fit", "At the end of the decay"), begins, strict=True):
        rows = np.flatnonzero((series.time_s >= begin_s) & (series.time_s <= begin_s + span_s))
        rows = rows[:: max(1, rows.size // _MOST_COLUMNS)]
        panels.append(_Panel(title, series.time_s[rows], moved[rows][:, known]))
    return _Shown(series.unit, series.positions_mm[known], tuple(panels))


def _draw_waterfall(figure: Figure, shown: _Shown) -> bool:
    if any(panel.time_s.size < 2 or not np.isfinite(panel.values).any() for panel in shown.panels):
        return False
    for axes, panel in zip(figure.subplots(1, len(shown.panels)), shown.panels, strict=True):
        # The scale is in the title: a colour bar would need as much room as a panel.
        largest = float(np.nanquantile(np.abs(panel.values), _LARGEST)) or 1.0
        _map(axes, panel, shown.position_mm, largest)
        axes.set_title(f"{panel.title}, ±{significant(largest, 2)} {figure_label(shown.unit)}")
        axes.set(xlabel="time (s)", ylabel="distance from the clamp (mm)")
        axes.grid(visible=False)
        few_ticks(axes, x=5)
    return True


def _map(axes: Axes, panel: _Panel, position_mm: FloatArray, largest: float) -> None:
    step_s, step_mm = (float(np.median(np.diff(at))) for at in (panel.time_s, position_mm))
    axes.imshow(
        panel.values.T,
        aspect="auto",
        origin="lower",
        interpolation="nearest",
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        extent=(
            float(panel.time_s[0]) - 0.5 * step_s,
            float(panel.time_s[-1]) + 0.5 * step_s,
            float(position_mm[0]) - 0.5 * step_mm,
            float(position_mm[-1]) + 0.5 * step_mm,
        ),
    )


WATERFALL = FigureKind("waterfall", "recording", _shows, _draw_waterfall, height_in=3.0)


def _draw_fields(figure: Figure, shown: Updating) -> None:
    from modalcam.report.style import GridLayout  # noqa: PLC0415 - loads matplotlib

    posterior, paper = shown.bayesian, shown.paper
    ne = posterior.properties.elements
    edges_mm = np.linspace(0.0, 1e3 * posterior.properties.length_m, ne + 1)
    bands = 100.0 * (posterior.factor_interval() - 1.0)
    median = 100.0 * (np.exp(np.median(posterior.log_factor_draws, axis=0)) - 1.0)
    prior = 100.0 * 1.6449 * posterior.prior.sd
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
    "fields", "updating", lambda result: result.beam and result.beam.updated, _draw_fields, height_in=3.4
)
