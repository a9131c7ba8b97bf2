"""Mode shape along the beam against theory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.figures.axes import few_ticks
from modalcam.report.style.palette import FIT, INK, MUTED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import figure_label
from sim.beam.modes import BeamModes
from tracker.arrays import FloatArray


def shape_figure(
    figure_id: str, found: Identification, mode: IdentifiedMode, theory: BeamModes | None
) -> FigureView | None:
    """Real part of the shape where its phase makes it largest; None with fewer than two known positions."""
    position_mm = found.series.positions_mm
    good = np.isfinite(position_mm) & np.isfinite(mode.shape) & found.channels_used
    if np.count_nonzero(good) < 2:
        return None
    position_mm, values, sd = position_mm[good], mode.shape[good], mode.shape_sd[good]
    turned = in_phase(values)
    with figure_style(figure_id):
        figure = new_figure(2.5)
        axes = figure.subplots()
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        curve = _theory(mode, theory, position_mm, turned.real)
        if curve is not None:
            sign = -1.0 if curve[1][-1] < 0.0 else 1.0
            turned = turned * sign
            axes.plot(
                curve[0],
                sign * curve[1],
                color=INK,
                linewidth=1.1,
                linestyle="--",
                label="beam theory, scaled",
            )
        bars = np.where(np.isfinite(sd), sd, 0.0)
        axes.errorbar(
            position_mm,
            turned.real,
            bars,
            fmt="o",
            color=FIT,
            markersize=5,
            capsize=2.5,
            linewidth=1.0,
            label="measured (±1 sd)",
        )
        axes.plot(position_mm, turned.imag, "x", color=MUTED, markersize=4.5, label="out of phase")
        few_ticks(axes, x=10)
        axes.set_xlabel("distance from the clamp (mm)")
        axes.set_ylabel(f"amplitude ({figure_label(found.series.unit)})")
        axes.legend(loc="best", borderaxespad=0.2)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Mode shape along the beam",
            alt="Amplitude of each marker against its distance from the clamp"
            + (", with the shape of the beam's theory." if curve is not None else "."),
            caption=_caption(mode, with_theory=curve is not None),
        )


def in_phase(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Shape turned by the common phase that leaves the least imaginary part (in the sum of squares)."""
    angle = 0.5 * np.angle(np.sum(values**2))
    return np.asarray(values * np.exp(-1j * angle))


def _theory(
    mode: IdentifiedMode, theory: BeamModes | None, position_mm: FloatArray, real: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    if theory is None or mode.number is None or mode.number > theory.count:
        return None
    length_mm = 1e3 * theory.beam.properties.length_m
    axis_mm = np.linspace(0.0, length_mm, 121)
    at_markers = theory.transverse_at(1e-3 * np.clip(position_mm, 0.0, length_mm))[:, mode.number - 1]
    power = float(at_markers @ at_markers)
    if power == 0.0:
        return None
    scale = float(at_markers @ real) / power
    return axis_mm, scale * theory.transverse_at(1e-3 * axis_mm)[:, mode.number - 1]


def _caption(mode: IdentifiedMode, *, with_theory: bool) -> str:
    text = "Crosses are the part that does not move in step with the rest: they lie on zero for a lightly damped beam. "
    if not with_theory:
        return text + "There is no theory to compare with for this mode."
    mac = f" The modal assurance criterion is {mode.mac:.4f}." if np.isfinite(mode.mac) else ""
    return (
        text + "The dashed curve is the theory of the beam, scaled to the markers; dots off it point to "
        "wrong positions or to "
        "a neighbouring mode." + mac
    )
