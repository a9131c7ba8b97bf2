"""Damping ratio against frequency over all recordings: what Rayleigh damping cannot follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

from modalcam.report.derived.model_decays import model_colour, model_marker, model_name
from modalcam.report.style.format import significant
from modalcam.report.style.palette import ALERT, INK, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from tracker.arrays import FloatArray


@dataclass(frozen=True)
class DampingPoint:
    """One mode: frequency in Hz, damping ratio, its 90 % interval."""

    frequency_hz: float
    damping_ratio: float
    low: float = float("nan")
    high: float = float("nan")
    label: str = ""


@dataclass(frozen=True)
class Reference:
    """Damping ratios of another source, with the Rayleigh curve through its two lowest modes."""

    name: str
    points: tuple[DampingPoint, ...]
    alpha_1_s: float
    beta_s: float


def damping_figure(
    figure_id: str,
    measured: Sequence[DampingPoint],
    simulated: Mapping[str, Sequence[DampingPoint]],
    *,
    alpha_1_s: float,
    beta_s: float,
    reference: Reference | None = None,
) -> FigureView | None:
    """Measured with intervals, both models as identified from their decays, and the Rayleigh curve of Eq. 3, 4.

    None where there are not two points to compare.
    """
    if not measured or (len(measured) == 1 and not any(simulated.values())):
        return None
    with_curve = bool(np.isfinite(alpha_1_s) and np.isfinite(beta_s))
    with figure_style(figure_id):
        figure = new_figure(3.3)
        axes = figure.subplots()
        span = _frequency_span(measured)
        tops = [p.high if np.isfinite(p.high) else p.damping_ratio for p in measured]
        if with_curve:
            f = np.geomspace(*span, 160)
            curve = rayleigh_damping_ratio(f, alpha_1_s, beta_s)
            axes.plot(
                f,
                100.0 * curve,
                color=model_colour("rayleigh"),
                linewidth=1.3,
                linestyle="--",
                label="Rayleigh curve, Eq. 3",
            )
        if reference is not None:
            _reference(axes, reference, span)
            tops += [p.damping_ratio for p in reference.points]
        _simulated(axes, simulated)
        tops += [p.damping_ratio for points in simulated.values() for p in points]
        _measured(axes, measured)
        _log_x(axes, span)
        axes.set_ylim(0.0, 115.0 * max([1e-6, *(t for t in tops if np.isfinite(t))]))
        axes.set_xlabel("natural frequency (Hz)")
        axes.set_ylabel("damping ratio ζ (%)")
        figure.legend(loc="outside upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Damping ratio against frequency",
            alt="Measured damping ratio of each mode against its natural frequency with 90 percent intervals"
            + (", and the Rayleigh curve through the two lowest modes" if with_curve else "")
            + (
                ", and the damping ratios identified from simulated decays."
                if any(simulated.values())
                else "."
            ),
            caption=_caption(with_curve=with_curve, with_models=any(simulated.values())),
        )


def rayleigh_damping_ratio(frequency_hz: FloatArray, alpha_1_s: float, beta_s: float) -> FloatArray:
    """``alpha / (2 omega) + beta omega / 2``: what Eq. 3 does to a mode of that frequency."""
    omega = 2.0 * np.pi * frequency_hz
    return np.asarray(0.5 * (alpha_1_s / omega + beta_s * omega))


def _reference(axes: Axes, reference: Reference, span: tuple[float, float]) -> None:
    f = np.geomspace(*span, 160)
    curve = rayleigh_damping_ratio(f, reference.alpha_1_s, reference.beta_s)
    label = f"Rayleigh curve, {reference.name}"
    axes.plot(f, 100.0 * curve, color=ALERT, linewidth=1.3, linestyle=(0, (1, 2)), label=label)
    axes.plot(
        [p.frequency_hz for p in reference.points],
        [100.0 * p.damping_ratio for p in reference.points],
        "D",
        color=ALERT,
        markersize=11.0,
        markerfacecolor="none",
        markeredgewidth=1.1,
        label=reference.name,
    )


def _simulated(axes: Axes, simulated: Mapping[str, Sequence[DampingPoint]]) -> None:
    for name, points in simulated.items():
        axes.plot(
            [p.frequency_hz for p in points],
            [100.0 * p.damping_ratio for p in points],
            model_marker(name),
            color=model_colour(name),
            markersize=7.5,
            markerfacecolor="none",
            markeredgewidth=1.3,
            label=f"simulated, {model_name(name)}",
        )


def _measured(axes: Axes, points: Sequence[DampingPoint]) -> None:
    values = 100.0 * np.array([p.damping_ratio for p in points])
    low = 100.0 * np.array([p.low for p in points])
    high = 100.0 * np.array([p.high for p in points])
    reach = np.nan_to_num(np.abs(np.vstack((values - low, high - values))))
    frequency = [p.frequency_hz for p in points]
    axes.errorbar(
        frequency,
        values,
        reach,
        fmt="o",
        color=INK,
        markersize=4.5,
        capsize=3,
        linewidth=1.2,
        label="measured, 90 % interval",
    )
    for point, value in zip(points, values, strict=True):
        if point.label:
            axes.annotate(
                point.label,
                (point.frequency_hz, value),
                xytext=(7, -10),
                textcoords="offset points",
                fontsize=8,
            )


def _frequency_span(points: Sequence[DampingPoint]) -> tuple[float, float]:
    frequency = [p.frequency_hz for p in points]
    return min(frequency) / 1.5, max(frequency) * 1.5


def _log_x(axes: Axes, span: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*span)
    subs = (1.0, 2.0, 5.0) if span[1] > 4.0 * span[0] else tuple(range(1, 10))
    ticks = LogLocator(base=10.0, subs=subs).tick_values(*span)
    axes.xaxis.set_major_locator(FixedLocator([t for t in ticks if span[0] <= t <= span[1]]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: significant(value, 2)))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _caption(*, with_curve: bool, with_models: bool) -> str:
    text = "Black dots are the measured modes. "
    if with_curve:
        text += (
            "The dashed curve is Rayleigh damping with α and β from the two lowest modes: it passes "
            "through these two and "
            "has no freedom left, so look at how far it lies from the measured dots above them. "
        )
    if with_models:
        text += "Open symbols are identified from the simulated decays by the same code as the measured ones."
    return text
