"""Damping ratio against frequency over all recordings, measured and by each model; against amplitude in one."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from modal_id import IdentifiedMode
from modalcam.pipeline import BeamResult, RunResult
from modalcam.report.figures.base import BAND_SD, FigureKind, RecordingSubject, Target
from modalcam.report.signals import instantaneous, shown_mode
from modalcam.report.style import (
    ALERT,
    FIT,
    INK,
    MEASURED,
    RAYLEIGH,
    PointLabel,
    Style,
    few_ticks,
    figure_label,
    legend_above,
    log_y,
    place_labels,
    significant,
)
from sim.comparison import DecayComparison, ModelDecay
from sim.damping import DAMPING_MODELS, MeasuredDamping, rayleigh_to_all
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Width of a phone's window at which the letters are as large as those of the text around the figure.
_WIDTH_IN = 4.0
# Diameter of the filled symbols, radius of the open ones and of the diamonds, and least height of the axes, in points.
_FILLED_PT = 4.5
_OPEN_PT = 3.75
_DIAMOND_PT = 6.0
_AXES_PT = 130.0
# Relative error of a damping ratio from which on its factor is written at the point.
_WRITTEN = 0.05
# Largest over smallest damping ratio from which on the axis is logarithmic.
_WIDE = 20.0
_ALL_MODES = "Rayleigh curve, fitted to all modes"


@dataclass(frozen=True)
class DampingPoint:
    """One mode: frequency in Hz, damping ratio, its 90 % interval, and what is written beside it."""

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


@dataclass(frozen=True)
class DampingShown:
    """Measured damping ratios, those of the simulated decays by damping model, and Rayleigh curves.

    `rayleigh` and `rayleigh_all` are alpha (1/s) and beta (s) from the two lowest modes and fitted to all modes.
    """

    measured: tuple[DampingPoint, ...]
    models: dict[str, tuple[DampingPoint, ...]]
    rayleigh: tuple[float, float] | None
    reference: Reference | None = None
    rayleigh_all: tuple[float, float] | None = None

    @property
    def ratios_of_all(self) -> tuple[tuple[float, str], ...]:
        """Fitted over measured damping ratio with the name of the mode, the smallest and the largest."""
        if self.rayleigh_all is None:
            return ()
        ratios = [
            (
                float(rayleigh_damping_ratio(np.array(p.frequency_hz), *self.rayleigh_all)) / p.damping_ratio,
                p.label,
            )
            for p in self.measured
        ]
        return min(ratios), max(ratios)

    @property
    def intervals_hidden(self) -> bool:
        """Whether every 90 % interval is shorter than the symbol of its mode, so that none can be seen."""
        drawn = [*self.measured, *(point for points in self.models.values() for point in points)]
        low, high = min(p.damping_ratio for p in drawn), max(p.damping_ratio for p in drawn)
        symbol = _FILLED_PT / _AXES_PT
        if low > 0.0 and high > _WIDE * low:
            symbol *= float(np.log(high / low))
            return all(p.high < p.low * np.exp(symbol) for p in self.measured)
        return all(p.high - p.low < symbol * high for p in self.measured)


def _shows(result: RunResult) -> DampingShown | None:
    shown = _of_run(result, {key for key, entry in DAMPING_MODELS.items() if entry.variant_of is None})
    return None if shown is None else replace(shown, rayleigh_all=_fitted_to_all(shown))


def _fitted_to_all(shown: DampingShown) -> tuple[float, float] | None:
    """Alpha and beta by least squares over all modes; None where they would not differ from those of two modes."""
    points = [p for p in shown.measured if p.label and p.damping_ratio > 0.0]
    if shown.rayleigh is None or len({p.label for p in points}) < 3 or len(points) < len(shown.measured):
        return None
    fitted = rayleigh_to_all(
        MeasuredDamping(
            tuple(range(1, len(points) + 1)),
            tuple(p.frequency_hz for p in points),
            tuple(p.damping_ratio for p in points),
        )
    )
    return fitted.alpha_1_s, fitted.beta_s


def _shows_variants(result: RunResult) -> DampingShown | None:
    variants = {
        key: entry.variant_of for key, entry in DAMPING_MODELS.items() if entry.variant_of is not None
    }
    shown = _of_run(result, {*variants, *variants.values()})
    return shown if shown is not None and variants.keys() & shown.models.keys() else None


def _of_run(result: RunResult, models: Container[str | None]) -> DampingShown | None:
    measured: list[DampingPoint] = []
    decays: list[tuple[ModelDecay, float]] = []
    for recording in result.recordings:
        found = recording.identified
        mode = None if found is None else shown_mode(found)
        if mode is not None:
            measured.append(measured_point(mode))
            if isinstance(recording.comparison, DecayComparison):
                decays += [(d, mode.damping_ratio) for d in recording.comparison.models if d.model in models]
    return damping_shown(measured, decays, result.beam)


def measured_point(mode: IdentifiedMode) -> DampingPoint:
    """An identified mode."""
    label = "" if mode.number is None else f"mode {mode.number}"
    return DampingPoint(mode.frequency_hz, mode.damping_ratio, *mode.damping_interval(), label)


def damping_shown(
    measured: Sequence[DampingPoint],
    decays: Iterable[tuple[ModelDecay, float]],
    beam: BeamResult | None,
    reference: Reference | None = None,
) -> DampingShown | None:
    """Data of the figure; None where there are not two points to compare.

    Each of `decays` comes with the damping ratio measured in its recording.
    """
    models: dict[str, tuple[DampingPoint, ...]] = {}
    for decay, own in decays:
        if np.isfinite(decay.damping_ratio) and np.isfinite(decay.frequency_hz):
            ratio = decay.damping_ratio / own if own > 0.0 else float("nan")
            label = f"×{significant(ratio, 2)}" if abs(ratio - 1.0) >= _WRITTEN else ""
            point = DampingPoint(decay.frequency_hz, decay.damping_ratio, label=label)
            models[decay.model] = (*models.get(decay.model, ()), point)
    if not measured or (len(measured) == 1 and not models):
        return None
    rayleigh = None if beam is None else (beam.rayleigh_alpha_1_s, beam.rayleigh_beta_s)
    if rayleigh is not None and not np.all(np.isfinite(rayleigh)):
        rayleigh = None
    return DampingShown(tuple(measured), models, rayleigh, reference)


def rayleigh_damping_ratio(frequency_hz: FloatArray, alpha_1_s: float, beta_s: float) -> FloatArray:
    """``alpha / (2 omega) + beta omega / 2``: damping ratio of a mode of that frequency by Eq. 3."""
    omega = 2.0 * np.pi * frequency_hz
    return np.asarray(0.5 * (alpha_1_s / omega + beta_s * omega))


def _draw(figure: Figure, shown: DampingShown) -> None:
    # Room for the labels of a third model and a second curve, and for another source and its two rows of the legend.
    extra_in = 0.4 * max(len(shown.models) - 2, 0) + 0.8 * (shown.reference is not None)
    extra_in += 0.3 * (shown.rayleigh_all is not None)
    figure.set_figheight(figure.get_figheight() + extra_in)
    axes = figure.subplots()
    frequency = [p.frequency_hz for p in shown.measured]
    span = (min(frequency) / 1.5, max(frequency) * 1.5)
    f = np.geomspace(*span, 160)
    drawn, curves = list(shown.measured), []
    if shown.rayleigh is not None:
        curves.append(100.0 * rayleigh_damping_ratio(f, *shown.rayleigh))
        axes.plot(f, curves[-1], "--", color=RAYLEIGH, linewidth=1.3, label="Rayleigh curve, Eq. 3")
    if shown.rayleigh_all is not None:
        entry = DAMPING_MODELS["rayleigh_all_modes"]
        curves.append(100.0 * rayleigh_damping_ratio(f, *shown.rayleigh_all))
        axes.plot(f, curves[-1], entry.line_style, color=entry.colour, linewidth=1.0, label=_ALL_MODES)
    if shown.reference is not None:
        curves.append(_reference(axes, shown.reference, f))
        drawn += shown.reference.points
    labels: list[PointLabel] = []
    for model, points in shown.models.items():
        entry = DAMPING_MODELS[model]
        style: Style = {"color": entry.colour, "markersize": 2.0 * _OPEN_PT, "markeredgewidth": 1.3}
        _open_symbols(axes, points, entry.marker, f"simulated, {entry.name}", style)
        labels += _labels(points, entry.colour, first=(-1, 1), bold=True)
        drawn += points
    _measured(axes, shown)
    _log_x(axes, span)
    _y_axis(axes, [v for p in drawn for v in (p.damping_ratio, p.low, p.high) if np.isfinite(v)])
    axes.set(xlabel="natural frequency (Hz)", ylabel="damping ratio ζ (%)")
    legend_above(figure, columns=2)
    radius = _OPEN_PT if shown.reference is None else _DIAMOND_PT
    symbols = np.array([(p.frequency_hz, 100.0 * p.damping_ratio, radius) for p in drawn])
    lines = np.array([(x, y) for curve in curves for x, y in zip(f, curve, strict=True)])
    place_labels(figure, axes, [*_labels(shown.measured, INK, first=(0, -1)), *labels], symbols, lines)


def _labels(
    points: Sequence[DampingPoint], colour: str, *, first: tuple[int, int], bold: bool = False
) -> list[PointLabel]:
    return [
        PointLabel(p.label, p.frequency_hz, 100.0 * p.damping_ratio, colour, first, bold)
        for p in points
        if p.label
    ]


def _y_axis(axes: Axes, values: Sequence[float]) -> None:
    low, high = 100.0 * min(values), 100.0 * max(values)
    if low > 0.0 and high > _WIDE * low:
        log_y(axes, (1.0, 2.0, 5.0))
        axes.set_ylim(low / 1.5, high * 1.5)
    else:
        axes.set_ylim(min(0.0, 1.15 * low), max(1e-4, 1.15 * high))


def _reference(axes: Axes, reference: Reference, f: FloatArray) -> FloatArray:
    curve = 100.0 * rayleigh_damping_ratio(f, reference.alpha_1_s, reference.beta_s)
    label = f"Rayleigh curve, {reference.name}"
    axes.plot(f, curve, color=ALERT, linewidth=1.3, linestyle=(0, (1, 2)), label=label)
    style: Style = {"color": ALERT, "markersize": 2.0 * _DIAMOND_PT - 3.0, "markeredgewidth": 1.1}
    _open_symbols(axes, reference.points, "D", reference.name, style)
    return curve


def _open_symbols(axes: Axes, points: Sequence[DampingPoint], marker: str, label: str, style: Style) -> None:
    x, y = [p.frequency_hz for p in points], [100.0 * p.damping_ratio for p in points]
    axes.plot(x, y, marker, markerfacecolor="none", label=label, **style)


def _measured(axes: Axes, shown: DampingShown) -> None:
    values, low, high = 100.0 * np.array([(p.damping_ratio, p.low, p.high) for p in shown.measured]).T
    reach = np.nan_to_num(np.abs(np.vstack((values - low, high - values))))
    style: Style = {"fmt": "o", "color": INK, "markersize": _FILLED_PT, "capsize": 3, "linewidth": 1.2}
    label = "measured" if shown.intervals_hidden else "measured, 90 % interval"
    axes.errorbar([p.frequency_hz for p in shown.measured], values, reach, label=label, **style)


def _log_x(axes: Axes, span: tuple[float, float]) -> None:
    from matplotlib.ticker import (  # noqa: PLC0415 - only to draw
        FixedLocator,
        FuncFormatter,
        LogLocator,
        NullFormatter,
    )

    axes.set_xscale("log")
    axes.set_xlim(*span)
    subs = (1.0, 2.0, 5.0) if span[1] > 4.0 * span[0] else tuple(range(1, 10))
    ticks = LogLocator(base=10.0, subs=subs).tick_values(*span)
    axes.xaxis.set_major_locator(FixedLocator([t for t in ticks if span[0] <= t <= span[1]]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: significant(value, 2)))
    axes.xaxis.set_minor_formatter(NullFormatter())


DAMPING = FigureKind("damping", "damping", _shows, _draw, height_in=2.7, width_in=_WIDTH_IN, essential=True)
VARIANTS = FigureKind("variants", "comparison", _shows_variants, _draw, height_in=3.5, width_in=_WIDTH_IN)


def _draw_instantaneous(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    seen = instantaneous(found, mode, channel)
    if seen.amplitude.size < 3:
        return False
    f, initial = mode.frequency_hz, float(np.abs(mode.shape[channel]))
    left, right = figure.subplots(1, 2)
    low, high = mode.damping_interval()
    zeta, zeta_sd = 100.0 * seen.damping_ratio, 100.0 * seen.damping_ratio_sd
    _windows(left, seen.amplitude, zeta, zeta_sd, (100.0 * low, 100.0 * high))
    low, high = mode.frequency_interval_hz()
    _windows(right, seen.amplitude, seen.frequency_hz - f, seen.frequency_sd_hz, (low - f, high - f))
    axis = np.linspace(0.0, max(initial, float(np.max(seen.amplitude))), 60)
    fit = mode.amplitude_dependence
    if fit is not None and fit.significant:
        curve = fit.curve
        if curve is not None:
            a = curve.amplitude * initial / float(np.nanmax(np.abs(mode.shape)))
            _law(left, a, 100.0 * curve.damping_ratio, 100.0 * curve.damping_ratio_sd)
            _law(right, a, curve.frequency_hz - f, curve.frequency_sd_hz)
        else:
            a = axis / initial
            zeta_sd, f_sd = (
                np.hypot(fit.zeta0_sd, fit.zeta1_sd * a),
                np.hypot(fit.f0_sd_hz, fit.f2_sd_hz * a**2),
            )
            _law(left, axis, 100.0 * (fit.zeta0 + fit.zeta1 * a), 100.0 * zeta_sd)
            _law(right, axis, fit.f0_hz + fit.f2_hz * a**2 - f, f_sd)
    left.set_ylabel("damping ratio ζ (%)")
    right.set_ylabel("frequency − fitted (Hz)")
    for axes in (left, right):
        axes.set(xlabel=f"amplitude ({figure_label(found.series.unit)})", xlim=(0.0, axis[-1]))
        few_ticks(axes, x=6)
    legend_above(figure, left.get_legend_handles_labels(), columns=3)
    return True


def _windows(axes: Axes, amplitude: Any, value: Any, sd: Any, band: tuple[float, float]) -> None:
    axes.axhspan(*band, color=FIT, alpha=0.25, linewidth=0.0, label="fitted constant, 90 %")
    style: Style = {"fmt": "o", "markersize": 2.6, "linewidth": 0.8, "color": MEASURED}
    axes.errorbar(amplitude, value, sd, label="windows of the record", **style)


def _law(axes: Axes, axis: FloatArray, value: FloatArray, sd: FloatArray) -> None:
    axes.plot(axis, value, "--", color=ALERT, linewidth=1.2, label="fitted amplitude dependence, 90 %")
    axes.fill_between(
        axis, value - BAND_SD * sd, value + BAND_SD * sd, color=ALERT, alpha=0.15, linewidth=0.0
    )


INSTANTANEOUS = FigureKind("instantaneous", "recording", RecordingSubject.decaying, _draw_instantaneous)
